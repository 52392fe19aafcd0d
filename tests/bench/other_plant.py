"""Another simulated arm than the project's own: Pinocchio's forward dynamics, springs in series, Runge-Kutta, plain PD.

It shares nothing with `ident.simulator.bench` but the campaign's format: another integrator, another controller without an observer, torque noise
on every motor, laws of effects as plain functions. What is found in its records is not what the project's plant is made like.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ident.records.campaign import Campaign, Record
from symgen.robot import Robot

#: Steps of the integration in a sample; band [Hz] of the hold, and of the filter of its velocity.
STEPS, HOLD, FILTER = 8, 5.0, 60.0
#: Largest swing of the excited link [rad], below which frequency lines are weaker [Hz]; torque noise, of the excitation's rms.
SWING, CORNER, NOISE = 0.01, 3.0, 0.005


@dataclass(frozen=True)
class At:
    """How the joint moves that a law is of, at one instant: motor side theta, omega, tau; the spring; the link's q, rate."""

    theta: float
    omega: float
    tau: float
    deflection: float
    q: float
    rate: float


@dataclass(frozen=True)
class Undeclared:
    """A torque by a `law` at a `port` of a joint (from 0): on the motor, added to the spring's, or on the link."""

    port: str
    joint: int
    law: Callable[[At], float]


def simulate(
    robot: Robot, cells: Sequence[tuple[str, np.ndarray]], effect: Undeclared | None, seed: int, *, f0: float = 0.5, periods: int = 5,
) -> Campaign:  # fmt: skip
    """A campaign of `cells` (joint, posture [n]) on the declared arm of a `robot` with an effect that nobody declared.

    Friction that stops a motor of J_m faster than 2.8 to a step (slope / J_m) would make it chatter.
    """
    urdf = robot.urdf.read_text(encoding="utf-8")
    model = pin.buildModelFromXML(urdf)
    model.gravity.linear = np.array(robot.gravity)
    names, fs = tuple(model.names[1:]), robot.experiment.fs
    rng = np.random.default_rng(seed)
    arm = _Arm(model, robot, effect, fs)
    records = []
    for k, (joint, q) in enumerate(cells, 1):
        lines = np.arange(1, int(robot.experiment.band[1] / f0) + 1)
        signal = arm.multisine(names.index(joint), q, lines, round(fs / f0), rng)
        tau, theta = arm.record(names.index(joint), q, signal, periods, rng)
        rms = float(np.std(signal))
        records.append(Record(f"{k:04d}", joint, np.array(q), f0, lines, len(signal), periods, rms, tau, theta))
    numbers = [[getattr(robot.drive(name), key) for name in names] for key in ("N", "J_m", "K")]
    N, J_m, K = np.array(numbers, dtype=float)
    return Campaign(urdf, names, fs, "zoh", N, J_m, K, np.array(robot.gravity), "another plant", tuple(records))


class _Arm:
    """The arm in motion: x = (theta, q, omega, q's rate) [4 n]."""

    def __init__(self, model: pin.Model, robot: Robot, effect: Undeclared | None, fs: float) -> None:
        drives = [robot.drive(name) for name in model.names[1:]]
        self.N, self.J_m, self.K, self.D, self.D_spring, counts = np.array(
            [(d.N, d.J_m, d.K, d.D, d.D_spring, d.encoder_counts) for d in drives], dtype=float
        ).T
        self.model, self.data, self.effect, self.fs = model, model.createData(), effect, fs
        self.n, self.step = model.nv, 2.0 * np.pi / counts

    def inertia(self, q: np.ndarray) -> np.ndarray:
        """What each motor turns [n], motor side, other joints held."""
        M = pin.crba(self.model, self.data, q)
        return self.J_m + np.diag(M) / self.N**2

    def multisine(
        self, joint: int, q: np.ndarray, lines: np.ndarray, samples: int, rng: np.random.Generator
    ) -> np.ndarray:
        """One period [S] of random phases, that swings the link by `SWING` at most."""
        X = np.zeros(samples // 2 + 1, dtype=complex)
        f = lines * self.fs / samples
        X[lines] = np.minimum(1.0, f / CORNER) * np.exp(2j * np.pi * rng.random(len(lines)))
        s, hold = 2j * np.pi * f, 2.0 * np.pi * HOLD
        answer = np.zeros_like(X)
        answer[lines] = X[lines] / (self.inertia(q)[joint] * (s + hold) ** 2)
        swing = np.abs(np.fft.irfft(answer, samples)).max() / self.N[joint]
        return np.asarray(np.fft.irfft(X, samples) * (SWING / swing))

    def record(
        self, joint: int, q: np.ndarray, signal: np.ndarray, periods: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Commanded torques and measured angles [T, n] from rest at a posture, all motors held by PD."""
        load = pin.rnea(self.model, self.data, q, np.zeros(self.n), np.zeros(self.n))
        rest = self.N * (q + load / self.K)
        x = np.concatenate([rest, q, np.zeros(2 * self.n)])
        J, hold = self.inertia(q), 2.0 * np.pi * HOLD
        noise, keep = NOISE * np.std(signal), np.exp(-2.0 * np.pi * FILTER / self.fs)
        samples = len(signal) * periods
        tau, theta = np.zeros((2, samples, self.n))
        last, speed = rest, np.zeros(self.n)
        for k in range(samples):
            theta[k] = np.round(x[: self.n] / self.step) * self.step
            speed = keep * speed + (1.0 - keep) * (theta[k] - last) * self.fs
            last = theta[k]
            tau[k] = load / self.N - J * hold * (hold * (theta[k] - rest) + 2.0 * speed)
            tau[k, joint] += signal[k % len(signal)]
            x = self._sampled(x, tau[k] + noise * rng.standard_normal(self.n))
        return tau, theta

    def _sampled(self, x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """The state a sample later, the torques held."""
        h = 1.0 / (self.fs * STEPS)
        for _ in range(STEPS):
            a = self._rate(x, tau)
            b = self._rate(x + h / 2.0 * a, tau)
            c = self._rate(x + h / 2.0 * b, tau)
            d = self._rate(x + h * c, tau)
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        return x

    def _rate(self, x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        theta, q, omega, rate = x.reshape(4, self.n)
        deflection = theta / self.N - q
        spring = self.K * deflection + self.D_spring * (omega / self.N - rate)
        motor, link = tau - self.D * omega, np.zeros(self.n)
        if self.effect is not None:
            j = self.effect.joint
            at = {"motor": motor, "spring": spring, "link": link}[self.effect.port]
            at[j] += self.effect.law(At(theta[j], omega[j], tau[j], deflection[j], q[j], rate[j]))
        acceleration = pin.aba(self.model, self.data, q, rate, spring + link)
        return np.concatenate([omega, rate, (motor - spring / self.N) / self.J_m, acceleration])
