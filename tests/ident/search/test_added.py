"""What an effect that was added makes of those before it: numbers of chi^2 alone, no arm."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ident.search.added
import ident.search.rounds
from ident.effects.base import Effect
from ident.effects.carried import carrying
from ident.effects.creeping import creeping
from ident.effects.friction import LinkCoulomb, LinkViscous, MotorCoulomb, MotorQuadraticDrag, MotorStribeck
from ident.effects.learned import learned
from ident.effects.motor import InputDelay, TorqueLag
from ident.effects.spring import SpringHardening
from ident.effects.structure import LinkFlexibility
from ident.loop.diagnose import _better
from ident.search.added import (
    Added,
    but_for_played,
    drawn_on,
    drawn_over,
    exchanged,
    largest_first,
    of_another_size,
    outdone,
    pruned,
)
from ident.search.choice import Tried
from ident.search.refits import Refit, instead

DOF, BASE = 1000, 3
BENCH: Any = SimpleNamespace(split=SimpleNamespace(select=()), late=False, say=lambda line: None, at_first=0.0)
DELAY, LAG, DRY = InputDelay(2, (1e-3,)), TorqueLag(2, (1.1e-3,)), LinkCoulomb(2, (0.07,))


def state(level: float, *effects: Effect) -> Any:
    """A model of `effects` that leaves `level` noise powers; scales and limits tell whose they are."""
    values = [v for e in effects for v in e.values]
    vector = np.array([1.0, 2.0, 3.0, *values])
    limits = tuple((0.0, 10.0 * v) for v in values)
    return SimpleNamespace(
        effects=effects, scales=tuple(2.0 * v for v in values), limits=limits, select=level * DOF,
        minimum=SimpleNamespace(vector=vector, slid={}), followed=False, problem=SimpleNamespace(base=BASE),
    )  # fmt: skip


def entry(effect: Effect, *others: Any) -> Added:
    tied = tuple(o.effects[-1] for o in others)
    return Added(effect, (), 0.1, 0.05, 1.0, 1.0, tuple((e, 0.06) for e in tied), tied, (), others)


def test_a_model_with_another_effect_keeps_the_rest_as_it_is() -> None:
    stribeck = MotorStribeck(1, (0.1, 0.2, 3.0))
    refit = instead(state(90.0, stribeck, DELAY, DRY), DELAY, state(400.0, DRY, LAG))
    assert refit.effects == (stribeck, LAG, DRY)
    assert refit.vector.tolist() == [1.0, 2.0, 3.0, *stribeck.values, *LAG.values, *DRY.values]
    assert refit.scales == tuple(2.0 * v for v in refit.vector[BASE:])
    assert refit.limits == tuple((0.0, 10.0 * v) for v in refit.vector[BASE:])


@pytest.mark.parametrize(
    ("now", "then", "taken"),
    [
        (90.0, 0.9, True),
        (90.0, 80.0, False),  # no better to speak of
        (1.05, 0.9, False),  # nothing is left: they stay tied
    ],
)
def test_what_was_tied_takes_the_place_of_what_leaves_more_once_more_is_known(
    now: float, then: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fitted(bench: Any, refits: list[Refit]) -> list[Any]:
        return [state(then, *refit.effects) for refit in refits]

    monkeypatch.setattr(ident.search.added, "all_fitted", fitted)
    monkeypatch.setattr(ident.search.added, "degrees", lambda data: DOF)
    monkeypatch.setattr(ident.search.added, "reduced_chi2", lambda bench, state: state.select / DOF)
    added = [entry(DELAY, state(400.0, LAG)), entry(DRY)]
    best, entries = exchanged(BENCH, state(now, DELAY, DRY), added)
    assert best.effects == ((LAG, DRY) if taken else (DELAY, DRY))
    said = [(one.effect, one.tied, one.rivals) for one in entries]
    first = (LAG, (), ((DELAY, 0.05),)) if taken else (DELAY, (LAG,), ((LAG, 0.06),))
    assert said == [first, (DRY, (), ())]


@pytest.mark.parametrize(("then", "taken"), [(600.0, False), (2.0, True)])
def test_beside_a_curve_a_name_is_exchanged_only_for_one_that_leaves_hardly_anything(
    then: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    curve = learned("spring", "velocity", [-1.0, 1.0])(2, (0.1, -0.1))
    monkeypatch.setattr(
        ident.search.added, "all_fitted", lambda bench, refits: [state(then, *refit.effects) for refit in refits]
    )
    monkeypatch.setattr(ident.search.added, "degrees", lambda data: DOF)
    monkeypatch.setattr(ident.search.added, "reduced_chi2", lambda bench, state: state.select / DOF)
    added = [entry(DELAY, state(900.0, LAG)), entry(curve)]
    best, _ = exchanged(BENCH, state(750.0, DELAY, curve), added)
    assert best.effects == ((LAG, curve) if taken else (DELAY, curve))


@pytest.mark.parametrize(
    ("alone", "error", "swapped"),
    [
        (1.9, 0.07, True),
        (1.9, 0.2, False),  # nor is less of the error left
        (90.0, 0.07, False),  # it leaves much that the first one explains
    ],
)
def test_of_two_names_that_leave_hardly_more_than_each_other_the_one_is_first_that_cuts_the_error_more(
    alone: float, error: float, swapped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ident.search.added, "degrees", lambda data: DOF)
    monkeypatch.setattr(ident.search.added, "fitted", lambda bench, refit: state(alone, *refit.effects))
    monkeypatch.setattr(ident.search.added, "errors", lambda bench, one, report: SimpleNamespace(all=error))
    monkeypatch.setattr(ident.search.added, "told_of", lambda parts, one, data: ())
    monkeypatch.setattr(ident.search.added, "linearised", lambda problem, vector: None)
    monkeypatch.setattr(ident.search.added, "port_shares", lambda lin: (("link", 2, 0.5),))
    bench = SimpleNamespace(**vars(BENCH) | {"split": SimpleNamespace(select=(), report=())})
    first = Added(DELAY, (1e-5,), 0.2, 0.1, 99e3, 100e3, ((LAG, 0.11), (DRY, 0.12)), (LAG,), (("motor", 2, 0.9),))
    second = Added(DRY, (0.01,), 0.1, 0.01, 995.0, 1e3, (), (), ())
    entries = largest_first(bench, state(1.0, DELAY, DRY), [first, second])
    if not swapped:
        assert entries == [first, second]
        return
    dry, delay = entries
    assert (dry.effect, dry.before, dry.after, dry.port_shares) == (DRY, 0.2, error, first.port_shares)
    assert (delay.effect, delay.before, delay.after, delay.tied) == (DELAY, error, 0.01, (LAG,))
    assert dry.rivals == ((DELAY, 0.1), (LAG, 0.11)) and delay.rivals == ()
    assert (dry.gain, delay.gain, dry.gain + delay.gain) == (99.1e3, 895.0, first.gain + second.gain)


@pytest.mark.parametrize(
    ("finely", "closely", "kept"),
    [
        (1.5, 0.9, False),  # the name that came later explains all, once it is at its minimum
        (1.5, 1.4, True),
        (70.0, 0.9, True),  # much is missing without it: not asked again
    ],
)
def test_what_came_first_is_left_out_by_what_is_left_without_it_at_the_minimum(
    finely: float, closely: float, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    curve = learned("motor", "position", [-1.0, 1.0])(2, (0.1, -0.1))
    monkeypatch.setattr(ident.search.added, "without", lambda bench, one, old, roughly=0.0: state(finely, DRY))
    monkeypatch.setattr(ident.search.added, "fully", lambda bench, one: state(closely, *one.effects))
    monkeypatch.setattr(ident.search.added, "reduced_chi2", lambda bench, state: state.select / DOF)
    best, entries = pruned(BENCH, state(0.9, curve, DRY), [entry(curve), entry(DRY)])
    assert best.effects == ((curve, DRY) if kept else (DRY,)) == tuple(one.effect for one in entries)


def test_what_was_left_out_leaves_what_it_led_to_to_what_made_it_superfluous(monkeypatch: pytest.MonkeyPatch) -> None:
    """Found again later it is told once, and the arm without effects that it led to is not forgotten."""
    led, with_delay, other = state(60.0), state(9.0, DELAY), state(50.0, LAG)
    monkeypatch.setattr(
        ident.search.added,
        "without",
        lambda bench, one, old, roughly=0.0: state(0.9 + 9.0 * (old is not DELAY), *one.effects[1:]),
    )
    monkeypatch.setattr(ident.search.added, "reduced_chi2", lambda bench, state: state.select / DOF)
    first = replace(entry(DELAY), besides=led, partly=(other,))
    second, last = replace(entry(LAG), besides=with_delay), replace(entry(DRY), besides=with_delay)
    _, entries = pruned(BENCH, state(0.9, DELAY, LAG, DRY), [first, second, last])
    assert [one.effect for one in entries] == [LAG, DRY]
    assert entries[-1].partly == (other,) and _better(state(90.0), entries) is led


def test_what_came_first_tells_what_the_declared_arm_left_to_what_made_it_superfluous(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ident.search.added, "without", lambda bench, one, old, roughly=0.0: state(0.9, DRY))
    monkeypatch.setattr(ident.search.added, "reduced_chi2", lambda bench, state: state.select / DOF)
    declared, later = (("motor", 2, 0.9),), (("link", 2, 0.4),)
    added = [replace(entry(DELAY), before=0.3, port_shares=declared), replace(entry(DRY), port_shares=later)]
    _, (one,) = pruned(BENCH, state(0.9, DELAY, DRY), added)
    assert (one.effect, one.before, one.port_shares) == (DRY, 0.3, declared)


def test_an_effect_to_which_another_only_led_is_told_by_what_the_arm_without_both_leaves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lead, alone, before = state(60.0, DELAY), state(0.9, DRY), SimpleNamespace(of="the arm without both")
    fakes = {
        "linearised": lambda *of: SimpleNamespace(of="the lead"), "hasty": lambda *of: (), "first_names": lambda *of: (),
        "likely_names": lambda *of: (),
        "_best": lambda *of: (None, []), "_entered": lambda *of: (state(0.9, DELAY, DRY), entry(DRY)),
        "earned": lambda bench, less, new: less is not alone, "left_without": lambda *of: alone,
        "_entry": lambda bench, less, new, gain, tried, lin, effect: lin,
    }  # fmt: skip
    for name, fake in fakes.items():
        monkeypatch.setattr(ident.search.rounds, name, fake)
    found = ident.search.rounds._with_second(BENCH, state(90.0), lead, (), (), before)
    assert found == (alone, [before])


def test_a_curve_that_bends_once_another_effect_is_left_out_is_still_told(monkeypatch: pytest.MonkeyPatch) -> None:
    curve, bends = (learned("motor", "position", [-1.0, 1.0], bends=b)(2, (0.1, -0.1)) for b in (False, True))
    earlier = learned("motor", "friction", [0.0])(2, (0.1,))
    monkeypatch.setattr(ident.search.added, "without", lambda bench, one, old, roughly=0.0: state(1.5, curve))
    monkeypatch.setattr(ident.search.added, "fully", lambda bench, one: state(0.9, bends))
    monkeypatch.setattr(ident.search.added, "reduced_chi2", lambda bench, state: state.select / DOF)
    best, entries = pruned(BENCH, state(0.9, earlier, curve), [entry(earlier), entry(curve)])
    assert best.effects == (bends,) == tuple(one.effect for one in entries)


@pytest.mark.parametrize("carries", [False, True])
def test_links_that_an_effect_carries_are_no_sizes_of_it(carries: bool) -> None:
    """Told anew, they may come to an effect that had none, or leave it."""
    plain = LinkFlexibility.of(2, {})
    pair = plain, carrying(plain, np.zeros((30, 2)))
    named, alone = pair if carries else pair[::-1]
    assert not outdone(
        named, [replace(entry(alone), gain=10.0), entry(learned("motor", "position", [-1.0, 1.0])(2, (0.1, 0.1)))]
    )


def whole_bench() -> Any:
    return SimpleNamespace(
        **vars(BENCH), workers=1, campaign=SimpleNamespace(N=[100.0] * 3), guess=SimpleNamespace(K=[5e3] * 3)
    )


def test_friction_whose_creep_was_fitted_is_no_learned_friction_of_one_height(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has two values: a curve is drawn in its place, if one does as well."""
    named, curve = creeping(MotorCoulomb(2, (0.1,)), -0.4), learned("motor", "position", [-1.0, 1.0])(2, (0.1, -0.1))
    drawn = learned("motor", "sliding", [-1.0, 1.0])(2, (0.1, 0.1))
    less = state(60.0, curve)
    monkeypatch.setattr(ident.search.added, "linearised", lambda problem, vector: None)
    monkeypatch.setattr(ident.search.added, "curves", lambda lin, workers: [SimpleNamespace(effect=drawn)])
    monkeypatch.setattr(ident.search.added, "refitted", lambda *of: [Tried(None, state(0.9, curve, drawn))])
    monkeypatch.setattr(ident.search.added, "fully", lambda bench, one: one)
    monkeypatch.setattr(ident.search.added, "degrees", lambda data: DOF)
    both, entries = state(0.9, named, curve), [entry(named), entry(curve)]
    best, told = drawn_over(whole_bench(), both, less, named, entries)
    assert best.effects == (curve, drawn) and [one.effect for one in told] == [drawn, curve]


