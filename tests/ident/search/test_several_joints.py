"""What acts at every joint hides itself: which names are tried together, and which of them are kept."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ident.search.choice
import ident.search.naming
import ident.search.rounds
import ident.search.several_joints
from ident.effects.base import Effect
from ident.effects.friction import MotorCoulomb, MotorStribeck
from ident.effects.spring import SpringHardening
from ident.search.candidates import Candidate
from ident.search.choice import Tried
from ident.search.refits import FINELY, HASTILY, Refit
from ident.search.rounds import _each_in_turn
from ident.search.several_joints import at_several_joints, instead_of

DOF = 1000
COULOMB, STRIBECK, HARD = MotorCoulomb(0, (0.1,)), MotorStribeck(1, (0.1, 0.05, 2.0)), SpringHardening(1, (1e7,))
BENCH: Any = SimpleNamespace(
    late=False, workers=1, say=lambda line: None, split=SimpleNamespace(select=()), model=SimpleNamespace(chain=SimpleNamespace(n=3))
)  # fmt: skip


def state(level: float, *effects: Effect, roughly: float = HASTILY) -> Any:
    scales = tuple(1.0 for e in effects for _ in e.values)
    return SimpleNamespace(select=level * DOF, effects=effects, roughly=roughly, problem=None, scales=scales)


def one(effect: Effect, level: float, gain: float = 50.0, found: Effect | None = None) -> Tried:
    return Tried(Candidate(effect, gain, tuple(1.0 for _ in effect.values)), state(level, found or effect))


@pytest.fixture(autouse=True)
def _numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Models that leave what `left` says of their effects' names; a fine fit leaves half of that."""
    for module in (ident.search.several_joints, ident.search.choice, ident.search.rounds):
        monkeypatch.setattr(module, "reduced_chi2", lambda bench, state: state.select / DOF, raising=False)
        monkeypatch.setattr(module, "degrees", lambda data: DOF, raising=False)
    here = ident.search.several_joints
    monkeypatch.setattr(here, "as_declared", lambda bench, state: None)
    monkeypatch.setattr(here, "linearised", lambda problem, vector: None)
    monkeypatch.setattr(here, "nearer", lambda lin, candidate: candidate)
    monkeypatch.setattr(here, "sized_together", lambda lin, some: some)
    monkeypatch.setattr(here, "with_candidates", lambda state, some, lin: tuple(c.effect for c in some))
    monkeypatch.setattr(
        here, "fitted", lambda bench, refit: state(0.5 * refit.select / DOF, *refit.effects, roughly=FINELY)
    )
    monkeypatch.setattr(Refit, "of", lambda state: state)
    kinds = {MotorCoulomb: (0.2,), MotorStribeck: (0.2, 0.1, 3.0)}

    def best_of(lin: Any, kind: type[Effect], joint: int) -> Candidate | None:
        return Candidate(kind(joint, kinds[kind]), 20.0, (1.0,) * len(kinds[kind])) if kind in kinds else None

    monkeypatch.setattr(here, "best_of", best_of)


def leave(monkeypatch: pytest.MonkeyPatch, levels: Sequence[float]) -> list[tuple[Effect, ...]]:
    asked: list[tuple[Effect, ...]] = []

    def all_fitted(bench: Any, refits: Sequence[tuple[Effect, ...]]) -> list[Any]:
        asked.extend(refits)
        return [state(level, *effects) for level, effects in zip(levels, refits, strict=True)]

    monkeypatch.setattr(ident.search.several_joints, "all_fitted", all_fitted)
    return asked


def test_the_best_name_of_each_joint_and_one_kind_at_all_joints_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """The joint at which it was not tried is one of all joints. Fewer numbers that do as much are taken."""
    asked = leave(monkeypatch, [2.0, 1.001, 1.0])
    tried = [
        one(COULOMB, 50.0),
        one(STRIBECK, 60.0),
        one(MotorCoulomb(1, (0.3,)), 61.0),
        one(MotorStribeck(0, (0.1, 0.1, 1.0)), 62.0),
    ]
    found = at_several_joints(BENCH, state(100.0), tried)
    assert asked[0] == (COULOMB, STRIBECK)
    assert asked[1] == (COULOMB, MotorCoulomb(1, (0.3,)), MotorCoulomb(2, (0.2,)))
    assert asked[2] == (MotorStribeck(0, (0.1, 0.1, 1.0)), STRIBECK, MotorStribeck(2, (0.2, 0.1, 3.0)))
    assert found is not None and found.effects == asked[1] and found.roughly == FINELY


