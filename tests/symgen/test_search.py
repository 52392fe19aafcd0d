"""The search for d cells: longer is better, all stay feasible, and what no exchange nearby betters is bettered from anywhere."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from arms import arm, factoring_of
from numpy.typing import NDArray

from symgen.cells import Cells, Rows
from symgen.holding import Holding, Mask, box
from symgen.kicks import POWER, enough
from symgen.optimal import Optimum, d_efficiency, further, optima
from symgen.saturated import Merit, candidates, refined
from symgen.search import Search, bettering, saturated, swept


def beside_a_wall(q: np.ndarray) -> NDArray[np.bool_]:
    return (q[:, 1:].sum(axis=1) < 2.0) & (q[:, 2] > -1.0)


class Arm:
    """The UR5, and the spread of measurements from which its plans are sought."""

    def __init__(self, mask: Mask | None = None):
        self.rows = Rows(factoring_of("ur5"), np.zeros(6))
        self.merit = Merit(self.rows)
        self.holding = Holding(arm("ur5"), box(arm("ur5").limits), mask)
        self.start = candidates(self.rows, self.holding)
        self.first, self.best = self.start[np.arange(28)], further(optima(self.rows, self.holding, self.start), 4)

    def planned(self, search: Search, best: Optimum | None = None) -> Cells:
        better = bettering(self.rows, self.merit, self.holding)
        return saturated(self.rows, self.merit, self.first, best or self.best, better, search)

    def worth(self, cells: Cells) -> float:
        return self.merit(self.rows.of_cells(cells))


@cache
def ur5_at(mask: Mask | None) -> Arm:
    """The same for all tests, none of which changes it."""
    return Arm(mask)


@pytest.mark.bench
def test_a_longer_search_is_not_worse() -> None:
    ur5 = ur5_at(None)
    searches = Search(1, 1, 0, 1, 0), Search(6, 1, 10, 1, 0), Search(12, 3, 30, 1, 8)
    found = [ur5.worth(ur5.planned(search)) for search in searches]
    assert ur5.worth(ur5.first) < found[0] < found[1] < found[2]


def test_all_cells_are_feasible_where_not_all_postures_are() -> None:
    ur5 = ur5_at(beside_a_wall)
    assert ur5.holding.keeps(ur5.start).all() and ur5.holding.keeps(ur5.best.cells).all()
    short, long = ur5.planned(Search(6, 2, 0, 1, 0)), ur5.planned(Search(6, 2, 40, 1, 8))
    for cells in (short, long):
        passed, placed = ur5.holding.placed(cells)
        assert passed.all() and beside_a_wall(placed.q).all()
    assert ur5.worth(long) > ur5.worth(short) + 0.1, "refined up to the walls"
    free = ur5_at(None)
    assert free.best.log_det > ur5.best.log_det
    assert free.worth(free.planned(Search(6, 2, 40, 1, 8))) > ur5.worth(long), "walls cost something"


@pytest.mark.parametrize(("mask", "gain"), [(None, 0.003), (beside_a_wall, 0.05)])
def test_sweeps_better_what_refinement_no_longer_does(mask: Mask | None, gain: float) -> None:
    ur5 = ur5_at(mask)
    cells = refined(ur5.rows, ur5.merit, ur5.planned(Search(2, 1, 0, 1, 0)), ur5.holding, 300)
    spent = refined(ur5.rows, ur5.merit, cells, ur5.holding, 300)
    found = swept(ur5.rows, ur5.merit, cells, ur5.holding, 8)
    # 0.12 is 1 % of D-efficiency
    assert ur5.worth(found) > ur5.worth(spent) + gain
    assert len(found) == len(cells) and ur5.holding.keeps(found).all()
    low, high = ur5.holding.allowed.T
    assert (found.q >= low).all() and (found.q <= high).all()
    assert swept(ur5.rows, ur5.merit, cells, ur5.holding, 0) is cells


@pytest.mark.parametrize("mask", [None, beside_a_wall])
@pytest.mark.bench
def test_kicks_better_what_sweeps_no_longer_do(mask: Mask | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Until that is enough; all cells stay feasible, and the same are found again."""
    ur5 = ur5_at(mask)
    plan = swept(ur5.rows, ur5.merit, ur5.planned(Search(6, 1, 30, 1, 0)), ur5.holding, 8)

    def efficiency(cells: Cells) -> float:
        return d_efficiency(ur5.rows.of_cells(cells), ur5.best.log_det_bound)

    def kicked(least: float) -> Cells:
        monkeypatch.setattr("symgen.kicks.ENOUGH", least)
        merit = Merit(ur5.rows, POWER)
        return enough(ur5.rows, merit, plan, ur5.best, bettering(ur5.rows, merit, ur5.holding))

    before = efficiency(plan)
    assert kicked(before - 0.001) is plan
    found = kicked(before + 0.001)
    assert efficiency(found) >= before + 0.001
    assert len(found) == len(plan) and ur5.holding.keeps(found).all()
    assert np.array_equal(found.q, kicked(before + 0.001).q)
