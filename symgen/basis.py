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

from symgen.chain import PARAMETERS, REVOLUTE, Array, Chain, readonly
from symgen.geometry import Units, at_right_angles, polynomials
from symgen.inertia import DIGIT_DEGREE, Entry, Maps, derive, length_scale, parameter_scale
from symgen.kinematics import energy_row, twists
from symgen.span import Growing, compressed, coordinates, nested, reached

#: J_ij(q), i <= j from 0, as monomials.
Entries = dict[tuple[int, int], Entry]

#: Units of constants, by the power of m.
UNITS = ("kg", "kg m", "kg m2")

#: Random postures whose rows stand for an entry, per joint: more than any entry has constants (6 a joint).
_SAMPLES = 10

#: What contributes less than this to a monomial, relative to the largest contribution, is rounding of zero.
_SMALL = 1e-13


@dataclass(frozen=True)
class Alpha:
    """One constant: coefficient `monomial` (row index) of J_ij, divided by the whole number `content`.

    `row` [10 n] gives it as a combination of the bodies' inertial parameters; `unit` "kg m2", "kg m" or "kg". Where `part`
    is set it is only the part of that coefficient that the constants before it do not give: they nearly do.
    """

    name: str
    i: int
    j: int
    monomial: int
    content: int
    row: Array
    unit: str
    part: bool = False


@dataclass(frozen=True)
class Factoring:
    """J_ij(q) = monomials_ij(q) S_ij alpha for every entry of J, with alpha [D] = W phi.

    The first `d` constants are those the diagonal J_ii see (shared rank), the rest only off-diagonals. `S[i, j]` [M, D]
    is sparse with small coefficients; for readers. `believed` names the parameters taken as exactly zero.
    `rank_per_joint`, `new_per_joint` [n]; `singular_values` of the stacked coefficients of all J_ii (columns scaled to one
    unit), relative to the largest: the first `d` count. `cost`: what was dropped below `span.RANK_TOLERANCE` changes J of
    the chain's own bodies by this much of its largest entry; 0 where nothing but rounding was dropped.
    """

    chain: Chain
    entries: Entries
    alphas: tuple[Alpha, ...]
    d: int
    W: Array
    S: dict[tuple[int, int], Array]
    rank_per_joint: tuple[int, ...]
    new_per_joint: tuple[int, ...]
    singular_values: Array
    believed: tuple[str, ...]
    free: NDArray[np.bool_]
    cost: float = 0.0

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


def _unit(chain: Chain, entry: Entry, monomial: int) -> str:
    turning = [chain.joints[k].type == "revolute" for k in (entry.i, entry.j)]
    power = sum(turning) - sum(int(d) for d, t in zip(entry.digits[monomial], entry.turning, strict=True) if not t)
    return UNITS[power]


def _content(units: Units, chain: Chain, entry: Entry, rows: list[int], free: NDArray[np.bool_]) -> list[int]:
    """The whole number that divides each coefficient whatever the lengths: 2 for 2 m_3 l_2 r_3 (so alpha_21 = m_3 l_2 r_3)."""
    inertias = np.where(free, entry.A[rows], 0.0).reshape(len(rows), chain.n, 10)[..., 4:]  # do not depend on lengths
    if not (np.abs(inertias - np.round(inertias)).max(axis=(1, 2)) < 1e-6).any():
        return [1] * len(rows)
    table = polynomials(units, entry, rows, [UNITS.index(_unit(chain, entry, row)) for row in rows])
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


def derived(chain: Chain) -> Entries:
    """Returns every J_ij(q), i <= j from 0, as monomials times inertial parameters: the diagonal, tip to base, comes first."""
    maps, n = Maps(chain), chain.n
    pairs = [(i, i) for i in reversed(range(n))] + [(i, j) for i in range(n) for j in range(i + 1, n)]
    return {pair: derive(chain, *pair, maps=maps) for pair in pairs}


def factor(chain: Chain, *, believe_zeros: bool = False, entries: Entries | None = None) -> Factoring:
    """Returns the minimal factoring of J(q); eqs. (9), (10) with the fewest alpha_ij, for any serial arm.

    With `believe_zeros` the parameters that are exactly zero in the URDF are taken as known to be zero (the paper's
    symmetric links); else every body may have any ten parameters, and the count holds whatever CAD says. `entries` of
    `derived` saves deriving them again.
    """
    n = chain.n
    zero: NDArray[np.bool_] = believed_zeros(chain) if believe_zeros else np.zeros(10 * n, dtype=np.bool_)
    scale = np.where(zero, 0.0, 1.0 / parameter_scale(chain))
    entries = {pair: _without(entry, zero) for pair, entry in (entries or derived(chain)).items()}
    samples = _Samples(chain, scale)
    spans, dropped = samples.spans(list(entries))
    tables = {pair: entry.A for pair, entry in entries.items()}
    if dropped:
        unscale = np.where(zero, 0.0, parameter_scale(chain))
        tables = {pair: tables[pair] * scale @ span @ span.T * unscale for pair, span in spans.items()}
    alphas, known = _constants(chain, entries, tables, spans, scale)
    W = np.array([alpha.row for alpha in alphas])
    S, size = {}, np.linalg.norm(W * scale, axis=1)
    for pair, entry in entries.items():
        P = coordinates((W * scale)[: known[pair]])
        S[pair] = readonly(_sparse(entry.A * scale, P, size))
    own = np.concatenate([entry.A for (i, j), entry in entries.items() if i == j])
    values = np.linalg.svd(compressed(own * scale), compute_uv=False)
    return Factoring(
        chain=chain,
        entries=entries,
        alphas=alphas,
        d=known[0, 0],
        W=readonly(W),
        S=S,
        rank_per_joint=tuple(reached(samples.of(i, i))[0].shape[1] for i in range(n)),
        new_per_joint=tuple(sum(alpha.i == alpha.j == i for alpha in alphas) for i in range(n)),
        singular_values=readonly(values / values[0]),
        believed=tuple(f"{PARAMETERS[p % 10]} of {chain.joints[p // 10].link}" for p in np.flatnonzero(zero)),
        free=~zero,
        cost=samples.cost(W, known) if dropped else 0.0,
    )


