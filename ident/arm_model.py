"""The whole arm about one posture as a linear system: all motors, all springs, J(q), sampled as its records are.

M x'' + D x' + K x = S tau with x = (theta / N, q), joint side: every link hangs on its own motor by a spring, gravity is
a stiffness, and J(q) couples the links. (1), (2) of the paper are one joint of it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from ident.campaign import Array
from ident.frf import Complex

#: Aliases on each side in the response to a held torque. Those left out fall with the fourth power of frequency.
ALIASES = 16
#: Aliases on each side whose derivatives are computed, and one more for every fs that the highest mode lies above, up to so many:
#: a mode far above is one of no arm, met on the way of a fit.
NEAR_ALIASES, MORE_ALIASES = 1, 2
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


@dataclass(frozen=True)
class Extra:
    """What acts on m live joints besides the elastic arm, at the lines [L] of a record; None: nothing.

    `impedance` [L, 2m, 2m] adds to the dynamic stiffness of (theta / N, q); `torque_gain`, `angle_gain` [L, m] multiply
    torques and measured angles, `folded` [L, m, s3] is the sum of (g(s_k) / g(s) - 1) / s_k^3 over the aliases s_k of a held
    torque, g the product of both gains; `on_motor`, `on_link` [L, m] are forces, joint side; `reading` [L, m, rad, motor side]
    adds to the measured angles.
    """

    impedance: Complex | None = None
    torque_gain: Complex | None = None
    angle_gain: Complex | None = None
    on_motor: Complex | None = None
    on_link: Complex | None = None
    reading: Complex | None = None
    folded: Complex | None = None

    def at(self, use: NDArray[np.bool_]) -> Extra:
        """The same at some of the lines [L]."""
        return Extra(*(None if x is None else x[use] for x in (getattr(self, f.name) for f in fields(self))))


NOTHING = Extra()


def motion(arm: Posture, p: Parameters, sampling: Sampling, tau: Complex, extra: Extra = NOTHING) -> Complex:
    """Returns the motor angles [L, m, c, rad] of torques `tau` [L, m, c, N m], motor side, at the lines of `sampling`.

    Exact for a held torque but for the aliases beyond `ALIASES` and the accuracy of their interpolation. Of `extra` only
    impedance and gains: forces belong to one column.
    """
    linear = replace(extra, on_motor=None, on_link=None, reading=None)
    return _motion(arm, p, sampling, tau, linear, False)[0]


def response(arm: Posture, p: Parameters, sampling: Sampling, extra: Extra = NOTHING) -> Complex:
    """Returns the motor angles by motor torques [L, m, m, rad per N m], as `motion` has them."""
    m, L = len(arm.live), len(sampling.f)
    return motion(arm, p, sampling, np.broadcast_to(np.eye(m, dtype=complex), (L, m, m)), extra)


def motion_and_derivatives(
    arm: Posture, p: Parameters, sampling: Sampling, tau: Complex, extra: Extra = NOTHING, derive: bool = True
) -> tuple[Complex, Complex]:
    """Returns the angles [L, m] for one column of torques [L, m] under `extra`, and their derivatives [L, m, P] by `arm.columns`.

    Those leave out what the far aliases add (1e-5 of a derivative and less).
    """
    theta, derivatives = _motion(arm, p, sampling, tau[..., None], extra, derive)
    return theta[..., 0], derivatives


def _motion(
    arm: Posture, p: Parameters, sampling: Sampling, tau: Complex, extra: Extra, derive: bool
) -> tuple[Complex, Complex]:
    """The continuous response at the line, plus all aliases; the derivatives [L, m, P] are those of column 0.

    A held torque is read as (1 - 1/z) / Ts sum_k H(s_k) / s_k over s_k = j (w + 2 pi k fs). What H is at high frequency,
    1 / (J_m s^2), is summed in closed form, the rest falls fast; at k != 0 it is smooth in w and interpolated.
    """
    s = 2j * np.pi * sampling.f
    if extra.torque_gain is not None:
        tau = tau * extra.torque_gain[..., None]
    if sampling.hold != "zoh":
        theta, derivatives = _continuous(arm, p, s, tau, derive, extra)
    else:
        theta, derivatives = _held(arm, p, sampling, tau, derive, extra)
    if extra.angle_gain is not None:
        theta, derivatives = theta * extra.angle_gain[..., None], derivatives * extra.angle_gain[..., None]
    if extra.reading is not None:
        theta = theta + extra.reading[..., None]
    return theta, derivatives


def _held(
    arm: Posture, p: Parameters, sampling: Sampling, tau: Complex, derive: bool, extra: Extra
) -> tuple[Complex, Complex]:
    """`_motion` of a torque held between samples."""
    s, Ts, m = 2j * np.pi * sampling.f, 1.0 / sampling.fs, len(arm.live)
    rise = -np.expm1(-s * Ts) / Ts  # (1 - 1/z) / Ts
    theta, derivatives = _continuous(arm, p, s, tau * (rise / s)[:, None, None], derive, extra)
    orders = np.delete(np.arange(-ALIASES, ALIASES + 1), ALIASES)
    shift = np.asarray(2j * np.pi * sampling.fs * orders, dtype=complex)
    left_over = np.sum(1.0 / (s[:, None] + shift) ** 3, axis=1) + 1.0 / s**3
    zm = np.expm1(s * Ts)
    rigid = (Ts**2 * (zm + 2.0) / (2.0 * zm**2) - rise * left_over)[:, None]
    if extra.folded is not None:
        rigid = rigid + rise[:, None] * extra.folded
    held = tau * (rigid / p.J_m[arm.live])[..., None]

    highest = _highest_mode(arm, p)
    nodes, interpolation = _nodes(sampling, highest)

    def aliases(shifts: Complex, with_derivatives: bool) -> tuple[Complex, Complex]:
        at = (2j * np.pi * nodes[:, None] + shifts).ravel()
        unit = np.asarray(np.eye(m) / at[:, None, None], dtype=complex)
        H, dH = _continuous(arm, p, at, unit, with_derivatives)
        dH = dH.reshape(len(nodes), len(shifts), m, -1, m).sum(axis=1) if with_derivatives else dH
        return H.reshape(len(nodes), -1, m * m).sum(axis=1), dH  # nodes, m m; nodes, m, P, m (input)

    scaled = tau * rise[:, None, None]
    H = aliases(shift, False)[0]
    H = H if interpolation is None else interpolation @ H
    theta = theta + held + H.reshape(-1, m, m) @ scaled
    if derive:
        near = np.abs(orders) <= NEAR_ALIASES + min(int(highest / sampling.fs), MORE_ALIASES)
        dH = aliases(shift[near], True)[1]
        if interpolation is None:
            derivatives = derivatives + (dH @ scaled[:, None, :, :])[..., 0]
        else:
            spread = interpolation[:, :, None] * scaled[:, None, :, 0]
            folded = spread.reshape(len(spread), -1) @ np.moveaxis(dH, 3, 1).reshape(len(nodes) * m, -1)
            derivatives = derivatives + folded.reshape(derivatives.shape)
        i = np.arange(m)
        derivatives[:, i, m + i] -= held[:, :, 0]
    return theta, derivatives


def stiffness(
    arm: Posture, p: Parameters, s: Complex, impedance: Complex | None
) -> tuple[Complex, Complex, Complex, Complex]:
    """Returns the blocks [S, m, m] of the dynamic stiffness: motors, motors by links, links by motors, links."""
    live, N, m = arm.live, arm.N, len(arm.live)
    K, J_m, D, D_spring = (values[live] for values in (p.K, p.J_m, p.D, p.D_spring))
    i, sc = np.arange(m), s[:, None]
    spring = K + sc * D_spring
    Z_ll = sc[..., None] ** 2 * arm.J(p) + arm.K_rows @ p.gravity
    Z_ll[:, i, i] += spring
    Z_mm, Z_ml = np.zeros_like(Z_ll), np.zeros_like(Z_ll)
    Z_mm[:, i, i] = sc**2 * N**2 * J_m + sc * N**2 * D + spring
    Z_ml[:, i, i] = -spring
    if impedance is None:
        return Z_mm, Z_ml, Z_ml, Z_ll
    return (
        Z_mm + impedance[:, :m, :m],
        Z_ml + impedance[:, :m, m:],
        Z_ml + impedance[:, m:, :m],
        Z_ll + impedance[:, m:, m:],
    )


def transfer(arm: Posture, p: Parameters, s: Complex, extra: Extra = NOTHING) -> tuple[Complex, Complex]:
    """Returns the measured angles [S, m, m, rad] per force on the motors and on the links, joint side, at s [S]."""
    Z_mm, Z_ml, Z_lm, Z_ll = stiffness(arm, p, s, extra.impedance)
    yielding = np.linalg.inv(Z_ll)
    core = arm.N[:, None] * np.linalg.inv(Z_mm - Z_ml @ yielding @ Z_lm)
    if extra.angle_gain is not None:
        core = core * extra.angle_gain[..., None]
    return core, -core @ Z_ml @ yielding


def by_impedance(arm: Posture, p: Parameters, s: Complex, extra: Extra, theta: Complex, changes: Complex) -> Complex:
    """Returns by how much `changes` [k, S, 2m, 2m] of the impedance change the angles `theta` [S, m] at s [S]: [S, m, k].

    Aliases, where the arm hardly moves, are left out.
    """
    _, _, Z_lm, Z_ll = stiffness(arm, p, s, extra.impedance)
    on_motor, on_link = transfer(arm, p, s, extra)
    x = theta if extra.reading is None else theta - extra.reading
    x = (x if extra.angle_gain is None else x / extra.angle_gain) / arm.N
    by_link = -(Z_lm @ x[..., None]) if extra.on_link is None else extra.on_link[..., None] - Z_lm @ x[..., None]
    both = np.concatenate([x[..., None], np.linalg.solve(Z_ll, by_link)], axis=1)
    forces = changes @ both  # k, S, 2m, 1
    m = len(arm.live)
    return np.moveaxis(-(on_motor @ forces[:, :, :m] + on_link @ forces[:, :, m:])[..., 0], 0, 2)


def _continuous(
    arm: Posture, p: Parameters, s: Complex, tau: Complex, derive: bool, extra: Extra = NOTHING
) -> tuple[Complex, Complex]:
    """Returns the motor angles [S, m, c] at s [S] of torques [S, m, c], and their derivatives: [S, m, P] for one column,
    else [S, m, P, c]."""
    live, N, m = arm.live, arm.N, len(arm.live)
    K, J_m, D, D_spring = (values[live] for values in (p.K, p.J_m, p.D, p.D_spring))
    Z_mm, Z_ml, Z_lm, Z_ll = stiffness(arm, p, s, extra.impedance)
    yielding = np.linalg.inv(Z_ll)
    if extra.impedance is None:  # springs alone are between motors and links: Z_ml is diagonal
        spring = np.diagonal(Z_ml, axis1=1, axis2=2)
        carried = -yielding * spring[:, None, :]  # q per theta / N
        felt = Z_mm + spring[:, :, None] * carried
    else:
        carried = -yielding @ Z_lm
        felt = Z_mm + Z_ml @ carried
    core = N[:, None] * np.linalg.inv(felt)  # angle of the motors per force on the motors, joint side
    on_motor = N[:, None] * tau
    if extra.on_motor is not None:
        on_motor = on_motor + extra.on_motor[..., None]
    theta = core @ on_motor
    if extra.on_link is None and not derive:
        return theta, np.zeros((len(s), m, 0), dtype=complex)
    across = -core @ Z_ml @ yielding  # angle of the motors per force on the links
    if extra.on_link is not None:
        theta = theta + across @ extra.on_link[..., None]
    if not derive:
        return theta, np.zeros((len(s), m, 0), dtype=complex)
    x = theta / N[:, None]
    q = carried @ x
    if extra.on_link is not None:
        q = q + yielding @ extra.on_link[..., None]
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


def _nodes(sampling: Sampling, highest: float) -> tuple[Array, Array | None]:
    """Returns frequencies [k, Hz] at which to compute the aliases and the interpolation [L, k] from there to the lines, None
    where those are the lines.

    Chebyshev points: the nearest pole, an alias of the highest mode, tells how fast they converge (Bernstein).
    """
    f = sampling.f
    low, high = float(f.min()), float(f.max())
    nearest = (2.0 * (sampling.fs - highest) - low - high) / max(high - low, 1e-300)
    count = len(f)
    if nearest > 1.0:
        ellipse = nearest + np.sqrt(nearest**2 - 1.0)
        count = int(np.ceil(-np.log(ALIAS_ACCURACY) / np.log(ellipse))) + 1
    if count >= min(len(f), MOST_NODES):
        return f, None
    angle = np.pi * (np.arange(count) + 0.5) / count
    x = (2.0 * f - low - high) / (high - low)
    orders = np.arange(count)
    basis = np.cos(orders * np.arccos(np.clip(x, -1.0, 1.0))[:, None])
    inverse = np.cos(orders[:, None] * angle) * np.where(orders, 2.0, 1.0)[:, None] / count
    return (low + high) / 2 + (high - low) / 2 * np.cos(angle), basis @ inverse
