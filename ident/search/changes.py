"""When a joint changed: since which record, which records tell, and of which nothing does."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ident.arm.arm_fit import chi_squared, hold
from ident.arm.evidence import Evidence
from ident.arm.parts import Split
from ident.effects.by_record import of_records
from ident.records.campaign import Array
from ident.search.choice import TIE
from ident.search.refits import Bench, State

#: The parameter of an effect that says from which record on it acts, from 1.
SINCE = "record"


def since(bench: Bench, state: State) -> State:
    """The same model, its last effect since the record that the choosing ones tell, of those between two that fit."""
    place = _places(state).get(len(state.effects) - 1)
    if place is None:
        return state
    now = int(state.minimum.vector[place])
    earlier = [one.index + 1 for one in bench.split.fit if one.index + 1 < now]
    choosing = {one.index + 1 for one in bench.split.select}  # from one to the next nothing that is told changes
    best = state
    for record in sorted(choosing & set(range(max(earlier, default=1) + 1, now))):
        vector = _since(state, place, record)
        select = _left(state, vector, bench.split.select)
        if select < best.select:
            minimum = replace(state.minimum, vector=vector)
            best = replace(state, effects=state.problem.effects_at(vector), minimum=minimum, select=select)
    return best


def told_of(split: Split, state: State, data: Sequence[Evidence]) -> tuple[Evidence, ...]:
    """Those records of `data` of which others that fit or choose tell whether they are from before a change, if there are any. With a joint
    that is another one in each none that only reports."""
    known = {one.index for one in split.fit + split.select}
    of_each = any(map(of_records, state.effects))
    untold = untold_changes(split, state)
    told = [
        one for one in data if not any(one.index in these for these in untold) and (one.index in known or not of_each)
    ]
    return tuple(told) or tuple(data)


def untold_changes(split: Split, state: State) -> tuple[range, ...]:
    """The records, from 0, of which nothing that fits or chooses tells whether they are from before a change, for each effect that is one:
    between the last record that shows that it is, and the first that shows that it is not."""
    return tuple(_untold(split, state, place) for place in _places(state).values())


def not_closer(split: Split, state: State) -> list[str]:
    """What there is to say of changes that may have been before several records: these, from 1."""
    return [
        f"{state.effects[i].name}: before any of the records {these.start + 1} to "
        f"{these.stop + 1 if these.stop < sys.maxsize else 'the last'}; no record tells closer"
        for i, these in zip(_places(state), untold_changes(split, state), strict=True)
        if these
    ]


@lru_cache(maxsize=8)  # those of one diagnosis
def _untold(split: Split, state: State, place: int) -> range:
    begin = int(state.minimum.vector[place]) - 1
    parts: dict[int, list[Evidence]] = {}
    for one in split.fit + split.select:
        parts.setdefault(one.index, []).append(one)

    def taken_otherwise(records: Iterable[int]) -> int | None:
        """The first of these records that would leave more, were it on the other side of the change, and those up to it."""
        more, now = 0.0, state.minimum.vector
        for record in records:
            other = _since(state, place, record + 1 + (record >= begin))
            more += _left(state, other, parts[record]) - _left(state, now, parts[record])
            if more > TIE:
                return record
        return None

    before = taken_otherwise(sorted((record for record in parts if record < begin), reverse=True))
    after = taken_otherwise(sorted(record for record in parts if record >= begin))
    return range(0 if before is None else before + 1, sys.maxsize if after is None else after)


def _places(state: State) -> dict[int, int]:
    """Where in the vector of a model the record is since which an effect acts, by the place of the effect."""
    found, k = {}, state.problem.base
    for i, effect in enumerate(state.effects):
        names = [p.name for p in effect.parameters]
        if SINCE in names:
            found[i] = k + names.index(SINCE)
        k += len(effect.values)
    return found


def _since(state: State, place: int, record: int) -> Array:
    vector = np.array(state.minimum.vector)
    vector[place] = record
    return vector


def _left(state: State, vector: Array, data: Sequence[Evidence]) -> float:
    problem = replace(state.problem, data=tuple(data))
    return chi_squared(problem, vector, hold(problem, vector))
