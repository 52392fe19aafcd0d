"""Which records an error is told of."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from ident.departures import _between
from ident.effects.declared import ChangeBetweenRecords
from ident.effects.spring import Backlash

BENCH: Any = SimpleNamespace(
    split=SimpleNamespace(
        fit=[SimpleNamespace(index=k) for k in (0, 4, 6)], select=[SimpleNamespace(index=k) for k in (1, 5)]
    )
)


def test_records_just_before_a_change_that_nobody_else_saw_are_not_told_of() -> None:
    """The fifth record is the first that is known to have changed, the second the last that is known not to have."""
    change = ChangeBetweenRecords(0, (5.0, 0.2, 0.0, 0.0))
    assert [k for k in range(8) if _between(BENCH, (Backlash(1, (1e-5,)), change), k)] == [2, 3]
    assert not any(_between(BENCH, (Backlash(1, (1e-5,)),), k) for k in range(8))
