"""symgen URDF: derive, factor, plan, write. Parses, calls and prints; the work is elsewhere."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields
from functools import partial
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symgen.errors import NoPlanError, SymgenError

if TYPE_CHECKING:
    from symgen.basis import Factoring
    from symgen.emit import Expressions
    from symgen.output import OfModel
    from symgen.plan import Model, Plan
    from symgen.request import Request

#: Threads cost more than they give on the small matrices here; set before numpy is first imported.
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="symgen",
        description="From a URDF to J_ii(q) = C_i(q) alpha_i, the postures that measure alpha, and code for both.",
        epilog="symgen plan DIR --plot draws the plan in a directory that -o wrote (symgen plan --help).",
    )
    parser.add_argument("urdf", metavar="URDF", nargs="?", help="the robot; a robot.toml beside it is read too")
    parser.add_argument("-o", dest="out", metavar="DIR", type=_stated, help="write plan, functions and equations here")
    parser.add_argument(
        "--check",
        metavar="DIR",
        help="compare the files there, drawings aside, with what would be written for URDF (default: "
        "DIR/../../robots/NAME/NAME.urdf)",
    )
    parser.add_argument("--base", metavar="LINK", type=_stated, help="first link of the arm (default: the root)")
    parser.add_argument(
        "--tip", metavar="LINK", type=_stated, help="last link of the arm (default: end of the longest run of joints)"
    )
    parser.add_argument(
        "--at",
        metavar="NAME=VALUE,..",
        type=_stated,
        help="freeze these joints there [rad or m]; default 0; before --base they turn gravity, along -z of the root",
    )
    parser.add_argument(
        "--believe-zeros",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="take inertial parameters that are exactly zero in the URDF as known (default: as robot.toml says, else no)",
    )
    parser.add_argument("--no-snap", dest="snap", action="store_false", help="keep angles such as 1.5708 as written")
    parser.add_argument("--spare", metavar="N", type=int, help="measurements beyond the minimum (default: a quarter)")
    parser.add_argument("--refine", action="store_true", help="search longer for the best plan")
    parser.add_argument(
        "--draft",
        action="store_true",
        help="take the first good plan; the D-efficiency it states is far below the true one",
    )
    parser.add_argument(
        "--postures", metavar="FILE", help="judge these: lines of joint name, q1, .. [rad or m], or JSON"
    )
    parser.add_argument("--grid", metavar="STEP", help="plan on multiples of this, as 15deg or 15deg,5mm (slides: 1cm)")
    parser.add_argument("--triangular", action="store_true", help="the paper's kind of plan, where the arm has one")
    parser.add_argument(
        "--no-feasible",
        dest="feasible",
        action="store_false",
        help="plan postures whatever gravity asks of the motors or touches itself",
    )
    parser.add_argument(
        "--columns",
        action="store_true",
        help="also plan runs in which the held joints are read too: all of J(q) from few",
    )
    parser.add_argument("--no-verify", action="store_true", help="do not compare J(q) with Pinocchio's")
    parser.add_argument("--json", action="store_true", help="print one JSON document and nothing else")
    return parser


def _stated(text: str) -> str:
    """The text of an option; argparse.ArgumentTypeError for none, as of a shell variable that is not set."""
    if not text.strip():
        raise argparse.ArgumentTypeError("empty; expected a text, or no such option")
    return text


def _plan_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="symgen plan", description="Shows the plan in a directory that -o wrote.")
    parser.add_argument("directory", metavar="DIR", type=Path, help="holds plan.json")
    parser.add_argument("urdf", metavar="URDF", type=Path, nargs="?", help="default: DIR/../../robots/NAME/NAME.urdf")
    parser.add_argument("--plot", action="store_true", help="draw postures, coverage, singular values, amplification")
    parser.add_argument("-o", dest="out", metavar="FILE.svg", type=Path, help="default: NAME_plan.svg, here")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit status.

    0 done, 1 done but a problem was found (files differ, postures do not suffice, no plan of that kind), 2 misuse or bad
    input (one line on standard error), 130 interrupted.
    """
    for name in _ONE_THREAD:
        os.environ.setdefault(name, "1")
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # of a name that the terminal can not show
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        if null := [word for word in words if "\0" in word]:
            raise SymgenError(
                f"{_before(words, null[0])}{null[0]!r}: no such file: a path can not hold a null character"
            )
        if words[:1] == ["plan"]:
            return _plan(_plan_parser().parse_args(words[1:]))
        parser = _parser()
        options = parser.parse_args(words)
        if options.urdf is None and options.check is None:
            parser.error("the following arguments are required: URDF")
        return _check(options) if options.check is not None else _run(options)
    except NoPlanError as error:
        return _failed(str(error), 1)
    except SymgenError as error:
        return _failed(str(error), 2)
    except OSError as error:
        where = "" if error.filename is None else f"{error.filename}: "
        return _failed(f"{where}{error.strerror or error}", 2)
    except KeyboardInterrupt:
        return _failed("interrupted", 130)


