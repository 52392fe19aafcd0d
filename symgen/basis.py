"""Entries J_ij -> the fewest constants alpha and J_ij(q) = C_ij(q) alpha, shared over all joints.

The number of constants is a rank, not a count of monomials: two monomials whose coefficients are proportional for every
body that could hang on the joints need one constant. Constants are taken tip to base, so that the alpha found at a
distal joint are used again at a proximal one (as the paper does with alpha_21), and each is the coefficient of one
monomial of one J_ii: readable, and every other monomial then needs few of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from symgen.chain import PARAMETERS, Array, Chain, readonly
from symgen.errors import SymgenError
from symgen.geometry import polynomials
from symgen.inertia import DIGIT_DEGREE, Entry, Maps, derive, parameter_scale
from symgen.kinematics import phi_rows

#: A row is new when its part outside the span of the known ones is larger than this, relative to the row. The singular
#: values kept and dropped differ by more than ten decades on every arm tried; the gap is reported.
RANK_TOLERANCE = 1e-9

#: Monomials are tried as pivots in order of degree; in the first passes only those well outside the known span count,
#: which keeps the coefficients of the others small.
_PIVOT_PASSES = (0.3, 0.03, RANK_TOLERANCE)

#: Units of constants, by the power of m.
UNITS = ("kg", "kg m", "kg m2")

#: Coefficients below this, relative to the largest of their monomial, are rounding of zero.
_SMALL = 1e-11


@dataclass(frozen=True)
class Alpha:
    """One constant: coefficient `monomial` (row index) of J_ij, divided by the whole number `content`.

    `row` [10 n] gives it as a combination of the bodies' inertial parameters; `unit` "kg m2", "kg m" or "kg".
    """

    name: str
    i: int
    j: int
    monomial: int
    content: int
    row: Array
    unit: str


@dataclass(frozen=True)
class Factoring:
    """J_ij(q) = monomials_ij(q) S_ij alpha for every entry of J, with alpha [D] = W phi.

    The first `d` constants are those the diagonal J_ii see (shared rank), the rest only off-diagonals. `S[i, j]` [M, D]
    is sparse with small coefficients; for readers. `believed` names the parameters taken as exactly zero.
    `rank_per_joint`, `new_per_joint` [n]; `singular_values` of the stacked coefficients of all J_ii (columns scaled to one
    unit), relative to the largest: the first `d` count.
    """

    chain: Chain
    entries: dict[tuple[int, int], Entry]
    alphas: tuple[Alpha, ...]
    d: int
    W: Array
    S: dict[tuple[int, int], Array]
    rank_per_joint: tuple[int, ...]
    new_per_joint: tuple[int, ...]
    singular_values: Array
    believed: tuple[str, ...]
    free: NDArray[np.bool_]

    @property
    def singular_value_gap(self) -> tuple[float, float]:
        """The smallest singular value that counts and the largest that does not."""
        values = self.singular_values
        return float(values[self.d - 1]), float(values[self.d]) if self.d < values.size else 0.0

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(alpha.name for alpha in self.alphas)

    @property
    def alpha_cad(self) -> Array:
        """The constants [D] of the URDF's own inertial parameters."""
        return readonly(self.W @ self.chain.parameters)


def believed_zeros(chain: Chain) -> NDArray[np.bool_]:
    """Returns which of the 10 n parameters are exactly zero in the file (relative to their body's size) [10 n]."""
    scale = np.maximum(np.abs(chain.parameters * parameter_scale(chain)).reshape(chain.n, 10).max(axis=1), 1e-300)
    relative = np.abs(chain.parameters * parameter_scale(chain)).reshape(chain.n, 10) / scale[:, None]
    tiny: NDArray[np.bool_] = (relative < 1e-14).ravel()
    return tiny


#: Sort weight of a digit (1, c, s, c^2, c s): within a joint the alphas run from c^2 over c s, c, s to the constant.
_ORDER = np.array([0, 2, 1, 4, 3])


