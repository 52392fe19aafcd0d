"""robot.toml -> Robot: the drives of an arm and the experiment to run on it, with every unit in the key's name.

Strict on purpose: a mistyped key that is silently ignored costs a day at the robot.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from os.path import isdir, isfile  # unlike pathlib's, false for every path that cannot be one
from pathlib import Path
from sys import float_info
from typing import Any

import numpy as np

from symgen.chain import PRISMATIC, Array, Chain, readonly
from symgen.errors import RobotError
from symgen.urdf_tree import read_tree

_MAX_BYTES = 1_000_000
_WHOLE = 1e-9  # relative: fs/f0 of decimal numbers such as 1000/0.1 is whole up to a few roundings
MOST_SAMPLES = 1e7  # a record: hours at 1 kHz; a gigabyte for a seven-axis arm
_MAX_GRAVITY = 100.0  # m/s2; anything beyond is a unit slip (mm/s2)


@dataclass(frozen=True)
class Drive:
    """Motor, gear and spring of one joint.

    `N` [1] motor rad per joint rad (negative: reversed), `J_m` [kg m2] and `D` [N m s/rad] motor side, `K` [N m/rad]
    and `D_spring` [N m s/rad] joint side, `encoder_counts` per motor revolution, `tau_max` [N m] motor side. A `linear`
    (prismatic) joint has N in motor rad per m, K in N/m and D_spring in N s/m; its motor is rotary all the same.
    `link_encoder_counts` per revolution, or per m, of the link itself; None where nothing reads it.
    """

    joint: str
    N: float
    J_m: float
    K: float
    D: float
    D_spring: float
    encoder_counts: int
    tau_max: float
    linear: bool = False
    link_encoder_counts: int | None = None

    @property
    def link_step(self) -> float | None:
        """What one count of the link's encoder is [rad or m]; None without one."""
        if self.link_encoder_counts is None:
            return None
        return (1.0 if self.linear else 2.0 * np.pi) / self.link_encoder_counts


@dataclass(frozen=True)
class Experiment:
    """How one record is made: `fs`, `band`, `f0` (line spacing), `lock_pd` and `lock_dob` in Hz, `periods` recorded
    (the settling ones included), `swing` [rad] the largest joint swing the excitation may cause, `torque_noise` rms
    relative to the excitation's rms (simulated robots only)."""

    fs: float = 1000.0
    band: tuple[float, float] = (0.1, 120.0)
    f0: float = 0.1
    periods: int = 6
    swing: float = 0.01
    torque_noise: float = 0.005
    lock_pd: float = 5.0
    lock_dob: float = 30.0

    @property
    def samples_per_period(self) -> int:
        return round(self.fs / self.f0)


@dataclass(frozen=True, eq=False)
class Robot:
    """One robot directory: where its `urdf` is, how to read it (`believe_zeros`, `base`, `tip`, `at` as in
    `symgen.urdf.load_chain`), `gravity` [3, m/s2] in the frame of its base, the experiment, the drives in file order."""

    name: str
    path: Path
    urdf: Path
    drives: tuple[Drive, ...]
    experiment: Experiment = Experiment()
    believe_zeros: bool = False
    base: str | None = None
    tip: str | None = None
    at: Mapping[str, float] = field(default_factory=dict)
    gravity: Array = field(default_factory=lambda: readonly([0.0, 0.0, -9.81]))

    def drive(self, joint: str) -> Drive:
        """Returns the drive of the named joint. RobotError if the file has none."""
        for drive in self.drives:
            if drive.joint == joint:
                return drive
        names = ", ".join(_key(drive.joint) for drive in self.drives)
        raise RobotError(f"{self.path}: joint {joint!r} has no [joint.<name>] table; expected one of {names}")

    def check(self, chain: Chain) -> None:
        """Raises RobotError naming the drive of no joint in the URDF (of the arm or not), or of another kind of joint."""
        kinds = {joint.name: joint.type for joint in read_tree(chain.source).joints.values() if joint.actuated}
        for drive in self.drives:
            where, kind = f"{self.path}: [joint.{_key(drive.joint)}]", kinds.get(drive.joint)
            if kind is None:
                names = ", ".join(map(_key, kinds))
                raise RobotError(f"{where}: no such joint in the URDF; its moving joints are {names}")
            if drive.linear != (kind == PRISMATIC):
                unit = "N and m (K_N_per_m, ..)" if kind == PRISMATIC else "N m and rad (K_Nm_per_rad, ..)"
                raise RobotError(f"{where}: the URDF says {kind}; expected keys in {unit}")


