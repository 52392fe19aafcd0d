"""A joint that is another one in every record: what that changes, in words and in the picture, and what is told of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from ident.arm.evidence import Evidence
from ident.arm.parts import Split, split_lines
from ident.effects.base import Effect, only_shares
from ident.effects.by_record import by_record
from ident.effects.declared import ChangeBetweenRecords, DriftOverRecords
from ident.effects.friction import MotorCoulomb
from ident.loop.diagnose import Diagnosis, begin
from ident.loop.diagnosis_figures import record_figure
from ident.loop.diagnosis_json import _of_place
from ident.loop.effect_words import meaning, values
from ident.records.frf import estimate
from ident.search.added import Added
from ident.search.candidates import best_of
from ident.search.changes import told_of
from ident.search.each_record import in_each_record
from ident.search.refits import linearised, reduced_chi2, without_effects
from ident.search.tried import refitted
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot, make_model, plan_of_robot
from symgen.robot import load_robot

WARM = by_record([4, 0, 2])(1, (0.1, -0.05))


def test_the_first_record_is_the_arm_s_own_and_others_have_a_share_each() -> None:
    assert [WARM.shares(k) for k in range(5)] == [{}, {}, {"K": 0.1}, {}, {"K": -0.05}]
    assert only_shares(WARM) and [p.name for p in WARM.parameters] == ["share_3", "share_5"]
    assert WARM.with_values([0.0, 0.0]).shares(2) == {"K": 0.0}  # it may become another one


def test_a_record_that_only_reports_tells_nothing_of_a_joint_that_is_another_one_in_each() -> None:
    a, b, c = (cast(Evidence, SimpleNamespace(index=k)) for k in range(3))
    by_records, by_lines = Split((a,), (b,), (b, c), ""), Split((a, b, c), (a, b, c), (a, b, c), "")
    warm: Any = SimpleNamespace(effects=(WARM,), problem=SimpleNamespace(base=0))
    assert told_of(by_records, warm, by_records.report) == (b,)
    assert told_of(by_lines, warm, by_lines.report) == (a, b, c)


def test_it_is_said_and_drawn_by_record() -> None:
    effect: dict[str, Any] = {"name": "unknown", "joint": "joint2", "port": "spring", "curve": WARM.curve()}
    assert "another one in every record" in meaning(effect)
    assert values(effect).endswith("0.05 to 0.1 over records 3 to 5")
    assert record_figure(WARM, [0.01, np.nan]).count("share of the stiffness") == 1


@pytest.mark.parametrize(
    ("effect", "again", "told"),
    [
        (ChangeBetweenRecords(1, (3.0, 0.1, 0.0, 0.0)), False, True),
        (ChangeBetweenRecords(1, (3.0, 0.1, 0.0, 0.0)), True, False),
        (DriftOverRecords(1, (3.0, 0.1, 0.0)), False, True),
        (MotorCoulomb(1, (0.1,)), False, False),
    ],
)
def test_a_change_may_be_a_curve_of_place_unless_a_posture_was_measured_on_both_sides(
    effect: Effect, again: bool, told: bool
) -> None:
    postures = [np.full(3, 0.1 * (0 if again and k == 4 else k)) for k in range(5)]
    campaign = SimpleNamespace(joints=("joint1", "joint2"), records=[SimpleNamespace(posture=q) for q in postures])
    d = cast(Diagnosis, SimpleNamespace(campaign=campaign))
    found = _of_place(d, effect)
    assert [(one["name"], one["joint"], one["recipe"]) for one in found] == [("unknown", "joint2", "repeat")] * told


@pytest.mark.bench  # 15 s
def test_a_stiffness_for_each_record_takes_the_place_of_a_change_that_leaves_much() -> None:
    robot = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
    robot = replace(robot, experiment=replace(robot.experiment, f0=1.0, periods=3, fs=500.0))
    chain = chain_of_robot(robot)
    cells = [(cell.joint, np.array(cell.q)) for cell in plan_of_robot(robot).cells]
    true = by_record(range(len(cells)))(0, tuple((0.1 * np.sin(2.1 * np.arange(1, len(cells)))).tolist()))
    campaign = simulate(chain, robot, cells, effects=[true], workers=1, seed=3)
    responses = tuple(estimate(record, campaign) for record in campaign.records)
    begun = begin(campaign, make_model(chain, believe_zeros=True), responses)
    bench = replace(begun.bench, split=split_lines(begun.data, "all"))
    start = without_effects(bench)
    lin = linearised(start.problem, start.minimum.vector)
    candidate = best_of(lin, ChangeBetweenRecords, 0)
    assert candidate is not None
    ((_, state),) = refitted(bench, start, [(candidate, lin)])
    entry = Added(state.effects[-1], (), 1.0, 1.0, 0.0, 1.0, (), (), ())
    new, (found,) = in_each_record(bench, state, [entry])
    assert reduced_chi2(bench, new) < 1.2 < reduced_chi2(bench, state)
    shares = (1.0 + np.array([0.0, *new.effects[-1].values])) * new.problem.parameters(new.minimum.vector).K[0]
    own = np.array([record.excited == chain.names[0] for record in campaign.records])  # others tell less of it
    ratios = (shares / (1.0 + np.array([0.0, *true.values])))[own]
    assert ratios == pytest.approx(np.full(len(ratios), ratios[0]), rel=2e-3)
    assert found.effect is new.effects[-1] and found.rivals == ((state.effects[-1], 1.0),)
    assert in_each_record(begun.bench if not begun.bench.split.note else bench, new, [found]) == (new, [found])
