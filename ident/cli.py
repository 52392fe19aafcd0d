"""ident: simulate a campaign, fit one, or both. Parses, calls and prints; the work is elsewhere."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ident.commands import add as commands_of_a_machine
from ident.diagnosis_commands import add as commands_of_the_loop
from ident.errors import IdentError
from symgen.errors import SymgenError

if TYPE_CHECKING:
    from ident.campaign import Campaign
    from ident.effects.base import Effect
    from ident.identify import Identification
    from symgen.robot import Drive, Robot

#: Notes printed with --brief.
_BRIEF = 3

#: Threads cost more than they give on the small matrices here; set before numpy is first imported.
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ident",
        description="Identify the inertia matrix J(q) of an arm with elastic joints from frequency responses.",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.add_argument("--json", action="store_true", help="print one JSON document and nothing else")
        sub.set_defaults(action=None)
        return sub

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
        sub.add_argument(
            "--target", type=_share, metavar="SHARE", help="the least robot time that tells J(q) to this standard deviation, relative "
            "to sqrt(J_ii J_jj), as 1%% or 0.01: spacing of the lines, and periods of each record",
        )  # fmt: skip
    simulate.add_argument("--spacing", type=float, metavar="HZ", help="of the lines, in place of robot.toml's")
    simulate.add_argument("--periods", type=int, metavar="N", help="recorded, the settling ones included, likewise")
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
    paper.add_argument("robot", metavar="ROBOT_DIR", nargs="?", default="robots/ypp3", help="default robots/ypp3")
    commands_of_a_machine(command)
    commands_of_the_loop(command)
    return parser


def _share(text: str) -> float:
    """1% or 0.01, as a number."""
    value = float(text[:-1]) / 100 if text.endswith("%") else float(text)
    if not 0.0 < value < 1.0:
        raise ValueError(text)
    return value


_share.__name__ = "share"  # as argparse calls it in "invalid share value"


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit status.

    0 done; 1 done, but a problem was found (a fit that does not explain its data); 2 misuse or bad input (one line).
    """
    for name in _ONE_THREAD:
        os.environ.setdefault(name, "1")
    options = _parser().parse_args(arguments)
    try:
        _check(options)
        actions = {"simulate": _simulate, "run": _run, "fit": _fit, "export": _export, "paper": _paper}
        return (options.action or actions[options.command])(options)
    except (IdentError, SymgenError) as error:
        return _failed(str(error))
    except OSError as error:
        return _failed(f"{error.filename}: {error.strerror}")
    except KeyboardInterrupt:
        _failed("interrupted; records that are done stay, the same command goes on there")
        return 130


def _failed(message: str) -> int:
    """One line on standard error, whatever a path may hold."""
    print(f"ident: {' '.join(message.splitlines())}", file=sys.stderr)
    return 2


def _check(options: argparse.Namespace) -> None:
    """Refuses at once what would otherwise be found after minutes of simulation."""
    for name, value in vars(options).items():
        if isinstance(value, str) and "\0" in value:
            raise IdentError(f"{'-o' if name == 'out' else name} {value!r}: expected text without null characters")
    if getattr(options, "seed", 0) < 0:
        raise IdentError(f"--seed {options.seed}: expected 0 or more")
    for name in ("spacing", "periods"):
        if getattr(options, "target", None) and getattr(options, name, None):
            raise IdentError(f"--target does not go with --{name}, which it chooses")
    if "method" in options:
        from ident.identify import METHODS

        if options.method not in (*METHODS, "all"):
            raise IdentError(f"method {options.method!r}: expected one of {', '.join(METHODS)}, all")
    if getattr(options, "out", None) is None:
        return
    if options.command in ("run", "fit", "export", "diagnose"):
        from ident.export import check_place

        check_place(options.out)
    out = Path(options.out)
    if options.command in ("simulate", "import"):
        if out.is_dir():
            raise IdentError(f"-o {out}: a directory; expected a file to write")
        if not out.parent.is_dir():
            raise IdentError(f"-o {out}: no directory {out.parent}; expected one that exists")
    elif out.exists() and not out.is_dir():
        raise IdentError(f"-o {out}: a file; expected a directory")
    nearest = next(path for path in (out, *out.resolve().parents) if path.exists())
    if not os.access(nearest if nearest.is_dir() else nearest.parent, os.W_OK):
        raise IdentError(f"-o {out}: {nearest} can not be written to")


def _progress(options: argparse.Namespace) -> Callable[[str], None]:
    """Says on standard error what is being done, on one line where that is a terminal; never with --json."""
    if options.json or not sys.stderr.isatty():
        return lambda text: None
    return lambda text: print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)


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


