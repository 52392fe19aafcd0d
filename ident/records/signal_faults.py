"""What can be wrong with a recorded signal as a signal: samples lost or repeated, tops cut off, readings that stick or wrap.

Nothing about the robot is needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ident.records.campaign import Array, Campaign, Record
from ident.records.quantisation import encoder_step

REFUSE, FLAG = "refuse", "flag"

#: Blocks a period in which a shift of the signal is looked for.
BLOCKS = 16
#: A shift counts when it leaves this part of the power that is left without it, and this part of the signal's.
EXPLAINED, LEFT = 0.25, 0.1
#: A signal is cut off where its extreme value holds this share of the samples, and this many times the samples of the
#: next values: a rounded top holds 1/(sqrt(2) - 1) = 2.4 times those of the step below it.
FLAT_SHARE, FLAT_RATIO, FLAT_LEAST = 2e-3, 4.0, 10
#: A signal that is told to less than this share of its range has no top that could be told from another level.
LEVELS = 20
#: Steps of its encoder, or changes of its speed from one sample to the next, by which an angle moves where it does not rest by chance; share
#: of a torque's samples that differ where none is twice the same by chance.
STEPS, DIFFERENT = 3.0, 0.9
#: Least share of a period for which a reading of a moving joint stays exactly where it is before it counts as stuck.
STUCK = 0.25
#: A held joint whose reading never changes has a stuck encoder when its torque moves by more than this part of the multisine.
ALIVE = 1e-3
#: Times what noise makes of the mean of some periods that what is the same in all of them is at least.
OF_NOISE = 0.5
#: A leap between two samples is this many times the change that nine in ten do not reach.
JUMP = 20.0


@dataclass(frozen=True)
class Fault:
    """`name` of the fault, `joint` and `record` where it is (empty: all of them), one `line` for a person with the remedy.

    `severity` "refuse": the numbers would be wrong; "flag": they may be.
    """

    name: str
    joint: str
    record: str
    line: str
    severity: str


def of_signals(campaign: Campaign, record: Record) -> Iterator[Fault]:
    """Yields what is wrong with the signals of one record."""
    i = campaign.joints.index(record.excited)
    if lost := lost_samples(record, i):
        yield Fault("lost samples", "", record.id, f"record {record.id}: {lost}", REFUSE)
    for j, name in enumerate(campaign.joints):
        where, theta, tau = f"record {record.id}: {name}: ", record.theta[:, j], record.tau[:, j]
        # a welded joint rests, and so does its torque; one held by its motor may rest between two counts, its torque then too but for noise
        S = record.samples_per_period
        still = stuck(theta, S) if j == i else np.ptp(theta) == 0 and answers(tau, S) > ALIVE * record.rms
        if still:
            line = (
                f"{where}the angle does not change while the torque does: its encoder, its cable, or friction holds it"
            )
            yield Fault("stuck encoder", name, record.id, line, REFUSE)
            continue
        if at := None if lost else jumps(theta):
            line = (
                f"{where}the angle jumps by {theta[at] - theta[at - 1]:.4g} rad at {at / campaign.fs:.4g} s: a counter that wraps "
                "(unwrap it) or lost counts"
            )
            yield Fault("jumping encoder", name, record.id, line, REFUSE)
        elif top := flat_top(theta) if j == i else None:
            line = f"{where}the angle stops at {top[0]:.6g} rad in {top[1]:.1%} of the samples: the encoder's range, or a stop"
            yield Fault("saturated encoder", name, record.id, line, REFUSE)
        if top := flat_top(tau):
            line = (
                f"{where}the torque is cut off at {top[0]:.4g} N m in {top[1]:.1%} of the samples: a limit is reached; lower "
                "the excitation (swing_rad) or the load"
            )
            yield Fault("clipped torque", name, record.id, line, REFUSE)


def answers(values: Array, period: int) -> float:
    """Standard deviation of what is the same in every `period` of a signal [T]; none where it is no more than noise makes of it."""
    periods = values.reshape(-1, period)
    noise = float(np.mean(np.var(periods, axis=0, ddof=1))) / len(periods)
    power = float(np.var(periods.mean(axis=0))) - noise
    return float(np.sqrt(power)) if power > OF_NOISE * noise else 0.0


def lost_samples(record: Record, joint: int) -> str:
    """Where samples are missing from the record or are there twice; seen in the torque and the angle of the excited `joint`.

    A block of a period that fits the last period only when shifted by whole samples has lost samples between the two; a
    row that repeats the one before, where no other period does, was made up.
    """
    theta = record.theta[:, joint]
    signals = {"torque": record.tau[:, joint]}
    if jumps(theta) is None and flat_top(theta) is None:  # what has lost its shape fits anywhere
        signals["angle"] = np.diff(theta, prepend=theta[0])
    for name, signal in signals.items():
        found = _shift(signal, record.periods, record.samples_per_period)
        if found:
            count, block = found
            about = (block + 0.5) / BLOCKS / record.f0
            what = (
                f"{abs(count)} sample{'s are' if abs(count) > 1 else ' is'} {'missing' if count > 0 else 'there twice'}"
            )
            return f"the {name} loses its period: {what} after about {about:.3g} s; record again, or cut before them"
    repeated = _repeated(record, joint)
    if repeated.size:
        first = repeated[0] * (1 / (record.f0 * record.samples_per_period))
        return (
            f"{repeated.size} rows repeat the row before them, the first at {first:.4g} s: samples were dropped and filled up; "
            "record again"
        )
    return ""


def _shift(signal: Array, periods: int, S: int) -> tuple[int, int] | None:
    """(samples missing, block from the start of the record) at the last block that is shifted against the last period."""
    if periods < 2 or S < 4 * BLOCKS:
        return None
    size = S // BLOCKS
    last = signal[-S:]
    spectrum = np.conj(np.fft.rfft(last))
    energy = np.concatenate([[0.0], np.cumsum(np.tile(last, 2) ** 2)])
    ahead = energy[size : size + S] - energy[:S]  # of `size` samples of the last period from each sample on
    shifts = np.zeros((periods - 1, BLOCKS), dtype=int)
    here = size * np.arange(BLOCKS)
    for period in range(periods - 1):
        parts = np.zeros((BLOCKS, S))
        inside = here[:, None] + np.arange(size)
        np.put_along_axis(parts, inside - here[:, None], signal[period * S + inside], axis=1)
        match = np.fft.irfft(np.conj(np.fft.rfft(parts) * spectrum), S)  # sum part[t] last[t + lag]
        power = np.sum(parts**2, axis=1)
        left = power[:, None] + ahead - 2 * match
        lag, before = np.argmin(left, axis=1), left[np.arange(BLOCKS), here]
        seen = (left.min(axis=1) < np.minimum(EXPLAINED * before, LEFT * power)) & (before > 1e-3 * power)
        shifts[period] = np.where(seen, (here - lag + S // 2) % S - S // 2, 0)
    # samples lost in the last period shift the blocks behind them in all others, and those before the gap in none
    latest, flat = shifts[-1], shifts.ravel()
    if not latest[0] and latest[-1] and (latest[-2] == latest[-1] or np.all(shifts[:, -1] == latest[-1])):
        first = int(np.flatnonzero(latest == 0)[-1]) + 1
        return int(latest[-1]), (periods - 1) * BLOCKS + first
    shifted = np.flatnonzero(flat)
    if len(shifted) < 2 or flat[shifted[-1]] != flat[shifted[-2]]:  # one block by chance is nothing
        return None
    end = int(shifted[-1]) + 1
    before_it = flat[max(end - BLOCKS, 0) : end]  # lost samples shift all of it, an encoder that leaps some by chance
    if np.count_nonzero(before_it == flat[end - 1]) < len(before_it) / 4:
        return None
    return int(flat[end - 1]), end - 1


def _repeated(record: Record, joint: int) -> NDArray[np.int64]:
    """Samples at which all torques and angles are those of the sample before, which is no chance: the angle of the `joint` moves before
    and after, or a torque that is never twice the same moves there in other periods."""
    tau, theta = record.tau[:, joint], record.theta[:, joint]
    same = np.all(np.diff(record.tau, axis=0) == 0, axis=1) & np.all(np.diff(record.theta, axis=0) == 0, axis=1)
    samples = np.flatnonzero(same) + 1
    if record.periods < 2 or not samples.size:
        return samples[:0]
    change = np.abs(np.diff(tau, prepend=tau[0])).reshape(record.periods, -1)
    usual = np.median(change, axis=0)
    moves = usual[samples % record.samples_per_period] > 0.2 * np.median(usual)
    moves &= len(np.unique(tau)) > DIFFERENT * (len(tau) - len(samples))
    speed = np.concatenate([[0.0], np.diff(theta), [0.0]])
    rough = max(float(encoder_step(theta[:, None])[0]), float(np.std(np.diff(speed, 2))))
    runs = np.split(np.arange(len(samples)), np.flatnonzero(np.diff(samples) > 1) + 1)
    for run in runs:
        before, after = speed[samples[run[0]] - 1], speed[samples[run[-1]] + 1]
        moves[run] |= before * after > 0.0 and min(abs(before), abs(after)) > STEPS * rough
    chosen = samples[moves]
    chosen = chosen[chosen > np.argmax(change.ravel() > 0.0)]  # before the excitation begins nothing moves
    return chosen if chosen.size < 0.5 * len(same) else chosen[:0]


def flat_top(values: Array) -> tuple[float, float] | None:
    """(value, share of the samples) at which a signal [T] is cut off; None where its extremes are those of a free signal."""
    span = float(np.ptp(values))
    if span == 0.0:
        return None
    for sign in (1.0, -1.0):
        drop = (sign * values).max() - sign * values  # below the extreme
        at = int(np.count_nonzero(drop <= 1e-9 * span))
        if at < max(FLAT_LEAST, FLAT_SHARE * len(values)):
            continue
        levels = np.unique(drop[drop > 1e-9 * span])
        if len(levels) < LEVELS:
            continue
        step = levels[0] if len(levels) < len(values) / 10 else span / 500  # of the quantisation, where there is one
        if at > FLAT_RATIO * np.count_nonzero((drop > 1e-9 * span) & (drop <= 1.5 * step)):
            return sign * float((sign * values).max()), at / len(values)
    return None


def stuck(values: Array, period: int) -> bool:
    """Whether a signal [T] stays exactly where it is for `STUCK` of a period or longer."""
    moved = np.flatnonzero(np.diff(values))
    rests = np.diff(np.concatenate([[-1], moved, [len(values) - 1]]))
    return bool(rests.max() > STUCK * period)


def jumps(values: Array) -> int | None:
    """The first sample at which a signal [T] leaps as it does not move otherwise; None where there is none.

    A leap stands alone: a joint that breaks loose takes some samples to gather speed, and to stop.
    """
    change = np.abs(np.diff(values))
    usual = float(np.quantile(change, 0.9))
    if usual == 0.0:
        return None
    padded = np.concatenate([[0.0, 0.0], change, [0.0, 0.0]])
    beside = np.max([padded[k : k + len(change)] for k in (0, 1, 3, 4)], axis=0)
    leaps = np.flatnonzero(change > JUMP * np.maximum(usual, beside))
    return int(leaps[0]) + 1 if leaps.size else None
