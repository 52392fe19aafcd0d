"""Rows of single cells and their slopes, judged by the regressor and by differences; postures spread evenly."""

from __future__ import annotations

import numpy as np
import pytest
from arms import factoring_of
from chains import chains, postures
from hypothesis import given, settings
from hypothesis import strategies as st

from symgen.basis import factor
from symgen.cells import Cells, Rows, every_joint, ranked, spread
from symgen.chain import Chain
from symgen.regressor import C_rows

#: Rounding of some hundred additions times the condition of W, below 1e3 on these arms.
ROUNDING = 1e-11

LAW = settings(derandomize=True, deadline=None, max_examples=15)


def some_cells(chain: Chain, count: int, seed: int) -> Cells:
    return Cells(np.random.default_rng(seed).integers(0, chain.n, count), postures(chain, count, seed))


@LAW
@given(chains(1, 5), st.integers(0, 99))
def test_a_cells_row_is_the_regressors_over_sigma(chain: Chain, seed: int) -> None:
    found, rotor = factor(chain), np.arange(1.0, chain.n + 1)
    rows, cells = Rows(found, rotor), some_cells(chain, 6, seed)
    C = C_rows(found, cells.q)[np.arange(6), cells.joint]
    expected = C / (C @ found.alpha_cad[: found.d] + rotor[cells.joint])[:, None]
    assert np.abs(rows.of_cells(cells) - expected).max() <= ROUNDING * np.abs(expected).max()
    assert np.abs(rows(cells.q)[np.arange(6), cells.joint] - expected).max() <= ROUNDING * np.abs(expected).max()


@LAW
@given(chains(2, 5), st.integers(0, 99))
def test_the_slope_is_that_of_differences(chain: Chain, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, cells = Rows(factor(chain), rng.uniform(0, 1, chain.n)), some_cells(chain, 4, seed)
    F, slope = rows.traced(cells)
    by_row = rng.normal(size=F.shape)
    step = 1e-6
    differences = np.zeros(cells.q.shape)
    for k in range(chain.n):
        shift = step * np.eye(chain.n)[k]
        up, down = (rows.of_cells(Cells(cells.joint, cells.q + sign * shift)) for sign in (1, -1))
        differences[:, k] = (by_row * (up - down)).sum(axis=1) / (2 * step)
    # central differences lose eps / step to rounding and step^2 to curvature
    scale = np.abs(by_row * F).sum(axis=1).max()
    assert np.abs(slope(by_row) - differences).max() <= 1e-8 * scale


def test_rows_of_another_factoring_keep_the_scaling() -> None:
    believed, wider = factoring_of("ypp3", believe_zeros=True), factoring_of("ypp3")
    rows, cells = Rows(believed, np.zeros(3)), some_cells(believed.chain, 8, 0)
    C = C_rows(wider, cells.q)[np.arange(8), cells.joint]
    sigma = C @ wider.alpha_cad[: wider.d]
    assert (
        np.abs(rows.of_cells(cells, of=wider) - C / sigma[:, None]).max() <= ROUNDING * np.abs(C / sigma[:, None]).max()
    )
    assert np.abs(rows(cells.q, of=wider)[np.arange(8), cells.joint] - C / sigma[:, None]).max() <= 1e-9


def test_cells_are_picked_and_joined() -> None:
    cells = every_joint(np.array([[0.0, 1.0], [2.0, 3.0]]))
    assert cells.joint.tolist() == [0, 1, 0, 1]
    assert cells.q.tolist() == [[0.0, 1.0], [0.0, 1.0], [2.0, 3.0], [2.0, 3.0]]
    twice = cells[cells.joint == 1] + cells[np.array([0])]
    assert len(twice) == 3 and twice.joint.tolist() == [1, 1, 0] and twice.q[1].tolist() == [2.0, 3.0]


def test_postures_spread_evenly_fill_the_box_better_than_chance() -> None:
    limits = np.array([[-1.0, 3.0], [0.0, 0.5], [-2.0, -1.0]])
    even = (spread(limits, 512, 0.5) - limits[:, 0]) / (limits[:, 1] - limits[:, 0])
    assert (even >= 0).all() and (even < 1).all()

    boxes = {tuple(corner) for corner in np.floor(8 * even).astype(int)}
    # 512 random postures leave 512 / e = 188 of the 512 boxes empty, give or take 8
    assert 512 - len(boxes) < 188 - 7 * 8
    assert not np.array_equal(spread(limits, 4, 0.5), spread(limits, 4, 0.6))


@pytest.mark.parametrize("most", [0, 1, 7, 40, 99])
def test_the_largest_are_those_that_come_first_of_all(most: int) -> None:
    """Values that agree to single precision, too: mirror images."""
    values = np.random.default_rng(0).integers(0, 9, 40) + 1e-9 * np.random.default_rng(1).normal(size=40)
    assert np.array_equal(ranked(values, most), ranked(values)[:most])
