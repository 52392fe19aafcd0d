"""The commands from a plan to J(q), for `cli`: simulate, run, fit, export, paper. Each parses, calls and prints."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ident import progress, record_options
from ident.commands import NewCommand
from ident.errors import IdentError

if TYPE_CHECKING:
    from ident.effects.base import Effect
    from ident.identification.identify import Identification
    from ident.records.campaign import Campaign
    from symgen.robot import Drive


def add(command: NewCommand) -> None:
    """Adds the commands to the command line; each sets `action`, which takes the options and returns the exit status."""
    simulate = command("simulate", "Run the planned campaign on the simulated robot and write the campaign file.")
    run = command("run", "Simulate the planned campaign, identify J(q) from it and write a report.")
    fit = command("fit", "Identify J(q) from a campaign file and write a report.")
    paper = command("paper", "Reproduce the two tables of the paper and put them right.")
    for sub in (simulate, run):
        sub.add_argument("robot", metavar="ROBOT_DIR", help="directory with robot.toml and the URDF it names")
        sub.add_argument("--seed", type=int, default=0, help="of the excitation and of the noise (default 0)")
        sub.add_argument(
            "--lock", choices=("dob", "rigid"), default="dob",
            help="hold the other joints by PD and disturbance observer on their motors (dob), or weld them (rigid)",
        )  # fmt: skip
        record_options.add_target(sub)
    record_options.add_lengths(simulate)
    simulate.add_argument(
        "--plan", metavar="PLAN.json", help="the cells of this plan (symgen, ident next) in place of the robot's own"
    )
    simulate.add_argument("-o", dest="out", metavar="FILE.h5", required=True, help="the campaign file to write")
    simulate.add_argument(
        "--effect", action="append", default=[], metavar="NAME:PARAM=VALUE,..@JOINT",
        help="put an effect that nobody declared into the simulated arm; may be repeated; the names are those of the diagnosis",
    )  # fmt: skip
    simulate.add_argument(
        "--truth", metavar="FILE.json", help="write here which effects were put in; the campaign does not tell"
    )
    fit.add_argument("campaign", metavar="CAMPAIGN.h5")
    for sub in (run, fit):
        sub.add_argument(
            "-o",
            dest="out",
            metavar="DIR",
            required=True,
            help="write result.json, report.html and the identified robot here",
        )
        sub.add_argument(
            "--method",
            default="coupled",
            help="coupled (default: all records and motors in one fit); record by record modal, two-mass, three-point (the "
            "paper's reading); or all: these side by side, the files those of coupled",
        )
        sub.add_argument("--brief", action="store_true", help="print the first few notes only")
    fit.add_argument(
        "--believe-zeros", action=argparse.BooleanOptionalAction, default=None,
        help="take inertial parameters that are exactly zero in the URDF as known (default: only where the records need it)",
    )  # fmt: skip
    export = command(
        "export", "Write the identified robot's files again: URDF, MJCF, robot.toml, CasADi and C functions."
    )
    export.add_argument("result", metavar="OUT", help="directory that ident fit wrote, or its identified.json")
    export.add_argument("-o", dest="out", metavar="DIR", help="write the files here (default: beside identified.json)")
    again = command("report", "Make the report of a result again, of the same campaign and in the same way.")
    again.add_argument("result", metavar="OUT", help="directory that ident fit, run or diagnose wrote")
    paper.add_argument("robot", metavar="ROBOT_DIR", nargs="?", default="robots/ypp3", help="default robots/ypp3")
    actions = {simulate: _simulate, run: _run, fit: _fit, export: _export, again: _report, paper: _paper}
    for sub, action in actions.items():
        sub.set_defaults(action=action)


def _effects(options: argparse.Namespace, drives: Sequence[Drive]) -> list[Effect]:
    """The effects of --effect, written to the file of --truth where one is wanted."""
    from ident.effects.catalogue import parse, truth

    effects = [parse(text, drives) for text in getattr(options, "effect", ())]
    if getattr(options, "truth", None):
        path = Path(options.truth)
        beside = path.with_name(f".{path.name}.part")
        beside.write_text(json.dumps(truth(effects, drives), indent=1) + "\n")
        os.replace(beside, path)
    return effects


def _simulated(options: argparse.Namespace, path: Path) -> tuple[bool, dict[str, Any]]:
    """Writes the planned campaign of a robot directory on the simulated robot; what to tell of it, and whether zeros are
    believed."""
    from ident.simulator.bench import design, head
    from ident.simulator.design import summary
    from ident.simulator.resume import run_to_file
    from symgen.plan import chain_of_robot, load_plan_cells, make_model, plan_of_robot
    from symgen.robot import load_robot

    robot = record_options.shortened(load_robot(options.robot), options)
    if getattr(options, "plan", None):
        model = make_model(chain_of_robot(robot), believe_zeros=robot.believe_zeros)
        planned = load_plan_cells(options.plan, model)
    else:
        plan = plan_of_robot(robot)
        model, planned = plan.model, plan.cells
    chain, cells = model.chain, [(cell.joint, cell.q) for cell in planned]
    effects = _effects(options, [robot.drive(name) for name in chain.names])
    wanted = record_options.wanted(model, robot, planned, options, options.lock)
    if wanted:
        robot = wanted.robot
    jobs = design(
        chain, robot, cells, lock=options.lock, seed=options.seed, effects=effects, realisations=options.realisations
    )
    if wanted:
        jobs = tuple(
            replace(job, setup=replace(job.setup, periods=k)) for job, k in zip(jobs, wanted.periods, strict=True)
        )
    notes = (*summary(chain, [job.setup for job in jobs]), *([f"For --target {wanted.text}"] if wanted else ()))
    empty = head(chain, robot, (), lock=options.lock)
    path.parent.mkdir(parents=True, exist_ok=True)
    with progress.bar(options) as update:
        run_to_file(
            jobs, empty, path, progress=update, say=lambda line: print(f"ident: {line}", file=sys.stderr, flush=True)
        )
    records = [job.id for job in jobs]
    told: dict[str, Any] = {"campaign": str(path), "records": records, "source": empty.source, "notes": notes}
    if wanted:
        told["precision"] = record_options.told(wanted, options)
    return robot.believe_zeros, told


def _simulate(options: argparse.Namespace) -> int:
    _, done = _simulated(options, Path(options.out))
    if options.json:
        print(json.dumps(done))
        return 0
    for note in done["notes"]:
        print(note)
    print(f"{options.out}: {len(done['records'])} records, {done['source']}")
    return 0


def _run(options: argparse.Namespace) -> int:
    out = Path(options.out)
    believe_zeros, told = _simulated(options, out / "campaign.h5")
    return _identified(out / "campaign.h5", believe_zeros, out, options, told.get("precision"))


def _fit(options: argparse.Namespace) -> int:
    return _identified(Path(options.campaign), options.believe_zeros, Path(options.out), options)


def _export(options: argparse.Namespace) -> int:
    from ident.identification.export import read, write_files

    place = Path(options.result)
    files = write_files(read(place), options.out or (place if place.is_dir() else place.parent))
    if options.json:
        print(json.dumps({"files": [str(path) for path in files]}))
    else:
        print("\n".join(str(path) for path in files))
    return 0


def _report(options: argparse.Namespace) -> int:
    from ident.diagnosis_commands import report_again
    from ident.identification.identify import identify
    from ident.loop.diagnosis_json import FILE
    from ident.plain import replace_file
    from ident.records.inputs import again, document
    from ident.reports import report
    from symgen.forked import WORKERS

    out, say = Path(options.result), progress.line(options)
    file = next((out / name for name in (FILE, "result.json") if (out / name).is_file()), out / "result.json")
    found = document(file, "ident fit, run or diagnose")
    try:
        if file.name == FILE:
            page = report_again(found, say)
        else:
            how = found["made_with"]
            result = _realised(identify(again(found["input"]), **how, workers=WORKERS, progress=say))[0]
            page = report.html(result, found.get("methods", ()))
    except (KeyError, TypeError) as error:
        raise IdentError(
            f"{file}: does not say what it was made of: {type(error).__name__} {error}; make it again"
        ) from None
    replace_file(out / "report.html", page)
    print(json.dumps({"report": str(out / "report.html")}) if options.json else f"Report: {out / 'report.html'}")
    return 0


def _paper(options: argparse.Namespace) -> int:
    from ident import paper

    tables = paper.run(options.robot, progress=progress.line(options))
    print(json.dumps(paper.document(tables)) if options.json else paper.text(tables))
    return 0


def _identified(
    file: Path,
    believe_zeros: bool | None,
    out: Path,
    options: argparse.Namespace,
    precision: dict[str, float] | None = None,
) -> int:
    from ident.identification.export import write_identified
    from ident.identification.identify import METHODS, identify
    from ident.plain import plain
    from ident.reports import report
    from ident.reports.result_page import doubtful, page
    from ident.reports.side_by_side import comparison, table
    from symgen.forked import WORKERS
    from symgen.robot import load_robot

    every, (campaign, source) = options.method == "all", _read(file)
    result, *others = (
        identify(campaign, method=method, believe_zeros=believe_zeros, workers=WORKERS, progress=progress.line(options))
        for method in (METHODS if every else (options.method,))
    )
    out.mkdir(parents=True, exist_ok=True)
    made: dict[str, Any] = {"input": source, "made_with": {"method": result.method, "believe_zeros": believe_zeros}}
    if every:
        made["methods"] = comparison([result, *others])
    result, distortions = _realised(result)
    if distortions:
        made["realisations"] = distortions
    document = report.result_document(result, precision, made)
    report.write(result, out, document)
    report.summary_plot(result, out / "responses.svg")
    write_identified(result, out, load_robot(options.robot) if options.command == "run" else None)
    if options.json:
        print(json.dumps(plain(document), allow_nan=False))
    else:
        if every:
            print(table(document["methods"]))
        print(page(result, document, options.brief))
        print(f"Report: {out / 'report.html'}")
        print(f"Plot:   {out / 'responses.svg'}")
        print(f"Robot:  {out / 'robot.toml'} with identified.urdf, identified.xml (MuJoCo), J.casadi, J.c")
    return 1 if doubtful(document) else 0


def _read(file: Path) -> tuple[Campaign, dict[str, Any]]:
    """The campaign in the file, and what a result says of that file. IdentError where another one took its place meanwhile."""
    from ident.records.inputs import told
    from ident.records.store import read_campaign

    before = _stamp(file)
    campaign, source = read_campaign(file), told([file])
    if _stamp(file) != before:
        raise IdentError(f"{file}: was replaced while it was read; expected one command at a time, run this one again")
    return campaign, source


def _stamp(file: Path) -> tuple[int, ...]:
    """Another one for every file that was ever at this place; nothing where there is none."""
    try:
        stat = file.stat()
    except (OSError, ValueError):
        return ()
    return stat.st_dev, stat.st_ino, stat.st_size, stat.st_mtime_ns


def _realised(result: Identification) -> tuple[Identification, list[dict[str, Any]]]:
    """The result with a note on what realisations of its records tell differently, and that as JSON; as it is where there are none."""
    from ident.identification import realisations

    records, responses = [m.record for m in result.measurements], [m.frf for m in result.measurements]
    found = realisations.distortions(records, responses)
    if found:
        result = replace(result, notes=(*result.notes, realisations.text(found)))
    return result, realisations.document(found)
