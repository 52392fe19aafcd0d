"""A log as a fit takes it: smooth positions, velocities, accelerations and torques, and what is kept of signals made of them.

Positions are smoothed forwards and backwards up to a frequency well above the motion's own, and differentiated. What follows from them, and
the torques, are then smoothed alike up to a lower one and thinned: both sides of an equation see the same filter (M. Gautier, ICRA 1997,
DOI 10.1109/ROBOT.1997.606736).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil

import numpy as np
from scipy.signal import butter, sosfiltfilt, sosfreqz, welch

from ident.errors import IdentError
from ident.records.log import Array, Log

#: Share of the power of the velocity that lies below the motion's band.
MOTION = 0.999
#: What an encoder's steps make of a velocity's power is known but for this share.
STEPS = 0.25
#: Equations are kept up to so many times that band, and at least up to this [Hz], positions up to so many times as far; both below a
#: part of the sampling rate.
KEPT, SLOWEST, SMOOTH, LIMIT = 4.0, 3.0, 4.0, 0.2
#: Samples per period of the highest frequency kept, in the equations and of positions.
EQUATIONS, FINE = 2.5, 5.0
ORDER = 4
#: Frequencies, in those up to which equations are kept, between which torques tell their noise.
ABOVE = (1.5, 3.0)
#: Periods of the highest frequency kept that filters spoil at each end.
SPOILT = 2.0
#: Least samples of a trajectory that a fit can take.
LEAST = 40


@dataclass(frozen=True, eq=False)
class Bands:
    """Frequencies [Hz]: of the `motion`, up to which `equations` are kept, up to which `positions` are smooth."""

    motion: float
    equations: float
    positions: float


@dataclass(frozen=True, eq=False)
class Moves:
    """One trajectory: positions `q`, velocities `v`, accelerations `a`, torques `tau` and their rates [S, n], joint side, `fs` [Hz]."""

    id: str
    q: Array
    v: Array
    a: Array
    tau: Array
    tau_rate: Array
    fs: float
    bands: Bands

    def kept(self, signals: Array) -> Array:
        """What a fit takes of signals [S, ..] of this motion: smoothed up to the equations' band and thinned, the ends left out."""
        return np.asarray(self._through(self._band, signals)[self._use()])

    def above(self, signals: Array) -> Array:
        """Signals [S, ..] between the frequencies `ABOVE`, the ends left out."""
        return np.asarray(self._through(self._beyond, signals)[self._use().start : self._use().stop])

    @property
    def beyond(self) -> tuple[float, float]:
        """The power of white noise in what is kept, of that in what is above; and how many samples of their own the latter is worth."""
        gains = []
        for sos in (self._band, self._beyond):
            f, response = sosfreqz(sos, 4096, fs=self.fs)
            _, smooth = sosfreqz(_low(self.bands.positions, self.fs), f, fs=self.fs)
            gains.append(float(np.mean(np.abs(response * smooth) ** 4)))
        return gains[0] / gains[1], 2.0 * gains[1] * len(range(*self._use().indices(len(self.q)))) * self._use().step

    @property
    def times(self) -> Array:
        """The times [s] of what is kept."""
        return np.arange(len(self.q))[self._use()] / self.fs

    @cached_property
    def _band(self) -> Array:
        return _low(self.bands.equations, self.fs)

    @cached_property
    def _beyond(self) -> Array:
        ends = [share * self.bands.equations for share in ABOVE]
        return np.asarray(butter(ORDER, ends, "bandpass", fs=self.fs, output="sos"))

    def _through(self, sos: Array, signals: Array) -> Array:
        pad = min(len(signals) - 1, _pad(self.fs, self.bands.equations))
        return np.asarray(sosfiltfilt(sos, signals, axis=0, padlen=pad))

    def _use(self) -> slice:
        spoilt = ceil(SPOILT * self.fs / self.bands.equations)
        return slice(spoilt, len(self.q) - spoilt, max(1, int(self.fs / (EQUATIONS * self.bands.equations))))


def bands(log: Log) -> Bands:
    """The frequencies that a log's motion asks for: those of the fastest joint."""
    highest = LIMIT * log.fs
    motion = max(_band(one.q[:, j], log.fs) for one in log.trajectories for j in range(log.n))
    equations = min(max(KEPT * motion, SLOWEST), highest / SMOOTH)
    return Bands(motion, equations, min(SMOOTH * equations, highest))


def _band(q: Array, fs: float) -> float:
    """The frequency [Hz] below which the velocity of an angle has nearly all of the power that the steps of its encoder do not make."""
    change = np.diff(q)
    f, power = welch(change * fs, fs, nperseg=min(len(change), 2 ** ceil(np.log2(20.0 * fs))), detrend="constant")
    step = float(np.min(np.abs(change[change != 0.0]), initial=np.inf))
    steps = (step * np.sin(np.pi * f / fs)) ** 2 * fs * 2.0 / 3.0 if step < np.inf else np.zeros(len(f))
    total = np.maximum.accumulate(np.cumsum(power - steps))
    share = MOTION - STEPS * float(np.sum(steps)) / total[-1] if total[-1] > 0.0 else 0.0
    return float(f[np.searchsorted(total, share * total[-1])]) if share > 0.0 else 0.0


def moves(log: Log) -> tuple[Moves, ...]:
    """Returns all trajectories, smoothed. IdentError, one line: one that is too short, or a log in which nothing moves."""
    found = bands(log)
    if found.motion == 0.0:
        raise IdentError("no joint moves in this log; expected trajectories")
    sos = _low(found.positions, log.fs)
    every = max(1, int(log.fs / (FINE * found.positions)))
    result = []
    for one in log.trajectories:
        pad = _pad(log.fs, found.positions)
        if len(one.q) <= 2 * pad:
            raise IdentError(f"trajectory {one.id}: {len(one.q)} samples, expected more than {2 * pad}")
        q, tau = (sosfiltfilt(sos, x, axis=0, padlen=pad) for x in (one.q, one.tau))
        v, rate = (np.gradient(x, 1.0 / log.fs, axis=0) for x in (q, tau))
        a = np.gradient(v, 1.0 / log.fs, axis=0)
        thin = [np.ascontiguousarray(x[::every]) for x in (q, v, a, tau, rate)]
        move = Moves(one.id, thin[0], thin[1], thin[2], thin[3], thin[4], log.fs / every, found)
        if len(move.times) < LEAST:
            raise IdentError(
                f"trajectory {one.id}: {len(one.q) / log.fs:.3g} s hold {len(move.times)} samples up to {found.equations:.3g} Hz, expected "
                f"at least {LEAST}"
            )
        result.append(move)
    return tuple(result)


def _low(frequency: float, fs: float) -> Array:
    return np.asarray(butter(ORDER, frequency, fs=fs, output="sos"))


def _pad(fs: float, frequency: float) -> int:
    return ceil(3.0 * fs / frequency)