def test_what_promises_much_is_tried_with_others_though_alone_it_leads_astray(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the size that it promised: what it was fitted to alone is bent by the others."""
    asked = leave(monkeypatch, [1.0])
    monkeypatch.setattr(ident.search.several_joints, "is_clear", lambda bench, state, effect: True)
    astray = one(STRIBECK, 400.0, 11.0, MotorStribeck(1, (9.0, 0.0, 5.0)))
    found = at_several_joints(BENCH, state(100.0), [one(COULOMB, 90.0), astray])
    assert found is not None and asked[0] == (COULOMB, STRIBECK)


@pytest.mark.parametrize(
    ("tried", "levels"),
    [
        ([one(COULOMB, 50.0), one(HARD, 60.0)], [35.0]),  # they leave more than a share of what one does
        ([one(COULOMB, 300.0), one(STRIBECK, 400.0)], [70.0]),  # or of what there was
        ([one(COULOMB, 2.0), one(HARD, 60.0)], None),  # one leaves little
        ([one(COULOMB, 50.0), one(HARD, 97.0)], None),  # the other does hardly anything, and is no friction
        ([one(COULOMB, 50.0), one(STRIBECK, 97.0, 9.0)], None),  # or does not promise much
        ([one(COULOMB, 50.0), one(MotorStribeck(0, (0.1, 0.05, 2.0)), 60.0)], None),  # both at one joint
        ([], None),
    ],
)  # fmt: skip
def test_they_are_not_tried_or_not_taken_where_one_does_it(
    tried: list[Tried], levels: list[float] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = leave(monkeypatch, levels or [])
    assert at_several_joints(BENCH, state(100.0), tried) is None
    assert bool(asked) == (levels is not None)


def test_of_names_that_push_beside_each_other_nothing_is_left_to_try(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the other one of them would have to push: that alone is no model of several joints."""
    asked = leave(monkeypatch, [])
    monkeypatch.setattr(ident.search.several_joints, "sized_together", lambda lin, some: some[:1])
    assert at_several_joints(BENCH, state(100.0), [one(COULOMB, 50.0), one(HARD, 60.0)]) is None and not asked


def test_what_promises_most_of_what_one_does_elsewhere_may_be_in_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """But for plainer names at the same place, which are tried anyway."""
    stribeck, coulomb, hard = (Candidate(e, 0.0, ()) for e in (STRIBECK, MotorCoulomb(1, (0.1,)), HARD))
    gains = {stribeck.key: 900.0, coulomb.key: 890.0, hard.key: 500.0, ("motor-coulomb", 0, "motor"): 300.0}
    names = [Candidate(c.effect, gains[c.key], ()) for c in (stribeck, coulomb, hard, Candidate(COULOMB, 0.0, ()))]
    monkeypatch.setattr(ident.search.several_joints, "catalogue", lambda lin, effects, workers: names)
    monkeypatch.setattr(ident.search.several_joints, "beyond_noise", lambda state, lin: 1000.0)
    found = instead_of(BENCH, state(2.0), None, stribeck)  # type: ignore[arg-type]
    assert [c.effect for c, _ in found] == [HARD]


def test_each_is_looked_at_beside_the_others_and_none_kept_that_earns_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without Coulomb friction 30 noise powers are left, without the spring's hardening no more than with it; a plainer name is taken."""
    rounds = ident.search.rounds
    plain = MotorCoulomb(1, (0.12,))
    left = {COULOMB: 30.0, STRIBECK: 20.0, plain: 20.0, HARD: 1.0}

    def reordered(bench: Any, found: Any, order: list[int]) -> Any:
        return state(1.0, *(found.effects[k] for k in order))

    def without(bench: Any, found: Any, old: Effect) -> Any:
        return state(left[old], *(e for e in found.effects if e != old))

    def plainer(bench: Any, own: Tried, hopeless: float) -> Tried:
        if own.candidate.effect != STRIBECK:
            return own
        return Tried(Candidate(plain, 1.0, (1.0,)), state(1.0, *own.state.effects[:-1], plain))

    monkeypatch.setattr(rounds, "reordered", reordered)
    monkeypatch.setattr(rounds, "left_without", without)
    monkeypatch.setattr(rounds, "without_each", lambda bench, found, names: [without(bench, found, e) for e in names])
    monkeypatch.setattr(rounds, "standing", lambda bench, found, keep: (found, None))
    monkeypatch.setattr(rounds, "instead_of", lambda *args: [])
    monkeypatch.setattr(rounds, "refitted", lambda *args: [])
    monkeypatch.setattr(rounds, "plainer", plainer)
    monkeypatch.setattr(rounds, "is_clear", lambda bench, state, effect: False)
    monkeypatch.setattr(rounds, "earned", lambda bench, before, after: before.select > 2.0 * after.select)
    monkeypatch.setattr(rounds, "_entry", lambda b, less, new, gain, tried, lin, effect, coarsely: (effect, gain))
    monkeypatch.setattr(rounds, "_error", lambda bench, one: 0.1)
    lin: Any = None
    found, added = _each_in_turn(BENCH, state(100.0), lin, state(1.0, COULOMB, STRIBECK, HARD)) or (None, [])
    assert set(found.effects) == {COULOMB, plain}
    assert added == [(COULOMB, 29.0 * DOF), (plain, 19.0 * DOF)]
    late: Any = SimpleNamespace(**{**vars(BENCH), "late": True})  # what they do together has to do
    found, added = _each_in_turn(late, state(100.0), lin, state(1.0, COULOMB, STRIBECK, HARD)) or (None, [])
    assert set(found.effects) == {COULOMB, STRIBECK, HARD} and [gain for _, gain in added] == [99.0 * DOF] * 3


def test_friction_of_more_numbers_gives_way_to_plain_friction_as_strong(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where that leaves as much; what is no friction stays. Each is begun with the numbers that it has."""
    here, strong = ident.search.several_joints, MotorCoulomb(1, (0.15,))
    monkeypatch.setattr(here, "smallest", lambda lin, kind, joint: Candidate(kind(joint, (0.01,)), 0.0, (1.0,)))
    monkeypatch.setattr(here, "as_strong", lambda lin, one, effect: Candidate(strong, 0.0, (1.0,)))
    monkeypatch.setattr(here, "some", lambda state, keep: SimpleNamespace(vector=None))
    monkeypatch.setattr(here, "is_clear", lambda bench, state, effect: False)
    monkeypatch.setattr(here, "replace", lambda one, **changes: one)
    monkeypatch.setattr(here, "with_candidates", lambda state, some, lin: [c.effect for c in some])

    def plainly(leaves: float) -> tuple[Effect, ...]:
        monkeypatch.setattr(here, "fitted", lambda bench, effects: state(leaves, *effects))
        found = state(1.0, COULOMB, STRIBECK, HARD)
        found.minimum = SimpleNamespace(slid={})
        lin: Any = None
        return here._rubbing_plainly(BENCH, state(100.0), lin, found).effects

    assert plainly(1.004) == (COULOMB, strong, HARD)
    assert plainly(1.1) == (COULOMB, STRIBECK, HARD)
    monkeypatch.setattr(here, "is_clear", lambda bench, state, effect: effect == STRIBECK)
    assert plainly(1.0) == (COULOMB, STRIBECK, HARD)


def test_a_size_known_far_better_than_chance_is_clear(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the same share as names are told apart; one that no record shows is not, and shapes are none."""
    naming = ident.search.naming
    monkeypatch.setattr(naming, "as_much", lambda bench, least: least + 40.0)
    for stds, clear in (((0.004, 0.002, 9.0), True), ((0.004, 0.003, 0.0), False), ((np.nan, 0.001, 0.0), False)):
        monkeypatch.setattr(naming, "standard_deviations", lambda state, effect, off, stds=stds: stds)
        assert naming.is_clear(BENCH, state(1.0), STRIBECK) == clear
