"""An effect that was added, and what it makes of those before: superfluous, or a name of a curve, or a curve of a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ident.arm.parts import degrees
from ident.effects.base import Effect, Law, winds_up
from ident.effects.learned import Learned, LearnedLaw, at_knots, learned
from ident.search.candidates import catalogue
from ident.search.changes import told_of
from ident.search.choice import AHEAD, ALIKE, LEAST_SHARE, chosen, left_by
from ident.search.curves import curves
from ident.search.departures import errors
from ident.search.minima import LEAST_GAIN, elsewhere, fully, told
from ident.search.refits import (
    CLOSE,
    FULLY,
    HASTILY,
    NAMED,
    Bench,
    Refit,
    State,
    all_fitted,
    fitted,
    instead,
    linearised,
    reduced_chi2,
    same,
    some,
    without,
)
from ident.search.rest import something_departs
from ident.search.trace import port_shares
from ident.search.trials import CURVES, explains, polished, promising
from ident.search.tried import refitted

#: Curves at the port of a name that together do more than this share of what it did, or leave it less than this share of its
#: size, make it superfluous, if they can.
OUTDONE = 0.5
#: Times what a model leaves that another may leave, hastily fitted, which may do better.
HASTILY_MORE = 3.0
#: Times what a name leaves beyond noise of which another leaves hardly more: it may be tried in its place later, or come first.
HARDLY_MORE = 2.0
#: Names tried in the place of a learned curve.
NAMES = 6


@dataclass(frozen=True, eq=False)
class Added:
    """One effect that was added: `before` and `after` held-out errors; `gain` of chi^2 where it was chosen, of `excess`.

    `rivals` are the next best, with the held-out error each leaves; `tied` those that these records do not tell apart; `others` the
    models with one of them that left hardly more, `partly` those that explained something, `besides` the model without it, and
    without what it made superfluous: with fewest effects where there are several.
    `port_shares` is how much of the excess a free force at each (port, joint) would explain.
    """

    effect: Effect
    std: tuple[float, ...]
    before: float
    after: float
    gain: float
    excess: float
    rivals: tuple[tuple[Effect, float], ...]
    tied: tuple[Effect, ...]
    port_shares: tuple[tuple[str, int, float], ...]
    others: tuple[State, ...] = ()
    partly: tuple[State, ...] = ()
    besides: State | None = None


def exchanged(bench: Bench, state: State, added: list[Added]) -> tuple[State, list[Added]]:
    """The model with others in the place of earlier effects, where these leave much less now that more is known.

    What two effects leave alone is nearly the same while a third is missing; where something is still left it may be because
    the wrong one of both was taken. Beside a curve, which can play what the name did, only one that leaves hardly anything.
    """
    dof = degrees(bench.split.select)
    for k, entry in enumerate(added[:-1]):
        others = [one for one in entry.others if all(not same(one.effects[-1], e) for e in state.effects)]
        if reduced_chi2(bench, state) <= NAMED or not others or not any(same(entry.effect, e) for e in state.effects):
            continue
        hastily = all_fitted(bench, [replace(instead(state, entry.effect, one), roughly=HASTILY) for one in others])
        likely = [Refit.of(one) for one in hastily if one.select < HASTILY_MORE * state.select]
        best = min(all_fitted(bench, likely), key=lambda one: one.select, default=state)
        least = max(LEAST_GAIN, LEAST_SHARE * (state.select - dof))
        by_curve = isinstance(added[-1].effect, Learned)
        if best.select > state.select - least or (by_curve and reduced_chi2(bench, best) > CLOSE):
            continue
        state, added = best, in_its_place(state, best, added)
        bench.say(f"  instead of {told(entry.effect)}, {told(added[k].effect)}: {reduced_chi2(bench, best):.4g}")
    return state, added


def in_its_place(state: State, new: State, added: list[Added]) -> list[Added]:
    """The entries, that of an effect of which the `new` model has another one in the place with that."""
    found = [e for e in new.effects if all(not same(e, old) for old in state.effects)]
    for effect in found:
        k = next(k for k, a in enumerate(added) if all(not same(a.effect, e) for e in new.effects))
        entry = added[k]
        rivals = ((entry.effect, entry.after), *(one for one in entry.rivals if not same(one[0], effect)))
        added = [*added[:k], replace(entry, effect=effect, rivals=rivals, tied=()), *added[k + 1 :]]
    return added


def left_without(bench: Bench, state: State, old: Effect) -> State:
    """The model without one of its effects; fitted hastily where that is far behind: nothing finer need be known then."""
    less = without(bench, state, old, HASTILY)
    return less if state.select < AHEAD * less.select else without(bench, state, old)


def pruned(bench: Bench, state: State, added: list[Added], together: Sequence[Added] = ()) -> tuple[State, list[Added]]:
    """The model without those earlier effects that the last one of `added` has made superfluous, but for those found `together` with it."""
    added = _of_model(state, added)
    last = added[-1].effect
    for old in state.effects[:-1]:
        if any(same(old, one.effect) for one in together):
            continue
        by_curve = isinstance(last, Learned) and old.name != "unknown"
        if by_curve and not outdone(old, added):
            continue  # a curve can play any law of its variable: it takes no name away
        less = without(bench, state, old) if by_curve else left_without(bench, state, old)
        if reduced_chi2(bench, less) <= CLOSE and less.select >= state.select + LEAST_GAIN:
            less = fully(bench, less)
        if less.select < state.select + LEAST_GAIN:
            bench.say(f"  without {told(old)} as well: {reduced_chi2(bench, less):.4g}")
            state, added = less, _of_model(less, renewed(state, less, added))
        elif by_curve:
            state, added = drawn_over(bench, state, less, old, added)
    return state, added


def drawn_on(bench: Bench, state: State, added: list[Added]) -> tuple[State, list[Added]]:
    """The model without its last name, where a curve that was found before explains the records alone, drawn on from where the name has
    led it: many heights come to their minimum slowly, and a name elsewhere that meets them on the way is none of a cause."""
    last = state.effects[-1]
    if isinstance(last, Learned) or not any(isinstance(e, Learned) for e in state.effects[:-1]) or bench.late:
        return state, added
    less = fitted(bench, replace(Refit.of(without(bench, state, last)), outer=FULLY))
    bench.say(f"  drawn on without {told(last)}: {reduced_chi2(bench, less):.4g}")
    if reduced_chi2(bench, less) > NAMED or something_departs(bench, less):
        return state, added
    return less, _of_model(less, added)


def but_for_played(bench: Bench, state: State, added: list[Added]) -> tuple[State, list[Added]]:
    """The model without its last names, each of a joint at which a curve was found before, of what that left it takes less than half, and more
    than noise is left with it: of what a curve leaves of its law any name plays a little."""
    while len(added) > 1:
        *before, last = added
        drawn = any(isinstance(one.effect, Learned) and one.effect.joint == last.effect.joint for one in before)
        named, half = last.effect.name != "unknown", last.gain < OUTDONE * last.excess
        less = last.besides
        if not (drawn and named and half) or less is None or len(less.effects) != len(before):
            break
        if reduced_chi2(bench, state) <= NAMED:
            break
        bench.say(f"  not named beside a curve, as it leaves {reduced_chi2(bench, state):.4g}: {told(last.effect)}")
        state, added = less, before
    return state, added


def renewed(state: State, new: State, added: Sequence[Added]) -> list[Added]:
    """The entries, that of the last effect with what it is in the `new` model: a curve that bends is another one."""
    return [replace(a, effect=new.effects[-1]) if same(a.effect, state.effects[-1]) else a for a in added]


def _of_model(state: State, added: list[Added]) -> list[Added]:
    """The entries of the effects that the model still has: the last one stands for the others, so what explained something beside
    them, and the model without them, are its own. What the declared model left is told by the first one."""
    gone = [a for a in added if not any(same(a.effect, e) for e in state.effects)]
    if len(gone) in (0, len(added)):
        return added
    first, *more = [a for a in added if a not in gone]
    if added[0] in gone:
        first = replace(first, before=added[0].before, port_shares=added[0].port_shares)
    *before, last = first, *more
    besides = [a.besides for a in (last, *gone) if a.besides is not None]
    fewest = min(besides, key=lambda one: len(one.effects), default=None)
    partly = tuple(one for a in (last, *gone) for one in a.partly)
    return [*before, replace(last, partly=partly, besides=fewest)]


def drawn_over(bench: Bench, state: State, less: State, named: Effect, added: list[Added]) -> tuple[State, list[Added]]:
    """The model with a name in the heights of the last curve, or another curve in its place, if either does as well; `less` is the one
    without the name."""
    if (flat := _flat(named)) is not None:
        effects = tuple(flat if same(e, named) else e for e in state.effects)
        problem = bench.problem(state.problem.data, effects, state.scales, state.limits)
        best = replace(state, effects=effects, problem=replace(problem, slid=state.problem.slid))
        return best, [replace(a, effect=flat) if same(a.effect, named) else a for a in added]
    most = _as_well(bench, state)
    if (whole := _in_one(bench, state, named)) is not None:
        best = fully(bench, fitted(bench, whole))
        bench.say(f"  {told(named)} in the curve: {reduced_chi2(bench, best):.4g}")
        if best.select <= most:
            curve = next(a for a in added if same(a.effect, state.effects[-1]))
            first, *others = both = [a for a in added if a is curve or same(a.effect, named)]
            entry = replace(first, effect=best.effects[-1], after=curve.after, gain=sum(a.gain for a in both))
            return best, [entry if a is first else a for a in added if a not in others]
    lin = linearised(less.problem, less.minimum.vector)
    here = [c for c in curves(lin, bench.workers) if (c.effect.port, c.effect.joint) == (named.port, named.joint)]
    tried = refitted(bench, less, [(c, lin) for c in here[:CURVES]])
    if not tried:
        return state, added
    best = fully(bench, min(tried, key=left_by).state)
    if best.select > most:
        return state, added
    entries = renewed(state, less, added)
    return best, [replace(a, effect=best.effects[-1]) if same(a.effect, named) else a for a in entries]


def _as_well(bench: Bench, state: State) -> float:
    """chi^2 on the choosing records of another model that does as well as this one, or leaves nothing."""
    dof = degrees(bench.split.select)
    return max(state.select + max(LEAST_GAIN, ALIKE * (state.select - dof)), NAMED * dof)


def _in_one(bench: Bench, state: State, named: Effect) -> Refit | None:
    """The model with a named law in the heights of the last curve, to be refitted. None where the curve is not one of all that the law
    follows from."""
    curve, joint = state.effects[-1], named.joint
    if not isinstance(curve, LearnedLaw) or not isinstance(named, Law) or joint is None:
        return None
    if (named.port, joint) != (curve.port, curve.joint):
        return None
    law = at_knots(curve, named, float(bench.campaign.N[joint]), float(bench.guess.K[joint]))
    if law is None:
        return None
    refit = some(state, [k for k, e in enumerate(state.effects) if not same(e, named)])
    vector = refit.vector.copy()
    vector[-len(law) :] += law
    size, others = float(np.abs(vector[-len(law) :]).max()), len(refit.scales) - len(law)
    return replace(refit, vector=vector, scales=refit.scales[:others] + (size,) * len(law))


def _flat(named: Effect) -> Effect | None:
    """The learned friction that is the same law as Coulomb's: as high everywhere. None for any other law, or one whose creep was
    fitted."""
    if not (isinstance(named, Law) and named.dry and [p.name for p in named.parameters] == ["level"]):
        return None
    return learned(named.port, "friction", [0.0])(named.joint, named.values)


def was_named(curve: Effect) -> bool:
    """Whether a learned curve is friction of one height, whose name another curve outdid: it is given none again."""
    return len(curve.values) == 1


def outdone(named: Effect, added: Sequence[Added]) -> bool:
    """Whether curves at the port of a named effect do so much besides it, or in its place, that it is hardly the right name."""
    alone = next(a for a in added if same(a.effect, named))
    drawn = [a for a in added if isinstance(a.effect, Learned)]
    here = [a for a in drawn if (a.effect.port, a.effect.joint) == (named.port, named.joint)]
    names = [p.name for p in alone.effect.parameters if p.zero is not None and not (p.whole or p.aside)]
    sizes = [(abs(named[name]), abs(alone.effect[name])) for name in names]
    less = bool(here) and bool(sizes) and all(now < OUTDONE * then for now, then in sizes)
    return less or sum(a.gain for a in here) > OUTDONE * alone.gain


def renamed(bench: Bench, state: State, curve: Effect, added: list[Added]) -> tuple[State, list[Added]]:
    """The model with a name in a learned curve's place, if one does as well now that more is known, or leaves nothing."""
    less = without(bench, state, curve)
    lin = linearised(less.problem, less.minimum.vector)
    names = catalogue(lin, less.effects, bench.workers, at=(curve.port, curve.joint))
    bench.say(f"without {told(curve)}: {reduced_chi2(bench, less):.4g}")
    limit = _as_well(bench, state)
    if reduced_chi2(bench, less) <= CLOSE:
        names = promising(bench, names, less.select - limit)
    tried = polished(bench, refitted(bench, less, [(c, lin) for c in names[:NAMES]]))
    best = chosen(bench, tried, less.select)
    if best is None or best.state.select > limit:
        return state, added
    new = fully(bench, best.state)
    entries = [replace(a, effect=new.effects[-1]) if same(a.effect, curve) else a for a in added]
    return (new, entries) if new.select <= limit else (state, added)


