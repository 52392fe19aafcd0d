"""Candidates tried: refitted with everything, the best finely; what one that is far ahead becomes at its minimum."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ident.arm.parts import degrees
from ident.effects.base import Effect, only_impedance, overrides, winds_up
from ident.search.candidates import Candidate, best_of, catalogue, of_kinds
from ident.search.choice import (
    AHEAD,
    LEAST_SHARE,
    MUCH,
    REST,
    SLIGHT,
    UNLIKELY,
    Tried,
    best_names,
    drawn_whole,
    hardly_bent,
    is_curve,
    law_leads,
    left_by,
    rings_ahead,
    vanished,
    with_model,
)
from ident.search.contact import as_it_sticks, balanced, besides, rubbing, rubbing_anew
from ident.search.curves import curves, resonances, responses
from ident.search.finer import LEADING, curve_finely, curves_alike, finely, finer, leader_finely
from ident.search.from_declared import as_it_moves, from_declared, soft_bases, tried_bending
from ident.search.minima import LEAST_GAIN, afresh, elsewhere, fully, told, wound_up
from ident.search.refits import (
    BENT,
    CLOSE,
    FAR,
    FINELY,
    FULLY,
    HASTILY,
    NAMED,
    Bench,
    State,
    all_fitted,
    as_declared,
    beyond_noise,
    linearised,
    reduced_chi2,
)
from ident.search.shapes import ringing
from ident.search.trace import Linearised, distorts
from ident.search.tried import by_few_lines, on_other_links, refitted, with_candidate
from ident.search.whole_numbers import last_otherwise, otherwise_if_left

#: Candidates of the catalogue refitted in each round (least and most), and learned curves.
REFITTED, CURVES = (6, 40), 2
#: Half of them hardly whatever they promise, as a promise is of first order: a `SLIGHT` share of what the best does; as many as make this
#: many numbers to be fitted.
EFFORT = 1.5e5
#: Share of what earns a place that a candidate must promise to be tried once little is left: promises are nearly right there.
HARDLY = 0.125
#: Candidates fitted finely before one is chosen.
FINALISTS = 3
#: Times what the best name leaves, if that is nothing or near it, that another may leave which may be as good.
NEAR_BEST = 1.2
#: Share of what was in excess without effects below which nothing more is looked for once little is left.
ENOUGH = 3e-3
#: Share of a small rest that an effect must promise to be tried, and one that acts where dry friction does; of what friction leaves, that
#: a law beside it may leave to be it.
MOST, BESIDE, HALF = 0.3, 0.05, 0.5


def explains(bench: Bench, state: State, near: float = CLOSE) -> bool:
    """Whether a model leaves nothing to look for: less than `near` noise powers, and little of what there is
    without effects."""
    dof = degrees(bench.split.select)
    little = reduced_chi2(bench, state) <= near and state.select - dof < ENOUGH * (bench.at_first - dof)
    return little or reduced_chi2(bench, state) <= NAMED


def earned(bench: Bench, before: State, after: State) -> bool:
    """Whether an effect more earns its place: a share of what was left, and either of what there is without effects, or nearly all
    that was left."""
    dof = degrees(bench.split.select)
    left, gain = max(before.select - dof, 1.0), before.select - after.select
    some = gain >= max(LEAST_GAIN, LEAST_SHARE * left)
    return some and (gain >= ENOUGH * (bench.at_first - dof) or after.select - dof < REST * left)


def promising(bench: Bench, likely: Sequence[Candidate], fall: float) -> list[Candidate]:
    """Those of `likely` that may make chi^2 on the choosing records fall so far, once little is left."""
    least = HARDLY * fall * degrees(bench.split.fit) / degrees(bench.split.select)
    return [c for c in likely if c.gain > least]


def first_names(bench: Bench, state: State, lin: Linearised) -> list[Tried]:
    """The likeliest names beyond `state`, linearised in `lin`, hastily refitted; where the fit is very far off from the arm that a
    fit begins at: no soft bases where something distorts, as these do not."""
    if reduced_chi2(bench, state) <= FAR:
        return on_other_links(bench, _from_fitted(bench, state, lin))
    return on_other_links(bench, leader_finely(bench, from_declared(bench, state, None, bases=not distorts(lin))))


def likely_names(bench: Bench, state: State, lin: Linearised, first: list[Tried]) -> list[Tried]:
    """The `first` names, and others where the fit is very far off and these leave much: soft bases, and names from the declared arm if
    fits begin at another."""
    if reduced_chi2(bench, state) <= FAR:
        return first
    names = [*first, *(soft_bases(bench, state, first) if distorts(lin) else [])]
    if bench.declared is not None and all(left_by(one) > MUCH * state.select for one in names):
        names += from_declared(replace(bench, guess=bench.declared), state, None, bases=not distorts(lin))
        names = leader_finely(bench, names)
    return on_other_links(bench, names, first)


def hasty(bench: Bench, state: State, lin: Linearised, names: list[Tried]) -> Iterator[list[Tried]]:
    """The candidates beyond `state`, linearised in `lin`, hastily refitted, in parts of which the first may do: the likely `names`, and
    others.

    The first effect is looked for from the declared arm, too: a fit that is far off bends everything else, shapes of an
    impedance at any rate. Where it is far so are later effects, unless a name explains the records already; where it is very far that
    comes first.
    """
    if reduced_chi2(bench, state) > FAR:
        yield names
        named = best_names(names)
        if _explaining(bench, names) is None:
            much = bool(named) and left_by(named[0]) < MUCH * state.select
            if not bench.only_names and (much or (not state.effects and law_leads(bench, names))):
                yield _drawn(bench, state, lin, names)
            else:
                tried = _from_fitted(bench, state, lin)
                yield _and_curves(bench, state, lin, tried)
    elif state.effects or reduced_chi2(bench, state) > BENT:
        tried = _and_curves(bench, state, lin, names)
        yield tried
        if reduced_chi2(bench, state) > BENT and not (drawn_whole(bench, tried) or _explaining(bench, tried)):
            yield leader_finely(bench, from_declared(bench, state, None), tried)
    else:
        anew = [] if _explaining(bench, names) is not None else from_declared(bench, state, None)
        tried = _and_curves(bench, state, lin, [*names, *anew])
        if not (drawn_whole(bench, tried) or hardly_bent(bench, state, tried)):
            if _explaining(bench, tried) is None:
                tried += tried_bending(bench, state, lin)
            found = _explaining(bench, tried)
            if found is not None and only_impedance(found):
                tried += from_declared(bench, state, found)
        yield tried


def resting(bench: Bench, state: State, lin: Linearised) -> list[Tried]:
    """The names that promise most of what is left, where that is little or one is known that leaves nothing, hastily refitted: less of it
    where dry friction acts, or where the best of them does."""
    names, left = catalogue(lin, state.effects, bench.workers), beyond_noise(state, lin)
    rubs = {
        (effect.port, effect.joint) for effect in state.effects if effect.dry and reduced_chi2(bench, state) > NAMED
    }
    here = [c for c in names if (c.effect.port, c.effect.joint) in rubs and c.gain > BESIDE * left]
    likely = [c for c in names[:FINALISTS] if c.gain > MOST * left]
    likely += [c for c in here[:FINALISTS] if c not in likely]
    tried = refitted(bench, state, [(c, lin) for c in likely])
    best = min(tried, key=left_by, default=None)
    if best is None or left_by(best) >= state.select:
        return tried
    place = best.candidate.effect.port, best.candidate.effect.joint
    kin = [c for c in names if (c.effect.port, c.effect.joint) == place and c not in likely and c.gain > BESIDE * left]
    return tried + refitted(bench, state, [(c, lin) for c in kin])


def _explaining(bench: Bench, tried: Sequence[Tried]) -> Effect | None:
    """The effect of the best name, if it explains the records."""
    name = min((one for one in tried if not is_curve(one)), key=left_by, default=None)
    return None if name is None or not explains(bench, name.state, CLOSE**2) else name.candidate.effect


def _from_fitted(bench: Bench, state: State, lin: Linearised) -> list[Tried]:
    """The likeliest names beyond a model."""
    most = int(np.clip(EFFORT / degrees(state.problem.data), *REFITTED))
    likely = catalogue(lin, state.effects, bench.workers)[:most]
    if reduced_chi2(bench, state) <= CLOSE:
        likely = promising(bench, likely, LEAST_SHARE * max(state.select - degrees(bench.split.select), 1.0))
    else:
        least, slight = LEAST_SHARE * beyond_noise(state, lin), SLIGHT * max((c.gain for c in likely), default=0.0)
        likely = [
            c
            for k, c in enumerate(likely)
            if c.gain > least or k < REFITTED[0] // 2 or (k < most // 2 and c.gain > slight)
        ]
        likely += balanced(lin, state.effects)
    tried = as_it_sticks(bench, state, lin, as_it_moves(bench, refitted(bench, state, [(c, lin) for c in likely])))
    tried += _ringing(bench, state, lin, tried)
    return _nearest_finely(bench, tried)


def _and_curves(bench: Bench, state: State, lin: Linearised, names: list[Tried]) -> list[Tried]:
    """The `names` tried beyond a model, and the likeliest curves where none of them explains the records."""
    tried = list(names)
    if reduced_chi2(bench, state) > CLOSE and all(left_by(one) > REST * state.select for one in tried):
        tried += _besides(bench, state, lin)
    if not (bench.late or bench.only_names or any(_leaves_nothing(bench, new) for _, new in tried)):
        tried += _drawn(bench, state, lin, tried)
    return tried


def _leaves_nothing(bench: Bench, state: State) -> bool:
    """Whether a model leaves nothing but noise: dry friction leaves a little until a model is chosen."""
    rubs = any(effect.dry for effect in state.effects)
    return explains(bench, state) if rubs else reduced_chi2(bench, state) <= NAMED


def _besides(bench: Bench, state: State, lin: Linearised) -> list[Tried]:
    """Laws beside the dry friction of a model, curves if no name is it, fitted until both settle; where much is left, hastily."""
    tried: list[Tried] = []
    roughly = HASTILY if reduced_chi2(bench, state) > BENT else FINELY
    for likely in besides(lin, state.effects):
        if not bench.late and all(left_by(one) > HALF * state.select for one in tried):
            refits = [replace(with_candidate(state, c, lin), outer=FULLY, roughly=roughly) for c in likely]
            tried += map(Tried, likely, all_fitted(bench, refits))
    for _, new in tried:
        bench.say(f"  beside what rubs, {told(new.effects[-1])}: {reduced_chi2(bench, new):.4g}")
    return tried


def _nearest_finely(bench: Bench, tried: list[Tried]) -> list[Tried]:
    """The candidates, the best fitted finely where it is near the noise, then others as near until one leaves nothing: nothing else need
    be tried."""
    best = min(tried, key=left_by, default=None)
    if best is None or not NAMED < reduced_chi2(bench, best.state) <= CLOSE**2:
        return tried
    for near in sorted((one for one in tried if left_by(one) <= NEAR_BEST * left_by(best)), key=left_by):
        state = otherwise_if_left(bench, finer(bench, near.state))
        tried = with_model(tried, near, state)
        if bench.late or reduced_chi2(bench, state) <= NAMED:
            break
    return tried


def _drawn(bench: Bench, state: State, lin: Linearised, names: Sequence[Tried]) -> list[Tried]:
    """The likeliest mass that rings at a motor beyond a model, hastily refitted; if that leaves anything, the likeliest learned curves,
    and those of what rubs where the `names` do; frequency responses that promise more than any law, from the declared arm, too, if the
    fit is very far off."""
    least = LEAST_SHARE * beyond_noise(state, lin)
    rung = _rung(bench, state, lin, least)
    if any(left_by(one) < ENOUGH * state.select or reduced_chi2(bench, one.state) <= NAMED for one in rung):
        return rung
    laws = curves(lin, bench.workers)[:CURVES]
    ahead = responses(lin, max([least, *(c.gain for c in laws)]), bench.workers)[:CURVES]
    tried = rung + refitted(bench, state, [(c, lin) for c in [*laws, *ahead] if c.gain > least])
    if drawn_whole(bench, tried):
        return tried
    tried += rubbing_anew(bench, state, lin, names)
    if any(not is_curve(one) and explains(bench, one.state, CLOSE**2) for one in tried):
        return tried
    more = rubbing(bench, lin, names)
    if ahead and reduced_chi2(bench, state) > BENT:
        declared = linearised(state.problem, as_declared(bench, state))
        more += [(c, declared) for c in responses(declared, 0.0, bench.workers)[:CURVES]]
    return tried + refitted(bench, state, more)


def _rung(bench: Bench, state: State, lin: Linearised, least: float) -> list[Tried]:
    """The likeliest mass that rings at a motor, if it promises so much at `least`, from the declared arm, too, if the fit is very far off."""
    origins = [lin]
    if reduced_chi2(bench, state) > BENT:
        origins.append(linearised(state.problem, as_declared(bench, state)))
    rings = [(c, at) for at in origins for c in resonances(at, state.effects, least, bench.workers)[:1]]
    rung = refitted(bench, state, rings)
    return rung + _ringing(bench, state, lin, rung)


def _ringing(bench: Bench, state: State, lin: Linearised, tried: Sequence[Tried]) -> list[Tried]:
    """What rings, promises most of all that were `tried` and leaves nearly all there was, at other frequencies."""
    best = max(tried, key=lambda one: one.candidate.gain, default=None)
    if best is None or reduced_chi2(bench, state) <= CLOSE or left_by(best) <= MUCH * state.select:
        return []
    explained = any(reduced_chi2(bench, one.state) <= NAMED for one in tried)
    return [] if explained else by_few_lines(bench, state, lin, ringing(best.candidate))


def ahead(bench: Bench, tried: Sequence[Tried]) -> Tried | None:
    """A name so far ahead of all other candidates that these need not be fitted finely; none if it leaves nothing already, where only
    those near it are."""
    order = sorted(tried, key=left_by)
    others = [left_by(one) for one in order if one.candidate.key != order[0].candidate.key]
    if not others or is_curve(order[0]) or left_by(order[0]) > min(LEADING * others[0], bench.at_first):
        return None
    return None if explains(bench, order[0].state, CLOSE**2) else order[0]


def outshines(bench: Bench, one: Tried, tried: Sequence[Tried]) -> bool:
    """Whether a name that is far ahead of all that were `tried` leaves so little of what there is without effects that what is left is
    another effect's: a law that leads little in noise powers, what gives little of all that there was, or of what any other leaves."""
    dof = degrees(bench.split.select)
    if only_impedance(one.candidate.effect):
        others = min((left_by(other) for other in tried if other.candidate.key != one.candidate.key), default=0.0)
        leads = left_by(one) <= min(AHEAD * others, LEADING * bench.at_first)
        return leads or one.state.select - dof < ENOUGH * (bench.at_first - dof)
    return law_leads(bench, tried) and reduced_chi2(bench, one.state) <= CLOSE**2


