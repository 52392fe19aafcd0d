"""What a model leaves of the records, and whether that is noise, a small rest of what was found, or another effect's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

from ident.arm.arm_fit import chi_squared
from ident.arm.parts import degrees, few_lines, sampled
from ident.effects.base import Effect, Law, has_forces, winds_up
from ident.effects.learned import Learned
from ident.search.candidates import surest
from ident.search.changes import told_of
from ident.search.departures import Departure, departures, errors, groups, held_as, is_rough
from ident.search.refits import BENT, CLOSE, FEW_SAMPLES, NAMED, Bench, State, linearised, reduced_chi2
from ident.search.trials import ENOUGH

if TYPE_CHECKING:
    from ident.search.added import Added

#: The excess of chi^2 on the choosing records is so many times that on the fitting ones where these bend what is free; so
#: many times where something is left and they may.
BENDS, MAY_BEND = 10.0, 1.5
#: Degrees of freedom by which effects are looked for where no group of lines departs, and what one must promise: so much, and
#: this share of them. Where nothing is missing it has been 114 of the 250 at most.
LOOKED_AT, SURE, SURE_SHARE = 20_000, 150.0, 0.005
#: Times chi^2 per degree of freedom of the other records that those which only report leave where something acts in them alone.
UNSEEN = 30.0
#: Times its noise that the error of another joint shows that something acts there, too.
ELSEWHERE = 2.0
#: Share of the excess beyond which effects leave most of it, and that a force at one port explains alone if all of it acts there; ports
#: that explain as much as this share of what the best one does are not told apart.
MOST_LEFT, ALL, SAME_PORT = 0.5, 0.95, 0.99
#: Share of the excess that found effects may leave, as laws are known but the motion they act on is measured.
LEFT = 0.03


def something_departs(bench: Bench, state: State) -> bool:
    """Whether anything but noise may be left, on the records that fit and choose."""
    return reduced_chi2(bench, state) > 1.1 or bool(groups(state, bench.split.fit + bench.split.select))


@lru_cache(maxsize=2)  # who chooses between two models asks, and then the loop
def is_suspect(bench: Bench, state: State) -> bool:
    """Whether an effect of the catalogue promises what noise does not, though no group of lines departs: of many thousand lines
    those that it moves may be few."""
    part = min(LOOKED_AT / degrees(state.problem.data), 1.0)
    data = tuple(sampled(few_lines(one, round(part * one.count)), FEW_SAMPLES) for one in state.problem.data)
    lin = linearised(replace(state.problem, data=data), state.minimum.vector)
    return surest(lin, bench.workers) > SURE + SURE_SHARE * degrees(data)


def is_uneven(bench: Bench, state: State) -> bool:
    """Whether the records that fit tell too little for the others, or hardly anything departs in those that choose."""
    return _bends(bench, state, BENDS) or _fits_alone(bench, state) or _hardly_chooses(bench, state)


def _bends(bench: Bench, state: State, times: float) -> bool:
    """Whether a model fits the records that fit so many times better than the others: these leave too much of it free."""
    return reduced_chi2(bench, state) - 1.0 > times * (max(_fitting(bench, state) - 1.0, 0.0) + 0.1)


def _fits_alone(bench: Bench, state: State) -> bool:
    """Whether the records that fit are explained and the others not: these may tell too little of the arm's constants."""
    return _fitting(bench, state) <= NAMED < reduced_chi2(bench, state)


def _hardly_chooses(bench: Bench, state: State) -> bool:
    """Whether so much more departs in the records that fit than in those that choose that these would choose blindly."""
    return _fitting(bench, state) - 1.0 > BENDS * (max(reduced_chi2(bench, state) - 1.0, 0.0) + 0.1)


def may_bend(bench: Bench, start: State, state: State) -> bool:
    """Whether records that fit may leave too much free, without effects or with those found."""
    return _bends(bench, start, MAY_BEND) or _bends(bench, state, MAY_BEND)


def is_doubtful(bench: Bench, start: State, state: State, left: bool) -> bool:
    """Whether lines of every record may tell more: where something is `left` if the records that fit may leave too much free, or if it
    is little though nothing was found; else if only the choosing records leave more than noise."""
    if left:
        return may_bend(bench, start, state) or (state is start and reduced_chi2(bench, state) <= CLOSE)
    return reduced_chi2(bench, state) > NAMED and _bends(bench, state, MAY_BEND)


def may_be_bent(bench: Bench, start: State, state: State) -> bool:
    """Whether something is left because what was missing may have bent the arm: a little of what a curve draws always is."""
    drawn = isinstance(state.effects[-1], Learned)
    return reduced_chi2(bench, state) > NAMED and not (drawn and is_little(bench, start, state))


