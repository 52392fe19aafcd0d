"""A campaign diagnosed with the constants that it can bear: those of general links, or fewer, the URDF's zeros believed.

Links that are drawn symmetric have products of inertia that are exactly zero. To take them for unknown is never wrong, but
what an undeclared effect bends can then hide in them, the more so as a part of the records only fits: a joint whose zero is
off looks like a link that is not symmetric. What takes fewer numbers is the simpler explanation. Fewer causes are it only where
the zeros are seen to be none: more constants than these take up what has a name without being a cause.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from math import inf

from ident.arm.parts import Split
from ident.effects.declared import GravityStiffness, InertialParameters, Payload
from ident.effects.waves import order_of
from ident.identification.campaign_model import model_of_campaign, zeros_believed
from ident.loop.diagnose import Begun, Diagnosis, begin
from ident.loop.zeros import far_from_zero
from ident.records.campaign import Campaign
from ident.records.faults import refuse
from ident.records.frf import estimate
from ident.search.one_more import one_more
from ident.search.refits import CLOSE, NAMED, State, reduced_chi2
from symgen.plan import model_of_urdf

#: What a note begins with that says of a verdict that time ran out before it.
ENDED = "The search was ended"
#: General links are tried where they leave less than this share of what is left when zeros are believed, beside the same
#: effects, and taken where they do with their own.
BETTER = 0.8
#: They are tried, too, where they explain the records with so many effects fewer.
FEWER = 2
#: They come first where they leave less than this share of what is left when zeros are believed, without effects, and are gone over
#: to where they do beside those found. It was 0.1 at most where a link was off, 0.4 at least where none was.
FAR = 0.2
#: Share of what is left when zeros are believed that they may leave, hastily fitted, to leave so much less.
MAYBE = 0.5
#: What may be off that moves the constants of links.
OF_LINKS = (Payload.name, InertialParameters.name, GravityStiffness.name)
#: They are taken where they explain the records with this share of the causes: which numbers are told as off is chance at the margin.
HALF = 0.5


def diagnose_either(
    campaign: Campaign,
    believe_zeros: bool | None = None,
    *,
    workers: int = 1,
    say: Callable[[str], None] = lambda line: None,
    seconds: float = inf,
) -> tuple[Diagnosis, tuple[str, ...]]:
    """Returns the diagnosis of a campaign and notes on its constants; `believe_zeros` None lets the records decide.

    Nothing new is looked for after so many `seconds` [s]: what was found by then is told.
    Raises IdentError for a campaign without usable records, or one with a fault of the recording (`ident.records.faults`): what bends the
    fit of a wrong sign or unit is no effect.
    """
    until = time.monotonic() + seconds
    found, notes = _diagnosed(campaign, believe_zeros, workers, say, until)
    if time.monotonic() > until and (found.status == "unexplained" or found.left > NAMED):
        notes += (f"{ENDED} after {seconds:.0f} s: a longer one may find more (--minutes).",)
    return found, notes


def _diagnosed(
    campaign: Campaign, believe_zeros: bool | None, workers: int, say: Callable[[str], None], until: float
) -> tuple[Diagnosis, tuple[str, ...]]:
    """As `diagnose_either`, until a time."""
    if campaign.records:
        refuse(campaign, model_of_urdf(campaign.urdf, campaign.joints))
    responses = tuple(estimate(record, campaign) for record in campaign.records)
    model, notes = model_of_campaign(campaign, responses, believe_zeros, "coupled")
    general = begin(campaign, model, responses, workers, until, say)
    symmetric = model_of_urdf(campaign.urdf, campaign.joints, believe_zeros=True)
    more = len(model.alpha_cad) - len(symmetric.alpha_cad)
    if believe_zeros is not None or not more:
        return general.diagnosed(), notes
    believed = len(symmetric.factoring.believed)
    simplest = begin(campaign, symmetric, responses, workers, until, say)
    alone = not general.departs
    by_general = cache(lambda: general.diagnosed())
    if alone and _is_load(by_general()):
        return by_general(), notes
    far = not alone and general.alone < FAR * simplest.alone
    gone_on: Callable[[], Diagnosis] | None = None
    if far:  # a search with the zeros believed would look for what links that are not symmetric do
        found = by_general()
        if found.left <= NAMED:
            stands, gone_on = _beside_zeros(simplest, found)
            if stands:
                return found, notes
    say(f"zeros of the URDF believed: {believed}")

    at_once = False

    def elsewhere(some: bool) -> bool:
        nonlocal at_once
        at_once = not (alone or some or general.bench.late) and general.at_once
        return alone or at_once

    stayed: set[frozenset[tuple[str, int | None, float | None]]] = set()

    def gives_way(state: State, split: Split) -> bool:
        bench = replace(simplest.bench, split=split)
        names = frozenset((e.name, e.joint, order_of(e)) for e in state.effects)
        if bench.late or names in stayed:
            return False
        left = reduced_chi2(bench, state)
        far = alone or reduced_chi2(*general.beside(state, split, most=MAYBE * left)) < FAR * left
        gives = far and not one_more(bench, state)[1]
        if not gives:
            stayed.add(names)
        return gives

    begun = simplest.by_names() if alone else simplest
    simple = gone_on() if gone_on else begun.diagnosed(gives_way, elsewhere)
    explained = simple.left <= NAMED and (not alone or 0 < sum(len(e.values) for e in simple.end.effects) < more)
    if not far and explained and _things(simple) > 1 and (alone or _fewer_do(general, simple)):
        found = by_general()
        fewer = found.left <= NAMED and _things(found) <= HALF * _things(simple)  # what needs fewer causes is likelier
        if fewer and far_from_zero(found.model, symmetric, found.end):
            return found, notes
    if not explained and (
        far
        or alone
        or at_once
        or (
            not general.bench.late
            and reduced_chi2(*general.beside(simple.end, simple.split, most=simple.left)) < BETTER * simple.left
        )
    ):
        found = by_general()
        if alone or found.left < BETTER * simple.left:
            return found, notes
    tried = (
        "were not tried for want of time"
        if not explained and not at_once and general.bench.late
        else "explain the records no better"
    )
    note = f"{zeros_believed(believed)}: more constants {tried} (--no-believe-zeros takes them for unknown"
    return simple, (note + ("; then the records are explained without an effect, too)." if alone else ")."),)


def _beside_zeros(simplest: Begun, found: Diagnosis) -> tuple[bool, Callable[[], Diagnosis] | None]:
    """Whether what was found with general links stands, as with the zeros believed it leaves something, and so does one name more; and how to go
    on from it there, where it does."""
    bench, state = simplest.beside(found.end, found.split)
    left, (_, missing) = reduced_chi2(bench, state), one_more(bench, state)
    does = left <= NAMED or bool(missing)
    gone_on = partial(simplest.going_on, found, bench, state, missing) if does and found.added else None
    return left > CLOSE and not does, gone_on


def _fewer_do(general: Begun, simple: Diagnosis) -> bool:
    return len(simple.end.effects) > FEWER and reduced_chi2(*general.beside(simple.end, simple.split, FEWER)) <= NAMED


def _is_load(found: Diagnosis) -> bool:
    """Whether a load that nobody declared, of a few numbers, is all that makes the links others than declared: what else does the same
    with the zeros believed need not be looked for."""
    links = [one.deviation.name for one in found.off if one.deviation.name in OF_LINKS]
    return links == [Payload.name] and not found.added


def _things(found: Diagnosis) -> int:
    """How many causes a diagnosis names."""
    return len(found.end.effects) + len(found.off)
