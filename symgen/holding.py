"""Where an arm is held for a measurement: on round numbers inside its limits, the joints that do not matter at rest."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from symgen.cells import Cells, spread
from symgen.chain import REVOLUTE, Array, Chain

#: Tells which postures [m, n] an arm may hold: a mask [m].
Mask = Callable[[Array], NDArray[np.bool_]]

#: Left free at either end of a joint's range [rad, m], but no more than this part of it: a swing and a poor zero.
MARGIN, MARGIN_PART = 0.05, 0.05

#: Angles and slides of a plan are whole multiples of this [rad, m], so that a plan is the same on every machine.
ROUNDING = 1e-4

#: Other places tried for the joints that a cell does not depend on: for the excited one alone, and for all of them.
_OTHER_RESTS, _OTHER_POSTURES = 3, 3

#: Postures looked at for feasible ones, more and more until there are enough.
_LOOKED_AT = (100, 1_000, 10_000)

#: Parts of the way to its aim that a cell tries.
_PARTS = np.array([0.7, 0.4, 0.2, 0.08, 0.03])[:, None]


def box(limits: Array) -> Array:
    """Returns the joint intervals a plan may use [n, 2]: the limits less a margin, on whole multiples of `ROUNDING`."""
    low, high = limits.T
    inset = np.minimum(MARGIN, MARGIN_PART * (high - low))
    inner = np.stack([np.ceil((low + inset) / ROUNDING), np.floor((high - inset) / ROUNDING)], axis=1) * ROUNDING
    fits = inner[:, 0] <= inner[:, 1]
    return np.where(fits[:, None], inner, limits.mean(axis=1, keepdims=True))


def home(allowed: Array) -> Array:
    """Returns the resting posture [n]: zero where allowed, else the middle of the interval."""
    inside = (allowed[:, 0] <= 0) & (allowed[:, 1] >= 0)
    return np.where(inside, 0.0, _round(allowed.mean(axis=1), allowed))


class Holding:
    """The postures of one arm in the box `allowed` [n, 2], and which of them are `feasible` (all, where None).

    What `feasible` knows to be `hopeless` (see `feasible.Feasible`) is not tried elsewhere.
    """

    def __init__(self, chain: Chain, allowed: Array, feasible: Mask | None):
        self.allowed, self.feasible = allowed, feasible
        self._hopeless = getattr(feasible, "hopeless", lambda q, joint: np.zeros(len(q), dtype=bool))
        self.rest = home(allowed)
        self._joints = np.arange(chain.n)
        self._turning = np.array([joint.type == REVOLUTE for joint in chain.joints])

    def keeps(self, cells: Cells) -> NDArray[np.bool_]:
        """Which cells [N] may be run with the joints that do not matter where they are."""
        if self.feasible is None or not len(cells):
            return np.ones(len(cells), dtype=bool)
        return self.feasible(self._exact(cells.q))

    def placed(self, cells: Cells) -> tuple[NDArray[np.bool_], Cells]:
        """Which cells [N] may be run, and the cells as they are run: whole turns taken off, rounded, the joints that J_ii
        does not depend on (1..i) at rest, or elsewhere where only that is feasible."""
        free = self._joints <= cells.joint[:, None]
        q = np.where(free, self.rest, self._exact(cells.q))
        passed = np.ones(len(q), dtype=bool) if self.feasible is None else self.feasible(q)
        if passed.all():
            return passed, Cells(cells.joint, q)
        own = self._joints == cells.joint[:, None]
        elsewhere = [(own, other) for other in self._exact(spread(self.allowed, _OTHER_RESTS, 0.7))]
        elsewhere += [(free, other) for other in self.others]
        left = np.flatnonzero(~passed)
        left = left[~self._hopeless(q[left], cells.joint[left])]
        for moving, other in elsewhere:  # first the excited joint alone, then all that do not matter
            moved = np.where(moving[left], other, q[left])
            good = self.keeps(Cells(cells.joint[left], moved))
            q[left[good]], passed[left[good]] = moved[good], True
            left = left[~good]
        return passed, Cells(cells.joint, q)

    def towards(self, cells: Cells, aim: Cells) -> Cells:
        """Each cell moved to its aim, or the largest of some parts of the way there at which it is feasible."""
        return aim if self.feasible is None else self.short_of(cells, aim, self.keeps(aim))

    def short_of(self, cells: Cells, aim: Cells, passed: NDArray[np.bool_]) -> Cells:
        """The same, where it is known which aims are feasible."""
        q, left = np.where(passed[:, None], aim.q, cells.q), np.flatnonzero(~passed)
        tried = cells.q[left, None] + _PARTS * (aim.q - cells.q)[left, None]
        kept = self.keeps(Cells(np.repeat(cells.joint[left], len(_PARTS)), tried.reshape(-1, q.shape[1])))
        kept = kept.reshape(-1, len(_PARTS))
        moved = kept.any(axis=1)
        q[left[moved]] = tried[moved, kept[moved].argmax(axis=1)]
        return Cells(cells.joint, q)

    def found(self, least: int) -> Array:
        """Feasible postures [m, n], evenly spread: at least so many, or all there are among the most that are looked at."""
        q = np.zeros((0, len(self.rest)))
        for count in _LOOKED_AT:
            q = self._exact(spread(self.allowed, count, 0.7))
            q = q if self.feasible is None else q[self.feasible(q)]
            if len(q) >= least:
                break
        return q

    @cached_property
    def others(self) -> Array:
        """Some feasible postures [m, n], those nearest to rest first: where joints may be that do not matter."""
        q = self.found(_OTHER_POSTURES)
        near = np.argsort(np.round(np.abs(q - self.rest).max(axis=1), 6), kind="stable")
        return q[near[:: max(len(q) // _OTHER_POSTURES, 1)][:_OTHER_POSTURES]]

    def _exact(self, q: Array) -> Array:
        """Postures [N, n] with whole turns taken off where the box allows it, rounded."""
        turned = q - np.where(self._turning, 2 * np.pi * np.round(q / (2 * np.pi)), 0.0)
        low, high = self.allowed.T
        return _round(np.where((turned >= low) & (turned <= high), turned, q), self.allowed)


def _round(q: Array, allowed: Array) -> Array:
    """The nearest whole multiples of `ROUNDING`; a value `allowed` that this would take out of its interval stays."""
    low, high = allowed.T
    rounded = np.round(q / ROUNDING) * ROUNDING
    leaves = (low <= q) & (q <= high) & ((rounded < low) | (rounded > high))
    return np.where(leaves, q, rounded)
