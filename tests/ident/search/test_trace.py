"""What candidates promise: to first order what they do to the very arm that was fitted, whichever way its gears turn."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnosed import CELLS, ROOT

import ident.search.candidates
import ident.search.plausible
import ident.search.trace
from ident.arm.arm_fit import Problem, hold, residual, whitened_by
from ident.arm.arm_model import stiffness
from ident.arm.coupled import declared_start, problem_of
from ident.arm.evidence import evidence, gravity_basis
from ident.arm.scene import linear_extra
from ident.effects.base import Effect
from ident.effects.carried import carrying
from ident.effects.catalogue import CATALOGUE
from ident.effects.friction import LinkViscous, MotorCoulomb, MotorStribeck
from ident.effects.motor import TorqueOffset
from ident.effects.response import Response, response
from ident.effects.sensor import JointZeroOffset
from ident.records.campaign import Array, Campaign
from ident.records.frf import estimate
from ident.search.candidates import Candidate, added, best_of, catalogue, otherwise, sized_together, surest
from ident.search.curves import responses, wave
from ident.search.periods import Spectrum, spectrum
from ident.search.resized import as_strong
from ident.search.trace import Linearised, distorts, linearise, port_shares
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot, make_model
from symgen.robot import load_robot

ROBOT = load_robot(ROOT / "robots/ypp3")
CHAIN = chain_of_robot(ROBOT)
MODEL = make_model(CHAIN, believe_zeros=True)
FAR, CHANGED = JointZeroOffset(2, (1.2,)), CATALOGUE["change-between-records"](0, (1.0, 0.6, 0.0, 0.0))
COUPLED, VISCOUS = CATALOGUE["motor-coupling"](0, (0.3, 1.0)), CATALOGUE["link-viscous"](0, (1e-3,))
LATE, WEAK, RELAXED = (CATALOGUE[name](1, values) for name, values in (
    ("input-delay", (3e-3,)), ("torque-scale", (0.3,)), ("spring-relaxation", (450.0, 0.02)),
))  # fmt: skip
BENT = CATALOGUE["link-flexibility"](1, (2e5, 0.6, 2e-4, 1.0))
BASE = CATALOGUE["base-compliance"](None, (5e4, 5e4, 150.0, 2e-4))


@cache
def campaign() -> Campaign:
    short = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=1.0, band=(1.0, 100.0), periods=3))
    return simulate(CHAIN, short, CELLS[1:2], workers=1)


def declared(c: Campaign, effects: tuple[Effect, ...], lines: str) -> tuple[Problem, Array]:
    """The declared arm with `effects`, and its record at such lines."""
    basis, frf = gravity_basis(MODEL, c.gravity), estimate(c.records[0], c)
    one, start = evidence(c, MODEL, basis, frf, 0, lines), declared_start(c, MODEL, (frf,), basis)
    values = [value for effect in effects for value in effect.values]
    scales, limits = [1e-3] * len(values), [(-np.inf, np.inf)] * len(values)
    problem = problem_of(c, MODEL, basis, (one,), start, effects, scales, limits)
    return problem, np.concatenate([start.vector(), values])


def left(effects: tuple[Effect, ...]) -> np.ndarray:
    """Measured less predicted angles of the declared arm with `effects` [L, m]."""
    problem, vector = declared(campaign(), effects, "usable")
    return residual(problem, vector, problem.data[0], None)[0]


def explained(there: tuple[Effect, ...], by: tuple[Effect, ...]) -> Linearised:
    """The declared arm with the effects `there`, of a record which tells that arm with those `by` which it was made."""
    problem, vector = declared(campaign(), there, "usable")
    (one,) = problem.data
    made = replace(one, scene=replace(one.scene, theta=one.scene.theta - left(by)))
    problem = replace(problem, data=(made,))
    return linearise(problem, vector, hold(problem, vector))


@pytest.mark.parametrize(
    ("there", "candidate"),
    [
        ((FAR,), JointZeroOffset(2, (1e-5,))),  # of another J than where the joint reads to be
        ((FAR,), CATALOGUE["link-flexibility"](1, (1e9, 0.6, 2e-4, 0.0))),
        ((CHANGED, COUPLED), VISCOUS),  # of another spring in this record, which loads both motors
        ((), CATALOGUE["input-delay"](1, (1e-6,))),  # of torques that are held
        ((LATE,), CATALOGUE["torque-lag"](1, (1e-6,))),  # and come late already
        ((WEAK,), CATALOGUE["input-delay"](None, (1e-6,))),
        ((RELAXED,), CATALOGUE["cable-stiffness"](1, (1e-2, 0.0))),  # of a motion in which the link pulls on the motor
    ],
    ids=lambda one: one.name if isinstance(one, Effect) else "",
)
def test_a_candidate_promises_what_it_does_to_the_fitted_arm(there: tuple[Effect, ...], candidate: Effect) -> None:
    lin = explained(there, there)
    does = whitened_by(lin.W[0], left(there) - left((*there, candidate)))
    (promised,) = added(lin, candidate)
    assert promised is not None
    assert np.linalg.norm(promised - does) < 0.03 * np.linalg.norm(does)


@pytest.mark.parametrize("there", [RELAXED, CATALOGUE["motor-coupling"](0, (0.1, 1.0))], ids=lambda one: one.name)
def test_links_pull_on_motors_beside_their_springs(there: Effect) -> None:
    """In the motion at whatever port is doubted: with the springs' law in doubt that pull is all that tells of the deflection."""
    lin = explained((there,), (there,))
    (scene,), ((p, _),) = lin.scenes, lin.arms
    _, _, Z_lm, Z_ll = stiffness(scene.arm, p, scene.s, linear_extra(scene, p, (there,)).impedance)
    x = scene.theta / scene.arm.N
    deflection = x + np.linalg.solve(Z_ll, Z_lm @ x[..., None])[..., 0]
    for port, motions in lin.motions.items():
        found = scene.at_lines(motions[0].of("deflection", scene.arm.live))
        assert np.linalg.norm(found - deflection) < 0.02 * np.linalg.norm(deflection), port


