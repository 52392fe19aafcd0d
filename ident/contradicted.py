"""Declared numbers that the fitted arm contradicts, each kept as declared to see what that costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ident.arm_fit import chi_squared, hold
from ident.departures import errors
from ident.descent import minimise
from ident.deviations import Deviation, deviations
from ident.effects.base import Effect
from ident.minima import LEAST_GAIN
from ident.parts import degrees
from ident.refits import FINELY, Bench, State

#: Declared numbers corrected at most.
MOST = 6


@dataclass(frozen=True, eq=False)
class Off:
    """A declared number that is off, held-out errors with it (and all less sure ones) as declared, and with it free;
    `without` is the model that keeps it."""

    deviation: Deviation
    before: float
    after: float
    without: State


def contradicted(bench: Bench, state: State) -> tuple[Off, ...]:
    """Declared numbers that the fitted arm contradicts, with the errors when they are kept: all, then one less at a time."""
    found = deviations(bench.campaign, bench.model, bench.basis, state.problem, state.minimum)[:MOST]
    result = []
    report, dof = bench.split.report, degrees(bench.split.select)
    kept_last = state
    for k in range(len(found) - 1, -1, -1):  # keep the least sure one, then the two least sure, ..
        kept = _kept(bench, state, found[k:])
        if kept.select < kept_last.select + LEAST_GAIN + max(state.select - dof, 0.0) / 2.0:
            continue
        result.append(Off(found[k], errors(bench, kept, report).all, errors(bench, kept_last, report).all, kept))
        kept_last = kept
    return tuple(reversed(result))


def merged(bench: Bench, state: State, off: Sequence[Off]) -> tuple[State, tuple[Off, ...]]:
    """The model, those declared numbers that one of its effects has, too, as values of that effect; and the others."""
    vector, others, k = state.minimum.vector.copy(), list(off), state.problem.base
    for effect in state.effects:
        for one in of_effect(others, effect):
            told = {name: value for name, value, *_ in one.deviation.values}
            places = {k + j: told[p.name] for j, p in enumerate(effect.parameters) if p.declared and p.name in told}
            vector[list(places)] = list(places.values())
            others.remove(one)
        k += len(effect.values)
    effects = state.problem.effects_at(vector)
    problem = bench.problem(state.problem.data, effects, state.scales, state.limits)
    problem = replace(problem, slid=state.problem.slid)
    minimum = replace(state.minimum, vector=vector)
    return replace(state, effects=effects, problem=problem, minimum=minimum), tuple(others)


def of_effect(off: Sequence[Off], effect: Effect) -> list[Off]:
    """Those of declared numbers that an effect has, too."""
    return [one for one in off if (one.deviation.name, one.deviation.joint) == (effect.name, effect.joint)]


def _kept(bench: Bench, state: State, declared: Sequence[Deviation]) -> State:
    """The model refitted with these numbers as declared."""
    problem, vector = state.problem, state.minimum.vector.copy()
    free = problem.free.copy()
    for one in declared:
        vector[one.indices] -= one.change
        free[one.indices] = False
    problem = replace(problem, free=free)
    minimum = minimise(problem, vector, (), 1, FINELY)
    problem = replace(problem, slid=minimum.slid)
    chosen = replace(problem, data=bench.split.select)
    select = chi_squared(chosen, minimum.vector, hold(chosen, minimum.vector))
    return replace(state, minimum=minimum, problem=problem, select=select)
