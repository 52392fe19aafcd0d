"""Impedances tried at plausible shapes, whatever they promise: what has bent the fitted arm far promises nothing from there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

from ident.effects.base import Effect, Parameter, only_impedance
from ident.search.candidates import Candidate, added, of_kinds, units
from ident.search.trace import Linearised

#: The least scale of a value.
TINY = 1e-12
#: Share of the least and largest plausible stiffness from where one is tried; and of one alone, and times as much.
STIFF = 0.5
#: Factors by which the frequency of what rings is another one than promises most: a sharp mode is found from within 4 % of it.
ELSEWHERE = tuple(1.04**k for k in range(-5, 6) if k)


def only_shapes(effect: Effect | type[Effect]) -> bool:
    """Whether all that an effect has are shapes: none of its numbers is a size, which is found from any start."""
    return bool(effect.parameters) and all(p.zero is None for p in effect.parameters)


def bending(lin: Linearised, taken: Sequence[Effect]) -> list[Candidate]:
    """The impedances of shapes alone at every joint, or of the arm, that are not `taken` yet, each from a few plausible shapes."""
    found = []
    for kind, joint in of_kinds(lin, lambda kind, _: only_shapes(kind), taken):
        unit = units(lin, kind, joint)
        options = [_plausible(p, u) for p, u in zip(kind.parameters, unit, strict=True)]
        effects = [kind(joint, values) for values in product(*options)]
        effects = [e for e in effects if only_impedance(e) and any(x is not None for x in added(lin, e))]
        found += [Candidate(e, 0.0, tuple(max(abs(v), TINY) for v in e.values)) for e in effects]
    return found


def ringing(one: Candidate) -> list[Candidate]:
    """The candidate at frequencies beside its own, if it has one: between lines a promise has peaks where there is no mode."""
    own = [k for k, p in enumerate(one.effect.parameters) if p.name == "frequency"]
    return [replace(one, effect=one.effect.with_value(k, by * one.effect.values[k])) for k in own for by in ELSEWHERE]


def _plausible(p: Parameter, unit: float) -> tuple[float, ...]:
    if p.whole:
        return p.sizes
    if p.relative == "K" and len(p.sizes) == 1:
        return STIFF * p.sizes[0] * unit, p.sizes[0] * unit, p.sizes[0] / STIFF * unit
    if p.relative == "K":
        return STIFF * min(p.sizes) * unit, STIFF * max(p.sizes) * unit
    return (p.sizes[0] * unit,)
