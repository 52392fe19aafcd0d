"""What one name more does: where it leaves nothing but noise, that is what is missing, and little else need be tried."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ident.effects.base import Effect, only_gains, only_shares, overrides, winds_up
from ident.search.candidates import CHANGE, catalogue
from ident.search.choice import CURVE_SHARE, Tried, best_names, is_curve, left_by, plainest, with_model
from ident.search.finer import finer
from ident.search.links_off import by_links
from ident.search.minima import told
from ident.search.refits import (
    CLOSE,
    FINELY,
    HASTILY,
    NAMED,
    Bench,
    State,
    beyond_noise,
    fitted,
    instead,
    linearised,
    reduced_chi2,
    same,
)
from ident.search.rest import something_departs
from ident.search.tried import refitted

#: Names tried, and share of what is left that each must promise, and that the best may leave beyond noise in haste: dry friction's motion
#: is not found then.
TRIED, PROMISED, MUCH = 3, 0.1, 0.5
#: Times what the best leaves that another may leave to be fitted finely, too.
NEAR = 2.0
#: Times what the best leaves that another name of its joint leaves which may be it.
ALMOST = 1.3
#: Share of what there was that a name may leave beside which another one does, more where it is tried from an arm that was not bent to
#: leave as little as there was; of what that leaves beyond noise, that both may leave; and where one of them winds a spring up, or rubs,
#: whose motion may not be found.
LEAVES, LEAVES_UNBENT, HARDLY, WOUND_UP = 0.7, 2.0, 0.1, 0.2


def one_more(bench: Bench, state: State, others: Sequence[State] = ()) -> tuple[State, list[Tried]]:
    """The names tried beyond a model, or beyond one of the `others` than its last effect, one of which leaves hardly anything where there is
    much: the model is not far astray then, but that is missing. The model and none if none does."""
    if bench.late or reduced_chi2(bench, state) <= CLOSE:
        return state, []
    least = min(NAMED + CURVE_SHARE * (reduced_chi2(bench, state) - NAMED), CLOSE)

    def most(effect: Effect) -> float:
        return least

    tried = _further(bench, state, most, lambda effect: True)
    if _does(bench, tried, most):
        return state, tried
    return _with_a_rival(bench, state, others, tried, most) or (state, [])


def leading_to_one_more(
    bench: Bench, state: State, tried: Sequence[Tried]
) -> tuple[list[Tried], tuple[State, list[Tried]] | None]:
    """The names `tried` beyond `state`, the best fitted finely if it explains some; and the model with that one, if one more leaves
    nothing but noise, and the names tried beyond it. Not two that may take the place of one law that has no name."""
    names = list(tried)
    named = [one for one in names if not is_curve(one)]
    if not named or bench.late or reduced_chi2(bench, state) <= CLOSE:
        return names, None
    best = plainest(bench, named)
    leaves = LEAVES if bench.declared is None else LEAVES_UNBENT
    if not NAMED < reduced_chi2(bench, best.state) < leaves * reduced_chi2(bench, state):
        return names, None
    lead = finer(bench, best.state) if best.state.roughly > FINELY else best.state
    names = with_model(names, best, lead)
    if reduced_chi2(bench, lead) <= NAMED or by_links(bench, lead):
        return names, None

    def most(effect: Effect) -> float:
        share, least = (WOUND_UP, CLOSE) if _hides_motion(best.candidate.effect, effect) else (HARDLY, NAMED)
        return min(1.0 + share * (reduced_chi2(bench, lead) - 1.0), least)

    more = _further(bench, lead, most, lambda effect: _of_two_causes(best.candidate.effect, effect))
    if _does(bench, more, most):
        return names, (lead, more)
    second = [one.candidate.effect for one in sorted(more, key=left_by)[:1]]
    if _hides_motion(best.candidate.effect, *second):
        return names, None
    return names, _with_a_rival(bench, lead, [one.state for one in best_names(names)], more, most)


def _hides_motion(*effects: Effect) -> bool:
    """Whether one winds a spring up, or rubs: its motion may not be found yet."""
    return any(winds_up(one) or one.dry for one in effects)


def _with_a_rival(
    bench: Bench, lead: State, others: Sequence[State], more: Sequence[Tried], most: Callable[[Effect], float]
) -> tuple[State, list[Tried]] | None:
    """The model with one of the `others` of the joint of `lead` in its place that leaves hardly more, and the best of one `more` beside that,
    if both leave nothing but noise: what delays a torque is told from what lags by what both leave, if nothing else is missing."""
    second, effect = min(more, key=left_by, default=None), lead.effects[-1]
    if second is None:
        return None
    for other in others:
        new = other.effects[-1]
        if bench.late or new.joint != effect.joint or same(new, effect) or other.select > ALMOST * lead.select:
            continue
        both = fitted(bench, replace(instead(second.state, effect, other), roughly=HASTILY))
        bench.say(f"  with {told(new)} instead: {reduced_chi2(bench, both):.4g}")
        if _does(bench, [second.refitted(both)], most):
            return finer(bench, other), [second.refitted(both)]
    return None


def _of_two_causes(one: Effect, other: Effect) -> bool:
    """Whether no law that has no name is both effects: such a law acts at one joint and one port from the first record to the last, and the
    joint is where it reads to be. What delays a torque and what delays an angle do nearly the same, and what is of the whole arm may be
    of one joint."""
    if None not in (one.joint, other.joint) and one.joint != other.joint:
        return True
    if only_shares(one) != only_shares(other) or overrides(one, "posture") != overrides(other, "posture"):
        return True
    ports = {one.port, other.port}
    apart = len(ports) == 2 and ("sensor" in ports or (one.joint is None) != (other.joint is None))
    return apart and not (only_gains(one) and only_gains(other))


def _guessed(effect: Effect) -> bool:
    """Whether an effect changes drives by as much as is allowed in all ways: what it promises is of another one."""
    return only_shares(effect) and all(
        abs(v) == CHANGE for v, p in zip(effect.values, effect.parameters, strict=True) if p.zero is not None
    )


def _does(bench: Bench, tried: Sequence[Tried], most: Callable[[Effect], float]) -> bool:
    """Whether one of those `tried` leaves at most so many noise powers."""
    return any(reduced_chi2(bench, new) <= most(one.effect) for one, new in tried)


def _further(
    bench: Bench, state: State, most: Callable[[Effect], float], wanted: Callable[[Effect], bool]
) -> list[Tried]:
    """The likeliest names that are `wanted` beyond a model, hastily refitted, those near the best finely unless one leaves nothing at once; none
    where all leave much."""
    lin = linearised(state.problem, state.minimum.vector)
    names, left = catalogue(lin, state.effects, bench.workers), beyond_noise(state, lin)
    likely = [c for c in names[:TRIED] if c.gain > PROMISED * left and wanted(c.effect) and not _guessed(c.effect)]
    tried = refitted(bench, state, [(c, lin) for c in likely])
    best = min(tried, key=left_by, default=None)
    if best is None or reduced_chi2(bench, best.state) - 1.0 > MUCH * (reduced_chi2(bench, state) - 1.0):
        return []
    if reduced_chi2(bench, best.state) > min(most(best.candidate.effect), NAMED):
        return _plainest_first(bench, tried, [one for one in tried if left_by(one) <= NEAR * left_by(best)])
    return tried


def _plainest_first(bench: Bench, tried: Sequence[Tried], near: Sequence[Tried]) -> list[Tried]:
    """The names tried, those `near` the best fitted finely, without such of them as have more numbers than one that leaves nothing: friction
    of more numbers, which does no better, takes ten times as long."""
    found, enough = {id(one): one for one in tried}, np.inf
    for one in sorted(near, key=lambda one: (one.candidate.effect.numbers, left_by(one))):
        if one.candidate.effect.numbers > enough:
            del found[id(one)]
            continue
        state = finer(bench, one.state)
        found[id(one)] = one.refitted(state)
        if reduced_chi2(bench, state) <= NAMED and not something_departs(bench, state):
            enough = one.candidate.effect.numbers
    return list(found.values())
