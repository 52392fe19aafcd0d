"""Encoders on the links as witnesses: how far from what they read the models have the links, that know motors alone.

No fit takes what they read. So they tell of the model what no motor does, and the model of them: how much too large they
read, and how late.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.arm.acting import Moved, acting
from ident.arm.arm_fit import Problem, hold
from ident.arm.arm_model import Parameters, motion_and_derivatives, places, response
from ident.arm.evidence import Evidence
from ident.arm.scene import Scene, in_record, linear_extra
from ident.effects.base import Effect
from ident.loop.diagnose import Diagnosis
from ident.records.campaign import Array
from ident.records.frf import Complex
from ident.records.leakage import between_lines
from ident.records.quantisation import encoder_step, quantisation
from ident.search.changes import told_of
from ident.search.refits import State

#: Times its noise that a line must be read to count: the link of an elastic joint hardly moves at high frequencies.
CLEAR = 10.0
#: Error of its lines, in their noise, from which an encoder is said to differ from the model.
DIFFERS = 2.0
#: Relative error of a model in any line, beside the noise.
EXACT = 1e-2
#: Newton's steps to a scale and a delay: these are small.
PASSES = 8
#: Share of that error that is left where a scale and a delay of the reading are all there is to it.
ALL_THERE_IS = 0.5


@dataclass(frozen=True, eq=False)
class LinkRead:
    """What the link encoder of the excited joint read in a record that reports, at its excited lines s [L]: `measured`, what the models
    `before` and `after` have there, and the standard deviation `noise` [L] of what is left by noise."""

    joint: int
    s: Complex
    measured: Complex
    before: Complex
    after: Complex
    noise: Array


@dataclass(frozen=True)
class Witness:
    """A joint's link encoder against the models, at the excited lines that it reads clearly, up to `highest` [Hz]: relative rms of what is
    left of its reading, `before`, `after` and by `noise` alone; it reads `gain` times what the last model has there, `delay` [s] late,
    but for `rest`, relative rms. `misfit` is what the last model leaves of every line, in its noise, rms."""

    joint: int
    highest: float
    before: float
    after: float
    noise: float
    gain: float
    delay: float
    rest: float
    misfit: float


def told_by_links(d: Diagnosis) -> dict[str, dict[str, float]]:
    """Returns the `witnesses` for verdict.json, by the names of their joints."""
    return {
        d.campaign.joints[one.joint]: {
            "before": one.before, "after": one.after, "noise": one.noise, "misfit": one.misfit,
            "highest_hz": one.highest, "gain": one.gain, "delay_s": one.delay, "rest": one.rest,
        }
        for one in witnesses(d)
    }  # fmt: skip


def remarks_on_links(witnesses: Mapping[str, Mapping[str, float]]) -> list[str]:
    """A line for every link encoder, as `told_by_links`, that differs from the last model by more than noise."""
    lines = []
    for joint, w in witnesses.items():
        if w["misfit"] <= DIFFERS:
            continue
        off = f"link encoder of {joint}: {100 * w['after']:.2g} % off what the model has there, noise makes {100 * w['noise']:.2g} %; "
        if w["rest"] < ALL_THERE_IS * w["after"]:
            late = f"{1e3 * abs(w['delay_s']):.2g} ms {'late' if w['delay_s'] > 0 else 'early'}"
            off += f"it reads {w['gain']:.4g} times that, {late}, but for {100 * w['rest']:.2g} %: check its counts and its clock"
        else:
            off += "something between motor and link, or in that encoder, is not as the model has it"
        lines.append(off)
    return lines


def link_reads(d: Diagnosis) -> tuple[LinkRead, ...]:
    """Returns what link encoders read in the records that errors are told of; nothing without any."""
    reported = [
        one for one in told_of(d.split, d.end, d.split.report) if d.campaign.records[one.index].q_link is not None
    ]
    if not reported:
        return ()
    before = _links(d.first, reported)
    after = before if d.end is d.first else _links(d.end, reported)
    return tuple(_read(d, one, *models) for one, *models in zip(reported, before, after, strict=True))


def witnesses(d: Diagnosis) -> tuple[Witness, ...]:
    """Returns what the link encoders say of the models, joint by joint; nothing without any."""
    reads = link_reads(d)
    joints = sorted({read.joint for read in reads})
    every = (_witness(joint, [read for read in reads if read.joint == joint]) for joint in joints)
    return tuple(one for one in every if one is not None)


def _links(state: State, data: Sequence[Evidence]) -> list[Complex]:
    """The links' angles [L, m] in each record as the model moves them under the torques."""
    problem = replace(state.problem, data=tuple(replace(one, judged=None) for one in data))
    vector = state.minimum.vector
    return [
        _moved_links(problem, vector, one, kept.moved)
        for one, kept in zip(problem.data, hold(problem, vector), strict=True)
    ]


