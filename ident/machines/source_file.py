"""One file of another program, as read: samples, readings and signals of joints, as a map names them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ident.errors import ImportingError
from ident.machines.mapping import JointMap, RecordMap, Signal
from ident.machines.readers import Variables, transposed
from ident.plain import as_text
from ident.records.campaign import Array, Record, is_copy
from ident.records.log import Trajectory

#: A time stamp further than this part of a sample from an even grid is an error: the clock of the record is not even.
JITTER = 0.25
#: What tells when a message of a topic was taken, the better first: by its sender, by the recorder.
_CLOCKS = ("header/stamp", "log_time")


def in_words(source: str, files: Sequence[str | Path]) -> str:
    """Where records come from: a map's words and the files' names, with "?" for what is no text in these."""
    names = ", ".join(Path(file).name for file in files)
    return as_text(f"{source}; files {names}")


@dataclass(frozen=True)
class SourceFile:
    """One file as read, and how it was recorded."""

    path: Path
    variables: Variables
    how: RecordMap

    def error(self, problem: str) -> ImportingError:
        return ImportingError(f"{self.path}: {problem}")

    def samples(self, signal: Signal, what: str) -> Array:
        """The samples [T] of a signal as the file has them."""
        if (other := self.variables.left_out.get(signal.name)) is not None:
            numbers = "seconds, or dates as 2024-05-01T12:00:00.000" if what == "time" else "numbers"
            raise self.error(f"{what}: {signal.name!r} is {other}; expected {numbers}")
        if signal.name not in self.variables:
            close = [name for name, value in self.variables.items() if value.ndim]
            shown = ", ".join(close[:20]) + (", .." if len(close) > 20 else "")
            raise self.error(f"{what}: no variable {signal.name!r}; the file has {shown or 'no signals'}")
        values = self.variables[signal.name]
        if values.ndim == 0:
            raise self.error(f"{what}: {signal.name!r} is one number; expected samples")
        if transposed(values):
            raise self.error(
                f"{what}: {signal.name!r} is {' x '.join(map(str, values.shape))}: transposed; expected a row a sample, so "
                "write its transpose to the file"
            )
        if values.ndim == 2:
            if signal.column is None or signal.column >= values.shape[1]:
                found = "no column is named" if signal.column is None else f"column {signal.column + 1} is asked for"
                raise self.error(f"{what}: {signal.name!r} has {values.shape[1]} columns, {found}")
            values = values[:, signal.column]
        elif signal.column not in (None, 0):
            raise self.error(f"{what}: {signal.name!r} has one column; column {signal.column + 1} is asked for")
        return values

    def reading(self, signal: Signal, what: str, use: slice) -> Array:
        """The samples in `use`, unwound from the first of the file on; sign, scale and offset are not in it yet."""
        values = self.samples(signal, what)
        finite = np.isfinite(values)
        if not finite[use].all():
            k = use.start + int(np.argmin(finite[use]))
            raise self.error(f"{what}: sample {k} of {signal.name!r} is {values[k]}, expected finite samples")
        if signal.wrap is None:
            return values[use]
        turned = np.zeros(len(values))
        turned[finite] = np.unwrap(values[finite], period=signal.wrap)
        return turned[use]

    def clocks(self, signal: Signal) -> dict[str, Array]:
        """The times [T, s] of the messages that a signal comes with, by `_CLOCKS`; none where it is of no topic."""
        parts = signal.name.split("/")
        topics = ("/".join(parts[:k]) for k in range(len(parts) - 1, 0, -1))
        topic = next((topic for topic in topics if f"{topic}/log_time" in self.variables), None)
        times = {clock: self.variables.get(f"{topic}/{clock}") for clock in _CLOCKS}
        shape = self.variables[signal.name].shape[:1]
        return {clock: t for clock, t in times.items() if t is not None and t.shape == shape and np.ptp(t) > 0}

    def signal(self, joint: JointMap, key: str, use: slice, period: int, rest: float) -> Array:
        """One signal of one joint in SI [T]: link angles joint side, all others motor side; `rest` is its posture."""
        signal = joint.signals[key]
        values = self.reading(signal, f"{joint.name}: {key}", use)
        zero = values[-period:].mean() if signal.offset is None else signal.offset
        values = (values - zero) * signal.scale
        ratio = 1.0 if key == "link_angle" else joint.N
        if signal.joint_side:
            values = values / ratio if key == "torque" else values * ratio
        return np.asarray(values + ratio * rest if signal.offset is None else values)

    def one_clock(self, played: Signal, joints: Sequence[JointMap], use: slice, samples: int, fs: float) -> None:
        """Raises ImportingError for a signal that is not of the reference's instants, as samples are paired by number."""
        signals = {f"{joint.name}: {key}": signal for joint in joints for key, signal in joint.signals.items()}
        if self.how.time is not None:
            signals["time"] = self.how.time
        ours = self.clocks(played)
        for what, signal in signals.items():
            if (found := len(self.samples(signal, what))) != samples:
                raise self.error(f"{what}: {signal.name!r} has {found} samples, expected {samples} as {played.name!r}")
            theirs = self.clocks(signal)
            clock = next((clock for clock in _CLOCKS if clock in ours and clock in theirs), None)
            if clock is None:
                continue
            late = (theirs[clock] - ours[clock])[use] * fs
            k = int(np.argmax(np.abs(late)))
            if abs(late[k]) > JITTER:
                raise self.error(
                    f"{what}: by {clock}, sample {use.start + k} of {signal.name!r} is {late[k]:+.3g} samples from that of "
                    f"{played.name!r}, allowed {JITTER:g}; expected signals of the same instants"
                )

    def once(
        self, record: Record | Trajectory, others: Sequence[Record | Trajectory], files: Sequence[str | Path]
    ) -> None:
        """Raises ImportingError if one of the `others`, of the `files` before, has the samples of this record."""
        copied = next((file for file, other in zip(files, others, strict=False) if is_copy(record, other)), None)
        if copied is not None:
            raise self.error(
                f"has the samples of {copied}; expected each record once, since a copy is no second measurement"
            )
