"""Derivatives of the residual, through whatever the effects do to the arm: against differences of the residual itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnosed import CELLS, ROOT, diagnosis

from ident.arm.arm_fit import Problem, hold, residual
from ident.arm.coupled import Start, declared_start, problem_of
from ident.arm.descent import _by_compliance, _further, _step, _taken, minimise
from ident.arm.evidence import Evidence, evidence, gravity_basis
from ident.arm.sums import Sums
from ident.effects.base import Effect
from ident.effects.catalogue import CATALOGUE
from ident.effects.motion import Motion
from ident.effects.response import response
from ident.effects.sensor import JointZeroOffset
from ident.effects.structure import BaseCompliance, LinkFlexibility
from ident.records.campaign import Array, Campaign
from ident.records.frf import estimate
from ident.simulator.bench import simulate
from symgen.plan import Model, chain_of_robot, make_model
from symgen.robot import load_robot

#: Of a large step; forward differences and far aliases leave 1e-4.
STEP, CLOSE = 1e-5, 1e-3
#: Of the derivative by a gain what aliases at a tenth of the sampling rate are.
ALIASED = 1e-2


def sized(kind: type[Effect], K: float) -> Effect:
    """An effect of the second joint that is felt: its first plausible sizes, what is given in shares of K so."""
    values = [p.sizes[0] * (K if p.relative == "K" else 0.01 if p.relative else 1.0) for p in kind.parameters]
    return kind(1 if "joint" in kind.scope else None, tuple(values))


@cache
def told() -> tuple[Campaign, Model, Array, Evidence, Start]:
    """One record of an arm that is as declared, and what a fit is given of it."""
    robot = load_robot(ROOT / "robots/ypp3")
    chain = chain_of_robot(robot)
    short = replace(robot, experiment=replace(robot.experiment, f0=1.0, band=(1.0, 100.0), periods=3))
    c = simulate(chain, short, CELLS[1:2], workers=1)
    model, frf = make_model(chain, believe_zeros=True), estimate(c.records[0], c)
    basis = gravity_basis(model, c.gravity)
    return c, model, basis, evidence(c, model, basis, frf, 0, "every"), declared_start(c, model, (frf,), basis)


def by_differences(
    effects: Sequence[Effect], one: Evidence, scales: Sequence[float], share: float
) -> Iterator[tuple[int, Array, Array]]:
    """The place, the derivative and the central difference over so large a `share` of every number of the last effect that is not whole, all
    that is free."""
    c, model, basis, _, start = told()
    problem = problem_of(c, model, basis, (one,), start, tuple(effects), scales, [(-np.inf, np.inf)] * len(scales))
    last, vector = effects[-1], np.concatenate([start.vector(), *(effect.values for effect in effects)])
    free = np.zeros(len(vector), dtype=bool)
    free[-len(last.values) :] = [not p.whole for p in last.parameters]
    problem = replace(problem, free=free, turns=0)
    (kept,) = hold(problem, vector)
    _, slopes, columns = residual(problem, vector, one, kept.moved, derive=True)
    tried = [k for k, column in enumerate(columns) if free[column]]
    assert len(tried) == free.sum()
    for k in tried:
        step = np.zeros(len(vector))
        step[columns[k]] = share * max(abs(vector[columns[k]]), 1e-4)
        ahead, behind = (residual(problem, vector + sign * step, one, kept.moved)[0] for sign in (1.0, -1.0))
        yield int(columns[k]), slopes[:, :, k], (ahead - behind) / (2.0 * step[columns[k]])


@pytest.mark.parametrize("name", CATALOGUE)
def test_derivatives_by_the_arm_are_differences_whatever_acts(name: str) -> None:
    c, model, basis, one, start = told()
    effect = sized(CATALOGUE[name], float(start.K[1]))
    many = len(effect.values)
    problem = problem_of(c, model, basis, (one,), start, (effect,), [1e-3] * many, [(-np.inf, np.inf)] * many)
    problem = replace(problem, free=np.arange(len(problem.free)) < problem.base, turns=0)
    vector = np.concatenate([start.vector(), effect.values])
    (kept,) = hold(problem, vector)
    _, slopes, columns = residual(problem, vector, one, kept.moved, derive=True)
    size = np.abs(slopes * problem.scale[columns]).max(axis=(0, 1))
    for column, slope, largest in zip(columns, np.moveaxis(slopes, 2, 0), size, strict=True):
        step = np.zeros(len(vector))
        step[column] = STEP * problem.scale[column]
        ahead, behind = (residual(problem, vector + sign * step, one, kept.moved)[0] for sign in (1.0, -1.0))
        found = (ahead - behind) / (2.0 * STEP)
        assert np.abs(found - slope * problem.scale[column]).max() <= CLOSE * max(largest, 1e-6 * size.max()), column


@pytest.mark.parametrize(
    ("effect", "close"),
    [
        (CATALOGUE["torque-lag"](1, (1e-3,)), ALIASED),
        (CATALOGUE["input-delay"](None, (5e-4,)), ALIASED),
        (CATALOGUE["torque-scale"](0, (0.1,)), ALIASED),
        (CATALOGUE["time-offset"](1, (1e-4,)), ALIASED),
        (CATALOGUE["change-between-records"](1, (2.0, 0.2, -0.3, 0.1)), CLOSE),
        (CATALOGUE["drift-over-records"](2, (3.0, -0.1, 0.5)), CLOSE),
        # of a response beyond its last knot aliases are a larger part
        (response("motor", [1.0, 10.0, 30.0, 100.0])(1, (0.1, -0.2, 0.1, 1e-3, 1e-3, 5e-4, 2e-4)), 3.0 * ALIASED),
        (response("sensor", [1.0, 10.0, 30.0, 100.0])(1, (0.1, -0.2, 0.1, 1e-3, 1e-3, 5e-4, 2e-4)), ALIASED),
    ],
    ids=lambda one: getattr(one, "name", "") + getattr(one, "port", ""),
)
def test_derivatives_by_gains_and_shares_are_differences(effect: Effect, close: float) -> None:
    """Of the fourth record of an arm on which another effect acts, too."""
    one, viscous = replace(told()[3], index=3), CATALOGUE["link-viscous"](1, (0.1,))
    for column, slope, found in by_differences((viscous, effect), one, [1e-3] * (1 + len(effect.values)), 1e-4):
        assert 0.0 < np.abs(found - slope).max() <= close * np.abs(found).max(), column


@pytest.mark.parametrize(
    "effect",
    [
        LinkFlexibility(0, (6e3, 0.75, 1.5e-4, 0.0)),
        CATALOGUE["attached-resonator"](2, (0.003, 40.0, 0.0004)),
        CATALOGUE["spring-relaxation"](1, (600.0, 0.02)),
        CATALOGUE["locked-joint-elasticity"](1, (4500.0, 1e-4)),
    ],
    ids=lambda one: one.name,
)
def test_derivatives_by_what_rings_are_as_exact_as_what_is_nearly_undone_by_others_needs(effect: Effect) -> None:
    """Off by 2e-3, of differences over 1e-4 of a stiffness, they ended fits of a link that bends at 5.7e3 Nm/rad, 121 above the chi^2 of its
    15e3: of what stiffness, share and links do together all but a ten millionth is undone by each other."""
    for column, slope, found in by_differences((effect,), told()[3], np.abs(effect.values), 1e-5):
        assert np.abs(found - slope).max() <= 5e-5 * np.abs(found).max(), column


def test_what_is_pressed_against_its_bound_is_left_there() -> None:
    """The others step as if it were not free: their steps together with it would lead elsewhere."""
    every, none = np.array([True, True]), np.array([False, False])
    problem = SimpleNamespace(
        low=np.array([0.0, -9.0]),
        high=np.array([9.0, 9.0]),
        free=every,
        giving=none,
        springs=none,
        shapes=none,
        dampings=none,
        scale=np.ones(2),
    )
    information, slope = np.array([[2.0, 1.9], [1.9, 2.0]]), np.array([0.4, 0.3])
    inside = _step(problem, np.array([1.0, 0.0]), slope, information, 0.0)  # type: ignore[arg-type]
    np.testing.assert_allclose(information @ inside, -slope)
    pressed = _step(problem, np.array([0.0, 0.0]), slope, information, 0.0)  # type: ignore[arg-type]
    np.testing.assert_allclose(pressed, [0.0, -0.15])
    away = _step(problem, np.array([0.0, 0.0]), -slope, information, 0.0)  # type: ignore[arg-type]
    np.testing.assert_allclose(away, -inside)


def _damped(slope: float, information: Array) -> Array:
    """The step of a parameter and the logarithm of a damping, the first of which has a gradient of 0.3."""
    free, damping = np.array([True, True]), np.array([False, True])
    low, high = np.full(2, -np.inf), np.full(2, np.inf)
    problem = SimpleNamespace(
        low=low, high=high, free=free, giving=~free, springs=~free, shapes=~free, dampings=damping, scale=np.ones(2)
    )
    step = _step(problem, np.zeros(2), np.array([0.3, slope]), information, 0.0)  # type: ignore[arg-type]
    return np.stack([step, _taken(problem, np.zeros(2), step)])  # type: ignore[arg-type]


def test_a_damping_that_would_vanish_leaves_the_others_their_step() -> None:
    """It wants -40 and may go -1: cut alone, the first would step as if it had gone all the way, uphill."""
    information = np.array([[2.0, 0.1], [0.1, 0.01]])
    assert np.abs(np.linalg.solve(information, [-0.3, -0.2]))[1] > 30.0
    step, _ = _damped(0.2, information)
    np.testing.assert_allclose(step, [-(0.3 - 0.1) / 2.0, -1.0])


def test_what_nothing_shows_does_not_turn_the_step_when_it_is_cut() -> None:
    """The last would go 50 for a little more, and may go 1; the others go where chi^2 is least then, which still falls."""
    information = np.array([[2.0, 0.0, 0.2], [0.0, 2.0, 0.1], [0.2, 0.1, 0.03]])
    slope, every, none = np.array([0.3, 0.3, -0.8]), np.ones(3, dtype=bool), np.zeros(3, dtype=bool)
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    problem = SimpleNamespace(
        low=low, high=high, free=every, giving=none, springs=none, shapes=none, dampings=none, scale=np.ones(3)
    )
    whole = -np.linalg.solve(information, slope)
    assert whole[2] > 50.0 and np.clip(whole, -1.0, 1.0) @ slope < -1.0
    step = _step(problem, np.zeros(3), slope, information, 0.0)  # type: ignore[arg-type]
    np.testing.assert_allclose(step, [-(0.3 + 0.2) / 2.0, -(0.3 + 0.1) / 2.0, 1.0])

    def left(step: Array) -> float:
        return float(2.0 * step @ slope + step @ information @ step)

    assert left(step) < left(np.clip(whole, -1.0, 1.0)) - 1.0


@pytest.mark.parametrize("step", [-0.3, -0.2, 0.3])
def test_a_joints_spring_gives_way_as_much_as_one_behind_it_takes_on(step: float) -> None:
    """What both give together stays, however far they go: there is no bend in the valley along them."""
    K, k = 5000.0, 8000.0
    every, springs = np.array([True, True]), np.array([True, False])
    low, high = np.full(2, -np.inf), np.full(2, np.inf)
    problem = SimpleNamespace(
        low=low,
        high=high,
        free=every,
        giving=~springs,
        springs=springs,
        shapes=~every,
        dampings=~every,
        scale=np.array([1.0, 1000.0]),
    )
    steps = np.array([step, -step * k / K * k / 1000.0])
    log_K, other = _taken(problem, np.array([np.log(K), k]), steps)  # type: ignore[arg-type]
    assert abs(np.exp(log_K) / K - 1.0) > 0.1
    assert 1.0 / np.exp(log_K) + 1.0 / other == pytest.approx(1.0 / K + 1.0 / k)


@pytest.mark.parametrize(
    ("step", "after"), [(1.0, 0.033), (-0.01, 0.003 * np.exp(-0.1)), (-0.1, 0.003 / np.e), (-1.0, 0.003 / np.e)]
)
def test_a_time_falls_to_a_part_of_itself_at_most_in_a_step(step: float, after: float) -> None:
    """From three times what it is it went to its least at once, where it is not felt, and stayed: three times the noise was left."""
    none, bounds = np.array([False]), (np.array([5e-4]), np.array([20.0]))
    problem = SimpleNamespace(
        low=bounds[0],
        high=bounds[1],
        free=~none,
        giving=none,
        springs=none,
        shapes=~none,
        dampings=none,
        scale=np.array([0.03]),
    )
    (found,) = _taken(problem, np.array([0.003]), np.array([step]))  # type: ignore[arg-type]
    assert found == pytest.approx(after)


def test_the_shapes_that_are_never_nothing() -> None:
    """But what gives has its own way, and an order is a whole number."""
    names = ("spring-relaxation", "motor-stribeck", "torque-ripple", "attached-resonator", "drift-over-records")
    effects = tuple(CATALOGUE[name].of(1, {}) for name in names)
    problem: Any = SimpleNamespace(
        effects=effects, base=0, giving=np.zeros(sum(len(e.values) for e in effects), dtype=bool)
    )
    shapes = Problem.shapes.func(problem)  # type: ignore[attr-defined]
    named = [p.name for e in effects for p in e.parameters]
    assert [name for name, is_shape in zip(named, shapes, strict=True) if is_shape] == [
        "time",
        "speed",
        "frequency",
        "records",
    ]
    problem.giving = np.array([name == "frequency" for name in named])
    assert sum(Problem.shapes.func(problem)) == 3  # type: ignore[attr-defined]


def test_what_gets_stiffer_far_stays_a_spring() -> None:
    """The compliance would be nothing at 1."""
    changes = np.array([0.4999, 0.5001, 1.0, 3.0])
    stiffer = _by_compliance(changes)
    assert stiffer[0] == pytest.approx(stiffer[1], rel=1e-3) and (np.diff(stiffer) > 0.0).all() and stiffer[-1] == 12.0


def test_a_damping_that_is_not_felt_grows_until_it_is_if_it_is_missed() -> None:
    felt = 1e-3  # of a standard deviation
    _, taken = _damped(-felt * 95.0, np.diag([2.0, felt**2]))
    assert np.exp(taken[1]) == pytest.approx(np.e / felt)
    _, taken = _damped(-felt, np.diag([2.0, felt**2]))  # noise
    assert taken[1] == pytest.approx(1.0)


@pytest.mark.bench
def test_what_gives_is_found_from_where_it_is_hardly_felt() -> None:
    """A base 200 times stiffer than it is, its own mode 10 times higher: a step of its stiffness is none of its compliance."""
    robot = load_robot(ROOT / "robots/ypp3")
    brief = replace(robot.experiment, f0=2.0, band=(2.0, 100.0), periods=3)
    true = np.array([8e4, 2e5, 150.0, 2e-4])
    cells = [
        ("joint1", [0, 0.7, 0.5]),
        ("joint2", [0, 0.2, 1.2]),
        ("joint1", [0, 0.2, 1.2]),
        ("joint3", [0, 1.2, -1.0]),
    ]
    chain = chain_of_robot(robot)
    base = BaseCompliance(None, tuple(true.tolist()))
    c = simulate(chain, replace(robot, experiment=brief), cells, effects=[base], workers=1)
    model = make_model(chain, believe_zeros=True)
    responses = tuple(estimate(record, c) for record in c.records)
    basis = gravity_basis(model, c.gravity)
    data = tuple(evidence(c, model, basis, frf, k, "every") for k, frf in enumerate(responses))
    start = declared_start(c, model, responses, basis)
    stiff = true * [1.0, 200.0, 10.0, 1.0]
    limits = [(1e3, 1e9), (1e3, 1e9), (20.0, 1e4), (0.0, 0.01)]
    problem = problem_of(c, model, basis, data, start, (base,), stiff.tolist(), limits)
    found = minimise(problem, np.concatenate([start.vector(), stiff]), (), 2, 1e-4).vector[-4:]
    np.testing.assert_allclose(found[:3], true[:3], rtol=0.1)


@pytest.mark.bench
def test_a_winding_valley_is_followed_by_its_bend() -> None:
    """A spring behind a spring: from far along the valley of their stiffnesses, steps of stiffness go 9 % of the way; what both give
    adds up, and is stepped along."""
    robot = load_robot(ROOT / "robots/ypp3")
    sharp = tuple(replace(drive, encoder_counts=2**20) for drive in robot.drives)
    brief = replace(robot.experiment, f0=2.0, band=(2.0, 200.0), periods=3, torque_noise=5e-4)
    short = replace(robot, experiment=brief, drives=sharp)
    bend = LinkFlexibility(0, (6000.0, 0.64, 2e-4, 0.0))
    cells = [(joint, [0, a, b]) for a, b in ((0.7, 0.5), (1.2, -1.0)) for joint in ("joint1", "joint2")]
    c = simulate(chain_of_robot(robot), short, cells, effects=[bend], workers=1)
    model = make_model(chain_of_robot(robot), believe_zeros=True)
    responses = tuple(estimate(record, c) for record in c.records)
    basis = gravity_basis(model, c.gravity)
    data = tuple(evidence(c, model, basis, frf, k, "every") for k, frf in enumerate(responses))
    start = declared_start(c, model, responses, basis)
    limits = [(50.0, 1e6), (0.05, 0.95), (0.0, 0.01), (0.0, 0.0)]
    problem = problem_of(c, model, basis, data, start, (bend,), [6000.0, 0.6, 2e-4, 1.0], limits)
    problem = replace(problem, free=np.arange(problem.base + 4) < problem.base + 3)
    vector = np.concatenate([start.vector(), bend.values])
    vector[0] += np.log(0.75)
    pinned = replace(problem, free=problem.free & (np.arange(len(vector)) != 0))
    along = minimise(pinned, vector, (), 3).vector

    found = minimise(problem, along, (), 3, 1e-4).vector
    assert 0.9 < (found[0] - along[0]) / np.log(1.0 / 0.75) < 1.1


@pytest.mark.bench
def test_at_another_posture_what_is_of_second_order_is_another_too() -> None:
    d = diagnosis()
    basis = gravity_basis(d.model, d.campaign.gravity)
    one, frf = d.start.problem.data[1], d.responses[d.start.problem.data[1].index]
    moved = d.start.problem.scene(one, (JointZeroOffset(2, (0.3,)),))
    turned = replace(frf, posture=frf.posture + np.array([0.0, 0.0, 0.3]))
    there = evidence(d.campaign, d.model, basis, turned, one.index, "every").scene
    assert moved.slopes is not None and there.slopes is not None and one.scene.slopes is not None
    for mine, right, untold in zip(moved.slopes, there.slopes, one.scene.slopes, strict=True):
        np.testing.assert_array_equal(mine, right)
        assert np.abs(mine - untold).max() > 0.05 * np.abs(untold).max()
    np.testing.assert_array_equal(moved.arm.J_rows, there.arm.J_rows)


class Valley(Sums):
    """What a record with one parameter leaves: a valley that is made anew by every motion."""

    steep: float
    bottom: Array | float
    left: float

    def equations(self, vector: Array) -> tuple[float, Array, Array]:
        away = vector - self.bottom
        return self.left + self.steep * float(away @ away), self.steep * away, self.steep * np.eye(1)

    def chi_squared(self, vector: Array) -> float:
        return self.equations(vector)[0]


def along_a_line(monkeypatch: pytest.MonkeyPatch, sums: type[Valley]) -> Problem:
    """A problem of one parameter that leaves what `sums` say."""
    monkeypatch.setattr("ident.arm.descent.summed", lambda problem: nullcontext(sums(problem, None, [])))
    one = np.ones(1)
    return Problem((), 0, 0, 1, (), one, -9.0 * one, 9.0 * one, one > 0.0, lambda scene, q: scene)


def test_a_fit_that_another_motion_leads_astray_ends_where_it_was_best(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each motion makes a valley of its own: the third, found at the minimum of the second, leaves a hundred times as much."""
    valleys = [(1.0, 50.0), (2.0, 10.0), (3.0, 1000.0)]
    motions = iter(valleys)

    class Valleys(Valley):
        steep = 100.0

        def hold(self, vector: Array, doubt: float = 0.0) -> None:
            self.bottom, self.left = next(motions)

    problem = along_a_line(monkeypatch, Valleys)
    found = minimise(problem, np.zeros(1), (), len(valleys))
    assert np.allclose(found.vector, 1.0, atol=1e-3) and found.chi2 < 200.0 and not found.converged


