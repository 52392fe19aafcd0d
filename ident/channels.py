"""Which channel of a foreign file is what: by names, and by how the numbers behave. For a guess that a person checks."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ident.campaign import Array
from ident.errors import ImportingError
from ident.periodic import find_lines, find_period
from ident.readers import Variables, read_variables
from symgen.plan import chain_of_file

Lines = NDArray[np.int64]

#: What a channel's name says of it; the first that fits counts.
_WORDS = {
    "velocity": r"omega|vel|speed|rpm|(^|[^a-z])(dq|qd|w)($|[^a-z])",
    "torque": r"torq|tau|trq|effort|moment",
    "current": r"(^|[^a-z])i_?q|curr|amp|(^|[^a-z])i($|[^a-z])",
    "angle": r"theta|pos|angle|enc|phi|(^|[^a-z])q($|[^a-z])",
}
_COMMANDED = r"ref|cmd|command|desired|target|setp|(^|[^a-z])(des|set)($|[^a-z])"
_LINK = r"link|load|output|second|joint_?(pos|ang)"
_MOTOR = r"motor|rotor"
_TIME = r"^t$|time|stamp"
_RATE = r"^(fs|f_s|fsamp\w*|sampl\w*rate\w*|rate_?hz)$"

#: How steeply each kind falls against the torque, d log / d log f, where a motor moves like a mass.
_SLOPE = {"torque": 0.0, "velocity": -1.0, "angle": -2.0}
#: A slope is believed when it is within this of one of them.
_NEAR = 0.4
#: Sampling rates [Hz] that a machine may have.
_RATES = (20.0, 2e5)
#: Fewest samples of a record.
_FEWEST = 200


@dataclass(frozen=True, eq=False)
class Channel:
    """One reading: variable, column (from 0), values [T]; `group` is the name without the joint, `joint` its number."""

    name: str
    column: int | None
    values: Array
    group: str
    joint: str
    kind: str = ""

    @property
    def commanded(self) -> bool:
        return bool(re.search(_COMMANDED, self.name.lower()))


@dataclass(frozen=True, eq=False)
class Excitation:
    """What was played: the channel that shows it best, its period and lines, and the spectra of others at those lines."""

    channel: Channel
    period: int
    lines: Lines

    def spectrum(self, values: Array) -> NDArray[np.complex128]:
        periods = values[: len(values) // self.period * self.period].reshape(-1, self.period)
        return np.asarray(np.fft.rfft(periods[len(periods) // 2 :].mean(axis=0))[self.lines])


@dataclass(frozen=True, eq=False)
class Found:
    """All that goes into a map: channels a joint [n], which joint is excited, the time (name, unit, Hz) or a rate [Hz]."""

    path: Path
    urdf: str | Path | None
    names: tuple[str, ...]
    excited: int
    torque: list[Channel]
    motor: list[Channel]
    link: list[Channel] | None
    speed: list[Channel] | None
    reference: Channel | None
    heard: Excitation
    time: tuple[str, str, float] | None
    rate: float | None


def look(path: str | Path, urdf: str | Path | None = None) -> Found:
    """Returns what the channels of a file are.

    ImportingError, one line, if the file can not be read, no channel of it is a multisine, or a joint's torque or angle
    is not there.
    """
    path = Path(path)
    variables = read_variables(path)
    names = chain_of_file(urdf)[0].names if urdf is not None else ()
    channels, time = _channels(variables, names)
    heard = _excitation(channels, path)
    channels = [replace(channel, kind=_kind(channel, heard)) for channel in channels]
    torques = _joints([c for c in channels if c.kind in ("torque", "current") and not c.commanded])
    torques = torques or _joints([c for c in channels if c.kind in ("torque", "current")])
    angles = _joints([c for c in channels if c.kind == "angle" and not c.commanded])
    count = max(len(group) for group in torques)
    if not names:
        names = tuple(f"joint{k + 1}" for k in range(count))
    torques, angles = ([group for group in groups if len(group) == len(names)] for groups in (torques, angles))
    if not torques or not angles:
        raise ImportingError(
            f"{path}: found no torque and angle of each of {', '.join(names)}; expected one channel a joint "
            f"among {', '.join(c.name for c in channels[:20])}"
        )
    excited = max(range(len(names)), key=lambda k: float(np.std(torques[0][k].values)))
    motor, link = _motor_and_link(angles, excited, heard)
    speeds = _joints([c for c in channels if c.kind == "velocity" and not c.commanded])
    speed = _derivative([group for group in speeds if len(group) == len(names)], motor, excited, heard, variables, time)
    reference = heard.channel if heard.channel is not torques[0][excited] else None
    rate = _rate(variables)
    return Found(path, urdf, names, excited, torques[0], motor, link, speed, reference, heard, time, rate)


# what is there --------------------------------------------------------------------------------------------------------


def _channels(variables: Variables, joints: Sequence[str]) -> tuple[list[Channel], tuple[str, str, float] | None]:
    """The channels that change, and the time: its name, unit and the sampling rate [Hz] it gives."""
    signals = {name: value for name, value in variables.items() if value.ndim and len(value) >= _FEWEST}
    lengths = [len(value) for value in signals.values()]
    samples = max(set(lengths), key=lambda length: (lengths.count(length), length), default=0)
    found, time = [], None
    for name, value in signals.items():
        if len(value) != samples or not np.isfinite(value).all():
            continue
        if value.ndim == 2:
            found += [Channel(name, k, value[:, k], name, f"{k:04d}") for k in range(value.shape[1])]
            continue
        step = np.diff(value)
        if (step > 0).all():  # time, or a counter
            if re.search(_TIME, name.lower()) and time is None:
                time = _time(name, float(np.median(step)))
            continue
        group, joint = _split(name, joints)
        found.append(Channel(name, None, value, group, joint))
    return [channel for channel in found if np.ptp(channel.values) > 0], time


def _split(name: str, joints: Sequence[str]) -> tuple[str, str]:
    """A name without the joint it speaks of, and that joint: one of the URDF's, else a number."""
    for k, joint in sorted(enumerate(joints), key=lambda item: -len(item[1])):
        if joint in name:
            return name.replace(joint, "#"), f"{k:04d}"
    number = re.search(r"\d+", name)
    return (re.sub(r"\d+", "#", name), f"{int(number[0]):04d}") if number else (name, "")


