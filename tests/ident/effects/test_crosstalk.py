"""Signals of another joint in one's own: seen as that, of the right joint, and drawn to the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import final

import numpy as np
import pytest
from fitting import bench_of

from ident.effects.base import Effect, Parameter
from ident.effects.crosstalk import Crosstalk, crosstalk
from ident.effects.motion import State
from ident.search.candidates import added
from ident.search.crosstalks import crosstalks
from ident.search.curves import curves
from ident.search.refits import Bench, Refit, fitted, linearised, reduced_chi2, without_effects
from ident.search.refits import State as Fitted
from ident.search.trace import Linearised
from ident.search.tried import refitted
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=2.0, periods=3, fs=500.0))
JOINT, OTHER, SHARE = 1, 2, 0.03
CELLS = (("joint2", (0.0, 0.6, 0.9)), ("joint3", (0.0, -0.4, 1.8)))


@final
class OfAnotherAmplifier(Effect):
    """A motor that gives a share of what another one is asked for."""

    name, port = "of-another-amplifier", "motor"
    parameters = (Parameter("share", "", -1.0, 1.0, (0.01,), linear=True),)

    def loads(self, states: Sequence[State]) -> tuple[tuple[str, int, float], ...]:
        return (("motor", JOINT, self["share"] * states[OTHER].tau),)


@cache
def bench() -> Bench:
    """Short records, the same to fit, choose and report."""
    chain = chain_of_robot(SHORT)
    cells = [(joint, np.array(q)) for joint, q in CELLS]
    c = simulate(chain, SHORT, cells, effects=[OfAnotherAmplifier(JOINT, (SHARE,))], workers=1, seed=3)
    return bench_of(c, chain)


@cache
def declared() -> tuple[Fitted, Linearised]:
    start = without_effects(bench())
    return start, linearised(start.problem, start.minimum.vector)


@pytest.mark.bench
def test_what_comes_of_another_amplifier_is_drawn_to_the_noise() -> None:
    start, lin = declared()
    likely = curves(lin)[0]
    ((_, hasty),) = refitted(bench(), start, [(likely, lin)])
    state = fitted(bench(), Refit.of(hasty))
    found = state.effects[-1]
    assert isinstance(found, Crosstalk) and (found.port, found.joint, found.other) == ("motor", JOINT, OTHER)
    assert found.values[0] == pytest.approx(SHARE, rel=0.05)
    assert reduced_chi2(bench(), state) < 1.1 < 0.5 * reduced_chi2(bench(), start)


def test_what_comes_of_another_encoder_is_seen_where_it_is() -> None:
    """To first order: of a residual that is nothing else."""
    _, lin = declared()
    true = crosstalk("sensor", OTHER)(JOINT, (SHARE,))
    r = tuple(np.zeros_like(r) if x is None else x for r, x in zip(lin.r, added(lin, true), strict=True))
    found = curves(replace(lin, r=r))[0].effect
    assert isinstance(found, Crosstalk) and (found.port, found.joint, found.other) == ("sensor", JOINT, OTHER)
    assert found.values[0] == pytest.approx(SHARE, rel=1e-3)


def test_only_joints_that_move_together_are_tried() -> None:
    _, lin = declared()
    assert len(crosstalks(lin)) == 2 * 3 * 2
    data = [
        replace(one, scene=replace(one.scene, arm=replace(one.scene.arm, live=np.array(live))))
        for one, live in zip(lin.problem.data, ([0, 1], [2]), strict=True)
    ]
    pairs = [
        (kind.other, joint)
        for kind, joint in crosstalks(replace(lin, problem=replace(lin.problem, data=tuple(data))))
        if issubclass(kind, Crosstalk)
    ]
    assert sorted(pairs) == [(0, 1), (0, 1), (1, 0), (1, 0)]
