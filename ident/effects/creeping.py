"""Dry friction whose contact creeps more or less before it slides than contacts are expected to: that is fitted with it."""

from __future__ import annotations

from typing import cast

from ident.effects.base import Effect, Law, Parameter

#: Decades by which a contact creeps slower or faster at most, and from where that is looked for: slower ones stop too soon for the
#: samples of a period, and move too little to be seen.
SLOWEST, FASTEST, FROM = -0.7, 1.0, (0.0, -0.35, -0.7, 0.4, 0.8)


class Creeping(Law):
    """A dry law whose last value says how it creeps."""

    @property
    def creep(self) -> float:
        return self.values[-1]


def creeping(law: Effect, decades: float) -> Effect:
    """The dry law, its contact creeping faster by so many decades."""
    kind = type(law)
    more = Parameter("creep", "decades", SLOWEST, FASTEST, (0.0,), zero=None, aside=True)
    found = type(kind.__name__, (Creeping, kind), {"parameters": (*kind.parameters, more)})
    return cast(Effect, found(law.joint, (*law.values, decades)))
