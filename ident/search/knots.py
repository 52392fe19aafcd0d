"""A learned curve that leaves something, with knots closer to each other where it bends, and another curve of its joint that so leaves less."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.arm.parts import degrees
from ident.effects.base import Effect
from ident.effects.learned import LearnedCurve, learned
from ident.records.campaign import Array
from ident.search.choice import Tried, is_curve, left_by
from ident.search.gains import FOR_EACH
from ident.search.minima import LEAST_GAIN, told
from ident.search.refits import CLOSE, FALLING, NAMED, Bench, Refit, State, fitted, reduced_chi2

#: Knots more that a curve is given at a time, and how often; share of what it bends most within a stretch that others must.
MORE_KNOTS, TIMES, BENDS = 8, 3, 0.1
#: Times what the best curve leaves beyond noise that another one of its joint may leave, whose knots may be too far apart.
AS_COARSE = 5.0


def drawn_closely(bench: Bench, best: Tried, tried: Sequence[Tried]) -> Tried:
    """The candidate, a curve that leaves anything with its knots closer where it bends; or another of those `tried` at its
    joint, if that leaves less then: what lies between the knots of one may fall on those of another."""
    if not _may_be_closer(bench, best.state):
        return best
    one = best.refitted(with_closer_knots(bench, best.state))
    dof = degrees(bench.split.select)
    most = dof + AS_COARSE * (left_by(best) - dof)
    joint = best.candidate.effect.joint
    drawn = (curve for curve in sorted(tried, key=left_by) if is_curve(curve) and curve.candidate.effect.joint == joint)
    other = next((curve for curve in drawn if _kind(curve) != _kind(best)), None)
    if (
        other is None
        or left_by(other) > most
        or not _may_be_closer(bench, other.state)
        or reduced_chi2(bench, one.state) <= NAMED
    ):
        return one
    state = with_closer_knots(bench, fitted(bench, Refit.of(other.state)))
    return other.refitted(state) if state.select < left_by(one) - LEAST_GAIN else one


def with_closer_knots(bench: Bench, state: State) -> State:
    """The model, its last effect, a curve that leaves something, with knots closer where it bends while these leave much less."""
    for _ in range(TIMES):
        curve = state.effects[-1]
        if not (isinstance(curve, LearnedCurve) and _may_be_closer(bench, state)):
            break
        closer = _closer(curve)
        more, old = len(closer.values) - len(curve.values), len(curve.values)
        new = fitted(bench, replace(
            Refit.of(state),
            vector=np.concatenate([state.minimum.vector[:-old], closer.values]),
            effects=(*state.effects[:-1], closer),
            scales=(*state.scales, *state.scales[-1:] * more),
            limits=(*state.limits, *state.limits[-1:] * more),
        ))  # fmt: skip
        bench.say(f"  with closer knots, {told(closer)}: {reduced_chi2(bench, new):.4g}")
        if new.select > min(state.select - max(LEAST_GAIN, FOR_EACH * more), _much_less(bench, state)):
            break
        state = new
    return state


def _kind(one: Tried) -> tuple[str, str]:
    """Port and variable of a curve."""
    effect = one.candidate.effect
    return effect.port, getattr(effect, "variable", "")


def _much_less(bench: Bench, state: State) -> float:
    """chi^2 on the choosing records that is much less than what a model leaves."""
    dof = degrees(bench.split.select)
    return dof + FALLING * (state.select - dof)


def _may_be_closer(bench: Bench, state: State) -> bool:
    """Whether the last effect of a model is a curve between whose knots what is left may lie."""
    curve = state.effects[-1]
    plain = isinstance(curve, LearnedCurve) and curve.period is None and len(curve.knots) > 2
    return plain and not bench.late and NAMED < reduced_chi2(bench, state) <= CLOSE**2


def _closer(curve: LearnedCurve) -> Effect:
    """The same curve with knots in the middle of those stretches at whose ends it bends most."""
    knots, heights = np.asarray(curve.knots), np.asarray(curve.values)
    wide = np.diff(knots)
    turns = np.abs(np.diff(np.diff(heights) / wide, prepend=np.nan, append=np.nan))
    turns = np.nan_to_num(turns)  # none at both ends
    bends = wide * np.maximum(turns[:-1], turns[1:])  # how far off a straight line may be
    order = np.argsort(-bends)[:MORE_KNOTS]
    chosen = order[bends[order] >= BENDS * bends.max()]
    all_knots: Array = np.sort(np.concatenate([knots, 0.5 * (knots[chosen] + knots[chosen + 1])]))
    kind = learned(curve.port, curve.variable, all_knots.tolist(), bends=curve.smooth)
    return kind(curve.joint, tuple(np.asarray(curve.height(all_knots), dtype=float).tolist()))
