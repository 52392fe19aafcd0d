"""Whether an arm touches itself: the same answer whatever was asked before, and nothing on standard error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arms import _FILES, arm

from symgen.collision import SelfCollision
from symgen.quiet import quiet


def test_what_was_asked_before_does_not_matter() -> None:
    """Along a path, cylinder beside cylinder on the z1: guesses kept from the posture before miss a third of the touches."""
    chain = arm("z1")
    touches = SelfCollision(chain, _FILES["z1"])
    steps = 0.05 * np.random.default_rng(0).normal(size=(1800, chain.n))
    path = np.clip(np.cumsum(steps, axis=0) % (2 * np.pi) - np.pi, *chain.limits.T)
    along = touches(path)
    assert 0.1 < along.mean() < 0.9
    assert np.array_equal(along, touches(path[::-1])[::-1])
    shuffled = np.random.default_rng(1).permutation(len(path))
    assert np.array_equal(along[shuffled], touches(path[shuffled]))


def test_what_a_library_prints_by_itself_is_not_seen(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pin = pytest.importorskip("pinocchio")
    noisy = '<robot name="r"><link name="a"><visual><geometry><box size="x"/></geometry></visual></link></robot>'
    pin.buildModelFromXML(noisy)
    assert capfd.readouterr().err, "urdfdom has something to say"
    with quiet():
        pin.buildModelFromXML(noisy)
    assert not capfd.readouterr().err
    with pytest.raises(RuntimeError, match="as it was"), quiet():
        raise RuntimeError("as it was")
    pin.buildModelFromXML(noisy)
    assert capfd.readouterr().err, "and is heard again"
