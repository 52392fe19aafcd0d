"""Motion of the bodies of a chain in numbers: twists, and the kinetic energy as a row over inertial parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from symgen.chain import REVOLUTE, Array, Chain, Joint, placements, skew

#: Rows and columns of the six entries Lxx, Lxy, Lyy, Lxz, Lyz, Lzz of a symmetric matrix, in the order of `PARAMETERS`.
MOMENTS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
#: Axes in right-handed order.
CYCLES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))


def motion(chain: Chain, k: int) -> Array:
    """Returns the unit twist [6] (omega, u) of joint k in its link frame."""
    joint = chain.joints[k]
    zero = np.zeros(3)
    return np.concatenate([joint.axis, zero] if joint.type == REVOLUTE else [zero, joint.axis])


def cross(one: Array, other: Array) -> Array:
    """Returns the cross products of vectors [.., 3]: `np.cross` moves axes about, which takes longer than the products."""
    out = np.empty(np.broadcast_shapes(one.shape, other.shape))
    for x, y, z in CYCLES:
        out[..., x] = one[..., y] * other[..., z] - one[..., z] * other[..., y]
    return out


def energy_row(v: Array, w: Array) -> Array:
    """Returns the row [.., 10] with v' M w = row . phi for twists v, w [.., 6] of one body (omega, u at its frame's origin)."""
    v_omega, v_u, w_omega, w_u = v[..., :3], v[..., 3:], w[..., :3], w[..., 3:]
    row = np.zeros((*np.broadcast_shapes(v.shape, w.shape)[:-1], 10))
    row[..., 0] = (v_u * w_u).sum(axis=-1)
    row[..., 1:4] = cross(v_u, w_omega) + cross(w_u, v_omega)
    for column, (x, y) in enumerate(MOMENTS):
        row[..., 4 + column] = v_omega[..., x] * w_omega[..., y]
        if x != y:
            row[..., 4 + column] += v_omega[..., y] * w_omega[..., x]
    return row


def twists(chain: Chain, q: Array) -> list[Array]:
    """Returns for each body k the unit twists [m, k + 1, 6] of the joints up to k, in the link frame of k."""
    out: list[Array] = []
    carried = np.zeros((len(q), 0, 6))
    for k, (R, p) in enumerate(placements(chain, q)):
        omega, u = carried[..., :3], carried[..., 3:]
        u = u + cross(omega, p[:, None, :])
        moved = np.concatenate([omega @ R, u @ R], axis=-1)
        own = np.broadcast_to(motion(chain, k), (len(q), 1, 6))
        carried = np.concatenate([moved, own], axis=1)
        out.append(carried)
    return out


def gravity_rows(chain: Chain, q: Array, gravity: Array) -> Array:
    """Returns the rows with G(q) = rows . phi, phi all bodies' parameters: [m, n, 10 n] at q [m, n].

    G are the joint forces [N m or N] that hold the arm against `gravity` [3, m/s2, base frame].
    """
    out = np.zeros((len(q), chain.n, 10 * chain.n))
    g = np.broadcast_to(np.asarray(gravity, dtype=float), (len(q), 3))
    for k, ((R, _), moving) in enumerate(zip(placements(chain, q), twists(chain, q), strict=True)):
        g = np.einsum("mba,mb->ma", R, g)
        out[:, : k + 1, 10 * k] = -np.einsum("mja,ma->mj", moving[..., 3:], g)
        out[:, : k + 1, 10 * k + 1 : 10 * k + 4] = -cross(g[:, None, :], moving[..., :3])  # -(omega x h) . g
    return out


def torque_rows(chain: Chain, q: Array, v: Array, a: Array, gravity: Array) -> Array:
    """Returns the rows with tau = rows . phi, phi all bodies' parameters: [m, n, 10 n] in the motion q, v, a [m, n].

    tau = J(q) a + c(q, v) + G(q) are the joint torques [N m or N] of a rigid arm, without friction; `gravity` as in `gravity_rows`.
    Newton-Euler in link frames (R. Featherstone, Rigid Body Dynamics Algorithms, 2008, DOI 10.1007/978-1-4899-7560-7).
    """
    out = np.zeros((len(q), chain.n, 10 * chain.n))
    moves, quickens = (
        np.zeros((len(q), 6)),
        np.tile(np.append(np.zeros(3), -np.asarray(gravity, dtype=float)), (len(q), 1)),
    )
    for k, ((R, p), moving) in enumerate(zip(placements(chain, q), twists(chain, q), strict=True)):
        unit = motion(chain, k)
        own = unit * v[:, k, None]
        moves = _carried(moves, R, p) + own
        quickens = _carried(quickens, R, p) + unit * a[:, k, None] + _across(moves, own)
        wrenches = momentum_rows(quickens) + _turning(moves, momentum_rows(moves))
        out[:, : k + 1, 10 * k : 10 * k + 10] = moving @ wrenches
    return out


def momentum_rows(twist: Array) -> Array:
    """Returns the rows [.., 6, 10] with which a body's parameters give its angular and linear momentum at a `twist` [.., 6]."""
    omega, u = twist[..., :3], twist[..., 3:]
    rows = np.zeros((*twist.shape, 10))
    rows[..., 3:, 0] = u
    for x, y, z in CYCLES:
        rows[..., x, 1 + y], rows[..., y, 1 + x] = u[..., z], -u[..., z]
        rows[..., 3 + x, 1 + y], rows[..., 3 + y, 1 + x] = -omega[..., z], omega[..., z]
    for column, (x, y) in enumerate(MOMENTS):
        rows[..., x, 4 + column] = omega[..., y]
        rows[..., y, 4 + column] = omega[..., x]
    return rows


