"""Is a robot ready for a campaign? What its robot.toml and URDF promise, before anything moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from ident.errors import ExperimentError
from ident.machines.doctor_findings import (
    STILL,
    Finding,
    JointCheck,
    of_band,
    of_drive,
    of_locks,
    of_plan,
    turns_too_little,
)
from ident.records.campaign import Array
from ident.simulator.design import Setup, prepare
from ident.simulator.plant import gravity_forces
from symgen.errors import PlanError
from symgen.plan import Cell, Plan, plan_of_robot
from symgen.robot import Drive, Robot, load_robot

_POSTURES = 300


@dataclass(frozen=True)
class Examination:
    """A robot directory examined; `ready` when no finding is serious. `seconds` the planned records take in all."""

    robot: Robot
    plan: Plan
    joints: tuple[JointCheck, ...]
    findings: tuple[Finding, ...]
    seconds: float

    @property
    def ready(self) -> bool:
        return not any(finding.serious for finding in self.findings)


def examine(directory: str) -> Examination:
    """Returns what a campaign on the robot in `directory` will meet. RobotError, UrdfError where it can not be read."""
    robot = load_robot(directory)
    plan = _planned(robot)
    setups, findings = _designed(robot, plan)
    joints = tuple(_joint(robot, plan, i, setups, weight) for i, weight in enumerate(_gravity(robot, plan)))
    findings += [*of_plan(plan), *of_locks(plan, [setup for _, setup in setups])]
    for check in joints:
        findings += [*of_band(check, robot), *of_drive(check, robot)]
    ordered = tuple(sorted(findings, key=lambda finding: not finding.serious))
    return Examination(robot, plan, joints, ordered, sum(setup.periods for _, setup in setups) / robot.experiment.f0)


def _planned(robot: Robot) -> Plan:
    """The plan of a robot; PlanError that asks for gear ratios where these may be why no posture can be held."""
    try:
        return plan_of_robot(robot)
    except PlanError as error:
        asked = [f"{drive.joint}: {text}" for drive in robot.drives if (text := turns_too_little(drive))]
        if asked:
            raise PlanError("; ".join([str(error), *asked])) from error
        raise


def _designed(robot: Robot, plan: Plan) -> tuple[list[tuple[Cell, Setup]], list[Finding]]:
    """The planned records as they would be run, and a finding for each that can not be."""
    setups, findings = [], []
    for k, cell in enumerate(plan.cells):
        try:
            rng = np.random.default_rng(k)
            setups.append((cell, prepare(plan.model.chain, robot, cell.joint, cell.q, lock="dob", rng=rng)))
        except ExperimentError as error:
            what, _, remedy = str(error).partition("; ")
            findings.append(Finding(f"record {k + 1}: {what}", "it can not be run", remedy, True))
    return setups, findings


def _gravity(robot: Robot, plan: Plan) -> Array:
    """The largest gravity force on each joint [n, N m] over the workspace and the planned postures."""
    chain = plan.model.chain
    drives = [robot.drive(name) for name in chain.names]
    random = plan.model.random_postures(_POSTURES, np.random.default_rng(0))
    postures = np.vstack([random, *[cell.q[None] for cell in plan.cells]])
    return np.asarray(np.abs(gravity_forces(chain, drives, robot.gravity, postures)).max(axis=0))


def _joint(robot: Robot, plan: Plan, i: int, setups: Sequence[tuple[Cell, Setup]], weight: float) -> JointCheck:
    model, e = plan.model, robot.experiment
    name = model.chain.names[i]
    drive = robot.drive(name)
    J = model.J_cad(model.random_postures(_POSTURES, np.random.default_rng(0)))[:, i, i]
    own = np.array([cell.q for cell in plan.cells if cell.joint == name])
    planned = model.J_cad(own)[:, i, i] if len(own) else None
    rotor = drive.N**2 * drive.J_m
    mine = [setup for cell, setup in setups if cell.joint == name]
    seen = [(_visible(setup, drive, e.samples_per_period), _top(setup)) for setup in mine]
    visible, visible_at = min(seen, default=(None, None))
    counts = [_counts(setup, [robot.drive(joint) for joint in model.chain.names]) for setup in mine]
    limits = np.array([robot.drive(joint).tau_max for joint in model.chain.names])
    return JointCheck(
        joint=name,
        linear=drive.linear,
        J=_range(J),
        rotor=rotor,
        ratio=_range(J / rotor),
        f_AR=_range(_anti_resonance(drive, J)),
        f_R=_range(_resonance(drive, J)),
        planned_f_AR=None if planned is None else _range(_anti_resonance(drive, planned)),
        planned_f_R=None if planned is None else _range(_resonance(drive, planned)),
        gravity=weight / (abs(drive.N) * drive.tau_max),
        sag=weight / drive.K,
        records=len(own),
        swing=max((setup.swing for setup in mine), default=None),
        counts=min((own for own, _ in counts), default=None),
        held_counts=min((held for _, held in counts if held > STILL), default=None),
        torque=max((float((setup.torque / limits[list(setup.live)]).max()) for setup in mine), default=None),
        settling=max((setup.settle for setup in mine), default=None),
        periods=max((setup.periods for setup in mine), default=None),
        margin=min((setup.margins.distance for setup in mine), default=None),
        delay=min((setup.margins.delay * e.fs for setup in mine), default=None),
        held=max((setup.held for setup in mine), default=None),
        visible=visible,
        visible_at=visible_at,
        beyond=_missed(mine, _resonance(drive, model.J_cad(np.array([s.posture for s in mine]))[:, i, i]))
        if mine
        else None,
        unseen=_missed(mine, np.array([setup.f_AR for setup in mine])) if mine else None,
    )


def _missed(setups: Sequence[Setup], f: Array) -> tuple[float, float] | None:
    """Frequency and highest line [Hz] of the record whose frequency `f` [records, Hz] lies furthest above its lines."""
    tops = [_top(setup) for setup in setups]
    worst = max(zip(f.tolist(), tops, strict=True), key=lambda one: one[0] / one[1])
    return worst if worst[0] > worst[1] else None


def _top(setup: Setup) -> float:
    """The highest line that is played [Hz]."""
    return float(setup.excitation.lines[-1] * setup.excitation.f0)


def _resonance(drive: Drive, J: Array) -> Array:
    return np.asarray(_anti_resonance(drive, J) * np.sqrt(1 + J / (drive.N**2 * drive.J_m)))


def _anti_resonance(drive: Drive, J: Array) -> Array:
    return np.asarray(np.sqrt(drive.K / J) / (2 * pi))


def _visible(setup: Setup, drive: Drive, samples: int) -> float:
    """Motor angle at the highest line, where it moves like the bare rotor, over the encoder's noise there."""
    top = setup.excitation
    angle = top.amplitude[-1] / (drive.J_m * (2 * pi * top.lines[-1] * top.f0) ** 2)
    step = 2 * pi / drive.encoder_counts
    return float(angle / (step * sqrt(2 / (3 * samples))))  # as `frf` has it for odd lines


def _counts(setup: Setup, drives: Sequence[Drive]) -> tuple[float, float]:
    """Encoder counts that the excited motor moves through, and the one of the held motors that moves through most."""
    per_rad = np.array([abs(drives[k].N) * drives[k].encoder_counts / (2 * pi) for k in setup.live])
    counts, port = 2 * setup.motion * per_rad, setup.live.index(setup.joint)
    return float(counts[port]), float(np.delete(counts, port).max(initial=0.0))


def _range(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())
