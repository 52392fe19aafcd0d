"""A force marched instant by instant: that of an integrated oscillator, and of linear algebra where its law is linear."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ident.arm.marching import marched
from ident.arm.sliding import closer

S, F0 = 1024, 1.0
#: An oscillator under two harmonics: mass, damper, spring.
M, C, K = 1.0, 8.0, 400.0
PUSH = {1: 60.0 + 0j, 3: 40.0j}


def oscillator() -> tuple[np.ndarray, np.ndarray]:
    """Its position under the push alone, and what a force at one instant does, [S] each; forces are against it."""
    s = 2j * np.pi * F0 * np.arange(S // 2 + 1)
    Y = 1.0 / (M * s**2 + C * s + K)
    push = np.zeros(S // 2 + 1, dtype=complex)
    for line, amplitude in PUSH.items():
        push[line] = amplitude * S / 2
    return np.fft.irfft(Y * push, S), np.fft.irfft(-Y, S)


def test_under_a_linear_law_it_is_the_stiffer_oscillator() -> None:
    alone, gives = oscillator()
    *_, force = islice(marched(alone, np.fft.rfft(gives), lambda x: 150.0 * x, alone, np.zeros(S)), 12)
    s = 2j * np.pi * F0 * np.arange(S // 2 + 1)
    softer, stiffer = (M * s**2 + C * s + k for k in (K, K + 150.0))
    expected = 150.0 * np.fft.irfft(np.fft.rfft(alone) * softer / stiffer, S)
    assert np.abs(force - expected).max() < 1e-3 * np.abs(expected).max()


@pytest.mark.bench
def test_a_stop_that_is_hit_is_that_of_an_integrated_oscillator() -> None:
    def stop(x: np.ndarray) -> np.ndarray:
        return np.asarray(2000.0 * (np.maximum(x - 0.1, 0.0) + np.minimum(x + 0.1, 0.0)))

    def slopes(t: float, y: np.ndarray) -> list[float]:
        push = sum((a * np.exp(2j * np.pi * F0 * line * t)).real for line, a in PUSH.items())
        return [y[1], (push - C * y[1] - K * y[0] - float(stop(y[:1])[0])) / M]

    alone, gives = oscillator()
    *_, force = islice(marched(alone, np.fft.rfft(gives), stop, alone, np.zeros(S)), 15)
    t = 4.0 + np.arange(S) / S  # of the transient e^-16 is left
    integrated = solve_ivp(slopes, (0.0, 5.0), [0.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=1e-3)
    expected = stop(integrated.y[0])
    assert np.abs(alone).max() > 0.12
    assert np.std(force - expected) < 0.03 * np.std(expected)


def test_it_ends_where_the_motion_leaves_all_bounds() -> None:
    alone, gives = oscillator()
    assert len(list(islice(marched(alone, -np.fft.rfft(gives), lambda x: 5e3 * x, alone, np.ones(S)), 50))) < 50


def test_newtons_steps_find_the_motion_of_a_spring_that_stiffens() -> None:
    """From the motion under the best line through it: the same as marched until it repeats."""

    def law(x: np.ndarray) -> np.ndarray:
        return np.asarray(8.0e3 * x**3)

    alone, gives = oscillator()
    softer = -1.0 / np.fft.rfft(gives)
    v, line = alone, 0.0
    for _ in range(60):
        line = 0.7 * line + 0.3 * float(law(v) @ v / (v @ v))
        v = np.fft.irfft(np.fft.rfft(alone) * softer / (softer + line), S)
    assert line > 0.5 * K
    x, force, share = closer(law, alone, -np.fft.rfft(gives), v)
    assert left(law, alone, gives, v) > 0.1 and left(law, alone, gives, x) < 1e-4
    assert share < 1e-6 and len(force) == S
    *_, repeated = islice(marched(alone, np.fft.rfft(gives), law, alone, np.zeros(S)), 25)
    assert np.std(force - repeated) < 1e-3 * np.std(force)


def test_what_bends_at_once_is_told_by_more_samples_than_steps_are_made_with() -> None:
    def play(x: np.ndarray) -> np.ndarray:
        return np.asarray(-0.9 * K * np.clip(x, -0.05, 0.05))

    alone, gives = oscillator()
    harmonics, few = -np.fft.rfft(gives), S // 32
    harmonics[few // 2 :] = 0.0  # the motion has no more of them
    x, exact, _ = closer(play, alone, harmonics, alone)
    step = S // few
    (_, coarse, _), (_, fine, share) = (
        closer(play, alone[::step], harmonics[: few // 2 + 1], alone[::step], samples) for samples in (few, S)
    )
    lines = slice(1, few // 4)
    told = [np.fft.rfft(force)[lines] / len(force) for force in (exact, coarse, fine)]
    wrong, right = (np.linalg.norm(one - told[0]) / np.linalg.norm(told[0]) for one in told[1:])
    assert np.abs(x).max() > 0.1 and share < 1e-6
    assert right < 1e-4 and wrong > 0.01


def left(law: Callable[[np.ndarray], np.ndarray], alone: np.ndarray, gives: np.ndarray, x: np.ndarray) -> float:
    """By how much of itself a motion is not that of the force that it makes."""
    moved = alone + np.fft.irfft(np.fft.rfft(gives) * np.fft.rfft(law(x)), S)
    return float(np.std(x - moved) / np.std(x))