def degrees(entry: Entry) -> NDArray[np.int64]:
    """Returns the degree of each monomial [M] of an entry."""
    table = np.array([(*DIGIT_DEGREE[turning], 0, 0)[:5] for turning in entry.turning]).reshape(-1, 5)
    total: NDArray[np.int64] = table[np.arange(len(table)), entry.digits].sum(axis=1)
    return total


class _Span:
    """A growing orthonormal basis of the rows known so far."""

    def __init__(self, width: int):
        self.Q = np.zeros((width, 0))

    def residual(self, A: Array) -> Array:
        return A - (A @ self.Q) @ self.Q.T

    def add(self, row: Array) -> Array:
        """Adds one row; returns the new unit direction."""
        direction = self.residual(self.residual(row))
        direction = direction / np.linalg.norm(direction)
        self.Q = np.column_stack([self.Q, direction])
        return direction

    def pivots(self, A: Array, order: NDArray[np.int64]) -> list[int]:
        """Rows of A that complete the span of A, tried in `order`, well-conditioned ones first; adds them."""
        size = np.linalg.norm(A, axis=1)
        chosen: list[int] = []
        left = self.residual(A)
        for threshold in _PIVOT_PASSES:
            while True:
                outside = np.linalg.norm(left[order], axis=1) > threshold * np.maximum(size[order], 1e-300)
                if not outside.any():
                    break
                row = int(order[np.argmax(outside)])
                direction = self.add(A[row])
                left = left - np.outer(left @ direction, direction)
                chosen.append(row)
        return chosen


def _rank(A: Array) -> tuple[int, Array]:
    """Rank and singular values of the rows of A."""
    values: Array = np.linalg.svd(np.linalg.qr(A, mode="r") if A.shape[0] > A.shape[1] else A, compute_uv=False)
    return int((values > RANK_TOLERANCE * values[0]).sum()) if values.size and values[0] > 0 else 0, values


def _unit(chain: Chain, entry: Entry, monomial: int) -> str:
    turning = [chain.joints[k].type == "revolute" for k in (entry.i, entry.j)]
    power = sum(turning) - sum(int(d) for d, t in zip(entry.digits[monomial], entry.turning, strict=True) if not t)
    return UNITS[power]


def _content(chain: Chain, entry: Entry, rows: list[int], free: NDArray[np.bool_]) -> list[int]:
    """The whole number that divides each coefficient whatever the lengths: 2 for 2 m_3 l_2 r_3 (so alpha_21 = m_3 l_2 r_3)."""
    if not rows:
        return []
    table = polynomials(chain, entry, rows, [UNITS.index(_unit(chain, entry, row)) for row in rows])
    coefficients = table[:, free].reshape(len(rows), -1)
    whole = np.round(coefficients).astype(np.int64)
    exact = np.abs(coefficients - whole).max(axis=1) < 1e-6
    return [max(int(np.gcd.reduce(row)), 1) if good else 1 for row, good in zip(whole, exact, strict=True)]


def _names(pairs: list[tuple[int, int]]) -> list[str]:
    """alpha_ik as in the paper; alpha_i_k once a number has two digits; alpha_1x2_k for what only J_12 shows."""
    counts: dict[tuple[int, int], int] = {}
    numbered = []
    for pair in pairs:
        counts[pair] = counts.get(pair, 0) + 1
        numbered.append((*pair, counts[pair]))
    wide = any(i + 1 > 9 or k > 9 for i, j, k in numbered if i == j)
    return [
        f"alpha_{i + 1}x{j + 1}_{k}" if i != j else f"alpha_{i + 1}_{k}" if wide else f"alpha_{i + 1}{k}"
        for i, j, k in numbered
    ]


