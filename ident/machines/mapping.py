"""map.toml -> Map: which numbers of a foreign file are the torque and the angles of which joint, and how they were taken.

As strict as robot.toml: every key is known, every unit is written out. `KEYS` says what each key means.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ident.machines.stand_in import Body, stand_in
from ident.machines.toml_table import (
    RATES,
    Check,
    Table,
    choice,
    either,
    lines_of,
    names_of,
    nonzero,
    number,
    numbers,
    positive,
    rate,
    read_toml,
    text,
    whole,
)
from ident.records.campaign import HOLDS
from symgen.chain import PRISMATIC, Chain
from symgen.plan import chain_of_file

AUTO = "auto"
MEASURED = "measured"


#: Every key a map may hold, by table, with what it means: the documentation, and the list of what is not a mistake.
KEYS: Mapping[str, Mapping[str, str]] = {
    "campaign": {
        "source": "where the records come from, in words",
        "hold": "\"zoh\": the torque is a command, held between samples; \"band-limited\": it is measured, behind a filter",
    },
    "log": {
        "source": "in the place of [campaign]: trajectories instead of multisines, joints taken as rigid; where they come from, in words",
    },
    "robot": {
        "urdf": "the declared robot, a path relative to the map; without one the joints below stand in, one link each",
        "joints": "the driven joints, base to tip (default: all that move in the URDF)",
        "gravity_m_per_s2": "gravity in the base frame (default [0, 0, -9.81], zeros without a URDF)",
    },
    "joint": {
        "N": "motor revolutions per joint revolution (a slide: N_rad_per_m); default 1",
        "N_rad_per_m": "of a slide: motor rad per m",
        "J_m_kgm2": "datasheet inertia of the motor, motor side (with torque in A: A s2/rad); left out where unknown",
        "K_Nm_per_rad": "datasheet stiffness, joint side; left out where unknown",
        "K_N_per_m": "of a slide: stiffness in N/m",
        "J_l_kgm2": "without a URDF: a guess of the inertia of this joint's link about its axis",
        "m_l_kg": "without a URDF, of a slide: a guess of the moving mass",
        "torque": "signal: motor torque, or current",
        "motor_angle": "signal: motor encoder",
        "motor_velocity": "signal, may be left out",
        "link_angle": "signal: second encoder, behind the spring; of all joints or of none",
    },
    "signal": {
        "name": "variable of the file, or heading of the column",
        "column": "which column of a variable with several, from 1",
        "unit": "torque: Nm, mNm, A, mA; angle: rad, mrad, deg, rev, counts, of what slides m, mm; velocity: any of these per s, or rpm",
        "counts_per_rev": "with unit counts: of one revolution",
        "torque_constant_Nm_per_A": "with unit A or mA; left out where unknown, of a single joint: inertia is then in A s2/rad",
        "sign": "1 or -1: positive torque must speed the motor up in the direction of positive motor and link angle",
        "gain": "what the file has times this is the reading, in the unit (default 1)",
        "offset": "reading, in the unit (counts: in counts), where the joint is at zero, before sign and side count "
        "(default 0); or \"posture\": what puts the mean there (not in a log, which has none)",
        "wrap": "the reading, in the unit, jumps back by this: unwound from the first sample of the file on",
        "side": "\"motor\" (default) or \"joint\": behind the gear, to be divided (torque) or multiplied (angle) by N",
    },
    "record": {
        "excited": "the joint whose motor got the multisine",
        "posture_rad": "link angles at rest (m for slides), one a joint; or \"measured\": the mean of the link_angle; without one "
        "that of the motor_angle over N, less what the mean torque deflects the spring where the map has K and a torque in N m",
        "sample_rate_Hz": f"sampling rate, {RATES[0]:g} to {RATES[1]:g}; or time",
        "time": "signal: time of every sample, unit s, ms, us or ns (dates in ISO 8601 are read as s): checked for samples dropped among those taken",
        "period_samples": "samples a period, or \"auto\" (default): found from the reference, whole from skip_samples on",
        "f0_Hz": "line spacing, to check the above",
        "periods": "whole periods to take (default: all); with period_samples said, what is behind them does not count",
        "skip_samples": "samples before the first one to take (default 0), whatever they are",
        "lines": "excited harmonics: a list, \"first:last\", \"first:step:last\" or \"auto\" (default): from the reference",
        "reference": "signal: commanded excitation, to find period and lines from (default: the excited joint's "
        "torque); all other signals are of as many samples and of the same instants",
    },
    "record of a log": {
        "sample_rate_Hz": f"sampling rate, {RATES[0]:g} to {RATES[1]:g}; or time",
        "time": "signal: time of every sample; where its steps are not even, signals are interpolated",
        "skip_samples": "samples before the first one to take (default 0)",
        "samples": "how many to take (default: all)",
    },
    "file": {"any key of [record]": "overrides it for the file of that name"},
}  # fmt: skip

_TORQUE = {"Nm": 1.0, "mNm": 1e-3, "A": 1.0, "mA": 1e-3}
_ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "rev": 2 * math.pi, "m": 1.0, "mm": 1e-3}
_LENGTH = ("m", "mm")
_VELOCITY = {f"{unit}/s": size for unit, size in _ANGLE.items()} | {"rpm": 2 * math.pi / 60}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_COUNTS = {"motor_angle": "counts", "link_angle": "counts", "motor_velocity": "counts/s"}
_UNITS = {
    "torque": _TORQUE, "motor_angle": _ANGLE, "link_angle": _ANGLE, "motor_velocity": _VELOCITY, "time": TIME_UNITS,
    "reference": {"any": 1.0},
}  # fmt: skip


@dataclass(frozen=True)
class Signal:
    """One reading: variable `name`, `column` (from 0) of it, times `scale` is SI (`current`: A instead of N m).

    `offset` and `wrap` are in the file's own numbers, before the scale; `offset` None puts the mean at the posture.
    `joint_side` when it is taken behind the gear.
    """

    name: str
    column: int | None = None
    scale: float = 1.0
    offset: float | None = 0.0
    wrap: float | None = None
    joint_side: bool = False
    current: bool = False


@dataclass(frozen=True)
class JointMap:
    """One joint: N, J_m, K as in `Campaign` (NaN: unknown) and its signals, keyed "torque", "motor_angle", .."""

    name: str
    N: float
    J_m: float
    K: float
    signals: Mapping[str, Signal]


@dataclass(frozen=True)
class RecordMap:
    """How one file was recorded; None where the file does not say, "auto" where the data must tell."""

    excited: str | None = None
    posture: tuple[float, ...] | str | None = None
    fs: float | None = None
    time: Signal | None = None
    period: int | str = AUTO
    f0: float | None = None
    periods: int | None = None
    skip: int = 0
    lines: tuple[int, ...] | str = AUTO
    reference: Signal | None = None
    samples: int | None = None


@dataclass(frozen=True)
class Map:
    """A whole map.toml: `urdf` text, joints base to tip, `record` for every file and `files` {name: RecordMap}; `is_log` where files are
    trajectories."""

    path: Path
    source: str
    hold: str
    urdf: str
    gravity: tuple[float, ...]
    joints: tuple[JointMap, ...]
    record: RecordMap
    files: Mapping[str, RecordMap] = field(default_factory=dict)
    is_log: bool = False

    def of(self, file: Path) -> RecordMap:
        """The record in `file`: what is said of all, overridden by what is said of the file of that name."""
        return self.files.get(file.name, self.record)


def load_map(path: str | Path) -> Map:
    """Returns the map in the TOML file. ImportingError, one line naming file, table and key, for whatever is not one."""
    path = Path(path)
    document = Table(str(path), read_toml(path))
    document.known(("campaign", "log", "robot", "joint", "record", "file"), ("robot", "joint", "record"))
    is_log = "log" in document.values
    if is_log and "campaign" in document.values:
        raise document.error("found both [campaign] and [log], expected one of them")
    campaign, robot = document.table("log" if is_log else "campaign"), document.table("robot")
    campaign.known(KEYS["log" if is_log else "campaign"], () if is_log else ("hold",))
    robot.known(KEYS["robot"], ())
    tables = document.table("joint")
    if not tables.values:
        raise tables.error("found none, expected one [joint.NAME] table per driven joint")
    names, chain = _robot(robot, tables, path)
    slides = {} if chain is None else {joint.name: joint.type == PRISMATIC for joint in chain.joints}
    joints = tuple(_joint(tables.table(name), name, slides.get(name), is_log) for name in names)
    if extra := set(tables.values) - set(names):
        raise tables.table(min(extra)).error(f"not among the joints {', '.join(names)}")
    if any("link_angle" in joint.signals for joint in joints):
        for joint in joints:
            if "link_angle" not in joint.signals:
                raise tables.table(joint.name).error("link_angle is missing; expected one of every joint or of none")
    if chain is None:
        bodies = [_body(tables.table(name), name) for name in names]
        if len({body.slide for body in bodies}) > 1:
            raise robot.error("found both J_l_kgm2 and m_l_kg in the joints, expected one kind, or a URDF")
        urdf = stand_in(bodies)
        gravity = (0.0, 0.0, 0.0)
    else:
        urdf, gravity = chain.source, (0.0, 0.0, -9.81)
    record = _record(document.table("record"), RecordMap(), names, is_log)
    files = document.table("file")
    return Map(
        path=path,
        source=campaign.get("source", text, "a measured machine"),
        hold=campaign.get("hold", choice(*HOLDS), HOLDS[0]),
        urdf=urdf,
        gravity=robot.get("gravity_m_per_s2", numbers(3), gravity),
        joints=joints,
        record=record,
        files={name: _record(files.table(name), record, names, is_log) for name in files.values},
        is_log=is_log,
    )


def _robot(robot: Table, tables: Table, path: Path) -> tuple[tuple[str, ...], Chain | None]:
    """The names of the joints, base to tip, and the chain of the URDF, None where the joints stand in."""
    given = robot.get("joints", names_of, None)
    if "urdf" not in robot.values:
        if given is None:
            raise robot.error("found neither urdf nor joints, expected one of them")
        return given, None
    chain, _ = chain_of_file(path.parent / robot.get("urdf", text, ""))
    names = chain.names if given is None else given
    if [name for name in chain.names if name in names] != list(names):
        raise robot.error(f"joints: found {', '.join(names)}, expected some of {', '.join(chain.names)}, in this order")
    return names, chain


def _joint(table: Table, name: str, slide: bool | None, is_log: bool) -> JointMap:
    """The joint, which the URDF says to be a `slide` or not (None: there is no URDF)."""
    table.known(KEYS["joint"], ("torque", "motor_angle"))
    for a, b in (("N", "N_rad_per_m"), ("K_Nm_per_rad", "K_N_per_m"), ("J_l_kgm2", "m_l_kg")):
        if a in table.values and b in table.values:
            raise table.error(f"found both {a} and {b}, expected one")
    for key in ("J_l_kgm2", "m_l_kg"):
        if key in table.values and slide is not None:
            raise table.error(f"{key}: the URDF says it; expected it only where there is no URDF")
    N = table.get("N", nonzero, table.get("N_rad_per_m", nonzero, 1.0))
    K = table.get("K_Nm_per_rad", positive, table.get("K_N_per_m", positive, math.nan))
    signals = {key: _signal(table, key, is_log) for key in ("torque", "motor_angle", "motor_velocity", "link_angle")}
    for key in ("motor_angle", "motor_velocity", "link_angle"):
        _fits(table, key, "m_l_kg" in table.values if slide is None else slide, N)
    found = {key: signal for key, signal in signals.items() if signal is not None}
    return JointMap(name, N, table.get("J_m_kgm2", positive, math.nan), K, found)


def _fits(table: Table, key: str, slide: bool, N: float) -> None:
    """Raises ImportingError for a length of what turns, or an angle of what slides: a motor may turn, behind its N_rad_per_m."""
    signal = table.values.get(key)
    unit = signal.get("unit", "") if isinstance(signal, dict) else ""
    if not unit or unit in _COUNTS.values():
        return
    length, geared = unit.removesuffix("/s") in _LENGTH, N != 1
    of_motor = key != "link_angle" and signal.get("side", "motor") == "motor"
    if not slide and length:
        raise table.error(f"{key} in {unit}, but the joint is revolute; expected an angle")
    if slide and not length and not (of_motor and geared):
        expected = "m/s or mm/s" if key == "motor_velocity" else "m or mm"
        remedy = ", or the N_rad_per_m of a motor that turns" if of_motor else ""
        raise table.error(f"{key} in {unit}, but the joint slides; expected {expected}{remedy}")
    if slide and length and of_motor and geared:
        raise table.error(f'{key} in {unit}, but N_rad_per_m says that the motor turns; expected side = "joint"')


def _body(table: Table, name: str) -> Body:
    if "m_l_kg" in table.values:
        return Body(name, True, table.get("m_l_kg", positive, 0.0))
    if "J_l_kgm2" not in table.values:
        raise table.error("J_l_kgm2 is missing; expected a guess of the link's inertia, as there is no URDF")
    return Body(name, False, table.get("J_l_kgm2", positive, 0.0))


def _signal(table: Table, key: str, is_log: bool) -> Signal | None:
    value = table.values.get(key)
    if value is None:
        return None
    signal = Table(f"{table.where}: {key}", {"name": value} if isinstance(value, str) else value)
    signal.known(KEYS["signal"], ("name",))
    units = _UNITS[key]
    counts = _COUNTS.get(key, "")
    unit = signal.get(
        "unit", choice(*units, *([counts] if counts else ())), next(iter(units)) if len(units) == 1 else ""
    )
    if not unit:
        raise signal.error(f"unit is missing; expected one of {', '.join(units)}{', ' + counts if counts else ''}")
    if (unit == counts) != ("counts_per_rev" in signal.values):
        raise signal.error(f'unit {unit!r}: counts_per_rev goes with unit "counts", and only with it')
    if "torque_constant_Nm_per_A" in signal.values and unit not in ("A", "mA"):
        raise signal.error(f"torque_constant_Nm_per_A: goes with a current, but unit is {unit!r}")
    size = 2 * math.pi / signal.get("counts_per_rev", positive, 1.0) if unit == counts else units[unit]
    gain = signal.get("gain", nonzero, 1.0)
    column = signal.get("column", whole(1), None)
    if is_log and signal.values.get("offset") == "posture":
        raise signal.error('offset = "posture": a log has no posture; expected the reading where the joint is at zero')
    offset, wrap = signal.values.get("offset", 0.0), signal.get("wrap", positive, None)
    constant = signal.get("torque_constant_Nm_per_A", positive, 1.0)
    return Signal(
        name=signal.get("name", text, ""),
        column=None if column is None else column - 1,
        scale=size * gain * signal.get("sign", choice(1, -1), 1) * constant,
        offset=None
        if offset == "posture" and key in ("motor_angle", "link_angle")
        else signal.get("offset", number, 0.0) / gain,
        wrap=None if wrap is None else wrap / abs(gain),
        joint_side=signal.get("side", choice("motor", "joint"), "motor") == "joint",
        current=unit in ("A", "mA") and "torque_constant_Nm_per_A" not in signal.values,
    )  # fmt: skip


def _record(table: Table, base: RecordMap, joints: Sequence[str], is_log: bool) -> RecordMap:
    table.known(KEYS["record of a log" if is_log else "record"], ())
    found: dict[str, Any] = {}

    def take(key: str, name: str, check: Check) -> None:
        if key in table.values:
            found[name] = table.get(key, check, None)

    take("excited", "excited", choice(*joints))
    take("posture_rad", "posture", either(MEASURED, numbers(len(joints))))
    take("sample_rate_Hz", "fs", rate)
    take("period_samples", "period", either(AUTO, whole(2)))
    take("f0_Hz", "f0", positive)
    take("periods", "periods", whole(1))
    take("skip_samples", "skip", whole(0))
    take("samples", "samples", whole(2))
    take("lines", "lines", either(AUTO, lines_of))
    for key in ("time", "reference"):
        if key in table.values:
            found[key] = _signal(table, key, is_log)
    return replace(base, **found)
