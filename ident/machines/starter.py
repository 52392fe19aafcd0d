"""A robot directory to start from: the URDF, and a robot.toml whose numbers a person replaces by the datasheets'."""

from __future__ import annotations

import os
import shutil
from math import pi, sqrt
from pathlib import Path

import numpy as np

from ident.errors import IdentError
from ident.identification.robot_text import one_line
from ident.records.campaign import Array
from ident.simulator.plant import gravity_forces
from ident.toml_text import key, quoted
from symgen.chain import PRISMATIC, Chain
from symgen.plan import chain_of_file, make_model
from symgen.robot import Drive, Experiment

#: Gear ratios to start from: motor revolutions per joint revolution; motor rad per m of a slide (a 10 mm spindle).
GEAR, SPINDLE = 100.0, 2 * pi / 0.01
#: Anti-resonance [Hz] to start from, at the geometric mean of J_ii over the workspace; J_ii equals N^2 J_m there.
F_AR = 20.0
#: Counts of an encoder on a link, by example.
SECOND = 65536
#: Damping of the spring as a share of 2 sqrt(K J), and of the motor per its inertia [1/s]: those of good gears.
DAMPING, MOTOR_DAMPING = 0.01, 1.0
#: A joint whose effort the URDF does not state gets this many times what gravity takes, or what moves link and rotor at
#: this [rad/s2 or m/s2], whichever is more.
RESERVE, ACCELERATION = 4.0, 10.0
#: What a robot.toml may hold of J_m, K, both dampings and the motor's torque (`symgen.robot`), whatever the links weigh.
_J_M, _K, _DAMPING, _TORQUE = (1e-12, 1e3), (1e-3, 1e12), (0.0, 1e9), (1e-9, 1e6)
_POSTURES = 200
_LARGE = 1e6  # N m: what a URDF with a larger effort says is "no limit"


def new_robot(urdf: str | Path, directory: str | Path, *, base: str | None = None, tip: str | None = None) -> Path:
    """Writes `directory` with a copy of the URDF and a robot.toml for its arm from link `base` to `tip`; returns the toml.

    The drives are invented: with them every anti-resonance lies in the default band, and gravity leaves torque to excite
    with. IdentError if the directory has a robot.toml, UrdfError for a URDF that is none.
    """
    urdf, directory = Path(urdf), Path(directory)
    chain, _ = chain_of_file(urdf, base=base, tip=tip)
    toml = directory / "robot.toml"
    if toml.exists():
        raise IdentError(f"{toml}: exists; expected a new directory")
    text = _toml(chain, urdf.name, base, tip)
    directory.mkdir(parents=True, exist_ok=True)
    copy = directory / urdf.name
    if not copy.exists():
        shutil.copyfile(urdf, copy)
    elif copy.read_bytes() != urdf.read_bytes():
        raise IdentError(f"{copy}: exists and differs from {urdf}; expected a new directory")
    beside = toml.with_name(".robot.toml.part")
    beside.write_text(text, encoding="utf-8")
    os.replace(beside, toml)
    return toml


def starting_drives(chain: Chain, gravity: Array) -> tuple[tuple[Drive, ...], Array, Array]:
    """Returns invented drives [n], the range of J_ii over the workspace [n, 2, kg m2] and the largest gravity force [n, N m]."""
    model = make_model(chain)
    q = model.random_postures(_POSTURES, np.random.default_rng(0))
    J = np.diagonal(model.J_cad(q), axis1=1, axis2=2)
    moving = [Drive(j.name, 1.0, 1.0, 1.0, 0.0, 0.0, 1, 1.0, j.type == PRISMATIC) for j in chain.joints]
    force = np.abs(gravity_forces(chain, moving, gravity, q)).max(axis=0)
    middle = np.exp(np.log(np.maximum(J, 1e-9)).mean(axis=0))
    drives = []
    for joint, inertia, weight in zip(chain.joints, middle, force, strict=True):
        slide = joint.type == PRISMATIC
        N = SPINDLE if slide else GEAR
        J_m, K = np.clip(inertia / N**2, *_J_M), np.clip(inertia * (2 * pi * F_AR) ** 2, *_K)
        limit, _ = _effort(joint.effort, weight, inertia, slide)
        D, D_spring = np.clip((MOTOR_DAMPING * J_m, 2 * DAMPING * sqrt(K * inertia)), *_DAMPING)
        tau_max = np.clip(limit / N, *_TORQUE)
        N, J_m, K, D, D_spring, tau_max = map(_two_digits, (N, J_m, K, D, D_spring, tau_max))
        drives.append(Drive(joint.name, N, J_m, K, D, D_spring, 131072, tau_max, slide))
    return tuple(drives), np.stack([J.min(axis=0), J.max(axis=0)], axis=1), force


