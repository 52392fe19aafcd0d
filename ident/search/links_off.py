"""What gives in the structure, found to carry links that are not the declared ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.arm.parts import degrees
from ident.arm.scene import known
from ident.effects.base import Effect
from ident.effects.carried import FARTHEST, Carrying, carrying, of_declared_links, shown
from ident.records.campaign import Array
from ident.search.refits import (
    BY_ALL,
    FALLING,
    HASTILY,
    NAMED,
    Bench,
    Refit,
    State,
    as_declared,
    fitted,
    lowest,
    reduced_chi2,
    until_nothing,
)

#: Lines at which an effect shows what it carries; share of what it leaves with declared links that it may leave with others.
SHOWN_AT, MUCH_LESS = 8, 0.5
#: Times that it is told by how much links are off.
TOLD_ANEW = 3
#: Times as stiff, or as fast, from where it is fitted again once links may be off.
HALF_OR_TWICE = (0.5, 2.0)
#: Valleys whose bottoms are looked at.
VALLEYS = 3
#: Times the least of its stiffnesses that the others are tried at, and of a usual frequency that its own is.
STIFFER_THAN, OF_USUAL = (1.0, 4.0), (0.6, 1.0)


def by_links(bench: Bench, state: State) -> bool:
    """Whether the last effect carries the declared links and leaves so much that these may be others: nothing is the lowest then."""
    last = state.effects[-1]
    return last.carries and not isinstance(last, Carrying) and reduced_chi2(bench, state) > BY_ALL


def carrying_others(bench: Bench, state: State) -> State:
    """The model, or one whose last effect carries links that are not the declared ones, if that leaves much less: by how much they
    are off, told anew while that shows in other ways where the effect is then."""
    for _ in range(TOLD_ANEW):
        new = _carrying_as_shown(bench, state)
        if new is state or bench.late or reduced_chi2(bench, new) <= NAMED:
            return new
        state = new
    return state


def hastily_carrying_others(bench: Bench, state: State) -> State:
    """As `carrying_others`, hastily and from where the model is: it, if more is missing than that."""
    refit = _with_links_off(bench, state) if by_links(bench, state) else None
    new = state if refit is None else fitted(bench, replace(refit, outer=1, roughly=HASTILY))
    return new if reduced_chi2(bench, new) <= NAMED else state


def _with_links_off(bench: Bench, state: State) -> Refit | None:
    """The model, to be refitted with links that may be off in the ways that the last effect shows where it is, at its softest, as they were
    declared at first. None where it carries none."""
    last = of_declared_links(state.effects[-1])
    if not last.carries or not np.isfinite(state.select):
        return None
    p = state.problem.parameters(state.minimum.vector)
    scenes = [state.problem.scene(one, state.effects) for one in state.problem.data]
    arms = [known(scene, p) for scene in scenes]
    s = scenes[0].s[np.linspace(0, len(scenes[0].s) - 1, SHOWN_AT).astype(int)]
    effect = carrying(last, shown(_soft(last), s, arms, bool(bench.model.factoring.believed)))
    more, kept = len(effect.values) - len(last.values), sum(len(e.values) for e in (*state.effects[:-1], last))
    vector = np.concatenate([state.minimum.vector[: state.problem.base + kept], np.zeros(more)])
    scales, limits = state.scales[:kept] + (1.0,) * more, state.limits[:kept] + ((-FARTHEST, FARTHEST),) * more
    return Refit(vector, (*state.effects[:-1], effect), scales, limits)


def _carrying_as_shown(bench: Bench, state: State) -> State:
    """As `carrying_others`, in the ways that the last effect shows where it is."""
    refit = _with_links_off(bench, state)
    if refit is None:
        return state
    declared, base = as_declared(bench, state), state.problem.base
    kept = len(refit.vector) - sum(p.aside for p in refit.effects[-1].parameters)
    starts = [replace(refit, vector=np.concatenate([declared[:kept], refit.vector[kept:]])), refit]
    new = lowest(bench, starts)
    if NAMED < reduced_chi2(bench, new) < FALLING * reduced_chi2(bench, state):
        anew = [replace(refit, vector=np.concatenate([declared[:base], values])) for values in _plausible(new)]
        others = [replace(one, outer=1, roughly=HASTILY) for one in [Refit.of(new), *anew]]
        for other in sorted(until_nothing(bench, others), key=lambda other: other.select)[:VALLEYS]:
            new = min(new, fitted(bench, Refit.of(other)), key=lambda one: one.select)
            if reduced_chi2(bench, new) <= NAMED:
                break
    dof = degrees(bench.split.select)
    if new.select - dof > MUCH_LESS * (state.select - dof):
        return state
    return new


def _plausible(state: State) -> list[Array]:
    """The values of all effects, those of the last, which carries links, anew: stiffnesses half and twice, or of several the stiffer
    ones as the least and a few times that, frequencies as is usual; links as declared. None of what has no stiffness."""
    last = state.effects[-1]
    before = [value for effect in state.effects[:-1] for value in effect.values]
    values = np.where([p.aside for p in last.parameters], 0.0, last.values)
    own = [k for k, p in enumerate(last.parameters) if p.unit == "Hz"]
    usual = np.array([last.parameters[k].sizes[0] for k in own])
    stiff = np.array(stiffnesses(last), dtype=int)
    if not len(stiff):
        return []
    least = values[stiff].min()
    if len(stiff) > 1:
        resized, factors = stiff[values[stiff] > least], STIFFER_THAN
    else:
        resized, factors = stiff, HALF_OR_TWICE
    found = []
    for factor in factors:
        for share in OF_USUAL if own else (1.0,):
            anew = values.copy()
            anew[resized] = factor * least
            anew[own] = share * usual
            found.append(np.concatenate([before, anew]))
    return found


def _soft(effect: Effect) -> Effect:
    """The effect with all its stiffnesses as its least: one that was found too stiff would not show what it carries."""
    stiff = stiffnesses(effect)
    values = np.array(effect.values)
    values[stiff] = values[stiff].min(initial=np.inf)
    return effect.with_values(values.tolist())


def stiffnesses(effect: Effect) -> list[int]:
    """Which values of an effect are stiffnesses of what gives."""
    return [k for k, p in enumerate(effect.parameters) if p.relative == "K" and p.zero is None]