def _failed(message: str, status: int) -> int:
    """One line on standard error, whatever a path may hold."""
    print(f"symgen: {' '.join(message.splitlines())}", file=sys.stderr)
    return status


def _before(words: Sequence[str], word: str) -> str:
    """The option that a word belongs to, with a space behind it; nothing for one that stands alone."""
    at = words.index(word)
    return f"{words[at - 1]} " if at and words[at - 1].startswith("-") else ""


def _request(options: argparse.Namespace) -> Request:
    from symgen.request import Request

    return Request(**{field.name: getattr(options, field.name) for field in fields(Request)})


def _run(options: argparse.Namespace) -> int:
    from symgen.request import plan_for

    result = plan_for(Path(options.urdf), _request(options), partial(_of_model, options))
    document = dict(result.document)
    verified, made = result.meanwhile
    if verified:
        document["verified"] = verified
    begin = time.perf_counter()
    document["files"] = _write(result, made, Path(options.out)) if options.out else []
    document["seconds"] = {**result.seconds, "emit": time.perf_counter() - begin}
    if options.json:
        print(json.dumps(document))
    else:
        _print(document)
    return 1 if document["plan"]["open"] or document["plan"]["infeasible"] else 0


def _of_model(options: argparse.Namespace, model: Model) -> tuple[dict[str, Any] | None, OfModel | None]:
    """What is asked for and needs no plan: how far J(q) is from Pinocchio's, and what will be written."""
    from symgen.emit import Expressions
    from symgen.output import of_model

    expressions = Expressions(model.factoring) if options.out or not options.no_verify else None
    verified = None if options.no_verify else _verified(model.factoring, expressions)
    return verified, of_model(model, expressions) if options.out else None


def _check(options: argparse.Namespace) -> int:
    from symgen.check import check

    if options.out is not None:
        raise SymgenError(f"-o {options.out}: expected without --check, which writes nothing")
    result = check(Path(options.check), Path(options.urdf) if options.urdf else None, _request(options))
    if options.json:
        print(json.dumps(result.document()))
    else:
        for name, what in result.differences.items():
            print(f"{result.directory / name}: {what}")
        if not result.differences:
            print(f"{result.directory}: {result.files} files, all as symgen writes them for {result.urdf}")
    return 1 if result.differences else 0


def _plan(options: argparse.Namespace) -> int:
    from symgen.plot import plot_of
    from symgen.request import urdf_of

    if not options.plot:
        raise SymgenError(f"plan {options.directory}: nothing to do; expected --plot")
    name = options.directory.resolve().name
    out = options.out or Path(f"{name}_plan.svg")
    if out.is_dir():
        raise SymgenError(f"-o {out}: a directory; expected a file to write")
    svg = plot_of(options.directory, options.urdf or urdf_of(options.directory))
    beside = out.with_name(f".{out.name}-{os.getpid()}")
    try:
        beside.write_text(svg, encoding="utf-8")
        os.replace(beside, out)
    except OSError as error:
        raise SymgenError(f"-o {out}: can not be written: {error.strerror}") from None
    print(out)
    return 0


def _verified(factoring: Factoring, expressions: Expressions | None) -> dict[str, Any]:
    from symgen.verify import verify

    verdict = verify(factoring, expressions=expressions)
    return {
        "against": "Pinocchio CRBA",
        "postures": verdict.postures,
        "relative_error": verdict.error,
        "relative_error_to_file_as_written": verdict.as_written,
    }


