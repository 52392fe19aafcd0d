"""The whole arm about one posture as a linear system: all motors, all springs, J(q), sampled as its records are.

M x'' + D x' + K x = S tau with x = (theta / N, q), joint side: every link hangs on its own motor by a spring, gravity is
a stiffness, and J(q) couples the links. (1), (2) of the paper are one joint of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ident.campaign import Array
from ident.frf import Complex

#: Aliases on each side in the response to a held torque. Those left out fall with the fourth power of frequency.
ALIASES = 16
#: Interpolation of the aliases is finer than this share of them; nodes beyond `MOST_NODES`: every line is computed.
ALIAS_ACCURACY, MOST_NODES = 1e-10, 24


@dataclass(frozen=True)
class Parameters:
    """An arm: K [N m/rad, joint side], J_m [kg m2], D [N m s/rad] motor side, D_spring [N m s/rad, joint side], each [n];
    alpha [D] constants of J(q), gravity [r] those of the gravity stiffness."""

    K: Array
    J_m: Array
    D: Array
    D_spring: Array
    alpha: Array
    gravity: Array

    def vector(self) -> Array:
        """The parameters [4 n + D + r] as they are fitted: logarithms of the drives', then alpha, gravity."""
        drives = np.concatenate([self.K, self.J_m, self.D, self.D_spring])
        return np.concatenate([np.log(drives), self.alpha, self.gravity])

    @staticmethod
    def of(vector: Array, n: int, D: int) -> Parameters:
        """The inverse of `vector` for n joints and D constants alpha."""
        K, J_m, D_motor, D_spring = np.exp(vector[: 4 * n]).reshape(4, n)
        return Parameters(K, J_m, D_motor, D_spring, vector[4 * n : 4 * n + D], vector[4 * n + D :])


@dataclass(frozen=True)
class Posture:
    """What an arm is at one posture, `live` joints [m] only: the others are clamped, motor and link.

    J = J_rows [m, m, D] . alpha; gravity stiffness = K_rows [m, m, r] . gravity; N [m].
    """

    live: NDArray[np.int64]
    N: Array
    J_rows: Array
    K_rows: Array

    def columns(self, n: int) -> NDArray[np.int64]:
        """The indices in `Parameters.vector` of an n-joint arm that act here, in the order of the derivatives."""
        drives = [k * n + self.live for k in range(4)]
        return np.concatenate([*drives, np.arange(4 * n, 4 * n + self.J_rows.shape[2] + self.K_rows.shape[2])])

    def J(self, p: Parameters) -> Array:
        """The inertia matrix [m, m]."""
        J: Array = self.J_rows @ p.alpha
        return J


@dataclass(frozen=True)
class Sampling:
    """When a response is read: lines `f` [L, Hz]; angles at `fs` [Hz] with torque held between ("zoh") or not."""

    f: Array
    fs: float
    hold: str


def motion(arm: Posture, p: Parameters, sampling: Sampling, tau: Complex) -> Complex:
    """Returns the motor angles [L, m, c, rad] of torques `tau` [L, m, c, N m], motor side, at the lines of `sampling`.

    Exact for a held torque but for the aliases beyond `ALIASES` and the accuracy of their interpolation.
    """
    return _motion(arm, p, sampling, tau, False)[0]


def motion_and_derivatives(arm: Posture, p: Parameters, sampling: Sampling, tau: Complex) -> tuple[Complex, Complex]:
    """Returns `motion` for one column of torques [L, m] and its derivatives [L, m, P] by `arm.columns`."""
    theta, derivatives = _motion(arm, p, sampling, tau[..., None], True)
    return theta[..., 0], derivatives


def _motion(arm: Posture, p: Parameters, sampling: Sampling, tau: Complex, derive: bool) -> tuple[Complex, Complex]:
    """The continuous response at the line, plus all aliases; the derivatives [L, m, P] are those of column 0.

    A held torque is read as (1 - 1/z) / Ts sum_k H(s_k) / s_k over s_k = j (w + 2 pi k fs). What H is at high frequency,
    1 / (J_m s^2), is summed in closed form, the rest falls fast; at k != 0 it is smooth in w and interpolated.
    """
    s = 2j * np.pi * sampling.f
    if sampling.hold != "zoh":
        return _continuous(arm, p, s, tau, derive)
    Ts = 1.0 / sampling.fs
    rise = -np.expm1(-s * Ts) / Ts  # (1 - 1/z) / Ts
    theta, derivatives = _continuous(arm, p, s, tau * (rise / s)[:, None, None], derive)
    shift = 2j * np.pi * sampling.fs * np.delete(np.arange(-ALIASES, ALIASES + 1), ALIASES)
    left_over = np.sum(1.0 / (s[:, None] + shift) ** 3, axis=1) + 1.0 / s**3
    zm = np.expm1(s * Ts)
    rigid = Ts**2 * (zm + 2.0) / (2.0 * zm**2) - rise * left_over
    held = tau * rigid[:, None, None] / p.J_m[arm.live][:, None]

    nodes, interpolation = _nodes(sampling, _highest_mode(arm, p))
    m = len(arm.live)
    at = (2j * np.pi * nodes[:, None] + shift).ravel()
    unit = np.asarray(np.eye(m) / at[:, None, None], dtype=complex)
    H, dH = _continuous(arm, p, at, unit, derive)
    scaled = tau * rise[:, None, None]
    H = interpolation @ H.reshape(len(nodes), -1, m * m).sum(axis=1)
    theta = theta + held + H.reshape(-1, m, m) @ scaled
    if derive:
        dH = dH.reshape(len(nodes), len(shift), m, -1, m).sum(axis=1)  # nodes, m, P, m (input)
        spread = interpolation[:, :, None] * scaled[:, None, :, 0]
        folded = spread.reshape(len(spread), -1) @ np.moveaxis(dH, 3, 1).reshape(len(nodes) * m, -1)
        derivatives = derivatives + folded.reshape(derivatives.shape)
        i = np.arange(m)
        derivatives[:, i, m + i] -= held[:, :, 0]
    return theta, derivatives


