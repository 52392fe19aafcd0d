"""A model at its minimum: how long it is fitted on, and where a fit ends that went astray. Numbers of chi^2 alone, no arm."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ident.search.contact
import ident.search.links_off
import ident.search.minima
import ident.search.own_records
import ident.search.refits
from ident.arm.descent import Minimum
from ident.arm.parts import Split
from ident.effects.base import Effect
from ident.effects.declared import GravityStiffness
from ident.effects.friction import LinkCoulomb, LinkViscous
from ident.effects.spring import SpringHardening
from ident.effects.structure import BaseCompliance
from ident.search.candidates import Candidate
from ident.search.choice import Tried
from ident.search.contact import as_it_winds
from ident.search.links_off import _plausible
from ident.search.minima import WHOLLY, _closely, _doubted, _in_lowest_valley, afresh, crept, followed, settled
from ident.search.refits import FAINTLY, FINELY, HASTILY, Refit, State, fitted

BENCH: Any = SimpleNamespace(late=False, say=lambda line: None)


@pytest.mark.parametrize(
    ("begins", "falls", "times"),
    [
        (186.0, [32.0, 7.0, 0.9], 3),  # friction on its way to its level
        (186.0, [32.0, 31.0, 30.0], 2),  # no longer on its way
        (5.0, [0.9], 1),
        (np.inf, [np.inf], 1),  # no arm at all
    ],
)
def test_a_fit_goes_on_while_what_is_left_falls(
    begins: float, falls: list[float], times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    levels, refits = iter(falls), []

    def fit(bench: Any, refit: Any) -> Any:
        refits.append(refit)
        return SimpleNamespace(level=next(levels))

    monkeypatch.setattr(ident.search.minima, "fitted", fit)
    monkeypatch.setattr(ident.search.minima, "reduced_chi2", lambda bench, state: state.level)
    monkeypatch.setattr(Refit, "of", lambda state: Refit(np.zeros(1), (), (), ()))
    assert _closely(BENCH, Refit(np.zeros(1), (), (), ()), begins).level == falls[times - 1]  # type: ignore[attr-defined]
    assert len(refits) == times


@pytest.mark.parametrize(
    ("effect", "roughly"), [(BaseCompliance(None, (6e4, 6e4, 100.0, 1e-4)), WHOLLY), (LinkCoulomb(1, (0.05,)), FAINTLY)]
)
def test_the_last_descent_goes_on_to_the_end_where_motions_are_not_found_anew(
    effect: Effect, roughly: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    refits: list[Refit] = []

    def fit(bench: Any, refit: Refit) -> State:
        refits.append(refit)
        return State((effect,), (), (), None, None, 10.0, FINELY)  # type: ignore[arg-type]

    bench: Any = SimpleNamespace(late=False, split=Split((), (), (), ""))
    monkeypatch.setattr(ident.search.minima, "fitted", fit)
    monkeypatch.setattr(ident.search.minima, "reduced_chi2", lambda bench, state: 1.0)
    monkeypatch.setattr(ident.search.minima, "replace", lambda one, **new: SimpleNamespace(**{**vars(one), **new}))
    monkeypatch.setattr(Refit, "of", lambda state: Refit(np.zeros(1), (), (), ()))
    settled(bench, State((effect,), (), (), None, None, 10.0, FINELY))  # type: ignore[arg-type]
    assert [one.roughly for one in refits] == [roughly]


@pytest.mark.parametrize(("there", "ends"), [(90.0, 1.0), (2.0, 2.0)])
def test_a_last_descent_whose_motions_no_longer_hold_is_taken_back(
    there: float, ends: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From where it left 4 it went to where it left 1 of the motions that were held; of its own it leaves so much `there`."""
    left = {1.0: 5.0, 2.0: there}
    minimum = Minimum(np.array([2.0]), np.eye(1), 1.0, False, {}, (np.array([1.0]), 4.0))
    monkeypatch.setattr(ident.search.refits, "minimise", lambda problem, vector, *how: minimum)
    monkeypatch.setattr(ident.search.refits, "degrees", lambda data: 1)
    monkeypatch.setattr(ident.search.refits, "sampled", lambda one, samples: one)
    monkeypatch.setattr(ident.search.refits, "hold", lambda problem, vector, hurries: [])
    monkeypatch.setattr(ident.search.refits, "chi_squared", lambda problem, vector, held: left[float(vector[0])])
    monkeypatch.setattr(ident.search.refits, "replace", lambda one, **new: SimpleNamespace(**{**vars(one), **new}))
    problem = SimpleNamespace(effects_at=lambda vector: (), expected=None)
    BENCH.guess = SimpleNamespace(K=np.zeros(1), vector=lambda: np.zeros(1))
    BENCH.split, BENCH.problem = SimpleNamespace(fit=(), select=()), lambda *of: problem
    state = fitted(BENCH, Refit(np.zeros(1), (), (), ()))
    assert (state.minimum.vector, state.select) == (ends, left[ends])


HARD = SpringHardening(1, (1e7,))