def largest_first(bench: Bench, state: State, added: Sequence[Added]) -> list[Added]:
    """The entries; of two names one of which alone leaves hardly more than the other, that comes first with which less is left of the
    error that is reported: noise powers tell of many sharp lines what a person hardly sees."""
    entries = list(added)
    dof, report = degrees(bench.split.select), told_of(bench.split, state, bench.split.report)
    for k, (first, second) in enumerate(pairwise(added)):
        drawn = isinstance(first.effect, Learned) or isinstance(second.effect, Learned)
        if entries[k] is not first or drawn or bench.late:
            continue
        names = [*(one.effect for one in entries[:k]), second.effect]
        refit = some(state, [at for at, e in enumerate(state.effects) if any(same(e, name) for name in names)])
        alone = fitted(bench, replace(refit, roughly=HASTILY))
        if alone.select - dof > HARDLY_MORE * max(first.excess - first.gain, 1.0):
            continue
        alone = fitted(bench, Refit.of(alone))
        error = errors(bench, alone, report).all
        if error >= first.after:
            continue
        bench.say(
            f"  {told(second.effect)} before {told(first.effect)}: {100 * error:.3g} % instead of {100 * first.after:.3g}"
        )
        left = alone.select - dof
        shares = port_shares(linearised(alone.problem, alone.minimum.vector))
        entries[k : k + 2] = [
            replace(
                first, effect=second.effect, std=second.std, after=error, gain=first.excess - left, tied=second.tied,
                rivals=((first.effect, first.after), *(one for one in first.rivals if not same(one[0], second.effect))),
            ),
            replace(
                second, effect=first.effect, std=first.std, before=error, gain=left - second.excess + second.gain,
                excess=max(left, 1.0), tied=first.tied, rivals=(), port_shares=shares, besides=alone,
            ),
        ]  # fmt: skip
    return entries


def of_another_size(bench: Bench, state: State, added: list[Added]) -> tuple[State, list[Added]]:
    """The model and its entries, or those where effects that were found while others were missing are some other size, if that leaves
    less: looked for where more is left than some others may leave, or than noise beside what winds a spring up, which may leave little
    far from its size."""
    for effect in state.effects[:-1]:
        doubtful = reduced_chi2(bench, state) > NAMED if winds_up(effect) else not explains(bench, state)
        if doubtful and not bench.late:
            new = elsewhere(bench, state, effect)
            state, added = new, renewed(state, new, added)
    return state, added
