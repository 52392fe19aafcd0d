"""A diagnosis made by hand: records with a known effect, the declared arm fitted to them without it and with it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from ident.arm.arm_fit import chi_squared, hold
from ident.arm.coupled import declared_start, problem_of
from ident.arm.descent import minimise
from ident.arm.evidence import evidence, gravity_basis
from ident.arm.parts import Split
from ident.effects.base import Effect
from ident.effects.friction import LinkCoulomb, MotorCoulomb, MotorStribeck
from ident.loop.diagnose import Diagnosis
from ident.loop.held_out import held_out
from ident.records.campaign import Campaign
from ident.records.frf import estimate
from ident.search.added import Added
from ident.search.departures import Band, Departure, Errors, in_bands
from ident.search.refits import State
from ident.search.trace import linearise, port_shares
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot, make_model
from symgen.robot import load_robot

ROOT = Path(__file__).parents[2]
#: The friction put in [N m, motor side], at joint 2.
LEVEL, JOINT = 0.004, 1
#: Postures with gravity in them; joint 1 at one only, so that some constants of its inertia stay unseen.
CELLS = [
    ("joint1", [0, 0.7, 0.5]), ("joint2", [0, 0.6, 0.9]), ("joint2", [0, -0.4, 1.8]), ("joint3", [0, 0.5, 0.3]),
    ("joint2", [0, 0.3, -1.2]), ("joint2", [0, -0.8, 0.7]),
]  # fmt: skip
SELECT, REPORT = (4,), (5,)


@cache
def campaign(level: float = LEVEL) -> Campaign:
    robot = load_robot(ROOT / "robots/ypp3")
    short = replace(robot, experiment=replace(robot.experiment, f0=1.0, band=(1.0, 100.0), periods=3, fs=500.0))
    short = replace(short, drives=tuple(replace(drive, link_encoder_counts=2**20) for drive in robot.drives))
    effects = [MotorCoulomb(JOINT, (level,))] if level else []
    return simulate(chain_of_robot(robot), short, CELLS, effects=effects, workers=1)


@cache
def diagnosis() -> Diagnosis:
    c = campaign()
    model = make_model(chain_of_robot(load_robot(ROOT / "robots/ypp3")), believe_zeros=True)
    responses = tuple(estimate(record, c) for record in c.records)
    basis = gravity_basis(model, c.gravity)
    data = [evidence(c, model, basis, frf, k, "every") for k, frf in enumerate(responses)]
    guess = declared_start(c, model, responses, basis)
    fit = tuple(one for k, one in enumerate(data) if k not in SELECT + REPORT)
    split = Split(fit, tuple(data[k] for k in SELECT), tuple(data[k] for k in REPORT), "")

    def fitted(effects: tuple[Effect, ...]) -> State:
        scales, limits = [1e-3] * len(effects), [(0.0, 1.0)] * len(effects)
        problem = problem_of(c, model, basis, fit, guess, effects, scales, limits)
        found = minimise(problem, np.concatenate([guess.vector(), [v for e in effects for v in e.values]]), (), 2)
        chosen = replace(problem, data=split.select)
        select = chi_squared(chosen, found.vector, hold(chosen, found.vector))
        return State(problem.effects_at(found.vector), tuple(scales), tuple(limits), found, problem, select)

    start, end = fitted(()), fitted((MotorCoulomb(JOINT, (1e-3,)),))
    shares = port_shares(linearise(start.problem, start.minimum.vector, hold(start.problem, start.minimum.vector)))
    none = Errors(0.0, {}, {}, 0.0, {}, {})
    d = Diagnosis(c, model, responses, split, start, end, (), (), none, none, (), "effect-found")
    before, after = errors(d, "before"), errors(d, "after")
    k = end.problem.base
    std = float(np.linalg.inv(end.minimum.information)[k, k] ** 0.5) * end.problem.scale[k]
    added = Added(
        end.effects[0], (std,), before.all, after.all, start.select - end.select, start.select,
        ((MotorStribeck(JOINT, (0.003, 0.001, 1.0)), 1.001 * after.all), (LinkCoulomb(JOINT, (0.4,)), 3.0 * after.all),
         (LinkCoulomb(JOINT, (0.4,)), 2.0 * after.all)), (), shares,
    )  # fmt: skip
    return replace(d, added=(added,), before=before, after=after)


def unexplained() -> Diagnosis:
    """The same, had nothing been found."""
    d = diagnosis()
    low, high = Band(3.0, 10.0), Band(30.0, 100.0)
    left = (Departure(0, low, "excited", 50.0, 0.3), Departure(JOINT, low, "odd", 90.0, 0.4),
            Departure(JOINT, high, "even", 9.0, 0.3))  # fmt: skip
    return replace(d, end=d.start, added=(), after=d.before, departures=left, status="unexplained")


def errors(d: Diagnosis, which: str) -> Errors:
    """Relative rms errors over the records that report, and of their noise, straight from their definition: but for bands, of lines
    whose noise is four medians of their joint at most."""
    rows = held_out(d)
    f = np.concatenate([row.f for row in rows])
    joint = np.concatenate([np.full(len(row.f), row.joint) for row in rows])
    share = np.concatenate([np.abs(getattr(row, which) / row.theta) ** 2 for row in rows])
    noise = np.concatenate([np.abs(row.noise / row.theta) ** 2 for row in rows])

    def rms(values: np.ndarray) -> float:
        return float(np.sqrt(values.mean()))

    quiet = np.array([n <= 16.0 * np.median(noise[joint == j]) for n, j in zip(noise, joint, strict=True)])
    of_joints = {d.campaign.joints[j]: quiet & (joint == j) for j in np.unique(joint)}
    of_bands = {band.name: inside for band, inside in in_bands(f)}
    parts = [
        (rms(one[quiet]), *({name: rms(one[use]) for name, use in of.items()} for of in (of_joints, of_bands)))
        for one in (share, noise)
    ]
    return Errors(*parts[0], *parts[1])
