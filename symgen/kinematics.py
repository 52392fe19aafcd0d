"""Motion of the bodies of a chain in numbers: twists, and the kinetic energy as a row over inertial parameters."""

from __future__ import annotations

import numpy as np

from symgen.chain import REVOLUTE, Array, Chain, placements, skew

#: Rows and columns of the six entries Lxx, Lxy, Lyy, Lxz, Lyz, Lzz of a symmetric matrix, in the order of `PARAMETERS`.
MOMENTS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


def motion(chain: Chain, k: int) -> Array:
    """Returns the unit twist [6] (omega, u) of joint k in its link frame."""
    joint = chain.joints[k]
    zero = np.zeros(3)
    return np.concatenate([joint.axis, zero] if joint.type == REVOLUTE else [zero, joint.axis])


def energy_row(v: Array, w: Array) -> Array:
    """Returns the row [.., 10] with v' M w = row . phi for twists v, w [.., 6] of one body (omega, u at its frame's origin)."""
    v_omega, v_u, w_omega, w_u = v[..., :3], v[..., 3:], w[..., :3], w[..., 3:]
    row = np.zeros((*np.broadcast_shapes(v.shape, w.shape)[:-1], 10))
    row[..., 0] = (v_u * w_u).sum(axis=-1)
    row[..., 1:4] = np.cross(v_u, w_omega) + np.cross(w_u, v_omega)
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
        u = u + np.cross(omega, p[:, None, :])
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
        out[:, : k + 1, 10 * k + 1 : 10 * k + 4] = -np.cross(g[:, None, :], moving[..., :3])  # -(omega x h) . g
    return out


def gravity_forces(chain: Chain, q: Array, gravity: Array) -> Array:
    """Returns the joint forces [m, n, N m or N] that hold the arm against `gravity` [3, m/s2, base frame] at q [m, n].

    `gravity_rows` times the chain's own parameters, without the rows: masses and first moments gathered from the tip.
    """
    placed, g = list(placements(chain, q)), [np.broadcast_to(np.asarray(gravity, dtype=float), (len(q), 3))]
    for R, _ in placed:
        g.append((g[-1][:, None, :] @ R)[:, 0])
    forces, mass, moment = np.zeros((len(q), chain.n)), 0.0, np.zeros((len(q), 3))
    for k in reversed(range(chain.n)):
        axis, body = chain.joints[k].axis, chain.parameters[10 * k : 10 * k + 4]
        mass, moment = mass + body[0], moment + body[1:]
        turning = chain.joints[k].type == REVOLUTE
        forces[:, k] = -((moment @ skew(axis).T if turning else mass * axis) * g[k + 1]).sum(axis=1)
        R, p = placed[k]
        moment = (R @ moment[..., None])[..., 0] + mass * p
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


def phi_rows(chain: Chain, q: Array, i: int, j: int) -> Array:
    """Returns the rows with J_ij(q) = row . phi, phi all bodies' parameters: [m, 10 n] at postures q [m, n]."""
    out = np.zeros((len(q), 10 * chain.n))
    for k, moving in enumerate(twists(chain, q)):
        if k >= max(i, j):
            out[:, 10 * k : 10 * k + 10] = energy_row(moving[:, i], moving[:, j])
    return out
