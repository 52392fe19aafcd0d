"""Rows of J(q) over the constants alpha, as numbers at many postures at once."""

from __future__ import annotations

import numpy as np

from symgen.basis import Factoring
from symgen.chain import REVOLUTE, Array, Chain, skew
from symgen.inertia import energy_row, motion, parameter_scale


def _twists(chain: Chain, q: Array) -> list[Array]:
    """For each body k the unit twists [m, k + 1, 6] of the joints up to k, in the link frame of k."""
    out: list[Array] = []
    carried = np.zeros((len(q), 0, 6))
    for k, joint in enumerate(chain.joints):
        if joint.type == REVOLUTE:
            c, s = np.cos(q[:, k])[:, None, None], np.sin(q[:, k])[:, None, None]
            A0 = np.outer(joint.axis, joint.axis)
            R = joint.R @ (A0 + c * (np.eye(3) - A0) + s * skew(joint.axis))
            p = np.broadcast_to(joint.p, (len(q), 3))
        else:
            R = np.broadcast_to(joint.R, (len(q), 3, 3))
            p = joint.p + q[:, k, None] * (joint.R @ joint.axis)
        omega, u = carried[..., :3], carried[..., 3:]
        u = u + np.cross(omega, p[:, None, :])
        moved = np.concatenate([omega @ R, u @ R], axis=-1)
        own = np.broadcast_to(motion(chain, k), (len(q), 1, 6))
        carried = np.concatenate([moved, own], axis=1)
        out.append(carried)
    return out


def _to_alpha(factoring: Factoring, count: int) -> Array:
    """The matrix P [10 n, count] with phi-row @ P = alpha-row for every row in the span of the first `count` constants."""
    scale = np.where(factoring.free, 1.0 / parameter_scale(factoring.chain), 0.0)
    P: Array = scale[:, None] * np.linalg.pinv(factoring.W[:count] * scale)
    return P


def C_rows(factoring: Factoring, q: Array) -> Array:
    """Returns the rows C_i(q) with J_ii(q) = C_i(q) . alpha[:d], eq. (10): [.., n, d] for postures q [.., n, rad or m]."""
    chain, d = factoring.chain, factoring.d
    flat = np.asarray(q, dtype=float).reshape(-1, chain.n)
    P = _to_alpha(factoring, d)
    out = np.zeros((len(flat), chain.n, d))
    for k, twists in enumerate(_twists(chain, flat)):
        out[:, : k + 1] += energy_row(twists, twists) @ P[10 * k : 10 * k + 10]
    return out.reshape(*np.shape(q)[:-1], chain.n, d)


def J_rows(factoring: Factoring, q: Array) -> Array:
    """Returns the regressor of the whole matrix, J(q) = J_rows(q) . alpha: [.., n, n, D] for postures q [.., n]."""
    chain, D = factoring.chain, len(factoring.alphas)
    flat = np.asarray(q, dtype=float).reshape(-1, chain.n)
    P = _to_alpha(factoring, D)
    out = np.zeros((len(flat), chain.n, chain.n, D))
    for k, twists in enumerate(_twists(chain, flat)):
        rows = energy_row(twists[:, :, None, :], twists[:, None, :, :])
        out[:, : k + 1, : k + 1] += rows @ P[10 * k : 10 * k + 10]
    return out.reshape(*np.shape(q)[:-1], chain.n, chain.n, D)


def inertia_matrix(chain: Chain, q: Array) -> Array:
    """Returns J(q) of the chain's own bodies [.., n, n] at postures q [.., n], without any factoring (composite bodies)."""
    flat = np.asarray(q, dtype=float).reshape(-1, chain.n)
    out = np.zeros((len(flat), chain.n, chain.n))
    for k, twists in enumerate(_twists(chain, flat)):
        rows = energy_row(twists[:, :, None, :], twists[:, None, :, :])
        out[:, : k + 1, : k + 1] += rows @ chain.parameters[10 * k : 10 * k + 10]
    return out.reshape(*np.shape(q)[:-1], chain.n, chain.n)
