"""Candidates refitted with a model, hastily: one after the other, or many of them by few lines first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.effects.base import Effect, winds_up
from ident.effects.waves import order_of
from ident.records.campaign import Array
from ident.search.candidates import Candidate, bounds, units
from ident.search.choice import Tried, left_by, with_model
from ident.search.links_off import by_links, hastily_carrying_others
from ident.search.minima import told
from ident.search.refits import (
    FIRST_LINES,
    HASTILY,
    NAMED,
    WOUND,
    Bench,
    Refit,
    State,
    all_fitted,
    reduced_chi2,
    same,
    winding,
)
from ident.search.trace import Linearised

#: Of many candidates, those that few lines leave least to are refitted as others are, but for such as leave so many times what there was.
BEST, BENT_MORE = 2, 2.0
#: Share of what there was that one leaves which leaves nearly nothing; chi^2 per degree of freedom beyond which there was so much that
#: noise is nothing; and share of what such a one promises, that others must.
NEARLY, SOMETHING, PROMISED = 0.03, 1.5, 0.5
#: Times what the best candidate leaves that one of declared links may leave which may leave nothing with others.
BY_LINKS = 2.0


def by_few_lines(bench: Bench, state: State, lin: Linearised, likely: Sequence[Candidate]) -> list[Tried]:
    """The best two of many candidates, by few lines, refitted as others are; none that bends the arm by more than it was."""
    if bench.late:
        return []
    refits = [replace(with_candidate(state, candidate, lin), lines=FIRST_LINES) for candidate in likely]
    left = [new.select for new in all_fitted(bench, refits)]
    best = sorted(zip(left, range(len(left)), strict=True))[:BEST]
    return refitted(bench, state, [(likely[k], lin) for least, k in best if least < BENT_MORE * state.select])


def refitted(bench: Bench, state: State, short: Sequence[tuple[Candidate, Linearised]]) -> list[Tried]:
    """The model `state` with each candidate, as it is where the arm was linearised, hastily refitted; once one leaves nothing, where
    there was much, or nearly nothing of it, none that promises much less, and none once it is late."""
    if bench.late:
        return []
    refits = [with_candidate(state, candidate, origin) for candidate, origin in short]
    candidates, whole = [candidate for candidate, _ in short], 0.0
    tried: list[Tried] = []
    for candidate, new in zip(candidates, all_fitted(bench, refits), strict=True):
        tried.append(Tried(candidate, new))
        bench.say(f"  {told(new.effects[-1])}: {reduced_chi2(bench, new):.4g}, promised {candidate.gain:.3g}")
        nothing = reduced_chi2(bench, new) <= NAMED and reduced_chi2(bench, state) > SOMETHING
        if nothing or new.select < NEARLY * state.select:
            whole = max(whole, candidate.gain)
        if bench.late or all(other.gain < PROMISED * whole for other in candidates[len(tried) :]):
            break
    return tried


def on_other_links(bench: Bench, tried: list[Tried], known: Sequence[Tried] = ()) -> list[Tried]:
    """The candidates, the best that carries the declared links with others if it leaves nothing then, unless it was `known`: with those it
    leads the fit astray, and all else is tried in vain."""
    least = min(map(left_by, tried), default=0.0)
    likely = [one for one in tried if left_by(one) <= BY_LINKS * least and by_links(bench, one.state)]
    best = min(likely, key=left_by, default=None)
    if best is None or bench.late or any(one is best for one in known):
        return tried
    state = hastily_carrying_others(bench, best.state)
    if state is best.state:
        return tried
    bench.say(f"  on other links, {told(state.effects[-1])}: {reduced_chi2(bench, state):.4g}")
    return with_model(tried, best, state)


def again(bench: Bench, state: State, earlier: Sequence[State]) -> list[Tried]:
    """The model `state` with the last effect of each of some `earlier` ones, as it was in them, on the arm that they had; no friction beside
    friction of the same port that follows from the same."""
    refits: dict[tuple[str, int | None, float | None], tuple[Candidate, Refit]] = {}
    base = state.problem.base
    for other in earlier:
        effect, arm = other.effects[-1], other.minimum.vector[:base]
        own = len(other.scales) - len(effect.values)
        candidate = Candidate(effect, 0.0, other.scales[own:])
        taken = any(same(effect, e) or _rub_alike(effect, e) for e in state.effects)
        key = effect.name, effect.joint, order_of(effect)
        if not taken and key not in refits:
            found = np.concatenate([arm, state.minimum.vector[base:]])
            refits[key] = candidate, _with(state, found, [candidate], other.limits[own:])
    candidates, models = [c for c, _ in refits.values()], all_fitted(bench, [refit for _, refit in refits.values()])
    tried = list(map(Tried, candidates, models))
    for _, new in tried:
        bench.say(f"  again, {told(new.effects[-1])}: {reduced_chi2(bench, new):.4g}")
    return tried


def _rub_alike(a: Effect, b: Effect) -> bool:
    """Whether both are dry friction of a velocity at the same port, whose sum is such a friction, too."""
    return a.dry and b.dry and (a.port, a.joint) == (b.port, b.joint) and not (a.by_load or b.by_load)


def with_candidate(state: State, candidate: Candidate, lin: Linearised) -> Refit:
    """The model with a candidate, to be refitted hastily."""
    return with_candidates(state, [candidate], lin)


def with_candidates(state: State, candidates: Sequence[Candidate], lin: Linearised) -> Refit:
    """The model with some candidates at once, to be refitted hastily."""
    unit = [units(lin, type(one.effect), one.effect.joint) for one in candidates]
    every = zip(candidates, unit, strict=True)
    limits = tuple(bounds(p, u) for one, own in every for p, u in zip(one.effect.parameters, own, strict=True))
    return _with(state, lin.vector, candidates, limits)


def _with(
    state: State, vector: Array, candidates: Sequence[Candidate], limits: tuple[tuple[float, float], ...]
) -> Refit:
    """The model with candidates, to be refitted hastily from this `vector` of all that it has already."""
    new = [one.effect for one in candidates]
    scales = tuple(scale for one in candidates for scale in one.scales)
    return Refit(
        np.concatenate([vector, *(effect.values for effect in new)]), (*state.effects, *new), state.scales + scales,
        state.limits + limits, WOUND if winding(state.effects) or any(map(winds_up, new)) else 1, HASTILY,
        slid=state.minimum.slid,
    )  # fmt: skip
