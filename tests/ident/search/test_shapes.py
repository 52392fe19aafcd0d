"""Impedances tried at plausible shapes: what has bent the fitted arm far promises nothing from there."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ident.search.candidates
from ident.effects.catalogue import parse
from ident.effects.structure import BaseCompliance, LinkFlexibility, LockedJointElasticity
from ident.loop.diagnose import Begun, begin
from ident.records.frf import estimate
from ident.search.candidates import catalogue, units
from ident.search.from_declared import tried_bending
from ident.search.refits import FAINTLY, FULLY, Refit, fitted, linearised, reduced_chi2
from ident.search.shapes import bending
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot, make_model, plan_of_robot
from symgen.robot import load_robot

ROBOTS = Path(__file__).parents[3] / "robots"
ROBOT = load_robot(ROBOTS / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=2.0, fs=500.0, periods=3))
#: The last link bends: stiffness, share, damping, about the joint's axis.
LAST = LinkFlexibility(2, (6642.0, 0.48, 1.48e-3, 0.0))


@cache
def begun() -> Begun:
    cells = [(cell.joint, np.array(cell.q)) for cell in plan_of_robot(SHORT).cells if not cell.spare]
    campaign = simulate(chain_of_robot(SHORT), SHORT, cells, effects=[LAST], seed=5, workers=1)
    responses = tuple(estimate(record, campaign) for record in campaign.records)
    return begin(campaign, make_model(chain_of_robot(SHORT), believe_zeros=True), responses)


@pytest.mark.bench
def test_all_joints_are_tried_but_those_where_it_is_known() -> None:
    lin = linearised(begun().start.problem, begun().start.minimum.vector)
    every = {(c.effect.name, c.effect.joint) for c in bending(lin, ())}
    assert every >= {("link-flexibility", joint) for joint in range(3)} | {("base-compliance", None)}
    assert ("link-flexibility", 2) not in {(c.effect.name, c.effect.joint) for c in bending(lin, (LAST,))}
    assert not any(name == "locked-joint-elasticity" for name, _ in every), "no lock holds a joint here"
    across = [c.effect["across"] for c in bending(lin, ()) if c.effect.name == "link-flexibility"]
    assert across.count(0.0) == across.count(1.0)


def test_what_turns_is_as_stiff_as_joints_that_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slide's spring, in N/m, says nothing of the base, or of a link that bends; of a lock at it all."""
    robot = load_robot(ROBOTS / "scara4")
    chain = chain_of_robot(robot)
    K = [robot.drive(name).K for name in chain.names]
    monkeypatch.setattr(ident.search.candidates, "_sizes", lambda lin, port, joint: {"K": K[joint]})
    data = [SimpleNamespace(scene=SimpleNamespace(chain=chain))]
    lin: Any = SimpleNamespace(problem=SimpleNamespace(n=chain.n, data=data))
    stiffest, slide = max(K[0], K[1], K[3]), chain.names.index("joint3")
    assert K[slide] > stiffest
    assert units(lin, BaseCompliance, None)[:2] == (stiffest, stiffest)
    assert units(lin, LinkFlexibility, slide)[0] == stiffest and units(lin, LinkFlexibility, 1)[0] == K[1]
    assert units(lin, LockedJointElasticity, slide)[0] == K[slide]
    assert parse("base-compliance:own=80", robot.drives)["rock"] == 10.0 * stiffest
    assert parse("link-flexibility@joint3", robot.drives)["stiffness"] == 2.0 * stiffest


@pytest.mark.bench
def test_a_link_that_hardly_rings_promises_most_as_one_that_does_not() -> None:
    """One that rings promised half of that in other records, and was fitted to a third of the stiffness, or five times it."""
    bench, start = begun().bench, begun().start
    lin = linearised(start.problem, start.minimum.vector)
    best = catalogue(lin, (), at=("structure", 2))[0].effect
    assert reduced_chi2(bench, start) > 3.0 and (best.name, best["damping"]) == ("link-flexibility", 1.5e-3)


@pytest.mark.bench
def test_a_last_link_that_bends_is_found_from_plausible_shapes() -> None:
    bench, start = begun().bench, begun().start
    lin = linearised(start.problem, start.minimum.vector)
    best = min(tried_bending(bench, start, lin), key=lambda one: one[1].select)
    assert (best[0].effect.name, best[0].effect.joint) == ("link-flexibility", 2)
    found = fitted(bench, replace(Refit.of(best[1]), outer=FULLY, roughly=FAINTLY))
    assert reduced_chi2(bench, found) < 1.0
    np.testing.assert_allclose(found.effects[0].values[:3], LAST.values[:3], rtol=0.05)


def test_a_lock_that_gives_is_tried_at_every_joint_that_one_holds_in_some_record() -> None:
    cells = [("joint3", np.zeros(3)), ("joint3", np.array([0.0, 0.5, 0.7])), ("joint2", np.array([0.0, 0.5, 0.7]))]
    campaign = simulate(chain_of_robot(SHORT), SHORT, cells, lock="rigid", seed=5, workers=1)
    responses = tuple(estimate(record, campaign) for record in campaign.records)
    found = begin(campaign, make_model(chain_of_robot(SHORT), believe_zeros=True), responses)
    tried = [c.effect for c in bending(linearised(found.start.problem, found.start.minimum.vector), ())]
    locks = [effect for effect in tried if effect.name == "locked-joint-elasticity"]
    assert {effect.joint for effect in locks} == {1, 2}, "joint 1 is moved by none that moves in pitch"
    K = SHORT.drive("joint2").K
    assert (
        min(effect["stiffness"] for effect in locks) < 0.6 * K
        and max(effect["stiffness"] for effect in locks) > 1.8 * K
    )
