"""A first map.toml, from what names and numbers of the files tell; a person checks it."""

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
from ident.toml_text import key, quoted
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
#: A ratio of encoders that is one up to this is one: there is no gear.
_UNEVEN = 0.1
#: Swing of a motor about its mean beyond which its angle is hardly in rad.
_WIDE = 10.0


@dataclass(frozen=True, eq=False)
class _Channel:
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
class _Excitation:
    """What was played: the channel that shows it best, its period and lines, and the spectra of others at those lines."""

    channel: _Channel
    period: int
    lines: Lines

    def spectrum(self, values: Array) -> NDArray[np.complex128]:
        periods = values[: len(values) // self.period * self.period].reshape(-1, self.period)
        return np.asarray(np.fft.rfft(periods[len(periods) // 2 :].mean(axis=0))[self.lines])


def guess(files: Sequence[str | Path], urdf: str | Path | None = None) -> str:
    """Returns the text of a map.toml for files of one kind, the first of which is looked into.

    ImportingError, one line, if the file can not be read or no channel of it is a multisine.
    """
    path = Path(files[0])
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
    return _text(
        _Found(path, urdf, names, excited, torques[0], motor, link, speed, reference, heard, time, rate), len(files)
    )


# what is there --------------------------------------------------------------------------------------------------------


def _channels(variables: Variables, joints: Sequence[str]) -> tuple[list[_Channel], tuple[str, str, float] | None]:
    """The channels that change, and the time: its name, unit and the sampling rate [Hz] it gives."""
    signals = {name: value for name, value in variables.items() if value.ndim and len(value) >= _FEWEST}
    lengths = [len(value) for value in signals.values()]
    samples = max(set(lengths), key=lambda length: (lengths.count(length), length), default=0)
    found, time = [], None
    for name, value in signals.items():
        if len(value) != samples or not np.isfinite(value).all():
            continue
        if value.ndim == 2:
            found += [_Channel(name, k, value[:, k], name, f"{k:04d}") for k in range(value.shape[1])]
            continue
        step = np.diff(value)
        if (step > 0).all():  # time, or a counter
            if re.search(_TIME, name.lower()) and time is None:
                time = _time(name, float(np.median(step)))
            continue
        group, joint = _split(name, joints)
        found.append(_Channel(name, None, value, group, joint))
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


def _excitation(channels: Sequence[_Channel], path: Path) -> _Excitation:
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
            best, least = _Excitation(channel, period, lines), score
    if best is None:
        raise ImportingError(
            f"{path}: no channel is a multisine played twice or more; expected a periodic torque or current with lines "
            "that stand out (a log of some other motion is no campaign)"
        )
    return best


def _kind(channel: _Channel, heard: _Excitation) -> str:
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


def _joints(channels: Sequence[_Channel]) -> list[list[_Channel]]:
    """Channels of one kind by group, each in the order of its joints; largest groups first."""
    groups: dict[str, list[_Channel]] = {}
    for channel in channels:
        groups.setdefault(channel.group, []).append(channel)
    ordered = [sorted(group, key=lambda channel: channel.joint) for group in groups.values()]
    return sorted(ordered, key=len, reverse=True)


def _motor_and_link(
    angles: list[list[_Channel]], excited: int, heard: _Excitation
) -> tuple[list[_Channel], list[_Channel] | None]:
    """The motor's encoders and those behind the spring: by name, else the motor is what still moves at the highest lines."""
    if len(angles) == 1:
        return angles[0], None
    first, second = angles[:2]
    for one, other in ((first, second), (second, first)):
        if re.search(_LINK, other[0].name.lower()) and not re.search(_LINK, one[0].name.lower()):
            return one, other
        if re.search(_MOTOR, one[0].name.lower()) and not re.search(_MOTOR, other[0].name.lower()):
            return one, other

    def high(group: list[_Channel]) -> float:
        size = np.abs(heard.spectrum(group[excited].values))
        count = max(1, len(size) // 10)
        return float(np.median(size[-count:]) / np.median(size[:count]))

    return (first, second) if high(first) >= high(second) else (second, first)


def _derivative(
    speeds: list[list[_Channel]], motor: list[_Channel], excited: int, heard: _Excitation, variables: Variables,
    time: tuple[str, str, float] | None,
) -> list[_Channel] | None:  # fmt: skip
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


# the map --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Found:
    """All that goes into the map."""

    path: Path
    urdf: str | Path | None
    names: tuple[str, ...]
    excited: int
    torque: list[_Channel]
    motor: list[_Channel]
    link: list[_Channel] | None
    speed: list[_Channel] | None
    reference: _Channel | None
    heard: _Excitation
    time: tuple[str, str, float] | None
    rate: float | None


def _text(found: _Found, files: int) -> str:
    heard, fs = found.heard, found.time[2] if found.time else found.rate
    commanded = found.torque[found.excited].commanded or heard.channel is found.torque[found.excited]
    hold = "zoh" if commanded else "band-limited"
    alone = found.urdf is None
    rows = [
        f"# A guess from {found.path.name}: check every line that says CHECK, then: ident import --map map.toml FILE.. -o out.h5",
        "",
        "[campaign]",
        'source = "a measured machine"',
        f'hold = "{hold}"  # CHECK: "zoh" if the torque below is the command, "band-limited" if it is measured behind a filter',
        "",
        "[robot]",
        f"joints = [{', '.join(map(quoted, found.names))}]",
        "# no URDF: one link a joint stands in" if alone else f"urdf = {quoted(str(found.urdf))}",
    ]
    for k, name in enumerate(found.names):
        rows += ["", f"[joint.{key(name)}]", *_joint(found, k)]
    rows += [
        "",
        "[record]",
        f"excited = {quoted(found.names[found.excited])}  # its torque is the largest; CHECK",
        "posture_rad = [0]"
        if alone and len(found.names) == 1
        else 'posture_rad = "measured"  # CHECK: or the angles at rest',
    ]
    if found.time:
        rows.append(f'time = {{name = {quoted(found.time[0])}, unit = "{found.time[1]}"}}  # {fs:.6g} Hz')
    elif found.rate:
        rows.append(f"sample_rate_Hz = {found.rate:.10g}  # the file says so")
    else:
        rows.append("sample_rate_Hz = 1000  # CHECK: the file does not say")
    if found.reference:
        rows.append(f"reference = {_signal(found.reference, '')}  # the most periodic channel")
    lines = heard.lines
    hertz = f", {lines[0] * fs / heard.period:.4g} to {lines[-1] * fs / heard.period:.4g} Hz" if fs else ""
    what = f"{len(lines)} lines from {lines[0]} to {lines[-1]}{hertz}"
    rows += [
        f"# period: {heard.period} samples, found" if files > 1 else f"period_samples = {heard.period}  # found",
        f'lines = "auto"  # here {what}',
    ]
    return "\n".join(rows) + "\n"


def _joint(found: _Found, k: int) -> list[str]:
    torque, motor, heard = found.torque[k], found.motor[k], found.heard
    tau, theta = heard.spectrum(torque.values), heard.spectrum(motor.values)
    live = k == found.excited
    count = max(1, len(tau) // 10)
    opposed = (
        live and min(np.median((np.conj(tau) * theta).real[part]) for part in (slice(count), slice(-count, None))) > 0
    )
    rows = []
    unit, swing = _angle_unit(motor)
    back = _gear(theta, heard.spectrum(found.link[k].values), heard.lines) if found.link and live else 1.0
    N = f"{abs(back):.3g}" if abs(abs(back) - 1) > _UNEVEN else "1"
    rows.append(f"N = {N}  # CHECK: motor revolutions per joint revolution")
    if found.urdf is None:
        rows.append(f"J_l_kgm2 = {_inertia(found, k, float(N)):.2g}  # half of what the lowest lines feel, as a start")
    kind = 'unit = "A"' if torque.kind == "current" else 'unit = "Nm"'
    note = "CHECK: a current; add torque_constant_Nm_per_A if known" if torque.kind == "current" else "CHECK the unit"
    rows.append(f"torque = {_signal(torque, kind)}  # {note}")
    offset = ', offset = "posture"' if found.urdf is None and len(found.names) == 1 else ""
    sign = ", sign = -1" if opposed else ""
    why = "; in phase with the torque, so turned" if opposed else ""
    rows.append(
        f"motor_angle = {_signal(motor, unit + sign + offset)}  # CHECK the unit: it swings by {swing:.3g}{why}"
    )
    if found.speed:
        per_s = unit.replace('"counts"', '"counts/s"').replace('"rad"', '"rad/s"').replace('"deg"', '"deg/s"')
        rows.append(f"motor_velocity = {_signal(found.speed[k], per_s + sign)}  # the slope of motor_angle")
    if found.link:
        link_unit, swing = _angle_unit(found.link[k])
        turned = (back < 0) != bool(opposed)
        why = "; against the motor, so turned" if turned else ""
        link = _signal(found.link[k], link_unit + (", sign = -1" if turned else "") + offset)
        rows.append(f"link_angle = {link}  # CHECK the unit: it swings by {swing:.3g}{why}")
    return rows


def _gear(motor: NDArray[np.complex128], link: NDArray[np.complex128], lines: Lines) -> float:
    """Motor over link angle at standstill, with its sign: theta/q = N (1 - f^2/f_AR^2) of two masses, by its lowest lines."""
    low = slice(0, max(4, len(lines) // 4))
    ratio = (motor[low] / link[low]).real
    return float(np.polyfit(lines[low].astype(float) ** 2, ratio, 1)[1]) if np.isfinite(ratio).all() else 1.0


def _inertia(found: _Found, k: int, N: float) -> float:
    """Half the inertia that the joint's lowest lines feel, behind the gear, in the units of the file."""
    fs = (found.time[2] if found.time else found.rate) or 1000.0
    heard = found.heard
    count = max(1, len(heard.lines) // 10)
    w = 2 * np.pi * heard.lines[:count] * fs / heard.period
    size = np.abs(heard.spectrum(found.torque[k].values)[:count] / heard.spectrum(found.motor[k].values)[:count]) / w**2
    return float(N**2 * np.median(size) / 2) if np.isfinite(size).all() and np.median(size) > 0 else 1.0


def _angle_unit(channel: _Channel) -> tuple[str, float]:
    """The unit of an angle as the map says it, and its swing: whole numbers are counts, wide swings degrees."""
    values = channel.values
    swing = float(np.ptp(values)) / 2
    if np.array_equal(values, np.round(values)) and len(np.unique(values[:1000])) > 2:
        return 'unit = "counts", counts_per_rev = 4096', swing
    return ('unit = "deg"' if re.search("deg", channel.name.lower()) or swing > _WIDE else 'unit = "rad"'), swing


def _signal(channel: _Channel, rest: str) -> str:
    column = "" if channel.column is None else f", column = {channel.column + 1}"
    return f"{{name = {quoted(channel.name)}{column}{', ' + rest if rest else ''}}}"
