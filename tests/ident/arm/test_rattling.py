"""A port that meets what it rattles between."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ident.arm.rattling import Rattling


@pytest.mark.parametrize(("last", "samples", "told"), [(1000, 8192, 4096), (4097, 32768, 16384), (2000, 32768, 8192)])
def test_samples_tell_every_line_of_a_scene(last: int, samples: int, told: int) -> None:
    rng = np.random.default_rng(0)
    lines = np.array([1, 7, last])
    s = 2j * np.pi * lines
    x0, Y = rng.normal(size=(2, 3)) + 1j * rng.normal(size=(2, 3))
    arm: Any = SimpleNamespace(
        scene=SimpleNamespace(samples=samples, lines=lines, s=s), rate=lambda key, on: (s * x0, s * Y)
    )
    rattling = Rattling(arm, ("spring", 0), {}, lambda x: x, rest=0.5, yields=0.2)
    alone, gives = rattling._moves(arm, 2.2)
    assert len(alone) == told and len(gives) == told // 2 + 1
    assert np.allclose(np.fft.rfft(alone)[lines] * 2 / told, x0) and np.isclose(alone.mean(), 0.5)
    assert np.allclose(gives[lines], Y) and np.isclose(gives[0], -0.2)
