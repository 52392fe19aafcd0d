"""From a commanded torque to the one that acts: gain, first-order lags and a delay that need not be whole samples."""

from __future__ import annotations

from collections import deque
from math import exp, floor

from ident.effects.base import Path

_WHOLE = 1e-9  # samples: a delay this close to a whole number of them is one


class Line:
    """One motor's torque path at rest at `start` [N m, commanded]; `steps` steps a sample, `h` [s] each.

    `push` once a sample, then `over(j)` for its steps in their order: the torque's mean over the step, which has its exact
    impulse, lag and switch between two commands included, and what its place in the step matters: the integral of
    (time left in the step) (torque - mean) [N m s2], by which the mean falls short of the momentum's own integral.
    """

    def __init__(self, path: Path, start: float, steps: int, h: float) -> None:
        samples = path.delay / (steps * h)
        whole = floor(samples + _WHOLE)
        self._part = max(samples - whole, 0.0) * steps  # in steps, of a sample
        if self._part < _WHOLE * steps:
            self._part = 0.0
        self._gain, self._h = path.gain, h
        self._queue = deque([start] * (whole + 1), maxlen=whole + 1)
        self._old = self._new = start
        self._lags = [[time, path.gain * start] for time in path.lags if time > 0]

    def push(self, command: float) -> None:
        self._queue.append(command)
        self._old, self._new = self._new, self._queue[0]

    def over(self, j: int) -> tuple[float, float]:
        h = self._h
        old = min(max(self._part - j, 0.0), 1.0)  # share of the step that still has the old command
        pieces = [(old, self._gain * self._old), (1.0 - old, self._gain * self._new)]
        mean = old * pieces[0][1] + (1.0 - old) * pieces[1][1] if old else pieces[1][1]
        short = 0.5 * h * h * old * (1.0 - old) * (pieces[0][1] - pieces[1][1])
        for lag in self._lags:
            time, y = lag
            left, impulse, moved = h, 0.0, 0.0
            for share, u in pieces:
                d = share * h
                kept = exp(-d / time)
                impulse += u * d + (y - u) * time * (1.0 - kept)
                moved += u * d * (left - 0.5 * d) + (y - u) * time * (left - time + (time + d - left) * kept)
                left -= d
                y = u + (y - u) * kept
            lag[1] = y
            mean = impulse / h
            short = moved - 0.5 * h * impulse
            pieces = [(1.0, mean)]
        return mean, short
