"""Memories that could explain a residual where no curve does: at every port with one, by thresholds within what the records cover."""

from __future__ import annotations

import numpy as np

from ident.effects.learned import Learned
from ident.effects.memory import LOOPS, PRESLIDING, remembering
from ident.search.candidates import side_of
from ident.search.trace import Linearised

#: Thresholds of a memory, sharp ones and soft ones, as shares of half of what the records cover: beyond that a stop never slips.
SHARP, SOFT = np.geomspace(0.003, 0.7, 8), np.geomspace(0.01, 1.0, 5)
#: Those of what sticks, which slips where it stops, closer to each other.
STICKS, GIVES = np.geomspace(0.003, 0.9, 16), np.geomspace(0.03, 1.0, 4)


def memories(lin: Linearised) -> list[tuple[type[Learned], int]]:
    """The kinds of memory at every port of every joint that moves, and the joint."""
    found = []
    for joint in range(lin.problem.n):
        for (variable, port), loop in LOOPS.items():
            signals = [
                motion.signal(loop.signal, joint)
                for one, motion in zip(lin.problem.data, lin.motions[side_of(port)], strict=True)
                if joint in one.scene.arm.live
            ]
            swing = max((0.5 * float(np.ptp(x)) for x in signals), default=0.0)
            sharp, soft = (STICKS, GIVES) if variable == PRESLIDING else (SHARP, SOFT)
            if swing > 0.0:
                found.append(
                    (remembering(variable, port, (swing * np.concatenate([sharp, soft])).tolist(), len(soft)), joint)
                )
    return found
