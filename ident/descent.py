"""The descent to a minimum of chi^2: Levenberg-Marquardt, weights made anew at every minimum, bends of valleys followed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ident.arm_fit import Problem, Slides
from ident.campaign import Array
from ident.sums import Sums, summed

#: A step of less than this share of a standard deviation ends a fit, of ten times as much the weighting.
SMALL_STEP = 0.01
#: Times that weights are made anew, steps of a descent, tries of a step, steps of a rough descent.
OUTER, INNER, TRIALS, FEW = 6, 30, 8, 10
#: Damping with which a step is promised that would be taken next, were it the last: along a valley the damped ones are short.
SLACK = 1e-9
#: A descent winds where a step does less than this share of what is promised undamped, though it is damped this little: there
#: it follows the bend of the valley, found from a share of the step ahead, where that is less than so much of the step.
WINDING, GENTLE, AHEAD, BEND = 0.1, 0.01, 0.1, 0.75
#: Fall of chi^2 that a damping alone promises that has become so small that it is not felt, though it is missed.
MISSED = 10.0
#: Times its scale that what gives may get softer in a step, where other parameters change by one.
SOFTER = 4.0
#: Progress below this share of chi^2 ends the way to a model that is still doubted.
ROUGHLY = 0.01
#: Share of chi^2 to which it comes back when motions with dry friction, found in turns, are found again.
TURNED = 1e-3
#: Share of the chi^2 with which the last descent began that one before it had, which then is better: another motion was found
#: since, and the way from there leads elsewhere.
LOST = 0.8


@dataclass(frozen=True)
class Minimum:
    """Where a fit ended: `vector` [P], `information` [P, P] per step of `scale` there, chi^2, whether it converged, and where
    dry friction was found, by record."""

    vector: Array
    information: Array
    chi2: float
    converged: bool
    slid: Slides = field(default_factory=dict)


def minimise(
    problem: Problem, vector: Array, doubts: Sequence[float] = (), outer: int = OUTER, roughly: float = 0.0
) -> Minimum:
    """Levenberg-Marquardt, weights made anew at every minimum until that moves nothing; first with `doubts`.

    `roughly` ends each descent where chi^2 falls by less than this share, or after `FEW` steps, and all of it where one
    changes chi^2 by less.
    """
    with summed(problem) as sums:
        return _minimised(sums, vector, doubts, outer, roughly)


def _minimised(sums: Sums, vector: Array, doubts: Sequence[float], outer: int, roughly: float) -> Minimum:
    """`minimise`, once somebody sums over the records."""
    problem = sums.problem
    converged, winding, damping, chi2, last, begun = False, False, 1e-3, np.inf, np.inf, np.inf
    information = np.zeros((len(vector), len(vector)))
    best: Minimum | None = None
    for doubt in (*doubts, *[0.0] * outer):
        sums.hold(vector, doubt)
        chi2, slope, information = sums.equations(vector)
        if not doubt and (best is None or chi2 < best.chi2):
            best = Minimum(vector, information, chi2, False, sums.slid)
        begun = chi2
        begin, settled, damping = vector, False, min(damping, 1e-3)
        for _ in range(FEW if roughly else INNER):
            for refused in range(TRIALS):
                step = _step(problem, vector, slope, information, damping)
                if winding and damping < GENTLE:
                    step = step + _bend(sums, vector, step, information, damping)
                trial = _taken(problem, vector, step)
                cost = sums.chi_squared(trial)
                if cost <= chi2:
                    break
                damping *= 5.0
            else:
                settled = bool(-step @ slope < SMALL_STEP)
                break
            if not (winding and refused):
                damping = max(damping / 5.0, 1e-12)
            vector, moved, before = trial, float(step @ information @ step), chi2
            chi2, slope, information = sums.equations(vector)
            little = max(ROUGHLY if doubt else 0.0, roughly) * before
            promised = float(-_step(problem, vector, slope, information, SLACK) @ slope)
            winding = winding or before - chi2 < WINDING * promised
            if (moved < SMALL_STEP**2 and promised < SMALL_STEP) or max(before - chi2, promised) < little:
                settled = True
                break
        shift = (vector - begin) / problem.scale
        small = shift @ information @ shift < (10.0 * SMALL_STEP) ** 2
        same = max(roughly, TURNED if sums.slid else 0.0)
        if not doubt and settled and (small or abs(last - chi2) < same * chi2):
            converged = True
            break
        last = np.inf if doubt else chi2
    if best is not None and not converged and best.chi2 < LOST * begun:
        return best
    return Minimum(vector, information, chi2, converged, sums.slid)


def _bend(sums: Sums, vector: Array, step: Array, information: Array, damping: float) -> Array:
    """Returns what the curvature of the residuals along a step adds to it [P], half its geodesic acceleration
    (doi:10.48550/arXiv.1201.5885); nothing where that is no small part of the step."""
    pushed = sums.curved(vector, step, AHEAD)
    with np.errstate(all="ignore"):  # a bend beyond numbers is none
        bend, size = 0.5 * _step(sums.problem, vector, pushed, information, damping), np.sqrt(np.diag(information))
        small = np.linalg.norm(size * bend) < BEND * np.linalg.norm(size * step)
    return bend if small else np.zeros_like(bend)


def _step(problem: Problem, vector: Array, slope: Array, information: Array, damping: float) -> Array:
    """Returns the damped step of the free parameters, no component beyond 1, or `SOFTER`; what would leave its bounds stays there.

    Logarithms of dampings that vanish would go far for nothing: the others step as they do when these go no farther than they
    may. One that has become so small that it is not felt, but is missed, may grow until it is felt.
    """
    pressed = ((vector <= problem.low) & (slope > 0.0)) | ((vector >= problem.high) & (slope < 0.0))
    free = np.flatnonzero(problem.free & ~pressed)
    size = np.sqrt(np.diag(information)[free])
    size[size == 0.0] = 1.0
    matrix = information[np.ix_(free, free)] / size / size[:, None] + damping * np.eye(len(free))
    down = slope[free] / size
    missed = problem.dampings[free] & (down**2 > MISSED)
    least = -size * np.where(problem.giving, SOFTER, 1.0)[free]
    most = np.where(missed, np.maximum(size, 1.0), size)
    y = -np.linalg.solve(matrix, down)
    far = problem.dampings[free] & ((y < least) | (y > most))
    if far.any() and not far.all():
        y = np.clip(y, least, most)
        y[~far] = -np.linalg.solve(matrix[np.ix_(~far, ~far)], down[~far] + matrix[np.ix_(~far, far)] @ y[far])
    step = np.zeros(len(slope))
    step[free] = np.clip(y, least, most) / size
    return step


def _taken(problem: Problem, vector: Array, step: Array) -> Array:
    """The parameters [P] after a step, within their bounds; what gets softer by as much as its compliance is to grow, a damping
    that grows more than e-fold by as much as it, not its logarithm, is to."""
    far = problem.dampings & (step > 1.0)
    change = problem.scale * np.where(far, 1.0 + np.log(np.where(far, step, 1.0)), step)
    softer = problem.giving & (change < 0.0)
    after = vector + change
    after[softer] = vector[softer] / (1.0 - change[softer] / vector[softer])
    return np.asarray(np.clip(after, problem.low, problem.high))
