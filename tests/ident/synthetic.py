"""Records of linear elastic-joint arms with known truth: exactly sampled, periodic, with the transient in front."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from ident.records.campaign import Campaign, Record
from ident.records.frf import Detection, Frf

FS = 1000.0
ENCODER = 2 * np.pi / 131072  # 17 bit


@dataclass(frozen=True)
class Arm:
    """Linear arm about a posture: link inertia `J` and gravity stiffness `K_g` [n, n] joint side, the rest [n]."""

    J: np.ndarray
    K: np.ndarray
    J_m: np.ndarray
    D: np.ndarray
    D_spring: np.ndarray
    K_g: np.ndarray
    N: np.ndarray

    @staticmethod
    def joint(J_m, K, J_l, D, D_spring, K_g, N=100.0):
        """One flexible joint, in the order of the six parameters of ident.joint.fit."""
        vectors = (np.array([float(value)]) for value in (K, J_m, D, D_spring))
        return Arm(np.array([[float(J_l)]]), *vectors, K_g=np.array([[float(K_g)]]), N=np.array([float(N)]))

    def continuous(self):
        """A [4n, 4n], B [4n, n] of x = (theta / N, q, their rates), input motor torque."""
        n, inv = len(self.K), np.linalg.inv
        B_m, K, d, O, E = (
            np.diag(self.N**2 * self.J_m),
            np.diag(self.K),
            np.diag(self.D_spring),
            np.zeros((len(self.K),) * 2),
            np.eye(len(self.K)),
        )
        A = np.block([
            [O, O, E, O], [O, O, O, E],
            [-inv(B_m) @ K, inv(B_m) @ K, -inv(B_m) @ (d + np.diag(self.N**2 * self.D)), inv(B_m) @ d],
            [inv(self.J) @ K, -inv(self.J) @ (K + self.K_g), inv(self.J) @ d, -inv(self.J) @ d],
        ])  # fmt: skip
        return A, np.vstack([O, O, inv(B_m) @ np.diag(self.N), np.zeros((n, n))])

    def sampled(self):
        """The exact zero-order-hold equivalent of `continuous` at FS."""
        A, B = self.continuous()
        size, n = len(A), len(self.K)
        M = expm(np.block([[A, B], [np.zeros((n, size + n))]]) / FS)
        return M[:size, :size], M[:size, size:]

    def response(self, f, hold="zoh"):
        """theta_j / tau_k [L, n, n], motor side, open loop."""
        n = len(self.K)
        A, B = self.sampled() if hold == "zoh" else self.continuous()
        p = np.exp(2j * np.pi * f / FS) if hold == "zoh" else 2j * np.pi * f
        X = np.linalg.solve(
            p[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (len(f), *B.shape)).astype(complex)
        )
        return self.N[:, None] * X[:, :n]


# The paper's arm at POS1: coupled joints 2 and 3, stiffness 5500 / 4500 / 4500.
YPP = Arm(
    J=np.array([[0.6987, 0, 0], [0, 0.6929, 0.13945], [0, 0.13945, 0.0466]]),
    K=np.array([5500.0, 4500, 4500]), J_m=np.array([4e-5, 4e-5, 1e-5]), D=np.array([3e-5, 3e-5, 1e-5]),
    D_spring=np.array([1.2, 1.1, 0.3]), K_g=np.array([[0.0, 0, 0], [0, -8.0, -2.0], [0, -2.0, -2.0]]),
    N=np.full(3, 100.0),
)  # fmt: skip


def multisine(lines, S, rms, rng, f0=0.1):
    """One period [S] of random phases, flat above 3 Hz and falling as f below, with the given rms."""
    X = np.zeros(S // 2 + 1, complex)
    X[lines] = np.minimum(lines * f0 / 3.0, 1.0) * np.exp(2j * np.pi * rng.random(len(lines)))
    x = np.fft.irfft(X, S)
    return x * rms / np.sqrt(np.mean(x**2))


def record(arm, excited, *, lines=None, periods=6, f0=0.1, rms=0.1, noise=0.005, step=ENCODER, gains=None, rng=None,
           id="r0", posture=None, level=None, extra=None):  # fmt: skip
    """A record of `arm` with feedback tau = r - kp theta - kd theta' (gains [n, 2], motor side, on the fine angle).

    `noise` is white unrecorded torque on every motor relative to `rms`; `step` the encoder step (0: none); `level` [n]
    a static torque; `extra` [T] a further unrecorded torque on the excited motor.
    """
    rng = rng or np.random.default_rng(0)
    n, S = len(arm.K), round(FS / f0)
    lines = np.arange(1, round(120 / f0) + 1, 2) if lines is None else np.asarray(lines)
    gains = np.zeros((n, 2)) if gains is None else np.asarray(gains, float)
    r = np.zeros((periods * S, n))
    r[:, excited] = np.tile(multisine(lines, S, rms, rng, f0), periods)
    v = noise * rms * rng.normal(size=r.shape)
    if extra is not None:
        v[:, excited] += extra
    Ad, Bd = arm.sampled()
    size = len(Ad)
    C = np.hstack([np.diag(arm.N), np.zeros((n, size - n))])
    F = np.hstack(
        [(gains[:, :1] + gains[:, 1:] * FS) * C, -np.diag(gains[:, 1] * FS)]
    )  # on (x, theta of the sample before)
    Ac = np.block([[Ad, np.zeros((size, n))], [C, np.zeros((n, n))]]) - np.vstack([Bd, np.zeros((n, n))]) @ F
    w, V = np.linalg.eig(Ac)
    assert np.abs(w).max() < 1 + 1e-9, "test arm is unstable"
    drive = np.linalg.solve(V, np.vstack([Bd, np.zeros((n, n))]) @ (r + v).T)
    modes = np.array([lfilter([0, 1], [1, -p], u) for p, u in zip(w, drive, strict=True)])
    x = (V @ modes).real.T
    tau = r - x @ F.T
    posture = np.zeros(n) if posture is None else np.asarray(posture, float)
    level = np.zeros(n) if level is None else np.asarray(level, float)
    theta = x[:, :size] @ C.T + arm.N * posture + arm.N**2 * level / arm.K
    if step:
        theta = np.round(theta / step) * step
    return Record(id, f"joint{excited + 1}", posture, f0, lines, S, periods, rms, tau + level, theta)


def campaign(arm, records=(), hold="zoh"):
    n = len(arm.K)
    names = tuple(f"joint{k + 1}" for k in range(n))
    return Campaign("<robot/>", names, FS, hold, arm.N, np.full(n, np.nan), arm.K, np.zeros(3), "made", tuple(records))


def measured(f, G, variance):
    """A measured response: G [L] at f [L] with known variance [L], as `ident.records.frf.estimate` would hand it out."""
    L, zero = len(f), np.zeros(1)
    nothing = Detection(np.zeros(0, int), np.zeros(0), np.zeros(0, bool), np.zeros((0, 1)), np.zeros((0, 1)))
    return Frf("r0", "joint1", 0, zero, f, np.ones((L, 1), complex), G[:, None], np.zeros((7, L, 2), complex), variance,
               1e6, 1, 0, 5, zero, zero, nothing, zero, zero, ())  # fmt: skip


def plants(count, rng):
    """Random joints [count, 6]: f_AR 5 .. 100 Hz, f_R < 115 Hz, J_l / (N^2 J_m) 0.03 .. 20, damping 0.2 .. 3 %."""
    found = []
    while len(found) < count:
        K, f_AR, r, zeta = np.exp(rng.uniform(np.log([500, 5, 0.03, 0.002]), np.log([5e4, 100, 20, 0.03])))
        if f_AR * np.sqrt(1 + r) < 115:
            J_l = K / (2 * np.pi * f_AR) ** 2
            J_m = J_l / r / 100.0**2
            K_g = rng.uniform(-0.02, 0.1) * K * min(1, rng.uniform(0, 40) / f_AR**2)
            found.append([J_m, K, J_l, J_m * rng.uniform(0.05, 5), 2 * zeta * np.sqrt(K * J_l), K_g])
    return np.array(found)
