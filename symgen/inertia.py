"""Chain -> every J_ij(q) as an exact sparse polynomial: a table of monomials times the bodies' inertial parameters.

A body's ten parameters phi (see `chain.PARAMETERS`) seen from another frame are T(R, p) phi, with T quadratic in (R, p).
J_ij is a row vector over phi, and walking outwards along the arm multiplies that row by T of one joint after another.
Each joint enters through {1, c, s, c^2, c s} (s^2 = 1 - c^2 used up) or {1, q, q^2}, so one digit a joint names a
monomial and no product ever has to be simplified. In a run of parallel axes the cumulative angle takes the place of the
joint angle: the frame is not turned with each joint, only shifted by R(psi_k) p_(k+1), and turned once, at the body in
question; this gives the paper's c_2 c_23 (17) in place of c_2^2 c_3 - c_2 s_2 s_3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from symgen.chain import REVOLUTE, Array, Chain, skew
from symgen.kinematics import MOMENTS, energy_row, motion

#: Angle (or slide) of one digit: the joints whose values are summed, with their signs.
Angle = tuple[tuple[int, int], ...]

#: Entries below this, relative to the arm's own length scale, are rounding of an exact zero. Not more: the small true
#: coefficients of an arm whose axes are nearly, but not quite, parallel add up over thousands of monomials.
ZERO = 4e-15

#: Entries with more monomials than this are not written out: only those up to `LOW_DEGREE` are, which name the same
#: constants (how many there are `basis` finds from J at postures). A general arm of 8 joints has 78125 in J_11.
MOST_MONOMIALS = 20_000
LOW_DEGREE = 3


def _products() -> NDArray[np.int64]:
    """Where M1_ac M2_bd, M1_bd M2_ac, M1_ad M2_bc, M1_bc M2_ad stand in the outer product, for moments ab and cd [4, 6, 6]."""
    (a, b), (c, d) = np.array(MOMENTS).T[:, :, None], np.array(MOMENTS).T[:, None, :]
    pairs = [((a, c), (b, d)), ((b, d), (a, c)), ((a, d), (b, c)), ((b, c), (a, d))]
    return np.array([27 * x + 9 * y + 3 * u + v for (x, y), (u, v) in pairs])


_PRODUCTS = _products()
_MIXED = np.array([x != y for x, y in MOMENTS])

#: A run of parallel axes is accepted when the axes differ by less than this (they are snapped before).
PARALLEL = 1e-13


@dataclass(frozen=True)
class Entry:
    """One entry J_ij(q) = f(q) A phi, f the monomials.

    `digits` [M, p] says which function of each of the p `angles` a monomial uses: 0..4 for 1, c, s, c^2, c s of a turning
    joint, 0..2 for 1, q, q^2 of a sliding one. `A` [M, 10 n] multiplies the parameters of all bodies; its unit is that of
    J_ij per parameter. Joints are counted from 0. Not `complete`: too many monomials, the higher degrees are left out.
    """

    i: int
    j: int
    angles: tuple[Angle, ...]
    turning: tuple[bool, ...]
    digits: NDArray[np.int8]
    A: Array
    complete: bool = True


def length_scale(chain: Chain) -> float:
    """Returns half the reach of the arm [m] (1 for an arm without offsets): makes m l^2, m r l and L comparable."""
    reach = sum(float(np.linalg.norm(joint.p)) for joint in chain.joints[1:])
    return reach / 2 if reach > 0 else 1.0


def parameter_scale(chain: Chain) -> Array:
    """Returns the scale [10 n] that makes a row over phi comparable column by column: l^2 for m, l for m r, 1 for L."""
    length = length_scale(chain)
    return np.tile([length**2, *[length] * 3, *[1.0] * 6], chain.n)


def _turn(M1: Array, M2: Array) -> Array:
    """The 6x6 map L -> (M1 L M2' + M2 L M1') / 2 on the six entries of a symmetric L."""
    straight, mirrored, crossed, back = np.multiply.outer(M1, M2).ravel()[_PRODUCTS]
    out: Array = (straight + mirrored + np.where(_MIXED, crossed + back, 0.0)) / 2
    return out


def _lever(p: Array) -> Array:
    """The 6x3 map h -> L of a shift by p: 2 p.h 1 - p h' - h p'."""
    out = np.zeros((6, 3))
    for row, (x, y) in enumerate(MOMENTS):
        out[row, y] -= p[x]
        out[row, x] -= p[y]
        if x == y:
            out[row] += 2 * p
    return out


def _square(a: Array, b: Array) -> Array:
    """The bilinear map m -> L [6] of a shift: (a.b) 1 - (a b' + b a') / 2."""
    return np.array([(x == y) * (a @ b) - (a[x] * b[y] + a[y] * b[x]) / 2 for x, y in MOMENTS])


class _Body:
    """Maps of a row over the ten parameters of a body: row_B = row_A T for a frame B placed in a frame A."""

    @staticmethod
    def rotation(R: Array) -> Array:
        T = np.zeros((10, 10))
        T[0, 0] = 1.0
        T[1:4, 1:4] = R
        T[4:, 4:] = _turn(R, R)
        return T

    @staticmethod
    def shift(p: Array) -> Array:
        T = np.eye(10)
        T[1:4, 0] = p
        T[4:, 1:4], T[4:, 0] = _lever(p), _square(p, p)
        return T

    @staticmethod
    def turn(axis: Array) -> list[Array]:
        """A turn by psi about `axis`: the coefficients of 1, c, s, c^2, c s."""
        A0 = np.outer(axis, axis)
        A1, A2 = np.eye(3) - A0, skew(axis)
        maps = [np.zeros((10, 10)) for _ in range(5)]
        maps[0][0, 0] = 1.0
        for T, M in zip(maps, (A0, A1, A2), strict=False):
            T[1:4, 1:4] = M
        maps[0][4:, 4:] = _turn(A0, A0) + _turn(A2, A2)
        maps[1][4:, 4:] = 2 * _turn(A0, A1)
        maps[2][4:, 4:] = 2 * _turn(A0, A2)
        maps[3][4:, 4:] = _turn(A1, A1) - _turn(A2, A2)
        maps[4][4:, 4:] = 2 * _turn(A1, A2)
        return maps

    @staticmethod
    def swing(axis: Array, p: Array) -> list[Array]:
        """A shift by R(psi) p, R about `axis`, without turning the frame: the coefficients of 1, c, s, c^2, c s."""
        p0 = axis * (axis @ p)
        p1, p2 = p - p0, skew(axis) @ p
        maps = [np.zeros((10, 10)) for _ in range(5)]
        maps[0] += np.eye(10)
        for T, part in zip(maps, (p0, p1, p2), strict=False):
            T[1:4, 0] += part
            T[4:, 1:4] += _lever(part)
        maps[0][4:, 0] = _square(p0, p0) + _square(p2, p2)
        maps[1][4:, 0] = 2 * _square(p0, p1)
        maps[2][4:, 0] = 2 * _square(p0, p2)
        maps[3][4:, 0] = _square(p1, p1) - _square(p2, p2)
        maps[4][4:, 0] = 2 * _square(p1, p2)
        return maps

    @staticmethod
    def slide(axis: Array) -> list[Array]:
        """A shift by q along `axis`: the coefficients of 1, q, q^2."""
        maps = [np.eye(10), np.zeros((10, 10)), np.zeros((10, 10))]
        maps[1][1:4, 0] = axis
        maps[1][4:, 1:4] = _lever(axis)
        maps[2][4:, 0] = _square(axis, axis)
        return maps


class _Twist:
    """The same maps for the row (omega, u) of a twist at the frame's origin: omega_B = R' omega, u_B = R' (u + omega x p)."""

    @staticmethod
    def rotation(R: Array) -> Array:
        return np.kron(np.eye(2), R)

    @staticmethod
    def shift(p: Array) -> Array:
        T = np.eye(6)
        T[:3, 3:] = skew(p)  # row: omega x p = (-[p]x omega)' = omega' [p]x
        return T

    @staticmethod
    def turn(axis: Array) -> list[Array]:
        A0 = np.outer(axis, axis)
        return [np.kron(np.eye(2), M) for M in (A0, np.eye(3) - A0, skew(axis))]

    @staticmethod
    def swing(axis: Array, p: Array) -> list[Array]:
        p0 = axis * (axis @ p)
        maps = [_Twist.shift(part) for part in (p0, p - p0, skew(axis) @ p)]
        return [maps[0], maps[1] - np.eye(6), maps[2] - np.eye(6)]

    @staticmethod
    def slide(axis: Array) -> list[Array]:
        return [np.eye(6), _Twist.shift(axis) - np.eye(6)]


