"""What an effect that was added makes of those before it: numbers of chi^2 alone, no arm."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ident.added
from ident.added import Added, exchanged, pruned
from ident.diagnose import _better
from ident.effects.base import Effect
from ident.effects.friction import LinkCoulomb, MotorStribeck
from ident.effects.learned import learned
from ident.effects.motor import InputDelay, TorqueLag
from ident.refits import Refit, instead

DOF, BASE = 1000, 3
BENCH: Any = SimpleNamespace(split=SimpleNamespace(select=()))
DELAY, LAG, DRY = InputDelay(2, (1e-3,)), TorqueLag(2, (1.1e-3,)), LinkCoulomb(2, (0.07,))


def state(level: float, *effects: Effect) -> Any:
    """A model of `effects` that leaves `level` noise powers; scales and limits tell whose they are."""
    values = [v for e in effects for v in e.values]
    vector = np.array([1.0, 2.0, 3.0, *values])
    limits = tuple((0.0, 10.0 * v) for v in values)
    return SimpleNamespace(
        effects=effects, scales=tuple(2.0 * v for v in values), limits=limits, select=level * DOF,
        minimum=SimpleNamespace(vector=vector, slid={}), problem=SimpleNamespace(base=BASE),
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

    monkeypatch.setattr(ident.added, "all_fitted", fitted)
    monkeypatch.setattr(ident.added, "degrees", lambda data: DOF)
    monkeypatch.setattr(ident.added, "excess", lambda bench, state: state.select / DOF)
    added = [entry(DELAY, state(400.0, LAG)), entry(DRY)]
    best, entries = exchanged(BENCH, state(now, DELAY, DRY), added, lambda line: None)
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
        ident.added, "all_fitted", lambda bench, refits: [state(then, *refit.effects) for refit in refits]
    )
    monkeypatch.setattr(ident.added, "degrees", lambda data: DOF)
    monkeypatch.setattr(ident.added, "excess", lambda bench, state: state.select / DOF)
    added = [entry(DELAY, state(900.0, LAG)), entry(curve)]
    best, _ = exchanged(BENCH, state(750.0, DELAY, curve), added, lambda line: None)
    assert best.effects == ((LAG, curve) if taken else (DELAY, curve))


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
    monkeypatch.setattr(ident.added, "without", lambda bench, one, old: state(finely, DRY))
    monkeypatch.setattr(ident.added, "fully", lambda bench, one: state(closely, *one.effects))
    monkeypatch.setattr(ident.added, "excess", lambda bench, state: state.select / DOF)
    best, _ = pruned(BENCH, state(0.9, curve, DRY), [entry(curve), entry(DRY)], lambda line: None)
    assert best.effects == ((curve, DRY) if kept else (DRY,))


def test_the_arm_without_effects_is_the_one_that_was_fitted_best() -> None:
    declared, led = state(90.0), state(60.0)
    assert _better(declared, []) is declared
    assert _better(declared, [replace(entry(DELAY), besides=led), entry(DRY)]) is led
    assert _better(declared, [replace(entry(DELAY), besides=state(95.0))]) is declared
    assert _better(declared, [replace(entry(DELAY), besides=state(1.0, DRY))]) is declared
