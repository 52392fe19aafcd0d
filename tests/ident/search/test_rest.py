"""What is left of one joint is not lost in what is left, or noise, of another."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from ident.effects.base import Effect
from ident.effects.spring import Backlash
from ident.effects.structure import BaseCompliance
from ident.search.departures import Errors
from ident.search.rest import acts_elsewhere, is_far, is_little

BENCH: Any = SimpleNamespace(campaign=SimpleNamespace(joints=("a", "b")), split=SimpleNamespace(select=(), report=()))
PLAY = Backlash(1, (1e-4,))
#: A noise of 20 % at joint b, of 2 % at joint a.
NOISE = {"a": 0.02, "b": 0.2}


def left(monkeypatch: pytest.MonkeyPatch, a: float, b: float) -> None:
    """Errors of so many times its noise at each joint."""
    per_joint = {"a": a * NOISE["a"], "b": b * NOISE["b"]}
    told = Errors(per_joint["b"], per_joint, {}, NOISE["b"], NOISE, {})
    monkeypatch.setattr("ident.search.rest.errors", lambda bench, state, data: told)


@pytest.mark.parametrize(("a", "b", "far"), [(1.0, 0.6, False), (2.8, 0.6, False), (3.3, 0.6, True), (1.0, 3.3, True)])
def test_a_joint_far_from_its_own_noise_is_far(a: float, b: float, far: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ripple left joint a at 3.3 times its noise, beside the noise of play at joint b 0.6 times that of all: "effect-found"."""
    left(monkeypatch, a, b)
    assert is_far(BENCH, SimpleNamespace()) == far


@pytest.mark.parametrize(
    ("effect", "a", "elsewhere"),
    [
        (PLAY, 1.5, False),
        (PLAY, 3.3, True),
        (Backlash(0, (1e-4,)), 3.3, False),
        (BaseCompliance.of(None, {}), 3.3, False),
    ],
)
def test_what_another_joint_lacks_is_looked_for(
    effect: Effect, a: float, elsewhere: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However little it is of what the first effect explained; an effect of the whole arm is at every joint."""
    left(monkeypatch, a, 0.6)
    monkeypatch.setattr("ident.search.rest.reduced_chi2", lambda bench, state: 2.0)
    monkeypatch.setattr("ident.search.rest._fitting", lambda bench, state: 2.0)
    monkeypatch.setattr("ident.search.rest.share_left", lambda bench, start, state: 0.01)
    state: Any = SimpleNamespace(effects=(effect,))
    assert acts_elsewhere(BENCH, state) == elsewhere
    if effect is PLAY:
        assert is_little(BENCH, state, state) != elsewhere
