"""Is a robot ready for a campaign? What its robot.toml and URDF promise, before anything moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from ident.campaign import Array
from ident.design import TORQUE_SHARE, Setup, place, prepare
from ident.errors import ExperimentError
from ident.frf import POSTURE_TOLERANCE
from ident.plant import build_plant
from symgen.plan import Cell, Plan, plan_of_robot
from symgen.robot import Drive, Robot, load_robot

#: Below this J_ii / (N^2 J_m) the link hardly shows in the motor's response: an error of f_R counts 2 (1 + r) / r times.
LIGHT = 0.1
#: Angles at the highest line that are less than this many times the encoder's noise tell little.
VISIBLE = 10.0
#: A resonance is resolved when this many lines lie within its half-power width.
RESOLVED = 1.0
#: Held motors that move more than this, relative to the excited one, show in a two-mass fit.
HELD = 0.02

_POSTURES = 300


@dataclass(frozen=True)
class JointCheck:
    """One joint over the workspace, and at the postures planned for it.

    `J` [2] least and largest J_ii [kg m2], `rotor` N^2 J_m, `ratio` [2] of the two; `f_AR`, `f_R` [2, Hz] over the
    workspace and `planned_f_AR`, `planned_f_R` at the planned postures, other joints rigid; `gravity` the largest share of
    the motor's torque; `sag` [rad] the largest static deflection of the spring. Of the `records` that excite it: `swing`
    [rad] predicted; `torque` the largest share of any motor's limit; `settling` and `periods` the most that any needs and
    lasts; `margin` the least distance of a loop from -1; `held` the largest velocity of a held motor over the excited
    one's; `visible` the angle at the highest line over the encoder's noise; `beyond` [f_R of two masses, highest line, Hz] of
    the record that misses its resonance by most, None where none does; `unseen` [f_AR, highest line, Hz] the same of the
    anti-resonance that tells most of J_ii, with the other joints' springs. None: no record could be designed.
    """

    joint: str
    J: tuple[float, float]
    rotor: float
    ratio: tuple[float, float]
    f_AR: tuple[float, float]
    f_R: tuple[float, float]
    planned_f_AR: tuple[float, float] | None
    planned_f_R: tuple[float, float] | None
    gravity: float
    sag: float
    records: int
    swing: float | None
    torque: float | None
    settling: int | None
    periods: int | None
    margin: float | None
    held: float | None
    visible: float | None
    beyond: tuple[float, float] | None
    unseen: tuple[float, float] | None


@dataclass(frozen=True)
class Finding:
    """What is amiss, why it matters, and what helps; not `serious` when a campaign can be run all the same."""

    what: str
    why: str
    remedy: str
    serious: bool


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
    plan = plan_of_robot(robot)
    setups, findings = _designed(robot, plan)
    joints = tuple(_joint(robot, plan, i, setups, weight) for i, weight in enumerate(_gravity(robot, plan)))
    findings += [*_of_plan(plan), *_of_locks(plan, [setup for _, setup in setups])]
    for check in joints:
        findings += [*_of_band(check, robot), *_of_drive(check, robot)]
    ordered = tuple(sorted(findings, key=lambda finding: not finding.serious))
    return Examination(robot, plan, joints, ordered, sum(setup.periods for _, setup in setups) / robot.experiment.f0)


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
    preload = np.array([build_plant(chain, drives, robot.gravity, q).preload for q in postures])
    return np.asarray(np.abs(preload * [drive.N for drive in drives]).max(axis=0))


def _joint(robot: Robot, plan: Plan, i: int, setups: Sequence[tuple[Cell, Setup]], weight: float) -> JointCheck:
    model, e = plan.model, robot.experiment
    name = model.chain.names[i]
    drive = robot.drive(name)
    J = model.J_cad(model.random_postures(_POSTURES, np.random.default_rng(0)))[:, i, i]
    own = np.array([cell.q for cell in plan.cells if cell.joint == name])
    planned = model.J_cad(own)[:, i, i] if len(own) else None
    rotor = drive.N**2 * drive.J_m
    mine = [setup for cell, setup in setups if cell.joint == name]
    limits = np.array([robot.drive(joint).tau_max for joint in model.chain.names])
    return JointCheck(
        joint=name,
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
        torque=max((float((setup.torque / limits[list(setup.live)]).max()) for setup in mine), default=None),
        settling=max((setup.settle for setup in mine), default=None),
        periods=max((setup.periods for setup in mine), default=None),
        margin=min((setup.margins.distance for setup in mine), default=None),
        held=max((setup.held for setup in mine), default=None),
        visible=min((_visible(setup, drive, e.samples_per_period) for setup in mine), default=None),
        beyond=_missed(mine, _resonance(drive, model.J_cad(np.array([s.posture for s in mine]))[:, i, i]))
        if mine
        else None,
        unseen=_missed(mine, np.array([setup.f_AR for setup in mine])) if mine else None,
    )


def _missed(setups: Sequence[Setup], f: Array) -> tuple[float, float] | None:
    """Frequency and highest line [Hz] of the record whose frequency `f` [records, Hz] lies furthest above its lines."""
    tops = [float(setup.excitation.lines[-1] * setup.excitation.f0) for setup in setups]
    worst = max(zip(f.tolist(), tops, strict=True), key=lambda one: one[0] / one[1])
    return worst if worst[0] > worst[1] else None


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


def _range(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())


# findings -------------------------------------------------------------------------------------------------------------


def _of_plan(plan: Plan) -> list[Finding]:
    document = plan.document["plan"]
    findings = [
        Finding(
            f"record {one['cell']}, {one['joint']}: {one['why']}", "the arm can not hold it", "other postures", True
        )
        for one in document["infeasible"]
    ]
    if document["open"]:
        names = ", ".join(document["open"])
        findings.append(
            Finding(
                f"the plan does not determine {names}", "J(q) stays CAD's in them", "more postures: wider limits", True
            )
        )
    for one in plan.document["unseen"]:
        findings.append(
            Finding(
                f"no J_ii shows {one['directions']} directions of {one['entry']}",
                "records of one joint alone leave them at CAD",
                "ident fit --method coupled, which reads all motors",
                False,
            )
        )
    return findings


def _of_locks(plan: Plan, setups: Sequence[Setup]) -> list[Finding]:
    """What the records' design had to change, once a joint, and whether the locks hold."""
    names = plan.model.chain.names
    found = []
    for i, name in enumerate(names):
        noted = [setup for setup in setups if setup.joint == i and setup.note]
        if noted:
            why = f"{place(name, noted[0].posture)}: {noted[0].note}"
            unseen = "is not seen here" in noted[0].note
            what = f"{name}: {len(noted)} of its records not run as robot.toml has it"
            found.append(Finding(what, why, "sample_rate_Hz, band_Hz or K" if unseen else "none needed", False))
    loose = max(setups, key=lambda setup: setup.held, default=None)
    if loose is not None and loose.held > HELD:
        found.append(
            Finding(
                f"held motors move up to {loose.held:.2g} of the excited one's velocity",
                "two masses then do not describe a joint",
                "ident fit --method coupled, which reads all motors",
                False,
            )
        )
    return found


