"""A second effect that is looked for beside one that alone does not earn its place."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ident.search.rounds
from ident.arm.parts import degrees
from ident.effects.base import Effect
from ident.effects.catalogue import CATALOGUE, parse
from ident.effects.friction import LinkCoulomb, LinkViscous, MotorCoulomb
from ident.effects.learned import learned
from ident.effects.motor import TorqueScale
from ident.identification.campaign_model import model_of_campaign
from ident.loop.diagnose import Begun, begin
from ident.records.frf import estimate
from ident.search.candidates import Candidate, best_of
from ident.search.choice import Tried
from ident.search.contact import balanced, besides, rubbing_anew
from ident.search.minima import LEAST_GAIN
from ident.search.refits import Bench, Refit, State, fitted, linearised, reduced_chi2
from ident.search.rounds import _best, _gaining, _two, _with_second
from ident.search.trials import giving
from ident.search.tried import again, refitted
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot, plan_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, periods=3, fs=500.0))
RINGS, SCALE = "attached-resonator", "torque-scale"


def begun_with(*texts: str, f0: float = 2.0, seed: int = 11) -> Begun:
    """Short records of an arm with these effects."""
    short, chain = replace(SHORT, experiment=replace(SHORT.experiment, f0=f0)), chain_of_robot(SHORT)
    cells = [(cell.joint, np.array(cell.q)) for cell in plan_of_robot(short).cells if not cell.spare]
    drives = [short.drive(name) for name in chain.names]
    campaign = simulate(chain, short, cells, effects=[parse(text, drives) for text in texts], workers=1, seed=seed)
    responses = tuple(estimate(record, campaign) for record in campaign.records)
    model, _ = model_of_campaign(campaign, responses, True, "coupled")
    return begin(campaign, model, responses)


@pytest.fixture(scope="module")
def begun() -> Begun:
    """Something rings on a link whose drive gives another torque than it says."""
    return begun_with(f"{RINGS}:inertia=7e-4,frequency=27.5,damping=1.8e-4@joint3", f"{SCALE}:error=-0.04@joint3")


@cache
def alone(begun: Begun, name: str) -> Tried:
    """The arm with one of both, from what is declared."""
    declared = linearised(begun.start.problem, begun.bench.guess.vector())
    candidate = best_of(declared, CATALOGUE[name], 2)
    assert candidate is not None
    (tried,) = refitted(begun.bench, begun.start, [(candidate, declared)])
    return tried


@pytest.mark.bench
def test_what_explained_something_before_is_tried_again_as_it_was(begun: Begun) -> None:
    said: list[str] = []
    bench = replace(begun.bench, say=said.append)
    scaled, rings = alone(begun, SCALE)[1], alone(begun, RINGS)[1]
    ((candidate, state),) = again(bench, scaled, [rings, rings, scaled])
    assert [e.name for e in state.effects] == [SCALE, RINGS] and candidate.effect is rings.effects[-1]
    assert reduced_chi2(bench, state) < 1.3 < reduced_chi2(bench, scaled)
    assert len(said) == 1 and not again(bench, state, [rings])


@pytest.mark.bench
def test_a_second_effect_is_found_beside_one_that_leads(begun: Begun) -> None:
    bench, start = begun.bench, begun.start
    lead = alone(begun, RINGS)
    lin = linearised(start.problem, start.minimum.vector)
    found = _two(bench, start, [lead], lin)
    assert found is not None
    state, added = found
    assert (
        [(e.name, e.joint) for e in state.effects]
        == [(RINGS, 2), (SCALE, 2)]
        == [(a.effect.name, a.effect.joint) for a in added]
    )
    assert reduced_chi2(bench, state) < 1.1
    assert state.effects[0]["inertia"] == pytest.approx(7e-4, rel=0.02)
    assert state.effects[1]["error"] == pytest.approx(-0.04, rel=0.03)


def test_a_second_effect_that_was_found_is_kept_though_it_is_late(begun: Begun) -> None:
    """A delay of arm7 and a zero that is off, which ended as the delay alone."""
    start, lead = begun.start, alone(begun, RINGS)
    lin = linearised(lead.state.problem, lead.state.minimum.vector)
    candidate = best_of(lin, CATALOGUE[SCALE], 2)
    assert candidate is not None
    missing = refitted(begun.bench, lead.state, [(candidate, lin)])
    late = replace(begun.bench, until=0.0)
    found = _with_second(late, start, lead.state, missing, [lead], linearised(start.problem, start.minimum.vector))
    assert found is not None and late.late
    assert [(a.effect.name, a.effect.joint) for a in found[1]] == [(RINGS, 2), (SCALE, 2)]
    assert found[0] is missing[0].state and reduced_chi2(late, found[0]) < 1.1


@pytest.mark.parametrize("names", [False, True])
def test_no_second_effect_is_looked_for_once_it_is_late(names: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything was tried beside the first, or once `names` were."""
    asked: list[str] = []
    bench: Any = SimpleNamespace(late=not names, say=asked.append)

    def likely(*of: object) -> list[Tried]:
        bench.late = True
        asked.append("names")
        return []

    nothing: Any = SimpleNamespace(
        problem=None, roughly=1.0, minimum=SimpleNamespace(vector=None, chi2=0.0), effects=(LinkCoulomb(1, (0.1,)),)
    )
    monkeypatch.setattr(ident.search.rounds, "linearised", lambda *of: asked.append("linearised"))
    monkeypatch.setattr(ident.search.rounds, "first_names", likely)
    monkeypatch.setattr(ident.search.rounds, "likely_names", lambda bench, state, lin, first: first)
    monkeypatch.setattr(ident.search.rounds, "hasty", lambda *of: pytest.fail("looked for"))
    tried: Any = [Tried(SimpleNamespace(effect=nothing.effects[0], key="rubs"), nothing)]  # type: ignore[arg-type]
    assert _with_second(bench, nothing, nothing, (), tried, nothing) is None
    assert asked == ["linearised", "names"] * names
    assert _two(bench, nothing, tried, nothing) is None and len(asked) == 2 * names


