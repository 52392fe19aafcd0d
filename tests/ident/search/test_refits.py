"""Models refitted by a part of the records and lines: which part, and what it tells of all."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnosed import CELLS, ROOT

import ident.arm.arm_fit
import ident.search.refits
from ident.arm.arm_fit import LATE_TURNS, hold
from ident.arm.coupled import declared_start
from ident.arm.descent import Minimum
from ident.arm.evidence import evidence, gravity_basis
from ident.arm.parts import Split, few_records
from ident.arm.sliding import TURNS
from ident.effects.catalogue import CATALOGUE
from ident.effects.learned import learned
from ident.records.frf import estimate
from ident.search.candidates import Candidate
from ident.search.choice import Tried
from ident.search.finer import finely
from ident.search.refits import (
    CLOSE,
    FINELY,
    HASTILY,
    NAMED,
    Bench,
    Refit,
    _as_declared,
    _by_all_lines,
    all_fitted,
    fitted,
    reduced_chi2,
    standing,
)
from ident.search.slopes import drawn_again
from ident.search.trace import FEW_RECORDS
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot, make_model
from symgen.robot import load_robot

SCALED = CATALOGUE["torque-scale"](1, (-0.1,))


@cache
def bench() -> Bench:
    """Of one record of a motor that gives a tenth less than it says."""
    robot = load_robot(ROOT / "robots/ypp3")
    chain = chain_of_robot(robot)
    short = replace(robot, experiment=replace(robot.experiment, f0=2.0, band=(2.0, 100.0), periods=3, fs=500.0))
    c = simulate(chain, short, CELLS[1:2], effects=[SCALED], workers=1)
    model, frf = make_model(chain, believe_zeros=True), estimate(c.records[0], c)
    basis = gravity_basis(model, c.gravity)
    data = (evidence(c, model, basis, frf, 0, "usable"),)
    return Bench(c, model, basis, Split(data, data, data, ""), declared_start(c, model, (frf,), basis), 1)


def test_few_records_are_of_every_joint() -> None:
    """Though they were made posture by posture, the joints by turns: every other one is of every other joint."""
    records: Any = tuple(SimpleNamespace(index=k, excited=k % 6) for k in range(6 * 8))
    few = [(one.index, one.excited) for one in few_records(records, FEW_RECORDS)]
    assert FEW_RECORDS <= len(few) <= 1.5 * FEW_RECORDS and few == sorted(few)
    assert {sum(joint == j for _, joint in few) for j in range(6)} == {4}
    assert few_records(records[:FEW_RECORDS], FEW_RECORDS) == records[:FEW_RECORDS]


def test_what_leaves_nothing_by_few_records_in_haste_is_asked_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two records that choose, few are the first: the second one, which tells another arm, is asked if that leaves nothing."""
    (one,) = bench().split.fit
    other = replace(one, index=1, scene=replace(one.scene, theta=1.1 * one.scene.theta))
    both = replace(bench(), split=replace(bench().split, select=(one, other)))
    monkeypatch.setattr(ident.search.refits, "few_records", lambda part, most: part[:1])
    vector, limits = np.append(bench().guess.vector(), SCALED.values), ((-0.5, 0.5),)
    hasty = Refit(vector, (SCALED,), (0.1,), limits, 1, HASTILY)
    by_first, by_both = (reduced_chi2(b, fitted(b, hasty)) for b in (bench(), both))
    assert by_first < NAMED and by_both > 10.0
    plain = Refit(bench().guess.vector(), (), (), (), 1, HASTILY)
    by_first, by_both = (reduced_chi2(b, fitted(b, plain)) for b in (bench(), both))
    assert by_first > NAMED and by_both == pytest.approx(by_first)


def test_friction_is_looked_for_where_it_was_found_in_the_records_that_choose_too() -> None:
    (one,) = bench().split.fit
    both = replace(bench(), split=replace(bench().split, select=(replace(one, index=1),)))
    rubs = CATALOGUE["motor-coulomb"](1, (1e-3,))
    refit = Refit(np.append(bench().guess.vector(), rubs.values), (rubs,), (1e-3,), ((0.0, 1.0),), 1, HASTILY)
    state = fitted(both, refit)
    assert set(state.minimum.slid) == set(state.problem.slid) == set(Refit.of(state).slid) == {0, 1}


def test_few_lines_tell_deviations_as_all_would() -> None:
    start = Refit(bench().guess.vector(), (), (), (), 1)
    few, whole = (fitted(bench(), one).minimum.information.diagonal() for one in (replace(start, lines=12), start))
    told = whole > 1e-6 * whole.max()
    assert 0.7 < np.exp(np.mean(np.log(few[told] / whole[told]))) < 1.5  # 0.4, were it that of the few


