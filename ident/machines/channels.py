"""Which channel of a foreign file is what: by names, and by how the numbers behave. For a guess that a person checks."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ident.errors import ImportingError
from ident.machines.clocks import Time, is_time, stated_rate, time_of
from ident.machines.joint_names import LINK, MOTOR, Channel, by_joint, of_word, split_name, words_of_joints
from ident.machines.readers import Variables, read_variables
from ident.records.campaign import Array
from ident.records.periodic import find_lines, find_period
from symgen.plan import chain_of_file

Lines = NDArray[np.int64]

#: What a channel's name says of it; the first that fits counts.
_WORDS = {
    "velocity": r"omega|vel|speed|rpm|(^|[^a-z])(dq|qd|w)($|[^a-z])",
    "torque": r"torq|tau|trq|effort|moment",
    "current": r"(^|[^a-z])i_?q|curr|amp|(^|[^a-z])i($|[^a-z])",
    "angle": r"theta|pos|angle|enc|phi|(^|[^a-z])q($|[^a-z])",
}
#: How steeply each kind falls against the torque, d log / d log f, where a motor moves like a mass.
_SLOPE = {"torque": 0.0, "velocity": -1.0, "angle": -2.0}
#: A slope is believed when it is within this of one of them.
_NEAR = 0.4
#: Fewest samples of a record.
_FEWEST = 200


class NoMultisine(ImportingError):
    """No channel of a file is a multisine."""


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
    """All that goes into a map: channels a joint [n], which joint is excited, the time or a rate [Hz]."""

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
    time: Time | None
    rate: float | None


def look(path: str | Path, urdf: str | Path | None = None) -> Found:
    """Returns what the channels of a file are.

    ImportingError, one line, if the file can not be read, no channel of it is a multisine, a joint's torque or angle is
    not there, or names do not tell which of them belong to one joint.
    """
    path = Path(path)
    variables = read_variables(path)
    names = chain_of_file(urdf)[0].names if urdf is not None else ()
    channels, time = _channels(variables, names)
    heard = _excitation(channels, path)
    channels = [replace(channel, kind=_kind(channel, heard)) for channel in channels]
    heard = replace(heard, channel=next(c for c in channels if c.values is heard.channel.values))
    if not names and (names := words_of_joints(channels, path)):
        channels = [of_word(channel, names) for channel in channels]
    torques = by_joint([c for c in channels if c.kind in ("torque", "current") and not c.commanded])
    torques = torques or by_joint([c for c in channels if c.kind in ("torque", "current")])
    angles = by_joint([c for c in channels if c.kind == "angle" and not c.commanded])
    if not names:
        names = tuple(f"joint{k + 1}" for k in range(max(map(len, torques))))
    torques, angles = ([group for group in groups if len(group) == len(names)] for groups in (torques, angles))
    if not torques or not angles:
        raise ImportingError(
            f"{path}: found no torque and angle of each of {', '.join(names)}; expected one channel a joint "
            f"among {', '.join(c.name for c in channels[:20])}"
        )
    loud = [(torque is heard.channel, float(np.std(torque.values))) for torque in torques[0]]
    excited = max(range(len(names)), key=loud.__getitem__)
    motor, link = _motor_and_link(angles, excited, heard)
    speeds = by_joint([c for c in channels if c.kind == "velocity" and not c.commanded])
    speed = _derivative([group for group in speeds if len(group) == len(names)], motor, excited, heard, variables, time)
    reference = heard.channel if heard.channel is not torques[0][excited] else None
    rate = stated_rate(variables)
    return Found(path, urdf, names, excited, torques[0], motor, link, speed, reference, heard, time, rate)


@dataclass(frozen=True, eq=False)
class Named:
    """All that goes into the map of a log, as names tell it: torques and angles of the joints [n], the time or a rate [Hz]."""

    path: Path
    urdf: str | Path | None
    names: tuple[str, ...]
    torque: list[Channel]
    angle: list[Channel]
    time: Time | None
    rate: float | None


def named(path: str | Path, urdf: str | Path | None = None) -> Named | None:
    """Returns the torques and angles that a file has, by their names alone; None where these do not tell."""
    path = Path(path)
    variables = read_variables(path)
    names = chain_of_file(urdf)[0].names if urdf is not None else ()
    channels, time = _channels(variables, names)
    told = [channel for channel in channels if not channel.commanded]

    def of(*kinds: str) -> list[list[Channel]]:
        return by_joint(
            [c for c in told if next((k for k, w in _WORDS.items() if re.search(w, c.name.lower())), "") in kinds]
        )

    torques, angles = of("torque", "current"), of("angle")
    count = len(names) or max(map(len, torques), default=0)
    torques, angles = ([group for group in groups if len(group) == count] for groups in (torques, angles))
    if not torques or not angles:
        return None
    names = names or tuple(f"joint{k + 1}" for k in range(count))
    return Named(path, urdf, names, torques[0], angles[0], time, stated_rate(variables))


# what is there --------------------------------------------------------------------------------------------------------


def _channels(variables: Variables, joints: Sequence[str]) -> tuple[list[Channel], Time | None]:
    """The channels that change, and the time."""
    signals = {name: value for name, value in variables.items() if value.ndim and len(value) >= _FEWEST}
    lengths = [len(value) for value in signals.values()]
    samples = max(set(lengths), key=lambda length: (lengths.count(length), length), default=0)
    found: list[Channel] = []
    time: Time | None = None
    for name, value in signals.items():
        if len(value) != samples or not np.isfinite(value).all():
            continue
        if value.ndim == 2:
            found += [Channel(name, k, value[:, k], name, f"{k:04d}") for k in range(value.shape[1])]
            continue
        step = np.diff(value)
        if (step > 0).all():  # time, or a counter
            if is_time(name) and time is None:
                time = time_of(name, float(np.median(step)))
            continue
        group, joint = split_name(name, joints)
        found.append(Channel(name, None, value, group, joint))
    return [channel for channel in found if np.ptp(channel.values) > 0], time


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
        raise NoMultisine(
            f"{path}: no channel is a multisine played twice or more; expected a periodic torque or current with lines "
            "that stand out (of another motion a map with [log] makes a log: ident import --keys)"
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


def _motor_and_link(
    angles: list[list[Channel]], excited: int, heard: Excitation
) -> tuple[list[Channel], list[Channel] | None]:
    """The motor's encoders and those behind the spring: by name, else the motor is what still moves at the highest lines."""
    if len(angles) == 1:
        return angles[0], None
    first, second = angles[:2]
    for one, other in ((first, second), (second, first)):
        if re.search(LINK, other[0].name.lower()) and not re.search(LINK, one[0].name.lower()):
            return one, other
        if re.search(MOTOR, one[0].name.lower()) and not re.search(MOTOR, other[0].name.lower()):
            return one, other

    def high(group: list[Channel]) -> float:
        size = np.abs(heard.spectrum(group[excited].values))
        count = max(1, len(size) // 10)
        return float(np.median(size[-count:]) / np.median(size[:count]))

    return (first, second) if high(first) >= high(second) else (second, first)


def _derivative(
    speeds: list[list[Channel]], motor: list[Channel], excited: int, heard: Excitation, variables: Variables,
    time: Time | None,
) -> list[Channel] | None:  # fmt: skip
    """The velocities that are the motor angle's slope, in the same unit; None where no group is."""
    fs = time.rate if time else stated_rate(variables)
    if fs is None:
        return None
    w = 2j * np.pi * heard.lines * fs / heard.period
    expected = w * heard.spectrum(motor[excited].values)
    for group in speeds:
        ratio = heard.spectrum(group[excited].values) / expected
        if abs(np.median(ratio.real) - 1) < 0.2:
            return group
    return None
