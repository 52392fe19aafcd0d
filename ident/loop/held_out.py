"""What a diagnosis looks like from outside: held-out responses before and after, the force an effect was, who carries it.

Everything is computed from the diagnosis as it ended; nothing is fitted here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ident.arm.arm_fit import Problem, hold, residual, whitened_by
from ident.arm.evidence import Evidence
from ident.effects.base import Effect, Law, has_forces, only_gains
from ident.effects.learned import LearnedCurve, factor, variable
from ident.effects.motion import Motion
from ident.effects.ringing import Ringing
from ident.loop.diagnose import Diagnosis
from ident.records.campaign import Array
from ident.records.excitation import synthesise
from ident.records.frf import Complex
from ident.search.changes import told_of
from ident.search.departures import held_as, in_bands
from ident.search.refits import FEW_TURNS, State, same
from ident.search.trace import PORTS, Linearised, along, linearise

#: Share of what an effect explains that a record, or a band, must have of it to be told: less is what noise makes of it.
LEAST_CARRIED = 0.01
#: Lines of a band, or joint, from which noise alone does not make an error of one and a half times what it does on average.
FEW_LINES = 10
#: Share of the largest that what a curve is multiplied by must be where its height is read off the records.
MULTIPLIED = 0.3


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The excited joint's angle in a record that reports, at its excited lines f [L, Hz]: the torque `tau`, what was measured
    `theta`, what each model leaves of it, `before` and `after`, and the standard deviation `noise` [L] of it by noise; `apart` [L]:
    other excited lines lie between a line and the one before it."""

    record: int
    joint: int
    f: Array
    tau: Complex
    theta: Complex
    before: Complex
    after: Complex
    noise: Array
    apart: NDArray[np.bool_]


def held_out(d: Diagnosis) -> tuple[HeldOut, ...]:
    """Returns the records that report and that the errors of the diagnosis are told of, with the errors of the first model and of the
    last one."""
    reported = told_of(d.split, d.end, d.split.report)
    rows = []
    for one, before, after in zip(reported, _left(d.first, reported), _left(d.end, reported), strict=True):
        k, use = one.place, one.is_excited & one.use
        noise = np.sqrt(np.sum(np.abs(np.linalg.inv(after[1][use])[:, k]) ** 2, axis=1))
        scene, places = one.scene, np.cumsum(one.is_excited)[use]
        rows.append(
            HeldOut(
                one.index, one.excited, one.sampling.f[use], scene.tau[use, k], scene.theta[use, k],
                before[0][use, k], after[0][use, k], noise, np.diff(places, prepend=places[:1]) > 1,
            )
        )  # fmt: skip
    return tuple(rows)


def with_few_lines(d: Diagnosis) -> frozenset[str]:
    """The joints and bands whose errors are those of so few lines that they tell little."""
    counts: dict[str, int] = {}
    for one in told_of(d.split, d.end, d.split.report):
        use, joint = one.is_excited & one.use, d.campaign.joints[one.excited]
        counts[joint] = counts.get(joint, 0) + int(use.sum())
        for band, inside in in_bands(one.sampling.f[use]):
            counts[band.name] = counts.get(band.name, 0) + int(inside.sum())
    return frozenset(name for name, count in counts.items() if count < FEW_LINES)


def _left(state: State, data: Sequence[Evidence]) -> list[tuple[Complex, Complex]]:
    """theta - G tau [L, m] of each record, and its weights [L, m, m]: of all lines, judged or not."""
    whole = tuple(replace(one, judged=None) for one in data)
    problem = replace(state.problem, data=whole)
    held = hold(problem, state.minimum.vector)
    return [
        (residual(problem, state.minimum.vector, one, kept.moved)[0], kept.W)
        for one, kept in zip(whole, held, strict=True)
    ]


def without(state: State, effect: Effect) -> tuple[Problem, Array]:
    """Returns the model with one of its effects taken out, all else as it is, and its vector."""
    problem, vector = state.problem, state.minimum.vector
    keep, k = np.ones(len(vector), dtype=bool), problem.base
    for e in state.effects:
        keep[k : k + len(e.values)] = not same(e, effect)
        k += len(e.values)
    fewer = replace(
        problem, effects=tuple(e for e in state.effects if not same(e, effect)), scale=problem.scale[keep],
        low=problem.low[keep], high=problem.high[keep], free=problem.free[keep],
        expected=problem.expected and (problem.expected[0][keep], problem.expected[1][keep]),
    )  # fmt: skip
    return fewer, vector[keep]