def load_robot(path: str | Path) -> Robot:
    """Returns the robot described by the TOML file `path`, or by robot.toml in the directory `path`.

    Raises RobotError, one line naming file, table and key: unknown or missing key, wrong type, impossible value.
    """
    path = Path(path)
    file = path / "robot.toml" if isdir(path) else path
    document = _read(file)
    _check_keys(str(file), document, _TABLES, required=("robot", "joint"))
    top = _values(f"{file}: [robot]", document["robot"], _ROBOT, required=("urdf",))
    urdf = file.parent / top.pop("urdf")
    if not isfile(urdf):
        raise RobotError(f"{file}: [robot]: urdf: no such file {str(urdf)!r}; expected a path relative to the toml")
    tables = document["joint"]
    if not isinstance(tables, dict) or not tables:
        raise RobotError(f"{file}: [joint]: found {_short(tables)}, expected one [joint.<name>] table per driven joint")
    drives = tuple(_drive(f"{file}: [joint.{_key(name)}]", name, table) for name, table in tables.items())
    for drive in drives:
        if (drive.link_encoder_counts is None) != (drives[0].link_encoder_counts is None):
            raise RobotError(
                f"{file}: [joint.{_key(drive.joint)}]: {_OPTIONAL[drive.linear]}: found at some joints only, expected at every joint or at none"
            )
    experiment = _experiment(f"{file}: [experiment]", document.get("experiment", {}))
    return Robot(file.resolve().parent.name, file, urdf, drives, experiment, **top)


