"""A model that was chosen, at its minimum: from other places than where it was found, if these do better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.arm.coupled import DOUBTS
from ident.arm.parts import degrees, united
from ident.effects.base import Effect, has_forces, only_impedance, winds_up
from ident.effects.carried import Carrying
from ident.effects.creeping import FASTEST, FROM, SLOWEST, Creeping, creeping
from ident.effects.learned import Learned, bent
from ident.search.links_off import by_links, carrying_others, stiffnesses
from ident.search.own_records import by_own
from ident.search.refits import (
    BY_ALL,
    CLOSE,
    FAINTLY,
    FALLING,
    FINELY,
    FULLY,
    HASTILY,
    NAMED,
    Bench,
    Refit,
    State,
    all_fitted,
    as_declared,
    fitted,
    lowest,
    reduced_chi2,
    same,
    some,
    until_nothing,
    winding,
    with_last,
)

#: Fall of chi^2 on the records that chose it with which an effect, or another place, is no matter of noise.
LEAST_GAIN = 40.0
#: Sizes, of what it is, from where what forces is tried again.
ELSEWHERE = (0.7, 0.85, 1.1, 1.2, 1.35)
#: And stiffnesses from where an impedance that was chosen is fitted again.
VALLEY = (0.5, 0.75, 1.35, 2.0)
#: And from where beside the declared arm one of them is, if it still leaves something.
STIFFER = (3.0, 10.0, 30.0)

#: Fall of chi^2 that ends the last descent of all, where motions are not found anew: of a link that bends it went on for four.
WHOLLY = 1e-5
#: Times that weights are made anew at the end where a curve is part of a model: its heights would go on for long, for nothing.
BY_CURVE = 3
#: chi^2 per degree of freedom of a model that may be near where it would end, had its fit not held the motion: it has left up to 21.
LED_ASTRAY = 50.0
#: A force that follows from the motion is fitted on so many times, while chi^2 falls to less than this share.
PATIENT, STILL = 8, 0.9
#: Share of what a contact leaves that it may leave as it creeps from near where it is expected, for that to be sought farther off.
CREPT = 0.9
#: Times what a model leaves that it leaves, at most, where it comes back to where it was, from the declared arm; and, hastily fitted, where
#: that is led farther astray.
BACK, FARTHER = 1.05, 30.0


def fully(bench: Bench, state: State) -> State:
    """The model at its minimum: of an impedance, whose shapes may do nearly the same in more than one place, at the lowest."""
    last = state.effects[-1]
    if bench.late:
        return fitted(bench, Refit.of(state))
    if isinstance(last, Learned):  # heights of a curve mean nothing by themselves
        return _bending(bench, fitted(bench, replace(Refit.of(state), outer=FULLY)))
    # what a curve leaves, which it does not draw, is no valley
    by_curve = _drawn(state)
    if only_impedance(last) and len([p for p in last.parameters if p.zero is None]) > 2 and not by_curve:
        state = _in_lowest_valley(bench, state)
    state = _closely(bench, Refit.of(state), reduced_chi2(bench, state))
    if by_curve or bench.late or reduced_chi2(bench, state) <= NAMED:
        return state
    state = followed(bench, state)
    for more in (_doubted, carrying_others, crept):
        state = _closely_if_new(bench, state, more(bench, state))
    return state


def _in_lowest_valley(bench: Bench, state: State) -> State:
    """The model, whose last effect is an impedance of several shapes, from where these do best."""
    last = state.effects[-1]
    stiff = stiffnesses(last)
    if by_links(bench, state) and reduced_chi2(bench, found := carrying_others(bench, state)) <= NAMED:
        return found
    state = lowest(bench, [Refit.of(state), *_resized(state, last, stiff, VALLEY)])
    if by_links(bench, state):
        state = carrying_others(bench, state)
    if reduced_chi2(bench, state) > NAMED and not isinstance(state.effects[-1], Carrying):
        # springs behind each other may have changed places
        declared = replace(state, minimum=replace(state.minimum, vector=as_declared(bench, state)))
        starts = [Refit.of(declared), *(one for k in stiff for one in _resized(declared, last, [k], STIFFER))]
        state = min(state, lowest(bench, starts), key=lambda other: other.minimum.chi2)
    return state


def _closely_if_new(bench: Bench, state: State, new: State) -> State:
    """The model, or what it became, at its minimum."""
    return state if new is state else _closely(bench, Refit.of(new), reduced_chi2(bench, new))


def followed(bench: Bench, state: State) -> State:
    """The model, or one where forces that wind a spring up are fitted with motions that follow them, if that leaves less: a fit that holds
    them may be led away from where it would end. Where that hardly helps hastily it is not done finely."""
    dry = any(effect.dry for effect in state.effects)
    if dry or state.followed or not winding(state.effects) or not NAMED < reduced_chi2(bench, state) <= LED_ASTRAY:
        return state
    new = fitted(bench, replace(Refit.of(state), roughly=HASTILY, followed=True))
    if not new.select < FALLING * state.select:
        return state
    new = fitted(bench, replace(Refit.of(new), roughly=FAINTLY))
    bench.say(f"  its motion followed, {told(new.effects[-1])}: {reduced_chi2(bench, new):.4g}")
    return new if new.select < state.select else state


def _doubted(bench: Bench, state: State) -> State:
    """The model, or one found while it was doubted, if that leaves much less: a constant whose resonance has to pass one of the lowest
    lines, as that of gravity may, is held by this line alone otherwise."""
    if reduced_chi2(bench, state) > BY_ALL:  # more is missing
        return state
    new = fitted(bench, replace(Refit.of(state), outer=1, roughly=HASTILY, doubts=DOUBTS[-1:]))
    return new if new.select < FALLING * state.select else state


def _bending(bench: Bench, state: State) -> State:
    """The model, or one whose last effect, a learned curve, bends between its knots, if that leaves less."""
    curve = bent(state.effects[-1])
    if curve is None or reduced_chi2(bench, state) <= NAMED:
        return state
    new = fitted(bench, replace(Refit.of(state), effects=(*state.effects[:-1], curve), outer=FULLY))
    return new if new.select < state.select - LEAST_GAIN else state


def crept(bench: Bench, state: State) -> State:
    """The model, or one whose dry last effect creeps more or less than contacts are expected to, if that leaves less; fitted on where
    chi^2 still falls."""
    last = state.effects[-1]
    if not last.dry or isinstance(last, Creeping | Learned) or reduced_chi2(bench, state) <= NAMED:
        return state
    here = by_own(bench, state)
    if reduced_chi2(bench, here) <= (CLOSE**2 if reduced_chi2(bench, state) > CLOSE**2 else NAMED):
        return here
    near = until_nothing(bench, [creeping_like(min(here, state, key=lambda one: one.select), FROM[0])])
    dof = degrees(bench.split.select)

    def helps(new: State) -> bool:  # else more is missing, which that would be bent to
        return new.select - dof < CREPT * (here.select - dof) or reduced_chi2(bench, here) <= CLOSE

    best = min([here, *near], key=lambda other: other.select)
    if reduced_chi2(bench, best) > NAMED and helps(best):
        near += until_nothing(bench, [creeping_like(state, decades) for decades in FROM[1:]])
    best = min(near, key=lambda other: other.select, default=here)
    if best.select < here.select - LEAST_GAIN and helps(best):
        return best
    return here if here.select < FALLING * state.select else state


def creeping_like(state: State, decades: float) -> Refit:
    """The model, to be refitted hastily, whose dry last effect creeps faster by so many decades at first."""
    effects = (*state.effects[:-1], creeping(state.effects[-1], decades))
    scales, limits = (*state.scales, 1.0), (*state.limits, (SLOWEST, FASTEST))
    return Refit(np.append(state.minimum.vector, decades), effects, scales, limits, 1, HASTILY)


def _closely(bench: Bench, refit: Refit, left: float) -> State:
    """The model at its minimum; not so closely where it leaves far more than noise, before, `left`, and once that no longer falls."""
    while left > BY_ALL:
        state = fitted(bench, refit)
        before, left = left, reduced_chi2(bench, state)
        if left >= max(BY_ALL, FALLING * before):
            return state
        refit = Refit.of(state)
    return fitted(bench, replace(refit, outer=FULLY, roughly=FAINTLY))


def settled(bench: Bench, state: State) -> State:
    """The model, once it is chosen, by the records that chose it, too: these tell its values as well as those that fitted it."""
    if bench.late or reduced_chi2(bench, state) > BY_ALL:
        return state
    both = replace(bench, split=replace(bench.split, fit=united(*bench.split.fit, *bench.split.select)))
    outer = BY_CURVE if _drawn(state) else FULLY
    roughly = FAINTLY if any(map(has_forces, state.effects)) else WHOLLY
    new = fitted(both, replace(Refit.of(state), outer=outer, roughly=roughly))
    return replace(new, select=state.select) if new.select < state.select + LEAST_GAIN else state


def _drawn(state: State) -> bool:
    """Whether a learned curve is part of a model."""
    return any(isinstance(effect, Learned) for effect in state.effects)


def afresh(bench: Bench, state: State) -> State:
    """The model, or a better one fitted from the declared arm, at once or by a detour: what was missing has led this one far astray."""
    here, declared = Refit.of(state), replace(Refit.of(state), vector=as_declared(bench, state))
    hastily = fitted(bench, replace(here, roughly=HASTILY))
    finely = state if state.roughly >= FINELY else None  # what is told by fewer samples may leave more
    for doubts in ((), DOUBTS):
        other = fitted(bench, replace(declared, roughly=HASTILY, doubts=doubts))
        if _as_much(hastily, other):
            break
        if other.select > FARTHER * hastily.select:
            continue
        other = fitted(bench, Refit.of(other))
        finely = finely or fitted(bench, here)
        back = _as_much(finely, other)
        if not back and other.select < CLOSE * finely.select:
            other = _closely(bench, Refit.of(other), min(reduced_chi2(bench, other), reduced_chi2(bench, state)))
        if other.select < state.select:
            bench.say(f"  from the declared arm again: {reduced_chi2(bench, other):.4g}")
            state = other
        if back or reduced_chi2(bench, state) <= NAMED or bench.late:
            break
    return links_anew(bench, state)


def links_anew(bench: Bench, state: State) -> State:
    """The model, or a better one with what its effects carry told anew: others were missing beside them."""
    for k, effect in enumerate(state.effects):
        order = with_last(state, k)
        if reduced_chi2(bench, state) <= NAMED or bench.late:
            break
        if isinstance(effect, Carrying) or (order[k] != k and effect.carries):
            last = fitted(bench, some(state, order))
            new = carrying_others(bench, last)
            if new is not last:
                new = _closely(bench, some(new, np.argsort(order).tolist()), reduced_chi2(bench, new))
                if new.select < state.select:
                    bench.say(f"  links anew, {told(new.effects[k])}: {reduced_chi2(bench, new):.4g}")
                    state = new
    return state


def _as_much(state: State, other: State) -> bool:
    """Whether two models, fitted alike, leave nearly the same."""
    return state.select / BACK < other.select < BACK * state.select


def wound_up(bench: Bench, state: State) -> State:
    """The model, fitted on while chi^2 falls where a force follows from the motion: each of both leads to the other by little."""
    if not winds_up(state.effects[-1]):
        return state
    for _ in range(PATIENT):
        if bench.late or reduced_chi2(bench, state) <= NAMED:
            break
        new = fitted(bench, replace(Refit.of(state), outer=FULLY // 2))
        bench.say(f"  on, {told(new.effects[-1])}: {reduced_chi2(bench, new):.4g}")
        fell = new.minimum.chi2 < STILL * state.minimum.chi2
        state = new if fell else state
        if not fell:
            break
    return state


def _resized(state: State, effect: Effect, which: Sequence[int], factors: Sequence[float]) -> list[Refit]:
    """The model from where these values of one of its effects are so many times as large."""
    place = next(k for k, e in enumerate(state.effects) if same(e, effect))
    first = state.problem.base + sum(len(e.values) for e in state.effects[:place])
    refits = []
    for factor in factors:
        vector = state.minimum.vector.copy()
        vector[[first + k for k in which]] *= factor
        refits.append(replace(Refit.of(state), vector=np.clip(vector, state.problem.low, state.problem.high)))
    return refits


def elsewhere(bench: Bench, state: State, effect: Effect) -> State:
    """The model, or a better one that lies where a force of `effect` is some other size: what moves so that a force
    follows has more than one way to."""
    sizes = [k for k, p in enumerate(effect.parameters) if p.zero is not None and not p.whole and effect.values[k]]
    if not winds_up(effect) or effect.name == "unknown" or not sizes:
        return state
    refits = [Refit.of(state), *_resized(state, effect, sizes, ELSEWHERE)]
    here, *others = all_fitted(bench, [replace(one, outer=1, roughly=HASTILY) for one in refits])
    best = min(others, key=lambda other: other.select)
    if bench.late or best.select > here.select - max(LEAST_GAIN, 0.1 * (here.select - degrees(bench.split.select))):
        return state
    best = fully(bench, best)
    bench.say(f"  elsewhere, {told(next(e for e in best.effects if same(e, effect)))}: {reduced_chi2(bench, best):.4g}")
    return best if best.select < state.select else state


def told(effect: Effect) -> str:
    place = "" if effect.joint is None else f" at joint {effect.joint + 1}"
    if isinstance(effect, Learned):
        again = "" if effect.period is None else f", again every {effect.period:.4g} rad"
        return f"{effect.name}{place}: {effect.variable} at the {effect.port}{again}"
    return f"{effect.name}{place} {[float(f'{v:.4g}') for v in effect.values][:4]}"
