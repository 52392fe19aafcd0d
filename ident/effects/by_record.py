"""A joint that is another one in every record, for no reason that anybody named: how warm it was, who had wound it up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

from ident.effects.base import Effect, Parameter
from ident.effects.declared import Changing
from ident.effects.learned import Learned


class ByRecord(Learned, Changing):
    """Its stiffness in each record: in those at `knots` (from 1) another by a share, in all others as it is in the first."""

    port = "spring"
    variable = "record"

    def shares(self, record: int) -> dict[str, float]:
        by = dict(zip(self.knots, self.values, strict=True)).get(record + 1.0)
        return {} if by is None else {"K": by}


def by_record(records: Sequence[int]) -> type[ByRecord]:
    """The kind for these `records` (from 0): the stiffness in the first of them is the fitted arm's own."""
    _, *others = sorted(set(records))

    @final
    class Shares(ByRecord):
        knots = tuple(record + 1.0 for record in others)
        parameters = tuple(Parameter(f"share_{record + 1}", "", -0.9, 10.0, (0.05,)) for record in others)

    return Shares


def of_records(effect: Effect) -> bool:
    """Whether an effect is one of each record."""
    return isinstance(effect, ByRecord)
