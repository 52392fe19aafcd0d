"""What a real robot has to play, record by record, and the map with which its records come back as a campaign."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ident.errors import IdentError
from ident.plain import as_text, replace_file
from ident.records.campaign import Array
from ident.simulator.bench import design
from ident.simulator.design import RAMP, Setup
from ident.simulator.plant import build_plant
from ident.toml_text import key, quoted
from symgen.chain import Chain
from symgen.plan import Cell, text_of_arm
from symgen.robot import Robot

FORMAT, VERSION = "frf-excitation", 1

#: The files that are written, and their first line: torque of the excited motor, posture.
_NAME, _HEAD = re.compile(r"\d{4,}\.csv"), re.compile(rb"t,(tau|i)_[\w.-]+(,q_[\w.-]+)+")
#: How the map begins.
_MAP = "# Record for every file of excitation/"

_SERVO = (
    "e = theta - rest, w = (e - e_before) fs; z = a z_before + (1 - a) (u_before + dob J w), a = exp(-dob / fs); "
    "u = -kp e - kd w + z - dob J w; torque = preload + u + excitation (on the excited motor); all motor side, rad, N m, "
    "J in kg m2, dob in rad/s (0: none, then z = 0)"
)


def export_excitation(
    robot: Robot,
    chain: Chain,
    cells: Sequence[Cell],
    directory: str | Path,
    *,
    seed: int = 0,
    realisations: int = 1,
    periods: Sequence[int] | None = None,
    constants: Mapping[str, float] | None = None,
) -> tuple[Path, ...]:
    """Writes what to play for every cell and returns the files; with the same seed it is what `bench.simulate` plays.

    `directory` gets the URDF, excitation.json (lines, order, servos, rest angles, preload), excitation/0001.csv ..: one
    period of the torque of the excited motor, with the posture; and map.toml for the records. Of an earlier export no excitation is
    left. `realisations` as in `bench.simulate`; `periods` of each record (default: the experiment's), which the map then asks for.
    `constants` {joint: N m/A}: those joints are driven and recorded in A. ExperimentError for a cell that can not be run; nothing
    is written then.
    """
    directory, constants = Path(directory), dict(constants or {})
    for joint in constants:
        if joint not in chain.names:
            raise IdentError(f"torque constant of {joint!r}: no such joint; expected one of {', '.join(chain.names)}")
    jobs = design(chain, robot, [(cell.joint, cell.q) for cell in cells], seed=seed, realisations=realisations)
    setups = [job.setup for job in jobs]
    if periods is not None:
        setups = [replace(setup, periods=count) for setup, count in zip(setups, periods, strict=True)]
    cells = [cell for cell in cells for _ in range(realisations)]
    urdf = _urdf(robot)
    texts = {
        urdf: text_of_arm(chain),
        "excitation.json": json.dumps(_document(robot, chain, cells, setups, constants), indent=1, ensure_ascii=False)
        + "\n",
        "map.toml": _map(robot, chain, setups, urdf, constants, periods is not None),
    }
    for k, setup in enumerate(setups):
        texts[f"excitation/{_id(k)}.csv"] = _csv(robot, chain, setup, constants)
    for name, text in texts.items():
        replace_file(directory / name, text)
    for path in (directory / "excitation").glob("*.csv"):
        if f"excitation/{path.name}" not in texts and _exported(path):
            path.unlink()
    return tuple(directory / name for name in texts)


def check_place(robot: Robot, directory: str | Path) -> None:
    """Raises IdentError where the files would replace the robot's own URDF, to which they add which joints are the arm, or a map.toml that a
    person wrote; one of an earlier export is written anew, whatever was changed in it since."""
    urdf, mapping = Path(directory) / _urdf(robot), Path(directory) / "map.toml"
    try:
        own = urdf.exists() and urdf.samefile(robot.urdf)
        foreign = mapping.is_file() and not mapping.read_bytes().startswith(_MAP.encode())
    except OSError as error:
        raise IdentError(f"{directory}: cannot be read: {error.strerror}") from None
    if own or foreign:
        what = f"{urdf}: the robot's own URDF" if own else f"{mapping}: a map that was not exported"
        raise IdentError(f"{what}, which what is to be played would replace; choose another directory")


def _urdf(robot: Robot) -> str:
    """The name of the URDF beside what is played."""
    return as_text(f"{robot.urdf.stem}.urdf")


def torque_column(chain: Chain, joint: str, constants: Mapping[str, float]) -> str:
    """The heading of a joint's torque in the files played and recorded: a current where it has a torque constant."""
    return f"{'i' if joint in constants else 'tau'}_{_labels(chain)[joint]}"


def _id(k: int) -> str:
    return f"{k + 1:04d}"


def _exported(path: Path) -> bool:
    """Whether the file is the excitation of some record, and nothing that a person recorded."""
    if not (_NAME.fullmatch(path.name) and path.is_file()):
        return False
    with path.open("rb") as file:
        return _HEAD.fullmatch(file.readline().rstrip()) is not None


def _labels(chain: Chain) -> dict[str, str]:
    """Every joint's name where that can head a column, else its number; no two alike."""
    labels = {name: name for name in chain.names if re.fullmatch(r"[\w.-]+", name, re.ASCII)}
    for k, name in enumerate(chain.names):
        if name not in labels:
            label = f"joint{k + 1}"
            while label in labels.values():
                label += "_"
            labels[name] = label
    return labels


def _csv(robot: Robot, chain: Chain, setup: Setup, constants: Mapping[str, float]) -> str:
    e = robot.experiment
    joint, labels = chain.names[setup.joint], _labels(chain)
    torque = setup.excitation.samples(e.fs) / constants.get(joint, 1.0)
    head = ["t", torque_column(chain, joint, constants), *(f"q_{labels[name]}" for name in chain.names)]
    posture = ",".join(f"{value:.10g}" for value in setup.posture)
    rows = (f"{k / e.fs:.10g},{value:.12g},{posture}" for k, value in enumerate(torque.tolist()))
    return "\n".join([",".join(head), *rows]) + "\n"


def _document(
    robot: Robot, chain: Chain, cells: Sequence[Cell], setups: Sequence[Setup], constants: Mapping[str, float]
) -> dict[str, Any]:
    e = robot.experiment
    return {
        "format": FORMAT,
        "version": VERSION,
        "robot": robot.name,
        "urdf_sha256": chain.sha256,
        "joints": list(chain.names),
        "fs_hz": e.fs,
        "f0_hz": e.f0,
        "samples_per_period": e.samples_per_period,
        "ramp_samples": int(RAMP * e.samples_per_period),
        "ramp": "multiply sample k of the first period by (1 - cos(pi k / ramp_samples)) / 2 while k < ramp_samples",
        "servo": _SERVO,
        "torque_constant_Nm_per_A": dict(constants),
        "records": [
            _record(robot, chain, k, cell, setup) for k, (cell, setup) in enumerate(zip(cells, setups, strict=True))
        ],
    }


def _record(robot: Robot, chain: Chain, k: int, cell: Cell, setup: Setup) -> dict[str, Any]:
    drives = [robot.drive(name) for name in chain.names]
    plant = build_plant(chain, drives, robot.gravity, setup.posture)
    return {
        "id": _id(k),
        "file": f"excitation/{_id(k)}.csv",
        "record_as": f"{_id(k)}.csv",
        "excited": cell.joint,
        "spare": cell.spare,
        "posture": setup.posture.tolist(),
        "periods": setup.periods,
        "lines": setup.excitation.lines.tolist(),
        "rms_Nm": setup.excitation.rms,
        "crest": setup.excitation.crest(robot.experiment.fs),
        "settling_periods": setup.settle,
        "predicted_swing_rad": setup.swing,
        "note": setup.note,
        "motors": [
            {
                "joint": chain.names[j],
                "rest_rad": float(plant.rest[j]),
                "preload_Nm": float(plant.preload[j]),
                "predicted_peak_Nm": float(peak),
                "kp_Nm_per_rad": servo.kp,
                "kd_Nms_per_rad": servo.kd,
                "J_kgm2": servo.J,
                "dob_rad_per_s": servo.dob,
            }
            for j, servo, peak in zip(setup.live, setup.servos, setup.torque, strict=True)
        ],
    }


def _map(
    robot: Robot, chain: Chain, setups: Sequence[Setup], urdf: str, constants: Mapping[str, float], asked: bool
) -> str:
    """map.toml; it asks for the periods of each record where these are `asked` for, else for all that were recorded."""
    e, labels = robot.experiment, _labels(chain)
    linked = any(robot.drive(name).link_encoder_counts is not None for name in chain.names)
    rows = [
        f"{_MAP} a CSV of the same name: a column t [s], and for every joint the torque command",
        f"# and the motor angle, motor side,{' and the link angle,' if linked else ''} from the first sample of the ramp on. Then, where the records are:",
        "# ident import --map map.toml 0001.csv 0002.csv .. -o campaign.h5",
        "",
        "[campaign]",
        f"source = {quoted(f'measured on {robot.name}')}",
        'hold = "zoh"   # the torques are commands; "band-limited" if they are measured behind a filter',
        "",
        "[robot]",
        f"urdf = {quoted(urdf)}",
        f"joints = [{', '.join(map(quoted, chain.names))}]",
        f"gravity_m_per_s2 = {_list(robot.gravity)}",
    ]
    for name in chain.names:
        drive = robot.drive(name)
        m = ("N_rad_per_m", "K_N_per_m") if drive.linear else ("N", "K_Nm_per_rad")
        column = torque_column(chain, name, constants)
        unit = f'unit = "A", torque_constant_Nm_per_A = {constants[name]!r}' if name in constants else 'unit = "Nm"'
        rows += [
            "",
            f"[joint.{key(name)}]",
            f"{m[0]} = {drive.N!r}",
            f"J_m_kgm2 = {drive.J_m!r}",
            f"{m[1]} = {drive.K!r}",
            f"torque = {{name = {quoted(column)}, {unit}}}",
            f'motor_angle = {{name = {quoted("theta_" + labels[name])}, unit = "rad"}}',
        ]
        if drive.link_encoder_counts is not None:
            unit = "m" if drive.linear else "rad"
            rows.append(f'link_angle = {{name = {quoted("link_" + labels[name])}, unit = "{unit}"}}')
    rows += [
        "",
        "[record]",
        'time = {name = "t", unit = "s"}',
        f"sample_rate_Hz = {e.fs!r}",
        f"period_samples = {e.samples_per_period}",
        f"f0_Hz = {e.f0!r}",
    ]
    for k, setup in enumerate(setups):
        rows += [
            "",
            f'[file."{_id(k)}.csv"]',
            f"excited = {quoted(chain.names[setup.joint])}",
            f"posture_rad = {_list(setup.posture)}",
            f"lines = {setup.excitation.lines.tolist()}",
            *([f"periods = {setup.periods}"] if asked else []),
        ]
    return "\n".join(rows) + "\n"


def _list(values: Array) -> str:
    return f"[{', '.join(repr(float(value)) for value in values)}]"
