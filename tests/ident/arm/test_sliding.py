"""Newton's step towards the motion under a force that it makes itself: whatever the slopes of that force, it takes away what is left."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ident.arm.sliding import FELT, LEFT, SLID, SOON, TURNS, Where, along_tangent, in_turns, in_turns_at_once, settled

S, OWN, DAMPING = 4096, 90.3, 0.1
RNG = np.random.default_rng(5)
ORDER = np.arange(S // 2 + 1) / OWN
GIVES = 1.0 / (1.0 - ORDER**2 + 2j * DAMPING * ORDER)  # place
RATE = 1j * ORDER * GIVES


STICKS = np.where(np.arange(S) % 2048 < 1000, 3e4, 0.0)  # in half of each of two swings
PLAY = np.where(np.arange(S) % 16 < 3, 0.0, 2.7)


@pytest.mark.parametrize(
    ("gives", "slope", "accuracy"),
    [
        pytest.param(RATE, np.full(S, 3e4), 1e-9, id="a joint that sticks"),
        pytest.param(RATE, STICKS, 1e-9, id="a joint that sticks in parts: as many directions"),
        pytest.param(GIVES, np.where(np.arange(S) < 48, PLAY, 2.7), 1e-9, id="a spring with play at a few samples"),
        pytest.param(GIVES, PLAY, LEFT, id="at more"),
        pytest.param(RATE, 1e5 + 300.0 * RNG.normal(size=S), LEFT, id="at all, and more than are solved for directly"),
        pytest.param(GIVES, 3.0 + FELT * 1e-4 * RNG.normal(size=S), 1e-3, id="nothing felt"),
    ],
)
def test_the_step_takes_away_what_is_left(gives: np.ndarray, slope: np.ndarray, accuracy: float) -> None:
    left = RNG.normal(size=S)
    step = along_tangent(gives, slope, left)
    missed = step + np.fft.irfft(gives * np.fft.rfft(slope * step), S) - left
    assert np.linalg.norm(missed) < 1.01 * accuracy * np.linalg.norm(left)


def test_a_slope_that_hardly_differs_takes_few_directions_however_many_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    few = S // 2
    slope = 0.3 + 0.1 * np.cos(4.0 * np.pi * np.arange(few) / few)
    gives, left = GIVES[: few // 2 + 1], RNG.normal(size=few)
    monkeypatch.setattr("ident.arm.sliding.MOST_DENSE", few)
    soon = along_tangent(gives, slope, left)
    monkeypatch.setattr("ident.arm.sliding.AT_ONCE", few)
    directly = along_tangent(gives, slope, left)
    assert 0.0 < np.linalg.norm(soon - directly) < 5.0 * LEFT * np.linalg.norm(directly)


@pytest.mark.parametrize(
    ("level", "turns"), [(50.0, SOON), (0.3, TURNS)]
)  # it sticks all the time; it slides in every swing
def test_the_motion_is_that_which_friction_leaves(level: float, turns: int) -> None:
    lines = np.arange(1, 400, 2)
    scene: Any = SimpleNamespace(samples=S, lines=lines)
    Y = RATE[lines]
    pushed = np.array([1.0, 1j]) @ np.random.default_rng(0).normal(size=(2, len(lines))) / (1.0 + (lines / 60.0) ** 2)
    v0 = Y * pushed

    def law(v: np.ndarray) -> np.ndarray:
        return np.asarray(level * np.tanh(v / 1e-3))

    def friction(where: Where) -> Callable[[np.ndarray], np.ndarray]:
        return law

    g = 0.5 / float(np.median(np.abs(Y)))
    start = np.zeros(S)
    _, _, (v, _) = in_turns(scene, friction, g, v0, Y, [start], turns)
    spectrum, force = np.zeros((2, S // 2 + 1), dtype=complex)
    spectrum[lines], force[:] = v0 * (S / 2), np.fft.rfft(law(v.astype(float)))
    gives = np.append(np.zeros(1), Y[-1] * lines[-1] / np.arange(1, S // 2 + 1))
    gives[lines] = Y
    left = v - np.fft.irfft(spectrum - gives * force, S)
    assert g * np.linalg.norm(left) < 1.5 * SLID * np.linalg.norm(law(v) + g * v)
    assert (np.linalg.norm(v) < 1e-4 * np.linalg.norm(np.fft.irfft(spectrum, S))) == (level == 50.0)


def test_the_motions_of_two_ports_that_move_each_other_are_those_which_friction_leaves_both() -> None:
    """One sticks all the time, the other slides; what acts at one moves the other nearly as far as itself, in one mode that is hardly damped,
    which takes many turns."""
    lines, levels = np.arange(1, 400, 2), (50.0, 0.3)
    scene: Any = SimpleNamespace(samples=S, lines=lines)
    Y = RATE[lines][:, None, None] * np.array([[1.0, 0.9], [0.9, 1.0]])
    pushed = np.array([1.0, 1j]) @ np.random.default_rng(0).normal(size=(2, len(lines), 2)).swapaxes(0, 1)
    v0 = (Y @ (pushed / (1.0 + (lines[:, None] / 60.0) ** 2))[..., None])[..., 0]
    laws = [lambda v, level=level: np.asarray(level * np.tanh(v / 1e-3)) for level in levels]
    frictions = [lambda where, law=law: law for law in laws]
    g = 0.5 / np.median(np.abs(Y[:, [0, 1], [0, 1]]), axis=0)
    starts, undriven = [np.full(S, 1e-3), np.full(S, 1e-3)], np.zeros((S // 2 + 1, 2), dtype=complex)
    forces, rises, ends = in_turns_at_once(scene, frictions, g, v0, Y, starts, 20 * TURNS, [0.0, 0.0], undriven)
    v = np.stack([told.astype(float) for told, _ in ends])
    f = np.stack([law(at) for law, at in zip(laws, v, strict=True)])
    alone, gives = np.zeros((S // 2 + 1, 2), dtype=complex), np.zeros((S // 2 + 1, 2, 2), dtype=complex)
    gives[1:] = Y[-1] * (lines[-1] / np.arange(1, S // 2 + 1))[:, None, None]
    alone[lines], gives[lines] = v0 * (S / 2), Y
    left = v - np.fft.irfft((alone - (gives @ np.fft.rfft(f).T[..., None])[..., 0]).T, S)
    for k in range(2):
        assert g[k] * np.linalg.norm(left[k]) < 3.0 * SLID * np.linalg.norm(f[k] + g[k] * v[k])
    assert rises and np.std(v[0]) < 1e-3 * np.std(v[1])
    assert forces[1].lines == pytest.approx(-np.fft.rfft(ends[1][1])[lines] * (2.0 / S), abs=1e-2)


def test_turns_that_run_away_end_without_a_word(capfd: pytest.CaptureFixture[str]) -> None:
    """Of what overflows LAPACK says, beside all output, that it is no number."""
    changes = iter([size * RNG.normal(size=8) for size in (1.0, 1.0, 1e90, 1e180, np.nan)])
    with np.errstate(all="ignore"):
        w = settled(lambda w: next(changes), np.ones(8), TURNS)
    assert len(w) == 8 and capfd.readouterr() == ("", "")
