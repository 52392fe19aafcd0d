"""Frequency responses of a drive or an encoder that nobody named, and names in their place."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import diagnosed
import numpy as np
import pytest
from outside import OUTSIDE

from ident.effects.base import Effect, Known
from ident.effects.catalogue import CATALOGUE
from ident.effects.response import Response, response
from ident.identification.campaign_model import model_of_campaign
from ident.loop.diagnose import Begun, begin
from ident.records.frf import estimate
from ident.search.apart import apart
from ident.search.candidates import Candidate, best_of
from ident.search.curves import responses
from ident.search.gains import _with_more_knots, named_gains, resolved
from ident.search.minima import told
from ident.search.refits import Refit, State, fitted, linearised, reduced_chi2, standing
from ident.search.tried import refitted, with_candidate
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot, plan_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=1.0, periods=3, fs=500.0))
JOINT, KNOTS = 1, [1.0, 3.0, 10.0, 30.0]
LOOP, LAG, DELAY = OUTSIDE["current-loop"], CATALOGUE["torque-lag"], CATALOGUE["input-delay"]


def known() -> Known:
    one = np.ones(3)
    return Known(one, one, np.eye(3), 0.0 * one, chain_of_robot(ROBOT), 0.0 * one)


def test_a_response_goes_through_its_gains_and_delays() -> None:
    effect = response("motor", KNOTS)(JOINT, (0.1, -0.2, 0.3, 1e-3, 2e-3, 1e-3, 0.0))
    s = 2j * np.pi * np.array(KNOTS)
    gain = effect.torque_gain(s, known())
    expected = np.exp([0.0, 0.1, -0.2, 0.3] - s * np.array([1e-3, 2e-3, 1e-3, 0.0]))
    np.testing.assert_allclose(gain[:, JOINT], expected, rtol=1e-12)
    np.testing.assert_array_equal(gain[:, [0, 2]], 1.0)
    assert effect.angle_gain(s, known()) is None
    again = type(effect).of_gains(JOINT, expected)
    np.testing.assert_allclose(again.values, effect.values, atol=1e-12)


def test_a_response_of_the_encoder_and_beyond_its_knots() -> None:
    """Gain and delay stay as they are; a response of -s is the conjugate."""
    effect = response("sensor", KNOTS)(JOINT, (0.1, -0.2, 0.3, 1e-3, 2e-3, 1e-3, 4e-3))
    gain = effect.angle_gain(2j * np.pi * np.array([0.0, 0.1, 300.0, -300.0]), known())
    assert gain is not None
    assert gain[:2, JOINT] == pytest.approx([1.0, np.exp(-2j * np.pi * 1e-4)])
    assert gain[2, JOINT] == pytest.approx(np.exp(0.3 - 2j * np.pi * 1.2)) == np.conj(gain[3, JOINT])
    assert effect.torque_gain(np.ones(2) * 1j, known()) is None


def test_a_curve_of_frequency_is_told_in_gains_and_delays() -> None:
    curve = response("motor", KNOTS)(JOINT, (0.0, np.log(0.5), 0.0, 1e-3, 2e-3, 1e-3, 0.0)).curve()
    assert curve["knots"] == KNOTS and curve["variable"] == "frequency"
    assert curve["heights"] == pytest.approx([1.0, 1.0, 0.5, 1.0]) and curve["delays"] == [1e-3, 2e-3, 1e-3, 0.0]
    assert curve["at"] == [3.0, 10.0, 30.0, *KNOTS]


def test_more_knots_are_lines_that_excite_the_joint_and_draw_the_same_response() -> None:
    lines, arm = np.arange(1.0, 31.0), SimpleNamespace(arm=SimpleNamespace(live=np.arange(2)))
    own, other = (
        SimpleNamespace(sampling=SimpleNamespace(f=f), use=f > 0, is_excited=f > 0, excited=joint, scene=arm)
        for f, joint in ((lines, JOINT), (lines + 0.5, 0))
    )
    lin: Any = SimpleNamespace(problem=SimpleNamespace(data=(own, other)))
    curve = response("motor", KNOTS)(JOINT, (0.1, -0.2, 0.3, 1e-3, 2e-3, 1e-3, 0.0))
    more = _with_more_knots(lin, curve, "sensor")
    assert isinstance(more.effect, Response) and (more.effect.port, more.effect.joint) == ("sensor", JOINT)
    assert len(curve.knots) < len(more.effect.knots) and set(more.effect.knots) <= set(lines)
    assert len(more.scales) == len(more.effect.values) == 2 * len(more.effect.knots) - 1
    s = 2j * np.pi * np.array(more.effect.knots)
    np.testing.assert_allclose(more.effect.response(s), curve.response(s), rtol=1e-12)


@cache
def begun(*effects: Effect) -> Begun:
    """Short records of an arm with these effects."""
    cells = [(cell.joint, np.array(cell.q)) for cell in plan_of_robot(SHORT).cells if not cell.spare]
    campaign = simulate(chain_of_robot(SHORT), SHORT, cells, effects=list(effects), workers=1, seed=5)
    frfs = tuple(estimate(record, campaign) for record in campaign.records)
    model, _ = model_of_campaign(campaign, frfs, True, "coupled")
    return begin(campaign, model, frfs)


@cache
def drawn(*effects: Effect) -> State:
    """The arm with the better of the two frequency responses that promise most."""
    one = begun(*effects)
    declared = linearised(one.start.problem, one.bench.guess.vector())
    tried = refitted(one.bench, one.start, [(c, declared) for c in responses(declared, 0.0)[:2]])
    best = min((state for _, state in tried), key=lambda state: state.select)
    return fitted(one.bench, Refit.of(best))


@pytest.mark.bench
def test_a_current_loop_of_second_order_is_drawn_to_the_noise() -> None:
    """To 1 % of the torque from 5 Hz; slower, these short records hardly tell."""
    loop = LOOP(JOINT, (1e-3,))
    state = drawn(loop)
    assert reduced_chi2(begun(loop).bench, state) < 1.2 < 1e-2 * reduced_chi2(begun(loop).bench, begun(loop).start)
    (found,) = state.effects
    assert isinstance(found, Response) and told(found) == "unknown at joint 2: frequency at the motor"
    s = 2j * np.pi * np.geomspace(5.0, found.knots[-1], 50)
    np.testing.assert_allclose(found.response(s), 1.0 / (1.0 + 1e-3 * s) ** 2, atol=0.01)


@pytest.mark.bench
def test_a_response_has_as_many_knots_as_it_needs_at_the_torque_where_none_tells_it_from_the_angle() -> None:
    """The first joint of this arm moves no other one."""
    loop = LOOP(0, (1.5e-3,))
    state, bench = drawn(loop), begun(loop).bench
    enough = state.effects[-1]
    assert isinstance(enough, Response) and resolved(bench, state) is state and reduced_chi2(bench, state) < 1.1
    few = response("sensor", np.geomspace(enough.knots[0], enough.knots[-1], 4).tolist())
    curve = few.of_gains(0, enough.response(2j * np.pi * np.array(few.knots)))
    plain, lin = standing(bench, state, [])
    coarse = fitted(
        bench, Refit.of(fitted(bench, with_candidate(plain, Candidate(curve, 0.0, (0.1,) * 3 + (1e-3,) * 4), lin)))
    )
    finer = resolved(bench, coarse)
    assert reduced_chi2(bench, finer) < 1.1 < reduced_chi2(bench, coarse)
    assert told(finer.effects[-1]) == "unknown at joint 1: frequency at the motor"


@pytest.mark.bench
def test_two_names_take_the_place_of_a_response_that_they_make() -> None:
    lag, delay = LAG(JOINT, (1e-3,)), DELAY(JOINT, (1e-3,))
    found = named_gains(begun(lag, delay).bench, drawn(lag, delay))
    assert found is not None and {e.name for e in found.effects} == {"torque-lag", "input-delay"}
    assert [e.values[0] for e in found.effects] == pytest.approx([1e-3, 1e-3], rel=0.02)


@pytest.mark.bench
def test_no_two_names_take_the_place_of_one_that_they_do_not_make() -> None:
    loop = LOOP(JOINT, (1e-3,))
    assert named_gains(begun(loop).bench, drawn(loop)) is None


@pytest.mark.parametrize(
    ("effects", "joints"),
    [
        pytest.param((LAG(0, (3e-4,)), LAG(1, (3e-4,))), [0, 1], id="two joints", marks=pytest.mark.bench),
        pytest.param((LAG(None, (3e-4,)), DELAY(1, (5e-4,))), [None], id="the arm, and more", marks=pytest.mark.bench),
    ],
)
def test_two_joints_that_lag_alike_are_no_arm_that_does(effects: tuple[Effect, ...], joints: list[int | None]) -> None:
    bench, start = begun(*effects).bench, begun(*effects).start
    declared = linearised(start.problem, bench.guess.vector())
    lag = best_of(declared, LAG, None)
    assert lag is not None
    ((_, state),) = refitted(bench, start, [(lag, declared)])
    entry = replace(diagnosed.diagnosis().added[0], effect=state.effects[-1])
    found, added = apart(bench, state, [entry])
    assert reduced_chi2(bench, state) > 10.0 and [e.joint for e in found.effects] == joints
    assert [one.effect for one in added] == list(found.effects)
    assert all(e.values[0] == pytest.approx(3e-4, rel=0.02) for e in found.effects if e.joint is not None)
