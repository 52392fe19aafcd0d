"""How sure the numbers of a model are: less than noise alone would have it, where more than noise is left of the records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ident.arm.coupled import uncertainty
from ident.arm.parts import Split, degrees
from ident.records.campaign import Array
from ident.search.added import Added
from ident.search.contradicted import Off, standard_deviations
from ident.search.refits import NAMED, State, same


def spread(split: Split, state: State) -> tuple[Array, Array, Array]:
    """Covariance of alpha, directions of it that no record shows, standard deviations of all parameters, see `uncertainty`."""
    covariance, unseen, std = _by_noise(state)
    times = scatter(split, state)
    return times**2 * covariance, unseen, times * std


@lru_cache(maxsize=2)  # both documents ask for that of the last model
def _by_noise(state: State) -> tuple[Array, Array, Array]:
    return uncertainty(state.problem, state.minimum)


def scatter(split: Split, state: State) -> float:
    """What standard deviations grow by where a model leaves more than noise, the root of chi^2 per degree of freedom; 1 where it does not
    (R. T. Birge, DOI 10.1103/PhysRev.40.207)."""
    dof = degrees(max(state.problem.data, split.fit, key=degrees))  # chi^2 is as all of their lines would have it
    level = state.minimum.chi2 / dof
    return float(np.sqrt(level)) if level > NAMED else 1.0


def as_found(split: Split, state: State, added: Sequence[Added], off: Sequence[Off]) -> tuple[Added, ...]:
    """The entries of the effects that a model has, in the order in which they were added, as they are in it."""
    times = scatter(split, state)
    return tuple(
        replace(a, effect=e, std=tuple(times * std for std in standard_deviations(state, e, off)))
        for a in added
        for e in state.effects
        if same(a.effect, e)
    )
