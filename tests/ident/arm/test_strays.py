"""How periods differ from the one that repeats, and what dry friction makes of it."""

from __future__ import annotations

import numpy as np
import pytest

from ident.arm.strays import strays
from ident.effects.friction import MotorCoulomb
from ident.effects.motion import Astray, State, over_periods

FS, S, M = 1000.0, 1000, 3
T = np.arange(M * S) / FS
REPEATING = 0.5 * np.sin(2 * np.pi * 3 * T[:S])


def at_speed(omega: np.ndarray) -> State:
    zero = np.zeros_like(omega)
    return State(zero, omega, zero, zero, zero, zero, zero, zero, 100.0, 1e4)


@pytest.mark.parametrize("step", [0.0, 5e-5], ids=["exact", "in encoder steps"])
def test_a_mean_on_its_way_and_slow_noise_are_told_from_what_repeats(step: float) -> None:
    """The record has no jump where a period ends, so the way to rest shows none either; within 2 % of the largest, noise apart."""
    away, faster = 0.1 * np.exp(-T / 0.7), -0.1 / 0.7 * np.exp(-T / 0.7)
    away, faster = away + 1e-3 * np.sin(9.2 * T), faster + 9.2e-3 * np.cos(9.2 * T)
    angle = np.tile(REPEATING, M) + away
    angle = step * np.round(angle / step) if step else angle
    found = strays(angle, REPEATING, FS, 5e-3, 4 * S)
    expected = np.interp(np.arange(4 * M * S) / (4 * FS), T, faster).reshape(M, -1)
    error = np.abs(found - expected)[:, 100:-100]
    assert error.max() < 2e-3 * np.abs(faster).max() + (4 * 5e-3 if step else 0.0)


def test_noise_of_the_angle_is_smoothed_until_it_is_as_quiet_as_asked() -> None:
    rng = np.random.default_rng(1)
    angle = np.tile(REPEATING, M) + 1e-4 * rng.standard_normal(M * S)
    for quiet in (3e-3, 1e-2):
        assert np.std(strays(angle, REPEATING, FS, quiet, S)) == pytest.approx(quiet, rel=0.15)


def test_dry_friction_over_periods_is_the_mean_of_that_in_each() -> None:
    rng = np.random.default_rng(2)
    law = MotorCoulomb(0, (0.02,)).law
    omega = 3.0 * np.sin(2 * np.pi * np.arange(2000) / 2000)
    faster = 0.1 + 0.08 * rng.standard_normal((M, 1)) + 0.02 * rng.standard_normal((M, 2000))
    found = over_periods(law, at_speed(omega), "motor", Astray.of(faster))
    expected = np.mean([law(at_speed(omega + more)) for more in faster], axis=0)
    of_the_mean = law(at_speed(omega + faster.mean(axis=0)))
    assert np.abs(found - expected).max() < 1e-4 * 0.02
    assert np.abs(of_the_mean - expected).max() > 0.02 * 0.02
    assert over_periods(law, at_speed(omega), "motor", None) == pytest.approx(law(at_speed(omega)))


def test_a_period_in_which_a_transient_died_away_tells_nothing_of_the_others() -> None:
    angle = np.tile(REPEATING, M) + 0.1 * np.exp(-T / 0.02) + 1e-4 * np.sin(9.2 * T)
    found = strays(angle, REPEATING, FS, 5e-3, S)
    assert found.shape == (M - 1, S)
    assert np.abs(found).max() < 2e-3
