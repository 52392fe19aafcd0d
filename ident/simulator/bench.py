"""The simulated robot: runs a campaign on a plant and hands out what a real robot would: torques and encoder readings."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from math import isfinite, pi
from multiprocessing.context import BaseContext
from typing import TypeVar

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ident.effects.base import Effect
from ident.errors import ExperimentError
from ident.records.campaign import Campaign, Record
from ident.simulator.design import EXCITATIONS, LOCKS, TORQUE_SHARE, Setup, place, played, prepare
from ident.simulator.dob import controller
from ident.simulator.injection import Injected, inject
from ident.simulator.machine import Machine, steps_for
from ident.simulator.phases import realised
from ident.simulator.plant import Linear, Plant, build_plant, linearise
from symgen.chain import Chain
from symgen.plan import text_of_arm
from symgen.robot import Drive, Robot

__all__ = [
    "EXCITATIONS",
    "LOCKS",
    "TORQUE_SHARE",
    "Job",
    "Setup",
    "check_steps",
    "design",
    "head",
    "in_parallel",
    "prepare",
    "run",
    "simulate",
]

Array = NDArray[np.float64]
_In = TypeVar("_In")
_Out = TypeVar("_Out")

#: Most steps of the integrator a sample: a thousand times slower than an arm of real drives.
MAX_STEPS = 1000

#: A joint that strays this many times the allowed swing from rest, in the last period, is no longer at its posture.
STRAY = 3.0


@dataclass(frozen=True, eq=False)
class Job:
    """Everything one record needs, to be sent to a worker process. `chain` and `drives` are those of the simulated arm."""

    id: str
    setup: Setup
    robot: Robot
    chain: Chain
    drives: tuple[Drive, ...]
    steps: int | None
    integrator: str
    seed: np.random.SeedSequence
    effects: tuple[Effect, ...] = ()


def simulate(
    chain: Chain,
    robot: Robot,
    cells: Sequence[tuple[str, ArrayLike]],
    *,
    lock: str = "dob",
    seed: int = 0,
    truth: Chain | None = None,
    truth_drives: Sequence[Drive] | None = None,
    effects: Sequence[Effect] = (),
    excitation: str = "odd",
    integrator: str = "RK4",
    steps: int | None = None,
    realisations: int = 1,
    workers: int = 2,
    progress: Callable[[int, int], None] | None = None,
) -> Campaign:
    """Returns the records of `cells`, (joint name, posture q [n, rad]) each, in that order.

    `lock` "dob" holds the other joints by their motors (PD and disturbance observer), "rigid" freezes them (the paper's
    simulation). `truth` and `truth_drives` [n] are the simulated arm where it differs from the declared `chain` and
    `robot`, `effects` what it has besides; the campaign tells the declared one only. `excitation`: "odd" (random phases, detection lines) or "schroeder"
    (all lines). `steps` of the integrator a sample: chosen by `Linear.rk4_steps`; RK4's linear part is exact at any step.
    `realisations` of each cell, one record each, next to each other: the same lines, as strong, in other phases.
    Every record draws from its own seed: the result does not depend on `workers` (processes; more than one needs the
    caller's script to be guarded by `if __name__ == "__main__"`). `progress(done, total)` is called after every record.

    ExperimentError naming joint and posture: outside the limits, gravity above the motor's torque, no stable lock, torque
    clipped, arm fallen to another equilibrium. All but the last two are found before anything is simulated.
    """
    jobs = design(
        chain, robot, cells, lock=lock, seed=seed, truth=truth, truth_drives=truth_drives, effects=effects, excitation=excitation,
        integrator=integrator, steps=steps, realisations=realisations,
    )  # fmt: skip
    check_steps(jobs)
    records: list[Record] = []
    for record in in_parallel(run, jobs, workers):
        records.append(record)
        if progress:
            progress(len(records), len(jobs))
    return head(chain, robot, tuple(records), lock=lock, excitation=excitation, integrator=integrator)


def design(
    chain: Chain,
    robot: Robot,
    cells: Sequence[tuple[str, ArrayLike]],
    *,
    lock: str = "dob",
    seed: int = 0,
    truth: Chain | None = None,
    truth_drives: Sequence[Drive] | None = None,
    effects: Sequence[Effect] = (),
    excitation: str = "odd",
    integrator: str = "RK4",
    steps: int | None = None,
    realisations: int = 1,
) -> tuple[Job, ...]:
    """Returns the job of every record of `cells`, ready to run; arguments and errors as in `simulate`."""
    drives = tuple(robot.drive(name) for name in chain.names)
    arm, true_drives = truth or chain, drives if truth_drives is None else tuple(truth_drives)
    if arm.names != chain.names:
        raise ExperimentError(f"truth has the joints {', '.join(arm.names)}; expected {', '.join(chain.names)}")
    jobs: list[Job] = []
    for (name, q), cell in zip(cells, np.random.SeedSequence(seed).spawn(len(cells)), strict=True):
        draws, noises = zip(*(cell.spawn(2) for _ in range(realisations)), strict=True)

        def prepared(rng: np.random.Generator, name: str = name, q: ArrayLike = q) -> Setup:
            return prepare(chain, robot, name, q, lock=lock, excitation=excitation, rng=rng)

        for setup, noise in zip(realised(chain, robot, prepared, draws), noises, strict=True):
            id = f"{len(jobs) + 1:04d}"
            jobs.append(Job(id, setup, robot, arm, true_drives, steps, integrator, noise, tuple(effects)))
    return tuple(jobs)


def check_steps(jobs: Sequence[Job]) -> None:
    """ExperimentError naming joint and posture of the first job whose arm the integrator can not follow."""
    for job in jobs:
        _arm(job)


def head(
    chain: Chain,
    robot: Robot,
    records: tuple[Record, ...],
    *,
    lock: str = "dob",
    excitation: str = "odd",
    integrator: str = "RK4",
) -> Campaign:
    """Returns the campaign of `records` as the engineer of the declared robot sees it; arguments as in `simulate`."""
    drives = [robot.drive(name) for name in chain.names]
    held = "held by PD and disturbance observer" if lock == "dob" else "rigid"
    return Campaign(
        urdf=text_of_arm(chain),
        joints=chain.names,
        fs=robot.experiment.fs,
        hold="zoh",
        N=np.array([drive.N for drive in drives]),
        J_m=np.array([drive.J_m for drive in drives]),
        K=np.array([drive.K for drive in drives]),
        D=np.array([drive.D for drive in drives]),
        D_spring=np.array([drive.D_spring for drive in drives]),
        gravity=robot.gravity,
        source=f"simulated: MuJoCo {mujoco.__version__}, {integrator}, other joints {held}, {excitation} multisine",
        records=records,
    )


def in_parallel(work: Callable[[_In], _Out], items: Sequence[_In], workers: int) -> Iterator[_Out]:
    """Yields work(item) for every item, in order, done by `workers` processes; in this one where one is enough.

    A worker ends with its parent, however that ends. ExperimentError if a worker dies.
    """
    workers = min(workers, len(items))
    if workers <= 1:
        yield from map(work, items)
        return
    pool = ProcessPoolExecutor(workers, _fresh(work.__module__), initializer=_follow_parent)
    try:
        yield from pool.map(work, items)
    except BrokenProcessPool:
        raise ExperimentError(
            "a worker process ended before its record was done; guard the calling script by "
            'if __name__ == "__main__", or use workers=1'
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _fresh(module: str) -> BaseContext:
    """How workers begin that know nothing of this process; where the system can, `module` is imported once for all of them."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([module])
    return context


def _follow_parent() -> None:
    """Ends this process when its parent is killed: a pool's workers would wait for ever. Ctrl-C is the parent's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def wait() -> None:
        if parent:
            parent.join()
            os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def run(job: Job) -> Record:
    """Simulates one record on the true arm and reads it as a robot's controller would."""
    setup, e = job.setup, job.robot.experiment
    where, Ts = place(job.chain.names[setup.joint], setup.posture), 1 / e.fs
    plant, linear, injected, steps = _arm(job)
    plant.model.opt.timestep = 1 / (e.fs * steps)
    lacking = _lacking(linear, Ts, steps) if job.integrator == "RK4" else None
    machine = Machine(injected, Ts, steps) if injected else None
    plant = injected.plant if injected else plant
    play = played(setup.excitation, e, setup.periods)
    size = np.array([plant.drives[k].tau_max for k in setup.live]) / plant.drives[setup.joint].tau_max
    noise = np.random.default_rng(job.seed).standard_normal((len(play), len(size))) * (
        e.torque_noise * setup.excitation.rms * size
    )
    resolution = np.array([2 * pi / drive.encoder_counts for drive in plant.drives])
    rest = resolution * np.round(plant.rest / resolution)
    theta, tau = np.tile(rest, (len(play), 1)), np.tile(plant.preload, (len(play), 1))
    live = list(setup.live)
    theta[:, live], tau[:, live], links = _play(
        plant, setup, play, noise, resolution[live], steps, Ts, lacking, machine, where
    )
    _check_motion(theta, plant, e.swing, e.samples_per_period, where)
    return Record(
        id=job.id,
        excited=job.chain.names[setup.joint],
        posture=setup.posture,
        f0=e.f0,
        lines=setup.excitation.lines,
        samples_per_period=e.samples_per_period,
        periods=setup.periods,
        rms=setup.excitation.rms,
        tau=tau,
        theta=theta,
        q_link=None if links is None else _read_links(links, plant, setup),
    )


def _read_links(links: Array, plant: Plant, setup: Setup) -> Array:
    """What encoders on the links read [T, n, rad] of those of the live joints [T, m]; the others stay at the posture."""
    q = np.tile(setup.posture, (len(links), 1))
    q[:, list(setup.live)] = links
    step = np.array([drive.link_step for drive in plant.drives], dtype=float)
    return np.asarray(step * np.round(q / step))


def _arm(job: Job) -> tuple[Plant, Linear, Injected | None, int]:
    """The true arm of the job, linearised, with its effects, and how many steps of the integrator a sample follow it."""
    setup, e = job.setup, job.robot.experiment
    where = place(job.chain.names[setup.joint], setup.posture)
    free = None if len(setup.live) == job.chain.n else setup.joint
    plant = build_plant(job.chain, job.drives, job.robot.gravity, setup.posture, free=free, integrator=job.integrator)
    linear, injected = linearise(plant), _injected(job, free, where)
    Ts, top = 1 / e.fs, setup.excitation.lines[-1] * e.f0
    steps = job.steps or (steps_for(injected, Ts, top) if injected else linear.rk4_steps(Ts, top))
    if steps > MAX_STEPS:
        raise ExperimentError(
            f"{where}: the fastest motion of these drives takes {steps} steps of the integrator a sample, at most "
            f"{MAX_STEPS}: check K_Nm_per_rad, D_spring_Nms_per_rad, D_Nms_per_rad and J_m_kgm2"
        )
    return plant, linear, injected, steps


def _injected(job: Job, free: int | None, where: str) -> Injected | None:
    """The arm of the job with its effects, where it has any."""
    if not job.effects:
        return None
    try:
        return inject(
            job.chain, job.drives, job.robot.gravity, job.setup.posture, job.effects,
            record=int(job.id) - 1, free=free, integrator=job.integrator,
        )  # fmt: skip
    except ExperimentError as error:
        raise ExperimentError(f"{where}: {error}") from None


def _lacking(linear: Linear, Ts: float, steps: int) -> Array:
    """`Linear.rk4_defect` [4m, 5m] in MuJoCo's coordinates: motor joint theta/N and spring joint q - theta/N by turns."""
    m = len(linear.N)
    both = np.kron(np.eye(2), np.vstack([np.kron(np.eye(m), [1.0, 0.0]), np.kron(np.eye(m), [1.0, 1.0])]))
    defect = linear.rk4_defect(Ts, steps)
    return np.ascontiguousarray(np.linalg.solve(both, np.hstack([defect[:, : 4 * m] @ both, defect[:, 4 * m :]])))


def _play(
    plant: Plant,
    setup: Setup,
    play: Array,
    noise: Array,
    resolution: Array,
    steps: int,
    Ts: float,
    lacking: Array | None,
    machine: Machine | None,
    where: str,
) -> tuple[Array, Array, Array | None]:
    """Encoder readings [T, live, rad], commanded torques [T, live, N m] and, where they are read, the links' angles [T, live, rad]; plain
    floats, a million times a campaign."""
    model, data, m = plant.model, plant.data(), len(setup.live)
    live, drives = list(setup.live), [plant.drives[k] for k in setup.live]
    command = controller(setup.servos, plant.rest[live].tolist(), plant.preload[live].tolist(), Ts)
    encoder = [(drive.N / unit, unit) for drive, unit in zip(drives, resolution.tolist(), strict=True)]
    links: list[list[float]] | None = [] if drives[0].link_step else None
    limits, port = [drive.tau_max for drive in drives], setup.live.index(setup.joint)
    qpos, qvel, ctrl, motor = data.qpos, data.qvel, data.ctrl, data.qpos[::2]
    at_rest, preload, away, missing = plant.qpos, plant.preload[live], np.zeros(5 * m), np.zeros(4 * m)
    x_away, v_away, u_away = away[: 2 * m], away[2 * m : 4 * m], away[4 * m :]
    x_missing, v_missing = missing[: 2 * m], missing[2 * m :]
    theta, tau = [], []
    for k, (torque, disturbance) in enumerate(zip(play.tolist(), noise.tolist(), strict=True)):
        state = machine.angles() if machine else motor.tolist()
        if not isfinite(sum(state)):
            raise ExperimentError(f"{where}: {k * Ts:.3f} s after the start the simulation has blown up")
        read = [unit * round(counts * x) for x, (counts, unit) in zip(state, encoder, strict=True)]
        u = command(read)
        u[port] += torque
        for value, limit, drive in zip(u, limits, drives, strict=True):
            if not -limit <= value <= limit:
                raise ExperimentError(
                    f"{where}: {k * Ts:.3f} s after the start the torque of motor {drive.joint!r} is {value:.3g} N m, "
                    f"beyond its limit of {limit:g} N m"
                )
        theta.append(read)
        if links is not None:
            links.append(machine.links() if machine else [a + b for a, b in zip(motor, qpos[1::2], strict=True)])
        tau.append(u)
        if machine:
            machine.advance(u, disturbance)
            continue
        ctrl[:] = [a + b for a, b in zip(u, disturbance, strict=True)]
        if lacking is None:
            mujoco.mj_step(model, data, steps)
            continue
        np.subtract(qpos, at_rest, out=x_away)
        v_away[:] = qvel
        np.subtract(ctrl, preload, out=u_away)
        np.matmul(lacking, away, out=missing)
        mujoco.mj_step(model, data, steps)
        qpos += x_missing
        qvel += v_missing
    angles = machine.recorded(np.array(theta), resolution) if machine else np.array(theta)
    return angles, np.array(tau), None if links is None else np.array(links)


def _check_motion(theta: Array, plant: Plant, swing: float, period: int, where: str) -> None:
    """ExperimentError if a joint is not at its posture in the last period: it fell, or it swings far beyond the plan."""
    N = np.array([drive.N for drive in plant.drives])
    away = (theta[-period:] - plant.rest) / N
    mean, peak = np.abs(away.mean(axis=0)), np.abs(away).max(axis=0)
    j = int(np.argmax(peak))
    if peak[j] > STRAY * swing:
        unit = "m" if plant.drives[j].linear else "rad"
        raise ExperimentError(
            f"{where}: {plant.drives[j].joint!r} moves {peak[j]:.3g} {unit} from rest in the last period (mean {mean[j]:.3g}); "
            f"expected at most {STRAY:g} times the planned swing of {swing:g} {unit}: it fell, or the arm is not as declared"
        )