def _read(file: Path) -> dict[str, Any]:
    if not isfile(file):
        raise RobotError(f"{file}: no such file; expected a robot.toml or the directory that holds one")
    try:
        if file.stat().st_size > _MAX_BYTES:
            raise RobotError(f"{file}: larger than {_MAX_BYTES} bytes; expected a robot.toml")
        return tomllib.loads(file.read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise RobotError(f"{file}: cannot be read: {error.strerror}") from None
    except RecursionError:
        raise RobotError(f"{file}: not TOML: nested too deeply") from None
    except ValueError as error:  # TOMLDecodeError, UnicodeDecodeError, an integer of more than 4300 digits
        raise RobotError(f"{file}: not TOML: {' '.join(str(error).split())}") from None


class _Unfit(Exception):
    """A value that breaks its key's rule; the text says what was expected."""


# Takes the TOML value and returns the field's value, or raises _Unfit.
_Check = Callable[[Any], Any]


def _number(expected: str, ok: Callable[[float], bool]) -> _Check:
    def check(value: Any) -> float:
        numeric = isinstance(value, int | float) and not isinstance(value, bool)
        if not (numeric and abs(value) <= float_info.max and ok(value)):  # neither nan nor inf, nor an endless integer
            raise _Unfit(expected)
        return float(value)

    return check


def _whole(expected: str, least: int) -> _Check:
    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value < 2**53:
            raise _Unfit(expected)
        return value

    return check


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value or "\0" in value:
        raise _Unfit("a non-empty string")
    return value


def _bool(value: Any) -> bool:
    if not isinstance(value, bool):
        raise _Unfit("true or false")
    return value


def _list(check: _Check, length: int, expected: str) -> _Check:
    def checked(value: Any) -> list[Any]:
        if not isinstance(value, list) or len(value) != length:
            raise _Unfit(expected)
        try:
            return [check(item) for item in value]
        except _Unfit:
            raise _Unfit(expected) from None

    return checked


def _gravity(value: Any) -> Array:
    return readonly(_list(_FINITE_GRAVITY, 3, f"three numbers of at most {_MAX_GRAVITY:g} m/s2")(value))


def _at(value: Any) -> dict[str, float]:
    if not isinstance(value, dict):
        raise _Unfit("a table of joint = value")
    return {name: _FINITE(number) for name, number in value.items()}


def _band(value: Any) -> tuple[float, float]:
    expected = "[lower, upper] with 0 < lower < upper"
    low, high = _list(_POSITIVE, 2, expected)(value)
    if low >= high:
        raise _Unfit(expected)
    return low, high


def _positive(low: float, high: float) -> _Check:
    """A quantity of a drive or an experiment: from `low` to `high`, far beyond any real one on either side.

    Products and matrix exponentials of what is left stay finite numbers.
    """
    return _number(f"a number > 0, from {low:g} to {high:g}", lambda x: low <= x <= high)


def _not_negative(high: float) -> _Check:
    return _number(f"a number >= 0, up to {high:g}", lambda x: 0 <= x <= high)


_FINITE = _number("a finite number (rad or m)", lambda x: True)
_FINITE_GRAVITY = _number("", lambda x: abs(x) <= _MAX_GRAVITY)
_POSITIVE = _number("a number > 0", lambda x: x > 0)
_RATIO = _number("a number other than 0, from 0.001 to 1e+06 in size", lambda x: 1e-3 <= abs(x) <= 1e6)
_STIFFNESS = _positive(1e-3, 1e12)
_DAMPING = _not_negative(1e9)
_BANDWIDTH = _positive(1e-3, 1e5)

# key in the file -> (field of the dataclass, check)
_Rules = Mapping[str, tuple[str, _Check]]
_TABLES = ("robot", "experiment", "joint")
_ROBOT: _Rules = {
    "urdf": ("urdf", _text),
    "believe_zeros": ("believe_zeros", _bool),
    "base": ("base", _text),
    "tip": ("tip", _text),
    "at": ("at", _at),
    "gravity_m_per_s2": ("gravity", _gravity),
}
_EXPERIMENT: _Rules = {
    "sample_rate_Hz": ("fs", _POSITIVE),
    "band_Hz": ("band", _band),
    "line_spacing_Hz": ("f0", _POSITIVE),
    "periods": ("periods", _whole("a whole number >= 2 (at least one period settles)", 2)),
    "swing_rad": ("swing", _positive(1e-9, 10.0)),
    "torque_noise_rel": ("torque_noise", _not_negative(10.0)),
    "lock_pd_Hz": ("lock_pd", _BANDWIDTH),
    "lock_dob_Hz": ("lock_dob", _BANDWIDTH),
}
_COUNTS = _whole("a whole number >= 1", 1)
#: What a drive may lack: of a joint that turns, of one that slides.
_OPTIONAL = ("link_encoder_counts_per_rev", "link_encoder_counts_per_m")
_MOTOR: _Rules = {
    "J_m_kgm2": ("J_m", _positive(1e-12, 1e3)),
    "D_Nms_per_rad": ("D", _DAMPING),
    "encoder_counts_per_rev": ("encoder_counts", _COUNTS),
    "torque_limit_Nm": ("tau_max", _positive(1e-9, 1e6)),
}
_ROTARY: _Rules = {
    "N": ("N", _RATIO),
    "K_Nm_per_rad": ("K", _STIFFNESS),
    "D_spring_Nms_per_rad": ("D_spring", _DAMPING),
    "link_encoder_counts_per_rev": ("link_encoder_counts", _COUNTS),
}
_LINEAR: _Rules = {
    "N_rad_per_m": ("N", _RATIO),
    "K_N_per_m": ("K", _STIFFNESS),
    "D_spring_Ns_per_m": ("D_spring", _DAMPING),
    "link_encoder_counts_per_m": ("link_encoder_counts", _COUNTS),
}


def _drive(where: str, joint: str, table: Any) -> Drive:
    linear = isinstance(table, dict) and any(key in table for key in _LINEAR)
    rules = {**(_LINEAR if linear else _ROTARY), **_MOTOR}
    required = tuple(key for key in rules if key not in _OPTIONAL)
    return Drive(joint=joint, linear=linear, **_values(where, table, rules, required))


def recordable(fs: float, f0: float, periods: int = 1) -> bool:
    """Whether a record of `periods` at `fs` with lines every `f0` [Hz] has a whole number of samples a period, and not too many in
    all: what robot.toml may have."""
    samples = fs / f0
    return samples * periods <= MOST_SAMPLES and abs(samples - round(samples)) <= _WHOLE * samples


def _experiment(where: str, table: Any) -> Experiment:
    result = Experiment(**_values(where, table, _EXPERIMENT, required=()))
    samples, (low, high) = result.fs / result.f0, result.band
    if not recordable(result.fs, result.f0):
        raise RobotError(
            f"{where}: sample_rate_Hz / line_spacing_Hz = {samples:.10g} samples per period; "
            f"expected a whole number of at most {MOST_SAMPLES:g}"
        )
    if not recordable(result.fs, result.f0, result.periods):
        raise RobotError(
            f"{where}: periods: {result.periods} of {samples:g} samples each; expected a record of at most "
            f"{MOST_SAMPLES:g} samples"
        )
    if high >= result.fs / 2:
        raise RobotError(f"{where}: band_Hz: {high:g} Hz is not below sample_rate_Hz / 2 = {result.fs / 2:g} Hz")
    if np.floor(high / result.f0 * (1 + _WHOLE)) < np.ceil(low / result.f0 * (1 - _WHOLE)):
        raise RobotError(f"{where}: band_Hz [{low:g}, {high:g}] holds no line k * {result.f0:g} Hz")
    return result


def _values(where: str, table: Any, rules: _Rules, required: tuple[str, ...]) -> dict[str, Any]:
    """Returns {field: checked value} for the keys of one table."""
    _check_keys(where, table, rules, required)
    result = {}
    for key, value in table.items():
        name, check = rules[key]
        try:
            result[name] = check(value)
        except _Unfit as error:
            raise RobotError(f"{where}: {key}: found {_short(value)}, expected {error}") from None
    return result


def _check_keys(where: str, table: Any, known: Iterable[str], required: tuple[str, ...]) -> None:
    if not isinstance(table, dict):
        raise RobotError(f"{where}: found {_short(table)}, expected a table")
    known = tuple(known)
    for key in table:
        if key not in known:
            meant = [name for name in known if name.startswith(f"{key}_")]  # the key without its unit
            raise RobotError(f"{where}: unknown key {key!r}; expected {' or '.join(meant) or ', '.join(known)}")
    for key in required:
        if key not in table:
            raise RobotError(f"{where}: key {key!r} is missing")


def _key(name: str) -> str:
    return name if name.isprintable() else repr(name)


def _short(value: Any) -> str:
    try:
        text = repr(value)
    except ValueError:  # a hexadecimal integer of more than 4300 decimal digits
        return "a huge integer"
    return text if len(text) <= 60 else text[:57] + "..."
