"""A joint that changed more often than once, and not evenly: another stiffness in every record in the place of changes that leave
something, or of several."""

from __future__ import annotations

from dataclasses import replace

from ident.arm.parts import degrees
from ident.effects.base import Effect, only_shares
from ident.effects.by_record import by_record, of_records
from ident.search.added import Added
from ident.search.candidates import best_of
from ident.search.choice import CURVE_RATIO
from ident.search.departures import errors
from ident.search.minima import LEAST_GAIN, fully
from ident.search.refits import NAMED, Bench, State, fitted, linearised, reduced_chi2, same, some
from ident.search.tried import refitted


def in_each_record(bench: Bench, state: State, added: list[Added]) -> tuple[State, list[Added]]:
    """The model with a stiffness for every record in the place of the changes of the last effect's joint, where that leaves far less of
    what one leaves, or as little as several do. Only where each record is in every part: of others nothing would be fitted."""
    last = state.effects[-1]
    changes = [e for e in state.effects if _changes(e) and e.joint == last.joint]
    several = len(changes) > 1
    if not (_changes(last) and bench.split.note) or bench.late or not (several or reduced_chi2(bench, state) > NAMED):
        return state, added
    less = fitted(bench, some(state, [k for k, e in enumerate(state.effects) if e not in changes]))
    lin = linearised(less.problem, less.minimum.vector)
    candidate = best_of(lin, by_record([one.index for one in less.problem.data]), last.joint)
    if candidate is None:
        return state, added
    ((_, tried),) = refitted(bench, less, [(candidate, lin)])
    new = fully(bench, tried)
    dof = degrees(bench.split.select)
    most = (
        dof * NAMED
        if several and reduced_chi2(bench, state) <= NAMED
        else dof + CURVE_RATIO * (state.select - dof) - LEAST_GAIN
    )
    if new.select > most:
        return state, added
    return new, _entries(bench, less, new, added, changes)


def _changes(effect: Effect) -> bool:
    """Whether an effect is a change of a joint that is not one of each record."""
    return only_shares(effect) and not of_records(effect)


def _entries(bench: Bench, less: State, new: State, added: list[Added], changes: list[Effect]) -> list[Added]:
    """The entries, one in the place of those of all `changes`: they are its rivals."""
    gone = [a for a in added if any(same(a.effect, e) for e in changes)]
    first, others = gone[0], [a for a in added if a not in gone]
    entry = replace(
        first, effect=new.effects[-1], after=errors(bench, new, bench.split.report).all, gain=less.select - new.select,
        rivals=tuple((a.effect, a.after) for a in gone), tied=(), others=(), partly=(), besides=less,
    )  # fmt: skip
    return [*others, entry]
