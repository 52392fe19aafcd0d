"""What sticks before it slips: with its stops closer to each other where they carry most, once it is known where that is."""

from __future__ import annotations

import numpy as np

from ident.effects.memory import PRESLIDING, Remembering, remembering
from ident.search.candidates import Candidate
from ident.search.gains import FOR_EACH
from ident.search.minima import LEAST_GAIN, told
from ident.search.refits import Bench, Refit, State, but_last, fitted, reduced_chi2, standing
from ident.search.tried import with_candidate

#: Share of the largest height from which a stop carries something; parts of the way from it to the next.
CARRIES, PARTS = 0.1, 4


def with_closer_stops(bench: Bench, state: State) -> State:
    """The model, its last effect, where that is a sum of stops which leaves anything, with more stops about those that carry
    something, and fewer elsewhere, if these leave less."""
    curve = state.effects[-1]
    if not (isinstance(curve, Remembering) and curve.variable == PRESLIDING) or bench.late:
        return state
    if reduced_chi2(bench, state) <= 1.0:
        return state
    plain, lin = standing(bench, state, but_last(state))
    effect = _closer(curve)
    size = max(map(abs, effect.values))
    candidate = Candidate(effect, 0.0, (size,) * len(effect.values))
    new = fitted(bench, Refit.of(fitted(bench, with_candidate(plain, candidate, lin))))
    more = max(len(effect.values) - len(curve.values), 0)
    if new.select > state.select - max(LEAST_GAIN, FOR_EACH * more):
        return state
    bench.say(f"  with closer stops, {told(new.effects[-1])}: {reduced_chi2(bench, new):.4g}")
    return new


def _closer(curve: Remembering) -> Remembering:
    """The same law with those stops that carry something, their neighbours and, between these, some more of no height yet."""
    sharp = len(curve.knots) - curve.soft
    r, heights = np.array(curve.knots[:sharp]), np.array(curve.values[:sharp])
    carries = np.abs(heights) > CARRIES * np.abs(heights).max()
    beside = np.convolve(carries, np.ones(3), "same") > 0.0
    at = {float(x): float(h) for x, h, near in zip(r, heights, beside, strict=True) if near}
    for k in np.flatnonzero(carries[:-1] | carries[1:]):
        for part in range(1, PARTS):
            at.setdefault(float(r[k] ** (1 - part / PARTS) * r[k + 1] ** (part / PARTS)), 0.0)
    knots = [*sorted(at), *curve.knots[sharp:]]
    values = [*(at[x] for x in sorted(at)), *curve.values[sharp:]]
    kind = remembering(curve.variable, curve.port, knots, curve.soft)
    return kind(curve.joint, tuple(values))  # type: ignore[return-value]