@pytest.mark.parametrize(("left", "departs", "taken"), [(1.0, False, True), (1.0, True, False), (1.3, False, False)])
def test_a_name_beside_a_curve_that_explains_without_it_once_drawn_on_is_none(
    left: float, departs: bool, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It met the curve on the way to its minimum."""
    curve, named = learned("spring", "position", [-1.0, 1.0])(0, (0.1, -0.1)), MotorQuadraticDrag(2, (3.0,))
    monkeypatch.setattr(ident.search.added, "fitted", lambda bench, refit: state(left, *refit.effects))
    monkeypatch.setattr(ident.search.added, "without", lambda bench, one, old: state(1.1, curve))
    monkeypatch.setattr(ident.search.added, "reduced_chi2", lambda bench, state: state.select / DOF)
    monkeypatch.setattr(ident.search.added, "something_departs", lambda bench, state: departs)
    best, entries = drawn_on(BENCH, state(0.99, curve, named), [entry(curve), entry(named)])
    kept = (curve,) if taken else (curve, named)
    assert best.effects == tuple(one.effect for one in entries) == kept
    last = state(0.99, named, curve)
    assert drawn_on(BENCH, last, []) == (last, [])


def test_a_second_name_in_the_heights_of_a_curve_is_of_the_curves_entry(monkeypatch: pytest.MonkeyPatch) -> None:
    """After the first one the curve's entry is not the last."""
    named, curve = MotorQuadraticDrag(2, (3.0,)), learned("motor", "velocity", [-1.0, 1.0])(2, (0.1, -0.1))
    monkeypatch.setattr(ident.search.added, "fitted", lambda bench, refit: state(0.9, *refit.effects))
    monkeypatch.setattr(ident.search.added, "fully", lambda bench, one: one)
    monkeypatch.setattr(ident.search.added, "degrees", lambda data: DOF)
    monkeypatch.setattr(ident.search.added, "reduced_chi2", lambda bench, state: state.select / DOF)
    entries = [replace(entry(curve), gain=5.0), replace(entry(named), gain=3.0)]
    best, (one,) = drawn_over(whole_bench(), state(0.9, named, curve), state(9.0, curve), named, entries)
    assert best.effects == (one.effect,) == (curve,) and one.gain == 8.0


def test_the_arm_without_effects_is_the_one_that_was_fitted_best() -> None:
    declared, led = state(90.0), state(60.0)
    assert _better(declared, []) is declared
    assert _better(declared, [replace(entry(DELAY), besides=led), entry(DRY)]) is led
    assert _better(declared, [replace(entry(DELAY), besides=state(95.0))]) is declared
    assert _better(declared, [replace(entry(DELAY), besides=state(1.0, DRY))]) is declared


@pytest.mark.parametrize(("left", "sized"), [(1.2, 1), (1.0, 0)])
def test_what_winds_a_spring_up_and_was_found_while_another_was_missing_is_tried_at_other_sizes(
    left: float, sized: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cubic spring that was 12 % off left 1.17 noise powers: little enough for any other effect."""
    effects = (SpringHardening(1, (1e7,)), LinkViscous(2, (0.1,)))
    found, better = (SimpleNamespace(left=x, effects=effects) for x in (left, 0.9))
    asked: list[Effect] = []

    def elsewhere(bench: Any, state: Any, effect: Effect) -> Any:
        asked.append(effect)
        return better

    stand_ins = {
        "reduced_chi2": lambda bench, state: state.left, "explains": lambda *of: True, "elsewhere": elsewhere,
        "renewed": lambda state, new, added: added,
    }  # fmt: skip
    for name, stand_in in stand_ins.items():
        monkeypatch.setattr(ident.search.added, name, stand_in)
    assert of_another_size(BENCH, found, []) == ((better, []) if sized else (found, []))
    assert asked == list(effects[:sized])


PLAYED = learned("motor", "drive", [-1.0, 1.0])(2, (-0.1, 0.1))


@pytest.mark.parametrize(
    ("first", "second", "gain", "left", "kept"),
    [
        pytest.param(
            PLAYED, DELAY, 0.42, 3.6, False, id="a delay beside what is drawn of a saturating motor with a loop"
        ),
        pytest.param(PLAYED, DELAY, 0.6, 3.6, True, id="it takes most of what the curve left"),
        pytest.param(PLAYED, DELAY, 0.42, 1.05, True, id="nothing is left"),
        pytest.param(PLAYED, LinkCoulomb(1, (0.07,)), 0.42, 3.6, True, id="another joint's"),
        pytest.param(DRY, DELAY, 0.42, 3.6, True, id="beside a name"),
        pytest.param(PLAYED, learned("link", "torque", [-1.0, 1.0])(2, (-0.1, 0.1)), 0.42, 3.6, True, id="a curve"),
    ],
)
def test_a_name_that_plays_a_little_of_what_a_curve_leaves_is_not_told(
    first: Effect, second: Effect, gain: float, left: float, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ident.search.added, "reduced_chi2", lambda bench, state: state.select / DOF)
    alone = state(5.5, first)
    added = [entry(first), replace(entry(second), gain=gain * 4500.0, excess=4500.0, besides=alone)]
    both = state(left, first, second)
    found, entries = but_for_played(BENCH, both, added)
    assert (found, entries) == ((both, added) if kept else (alone, added[:1]))
    assert kept or but_for_played(BENCH, both, [added[0], replace(added[1], besides=None)])[0] is both, "nobody knows"
