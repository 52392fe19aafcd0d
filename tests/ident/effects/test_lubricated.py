"""Friction that gives before it slides and is less the faster it does: the law of LuGre, in the fit as in a simulation, and found."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fitting import bench_of
from scipy.integrate import solve_ivp

from ident.effects.hysteresis import MotorHysteresis
from ident.effects.lubricated import Lubricated, LubricatedLink, LubricatedMotor
from ident.effects.motion import State
from ident.search.candidates import best_of
from ident.search.contact import as_it_sticks
from ident.search.refits import Bench, linearised, reduced_chi2, without_effects
from ident.search.refits import State as Fitted
from ident.search.trace import Linearised
from ident.search.tried import refitted
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=2.0, periods=3, fs=1000.0))
JOINT, RESTS = 1, (-1.1, 0.31)
#: Level and peak [N m], distance [rad], speed [rad/s], time [s].
LEVEL, PEAK, DISTANCE, SPEED, TIME = VALUES = (6e-3, 3e-3, 0.05, 2.0, 1e-3)
#: A period [s] of a motion, samples of it.
PERIOD, SAMPLES = 0.5, 4000


def at(x: Any, v: Any, port: str = "motor") -> State:
    rest = State(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 100.0, 5000.0)
    return replace(rest, **dict(zip({"motor": ("theta", "omega"), "link": ("q", "q_rate")}[port], (x, v), strict=True)))


def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    w, t = 2.0 * np.pi / PERIOD, np.arange(SAMPLES) * PERIOD / SAMPLES
    return t, 0.3 * np.sin(w * t) + 0.1 * np.sin(3.0 * w * t), w * (0.3 * np.cos(w * t) + 0.3 * np.cos(3.0 * w * t))


def lugre() -> np.ndarray:
    """Bristles of stiffness (level + peak) / distance, integrated over two periods."""
    stiffness, w = (LEVEL + PEAK) / DISTANCE, 2.0 * np.pi / PERIOD

    def bends(t: Any, z: Any) -> Any:
        v = w * (0.3 * np.cos(w * t) + 0.3 * np.cos(3.0 * w * t))
        return v - stiffness * np.abs(v) * z / (LEVEL + PEAK * np.exp(-((v / SPEED) ** 2)))

    t = np.arange(2 * SAMPLES) * PERIOD / SAMPLES
    z = solve_ivp(bends, (0.0, t[-1]), [0.0], t_eval=t, rtol=1e-9, atol=1e-12).y[0]
    return np.asarray(-(stiffness * (z + TIME * bends(t, z))))[SAMPLES:]


@pytest.mark.parametrize("kind", [LubricatedMotor, LubricatedLink])
def test_it_is_the_law_of_bristles_that_bend(kind: type[Lubricated]) -> None:
    _, x, v = motion()
    found = kind(JOINT, VALUES).over_period(at(x, v, kind.port))
    np.testing.assert_allclose(found, lugre(), atol=0.01 * (LEVEL + PEAK))


def test_it_is_the_same_in_a_simulation_that_goes_on() -> None:
    t, _, _ = motion()
    law, remember = LubricatedMotor(JOINT, VALUES).start(PERIOD / SAMPLES)
    w, found = 2.0 * np.pi / PERIOD, np.empty(SAMPLES)
    for _ in range(2):
        for k, time in enumerate(t + 0.5 * PERIOD / SAMPLES):
            half = at(0.0, w * (0.3 * np.cos(w * time) + 0.3 * np.cos(3.0 * w * time)))
            found[k] = law(half)
            remember(half)
    np.testing.assert_allclose(0.5 * (found + np.roll(found, 1)), lugre(), atol=0.01 * (LEVEL + PEAK))


def test_without_a_peak_it_is_dahls() -> None:
    _, x, v = motion()
    plain = MotorHysteresis(JOINT, (LEVEL, DISTANCE)).over_period(at(x, v))
    np.testing.assert_allclose(LubricatedMotor(JOINT, (LEVEL, 0.0, DISTANCE, SPEED, 0.0)).over_period(at(x, v)), plain)
    assert not LubricatedMotor(JOINT, (0.0, 0.0, DISTANCE, SPEED, TIME)).over_period(at(x, v)).any()


@cache
def measured(peak: float) -> tuple[Bench, Fitted, Linearised]:
    """Short records of a motor that rubs so, the same to fit, choose and report."""
    chain = chain_of_robot(SHORT)
    cells = [(chain.names[JOINT], angle * np.eye(chain.n)[JOINT]) for angle in RESTS]
    effect = LubricatedMotor(JOINT, (LEVEL, peak, DISTANCE, SPEED, TIME))
    bench = bench_of(simulate(chain, SHORT, cells, effects=[effect], workers=1, seed=3), chain)
    start = without_effects(bench)
    return bench, start, linearised(start.problem, start.minimum.vector)


@pytest.mark.bench
def test_it_is_found_where_a_name_that_gives_leaves_more_than_noise() -> None:
    bench, start, lin = measured(PEAK)
    named = best_of(lin, MotorHysteresis, JOINT)
    assert named is not None
    tried = refitted(bench, start, [(named, lin)])
    name, *others = as_it_sticks(bench, start, lin, tried)
    assert name is tried[0] and reduced_chi2(bench, name.state) > 2.0
    (found,) = (one for one in others if isinstance(one.candidate.effect, Lubricated))
    assert reduced_chi2(bench, found.state) < 1.1
    np.testing.assert_allclose(found.state.effects[-1].values, VALUES, rtol=0.1)