class _Samples:
    """Rows of J(q) over the scaled parameters at random postures, comparable whatever the unit: a slide's motion is counted
    in `length_scale`. They span what the monomials span, without their number."""

    def __init__(self, chain: Chain, scale: Array):
        length, turning = length_scale(chain), [joint.type == REVOLUTE for joint in chain.joints]
        rng = np.random.default_rng(0)
        self._q = np.where(turning, np.pi, length) * rng.uniform(-1.0, 1.0, (_SAMPLES * chain.n, chain.n))
        self._speeds = rng.normal(size=self._q.shape) * np.where(turning, 1.0, length)
        self._size = np.where(turning, 1.0, length)
        self._scale, self._phi = scale, chain.parameters * parameter_scale(chain)
        self._twists = twists(chain, self._q)

    def of(self, i: int, j: int) -> Array:
        """Rows of J_ij [m, 10 n]."""
        rows = np.zeros((len(self._q), self._scale.size))
        for k in range(max(i, j), len(self._twists)):
            rows[:, 10 * k : 10 * k + 10] = energy_row(self._twists[k][:, i], self._twists[k][:, j])
        weighted: Array = rows * self._scale * (self._size[i] * self._size[j])
        return weighted

    def spans(self, pairs: list[tuple[int, int]]) -> tuple[dict[tuple[int, int], Array], bool]:
        """For each entry an orthonormal basis of what it and those before it span, each within the next; and whether more
        than rounding is dropped."""
        moving = [(self._speeds[:, None, : k + 1] @ twist)[:, 0] for k, twist in enumerate(self._twists)]
        whole, dropped = reached(np.hstack([energy_row(v, v) for v in moving]) * self._scale)
        bases, more = nested([self.of(*pair) for pair in pairs], whole)
        return dict(zip(pairs, bases, strict=True)), dropped or more

    def cost(self, W: Array, known: dict[tuple[int, int], int]) -> float:
        """What J of the chain's own bodies differs from that of their constants, relative to its largest entry."""
        largest = worst = 0.0
        for pair, count in known.items():
            rows, scaled = self.of(*pair), W[:count] * self._scale
            worst = max(worst, float(np.abs((rows - rows @ coordinates(scaled) @ scaled) @ self._phi).max()))
            largest = max(largest, float(np.abs(rows @ self._phi).max()))
        return worst / largest


def _constants(
    chain: Chain,
    entries: Entries,
    tables: dict[tuple[int, int], Array],
    spans: dict[tuple[int, int], Array],
    scale: Array,
) -> tuple[tuple[Alpha, ...], dict[tuple[int, int], int]]:
    """The constants in the order of the entries in `spans`, and how many are known once each entry is.

    `tables` [M, 10 n]: what of the entries' rows lies within the spans.
    """
    exact, free, units = at_right_angles(chain), scale > 0, Units(chain)
    unscale = np.where(free, parameter_scale(chain), 0.0)
    growing = Growing(10 * chain.n)
    found: list[Alpha] = []
    known = {}
    for (i, j), span in spans.items():
        entry, table = entries[i, j], tables[i, j]
        order = np.lexsort((np.arange(len(entry.digits)), degrees(entry)))
        added = dict(growing.complete(table * scale, order, span, exact=exact))
        rows = sorted(added, key=lambda row: tuple(_ORDER[entry.digits[row][::-1]]), reverse=True)
        plain = [row for row in rows if added[row] is None]
        content = dict(zip(plain, _content(units, chain, entry, plain, free), strict=True))
        for row in rows:
            part, whole = added[row], content.get(row, 1)
            coefficient = table[row] / whole if part is None else part * unscale
            found.append(Alpha("", i, j, row, whole, readonly(coefficient), _unit(chain, entry, row), part is not None))
        known[i, j] = len(found)
    names = _names([(alpha.i, alpha.j) for alpha in found])
    return tuple(replace(alpha, name=name) for alpha, name in zip(found, names, strict=True)), known


def _without(entry: Entry, zero: NDArray[np.bool_]) -> Entry:
    """The entry with the believed zeros struck out, and the monomials that thereby vanish (but never all of them)."""
    A: Array = np.where(zero, 0.0, entry.A) if zero.any() else entry.A
    kept = np.array(A.any(axis=1))
    kept[:1] |= not kept.any()
    if kept.all():
        return replace(entry, A=A)
    return replace(entry, digits=entry.digits[kept], A=A[kept])


def _sparse(A: Array, P: Array, size: Array) -> Array:
    """The coefficients A P [M, D], the last zero, with rounding removed: tiny ones to zero, those within 1e-12 of a whole
    number to it. `size` [D] of the constants' rows: a coefficient is tiny by what it contributes."""
    S = np.zeros((len(A), len(size)))
    S[:, : P.shape[1]] = A @ P
    contribution = np.abs(S) * size
    largest = contribution.max(axis=1, keepdims=True, initial=0.0)
    np.copyto(S, 0.0, where=contribution < _SMALL * np.maximum(largest, 1e-300))
    whole = np.rint(S)
    np.copyto(S, whole, where=np.abs(S - whole) < 1e-12 * np.abs(whole))
    return S
