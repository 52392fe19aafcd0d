"""J(q, alpha) as a CasADi graph: the fast form of what the equations say monomial by monomial.

D of the 10 n inertial parameters, chosen so that W restricted to them can be inverted, carry the constants alpha
and all others are zero; J does not change, because it sees alpha only. One composite-rigid-body recursion over these
few parameters, in frames whose z axis is the joint axis, gives all of J. Structural zeros never enter the graph.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from symgen.basis import Factoring
from symgen.chain import REVOLUTE, Array, Chain
from symgen.formula import rounded
from symgen.inertia import parameter_scale
from symgen.kinematics import MOMENTS

#: Order in which a link's parameters are tried as carriers of alpha, in frames with z the joint axis. Mass, height of
#: the centre of mass and L_yy come last: their effect can be had from the link before, and a massless composite body
#: makes the cheapest recursion.
_CARRIERS = (9, 5, 7, 8, 4, 1, 2, 6, 3, 0)

#: A parameter is taken when its part outside the span of those taken before is larger than this share of it, and of a share of the
#: largest: what is left of one that hardly matters is rounding. Then that is taken of which most is outside, or nearly so.
_PASSES, _SMALL, _MOST = (0.3, 0.03), 0.1, 0.99

#: Below this, relative to the sum of the magnitudes it came from, a number is rounding of zero.
_ZERO = 1e-13

#: A scalar of the graph, or a number; 0.0 where there is nothing.
Scalar = Any


@dataclass(frozen=True)
class Graph:
    """Symbols q [n, rad or m] and alpha [D], and J [n, n] over them (structural zeros not stored)."""

    q: ca.SX
    alpha: ca.SX
    J: ca.SX


def inertia_graph(factoring: Factoring) -> Graph:
    """Returns J(q, alpha) [n, n] as one composite-rigid-body recursion (Featherstone 2008, table 6.2)."""
    n, D = factoring.chain.n, len(factoring.alphas)
    q, alpha = ca.SX.sym("q", n), ca.SX.sym("alpha", D)
    turns = [_onto(joint.axis) for joint in factoring.chain.joints]
    phi = _parameters(factoring, turns, ca.vertsplit(alpha))
    return Graph(q, alpha, _composite(factoring.chain, turns, phi, ca.vertsplit(q)))


def _parameters(factoring: Factoring, turns: list[Array], alpha: list[ca.SX]) -> list[Scalar]:
    """Parameters [10 n] in the turned frames, zero but for the carriers, with W phi = alpha."""
    free = factoring.free.reshape(-1, 10)
    to_link = [_parameters_turned(turn) for turn in turns]
    # A believed zero is one in the link's own axes: there its links choose their carriers, unless axes are only renamed.
    own = [
        not there.all() and not np.isin(turn, (-1.0, 0.0, 1.0)).all() for there, turn in zip(free, turns, strict=True)
    ]
    W = [
        factoring.W[:, 10 * k : 10 * k + 10] @ (np.eye(10) if own[k] else to_link[k]) for k in range(factoring.chain.n)
    ]
    columns, inverse = carriers(np.hstack(W), parameter_scale(factoring.chain), sparse=not factoring.cost)
    phi: list[Scalar] = [0.0] * factoring.free.size
    for column, row in zip(columns, inverse, strict=True):
        phi[column] = _sum(*(_product(float(row[k]), alpha[k]) for k in np.flatnonzero(row)))
    for k in np.flatnonzero(own):
        turned, block = _parameters_turned(turns[k].T), phi[10 * k : 10 * k + 10]
        phi[10 * k : 10 * k + 10] = [_sum(*map(_product, map(rounded, row), block)) for row in turned.tolist()]
    return phi


def carriers(W: Array, scale: Array, *, sparse: bool = True) -> tuple[list[int], Array]:
    """Returns D columns of W [D, 10 n] that carry alpha, and the inverse [D, D] of W restricted to them.

    `scale` [10 n] makes columns comparable. `sparse`: the inverse is to have few numbers rather than small ones, which where constants
    were dropped would make more of what they cost. It is computed without BLAS and rounded: same on any processor.
    """
    D, width = W.shape
    order = np.array([10 * k + a for k in range(width // 10) for a in _CARRIERS])
    left = (W / scale / np.linalg.norm(W / scale, axis=1)[:, None]).T[order]
    size = np.linalg.norm(left, axis=1)
    size = np.maximum(size, _SMALL * size.max())
    columns: list[int] = []
    while len(columns) < D:
        outside = np.linalg.norm(left, axis=1)
        enough = (*(share * size for share in _PASSES if sparse), _MOST * outside.max())
        at = next(int(np.argmax(outside > least)) for least in enough if (outside > least).any())
        columns.append(int(order[at]))
        direction = left[at] / outside[at]
        left = left - np.outer(left @ direction, direction)
    columns.sort()
    return columns, _inverse(np.vectorize(rounded)(W[:, columns]))


def _inverse(B: Array) -> Array:
    """Gauss-Jordan with row pivoting, elementwise operations only; entries that are rounding of zero are zero. Rows are made alike first,
    by powers of two: constants that hardly matter have small ones."""
    D = len(B)
    alike = np.exp2(-np.round(np.log2(np.abs(B).max(axis=1))))
    M = np.column_stack([B * alike[:, None], np.diag(alike)])
    for k in range(D):
        pivot = k + int(np.argmax(np.abs(M[k:, k])))
        M[[k, pivot]] = M[[pivot, k]]
        M[k] = M[k] / M[k, k]
        factors = M[:, k].copy()
        factors[k] = 0.0
        change = factors[:, None] * M[k]
        M = np.where(np.abs(M - change) > _ZERO * (np.abs(M) + np.abs(change)), M - change, 0.0)
    inverse: Array = np.vectorize(rounded)(M[:, D:])
    return inverse


def _onto(axis: Array) -> Array:
    """A rotation [3, 3] whose third column is the unit vector `axis`: signed permutation for a coordinate axis."""
    k = int(np.argmax(np.abs(axis)))
    x = np.cross(np.eye(3)[(k + 2) % 3], axis)
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def _parameters_turned(Q: Array) -> Array:
    """The map [10, 10] phi -> phi of the same body in axes turned by Q: m, Q h, Q L Q'."""
    T = np.zeros((10, 10))
    T[0, 0] = 1.0
    T[1:4, 1:4] = Q
    for column, (x, y) in enumerate(MOMENTS):
        unit = np.zeros((3, 3))
        unit[x, y] = unit[y, x] = 1.0
        turned = Q @ unit @ Q.T
        T[4:, 4 + column] = [turned[pair] for pair in MOMENTS]
    return T