@pytest.mark.parametrize(
    ("effects", "before", "after", "ends"),
    [
        ((HARD,), 21.0, 0.9, 0.9),
        ((HARD,), 21.0, 22.0, 21.0),
        ((HARD,), 1.0, 0.9, 1.0),  # nothing is left
        ((HARD,), 200.0, 0.9, 200.0),  # more is missing
        ((HARD, LinkCoulomb(1, (0.1,))), 21.0, 0.9, 21.0),  # where a joint sticks no derivative tells its motion
        ((LinkViscous(1, (0.1,)),), 21.0, 0.9, 21.0),
    ],
)
def test_motions_follow_what_winds_them_up_where_that_leaves_less(
    effects: tuple[Effect, ...], before: float, after: float, ends: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def fit(bench: Any, refit: Refit) -> Any:
        asked.append((refit.followed, refit.roughly))
        return SimpleNamespace(**vars(state) | {"select": after, "followed": refit.followed})

    monkeypatch.setattr(ident.search.minima, "fitted", fit)
    monkeypatch.setattr(ident.search.minima, "reduced_chi2", lambda bench, state: state.select)
    minimum = SimpleNamespace(vector=np.zeros(1), slid={})
    state: Any = SimpleNamespace(
        effects=effects, scales=(), limits=(), minimum=minimum, select=before, roughly=FAINTLY, followed=False
    )
    assert followed(BENCH, state).select == ends
    assert asked[:1] in ([], [(True, HASTILY)])
    assert asked[1:] == ([(True, FAINTLY)] if ends == after else [])  # finely only where that has helped


@pytest.mark.parametrize(
    ("here", "there", "fits", "ends"),
    [
        (2.0, [2.02], 2, 1.5),  # comes back to where it was, told as coarsely: no detour, nothing more closely
        (2.0, [9.0, 2.02, 2.0], 4, 1.5),  # comes back once it is fitted finely
        (2.0, [9.0, 5.0, 2.0, 0.9, 0.9], 8, 0.8),  # a detour leads elsewhere
        (2.0, [9.0, 9.0, 2.0, 0.9, 0.9], 7, 0.8),  # far from it, finely: not more closely
        (2.0, [61.0, 0.9, 0.9, 2.0], 6, 0.8),  # far astray: not finely either
    ],
)
def test_an_arm_fitted_afresh_that_comes_back_is_not_fitted_closely(
    here: float, there: list[float], fits: int, ends: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By what is left: 1.5 of a model that was fitted closely, `here` told as coarsely as what is fitted afresh."""
    levels, made = iter([here, *there]), []

    def fit(bench: Any, refit: Any) -> Any:
        made.append(refit)
        return SimpleNamespace(select=next(levels), roughly=FINELY, effects=())

    def closely(bench: Any, refit: Any, left: float) -> Any:
        made.append(refit)
        return SimpleNamespace(select=min(left, 9.0) - 0.1, roughly=FAINTLY, effects=(None,))

    monkeypatch.setattr(ident.search.minima, "fitted", fit)
    monkeypatch.setattr(ident.search.minima, "_closely", closely)
    monkeypatch.setattr(ident.search.minima, "reduced_chi2", lambda bench, state: state.select)
    monkeypatch.setattr(ident.search.minima, "as_declared", lambda bench, state: np.zeros(1))
    monkeypatch.setattr(Refit, "of", lambda state: Refit(np.zeros(1), (), (), ()))
    state: Any = SimpleNamespace(select=1.5, roughly=FAINTLY, effects=(None,))
    found = afresh(BENCH, state)
    assert found.select == pytest.approx(ends) and len(made) == fits


@pytest.mark.parametrize(
    ("left", "doubted", "ends"),
    [
        (1.97, 1.15, 1.15),  # gravity was on the wrong side of a pole at the lowest line
        (1.97, 1.90, 1.97),  # nothing held it
        (70.0, 1.0, 70.0),  # more is missing: not asked
    ],
)
def test_what_a_line_may_hold_is_found_while_the_model_is_doubted(
    left: float, doubted: float, ends: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not from the model as it would be: with errors of a tenth of every angle, first."""
    asked = []

    def fit(bench: Any, refit: Any) -> Any:
        asked.append(refit.doubts)
        return SimpleNamespace(select=doubted)

    monkeypatch.setattr(ident.search.minima, "fitted", fit)
    monkeypatch.setattr(ident.search.minima, "reduced_chi2", lambda bench, state: state.select)
    monkeypatch.setattr(Refit, "of", lambda state: Refit(np.zeros(1), (), (), ()))
    state: Any = SimpleNamespace(select=left)
    assert _doubted(BENCH, state).select == ends
    assert asked == ([(0.1,)] if left < 10.0 else [])


def test_what_carries_links_is_told_anew_by_its_stiffnesses_if_it_has_any() -> None:
    """A base that is tilted carries the links, too, and has none."""
    tilted: Any = SimpleNamespace(effects=(GravityStiffness(None, (0.0, 0.1, 0.0)),))
    assert _plausible(tilted) == []
    soft: Any = SimpleNamespace(effects=(BaseCompliance(None, (3e5, 1e6, 60.0, 1e-3)),))
    assert {tuple(values[:2]) for values in _plausible(soft)} == {(3e5, 3e5), (3e5, 12e5)}


@pytest.mark.parametrize(("by_other_links", "asked"), [(0.9, ["links"]), (3.0, ["links", "valley", "valley"])])
def test_what_carries_links_is_fitted_with_others_before_its_valleys_are_looked_at(
    by_other_links: float, asked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A base on declared links leaves 190: with others it leaves nothing, or something."""
    done: list[str] = []

    def state(left: float) -> Any:
        minimum, soft = Minimum(np.zeros(4), np.zeros((4, 4)), left, True), BaseCompliance(None, (3e5, 1e6, 60.0, 1e-3))
        return State((soft,), (), (), minimum, SimpleNamespace(), left)  # type: ignore[arg-type]

    def made(what: str, left: float) -> Any:
        done.append(what)
        return state(left)

    monkeypatch.setattr(ident.search.minima, "carrying_others", lambda bench, one: made("links", by_other_links))
    monkeypatch.setattr(ident.search.minima, "lowest", lambda bench, starts: made("valley", 8.0))
    for module in (ident.search.minima, ident.search.links_off):
        monkeypatch.setattr(module, "reduced_chi2", lambda bench, one: one.select)
    monkeypatch.setattr(ident.search.minima, "_resized", lambda state, effect, which, factors: [])
    monkeypatch.setattr(ident.search.minima, "as_declared", lambda bench, one: np.zeros(4))
    found = _in_lowest_valley(BENCH, state(190.0))
    assert done == asked and found.select == (by_other_links if by_other_links < 1.0 else 8.0)


def by_stages(effect: Effect, stages: dict[str, float], monkeypatch: pytest.MonkeyPatch) -> tuple[Any, list[str], Any]:
    """A model that leaves 300, and what fits of each stage leave of it, as they are asked for; its bench has records that move joint 1."""
    asked: list[str] = []

    def fit(bench: Any, refit: Refit) -> Any:
        stage = "own" if refit.own else "arm" if refit.kept else "all"
        asked.append(stage + (" followed" if refit.followed else ""))
        vector = refit.vector + (0.0 if refit.own else 1.0)
        vector[-len(effect.values) :] = 7.0 if refit.own else refit.vector[-len(effect.values) :]
        last = effect.with_values(vector[-len(effect.values) :])
        minimum = Minimum(vector, np.eye(len(vector)), 1.0, True)
        return State((last,), (), (), minimum, None, stages[stage], HASTILY, refit.followed)  # type: ignore[arg-type]

    monkeypatch.setattr(ident.search.own_records, "fitted", fit)
    for module in (ident.search.minima, ident.search.own_records, ident.search.contact):
        monkeypatch.setattr(module, "reduced_chi2", lambda bench, state: state.select)
    vector = np.concatenate([np.zeros(2), effect.values])
    minimum = Minimum(vector, np.eye(len(vector)), 1.0, True)
    moved = (SimpleNamespace(excited=1), SimpleNamespace(excited=2))
    bench = SimpleNamespace(late=False, say=lambda line: None, split=SimpleNamespace(fit=moved, select=moved))
    return bench, asked, State((effect,), (), (), minimum, None, 300.0, HASTILY)  # type: ignore[arg-type]


def test_friction_is_as_its_own_records_have_it_and_the_arm_beside_it_first(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, asked, state = by_stages(LinkCoulomb(1, (0.1,)), {"own": 3.0, "arm": 4.0, "all": 1.2}, monkeypatch)
    found = crept(bench, state)
    assert asked == ["own", "arm", "all"] and found.select == 1.2
    assert found.minimum.vector.tolist() == [2.0, 2.0, 7.0], "what it is from its own records, the arm from all"


def test_friction_that_no_record_moves_is_fitted_by_all(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, asked, state = by_stages(LinkCoulomb(0, (0.1,)), {"all": 1.2}, monkeypatch)
    assert crept(bench, state).select == 1.2 and asked == ["all"]


@pytest.mark.parametrize(
    ("effect", "own", "all_", "asks", "ends"),
    [
        (HARD, 1.8, 1.1, ["own followed", "all followed"], 1.1),
        (HARD, 600.0, 1.1, ["own followed"], 300.0),  # its own records are not explained
        (HARD, 1.8, 299.0, ["own followed", "all followed"], 300.0),  # the others are not
        (LinkViscous(1, (0.1,)), 1.8, 1.1, [], 300.0),
    ],
)
def test_what_winds_up_follows_its_motion_by_its_own_records_first(
    effect: Effect, own: float, all_: float, asks: list[str], ends: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, asked, state = by_stages(effect, {"own": own, "all": all_}, monkeypatch)
    (found,) = as_it_winds(bench, [Tried(Candidate(effect, 1.0, (1.0,)), state)], 9.0)
    assert asked == asks and found.state.select == ends and not found.state.followed