def _effort(effort: float, weight: float, inertia: float, slide: bool) -> tuple[float, str]:
    """The largest force of a joint [N m or N], and where it is from; `inertia` is the link's and again the rotor's."""
    force, m = ("N", "m") if slide else ("N m", "rad")
    if 0 < effort < _LARGE:
        return effort, f"the URDF's effort, {effort:g} {force}"
    invented = (
        (RESERVE * weight, f"{RESERVE:g} times gravity"),
        (ACCELERATION * 2 * inertia, f"{ACCELERATION:g} {m}/s2 of mean J_ii and N^2 J_m"),
    )
    return max(invented)


def _toml(chain: Chain, urdf: str, base: str | None, tip: str | None) -> str:
    e, gravity = Experiment(), np.array([0.0, 0.0, -9.81])
    drives, inertia, force = starting_drives(chain, gravity)
    frozen = one_line(", ".join(f"{name} = {value:g}" for name, value in chain.frozen.items()))
    title = one_line(f"{chain.name}: {chain.n} joints, {chain.base_link} to {chain.tip_link}.")
    rows = [
        f"# {title} The URDF knows nothing of motors, gears and",
        "# springs: every number marked `check me` is invented. Then: ident doctor on this directory.",
        "",
        "[robot]",
        f"urdf = {quoted(urdf)}   # the declared robot, beside this file",
        *([f"base = {quoted(base)}   # where the arm begins"] if base else ["# base = \"link\"     # where the arm begins, if not at the root"]),
        *([f"tip = {quoted(tip)}   # where it ends"] if tip else ["# tip = \"link\"      # where it ends, if not at the longest chain's end"]),
        f"# at = {{ joint = 0.0 }}    # joints that do not move, and where{'; now ' + frozen if frozen else ''}",
        "believe_zeros = false   # true: inertial parameters that are exactly zero in the URDF are known to be zero",
        "gravity_m_per_s2 = [0, 0, -9.81]   # in the base frame; check me if the arm hangs or stands on a wall",
        "",
        "[experiment]",
        f"sample_rate_Hz = {e.fs:g}     # of the torque command and of the encoder readings",
        f"band_Hz = [{e.band[0]:g}, {e.band[1]:g}]    # must hold the anti-resonance and resonance of every joint",
        f"line_spacing_Hz = {e.f0:g}     # one period lasts 1 / this; finer resolves sharper resonances",
        f"periods = {e.periods}              # recorded, the settling ones included",
        f"swing_rad = {e.swing:g}         # no motor or link swings further about its posture (joint side; m for slides)",
        f"torque_noise_rel = {e.torque_noise:g} # of simulated robots only: torque noise, rms, relative to the excitation's",
        f"lock_pd_Hz = {e.lock_pd:g}           # how stiffly the other motors hold, on their own inertia",
        f"lock_dob_Hz = {e.lock_dob:g}         # bandwidth of their disturbance observers, well above lock_pd_Hz",
    ]  # fmt: skip
    for joint, drive, (low, high), weight in zip(chain.joints, drives, inertia, force, strict=True):
        rows += ["", *_joint(drive, low, high, weight, joint.effort)]
    return "\n".join(rows) + "\n"


def _joint(drive: Drive, low: float, high: float, weight: float, effort: float) -> list[str]:
    slide = drive.linear
    kg, force, m = ("kg", "N", "m") if slide else ("kg m2", "N m", "rad")
    per = "N_rad_per_m" if slide else "N"
    K, D = ("K_N_per_m", "D_spring_Ns_per_m") if slide else ("K_Nm_per_rad", "D_spring_Nms_per_rad")
    f_low, f_high = (sqrt(drive.K / J) / (2 * pi) for J in (high, max(low, 1e-9)))
    _, stated = _effort(effort, weight, drive.N**2 * drive.J_m, slide)
    return [
        f"[joint.{key(drive.joint)}]",
        f"# J_ii from {low:.3g} to {high:.3g} {kg} over the workspace, gravity up to {weight:.3g} {force}.",
        f"{per} = {drive.N:g}   # motor rad per joint {m}, negative if reversed; check me: gear datasheet",
        f"J_m_kgm2 = {drive.J_m:g}   # rotor, brake and wave generator, motor side; check me: N^2 J_m = mean J_ii is a guess",
        f"{K} = {drive.K:g}   # gear, joint side; check me: so chosen that f_AR is {f_low:.3g} to {f_high:.3g} Hz",
        f"D_Nms_per_rad = {drive.D:g}   # viscous friction of the motor, motor side; check me, roughly is enough",
        f"{D} = {drive.D_spring:g}   # damping of the spring, joint side; check me, roughly is enough",
        f"encoder_counts_per_rev = {drive.encoder_counts}   # of the motor; check me: datasheet",
        f"torque_limit_Nm = {drive.tau_max:g}   # motor side; check me: {stated}, over N",
        f"# link_encoder_counts_per_{'m' if slide else 'rev'} = {SECOND}   # where every link has an encoder of its own, behind the spring",
    ]  # fmt: skip


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}") if value > 0 else 0.0
