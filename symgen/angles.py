"""Rotations with exact zeros and ones, and the angles that had to be moved to get them.

A URDF writes pi/2 as 1.5708. Taken literally that turns 1293 monomials of a 7-axis arm into 8795 and adds spurious
unknowns; moved to the exact value it changes J by 6e-7. Angles only: lengths and masses are the vendor's.
"""

from __future__ import annotations

from fractions import Fraction
from math import cos, hypot, pi, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike

from symgen.chain import Array, Snap, skew

SNAP = 1e-4  # rad: 1.5708 is 4e-6 off pi/2, 3.1415 is 9e-5 off pi; a degree-rounded or calibrated angle is further away
ROUNDING = 1e-9  # rad: 1.57079632679 is pi/2 as meant; set exactly, and not worth a report
_STEP = pi / 12
_NOISE = 4e-16  # rounding of products of two rotations
_COS = (
    1.0,
    (sqrt(6) + sqrt(2)) / 4,
    sqrt(3) / 2,
    sqrt(2) / 2,
    0.5,
    (sqrt(6) - sqrt(2)) / 4,
    0.0,
)  # of k pi/12, k = 0..6


def nearest(angle: float, tolerance: float) -> int | None:
    """Returns k if `angle` [rad] is within `tolerance` [rad] of k pi/12, else None."""
    k = round(angle / _STEP)
    return k if abs(angle - k * _STEP) <= tolerance else None


def cos_sin(angle: float, tolerance: float) -> tuple[float, float]:
    """Returns cos and sin of `angle` [rad], of the exact multiple of pi/12 if one is within `tolerance` [rad]."""
    k = nearest(angle, tolerance)
    return (cos(angle), sin(angle)) if k is None else (_cos_of_step(k), _cos_of_step(k - 6))


def _cos_of_step(k: int) -> float:
    k = abs((k + 12) % 24 - 12)  # cos is even and 2 pi periodic: k in 0..12
    return _COS[k] if k <= 6 else -_COS[12 - k]


def cleaned(R: ArrayLike) -> Array:
    """Returns the rotation R [3, 3] with entries within rounding of 0, 1 and -1 set to them."""
    R = np.array(R, dtype=float)
    whole = np.round(R)
    return np.where(np.abs(R - whole) <= _NOISE, whole + 0.0, R)


def from_rpy(rpy: ArrayLike, tolerance: float) -> Array:
    """Returns Rz(yaw) Ry(pitch) Rx(roll) [3, 3] for (roll, pitch, yaw) [3, rad] (URDF's fixed-axis convention)."""
    R = np.eye(3)
    for axis, angle in zip(np.eye(3), np.asarray(rpy, dtype=float), strict=True):
        if angle:
            R = cleaned(about(axis, float(angle), tolerance) @ R)
    return R


def about(axis: ArrayLike, angle: float, tolerance: float) -> Array:
    """Returns the rotation [3, 3] by `angle` [rad] about the unit vector `axis` [3] (Rodrigues)."""
    c, s = cos_sin(angle, tolerance)
    k = np.asarray(axis, dtype=float)
    return cleaned(c * np.eye(3) + s * skew(k) + (1.0 - c) * np.outer(k, k))


def unit_axis(axis: ArrayLike, tolerance: float) -> tuple[Array, float]:
    """Returns the direction of `axis` [3] as a unit vector, and the angle [rad] by which it was moved.

    A direction within `tolerance` [rad] of a coordinate axis becomes that axis. The axis must not be zero.
    """
    axis = np.asarray(axis, dtype=float)
    unit = axis / np.linalg.norm(axis)
    main = int(np.argmax(np.abs(unit)))
    rest = np.delete(unit, main)
    tilt = hypot(*rest)  # sin of the angle to the coordinate axis, equal to it within tilt^3/6
    if tilt > tolerance:
        return unit, 0.0
    return np.eye(3)[main] * np.sign(unit[main]) + 0.0, float(tilt)


def snaps_of_rpy(where: str, rpy: ArrayLike, tolerance: float) -> list[Snap]:
    """Returns one Snap per angle of `rpy` [3, rad] that `from_rpy` moves by more than a rounding of its text."""
    found = []
    for angle in map(float, np.asarray(rpy, dtype=float)):
        k = nearest(angle, tolerance)
        if k is not None and abs(angle - k * _STEP) > ROUNDING:
            found.append(Snap(where, angle, k * _STEP, _in_words(k)))
    return found


def _in_words(k: int) -> str:
    """ "-3pi/4" for k = -9."""
    ratio = Fraction(k, 12)
    top, bottom = ratio.numerator, ratio.denominator
    if top == 0:
        return "0"
    sign, times = "-" if top < 0 else "", "" if abs(top) == 1 else str(abs(top))
    return f"{sign}{times}pi" + ("" if bottom == 1 else f"/{bottom}")