def _carried(twist: Array, R: Array, p: Array) -> Array:
    """A twist [m, 6] of one body in the frame `R`, `p` of the next."""
    omega, u = twist[:, :3], twist[:, 3:]
    return np.concatenate([np.einsum("mab,ma->mb", R, x) for x in (omega, u + cross(omega, p))], axis=1)


def _across(one: Array, other: Array) -> Array:
    """The cross product of two twists [m, 6]."""
    omega, u = one[:, :3], one[:, 3:]
    return np.concatenate([cross(omega, other[:, :3]), cross(omega, other[:, 3:]) + cross(u, other[:, :3])], axis=1)


def _turning(twist: Array, momentum: Array) -> Array:
    """How momenta [m, 6, c] in axes that move by a `twist` [m, 6] change by that alone."""
    omega, u = twist[:, :3, None], twist[:, 3:, None]
    angular, linear = momentum[:, :3], momentum[:, 3:]
    return np.concatenate([_crossed(omega, angular) + _crossed(u, linear), _crossed(omega, linear)], axis=1)


def _crossed(one: Array, other: Array) -> Array:
    """The cross products along the second axis [m, 3, ..], in place of `np.cross`, which moves axes about."""
    return np.stack([one[:, y] * other[:, z] - one[:, z] * other[:, y] for _, y, z in CYCLES], axis=1)


def frames(joints: Sequence[Joint], before: Array) -> Callable[[Array], Array]:
    """Returns the function that gives the frames of the base and all bodies [m, n + 1, 4, 4] at q [m, n], in the base frame.

    `before` [n, 4, 4] are the frames of the joints at zero, each in that of the body before.
    """
    one, c, s, slide = before @ np.array([_motions(joint) for joint in joints]).swapaxes(0, 1)

    def at(q: Array) -> Array:
        x = q[:, :, None, None]
        steps = one + c * np.cos(x) + s * np.sin(x) + slide * x
        out = np.broadcast_to(np.eye(4), (len(q), len(joints) + 1, 4, 4)).copy()
        for k in range(len(joints)):
            out[:, k + 1] = out[:, k] @ steps[:, k]
        return out

    return at


def _motions(joint: Joint) -> Array:
    """A joint's motion [4, 4] as the sum of these [4, 4, 4] times 1, cos q, sin q and q."""
    parts = np.zeros((4, 4, 4))
    parts[0] = np.eye(4)
    if joint.type == REVOLUTE:
        along = np.outer(joint.axis, joint.axis)
        parts[:3, :3, :3] = along, np.eye(3) - along, skew(joint.axis)
    else:
        parts[3, :3, 3] = joint.axis
    return parts


def gravity_forces(chain: Chain, gravity: ArrayLike) -> Callable[[Array], Array]:
    """Returns the function that gives the joint forces [m, n, N m or N] at q [m, n] that hold the arm against `gravity`.

    `gravity` [3, m/s2] is in the base frame. It is `gravity_rows` times the chain's own parameters, without the rows.
    """
    g = np.asarray(gravity, dtype=float)
    before = np.tile(np.eye(4), (chain.n, 1, 1))
    before[:, :3, :3], before[:, :3, 3] = [joint.R for joint in chain.joints], [joint.p for joint in chain.joints]
    bodies = chain.parameters.reshape(-1, 10)
    moments = np.concatenate([bodies[:, 1:4], bodies[:, :1]], axis=1)[..., None]
    mass = np.cumsum(bodies[::-1, :1], axis=0)[::-1]
    axes = np.array([joint.axis for joint in chain.joints])[..., None]
    turning = np.array([joint.type == REVOLUTE for joint in chain.joints])
    place = frames(chain.joints, before)

    def forces(q: Array) -> Array:
        at = place(q)[:, 1:]
        axis = (at[..., :3, :3] @ axes)[..., 0]
        outer = np.cumsum((at[..., :3, :] @ moments)[:, ::-1, :, 0], axis=1)[:, ::-1]
        arm = outer - mass * at[..., :3, 3]
        return -np.where(turning, (axis * (arm @ skew(g))).sum(axis=2), mass[:, 0] * (axis @ g))

    return forces


def gravity_stiffness_rows(chain: Chain, q: Array, gravity: Array) -> Array:
    """Returns the rows with dG_i/dq_k = rows[i, k] . phi: [m, n, n, 10 n] at q [m, n]; arguments as in `gravity_rows`.

    Exact: G is of first degree in (cos, sin) of each angle and in each displacement, so that half the difference of
    its values a quarter turn (or one metre) to either side is its derivative.
    """
    quarter = [np.pi / 2 if joint.type == REVOLUTE else 1.0 for joint in chain.joints]
    away = np.array([1.0, -1.0])[:, None, None, None] * np.diag(quarter)[:, None, :]  # 2, n, 1, n
    rows = gravity_rows(chain, (q + away).reshape(-1, chain.n), gravity).reshape(2, chain.n, len(q), chain.n, -1)
    out: Array = np.moveaxis((rows[0] - rows[1]) / 2, 0, 2)
    return out


def inertia_matrix(chain: Chain, q: Array) -> Array:
    """Returns J(q) of the chain's own bodies [.., n, n] at postures q [.., n], without any factoring (composite bodies)."""
    flat = np.asarray(q, dtype=float).reshape(-1, chain.n)
    out = np.zeros((len(flat), chain.n, chain.n))
    for k, moving in enumerate(twists(chain, flat)):
        rows = energy_row(moving[:, :, None, :], moving[:, None, :, :])
        out[:, : k + 1, : k + 1] += rows @ chain.parameters[10 * k : 10 * k + 10]
    return out.reshape(*np.shape(q)[:-1], chain.n, chain.n)