def _runs(chain: Chain, first: int) -> Iterator[list[int]]:
    """Yields the joints first.. in runs of consecutive turning joints with parallel axes."""
    run: list[int] = []
    for k in range(first, chain.n):
        joint = chain.joints[k]
        if run:
            previous = chain.joints[run[-1]]
            parallel = previous.type == joint.type == REVOLUTE and (
                float(np.linalg.norm(skew(previous.axis) @ joint.R @ joint.axis)) < PARALLEL
            )
            if not parallel:
                yield run
                run = []
        run.append(k)
    if run:
        yield run


def _signs(chain: Chain, run: list[int]) -> list[int]:
    """+1 or -1 for each joint of a run: whether its axis points along the first one's."""
    signs = [1]
    for k in run[1:]:
        joint = chain.joints[k]
        signs.append(signs[-1] * (1 if (joint.R @ joint.axis) @ chain.joints[k - 1].axis > 0 else -1))
    return signs


def angles(chain: Chain, first: int) -> tuple[Angle, ...]:
    """Returns the angle of each joint from `first` on: itself, or the cumulative angle in its run of parallel axes."""
    return _angles([(run, _signs(chain, run)) for run in _runs(chain, first)])


def _angles(runs: list[tuple[list[int], list[int]]]) -> tuple[Angle, ...]:
    out: list[Angle] = []
    for run, signs in runs:
        out += [tuple(zip(run[: k + 1], signs[: k + 1], strict=True)) for k in range(len(run))]
    return tuple(out)


