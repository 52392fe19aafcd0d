"""A first map.toml, from what names and numbers of the files tell; a person checks it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ident.machines.at_rest import opposed, ratio_at_rest
from ident.machines.channels import Found, Named, NoMultisine, look, named
from ident.machines.import_notes import RESTS
from ident.machines.joint_names import Channel
from ident.toml_text import key, quoted

#: A ratio of encoders that is one up to this is one: there is no gear.
_UNEVEN = 0.1
#: Swing of a motor about its mean beyond which its angle is hardly in rad.
_WIDE = 10.0
#: Counts per revolution of an encoder of which none are known.
_COUNTS = 4096
#: How names of angles say their unit.
_ANGLES = {"deg": r"deg|°", "mrad": r"(^|[^a-z])mrad", "rad": r"(^|[^a-z])rad($|[^a-z])"}


def guess(files: Sequence[str | Path], urdf: str | Path | None = None) -> str:
    """Returns the text of a map.toml for files of one kind, the first of which is looked into: of a log where no channel is a multisine, and
    names tell torques and angles. Errors as `look`."""
    try:
        return _text(look(files[0], urdf), len(files))
    except NoMultisine:
        log = named(files[0], urdf)
        if log is None:
            raise
        return _text_of_log(log)


def _text_of_log(found: Named) -> str:
    rows = [
        f"# A guess from {found.path.name}, in which no channel is a multisine: a log of trajectories. Check every line that says CHECK, then:",
        "# ident import --map map.toml FILE.. -o log.h5",
        "",
        "[log]",
        'source = "a measured machine"',
        "",
        "[robot]",
        f"joints = [{', '.join(map(quoted, found.names))}]",
        "# no URDF: one link a joint stands in" if found.urdf is None else f"urdf = {quoted(str(found.urdf))}",
    ]
    unit = _angle_unit(found.angle)
    for name, torque, angle in zip(found.names, found.torque, found.angle, strict=True):
        current = torque.kind == "current"
        rows += ["", f"[joint.{key(name)}]"]
        rows += ["J_l_kgm2 = 1.0  # CHECK: no URDF says it"] if found.urdf is None else []
        of_torque, side = f'unit = "{_torque_unit(torque, current)}"', ', side = "joint"'
        rows += [
            "# N = 100  # motor revolutions per joint revolution, if one of the sides below is the motor's",
            f"torque = {_signal(torque, of_torque + side)}  # CHECK unit and side",
            f"motor_angle = {_signal(angle, unit + side)}  # CHECK unit and side: it swings by {_swing(angle):.3g}",
        ]
    rows += ["", "[record]", _clock(found)]
    return "\n".join(rows + _missing(found.torque + found.angle)) + "\n"


def _clock(found: Found | Named) -> str:
    """The line that says when samples were taken; one that no import accepts where the file does not tell."""
    if found.time:
        column = "" if found.time.column is None else f", column = {found.time.column + 1}"
        unsure = "" if found.time.sure else "; CHECK the unit" if column == "" else "; CHECK: told by its even steps"
        return f'time = {{name = {quoted(found.time.name)}{column}, unit = "{found.time.unit}"}}  # {found.time.rate:.6g} Hz{unsure}'
    if found.rate:
        return f"sample_rate_Hz = {found.rate:.10g}  # the file says so"
    return 'sample_rate_Hz = "?"  # CHECK: the file does not say; fill in the number'


def _missing(channels: Sequence[Channel]) -> list[str]:
    """A remark on samples that are no numbers."""
    return [
        f"# CHECK: of {_signal(channel, '')} {channel.missing} of {len(channel.values)} samples are no numbers: leave them out by periods or "
        "samples, and skip_samples"
        for channel in channels
        if channel.missing
    ]


def _text(found: Found, files: int) -> str:
    heard, fs = found.heard, found.time.rate if found.time else found.rate
    commanded = found.torque[found.excited].commanded or heard.channel is found.torque[found.excited]
    hold = "zoh" if commanded else "band-limited"
    alone, why = found.urdf is None, "most periodic" if heard.channel is found.torque[found.excited] else "largest"
    order = "  # CHECK: base to tip" if alone and len(found.names) > 1 else ""
    rows = [
        f"# A guess from {found.path.name}: check every line that says CHECK, then: ident import --map map.toml FILE.. -o out.h5",
        "",
        "[campaign]",
        'source = "a measured machine"',
        f'hold = "{hold}"  # CHECK: "zoh" if the torque below is the command, "band-limited" if it is measured behind a filter',
        "",
        "[robot]",
        f"joints = [{', '.join(map(quoted, found.names))}]{order}",
        "# no URDF: one link a joint stands in" if alone else f"urdf = {quoted(str(found.urdf))}",
    ]
    for k, name in enumerate(found.names):
        rows += ["", f"[joint.{key(name)}]", *_joint(found, k)]
    rows += [
        "",
        "[record]",
        f"excited = {quoted(found.names[found.excited])}  # its torque is the {why}; CHECK",
        "posture_rad = [0]"
        if alone and len(found.names) == 1
        else 'posture_rad = "measured"  # CHECK: or the angles at rest',
    ]
    rows.append(_clock(found))
    if found.reference:
        rows.append(f"reference = {_signal(found.reference, '')}  # the most periodic channel")
    lines = heard.lines
    hertz = f", {lines[0] * fs / heard.period:.4g} to {lines[-1] * fs / heard.period:.4g} Hz" if fs else ""
    what = f"{len(lines)} lines from {lines[0]} to {lines[-1]}{hertz}"
    rows += [
        f"# period: {heard.period} samples, found" if files > 1 else f"period_samples = {heard.period}  # found",
        f'lines = "auto"  # here {what}',
        *_missing(found.torque + found.motor + (found.link or []) + (found.speed or [])),
    ]
    return "\n".join(rows) + "\n"


def _joint(found: Found, k: int) -> list[str]:
    torque, motor, heard = found.torque[k], found.motor[k], found.heard
    tau, theta = heard.spectrum(torque.values), heard.spectrum(motor.values)
    live = k == found.excited
    turned = live and opposed(heard.lines.astype(float), tau, theta)
    unit = _angle_unit(found.motor)
    N, told = _ratio(found, k)
    per, means = (
        ("N_rad_per_m", "motor rad per m")
        if found.names[k] in found.slides
        else ("N", "motor revolutions per joint revolution")
    )
    rows = [f"{per} = {N:.3g}  # CHECK: {means}{told}"]
    if found.urdf is None:
        rows.append(f"J_l_kgm2 = {_inertia(found, k, N):.2g}  # half of what the lowest lines feel, as a start")
    current = torque.kind == "current"
    kind = f'unit = "{_torque_unit(torque, current)}"'
    note = "CHECK the unit: a current; add torque_constant_Nm_per_A if known" if current else "CHECK the unit"
    rows.append(f"torque = {_signal(torque, kind)}  # {note}")
    offset = ', offset = "posture"' if found.urdf is None and len(found.names) == 1 else ""
    sign = ", sign = -1" if turned else ""
    why = "; in phase with the torque, so turned" if turned else ""
    rows.append(
        f"motor_angle = {_signal(motor, unit + sign + offset)}  # CHECK the unit: it swings by {_swing(motor):.3g}{why}"
    )
    if found.speed:
        per_s = re.sub('unit = "([a-z]+)"', r'unit = "\1/s"', unit)
        rows.append(f"motor_velocity = {_signal(found.speed[k], per_s + sign)}  # the slope of motor_angle")
    if found.link:
        against = live and (_gear(found) < 0) != turned
        why = "; against the motor, so turned" if against else ""
        link = _signal(found.link[k], _angle_unit(found.link) + (", sign = -1" if against else "") + offset)
        rows.append(f"link_angle = {link}  # CHECK the unit: it swings by {_swing(found.link[k]):.3g}{why}")
    return rows


def _ratio(found: Found, k: int) -> tuple[float, str]:
    """Motor revolutions per joint revolution, and how they are told: of the excited joint by how it moves, of others by where they rest."""
    if found.link is None:
        return 1.0, ""
    N = abs(_gear(found))
    N = N if abs(N - 1) > _UNEVEN else 1.0
    if k == found.excited:
        return N, ""
    sizes = (_size(found.motor), _size(found.link))
    theta, q = (
        abs(float(np.mean(group[k].values))) * size
        for group, size in zip((found.motor, found.link), sizes, strict=True)
    )
    if q > RESTS and abs(theta / q / N - 1) < _UNEVEN:
        return theta / q, ": by the angles at rest"
    return N, f": as {found.names[found.excited]}'s, nothing here tells"


def _gear(found: Found) -> float:
    """Motor over link angle of the excited joint at standstill, with its sign; 1 where no line tells."""
    assert found.link is not None  # where there are two encoders
    motor, link = (
        found.heard.spectrum(group[found.excited].values) * _size(group) for group in (found.motor, found.link)
    )
    return ratio_at_rest(found.heard.lines.astype(float), motor, link) or 1.0


def _inertia(found: Found, k: int, N: float) -> float:
    """Half the inertia that the joint's lowest lines feel, behind the gear, in the units of the file."""
    fs, heard = found.time.rate if found.time else found.rate, found.heard
    if fs is None or found.torque[k].still or found.motor[k].still:
        return 1.0
    count = max(1, len(heard.lines) // 10)
    w = 2 * np.pi * heard.lines[:count] * fs / heard.period
    size = np.abs(heard.spectrum(found.torque[k].values)[:count] / heard.spectrum(found.motor[k].values)[:count]) / w**2
    return float(N**2 * np.median(size) / 2) if np.isfinite(size).all() and np.median(size) > 0 else 1.0


def _torque_unit(channel: Channel, current: bool) -> str:
    """The unit of a torque or current as the map says it: thousandths where its name ends so."""
    unit = "A" if current else "Nm"
    small = re.search(rf"(?<![A-Za-z])m{unit}\b", channel.name.replace("_", " "))
    return f"m{unit}" if small else unit


def _angle_unit(angles: Sequence[Channel]) -> str:
    """The unit of angles of one kind as the map says it: as a name says; whole numbers are counts, wide swings degrees."""
    names = " ".join(channel.name.lower() for channel in angles)
    whole = all(np.array_equal(channel.values, np.round(channel.values)) for channel in angles)
    if whole and any(len(np.unique(channel.values[:1000])) > 2 for channel in angles):
        return f'unit = "counts", counts_per_rev = {_COUNTS}'
    for unit, words in _ANGLES.items():
        if re.search(words, names):
            return f'unit = "{unit}"'
    return 'unit = "deg"' if max(map(_swing, angles)) > _WIDE else 'unit = "rad"'


def _size(angles: Sequence[Channel]) -> float:
    """The unit of these angles in rad."""
    unit = _angle_unit(angles).split('"')[1]
    return {"counts": 2 * np.pi / _COUNTS, "deg": np.pi / 180, "mrad": 1e-3}.get(unit, 1.0)


def _swing(channel: Channel) -> float:
    return float(np.ptp(channel.values)) / 2


def _signal(channel: Channel, rest: str) -> str:
    column = "" if channel.column is None else f", column = {channel.column + 1}"
    return f"{{name = {quoted(channel.name)}{column}{', ' + rest if rest else ''}}}"