def _of_band(check: JointCheck, robot: Robot) -> list[Finding]:
    """The joint's modes against the lines of its records, and the distance of the lines against its sharpest mode."""
    e, found = robot.experiment, []
    drive = robot.drive(check.joint)
    for name, missed, why, serious in (
        ("anti-resonance", check.unseen, "J_ii and K are then not told apart", True),
        ("resonance", check.beyond, "J_ii and K are then told apart poorly", False),
    ):
        if missed is not None:
            f, top = missed
            found.append(
                Finding(
                    f"{check.joint}: its {name} is at {f:.3g} Hz in a planned record, the highest line at {top:.4g} Hz",
                    why,
                    f"band_Hz up to {1.3 * f:.0f} (sample_rate_Hz above {3.3 * f:.0f}), or K from the datasheet taken as known",
                    serious,
                )
            )
            break
    if check.planned_f_AR is not None and check.planned_f_AR[0] < e.band[0] + 3 * e.f0:
        found.append(
            Finding(
                f"{check.joint}: its anti-resonance falls to {check.planned_f_AR[0]:.3g} Hz, the lines begin at {e.band[0]:g} Hz",
                "nothing below it shows the whole inertia",
                "a lower band_Hz, a smaller line_spacing_Hz",
                True,
            )
        )
    width = drive.D_spring / check.J[1] / (2 * pi)  # half-power width of the anti-resonance: D/J [rad/s]
    if 0 < width < RESOLVED * e.f0:
        found.append(
            Finding(
                f"{check.joint}: its sharpest anti-resonance is {width:.2g} Hz wide, lines are {e.f0:g} Hz apart",
                "its depth, and with it the spring's damping, falls between the lines",
                f"line_spacing_Hz = {width / 2:.1g}, or more periods",
                False,
            )
        )
    return found


def _of_drive(check: JointCheck, robot: Robot) -> list[Finding]:
    e, name = robot.experiment, check.joint
    found = []
    if check.ratio[0] < LIGHT:
        r = check.ratio[0]
        found.append(
            Finding(
                f"{name}: J_ii falls to {r:.2g} of the rotor's N^2 J_m",
                f"a relative error of f_R / f_AR counts {2 * (1 + r) / r:.0f} times in J_ii",
                "more periods, a larger swing_rad, spare postures where J_ii is large",
                False,
            )
        )
    if check.gravity > TORQUE_SHARE:
        found.append(
            Finding(
                f"{name}: gravity takes {check.gravity:.0%} of its torque somewhere in the workspace",
                f"records need it below {TORQUE_SHARE:.0%}",
                "nothing where the plan avoids these postures; else a larger torque_limit_Nm",
                False,
            )
        )
    if check.sag > POSTURE_TOLERANCE:
        found.append(
            Finding(
                f"{name}: its spring gives by up to {1e3 * check.sag:.3g} mrad under gravity",
                "the link is not where the motor says; K of the datasheet is used to tell",
                "a sound K, or a link encoder",
                False,
            )
        )
    if check.settling is not None and check.periods is not None and check.periods > e.periods:
        found.append(
            Finding(
                f"{name}: a transient takes {check.settling} periods to die, so records last {check.periods}",
                "the first periods have to be thrown away",
                "a higher lock_pd_Hz, or nothing",
                False,
            )
        )
    if check.visible is not None and check.visible < VISIBLE:
        found.append(
            Finding(
                f"{name}: at {e.band[1]:g} Hz its motor moves {check.visible:.2g} times the encoder's noise",
                "the upper lines tell little",
                "a larger swing_rad or torque, more periods, a finer encoder",
                False,
            )
        )
    return found