@contextmanager
def _bar(options: argparse.Namespace) -> Iterator[Callable[[int, int], None]]:
    """A progress bar of records on standard error where that is a terminal; never with --json."""
    from tqdm import tqdm

    with tqdm(unit="record", disable=options.json or not sys.stderr.isatty(), leave=False) as bar:

        def update(done: int, total: int) -> None:
            if bar.total is None:
                bar.reset(total)
                bar.initial = done
            bar.update(done - bar.n)

        yield update


def _simulated(options: argparse.Namespace, path: Path) -> tuple[bool, dict[str, Any]]:
    """Writes the planned campaign of a robot directory on the simulated robot; what to tell of it, and whether zeros are
    believed."""
    from ident.bench import design, head
    from ident.design import summary
    from ident.resume import run_to_file
    from symgen.plan import chain_of_robot, load_plan_cells, make_model, plan_of_robot
    from symgen.robot import load_robot

    robot = _shortened(load_robot(options.robot), options)
    if getattr(options, "plan", None):
        model = make_model(chain_of_robot(robot), believe_zeros=robot.believe_zeros)
        planned = load_plan_cells(options.plan, model)
    else:
        plan = plan_of_robot(robot)
        model, planned = plan.model, plan.cells
    chain, cells = model.chain, [(cell.joint, cell.q) for cell in planned]
    effects = _effects(options, [robot.drive(name) for name in chain.names])
    wanted = None
    if options.target:
        from ident.precision import for_target

        wanted = for_target(model, robot, cells, options.target, lock=options.lock, seed=options.seed)
        robot = wanted.robot
    jobs = design(chain, robot, cells, lock=options.lock, seed=options.seed, effects=effects)
    if wanted:
        jobs = tuple(
            replace(job, setup=replace(job.setup, periods=k)) for job, k in zip(jobs, wanted.periods, strict=True)
        )
    notes = (*summary(chain, [job.setup for job in jobs]), *([f"For --target {wanted.text}"] if wanted else ()))
    empty = head(chain, robot, (), lock=options.lock)
    _directory(str(path.parent))
    with _bar(options) as progress:
        run_to_file(
            jobs, empty, path, progress=progress, say=lambda line: print(f"ident: {line}", file=sys.stderr, flush=True)
        )
    records = [job.id for job in jobs]
    told: dict[str, Any] = {"campaign": str(path), "records": records, "source": empty.source, "notes": notes}
    if wanted:
        told["precision"] = {"target": options.target, "predicted": wanted.sigma, "robot_time_s": wanted.seconds}
    return robot.believe_zeros, told


def _shortened(robot: Robot, options: argparse.Namespace) -> Robot:
    """The robot with the line spacing and the periods of the command line, where they are given."""
    e = robot.experiment
    f0, periods = getattr(options, "spacing", None), getattr(options, "periods", None)
    if f0 is not None:
        samples = e.fs / f0 if f0 > 0.0 else 0.0
        if not (e.fs / 2 > e.band[1] >= f0 > 0.0 and abs(samples - round(samples)) < 1e-9 * samples):
            raise IdentError(
                f"--spacing {f0:g}: expected Hz that divide the sampling rate of {e.fs:g} Hz, below {e.band[1]:g}"
            )
        e = replace(e, f0=f0, band=(max(e.band[0], f0), e.band[1]))
    if periods is not None:
        if periods < 2:
            raise IdentError(f"--periods {periods}: expected 2 or more (at least one settles)")
        e = replace(e, periods=periods)
    return replace(robot, experiment=e)


def _simulate(options: argparse.Namespace) -> int:
    _, done = _simulated(options, Path(options.out))
    if options.json:
        print(json.dumps(done, ensure_ascii=False))
        return 0
    for note in done["notes"]:
        print(note)
    print(f"{options.out}: {len(done['records'])} records, {done['source']}")
    return 0


def _run(options: argparse.Namespace) -> int:
    from ident.store import read_campaign

    out = Path(options.out)
    believe_zeros, told = _simulated(options, out / "campaign.h5")
    return _identified(read_campaign(out / "campaign.h5"), believe_zeros, out, options, told.get("precision"))


def _fit(options: argparse.Namespace) -> int:
    from ident.store import read_campaign

    campaign = read_campaign(options.campaign)
    return _identified(campaign, options.believe_zeros, Path(options.out), options)


def _export(options: argparse.Namespace) -> int:
    from ident.export import read, write_files

    place = Path(options.result)
    files = write_files(read(place), options.out or (place if place.is_dir() else place.parent))
    if options.json:
        print(json.dumps({"files": [str(path) for path in files]}))
    else:
        print("\n".join(str(path) for path in files))
    return 0


