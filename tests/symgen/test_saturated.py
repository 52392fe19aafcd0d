"""d cells out of many: exchange reaches what exhaustive search does, merit is what it says."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from arms import arm, factoring_of
from chains import general_chain, postures
from numpy.typing import NDArray

from symgen.basis import factor
from symgen.cells import Rows
from symgen.chain import Chain
from symgen.errors import PlanError
from symgen.holding import Holding, box
from symgen.saturated import Merit, candidates, maxvol


def free(chain: Chain) -> Holding:
    return Holding(chain, box(chain.limits), None)


def volume(F: np.ndarray) -> float:
    return abs(float(np.linalg.det(F)))


@pytest.mark.parametrize("seed", range(8))
def test_exchange_ends_where_no_single_swap_helps_and_near_the_best_of_all(seed: int) -> None:
    F = np.random.default_rng(seed).normal(size=(14, 4))
    chosen = maxvol(F)
    reached = volume(F[chosen])
    for column in range(4):
        for row in range(14):
            swapped = chosen.copy()
            swapped[column] = row
            assert volume(F[swapped]) <= 1.001 * reached + 1e-12
    best = max(volume(F[list(rows)]) for rows in combinations(range(14), 4))
    started = max(volume(F[maxvol(F, first)]) for first in range(14))
    assert reached <= started * 1.001 and started >= 0.999 * best


def test_merit_is_determinant_over_worst_amplification_and_its_slope_is_that_of_differences() -> None:
    rows = Rows(factoring_of("ypp3"), np.array([0.0, 0.2, 0.1]))
    merit, chain = Merit(rows), rows.factoring.chain
    cells = candidates(rows, free(chain))[np.arange(9)]
    F = rows.of_cells(cells)
    everywhere = rows(postures(chain, 20000))
    covariance = np.linalg.inv(F.T @ F)
    worst = np.sqrt(np.einsum("mid,de,mie->mi", everywhere, covariance, everywhere).mean(axis=0).max())
    value, slope = merit.with_slope(F)
    plain = 6 * np.linalg.slogdet(F.T @ F)[1] / len(F) - np.log(worst)
    # the smooth maximum of 3 joints is above the largest by at most 3^(1/8) in the square; 500 postures stand for all
    assert plain - np.log(3) / 16 - 0.05 <= value <= plain + 0.05
    for seed in range(3):
        step = 1e-6 * np.random.default_rng(seed).normal(size=F.shape)
        assert merit(F + step) - merit(F - step) == pytest.approx(2 * (slope * step).sum(), rel=1e-5)


def test_exchange_by_merit_raises_it_and_says_truly_what_a_swap_brings() -> None:
    rows = Rows(factoring_of("ypp3"), np.zeros(3))
    merit, F = Merit(rows), rows(postures(rows.factoring.chain, 60)).reshape(180, -1)

    def merit_of(chosen: np.ndarray) -> float:
        return sharp(merit, F[chosen])

    before = maxvol(F)
    after = merit.exchanged(F, before)
    assert merit_of(after) >= merit_of(before)
    for column in range(len(after)):
        for row in range(0, 180, 7):
            swapped = after.copy()
            swapped[column] = row
            if volume(F[swapped]) > 0.3 * volume(F[after]):
                assert merit_of(swapped) <= merit_of(after) + 1.1e-3


def sharp(merit: Merit, F: np.ndarray) -> float:
    """The merit with the true maximum over the joints."""
    G = np.linalg.inv(F)
    worst = max(np.trace(G.T @ M @ G) for M in merit.moments)
    return 12 / len(F) * float(np.linalg.slogdet(F)[1]) - float(np.log(worst)) / 2


def test_too_few_feasible_postures_are_refused_in_one_line() -> None:
    rows = Rows(factoring_of("ypp3"), np.zeros(3))
    holding = Holding(arm("ypp3"), box(arm("ypp3").limits), lambda q: np.abs(q[:, 2]) < 1e-3)
    with pytest.raises(
        PlanError, match=r"ypp3: the postures the arm may hold .* tell only \d of 9 constants apart"
    ) as caught:
        candidates(rows, holding)
    assert "\n" not in str(caught.value)


def test_an_unusual_wall_leaves_a_plan_wherever_its_postures_tell_enough() -> None:
    """Nothing is feasible near rest, and joints that do not matter must go together: no single joint can be moved alone."""

    def thin(q: np.ndarray) -> NDArray[np.bool_]:
        return (np.abs(q[:, 0] - q[:, 1]) < 0.6) & (np.abs(q[:, 0] + q[:, 2]) > 1.0) & (q[:, 1] < -0.8)

    rows = Rows(factoring_of("ypp3"), np.zeros(3))
    chain = rows.factoring.chain
    holding = Holding(chain, box(chain.limits), thin)
    assert not thin(holding.rest[None]).any()
    start = candidates(rows, holding)
    assert len(start) >= 9 and holding.keeps(start).all()
    assert np.linalg.matrix_rank(rows.of_cells(start)) == 9


def test_postures_that_can_not_tell_the_constants_are_refused_by_name() -> None:
    chain = general_chain(0, 3)
    stuck = replace(chain.joints[1], lower=0.5, upper=0.5)
    rows = Rows(factor(replace(chain, joints=(chain.joints[0], stuck, chain.joints[2]))), np.zeros(3))
    with pytest.raises(PlanError, match=r"seed 0: .* only \d+ of 13 constants .*narrowest: j2, 0 rad"):
        candidates(rows, free(rows.factoring.chain))
