"""Algebra of many small matrices at once: the arm's dynamic stiffness, and the covariance of its noise, at every line.

It is quickest where each component has all lines in a row in memory, as `by_component` has them; arrays are [S, m, m] anyway, and what
is made of them is laid out alike.
"""

from __future__ import annotations

import numpy as np

from ident.records.campaign import Array
from ident.records.frf import Complex

#: Rows and columns up to which matrices are multiplied and inverted component by component: LAPACK and BLAS, which are called for each
#: of the S, take three to eight times as long.
SMALL = 3


def by_component(blocks: Complex | Array) -> Complex:
    """Matrices [S, m, k] of components [m, k, S]."""
    return np.moveaxis(np.ascontiguousarray(blocks, dtype=complex), 2, 0)


def products(A: Complex, B: Complex) -> Complex:
    """Returns A @ B [.., S, m, k] of many small matrices."""
    if max(A.shape[-2], B.shape[-1]) > SMALL:
        return np.asarray(A @ B)
    total = A[..., :, 0, None] * B[..., None, 0, :]
    for k in range(1, A.shape[-1]):
        total += A[..., :, k, None] * B[..., None, k, :]
    return np.asarray(total)


def times(A: Complex, x: Complex) -> Complex:
    """Returns A x [S, m] of many small matrices [S, m, k] and vectors [S, k]."""
    return products(A, x[..., None])[..., 0]


def inverses(A: Complex) -> Complex:
    """Returns the inverses [S, m, m] of matrices `A` [S, m, m], small ones by their cofactors (Cramer's rule).

    Raises numpy.linalg.LinAlgError where one has none.
    """
    m = A.shape[-1]
    if m > SMALL:
        return np.asarray(np.linalg.inv(A), dtype=complex)
    inverse = np.empty_like(A)
    if m == 3:
        (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(A, 0, 2)
        inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 0, 2] = e * i - f * h, c * h - b * i, b * f - c * e
        inverse[:, 1, 0], inverse[:, 1, 1], inverse[:, 1, 2] = f * g - d * i, a * i - c * g, c * d - a * f
        inverse[:, 2, 0], inverse[:, 2, 1], inverse[:, 2, 2] = d * h - e * g, b * g - a * h, a * e - b * d
        determinant = a * inverse[:, 0, 0] + b * inverse[:, 1, 0] + c * inverse[:, 2, 0]
    elif m == 2:
        (a, b), (c, d) = np.moveaxis(A, 0, 2)
        inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 0], inverse[:, 1, 1] = d, -b, -c, a
        determinant = a * d - b * c
    else:
        inverse[:], determinant = 1.0, A[:, 0, 0]
    if not determinant.all():
        raise np.linalg.LinAlgError("singular matrix")
    return np.asarray(inverse / determinant[:, None, None], dtype=complex)