@dataclass(frozen=True, eq=False)
class Force:
    """What acted at a port of a joint in one record, at S instants: `found` from the records without a law, `law` the effect's, under
    a `motion`.

    `position`, `velocity`, `torque` [S] are the port's own. Units of the port; an angle error [rad] where it is a sensor.
    """

    record: int
    port: str
    joint: int
    found: Array
    law: Array
    motion: Motion

    @property
    def position(self) -> Array:
        return self.motion.at(self.port, self.joint)[0]

    @property
    def velocity(self) -> Array:
        return self.motion.at(self.port, self.joint)[1]

    @property
    def torque(self) -> Array:
        return self.motion.at(self.port, self.joint)[2]


def reconstructed(d: Diagnosis, effect: Effect, most: int = 1) -> tuple[Force, ...]:
    """Returns the force that the records want where the effect acts, in so many records, at `most`, that excite its joint: the one that
    shows it best first; none for an effect of the structure or of the whole arm, which has no port."""
    if effect.joint is None or effect.port not in PORTS:
        return ()
    lin = _without_it(d, effect)
    key = (effect.port, effect.joint)
    known = [at for at, ports in enumerate(lin.ports) if key in ports]
    powers = {at: float(np.sum(along(lin.ports[at][key], lin.r[at])[1])) for at in known}
    return tuple(_force(d, effect, lin, at) for at in sorted(known, key=lambda at: -powers[at])[:most])


def _without_it(d: Diagnosis, effect: Effect) -> Linearised:
    """The last model without an effect, about the records that excite its joint, all of their lines."""
    problem, vector = without(d.end, effect)
    own = tuple(one for one in problem.data if effect.joint in (None, one.excited)) or problem.data
    problem = replace(problem, data=tuple(replace(one, judged=None) for one in own))
    return linearise(problem, vector, hold(problem, vector))


def _force(d: Diagnosis, effect: Effect, lin: Linearised, at: int) -> Force:
    """The force in one of the records."""
    assert effect.joint is not None
    one, a, r = lin.problem.data[at], lin.ports[at][effect.port, effect.joint], lin.r[at]
    force, clear = along(a, r)
    force = force * np.maximum(1.0 - 1.0 / np.maximum(clear, 1.0), 0.0)  # Wiener: noise, and what is doubted
    moved = hold(replace(d.end.problem, data=(one,)), d.end.minimum.vector)[0].moved
    assert moved is not None
    law, lines = _law(effect, moved.motion), one.scene.lines
    if law is None:
        left = residual(d.end.problem, d.end.minimum.vector, one, moved)[0]
        explained = along(a, r - whitened_by(lin.W[at], left))[0]
        samples = len(moved.motion.at(effect.port, effect.joint)[0])
        law = synthesise(lines, explained, samples)
    found = synthesise(lines, force, len(law)) + float(law.mean())
    return Force(one.index, effect.port, effect.joint, found, law, moved.motion)


def _law(effect: Effect, motion: Motion) -> Array | None:
    """The effect's own force [S], where it is one of the motion; of one that is an impedance without its mean, which moves nothing."""
    if isinstance(effect, Law) and effect.linear and effect.joint is not None:
        force = np.asarray(effect.law(motion.state(effect.joint)))
        return np.asarray(force - force.mean())
    if not has_forces(effect):
        return None
    law = effect.reading(motion) if effect.port == "sensor" else effect.force(motion)
    return None if law is None else np.asarray(law)


def heights(effect: LearnedCurve, forces: Sequence[Force]) -> tuple[Array, Array]:
    """Returns where a learned curve was asked for in the records, and the height they want there: both [S], but where hardly anything is
    multiplied by it."""
    x, y = [], []
    for force in forces:
        state = force.motion.state(force.joint)
        over = np.asarray(variable(state, effect.port, effect.variable))
        by = np.broadcast_to(factor(state, effect.port, effect.variable), over.shape)
        clear = np.abs(by) >= MULTIPLIED * np.abs(by).max()
        x.append(over[clear])
        y.append(force.found[clear] / by[clear])
    return np.concatenate(x), np.concatenate(y)


