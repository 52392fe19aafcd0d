"""A mass that rings with a motor, which no name of the catalogue is: found, told and left to link-side names where these are it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from outside import OUTSIDE

from ident.effects.base import Effect, Known
from ident.effects.learned import Learned
from ident.effects.ringing import Ringing
from ident.effects.structure import AttachedResonator
from ident.identification.campaign_model import model_of_campaign
from ident.loop.diagnose import Begun, begin
from ident.loop.effect_words import meaning, named, values
from ident.records.frf import estimate
from ident.search.candidates import units
from ident.search.curves import resonances
from ident.search.minima import fully
from ident.search.refits import State, linearised, reduced_chi2, same
from ident.search.trials import _drawn
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
#: Lines so far apart that the mode lies between two of them.
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=1.0, fs=500.0, periods=3))
DISC = (4e-6, 41.5, 3e-4)
CELLS = [("joint1", np.array([0.0, 0.7, 0.5]))]


@cache
def begun(*effects: Effect) -> Begun:
    campaign = simulate(chain_of_robot(SHORT), SHORT, CELLS, effects=list(effects), seed=5, workers=1)
    responses = tuple(estimate(record, campaign) for record in campaign.records)
    model, _ = model_of_campaign(campaign, responses, True, "coupled")
    return begin(campaign, model, responses)


def begun_with_disc() -> Begun:
    return begun(OUTSIDE["brake-disc"](0, DISC))


@cache
def with_it() -> State:
    one = begun_with_disc()
    lin = linearised(one.start.problem, one.start.minimum.vector)
    return min((state for _, state in _drawn(one.bench, one.start, lin, [])), key=lambda state: state.select)


def test_a_motor_feels_what_a_link_feels_of_the_same_mass() -> None:
    """Motor side, so N^2 times as much beyond the gear; all of its inertia far below, hardly any far beyond."""
    one = np.ones(3)
    arm = Known(100.0 * one, one, np.eye(3), 0.0 * one, chain_of_robot(ROBOT), 0.0 * one)
    s = 2j * np.pi * np.array([0.1, 30.0, 41.5, 60.0, 4e3])
    ringing = Ringing(1, DISC)
    at_link = AttachedResonator(1, DISC).impedance(s, arm)
    expected = np.zeros_like(at_link)
    expected[:, 1, 1] = 1e4 * at_link[:, 4, 4]
    np.testing.assert_allclose(ringing.impedance(s, arm), expected, rtol=1e-12)
    assert ringing.felt(s)[0] == pytest.approx(DISC[0], rel=1e-4) and abs(ringing.felt(s)[-1]) < 4e-3 * DISC[0]


def test_its_curve_has_the_peak_and_half_a_turn_of_phase() -> None:
    curve = Ringing(1, DISC).curve()
    f, size, phase = (np.array(curve[key]) for key in ("knots", "heights", "phases"))
    assert np.all(np.diff(f) > 0.0) and f[np.argmax(size)] == pytest.approx(41.5)
    quality = 1.0 / (2.0 * np.pi * 41.5 * DISC[2])
    assert size.max() / DISC[0] == pytest.approx(np.hypot(quality, 1.0), rel=1e-6)
    assert abs(phase[0]) < 0.01 and phase[-1] < -0.8 * np.pi and curve["variable"] == "resonance"


@pytest.mark.bench
def test_its_inertia_is_a_share_of_the_motors() -> None:
    lin = linearised(begun_with_disc().start.problem, begun_with_disc().start.minimum.vector)
    J_m = lin.problem.parameters(lin.vector).J_m
    assert [units(lin, Ringing, joint)[0] for joint in range(3)] == pytest.approx(J_m)
    assert units(lin, AttachedResonator, 0)[0] == pytest.approx(max(float(arm.J[0, 0]) for _, arm in lin.arms))


@pytest.mark.bench
def test_a_disc_on_a_motor_is_found_between_lines_and_explains_the_records() -> None:
    one, state = begun_with_disc(), with_it()
    (found,) = state.effects
    assert isinstance(found, Ringing) and found.joint == 0
    assert reduced_chi2(one.bench, fully(one.bench, state)) < 1.2 < 1e-3 * reduced_chi2(one.bench, one.start)
    assert found.values == pytest.approx(DISC, rel=0.01)


@pytest.mark.bench
def test_no_second_one_is_looked_for_where_one_is() -> None:
    lin = linearised(begun_with_disc().start.problem, begun_with_disc().start.minimum.vector)
    assert resonances(lin, (), 0.0)[0].effect.joint == 0
    assert 0 not in [c.effect.joint for c in resonances(lin, with_it().effects, 0.0)]
    assert resonances(lin, (), np.inf) == []


def test_it_is_another_one_at_another_joint_and_no_drawn_law() -> None:
    a, b = Ringing(0, DISC), Ringing(0, (1e-6, 20.0, 0.0))
    assert same(a, b) and not same(a, Ringing(1, DISC)) and not isinstance(a, Learned)


def test_people_read_where_it_rings_and_its_numbers() -> None:
    numbers = {p.name: {"value": v, "std": 1e-3 * v, "unit": p.unit} for p, v in zip(Ringing.parameters, DISC, strict=True)}  # fmt: skip
    effect = {
        "name": "unknown", "joint": "joint1", "port": "motor", "declared": False, "parameters": numbers,
        "curve": Ringing(0, DISC).curve(),
    }  # fmt: skip
    assert named(effect) == "an unknown resonance at joint1"
    assert values(effect).startswith(
        "a mass that rings at 41.5 Hz at the motor, inertia 4e-06 +- 4e-09 kgm2, frequency"
    )
    assert meaning(effect).endswith("learned from the records: a mass that rings at 41.5 Hz at the motor.")
