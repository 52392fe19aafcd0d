"""One record, designed on the declared robot before anything moves: locks, band, size of the excitation, settling time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, log

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh

from ident.errors import ExperimentError
from ident.records.excitation import KNEE, Multisine, random_phase_odd, schroeder, synthesise
from ident.simulator.dob import SAGS, SLIDES, ClosedLoop, Margins, Servo
from ident.simulator.locks import locked
from ident.simulator.plant import Linear, Plant, build_plant, linearise
from symgen.chain import REVOLUTE, Chain
from symgen.robot import Experiment, Robot

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

LOCKS = ("dob", "rigid")
EXCITATIONS = ("odd", "schroeder")

#: Share of a motor's torque limit that preload and predicted peak may use together: the declared arm is not the true one.
TORQUE_SHARE = 0.7

#: The excitation grows from zero over this share of the first period, so that the arm starts without a jerk.
RAMP = 0.25

#: A transient that has fallen to this part of what it was has settled; at least `STEADY` periods are recorded after it, from
#: which `ident.records.frf` can tell that it has.
SETTLED, STEADY = 1e-3, 3
MOST_SETTLING = 30

#: A record is excited up to `ABOVE` times the joint's own resonance where its anti-resonance lies outside the band, and never
#: beyond `NYQUIST` times the sampling rate, if then both sides of the anti-resonance are seen: it is below `INSIDE` of the
#: highest line. Below `KNEE_SHARE` of it the spectrum falls, so that the swing is spent where it tells.
ABOVE, NYQUIST, INSIDE, KNEE_SHARE = 1.25, 0.4, 0.9, 0.25

#: Share of the way to its nearer limit that a joint is predicted to go at most: the declared arm is not the true one. A limit
#: that leaves less than `LEAST_ROOM` of what swing and torque allow leaves no room for a record. How far joints go at the
#: start, up to four times as far as later, is looked at where a limit is nearer than `NEAR` times that.
LIMIT_SHARE, LEAST_ROOM, NEAR = 0.9, 0.1, 5.0

_LIMIT_SLACK = 1e-6  # rad: limits and postures are written with a few digits


@dataclass(frozen=True, eq=False)
class Setup:
    """One record, designed on the declared robot: what to play on which motor, and how the others are held.

    `joint` (from 0) is excited at `posture` [n, rad] by `excitation` over `periods`, of which the first `settle` hold the
    transient; `live` joints (from 0) are under `servos` [live].
    Predicted: `growth` [1/s] of the slowest closed-loop mode; `margins` of the loops of all motors; `held` the largest
    velocity of a held motor relative to the excited one's, rms over the lines, each times sqrt(J_ii + N^2 J_m), so that
    slides compare with hinges; `swing` [rad] the largest peak of any motor or link about rest (joint side), `motion` [live,
    rad] that of each motor; `torque` [live, N m] the peak of each motor, preload included; `f_AR` [Hz] the anti-resonance
    that tells most of the joint's J_ii. `note` is empty, or one line about what is not as robot.toml has it.
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
    motion: Array
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

    The excitation is as large as `Experiment.swing` and its limits allow for every motor and link, and `TORQUE_SHARE` for
    every motor.
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
    loop, servos, found, softened = locked(plant, linear, e, i, SLIDES if chain.slides(i) else SAGS, where)
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
    angles, torques = (np.abs(synthesise(signal.lines, x, e.samples_per_period)).max(axis=0) for x in (motion, torque))
    size = _size(chain, robot, plant, angles, torques, where)
    settle = _settling(loop, e.f0, where)
    start = played(signal.scaled(size), e, settle)
    share, short = _within_limits(chain, plant, loop, port, start, size * angles, where)
    size *= share
    weight = np.sqrt(np.diag(linear.M)[: len(servos)] + np.diag(linear.link_inertia))
    moved = weight * np.linalg.norm(signal.lines[:, None] * motion[:, : len(servos)], axis=0)
    held = np.delete(moved, port).max(initial=0.0) / moved[port]
    preload = np.abs(plant.preload[list(plant.live)])
    return Setup(
        i, q, signal.scaled(size), max(e.periods, settle + STEADY), settle, plant.live, servos, loop.growth, found,
        float(held), float(size * angles.max()), size * angles[: len(servos)], preload + size * torques, f_AR,
        "; ".join(filter(None, (softened, unseen, short))),
    )  # fmt: skip


def place(joint: str, q: Array) -> str:
    """A cell, as error messages begin with it."""
    return f"joint {joint!r} at posture [{', '.join(f'{value:.4g}' for value in q)}]"