def _time(name: str, step: float) -> tuple[str, str, float] | None:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        if _RATES[0] <= 1 / (step * size) <= _RATES[1]:
            return name, unit, 1 / (step * size)
    return None


def _rate(variables: Variables) -> float | None:
    """A sampling rate that the file states [Hz]."""
    for name, value in variables.items():
        if value.ndim == 0 and re.search(_RATE, name.lower().split(".")[-1]) and value > 0:
            return float(value)
    return None


def _excitation(channels: Sequence[Channel], path: Path) -> Excitation:
    """The channel that is a multisine and repeats most exactly; of equals, the strongest."""
    best, least = None, (np.inf, np.inf)
    for channel in channels:
        if re.search(f"{_WORDS['velocity']}|{_WORDS['angle']}", channel.name.lower()):
            continue
        period = find_period(channel.values)
        lines = find_lines(channel.values, period) if period else None
        if period is None or lines is None:
            continue
        x = channel.values[: len(channel.values) // period * period].reshape(-1, period)
        change = float(np.mean(np.var(x, axis=0)) / np.var(x))
        score = (round(np.log10(change + 1e-9)), -float(np.std(x)))
        if score < least:
            best, least = Excitation(channel, period, lines), score
    if best is None:
        raise ImportingError(
            f"{path}: no channel is a multisine played twice or more; expected a periodic torque or current with lines "
            "that stand out (a log of some other motion is no campaign)"
        )
    return best


def _kind(channel: Channel, heard: Excitation) -> str:
    """What a channel is: by its name, where that says nothing by how it falls with frequency against the excitation."""
    for kind, words in _WORDS.items():
        if re.search(words, channel.name.lower()):
            return kind
    size = np.abs(heard.spectrum(channel.values)) / np.abs(heard.spectrum(heard.channel.values))
    low = slice(0, max(4, len(heard.lines) // 20))
    if not (size[low] > 0).all():
        return ""
    slope = float(np.polyfit(np.log(heard.lines[low]), np.log(size[low]), 1)[0])
    return next((kind for kind, value in _SLOPE.items() if abs(slope - value) < _NEAR), "")


def _joints(channels: Sequence[Channel]) -> list[list[Channel]]:
    """Channels of one kind by group, each in the order of its joints; largest groups first."""
    groups: dict[str, list[Channel]] = {}
    for channel in channels:
        groups.setdefault(channel.group, []).append(channel)
    ordered = [sorted(group, key=lambda channel: channel.joint) for group in groups.values()]
    return sorted(ordered, key=len, reverse=True)


def _motor_and_link(
    angles: list[list[Channel]], excited: int, heard: Excitation
) -> tuple[list[Channel], list[Channel] | None]:
    """The motor's encoders and those behind the spring: by name, else the motor is what still moves at the highest lines."""
    if len(angles) == 1:
        return angles[0], None
    first, second = angles[:2]
    for one, other in ((first, second), (second, first)):
        if re.search(_LINK, other[0].name.lower()) and not re.search(_LINK, one[0].name.lower()):
            return one, other
        if re.search(_MOTOR, one[0].name.lower()) and not re.search(_MOTOR, other[0].name.lower()):
            return one, other

    def high(group: list[Channel]) -> float:
        size = np.abs(heard.spectrum(group[excited].values))
        count = max(1, len(size) // 10)
        return float(np.median(size[-count:]) / np.median(size[:count]))

    return (first, second) if high(first) >= high(second) else (second, first)


def _derivative(
    speeds: list[list[Channel]], motor: list[Channel], excited: int, heard: Excitation, variables: Variables,
    time: tuple[str, str, float] | None,
) -> list[Channel] | None:  # fmt: skip
    """The velocities that are the motor angle's slope, in the same unit; None where no group is."""
    fs = time[2] if time else _rate(variables)
    if fs is None:
        return None
    w = 2j * np.pi * heard.lines * fs / heard.period
    expected = w * heard.spectrum(motor[excited].values)
    for group in speeds:
        ratio = heard.spectrum(group[excited].values) / expected
        if abs(np.median(ratio.real) - 1) < 0.2:
            return group
    return None
