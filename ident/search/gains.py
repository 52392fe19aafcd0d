"""A frequency response: with as many knots as it needs, and names in its place, two of which it can play alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.arm.parts import degrees
from ident.effects.base import Effect, overrides
from ident.effects.response import Response, response
from ident.search.candidates import Candidate, best_of, of_kinds
from ident.search.choice import ALIKE, DOUBT, TIE, Tried, left_by
from ident.search.curves import knots_of_frequency, scales_of_response
from ident.search.minima import LEAST_GAIN, fully, told
from ident.search.refits import Bench, Refit, State, all_fitted, but_last, linearised, reduced_chi2, standing
from ident.search.trace import Linearised
from ident.search.tried import refitted, with_candidate
from symgen.forked import forked

#: What makes an effect a gain of its joint.
GAINS = ("torque_gain", "angle_gain")
#: Noise powers by which two names may leave more than the response, of many knots.
AS_LITTLE = 0.02
#: Knots more that a response is given at a time, and at most; by how much chi^2 falls for each of its numbers more.
MORE_KNOTS, MOST_KNOTS, FOR_EACH = 8, 33, 4.0


def resolved(bench: Bench, state: State) -> State:
    """The model, its last effect, where that is a frequency response which leaves little, with more knots if these leave less: what a few
    promise where all is missing does not tell how many it needs. At the torque where that leaves hardly more than at the angle."""
    curve, dof = state.effects[-1], degrees(bench.split.select)
    ports: tuple[str, ...] = ("motor", "sensor")
    while isinstance(curve, Response) and len(curve.knots) < MOST_KNOTS and not bench.late:
        if reduced_chi2(bench, state) <= 1.0:
            break
        plain, lin = standing(bench, state, but_last(state))
        drawn = [_with_more_knots(lin, curve, port) for port in ports]
        hastily = all_fitted(bench, [with_candidate(plain, one, lin) for one in drawn])
        finely = list(all_fitted(bench, [Refit.of(one) for one in hastily]))
        least = min(one.select for one in finely)
        best = next(one for one in finely if one.select <= least + TIE + DOUBT * dof)
        more = len(best.scales) - len(state.scales)
        if best.select > state.select - max(LEAST_GAIN, FOR_EACH * more):
            break
        state, curve = best, best.effects[-1]
        bench.say(f"  with more knots, {told(curve)}: {reduced_chi2(bench, state):.4g}")
        ports = (curve.port,)
    return state


def _with_more_knots(lin: Linearised, curve: Response, port: str) -> Candidate:
    """The same response, of a joint's torque or angle, through more knots."""
    assert curve.joint is not None
    knots = knots_of_frequency(lin, curve.joint, len(curve.knots) + MORE_KNOTS)
    gains, delays = curve.at_frequencies(knots)
    effect = response(port, knots.tolist())(curve.joint, (*np.log(gains[1:] / gains[0]).tolist(), *delays.tolist()))
    return Candidate(effect, 0.0, scales_of_response(effect))


def named_gains(bench: Bench, state: State) -> State | None:
    """The model with two named gains of a joint in the place of its last effect, a frequency response, and of all other gains
    there, if they leave as little; None if they do not."""
    curve = state.effects[-1]
    if not isinstance(curve, Response):
        return None
    others = [k for k, e in enumerate(state.effects) if e.joint != curve.joint or not overrides(e, *GAINS)]
    plain, lin = standing(bench, state, others)
    tried: list[Tried] = []
    for _, lead in refitted(bench, plain, _likely(bench, lin, curve.joint, ())):
        there = linearised(lead.problem, lead.minimum.vector)
        # both ways round: beside one that does the work of both, the other may promise nothing
        tried += refitted(bench, lead, _likely(bench, there, curve.joint, lead.effects))
    if not tried:
        return None
    best = fully(bench, min(tried, key=left_by).state)
    dof = degrees(bench.split.select)
    limit = state.select + max(LEAST_GAIN, ALIKE * (state.select - dof), AS_LITTLE * dof)
    bench.say(
        f"  instead of {told(curve)}, {' and '.join(told(e) for e in best.effects[-2:])}: {reduced_chi2(bench, best):.4g}"
    )
    return best if best.select <= limit else None


def _likely(
    bench: Bench, lin: Linearised, joint: int | None, taken: Sequence[Effect]
) -> list[tuple[Candidate, Linearised]]:
    """Every gain of the catalogue at a joint that is not `taken`, as it fits best to first order."""
    kinds = of_kinds(lin, lambda kind, there: there == joint and overrides(kind, *GAINS), taken)
    lin.prepare()
    found = forked(lambda one: best_of(lin, *one), kinds, bench.workers)
    return [(c, lin) for c in found if c is not None]