def at_minimum(bench: Bench, one: Tried) -> Tried:
    """A candidate that is far ahead, at its minimum."""
    state = fully(bench, wound_up(bench, otherwise_if_left(bench, one.state)))
    if winds_up(state.effects[-1]) and reduced_chi2(bench, state) > NAMED and not bench.late:
        state = afresh(bench, state)
    bench.say(f"  far ahead, {told(state.effects[-1])}: {reduced_chi2(bench, state):.4g}")
    return one.refitted(state)


def giving(bench: Bench, state: State, lin: Linearised, one: Tried, tried: Sequence[Tried]) -> list[Tried]:
    """Beside what gives, a spring or a mode of its own, all else that gives at its joint and was not `tried` beyond `state`: as shapes move
    far, what these promise to first order says little."""
    effect = one.state.effects[-1]
    if not only_impedance(effect) or effect.joint is None or effect.numbers < 2:
        return []
    known = [*state.effects, *(other.effect for other, _ in tried)]
    kinds = of_kinds(
        lin, lambda k, at: at == effect.joint and overrides(k, "impedance") and len(k.parameters) > 1, known
    )
    names = [best_of(lin, *one) for one in kinds]
    likely = [c for c in names if c is not None and only_impedance(c.effect)]
    return refitted(bench, state, [(c, lin) for c in likely])