def test_a_spring_rests_under_the_torque_that_its_motor_gives() -> None:
    """Behind its gain, with its offset."""
    lin = explained((WEAK, CATALOGUE["torque-offset"](1, (0.05,))), ())
    (scene,), ((p, _),) = lin.scenes, lin.arms
    tau = 1.3 * scene.means[0, 1] + 0.05
    for (motion,) in lin.motions.values():
        assert motion.signal("deflection", 1).mean() == pytest.approx(scene.N[1] * tau / p.K[1])
        assert motion.signal("tau", 1).mean() == pytest.approx(1.3 * scene.means[0, 1])


def test_the_response_of_a_torque_is_what_the_fit_would_have_beside_the_gains_it_has() -> None:
    found = response("motor", np.geomspace(1.0, 100.0, 9).tolist())(1, (0.05,) * 8 + (2e-4,) * 9)
    lin = explained((LATE,), (LATE, found))
    (best,) = (one.effect for one in responses(lin, 0.0) if (one.effect.port, one.effect.joint) == ("motor", 1))
    assert isinstance(best, Response)
    np.testing.assert_allclose(best.at_frequencies(np.geomspace(20.0, 90.0, 9))[0], np.exp(0.05), rtol=1e-2)


def test_a_band_has_the_share_of_its_own_lines() -> None:
    """What a delay leaves acts where torques do, in each band; of lines that no record has nothing is in excess."""
    lin = explained((), (LATE,))
    f, lines = lin.problem.data[0].sampling.f, np.abs(lin.r[0]) ** 2
    excess = [2.0 * float((lines[use] - 1.0).sum()) for use in (f < 10.0, f >= 10.0, f > 0.0)]
    low, high, whole = (
        {(port, joint): share for port, joint, share in port_shares(lin, *band)} for band in ((0.0, 10.0), (10.0,), ())
    )
    for port in whole:
        assert low[port] * excess[0] + high[port] * excess[1] == pytest.approx(whole[port] * excess[2], rel=1e-9)
    assert whole["motor", 1] == max(whole.values()) > 0.9
    assert {share for *_, share in port_shares(lin, 200.0)} == {0.0}