@dataclass(frozen=True)
class _Axis:
    """A joint in a row of joints with parallel axes, seen from the frame before the first of them, z the axis of that one.

    Its own z is `sign` times that; its link's frame is turned by the constant `turn` [3, 3] and then about z by an angle of which
    `cs` are cosine and sine (None: by none). `step` [3, 3] and `lever` [3] lead to its frame from the link before, `along` is what it
    slides along z.
    """

    turning: bool
    sign: float
    turn: list[list[float]]
    cs: tuple[Scalar, Scalar] | None
    step: list[list[float]]
    lever: list[float]
    along: Scalar

    def vector(self, v: Sequence[Scalar]) -> list[Scalar]:
        """A vector of its link in the frame of the row."""
        v = _turned(self.turn, v)
        return v if self.cs is None else _about_z(*self.cs, v)

    def inertia(self, L: Sequence[Scalar]) -> list[Scalar]:
        """Second moments of its link in the frame of the row."""
        L = _inertia_turned(self.turn, L)
        return L if self.cs is None else _inertia_about_z(*self.cs, L)

    def momenta(self, columns: Any) -> Any:
        """Momenta [6, k] in its link in the frame of the row."""
        columns = _both(ca.sparsify(ca.DM(self.turn))) @ columns
        if self.cs is None:
            return columns
        c, s = self.cs
        return _both(ca.diagcat(ca.blockcat([[c, -s], [s, c]]), 1)) @ columns

    def of_unit_speed(self, m: Scalar, h: Sequence[Scalar], L: Sequence[Scalar]) -> Any:
        """The momentum [6] of unit speed of this joint, of what it carries, all in the frame of the row."""
        x, y, _ = h
        column = [*L[3:], _product(-1.0, y), x, 0.0] if self.turning else [y, _product(-1.0, x), 0.0, 0.0, 0.0, m]
        return ca.sparsify(ca.vertcat(*(_product(self.sign, entry) for entry in column)))


