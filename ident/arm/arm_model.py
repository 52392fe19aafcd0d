"""The whole arm about one posture as a linear system: all motors, all springs, J(q), sampled as its records are.

M x'' + D x' + K x = S tau with x = (theta / N, q), joint side: every link hangs on its own motor by a spring, gravity is
a stiffness, and J(q) couples the links. (1), (2) of the paper are one joint of it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import zeta

from ident.arm.small_matrices import by_component, inverses, products, times
from ident.records.campaign import Array
from ident.records.frf import Complex

#: Aliases of a held torque are summed by powers of 1/s to this share, where they lie so far above the arm's poles that so many
#: powers do, their derivatives to this; aliases less than so many times as high as the fastest pole, up to so many a side, are
#: computed one by one, the derivatives of so many: a pole farther above is one of no arm, met on the way of a fit.
ALIAS_ACCURACY, SLOPE_ACCURACY, CONVERGES, MOST_NEAR, NEAR_SLOPES = 1e-9, 1e-5, 2.5, 16, 3

#: The numbers of a drive, in the order of `Parameters`.
DRIVES = ("K", "J_m", "D", "D_spring")


@dataclass(frozen=True, eq=False)
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


@lru_cache(maxsize=16)  # chi^2 of a step is asked, and then its derivatives
def parameters_at(vector: bytes, n: int, D: int) -> Parameters:
    """`Parameters.of` the numbers of `vector`, read-only, and the same ones when they are asked again."""
    found = Parameters.of(np.frombuffer(vector), n, D)
    for drive in DRIVES:
        getattr(found, drive).setflags(write=False)
    return found


@dataclass(frozen=True, eq=False)
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
    """When a response is read: lines `f` [L, Hz]; angles at `fs` [Hz] with torque held between ("zoh") or not; up to `near` aliases
    a side computed one by one."""

    f: Array
    fs: float
    hold: str
    near: int = MOST_NEAR


def hold_gain(s: Complex, fs: float) -> Complex:
    """What a torque held between samples is at its own line s [L]: smaller, and half a sample late."""
    return np.asarray(-np.expm1(-s / fs) * fs / s)


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

    Exact for a held torque, but that impedances do nothing to its aliases. Of `extra` only impedance and gains: forces belong to
    one column.
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
    """Returns the angles [L, m] for one column of torques [L, m] under `extra`, and their derivatives [L, m, P] by `arm.columns`."""
    theta, derivatives = _motion(arm, p, sampling, tau[..., None], extra, derive)
    return theta[..., 0], derivatives


def _motion(
    arm: Posture, p: Parameters, sampling: Sampling, tau: Complex, extra: Extra, derive: bool
) -> tuple[Complex, Complex]:
    """Angles and, if they are asked, their derivatives [L, m, P], those of column 0."""
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
    """`_motion` of a torque held between samples: (1 - 1/z) / Ts sum_k H(s_k) / s_k over the aliases s_k = j (w + 2 pi k fs)."""
    s, m = 2j * np.pi * sampling.f, len(arm.live)
    held = tau * hold_gain(s, sampling.fs)[:, None, None]
    risen = held * s[:, None, None]
    theta, derivatives = _continuous(arm, p, s, held, derive, extra)
    told = _by_powers(arm, p, sampling.fs, float(sampling.f.max()), sampling.near)
    near, powers = told.near, told.powers
    sums = _sums(sampling.f.tobytes(), sampling.fs, near, len(powers))
    H = (sums @ powers.reshape(len(powers), -1)).reshape(-1, m, m)
    if derive:
        slopes = _slopes_by_powers(arm, p, told)
        spread = (sums[:, : len(slopes) // m, None] * risen[:, None, :, 0]).reshape(len(s), -1)
        derivatives = derivatives + (spread.real @ slopes + 1j * (spread.imag @ slopes)).reshape(derivatives.shape)
    if extra.folded is not None:
        i, folded = np.arange(m), extra.folded / p.J_m[arm.live]
        H[:, i, i] += folded
        if derive:
            derivatives[:, i, m + i] -= folded * risen[..., 0]
    for order in (k for k in range(-near, near + 1) if k):
        at = s + 2j * np.pi * sampling.fs * order
        sloped = derive and abs(order) <= NEAR_SLOPES
        one, more = _continuous(arm, p, at, np.asarray(np.eye(m) / at[:, None, None], dtype=complex), sloped)
        H = H + one
        if sloped:
            derivatives = derivatives + (more.reshape(len(s), m, -1, m) @ risen[:, None]).reshape(derivatives.shape)
    return theta + products(H, risen), derivatives


@lru_cache(maxsize=512)
def _sums(f: bytes, fs: float, near: int, count: int) -> Complex:
    """Sums of s_k^-3, s_k^-4, .. [L, count] over the aliases s_k of frequencies `f` [L, Hz] beyond the `near` ones on each side."""
    x, n = np.frombuffer(f)[:, None] / fs, np.arange(3, 3 + count)
    both = zeta(n, near + 1.0 + x) + (-1.0) ** n * zeta(n, near + 1.0 - x)
    return np.asarray(both / (2j * np.pi * fs) ** n)


@dataclass(frozen=True, eq=False)
class _Powers:
    """An arm's response to torques by powers of 1/s: `b` [2 + k, 2m, m] of (theta / N, q), from s^0 on, `sloped` of which from s^-2 on
    suffice for derivatives; `near` aliases on each side are too near to the poles for that. Accelerations by forces, `mobility`
    [2m, 2m], and by places and rates, `back` [2m, 4m]: of one power by the two before."""

    near: int
    b: Array
    powers: Array
    sloped: int
    mobility: Array
    back: Array


@lru_cache(maxsize=64)  # of all records; where an effect alone is changed, the arm stays as it is
def _by_powers(arm: Posture, p: Parameters, fs: float, top: float, most: int) -> _Powers:
    """Of the arm sampled at `fs` [Hz], at lines up to `top` [Hz]; at most `most` aliases on each side are near. `powers` [k, m, m] are
    its measured angles from s^-2 on.

    M x'' + D x' + K x = N tau with x = sum_j b_j s^-j: M b_j + D b_(j-1) + K b_(j-2) is N for j = 2, else nothing.
    """
    live, N, m = arm.live, arm.N, len(arm.live)
    K, J_m, D, D_spring = (values[live] for values in (p.K, p.J_m, p.D, p.D_spring))
    dK, dD = np.diag(K), np.diag(D_spring)
    mobility = np.zeros((2 * m, 2 * m))
    mobility[:m, :m], mobility[m:, m:] = np.diag(1.0 / (N**2 * J_m)), np.linalg.inv(arm.J(p))
    by_place = mobility @ _of_blocks(dK, -dK, -dK, dK + arm.K_rows @ p.gravity)
    by_rate = mobility @ _of_blocks(dD + np.diag(N**2 * D), -dD, -dD, dD)
    eye = np.eye(2 * m)
    generator = _of_blocks(0.0 * eye, eye, -by_place, -by_rate)
    beyond_numbers = not np.isfinite(generator).all()  # then so is the response
    poles = np.inf if beyond_numbers else np.abs(np.linalg.eigvals(generator)).max() / (2.0 * np.pi)

    near = int(np.clip(np.ceil((CONVERGES * poles + top) / fs) - 1, 0, most))
    ratio = poles / ((near + 1) * fs - top)
    count, sloped = (1 if CONVERGES * ratio > 1.0 else 1 + int(np.ceil(np.log(accuracy) / np.log(ratio)))
                     for accuracy in (ALIAS_ACCURACY, SLOPE_ACCURACY))  # fmt: skip
    b, back = np.zeros((2 + count, 2 * m, m)), generator[2 * m :]
    b[2] = mobility[:, :m] * N
    for j in range(3, 2 + count):
        np.matmul(back, b[j - 2 : j].reshape(4 * m, m), out=b[j])
    return _Powers(near, b, N[:, None] * b[2:, :m], sloped, mobility, back)


def _slopes_by_powers(arm: Posture, p: Parameters, told: _Powers) -> Array:
    """The derivatives [k m, m P] of the `powers`: rows are powers and torques."""
    live, N, m, sloped = arm.live, arm.N, len(arm.live), told.sloped
    K, J_m, D, D_spring = (values[live] for values in (p.K, p.J_m, p.D, p.D_spring))
    b = told.b[: 2 + sloped]
    x, rate, place, i = b[2:], b[1:-1], b[:-2], np.arange(m)
    alphas = 4 * m + arm.J_rows.shape[2]
    forces = np.zeros((2 + sloped, 2 * m, alphas + arm.K_rows.shape[2], m))  # M' b_j + D' b_(j-1) + K' b_(j-2)
    stretch, stretching = K[:, None] * (place[:, :m] - place[:, m:]), D_spring[:, None] * (rate[:, :m] - rate[:, m:])
    forces[2:, i, i], forces[2:, m + i, i] = stretch, -stretch
    forces[2:, i, m + i] = (N**2 * J_m)[:, None] * x[:, :m]
    forces[2:, i, 2 * m + i] = (N**2 * D)[:, None] * rate[:, :m]
    forces[2:, i, 3 * m + i], forces[2:, m + i, 3 * m + i] = stretching, -stretching
    forces[2:, m:, 4 * m : alphas] = np.einsum("abd,jbc->jadc", arm.J_rows, x[:, m:])
    forces[2:, m:, alphas:] = np.einsum("abd,jbc->jadc", arm.K_rows, place[:, m:])
    db = -(told.mobility @ forces.reshape(2 + sloped, 2 * m, -1))
    for j in range(3, 2 + sloped):
        db[j] += told.back @ db[j - 2 : j].reshape(4 * m, -1)
    slopes = N[:, None, None] * db[2:, :m].reshape(sloped, m, -1, m)
    return np.moveaxis(slopes, 3, 1).reshape(sloped * m, -1)


def _of_blocks(a: Array, b: Array, c: Array, d: Array) -> Array:
    """[[a, b], [c, d]] of blocks [m, m], in a tenth of the time of `np.block`."""
    m = len(a)
    whole = np.empty((2 * m, 2 * m))
    whole[:m, :m], whole[:m, m:], whole[m:, :m], whole[m:, m:] = a, b, c, d
    return whole


def stiffness(
    arm: Posture, p: Parameters, s: Complex, impedance: Complex | None
) -> tuple[Complex, Complex, Complex, Complex]:
    """Returns the blocks [S, m, m] of the dynamic stiffness: motors, motors by links, links by motors, links."""
    live, N, m = arm.live, arm.N, len(arm.live)
    K, J_m, D, D_spring = (values[live] for values in (p.K, p.J_m, p.D, p.D_spring))
    Z_ll = by_component(arm.J(p)[..., None] * s**2 + (arm.K_rows @ p.gravity)[..., None])
    Z_mm, Z_ml = np.zeros_like(Z_ll), np.zeros_like(Z_ll)
    for i in range(m):
        spring = K[i] + s * D_spring[i]
        Z_ll[:, i, i] += spring
        Z_mm[:, i, i] = s**2 * (N[i] ** 2 * J_m[i]) + s * (N[i] ** 2 * D[i]) + spring
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
    yielding = inverses(Z_ll)
    felt = products(Z_ml, yielding)
    core = arm.N[:, None] * inverses(Z_mm - products(felt, Z_lm))
    if extra.angle_gain is not None:
        core = core * extra.angle_gain[..., None]
    return core, -products(core, felt)


def by_impedance(
    arm: Posture, p: Parameters, s: Complex, extra: Extra, theta: Complex, changes: Complex, pushed: tuple[Complex, Complex]
) -> Complex:  # fmt: skip
    """Returns by how much `changes` [k, S, 2m, 2m] of the impedance change the angles `theta` [S, m] at s [S]: [S, m, k]; `pushed` is
    what `transfer` has there.

    Aliases, where the arm hardly moves, are left out.
    """
    on_motor, on_link = pushed
    forces = changes @ places(arm, p, s, extra, theta)[..., None]  # k, S, 2m, 1
    m = len(arm.live)
    return np.moveaxis(-(on_motor @ forces[:, :, :m] + on_link @ forces[:, :, m:])[..., 0], 0, 2)


def places(arm: Posture, p: Parameters, s: Complex, extra: Extra, theta: Complex) -> Complex:
    """Returns where motors and links are, theta / N and q [S, 2m, joint side], when the motors are read at `theta` [S, m] at s [S]."""
    _, _, Z_lm, Z_ll = stiffness(arm, p, s, extra.impedance)
    x = theta if extra.reading is None else theta - extra.reading
    x = (x if extra.angle_gain is None else x / extra.angle_gain) / arm.N
    by_link = -times(Z_lm, x) if extra.on_link is None else extra.on_link - times(Z_lm, x)
    return np.concatenate([x, np.linalg.solve(Z_ll, by_link[..., None])[..., 0]], axis=1)


def _continuous(
    arm: Posture, p: Parameters, s: Complex, tau: Complex, derive: bool, extra: Extra = NOTHING
) -> tuple[Complex, Complex]:
    """Returns the motor angles [S, m, c] at s [S] of torques [S, m, c], and their derivatives: [S, m, P] for one column,
    else [S, m, P, c]."""
    live, N, m = arm.live, arm.N, len(arm.live)
    K, J_m, D, D_spring = (values[live] for values in (p.K, p.J_m, p.D, p.D_spring))
    Z_mm, Z_ml, Z_lm, Z_ll = stiffness(arm, p, s, extra.impedance)
    yielding = inverses(Z_ll)
    if extra.impedance is None:  # springs alone are between motors and links: Z_ml is diagonal
        spring = np.diagonal(Z_ml, axis1=1, axis2=2)
        pulled = spring[:, :, None] * yielding  # motors by forces on links, if they are held
        carried = -yielding * spring[:, None, :]  # q per theta / N
        felt = Z_mm + spring[:, :, None] * carried
    else:
        pulled, carried = products(Z_ml, yielding), -products(yielding, Z_lm)
        felt = Z_mm + products(Z_ml, carried)
    core = N[:, None] * inverses(felt)  # angle of the motors per force on the motors, joint side
    on_motor = N[:, None] * tau
    if extra.on_motor is not None:
        on_motor = on_motor + extra.on_motor[..., None]
    theta = products(core, on_motor)
    if extra.on_link is None and not derive:
        return theta, np.zeros((len(s), m, 0), dtype=complex)
    across = -products(core, pulled)  # angle of the motors per force on the links
    if extra.on_link is not None:
        theta = theta + products(across, extra.on_link[..., None])
    if not derive:
        return theta, np.zeros((len(s), m, 0), dtype=complex)
    x = theta / N[:, None]
    q = products(carried, x)
    if extra.on_link is not None:
        q = q + products(yielding, extra.on_link[..., None])
    by_place = (across[:, None, :, :, None] * np.swapaxes(q, 1, 2)[:, :, None, None, :]).reshape(-1, m * m)
    by_link = [
        (by_place @ rows.reshape(m * m, -1)).reshape(len(s), q.shape[2], m, -1) for rows in (arm.J_rows, arm.K_rows)
    ]  # S, c, m, D and r
    stretch, x_ = np.swapaxes(x - q, 1, 2)[:, :, None, :], np.swapaxes(x, 1, 2)[:, :, None, :]
    between = (core - across)[:, None] * stretch
    motor, sc4 = core[:, None] * x_, s[:, None, None, None]
    derivatives = -np.concatenate(
        [
            between * K, motor * (sc4**2 * (N**2 * J_m)), motor * (sc4 * (N**2 * D)), between * (sc4 * D_spring),
            by_link[0] * sc4**2, by_link[1],
        ],
        axis=3,
    )  # fmt: skip
    return theta, derivatives[:, 0] if tau.shape[2] == 1 else np.moveaxis(derivatives, 1, 3)