def test_few_lines_tell_no_more_of_what_is_known_beforehand() -> None:
    known, seen = np.array([1.0, 0.0]), np.array([[4.0, 1.0], [1.0, 2.0]])
    problem: Any = SimpleNamespace(expected=(np.zeros(2), known), scale=np.ones(2))
    found = _by_all_lines(problem, Minimum(np.zeros(2), seen + np.diag(known), 3.0, True), 5.0)
    np.testing.assert_allclose(found.information, 5.0 * seen + np.diag(known))
    assert found.chi2 == 15.0


def test_a_model_without_an_effect_leaves_what_that_explained() -> None:
    vector, limits = np.append(bench().guess.vector(), SCALED.values), ((-0.5, 0.5),)
    state = fitted(bench(), Refit(vector, (SCALED,), (0.1,), limits, 1))
    plain, _ = standing(bench(), state, [])
    assert not plain.effects and reduced_chi2(bench(), state) < CLOSE < reduced_chi2(bench(), plain)


def test_a_curve_begins_with_what_its_damping_was_more_than_declared() -> None:
    """A damping that a missing law has bent is no damping: what was lost with it left 766 noise powers where 22 had been."""
    n, guess = 3, bench().guess.vector()
    curve = learned("spring", "damping", [0.0, 1.0])(1, (0.5, -0.25))
    place, bent = 3 * n + 1, guess + np.log(4.0) * (np.arange(len(guess)) == 3 * n + 1)
    vector = np.concatenate([bent, SCALED.values, curve.values])
    refit = Refit(vector, (SCALED, curve), (1.0,) * 3, ((-9.0, 9.0),) * 3)
    begun = _as_declared(bench(), refit)
    more = 3.0 * np.exp(guess[place])
    np.testing.assert_allclose(begun, np.concatenate([guess, SCALED.values, [0.5 + more, -0.25 + more]]))
    np.testing.assert_allclose(_as_declared(bench(), replace(refit, vector=begun)), begun)


@pytest.mark.parametrize(
    ("law", "values", "variable", "held"),
    [
        ("cable-stiffness", (5.0, 0.0), "position", True),
        ("cable-stiffness", (5.0, 0.0), "velocity", False),
        ("link-viscous", (0.1,), "velocity", True),
        ("link-viscous", (0.1,), "position", False),
    ],
)
def test_a_linear_law_stays_where_a_curve_has_its_slope_and_no_other(
    law: str, values: Any, variable: str, held: bool
) -> None:
    effect, curve = CATALOGUE[law](1, values), learned("link", variable, [-1.0, 0.0, 1.0])(1, (0.0, 0.0, 0.1))
    assert drawn_again(effect, (effect, curve)) == held
    assert not drawn_again(effect, (effect, replace(curve, joint=0)))


def test_refits_that_begin_late_are_skipped_and_lose_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    b = bench()
    refit = Refit(np.append(b.guess.vector(), SCALED.values), (SCALED,), (0.1,), ((-0.5, 0.5),), 1, HASTILY)
    hasty = fitted(b, refit)
    late = replace(b, until=time.monotonic() - 1.0)
    monkeypatch.setattr(ident.search.refits, "fitted", lambda *_: pytest.fail("it was begun"))
    (skipped,) = all_fitted(late, [refit])
    assert np.isinf(skipped.select) and np.array_equal(skipped.minimum.vector, refit.vector)
    tried = Tried(Candidate(SCALED, 0.0, (0.1,)), hasty)
    assert finely(late, [tried]) == [tried]


def test_motions_of_a_fit_that_is_late_take_few_turns_and_those_that_are_told_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    b, law = replace(bench(), until=time.monotonic() - 1.0), CATALOGUE["link-coulomb"](1, (0.5,))
    turns = list[int]()

    def smoothed(scene: Any, p: Any, effects: Any, how: Any, *of: Any) -> Any:
        turns.append(of[2])
        return how

    monkeypatch.setattr(ident.arm.arm_fit, "smoothed", smoothed)
    vector = np.append(b.guess.vector(), law.values)
    state = fitted(b, Refit(vector, (law,), (0.1,), ((0.0, 1.0),), 1, FINELY))
    assert len(turns) == 2 and set(turns) == {LATE_TURNS}  # of records that fit, and that choose
    hold(state.problem, state.minimum.vector)
    assert turns[2:] == [TURNS]


@pytest.mark.parametrize(
    ("name", "roughly", "few"),
    [
        ("link-coulomb", HASTILY, True),
        ("link-coulomb", FINELY, False),  # by few samples the very truth left 1.4 to 1.9 noise powers
        ("link-viscous", FINELY, True),
    ],
)
def test_friction_is_fitted_finely_by_all_samples(
    name: str, roughly: float, few: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    b, law, told = bench(), CATALOGUE[name](1, (0.05,)), list[int]()
    sampled = ident.search.refits.sampled

    def counted(one: Any, samples: int) -> Any:
        told.append(samples)
        return sampled(one, samples)

    monkeypatch.setattr(ident.search.refits, "sampled", counted)
    fitted(b, Refit(np.append(b.guess.vector(), law.values), (law,), (0.1,), ((0.0, 1.0),), 1, roughly))
    assert bool(told) == few