def polished(bench: Bench, tried: Sequence[Tried], before: float = np.inf) -> list[Tried]:
    """The candidates, those that may be chosen fitted finely, and the best name from other places where it leaves something; `before` is
    chi^2 on the choosing records without any. Once it is late all stay as they are."""
    if bench.late:
        return list(tried)
    tried = curve_finely(bench, tried)
    finalists = _finalists(bench, tried, before)
    if not finalists:
        return list(tried)
    found = finely(bench, finalists) + [one for one in tried if all(one is not other for other in finalists)]
    named = best_names(found)
    if not named:
        return found
    best_name, likeliest = named[0], max(named, key=lambda one: one.candidate.gain)
    if likeliest is not best_name and (other := last_otherwise(bench, likeliest.state)) is not likeliest.state:
        found = with_model(found, likeliest, other)
        best_name = best_names(found)[0]
    if drawn_whole(bench, found):
        return found
    better = wound_up(bench, otherwise_if_left(bench, best_name.state))
    far = not explains(bench, better) or (winds_up(better.effects[-1]) and reduced_chi2(bench, better) > NAMED)
    curve = min((left_by(one) for one in found if is_curve(one)), default=np.inf)
    if far and not bench.late and curve > UNLIKELY * better.select:
        better = elsewhere(bench, better, better.effects[-1])
    return with_model(found, best_name, better)