def _composite(chain: Chain, turns: list[Array], phi: list[Scalar], q: list[ca.SX]) -> Any:
    """J [n, n], tip to base: the composite body (m, h, L about the frame's origin) and the momenta of unit speeds.

    The frame of link k is the link frame turned by turns[k], so that z is its joint axis. What a row of joints with parallel axes
    carries is turned once, into the frame before the first of them: instead of it the levers between them are.
    """
    J = ca.SX(chain.n, chain.n)
    m: Scalar = 0.0
    h: list[Scalar] = [0.0] * 3
    L: list[Scalar] = [0.0] * 6
    momenta: Any = ca.SX(6, 0)  # columns: angular and linear momentum of the unit speed of joints k, k + 1, .., here
    k = chain.n
    for row in reversed(_rows(chain, turns, q)):
        for i in reversed(range(len(row))):
            k, axis = k - 1, row[i]
            own_m, own_h, own_L = phi[10 * k], phi[10 * k + 1 : 10 * k + 4], phi[10 * k + 4 : 10 * k + 10]
            if axis is row[-1]:
                h, L = axis.vector(_plus(h, own_h)), axis.inertia(_plus(L, own_L))
                momenta = axis.momenta(momenta)
            else:
                h, L = _plus(h, axis.vector(own_h)), _plus(L, axis.inertia(own_L))
            m = _sum(m, own_m)
            momenta = ca.horzcat(axis.of_unit_speed(m, h, L), momenta)
            J[k, k:] = J[k:, k] = _product(axis.sign, momenta[2 if axis.turning else 5, :])
            if k == 0:
                break
            offset = row[i - 1].vector(axis.lever) if i else [0.0, 0.0, 0.0]
            offset = _plus(offset, [0.0, 0.0, _product(axis.sign, axis.along)])
            h, L = _shifted(offset, m, h, L)
            momenta = _lever(offset) @ momenta
            if i == 0:
                h, L = _shifted(axis.lever, m, _turned(axis.step, h), _inertia_turned(axis.step, L))
                momenta = _lever(axis.lever) @ (_both(ca.sparsify(ca.DM(axis.step))) @ momenta)
    return ca.sparsify(J)


def _rows(chain: Chain, turns: list[Array], q: list[ca.SX]) -> list[list[_Axis]]:
    """The joints, base to tip, in rows of parallel axes; J does not depend on where the first joint is."""
    rows: list[list[_Axis]] = []
    turn, angle = np.eye(3), 0.0
    for k, joint in enumerate(chain.joints):
        before = turns[k - 1].T if k else np.eye(3)
        step, lever = _exactly(before @ joint.R @ turns[k]), [rounded(x) for x in before @ joint.p]
        if k and not step[:2, 2].any():
            turn = _exactly(turn @ step)
        else:
            rows.append([])
            turn, angle = np.eye(3), 0.0
        turning, sign = joint.type == REVOLUTE, float(turn[2, 2])
        if turning and k:
            angle = _sum(angle, _product(sign, q[k]))
        cs = None if _none(angle) else (ca.cos(angle), ca.sin(angle))
        along = 0.0 if turning or k == 0 else q[k]
        rows[-1].append(_Axis(turning, sign, turn.tolist(), cs, step.tolist(), lever, along))
    return rows


