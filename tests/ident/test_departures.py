"""Which records an error is told of."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from ident.departures import told_of
from ident.effects.declared import ChangeBetweenRecords
from ident.effects.spring import Backlash


def records(*which: int) -> Any:
    return tuple(SimpleNamespace(index=k) for k in which)


def test_records_just_before_a_change_that_nobody_else_saw_are_not_told_of() -> None:
    """The fifth record is the first that is known to have changed, the second the last that is known not to have."""
    split: Any = SimpleNamespace(fit=records(0, 4, 6), select=records(1, 5))
    change, play = ChangeBetweenRecords(0, (5.0, 0.2, 0.0, 0.0)), Backlash(1, (1e-5,))

    def told(*which: int) -> list[int]:
        return [one.index for one in told_of(split, (play, change), records(*which))]

    assert told(0, 2, 3, 7) == [0, 7]
    assert told(2, 3) == [2, 3]  # else there were nothing to tell
    assert len(told_of(split, (play,), records(0, 2, 3, 7))) == 4
