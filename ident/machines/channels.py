"""Which channel of a foreign file is what: by names, and by how the numbers behave. For a guess that a person checks."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os.path import commonprefix
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ident.errors import ImportingError
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
_COMMANDED = r"ref|cmd|command|desired|target|setp|(^|[^a-z])(des|set)($|[^a-z])"
_LINK = r"link|load|output|second|joint_?(pos|ang)"
_MOTOR = r"motor|rotor"
_TIME = r"^t($|[^a-z])|time|stamp"
#: Units of time: s each, and how names say them (an MCAP file's clocks are in s).
_TIME_UNITS = {
    "s": (1.0, r"s|secs?|seconds?|/header/stamp|/log_time"),
    "ms": (1e-3, r"ms|msecs?|millis\w*"),
    "us": (1e-6, r"us|[µμ]s|usecs?|micros\w*"),
    "ns": (1e-9, r"ns|nsecs?|nanos\w*"),
}
#: A name's parts: words also where a capital begins them, numbers, and what separates them.
_PART = r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+|[\W_]+|\w"
_RATE = r"^(fs|f_s|fsamp\w*|sampl\w*rate\w*|rate_?hz)$"

#: What tells the readings of one joint apart, and so is no joint's name.
_ROLE = (
    rf"{_LINK}|{_MOTOR}|{_COMMANDED}|act(ual)?|dem(and)?|meas(ured)?|feedback|fb|est(imated)?|filt(ered)?|raw|err(or)?|"
    "mean|min|max|[dq]|in|out|abs|inc|ext"
)

#: How steeply each kind falls against the torque, d log / d log f, where a motor moves like a mass.
_SLOPE = {"torque": 0.0, "velocity": -1.0, "angle": -2.0}
#: A slope is believed when it is within this of one of them.
_NEAR = 0.4
#: Sampling rates [Hz] that a machine may have.
_RATES = (20.0, 2e5)
#: Fewest samples of a record.
_FEWEST = 200


class NoMultisine(ImportingError):
    """No channel of a file is a multisine."""


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


@dataclass(frozen=True)
class Time:
    """The time of a file: its variable, its unit, the sampling rate [Hz]; not `sure` if another unit fits as well."""

    name: str
    unit: str
    rate: float
    sure: bool


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
    if not names and (names := _words(channels, path)):
        channels = [_of_word(channel, names) for channel in channels]
    torques = _joints([c for c in channels if c.kind in ("torque", "current") and not c.commanded])
    torques = torques or _joints([c for c in channels if c.kind in ("torque", "current")])
    angles = _joints([c for c in channels if c.kind == "angle" and not c.commanded])
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
    speeds = _joints([c for c in channels if c.kind == "velocity" and not c.commanded])
    speed = _derivative([group for group in speeds if len(group) == len(names)], motor, excited, heard, variables, time)
    reference = heard.channel if heard.channel is not torques[0][excited] else None
    rate = _rate(variables)
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
        return _joints(
            [c for c in told if next((k for k, w in _WORDS.items() if re.search(w, c.name.lower())), "") in kinds]
        )

    torques, angles = of("torque", "current"), of("angle")
    count = len(names) or max(map(len, torques), default=0)
    torques, angles = ([group for group in groups if len(group) == count] for groups in (torques, angles))
    if not torques or not angles:
        return None
    names = names or tuple(f"joint{k + 1}" for k in range(count))
    return Named(path, urdf, names, torques[0], angles[0], time, _rate(variables))


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


def _words(channels: Sequence[Channel], path: Path) -> tuple[str, ...]:
    """The joints' names where words tell them: what differs among the names of torques and again among those of angles.

    () where numbers tell them, or there is one joint. ImportingError where different words are in either kind.
    """
    alone = [channel for channel in channels if channel.column is None]
    angles = [channel for channel in alone if channel.kind == "angle" and not channel.commanded]
    driven = [channel for channel in alone if channel.kind in ("torque", "current")]
    driven = [channel for channel in driven if not channel.commanded] or driven
    kinds = [[channel for channel in driven if channel.kind == kind] for kind in ("torque", "current")]
    for torques in kinds:
        for words in _candidates(torques):
            if all(_have_all(either, words) for either in (torques, angles)):
                return words
    untold = next((torques for torques in kinds if _candidates(torques) and len(_joints(torques)[0]) == 1), None)
    if untold and _candidates(angles):
        raise ImportingError(
            f"{path}: names do not tell which of {', '.join(channel.name for channel in untold)} and of "
            f"{', '.join(channel.name for channel in angles)} belong to one joint; expected the joints' names in both, "
            "or --urdf"
        )
    return ()


def _candidates(channels: Sequence[Channel]) -> list[tuple[str, ...]]:
    """Words that may be joints: last parts of names of one path, or what is left without the parts common to all."""
    names = [channel.name for channel in channels]
    paths: dict[str, list[str]] = {}
    for name in names:
        path, _, last = name.rpartition("/")
        paths.setdefault(path, []).append(last)
    parts = [re.findall(_PART, name) for name in names]
    for _ in range(2):  # common to all in front, then behind
        common = len(commonprefix(parts))
        parts = [part[common:][::-1] for part in parts]
    rest = [re.sub(r"^[\W_]+|[\W_]+$", "", "".join(part)) for part in parts]
    found = [*(words for path, words in paths.items() if path), rest]
    return [tuple(words) for words in found if len(words) > 1 and _are_joints(words)]


def _are_joints(words: Sequence[str]) -> bool:
    """Whether the words may name joints: all different, not all with a number, none a kind of reading."""
    numbered = all(re.search(r"\d", word) for word in words)
    return (
        all(words)
        and len(set(words)) == len(words)
        and not numbered
        and not any(re.fullmatch(_ROLE, word.lower()) for word in words)
    )


def _have_all(channels: Sequence[Channel], words: Sequence[str]) -> bool:
    """Whether some group of channels has one of every word."""
    return any(len(group) == len(words) for group in _joints([_of_word(channel, words) for channel in channels]))


def _of_word(channel: Channel, words: Sequence[str]) -> Channel:
    """The channel, of the joint whose word is among the parts of its name, else of none."""
    if channel.column is not None:
        return channel
    parts = re.findall(_PART, channel.name)
    for k, word in sorted(enumerate(words), key=lambda item: -len(item[1])):
        own = re.findall(_PART, word)
        for at in range(len(parts) - len(own) + 1):
            if parts[at : at + len(own)] == own:
                group = "".join([*parts[:at], "#", *parts[at + len(own) :]])
                return replace(channel, group=group, joint=f"{k:04d}")
    return replace(channel, group=channel.name, joint="")


def _time(name: str, step: float) -> Time | None:
    """The time of that step: in the unit its name says, else in the one of the highest rate that a machine may have."""
    rates = {unit: 1 / (step * size) for unit, (size, _) in _TIME_UNITS.items()}
    fits = {unit: rate for unit, rate in rates.items() if _RATES[0] <= rate <= _RATES[1]}
    named = [
        unit
        for unit, (_, words) in _TIME_UNITS.items()
        if re.search(rf"(^|[^a-zµμ]|(?=/))({words})($|[^a-z])", name.lower())
    ]
    if not fits:
        return None
    unit = next((unit for unit in named if unit in fits), max(fits, key=fits.__getitem__))
    return Time(name, unit, fits[unit], unit in named or (len(fits) == 1 and not named))


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
    time: Time | None,
) -> list[Channel] | None:  # fmt: skip
    """The velocities that are the motor angle's slope, in the same unit; None where no group is."""
    fs = time.rate if time else _rate(variables)
    if fs is None:
        return None
    w = 2j * np.pi * heard.lines * fs / heard.period
    expected = w * heard.spectrum(motor[excited].values)
    for group in speeds:
        ratio = heard.spectrum(group[excited].values) / expected
        if abs(np.median(ratio.real) - 1) < 0.2:
            return group
    return None