@pytest.mark.parametrize(("peak", "least", "most"), [(0.0, 1.0, 1.0), (0.02, 1.05, 1.95)])
def test_a_plainer_friction_is_as_strong_as_the_one_it_is_to_replace(peak: float, least: float, most: float) -> None:
    """The level of one without a peak; else between that and the level at rest."""
    lin = explained((), ())
    candidate = Candidate(MotorCoulomb(1, (1e-4,)), 1.0, (1.0,))
    strong = as_strong(lin, candidate, MotorStribeck(1, (0.02, peak, 5.0))).effect
    assert least * 0.02 * (1 - 1e-9) <= strong["level"] <= most * 0.02 * (1 + 1e-9)
    assert as_strong(lin, candidate, TorqueOffset(1, (0.0,))) == candidate  # what does nothing


def test_what_is_left_at_lines_that_nothing_excites_distorts() -> None:
    """Not what is left at excited ones, however much."""
    one = SimpleNamespace(use=np.array([True, True, True, False]), is_excited=np.array([True, False, False, False]))
    left = np.array([[1e3], [12.0], [12.0], [1e3]])
    lin: Any = SimpleNamespace(problem=SimpleNamespace(data=[one]), r=[left])
    assert distorts(lin)
    lin.r = [np.where(left == 12.0, 8.0, left)]
    assert not distorts(lin)


def test_links_that_an_effect_carries_are_no_sizes_of_it() -> None:
    """They stay where they are, and one is a large step of each: so it is tried in another shape, too."""
    directions = 0.1 * np.random.default_rng(2).normal(size=(30, 2)) * CHAIN.parameters[:, None]
    true = carrying(BENT, directions).with_values([*BENT.values, 0.5, -1.0])
    lin = explained((), (true,))
    (found,) = otherwise(lin, true.with_value(3, 0.0))
    assert found.effect.values == true.values and found.scales[-2:] == (1.0, 1.0)


def test_a_reversed_gear_moves_its_link_as_the_other_does() -> None:
    """The same record, told by motors that turn the other way."""
    c, sign = campaign(), np.array([1.0, -1.0, -1.0])
    records = tuple(replace(one, tau=one.tau * sign, theta=one.theta * sign) for one in c.records)
    lins = []
    for told in (c, replace(c, N=c.N * sign, records=records)):
        problem, vector = declared(told, (CATALOGUE["link-coulomb"](1, (0.1,)),), "every")
        lins.append(linearise(problem, vector, hold(problem, vector)))
    for port in ("motor", "spring", "link"):
        moves = [lin.motions[port][0].of("q", range(3)) for lin in lins]
        np.testing.assert_allclose(moves[1], moves[0], rtol=1e-6, atol=1e-9 * np.abs(moves[0]).max())
    waves: list[Any] = [spectrum(lin, "motor", "motor", 1, 40.0, 0.5) for lin in lins]
    assert waves[1] is not None and waves[1].fall.max() == pytest.approx(waves[0].fall.max(), rel=1e-2)


def test_a_joint_that_hardly_moves_tells_no_order() -> None:
    """Two milliradians of its motor, of 2 pi a turn: no wave of up to a hundred a turn is told from any other."""
    c = campaign()
    (one,) = c.records
    at_rest = [signal.mean(axis=0) for signal in (one.tau, one.theta)]
    less = 2e-3 / float(np.ptp(one.theta[:, 1]))
    tau, theta = (rest + less * (signal - rest) for rest, signal in zip(at_rest, (one.tau, one.theta), strict=True))
    problem, vector = declared(replace(c, records=(replace(one, tau=tau, theta=theta),)), (), "usable")
    lin = linearise(problem, vector, hold(problem, vector))
    assert spectrum(lin, "motor", "motor", 1, 100.5, 0.5) is None and wave(lin, "motor", 1, 100.5) is None
    found = [
        best_of(lin, CATALOGUE[name], 1) for name in ("torque-ripple", "transmission-error", "encoder-eccentricity")
    ]
    assert {one.effect["order"] for one in found if one is not None} <= {1.0}


