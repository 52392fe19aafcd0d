"""The effects that could explain a residual, each with the size it wants: scored to first order, all else refitted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.arm.acting import signals
from ident.arm.arm_model import DRIVES
from ident.arm.parts import degrees
from ident.arm.small_matrices import times
from ident.effects.base import Effect, Parameter, only_impedance, scale
from ident.effects.catalogue import CATALOGUE
from ident.effects.motion import CREEP
from ident.effects.waves import is_wave
from ident.errors import IdentError
from ident.records.frf import Complex
from ident.search.plausible import starts, values_of
from ident.search.trace import Linearised
from symgen.forked import forked

#: How many orders of a wave are scored; orders, or records of a change, tried where what was found leaves something.
BEST_ORDERS, MORE = 2, 6
#: chi^2 per degree of freedom above which candidates are told by few lines of few records.
MUCH = 9.0
#: Share of a plausible size from which an effect that is not linear in its size is differentiated.
SMALL = 1e-3
#: Factors by which stiffnesses and frequencies of an impedance are moved from the best ones tried: at first, and from then on.
FAR = tuple(1.2**k for k in range(-8, 9) if k)
NEAR = tuple(f for by in (1.07, 1.2, 1.5) for f in (by, 1.0 / by))
#: Largest change from one record to the next from which a fit starts.
CHANGE = 0.1
#: Times the speed at which dry friction creeps below which a joint is taken to be held by it.
RESTS = 6.0
#: A first-order size beyond these factors of the one tried says that another one is meant.
WITHIN = (0.02, 50.0)
#: The least scale of a value, as a share of the largest plausible one: what is nothing at first is refined in such steps.
LEAST = 0.1
#: Rounding errors of a value, in its units.
ROUNDED = 1e-12

#: Values of an effect, and by how much chi^2 falls by them.
Found = tuple[list[float], float]


@dataclass(frozen=True)
class Candidate:
    """An effect with start values, the fall of chi^2 it promises on the records fitted, and the `scales` of its parameters."""

    effect: Effect
    gain: float
    scales: tuple[float, ...]

    @property
    def key(self) -> tuple[str, int | None, str]:
        return self.effect.name, self.effect.joint, self.effect.port


def units(lin: Linearised, effect: type[Effect], joint: int | None) -> tuple[float, ...]:
    """What one unit of each parameter is, for an effect at a joint: the largest one at a joint that turns for an effect of the whole arm,
    and for one that turns whatever its joint does at a slide."""
    chain = lin.problem.data[0].scene.chain
    joints = list(range(lin.problem.n))
    turning = [j for j in joints if not chain.slides(j)] or joints
    at = turning if joint is None or (effect.turns and joint not in turning) else [joint]
    every = [[scale(p.relative, _sizes(lin, effect.port, j)) for p in effect.parameters] for j in at]
    return tuple(np.max(every, axis=0).tolist()) if every[0] else ()


def _sizes(lin: Linearised, port: str, joint: int) -> dict[str, float]:
    """Largest rms torque, angle and rate at a port over the records, K and the inertia, J_m or the link's J_ii, of its joint: of the scales of a
    parameter those that an effect may have of which the fitted arm has to be told."""
    angle, rate, torque = lin.swings[side_of(port), joint]
    drives = lin.problem.parameters(lin.vector)
    K = float(drives.K[joint])
    J = float(drives.J_m[joint]) if port == "motor" else max(float(arm.J[joint, joint]) for _, arm in lin.arms)
    tiny = 1e-300
    return {"torque": torque + tiny, "angle": angle + tiny, "rate": rate + tiny, "K": K, "J": J}


def side_of(port: str) -> str:
    """The port whose motion an effect sees: that of the motor for sensors, that of the link for the structure."""
    return port if port in ("motor", "spring", "link") else "motor" if port == "sensor" else "link"


def added(lin: Linearised, effect: Effect) -> list[Complex | None]:
    """What `effect` adds to the whitened prediction of each record at the lines judged [L, m], to first order in the effect; None: nothing."""
    found: list[Complex | None] = []
    for at, one in enumerate(lin.problem.data):
        scene, motion = one.scene, lin.motions[side_of(effect.port)][at]
        total = _linear(lin, effect, at)
        for (port, k), signal in signals(scene, (effect,), motion).items():
            push = lin.judged[at].pushes["sensor" if port == "reading" else port][:, :, k]
            unit = scene.arm.N[k] if port == "motor" else 1.0
            total = total + push * (scene.at_lines(signal)[one.use] / unit)[:, None]
        for name, share in effect.shares(one.index).items():
            column = DRIVES.index(name) * scene.n + int(effect.joint or 0)
            place = np.flatnonzero(lin.columns[at] == column)
            if place.size:
                total = total - lin.A[at][one.use, :, place[0]] * (np.log1p(share) / lin.problem.scale[column])
        found.append(total if np.any(total) else None)
    return found


def _linear(lin: Linearised, effect: Effect, at: int) -> Complex:
    """What its impedance, gains and shift of posture add in record `at`."""
    kind, scene, here, (p, arm) = type(effect), lin.scenes[at], lin.judged[at], lin.arms[at]
    live, s, m = scene.arm.live, here.s, len(scene.arm.live)
    total = np.zeros_like(here.theta)
    Z: Complex | None = None
    if kind.impedance is not Effect.impedance:
        whole = effect.impedance(s, arm)
        Z = None if whole is None else scene.of_live(whole)
    if kind.posture is not Effect.posture:
        moved = lin.problem.scene_at(scene, effect.posture(scene.posture)).arm
        dJ, dK = moved.J(p) - scene.arm.J(p), (moved.K_rows - scene.arm.K_rows) @ p.gravity
        Z = np.zeros((len(s), 2 * m, 2 * m), dtype=complex)
        Z[:, m:, m:] = s[:, None, None] ** 2 * dJ + dK
    if Z is not None:
        force = -times(Z, here.positions[side_of(kind.port)])
        total = total + times(here.pushes["motor"], force[:, :m] / scene.arm.N)
        total = total + times(here.pushes["link"], force[:, m:])
    if kind.torque_gain is not Effect.torque_gain and (gain := effect.torque_gain(s, arm)) is not None:
        total = total + times(here.pushes["motor"], (gain[:, live] - 1.0) * here.torque)
    if kind.angle_gain is not Effect.angle_gain and (gain := effect.angle_gain(s, arm)) is not None:
        total = total + times(here.pushes["sensor"], (gain[:, live] - 1.0) * here.theta)
    return total


def places(kind: type[Effect], n: int) -> list[int | None]:
    """Where an effect of a kind may be in an arm of n joints: joints from 0, None for the whole arm. That of one joint is its joint, for
    an effect that may be either."""
    joints: list[int | None] = list(range(n)) if "joint" in kind.scope else []
    return joints + [None] * ("arm" in kind.scope and (n > 1 or not joints))


def of_kinds(
    lin: Linearised, wanted: Callable[[type[Effect], int | None], bool], taken: Sequence[Effect]
) -> list[tuple[type[Effect], int | None]]:
    """The kinds of the catalogue with the places that are `wanted`, and not `taken` yet; waves of another order are."""
    there = {(e.name, e.joint) for e in taken if not is_wave(e)}
    return [
        (kind, joint)
        for kind in CATALOGUE.values() if kind.injectable
        for joint in places(kind, lin.problem.n) if wanted(kind, joint) and (kind.name, joint) not in there
    ]  # fmt: skip


def catalogue(
    lin: Linearised, taken: Sequence[Effect], workers: int = 1, at: tuple[str, int | None] | None = None
) -> list[Candidate]:
    """All effects of the catalogue that the fitted arm does not contain yet, best first: at all joints, or `at` a port and joint. Where much
    is left they are told by few lines of few records, as all would have them."""
    tasks = of_kinds(lin, lambda kind, joint: _in_fit(kind) and (at is None or at == (kind.port, joint)), taken)
    measured = degrees(lin.problem.data)
    few = lin.by_few() if lin.chi2 > MUCH * measured else lin
    whole = measured / degrees(few.problem.data)
    lin.prepare()
    few.prepare()

    def best(task: tuple[type[Effect], int | None]) -> Candidate | None:
        if task[0].shares is not Effect.shares:  # from one record to the next
            return best_of(lin, *task)
        found = best_of(few, *task)
        return None if found is None else replace(found, gain=whole * found.gain)

    found = [c for c in forked(best, tasks, workers) if c is not None]
    return sorted(found, key=lambda c: -c.gain)


def surest(lin: Linearised, workers: int = 1) -> float:
    """The largest fall of chi^2 that an effect of the catalogue promises just as it stands, the same one in all records: of dry friction
    in all of them together, some of which may want it to push."""
    found = [c.effect for c in catalogue(lin, (), workers) if type(c.effect).shares is Effect.shares]
    stand = (_as_it_stands(lin, effect) for effect in found)
    return max((fall for _, fall in filter(None, stand)), default=0.0)


def _in_fit(kind: type[Effect]) -> bool:
    """Whether the fitted arm has to be told of an effect: no number that it has of its own does the same."""
    return not kind.declared or kind.shares is not Effect.shares or kind.impedance is not Effect.impedance


def best_of(lin: Linearised, kind: type[Effect], joint: int | None) -> Candidate | None:
    """The effect of this kind at a joint that promises most."""
    return max(_scored(lin, kind, joint), key=lambda c: c.gain, default=None)


def nearer(lin: Linearised, best: Candidate) -> Candidate:
    """The candidate or, of an impedance, one like it whose stiffnesses and frequencies promise more: a mode that is moved far is
    found from near only, so the first steps of each look far around."""
    kind, joint = type(best.effect), best.effect.joint
    shapes = [
        k for k, p in enumerate(kind.parameters) if p.zero is None and (p.relative == "K" or p.name == "frequency")
    ]
    if not only_impedance(best.effect) or not shapes:
        return best
    unit = units(lin, kind, joint)
    steps, before = FAR, 0.0
    while best.gain > before:
        before = best.gain
        for k in shapes:
            others = (_possible(lin, best.effect.with_value(k, best.effect.values[k] * by), unit) for by in steps)
            best = max([best, *(other for other in others if other is not None)], key=lambda c: c.gain)
        steps = NEAR
    return best


def _scored(lin: Linearised, kind: type[Effect], joint: int | None) -> Iterator[Candidate]:
    """One kind at one joint, for every combination of its plausible shapes."""
    unit = units(lin, kind, joint)
    for values in starts(lin, kind, joint, unit, BEST_ORDERS):
        candidate = _possible(lin, kind(joint, values), unit)
        if candidate is not None:
            yield candidate


def _possible(lin: Linearised, effect: Effect, unit: Sequence[float]) -> Candidate | None:
    """The effect, those of its values that are linear as they fit best; None where that is no arm."""
    try:
        return _sized(lin, effect, unit)
    except (ArithmeticError, IdentError, np.linalg.LinAlgError, ValueError):
        return None


def sized_together(lin: Linearised, some: Sequence[Candidate]) -> list[Candidate]:
    """Candidates beside each other, each as large as fits best to first order beside all others: what acts at every joint hides in each alone.
    Without those that are beyond their bounds then; shapes are as they were."""
    columns: list[list[Complex | None]] = []
    places: list[tuple[int, int, float]] = []
    for at, one in enumerate(some):
        kind = type(one.effect)
        for k in _sizes_of(kind):
            only = only_size(kind, one.effect.values, k)
            only[k] = (one.effect.values[k] or one.scales[k]) * (1.0 if kind.parameters[k].linear else SMALL)
            columns.append(added(lin, one.effect.with_values(only)))
            places.append((at, k, only[k]))
    values = [list(one.effect.values) for one in some]
    for (at, k, unit), size in zip(places, lin.step(columns)[0], strict=True):
        values[at][k] = float(size * unit)
    beside = []
    for one, sized in zip(some, values, strict=True):
        kind = type(one.effect)
        allowed = _allowed(kind, sized, units(lin, kind, one.effect.joint))
        if allowed is not None:
            beside.append(replace(one, effect=one.effect.with_values(allowed)))
    return beside


def otherwise(lin: Linearised, effect: Effect) -> list[Candidate]:
    """Effects like this one with another whole number, an order or the record of a change: `MORE` of those that promise most."""
    kind, unit = type(effect), units(lin, type(effect), effect.joint)
    found = [
        _possible(lin, effect.with_value(k, value), unit)
        for k, p in enumerate(kind.parameters) if p.whole
        for value in values_of(lin, kind, effect.joint, p, unit[k], MORE) if value != effect[p.name]
    ]  # fmt: skip
    return sorted((c for c in found if c is not None), key=lambda c: -c.gain)[:MORE]


def _sized(lin: Linearised, effect: Effect, unit: Sequence[float]) -> Candidate | None:
    """The effect with the sizes that fit best to first order, shapes kept; None where none fits within the bounds."""
    kind, sizes = type(effect), _sizes_of(type(effect))
    found: Found | None
    if any(p.name == "phase" for p in kind.parameters):
        found = _as_wave(lin, effect)
    else:
        found = _as_large(lin, effect, sizes, unit) if sizes else _as_it_stands(lin, effect)
    if found is None or not found[1] > 0.0:
        return None
    values = _allowed(kind, found[0], unit)
    return None if values is None else Candidate(effect.with_values(values), found[1], _usual(kind, values, unit))


def _sizes_of(kind: type[Effect]) -> list[int]:
    """The places of the parameters that are sizes, as they are looked for."""
    return [k for k, p in enumerate(kind.parameters) if p.zero is not None and not (p.declared or p.aside)]


def _as_wave(lin: Linearised, effect: Effect) -> Found:
    """Amplitude and phase that fit best, by the sums of a sine and a cosine."""
    names, values = [p.name for p in effect.parameters], list(effect.values)
    a, f = names.index("amplitude"), names.index("phase")
    waves = [effect.with_value(f, phase) for phase in (0.0, np.pi / 2)]
    c, gain = lin.step([added(lin, one.with_values(only_size(type(one), one.values, a))) for one in waves])
    values[f] = float(np.arctan2(c[1], c[0]))
    values[a] *= float(np.hypot(*c))
    return values, gain


def _as_large(lin: Linearised, effect: Effect, sizes: Sequence[int], unit: Sequence[float]) -> Found | None:
    """The `sizes`, by their places, that fit best; None if none does anything. Dry friction is taken to hold what hardly moves."""
    kind, values, columns, moved = type(effect), list(effect.values), [], []
    for k in sizes:
        p = kind.parameters[k]
        size = values[k] if values[k] else unit[k] * max(abs(x) for x in p.sizes)
        moved.append(size * (1.0 if p.linear or p.name == "gap" else SMALL))
        only = only_size(kind, values, k)
        only[k] = moved[-1]
        columns.append(added(lin, effect.with_values(only)))
    stuck = _stuck(lin, effect) if kind.dry else ()
    if all(column is None for one in columns for at, column in enumerate(one) if at not in stuck):
        return None
    c, gain = lin.step(columns, stuck)
    for k, factor, step in zip(sizes, c, moved, strict=True):
        values[k] = float(factor * step)
    return values, gain + sum(_held(lin, effect.with_values(values), at) for at in stuck)


def _as_it_stands(lin: Linearised, effect: Effect) -> Found | None:
    """An effect of shapes alone; None where it is meant to be much larger, or smaller."""
    c, gain = lin.step([added(lin, effect)])
    return (list(effect.values), gain) if WITHIN[0] < c[0] < WITHIN[1] else None


def _allowed(kind: type[Effect], values: Sequence[float], unit: Sequence[float]) -> list[float] | None:
    """The values of an effect, each within its bounds, changes from record to record at most `CHANGE`; None where a shape is beyond
    its bounds, or the only size."""
    allowed = []
    for value, p, u in zip(values, kind.parameters, unit, strict=True):
        if p.zero is not None and kind.shares is not Effect.shares:  # of first order only: a large change is a guess
            value = float(np.clip(value, -CHANGE, CHANGE))
        low, high = bounds(p, u)
        if not low - ROUNDED * u <= value <= high + ROUNDED * u:
            if p.zero is None or len(_sizes_of(kind)) < 2:
                return None
            value = float(np.clip(value, low, high))
        allowed.append(value)
    return allowed


def _usual(kind: type[Effect], values: Sequence[float], unit: Sequence[float]) -> tuple[float, ...]:
    """The scales of the values of an effect: what they are, or a share of what is plausible where that is more."""
    sizes = [abs(u * max(abs(x) for x in p.sizes)) for p, u in zip(kind.parameters, unit, strict=True)]
    return tuple(
        1.0 if p.aside else max(abs(value), LEAST * size, ROUNDED * abs(u))
        for value, p, size, u in zip(values, kind.parameters, sizes, unit, strict=True)
    )


def _stuck(lin: Linearised, effect: Effect) -> tuple[int, ...]:
    """The records, by their places, in which the port of a dry effect hardly moves: what friction there is not told by its velocity."""
    joint, port = int(effect.joint or 0), effect.port
    per = lin.motions[port][0].N[joint] if port == "motor" else 1.0
    rates = [float(np.std(motion.at(port, joint)[1])) for motion in lin.motions[port]]
    return tuple(at for at, rate in enumerate(rates) if rate < RESTS * CREEP * abs(per))


def _held(lin: Linearised, effect: Effect, at: int) -> float:
    """By how much chi^2 of a record falls when whatever force is needed holds a port, up to that of a dry effect which slides."""
    one, joint = lin.problem.data[at], int(effect.joint or 0)
    force = effect.force(lin.motions[effect.port][at])
    if joint not in one.scene.arm.live or force is None:
        return 0.0
    a, r = lin.ports[at][effect.port, joint][one.use], lin.r[at][one.use]
    along, size = np.sum(a.conj() * r, axis=1), np.sum(np.abs(a) ** 2, axis=1)
    needed = float(np.sqrt(np.sum(np.abs(along / size) ** 2) / 2.0))
    share = min(1.0, float(np.abs(force).max()) / max(needed, 1e-300))
    fall = 2.0 * float(np.sum(np.abs(along) ** 2 / size)) - 2.0 * len(size)
    return share * (2.0 - share) * max(fall, 0.0)


def only_size(kind: type[Effect], values: Sequence[float], keep: int) -> list[float]:
    """`values` with all sizes but one at zero, shapes and what is aside kept."""
    return [
        v if k == keep or p.zero is None or p.aside else p.zero
        for k, (v, p) in enumerate(zip(values, kind.parameters, strict=True))
    ]


def bounds(parameter: Parameter, unit: float) -> tuple[float, float]:
    """Lowest and highest value of a parameter whose unit is `unit`."""
    return parameter.low * unit, parameter.high * unit
