"""Exact rotations: right where scipy is right, and exactly zero or one where scipy is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from symgen.angles import ROUNDING, SNAP, about, cos_sin, from_rpy, snaps_of_rpy, unit_axis

EPS = np.finfo(float).eps


@pytest.mark.parametrize("k", range(-30, 31))
def test_multiples_of_15_degrees_are_exact_and_others_untouched(k: int) -> None:
    angle = k * np.pi / 12
    c, s = cos_sin(angle + 0.9 * SNAP, SNAP)
    # |angle| eps: the angle itself is rounded before cos and sin see it
    np.testing.assert_allclose([c, s], [np.cos(angle), np.sin(angle)], rtol=0, atol=(2 + abs(angle)) * EPS)
    if k % 6 == 0:
        assert {abs(c), abs(s)} == {0.0, 1.0}
    if k % 4 == 0 and k % 12:
        assert abs(c) == 0.5
    assert cos_sin(angle + 1.1 * SNAP, SNAP) == (np.cos(angle + 1.1 * SNAP), np.sin(angle + 1.1 * SNAP))


def test_rpy_and_axis_angle_agree_with_scipy() -> None:
    rng = np.random.default_rng(5)
    for rpy in rng.uniform(-7, 7, (200, 3)):
        np.testing.assert_allclose(
            from_rpy(rpy, ROUNDING), Rotation.from_euler("xyz", rpy).as_matrix(), rtol=0, atol=20 * EPS
        )
        axis, _ = unit_axis(rpy, ROUNDING)
        judge = Rotation.from_rotvec(axis * rpy[0]).as_matrix()
        np.testing.assert_allclose(about(axis, rpy[0], ROUNDING), judge, rtol=0, atol=20 * EPS)


def test_right_angles_give_signed_permutations() -> None:
    for rpy in np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3), axis=-1).reshape(-1, 3):
        literal, exact = rpy * 1.5708, rpy * np.pi / 2
        R = from_rpy(literal, SNAP)
        assert set(np.unique(R)) <= {-1.0, 0.0, 1.0}
        moved = np.abs(literal - exact).sum()
        np.testing.assert_allclose(R, Rotation.from_euler("xyz", literal).as_matrix(), rtol=0, atol=moved + 20 * EPS)


def test_only_angles_that_really_move_are_reported() -> None:
    assert snaps_of_rpy("j", [np.pi / 2, 1.57079632679, 0.3], SNAP) == []
    (pitch,) = snaps_of_rpy("j", [0.0, -2.35619, 1.57], SNAP)  # 1.57 is 8e-4 off pi/2: what the vendor says
    assert (pitch.joint, pitch.found, pitch.snapped, pitch.text) == ("j", -2.35619, -9 * np.pi / 12, "-3pi/4")
    words = [snaps_of_rpy("j", [k * np.pi / 12 + 1e-5, 0, 0], SNAP)[0].text for k in (0, 1, 2, 6, 8, 12, -12, 24)]
    assert words == ["0", "pi/12", "pi/6", "pi/2", "2pi/3", "pi", "-pi", "2pi"]


def test_axes_within_the_tolerance_become_coordinate_axes() -> None:
    axis, moved = unit_axis([3e-4, 0.0, -5.0], SNAP)
    assert (axis.tolist(), moved) == ([0.0, 0.0, -1.0], pytest.approx(6e-5))
    axis, moved = unit_axis([6e-4, 0.0, -5.0], SNAP)
    assert moved == 0.0
    np.testing.assert_allclose(axis, np.array([6e-4, 0.0, -5.0]) / np.hypot(6e-4, 5.0), rtol=4 * EPS)
