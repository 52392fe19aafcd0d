"""A plan bettered is better, feasible, and left alone once it is good enough."""

from __future__ import annotations

import numpy as np
import pytest
from arms import arm, factoring_of
from numpy.typing import NDArray

from symgen.cells import Cells, Rows
from symgen.holding import Holding, Mask, box
from symgen.optimal import Optimum, d_efficiency, further, optima
from symgen.renewal import renewed
from symgen.saturated import Merit, Search, candidates, saturated


def beside_a_wall(q: np.ndarray) -> NDArray[np.bool_]:
    return (q[:, 1:].sum(axis=1) < 2.0) & (q[:, 2] > -1.0)


def planned(mask: Mask | None) -> tuple[Rows, Holding, Cells, Optimum]:
    rows = Rows(factoring_of("ur5"), np.zeros(6))
    holding = Holding(arm("ur5"), box(arm("ur5").limits), mask)
    start = candidates(rows, holding)
    best = further(optima(rows, holding, start), 4)
    return rows, holding, saturated(rows, start[np.arange(28)], best, holding, Search(2, 1, 0, 0)), best


@pytest.mark.parametrize("mask", [None, beside_a_wall])
def test_a_plan_bettered_is_better_and_still_feasible(mask: Mask | None) -> None:
    rows, holding, cells, best = planned(mask)
    found = renewed(rows, cells, best, holding, 8, 1.0, np.random.default_rng(0))
    merit = Merit(rows)
    # 5 %: a plan that was not refined at all is further than that from any local optimum
    assert merit(rows.of_cells(found)) > merit(rows.of_cells(cells)) + 0.05
    assert len(found) == len(cells) and holding.keeps(found).all()
    low, high = holding.allowed.T
    assert (found.q >= low).all() and (found.q <= high).all()


def test_a_plan_that_is_good_enough_is_left_alone() -> None:
    rows, holding, cells, best = planned(None)
    reached = d_efficiency(rows.of_cells(cells), best.log_det_bound)
    same = renewed(rows, cells, best, holding, 8, reached, np.random.default_rng(0))
    assert np.array_equal(same.q, cells.q) and np.array_equal(same.joint, cells.joint)
    other = renewed(rows, cells, best, holding, 8, reached + 1e-9, np.random.default_rng(0))
    assert not np.array_equal(other.q, cells.q)
