"""The motion that a force follows, instant by instant: where turns around the whole period do not find it, as in play that rattles."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ident.records.campaign import Array

#: Points at which a law is tabled, and how much wider than the motion it was met in, either side.
TABLED, WIDER = 20000, 1.0
#: Points of the table, outside of it, that no motion goes to.
BEYOND = 1e9
#: Newton's steps to the force of an instant, which moves the port at that instant, too.
STEPS = 3


def marched(alone: Array, gives: Array, law: Callable[[Array], Array], x: Array, start: Array) -> Iterator[Array]:
    """Yields the forces [S] of `law`, period after period, from `start` [S] on: at each instant that of the position
    `alone` + `gives` * force, the convolution over the last period.

    It ends where the motion goes beyond all bounds. `alone` [S] is the position without the force, `gives` [S] what a unit of it at one instant does at this and later ones; `x` [S] a
    motion of about the size. `law`(x) of positions [T]. Periods need not repeat each other.
    """
    S, span = len(alone), float(np.ptp(x)) or 1.0
    low = float(x.min()) - WIDER * span
    per_step = (TABLED - 1) / ((1.0 + 2.0 * WIDER) * span)
    table = law(low + np.arange(TABLED) / per_step)
    heights, slopes = table.tolist(), np.diff(table).tolist()
    at_once, later = float(gives[0]), np.ascontiguousarray(gives[:0:-1])
    position, forces = alone.tolist(), np.concatenate([start, np.zeros(S)])
    force = float(start[-1])
    while True:
        for k in range(S):
            free = position[k] + float(later @ forces[k + 1 : k + S])
            y = free + at_once * force
            for _ in range(STEPS):
                place = (y - low) * per_step
                if not -BEYOND < place < BEYOND:
                    return
                at = min(max(int(place), 0), TABLED - 2)
                slope = slopes[at]
                force = heights[at] + (place - at) * slope
                y -= (y - free - at_once * force) / (1.0 - at_once * slope * per_step)
            forces[S + k] = force
        forces[:S] = forces[S:]
        yield forces[S:].copy()
