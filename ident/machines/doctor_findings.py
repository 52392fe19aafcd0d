"""What may be amiss with a robot before a campaign, by its figures: each finding says why it matters and what helps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, pi

from ident.records.frf import POSTURE_TOLERANCE
from ident.simulator.design import TORQUE_SHARE, Setup, place
from symgen.plan import Plan
from symgen.robot import MOST_SAMPLES, Drive, Experiment, Robot, recordable

#: Below this J_ii / (N^2 J_m) the link hardly shows in the motor's response: an error of f_R counts 2 (1 + r) / r times.
LIGHT = 0.1
#: Angles at the highest line that are less than this many times the encoder's noise tell little.
VISIBLE = 10.0
#: A motor that moves through fewer counts of its encoder than `STEPS` is not seen to move. The error of few counts is no noise:
#: gains read from two are off by ten sigma, from three by three, from four and more by less than two; `COUNTS` is one more.
#: Below `STILL` a motor is read as standing, which it then does.
STEPS, COUNTS, STILL = 2.0, 5.0, 0.1
#: A resonance is resolved when this many excited lines lie within its half-power width.
RESOLVED = 1.0
#: Held motors that move more than this, relative to the excited one, show in a two-mass fit.
HELD = 0.02
#: What no arm is built like, but units make of it: a spring that gives by so much [rad, m] under gravity, rotors that are so many times J_ii,
#: and so small a part of it, at every posture (direct drives have a hundredth).
FALLS, SLUMPS = 0.5, 0.05
HEAVY_ROTOR, LIGHT_ROTOR = 100.0, 0.003


@dataclass(frozen=True)
class JointCheck:
    """One joint over the workspace, and at the postures planned for it; a `linear` one has m, N and kg for rad, N m and kg m2.

    `J` [2] least and largest J_ii [kg m2], `rotor` N^2 J_m, `ratio` [2] of the two; `f_AR`, `f_R` [2, Hz] over the
    workspace and `planned_f_AR`, `planned_f_R` at the planned postures, other joints rigid; `gravity` the largest share of
    the motor's torque; `sag` [rad] the largest static deflection of the spring. Of the `records` that excite it: `swing`
    [rad] predicted; `counts` the fewest encoder counts that its motor moves through, `held_counts` those that the held
    motor moves through which moves through most; `torque` the largest share of any motor's limit; `settling` and `periods`
    the most that any needs and lasts; `margin` the least distance of a loop from -1; `delay` the fewest samples of delay
    that make one unstable; `held` the largest velocity of a held motor over the excited one's, see `design.Setup`;
    `visible` the least angle at the highest line over the encoder's noise, that line being at `visible_at` [Hz];
    `beyond` [f_R of two masses, highest line, Hz] of the record that misses its resonance by most, None where none
    does; `unseen` [f_AR, highest line, Hz] the same of the anti-resonance that tells most of J_ii, with the other
    joints' springs. None: no record could be designed.
    """

    joint: str
    linear: bool
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
    counts: float | None
    held_counts: float | None
    torque: float | None
    settling: int | None
    periods: int | None
    margin: float | None
    delay: float | None
    held: float | None
    visible: float | None
    visible_at: float | None
    beyond: tuple[float, float] | None
    unseen: tuple[float, float] | None


@dataclass(frozen=True)
class Finding:
    """What is amiss, why it matters, and what helps; not `serious` when a campaign can be run all the same."""

    what: str
    why: str
    remedy: str
    serious: bool


def of_plan(plan: Plan) -> list[Finding]:
    """What the plan can not hold, does not determine, or can not see."""
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
                "none needed with ident fit as it is: --method coupled reads all motors",
                False,
            )
        )
    return findings


def of_locks(plan: Plan, setups: Sequence[Setup]) -> list[Finding]:
    """What the records' design had to change, once a joint, and whether the locks hold."""
    names = plan.model.chain.names
    found = []
    for i, name in enumerate(names):
        noted = [setup for setup in setups if setup.joint == i and setup.note]
        if noted:
            why = f"{place(name, noted[0].posture)}: {noted[0].note}"
            what = f"{name}: {len(noted)} of its records not run as robot.toml has it"
            helps = (
                ("is not seen here", "sample_rate_Hz, band_Hz or K"),
                ("from its limit", "other postures"),
                (
                    "raise the sampling rate",
                    "a higher sample_rate_Hz: a controller that acts a sample late may let it swing up",
                ),
            )
            remedy = "; ".join(remedy for said, remedy in helps if said in noted[0].note)
            found.append(Finding(what, why, remedy or "none needed", False))
    loose = max(setups, key=lambda setup: setup.held, default=None)
    if loose is not None and loose.held > HELD:
        found.append(
            Finding(
                f"held motors take up to {loose.held:.2g} of the excited one's motion",
                "two masses then do not describe a joint",
                "none needed with ident fit as it is: --method coupled reads all motors",
                False,
            )
        )
    return found


