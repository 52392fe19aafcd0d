"""Candidates that were tried: the names and curves among them, and which one is chosen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from ident.arm.parts import degrees
from ident.effects.base import Effect, has_forces, only_forces, only_impedance
from ident.effects.catalogue import CATALOGUE
from ident.search.candidates import Candidate
from ident.search.minima import LEAST_GAIN
from ident.search.refits import CLOSE, FINELY, NAMED, Bench, State, reduced_chi2

#: An effect earns its place with this share of what was in excess, besides `LEAST_GAIN`.
LEAST_SHARE = 0.2
#: A learned curve takes a name's place where it leaves less than this share of what the name leaves.
CURVE_RATIO = 0.3
#: A learned curve needs this share of all that was in excess to be added, or to leave hardly anything where much was left.
CURVE_SHARE = 0.05
#: Effects whose chi^2 on the choosing records differ by less than this, or by this share of what both leave, are not told apart.
TIE, ALIKE = 12.0, 0.05
#: Share of what any other candidate leaves that one leaves which is far ahead; of what there was, that an effect has to leave less of
#: which does little of all.
AHEAD, REST = 0.03, 0.2
#: Share of what a fine fit leaves that another one leaves in haste, at least, that ends where it did.
HASTE = 0.7
#: Share of what the best promises from which another is tried, as a promise is of first order.
SLIGHT = 0.1
#: Share of what there was that a name from the declared arm may leave for only curves to be tried from where the arm was fitted, and
#: nothing that bends the whole arm.
MUCH = 0.3
#: What another leaves so far behind is not fitted finely, nor looked for where it is some other size.
UNLIKELY = 0.1
#: Share of chi^2 that the descents of two candidates may have left.
DOUBT = 2.0 * FINELY


class Tried(NamedTuple):
    """A candidate as it was promised, and the model refitted with it."""

    candidate: Candidate
    state: State

    def refitted(self, state: State) -> Tried:
        """The candidate with the model fitted again."""
        return Tried(self.candidate, state)


def with_model(tried: Sequence[Tried], one: Tried, state: State) -> list[Tried]:
    """The candidates, `one` of them with its model fitted again."""
    return [other.refitted(state) if other is one else other for other in tried]


def is_curve(one: Tried) -> bool:
    return one.candidate.effect.name == "unknown"


def left_by(one: Tried) -> float:
    """chi^2 on the choosing records."""
    return one.state.select


def best_names(tried: Sequence[Tried], by: Callable[[Tried], float] = left_by) -> list[Tried]:
    """The best of each named effect at each joint, best first, `by` chi^2 on the choosing records or something else: one that was fitted
    finely, unless another leaves much less in haste."""
    found: dict[tuple[str, int | None, str], Tried] = {}
    for one in sorted((one for one in tried if not is_curve(one)), key=by):
        if ended_there(one, found.setdefault(one.candidate.key, one), by):
            found[one.candidate.key] = one
    return sorted(found.values(), key=by)


def ended_there(fine: Tried, hasty: Tried, by: Callable[[Tried], float] = left_by) -> bool:
    """Whether a name was fitted finely already where it is in haste, as far as what both leave tells."""
    finer = fine.state.roughly <= FINELY < hasty.state.roughly
    return finer and fine.candidate.key == hasty.candidate.key and HASTE * by(fine) <= by(hasty)


def vanished(effect: Effect) -> bool:
    """Whether nothing is left of an effect: all its sizes are zero, whatever its other values are."""
    values = zip(effect.values, effect.parameters, strict=True)
    sizes = [value - p.zero for value, p in values if p.zero is not None and not p.aside]
    return bool(sizes) and not any(sizes)


def chosen(bench: Bench, tried: Sequence[Tried], before: float) -> Tried | None:
    """The candidate that is chosen: the best name, or the best curve where no name earns what that does; `before` is
    chi^2 on the choosing records without any."""
    dof = degrees(bench.split.select)
    named = [one for one in tried if not is_curve(one)]
    name = plainest(bench, named) if named else None
    curve = min((one for one in tried if is_curve(one)), key=left_by, default=None)
    earned = name is not None and before - left_by(name) > max(LEAST_GAIN, LEAST_SHARE * (before - dof))
    if name is None or (curve is not None and (not earned or _much_better(bench, left_by(curve) - dof, name.state))):
        return curve
    return name


def plainest(bench: Bench, named: Sequence[Tried], doubt: float = DOUBT) -> Tried:
    """The best of the named candidates; of those that are not told apart from it the one with the fewest parameters. Descents may
    have left a share `doubt` of chi^2."""
    limit = as_much(bench, min(map(left_by, named)), doubt)
    order = list(CATALOGUE)
    return min(
        (pair for pair in named if left_by(pair) <= limit),
        key=lambda pair: (pair.candidate.effect.numbers, order.index(pair.candidate.effect.name), left_by(pair)),
    )


def as_much(bench: Bench, least: float, doubt: float = DOUBT) -> float:
    """chi^2 on the choosing records that is not told apart from the `least`; descents may have left a share `doubt` of chi^2."""
    dof = degrees(bench.split.select)
    return least + TIE + doubt * dof + ALIKE * max(least - dof, 0.0)


def rivals(bench: Bench, tried: Sequence[Tried], best: Tried) -> list[Tried]:
    """The best of the other names that may leave less than the chosen one with no more parameters, had all been fitted on."""
    if is_curve(best):
        return []
    limit = left_by(best) + TIE + DOUBT * degrees(bench.split.select)
    others = [one for one in best_names(tried) if one.candidate.key != best.candidate.key and left_by(one) <= limit]
    return [one for one in others if one.candidate.effect.numbers <= best.candidate.effect.numbers]


def _much_better(bench: Bench, by_curve: float, named: State) -> bool:
    """Whether a learned curve, that can play any law of its variable, leaves so much less than a name that the name is wrong."""
    by_name = named.select - degrees(bench.split.select)
    return by_curve < CURVE_RATIO * by_name - LEAST_GAIN and reduced_chi2(bench, named) > NAMED


def drawn_whole(bench: Bench, tried: Sequence[Tried]) -> bool:
    """Whether a curve of a force is the only one of `tried` that leaves nothing, or little, and is far ahead of all names: its name, if it
    has one, is looked for where it is."""
    best, named = min(tried, key=left_by, default=None), best_names(tried)[:1]
    if best is None or not is_curve(best) or not has_forces(best.state.effects[-1]):
        return False
    ahead = any(left_by(best) <= AHEAD * left_by(name) for name in named)
    return reduced_chi2(bench, best.state) <= (CLOSE if ahead else NAMED)


def rings_ahead(tried: Sequence[Tried]) -> bool:
    """Whether the best of `tried` is a mass that rings, of no name, and leaves hardly anything of what any name does."""
    best, named = min(tried, key=left_by, default=None), best_names(tried)
    if best is None or not named or not is_curve(best) or not only_impedance(best.candidate.effect):
        return False
    return left_by(best) <= AHEAD * left_by(named[0])


def hardly_bent(bench: Bench, state: State, tried: Sequence[Tried]) -> bool:
    """Whether a force leaves little beside what any other name does, and the model without: the arm was hardly bent."""
    named, dof = best_names(tried), degrees(bench.split.select)
    if len(named) < 2 or not only_forces(named[0].candidate.effect) or reduced_chi2(bench, named[0].state) > CLOSE:
        return False
    return left_by(named[0]) - dof < REST * (min(left_by(named[1]), state.select) - dof)


def law_leads(bench: Bench, tried: Sequence[Tried]) -> bool:
    """Whether the best of the names is a force and so far ahead of all others that none of these is it; impedances may have been
    far from their place. None leads that leaves more than there is without effects."""
    named = best_names(tried)
    if len(named) < 2 or left_by(named[0]) >= bench.at_first:
        return False
    return only_forces(named[0].candidate.effect) and left_by(named[0]) <= AHEAD * left_by(named[1])
