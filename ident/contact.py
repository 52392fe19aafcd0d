"""Candidates of dry friction, told as their contact creeps before it slides: until then the true law may leave much."""

from __future__ import annotations

from collections.abc import Callable

from ident.choice import Tried, is_curve, left_by
from ident.minima import creeping_like, crept, told
from ident.refits import Bench, all_fitted, excess


def as_it_creeps(bench: Bench, tried: list[Tried], near: float, progress: Callable[[str], None]) -> list[Tried]:
    """The candidates, the best one as its contact creeps, if it is dry and leaves more than `near` times the noise power; plainer laws of
    its port likewise."""
    best = min(tried, key=left_by, default=None)
    if best is None or excess(bench, best[1]) <= near or (state := crept(bench, best[1])) is best[1]:
        return tried
    progress(f"  as it creeps, {told(state.effects[-1])}: {excess(bench, state):.4g}")
    law = state.effects[-1]
    alike = [
        one for one in tried
        if one[1].effects[-1].dry and not is_curve(one) and one[0].key[1:] == best[0].key[1:] and one[0].effect.numbers < law.numbers
    ]  # fmt: skip
    like_it = [creeping_like(one[1], law.values[-1]) for one in alike]
    found = dict(zip([id(one) for one in [best, *alike]], [state, *all_fitted(bench, like_it)], strict=True))
    return [(one[0], found.get(id(one), one[1])) for one in tried]