def _exactly(turn: Array) -> Array:
    """A rotation with rounded entries; what is rounding of zero is zero."""
    return np.array([[rounded(x) if abs(x) > _ZERO else 0.0 for x in row] for row in turn])


def _both(turn: Any) -> Any:
    """The 6x6 map that turns angular and linear momentum."""
    return ca.diagcat(turn, turn)


def _lever(p: Sequence[Scalar]) -> Any:
    """The 6x6 map of momenta to an origin from which the present one is at p: angular + p x linear."""
    x, y, z = p
    return ca.sparsify(
        ca.blockcat([[ca.DM.eye(3), ca.blockcat([[0, -z, y], [z, 0, -x], [-y, x, 0]])], [ca.DM(3, 3), ca.DM.eye(3)]])
    )


def _none(a: Scalar) -> bool:
    return isinstance(a, float) and a == 0.0


def _sum(*terms: Scalar) -> Scalar:
    """The sum of scalars, structural zeros left out."""
    there = [term for term in terms if not _none(term)]
    return sum(there[1:], there[0]) if there else 0.0


def _product(a: Scalar, b: Scalar) -> Scalar:
    """The product of scalars, structural zeros and factors of +-1 left out."""
    if _none(a) or _none(b):
        return 0.0
    if isinstance(a, float) and abs(a) == 1.0:
        return b if a > 0 else -b
    return a * b


def _plus(a: Sequence[Scalar], b: Sequence[Scalar]) -> list[Scalar]:
    return [_sum(x, y) for x, y in zip(a, b, strict=True)]


def _about_z(c: Scalar, s: Scalar, v: Sequence[Scalar]) -> list[Scalar]:
    x, y, z = v
    return [_sum(_product(c, x), _product(-s, y)), _sum(_product(s, x), _product(c, y)), z]


def _inertia_about_z(c: Scalar, s: Scalar, L: Sequence[Scalar]) -> list[Scalar]:
    """L turned about z, from one common product."""
    xx, xy, yy, xz, yz, zz = L
    u = _sum(_product(s, _sum(xx, _product(-1.0, yy))), _product(c, _product(2.0, xy)))
    su, cu = _product(s, u), _product(c, u)
    xz, yz, _ = _about_z(c, s, (xz, yz, 0.0))
    return [_sum(xx, _product(-1.0, su)), _sum(cu, _product(-1.0, xy)), _sum(yy, su), xz, yz, zz]


def _turned(R: list[list[float]], v: Sequence[Scalar]) -> list[Scalar]:
    return [_sum(*(_product(r, x) for r, x in zip(row, v, strict=True))) for row in R]


def _inertia_turned(R: list[list[float]], L: Sequence[Scalar]) -> list[Scalar]:
    xx, xy, yy, xz, yz, zz = L
    rows = zip(*(_turned(R, column) for column in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))), strict=True)  # R L
    x, y, z = (_turned(R, row) for row in rows)
    return [x[0], x[1], y[1], x[2], y[2], z[2]]


def _shifted(
    p: Sequence[Scalar], m: Scalar, h: Sequence[Scalar], L: Sequence[Scalar]
) -> tuple[list[Scalar], list[Scalar]]:
    """First moment and inertia about an origin from which the present one is at p: with g = h + m p / 2,
    L + 2 p.g - p g' - g p'."""
    half = [_product(x / 2, m) for x in p]
    g = _plus(h, half)
    x, y, z = (_product(2.0, _product(a, b)) for a, b in zip(p, g, strict=True))

    def minus(a: int, b: int) -> Scalar:
        return _product(-1.0, _sum(_product(p[a], g[b]), _product(p[b], g[a])))

    lever = [_sum(y, z), minus(0, 1), _sum(x, z), minus(0, 2), minus(1, 2), _sum(x, y)]
    return _plus(g, half), _plus(L, lever)
