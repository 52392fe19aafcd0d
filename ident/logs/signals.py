"""What can be wrong with the signals of a trajectory, whatever the robot: angles that wrap, freeze or leave their range, rows that are lost, tops cut off."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from ident.records.log import Array, Log, Trajectory
from ident.records.signal_faults import REFUSE, Fault, jumps

#: No joint moves by this part of all its way from one sample to the next.
LEAP = 0.5
#: A reading that stays exactly where it is for so long [s, samples] though its joint moved by so many of its steps in the time is frozen.
FROZEN, LEAST, STEPS = 0.1, 20, 30.0
#: Its joint moves by the speed of so many samples before or after, if that is this share of the mean one.
NEAR, SLOW = 8, 0.3
#: An angle that goes on by so many of its steps at once is not read at every sample.
HELD = 5.0
#: Ways from one sample to the next are even when they differ by less than this share; they count where they are so many times what they scatter by,
#: and so many steps of the encoder. A log that has lost so many rows is refused.
EVEN, CLEARLY, COUNTS, LOST = 0.3, 15.0, 8.0, 3


def of_signals(log: Log) -> Iterator[Fault]:
    """Yields what is wrong with the signals of a log."""
    for run in log.trajectories:
        wrong = [fault for j in range(log.n) if (fault := _angle(log, run, j)) is not None]
        yield from wrong
        if not wrong and (rows := lost_rows(run.q)).size >= LOST:
            line = (
                f"trajectory {run.id}: {rows.size} rows are missing, the first after {rows[0] / log.fs:.4g} s: every joint that moves goes two "
                "steps or more there; import it with time stamps (time), or record again"
            )
            yield Fault("lost samples", "", run.id, line, REFUSE)


def _angle(log: Log, run: Trajectory, j: int) -> Fault | None:
    """What is wrong with the angle of one joint."""
    name, q, where = log.joints[j], run.q[:, j], f"trajectory {run.id}: {log.joints[j]}: "
    if (ends := frozen(q, log.fs)) is not None:
        line = (
            f"{where}the angle stays exactly where it is from {ends[0] / log.fs:.4g} to {ends[1] / log.fs:.4g} s while the joint moves: its "
            "encoder or its cable; cut the trajectory there, or record again"
        )
        return Fault("stuck encoder", name, run.id, line, REFUSE)
    if (samples := held(q)) > 1:
        line = (
            f"{where}the angle is read anew at every {samples}th sample only, at {log.fs / samples:.4g} Hz: import these samples alone, or an angle "
            "that is read as often as the torque"
        )
        return Fault("held angle", name, run.id, line, REFUSE)
    if (at := leap(q)) is not None:
        line = (
            f"{where}the angle jumps by {q[at] - q[at - 1]:.4g} (joint side) at {at / log.fs:.4g} s: a counter that wraps (unwrap it "
            "before the import) or lost counts"
        )
        return Fault("jumping encoder", name, run.id, line, REFUSE)
    return None


def leap(q: Array) -> int | None:
    """The first sample at which an angle [T] leaps; None where it moves on."""
    change = np.abs(np.diff(q))
    far = np.flatnonzero(change > LEAP * np.ptp(q)) if np.median(change) < 0.1 * LEAP * np.ptp(q) else np.zeros(0, int)
    return int(far[0]) + 1 if far.size else jumps(q)


def frozen(q: Array, fs: float) -> tuple[int, int] | None:
    """The first stretch (first, last sample) in which a reading [T] freezes though its joint moves; None where there is none."""
    change = np.abs(np.diff(q))
    moved = np.flatnonzero(change)
    if moved.size < LEAST:
        return None
    step, speed = change[moved].min(), change[moved].mean()
    usual = np.quantile(np.diff(moved), 0.99)  # of an encoder so coarse that it rests between counts
    ends = np.concatenate([[-1], moved, [len(change)]])
    long = np.flatnonzero(np.diff(ends) - 1 >= max(LEAST, FROZEN * fs, 5 * usual))
    for first, last in zip(ends[long] + 1, ends[long + 1], strict=True):
        beside = (change[max(first - NEAR, 0) : first], change[last + 1 : last + 1 + NEAR])
        speeds = [one.mean() for one in beside if len(one) == NEAR]
        if any(one * (last - first) > STEPS * step and one > SLOW * speed for one in speeds):
            return int(first), int(last)
    return None


def held(q: Array) -> int:
    """How many samples an angle [T] stays the same before it goes on by many of its steps; 1 where it is read anew at each."""
    change = np.abs(np.diff(q))
    moved = np.flatnonzero(change)
    if moved.size < LEAST or np.median(change[moved]) < HELD * change[moved].min():
        return 1
    return int(np.median(np.diff(moved)))


def lost_rows(q: Array) -> NDArray[np.int64]:
    """The samples of angles [T, n] before which rows are lost: each joint that moves clearly moves as far there, once, as in two steps or more."""
    for_it, against = np.zeros(len(q) - 1, dtype=bool), np.zeros(len(q) - 1, dtype=bool)
    for column in q.T:
        change = np.diff(column)
        around = median_filter(change, 9)
        off = np.abs(change - around)
        step = np.min(np.abs(change[change != 0.0]), initial=np.inf)
        clear = (np.abs(around) > CLEARLY * 1.48 * np.median(off)) & (np.abs(around) > COUNTS * step)
        even = off < EVEN * np.abs(around)
        steps = np.round(np.divide(change, around, out=np.zeros(len(change)), where=clear))
        longer = (steps > 1.0) & (np.abs(change - steps * around) < EVEN * np.abs(around))
        longer[1:-1] &= even[:-2] & even[2:]
        for_it |= clear & longer
        against |= clear & ~longer
    return np.flatnonzero(for_it & ~against) + 1