@dataclass(frozen=True, eq=False)
class Gains:
    """What becomes of a signal on its way, at L lines f [Hz] of some `records`: `measured` without a law, `law` the effect's."""

    records: tuple[int, ...]
    f: Array
    measured: Complex
    law: Complex


def gains(d: Diagnosis, effect: Effect) -> Gains | None:
    """Returns what becomes of the torque that is commanded, or of the angle that is read, at the excited lines of the records that excite
    the effect's joint; None for an effect that does anything else."""
    if not only_gains(effect) or effect.port not in ("motor", "sensor"):
        return None
    lin = _without_it(d, effect)
    records, f, measured, law = [], [], [], []
    for at, (one, (_, arm)) in enumerate(zip(lin.problem.data, lin.arms, strict=True)):
        joint = one.excited if effect.joint is None else effect.joint
        if (effect.port, joint) not in lin.ports[at]:
            continue
        use, k = one.is_excited, int(np.flatnonzero(one.scene.arm.live == joint)[0])
        off = along(lin.ports[at][effect.port, joint], lin.r[at])[0][use]
        if effect.port == "motor":
            own, gain = 1.0 + off / lin.acting_torque(at)[use, k], effect.torque_gain(one.scene.s[use], arm)
        else:
            theta = one.scene.theta[use, k]
            own, gain = theta / (theta - off), effect.angle_gain(one.scene.s[use], arm)
        if gain is None:
            return None
        records.append(one.index)
        f.append(one.sampling.f[use])
        measured.append(own)
        law.append(gain[:, joint])
    return Gains(tuple(records), *(np.concatenate(rows) for rows in (f, measured, law))) if records else None


def felt(d: Diagnosis, effect: Ringing) -> Gains:
    """Returns the inertia [kg m2] that the motor feels of a mass that rings with it, at the excited lines of the records that excite its
    joint."""
    lin, joint = _without_it(d, effect), effect.joint
    assert joint is not None
    records, f, measured = [], [np.empty(0)], [np.empty(0, dtype=complex)]
    for at, one in enumerate(lin.problem.data):
        if ("motor", joint) not in lin.ports[at]:
            continue
        use, k = one.is_excited, int(np.flatnonzero(one.scene.arm.live == joint)[0])
        pushed = along(lin.ports[at]["motor", joint], lin.r[at])[0][use]
        records.append(one.index)
        f.append(one.sampling.f[use])
        measured.append(-pushed / (one.scene.s[use] ** 2 * one.scene.theta[use, k]))
    there = np.concatenate(f)
    law = effect.felt(np.asarray(2j * np.pi * there, dtype=complex))
    return Gains(tuple(records), there, np.concatenate(measured), law)


def carried(d: Diagnosis, effect: Effect) -> tuple[dict[str, float], dict[str, float]]:
    """Returns which records, and which bands, miss the effect when it is taken out of the last model: shares of all by which chi^2 of
    those that miss it grows, on the records that chose it."""
    fewer, vector = without(d.end, effect)
    by_record: dict[str, float] = {}
    by_band: dict[str, float] = {}
    fewer, full = replace(fewer, data=d.split.select, turns=FEW_TURNS), replace(d.end.problem, data=d.split.select)
    less, more = hold(fewer, vector), held_as(d.end, d.split.select)
    for one, kept, whole in zip(d.split.select, less, more, strict=True):
        r = residual(fewer, vector, one, kept.moved)[0]
        s = residual(full, d.end.minimum.vector, one, whole.moved)[0]
        a, b = (whitened_by(kept.W, x) for x in (r, s))
        fall = 2.0 * np.sum(np.abs(a) ** 2 - np.abs(b) ** 2, axis=1)
        name = d.campaign.records[one.index].id
        by_record[name] = by_record.get(name, 0.0) + float(fall.sum())
        for band, inside in in_bands(one.sampling.f):
            by_band[band.name] = by_band.get(band.name, 0.0) + float(fall[inside].sum())
    if not sum(by_record.values()) > 0.0:
        return {}, {}
    return _largest(by_record), _largest(by_band)


def _largest(parts: dict[str, float]) -> dict[str, float]:
    """The parts above `LEAST_CARRIED` as shares of all that are above zero, largest first."""
    total = sum(part for part in parts.values() if part > 0.0)
    shares = {name: part / total for name, part in sorted(parts.items(), key=lambda item: -item[1])}
    return {name: share for name, share in shares.items() if share > LEAST_CARRIED}
