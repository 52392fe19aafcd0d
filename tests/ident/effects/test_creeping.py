"""Dry friction of contacts that creep otherwise than expected, at joints that move and at joints that it holds."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import diagnosed
import numpy as np
import pytest

from ident.effects.creeping import Creeping, creeping
from ident.effects.friction import MotorCoulomb, MotorStribeck
from ident.effects.motion import CREEP, State
from ident.loop.diagnose import Begun, begin
from ident.records.campaign import Campaign
from ident.records.frf import estimate
from ident.search.candidates import best_of
from ident.search.minima import crept
from ident.search.refits import FINELY, Refit, as_declared, fitted, linearised, reduced_chi2
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot, make_model, plan_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=2.0, periods=3, fs=500.0))
#: A twentieth of the excitation's torque, at a contact that creeps 2.5 times as slowly as expected.
JOINT, LEVEL, DECADES = 1, 0.01, -0.4


def moving(omega: float) -> State:
    return State(0.0, omega, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 100.0, 5000.0)


def test_a_law_that_creeps_is_the_same_law_of_another_speed_near_standstill() -> None:
    plain = MotorStribeck(JOINT, (1.0, 2.0, 5.0))
    law = creeping(plain, DECADES)
    assert isinstance(law, Creeping) and (law.name, law.numbers, law.dry) == (plain.name, 3, True)
    creep = 100.0 * CREEP * 10.0**DECADES
    assert law.law(moving(creep)) == pytest.approx(-np.tanh(1.0) * (1.0 + 2.0 * np.exp(-((creep / 5.0) ** 2))))
    assert law.law(moving(20.0)) == pytest.approx(plain.law(moving(20.0)))
    assert creeping(plain, 0.0).law(moving(0.03)) == plain.law(moving(0.03))


@cache
def measured() -> Campaign:
    """Records of an arm with friction in its second joint, which sticks while others are excited."""
    effect = creeping(MotorCoulomb(JOINT, (LEVEL,)), DECADES)
    cells = [(cell.joint, np.array(cell.q)) for cell in plan_of_robot(SHORT).cells if not cell.spare]
    return simulate(chain_of_robot(SHORT), SHORT, cells, effects=[effect], seed=4, workers=1)


@cache
def begun() -> Begun:
    responses = tuple(estimate(record, measured()) for record in measured().records)
    return begin(measured(), make_model(chain_of_robot(SHORT), believe_zeros=True), responses)


@pytest.mark.bench
def test_friction_is_sized_by_records_in_which_its_joint_slides() -> None:
    """Where it sticks friction is whatever holds it, and not that of a velocity that is all noise."""
    bench, start = begun().bench, begun().start
    lin = linearised(start.problem, as_declared(bench, start))
    found = best_of(lin, MotorCoulomb, JOINT)
    assert found is not None and found.effect["level"] == pytest.approx(LEVEL, rel=0.3)
    assert found.gain > 0.5 * lin.chi2


@pytest.mark.bench
def test_how_a_contact_creeps_is_found_where_that_leaves_less() -> None:
    bench, start = begun().bench, begun().start
    scales, limits = (LEVEL,), ((0.0, 1.0),)
    plain = fitted(
        bench,
        Refit(np.append(as_declared(bench, start), LEVEL), (MotorCoulomb(JOINT, (LEVEL,)),), scales, limits, 1, FINELY),
    )
    found = crept(bench, plain)
    assert reduced_chi2(bench, found) < 0.5 * reduced_chi2(bench, plain)
    (law,) = found.effects
    assert isinstance(law, Creeping) and law.creep == pytest.approx(DECADES, abs=0.2)
    assert law["level"] == pytest.approx(LEVEL, rel=0.1)  # a hasty fit
    assert crept(bench, found) is found


@pytest.mark.bench
def test_nothing_new_is_looked_for_once_it_is_time() -> None:
    lines, c = list[str](), diagnosed.campaign()
    responses = tuple(estimate(record, c) for record in c.records)
    late = begin(c, make_model(chain_of_robot(ROBOT), believe_zeros=True), responses, until=time.monotonic() - 1.0)
    found = late.diagnosed(lines.append)
    assert found.status == "unexplained" and not found.added
    assert not any("promised" in line for line in lines)
