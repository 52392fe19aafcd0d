"""Which channel of a foreign file is what: by names, and by how the numbers behave. For a guess that a person checks."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ident.errors import ImportingError
from ident.machines.clocks import Time, find_time, stated_rate
from ident.machines.joint_names import LINK, MOTOR, Channel, by_joint, of_word, split_name, words_of_joints
from ident.machines.readers import FEWEST, Variables, read_variables, transposed
from ident.records.campaign import Array
from ident.records.periodic import find_lines, find_period
from symgen.chain import PRISMATIC
from symgen.plan import chain_of_file

Lines = NDArray[np.int64]

#: What a channel's name says of it; the first that fits counts.
_WORDS = {
    "velocity": r"omega|vel|speed|rpm|(rad|deg|°)/s|drehzahl|(^|[^a-z])(dq|qd|w)($|[^a-z])",
    "torque": r"torq|tau|trq|effort|moment|\[m?n ?m\]",
    "current": r"(^|[^a-z])i_?q|curr|amp|strom|\[m?a\]|(^|[^a-z])i($|[^a-z])",
    "angle": r"theta|pos|angle|enc|phi|winkel|geber|\[(m?rad|deg|°|counts?)\]|(^|[^a-z])q($|[^a-z])",
}
#: How steeply each kind falls against the torque, d log / d log f, where a motor moves like a mass.
_SLOPE = {"torque": 0.0, "velocity": -1.0, "angle": -2.0}
#: A slope is believed when it is within this of one of them.
_NEAR = 0.4


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
    """All that goes into a map: channels a joint [n], which joint is excited, the time or a rate [Hz], which joints slide."""

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
    slides: frozenset[str]


def look(path: str | Path, urdf: str | Path | None = None) -> Found:
    """Returns what the channels of a file are.

    ImportingError, one line, if the file can not be read, no channel of it is a multisine, a joint's torque or angle is
    not there, or names do not tell which of them belong to one joint.
    """
    path = Path(path)
    variables = read_variables(path)
    chain = chain_of_file(urdf)[0] if urdf is not None else None
    names = chain.names if chain is not None else ()
    slides = (
        frozenset(joint.name for joint in chain.joints if joint.type == PRISMATIC) if chain is not None else frozenset()
    )
    channels, time = _channels(variables, names, path)
    heard = _excitation(channels, path, variables.others)
    channels = _readings(_with_kinds(channels, heard))
    heard = replace(heard, channel=next(c for c in channels if c.values is heard.channel.values))
    channels, names, torques, angles = _of_every_joint(channels, names, path)
    if not torques or not angles:
        raise ImportingError(f"{path}: {_lacks(channels, names, urdf, path)}")
    loud = [(torque is heard.channel, float(np.std(torque.values))) for torque in torques[0]]
    excited = max(range(len(names)), key=loud.__getitem__)
    motor, link = _motor_and_link(angles, excited, heard)
    speeds = by_joint([c for c in channels if c.kind == "velocity" and not c.commanded])
    speed = _derivative([group for group in speeds if len(group) == len(names)], motor, excited, heard, variables, time)
    reference = heard.channel if heard.channel is not torques[0][excited] else None
    rate = stated_rate(variables)
    return Found(path, urdf, names, excited, torques[0], motor, link, speed, reference, heard, time, rate, slides)


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
    channels, time = _channels(variables, names, path)
    told = [channel for channel in _readings(channels) if not channel.commanded]
    told, names, torques, angles = _of_every_joint(told, names, path)
    if torques and angles:
        return Named(path, urdf, names, torques[0], angles[0], time, stated_rate(variables))
    if urdf is not None and words_of_joints(told, path):
        raise ImportingError(f"{path}: {_lacks(told, names, urdf, path)}")
    return None


def _of_every_joint(
    channels: list[Channel], names: tuple[str, ...], path: Path
) -> tuple[list[Channel], tuple[str, ...], list[list[Channel]], list[list[Channel]]]:
    """The channels and the joints' names, where these are not said as words or numbers tell them; groups of torques, and of angles, with one of
    every joint."""
    if not names and (names := words_of_joints(channels, path)):
        channels = [of_word(channel, names) for channel in channels]
    driven = [channel for channel in channels if channel.kind in ("torque", "current")]
    torques = by_joint([channel for channel in driven if not channel.commanded] or driven)
    angles = by_joint([channel for channel in channels if channel.kind == "angle" and not channel.commanded])
    names = names or tuple(f"joint{k + 1}" for k in range(max(map(len, torques), default=0)))
    torques, angles = ([group for group in groups if len(group) == len(names)] for groups in (torques, angles))
    return channels, names, torques, angles


def _lacks(channels: Sequence[Channel], names: Sequence[str], urdf: str | Path | None, path: Path) -> str:
    """Why no torque and angle of each joint were found."""
    if urdf is not None and not any(name in channel.name for name in names for channel in channels):
        words = words_of_joints(channels, path)
        if words:
            return (
                f"its names speak of {', '.join(words)}, {urdf} of {', '.join(names)}; expected the URDF's names in the file, or --guess without "
                "--urdf (then write urdf and its names of the joints into the map)"
            )
    return (
        f"found no torque and angle of each of {', '.join(names)}; expected one channel a joint "
        f"among {', '.join(c.name for c in channels[:20])}"
    )


# what is there --------------------------------------------------------------------------------------------------------


def _channels(variables: Variables, joints: Sequence[str], path: Path) -> tuple[list[Channel], Time | None]:
    """The channels, and the time. ImportingError where signals lie in rows."""
    signals = {name: value for name, value in variables.items() if value.ndim and len(value) >= FEWEST}
    lengths = [len(value) for value in signals.values()]
    samples = max(set(lengths), key=lambda length: (lengths.count(length), length), default=0)
    for name, value in variables.items():
        if transposed(value) and value.shape[1] == (samples or value.shape[1]):
            shape = " x ".join(map(str, value.shape))
            raise ImportingError(
                f"{path}: {name!r} is {shape}: transposed; expected a row a sample, so write its transpose to the file"
            )
    found: list[Channel] = []
    times: list[Time | None] = []
    for name, values in signals.items():
        if len(values) != samples:
            continue
        alone, kind = values.ndim == 1, _told(name)
        for k, (column, missing) in enumerate(map(_filled, values[:, None].T if alone else values.T)):
            if 2 * missing > samples:
                continue
            if (np.diff(column) > 0).all() and (alone or not kind):  # time, or a counter
                times.append(find_time(name, None if alone else k, column, variables))
                if times[-1] or (alone and not kind):
                    continue
            group, joint = split_name(name, joints) if alone else (name, f"{k:04d}")
            found.append(Channel(name, None if alone else k, column, group, joint, kind, missing))
    told = sorted(
        (time for time in times if time),
        key=lambda time: (not time.sure, time.column is not None, time.name.isdecimal()),
    )
    return found, next(iter(told), None)


def _filled(values: Array) -> tuple[Array, int]:
    """The values with those that are not finite interpolated, and how many these are."""
    finite = np.isfinite(values)
    if finite.all() or not finite.any():
        return values, int((~finite).sum())
    at = np.arange(len(values))
    return np.interp(at, at[finite], values[finite]), int((~finite).sum())


def _readings(channels: Sequence[Channel]) -> list[Channel]:
    """The channels that change; and those of joints at rest: of a kind whose group changes, or torques of 0."""
    live = {channel.group for channel in channels if not channel.still}
    driven = ("torque", "current")
    return [
        channel
        for channel in channels
        if not channel.still
        or (channel.kind and (channel.group in live or (channel.kind in driven and not channel.values.any())))
    ]


def _excitation(channels: Sequence[Channel], path: Path, others: str) -> Excitation:
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
            + (f"; left out: {others}" if others else "")
        )
    return best


def _told(name: str) -> str:
    """What a channel is by its name."""
    return next((kind for kind, words in _WORDS.items() if re.search(words, name.lower())), "")


def _with_kinds(channels: Sequence[Channel], heard: Excitation) -> list[Channel]:
    """The channels with what they are: where their names say nothing as the others of their group, if these are all alike."""
    found = [replace(channel, kind=channel.kind or _kind(channel, heard)) for channel in channels]
    kinds = {group: {c.kind for c in found if c.group == group and c.kind} for group in {c.group for c in found}}
    alike = {group: min(kinds) for group, kinds in kinds.items() if len(kinds) == 1}
    return [channel if channel.kind else replace(channel, kind=alike.get(channel.group, "")) for channel in found]


def _kind(channel: Channel, heard: Excitation) -> str:
    """What a channel is by how it falls with frequency against the excitation."""
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
