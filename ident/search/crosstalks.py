"""Signals of other joints that could explain a residual: of every pair of joints that move in the same records."""

from __future__ import annotations

from itertools import permutations

from ident.effects.crosstalk import SIGNALS, crosstalk
from ident.effects.learned import Learned
from ident.search.trace import Linearised


def crosstalks(lin: Linearised) -> list[tuple[type[Learned], int]]:
    """The kinds of crosstalk between joints that move together, and the joint that hears the other."""
    together = {pair for one in lin.problem.data for pair in permutations(one.scene.arm.live.tolist(), 2)}
    return [(crosstalk(port, other), joint) for port in SIGNALS for joint, other in sorted(together)]