class Maps:
    """The maps of the joints of one chain, each computed once: from the frame before a joint to the one behind it."""

    def __init__(self, chain: Chain):
        self.chain = chain
        self._made: dict[tuple[type[_Body | _Twist], str, int, int], list[Array]] = {}
        self._runs: dict[int, list[tuple[list[int], list[int]]]] = {}

    def runs(self, first: int) -> list[tuple[list[int], list[int]]]:
        """The joints first.. in runs of parallel axes, and the signs of those."""
        if first not in self._runs:
            self._runs[first] = [(run, _signs(self.chain, run)) for run in _runs(self.chain, first)]
        return self._runs[first]

    def placed(self, kind: type[_Body | _Twist], k: int, shifted: bool) -> Array:
        """The fixed placement of joint k: a turn, and before it a shift if `shifted`."""
        joint = self.chain.joints[k]
        return self._once(
            (kind, "placed", k, shifted),
            lambda: [kind.shift(joint.p) @ kind.rotation(joint.R) if shifted else kind.rotation(joint.R)],
        )[0]

    def moved(self, kind: type[_Body | _Twist], k: int, sign: int) -> list[Array]:
        """The motion of joint k along or about its axis, `sign` times."""
        joint = self.chain.joints[k]
        if joint.type != REVOLUTE:
            return self._once((kind, "moved", k, 1), lambda: kind.slide(joint.axis))
        return self._once((kind, "moved", k, sign), lambda: kind.turn(sign * joint.axis))

    def swung(self, kind: type[_Body | _Twist], k: int, sign: int) -> list[Array]:
        """The way to the origin of joint k + 1, which joint k swings about its axis, in a frame that is not turned."""
        p = self.chain.joints[k + 1].p
        return self._once((kind, "swung", k, sign), lambda: kind.swing(sign * self.chain.joints[k].axis, p))

    def _once(self, key: tuple[type[_Body | _Twist], str, int, int], make: Callable[[], list[Array]]) -> list[Array]:
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]


class _TooMany(Exception):
    """More than `MOST_MONOMIALS` on the way."""


#: Degree of each digit in the cosines, sines and slides.
DIGIT_DEGREE = {True: (0, 1, 1, 2, 2), False: (0, 1, 2)}


class _Walk:
    """Rows over monomials on their way from one frame to the next: keys [M] (base-5 digits), rows [M, 6 or 10].

    Only the `wanted` keys are followed, or only monomials up to `most_degree`, where given.
    """

    def __init__(self, row: Array, floor: Array, wanted: NDArray[np.int64] | None, most_degree: int | None):
        self.keys = np.zeros(1, dtype=np.int64)
        self.degree = np.zeros(1, dtype=np.int64)
        self.rows = row[None, :]
        self.floor = floor
        self.wanted = wanted
        self.most_degree = most_degree

    def constant(self, T: Array) -> None:
        self.rows = self.rows @ T

    def branch(self, maps: list[Array], position: int, turning: bool) -> _Walk:
        """The walk one joint further, zero rows and rows nobody wants left out. Raises _TooMany."""
        rows = np.concatenate([self.rows @ T for T in maps])
        keys = np.concatenate([self.keys + f * 5**position for f in range(len(maps))])
        degree = np.concatenate([self.degree + DIGIT_DEGREE[turning][f] for f in range(len(maps))])
        rows[np.abs(rows) < (self.floor if rows.shape[1] == 10 else ZERO)] = 0.0
        kept = rows.any(axis=1)
        if self.wanted is not None:
            kept &= np.isin(keys, self.wanted % 5 ** (position + 1))
        if self.most_degree is not None:
            kept &= degree <= self.most_degree
        if kept.sum() > MOST_MONOMIALS:
            raise _TooMany
        other = _Walk(rows, self.floor, self.wanted, self.most_degree)
        other.keys, other.degree, other.rows = keys[kept], degree[kept], rows[kept]
        return other

    def step(self, maps: list[Array], position: int, turning: bool) -> None:
        other = self.branch(maps, position, turning)
        self.keys, self.degree, self.rows = other.keys, other.degree, other.rows


