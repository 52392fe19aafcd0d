"""A first map.toml, from what names and numbers of the files tell; a person checks it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ident.machines.channels import Found, Lines, Named, NoMultisine, look, named
from ident.machines.joint_names import Channel
from ident.toml_text import key, quoted

#: A ratio of encoders that is one up to this is one: there is no gear.
_UNEVEN = 0.1
#: Swing of a motor about its mean beyond which its angle is hardly in rad.
_WIDE = 10.0


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
    for name, torque, angle in zip(found.names, found.torque, found.angle, strict=True):
        current = bool(re.search(r"curr|amp|i_?q", torque.name.lower()))
        unit, swing = _angle_unit(angle)
        rows += ["", f"[joint.{key(name)}]"]
        rows += ["J_l_kgm2 = 1.0  # CHECK: no URDF says it"] if found.urdf is None else []
        of_torque, side = f'unit = "{_torque_unit(torque, current)}"', ', side = "joint"'
        rows += [
            "# N = 100  # motor revolutions per joint revolution, if one of the sides below is the motor's",
            f"torque = {_signal(torque, of_torque + side)}  # CHECK unit and side",
            f"motor_angle = {_signal(angle, unit + side)}  # CHECK unit and side: it swings by {swing:.3g}",
        ]
    rows += ["", "[record]"]
    if found.time:
        unsure = "" if found.time.sure else "; CHECK the unit"
        rows.append(
            f'time = {{name = {quoted(found.time.name)}, unit = "{found.time.unit}"}}  # {found.time.rate:.6g} Hz{unsure}'
        )
    else:
        rows.append(
            f"sample_rate_Hz = {found.rate or 1000.0:.10g}  # {'the file says so' if found.rate else 'CHECK: the file does not say'}"
        )
    return "\n".join(rows) + "\n"


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
    if found.time:
        unsure = "" if found.time.sure else "; CHECK the unit"
        rows.append(f'time = {{name = {quoted(found.time.name)}, unit = "{found.time.unit}"}}  # {fs:.6g} Hz{unsure}')
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


def _joint(found: Found, k: int) -> list[str]:
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
    current = torque.kind == "current"
    kind = f'unit = "{_torque_unit(torque, current)}"'
    note = "CHECK the unit: a current; add torque_constant_Nm_per_A if known" if current else "CHECK the unit"
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


def _inertia(found: Found, k: int, N: float) -> float:
    """Half the inertia that the joint's lowest lines feel, behind the gear, in the units of the file."""
    fs = (found.time.rate if found.time else found.rate) or 1000.0
    heard = found.heard
    count = max(1, len(heard.lines) // 10)
    w = 2 * np.pi * heard.lines[:count] * fs / heard.period
    size = np.abs(heard.spectrum(found.torque[k].values)[:count] / heard.spectrum(found.motor[k].values)[:count]) / w**2
    return float(N**2 * np.median(size) / 2) if np.isfinite(size).all() and np.median(size) > 0 else 1.0


def _torque_unit(channel: Channel, current: bool) -> str:
    """The unit of a torque or current as the map says it: thousandths where its name ends so."""
    unit = "A" if current else "Nm"
    small = re.search(rf"(?<![A-Za-z])m{unit}\b", channel.name.replace("_", " "))
    return f"m{unit}" if small else unit


def _angle_unit(channel: Channel) -> tuple[str, float]:
    """The unit of an angle as the map says it, and its swing: whole numbers are counts, wide swings degrees."""
    values = channel.values
    swing = float(np.ptp(values)) / 2
    if np.array_equal(values, np.round(values)) and len(np.unique(values[:1000])) > 2:
        return 'unit = "counts", counts_per_rev = 4096', swing
    return ('unit = "deg"' if re.search("deg", channel.name.lower()) or swing > _WIDE else 'unit = "rad"'), swing


def _signal(channel: Channel, rest: str) -> str:
    column = "" if channel.column is None else f", column = {channel.column + 1}"
    return f"{{name = {quoted(channel.name)}{column}{', ' + rest if rest else ''}}}"
