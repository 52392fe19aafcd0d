"""Candidates that were hastily refitted, fitted finely."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.arm.parts import degrees
from ident.search.choice import Tried, ended_there, is_curve, left_by, with_model
from ident.search.minima import told
from ident.search.refits import CLOSE, FALLING, FINELY, Bench, Refit, State, all_fitted, fitted, reduced_chi2

#: Share of what any other candidate leaves that one leaves which may be far ahead once it is fitted finely: nothing else is tried then.
#: Below the first one it is far ahead already.
LEADING, FORWARD = 0.1, 0.5
#: Times what the best curve leaves, hastily fitted, that one of dry friction may leave to do better finely fitted: in haste the motion
#: that friction leaves is hardly found.
AS_DRY = 2.0
#: While none of the candidates is near, those whose chi^2 is `FALLING` go on so many times.
PATIENCE = 4


def curve_finely(bench: Bench, tried: Sequence[Tried]) -> list[Tried]:
    """The candidates, a curve that leaves least of all fitted finely: it may be so far ahead that few names need be. Where it stays far
    from the noise, dry friction of its port, too, whose motion is not found in haste."""
    best = min(tried, key=left_by, default=None)
    if best is None or not is_curve(best) or reduced_chi2(bench, best.state) <= CLOSE**2:
        return list(tried)
    tried = with_finer(bench, tried, best)
    place = best.candidate.key[1:]
    dry = [
        one
        for one in tried
        if one.candidate.effect.dry and one.candidate.key[1:] == place and one.state.roughly > FINELY
    ]
    for one in curves_alike(dry):
        if bench.late or min(reduced_chi2(bench, state) for _, state in tried) <= CLOSE**2:
            break
        tried = with_finer(bench, tried, one)
    return tried


def curves_alike(tried: Sequence[Tried]) -> list[Tried]:
    """The best of the curves, and those of dry friction that leave hardly more, best first: in haste these are not told apart."""
    drawn = sorted((one for one in tried if is_curve(one)), key=left_by)
    return drawn[:1] + [
        one for one in drawn[1:] if one.candidate.effect.dry and left_by(one) <= AS_DRY * left_by(drawn[0])
    ]


def leader_finely(bench: Bench, tried: list[Tried], earlier: Sequence[Tried] = ()) -> list[Tried]:
    """The candidates, the best fitted finely if it leads already, unless that ended `earlier` where it is: it may be far ahead, and nothing
    else need be tried."""
    best = min(tried, key=left_by, default=None)
    others = [left_by(one) for one in tried if best is not None and one.candidate.key != best.candidate.key]
    if best is None or not others or not LEADING < left_by(best) / min(others) < FORWARD:
        return tried
    if reduced_chi2(bench, best.state) <= CLOSE**2 or any(ended_there(one, best) for one in earlier):
        return tried
    return with_finer(bench, tried, best)


def with_finer(bench: Bench, tried: Sequence[Tried], best: Tried) -> list[Tried]:
    """The candidates, one of them fitted finely."""
    return with_model(tried, best, finer(bench, best.state))


def finer(bench: Bench, state: State) -> State:
    """The same model, fitted finely."""
    state = fitted(bench, Refit.of(state))
    bench.say(f"  finely, {told(state.effects[-1])}: {reduced_chi2(bench, state):.4g}")
    return state


def finely(bench: Bench, tried: Sequence[Tried]) -> list[Tried]:
    """Candidates fitted finely that are not yet; while no name is near the noise, those whose chi^2 falls much again and again."""
    near = CLOSE**2 * degrees(bench.split.select)
    settled = [one for one in tried if one.state.roughly <= FINELY]
    falling = [one for one in tried if one.state.roughly > FINELY]
    for _ in range(1 + PATIENCE):
        before = list(map(left_by, falling))
        new = all_fitted(bench, [Refit.of(state) for _, state in falling])
        finer = [
            one if bench.late and np.isinf(state.select) else one.refitted(state)
            for one, state in zip(falling, new, strict=True)
        ]
        for _, state in finer:
            bench.say(f"  finely, {told(state.effects[-1])}: {reduced_chi2(bench, state):.4g}")
        best = min(settled + finer, key=left_by)
        falling = []
        for one, was in zip(finer, before, strict=True):
            fell = left_by(one) / was
            if left_by(best) <= near:  # only a name that is on its way to where a curve is: it may be what that plays
                goes_on = is_curve(best) and not is_curve(one) and fell * left_by(one) < left_by(best)
            else:
                goes_on = fell < FALLING
            (falling if goes_on else settled).append(one)
        if not falling or bench.late:
            break
    return settled + falling