def _paper(options: argparse.Namespace) -> int:
    from ident import paper

    tables = paper.run(options.robot, progress=_progress(options))
    print(json.dumps(paper.document(tables)) if options.json else paper.text(tables))
    return 0


def _directory(path: str) -> Path:
    directory = Path(path)
    directory.mkdir(parents=True, exist_ok=True)
    return directory


def _identified(
    campaign: Campaign, believe_zeros: bool | None, out: Path, options: argparse.Namespace,
    wanted: dict[str, float] | None = None,
) -> int:  # fmt: skip
    from ident import report
    from ident.export import write_identified
    from ident.identify import METHODS, identify
    from ident.side_by_side import comparison, table
    from symgen.robot import load_robot

    every = options.method == "all"
    method = METHODS[0] if every else options.method
    result = identify(campaign, method=method, believe_zeros=believe_zeros, progress=_progress(options))
    others = [
        identify(campaign, method=other, believe_zeros=believe_zeros, progress=_progress(options))
        for other in (METHODS[1:] if every else ())
    ]
    _directory(str(out))
    report.write(result, out)
    report.summary_plot(result, out / "responses.svg")
    write_identified(result, out, load_robot(options.robot) if options.command == "run" else None)
    document = report.result_document(result)
    if every:
        document["methods"] = comparison([result, *others])
    if wanted:
        entries = [value for row in document["certainty"]["per_entry"] for value in row]
        document["precision"] = {**wanted, "achieved": None if None in entries else max(entries)}
    if options.json:
        print(json.dumps(document, ensure_ascii=False))
    else:
        if every:
            print(table(document["methods"]))
        _print(result, document, out, options.brief)
    return 1 if _doubtful(result, document) else 0


def _doubtful(result: Identification, document: dict[str, Any]) -> bool:
    return not result.explained or any(problem["serious"] for problem in document["problems"])


def _print(result: Identification, document: dict[str, Any], out: Path, brief: bool) -> None:
    print(result.campaign.source)
    print()
    width = 9 * result.campaign.n
    head = f"{'posture [rad, m]':<{width}}{'measured':>11}{'sigma':>9}{'CAD':>10}{'error %':>9}{'chi2/dof':>10}"
    print(f"{'record':<7}{'entry':<6}{head}")
    for measured in result.measurements:
        posture = "".join(f"{value:8.4f} " for value in measured.record.posture)
        values = (
            f"{measured.J:>11.5f}{measured.std:>9.2g}{measured.J_cad:>10.5f}{_percent(measured.J, measured.J_cad):>9}"
        )
        fits = "" if measured.explained else "  does not fit"
        entry = f"J_{measured.index + 1}{measured.index + 1}"
        print(f"{measured.record.id:<7}{entry:<6}{posture}{values}{measured.chi2_per_dof:>10.3g}{fits}")
    print()
    print(f"{'constant':<14}{'identified':>12}{'sigma':>12}{'CAD':>12}{'error %':>9}  unit")
    alpha = document["alpha"]
    columns = (alpha[key] for key in ("names", "value", "std", "unit", "cad"))
    for name, value, std, unit, cad in zip(*columns, strict=True):
        sigma = "held at CAD" if std is None else f"{std:.2g}"
        print(f"{name:<14}{value:>12.6f}{sigma:>12}{cad:>12.6f}{_percent(value, cad):>9}  {unit}")
    print()
    notes = result.notes[: _BRIEF if brief else None]
    for note in notes:
        print(f"! {note}")
    if len(notes) < len(result.notes):
        print(f"! {len(result.notes) - len(notes)} more notes in the report")
    largest = 100 * document["inertia_vs_cad"]["largest"]
    print(f"J(q) at 1000 postures never measured: within {largest:.3g} % of CAD's, relative to the largest entry.")
    if "precision" in document:
        said = {key: "-" if value is None else f"{100 * value:.2g} %" for key, value in document["precision"].items()}
        print(
            f"Largest sigma of J(q) over sqrt(J_ii J_jj): wanted {said['target']}, predicted {said['predicted']}, achieved "
            f"{said['achieved']}, in {document['precision']['robot_time_s']:.0f} s of robot time."
        )
    print(
        "The model explains the records."
        if not _doubtful(result, document)
        else "THE MODEL DOES NOT EXPLAIN THE RECORDS: see the report."
    )
    print(f"Report: {out / 'report.html'}")
    print(f"Plot:   {out / 'responses.svg'}")
    print(f"Robot:  {out / 'robot.toml'} with identified.urdf, identified.xml (MuJoCo), J.casadi, J.c")


def _percent(value: float, cad: float) -> str:
    """Error relative to CAD in percent; nothing where CAD says zero."""
    return f"{100 * (value - cad) / abs(cad):.3f}" if cad else ""


if __name__ == "__main__":
    sys.exit(main())
