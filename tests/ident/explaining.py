"""How much of a simulated record the fit side of an effect explains, with everything else known: an independent judge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.effects.base import Effect, Known
from ident.effects.motion import Motion
from ident.records.campaign import Record
from ident.simulator.plant import Linear

ALIASES = 16
FINER = 4  # samples of the forces per sample of the record: laws with kinks have lines beyond Nyquist


@dataclass(frozen=True)
class Judged:
    """Relative rms error of theta - mean over the excited lines' band, all live motors: without the effect, and with it."""

    without: float
    with_it: float


def judge(
    record: Record,
    linear: Linear,
    live: tuple[int, ...],
    N: np.ndarray,
    known: Known,
    load: np.ndarray,
    effects: list[Effect],
) -> Judged:
    """The last period of a noiseless record against the linear arm `linear` about its rest, held torque, and `effects`.

    `load` [n, N m] is what gravity asks of the springs at rest.
    """
    S, n, m = record.samples_per_period, len(N), len(live)
    tau, theta = record.tau[-S:], record.theta[-S:]
    top = int(record.lines.max())
    lines = np.arange(1, top + 1)
    T, Theta = (np.fft.rfft(x, axis=0)[lines][:, list(live)] / S for x in (tau, theta))
    both = np.array([*live, *(n + k for k in live)])

    def stiffness(s: np.ndarray, with_it: bool) -> np.ndarray:
        Z = s[:, None, None] ** 2 * linear.M + s[:, None, None] * linear.D + linear.K
        for effect in effects if with_it else ():
            if (more := effect.impedance(s, known)) is not None:
                Z = Z + more[:, both[:, None], both]
        return Z

    def gain(s: np.ndarray, kind: str, with_it: bool) -> np.ndarray:
        product = np.ones((len(s), m), dtype=complex)
        for effect in effects if with_it else ():
            if (factor := getattr(effect, kind)(s, known)) is not None:
                product = product * factor[:, list(live)]
        return product

    fs, s = record.f0 * S, 2j * np.pi * lines * record.f0
    motors = linear.N

    def held(with_it: bool) -> np.ndarray:
        """(theta / N, q) [L, 2 m] of the held torques."""
        total = np.zeros((top, 2 * m), dtype=complex)
        for alias in range(-ALIASES, ALIASES + 1):
            sk = s + 2j * np.pi * fs * alias
            push = np.zeros((top, 2 * m), dtype=complex)
            push[:, :m] = motors * gain(sk, "torque_gain", with_it) * T * ((1 - np.exp(-s / fs)) / sk * fs)[:, None]
            X = np.linalg.solve(stiffness(sk, with_it), push[..., None])[..., 0]
            X[:, :m] *= gain(sk, "angle_gain", with_it)
            total += X
        return total

    measured = Theta / motors
    plain = held(False)
    free, Z = held(True), stiffness(s, True)
    read, wound = theta.mean(axis=0), load / known.K
    mean = read
    reading = np.zeros_like(Theta)
    push = np.zeros((top, 2 * m), dtype=complex)
    free_push = np.zeros((top, 2 * m), dtype=complex)
    free_push[:, :m] = motors * gain(s, "torque_gain", True) * T * ((1 - np.exp(-s / fs)) / s * fs)[:, None]
    for _ in range(12):
        true = (Theta - reading) / motors / gain(s, "angle_gain", True)
        # both rows know of the links: together they are well posed at resonance and anti-resonance
        A, rhs = Z[:, :, m:], free_push + push - np.einsum("lij,lj->li", Z[:, :, :m], true)
        links = np.linalg.solve(A.conj().swapaxes(1, 2) @ A, A.conj().swapaxes(1, 2) @ rhs[..., None])[..., 0]
        motion = _motion(record, known, linear, list(live), true * motors, links, s, T, mean, wound)
        wound = load / known.K
        push = np.zeros((top, 2 * m), dtype=complex)
        reading, mean = np.zeros_like(Theta), read.copy()
        for effect in effects:
            loads = [(effect.port, effect.joint, F)] if (F := effect.force(motion)) is not None else []
            loads += effect.loads([motion.state(j) for j in range(n)])
            for port, joint, F in loads:
                if joint in live:
                    k, line = live.index(joint), np.fft.rfft(F)[lines] / len(F)
                    wound[joint] -= {"motor": 0.0, "spring": 1.0, "link": 1.0}[port] * F.mean() / known.K[joint]
                    push[:, k] += {"motor": motors[k], "spring": -1.0, "link": 0.0}[port] * line
                    push[:, m + k] += {"motor": 0.0, "spring": 1.0, "link": 1.0}[port] * line
            if (error := effect.reading(motion)) is not None:
                reading[:, live.index(effect.joint)] += np.fft.rfft(error)[lines] / len(error)
                mean[effect.joint] -= error.mean()
        response = np.linalg.solve(Z, push[..., None])[..., 0]
        response[:, :m] *= gain(s, "angle_gain", True)
        X = free + response
    size = np.linalg.norm(measured)
    predicted = X[:, :m] + reading / motors
    return Judged(
        float(np.linalg.norm(measured - plain[:, :m]) / size), float(np.linalg.norm(measured - predicted) / size)
    )


def _motion(record, known, linear, live, theta, q, s, T, mean, bend):
    n, S = len(known.N), record.samples_per_period * FINER
    columns = {}

    def signal(name, spectrum, means):
        full = np.zeros((S // 2 + 1, len(live)), dtype=complex)
        full[1 : len(s) + 1] = spectrum * S
        values = np.tile(np.asarray(means, dtype=float), (S, 1))
        values[:, live] += np.fft.irfft(full, S, axis=0)
        columns[name] = values

    N = known.N[live]
    x = theta / N - q
    sc = s[:, None]
    signal("theta", theta, mean)
    signal("omega", sc * theta, np.zeros(n))
    signal("tau", T, record.tau[-record.samples_per_period :].mean(axis=0))
    signal("q", q, mean / known.N - bend)
    signal("q_rate", sc * q, np.zeros(n))
    signal("deflection", x, bend)
    signal("deflection_rate", sc * x, np.zeros(n))
    signal("spring", (known.K[live] - sc * linear.D[: len(live), len(live) :].diagonal()) * x, known.K * bend)
    return Motion(1 / (record.f0 * S), known.N, known.K, lambda name, joint: columns[name][:, joint])
