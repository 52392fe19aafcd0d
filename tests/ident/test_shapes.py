"""Impedances tried at plausible shapes: what has bent the fitted arm far promises nothing from there."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from ident.bench import simulate
from ident.candidates import catalogue
from ident.diagnose import Begun, begin
from ident.effects.structure import LinkFlexibility
from ident.frf import estimate
from ident.refits import Refit, excess, fitted, linearised
from ident.shapes import bending
from ident.trials import _bending
from symgen.plan import chain_of_robot, make_model, plan_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[2] / "robots" / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=1.0, periods=3))
#: The last link bends: stiffness, share, damping, about the joint's axis.
LAST = LinkFlexibility(2, (6642.0, 0.48, 1.48e-3, 0.0))


@cache
def begun() -> Begun:
    cells = [(cell.joint, np.array(cell.q)) for cell in plan_of_robot(SHORT).cells]
    campaign = simulate(chain_of_robot(SHORT), SHORT, cells, effects=[LAST], seed=5, workers=1)
    responses = tuple(estimate(record, campaign) for record in campaign.records)
    return begin(campaign, make_model(chain_of_robot(SHORT), believe_zeros=True), responses)


def test_all_joints_are_tried_but_those_where_it_is_known() -> None:
    lin = linearised(begun().start.problem, begun().start.minimum.vector)
    every = {(c.effect.name, c.effect.joint) for c in bending(lin, ())}
    assert every >= {("link-flexibility", joint) for joint in range(3)} | {("base-compliance", None)}
    assert ("link-flexibility", 2) not in {(c.effect.name, c.effect.joint) for c in bending(lin, (LAST,))}
    assert not any(name == "locked-joint-elasticity" for name, _ in every), "no lock holds a joint here"
    across = [c.effect["across"] for c in bending(lin, ()) if c.effect.name == "link-flexibility"]
    assert across.count(0.0) == across.count(1.0)


def test_a_last_link_that_bends_is_found_though_it_promises_nothing() -> None:
    bench, start = begun().bench, begun().start
    lin = linearised(start.problem, start.minimum.vector)
    promised = [(c.effect.name, c.effect.joint) for c in catalogue(lin, ())[:6]]
    assert excess(bench, start) > 3.0 and ("link-flexibility", 2) not in promised
    best = min(_bending(bench, start, lin, print), key=lambda one: one[1].select)
    assert (best[0].effect.name, best[0].effect.joint) == ("link-flexibility", 2)
    assert excess(bench, fitted(bench, Refit.of(best[1]))) < 1.0


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