def factor(chain: Chain, *, believe_zeros: bool = False) -> Factoring:
    """Returns the minimal factoring of J(q); eqs. (9), (10) with the fewest alpha_ij, for any serial arm.

    With `believe_zeros` the parameters that are exactly zero in the URDF are taken as known to be zero (the paper's
    symmetric links); else every body may have any ten parameters, and the count holds whatever CAD says.
    """
    n = chain.n
    zero: NDArray[np.bool_] = believed_zeros(chain) if believe_zeros else np.zeros(10 * n, dtype=np.bool_)
    scale = np.where(zero, 0.0, 1.0 / parameter_scale(chain))
    diagonal = [(i, i) for i in reversed(range(n))]
    off_diagonal = [(i, j) for i in range(n) for j in range(i + 1, n)]
    maps = Maps(chain)
    entries = {pair: derive(chain, *pair, maps=maps) for pair in diagonal + off_diagonal}
    entries = {pair: _without(entry, zero) for pair, entry in entries.items()}

    span = _Span(10 * n)
    found: list[Alpha] = []
    new_per_joint = [0] * n
    d = 0
    for i, j in diagonal + off_diagonal:
        entry = entries[i, j]
        order = np.lexsort((np.arange(len(entry.digits)), degrees(entry)))
        rows = span.pivots(entry.A * scale, order)
        rows.sort(key=lambda row: tuple(_ORDER[entry.digits[row][::-1]]), reverse=True)
        for row, content in zip(rows, _content(chain, entry, rows, ~zero), strict=True):
            found.append(Alpha("", i, j, row, content, readonly(entry.A[row] / content), _unit(chain, entry, row)))
        if i == j:
            new_per_joint[i] = len(rows)
            d += len(rows)
    alphas = tuple(
        replace(alpha, name=name) for alpha, name in zip(found, _names([(a.i, a.j) for a in found]), strict=True)
    )
    W = np.array([alpha.row for alpha in alphas])
    to_alpha = scale[:, None] * np.linalg.pinv(W * scale)
    stacked = np.concatenate([entries[pair].A for pair in diagonal]) * scale
    rank, values = _rank(stacked)
    if rank != d or any(_outside(chain, entry, W * scale, scale) for entry in entries.values() if not entry.complete):
        raise SymgenError(
            f"{chain.name}: the constants found do not span J(q) (rank {rank}, {d} found): please report this robot"
        )
    return Factoring(
        chain=chain,
        entries=entries,
        alphas=alphas,
        d=d,
        W=readonly(W),
        S={pair: readonly(_sparse(entry.A @ to_alpha)) for pair, entry in entries.items()},
        rank_per_joint=tuple(_rank(entries[i, i].A * scale)[0] for i in range(n)),
        new_per_joint=tuple(new_per_joint),
        singular_values=readonly(values / values[0]),
        believed=tuple(f"{PARAMETERS[p % 10]} of {chain.joints[p // 10].link}" for p in np.flatnonzero(zero)),
        free=~zero,
    )


def _outside(chain: Chain, entry: Entry, W: Array, scale: Array) -> bool:
    """Whether an entry that is not written out in full has rows outside the span of the constants, at random postures."""
    low, high = chain.limits.T
    q = low + (high - low) * np.random.default_rng(0).random((4 * chain.n, chain.n))
    rows = phi_rows(chain, q, entry.i, entry.j) * scale
    basis = np.linalg.qr(W.T)[0]
    return bool(np.linalg.norm(rows - rows @ basis @ basis.T) > RANK_TOLERANCE * np.linalg.norm(rows))


def _without(entry: Entry, zero: NDArray[np.bool_]) -> Entry:
    """The entry with the believed zeros struck out, and the monomials that thereby vanish (but never all of them)."""
    A: Array = np.where(zero, 0.0, entry.A)
    kept = np.array(A.any(axis=1))
    kept[:1] |= not kept.any()
    return replace(entry, digits=entry.digits[kept], A=A[kept])


def _sparse(S: Array) -> Array:
    """Coefficients with rounding removed: tiny ones to zero, those within 1e-12 of a whole number to it."""
    largest = np.abs(S).max(axis=1, keepdims=True, initial=0.0)
    S = np.where(np.abs(S) < _SMALL * np.maximum(largest, 1e-300), 0.0, S)
    whole = np.round(S)
    return np.where(np.abs(S - whole) < 1e-12 * np.maximum(np.abs(whole), 1.0), whole, S)
