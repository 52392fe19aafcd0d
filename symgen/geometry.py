"""The lengths of an arm, and what the derivation's coefficients are as polynomials in them.

A coefficient of J_ij has one unit, so it is homogeneous: of degree 2 in the lengths in front of m, 1 in front of m r, 0 in
front of L (less for a sliding joint). A few exact evaluations of the derivation at lengths 0 and 1 m therefore give it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from symgen.chain import Array, Chain
from symgen.inertia import Entry, Maps, derive, length_scale
from symgen.kinematics import MOMENTS

#: Offsets below this, relative to the arm's size, are rounding of zero (composed fixed transforms).
_NO_LENGTH = 1e-12


@dataclass(frozen=True)
class Length:
    """One component of the offset from joint `link` to the next (joints from 1): a length of that link.

    `axis` 0 x, 1 y, 2 z of the link frame; `alone` if the other two are zero; `value` [m] and sign as in the URDF, which
    states it as the origin of `joint`.
    """

    link: int
    axis: int
    alone: bool
    value: float
    joint: str


def lengths(chain: Chain) -> list[Length]:
    """Returns the lengths of the arm, base to tip. The offset of the first joint is none: J(q) does not depend on it."""
    found = []
    for link, joint in enumerate(chain.joints[1:], start=1):
        components = np.flatnonzero(np.abs(joint.p) > _NO_LENGTH * length_scale(chain)).tolist()
        found += [Length(link, a, len(components) == 1, float(joint.p[a]), joint.name) for a in components]
    return found


def at_right_angles(chain: Chain) -> bool:
    """Returns whether all axes and fixed rotations behind the first joint are along coordinate axes: the coefficients of
    the polynomials are then whole numbers."""
    exact = [np.isin(joint.R, (-1.0, 0.0, 1.0)).all() for joint in chain.joints[1:]]
    return all(exact) and all(np.isin(joint.axis, (-1.0, 0.0, 1.0)).all() for joint in chain.joints)


class Units:
    """The `lengths` of an arm, and that arm without any, then with each of them alone, 1 m long: their maps serve all entries."""

    def __init__(self, chain: Chain) -> None:
        self.lengths = lengths(chain)
        self.maps = [Maps(_with_unit_length(chain, length)) for length in (None, *self.lengths)]


def polynomials(units: Units, entry: Entry, monomials: Sequence[int], powers: Sequence[int]) -> Array:
    """Returns the coefficients of some monomials of J_ij as polynomials in the L lengths: [A, 10 n, 1 + L, 1 + L].

    `monomials` [A] are rows of `entry`, `powers` [A] the power of m in their unit (2 for kg m2). Of the last two indices
    0 means no length, k length k - 1 of `lengths`, in ascending order. From lengths 0 and 1 at a time come L and m r; a
    mass on the origin of the next link is a point mass of this one, which gives m.
    """
    named, n = units.lengths, units.maps[0].chain.n
    degree = np.add.outer(np.asarray(powers), np.tile([0, *[-1] * 3, *[-2] * 6], n))
    table = np.zeros((len(monomials), 10 * n, 1 + len(named), 1 + len(named)))
    for a, (length, maps) in enumerate(zip([None, *named], units.maps, strict=True)):
        if length is None or length.link > entry.i:  # links before joint i do not move with it
            table[..., 0, a] = np.where(degree == min(a, 1), _rows(maps, entry, monomials), 0.0)
    square = degree[:, 0] == 2
    for k in range(entry.j, n - 1):
        table[square, 10 * k + 10] = (table[:, 10 * k] + _point_mass(table, named, k))[square]
    return table


def _point_mass(table: Array, named: list[Length], k: int) -> Array:
    """What m r and L of a unit mass at the end of link k (from 0) add: [A, 1 + L, 1 + L]."""
    out = np.zeros((len(table), *table.shape[2:]))
    here = [(a, length.axis) for a, length in enumerate(named, start=1) if length.link == k + 1]
    for a, x in here:
        out[:, :, a] += table[:, 10 * k + 1 + x, 0, :]
        for moment, (y, z) in enumerate(MOMENTS):
            if y == z != x:
                out[:, a, a] += table[:, 10 * k + 4 + moment, 0, 0]
        for b, y in here:
            if x < y:
                out[:, a, b] -= table[:, 10 * k + 4 + MOMENTS.index((x, y)), 0, 0]
    return out


def _with_unit_length(chain: Chain, length: Length | None) -> Chain:
    """The arm with all offsets zero, but for one length of 1 m."""
    joints = [replace(joint, p=np.zeros(3)) for joint in chain.joints]
    if length is not None:
        joints[length.link] = replace(joints[length.link], p=np.eye(3)[length.axis])
    return replace(chain, joints=tuple(joints))


def _rows(maps: Maps, entry: Entry, monomials: Sequence[int]) -> Array:
    """The coefficients [A, 10 n] of the same monomials for another arm; zero for one that vanishes there."""
    wanted: NDArray[np.int8] = entry.digits[list(monomials)]
    other = derive(maps.chain, entry.i, entry.j, wanted, maps)
    where = {digits.tobytes(): row for digits, row in zip(other.digits, other.A, strict=True)}
    nothing = np.zeros(10 * maps.chain.n)
    return np.array([where.get(digits.tobytes(), nothing) for digits in wanted])
