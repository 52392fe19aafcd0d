"""Waves of a whole order in a turn of the motor: of one kind a joint may have several, each of its own order, and none the harmonic of another."""

from __future__ import annotations

from collections.abc import Sequence

from ident.effects.base import Effect

#: The parameter that is the order.
ORDER = "order"
#: What a wave that is no sine has besides its own order, most of all.
HARMONICS = (2.0, 3.0)


def is_wave(kind: type[Effect] | Effect) -> bool:
    """Whether an effect, or those of a kind, are waves of a whole order."""
    return any(p.name == ORDER and p.whole for p in kind.parameters)


def order_of(effect: Effect) -> float | None:
    """The order of a wave; None for other effects."""
    return effect[ORDER] if is_wave(effect) else None


def orders_at(effects: Sequence[Effect], kind: type[Effect], joint: int | None) -> set[float]:
    """The orders of the waves of a kind that a joint has already."""
    return {e[ORDER] for e in effects if is_wave(e) and (e.name, e.joint) == (kind.name, joint)}


def is_harmonic(order: float, taken: set[float]) -> bool:
    """Whether a wave of this order and one of those `taken` are one law that is no sine, for a curve to draw."""
    return any(order in (h * other, other / h) for other in taken for h in HARMONICS)
