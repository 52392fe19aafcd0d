"""Since when a joint is another one, and of which records nothing tells: by stand-ins, a record leaves something where it is taken
for what it is not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ident.effects.declared import ChangeBetweenRecords
from ident.effects.spring import Backlash
from ident.search.changes import not_closer, since, told_of, untold_changes

#: The fifth record is the first that has changed; the first value of the arm, and that of an effect before it.
CHANGED, ARM, PLAY = 4, (7.0, 8.0), (1e-5,)


class Stand(SimpleNamespace):
    """A part that may be remembered."""

    __hash__ = object.__hash__


def records(*which: int) -> Any:
    return tuple(SimpleNamespace(index=k) for k in which)


def state(record: float) -> Any:
    change = ChangeBetweenRecords(0, (record, 0.2, 0.0, 0.0))
    effects = (Backlash(1, PLAY), change)
    problem = SimpleNamespace(base=len(ARM), effects_at=lambda vector: (effects[0], change.with_values(vector[3:])))
    minimum = SimpleNamespace(vector=np.array([*ARM, *PLAY, *change.values]))
    return Stand(effects=effects, problem=problem, minimum=minimum, select=1e3)


@pytest.fixture
def shows(monkeypatch: pytest.MonkeyPatch) -> dict[int, float]:
    """What is left of each record more than noise where it is taken for what it is not, much unless it is said how much."""
    much: dict[int, float] = {}

    def left(of: Any, vector: np.ndarray, data: Any) -> float:
        wrong = [one.index for one in data if (one.index >= vector[3] - 1) != (one.index >= CHANGED)]
        return sum(much.get(k, 1e4) for k in wrong)

    monkeypatch.setattr("ident.search.changes._left", left)
    monkeypatch.setattr("ident.search.changes.replace", lambda of, **new: Stand(**(vars(of) | new)))
    return much


def test_records_about_a_change_that_nobody_else_saw_are_not_told_of(shows: dict[int, float]) -> None:
    """The second is the last that is known to be from before it."""
    split: Any = Stand(fit=records(0, 4, 6), select=records(1, 5))

    def told(*which: int) -> list[int]:
        return [one.index for one in told_of(split, state(5.0), records(*which))]

    assert told(0, 2, 3, 7) == [0, 7]
    assert told(2, 3) == [2, 3]  # else there were nothing to tell
    assert told(0, 2, 3, 4, 6) == [0, 4, 6]
    assert not_closer(split, state(5.0)) == [
        "change-between-records: before any of the records 3 to 5; no record tells closer"
    ]


def test_nothing_tells_of_a_record_that_only_those_that_hardly_show_it_are_about(shows: dict[int, float]) -> None:
    """As of another joint: two of them show a little, which is enough together."""
    split: Any = Stand(fit=records(0, 2, 6), select=records(3, 5))
    shows.update({3: 0.1, 5: -0.1})
    for record in (4.0, 5.0, 6.0, 7.0):
        assert untold_changes(split, state(record)) == (range(3, 6),)
    shows.update({3: 8.0, 2: 8.0})
    assert untold_changes(split, state(5.0)) == (range(3, 6),)


def test_after_the_last_record_that_fits_or_chooses_nothing_tells(shows: dict[int, float]) -> None:
    split: Any = Stand(fit=records(0, 1, 4), select=records(2, 3))
    shows[4] = 0.1
    (untold,) = untold_changes(split, state(5.0))
    assert 3 not in untold and 4 in untold and 99 in untold
    assert not_closer(split, state(5.0)) == [
        "change-between-records: before any of the records 5 to the last; no record tells closer"
    ]
    assert untold_changes(split, SimpleNamespace(effects=(Backlash(1, PLAY),), problem=SimpleNamespace(base=0))) == ()  # type: ignore[arg-type]


def test_a_change_is_since_the_first_record_that_chooses_and_has_it(shows: dict[int, float]) -> None:
    """Of those between two that fit; from one that chooses to the next nothing is told, and rounding does not decide."""
    bench: Any = SimpleNamespace(split=SimpleNamespace(fit=records(0, 8), select=records(2, 4, 5)))
    found = since(bench, state(9.0))
    assert found.effects[1]["record"] == found.minimum.vector[3] == CHANGED + 1 and found.select == 0.0
    only: Any = SimpleNamespace(split=SimpleNamespace(fit=records(0, 8), select=records(9)))
    assert since(only, began := state(9.0)) is began
