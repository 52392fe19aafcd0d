"""The descent with motions that are held: where a change that they promise is not what it does."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ident.arm.descent import BACK, _minimised
from ident.effects.base import Effect
from ident.effects.friction import LinkCoulomb, LinkViscous


class Overshooting:
    """chi^2 of one number, least at 1; under a motion that is held its minimum is `times` as far off the other way."""

    def __init__(self, effect: Effect, times: float) -> None:
        one, none = np.ones(1), np.zeros(1, dtype=bool)
        self.problem = SimpleNamespace(
            effects=(effect,), late=False, scale=100.0 * one, free=~none, low=-1e9 * one, high=1e9 * one,
            dampings=none, giving=none, springs=none, shapes=none,
        )  # fmt: skip
        self.times, self.slid, self.held = times, {}, 0.0
        self.motions: list[float] = []
        self.asked, self.late_at = 0, 0  # equations; motions after which it is late

    def hold(self, vector: Any, doubt: float) -> None:
        self.held = float(vector[0])
        self.motions.append(self.held)
        self.problem.late = self.problem.late or len(self.motions) == self.late_at

    def _off(self, vector: Any) -> float:
        return float(vector[0]) - self.held - self.times * (1.0 - self.held)

    def chi_squared(self, vector: Any) -> float:
        return 1e4 * (self._off(vector) ** 2 + (self.held - 1.0) ** 2)

    def equations(self, vector: Any) -> tuple[float, Any, Any]:
        self.asked += 1
        return self.chi_squared(vector), np.array([1e6 * self._off(vector)]), 1e8 * np.eye(1)

    def curved(self, vector: Any, step: Any, ahead: float) -> Any:
        return np.zeros(1)


@pytest.mark.parametrize("times", [1.4, 2.5, 3.5])
def test_dry_friction_goes_part_of_the_way_that_leads_beyond_where_it_was(times: float) -> None:
    """Twice as far as it should is as far off as before; a half or a quarter of that is nearer."""
    sums: Any = Overshooting(LinkCoulomb(1, (0.1,)), times)
    found = _minimised(sums, np.zeros(1), (), 12, 0.03)
    assert abs(found.vector[0] - 1.0) < 0.2
    assert bool(np.isclose(sums.motions, times * BACK[0], atol=1e-3).any()) == (times > 2.0)


def test_what_is_not_dry_is_taken_back_whole() -> None:
    sums: Any = Overshooting(LinkViscous(1, (0.1,)), 3.5)
    found = _minimised(sums, np.zeros(1), (), 12, 0.03)
    assert not np.isclose(sums.motions, 3.5 * BACK[0], atol=1e-3).any() and abs(found.vector[0] - 1.0) > 0.5


def test_what_is_late_is_weighed_once_and_goes_one_step_at_most() -> None:
    sums: Any = Overshooting(LinkCoulomb(1, (0.1,)), 1.4)
    sums.problem.late = True
    found = _minimised(sums, np.zeros(1), (), 12, 0.03)
    assert sums.motions == [0.0] and sums.asked <= 2 and not found.converged


def test_what_becomes_late_while_motions_are_found_anew_looks_for_no_others() -> None:
    sums: Any = Overshooting(LinkCoulomb(1, (0.1,)), 2.5)
    sums.late_at = 2
    _minimised(sums, np.zeros(1), (), 12, 0.03)
    assert len(sums.motions) == 2
