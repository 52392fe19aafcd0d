"""An order that is off by one leaves hardly anything: the right one is found at the end, whatever was added since."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fitting import bench_of

from ident.effects.motor import TorqueScale
from ident.effects.spring import TransmissionError
from ident.search.added import Added
from ident.search.candidates import Candidate, catalogue
from ident.search.refits import (
    NAMED,
    Bench,
    Refit,
    State,
    fitted,
    linearised,
    reduced_chi2,
    same,
    without,
    without_effects,
)
from ident.search.tried import with_candidate
from ident.search.whole_numbers import each_otherwise, otherwise_if_left, renumbered
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=2.0, fs=500.0, periods=4))
JOINT, ORDER, AMPLITUDE, SCALE = 1, 3.0, 6e-6, -0.03
#: Of another wave at the same joint.
SECOND = 11.0
CELLS = (("joint2", (0.0, 0.6, 0.9)), ("joint3", (0.0, -0.4, 1.8)))


@cache
def bench() -> Bench:
    effects = [TransmissionError(JOINT, (AMPLITUDE, ORDER, 0.4)), TorqueScale(2, (SCALE,))]
    chain, cells = chain_of_robot(SHORT), [(joint, np.array(q)) for joint, q in CELLS]
    return bench_of(simulate(chain, SHORT, cells, effects=effects, workers=1, seed=3), chain)


@cache
def a_little_wrong() -> State:
    """Another order, as large as does most, and the other effect added since."""
    state = without_effects(bench())
    wave = Candidate(TransmissionError(JOINT, (2.0 * AMPLITUDE, ORDER - 1.0, 0.4)), 0.0, (AMPLITUDE, 1.0, 1.0))
    for candidate in (wave, Candidate(TorqueScale(2, (SCALE,)), 0.0, (0.01,))):
        lin = linearised(state.problem, state.minimum.vector)
        state = fitted(bench(), Refit.of(fitted(bench(), with_candidate(state, candidate, lin))))
    return state


@cache
def mended() -> State:
    return each_otherwise(bench(), a_little_wrong())


@pytest.mark.bench
def test_the_right_order_is_found_though_hardly_anything_is_left() -> None:
    wrong, right = a_little_wrong(), mended()
    assert reduced_chi2(bench(), wrong) < NAMED and otherwise_if_left(bench(), wrong) is wrong
    wave, scale = right.effects
    assert isinstance(wave, TransmissionError) and isinstance(scale, TorqueScale)
    assert wave["order"] == ORDER and wave["amplitude"] == pytest.approx(AMPLITUDE, rel=0.2)
    assert scale["error"] == pytest.approx(SCALE, rel=0.1)
    assert right.select < wrong.select


def test_the_right_order_stays() -> None:
    assert each_otherwise(bench(), mended()) is mended()


@pytest.mark.bench
def test_a_joint_may_have_two_waves_of_one_kind_each_of_its_own_order() -> None:
    waves = [TransmissionError(JOINT, (AMPLITUDE, order, 0.4)) for order in (ORDER, SECOND)]
    chain, cells = chain_of_robot(SHORT), [(joint, np.array(q)) for joint, q in CELLS]
    both = bench_of(simulate(chain, SHORT, cells, effects=waves, workers=1, seed=3), chain)
    state = without_effects(both)
    for order in (SECOND, ORDER):
        lin = linearised(state.problem, state.minimum.vector)
        (found,) = [c for c in catalogue(lin, state.effects, at=("spring", JOINT)) if c.effect.name == waves[0].name]
        assert order not in (e["order"] for e in state.effects) and found.effect["order"] == order
        state = fitted(both, Refit.of(fitted(both, with_candidate(state, found, lin))))
    assert reduced_chi2(both, state) < NAMED and not same(*state.effects)
    assert {e["order"] for e in state.effects} == {ORDER, SECOND}
    assert [e["amplitude"] for e in state.effects] == pytest.approx([AMPLITUDE] * 2, rel=0.2)
    less = without(both, state, state.effects[0])
    assert [e["order"] for e in less.effects] == [state.effects[1]["order"]]


def test_entries_have_the_order_that_their_effect_has_in_the_end() -> None:
    entries = [Added(e, (), 0.0, 0.0, 0.0, 1.0, (), (), ()) for e in a_little_wrong().effects]
    wave, scale = renumbered(a_little_wrong(), mended(), entries)
    assert wave.effect["order"] == ORDER and scale.effect == a_little_wrong().effects[1]