def of_band(check: JointCheck, robot: Robot) -> list[Finding]:
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
        f_AR, first = check.planned_f_AR[0], max(ceil((e.band[0] / e.f0 - 1.0) / 2.0), 0)
        below = max(ceil((f_AR / e.f0 - 1.0) / 2.0) - first, 0)
        found.append(
            Finding(
                f"{check.joint}: its anti-resonance falls to {f_AR:.3g} Hz, below which {below or 'no'} line{'s' if below > 1 else ''} "
                f"of {e.band[0]:g} to {e.band[1]:g} Hz, every {2 * e.f0:g} Hz, "
                f"{'lie' if below > 1 else 'lies'}",
                "only lines below it show the whole inertia",
                "a lower band_Hz, a smaller line_spacing_Hz",
                True,
            )
        )
    width = drive.D_spring / check.J[1] / (2 * pi)  # half-power width of the anti-resonance: D/J [rad/s]
    apart = 2 * e.f0  # what is excited are odd lines
    if 0 < width < RESOLVED * apart:
        found.append(
            Finding(
                f"{check.joint}: its sharpest anti-resonance is {width:.3g} Hz wide, excited lines are {apart:g} Hz "
                "apart",
                "its depth, and with it the spring's damping, falls between the lines",
                _finer(e, width),
                False,
            )
        )
    return found


def _finer(e: Experiment, width: float) -> str:
    """The remedy for a resonance `width` [Hz] wide: a line spacing that shows it and that robot.toml may have."""
    times = 2 * RESOLVED * e.f0 / width
    if times * e.fs / e.f0 * e.periods > MOST_SAMPLES:
        return "check D_spring: no record holds lines as close as this needs"
    short = (float(f"{e.f0 / k:.3g}") for k in range(ceil(times), ceil(2.5 * times) + 1))
    fine = (spacing for spacing in short if recordable(e.fs, spacing, e.periods) and 2 * RESOLVED * spacing <= width)
    return f"line_spacing_Hz = {next(fine, e.f0 / ceil(times)):.10g}, or more periods"


def of_drive(check: JointCheck, robot: Robot) -> list[Finding]:
    """The link against the rotor, gravity against motor and spring, the encoder against the highest line."""
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
    if POSTURE_TOLERANCE < check.sag <= (SLUMPS if check.linear else FALLS):
        unit = "mm" if check.linear else "mrad"
        found.append(
            Finding(
                f"{name}: its spring gives by up to {1e3 * check.sag:.3g} {unit} under gravity",
                "the link is not where the motor says",
                "none needed with ident fit as it is: --method coupled tells by the K found where the link rests, the others do not",
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
    return found + of_units(check, robot.drive(name)) + of_encoders(check)


def of_units(check: JointCheck, drive: Drive) -> list[Finding]:
    """Figures that units or sides of the gear make, and arms hardly have."""
    name, found = check.joint, []
    if check.sag > (SLUMPS if check.linear else FALLS):
        unit = "m" if check.linear else "rad"
        asks = "is K in N/mm? multiply it by 1000" if check.linear else "is K in N m/deg? multiply it by 57.3"
        why, remedy = (
            f"no joint rests {check.sag:.2g} {unit} from its motor",
            f"{asks}; else check the masses in the URDF",
        )
        found.append(
            Finding(f"{name}: its spring gives by up to {check.sag:.3g} {unit} under gravity", why, remedy, True)
        )
    if asked := turns_too_little(drive):
        what = f"{name}: N = {drive.N:g}, its motor turns less than the joint"
        found.append(Finding(what, "N is turns of the motor over turns of the joint", asked, False))
    heavy, light = check.ratio[1] < 1 / HEAVY_ROTOR, check.ratio[0] > 1 / LIGHT_ROTOR
    if heavy or light:
        J_ii = check.J[1] if heavy else check.J[0]
        asks = "is it in g cm2 (1e-7), kg cm2 (1e-4), or that of the joint's side (over N^2)?"
        what = f"{name}: N^2 J_m is {check.rotor / J_ii:.2g} times J_ii, whatever the posture"
        why = "the link hardly shows in its motor's response" if heavy else "the motor hardly shows beside its link"
        found.append(Finding(what, why, f"J_m_kgm2 = {drive.J_m:g}: {asks}", False))
    return found


def turns_too_little(drive: Drive) -> str:
    """What to ask of a drive whose motor turns less than its joint, as 1/N has it; empty where it turns as much at least."""
    return "" if drive.linear or abs(drive.N) >= 1.0 else f"is 1/N meant, N = {1 / drive.N:.4g}?"


def of_encoders(check: JointCheck) -> list[Finding]:
    """The motion of excited and held motors against what their encoders tell."""
    name, found = check.joint, []
    if check.counts is not None and check.counts < STEPS:
        found.append(
            Finding(
                f"{name}: its motor moves through {check.counts:.2g} counts of its encoder",
                "angles of so few steps tell nothing of the responses",
                "a larger swing_rad, a finer encoder",
                True,
            )
        )
    elif check.visible is not None and check.visible < VISIBLE:
        found.append(
            Finding(
                f"{name}: at {check.visible_at:.4g} Hz its motor moves {check.visible:.2g} times the encoder's noise",
                "the upper lines tell little" if check.visible >= 1 else "the upper lines tell nothing",
                "a larger swing_rad or torque, more periods, a finer encoder",
                check.visible < 1,
            )
        )
    if check.held_counts is not None and check.held_counts < COUNTS:
        found.append(
            Finding(
                f"{name}: in its records held motors move through as little as {check.held_counts:.2g} counts of their encoders",
                "the error of so few steps is no noise: sigma of J(q) comes out too small",
                "a larger swing_rad, finer encoders",
                False,
            )
        )
    return found
