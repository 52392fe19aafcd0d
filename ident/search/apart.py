"""An effect of the whole arm that is one of some of its joints, each on its own: two that lag alike look like an arm that does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.search.added import Added
from ident.search.minima import LEAST_GAIN, told
from ident.search.refits import HASTILY, NAMED, Bench, Refit, State, but_last, fitted, reduced_chi2, some, without

#: Share of what the arm's effect leaves that those of its joints may leave.
FAR_LESS = 0.5


def apart(bench: Bench, state: State, added: list[Added]) -> tuple[State, list[Added]]:
    """The model with effects of single joints in the place of its last one, that of the whole arm, where that leaves something and they
    far less, and not every joint needs its own."""
    entry, whole = added[-1], state.effects[-1]
    of_joints = "joint" in whole.scope and not any(e.name == whole.name for e in state.effects[:-1])
    if whole.joint is not None or not of_joints or reduced_chi2(bench, state) <= NAMED or bench.late:
        return state, added
    best = fitted(bench, Refit.of(fitted(bench, _of_each(bench, state))))
    others = len(state.effects) - 1
    for effect in best.effects[others:]:
        less = without(bench, best, effect)
        best = less if less.select < best.select + LEAST_GAIN else best
    found = best.effects[others:]
    if not 0 < len(found) < bench.model.chain.n or reduced_chi2(bench, best) > FAR_LESS * reduced_chi2(bench, state):
        return state, added
    bench.say(f"  of single joints, {' and '.join(map(told, found))}: {reduced_chi2(bench, best):.4g}")
    return best, [*added[:-1], *(replace(entry, effect=effect, tied=(), others=()) for effect in found)]


def _of_each(bench: Bench, state: State) -> Refit:
    """The model with the last effect at every joint instead of at the whole arm, to be refitted hastily."""
    refit, whole, n = some(state, but_last(state)), state.effects[-1], bench.model.chain.n
    size = len(whole.values)
    return replace(
        refit, vector=np.concatenate([refit.vector, *[whole.values] * n]), roughly=HASTILY,
        effects=(*refit.effects, *(type(whole)(joint, whole.values) for joint in range(n))),
        scales=refit.scales + state.scales[-size:] * n, limits=refit.limits + state.limits[-size:] * n,
    )  # fmt: skip
