"""The simulated robot: runs a campaign on a plant and hands out what a real robot would: torques and encoder readings."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from math import pi

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ident.campaign import Campaign, Record
from ident.dob import ClosedLoop, Servo, check_stable, close_loop, controller, hold_servo, lock_servo
from ident.errors import ExperimentError
from ident.excitation import Multisine, random_phase_odd, schroeder, synthesise
from ident.plant import Plant, build_plant, linearise
from symgen.chain import Chain
from symgen.robot import Drive, Robot

Array = NDArray[np.float64]

LOCKS = ("dob", "rigid")
EXCITATIONS = ("odd", "schroeder")

#: Share of a motor's torque limit that preload and predicted peak may use together: the declared arm is not the true one.
TORQUE_SHARE = 0.7

#: Largest relative frequency error of an elastic mode that the integrator's step may cause: four times it on an inertia.
MODE_ERROR = 2e-6

#: The excitation grows from zero over this share of the first period, so that the arm starts without a jerk.
RAMP = 0.25

#: A joint that strays this many times the allowed swing from rest, in the last period, is no longer at its posture.
STRAY = 3.0

_LIMIT_SLACK = 1e-6  # rad: limits and postures are written with a few digits


@dataclass(frozen=True, eq=False)
class Setup:
    """One record, designed on the declared robot: what to play on which motor, and how the others are held.

    `joint` (from 0) is excited at `posture` [n, rad] by `excitation`; `live` joints (from 0) are under `servos` [live].
    Predicted: `growth` [1/s] of the slowest closed-loop mode, `swing` [rad] the largest peak of any motor or link about
    rest (joint side), `torque` [live, N m] the peak of each motor, preload included.
    """

    joint: int
    posture: Array
    excitation: Multisine
    live: tuple[int, ...]
    servos: tuple[Servo, ...]
    growth: float
    swing: float
    torque: Array


@dataclass(frozen=True, eq=False)
class _Job:
    """Everything one record needs, to be sent to a worker process. `chain` and `drives` are those of the simulated arm."""

    id: str
    setup: Setup
    robot: Robot
    chain: Chain
    drives: tuple[Drive, ...]
    steps: int | None
    integrator: str
    seed: np.random.SeedSequence


def simulate(
    chain: Chain,
    robot: Robot,
    cells: Sequence[tuple[str, ArrayLike]],
    *,
    lock: str = "dob",
    seed: int = 0,
    truth: Chain | None = None,
    truth_drives: Sequence[Drive] | None = None,
    excitation: str = "odd",
    integrator: str = "RK4",
    steps: int | None = None,
    workers: int = 2,
    progress: Callable[[int, int], None] | None = None,
) -> Campaign:
    """Returns the records of `cells`, (joint name, posture q [n, rad]) each, in that order.

    `lock` "dob" holds the other joints by their motors (PD and disturbance observer), "rigid" freezes them (the paper's
    simulation). `truth` and `truth_drives` [n] are the simulated arm where it differs from the declared `chain` and
    `robot`; the campaign tells the declared one only. `excitation`: "odd" (random phases, detection lines) or "schroeder"
    (all lines). `steps` of the integrator a sample: chosen so that no mode in the band is off by more than `MODE_ERROR`.
    Every record draws from its own seed: the result does not depend on `workers` (processes; more than one needs the
    caller's script to be guarded by `if __name__ == "__main__"`). `progress(done, total)` is called after every record.

    ExperimentError naming joint and posture: outside the limits, gravity above the motor's torque, unstable lock, torque
    clipped, arm fallen to another equilibrium. All but the last two are found before anything is simulated.
    """
    drives = tuple(robot.drive(name) for name in chain.names)
    arm, true_drives = truth or chain, drives if truth_drives is None else tuple(truth_drives)
    if arm.names != chain.names:
        raise ExperimentError(f"truth has the joints {', '.join(arm.names)}; expected {', '.join(chain.names)}")
    jobs = []
    for k, ((name, q), cell) in enumerate(zip(cells, np.random.SeedSequence(seed).spawn(len(cells)), strict=True)):
        design, noise = cell.spawn(2)
        setup = prepare(chain, robot, name, q, lock=lock, excitation=excitation, rng=np.random.default_rng(design))
        jobs.append(_Job(f"{k + 1:04d}", setup, robot, arm, true_drives, steps, integrator, noise))
    records: list[Record] = []
    for record in _run_all(jobs, min(workers, len(jobs))):
        records.append(record)
        if progress:
            progress(len(records), len(jobs))
    held = "held by PD and disturbance observer" if lock == "dob" else "rigid"
    return Campaign(
        urdf=chain.source,
        joints=chain.names,
        fs=robot.experiment.fs,
        hold="zoh",
        N=np.array([drive.N for drive in drives]),
        J_m=np.array([drive.J_m for drive in drives]),
        K=np.array([drive.K for drive in drives]),
        gravity=robot.gravity,
        source=f"simulated: MuJoCo {mujoco.__version__}, {integrator}, other joints {held}, {excitation} multisine",
        records=tuple(records),
    )


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
    """Returns the record of one cell, designed on the linear model of the declared robot; arguments as in `simulate`.

    The excitation is as large as `Experiment.swing` allows for every motor and link, and `TORQUE_SHARE` for every motor.
    """
    e = robot.experiment
    q = _checked_posture(chain, joint, posture)
    i, where = chain.names.index(joint), _where(joint, q)
    for word, value, known in (("lock", lock, LOCKS), ("excitation", excitation, EXCITATIONS)):
        if value not in known:
            raise ExperimentError(f"{word} = {value!r}; expected {' or '.join(map(repr, known))}")
    free = i if lock == "rigid" else None
    plant = build_plant(chain, [robot.drive(name) for name in chain.names], robot.gravity, q, free=free)
    loop, servos = _closed_loop(plant, robot, i)
    growth = check_stable(loop, where)
    signal = random_phase_odd(e.f0, e.band, rng, fs=e.fs) if excitation == "odd" else schroeder(e.f0, e.band)

    m, port = len(plant.live), plant.live.index(i)
    states = loop.response(signal.lines * signal.f0, port) * signal.spectrum[:, None]
    torque = states @ loop.U.T
    torque[:, port] += signal.spectrum
    peak = np.abs(synthesise(signal.lines, states[:, : 2 * m], e.samples_per_period)).max()
    peak_torque = np.abs(synthesise(signal.lines, torque, e.samples_per_period)).max(axis=0)
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
    return Setup(
        i, q, signal.scaled(scale), plant.live, servos, growth, float(scale * peak), preload + scale * peak_torque
    )


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
                f"{_where(joint, q)}: {one.name!r} = {value:g} is outside its limits [{one.lower:g}, {one.upper:g}]"
            )
    return q


def _closed_loop(plant: Plant, robot: Robot, excited: int) -> tuple[ClosedLoop, tuple[Servo, ...]]:
    """The declared plant under a soft hold of the excited joint and the lock of the others."""
    e, linear = robot.experiment, linearise(plant)
    drives = [plant.drives[k] for k in plant.live]
    gravity = np.diag(linear.gravity_stiffness([drive.K for drive in drives]))
    servos = []
    for k, drive, J, dG in zip(plant.live, drives, np.diag(linear.link_inertia), gravity, strict=True):
        inertia = float(J) + drive.N**2 * drive.J_m
        servos.append(
            hold_servo(drive.N, inertia, float(dG)) if k == excited else lock_servo(drive.J_m, e.lock_pd, e.lock_dob)
        )
    return close_loop(*linear.sampled(1 / e.fs), servos, 1 / e.fs), tuple(servos)


def _run_all(jobs: list[_Job], workers: int) -> Iterator[Record]:
    if workers <= 1:
        yield from map(_run, jobs)
        return
    try:
        with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
            yield from pool.map(_run, jobs)
    except BrokenProcessPool:
        raise ExperimentError(
            "a worker process ended before its record was done; guard the calling script by "
            'if __name__ == "__main__", or use workers=1'
        ) from None


def _run(job: _Job) -> Record:
    """Simulates one record on the true arm and reads it as a robot's controller would."""
    setup, robot, e = job.setup, job.robot, job.robot.experiment
    free = None if len(setup.live) == job.chain.n else setup.joint
    plant = build_plant(job.chain, job.drives, robot.gravity, setup.posture, free=free, integrator=job.integrator)
    steps = job.steps or linearise(plant).rk4_steps(e.fs, e.band[1], MODE_ERROR)
    plant.model.opt.timestep = 1 / (e.fs * steps)
    where = _where(job.chain.names[setup.joint], setup.posture)
    play = np.tile(setup.excitation.samples(e.fs), e.periods)
    ramp = int(RAMP * e.samples_per_period)
    play[:ramp] *= (1 - np.cos(pi * np.arange(ramp) / ramp)) / 2
    size = np.array([plant.drives[k].tau_max for k in setup.live]) / plant.drives[setup.joint].tau_max
    noise = np.random.default_rng(job.seed).standard_normal((len(play), len(size))) * (
        e.torque_noise * setup.excitation.rms * size
    )
    resolution = np.array([2 * pi / drive.encoder_counts for drive in plant.drives])
    rest = resolution * np.round(plant.rest / resolution)
    theta, tau = np.tile(rest, (len(play), 1)), np.tile(plant.preload, (len(play), 1))
    live = list(setup.live)
    theta[:, live], tau[:, live] = _play(plant, setup, play, noise, resolution[live], steps, 1 / e.fs, where)
    _check_motion(theta, plant, e.swing, e.samples_per_period, where)
    return Record(
        id=job.id,
        excited=job.chain.names[setup.joint],
        posture=setup.posture,
        f0=e.f0,
        lines=setup.excitation.lines,
        samples_per_period=e.samples_per_period,
        periods=e.periods,
        rms=setup.excitation.rms,
        tau=tau,
        theta=theta,
    )


def _play(
    plant: Plant, setup: Setup, play: Array, noise: Array, resolution: Array, steps: int, Ts: float, where: str
) -> tuple[Array, Array]:
    """Encoder readings [T, live, rad] and commanded torques [T, live, N m]; plain floats, a million times a campaign."""
    model, data = plant.model, plant.data()
    live, drives = list(setup.live), [plant.drives[k] for k in setup.live]
    command = controller(setup.servos, plant.rest[live].tolist(), plant.preload[live].tolist(), Ts)
    encoder = [(drive.N / unit, unit) for drive, unit in zip(drives, resolution.tolist(), strict=True)]
    limits, port = [drive.tau_max for drive in drives], setup.live.index(setup.joint)
    motor, ctrl = data.qpos[::2], data.ctrl
    theta, tau = [], []
    for k, (torque, disturbance) in enumerate(zip(play.tolist(), noise.tolist(), strict=True)):
        read = [unit * round(counts * x) for x, (counts, unit) in zip(motor.tolist(), encoder, strict=True)]
        u = command(read)
        u[port] += torque
        for value, limit, drive in zip(u, limits, drives, strict=True):
            if not -limit <= value <= limit:
                raise ExperimentError(
                    f"{where}: {k * Ts:.3f} s after the start the torque of motor {drive.joint!r} is {value:.3g} N m, "
                    f"beyond its limit of {limit:g} N m"
                )
        theta.append(read)
        tau.append(u)
        ctrl[:] = [a + b for a, b in zip(u, disturbance, strict=True)]
        mujoco.mj_step(model, data, steps)
    return np.array(theta), np.array(tau)


def _check_motion(theta: Array, plant: Plant, swing: float, period: int, where: str) -> None:
    """ExperimentError if a joint is not at its posture in the last period: it fell, or it swings far beyond the plan."""
    N = np.array([drive.N for drive in plant.drives])
    away = (theta[-period:] - plant.rest) / N
    mean, peak = np.abs(away.mean(axis=0)), np.abs(away).max(axis=0)
    j = int(np.argmax(peak))
    if peak[j] > STRAY * swing:
        raise ExperimentError(
            f"{where}: {plant.drives[j].joint!r} moves {peak[j]:.3g} rad from rest in the last period (mean {mean[j]:.3g}); expected at "
            f"most {STRAY:g} times the planned swing of {swing:g} rad: it fell, or the arm is not as declared"
        )


def _where(joint: str, q: Array) -> str:
    return f"joint {joint!r} at posture [{', '.join(f'{value:.4g}' for value in q)}]"