@pytest.mark.bench
def test_an_effect_to_which_another_only_led_is_added_alone(begun: Begun) -> None:
    bench = begun.bench
    state = alone(begun, RINGS)[1]
    lin = linearised(state.problem, state.minimum.vector)
    candidate = best_of(lin, CATALOGUE["time-offset"], 1)
    assert candidate is not None
    ((_, lead),) = refitted(bench, state, [(candidate, lin)])
    lead = replace(lead, minimum=replace(lead.minimum, chi2=0.5 * state.minimum.chi2))
    found = _two(bench, state, [Tried(candidate, lead)], lin)
    assert found is not None
    assert [e.name for e in found[0].effects] == [RINGS, SCALE] and [a.effect.name for a in found[1]] == [SCALE]


def test_nothing_is_pursued_that_leaves_more_where_records_that_fit_let_the_arm_bend(
    begun: Begun, monkeypatch: pytest.MonkeyPatch
) -> None:
    candidate, state = alone(begun, RINGS)
    tried = [Tried(candidate, replace(state, select=2.0 * begun.start.select))]
    monkeypatch.setattr(ident.search.rounds, "polished", lambda *of: pytest.fail("pursued"))
    start = begun.start
    lin = linearised(start.problem, start.minimum.vector)
    found = _best(begun.bench, start, lin, [], [tried], bends=True)
    assert found == (None, tried)


@pytest.mark.parametrize(("gain", "pursued"), [(2.0 * LEAST_GAIN, True), (0.5 * LEAST_GAIN, False)])
def test_a_little_is_pursued_by_what_leaves_less_as_roughly_fitted(
    gain: float, pursued: bool, begun: Begun, monkeypatch: pytest.MonkeyPatch
) -> None:
    candidate, state = alone(begun, RINGS)
    roughly = []

    def without(bench: Bench, state: State, effect: Effect, how: float) -> State:
        roughly.append(how)
        return replace(state, select=state.select + gain)

    monkeypatch.setattr(ident.search.rounds, "without", without)
    assert _gaining(begun.bench, [Tried(candidate, state)]) == pursued and roughly == [state.roughly]
    assert not _gaining(begun.bench, [])


def test_a_torque_that_friction_balances_is_tried_as_large_as_is_plausible(begun: Begun) -> None:
    lin = linearised(begun.start.problem, begun.start.minimum.vector)
    rubs, scale = MotorCoulomb(1, (0.1,)), TorqueScale(1, (0.02,))
    assert [(c.effect.name, c.effect.joint, c.effect.values) for c in balanced(lin, [rubs])] == [
        (SCALE, 1, (0.05,)),
        (SCALE, 1, (-0.05,)),
    ]
    assert balanced(lin, [rubs, scale]) == balanced(lin, [scale]) == []