def _continuous(arm: Posture, p: Parameters, s: Complex, tau: Complex, derive: bool) -> tuple[Complex, Complex]:
    """Returns the motor angles [S, m, c] at s [S] of torques [S, m, c], and their derivatives: [S, m, P] for one column,
    else [S, m, P, c]."""
    live, N, m = arm.live, arm.N, len(arm.live)
    K, J_m, D, D_spring = (values[live] for values in (p.K, p.J_m, p.D, p.D_spring))
    i = np.arange(m)
    sc = s[:, None]
    spring = K + sc * D_spring
    link = sc[..., None] ** 2 * arm.J(p) + arm.K_rows @ p.gravity
    link[:, i, i] += spring
    yielding = np.linalg.inv(link)
    core = -spring[:, :, None] * yielding * spring[:, None, :]
    core[:, i, i] += sc**2 * N**2 * J_m + sc * N**2 * D + spring
    core = N[:, None] * np.linalg.inv(core)  # angle of the motors per force on the motors, joint side
    carried = yielding * spring[:, None, :]  # q per theta / N
    x = (core / N[:, None]) @ (N[:, None] * tau)
    theta: Complex = N[:, None] * x
    if not derive:
        return theta, np.zeros((len(s), m, 0), dtype=complex)
    q = carried @ x
    across = core @ np.swapaxes(carried, 1, 2)  # angle of the motors per force on the links
    J_rows, K_rows = (np.moveaxis(rows, 1, 0).reshape(m, -1) for rows in (arm.J_rows, arm.K_rows))
    forces = np.concatenate(
        [
            (np.swapaxes(q, 1, 2) @ rows).reshape(len(s), q.shape[2], m, -1) * factor[:, None, None, None]
            for rows, factor in ((J_rows, s**2), (K_rows, np.ones_like(s)))
        ],
        axis=3,
    )  # S, c, m, D + r
    by_link = across[:, None] @ forces  # S, c, m, D + r
    stretch, x_ = np.swapaxes(x - q, 1, 2)[:, :, None, :], np.swapaxes(x, 1, 2)[:, :, None, :]
    between = (core - across)[:, None]
    motor, sc4 = core[:, None], s[:, None, None, None]
    by_drive = [
        between * stretch * K, motor * x_ * (sc4**2 * N**2 * J_m),
        motor * x_ * (sc4 * N**2 * D), between * stretch * (sc4 * D_spring),
    ]  # fmt: skip
    derivatives = -np.concatenate([*by_drive, by_link], axis=3)
    return theta, derivatives[:, 0] if tau.shape[2] == 1 else np.moveaxis(derivatives, 1, 3)


def _highest_mode(arm: Posture, p: Parameters) -> float:
    """Returns the highest undamped frequency [Hz] of the arm."""
    K = p.K[arm.live]
    motors = K / (arm.N**2 * p.J_m[arm.live])
    links = np.linalg.solve(arm.J(p), np.hstack([-np.diag(K), np.diag(K) + arm.K_rows @ p.gravity]))
    squares = np.linalg.eigvals(np.vstack([np.hstack([np.diag(motors), -np.diag(motors)]), links]))
    return float(np.sqrt(np.abs(squares).max()) / (2 * np.pi))


def _nodes(sampling: Sampling, highest: float) -> tuple[Array, Array]:
    """Returns frequencies [k, Hz] at which to compute the aliases and the interpolation [L, k] from there to the lines.

    Chebyshev points: the nearest pole, an alias of the highest mode, tells how fast they converge (Bernstein).
    """
    f = sampling.f
    low, high = float(f[0]), float(f[-1])
    nearest = (2.0 * (sampling.fs - highest) - low - high) / max(high - low, 1e-300)
    count = len(f)
    if nearest > 1.0:
        ellipse = nearest + np.sqrt(nearest**2 - 1.0)
        count = int(np.ceil(-np.log(ALIAS_ACCURACY) / np.log(ellipse))) + 1
    if count >= min(len(f), MOST_NODES):
        return f, np.eye(len(f))
    angle = np.pi * (np.arange(count) + 0.5) / count
    x = (2.0 * f - low - high) / (high - low)
    orders = np.arange(count)
    basis = np.cos(orders * np.arccos(np.clip(x, -1.0, 1.0))[:, None])
    inverse = np.cos(orders[:, None] * angle) * np.where(orders, 2.0, 1.0)[:, None] / count
    return (low + high) / 2 + (high - low) / 2 * np.cos(angle), basis @ inverse