def _in(problem: Problem, vector: Array, one: Evidence) -> tuple[Scene, Parameters, tuple[Effect, ...]]:
    """The arm at `vector` and its effects in a record, and that as these have it."""
    effects = problem.effects_at(vector)
    return problem.scene(one, effects), in_record(problem.parameters(vector), effects, one.index), effects


def _moved_links(problem: Problem, vector: Array, one: Evidence, how: Moved | None) -> Complex:
    scene, p, effects = _in(problem, vector, one)
    extra = acting(scene, p, effects, how)
    theta, _ = motion_and_derivatives(scene.arm, p, one.sampling, scene.tau, extra, derive=False)
    return places(scene.arm, p, scene.s, extra, theta)[:, len(scene.arm.live) :]


def _read(d: Diagnosis, one: Evidence, before: Complex, after: Complex) -> LinkRead:
    record, frf = d.campaign.records[one.index], d.responses[one.index]
    assert record.q_link is not None and frf.band is not None
    S, use, k = record.samples_per_period, one.is_excited & one.use, one.place
    q = record.q_link[frf.first * S :, [one.excited]]
    mean, errors, _ = between_lines(q, frf.periods, one.scene.lines[use])
    power = np.mean(np.abs(errors[:, :, 0] - _by_torque_noise(d.end, one)[:, use]) ** 2, axis=0)
    _, floors = quantisation(encoder_step(q), q.reshape(frf.periods, S, 1), bool(np.all(record.lines % 2)), record.f0)
    noise = np.sqrt(np.maximum(power, floors[one.scene.lines[use], 0]))
    return LinkRead(one.excited, one.scene.s[use], mean[:, 0], before[use, k], after[use, k], noise)


def _by_torque_noise(state: State, one: Evidence) -> Complex:
    """What errors of the measured torques make of the excited joint's link angle in the last model [R, L]."""
    scene, p, effects = _in(state.problem, state.minimum.vector, one)
    extra = linear_extra(scene, p, effects)
    theta, m = response(scene.arm, p, one.sampling, extra), len(scene.arm.live)
    by_torque = np.stack(
        [places(scene.arm, p, scene.s, extra, theta[:, :, j])[:, m + one.place] for j in range(m)], axis=1
    )
    return np.asarray(np.einsum("rlj,lj->rl", one.noise.samples[:, :, :m], by_torque))


def _witness(joint: int, reads: Sequence[LinkRead]) -> Witness | None:
    s, measured, before, after, noise = (
        np.concatenate([getattr(read, name) for read in reads])
        for name in ("s", "measured", "before", "after", "noise")
    )
    misfit = float(np.sqrt(np.mean(np.abs((measured - after) / noise) ** 2)))
    clear = np.abs(measured) > CLEAR * noise
    if not clear.any():
        return None
    s, measured, before, after, noise = (values[clear] for values in (s, measured, before, after, noise))
    gain, delay = _scale_and_delay(s, after / measured, np.abs(noise / measured))

    def rms(left: Complex | Array) -> float:
        return float(np.sqrt(np.mean(np.abs(left / measured) ** 2)))

    rest = measured - gain * np.exp(-s * delay) * after
    highest = float(s.imag.max()) / (2.0 * np.pi)
    return Witness(
        joint, highest, rms(measured - before), rms(measured - after), rms(noise), gain, delay, rms(rest), misfit
    )


def _scale_and_delay(s: Complex, model: Complex, noise: Array) -> tuple[float, float]:
    """The gain and delay [s] that bring `model` [L], with its `noise` [L], nearest to 1, by Newton's steps from none."""
    gain, delay, trust = 1.0, 0.0, 1.0 / (noise + EXACT)
    for _ in range(PASSES):
        now = gain * np.exp(-s * delay) * model
        A, left = trust[:, None] * np.stack([now, -s * now], axis=1), trust * (1.0 - now)
        (more, later), *_ = np.linalg.lstsq(_real(A), _real(left), rcond=None)
        gain, delay = gain * (1.0 + float(more)), delay + float(later)
    return gain, delay


def _real(values: Array) -> Array:
    return np.concatenate([values.real, values.imag])