def test_what_drags_is_tried_beside_what_rubs_whatever_it_promises(begun: Begun) -> None:
    lin = linearised(begun.start.problem, begun.start.minimum.vector)
    rubs, drags = LinkCoulomb(1, (0.1,)), LinkViscous(1, (0.02,))
    names, curves = besides(lin, [rubs])
    assert [(c.effect.name, c.effect.joint) for c in names] == [("link-viscous", 1)]
    assert [(c.effect.port, c.effect.joint, set(c.effect.values)) for c in curves] == [("link", 1, {0.0})]
    assert not besides(lin, [rubs, drags])[0]
    assert [c.effect.name for c in besides(lin, [MotorCoulomb(1, (0.1,))])[0]] == ["motor-quadratic-drag"]
    assert besides(lin, [drags]) == ([], [])


def test_what_gives_is_tried_beside_all_else_that_gives_there(begun: Begun) -> None:
    lin = linearised(begun.start.problem, begun.start.minimum.vector)
    rings = alone(begun, RINGS)

    def others(one: Tried, tried: list[Tried]) -> list[Tried]:
        return giving(begun.bench, begun.start, lin, one, tried)

    found = others(rings, [rings])
    names = {candidate.effect.name for candidate, _ in found}
    assert {"link-flexibility", "spring-relaxation"} <= names and RINGS not in names
    assert {candidate.effect.joint for candidate, _ in found} == {2}
    assert others(rings, [rings, *found]) == []
    assert others(alone(begun, SCALE), []) == [], "no impedance"


def test_none_leads_that_hardly_explains_the_records_that_fit(begun: Begun) -> None:
    start = begun.start
    lead = alone(begun, RINGS)
    weak = replace(lead[1], minimum=replace(lead[1].minimum, chi2=0.9 * start.minimum.chi2))
    lin = linearised(start.problem, start.minimum.vector)
    assert _two(begun.bench, start, [lead.refitted(weak)], lin) is None


@pytest.mark.parametrize(("at_minimum", "name"), [(1.0, RINGS), (2000.0, "unknown")])
def test_a_curve_is_taken_only_where_no_name_does_as_well_at_its_minimum(
    at_minimum: float, name: str, begun: Begun, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A name that far from it leaves a thousand times what the curve does."""
    bench, (candidate, state) = begun.bench, alone(begun, RINGS)
    dof = degrees(bench.split.select)
    curve = learned("link", "velocity", [-1.0, 1.0])(2, (-0.1, 0.1))
    named = Tried(candidate, replace(state, select=1000.0 * dof))
    drawn = Tried(Candidate(curve, 0.0, (1.0, 1.0)), replace(state, effects=(curve,), select=0.99 * dof))
    tried = [named, drawn]
    monkeypatch.setattr(ident.search.rounds, "polished", lambda bench, tried, before: tried)
    monkeypatch.setattr(
        ident.search.rounds, "fully", lambda bench, s: s if s is drawn[1] else replace(s, select=at_minimum * dof)
    )
    lin = linearised(begun.start.problem, begun.start.minimum.vector)
    much = 5000.0 * dof
    best, _ = _best(replace(bench, at_first=much), replace(begun.start, select=much), lin, [], [tried])
    assert best is not None and best[0].effect.name == name


@pytest.mark.bench
def test_friction_that_falls_with_speed_is_found_where_its_motion_is_followed() -> None:
    """From where plainer friction leads; a fit that holds the motion ends far from there, from what promises most."""
    true = (0.004, 0.008, 3.0)
    begun = begun_with("motor-stribeck:level=0.004,peak=0.008,speed=3@joint2", f0=1.0, seed=22)
    bench, start = begun.bench, begun.start
    lin = linearised(start.problem, start.minimum.vector)
    plain, falling = (best_of(lin, CATALOGUE[f"motor-{name}"], 1) for name in ("coulomb", "stribeck"))
    assert plain is not None and falling is not None
    tried, (held,) = (refitted(bench, start, [(c, lin)]) for c in (plain, falling))
    assert reduced_chi2(bench, fitted(bench, Refit.of(held.state))) > 30.0
    *_, found = rubbing_anew(bench, start, lin, tried)
    state = fitted(bench, Refit.of(found.state))
    assert reduced_chi2(bench, state) < 3.0 and state.effects[-1].values == pytest.approx(true, rel=0.1)