def derive(chain: Chain, i: int, j: int, wanted: NDArray[np.int8] | None = None, maps: Maps | None = None) -> Entry:
    """Returns J_ij(q) (joints counted from 0, i <= j) as monomials times inertial parameters; eqs. (13)-(16) for any arm.

    `wanted` [W, p] limits the work to those monomials (digits as in `Entry`); `maps` of the same chain, if there are some,
    save work. An entry of more than `MOST_MONOMIALS` comes back with those up to `LOW_DEGREE` only, and `complete` False.
    """
    maps = Maps(chain) if maps is None else maps
    try:
        return _derive(maps, i, j, wanted, None)
    except _TooMany:
        return _derive(maps, i, j, wanted, LOW_DEGREE)


def _derive(maps: Maps, i: int, j: int, wanted: NDArray[np.int8] | None, most_degree: int | None) -> Entry:
    chain, first = maps.chain, i + 1
    base5 = 5 ** np.arange(chain.n - first, dtype=np.int64)
    length = max(length_scale(chain), 1.0)
    floor = ZERO * np.array([length**2, *[length] * 3, *[1.0] * 6])
    parts: list[tuple[int, NDArray[np.int64], Array]] = []
    start = motion(chain, i)
    row = energy_row(start, start) if i == j else start
    walk = _Walk(row, floor, None if wanted is None else wanted @ base5, most_degree)
    if i == j:
        parts.append((i, walk.keys, walk.rows))
    for run, signs in maps.runs(first):
        for k, sign in zip(run, signs, strict=True):
            joint, position = chain.joints[k], k - first
            kind: type[_Body | _Twist] = _Body if k > j else _Twist
            walk.constant(maps.placed(kind, k, k == run[0]))
            if k == j:
                walk.rows, kind = energy_row(walk.rows, motion(chain, j)), _Body
            here = walk
            turning = joint.type == REVOLUTE
            if not turning or k == run[-1]:
                walk.step(maps.moved(kind, k, sign), position, turning)
            else:
                here = walk.branch(maps.moved(kind, k, sign), position, True)
                walk.step(maps.swung(kind, k, sign), position, True)
            if k >= j:
                parts.append((k, here.keys, here.rows))
    return _collect(maps, i, j, parts, base5, most_degree is None)


def _collect(
    maps: Maps,
    i: int,
    j: int,
    parts: list[tuple[int, NDArray[np.int64], Array]],
    base5: NDArray[np.int64],
    complete: bool,
) -> Entry:
    """Puts the rows of all bodies into one table over the monomials that occur."""
    chain = maps.chain
    keys = np.unique(np.concatenate([part[1] for part in parts]))
    A = np.zeros((len(keys), 10 * chain.n))
    for k, part_keys, rows in parts:
        A[np.searchsorted(keys, part_keys), 10 * k : 10 * k + 10] += rows
    digits = ((keys[:, None] // base5) % 5).astype(np.int8)
    turning = tuple(joint.type == REVOLUTE for joint in chain.joints[i + 1 :])
    return Entry(i, j, _angles(maps.runs(i + 1)), turning, digits, A, complete)


def monomials(entry: Entry, q: Array) -> Array:
    """Returns the monomials of an entry at postures q [.., n, rad or m]: [.., M]."""
    out = np.ones((len(entry.digits), *q.shape[:-1]))
    for position, angle in enumerate(entry.angles):
        psi = sum(sign * q[..., k] for k, sign in angle)
        if entry.turning[position]:
            c, s = np.cos(psi), np.sin(psi)
            table = np.stack([np.ones_like(c), c, s, c * c, c * s])
        else:
            table = np.stack([np.ones_like(psi), psi, psi * psi])
        out *= table[entry.digits[:, position]]
    return np.moveaxis(out, 0, -1)
