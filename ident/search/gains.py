"""Names in the place of a frequency response: what a drive or an encoder does is often two of them, which it can play alone."""

from __future__ import annotations

from collections.abc import Sequence

from ident.arm.parts import degrees
from ident.effects.base import Effect, overrides
from ident.effects.response import Response
from ident.search.candidates import Candidate, best_of, of_kinds
from ident.search.choice import ALIKE, Tried, left_by
from ident.search.minima import LEAST_GAIN, fully, told
from ident.search.refits import Bench, State, linearised, reduced_chi2, standing
from ident.search.trace import Linearised
from ident.search.tried import refitted
from symgen.forked import forked

#: What makes an effect a gain of its joint.
GAINS = ("torque_gain", "angle_gain")
#: Noise powers by which two names may leave more than the response, of many knots.
AS_LITTLE = 0.02


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