def test_orders_are_looked_for_within_their_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an encoder up to 64, of a torque up to 100: however well one beyond does."""
    lin = explained((), (CATALOGUE["encoder-eccentricity"](1, (1e-3, 64.0, 0.4)),))
    rising = Spectrum(np.arange(1.0, 101.0), np.arange(1.0, 101.0), 0.5)
    monkeypatch.setattr(ident.search.plausible, "spectrum", lambda *asked: rising)
    for name, highest in (("encoder-eccentricity", 64.0), ("torque-ripple", 100.0)):
        found = best_of(lin, CATALOGUE[name], 1)
        assert found is not None and highest - 1.0 <= found.effect["order"] <= highest


def test_where_much_is_left_candidates_promise_by_few_lines_what_they_do_by_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """But what changes from one record to the next, which all records tell."""
    lin, asked = explained((), (CATALOGUE["link-viscous"](0, (20.0,)),)), {}
    best = ident.search.candidates.best_of

    def seen(of: Linearised, kind: type[Effect], joint: int | None) -> Candidate | None:
        asked[kind.name] = of.problem.data[0].count
        return best(of, kind, joint) if kind.name in ("link-viscous", "link-coulomb") else None

    monkeypatch.setattr(ident.search.candidates, "best_of", seen)
    monkeypatch.setattr(ident.search.trace, "FEW_LINES", 15)
    monkeypatch.setattr(ident.search.candidates, "MUCH", 0.01)
    few = catalogue(lin, ())
    lines = lin.problem.data[0].count
    assert lines > 30 and asked["link-viscous"] == 15 and asked["change-between-records"] == lines
    monkeypatch.setattr(ident.search.candidates, "MUCH", np.inf)
    every = catalogue(lin, ())
    assert asked["link-viscous"] == lines and few[0].key == every[0].key == ("link-viscous", 0, "link")
    assert few[0].gain == pytest.approx(every[0].gain, rel=0.5)
    np.testing.assert_allclose(few[0].effect.values, every[0].effect.values, rtol=0.1)


def test_friction_that_would_have_to_push_promises_nothing_as_it_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    """Joints that are held move by a count of their encoders: of 16 records without effects Stribeck friction, -5.4 times that of those that
    slide, promised 220."""
    falls = {VISCOUS: (1.0, 12.0), CATALOGUE["motor-coulomb"](2, (5e-6,)): (-5.4, 220.0)}
    monkeypatch.setattr(
        ident.search.candidates, "catalogue", lambda lin, taken, workers: [Candidate(e, 12.0, (1.0,)) for e in falls]
    )
    monkeypatch.setattr(ident.search.candidates, "added", lambda lin, effect: effect)

    def step(columns: list[Effect]) -> tuple[list[float], float]:
        size, fall = falls[columns[0]]
        return [size], fall

    lin: Any = SimpleNamespace(step=step)
    assert surest(lin) == 12.0


def test_an_effect_of_the_arm_alone_is_promised_in_an_arm_of_one_joint(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that may be either is of its joint there; what every simulated arm has is never looked for."""
    monkeypatch.setattr(ident.search.candidates, "degrees", lambda data: 1)
    monkeypatch.setattr(
        ident.search.candidates, "best_of", lambda lin, kind, joint: Candidate(kind(joint, ()), 1.0, ())
    )

    def asked(n: int, *taken: Effect) -> set[tuple[str, int | None]]:
        lin: Any = SimpleNamespace(problem=SimpleNamespace(n=n, data=None), prepare=lambda: None, chi2=0.0)
        return {(c.effect.name, c.effect.joint) for c in catalogue(lin, taken)}

    arm = {("base-compliance", None), ("gravity-stiffness", None)}
    assert {one for one in asked(1) if one[1] is None} == arm and ("torque-lag", 0) in asked(1)
    assert asked(1, BASE) == asked(1) - {("base-compliance", None)}
    assert asked(2) >= arm | {("torque-lag", 0), ("torque-lag", 1), ("torque-lag", None)}


def test_what_acts_at_several_joints_is_sized_beside_each_other() -> None:
    """To first order all are right at once, and one that is none is nothing or, where it would have to push, left out; alone the second is not."""
    lin = explained((), (LinkViscous(1, (1e-2,)), LinkViscous(2, (0.4,))))
    found = sized_together(lin, [Candidate(LinkViscous(joint, (1.0,)), 1.0, (1.0,)) for joint in (0, 1, 2)])
    sizes = {one.effect.joint: one.effect["damping"] for one in found}
    alone = best_of(lin, LinkViscous, 1)
    assert sizes[1] == pytest.approx(1e-2, rel=0.01) and sizes[2] == pytest.approx(0.4, rel=0.01)
    assert sizes.get(0, 0.0) < 1e-4
    assert alone is not None and abs(alone.effect["damping"] - 1e-2) > 1e-3