def is_little(bench: Bench, start: State, state: State) -> bool:
    """Whether so little is left of what was in excess that only what promises most of it is tried: of a force that may have moved
    the arm in more than one way, or of dry friction, more than of others; nothing of what is exact."""
    if not any(map(has_forces, state.effects)):
        return False
    left = share_left(bench, start, state)
    many_ways = any(isinstance(effect, Law) and winds_up(effect) for effect in state.effects)
    most = CLOSE**2 if any(effect.dry for effect in state.effects) else CLOSE
    little = left < ENOUGH and max(reduced_chi2(bench, state), _fitting(bench, state)) <= most
    return (little or (left < LEFT and many_ways)) and not acts_elsewhere(bench, state)


def acts_elsewhere(bench: Bench, state: State) -> bool:
    """Whether joints at which nothing was found are left far from their noise in the choosing records: all that is in excess may be little
    beside what another joint's was."""
    found = {None if e.joint is None else bench.campaign.joints[e.joint] for e in state.effects}
    told = errors(bench, state, bench.split.select)
    others = {} if None in found else {j: error for j, error in told.per_joint.items() if j not in found}
    return any(error > ELSEWHERE * told.noise_per_joint[j] for j, error in others.items())


@lru_cache(maxsize=2)
def is_unseen(bench: Bench, state: State) -> bool:
    """Whether the records that only report leave far more than those that fit and choose: something acts in them alone."""
    data = told_of(bench.split, state, bench.split.report)
    problem = replace(state.problem, data=data)
    held = held_as(state, data, is_rough(bench, state))
    left = chi_squared(problem, state.minimum.vector, held) / max(degrees(data), 1)
    return left > UNSEEN * max(reduced_chi2(bench, state), _fitting(bench, state), 1.0)


def left_over(bench: Bench, start: State, state: State) -> tuple[Departure, ...]:
    """What stays unexplained, but for the small rest that known forces may leave; less of it where a name needs a curve at its own port."""
    most = CLOSE if _mended(state.effects) else CLOSE**2
    forced = any(map(has_forces, state.effects))
    little = (
        forced
        and share_left(bench, start, state) < LEFT
        and max(reduced_chi2(bench, state), _fitting(bench, state)) < most
    )
    little = little and not (is_unseen(bench, state) or is_far(bench, state))
    return () if little else departures(bench, state)


def is_far(bench: Bench, state: State) -> bool:
    """Whether the error that is reported, of all or of one joint, is `CLOSE` times what noise makes, or more: few lines may be most of it, or
    a few chi^2 of all; another joint's noise says nothing of its own."""
    told = errors(bench, state, bench.split.report)
    pairs = [(told.all, told.noise), *((error, told.noise_per_joint[j]) for j, error in told.per_joint.items())]
    return any(error > CLOSE * noise for error, noise in pairs)


def _mended(effects: Sequence[Effect]) -> bool:
    """Whether a named law acts where a learned curve does, too: the name may be another's."""
    curves = {(e.port, e.joint) for e in effects if isinstance(e, Learned)}
    return any((e.port, e.joint) in curves and not (e.declared or isinstance(e, Learned)) for e in effects)


def is_of_one_joint(bench: Bench, start: State, state: State, added: Sequence[Added]) -> bool:
    """Whether the first effect found is one of the whole arm, and all found leaves much, of which a free force at one port of a joint would
    have explained more: what bends the whole arm plays a little of anything."""
    if not added or added[0].effect.joint is not None or bench.model.chain.n == 1 or reduced_chi2(bench, state) <= BENT:
        return False
    by_port = max((share for _, _, share in added[0].port_shares), default=0.0)
    return by_port > 1.0 - share_left(bench, start, state)


def is_of_another_port(bench: Bench, start: State, state: State, added: Sequence[Added]) -> bool:
    """Whether all found leaves most of what was in excess, nearly all of which a free force would have explained at a port where none of
    it acts: each plays a little of what acts there. What is no force at one port is not judged by that."""
    if not added or share_left(bench, start, state) <= MOST_LEFT:
        return False
    shares = {(port, joint): share for port, joint, share in added[0].port_shares}
    places = [(effect.port, effect.joint) for effect in state.effects if effect.joint is not None]
    if len(places) < len(state.effects) or any(place not in shares for place in places):
        return False
    best = max(shares.values())
    return best >= ALL and all(shares[place] < SAME_PORT * best for place in places)


def share_left(bench: Bench, start: State, state: State) -> float:
    """Share of what was in excess on the records that fit and choose that still is."""
    fit, select = degrees(bench.split.fit), degrees(bench.split.select)

    def beyond(one: State) -> float:
        return max(one.minimum.chi2 - fit, 0.0) + max(one.select - select, 0.0)

    return beyond(state) / max(beyond(start), 1.0)


def _fitting(bench: Bench, state: State) -> float:
    """chi^2 per degree of freedom on the records that fit."""
    return state.minimum.chi2 / degrees(bench.split.fit)
