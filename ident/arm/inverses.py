"""Inverses of many small matrices at once: the arm's dynamic stiffness, and the covariance of its noise, at every line."""

from __future__ import annotations

import numpy as np

from ident.records.frf import Complex


def inverses(A: Complex) -> Complex:
    """Returns the inverses [S, m, m] of matrices `A` [S, m, m], up to three by three by their cofactors (Cramer's rule): LAPACK, which
    is called for each of the S, takes three to six times as long.

    Raises numpy.linalg.LinAlgError where one has none.
    """
    m = A.shape[-1]
    if m > 3:
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
