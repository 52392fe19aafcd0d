"""The motion that a force follows, instant by instant: where turns around the whole period do not find it, as in play that rattles."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from scipy.fft import next_fast_len

from ident.records.campaign import Array
from ident.records.frf import Complex

#: Points at which a law is tabled, and how much wider than the motion it was met in, either side.
TABLED, WIDER = 20000, 1.0
#: Points of the table, outside of it, that no motion goes to.
BEYOND = 1e9
#: Newton's steps to the force of an instant, which moves the port at that instant, too; points of the table by which the last one moves it.
STEPS, SETTLED = 3, 1e-9
#: Instants whose forces before them all are summed up at once.
BLOCK = 512
#: Points of the table within which a position has not changed since the instant before.
STILL = 1e-6


def marched(alone: Array, gives: Complex, law: Callable[[Array], Array], x: Array, start: Array) -> Iterator[Array]:
    """Yields the forces [S] of `law`, period after period, from `start` [S] on: at each instant that of the position
    `alone` + `gives` * force, the convolution over the last period.

    It ends where the motion goes beyond all bounds. `alone` [S] is the position without the force, `gives` [S/2 + 1] what a unit of
    it does, by harmonics; `x` [S] a motion of about the size. `law`(x) of positions [T]. Periods need not repeat each other.

    A force is its mean from one instant to the next, while the position goes straight: where it bends at once its samples would be
    another force (J.D. Parker et al., Proc. DAFx-16 (2016): antiderivative antialiasing).
    """
    S, span = len(alone), float(np.ptp(x)) or 1.0
    low = float(x.min()) - WIDER * span
    per_step = (TABLED - 1) / ((1.0 + 2.0 * WIDER) * span)
    table = law(low + np.arange(TABLED) / per_step)
    heights, slopes = table.tolist(), np.diff(table).tolist()
    sums = np.concatenate([[0.0], np.cumsum(0.5 * (table[1:] + table[:-1]))]).tolist()
    turn = np.pi * np.arange(S // 2 + 1) / S  # by half the time between instants
    as_mean = np.sinc(turn / np.pi) * np.exp(-1j * turn)
    response = np.fft.irfft(gives / as_mean, S)
    at_once, later = float(response[0]) * per_step, np.ascontiguousarray(response[:0:-1]) * per_step
    position = (alone - low) * per_step
    forces = np.concatenate([np.fft.irfft(np.fft.rfft(start) * as_mean, S), np.zeros(S)])
    force = float(forces[S - 1])
    last = float(position[-1] + later @ forces[: S - 1]) + at_once * force
    at = min(max(int(last), 0), TABLED - 2)
    behind = sums[at] + (last - at) * (heights[at] + 0.5 * (last - at) * slopes[at])
    block = min(BLOCK, S)
    long = next_fast_len(S + block, real=True)
    kernel = np.fft.rfft(response, long) * per_step
    latest = np.zeros(block)  # forces of the block until now, and what these do
    done, does = [latest[:b] for b in range(block)], [later[S - 1 - b :].dot for b in range(block)]
    while True:
        for first in range(0, S, block):
            earlier = np.fft.rfft(forces[first + 1 : first + S], long) * kernel
            free = np.fft.irfft(earlier, long)[S - 1 : S - 1 + block][: S - first] + position[first : first + block]
            for b, moved in enumerate(free.tolist()):
                moved += float(does[b](done[b]))
                y = moved + at_once * force
                for _ in range(STEPS):
                    if not -BEYOND < y < BEYOND:
                        return
                    at = min(max(int(y), 0), TABLED - 2)
                    part, slope = y - at, slopes[at]
                    height, total = heights[at] + part * slope, sums[at] + part * (heights[at] + 0.5 * part * slope)
                    way = y - last
                    if -STILL < way < STILL:
                        force, bends = height, 0.5 * slope
                    else:
                        force = (total - behind) / way
                        bends = (height - force) / way
                    step = (y - moved - at_once * force) / (1.0 - at_once * bends)
                    y -= step
                    if -SETTLED < step < SETTLED:
                        break
                latest[b], last, behind = force, y, total
            forces[S + first : S + first + len(free)] = latest[: len(free)]
        forces[:S] = forces[S:]
        yield np.fft.irfft(np.fft.rfft(forces[S:]) / as_mean, S)
