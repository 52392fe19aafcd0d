"""Newton's step towards the motion under a force that it makes itself: whatever the slopes of that force, it takes away what is left."""

from __future__ import annotations

import numpy as np
import pytest

from ident.sliding import FELT, LEFT, MOST_DENSE, along_tangent

S, OWN, DAMPING = 4096, 90.3, 0.01
RNG = np.random.default_rng(5)
ORDER = np.arange(S // 2 + 1) / OWN
GIVES = 1.0 / (1.0 - ORDER**2 + 2j * DAMPING * ORDER)  # place
RATE = 1j * ORDER * GIVES


@pytest.mark.parametrize(
    ("gives", "slope", "accuracy"),
    [
        (RATE, np.full(S, 3e4), 1e-9),  # a joint that sticks
        (
            GIVES,
            np.where(np.arange(S) % 16 < 3, 0.0, 2.7),
            1e-9,
        ),  # a spring with play: less than MOST_DENSE samples apart
        (RATE, 1e5 + 300.0 * RNG.normal(size=S), LEFT),  # more
        (GIVES, 3.0 + FELT * 1e-4 * RNG.normal(size=S), 1e-3),
    ],
)
def test_the_step_takes_away_what_is_left(gives: np.ndarray, slope: np.ndarray, accuracy: float) -> None:
    left = RNG.normal(size=S)
    step = along_tangent(gives, slope, left)
    missed = step + np.fft.irfft(gives * np.fft.rfft(slope * step), S) - left
    assert np.linalg.norm(missed) < 1.01 * accuracy * np.linalg.norm(left)


def test_more_samples_apart_than_are_solved_for_directly_agree_with_those_that_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    slope = np.where(np.arange(S) % 16 < 3, 0.2, 0.3)
    left = RNG.normal(size=S)
    directly = along_tangent(GIVES, slope, left)
    monkeypatch.setattr("ident.sliding.MOST_DENSE", MOST_DENSE // 10)
    assert np.linalg.norm(along_tangent(GIVES, slope, left) - directly) < 5.0 * LEFT * np.linalg.norm(directly)
