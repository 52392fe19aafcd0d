"""Logs of simulated rigid arms: Fourier trajectories, torques by Newton-Euler and what acts besides, noise, encoder counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ident.logs.diagnose import LogDiagnosis
from ident.records.log import Log, Trajectory
from symgen.chain import Chain
from symgen.plan import chain_of_file, model_of_urdf

Array = NDArray[np.float64]

ROBOTS = Path(__file__).parents[2] / "robots"
GRAVITY = np.array([0.0, 0.0, -9.81])
N, J_M, FS, SECONDS, COUNTS = 50.0, 1e-4, 500.0, 20.0, 2**17
#: Noise of the torques, relative to how much each varies in the first trajectory.
NOISE = 0.01


@dataclass(frozen=True)
class Moved:
    """One joint in motion: q, v, a, and the torque `load` of its link, `tau` of link and rotor [T]; `typical` sizes of these in the first trajectory, in
    this order; how often it is sampled."""

    q: Array
    v: Array
    a: Array
    load: Array
    tau: Array
    typical: tuple[float, ...]
    fs: float


def log(
    acts: Callable[[Moved], Array] | None = None, joint: int = 1, *, robot: str = "ypp3_general", runs: int = 3, off: float = 0.0,
    noise: float = NOISE, seed: int = 0, fs: float = FS,
) -> Log:  # fmt: skip
    """A log of `runs` trajectories in which `acts` gives what has to be added to the torque of a `joint`; the masses of the links are `off` by that
    share (rms)."""
    chain = _chain(robot)
    n = chain.n
    typical: tuple[float, ...] = ()
    scatter = np.zeros(n)
    trajectories = []
    for k, (q, v, a, load, noises) in enumerate(_moved(robot, runs, off, seed, fs)):
        tau = load + N * N * J_M * a
        own = [x[:, joint] for x in (q, v, a, load, tau)]
        typical = typical or tuple(float(x.std()) for x in own)
        scatter = noise * tau.std(axis=0) if k == 0 else scatter
        if acts is not None:
            tau[:, joint] += acts(Moved(*own, typical, fs))
        tau += scatter * noises
        step = 2 * np.pi / COUNTS / N
        trajectories.append(Trajectory(f"{k + 1:04d}", step * np.round(q / step), tau))
    return Log(
        chain.source, chain.names, fs, np.full(n, N), np.full(n, J_M), GRAVITY, "a simulated arm", tuple(trajectories)
    )


@cache
def _chain(robot: str) -> Chain:
    return chain_of_file(ROBOTS / robot / f"{robot}.urdf")[0]


@cache
def _moved(robot: str, runs: int, off: float, seed: int, fs: float) -> list[tuple[Array, Array, Array, Array, Array]]:
    """Of each trajectory q, v, a, the torques of the links, and draws for the noise [T, n]."""
    rng, chain = np.random.default_rng(seed), _chain(robot)
    model, n = model_of_urdf(chain.source, chain.names), chain.n
    phi = (chain.parameters.reshape(n, 10) * (1.0 + off * rng.normal(size=(n, 1)))).ravel()
    moved = []
    for _ in range(runs):
        q, v, a = _fourier(n, rng, fs)
        moved.append((q, v, a, model.torque_rows(q, v, a, GRAVITY) @ phi, rng.normal(size=q.shape)))
    return moved


def _fourier(
    n: int, rng: np.random.Generator, fs: float, harmonics: int = 5, f0: float = 0.1, swing: float = 0.8
) -> tuple[Array, Array, Array]:
    t = np.arange(int(SECONDS * fs)) / fs
    q, v, a = (np.zeros((len(t), n)) for _ in range(3))
    for h in range(1, harmonics + 1):
        w = 2 * np.pi * f0 * h
        sine, cosine = swing / harmonics / np.sqrt(h) * rng.normal(size=(2, n))
        s, c = np.sin(w * t)[:, None], np.cos(w * t)[:, None]
        q += s * sine + c * cosine
        v += w * (c * sine - s * cosine)
        a -= w * w * (s * sine + c * cosine)
    return q + rng.uniform(-0.5, 0.5, n), v, a


def friction(m: Moved) -> np.ndarray:
    return 0.1 * m.typical[4] * np.tanh(m.v / 5e-4)


def found(d: LogDiagnosis) -> list[tuple[str, int | None]]:
    return [(step.term.name, step.term.joint) for step in d.found.steps]


#: What acts, at which joint, its name, parameters as `ident.effects` has them from (typical q, v, a, load, tau), and whether it is quick.
LAWS = [
    ("motor-coulomb", 1, friction, lambda s: [0.1 * s[4] / N]),
    ("motor-viscous", 2, lambda m: 0.1 * m.typical[4] * m.v / m.typical[1], lambda s: [0.1 * s[4] / s[1] / N**2]),
    ("motor-quadratic-drag", 1, lambda m: 0.1 * m.typical[4] * m.v * abs(m.v) / m.typical[1] ** 2,
     lambda s: [0.1 * s[4] / s[1] ** 2 / N**3]),
    ("torque-offset", 2, lambda m: np.full(len(m.q), 0.1 * m.typical[4]), lambda s: [-0.1 * s[4] / N]),
    ("torque-scale", 1, lambda m: 0.05 * m.tau, lambda s: [1 / 1.05 - 1]),
    ("motor-inertia", 0, lambda m: 0.3 * N**2 * J_M * m.a, lambda s: [0.3 * J_M]),
    ("cable-stiffness", 1, lambda m: 0.1 * m.typical[4] / m.typical[0] * (m.q - 0.3), lambda s: [0.1 * s[4] / s[0], 0.3]),
    ("load-dependent-friction", 1, lambda m: 0.05 * abs(m.load) * np.tanh(m.v / 5e-4), lambda s: [0.05]),
    ("torque-ripple", 0, lambda m: -0.1 * m.typical[4] * np.sin(2 * N * m.q + 1.0), lambda s: [0.1 * s[4] / N, 2.0, 1.0]),
    ("input-delay", 1, lambda m: 0.004 * np.gradient(m.tau) * m.fs, lambda s: [0.004]),
]  # fmt: skip
