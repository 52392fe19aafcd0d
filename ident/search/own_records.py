"""A model fitted from what the records that move a joint alone tell of the effect there.

In the others the joint is held, and hardly slides or winds up: what it does then hangs on all else, and a fit of all records at once
that holds motions is led by them to where these are other ones.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.search.refits import HASTILY, Bench, Refit, State, fitted, own_records, reduced_chi2

#: Times that motions are found anew, and for the arm beside an effect that is kept.
ANEW, BESIDE = 4, 2


def by_own(bench: Bench, state: State, near: float = np.inf) -> State:
    """The model fitted hastily from its last effect as the records that move its joint have it, and, if that rubs, the arm that fits it
    as it is then: what holds a joint, or hardly slides, leads both astray. With motions that follow what winds up; as it is where those
    records leave more than `near` noise powers. By all records where none move its joint."""
    last, winds = state.effects[-1], not state.effects[-1].dry
    refit = replace(Refit.of(state), outer=ANEW, roughly=HASTILY, followed=winds)
    if all(own_records(part, last) for part in (bench.split.fit, bench.split.select)):
        own = fitted(bench, replace(refit, own=True))
        if reduced_chi2(bench, own) > near:
            return state
        refit = replace(refit, vector=np.concatenate([refit.vector[: -len(last.values)], own.effects[-1].values]))
        if not winds:
            arm = fitted(bench, replace(refit, outer=BESIDE, kept=True)).minimum
            refit = replace(refit, vector=arm.vector, slid=arm.slid)
    return replace(fitted(bench, refit), followed=False)
