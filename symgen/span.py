"""Spans of rows over the inertial parameters: nested ones over the entries of J, and the rows that complete one.

A nearly, but not quite, special arm (every axis off by a milliradian, as calibrated ones are) has constants that matter
thousands of times less than others, and one that hardly shows at a distal joint may show plainly at a proximal one. So
each span is found once, from all that lies in it, and the spans of fewer entries are sought within those of more: what
is found poorly at one joint then differs from the truth only within what the next joints complete anyway.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from symgen.chain import Array

#: A direction counts when the rows reach further along it than this, relative to where they reach furthest. Rounding is
#: 1e-16: on every arm tried, calibrated ones too, nothing lies between 1e-7 and 1e-15. What is dropped is reported.
RANK_TOLERANCE = 1e-9

#: Singular values below this, relative to the largest, are rounding of zero.
_ROUNDING = 1e-14

#: Rows are tried in order: those well outside the known span come first, which keeps the coefficients of the others small.
_PASSES = (0.3, 0.03)

#: A row is not taken where another one reaches further outside by more than this factor.
_REACH = 0.1

#: Of rows that are all nearly known, the first is taken that reaches this much as far outside as the best.
_AS_GOOD = 0.5

#: A row less than this outside what is known, in itself or relative to its size, is rid of what is known and of rounding.
_WEAK = 1e-2

#: A row that has nothing but rounding outside what is known.
_NOTHING = 1e-13


def reached(rows: Array) -> tuple[Array, bool]:
    """Returns an orthonormal basis [width, rank] of what the rows span, and whether more than rounding is dropped."""
    _, values, basis = np.linalg.svd(rows, full_matrices=False)
    values = values / max(values.max(initial=0.0), 1e-300)
    counts = values > RANK_TOLERANCE
    return basis[counts].T, bool((values[~counts] > _ROUNDING).any())


def compressed(rows: Array) -> Array:
    """Returns at most `width` rows with the same singular values and the same span."""
    return np.asarray(np.linalg.qr(rows, mode="r")) if len(rows) > rows.shape[1] else rows


def nested(stages: list[Array], whole: Array) -> tuple[list[Array], bool]:
    """Returns orthonormal bases of the spans of the first stage's rows, of the first two's, .. : each within the next, and
    the last within the span of the orthonormal columns `whole` [width, k]; and whether more than rounding is dropped."""
    together = [compressed(stages[0] @ whole)]
    for rows in stages[1:]:
        together.append(compressed(np.concatenate([together[-1], rows @ whole])))
    basis, bases, dropped = np.eye(whole.shape[1]), [], False
    for rows in reversed(together):
        inner, more = reached(rows @ basis)
        basis, dropped = basis @ inner, dropped or more
        bases.append(whole @ basis)
    return bases[::-1], dropped


def coordinates(W: Array) -> Array:
    """Returns P [width, D] with row @ P @ W = row for every row in the span of W [D, width], which has full row rank.

    The first k columns of P of the first k rows of W do the same for those. Rows of any size are equally good.
    """
    size = np.linalg.norm(W, axis=1)
    Q, R = np.linalg.qr((W / size[:, None]).T)
    P: Array = Q @ np.linalg.inv(R).T / size
    return P


class Growing:
    """An orthonormal basis `Q` [width, k] of the rows known so far."""

    def __init__(self, width: int):
        self.Q = np.zeros((width, 0))

    def residual(self, A: Array) -> Array:
        """What of rows lies outside."""
        return A - (A @ self.Q) @ self.Q.T

    def complete(
        self, A: Array, order: NDArray[np.int64], span: Array, *, exact: bool
    ) -> list[tuple[int, Array | None]]:
        """Adds rows of A [M, width], preferred in `order`, until the orthonormal columns of `span` are reached.

        Returns the index of each; and, where that row would differ too little from what is known, what was added in its
        place: the part of it that is new. `exact`: small numbers in A are as accurate as large ones.
        """
        count = span.shape[1] - self.Q.shape[1]
        added: list[tuple[int, Array | None]] = []
        size = np.maximum(np.linalg.norm(A, axis=1), 1e-300)
        left = self.residual(A) if count > 0 else A
        for threshold in (*_PASSES, 0.0):
            while len(added) < count:
                outside = np.linalg.norm(left, axis=1)
                good = (outside > threshold * size) & (outside > _REACH * outside.max())
                if threshold == 0.0:
                    good = outside > _AS_GOOD * outside.max()
                if not good[order].any():
                    break
                row = int(order[np.argmax(good[order])])
                plain = outside[row] > _WEAK * (size[row] if exact else max(1.0, size[row]))
                new = None if plain else self._within(left[row], span)
                direction = self._add(A[row] if new is None else new)
                left = left - np.outer(left @ direction, direction)
                added.append((row, new))
        return added

    def _within(self, row: Array, span: Array) -> Array:
        """The part of a row inside `span` and outside what is known; where there is none, what `span` has most besides."""
        part = self.residual(self.residual(row @ span @ span.T))
        if np.linalg.norm(part) > _NOTHING:
            return part
        missing = self.residual(span.T)
        return np.linalg.svd(missing, full_matrices=False)[2][0]

    def _add(self, row: Array) -> Array:
        """Adds one row; returns the new unit direction."""
        direction = self.residual(self.residual(row))
        direction = direction / np.linalg.norm(direction)
        self.Q = np.column_stack([self.Q, direction])
        return direction
