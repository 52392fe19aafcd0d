"""The commands around a real machine, for `cli`: new, doctor, export-excitation, import. Each parses, calls and prints."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from ident import record_options
from ident.errors import IdentError

#: Returns the parser of a new command: its name and what it does.
NewCommand = Callable[[str, str], argparse.ArgumentParser]


def add(command: NewCommand) -> None:
    """Adds the commands to the command line; each sets `action`, which takes the options and returns the exit status."""
    new = command("new", "Make a robot directory from a URDF: a robot.toml with every key, its numbers to be checked.")
    new.add_argument("urdf", metavar="URDF")
    new.add_argument("-o", dest="out", metavar="DIR", help="the directory to make (default: the URDF's name)")
    new.add_argument("--base", metavar="LINK", help="where the arm begins (default: at the root)")
    new.add_argument("--tip", metavar="LINK", help="where it ends (default: at the end of the longest chain)")
    new.set_defaults(action=_new)
    doctor = command("doctor", "Say on one page whether a robot is ready for a campaign; exit status 1 if it is not.")
    doctor.add_argument("robot", metavar="ROBOT_DIR", help="directory with robot.toml and the URDF it names")
    doctor.set_defaults(action=_doctor)
    play = command(
        "export-excitation", "Write what a real robot has to play, and the map that brings its records back."
    )
    play.add_argument("plan", metavar="PLAN|ROBOT_DIR", help="a plan.json, or a robot directory, which is then planned")
    play.add_argument(
        "--robot", metavar="ROBOT_DIR", help="the robot of a plan.json that does not lie beside its robot.toml"
    )
    play.add_argument("-o", dest="out", metavar="DIR", help="write the files here (default: play, beside the plan)")
    play.add_argument("--seed", type=int, default=0, help="of the excitation (default 0)")
    record_options.add_target(play)
    record_options.add_lengths(play)
    play.add_argument(
        "--torque-constant", metavar="JOINT=NM_PER_A", action="append", default=[], help="this joint is driven in A"
    )
    play.set_defaults(action=_export_excitation)
    bring = command("import", "Bring measured records of a real machine into a campaign file, as a map.toml says.")
    bring.add_argument("files", metavar="FILE", nargs="*", help="records: MAT, CSV, NPZ, HDF5 or MCAP, one a file")
    bring.add_argument("--map", metavar="map.toml", help="which numbers are the torque and the angles of which joint")
    bring.add_argument("-o", dest="out", metavar="FILE.h5", help="the campaign file to write")
    bring.add_argument("--guess", action="store_true", help="print a first map.toml, to be checked by a person")
    bring.add_argument("--keys", action="store_true", help="say what every key of a map.toml means")
    bring.add_argument("--urdf", metavar="URDF", help="with --guess: the declared robot")
    bring.set_defaults(action=_import)


def _import(options: argparse.Namespace) -> int:
    from ident.machines.importing import import_files
    from ident.machines.log_importing import import_log
    from ident.machines.mapping import load_map
    from ident.records.store import write_campaign, write_log

    if options.keys:
        return _keys(options)
    if not options.files:
        raise IdentError("import: no FILE; expected the records to bring in")
    if options.guess:
        return _guess(options)
    if options.map is None:
        raise IdentError("import: --map is missing; expected a map.toml (--guess prints a first one)")
    if options.out is None:
        raise IdentError("import: -o is missing; expected the campaign file to write")
    mapping = load_map(options.map)
    if mapping.is_log:
        log = import_log(mapping, options.files)
        write_log(log.log, options.out)
        return _brought(
            options, "log", [run.id for run in log.log.trajectories], log.log.source, log.records, log.notes
        )
    found = import_files(mapping, options.files)
    write_campaign(found.campaign, options.out)
    ids = [record.id for record in found.campaign.records]
    return _brought(options, "campaign", ids, found.campaign.source, found.records, found.notes)


def _brought(
    options: argparse.Namespace,
    kind: str,
    ids: Sequence[str],
    source: str,
    records: Sequence[str],
    notes: Sequence[str],
) -> int:
    if options.json:
        print(json.dumps({"campaign": options.out, "kind": kind, "records": ids, "notes": notes}))
        return 0
    for line in records:
        print(line)
    for note in notes:
        print(f"! {note}", file=sys.stderr)
    print(f"{options.out}: {len(ids)} {'records' if kind == 'campaign' else 'trajectories'}, {source}")
    return 0


def _keys(options: argparse.Namespace) -> int:
    from ident.machines.mapping import KEYS

    if options.json:
        print(json.dumps(KEYS))
        return 0
    titles = {"joint": "[joint.NAME]", "file": '[file."NAME"]', "signal": "a signal: {name = .., ..}"}
    for table, keys in KEYS.items():
        print(titles.get(table, f"[{table}]"))
        for key, meaning in keys.items():
            print(f"  {key:<26}{meaning}")
    return 0


def _guess(options: argparse.Namespace) -> int:
    from ident.machines.guess import guess

    for name in ("map", "out"):
        if getattr(options, name) is not None:
            raise IdentError(
                f"import: {'-o' if name == 'out' else '--map'} does not go with --guess, which prints a map"
            )
    text = guess(options.files, options.urdf)
    print(json.dumps({"map": text}) if options.json else text, end="\n" if options.json else "")
    return 0


def _new(options: argparse.Namespace) -> int:
    from ident.machines.starter import new_robot

    toml = new_robot(options.urdf, options.out or Path(options.urdf).stem, base=options.base, tip=options.tip)
    if options.json:
        print(json.dumps({"robot": str(toml.parent), "files": sorted(str(path) for path in toml.parent.iterdir())}))
    else:
        print(f"{toml}: check what is marked `check me`, then: ident doctor {toml.parent}")
    return 0


def _doctor(options: argparse.Namespace) -> int:
    from ident.machines.doctor import examine
    from ident.machines.doctor_page import document, page

    found = examine(options.robot)
    print(json.dumps(document(found)) if options.json else page(found))
    return 0 if found.ready else 1


def _export_excitation(options: argparse.Namespace) -> int:
    from ident.machines.playing import check_place, export_excitation
    from symgen.plan import chain_of_robot, load_plan_cells, make_model, plan_of_robot
    from symgen.robot import load_robot

    path = Path(options.plan)
    file = path / "plan.json" if path.is_dir() and not (path / "robot.toml").exists() else path
    out = options.out or str((file if file.is_dir() else file.parent) / "play")
    robot = load_robot(file if file.is_dir() else options.robot or file.parent)
    check_place(robot, out)
    if file.is_dir():
        plan = plan_of_robot(robot)
        model, cells = plan.model, plan.cells
    else:
        model = make_model(chain_of_robot(robot), believe_zeros=robot.believe_zeros)
        cells = load_plan_cells(file, model)
    robot = record_options.shortened(robot, options)
    wanted = record_options.wanted(model, robot, cells, options)
    files = export_excitation(
        wanted.robot if wanted else robot, model.chain, cells, out, seed=options.seed, realisations=options.realisations,
        periods=wanted.periods if wanted else None, constants=dict(map(_constant, options.torque_constant)),
    )  # fmt: skip
    count = len(cells) * options.realisations
    if options.json:
        precision = {"precision": record_options.told(wanted, options)} if wanted else {}
        print(json.dumps({"directory": out, "records": count, "files": [str(file) for file in files], **precision}))
        return 0
    if wanted:
        print(f"For --target {wanted.text}")
    print(f"{out}: {count} records to play, and map.toml to bring them back with ident import")
    return 0


def _constant(text: str) -> tuple[str, float]:
    joint, _, value = text.rpartition("=")
    try:
        constant = float(value)
    except ValueError:
        constant = 0.0
    if not joint or not 0 < constant < float("inf"):
        raise IdentError(f"--torque-constant {text}: expected JOINT=NM_PER_A, a number > 0")
    return joint, constant
