"""A plan bettered is better, feasible, and left alone once it is good enough."""

from __future__ import annotations

import numpy as np
import pytest
from arms import arm, factoring_of
from numpy.typing import NDArray

from symgen.cells import Cells, Rows
from symgen.holding import Holding, Mask, box
from symgen.optimal import d_efficiency, further, optima
from symgen.renewal import renewed
from symgen.saturated import Merit, Search, candidates, refining, saturated


def beside_a_wall(q: np.ndarray) -> NDArray[np.bool_]:
    return (q[:, 1:].sum(axis=1) < 2.0) & (q[:, 2] > -1.0)


class Planned:
    """A plan of the UR5 that was hardly looked for, and what betters it."""

    def __init__(self, mask: Mask | None):
        self.rows = Rows(factoring_of("ur5"), np.zeros(6))
        self.merit = Merit(self.rows)
        self.holding = Holding(arm("ur5"), box(arm("ur5").limits), mask)
        start = candidates(self.rows, self.holding)
        self.best = further(optima(self.rows, self.holding, start), 4)
        first = start[np.arange(28)]
        self.refine = refining(self.rows, self.merit, self.holding)
        self.cells = saturated(self.rows, self.merit, first, self.best, self.refine, Search(2, 1, 0, 0))

    def renewed(self, enough: float) -> Cells:
        rng = np.random.default_rng(0)
        return renewed(self.rows, self.merit, self.cells, self.best, self.refine, 8, enough, rng)


@pytest.mark.parametrize("mask", [None, beside_a_wall])
def test_a_plan_bettered_is_better_and_still_feasible(mask: Mask | None) -> None:
    plan = Planned(mask)
    found = plan.renewed(1.0)
    # 5 %: a plan that was not refined at all is further than that from any local optimum
    assert plan.merit(plan.rows.of_cells(found)) > plan.merit(plan.rows.of_cells(plan.cells)) + 0.05
    assert len(found) == len(plan.cells) and plan.holding.keeps(found).all()
    low, high = plan.holding.allowed.T
    assert (found.q >= low).all() and (found.q <= high).all()


def test_a_plan_that_is_good_enough_is_left_alone() -> None:
    plan = Planned(None)
    reached = d_efficiency(plan.rows.of_cells(plan.cells), plan.best.log_det_bound)
    same = plan.renewed(reached)
    assert np.array_equal(same.q, plan.cells.q) and np.array_equal(same.joint, plan.cells.joint)
    assert not np.array_equal(plan.renewed(reached + 1e-9).q, plan.cells.q)
