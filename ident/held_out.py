"""What a diagnosis looks like from outside: held-out responses before and after, the force an effect was, who carries it.

Everything is computed from the diagnosis as it ended; nothing is fitted here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.arm_fit import Problem, hold, residual, whitened_by
from ident.campaign import Array
from ident.departures import in_bands, told_of
from ident.diagnose import Diagnosis
from ident.effects.base import Effect, has_forces
from ident.effects.motion import Motion
from ident.evidence import Evidence
from ident.excitation import synthesise
from ident.frf import Complex
from ident.refits import State, same
from ident.trace import PORTS, along, linearise

#: Share of what an effect explains that a record, or a band, must have of it to be told: less is what noise makes of it.
LEAST_CARRIED = 0.01


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The excited joint's angle in a record that reports, at its excited lines f [L, Hz]: the torque `tau`, what was measured
    `theta`, what each model leaves of it, `before` and `after`, and the standard deviation `noise` [L] of it by noise."""

    record: int
    joint: int
    f: Array
    tau: Complex
    theta: Complex
    before: Complex
    after: Complex
    noise: Array


def held_out(d: Diagnosis) -> tuple[HeldOut, ...]:
    """Returns the records that report and that the errors of the diagnosis are told of, with the errors of the first model and of the
    last one."""
    reported = told_of(d.split, d.end.effects, d.split.report)
    rows = []
    for one, before, after in zip(reported, _left(d.first, reported), _left(d.end, reported), strict=True):
        k, use = one.place, one.is_excited & one.use
        noise = np.sqrt(np.sum(np.abs(np.linalg.inv(after[1][use])[:, k]) ** 2, axis=1))
        scene = one.scene
        rows.append(
            HeldOut(
                one.index, one.excited, one.sampling.f[use], scene.tau[use, k], scene.theta[use, k],
                before[0][use, k], after[0][use, k], noise,
            )
        )  # fmt: skip
    return tuple(rows)


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
    )  # fmt: skip
    return fewer, vector[keep]


@dataclass(frozen=True, eq=False)
class Force:
    """What acted at a port of a joint in one record, at S instants: `found` from the records without a law, `law` the effect's.

    `position`, `velocity`, `torque` [S] are the port's own. Units of the port; an angle error [rad] where it is a sensor.
    `share` of the record's excess that the force explains.
    """

    record: int
    port: str
    joint: int
    found: Array
    law: Array
    position: Array
    velocity: Array
    torque: Array
    share: float


def reconstructed(d: Diagnosis, effect: Effect) -> Force | None:
    """Returns the force that the records want where the effect acts, in the record of its joint that shows it best; None for an effect of
    the structure or of the whole arm, which has no port."""
    if effect.joint is None or effect.port not in PORTS:
        return None
    problem, vector = without(d.end, effect)
    lin = linearise(problem, vector, hold(problem, vector))
    key = (effect.port, effect.joint)
    powers = [
        float(np.sum(along(ports[key], r)[1])) if key in ports else 0.0
        for ports, r in zip(lin.ports, lin.r, strict=True)
    ]
    own = [k for k, one in enumerate(lin.problem.data) if one.excited == effect.joint] or list(range(len(powers)))
    at = max(own, key=lambda k: powers[k])
    one, ports, r = lin.problem.data[at], lin.ports[at], lin.r[at]
    if key not in ports:
        return None
    force, clear = along(ports[key], r)
    force = force * np.maximum(1.0 - 1.0 / np.maximum(clear, 1.0), 0.0)  # Wiener: noise, and what is doubted
    with_it = d.end.problem.data[at]
    full = hold(replace(d.end.problem, data=(with_it,)), d.end.minimum.vector)[0]
    moved = full.moved
    assert moved is not None
    motion = moved.motion
    left = residual(d.end.problem, d.end.minimum.vector, with_it, moved)[0]
    explained = r - whitened_by(lin.W[at], left)
    law = _law(effect, motion)
    x, v, torque = motion.at(effect.port, effect.joint)
    if law is None:
        shown = synthesise(with_it.scene.lines, along(ports[key], explained)[0], len(x))
        level = 0.0
    else:
        shown, level = law, float(law.mean())
    excess = max(2.0 * float(np.sum(np.abs(r) ** 2)) - 2.0 * r.size, 1e-300)
    return Force(
        one.index, effect.port, effect.joint, synthesise(with_it.scene.lines, force, len(x)) + level, shown, x, v, torque,
        2.0 * powers[at] / excess,
    )  # fmt: skip


def _law(effect: Effect, motion: Motion) -> Array | None:
    """The effect's own force [S], where it is one of the motion."""
    if not has_forces(effect):
        return None
    law = effect.reading(motion) if effect.port == "sensor" else effect.force(motion)
    return None if law is None else np.asarray(law)


def carried(d: Diagnosis, effect: Effect) -> tuple[dict[str, float], dict[str, float]]:
    """Returns which records, and which bands, miss the effect when it is taken out of the last model: shares of chi^2 on the
    records that chose it."""
    fewer, vector = without(d.end, effect)
    by_record: dict[str, float] = {}
    by_band: dict[str, float] = {}
    fewer, full = replace(fewer, data=d.split.select), replace(d.end.problem, data=d.split.select)
    less, more = hold(fewer, vector), hold(full, d.end.minimum.vector)
    for one, kept, whole in zip(d.split.select, less, more, strict=True):
        r = residual(fewer, vector, one, kept.moved)[0]
        s = residual(full, d.end.minimum.vector, one, whole.moved)[0]
        a, b = (whitened_by(kept.W, x) for x in (r, s))
        fall = 2.0 * np.sum(np.abs(a) ** 2 - np.abs(b) ** 2, axis=1)
        name = d.campaign.records[one.index].id
        by_record[name] = by_record.get(name, 0.0) + float(fall.sum())
        for band, inside in in_bands(one.sampling.f):
            by_band[band.name] = by_band.get(band.name, 0.0) + float(fall[inside].sum())
    total = sum(by_record.values())
    if not total > 0.0:
        return {}, {}
    return _largest(by_record, total), _largest(by_band, total)


def _largest(parts: dict[str, float], total: float) -> dict[str, float]:
    """The parts above `LEAST_CARRIED` as shares, largest first."""
    shares = {name: part / total for name, part in sorted(parts.items(), key=lambda item: -item[1])}
    return {name: share for name, share in shares.items() if share > LEAST_CARRIED}