def summary(chain: Chain, setups: Sequence[Setup]) -> tuple[str, ...]:
    """Returns what a person should know of a campaign before it starts, one line each; notes once a joint."""

    def cell(setup: Setup) -> str:
        return place(chain.names[setup.joint], setup.posture)

    near = min(setups, key=lambda s: s.margins.distance)
    down, up = max(setups, key=lambda s: s.margins.gain_down), min(setups, key=lambda s: s.margins.gain_up)
    turn, late = min(setups, key=lambda s: s.margins.phase), min(setups, key=lambda s: s.margins.delay)
    lines = [
        f"Locks: every loop keeps {near.margins.distance:.2f} or more from -1 ({cell(near)})",
        f"Worst gain margins: {down.margins.gain_down:.2f} ({cell(down)}) and {up.margins.gain_up:.2f} ({cell(up)})",
        f"Worst phase margin: {turn.margins.phase:.0f} deg ({cell(turn)})",
        f"Least delay margin: {1e3 * late.margins.delay:.2g} ms ({cell(late)})",
    ]
    if len(near.live) > 1:
        loose = max(setups, key=lambda s: s.held)
        lines.append(f"Held motors take up to {loose.held:.2f} of the excited one's motion ({cell(loose)})")
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
    top = min(ABOVE * f_R, NYQUIST * e.fs)
    note = f"f_AR = {f_AR:.3g} Hz is above the band's {high:g} Hz"
    if f_AR <= INSIDE * top:
        beyond = f", its f_R is {f_R:.3g} Hz" if f_R > top else ""
        return (low, top), max(KNEE, KNEE_SHARE * f_AR), f"{note}: excited up to {top:.3g} Hz{beyond}"
    note += (
        f" and too high for {e.fs:g} samples a second: J_ii is not seen here without sample_rate_Hz >= "
        f"{f_AR / INSIDE / NYQUIST:.4g} or a K known beforehand"
    )
    return e.band, KNEE, note


def _size(chain: Chain, robot: Robot, plant: Plant, angles: Array, torques: Array, where: str) -> float:
    """How many times a signal that causes these peaks, `angles` [2 live, rad] and `torques` [live, N m], may be played."""
    limits = np.array([plant.drives[k].tau_max for k in plant.live])
    preload = np.abs(plant.preload[list(plant.live)])
    room = TORQUE_SHARE * limits - preload
    if np.any(room <= 0):
        k = int(np.argmin(room / limits))
        raise ExperimentError(
            f"{where}: gravity alone needs {preload[k]:.3g} N m of motor {chain.names[plant.live[k]]!r}, allowed "
            f"{TORQUE_SHARE:.0%} of its limit of {limits[k]:g} N m; another posture or a larger torque_limit_Nm"
        )
    return float(1 / max(angles.max() / robot.experiment.swing, np.max(torques / room)))


def _settling(loop: ClosedLoop, f0: float, where: str) -> int:
    """Periods of 1/`f0` [Hz] until transients have died."""
    settle = ceil(RAMP + log(SETTLED) / loop.growth * f0)
    if settle > MOST_SETTLING:
        raise ExperimentError(
            f"{where}: transients need {settle / f0:.3g} s to die, {settle} periods, expected at most {MOST_SETTLING}; check "
            "D_Nms_per_rad, lower line_spacing_Hz or raise lock_pd_Hz"
        )
    return settle


def played(signal: Multisine, e: Experiment, periods: int) -> Array:
    """The samples of so many first periods of a record [S, N m], with its ramp."""
    play, ramp = np.tile(signal.samples(e.fs), periods), int(RAMP * e.samples_per_period)
    play[:ramp] *= (1 - np.cos(np.pi * np.arange(ramp) / ramp)) / 2
    return play


def _within_limits(
    chain: Chain, plant: Plant, loop: ClosedLoop, port: int, play: Array, angles: Array, where: str
) -> tuple[float, str]:
    """The share of a signal that the joints' limits allow, and a note where that is not all of it.

    `play` [T, N m] is the signal from its start until the arm has settled, `angles` [2 live, rad] the peaks after that.
    """
    live, q = list(plant.live), plant.posture[list(plant.live)]
    lower, upper = chain.limits[live].T
    room = np.maximum(np.minimum(q - lower, upper - q), 0.0) + _LIMIT_SLACK
    far = angles.reshape(2, -1).max(axis=0)
    if np.all(LIMIT_SHARE * room > NEAR * far):
        return 1.0, ""
    state, most = np.zeros(len(loop.A)), np.zeros(len(loop.A))
    for torque in play:
        state = loop.A @ state + loop.B[:, port] * torque
        np.maximum(most, np.abs(state), out=most)
    far = np.maximum(far, most[: len(angles)].reshape(2, -1).max(axis=0))
    k = int(np.argmax(far / room))
    share = float(LIMIT_SHARE * room[k] / far[k])
    if share >= 1:
        return 1.0, ""
    name, unit = chain.names[live[k]], "rad" if chain.joints[live[k]].type == REVOLUTE else "m"
    near = f"{name!r} is {room[k]:.2g} {unit} from its limit and would move {far[k]:.2g} {unit}"
    if share < LEAST_ROOM:
        raise ExperimentError(f"{where}: no room: {near}; another posture, or a smaller swing_rad")
    return share, f"excited at {share:.0%} of what swing and torque allow: {near}"
