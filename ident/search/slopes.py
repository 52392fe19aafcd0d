"""Stiffnesses and dampings that a learned curve has in it, too: its slope, so that only one of both is fitted."""

from __future__ import annotations

from collections.abc import Sequence

from ident.effects.base import Effect, Law, PortLaw
from ident.effects.learned import LINEAR, Learned

#: Which of the four numbers of a drive (`Parameters`: K, J_m, D, D_spring) is a slope of a curve, by port and variable.
SLOPES = {
    ("spring", "position"): 0, ("motor", "velocity"): 2, ("motor", "sliding"): 2, ("motor", "damping"): 2, ("motor", "laden"): 2,
    ("motor", "driving"): 2, ("spring", "velocity"): 3, ("spring", "damping"): 3, ("spring", "stiffness"): 0,
}  # fmt: skip


def drawn_again(effect: Effect, effects: Sequence[Effect]) -> bool:
    """Whether a learned curve has the slope of a linear law of its port in it, too, a stiffness or a damping, or of one with a memory, which is
    either: together they could be anything."""
    if not (isinstance(effect, PortLaw) and effect.linear):
        return False
    curves = [e for e in effects if isinstance(e, Learned) and e.variable in LINEAR]
    slopes = [e.variable != "position" for e in curves if (e.port, e.joint) == (effect.port, effect.joint)]
    return effect.drags in slopes if isinstance(effect, Law) else bool(slopes)


def drawn_besides(effect: Effect, n: int) -> int | None:
    """The place of the stiffness or damping of the arm that is the slope of a learned curve, too; None where it has none."""
    if not isinstance(effect, Learned) or effect.joint is None or (effect.port, effect.variable) not in SLOPES:
        return None
    return SLOPES[effect.port, effect.variable] * n + effect.joint
