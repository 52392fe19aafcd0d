"""Records of a real machine -> Campaign: the files of other programs, read as a map.toml says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ident.errors import ImportingError
from ident.machines.import_notes import signs, untold_gears
from ident.machines.mapping import AUTO, MEASURED, JointMap, Map, Signal
from ident.machines.readers import read_variables
from ident.machines.sampling import sampling_rate
from ident.machines.source_file import SourceFile, in_words
from ident.records.campaign import Array, Campaign, Record
from ident.records.periodic import find_lines, find_period

#: Relative difference allowed between f0 said and sampling rate over period: a few roundings.
_SAME = 1e-6


@dataclass(frozen=True)
class Imported:
    """The campaign, one line a record that says what was found, and `notes` on what a person should look at."""

    campaign: Campaign
    records: tuple[str, ...]
    notes: tuple[str, ...]


def import_files(mapping: Map, files: Sequence[str | Path]) -> Imported:
    """Returns the campaign whose records are the files, in this order, read as the map says.

    ImportingError, one line that names file, variable and what is missing: a signal that is not there or not finite,
    dropped samples, signals of different lengths or clocks, no whole number of samples a period, no period at all,
    excited lines that can not be told.
    """
    paths = [Path(file) for file in files]
    if len({path.name for path in paths}) < len(paths):
        raise ImportingError("two files of one name; expected different names, by which the map can tell them apart")
    records: list[Record] = []
    lines, notes = [], []
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
        file.once(record, records, paths)
        records.append(record)
        lines.append(_summary(record, fs, path))
        notes += signs(record, mapping)
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
    notes += untold_gears(mapping, records)
    campaign = Campaign(
        urdf=mapping.urdf,
        joints=tuple(joint.name for joint in mapping.joints),
        fs=rates[0],
        hold=mapping.hold,
        N=np.array([joint.N for joint in mapping.joints]),
        J_m=np.array([joint.J_m for joint in mapping.joints]),
        K=np.array([joint.K for joint in mapping.joints]),
        gravity=np.array(mapping.gravity),
        source=in_words(said, paths),
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
    fs = sampling_rate(file, use, samples, first)
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


def _period(file: SourceFile, played: Signal, samples: int) -> int:
    """Samples a period: said, or found from all behind skip_samples, where then none may be dropped."""
    if file.how.period != AUTO:
        return int(file.how.period)
    behind = slice(file.how.skip, samples)
    sampling_rate(file, behind, samples)
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
    """The link angles at rest [n, rad]: said, or `_rest` over the last period."""
    posture = file.how.posture
    if posture is None:
        raise file.error('posture_rad: the map does not say; expected the link angles at rest, or "measured"')
    if posture != MEASURED:
        return np.array(posture, dtype=float)
    return np.array([_rest(file, joint, use, period) for joint in joints])


def _rest(file: SourceFile, joint: JointMap, use: slice, period: int) -> float:
    """Where the link rests [rad or m]: as its own encoder reads; without one, as the motor's does, over N, less what the mean torque deflects
    the spring where K and torque [N m] are known."""

    def mean(key: str) -> float:
        return float(file.signal(joint, key, use, period, 0.0)[-period:].mean())

    own = "link_angle" if "link_angle" in joint.signals else "motor_angle"
    if joint.signals[own].offset is None:
        raise file.error(
            f'{joint.name}: posture_rad "measured" and offset "posture" of its {own} take each from the other'
        )
    if _wraps_within_a_turn(joint, own):
        raise file.error(
            f'{joint.name}: posture_rad "measured", but its {own} wraps within a turn of the joint, so it does not tell which; '
            "expected the link angles at rest"
        )
    if own == "link_angle":
        return mean("link_angle")
    known = np.isfinite(joint.K) and not joint.signals["torque"].current
    return mean("motor_angle") / joint.N - (joint.N * mean("torque") / joint.K if known else 0.0)


def _wraps_within_a_turn(joint: JointMap, key: str) -> bool:
    """Whether readings of this angle repeat themselves for angles of the joint less than a turn apart."""
    signal = joint.signals[key]
    if signal.wrap is None:
        return False
    gear = 1.0 if signal.joint_side or key == "link_angle" else abs(joint.N)
    return bool(abs(signal.wrap * signal.scale) / gear < 2 * np.pi * (1.0 - 1e-6))


def _rms(tau: Array, lines: NDArray[np.int64]) -> float:
    """RMS of the excited lines in one period of torque."""
    return float(np.sqrt(2) * np.linalg.norm(np.fft.rfft(tau)[lines]) / len(tau))


def _summary(record: Record, fs: float, path: Path) -> str:
    lines = record.lines * record.f0
    return (
        f"{record.id}  {path.name}: {record.excited} excited, {record.periods} periods of {record.samples_per_period} "
        f"samples at {fs:g} Hz, {len(lines)} lines from {lines[0]:g} to {lines[-1]:g} Hz, rms {record.rms:.4g}"
    )
