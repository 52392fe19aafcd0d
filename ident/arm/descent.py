"""The descent to a minimum of chi^2: Levenberg-Marquardt, weights made anew at every minimum, bends of valleys followed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.arm.arm_fit import Problem, Slides
from ident.arm.sums import Sums, summed
from ident.effects.base import has_forces
from ident.records.campaign import Array

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
#: Times its scale, or what it is if that is more, that what gives may get softer in a step, where other parameters change by one.
SOFTER = 4.0
#: What goes beyond its limit by more than this share of what goes farthest is held first; what is no farther than rounding is within.
FARTHEST, ROUNDING = 0.3, 1e-9
#: Progress below this share of chi^2 ends the way to a model that is still doubted.
ROUGHLY = 0.01
#: Share of chi^2 to which it comes back when motions with dry friction, found in turns, are found again.
TURNED = 1e-3
#: Cosine between changes that lead straight to where they end, and the share of the one before it that the last one is.
STRAIGHT, SLOWLY = 0.9, (0.2, 0.9)
#: Share of the chi^2 with which the last descent began that one before it had, which then is better: another motion was found
#: since, and the way from there leads elsewhere.
LOST = 0.8
#: Shares of the way of a descent that dry friction goes where under the motion found anew all of it leaves more than before.
BACK = (0.5, 0.25)
#: Motions found anew, one after another, under forces that follow from them, which leave more than an earlier one did: they lead away.
ASTRAY = 2


@dataclass(frozen=True)
class Minimum:
    """Where a fit ended: `vector` [P], `information` [P, P] per step of `scale` there, chi^2, whether it converged, and where
    dry friction was found, by record. Its weights and motions are those of `weighed`, a vector and its chi^2."""

    vector: Array
    information: Array
    chi2: float
    converged: bool
    slid: Slides = field(default_factory=dict)
    weighed: tuple[Array, float] | None = None


def minimise(
    problem: Problem, vector: Array, doubts: Sequence[float] = (), outer: int = OUTER, roughly: float = 0.0
) -> Minimum:
    """Levenberg-Marquardt, weights made anew at every minimum until that moves nothing; first with `doubts`.

    `roughly` ends each descent where chi^2 falls by less than this share, or after `FEW` steps, and all of it where one
    changes chi^2 by less.
    """
    with summed(problem) as sums:
        return _minimised(sums, vector, doubts, outer, roughly)


@dataclass
class _Place:
    """Where a descent is: parameters, chi^2, half its gradient and Hessian there; damping of the next step, whether the way winds."""

    vector: Array
    chi2: float
    slope: Array
    information: Array
    damping: float = 1e-3
    winding: bool = False

    def weighed(self, sums: Sums, vector: Array, doubt: float) -> None:
        """Goes to `vector`, weights and motions made anew."""
        sums.hold(vector, doubt)
        self.vector, self.damping = vector, min(self.damping, 1e-3)
        self.chi2, self.slope, self.information = sums.equations(vector)

    def at(self, sums: Sums, converged: bool, weighed: tuple[Array, float] | None = None) -> Minimum:
        return Minimum(self.vector, self.information, self.chi2, converged, sums.slid, weighed)


def _minimised(sums: Sums, vector: Array, doubts: Sequence[float], outer: int, roughly: float) -> Minimum:
    """`minimise`, once somebody sums over the records."""
    P, problem, last, begun = len(vector), sums.problem, np.inf, np.inf
    place, converged = _Place(vector, np.inf, np.zeros(P), np.zeros((P, P))), False
    begin = vector
    best: Minimum | None = None
    plain: Array | None = None
    shifted, worse = np.zeros(P), 0
    dry = any(effect.dry for effect in problem.effects)
    followed = any(map(has_forces, problem.effects))
    for left, doubt in zip(range(len(doubts) + outer, 0, -1), (*doubts, *[0.0] * outer), strict=True):
        place.weighed(sums, vector, doubt)
        if plain is not None and place.chi2 > begun and not problem.late:
            place.weighed(sums, plain, doubt)
        for share in BACK if dry and not doubt else ():
            if place.chi2 > (1.0 + ROUGHLY) * begun and not problem.late:
                place.weighed(sums, begin + share * (vector - begin), doubt)
        if not doubt and (best is None or place.chi2 < best.chi2):
            best, worse = place.at(sums, False), 0
        elif followed and not doubt and best is not None:
            worse += 1
            if worse == ASTRAY:
                return replace(best, converged=True)
        begun, begin = place.chi2, place.vector
        settled = _descended(sums, place, max(ROUGHLY if doubt else 0.0, roughly), FEW if roughly else INNER)
        vector, shift = place.vector, (place.vector - begin) / problem.scale
        small = shift @ place.information @ shift < (10.0 * SMALL_STEP) ** 2
        same = max(roughly, TURNED if dry else 0.0)
        if not doubt and settled and (small or abs(last - place.chi2) < same * place.chi2):
            converged = True
            break
        if problem.late:
            break
        last, plain = np.inf if doubt else place.chi2, None
        if sums.slid and not doubt and left > 1:
            further = _further(shifted, shift, place.information)
            if further:
                plain, vector = vector, np.clip(vector + further * problem.scale * shift, problem.low, problem.high)
            shifted = np.zeros(P) if further else shift
    if best is not None and not converged and best.chi2 < LOST * begun:
        return best
    return place.at(sums, converged, (begin, begun))


def _descended(sums: Sums, place: _Place, least: float, steps: int) -> bool:
    """Goes down from a place under its weights, at most so many steps, until chi^2 falls by less than the share `least`, or no step
    is to be made; whether it does."""
    problem = sums.problem
    for k in range(steps):
        if k and problem.late:
            return False
        for refused in range(TRIALS):
            step = _step(problem, place.vector, place.slope, place.information, place.damping)
            if place.winding and place.damping < GENTLE:
                step = step + _bend(sums, place.vector, step, place.information, place.damping)
            trial = _taken(problem, place.vector, step)
            if sums.chi_squared(trial) <= place.chi2:
                break
            place.damping *= 5.0
        else:
            return bool(-step @ place.slope < SMALL_STEP)
        if not (place.winding and refused):
            place.damping = max(place.damping / 5.0, 1e-12)
        moved, before = float(step @ place.information @ step), place.chi2
        place.vector, (place.chi2, place.slope, place.information) = trial, sums.equations(trial)
        promised = float(-_step(problem, trial, place.slope, place.information, SLACK) @ place.slope)
        fell = before - place.chi2
        place.winding = place.winding or fell < WINDING * promised
        if (moved < SMALL_STEP**2 and promised < SMALL_STEP) or max(fell, promised) < least * before:
            return True
    return False


def _further(before: Array, now: Array, information: Array) -> float:
    """How many times the last change of the parameters (in their scales) is missing to their fixed point, which changes that shrink
    evenly approach, or swing about (A. C. Aitken, Proc. Roy. Soc. Edinburgh 46 (1926)); 0 where they do not."""
    square, along, new = before @ information @ before, before @ information @ now, now @ information @ now
    if not square > 0.0 or abs(along) < STRAIGHT * np.sqrt(square * new):
        return 0.0
    ratio = float(along / square)
    return ratio / (1.0 - ratio) if SLOWLY[0] < abs(ratio) < SLOWLY[1] else 0.0


def _bend(sums: Sums, vector: Array, step: Array, information: Array, damping: float) -> Array:
    """Returns what the curvature of the residuals along a step adds to it [P], half its geodesic acceleration
    (doi:10.48550/arXiv.1201.5885), without what `_taken` bends already; nothing where that is no small part of the step."""
    problem = sums.problem
    pushed = sums.curved(vector, step, AHEAD)
    with np.errstate(all="ignore"):  # a bend beyond numbers is none
        bend, size = 0.5 * _step(problem, vector, pushed, information, damping), np.sqrt(np.diag(information))
        small = np.linalg.norm(size * bend) < BEND * np.linalg.norm(size * step)
    gives, springs, falls = problem.giving, problem.springs, problem.shapes & (step < 0.0)
    bend[falls] -= 0.5 * problem.scale[falls] * step[falls] ** 2 / vector[falls]
    bend[gives] -= problem.scale[gives] * step[gives] ** 2 / vector[gives]
    bend[springs] -= 0.5 * problem.scale[springs] * step[springs] ** 2
    return bend if small else np.zeros_like(bend)


def stepped(problem: Problem, vector: Array, slope: Array, information: Array, damping: float) -> Array:
    """The parameters [P] after a damped Gauss-Newton step, within their bounds."""
    return _taken(problem, vector, _step(problem, vector, slope, information, damping))


def _step(problem: Problem, vector: Array, slope: Array, information: Array, damping: float) -> Array:
    """Returns the damped step of the free parameters, no component beyond 1, or `SOFTER`; what would leave its bounds stays there.

    What goes as far as it may is held there, and the others step as they do then: a direction that nothing shows would
    otherwise go far, and turn the step of all when it is cut. A logarithm of a damping that has become so small that it is not felt,
    but is missed, may grow until it is felt.
    """
    pressed = ((vector <= problem.low) & (slope > 0.0)) | ((vector >= problem.high) & (slope < 0.0))
    free = np.flatnonzero(problem.free & ~pressed)
    size = np.sqrt(np.diag(information)[free])
    size[size == 0.0] = 1.0
    matrix = information[np.ix_(free, free)] / size / size[:, None] + damping * np.eye(len(free))
    down = slope[free] / size
    missed = problem.dampings[free] & (down**2 > MISSED)
    least = -size * np.where(problem.giving, SOFTER * np.maximum(vector / problem.scale, 1.0), 1.0)[free]
    most = np.where(missed, np.maximum(size, 1.0), size)
    y, held = np.zeros(len(free)), np.zeros(len(free), dtype=bool)
    while not held.all():
        if not held.any():
            y = -np.linalg.solve(matrix, down)
        else:
            pushed = down[~held] + matrix[np.ix_(~held, held)] @ y[held]
            y[~held] = -np.linalg.solve(matrix[np.ix_(~held, ~held)], pushed)
        beyond = np.maximum(y / most, y / least)
        if not beyond.max() > 1.0 + ROUNDING:
            break
        far = beyond > max(1.0 + ROUNDING, FARTHEST * beyond.max())
        y[far] = np.clip(y[far], least[far], most[far])
        held |= far
    step = np.zeros(len(slope))
    step[free] = y / size
    return step


def _taken(problem: Problem, vector: Array, step: Array) -> Array:
    """The parameters [P] after a step, within their bounds: what gives by as much as its compliance is to change, with it the joints'
    springs; a damping that grows more than e-fold by as much as it, not its logarithm, is to; a shape that falls as its logarithm,
    e-fold at most: near its least, where it is hardly felt any more, it would stay."""
    far = problem.dampings & (step > 1.0)
    change = problem.scale * np.where(far, 1.0 + np.log(np.where(far, step, 1.0)), step)
    after = vector + change
    gives, springs, falls = problem.giving, problem.springs, problem.shapes & (change < 0.0)
    after[falls] = vector[falls] * np.exp(np.maximum(change[falls] / vector[falls], -1.0))
    after[gives] = vector[gives] * _by_compliance(change[gives] / vector[gives])
    after[springs] = vector[springs] + np.log(_by_compliance(change[springs]))
    return np.asarray(np.clip(after, problem.low, problem.high))


def _by_compliance(change: Array) -> Array:
    """Times as stiff as before, where the compliance is to fall by a share `change` of itself; beyond half of it along the tangent there."""
    return np.where(change < 0.5, 1.0 / (1.0 - np.minimum(change, 0.5)), 4.0 * change)
