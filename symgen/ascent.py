"""Uphill in a box: limited-memory quasi-Newton steps, projected onto the bounds.

A library's minimiser would do as well; importing it takes longer than a plan.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from symgen.chain import Array

#: Steps remembered for the curvature, and the length of the first one [the unit of x] along its largest component.
_MEMORY, _FIRST = 10, 0.05

#: A step must gain this part of what the slope promises, and is shortened at most so often.
_GAINED, _SHORTER = 1e-4, 8

#: A step with less curvature than this, relative to the largest possible, tells nothing.
_CURVED = 1e-10

#: Over when a step gains less than this, relative to the value.
_STALLED = 1e-11

#: The value at x and its slope there, or None where there is none (the next step is shorter).
Hill = Callable[[Array], tuple[float, Array] | None]


def climbed_each(
    hills: Callable[[Array], tuple[Array, Array]], x: Array, limits: Array, steps: int
) -> tuple[Array, Array]:
    """Returns many places x [N, m], each after at most `steps` steps up its own hill within `limits` [m, 2], and the values.

    `hills` gives the values [N] > 0 and the slopes of their logarithms [N, m]. Step lengths of Barzilai and Borwein
    (DOI 10.1093/imanum/8.1.141), a quarter of it where a step does not gain.
    """
    value, slope = hills(x)
    step = _FIRST / (np.linalg.norm(slope, axis=1) + 1e-12)
    for _ in range(steps):
        tried = np.clip(x + step[:, None] * slope, *limits.T)
        new, new_slope = hills(tried)
        better = new > value
        moved, bent = tried - x, new_slope - slope
        curvature = -(moved * bent).sum(axis=1)
        newton = (moved**2).sum(axis=1) / np.maximum(curvature, 1e-300)
        longer = np.where(curvature > 0, np.minimum(newton, 10 * step), 3 * step)
        step = np.where(better, longer, step / 4)
        x, slope = np.where(better[:, None], tried, x), np.where(better[:, None], new_slope, slope)
        value = np.where(better, new, value)
    return x, value


def climbed(hill: Hill, x: Array, low: Array, high: Array, steps: int) -> Array:
    """Returns x [m] after at most `steps` steps up the hill within `low` <= x <= `high` [m]; x itself if it has no value.

    Curvature from the last steps as in L-BFGS (Nocedal, DOI 10.1090/S0025-5718-1980-0572855-7); coordinates that stand at
    a bound and would leave take no part in a step, and the step is cut off at the bounds.
    """
    here = hill(x)
    if here is None:
        return x
    pairs: list[tuple[Array, Array]] = []
    for _ in range(steps):
        value, slope = here
        free = ~((x <= low) & (slope < 0) | (x >= high) & (slope > 0))
        found = _further(hill, x, here, _direction(slope, free, pairs), low, high)
        if found is None:
            break
        new, here = found
        pairs = [*pairs[1 - _MEMORY :], (new - x, slope - here[1])]
        x = new
        if here[0] - value <= _STALLED * (1 + abs(value)):
            break
    return x


def _further(
    hill: Hill, x: Array, here: tuple[float, Array], direction: Array, low: Array, high: Array
) -> tuple[Array, tuple[float, Array]] | None:
    """The place and what the hill is there, after the first of ever shorter steps that gains enough; None if none does."""
    value, slope = here
    promised, length = float(slope @ direction), 1.0
    for _ in range(_SHORTER):
        new = np.clip(x + length * direction, low, high)
        there = hill(new)
        if there is not None and there[0] >= value + _GAINED * float(slope @ (new - x)):
            return new, there
        fall = 2 * (promised * length - (there[0] - value)) if there is not None else np.inf
        length *= float(np.clip(promised * length / fall, 0.1, 0.5)) if fall > 0 else 0.5
    return None


def _direction(slope: Array, free: NDArray[np.bool_], pairs: list[tuple[Array, Array]]) -> Array:
    """The quasi-Newton step in the free coordinates, or a short one straight up the slope."""
    up = np.where(free, slope, 0.0)
    curved = []
    for move, bend in ((move * free, bend * free) for move, bend in pairs):
        product = float(move @ bend)
        if product > _CURVED * np.sqrt(float(move @ move) * float(bend @ bend)):
            curved.append((move, bend, product))
    if curved:
        direction, shares = up.copy(), []
        for move, bend, product in reversed(curved):
            shares.append(float(move @ direction) / product)
            direction -= shares[-1] * bend
        _, bend, product = curved[-1]
        direction *= product / float(bend @ bend)
        for (move, bend, product), share in zip(curved, reversed(shares), strict=True):
            direction += (share - float(bend @ direction) / product) * move
        if float(direction @ up) > 0:
            return direction
    return up * (_FIRST / max(float(np.abs(up).max()), 1e-300))
