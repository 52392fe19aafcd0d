"""Rows of J(q) over the constants alpha, as numbers at many postures at once."""

from __future__ import annotations

import numpy as np

from symgen.basis import Factoring
from symgen.chain import Array
from symgen.inertia import parameter_scale
from symgen.kinematics import energy_row, twists
from symgen.span import coordinates


def to_alpha(factoring: Factoring, count: int) -> Array:
    """The matrix P [10 n, count] with phi-row @ P = alpha-row for every row in the span of the first `count` constants."""
    scale = np.where(factoring.free, 1.0 / parameter_scale(factoring.chain), 0.0)
    P: Array = scale[:, None] * coordinates(factoring.W[:count] * scale)
    return P


def C_rows(factoring: Factoring, q: Array) -> Array:
    """Returns the rows C_i(q) with J_ii(q) = C_i(q) . alpha[:d], eq. (10): [.., n, d] for postures q [.., n, rad or m]."""
    chain, d = factoring.chain, factoring.d
    flat = np.asarray(q, dtype=float).reshape(-1, chain.n)
    P = to_alpha(factoring, d)
    out = np.zeros((len(flat), chain.n, d))
    for k, moving in enumerate(twists(chain, flat)):
        out[:, : k + 1] += energy_row(moving, moving) @ P[10 * k : 10 * k + 10]
    return out.reshape(*np.shape(q)[:-1], chain.n, d)


def J_rows(factoring: Factoring, q: Array) -> Array:
    """Returns the regressor of the whole matrix, J(q) = J_rows(q) . alpha: [.., n, n, D] for postures q [.., n]."""
    chain, D = factoring.chain, len(factoring.alphas)
    flat = np.asarray(q, dtype=float).reshape(-1, chain.n)
    P = to_alpha(factoring, D)
    out = np.zeros((len(flat), chain.n, chain.n, D))
    for k, moving in enumerate(twists(chain, flat)):
        rows = energy_row(moving[:, :, None, :], moving[:, None, :, :])
        out[:, : k + 1, : k + 1] += rows @ P[10 * k : 10 * k + 10]
    return out.reshape(*np.shape(q)[:-1], chain.n, chain.n, D)