def _write(result: Plan, made: OfModel | None, directory: Path) -> list[str]:
    """Writes everything into a folder of its own in the directory, and moves it out of there file by file: never a
    half-written output. Folders that were not there are removed again where that fails."""
    from symgen import output

    if directory.exists() and not directory.is_dir():
        raise SymgenError(f"-o {directory}: a file; expected a directory")
    new = [folder for folder in (directory, *directory.parents) if not folder.exists()]
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".symgen-", dir=directory, ignore_cleanup_errors=True) as within:
            names = output.write_all(result, Path(within), made)
            for name in names:
                if (directory / name).is_dir():
                    raise SymgenError(f"{directory / name}: a directory; expected a file to replace, or nothing")
            for name in names:
                os.replace(Path(within, name), directory / name)
    except BaseException:
        for folder in new:
            with suppress(OSError):
                folder.rmdir()
        raise
    return [str(directory / name) for name in names]


def _print(document: dict[str, Any]) -> None:
    plan = document["plan"]
    n = len(document["joints"])
    print(f"{document['robot']}: {n} joints, {document['base']} to {document['tip']}")
    print(f"{'joint':<24}{'type':<11}{'monomials':>9}{'rank':>6}{'new alpha':>11}{'cells':>7}{'amplification':>15}")
    for k in range(n):
        cells = sum(cell["joint"] == document["joints"][k] and not cell["spare"] for cell in plan["cells"])
        print(
            f"{document['joints'][k]:<24}{document['types'][k]:<11}{document['monomials_per_joint'][k]:>9}"
            f"{document['rank_per_joint'][k]:>6}{document['new_per_joint'][k]:>11}{cells:>7}"
            f"{_number(plan['amplification_per_joint'][k]):>15}"
        )
    kept, dropped = document["singular_value_gap"]
    print(
        f"{document['shared_rank']} shared constants give every J_ii (singular values: {kept:g} kept, {dropped:g} dropped),"
    )
    print(f"{document['full_inertia_rank']} give all of J(q).")
    if "dropped" in document:
        print(f"What hardly matters is left out: it changes J by {document['dropped']['cost']:g} of its largest entry.")
    for row in document["unseen"]:
        print(
            f"  {row['directions']} directions of {row['entry']} no J_ii shows: {row['measure']} at {row['postures']} postures"
        )
    if document["believed_zeros"]:
        print(f"Believed to be exactly zero: {len(document['believed_zeros'])} inertial parameters (see plan.json).")
    for row in document["snapped"]:
        print(f"Snapped: {row['joint']} {row['from']:g} -> {row['to']} rad, changes J by {row['cost']:g}")
    if document["frozen"]:
        print("Frozen: " + ", ".join(f"{name} = {value:g}" for name, value in document["frozen"].items()))
    print(
        f"Plan: {plan['measurements']} measurements and {plan['spare']} spare ones, "
        f"D-efficiency at least {plan['d_efficiency_at_least']:.3f}"
    )
    if columns := document.get("column_plan"):
        print(f"Column plan: {columns['runs']} runs tell all of J(q), amplification {columns['amplification']:.3g}")
    if plan["open"]:
        print(
            f"The postures determine {plan['rank']} of {document['shared_rank']} constants; open: {', '.join(plan['open'])}"
        )
    for row in plan["infeasible"]:
        print(f"Cell {row['cell']} ({row['joint']}) can not be held: {row['why']}")
    if "verified" in document:
        verified = document["verified"]
        written = verified["relative_error_to_file_as_written"]
        print(
            f"J(q) equals Pinocchio's to {verified['relative_error']:.1e} at {verified['postures']} random postures"
            + (
                "; Pinocchio does not read the file itself."
                if written is None
                else f", and that of the file as Pinocchio reads it to {written:.1e}."
            )
        )
    for name in document["files"]:
        print(name)


def _number(value: float | None) -> str:
    return "open" if value is None else f"{value:.3g}"


if __name__ == "__main__":
    sys.exit(main())
