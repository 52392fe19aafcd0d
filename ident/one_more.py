"""What one name more does: where it leaves nothing but noise, that is what is missing, and little else need be tried."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ident.candidates import catalogue
from ident.choice import CURVE_SHARE, Tried, best_names, left_by
from ident.effects.base import Effect, only_shares
from ident.finer import finer
from ident.parts import degrees
from ident.refits import BY_ALL, CLOSE, NAMED, Bench, State, excess, linearised
from ident.trace import Linearised
from ident.tried import refitted

#: Names tried, and share of what is left that each must promise; share of it that the best may leave.
TRIED, PROMISED, MUCH = 3, 0.1, 0.3
#: Times what the best leaves that another may leave to be fitted finely, too.
NEAR = 2.0
#: Share of what there was that a name may leave beside which another one does, and of what names of other places leave.
HALF, LEADS = 0.5, 0.8


def beyond_noise(state: State, lin: Linearised) -> float:
    """chi^2 beyond noise on the records that fit."""
    return max(lin.chi2 - degrees(state.problem.data), 1.0)


def one_more(bench: Bench, state: State, progress: Callable[[str], None]) -> list[Tried]:
    """The names tried beyond a model, one of which leaves hardly anything where there is much: the model is not far astray then, but that
    is missing. None if none does."""
    if bench.late or excess(bench, state) <= CLOSE:
        return []
    most = min(NAMED + CURVE_SHARE * (excess(bench, state) - NAMED), CLOSE)
    return _one_more(bench, state, most, lambda effect: True, progress)


def leading_to_one_more(
    bench: Bench, state: State, tried: Sequence[Tried], progress: Callable[[str], None]
) -> tuple[State, list[Tried]] | None:
    """The model with the best of the names `tried` beyond `state`, if it leads and one more leaves nothing but noise; and the names tried
    beyond that. What has no name acts at one joint and from the first record to the last: the two do not take its place if they are of
    different joints, or one of them alone changes from record to record."""
    order = best_names(tried)
    if bench.late or not order or excess(bench, state) <= BY_ALL:
        return None
    (candidate, best), place = order[0], _place(order[0][0].effect)
    others = [left_by(one) for one in order[1:] if _place(one[0].effect) != place]
    leads = left_by(order[0]) < min([HALF * state.select, *(LEADS * left for left in others)])
    if not leads or candidate.effect.joint is None or excess(bench, best) <= CLOSE:
        return None

    def no_one_law(effect: Effect) -> bool:
        elsewhere = effect.joint not in (None, candidate.effect.joint)
        return elsewhere or only_shares(effect) != only_shares(candidate.effect)

    lead = finer(bench, best, progress)
    more = _one_more(bench, lead, NAMED, no_one_law, progress)
    return (lead, more) if more else None


def _place(effect: Effect) -> tuple[str, int | None]:
    return effect.port, effect.joint


def _one_more(
    bench: Bench, state: State, most: float, wanted: Callable[[Effect], bool], progress: Callable[[str], None]
) -> list[Tried]:
    """The likeliest names that are `wanted` beyond a model, hastily refitted, the best finely unless one leaves nothing at once, if
    one leaves at most so many noise powers; else none."""
    lin = linearised(state.problem, state.minimum.vector)
    names, left = catalogue(lin, state.effects, bench.workers), beyond_noise(state, lin)
    likely = [c for c in names[:TRIED] if c.gain > PROMISED * left and wanted(c.effect)]
    tried = refitted(bench, state, [(c, lin) for c in likely], progress)
    best = min(tried, key=left_by, default=None)
    if best is None or left_by(best) > MUCH * state.select:
        return []
    if excess(bench, best[1]) > NAMED:
        near = [one for one in tried if left_by(one) <= NEAR * left_by(best)]
        tried = [(one[0], finer(bench, one[1], progress)) if one in near else one for one in tried]
    return tried if min(excess(bench, new) for _, new in tried) <= most else []
