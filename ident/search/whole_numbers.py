"""Whole numbers of effects, an order or the record of a change: others tried, as what was missing may have bent the arm."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ident.search.candidates import otherwise
from ident.search.minima import told
from ident.search.refits import (
    NAMED,
    Bench,
    Refit,
    State,
    all_fitted,
    beyond_noise,
    but_last,
    fitted,
    reduced_chi2,
    reordered,
    same,
    standing,
    with_last,
)
from ident.search.tried import with_candidate

if TYPE_CHECKING:
    from ident.search.added import Added

#: Share of what an effect does that it must promise with another whole number to be tried, where nothing is left: promises are nearly right.
PROMISED = 0.5


def otherwise_if_left(bench: Bench, state: State) -> State:
    """The model, or a better one whose last effect has another whole number, if anything is left."""
    return state if bench.late or reduced_chi2(bench, state) < NAMED else last_otherwise(bench, state)


def last_otherwise(bench: Bench, state: State) -> State:
    """The model, or a better one whose last effect has another whole number."""
    effect = state.effects[-1]
    if not any(p.whole for p in effect.parameters):
        return state
    plain, lin = standing(bench, state, but_last(state))
    least = PROMISED * beyond_noise(plain, lin) if reduced_chi2(bench, state) <= NAMED else 0.0
    likely = [candidate for candidate in otherwise(lin, effect) if candidate.gain >= least]
    refits = [with_candidate(plain, candidate, lin) for candidate in likely]
    best = min(all_fitted(bench, refits), key=lambda other: other.select, default=state)
    if best.select >= state.select:
        return state
    best = fitted(bench, Refit.of(best))
    bench.say(f"  otherwise, {told(best.effects[-1])}: {reduced_chi2(bench, best):.4g}")
    return best if best.select < state.select else state


def each_otherwise(bench: Bench, state: State) -> State:
    """The model, or a better one whose effects have other whole numbers, though hardly anything is left: a wave whose order is off by one
    does nearly as much, and what it does not is taken up by the arm's constants."""
    final = len(state.effects) - 1
    for k, effect in enumerate(state.effects):
        if bench.late or not any(p.whole for p in effect.parameters):
            continue
        order = with_last(state, k)
        last = state if k == final else reordered(bench, state, order)
        new = last_otherwise(bench, last)
        if new is not last:
            state = new if k == final else reordered(bench, new, np.argsort(order).tolist())
    return state


def renumbered(state: State, new: State, added: list[Added]) -> list[Added]:
    """The entries of the effects of a model, as they are in the `new` one, where they have other whole numbers."""
    if new is state:
        return added
    became = list(zip(state.effects, new.effects, strict=True))
    return [
        replace(a, effect=next((now for was, now in became if same(a.effect, was) and not same(was, now)), a.effect))
        for a in added
    ]
