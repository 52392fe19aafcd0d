"""Declared numbers that the fitted arm contradicts, each kept as declared to see what that costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.arm.arm_fit import Problem, chi_squared, hold, spectrum
from ident.arm.descent import SLACK, minimise
from ident.arm.parts import degrees
from ident.effects.base import Effect
from ident.records.campaign import Array
from ident.search.departures import errors, held_as
from ident.search.deviations import HIDDEN, Deviation, deviations
from ident.search.minima import LEAST_GAIN
from ident.search.refits import FINELY, Bench, State, same
from symgen.forked import forked


@dataclass(frozen=True, eq=False)
class Off:
    """A declared number that is off: held-out errors with it alone as declared and with it as found; `without` is the model that
    keeps all such, the model itself where it has effects: these tell before from after."""

    deviation: Deviation
    before: float
    after: float
    without: State


def contradicted(bench: Bench, state: State) -> tuple[Off, ...]:
    """Declared numbers that the fitted arm contradicts, dearest first."""
    found = deviations(bench.campaign, bench.model, bench.basis, state.problem, state.minimum)
    if not found:
        return ()
    least = state.select + LEAST_GAIN + max(state.select - degrees(bench.split.select), 0.0) / 2.0
    select, report = bench.split.select, bench.split.report
    chosen = replace(state.problem, data=select)
    held, held_out = held_as(state, select), held_as(state, report)

    def cost(one: Deviation) -> tuple[float, float]:
        """What it costs to keep one: chi^2 on the choosing records and held-out error, under forces as they were found."""
        kept = _kept(state, (one,))
        return chi_squared(chosen, kept.minimum.vector, held), errors(bench, kept, report, held_out).all

    costs = zip(found, forked(cost, found, bench.workers), strict=True)
    rows = sorted((row for row in costs if row[1][0] >= least), key=lambda row: -row[1][0])
    if not rows:
        return ()
    after = errors(bench, state, report, held_out).all
    none = state if state.effects else _refitted(bench, _kept(state, [one for one, _ in rows]))
    return tuple(Off(one, before, after, none) for one, (_, before) in rows)


def merged(state: State, off: Sequence[Off]) -> tuple[State, tuple[Off, ...]]:
    """The model, those declared numbers that one of its effects has, too, as values of that effect; and the others."""
    vector, others, k = state.minimum.vector.copy(), list(off), state.problem.base
    for effect in state.effects:
        for one in of_effect(others, effect):
            told = {name: value for name, value, *_ in one.deviation.values}
            places = {k + j: told[p.name] for j, p in enumerate(effect.parameters) if p.declared and p.name in told}
            vector[list(places)] = list(places.values())
            others.remove(one)
        k += len(effect.values)
    minimum = replace(state.minimum, vector=vector)
    return replace(state, effects=state.problem.effects_at(vector), minimum=minimum), tuple(others)


def of_effect(off: Sequence[Off], effect: Effect) -> list[Off]:
    """Those of declared numbers that an effect has, too."""
    return [one for one in off if (one.deviation.name, one.deviation.joint) == (effect.name, effect.joint)]


def standard_deviations(state: State, effect: Effect, off: Sequence[Off]) -> tuple[float, ...]:
    """Standard deviations of an effect's values, NaN where no record shows one; of those that are declared numbers, too, what these are
    `off` by tells them, 0: as declared."""
    values, vectors, seen = spectrum(state.minimum.information)
    deviation = (
        np.sqrt(np.einsum("ik,k,ik->i", vectors[:, seen], 1.0 / values[seen], vectors[:, seen])) * state.problem.scale
    )
    deviation[np.abs(vectors[:, ~seen]).max(axis=1, initial=0.0) > HIDDEN] = np.nan
    told_by = {name: std for one in of_effect(off, effect) for name, _, std, _ in one.deviation.values}
    k = state.problem.base
    for e in state.effects:
        if same(e, effect):
            own = deviation[k : k + len(e.values)].tolist()
            return tuple(
                told_by.get(p.name, 0.0) if p.declared else std for p, std in zip(e.parameters, own, strict=True)
            )
        k += len(e.values)
    return ()


def is_shapeless(state: State) -> bool:
    """Whether a shape of the last effect is as small as may be, which is not nothing, and its standard deviation larger: whatever has
    that name does what another does. A damping may be none, and what is stiffer than can be told is stiff."""
    effect = state.effects[-1]
    limits = state.limits[len(state.limits) - len(effect.values) :]
    least = [
        p.zero is None and not (p.whole or p.aside) and 0.0 < low and value <= low * (1.0 + SLACK)
        for p, value, (low, _) in zip(effect.parameters, effect.values, limits, strict=True)
    ]
    if not any(least):
        return False
    told = zip(least, effect.values, standard_deviations(state, effect, ()), strict=True)
    return any(at and not std <= value for at, value, std in told)


def _kept(state: State, declared: Sequence[Deviation]) -> State:
    """The model with these numbers as declared, the others where the curvature at its minimum takes them; nobody has judged it."""
    problem, vector = state.problem, state.minimum.vector.copy()
    free = problem.free.copy()
    for one in declared:
        vector[one.indices] -= one.change
        free[one.indices] = False
    problem = replace(problem, free=free)
    minimum = replace(state.minimum, vector=_follows(problem, state, vector))
    return replace(state, problem=problem, minimum=minimum, select=np.inf)


def _refitted(bench: Bench, state: State) -> State:
    """The model refitted from where it is, with what it leaves of the records that choose."""
    told = replace(state.problem, until=np.inf)  # of what is told, however late
    minimum = minimise(told, state.minimum.vector, (), 1, FINELY)
    problem = replace(state.problem, slid=minimum.slid)
    chosen = replace(problem, data=bench.split.select)
    select = chi_squared(chosen, minimum.vector, hold(chosen, minimum.vector))
    return replace(state, minimum=minimum, problem=problem, select=select)


def _follows(problem: Problem, state: State, vector: Array) -> Array:
    """What is free, where the curvature at the minimum takes it when the rest is moved to where `vector` has it; what is lost of a drive,
    whose logarithms are fitted, is no more than all of it."""
    free, scale, information = problem.free, problem.scale, state.minimum.information
    moved = (vector - state.minimum.vector) / scale
    moved[: 4 * problem.n] = np.maximum(moved[: 4 * problem.n], -1.0)
    pushed = information[np.ix_(free, ~free)] @ moved[~free]
    size = np.sqrt(np.maximum(np.diag(information)[free], 1e-300))
    curvature = information[np.ix_(free, free)] / size / size[:, None] + SLACK * np.eye(len(size))
    step = -np.linalg.solve(curvature, pushed / size) / size
    result = vector.copy()
    result[free] += np.clip(step, -1.0, 1.0) * scale[free]
    return np.asarray(np.clip(result, problem.low, problem.high))
