"""The sampling rate of a foreign file, as the map says it and its time stamps tell it."""

from __future__ import annotations

import numpy as np

from ident.machines.mapping import TIME_UNITS, Signal
from ident.machines.source_file import JITTER, SourceFile
from ident.machines.toml_table import RATES
from ident.records.campaign import Array

#: Relative difference between a sampling rate said and one read from time stamps, beyond which one of them is wrong.
CLOCK = 1e-3
#: A sampling rate read from time stamps is taken as a round number within this of it: clocks are no better.
_ROUND = 1e-4


def sampling_rate(file: SourceFile, use: slice, samples: int, first: float | None = None) -> float:
    """The sampling rate [Hz], from time stamps where there are any; samples dropped on the way are named.

    A rate that differs from the `first` file's by no more than clocks do is that one.
    """
    how = file.how
    if how.time is None:
        if how.fs is None:
            raise file.error("the map says neither sample_rate_Hz nor time; expected one of them in [record]")
        return how.fs
    t = stamps(file, how.time, use, samples)
    step = np.diff(t)
    Ts = float(np.median(step)) if how.fs is None else 1.0 / how.fs
    count = np.maximum(np.round(step / Ts), 1)
    if (count > 1).any():
        k = int(np.argmax(count > 1))
        if np.median(count) > 1:
            raise file.error(
                f"time stamps are {np.median(step):.6g} s apart, sample_rate_Hz = {how.fs:g}; expected one rate"
            )
        lost = int((count - 1).sum())
        raise file.error(
            f"{lost} samples were dropped, the first {int(count[k]) - 1} after sample {use.start + k}, at {t[k]:.6g} "
            "s; expected none: take whole periods before (period_samples and periods) or behind (skip_samples)"
        )
    measured = (len(t) - 1) / float(t[-1] - t[0])
    if how.fs is not None and abs(measured - how.fs) > CLOCK * how.fs:
        raise file.error(f"time stamps say {measured:.6g} Hz, sample_rate_Hz = {how.fs:g}; expected one rate")
    grid = t[0] + np.arange(len(t)) / measured
    worst = int(np.argmax(np.abs(t - grid)))
    if abs(t[worst] - grid[worst]) > JITTER * Ts:
        raise file.error(
            f"time: sample {use.start + worst} is {(t[worst] - grid[worst]) / Ts:+.2g} samples from an even grid, "
            f"allowed {JITTER:g}; expected samples of an even clock (if only their stamps are late: sample_rate_Hz in the place of time)"
        )
    if first is not None and abs(measured - first) <= _ROUND * first:
        return how.fs or first
    return how.fs or rounded_rate(measured, _ROUND)


def stamps(file: SourceFile, time: Signal, use: slice, samples: int) -> Array:
    """The time stamps in `use` [s]: as many as there are `samples`, increasing, at a rate that a machine may have."""
    if (found := len(file.samples(time, "time"))) != samples or use.stop - use.start < 3:
        raise file.error(f"time: {time.name!r} has {found} samples, expected {max(samples, use.start + 3)}")
    values = file.reading(time, "time", use)
    t, step = values * time.scale, np.diff(values)
    if (step <= 0).any():
        k = int(np.argmax(step <= 0))
        raise file.error(f"time: {time.name!r} does not increase after sample {use.start + k}, at {t[k]:.6g} s")
    rate, (low, high) = 1.0 / (float(np.median(step)) * time.scale), RATES
    if not low <= rate <= high:
        rates = {unit: 1.0 / (float(np.median(step)) * size) for unit, size in TIME_UNITS.items()}
        likely = " or ".join(f"{unit} ({rate:.4g} Hz)" for unit, rate in rates.items() if low <= rate <= high)
        raise file.error(
            f"time: {time.name!r} says {rate:.4g} Hz, expected {low:g} to {high:g} Hz"
            + (f"; its unit is more likely {likely}" if likely else "")
        )
    return t


def rounded_rate(measured: float, within: float) -> float:
    """The sampling rate [Hz] of as many digits as a measured one has `within` this share of itself, if it is that near; else the measured one."""
    near = float(f"{measured:.{round(-np.log10(within))}g}")
    return near if abs(measured - near) <= within * near else measured
