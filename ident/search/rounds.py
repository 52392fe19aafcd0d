"""One effect more, or two at once: the candidates of a round, the best of them at its minimum, whether it earns its place."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ident.arm.parts import degrees, sampled
from ident.effects.base import Effect, Law
from ident.effects.learned import Learned
from ident.search.added import HARDLY_MORE, Added, left_without
from ident.search.alike import names_alike
from ident.search.candidates import Candidate
from ident.search.changes import since, told_of
from ident.search.choice import (
    AHEAD,
    ALIKE,
    CURVE_SHARE,
    TIE,
    Tried,
    best_names,
    chosen,
    is_curve,
    left_by,
    plainest,
    rings_ahead,
    rivals,
    vanished,
    with_model,
)
from ident.search.contradicted import is_shapeless
from ident.search.departures import errors
from ident.search.finer import finer
from ident.search.gains import named_gains, resolved
from ident.search.knots import drawn_closely
from ident.search.minima import LEAST_GAIN, fully, told
from ident.search.naming import is_clear, named_by_load, of_any_order, plainer
from ident.search.one_more import leading_to_one_more
from ident.search.refits import (
    BY_ALL,
    CLOSE,
    FEW_SAMPLES,
    FEW_TURNS,
    FULLY,
    NAMED,
    Bench,
    Refit,
    State,
    but_last,
    fitted,
    linearised,
    reduced_chi2,
    reordered,
    same,
    standing,
    with_last,
    without,
    without_each,
)
from ident.search.several_joints import SOME, at_several_joints, instead_of
from ident.search.slips import with_closer_stops
from ident.search.trace import Linearised, port_shares
from ident.search.trials import (
    ahead,
    at_minimum,
    earned,
    explains,
    first_names,
    giving,
    hasty,
    likeliest,
    likely_names,
    outshines,
    polished,
    resting,
)
from ident.search.tried import again, refitted
from symgen.forked import forked

#: Rivals whose errors are told.
RIVALS = 3
#: Most effects with each of which a second one is looked for, where none does alone; share of chi^2 on the fitting records that
#: one of these leaves at most.
LEADERS, LEADS = 2, 0.8


def another(
    bench: Bench,
    state: State,
    little: bool,
    bends: bool = False,
    partly: Sequence[State] = (),
    missing: Sequence[Tried] = (),
) -> tuple[State, list[Added]] | None:
    """The model with one effect more, if any earns it, or two that do together. Where `little` is left, only of those that promise most of it. Where the records that fit may let the model bend, `bends`,
    no two, and none if all leave more at first than there was. What explained something `partly` before others were added is tried as it
    was then, too: what these missed may have bent the arm. `missing` are names that were tried already, one of which leaves hardly anything."""
    lin = linearised(state.problem, state.minimum.vector)
    tried: list[Tried] = list(missing)
    further: Iterable[list[Tried]] = ()
    if not (bench.late or any(explains(bench, new) for _, new in missing)):
        tried += again(bench, state, partly) if reduced_chi2(bench, state) > CLOSE else []
        if little or any(reduced_chi2(bench, new) <= NAMED for _, new in tried):
            further = [resting(bench, state, lin)]
        else:
            likely = first_names(bench, state, lin)
            several = None if bends else at_several_joints(bench, state, likely)
            if several is not None and (kept := _each_in_turn(bench, state, lin, several)) is not None:
                return kept
            likely = likely_names(bench, state, lin, likely)
            likely, lead = leading_to_one_more(bench, state, likely)
            two = None if lead is None else _with_second(bench, state, *lead, likely, lin)
            if two is not None:
                return two
            further = hasty(bench, state, lin, likely)
    best, tried = _best(bench, state, lin, tried, further, little, bends)
    best = best and best.refitted(with_closer_stops(bench, resolved(bench, best.state)))
    best = best and drawn_closely(bench, best, tried)
    one = _entered(bench, state, best, tried, lin)
    names = None if best is None else named_gains(bench, best.state) or named_by_load(bench, best.state)
    if names is not None and earned(bench, state, names):
        new = [e for e in names.effects if all(not same(e, old) for old in state.effects)]
        if new:
            return names, [_entry(bench, state, names, state.select - names.select, tried, lin, e) for e in new]
    drawn = best is not None and isinstance(best.state.effects[-1], Learned)
    if one is not None and not (drawn and reduced_chi2(bench, one[0]) > CLOSE**2):
        return one[0], [one[1]]
    two = (
        None if little or bends or bench.late or reduced_chi2(bench, state) < BY_ALL else _two(bench, state, tried, lin)
    )
    if one is not None and (two is None or one[0].select <= two[0].select):
        return one[0], [one[1]]
    return two


def _two(bench: Bench, state: State, tried: Sequence[Tried], lin: Linearised) -> tuple[State, list[Added]] | None:
    """The model with two effects more, the first one of those that, of all that were tried, explain most of the records that fit:
    what is missing besides may bend the others."""
    for _, lead in best_names(tried, by=lambda one: one.state.minimum.chi2)[:LEADERS]:
        if bench.late or lead.minimum.chi2 > LEADS * state.minimum.chi2:
            break
        bench.say(f"  none alone; with {told(lead.effects[-1])}:")
        both = _with_second(bench, state, lead, (), tried, lin)
        if both is not None:
            return both
    return None


def _with_second(
    bench: Bench, state: State, lead: State, missing: Sequence[Tried], tried: Sequence[Tried], lin: Linearised,
) -> tuple[State, list[Added]] | None:  # fmt: skip
    """The model with the last effect of `lead`, one of those `tried` beyond `state`, and a second one, that which is `missing` if it was
    found; with the second alone if that does without the first, which led to it. None is looked for once it is late, but one that
    was found is kept."""
    if bench.late and not missing:
        return None
    there = linearised(lead.problem, lead.minimum.vector)
    likely = missing or likely_names(bench, lead, there, first_names(bench, lead, there))
    if bench.late and not missing:
        return None
    further = () if missing else hasty(bench, lead, there, [*likely])
    best, more = _best(bench, lead, there, list(missing), further)
    second = _entered(bench, lead, best, more, there)
    if second is None or not earned(bench, state, second[0]):
        return None
    new, entry = second
    alone = left_without(bench, new, lead.effects[-1])
    if earned(bench, alone, new):
        gain, found = alone.select - new.select, new.effects[-2]
        return new, [_entry(bench, state, lead, gain, tried, lin, found), entry]
    if earned(bench, state, alone):
        return alone, [_entry(bench, state, alone, state.select - alone.select, more, lin, alone.effects[-1])]
    return None


def _each_in_turn(bench: Bench, state: State, lin: Linearised, found: State) -> tuple[State, list[Added]] | None:
    """The model `found` with effects more than `state`, linearised in `lin`, each once more beside all others, as if it were found last: what does
    as much may be in its place, unless all is noise with it that is none without it, and none is kept that earns nothing there. None if none is."""
    rows: list[tuple[State, State, float, list[Tried], Linearised, Effect]] = []
    first, names = found, found.effects[len(state.effects) :]
    for effect, less in zip(names, without_each(bench, found, names), strict=True):
        k = next(k for k, e in enumerate(found.effects) if same(e, effect))
        if bench.late:  # then what they do together has to do
            rows.append((state, found, state.select - found.select, [], lin, found.effects[k]))
            continue
        unchanged = set(found.effects) == set(first.effects)
        found = reordered(bench, found, with_last(found, k))
        far = found.select < AHEAD * less.select
        if not (unchanged and far):
            less = left_without(bench, found, effect)
        some = reduced_chi2(bench, found) > CLOSE and found.select < SOME * less.select
        if not (some or earned(bench, less, found)):
            found = less
            continue
        own = Tried(Candidate(found.effects[-1], 0.0, found.scales[-len(effect.values) :]), found)
        others, here = list[Tried](), lin
        stands = far and reduced_chi2(bench, found) <= NAMED
        if not stands:
            plain, here = standing(bench, found, but_last(found))
            others = refitted(bench, plain, instead_of(bench, plain, here, own.candidate))
        clear = stands and is_clear(bench, found, found.effects[-1])
        best = plainest(bench, [own if clear else plainer(bench, own, CLOSE), *others])
        if any(best is one for one in others):
            best = plainest(bench, [own, best.refitted(finer(bench, best.state))])
        found = best.state
        rows.append((less, found, less.select - found.select, [own, *others], here, found.effects[-1]))
    states = {id(one): one for row in rows for one in row[:2]}
    error = dict(zip(states, forked(lambda one: _error(bench, one), list(states.values()), bench.workers), strict=True))
    added = [_entry(bench, *row, coarsely=(error[id(row[0])], error[id(row[1])])) for row in rows]
    return (found, added) if added else None


def _entered(
    bench: Bench, state: State, best: Tried | None, tried: Sequence[Tried], lin: Linearised
) -> tuple[State, Added] | None:
    """The model with the best candidate, if it earns its place."""
    if best is None:
        return None
    new = since(bench, best.state)
    if vanished(new.effects[-1]) or is_shapeless(new):
        return None
    alone = left_without if new.select < AHEAD * state.select else without
    less = alone(bench, new, new.effects[-1])
    state = less if less.select < state.select else state  # what is gained by a better fit is no gain of the effect
    if new.roughly < state.roughly and reduced_chi2(bench, state) <= NAMED and earned(bench, state, new):
        less = fitted(bench, replace(Refit.of(state), outer=FULLY, roughly=new.roughly))
        state = less if less.select < state.select else state
    gain = state.select - new.select
    share = CURVE_SHARE * max(bench.at_first - degrees(bench.split.select), 0.0)
    little = gain < share and not (reduced_chi2(bench, state) > BY_ALL and reduced_chi2(bench, new) <= CLOSE)
    if not earned(bench, state, new) or (is_curve(best) and little):
        return None
    return new, _entry(bench, state, new, gain, tried, lin, new.effects[-1])


def _entry(
    bench: Bench, state: State, new: State, gain: float, tried: Sequence[Tried], lin: Linearised, effect: Effect,
    coarsely: tuple[float, float] | None = None,
) -> Added:  # fmt: skip
    """The entry of an `effect` that makes of a model the `new` one, its rivals those that were `tried` beside it; errors of both as closely as
    any, or as they were told `coarsely`."""
    dof, last = degrees(bench.split.select), new.effects[-1]
    key = last.name, last.joint, last.port
    others = [pair for pair in tried if pair.candidate.key != key and np.isfinite(pair.state.select)]
    order = sorted((other for _, other in others), key=lambda other: other.select)
    named = [other for other in order if other.effects[-1].name != "unknown"]
    of_rivals = list(forked(lambda other: _error(bench, other), order[:RIVALS], bench.workers))
    report = told_of(bench.split, new, bench.split.report)
    before, after = coarsely or (errors(bench, one, report).all for one in (state, new))
    return Added(
        effect=effect,
        std=(),
        before=before,
        after=after,
        gain=gain,
        excess=max(state.select - dof, 1.0),
        rivals=tuple((other.effects[-1], error) for other, error in zip(order[:RIVALS], of_rivals, strict=True) if error < np.inf),
        tied=tuple(
            other.effects[-1] for other in named if other.select < new.select + TIE + ALIKE * max(new.select - dof, 0.0)
        ),
        port_shares=port_shares(lin),
        besides=state,
        partly=tuple([one for one in named if one.select < LEADS * state.select][:RIVALS]),
        others=tuple([one for one in named if one.select - dof < HARDLY_MORE * max(new.select - dof, 0.0)][:RIVALS]),
    )  # fmt: skip


def _best(
    bench: Bench,
    state: State,
    lin: Linearised,
    tried: list[Tried],
    further: Iterable[list[Tried]],
    little: bool = False,
    bends: bool = False,
) -> tuple[Tried | None, list[Tried]]:
    """The candidate to be chosen beyond `state`, at its minimum, and all that were `tried` and `further`; as in `another`."""
    leader: Tried | None = None
    for more in further:
        tried += more
        if bench.late:
            return chosen(bench, tried, state.select), tried
        one = ahead(bench, tried)
        if one is None or one is leader or (little and left_by(one) >= state.select):
            continue
        leader = at_minimum(bench, one)
        tried = [leader if other is one else other for other in tried]
        stands = explains(bench, leader.state) or outshines(bench, leader, tried)
        if stands and not is_shapeless(leader.state):
            return of_any_order(bench, plainer(bench, leader)), tried
    if (little and not _gaining(bench, tried)) or (bends and all(left_by(one) > state.select for one in tried)):
        return None, tried
    tried = [one for one in polished(bench, tried, state.select) if not vanished(one.state.effects[-1])]
    tried = [one for one in tried if not is_shapeless(one.state)]
    best = chosen(bench, tried, state.select)
    if bench.late:
        return best, tried
    if best is not None and is_curve(best):
        if isinstance(best.state.effects[-1], Law) and reduced_chi2(bench, best.state) <= CLOSE**2:
            plain, likely = names_alike(best.state)
            tried += refitted(bench, plain, likely)
        for name in [] if rings_ahead(tried) else likeliest(bench, tried)[:1]:  # which may do as well at its minimum
            tried = with_model(tried, name, fully(bench, name.state))
        best = chosen(bench, tried, state.select)
    if best is None or not np.isfinite(best.state.select) or (is_curve(best) and left_by(best) > state.select):
        return None, tried
    if more := giving(bench, state, lin, best, tried):
        tried += more
        best = chosen(bench, tried, state.select) or best
    alike = [best, *rivals(bench, tried, best)]
    closely = [one if one is leader else one.refitted(fully(bench, one.state)) for one in alike]
    for one in closely[1:]:
        bench.say(f"  as closely, {told(one.state.effects[-1])}: {left_by(one):.6g} and {left_by(closely[0]):.6g}")
    best = closely[0] if len(closely) == 1 else plainest(bench, closely, 0.0)
    if best.state.effects[-1].dry and not is_curve(best) and reduced_chi2(bench, best.state) <= CLOSE:
        best = plainer(bench, best)  # what that leaves depends on how it creeps
    best = of_any_order(bench, best)
    return best, [one for one in tried if all(one is not other for other in alike)] + closely


def _gaining(bench: Bench, tried: Sequence[Tried]) -> bool:
    """Whether the best of some candidates leaves less than the model without it, fitted as roughly."""
    best = min((state for _, state in tried), key=lambda state: state.select, default=None)
    if best is None:
        return False
    return best.select < without(bench, best, best.effects[-1], best.roughly).select - LEAST_GAIN


def _error(bench: Bench, state: State) -> float:
    """The relative error of a rival on the records that report, told as coarsely as it was fitted; infinite where its response is
    no number."""
    coarse = replace(state, problem=replace(state.problem, turns=FEW_TURNS))
    try:
        return errors(bench, coarse, tuple(sampled(one, FEW_SAMPLES) for one in bench.split.report)).all
    except (ValueError, np.linalg.LinAlgError):
        return float(np.inf)
