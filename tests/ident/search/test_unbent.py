"""The arm by records in which a joint is held: of what is missing at that joint it knows next to nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ident.search.unbent
from ident.effects.catalogue import parse
from ident.loop.diagnose import Begun, begin
from ident.records.frf import estimate
from ident.search.refits import reduced_chi2
from ident.search.unbent import DOUBTED, _is_an_arm, unbent
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot, make_model, plan_of_robot
from symgen.robot import Robot, load_robot

YPP3 = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
ROBOT = replace(YPP3, experiment=replace(YPP3.experiment, f0=1.0, periods=3, fs=500.0))
#: Half as long, and as fine.
BRIEF = replace(YPP3, experiment=replace(YPP3.experiment, f0=2.0, periods=3, fs=500.0))
CHAIN = chain_of_robot(ROBOT)


def begun(*effects: str, times: int = 1, robot: Robot = ROBOT) -> Begun:
    """By the cells that the constants need; more than once, by the spare ones, too."""
    planned = [cell for cell in plan_of_robot(robot).cells if times > 1 or not cell.spare]
    cells = [(cell.joint, np.array(cell.q)) for cell in planned] * times
    parsed = [parse(text, [robot.drive(name) for name in CHAIN.names]) for text in effects]
    campaign = simulate(CHAIN, robot, cells, effects=parsed, workers=1, seed=11)
    responses = tuple(estimate(record, campaign) for record in campaign.records)
    return begin(campaign, make_model(CHAIN, believe_zeros=True), responses)


@pytest.mark.bench
@pytest.mark.parametrize(("joint", "times"), [(0, 2), (1, 1)])
def test_what_bends_the_arm_at_one_joint_is_left_out_with_its_records(joint: int, times: int) -> None:
    found, said = begun(f"spring-hardening:cubic=3e9@joint{joint + 1}", times=times), list[str]()
    bench, start, n = found.bench, found.start, CHAIN.n
    off = replace(bench, guess=replace(bench.guess, K=bench.guess.K * [1.1, 0.9, 1.05]))  # what is declared is not so
    better = unbent(replace(off, say=said.append), start)
    others = [k for k in range(n) if k != joint]
    assert reduced_chi2(bench, start) > 100.0 and f"without records of joint {joint + 1}" in said[0]
    assert np.abs(better.guess.K[others] / bench.guess.K[others] - 1.0).max() < 0.02
    assert abs(np.log(better.guess.K[joint] / off.guess.K[joint])) <= DOUBTED
    assert (
        np.abs(better.guess.alpha / bench.guess.alpha - 1.0).max() < 0.05
    )  # nor those that no record shows without the joint's
    assert np.isfinite(better.guess.vector()).all() and better.split is bench.split and better.firm == 0.0


@pytest.mark.parametrize(
    "effects",
    [(), [f"torque-lag:time=2e-3@joint{k}" for k in (1, 2, 3)]],
    ids=["nothing", "everywhere"],
)
@pytest.mark.bench
def test_an_arm_that_nothing_bends_or_something_everywhere_stays_as_declared(effects: tuple[str, ...]) -> None:
    found = begun(*effects, robot=BRIEF)
    assert unbent(found.bench, found.start) is found.bench


def test_it_begins_from_no_arm_whose_inertia_is_none_at_another_record(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that do not fit it need not have one: every fit from there had no number (a zero of arm6, "unexplained")."""
    found = begun(robot=BRIEF)
    state = found.start
    vector = state.minimum.vector.copy()
    vector[4 * CHAIN.n :] *= -1.0
    none = replace(state, minimum=replace(state.minimum, vector=vector))
    assert _is_an_arm(found.bench, state) and not _is_an_arm(found.bench, none)
    left = iter([0.5, 400.0, 300.0])
    monkeypatch.setattr(ident.search.unbent, "FEWEST", 1)
    monkeypatch.setattr(ident.search.unbent, "fitted", lambda bench, refit: none)
    monkeypatch.setattr(
        ident.search.unbent, "reduced_chi2", lambda bench, one: 1000.0 if one is state else next(left, 0.5)
    )
    assert unbent(found.bench, state) is found.bench
