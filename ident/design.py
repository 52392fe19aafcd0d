"""One record, designed on the declared robot before anything moves: locks, band, size of the excitation, settling time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, log

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh

from ident.dob import ClosedLoop, Margins, Servo, check_stable, close_loop, hold_servo, lock_servo, margins
from ident.errors import ExperimentError
from ident.excitation import KNEE, Multisine, random_phase_odd, schroeder, synthesise
from ident.plant import Linear, Plant, build_plant, linearise
from symgen.chain import Chain
from symgen.robot import Robot

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

LOCKS = ("dob", "rigid")
EXCITATIONS = ("odd", "schroeder")

#: Share of a motor's torque limit that preload and predicted peak may use together: the declared arm is not the true one.
TORQUE_SHARE = 0.7

#: Locks are tried as declared, then softer, until no motor's loop comes nearer to -1 than `DISTANCE`: (share of the PD's
#: bandwidth, observer on). PD alone is stable at any bandwidth far below the sampling rate. 0.25 leaves 14 deg of phase
#: and bears a gain wrong by 20 % downwards, 33 % upwards, the true arm being off by as much.
SOFTER = ((1.0, True), (0.7, True), (0.5, True), (1.0, False), (0.5, False))
DISTANCE = 0.25

#: The excitation grows from zero over this share of the first period, so that the arm starts without a jerk.
RAMP = 0.25

#: A transient that has fallen to this part of what it was has settled; at least `STEADY` periods are recorded after it, from
#: which `ident.frf` can tell that it has.
SETTLED, STEADY = 1e-3, 3
MOST_SETTLING = 30

#: A record is excited up to `ABOVE` times the joint's own resonance where that lies outside the band, and never beyond
#: `NYQUIST` times the sampling rate; below `KNEE_SHARE` of it the spectrum falls, so that the swing is spent where it tells.
ABOVE, NYQUIST, KNEE_SHARE = 1.25, 0.4, 0.25

_LIMIT_SLACK = 1e-6  # rad: limits and postures are written with a few digits


@dataclass(frozen=True, eq=False)
class Setup:
    """One record, designed on the declared robot: what to play on which motor, and how the others are held.

    `joint` (from 0) is excited at `posture` [n, rad] by `excitation` over `periods`, of which the first `settle` hold the
    transient; `live` joints (from 0) are under `servos` [live].
    Predicted: `growth` [1/s] of the slowest closed-loop mode; `margins` of the loops of all motors; `held` the largest
    velocity of a held motor relative to the excited one's, rms over the lines; `swing` [rad] the largest peak of any motor
    or link about rest (joint side); `torque` [live, N m] the peak of each motor, preload included; `f_AR` [Hz] the
    anti-resonance that tells most of the joint's J_ii. `note` is empty, or one line about what is not as robot.toml has it.
    """

    joint: int
    posture: Array
    excitation: Multisine
    periods: int
    settle: int
    live: tuple[int, ...]
    servos: tuple[Servo, ...]
    growth: float
    margins: Margins
    held: float
    swing: float
    torque: Array
    f_AR: float
    note: str


def prepare(
    chain: Chain,
    robot: Robot,
    joint: str,
    posture: ArrayLike,
    *,
    lock: str,
    rng: np.random.Generator,
    excitation: str = "odd",
) -> Setup:
    """Returns the record of one cell, designed on the linear model of the declared robot; arguments as in `bench.simulate`.

    The excitation is as large as `Experiment.swing` allows for every motor and link, and `TORQUE_SHARE` for every motor.
    """
    e = robot.experiment
    q = _checked_posture(chain, joint, posture)
    i, where = chain.names.index(joint), place(joint, q)
    for word, value, known in (("lock", lock, LOCKS), ("excitation", excitation, EXCITATIONS)):
        if value not in known:
            raise ExperimentError(f"{word} = {value!r}; expected {' or '.join(map(repr, known))}")
    free = i if lock == "rigid" else None
    plant = build_plant(chain, [robot.drive(name) for name in chain.names], robot.gravity, q, free=free)
    linear = linearise(plant)
    loop, servos, found, softened = _locked(plant, linear, robot, i, where)
    port = plant.live.index(i)
    f_AR, f_R = _own_pair(linear, plant, port)
    band, knee, unseen = _band(robot, where, f_AR, f_R)
    signal = (
        random_phase_odd(e.f0, band, rng, fs=e.fs, knee=knee)
        if excitation == "odd"
        else schroeder(e.f0, band, knee=knee)
    )
    states = loop.response(signal.lines * signal.f0, port) * signal.spectrum[:, None]
    motion, torque = states[:, : 2 * len(servos)], states @ loop.U.T
    torque[:, port] += signal.spectrum
    scale, swing, peaks = _size(chain, robot, plant, signal.lines, motion, torque, where)
    moved = np.linalg.norm(signal.lines[:, None] * motion[:, : len(servos)], axis=0)  # as velocities
    held = np.delete(moved, port).max(initial=0.0) / moved[port]
    growth = loop.growth
    settle = ceil(RAMP + log(SETTLED) / growth * e.f0)
    if settle > MOST_SETTLING:
        raise ExperimentError(
            f"{where}: transients need {settle / e.f0:.3g} s to die, {settle} periods, expected at most {MOST_SETTLING}: check "
            "D_Nms_per_rad, lower line_spacing_Hz or raise lock_pd_Hz"
        )
    return Setup(
        i, q, signal.scaled(scale), max(e.periods, settle + STEADY), settle, plant.live, servos, growth, found,
        float(held), swing, peaks, f_AR, "; ".join(filter(None, (softened, unseen))),
    )  # fmt: skip


def place(joint: str, q: Array) -> str:
    """A cell, as error messages begin with it."""
    return f"joint {joint!r} at posture [{', '.join(f'{value:.4g}' for value in q)}]"


def summary(chain: Chain, setups: Sequence[Setup]) -> tuple[str, ...]:
    """Returns what a person should know of a campaign before it starts, one line each; notes once a joint."""

    def cell(setup: Setup) -> str:
        return place(chain.names[setup.joint], setup.posture)

    near = min(setups, key=lambda s: s.margins.distance)
    locks = (
        f"Locks: every loop keeps {near.margins.distance:.2f} or more from -1; worst gain margins "
        f"{max(s.margins.gain_down for s in setups):.2f} and {min(s.margins.gain_up for s in setups):.2f}, worst phase margin "
        f"{min(s.margins.phase for s in setups):.0f} deg ({cell(near)})"
    )
    lines = [locks]
    if len(near.live) > 1:
        loose = max(setups, key=lambda s: s.held)
        lines.append(f"Held motors move up to {loose.held:.2f} of the excited one's velocity ({cell(loose)})")
    slow = max(setups, key=lambda s: s.settle)
    lines.append(f"Transients die within {slow.settle} of {slow.periods} periods ({cell(slow)})")
    for joint, name in enumerate(chain.names):
        own = [s for s in setups if s.joint == joint and s.note]
        if own:
            many = f" (and {len(own) - 1} more of its postures)" if len(own) > 1 else ""
            lines.append(f"{place(name, own[0].posture)}{many}: {own[0].note}")
    return tuple(lines)


def _checked_posture(chain: Chain, joint: str, posture: ArrayLike) -> Array:
    if joint not in chain.names:
        raise ExperimentError(f"cell excites joint {joint!r}; the arm has {', '.join(chain.names)}")
    q = np.array(posture, dtype=float)
    if q.shape != (chain.n,) or not np.all(np.isfinite(q)):
        found = " ".join(str(posture).split())
        raise ExperimentError(f"joint {joint!r}: posture {found}; expected {chain.n} finite numbers")
    for one, value in zip(chain.joints, q, strict=True):
        if not one.lower - _LIMIT_SLACK <= value <= one.upper + _LIMIT_SLACK:
            raise ExperimentError(
                f"{place(joint, q)}: {one.name!r} = {value:g} is outside its limits [{one.lower:g}, {one.upper:g}]"
            )
    return q


def _locked(
    plant: Plant, linear: Linear, robot: Robot, excited: int, where: str
) -> tuple[ClosedLoop, tuple[Servo, ...], Margins, str]:
    """The declared plant under a soft hold of the excited joint and the stiffest lock of the others that is safe.

    ExperimentError where none is; the note says what was softened.
    """
    e = robot.experiment
    tried = SOFTER if len(plant.live) > 1 else SOFTER[:1]
    first = None
    for share, observed in tried:
        servos = _servos(plant, linear, excited, share * e.lock_pd, e.lock_dob if observed else 0.0)
        loop = close_loop(*linear.sampled(1 / e.fs), servos, 1 / e.fs)
        if loop.growth < 0 and (found := margins(loop)).distance >= (DISTANCE if len(tried) > 1 else 0.0):
            if first is None:
                return loop, servos, found, ""
            observer = f"observer of {e.lock_dob:g} Hz" if observed else "no observer"
            return loop, servos, found, f"lock softened to PD {share * e.lock_pd:.3g} Hz, {observer}: {first}"
        if first is None:
            first = (
                f"as declared it is {found.distance:.2f} from instability, allowed {DISTANCE:g}"
                if loop.growth < 0
                else "as declared it is unstable"
            )
    check_stable(loop, where)
    raise ExperimentError(
        f"{where}: no lock is safe: the last one tried keeps {found.distance:.2g} from instability, allowed {DISTANCE:g}; "
        "change lock_pd_Hz or raise the sampling rate"
    )


def _servos(plant: Plant, linear: Linear, excited: int, f_pd: float, f_dob: float) -> tuple[Servo, ...]:
    drives = [plant.drives[k] for k in plant.live]
    gravity = np.diag(linear.gravity_stiffness([drive.K for drive in drives]))
    servos = []
    for k, drive, J, dG in zip(plant.live, drives, np.diag(linear.link_inertia), gravity, strict=True):
        inertia, damping = float(J) + drive.N**2 * drive.J_m, drive.N**2 * drive.D
        hold = hold_servo(drive.N, inertia, float(dG), damping)
        servos.append(hold if k == excited else lock_servo(drive.J_m, f_pd, f_dob))
    return tuple(servos)


def _own_pair(linear: Linear, plant: Plant, port: int) -> tuple[float, float]:
    """Anti-resonance [Hz] with the largest share of J_ii of the joint at `port`, motors held, and the resonance above it.

    Mode k of (K, J), phi^T J phi = 1, is felt by motor i as the mass K_i^2 phi_ik^2 / w_k^4; their sum is J_ii.
    """
    K = np.array([plant.drives[k].K for k in plant.live])
    squares, shapes = eigh(np.diag(K), linear.link_inertia)
    mass = (K[port] * shapes[port] / squares) ** 2
    k = int(np.argmax(mass))
    drive = plant.drives[plant.live[port]]
    f_AR = float(np.sqrt(squares[k]) / (2 * np.pi))
    return f_AR, f_AR * float(np.sqrt(1 + mass[k] / (drive.N**2 * drive.J_m)))


def _band(robot: Robot, where: str, f_AR: float, f_R: float) -> tuple[tuple[float, float], float, str]:
    """Band [Hz] and knee [Hz] of a record, and a note where the joint's own anti-resonance is not in the declared band."""
    e = robot.experiment
    low, high = e.band
    if f_AR <= high:
        return e.band, KNEE, ""
    top = ABOVE * f_R
    if top <= NYQUIST * e.fs:
        note = f"f_AR = {f_AR:.3g} Hz is above the band's {high:g} Hz: excited up to {top:.3g} Hz"
        return (low, top), max(KNEE, KNEE_SHARE * f_AR), note
    note = (
        f"f_AR = {f_AR:.3g} Hz is above the band's {high:g} Hz and too high for {e.fs:g} samples a second: J_ii is not seen "
        f"here without sample_rate_Hz >= {top / NYQUIST:.3g} or a K known beforehand"
    )
    return e.band, KNEE, note


def _size(
    chain: Chain, robot: Robot, plant: Plant, lines: NDArray[np.int64], motion: Complex, torque: Complex, where: str
) -> tuple[float, float, Array]:
    """How many times the signal may be played, and what peaks it then causes: [rad] of any angle, [live, N m] of each motor.

    `motion` [L, 2 live] and `torque` [L, live] are the spectra that the signal causes.
    """
    e = robot.experiment
    peak = float(np.abs(synthesise(lines, motion, e.samples_per_period)).max())
    peak_torque = np.abs(synthesise(lines, torque, e.samples_per_period)).max(axis=0)
    limits = np.array([plant.drives[k].tau_max for k in plant.live])
    preload = np.abs(plant.preload[list(plant.live)])
    room = TORQUE_SHARE * limits - preload
    if np.any(room <= 0):
        k = int(np.argmin(room / limits))
        raise ExperimentError(
            f"{where}: gravity alone needs {preload[k]:.3g} N m of motor {chain.names[plant.live[k]]!r}; expected less than "
            f"{TORQUE_SHARE:.0%} of its limit of {limits[k]:g} N m"
        )
    scale = float(1 / max(peak / e.swing, np.max(peak_torque / room)))
    return scale, scale * peak, preload + scale * peak_torque
