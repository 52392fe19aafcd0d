"""Who of those that were tried is looked at further: numbers of chi^2 alone, no arm."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ident.search.choice
import ident.search.contact
import ident.search.finer
import ident.search.from_declared
import ident.search.links_off
import ident.search.minima
import ident.search.naming
import ident.search.trials
import ident.search.tried
import ident.search.whole_numbers
from ident.effects.base import Effect
from ident.effects.carried import carrying
from ident.effects.catalogue import CATALOGUE
from ident.effects.creeping import creeping
from ident.effects.friction import (
    LinkCoulomb,
    LinkViscous,
    LoadDependentFriction,
    MotorCoulomb,
    MotorQuadraticDrag,
    MotorStribeck,
)
from ident.effects.learned import Learned, learned
from ident.effects.ringing import Ringing
from ident.effects.spring import SpringHardening, TransmissionError
from ident.effects.structure import AttachedResonator, LinkFlexibility
from ident.search.candidates import Candidate
from ident.search.choice import (
    Tried,
    best_names,
    drawn_whole,
    hardly_bent,
    law_leads,
    plainest,
    rings_ahead,
    rivals,
    vanished,
)
from ident.search.contact import rubbing, rubbing_anew
from ident.search.finer import curve_finely, finely, leader_finely
from ident.search.from_declared import on_declared_arm
from ident.search.naming import named_by_load, of_any_order, plainer
from ident.search.refits import FINELY, HASTILY, State
from ident.search.trace import Linearised
from ident.search.trials import (
    _finalists,
    _nearest_finely,
    _ringing,
    ahead,
    first_names,
    likeliest,
    likely_names,
    outshines,
    polished,
    resting,
)
from ident.search.tried import again, by_few_lines, on_other_links, refitted

DOF = 1000
CURVE = learned("spring", "position", [-1.0, 0.0, 1.0])(1, (0.0, 0.0, 0.0))
BENCH: Any = SimpleNamespace(late=False, only_names=False, say=lambda line: None)
LOADED, SLIDING, PLACE = (
    learned("link", name, [-1.0, 0.0, 1.0])(1, (0.1, 0.1, 0.1)) for name in ("loaded", "sliding", "friction")
)
DRY, HARD = LinkCoulomb(1, (0.1,)), SpringHardening(1, (1e7,))
WAVE = TransmissionError(1, (1e-4, 2.0, 0.0))
BENT = LinkFlexibility(1, (6e3, 0.6, 5e-5, 1.0))


@pytest.fixture(autouse=True)
def _degrees(monkeypatch: pytest.MonkeyPatch) -> None:
    BENCH.split = SimpleNamespace(select=())
    for module in (ident.search.choice, ident.search.finer, ident.search.trials, ident.search.naming):
        monkeypatch.setattr(module, "degrees", lambda data: DOF)
    for module in (
        ident.search.choice,
        ident.search.finer,
        ident.search.trials,
        ident.search.tried,
        ident.search.naming,
        ident.search.links_off,
        ident.search.minima,
        ident.search.whole_numbers,
    ):
        monkeypatch.setattr(module, "reduced_chi2", lambda bench, state: state.select / DOF)


def one(effect: Effect, level: float, roughly: float = HASTILY) -> Any:
    state = SimpleNamespace(select=level * DOF, effects=(effect,), roughly=roughly)
    return Tried(SimpleNamespace(effect=effect, key=(effect.name, effect.joint, effect.port)), state)  # type: ignore[arg-type]


def where(first: float) -> Any:
    """The bench of records of which the arm without effects leaves so much."""
    return SimpleNamespace(**vars(BENCH) | {"at_first": first * DOF})


def test_none_leads_that_leaves_more_than_there_is_without_it() -> None:
    tried = [one(DRY, 260.0), one(MotorCoulomb(1, (0.1,)), 6e4)]
    assert law_leads(where(1000.0), tried) and ahead(where(1000.0), tried) is tried[0]
    assert not law_leads(where(128.0), tried) and ahead(where(128.0), tried) is None


def test_no_name_is_fitted_finely_behind_a_mass_that_rings_and_is_far_ahead() -> None:
    ring, name = one(Ringing(0, (4e-6, 55.0, 1e-4)), 13.0), one(AttachedResonator(1, (0.1, 30.0, 0.0)), 6000.0)
    assert rings_ahead([name, ring]) and _finalists(where(1e4), [name, ring]) == [ring]
    near = one(AttachedResonator(1, (0.1, 30.0, 0.0)), 400.0)
    assert not rings_ahead([near, ring]) and near in _finalists(where(1e4), [near, ring])
    assert not rings_ahead([name, one(CURVE, 13.0)]) and not rings_ahead([ring]) and not rings_ahead([])


@pytest.mark.parametrize(
    ("falls", "times"),
    [
        ([1500.0, 3.9, 0.95], 2),  # a name on its way to where the curve is
        ([1500.0, 1200.0, 0.95], 1),  # one that is not
        ([1.95, 1.9, 0.95], 1),
    ],
)
def test_a_name_that_falls_to_where_a_curve_is_goes_on(
    falls: list[float], times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin, *after = falls
    levels = {HARD.name: iter(after), CURVE.name: iter([1.7] * 5)}
    rounds = []

    def fitted(bench: Any, refits: Any) -> list[Any]:
        rounds.append([e.name for e in refits])
        return [one(e, next(levels[e.name]))[1] for e in refits]

    monkeypatch.setattr(ident.search.finer, "all_fitted", fitted)
    monkeypatch.setattr(ident.search.finer, "Refit", SimpleNamespace(of=lambda state: state.effects[-1]))
    found = finely(BENCH, [one(HARD, begin), one(CURVE, 77.0)])
    assert len(rounds) == times and len(found) == 2
    assert rounds[1:] == [[HARD.name]] * (times - 1)


def test_what_is_fitted_finely_is_not_again(monkeypatch: pytest.MonkeyPatch) -> None:
    again: list[Effect] = []

    def fitted(bench: Any, refits: list[Effect]) -> list[Any]:
        again.extend(refits)
        return [one(effect, 1.7)[1] for effect in refits]

    monkeypatch.setattr(ident.search.finer, "all_fitted", fitted)
    monkeypatch.setattr(ident.search.finer, "Refit", SimpleNamespace(of=lambda state: state.effects[-1]))
    already = one(HARD, 1.5, FINELY)
    found = finely(BENCH, [already, one(CURVE, 77.0)])
    assert again == [CURVE] and found[0] is already and len(found) == 2


@pytest.mark.parametrize(("leads", "finer"), [(9.0, 9.0), (30.0, 1.2), (80.0, 80.0)])
def test_a_name_that_leads_but_not_far_ahead_is_fitted_finely(
    leads: float, finer: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It leaves so much where another leaves 100: one far ahead is fitted further anyway, one that hardly leads may be another."""
    monkeypatch.setattr(ident.search.finer, "fitted", lambda bench, effect: one(effect, 1.2)[1])
    monkeypatch.setattr(ident.search.finer, "Refit", SimpleNamespace(of=lambda state: state.effects[-1]))
    found = leader_finely(BENCH, [one(DRY, 100.0), one(HARD, leads)])
    assert [state.select for _, state in found] == [100.0 * DOF, finer * DOF]