class Pushed(Effect):
    """A force of no numbers that follows from the motion."""

    name, parameters = "pushed", ()

    def force(self, motion: Motion) -> Array:
        return np.zeros(1)


@pytest.mark.parametrize(
    ("levels", "least", "motions", "dry"),
    [
        ([50.0, 10.0, 20.0, 30.0, 5.0], 10.0, 4, False),  # two motions in a row that leave more lead away
        ([50.0, 10.0, 20.0, 4.0, 3.0], 3.0, 5, False),  # one is on the way
        (
            [50.0, 10.0, 20.0, 20.0, 20.0, 30.0, 30.0, 30.0, 5.0],
            10.0,
            8,
            True,
        ),  # friction goes a half and a quarter of it, too
    ],
)
def test_a_fit_whose_motions_lead_away_ends_at_its_best(
    levels: list[float], least: float, motions: int, dry: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Pushed, "dry", dry)
    held = iter(enumerate(levels))
    found = 0

    class Valleys(Valley):
        steep = 100.0

        def hold(self, vector: Array, doubt: float = 0.0) -> None:
            nonlocal found
            found, self.left = next(held)
            self.bottom = vector + 1.0
            self.left -= self.steep  # of where it begins

    problem = replace(along_a_line(monkeypatch, Valleys), effects=(Pushed(0, ()),))
    end = minimise(problem, np.zeros(1), (), len(levels))
    assert found == motions - 1
    assert end.chi2 == pytest.approx(least if motions < len(levels) else least - 100.0)