def likeliest(bench: Bench, tried: Sequence[Tried]) -> list[Tried]:
    """The best names, no force that a curve which is the whole of what is left is far ahead of."""
    least = min(map(left_by, tried), default=0.0) if drawn_whole(bench, tried) else np.inf
    names = best_names(tried)
    return [one for one in names if only_impedance(one.candidate.effect) or UNLIKELY * left_by(one) <= least]


def _may_be_as_good(bench: Bench, one: Tried, best: Tried, before: float) -> bool:
    """Whether a name may leave nothing, as the `best` one does in haste: it leaves little of what there is without effects, and takes half as
    much of what there was `before` as the best does; or the motion that its force makes of its joint, the same one, is not found in haste.
    None that is nothing itself."""
    effect, dof = one.candidate.effect, degrees(bench.split.select)
    if vanished(one.state.effects[-1]):
        return False
    little = dof + REST * max(bench.at_first - dof, 0.0)
    unfound = effect.joint == best.candidate.effect.joint and (effect.dry or winds_up(effect))
    some = before - left_by(one) >= HALF * (before - left_by(best))
    return unfound or (some and left_by(one) <= max(little, NEAR_BEST * left_by(best)))


def _finalists(bench: Bench, tried: Sequence[Tried], before: float = np.inf) -> list[Tried]:
    """The candidates to be fitted finely: where a name leaves nothing, those near the noise, or none if it is alone there; where none
    is near, those not far behind the best, but none behind a law that is far ahead, or behind what rings that is. Of the curves the best,
    and dry friction that is as good in haste.
    """
    named, drawn = best_names(tried), curves_alike(tried)
    near = (CLOSE if named and reduced_chi2(bench, named[0].state) <= NAMED else CLOSE**2) * degrees(bench.split.select)
    if not named:
        return drawn
    if rings_ahead(tried):
        return drawn[:1]
    if drawn_whole(bench, tried):
        return drawn + likeliest(bench, tried)[:FINALISTS]
    left = reduced_chi2(bench, named[0].state)
    if explains(bench, named[0].state, CLOSE**2):
        if left > NAMED:
            return [one for one in named[:FINALISTS] + drawn if left_by(one) <= near]
        rivals = [
            one for one in named[:FINALISTS] if left_by(one) <= near and _may_be_as_good(bench, one, named[0], before)
        ]
        return rivals if len(rivals) > 1 else []
    if law_leads(bench, tried):
        return named[:1] + drawn
    return named[:1] + [one for one in named[1:FINALISTS] + drawn if UNLIKELY * left_by(one) <= left_by(named[0])]