@pytest.mark.parametrize(("left", "leaves"), [(0.96, 0.96), (1.3, 1.15)])
def test_what_was_tried_beyond_an_arm_that_it_bent_is_fitted_from_the_declared_one(
    left: float, leaves: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    begins: list[Any] = []
    monkeypatch.setattr(
        ident.search.from_declared, "Refit", SimpleNamespace(of=lambda state: SimpleNamespace(state=state))
    )
    monkeypatch.setattr(ident.search.from_declared, "as_declared", lambda bench, state: ("declared", state.effects[-1]))
    monkeypatch.setattr(
        ident.search.from_declared, "replace", lambda refit, vector: begins.append(vector) or refit.state.effects[-1]
    )
    monkeypatch.setattr(ident.search.from_declared, "fitted", lambda bench, effect: one(effect, left)[1])
    found = on_declared_arm(BENCH, [one(DRY, 131.0), one(HARD, 1.15)])
    assert [state.select for _, state in found] == [131.0 * DOF, leaves * DOF] and begins == [("declared", HARD)]
    assert on_declared_arm(BENCH, []) == []


@pytest.mark.parametrize(("earlier", "fits"), [([], 1), ([one(HARD, 31.0, FINELY)], 0), ([one(HARD, 31.0)], 1)])
def test_a_name_that_ended_there_finely_is_not_fitted_so_again(
    earlier: list[Tried], fits: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Effect] = []
    monkeypatch.setattr(ident.search.finer, "fitted", lambda bench, effect: asked.append(effect) or one(effect, 1.2)[1])
    monkeypatch.setattr(ident.search.finer, "Refit", SimpleNamespace(of=lambda state: state.effects[-1]))
    leader_finely(BENCH, [one(DRY, 100.0), one(HARD, 30.0)], earlier)
    assert len(asked) == fits


@pytest.mark.parametrize(
    ("bent", "beside", "left", "tries", "leaves"),
    [
        (400.0, 300.0, 0.97, 1, 0.97),  # another name leads hardly: what bends led the fit astray
        (400.0, 300.0, 90.0, 1, 400.0),  # other links are not what is missing
        (700.0, 300.0, 0.97, 0, 700.0),
        (8.0, 300.0, 0.97, 0, 8.0),  # near enough to be fitted on
    ],
)
def test_what_bends_is_tried_on_other_links_before_all_else(
    bent: float, beside: float, left: float, tries: int, leaves: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Effect] = []
    refit = SimpleNamespace(effects=(BENT,))
    monkeypatch.setattr(ident.search.links_off, "_with_links_off", lambda bench, state: refit)
    monkeypatch.setattr(ident.search.links_off, "replace", lambda refit, **changes: refit)
    monkeypatch.setattr(
        ident.search.links_off, "fitted", lambda bench, refit: asked.append(refit.effects[-1]) or one(BENT, left)[1]
    )
    names = [one(BENT, bent), one(HARD, beside)]
    found = on_other_links(BENCH, names)
    assert len(asked) == tries
    assert [state.select for _, state in found] == [leaves * DOF, beside * DOF]
    asked.clear()
    assert on_other_links(BENCH, names, names[:1]) == names and not asked


@pytest.mark.parametrize(
    ("left", "promised", "beside", "tries"),
    [(74.0, 900.0, 66.0, 10), (74.0, 100.0, 66.0, 0), (3.0, 900.0, 66.0, 0), (74.0, 900.0, 0.98, 0)],
)
def test_what_rings_and_leaves_all_there_was_is_tried_at_other_frequencies(
    left: float, promised: float, beside: float, tries: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it promises most of all, none of it came true, and nothing else explains it: a sharp mode between two lines."""
    rings, rubs = AttachedResonator(1, (2e-3, 11.0, 2e-4)), Candidate(DRY, 500.0, (1.0,))
    tried = [Tried(Candidate(rings, promised, (1.0,) * 3), one(rings, left)[1]), Tried(rubs, one(DRY, beside)[1])]
    short: list[Candidate] = []
    monkeypatch.setattr(
        ident.search.trials, "by_few_lines", lambda bench, state, lin, likely: short.extend(likely) or []
    )
    lin: Any = None
    _ringing(BENCH, one(DRY, 66.0)[1], lin, tried)  # type: ignore[arg-type]
    assert len(short) == tries
    f = sorted([11.0] * bool(short) + [candidate.effect["frequency"] for candidate in short])
    assert not f or (f[0] < 11.0 / 1.2 and f[-1] > 1.2 * 11.0 and max(b / a for a, b in pairwise(f)) < 1.05)


@pytest.mark.parametrize(
    ("there", "left", "last"), [(30.0, 0.95, 2), (30.0, 1.2, 4), (500.0, 12.0, 2), (500.0, 18.0, 4)]
)
def test_what_promises_much_less_than_what_leaves_nothing_is_not_tried(
    there: float, left: float, last: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of names that promise so much the first leaves nothing, nearly nothing of what was there, or a little: those that promise half of it
    are tried anyway."""
    names = [DRY, WAVE, HARD, MotorCoulomb(1, (0.1,)), MotorQuadraticDrag(1, (1e-5,))]
    promised = [900.0, 500.0, 460.0, 440.0, 50.0]
    levels = dict(zip(names, [left, *[20.0] * 4], strict=True))
    short = [(SimpleNamespace(effect=e, gain=gain), None) for e, gain in zip(names, promised, strict=True)]
    monkeypatch.setattr(ident.search.tried, "with_candidate", lambda state, candidate, origin: candidate.effect)
    monkeypatch.setattr(ident.search.tried, "all_fitted", lambda bench, refits: (one(e, levels[e])[1] for e in refits))
    found = refitted(BENCH, one(DRY, there)[1], short)  # type: ignore[arg-type]
    assert [candidate.effect for candidate, _ in found] == names[: last + 1]


@pytest.mark.parametrize(("leads", "expected"), [(1.5, [DRY, LinkViscous(1, (0.1,))]), (9.0, [DRY])])
def test_of_a_little_that_is_left_all_names_are_tried_at_the_place_of_the_best_that_does_some(
    leads: float, expected: list[Effect], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What they promise where dry friction acts is not what they do, if only it is something."""
    promised = {
        DRY: 700.0,
        WAVE: 200.0,
        MotorCoulomb(1, (0.1,)): 150.0,
        LinkViscous(1, (0.1,)): 90.0,
        LinkCoulomb(0, (0.1,)): 90.0,
        LoadDependentFriction(1, (0.1,)): 4.0,
    }
    names = [SimpleNamespace(effect=e, gain=gain) for e, gain in promised.items()]
    monkeypatch.setattr(ident.search.trials, "catalogue", lambda lin, effects, workers: names)
    monkeypatch.setattr(ident.search.trials, "beyond_noise", lambda state, lin: 1000.0)
    monkeypatch.setattr(
        ident.search.trials, "refitted", lambda bench, state, short: [one(c.effect, leads) for c, _ in short]
    )
    bench: Any = SimpleNamespace(**vars(BENCH), workers=1)
    found = resting(bench, one(HARD, 2.0)[1], SimpleNamespace())  # type: ignore[arg-type]
    assert [candidate.effect for candidate, _ in found] == expected


def test_of_many_candidates_the_two_that_few_lines_leave_least_to_are_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """None of which leaves twice what there was: that bends the arm."""
    levels = {DRY: 70.0, HARD: 20.0, WAVE: 50.0}
    likely: Any = [SimpleNamespace(effect=e) for e in levels]
    monkeypatch.setattr(ident.search.tried, "with_candidate", lambda state, candidate, lin: candidate.effect)
    monkeypatch.setattr(ident.search.tried, "replace", lambda effect, lines: effect)
    monkeypatch.setattr(ident.search.tried, "all_fitted", lambda bench, refits: [one(e, levels[e])[1] for e in refits])
    monkeypatch.setattr(ident.search.tried, "refitted", lambda bench, state, short: [c.effect for c, _ in short])
    for there, tried in ((40.0, [HARD, WAVE]), (20.0, [HARD]), (5.0, [])):
        found: Any = by_few_lines(BENCH, one(DRY, there)[1], SimpleNamespace(), likely)  # type: ignore[arg-type]
        assert found == tried


def test_no_finalist_is_far_behind_the_best() -> None:
    tried = [one(DRY, 30.0), one(HARD, 310.0), one(WAVE, 290.0), one(MotorCoulomb(1, (0.1,)), 500.0), one(CURVE, 299.0)]
    assert _finalists(where(1000.0), tried) == [tried[0], tried[2], tried[4]]


@pytest.mark.parametrize(("best", "finalists"), [(1.4, 3), (0.95, 2)])
def test_behind_a_name_that_leaves_nothing_in_haste_only_those_near_the_noise_are_fitted_finely(
    best: float, finalists: int
) -> None:
    tried = [one(DRY, best), one(HARD, 2.5), one(WAVE, 5.0), one(MotorCoulomb(1, (0.1,)), 500.0)]
    assert _finalists(where(1000.0), tried) == tried[:finalists]


@pytest.mark.parametrize(
    ("there", "before", "best", "rival", "level", "finely"),
    [
        (1.8, np.inf, 0.95, LinkViscous(1, (0.1,)), 1.6, False),
        (1.8, np.inf, 0.95, LinkViscous(1, (0.1,)), 1.12, True),
        (1.8, np.inf, 0.95, DRY, 1.6, True),  # whose motion is not found in haste
        (1.8, np.inf, 0.95, LinkCoulomb(2, (0.1,)), 1.6, False),  # of another joint
        (
            7.2,
            1.083,
            0.99,
            LinkViscous(2, (0.1,)),
            1.09,
            False,
        ),  # all that there was before, though little of all without effects
        (7.2, 1.083, 0.99, LinkViscous(2, (0.1,)), 1.03, True),
        (7.2, 1.083, 0.99, DRY, 1.09, True),  # whose motion is not found in haste
        (7.2, 1.083, 0.99, LinkCoulomb(1, (0.0,)), 1.09, False),  # which is none
    ],
)
def test_behind_a_name_that_leaves_nothing_only_what_may_be_as_good_is_fitted_finely(
    there: float, before: float, best: float, rival: Effect, level: float, finely: bool
) -> None:
    """Of a little, or of what another left: of 7.2 a gain of arm7 had left 1.083, eccentricity beside it 0.99, and three more that took nothing were
    fitted for 136 CPU s."""
    tried = [one(WAVE, best), one(rival, level)]
    assert _finalists(where(there), tried, before * DOF) == (tried if finely else [])


def test_dry_friction_that_curves_draw_alike_in_haste_is_fitted_finely_by_each() -> None:
    """A name leads; a curve that is not dry is as good finely as in haste."""
    tried = [one(DRY, 77.0), one(LOADED, 326.0), one(PLACE, 333.0), one(CURVE, 340.0), one(SLIDING, 700.0)]
    assert _finalists(where(1000.0), tried) == tried[:3]
    assert _finalists(where(1000.0), tried[1:]) == tried[1:3]


@pytest.mark.parametrize(("as_good", "levels"), [(180.0, [25.0, 30.0, 0.9]), (310.0, [25.0, 30.0, 310.0])])
def test_where_a_curve_leads_all_that_rubs_as_well_in_haste_is_fitted_finely(
    as_good: float, levels: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    finer = {LOADED: 25.0, SLIDING: 30.0, PLACE: 0.9}
    monkeypatch.setattr(ident.search.finer, "fitted", lambda bench, effect: one(effect, finer[effect], FINELY)[1])
    monkeypatch.setattr(ident.search.finer, "Refit", SimpleNamespace(of=lambda state: state.effects[-1]))
    tried = [one(LOADED, 100.0), one(SLIDING, 150.0), one(PLACE, as_good), one(DRY, 500.0)]
    found = curve_finely(BENCH, tried)
    assert [state.select / DOF for _, state in found] == [*levels, 500.0]


@pytest.mark.parametrize("fits", [0, 2])
def test_nothing_is_refitted_any_more_once_it_is_late(fits: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is late after so many fits."""
    begun: list[Effect] = []

    def fitted(bench: Any, refits: Any) -> Any:
        for effect in refits:
            begun.append(effect)
            bench.late = len(begun) >= fits
            yield one(effect, 20.0)[1]

    names = [DRY, WAVE, HARD]
    short: Any = [(SimpleNamespace(effect=e, gain=500.0), None) for e in names]
    bench: Any = SimpleNamespace(late=fits == 0, say=BENCH.say)
    monkeypatch.setattr(ident.search.tried, "with_candidate", lambda state, candidate, origin: candidate.effect)
    monkeypatch.setattr(ident.search.tried, "all_fitted", fitted)
    found = refitted(bench, one(DRY, 30.0)[1], short)
    assert [candidate.effect for candidate, _ in found] == names[:fits] == begun
    nothing: Any = None
    assert bench.late and by_few_lines(bench, nothing, nothing, [c for c, _ in short]) == []
    assert polished(bench, tried := [one(CURVE, 100.0)]) == tried and len(begun) == fits


@pytest.mark.parametrize(("promised", "best"), [(1100.0, TransmissionError), (100.0, LinkCoulomb)])
def test_what_promised_most_is_fitted_with_another_whole_number(
    promised: float, best: type[Effect], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was of an order read from what another arm left."""
    second, first = (TransmissionError(1, (1e-4, order, 0.0)) for order in (2.0, 1.0))
    tried = [one(DRY, 1.03, FINELY), one(second, 1.11, FINELY)]
    for (candidate, _), gain in zip(tried, (450.0, promised), strict=True):
        candidate.gain = gain
    for module in (ident.search.finer, ident.search.trials):
        monkeypatch.setattr(module, "all_fitted", lambda bench, refits: [])
    for module in (ident.search.trials, ident.search.whole_numbers):
        monkeypatch.setattr(module, "last_otherwise", lambda bench, state: one(first, 0.94)[1])
    found = polished(where(1.34), tried)
    assert type(min(found, key=lambda pair: pair[1].select)[1].effects[-1]) is best


@pytest.mark.parametrize(
    ("finely", "at_its_minimum", "beyond", "best"),
    [
        (2.0, 0.91, 100.0, MotorCoulomb),
        (2.0, 1.4, 100.0, MotorStribeck),
        (2.8, 0.91, 100.0, MotorStribeck),
        (2.0, 0.91, 1000.0, MotorCoulomb),  # the other promises less than it does, too
    ],
)
def test_a_force_of_fewer_parameters_is_taken_where_it_does_as_much(
    finely: float, at_its_minimum: float, beyond: float, best: type[Effect], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only what promises to: drag does not; nor is what stays far behind, fitted finely, taken to its minimum."""
    found = one(MotorStribeck(1, (5e-3, 6e-6, 0.2)), 0.9)
    found[0].gain = 95.0
    likely, unlikely = one(MotorCoulomb(1, (5e-3,)), 4.0), one(MotorQuadraticDrag(1, (1e-5,)), 0.8)
    likely[0].gain, unlikely[0].gain = 90.0, 20.0
    refits = {likely[0].effect.name: likely, unlikely[0].effect.name: unlikely}
    plain = SimpleNamespace(effects=())
    BENCH.workers = 1
    monkeypatch.setattr(ident.search.naming, "standing", lambda bench, state, keep: (plain, None))
    monkeypatch.setattr(ident.search.naming, "beyond_noise", lambda state, lin: beyond)
    monkeypatch.setattr(ident.search.naming, "as_strong", lambda lin, candidate, effect: candidate)
    monkeypatch.setattr(ident.search.naming, "catalogue", lambda *of, at: [found[0], likely[0], unlikely[0]])
    monkeypatch.setattr(
        ident.search.naming, "refitted", lambda bench, state, short: [refits[c.effect.name] for c, _ in short]
    )
    for step, left in (("finer", finely), ("fully", at_its_minimum)):
        there = one(likely[0].effect, left)[1]
        monkeypatch.setattr(ident.search.naming, step, lambda bench, state, there=there: there)
    monkeypatch.setattr(ident.search.choice, "degrees", lambda data: DOF)
    assert type(plainer(BENCH, found)[0].effect) is best


def test_what_is_fitted_aside_counts_for_nobody() -> None:
    """Neither how a contact creeps nor by how much links are off: another of as many numbers may be it as well."""
    creeps, rubs = one(creeping(MotorCoulomb(1, (0.1,)), 0.3), 1.0), one(MotorQuadraticDrag(1, (1e-5,)), 1.001)
    carries, rings = carrying(LinkFlexibility(1, (2e4, 0.5, 2e-4, 1.0)), np.ones((30, 2))), AttachedResonator
    assert plainest(BENCH, [creeps, rubs]) is creeps
    assert rivals(BENCH, [creeps, rubs], rubs) == [creeps] and not vanished(carries)
    heavy, other = one(carries, 1.001), one(rings(1, (1e-3, 20.0, 1e-4)), 1.0)
    assert rivals(BENCH, [heavy, other], one(LinkFlexibility(2, carries.values[:4]), 1.0)) == [other, heavy]


@pytest.mark.parametrize(
    ("name", "left", "hastily", "fully", "is_named"),
    [
        (WAVE, 1.05, 0.95, 0.9, False),
        (WAVE, 1.05, 1.2, 0.9, False),
        (WAVE, 1.05, 1.04, 1.04, True),  # no more than a whole order that is told to a few digits
        (WAVE, 1.05, 0.9, 1.05, True),  # less by the few lines of a hasty fit alone
        (WAVE, 8.0, 4.0, 4.0, True),  # more is missing that may bend it
        (DRY, 1.05, 0.9, 0.9, True),
    ],
)
def test_a_wave_that_is_not_whole_in_a_turn_of_the_motor_has_no_name(
    name: Effect, left: float, hastily: float, fully: float, is_named: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = one(name, left)
    BENCH.workers = 1
    monkeypatch.setattr(ident.search.naming, "standing", lambda bench, state, keep: (None, None))
    monkeypatch.setattr(ident.search.naming, "beyond_noise", lambda plain, lin: 1000.0)
    promises = {"motor": 10.0, "link": 900.0}
    monkeypatch.setattr(ident.search.naming, "wave", lambda lin, port, *of: Candidate(CURVE, promises[port], ()))
    likely = []

    def refitted(bench: Any, state: Any, short: Any) -> Any:
        likely.extend(candidate.gain for candidate, _ in short)
        return [one(CURVE, hastily) for _ in short]

    monkeypatch.setattr(ident.search.naming, "refitted", refitted)
    monkeypatch.setattr(ident.search.naming, "fully", lambda bench, state: one(CURVE, fully)[1])
    assert (of_any_order(BENCH, found) is found) == is_named
    assert set(likely) <= {900.0}, "what promises nothing is not tried"


@pytest.mark.parametrize(
    ("names", "unbent"),
    [
        ([one(DRY, 2.4), one(HARD, 17.0)], True),
        ([one(DRY, 2.4), one(HARD, 5.0)], False),  # another does nearly as much
        ([one(DRY, 4.0), one(HARD, 90.0)], False),  # much is left that may have bent the arm
        ([one(AttachedResonator(1, (1e-3, 20.0, 1e-4)), 2.4), one(HARD, 17.0)], False),  # what gives bends it itself
        ([one(DRY, 2.4)], False),
    ],
)
def test_where_a_force_leaves_little_the_arm_was_hardly_bent(names: Any, unbent: bool) -> None:
    assert hardly_bent(BENCH, one(DRY, 30.0)[1], names) == unbent


def test_a_curve_that_leaves_nothing_ends_the_search_for_other_ports() -> None:
    assert drawn_whole(BENCH, [one(CURVE, 0.96), one(HARD, 2.5)])
    assert not drawn_whole(BENCH, [one(CURVE, 1.4), one(HARD, 2.5)]), "something is left"
    assert not drawn_whole(BENCH, [one(CURVE, 0.96), one(HARD, 0.95)]), "a name does, too"
    assert drawn_whole(BENCH, [one(CURVE, 1.4), one(HARD, 50.0)]), "it is far ahead of all names"
    assert not drawn_whole(BENCH, [one(CURVE, 4.0), one(HARD, 500.0)]), "much is left"


def test_no_force_is_fitted_behind_a_curve_that_is_far_ahead() -> None:
    curve, law, near = one(CURVE, 1.2), one(HARD, 50.0), one(WAVE, 9.0)
    rings = one(AttachedResonator(1, (0.1, 30.0, 0.0)), 60.0)  # which may be far from its place
    assert likeliest(BENCH, [curve, law, rings]) == [rings]
    assert likeliest(BENCH, [one(CURVE, 4.0), law, rings]) == [law, rings]
    assert _finalists(where(100.0), [law, rings, curve]) == [curve, rings]
    assert near in _finalists(where(100.0), [law, near, one(CURVE, 1.08)])


@pytest.mark.parametrize(("hastily", "best"), [(44.0, FINELY), (20.0, HASTILY)])
def test_a_name_that_was_fitted_finely_is_the_best_of_its_name_unless_another_is_elsewhere(
    hastily: float, best: float
) -> None:
    fine, hasty, other = one(HARD, 51.0, FINELY), one(HARD, hastily), one(DRY, 48.0)
    assert [name.state.roughly for name in best_names([hasty, other, fine]) if name[0].effect is HARD] == [best]
    order = [name.state.select for name in best_names([hasty, other, fine])]
    assert order == sorted(order) and len(order) == 2


def test_friction_without_a_force_has_vanished_whatever_its_speed() -> None:
    assert vanished(MotorStribeck(2, (0.0, 0.0, 3.8))) and vanished(DRY.with_values([0.0]))
    assert (
        not vanished(MotorStribeck(2, (0.0, 1e-9, 3.8)))
        and not vanished(HARD)
        and not vanished(CURVE.with_values([0.1, 0.0, 0.0]))
    )


def test_a_law_is_ahead_of_others_whatever_else_it_was_tried_with() -> None:
    tried = [one(HARD, 29.0), one(SpringHardening(1, (2e7,)), 220.0), one(DRY, 900.0)]
    assert ahead(where(1000.0), tried) is tried[0]
    assert ahead(where(1000.0), [*tried, one(WAVE, 280.0)]) is None
    assert ahead(where(1000.0), tried[:2]) is None, "nothing else was tried"


@pytest.mark.parametrize(("left", "shines"), [(5.0, True), (20.0, False)])
def test_a_law_far_ahead_that_leaves_little_is_not_measured_by_curves(left: float, shines: bool) -> None:
    bench = where(300.0)
    leader = one(DRY, left)
    assert outshines(bench, leader, [leader, one(HARD, 800.0)]) == shines
    assert not outshines(bench, leader, [leader, one(HARD, 30.0)]), "not far ahead"
    impedance = one(AttachedResonator(1, (1e-3, 20.0, 1e-4)), left)
    assert outshines(bench, impedance, [impedance, one(HARD, 800.0)])
    assert not outshines(bench, impedance, [impedance, one(HARD, 100.0)]), "no curve does what it does"


@pytest.mark.parametrize(
    ("effect", "left", "names"),
    [
        (MotorStribeck(1, (0.01, 0.03, 5.0)), 600.0, ["friction", "sliding", "loaded", "driven"]),
        (DRY, 600.0, ["friction", "sliding", "loaded"]),
        (DRY, 2.0, []),  # little is left
        (WAVE, 600.0, []),
    ],
)
def test_what_friction_may_follow_is_tried_where_a_name_of_it_leaves_much(
    effect: Effect, left: float, names: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def drawn(lin: Any, port: str, joint: int, name: str) -> Candidate:
        return Candidate(learned(port, name, [-1.0, 0.0, 1.0])(joint, (0.0,) * 3), 5.0, (1.0,) * 3)

    monkeypatch.setattr(ident.search.contact, "curve_of", drawn)
    monkeypatch.setattr(ident.search.contact, "reduced_chi2", lambda bench, state: state.select / DOF)
    found = np.arange(4.0)
    state: Any = SimpleNamespace(effects=(effect,), select=left * DOF, minimum=SimpleNamespace(vector=found))
    tried = [Tried(Candidate(effect, 9.0, (1.0,)), state)]
    likely = rubbing(BENCH, Linearised(SimpleNamespace(), np.zeros(3), (), (), (), ()), tried)
    level = max(effect.values[:2])
    assert [c.effect.variable for c, _ in likely if isinstance(c.effect, Learned)] == names
    assert all(c.effect.values == (level,) * 3 and np.array_equal(lin.vector, found[:3]) for c, lin in likely)


@pytest.mark.parametrize(
    ("effect", "left", "after", "starts"),
    [
        (MotorCoulomb(1, (0.1,)), 600.0, 300.0, 2),
        (MotorCoulomb(1, (0.1,)), 600.0, 1.0, 1),  # the first does
        (MotorCoulomb(1, (0.1,)), 2.0, 3.0, 0),
        (DRY, 600.0, 3.0, 0),
        (WAVE, 600.0, 3.0, 0),
    ],
)
def test_friction_of_more_numbers_is_sized_as_the_best_and_its_motion_followed(
    effect: Effect, left: float, after: float, starts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    state: Any = SimpleNamespace(
        effects=(effect,),
        select=left * DOF,
        minimum=SimpleNamespace(vector=np.arange(4.0), slid={}),
        scales=(),
        limits=(),
    )
    asked = []

    def fitted(bench: Any, refit: Any) -> Any:
        asked.append((refit.followed, refit.roughly, refit.vector[:3].tolist()))
        return State(refit.effects[-1:], (), (), SimpleNamespace(vector=refit.vector), None, after * DOF, HASTILY, True)  # type: ignore[arg-type]

    kinds = [(kind, 1) for kind in CATALOGUE.values()]
    monkeypatch.setattr(ident.search.contact, "reduced_chi2", lambda bench, state: state.select / DOF)
    monkeypatch.setattr(
        ident.search.contact, "of_kinds", lambda lin, wanted, taken: [one for one in kinds if wanted(*one)]
    )
    monkeypatch.setattr(ident.search.contact, "units", lambda lin, kind, joint: (1.0,) * len(kind.parameters))
    monkeypatch.setattr(ident.search.tried, "units", lambda lin, kind, joint: (1.0,) * len(kind.parameters))
    monkeypatch.setattr(ident.search.contact, "fitted", fitted)
    tried = [Tried(Candidate(effect, 9.0, (1.0,)), state)]
    lin = Linearised(SimpleNamespace(), np.zeros(3), (), (), (), ())  # type: ignore[arg-type]
    found = rubbing_anew(BENCH, state, lin, tried)
    assert asked == [(True, HASTILY, [0.0, 1.0, 2.0])] * starts and len(found) == starts
    level = effect.values[0]
    assert all(one.candidate.effect.values[:2] == (level / 2, level / 2) for one in found)
    assert all(one.state.effects[-1].name == "motor-stribeck" and not one.state.followed for one in found)


@pytest.mark.parametrize(
    ("there", "earlier", "tried"),
    [
        (MotorStribeck(1, (0.1, 0.1, 3.0)), MotorCoulomb(1, (0.1,)), False),
        (MotorStribeck(1, (0.1, 0.1, 3.0)), MotorCoulomb(0, (0.1,)), True),
        (LinkCoulomb(1, (0.1,)), LoadDependentFriction(1, (0.1,)), True),
    ],
)
def test_friction_is_tried_again_beside_friction_only_where_it_follows_from_something_else(
    there: Effect, earlier: Effect, tried: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def model(effect: Effect) -> Any:
        vector = np.zeros(3 + len(effect.values))
        return SimpleNamespace(
            effects=(effect,), minimum=SimpleNamespace(vector=vector, slid={}), problem=SimpleNamespace(base=3), select=1.0,
            scales=effect.values, limits=((0.0, 1.0),) * len(effect.values),
        )  # fmt: skip

    monkeypatch.setattr(ident.search.tried, "all_fitted", lambda bench, refits: [model(earlier) for _ in refits])
    monkeypatch.setattr(ident.search.tried, "reduced_chi2", lambda bench, state: state.select)
    assert bool(again(BENCH, model(there), [model(earlier)])) == tried


@pytest.mark.parametrize(
    ("heights", "left", "named"),
    [
        ((1.4, 0.4, 1.4), 1.0, (0.4, 0.5)),
        ((1.4, 0.4, 1.4), 30.0, None),  # they leave much more
        ((1.0, 0.0, 1.0), 1.0, None),  # friction by load alone is a name that was tried
    ],
)
def test_friction_that_is_always_there_and_friction_by_load_are_named_in_a_curve(
    heights: tuple[float, ...], left: float, named: tuple[float, float] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    curve = learned("link", "loaded", [-2.0, 0.0, 2.0])(1, heights)
    state: Any = SimpleNamespace(effects=(HARD, curve), select=5.0 * DOF)
    plain: Any = SimpleNamespace(effects=(HARD,), scales=(1e7,), limits=((0.0, 1e9),), minimum=SimpleNamespace(slid={}))
    lin = Linearised(SimpleNamespace(), np.zeros(4), (), (), (), ())  # type: ignore[arg-type]

    def fitted(bench: Any, refit: Any) -> Any:
        assert refit.vector[-2:].tolist() == pytest.approx(refit.scales[-2:]) and len(refit.limits) == 3
        return SimpleNamespace(effects=refit.effects, select=left * DOF)

    monkeypatch.setattr(ident.search.naming, "standing", lambda bench, state, keep: (plain, lin))
    monkeypatch.setattr(ident.search.tried, "units", lambda lin, kind, joint: (1.0,))
    monkeypatch.setattr(ident.search.naming, "fitted", fitted)
    monkeypatch.setattr(ident.search.naming, "fully", lambda bench, state: state)
    monkeypatch.setattr(ident.search.naming, "reduced_chi2", lambda bench, state: state.select / DOF)
    monkeypatch.setattr(ident.search.naming, "degrees", lambda data: DOF)
    bench: Any = SimpleNamespace(**vars(BENCH) | {"split": SimpleNamespace(select=())})
    found = named_by_load(bench, state)
    assert (found is None) == (named is None)
    if found is not None:
        assert [e.name for e in found.effects[1:]] == ["link-coulomb", "load-dependent-friction"]
        assert [e.values[0] for e in found.effects[1:]] == pytest.approx(named)


@pytest.mark.parametrize(
    ("level", "unbent", "left", "tried"),
    [
        (2000.0, True, 900.0, ["unbent", "declared"]),  # what was to be a better arm leads nowhere
        (2000.0, True, 20.0, ["unbent"]),
        (2000.0, False, 900.0, ["declared"]),
        (500.0, True, 400.0, []),
    ],
)
def test_the_declared_arm_is_tried_where_a_better_one_leads_nowhere(
    level: float, unbent: bool, left: float, tried: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def from_declared(bench: Any, state: State, found: Effect | None, bases: bool) -> list[Tried]:
        seen.append(bench.guess)
        return [one(DRY, left)]

    monkeypatch.setattr(ident.search.trials, "from_declared", from_declared)
    monkeypatch.setattr(ident.search.trials, "_from_fitted", lambda bench, state, lin: [])
    own: dict[str, Any] = (
        {"guess": "unbent", "declared": "declared"} if unbent else {"guess": "declared", "declared": None}
    )
    monkeypatch.setattr(ident.search.trials, "replace", lambda bench, **new: SimpleNamespace(**vars(bench) | new))
    monkeypatch.setattr(ident.search.trials, "distorts", lambda lin: False)
    bench, state, lin = SimpleNamespace(**vars(BENCH) | own), one(DRY, level)[1], SimpleNamespace()
    first = first_names(bench, state, lin)  # type: ignore[arg-type]
    assert seen == tried[:1]
    names = likely_names(bench, state, lin, first)  # type: ignore[arg-type]
    assert seen == tried and len(names) == len(tried)


@pytest.mark.parametrize("distorted", [False, True])
def test_soft_bases_come_last_where_something_distorts(distorted: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Friction at six joints: soft bases, which distort nothing, took the time of ten names before it was tried at all joints."""
    trials, base = ident.search.trials, one(LinkViscous(None, (1.0,)), 800.0)
    asked: list[bool] = []

    def from_declared(bench: Any, state: State, found: Effect | None, bases: bool) -> list[Tried]:
        asked.append(bases)
        return [one(DRY, 900.0), *([base] if bases else [])]

    monkeypatch.setattr(trials, "from_declared", from_declared)
    monkeypatch.setattr(trials, "soft_bases", lambda bench, state, tried: [base])
    monkeypatch.setattr(trials, "distorts", lambda lin: distorted)
    bench, state, lin = SimpleNamespace(**vars(BENCH) | {"declared": None}), one(DRY, 2000.0)[1], SimpleNamespace()
    first = first_names(bench, state, lin)  # type: ignore[arg-type]
    names = likely_names(bench, state, lin, first)  # type: ignore[arg-type]
    assert asked == [not distorted] and (base in first) != distorted and names.count(base) == 1


@pytest.mark.parametrize(("lefts", "asked"), [((1.65, 0.93), 2), ((0.95, 0.93), 1), ((1.65, 1.6), 2)])
def test_names_as_near_the_noise_as_the_best_are_fitted_finely_until_one_leaves_nothing(
    lefts: tuple[float, ...], asked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A link that bends left 1.84 in haste, where a spring that relaxes left 1.68, and 0.93 finely."""
    fine = iter(lefts)
    monkeypatch.setattr(ident.search.trials, "reduced_chi2", lambda bench, state: state.select)
    monkeypatch.setattr(ident.search.trials, "finer", lambda bench, state: SimpleNamespace(select=next(fine)))
    monkeypatch.setattr(ident.search.trials, "otherwise_if_left", lambda bench, state: state)
    tried = [Tried(None, SimpleNamespace(select=left)) for left in (5.8, 1.84, 1.68, 2.1)]  # type: ignore[arg-type]
    found = [one.state.select for one in _nearest_finely(BENCH, tried)]
    assert found == [5.8, *(reversed(lefts) if asked == 2 else (1.84, lefts[0])), 2.1]
