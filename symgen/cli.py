"""symgen URDF: derive, factor, plan, write. Parses, calls and prints; the work is elsewhere."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symgen.errors import SymgenError

if TYPE_CHECKING:
    from symgen.plan import Plan

#: Threads cost more than they give on the small matrices here; set before numpy is first imported.
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="symgen",
        description="From a URDF to J_ii(q) = C_i(q) alpha_i, the postures that measure alpha, and code for both.",
    )
    parser.add_argument("urdf", metavar="URDF", help="the robot; a robot.toml beside it is read too")
    parser.add_argument("-o", dest="out", metavar="DIR", help="write plan, functions and equations here")
    parser.add_argument("--base", metavar="LINK", help="first link of the arm (default: the root)")
    parser.add_argument(
        "--tip", metavar="LINK", help="last link of the arm (default: end of the longest run of joints)"
    )
    parser.add_argument("--at", metavar="NAME=VALUE,..", help="freeze these joints there [rad or m]; default 0")
    parser.add_argument(
        "--believe-zeros",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="take inertial parameters that are exactly zero in the URDF as known (default: as robot.toml says, else no)",
    )
    parser.add_argument("--no-snap", action="store_true", help="keep angles such as 1.5708 as written")
    parser.add_argument("--spare", metavar="N", type=int, help="measurements beyond the minimum (default: a quarter)")
    parser.add_argument("--refine", action="store_true", help="search longer for the best plan")
    parser.add_argument(
        "--no-feasible", action="store_true", help="plan postures whatever gravity asks of the motors or touches itself"
    )
    parser.add_argument("--no-verify", action="store_true", help="do not compare J(q) with Pinocchio's")
    parser.add_argument("--json", action="store_true", help="print one JSON document and nothing else")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit status: 0 done, 2 misuse or bad input (one line on standard error)."""
    for name in _ONE_THREAD:
        os.environ.setdefault(name, "1")
    options = _parser().parse_args(arguments)
    try:
        return _run(options)
    except SymgenError as error:
        print(f"symgen: {error}", file=sys.stderr)
    except OSError as error:
        print(f"symgen: {error.filename}: {error.strerror}", file=sys.stderr)
    return 2


def _run(options: argparse.Namespace) -> int:
    from symgen import plan

    start = time.perf_counter()
    if options.spare is not None and options.spare < 0:
        raise SymgenError(f"--spare {options.spare}: expected 0 or more")
    settings = _settings(options)
    believe_zeros, drives, gravity = (settings.pop(name) for name in ("believe_zeros", "drives", "gravity"))
    chain, unsnapped = plan.chain_of_file(options.urdf, snap=not options.no_snap, **settings)
    parsed = time.perf_counter() - start
    result = plan.make_plan(
        chain,
        unsnapped=unsnapped,
        believe_zeros=believe_zeros,
        rotor=plan.reflected_inertia(chain, drives),
        spare=options.spare,
        effort="full" if options.refine else "quick",
        feasible=None if options.no_feasible else plan.feasible_postures(chain, Path(options.urdf), drives, gravity),
    )
    document = dict(result.document)
    if not options.no_verify:
        document["verified"] = _verified(result)
    document["seconds"] = {"parse": parsed, **result.seconds}
    begin = time.perf_counter()
    document["files"] = _write(result, Path(options.out), Path(options.urdf)) if options.out else []
    document["seconds"]["emit"] = time.perf_counter() - begin
    if options.json:
        print(json.dumps(document, ensure_ascii=False))
    else:
        _print(document)
    return 0


def _verified(result: Plan) -> dict[str, Any]:
    from symgen.verify import verify

    verdict = verify(result.model.factoring)
    return {
        "against": "Pinocchio CRBA",
        "postures": verdict.postures,
        "relative_error": verdict.error,
        "relative_error_to_file_as_written": verdict.as_written,
    }


def _settings(options: argparse.Namespace) -> dict[str, Any]:
    """base, tip, at, believe_zeros and drives: from the command line, else from the robot.toml beside the URDF."""
    from symgen.robot import load_robot

    urdf = Path(options.urdf)
    beside = urdf.parent / "robot.toml"
    robot = load_robot(beside) if beside.is_file() else None
    if robot is not None and robot.urdf.resolve() != urdf.resolve():
        robot = None
    return {
        "base": options.base or (robot.base if robot else None),
        "tip": options.tip or (robot.tip if robot else None),
        "at": _frozen_at(options.at) or (dict(robot.at) if robot else {}),
        "believe_zeros": options.believe_zeros
        if options.believe_zeros is not None
        else bool(robot and robot.believe_zeros),
        "drives": robot.drives if robot else (),
        "gravity": robot.gravity if robot else (0.0, 0.0, -9.81),
    }


def _frozen_at(text: str | None) -> dict[str, float]:
    out = {}
    for item in text.split(",") if text else ():
        name, separator, value = item.rpartition("=")
        try:
            out[name.strip()] = float(value)
        except ValueError:
            separator = ""
        if not separator or not name.strip():
            raise SymgenError(f"--at {item!r}: expected NAME=VALUE with a number in rad or m")
    return out


def _write(result: Plan, directory: Path, urdf: Path) -> list[str]:
    """Writes everything beside the target first and moves it there file by file: never a half-written output."""
    from symgen import emit

    if directory.exists() and not directory.is_dir():
        raise SymgenError(f"-o {directory}: a file; expected a directory")
    directory.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(prefix=f".{directory.name}-", dir=directory.parent))
    try:
        names = emit.write_all(result, beside)
        directory.mkdir(exist_ok=True)
        for name in names:
            os.replace(beside / name, directory / name)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
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
            f"{plan['amplification_per_joint'][k]:>15.3g}"
        )
    kept, dropped = document["singular_value_gap"]
    print(
        f"{document['shared_rank']} shared constants give every J_ii (singular values: {kept:g} kept, {dropped:g} dropped),"
    )
    print(f"{document['full_inertia_rank']} give all of J(q).")
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
    if "verified" in document:
        verified = document["verified"]
        print(f"J(q) equals Pinocchio's to {verified['relative_error']:.1e} at {verified['postures']} random postures.")
    for name in document["files"]:
        print(name)


if __name__ == "__main__":
    sys.exit(main())
