"""Records of a real machine -> Campaign: the files of other programs, read as a map.toml says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ident.errors import ImportingError
from ident.machines.mapping import AUTO, MEASURED, JointMap, Map, RecordMap, Signal
from ident.machines.readers import Variables, read_variables
from ident.records.campaign import Array, Campaign, Record
from ident.records.periodic import find_lines, find_period

#: A time stamp further than this part of a sample from an even grid is an error: the clock of the record is not even.
JITTER = 0.25
#: Relative difference between a sampling rate said and one read from time stamps, beyond which one of them is wrong.
CLOCK = 1e-3
#: A sampling rate read from time stamps is taken as a round number within this of it: clocks are no better.
_ROUND = 1e-4
#: What tells when a message of a topic was taken, the better first: by its sender, by the recorder.
_CLOCKS = ("header/stamp", "log_time")
#: Relative difference allowed between f0 said and sampling rate over period: a few roundings.
_SAME = 1e-6
#: A joint that rested no further from 0 than this [rad or m] shows nothing of its gear at rest.
RESTS = 0.05
#: Share of the lines, at either end of the band, at which signs are judged: there a motor moves like a mass.
_ENDS = 0.1


@dataclass(frozen=True)
class Imported:
    """The campaign, one line a record that says what was found, and `notes` on what a person should look at."""

    campaign: Campaign
    records: tuple[str, ...]
    notes: tuple[str, ...]


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
        if signal.name not in self.variables:
            close = [name for name, value in self.variables.items() if value.ndim]
            shown = ", ".join(close[:20]) + (", .." if len(close) > 20 else "")
            raise self.error(f"{what}: no variable {signal.name!r}; the file has {shown or 'no signals'}")
        values = self.variables[signal.name]
        if values.ndim == 0:
            raise self.error(f"{what}: {signal.name!r} is one number; expected samples")
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


def import_files(mapping: Map, files: Sequence[str | Path]) -> Imported:
    """Returns the campaign whose records are the files, in this order, read as the map says.

    ImportingError, one line that names file, variable and what is missing: a signal that is not there or not finite,
    dropped samples, signals of different lengths or clocks, no whole number of samples a period, no period at all,
    excited lines that can not be told.
    """
    paths = [Path(file) for file in files]
    if len({path.name for path in paths}) < len(paths):
        raise ImportingError("two files of one name; expected different names, by which the map can tell them apart")
    records, lines, notes = [], [], []
    rates: list[float] = []
    for k, path in enumerate(paths):
        file = SourceFile(path, read_variables(path), mapping.of(path))
        record, fs = _record(file, mapping, f"{k + 1:04d}", rates[0] if rates else None)
        rates.append(fs)
        if fs != rates[0]:
            raise file.error(
                f"sampled at {fs:.10g} Hz, {paths[0]} at {rates[0]:.10g} Hz; expected one rate in a campaign "
                "(if the clocks are off, sample_rate_Hz says which)"
            )
        records.append(record)
        lines.append(_summary(record, fs, path))
        notes += _signs(record, mapping)
    unused = sorted(set(mapping.files) - {path.name for path in paths})
    notes += [f"{mapping.path}: [file.{name!r}]: no such file among those imported" for name in unused]
    currents = [joint.name for joint in mapping.joints if joint.signals["torque"].current]
    said = mapping.source
    if currents and len(mapping.joints) > 1:
        raise ImportingError(
            f"{mapping.path}: torque of {', '.join(currents)} in A without torque_constant_Nm_per_A: of several joints that pull on each other "
            "nothing is told then, as their torques have no unit in common; expected each joint's torque constant"
        )
    if currents:
        unit = "no torque constant is known: read A for N m, A s2/rad for kg m2 and A/rad for N m/rad"
        said += f"; torque of {', '.join(currents)} in A, {unit}"
        notes.append(f"{', '.join(currents)}: {unit}")
    notes += _untold_gears(mapping, records)
    campaign = Campaign(
        urdf=mapping.urdf,
        joints=tuple(joint.name for joint in mapping.joints),
        fs=rates[0],
        hold=mapping.hold,
        N=np.array([joint.N for joint in mapping.joints]),
        J_m=np.array([joint.J_m for joint in mapping.joints]),
        K=np.array([joint.K for joint in mapping.joints]),
        gravity=np.array(mapping.gravity),
        source=f"{said}; files {', '.join(path.name for path in paths)}",
        records=tuple(records),
    )
    return Imported(campaign, tuple(lines), tuple(notes))


def _record(file: SourceFile, mapping: Map, id: str, first: float | None) -> tuple[Record, float]:
    """The record, and its sampling rate [Hz]; `first` is that of the first file."""
    how, joints = file.how, mapping.joints
    names = [joint.name for joint in joints]
    excited = how.excited or (names[0] if len(names) == 1 else None)
    if excited is None:
        raise file.error(f"excited: the map does not say which joint; expected one of {', '.join(names)}")
    played = how.reference or joints[names.index(excited)].signals["torque"]
    samples = len(file.samples(played, "reference"))
    if how.skip >= samples:
        raise file.error(f"skip_samples = {how.skip}, but {played.name!r} has {samples} samples; expected fewer")
    period = _period(file, played, samples)
    periods = _periods(file, samples - how.skip, period)
    use = slice(how.skip, how.skip + periods * period)
    fs = _sampling_rate(file, use, samples, first)
    file.one_clock(played, joints, use, samples, fs)
    if how.f0 is not None and abs(how.f0 * period - fs) > _SAME * fs:
        raise file.error(f"f0_Hz = {how.f0:g} is not sampling rate / period = {fs:g} / {period} = {fs / period:g} Hz")
    lines = _lines(file, file.reading(played, "reference", use), period)
    posture = _posture(file, joints, use, period)

    def columns(key: str) -> Array | None:
        if key not in joints[0].signals or key not in joints[-1].signals:
            return None
        chosen = [file.signal(joint, key, use, period, rest) for joint, rest in zip(joints, posture, strict=True)]
        return np.stack(chosen, axis=1)

    tau, theta = columns("torque"), columns("motor_angle")
    assert tau is not None and theta is not None  # the map has them
    record = Record(
        id=id,
        excited=excited,
        posture=posture,
        f0=fs / period,
        lines=lines,
        samples_per_period=period,
        periods=periods,
        rms=_rms(tau[-period:, names.index(excited)], lines),
        tau=tau,
        theta=theta,
        omega=columns("motor_velocity") if all("motor_velocity" in joint.signals for joint in joints) else None,
        q_link=columns("link_angle"),
    )
    return record, fs


def _sampling_rate(file: SourceFile, use: slice, samples: int, first: float | None = None) -> float:
    """The sampling rate [Hz], from time stamps where there are any; samples dropped on the way are named.

    A rate that differs from the `first` file's by no more than clocks do is that one.
    """
    how = file.how
    if how.time is None:
        if how.fs is None:
            raise file.error("the map says neither sample_rate_Hz nor time; expected one of them in [record]")
        return how.fs
    if (found := len(file.samples(how.time, "time"))) != samples or use.stop - use.start < 3:
        raise file.error(f"time: {how.time.name!r} has {found} samples, expected {max(samples, use.start + 3)}")
    t = file.reading(how.time, "time", use) * how.time.scale
    step = np.diff(t)
    if (step <= 0).any():
        k = int(np.argmax(step <= 0))
        raise file.error(f"time: {how.time.name!r} does not increase after sample {use.start + k}, at {t[k]:.6g} s")
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
            f"allowed {JITTER:g}"
        )
    if first is not None and abs(measured - first) <= _ROUND * first:
        return how.fs or first
    return how.fs or rounded_rate(measured, _ROUND)


def rounded_rate(measured: float, within: float) -> float:
    """The sampling rate [Hz] of as many digits as a measured one has `within` this share of itself, if it is that near; else the measured one."""
    near = float(f"{measured:.{round(-np.log10(within))}g}")
    return near if abs(measured - near) <= within * near else measured


def _period(file: SourceFile, played: Signal, samples: int) -> int:
    """Samples a period: said, or found from all behind skip_samples, where then none may be dropped."""
    if file.how.period != AUTO:
        return int(file.how.period)
    behind = slice(file.how.skip, samples)
    _sampling_rate(file, behind, samples)
    period = find_period(file.reading(played, "reference", behind))
    if period is None:
        raise file.error(
            "no period found, so no multisine record; expected at least two equal periods (say period_samples if it has them)"
        )
    return period


def _periods(file: SourceFile, samples: int, period: int) -> int:
    there = max(samples, 0) // period
    wanted = there if file.how.periods is None else file.how.periods
    if not 2 <= wanted <= there:
        raise file.error(f"{there} whole periods of {period} samples, expected {max(wanted, 2)}")
    return wanted


def _lines(file: SourceFile, reference: Array, period: int) -> NDArray[np.int64]:
    if not isinstance(file.how.lines, str):
        lines = np.array(file.how.lines, dtype=np.int64)
        if 2 * lines[-1] >= period:
            raise file.error(f"lines: {lines[-1]} is not below half of {period} samples a period")
        return lines
    found = find_lines(reference, period)
    if found is None:
        raise file.error(
            "lines: none stand out of the reference's spectrum, so no multisine is seen; say which are excited"
        )
    return found


def _posture(file: SourceFile, joints: Sequence[JointMap], use: slice, period: int) -> Array:
    """The link angles at rest [n, rad]: said, or the mean of the motor angles over the last period."""
    posture = file.how.posture
    if posture is None:
        raise file.error('posture_rad: the map does not say; expected the link angles at rest, or "measured"')
    if posture != MEASURED:
        return np.array(posture, dtype=float)
    for joint in joints:
        if joint.signals["motor_angle"].offset is None:
            raise file.error(f'{joint.name}: posture_rad "measured" and offset "posture" take each from the other')
        if _wraps_within_a_turn(joint):
            raise file.error(
                f'{joint.name}: posture_rad "measured", but its motor_angle wraps within a turn of the joint, so it does not tell which; '
                "expected the link angles at rest"
            )
    angles = [file.signal(joint, "motor_angle", use, period, 0.0)[-period:].mean() / joint.N for joint in joints]
    return np.array(angles)


def _wraps_within_a_turn(joint: JointMap) -> bool:
    """Whether readings of the motor's angle repeat themselves for angles of the joint less than a turn apart."""
    signal = joint.signals["motor_angle"]
    if signal.wrap is None:
        return False
    gear = 1.0 if signal.joint_side else abs(joint.N)
    return bool(abs(signal.wrap * signal.scale) / gear < 2 * np.pi * (1.0 - 1e-6))


