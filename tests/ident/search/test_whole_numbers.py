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
from ident.search.candidates import Candidate
from ident.search.refits import NAMED, Bench, Refit, State, fitted, linearised, reduced_chi2, without_effects
from ident.search.tried import with_candidate
from ident.search.whole_numbers import each_otherwise, otherwise_if_left
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=2.0, fs=500.0))
JOINT, ORDER, AMPLITUDE, SCALE = 1, 3.0, 6e-6, -0.03
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
