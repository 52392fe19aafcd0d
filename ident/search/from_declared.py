"""Names tried from the declared arm: a fit that is far off bends all that is looked for from there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ident.arm.parts import degrees
from ident.effects.base import Effect, only_read, winds_up
from ident.effects.sensor import JointZeroOffset
from ident.effects.structure import LockedJointElasticity
from ident.search.candidates import Candidate, best_of, catalogue, nearer
from ident.search.choice import MUCH, SLIGHT, UNLIKELY, Tried, left_by, with_model
from ident.search.contact import as_it_creeps, as_it_sticks, as_it_winds
from ident.search.finer import with_finer
from ident.search.minima import told
from ident.search.refits import (
    BENT,
    CLOSE,
    NAMED,
    Bench,
    Refit,
    State,
    as_declared,
    fitted,
    linearised,
    reduced_chi2,
    same,
)
from ident.search.resized import larger
from ident.search.shapes import bending, only_shapes
from ident.search.trace import Linearised
from ident.search.tried import NEARLY, by_few_lines, refitted
from symgen.forked import forked

#: Candidates taken over from the declared arm; share of what the best promises from which a force that follows from the motion is
#: tried where it is so many times as large, too; and share of what is left without a force that promises to do as much.
SURELY, LIKELY, LARGER = 6, 0.5, 1.4


def from_declared(bench: Bench, state: State, found: Effect | None, bases: bool = True) -> list[Tried]:
    """The likeliest names beyond the declared arm with the effects of `state`, or the effect that was `found` already: first those that are
    fitted at once, and only these where one leaves nothing, as promises say little there. Soft `bases` where all leave much."""
    declared = linearised(state.problem, as_declared(bench, state))
    tried: list[Tried] = []
    if found is not None:
        again = [c for c in [best_of(declared, type(found), found.joint)] if c is not None]
    else:
        names = catalogue(declared, state.effects, bench.workers)
        tried = _at_once(bench, state, declared, names)
        if any(reduced_chi2(bench, one.state) <= NAMED for one in tried):
            return tried
        likely = list(forked(lambda c: nearer(declared, c), names[: 2 * SURELY], bench.workers))
        again = sorted(likely, key=lambda c: -c.gain)[:SURELY]
        again += [larger(c, LARGER) for c in again if winds_up(c.effect) and c.gain > LIKELY * again[0].gain]
        again = [
            c for c in again if c.effect not in [one.candidate.effect for one in tried]
        ]  # copies, from another process
    tried += refitted(bench, state, [(c, declared) for c in again])
    best = min(tried, key=left_by, default=None)
    left = max(CLOSE**2 * degrees(bench.split.select), NEARLY * state.select)
    if best is not None and only_shapes(best.candidate.effect) and left_by(best) > left:
        tried += tried_bending(bench, state, declared, lambda effect: same(effect, best.candidate.effect))
    if found is None and bases:
        tried += soft_bases(bench, state, tried, declared)
    return as_it_sticks(bench, state, declared, as_it_moves(bench, tried))


def on_declared_arm(bench: Bench, tried: Sequence[Tried]) -> list[Tried]:
    """The candidates, the best fitted from the declared arm, too: what was missing may have bent that beyond which they were tried."""
    best = min(tried, key=left_by, default=None)
    if best is None:
        return []
    anew = fitted(bench, replace(Refit.of(best.state), vector=as_declared(bench, best.state)))
    bench.say(f"  from the declared arm, {told(anew.effects[-1])}: {reduced_chi2(bench, anew):.4g}")
    return with_model(tried, best, min(best.state, anew, key=lambda one: one.select))


def soft_bases(bench: Bench, state: State, tried: Sequence[Tried], declared: Linearised | None = None) -> list[Tried]:
    """Soft bases beyond the declared arm with the effects of `state`, linearised in `declared`, where all that was `tried` leaves much: a soft
    base, or lock, bends the whole arm, and promises nothing from there."""
    best = min(tried, key=left_by, default=None)
    much = max(BENT * degrees(bench.split.select), MUCH * state.select)
    if (best is not None and best.candidate.effect.joint is None) or any(left_by(one) <= much for one in tried):
        return []
    declared = declared or linearised(state.problem, as_declared(bench, state))
    return tried_bending(bench, state, declared, lambda e: e.joint is None or isinstance(e, LockedJointElasticity))


def _at_once(bench: Bench, state: State, declared: Linearised, names: Sequence[Candidate]) -> list[Tried]:
    """Those of the likely `names` that are fitted at once, the best finely where it leaves little. Where only names are wanted, as general
    links do alone, zeros that are off in any case: these look like such links most."""
    zeros = [c for c in names if bench.only_names and isinstance(c.effect, JointZeroOffset)]
    slight = SLIGHT * max((c.gain for c in names), default=0.0)
    plain = [c for c in names if only_read(c.effect) and (c.gain > slight or c in zeros)][:SURELY]
    tried = refitted(bench, state, [(c, declared) for c in plain])
    best = min(tried, key=left_by, default=None)
    if best is None or left_by(best) > (1.0 if zeros else UNLIKELY) * state.select:
        return tried
    return with_finer(bench, tried, best)


def tried_bending(
    bench: Bench,
    state: State,
    lin: Linearised,
    wanted: Callable[[Effect], bool] = lambda effect: True,
) -> list[Tried]:
    """The impedances of shapes alone that may have bent the arm, those `wanted`, from plausible ones."""
    if bench.only_names:
        return []
    return by_few_lines(bench, state, lin, [c for c in bending(lin, state.effects) if wanted(c.effect)])


def as_it_moves(bench: Bench, tried: list[Tried]) -> list[Tried]:
    """The candidates, the best one with the motion that its force makes, where it leaves much with motions that were held."""
    return as_it_winds(bench, as_it_creeps(bench, tried, CLOSE**2), CLOSE**2)
