"""Names whose law has the force of a curve that was found: as large as there, from the arm that was found with it.

A name that is tried from an arm which its effect has bent may not find its way; a curve, straight in its heights, does, and
tells force and arm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from ident.effects.base import Effect, PeriodicLaw
from ident.effects.catalogue import CATALOGUE
from ident.effects.motion import Motion
from ident.records.campaign import Array
from ident.search.candidates import Candidate, bounds, only_size, units
from ident.search.plausible import ORDERS
from ident.search.refits import State, but_last, linearised, some
from ident.search.resized import larger
from ident.search.shapes import TINY
from ident.search.slopes import SLOPES
from ident.search.trace import Linearised

#: Samples of a record by which forces are compared; share of what a straight line leaves of a curve's force that a name may leave, and
#: names that are tried.
SAMPLES, LIKE, MOST = 256, 0.1, 2
#: Times the force of the curve that a name begins with, too: near a resonance a law that is too strong has the arm move in another way.
WEAKER = 0.8
#: The least share of itself that a stiffness or damping has which takes over the straight line of a curve's force.
LEAST = 0.1

#: The unit of each value of an effect, see `units`.
Units = tuple[float, ...]


def names_alike(state: State) -> tuple[State, list[tuple[Candidate, Linearised]]]:
    """The model without its last effect, a curve, as nobody has judged it; and names at its port that have nearly its force beside a
    straight line, best first, each with the arm to be refitted from."""
    curve, lin = state.effects[-1], linearised(state.problem, state.minimum.vector)
    less = some(state, but_last(state))
    plain = replace(state, effects=less.effects, scales=less.scales, limits=less.limits, select=np.inf)
    drawn, problem = Drawn.of(lin, curve), replace(state.problem, effects=less.effects)
    found = (drawn.by(effect, unit) for effect, unit in _likely(lin, curve))
    best: dict[str, tuple[float, Effect]] = {}
    for one in sorted((one for one in found if one is not None and one[0] < LIKE), key=lambda one: one[0]):
        best.setdefault(one[1].name, one)
    tried = []
    for share, as_drawn in list(best.values())[:MOST]:
        scales = tuple(max(abs(v), TINY) for v in as_drawn.values)
        for effect in (as_drawn, larger(Candidate(as_drawn, 0.0, scales), WEAKER).effect):
            vector = _with_slopes(state, less.vector, curve, drawn.slopes_beside(effect))
            candidate = Candidate(effect, (1.0 - share) * lin.chi2, scales)
            tried.append((candidate, replace(lin, problem=problem, vector=vector)))
    return plain, tried


def _likely(lin: Linearised, curve: Effect) -> Iterator[tuple[Effect, Units]]:
    """Laws at the port of a curve, of every shape that is plausible there, and the units of their values."""
    for kind in CATALOGUE.values():
        if not (kind.injectable and issubclass(kind, PeriodicLaw) and kind.port == curve.port and not kind.linear):
            continue
        unit = units(lin, kind, curve.joint)
        shapes = [
            ORDERS if p.name == "order" else (0.0,) if p.name == "phase" else tuple(u * size for size in p.sizes)
            if p.zero is None else (u * p.sizes[0],)
            for p, u in zip(kind.parameters, unit, strict=True)
        ]  # fmt: skip
        for values in product(*shapes):
            yield kind(curve.joint, tuple(map(float, values))), unit


@dataclass(frozen=True, eq=False)
class Drawn:
    """The `force` [k] of a curve in some samples of the `motions` of the records that move its joint, position and rate there
    `straight` [k, 2], each without its mean."""

    motions: tuple[Motion, ...]
    force: Array
    straight: Array

    @staticmethod
    def of(lin: Linearised, curve: Effect) -> Drawn:
        every = zip(lin.problem.data, lin.motions[curve.port], strict=True)
        motions = tuple(motion for one, motion in every if curve.joint in one.scene.arm.live)
        lines = [np.stack(motion.at(curve.port, int(curve.joint or 0))[:2], axis=1) for motion in motions]
        return Drawn(motions, _forces(motions, curve), np.concatenate([_few(line) for line in lines]))

    @cached_property
    def alone(self) -> float:
        """The squares that straight lines alone leave of the force."""
        return _best(self.straight, self.force)[1]

    def by(self, effect: Effect, unit: Units) -> tuple[float, Effect] | None:
        """The law as large as it has the force best, beside straight lines of position and rate; and the share that it leaves of what
        these alone leave. None where it can not."""
        names = [p.name for p in effect.parameters]
        sizes = [k for k, p in enumerate(effect.parameters) if p.zero is not None]
        if not all(effect.parameters[k].linear for k in sizes):
            return None
        ones = [effect.with_values(only_size(type(effect), effect.values, k)) for k in sizes]
        if "phase" in names:
            ones.append(ones[0].with_value(names.index("phase"), np.pi / 2))
        X = np.column_stack([*(_forces(self.motions, one) for one in ones), self.straight])
        found, left = _best(X, self.force)
        c, values = found[:-2], list(effect.values)
        if "phase" in names:
            values[names.index("phase")] = float(np.arctan2(c[1], c[0]))
            c = np.array([np.hypot(*c)])
        for k, factor in zip(sizes, c, strict=True):
            values[k] = float(factor * values[k])
        limits = [bounds(p, u) for p, u in zip(effect.parameters, unit, strict=True)]
        if not all(low <= v <= high for v, (low, high) in zip(values, limits, strict=True)):
            return None
        return left / max(self.alone, 1e-300), effect.with_values(values)

    def slopes_beside(self, effect: Effect) -> Array:
        """The slopes [2] of the straight lines of position and rate that are best beside a law as it is."""
        return _best(self.straight, self.force - _forces(self.motions, effect))[0]


def _best(X: Array, force: Array) -> tuple[Array, float]:
    """The shares of columns [k, c] that make a force [k] best, and the squares that are left."""
    size = np.linalg.norm(X, axis=0) + 1e-300
    found = np.linalg.lstsq(X / size, force, rcond=None)[0] / size
    return found, float(np.sum((force - X @ found) ** 2))


def _forces(motions: Sequence[Motion], effect: Effect) -> Array:
    return np.concatenate([_few(np.asarray(effect.force(motion))) for motion in motions])


def _few(signal: Array) -> Array:
    """Some of a record's samples, without their mean: a constant torque moves nothing for ever."""
    few = signal[:: max(1, len(signal) // SAMPLES)]
    return few - few.mean(axis=0)


def _with_slopes(state: State, vector: Array, curve: Effect, slopes: Array) -> Array:
    """The parameters with the straight lines of a curve's force as stiffness and damping."""
    n, joint, vector = state.problem.n, int(curve.joint or 0), vector.copy()
    for variable, slope in zip(("position", "velocity"), slopes, strict=True):
        place = SLOPES.get((curve.port, variable))
        if place is not None:
            was = float(np.exp(vector[place * n + joint]))
            more = slope if curve.port == "spring" else -slope
            vector[place * n + joint] = np.log(max(was + more, LEAST * was))
    return vector