@pytest.mark.parametrize(("answers", "holds"), [(-0.65, 5), (0.65, 5)])
def test_motions_that_swing_about_the_minimum_or_creep_to_it_are_met_there(
    monkeypatch: pytest.MonkeyPatch, answers: float, holds: int
) -> None:
    """Each motion, found at the parameters, has its minimum so many times as far on the other side, or this."""
    held = []

    class Swings(Valley):
        steep = 1e4

        def hold(self, vector: Array, doubt: float = 0.0) -> None:
            self.bottom, self.slid = 2.0 + answers * (vector - 2.0), {0: {}}
            self.left = 1.0 + 1e3 * float((vector[0] - 2.0) ** 2)
            held.append(vector)

    problem = along_a_line(monkeypatch, Swings)
    found = minimise(problem, np.zeros(1), (), 8, 1e-4)
    assert np.allclose(found.vector, 2.0, atol=1e-3) and found.converged and len(held) <= holds


def test_a_foreseen_place_that_leaves_more_is_left_again(monkeypatch: pytest.MonkeyPatch) -> None:
    held = []

    class Trap(Valley):
        steep = 1e4

        def hold(self, vector: Array, doubt: float = 0.0) -> None:
            self.bottom, self.slid = 2.0 - 0.65 * (vector - 2.0), {0: {}}
            self.left = 1e9 if len(held) == 2 else 1.0 + 1e3 * float((vector[0] - 2.0) ** 2)
            held.append(float(vector[0]))

    found = minimise(along_a_line(monkeypatch, Trap), np.zeros(1), (), 3, 1e-4)
    second = 2.0 + 0.65 * 2.0
    assert held[:2] == pytest.approx([0.0, second], abs=1e-3)
    assert held[3] == pytest.approx(2.0 - 0.65 * (second - 2.0), abs=1e-3)  # where the second motion has its minimum
    assert found.chi2 < 1e4


def test_what_leads_nowhere_is_not_followed() -> None:
    square = np.eye(2)
    assert _further(np.array([1.0, 0.0]), np.array([-0.6, 0.0]), square) == pytest.approx(-0.375)
    assert _further(np.array([1.0, 0.0]), np.array([0.6, 0.0]), square) == pytest.approx(1.5)
    assert _further(np.array([1.0, 0.0]), np.array([0.5, 0.5]), square) == 0.0  # not along it
    assert _further(np.array([1.0, 0.0]), np.array([1.1, 0.0]), square) == 0.0  # it grows
    assert _further(np.zeros(2), np.array([1.0, 0.0]), square) == 0.0
