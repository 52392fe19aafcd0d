"""Trajectories of a real machine -> Log: the files of other programs, read as a map.toml with a [log] says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ident.machines.mapping import Map
from ident.machines.readers import read_variables
from ident.machines.sampling import CLOCK, rounded_rate, stamps
from ident.machines.source_file import JITTER, SourceFile, in_words
from ident.records.log import Array, Log, Trajectory

#: Time stamps further apart than this many samples leave a hole that nothing is interpolated over.
GAP = 3.5
#: A step of so many usual ones is more than one.
LONG = 2.2
#: Least samples that a trajectory has.
LEAST = 100


@dataclass(frozen=True)
class ImportedLog:
    """The log, one line a trajectory that says what was found, and `notes` on what a person should look at."""

    log: Log
    records: tuple[str, ...]
    notes: tuple[str, ...]


def import_log(mapping: Map, files: Sequence[str | Path]) -> ImportedLog:
    """Returns the log whose trajectories are the files, in this order, read as the map says.

    ImportingError, one line that names file, variable and what is missing: a signal that is not there or not finite, signals of different
    lengths, a hole in the time stamps, another sampling rate than the first file's.
    """
    runs: list[Trajectory] = []
    lines, notes = [], []
    fs = 0.0
    for k, path in enumerate(map(Path, files)):
        file = SourceFile(path, read_variables(path), mapping.of(path))
        run, rate, note = _trajectory(file, mapping, f"{k + 1:04d}")
        if fs and rate != fs:
            raise file.error(f"sampled at {rate:.10g} Hz, {files[0]} at {fs:.10g} Hz; expected one rate in a log")
        fs = rate
        file.once(run, runs, files)
        runs.append(run)
        moved = ", ".join(f"{span:.3g}" for span in np.ptp(run.q, axis=0))
        lines.append(f"{run.id}  {path.name}: {len(run.q)} samples at {fs:g} Hz, joints move over {moved}")
        notes += [f"{path.name}: {note}"] if note else []
    joints = mapping.joints
    currents = [joint.name for joint in joints if joint.signals["torque"].current]
    if currents:
        notes.append(f"{', '.join(currents)}: no torque constant is known: read A for N m, A s2/rad for kg m2")
    log = Log(
        urdf=mapping.urdf,
        joints=tuple(joint.name for joint in joints),
        fs=fs,
        N=np.array([joint.N for joint in joints]),
        J_m=np.array([joint.J_m for joint in joints]),
        gravity=np.array(mapping.gravity),
        source=in_words(mapping.source, files),
        trajectories=tuple(runs),
        currents=tuple(currents),
    )
    return ImportedLog(log, tuple(lines), tuple(notes))


def _trajectory(file: SourceFile, mapping: Map, id: str) -> tuple[Trajectory, float, str]:
    """The trajectory, its sampling rate [Hz], and a note on its time stamps."""
    how, joints = file.how, mapping.joints
    played = joints[0].signals["torque"]
    samples = len(file.samples(played, f"{joints[0].name}: torque"))
    stop = samples if how.samples is None else how.skip + how.samples
    if stop > samples or stop - how.skip < LEAST:
        raise file.error(
            f"{samples} samples, {how.skip} skipped; expected at least {max(how.samples or 0, LEAST)} behind them"
        )
    use = slice(how.skip, stop)
    t, fs, note = _times(file, use, samples)
    file.one_clock(played, joints, use, samples, fs)

    def columns(key: str) -> Array:
        return np.stack([file.signal(joint, key, use, stop - how.skip, 0.0) for joint in joints], axis=1)

    N = np.array([joint.N for joint in joints])
    q = columns("link_angle") if "link_angle" in joints[0].signals else columns("motor_angle") / N
    tau = columns("torque") * N
    if t is not None:
        even = t[0] + np.arange(int((t[-1] - t[0]) * fs + 1e-9) + 1) / fs
        q, tau = (np.stack([np.interp(even, t, column) for column in x.T], axis=1) for x in (q, tau))
    return Trajectory(id, q, tau), fs, note


def _times(file: SourceFile, use: slice, samples: int) -> tuple[Array | None, float, str]:
    """Time stamps [T, s] that signals are to be interpolated between, None where their steps are even; the sampling rate [Hz]; a note."""
    how = file.how
    if how.time is None:
        if how.fs is None:
            raise file.error("the map says neither sample_rate_Hz nor time; expected one of them in [record]")
        return None, how.fs, ""
    t = stamps(file, how.time, use, samples)
    step = np.diff(t)
    long = step[step > LONG * np.median(step)] / np.median(step)
    measured = float(len(step) + np.sum(np.round(long) - 1.0)) / float(t[-1] - t[0])
    fs = how.fs or rounded_rate(measured, CLOCK)
    if abs(measured - fs) > 0.5 * fs:
        raise file.error(f"time stamps say {measured:.6g} Hz, sample_rate_Hz = {fs:g}; expected one rate")
    if (worst := float(step.max()) * fs) > GAP:
        k = int(np.argmax(step))
        raise file.error(
            f"time: {round(worst) - 1} samples are missing after sample {use.start + k}, at {t[k]:.6g} s; expected none: take what is before "
            "(samples) or behind (skip_samples)"
        )
    off = np.abs(t - t[0] - np.arange(len(t)) / fs) * fs
    if off.max() <= JITTER:
        return None, fs, ""
    return (
        t,
        fs,
        f"time stamps are up to {off.max():.2g} samples from an even grid of {fs:g} Hz: signals are interpolated to it",
    )
