"""Candidates of another size than the records promise to first order: larger, as strong as what was found, as small as is plausible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.effects.base import Effect
from ident.search.candidates import Candidate, side_of, units
from ident.search.trace import Linearised


def larger(one: Candidate, times: float) -> Candidate:
    """The candidate, its sizes so many times as large: what moves less for its own force promises less than it is."""
    values = [
        value * (1.0 if p.zero is None or p.aside else times)
        for value, p in zip(one.effect.values, one.effect.parameters, strict=True)
    ]
    return replace(one, effect=one.effect.with_values(values))


def as_strong(lin: Linearised, one: Candidate, found: Effect) -> Candidate:
    """The candidate, a force, as strong as another one of its port that was `found`: over the records, by the motions there."""
    motions = lin.motions[side_of(one.effect.port)]
    forces = [(one.effect.force(motion), found.force(motion)) for motion in motions]
    both = [(own, other) for own, other in forces if own is not None and other is not None]
    size = sum(float(np.vdot(own, own)) for own, _ in both)
    along = sum(float(np.vdot(own, other)) for own, other in both)
    return larger(one, along / size) if along > 0.0 else one


def smallest(lin: Linearised, kind: type[Effect], joint: int | None) -> Candidate:
    """An effect of this kind as small as is plausible, whatever it promises."""
    unit = units(lin, kind, joint)
    values = [u * min(p.sizes, key=abs) for p, u in zip(kind.parameters, unit, strict=True)]
    return Candidate(kind(joint, tuple(values)), 0.0, tuple(np.abs(values).tolist()))