def _rms(tau: Array, lines: NDArray[np.int64]) -> float:
    """RMS of the excited lines in one period of torque."""
    return float(np.sqrt(2) * np.linalg.norm(np.fft.rfft(tau)[lines]) / len(tau))


def _spectra(record: Record, values: Array) -> NDArray[np.complex128]:
    """The excited lines [L, n] of the mean over all periods but the first."""
    S = record.samples_per_period
    mean = values.reshape(-1, S, values.shape[1])[1:].mean(axis=0)
    return np.asarray(np.fft.rfft(mean, axis=0)[record.lines])


def _signs(record: Record, mapping: Map) -> list[str]:
    """A note for the excited joint if torque and motor, or motor and link, seem to turn in opposite directions.

    Far below and far above its modes a motor moves like a mass: in antiphase with its torque.
    """
    k = [joint.name for joint in mapping.joints].index(record.excited)
    tau, theta = _spectra(record, record.tau)[:, k], _spectra(record, record.theta)[:, k]
    count = max(1, round(_ENDS * len(record.lines)))
    notes = []
    both = np.conj(tau) * theta
    if min(np.median(both[:count].real), np.median(both[-count:].real)) > 0:
        notes.append(
            f"record {record.id}: torque and motor angle of {record.excited} seem of opposite sign: check the map"
        )
    if record.q_link is not None:
        link = _spectra(record, record.q_link)[:, k] * mapping.joints[k].N
        share = float(np.median((np.conj(theta) * link)[:count].real / np.abs(theta[:count]) ** 2))
        if share < 0:
            notes.append(
                f"record {record.id}: motor and link angle of {record.excited} are of opposite sign: check the map"
            )
        elif not 0.5 < share < 2:
            notes.append(
                f"record {record.id}: at the lowest lines the link of {record.excited} moves {share:.2g} times as far as its motor "
                "says; expected 1: check N, counts and units"
            )
    return notes


def _untold_gears(mapping: Map, records: Sequence[Record]) -> list[str]:
    """A note if there are joints of whose gear no angle at rest tells anything."""
    at_zero = np.abs([record.posture for record in records]).max(axis=0) <= RESTS
    names = [joint.name for joint, zero in zip(mapping.joints, at_zero, strict=True) if zero and joint.N != 1]
    if not names:
        return []
    gears = "gear ratio and sign of" if len(names) == 1 else "gear ratios and signs of"
    was = "it rested" if len(names) == 1 else "they rested"
    return [f"{gears} {', '.join(names)} are taken as declared: {was} at 0 in all records"]


def _summary(record: Record, fs: float, path: Path) -> str:
    lines = record.lines * record.f0
    return (
        f"{record.id}  {path.name}: {record.excited} excited, {record.periods} periods of {record.samples_per_period} "
        f"samples at {fs:g} Hz, {len(lines)} lines from {lines[0]:g} to {lines[-1]:g} Hz, rms {record.rms:.4g}"
    )
