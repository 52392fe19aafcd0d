"""Lines that stand alone. What an arm does goes on from a line to the next; a tone that its motors do not make, in step with the periods, is at
one line, at the same frequency at every posture, and bends the whole fit."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from ident.arm.arm_fit import Problem, chi_squared_of_lines, hold
from ident.records.campaign import Array

#: Times what the largest of its neighbours leaves, and noise, that a line leaves which stands alone; neighbours on either side.
ALONE, BESIDE = 30.0, 2
#: Records in which it has to, at least, and share of those that have the line; share of how far the one that stands out most does.
RECORDS, SHARE, AS_FAR = 2, 0.5, 0.1


def lone_lines(problem: Problem, vector: Array) -> Array:
    """Returns the frequencies [Hz], ascending, at which what an arm leaves of its records stands alone in most of those that have them: the
    ones that do most, as they may have bent the arm so that others do."""
    have: dict[float, int] = defaultdict(int)
    alone: dict[float, list[float]] = defaultdict(list)
    for one, held in zip(problem.data, hold(problem, vector), strict=True):
        left = chi_squared_of_lines(problem, vector, one, held) / (2.0 * one.scene.theta.shape[1])
        kinds = np.where(one.is_excited, 2, one.scene.lines % 2)
        for kind in range(3):
            lines = np.flatnonzero(kinds == kind)
            f, times = np.round(one.sampling.f[lines], 9), _times_others(left[lines])
            for frequency, more in zip(f.tolist(), times.tolist(), strict=True):
                have[frequency] += 1
                if more > ALONE:
                    alone[frequency].append(more)
    found = {f: max(times) for f, times in alone.items() if len(times) >= max(RECORDS, SHARE * have[f])}
    return np.array(sorted(f for f, most in found.items() if most >= AS_FAR * max(found.values())))


def _times_others(left: Array) -> Array:
    """How many times what the largest of those beside it leaves, or noise, each of neighbouring lines does; 0 of few."""
    if len(left) <= 2 * BESIDE:
        return np.zeros(len(left))
    around = np.pad(left, BESIDE)
    steps = [k for k in range(2 * BESIDE + 1) if k != BESIDE]
    most = np.max([around[k : k + len(left)] for k in steps], axis=0)
    return np.asarray(left / np.maximum(most, 1.0))
