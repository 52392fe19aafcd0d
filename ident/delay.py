"""From a commanded torque to the one that acts: gain, first-order lags and a delay that need not be whole samples."""

from __future__ import annotations

from collections import deque
from math import exp, floor

from ident.effects.base import Path

_WHOLE = 1e-9  # samples: a delay this close to a whole number of them is one


class Line:
    """One motor's torque path at rest at `start` [N m, commanded]; `steps` steps a sample, `h` [s] each.

    `push` once a sample, then `mean(j)` for its steps in their order: the torque's mean over the step, which has its exact
    impulse, lag and switch between two commands included.
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

    def mean(self, j: int) -> float:
        old = min(max(self._part - j, 0.0), 1.0)  # share of the step that still has the old command
        pieces = [(old, self._gain * self._old), (1.0 - old, self._gain * self._new)]
        if not self._lags:
            return pieces[0][0] * pieces[0][1] + pieces[1][0] * pieces[1][1] if old else pieces[1][1]
        torque = 0.0
        for lag in self._lags:
            time, y = lag
            torque = 0.0
            for share, u in pieces:
                kept = exp(-share * self._h / time)
                torque += share * u + (y - u) * (1.0 - kept) * time / self._h
                y = u + (y - u) * kept
            lag[1] = y
            pieces = [(1.0, torque)]
        return torque
