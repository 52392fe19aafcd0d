"""The commands of the loop, for `cli`: diagnose and next. Each parses, calls and prints."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ident import progress
from ident.commands import NewCommand
from ident.errors import IdentError

if TYPE_CHECKING:
    from ident.loop.diagnose import Diagnosis
    from ident.records.campaign import Campaign


#: How long a search takes at most, unless told otherwise.
MINUTES = 4.0


def _minutes(text: str) -> float:
    """A time that is given in minutes. argparse.ArgumentTypeError: none above zero."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text!r}; expected minutes above 0, or inf")
    return value


def add(command: NewCommand) -> None:
    """Adds the commands to the command line; each sets `action`, which takes the options and returns the exit status."""
    diagnose = command(
        "diagnose",
        "Find what the declared robot lacks to explain its records; add it, and say the error before and after.",
    )
    diagnose.add_argument("campaign", metavar="FILE.h5", nargs="+", help="campaigns of one robot, diagnosed together")
    diagnose.add_argument(
        "-o",
        dest="out",
        metavar="DIR",
        required=True,
        help="write verdict.json, report.html and the corrected robot here",
    )
    diagnose.add_argument(
        "--baseline", metavar="OTHER.h5",
        help="the same robot earlier: its drives and links as found there are the declared ones; effects that it has already are "
        "found again, and said to be old",
    )  # fmt: skip
    diagnose.add_argument(
        "--believe-zeros", action=argparse.BooleanOptionalAction, default=None,
        help="take inertial parameters that are exactly zero in the URDF as known (default: where the records need it, or are "
        "explained by an effect and fewer constants then)",
    )  # fmt: skip
    diagnose.add_argument(
        "--minutes", type=_minutes, metavar="M",
        help=f"tell what was found so far once the search has taken so long (default {MINUTES:g}; inf: never)",
    )  # fmt: skip
    diagnose.add_argument("--brief", action="store_true", help="print the sentence, the errors and the effects only")
    diagnose.set_defaults(action=_diagnose)
    then = command("next", "Plan the records that would tell apart what a diagnosis could not, ready to be played.")
    then.add_argument("result", metavar="OUT", help="directory that ident diagnose wrote")
    then.add_argument("--seed", type=int, default=1, help="of the excitation (default 1: not the campaign's)")
    then.set_defaults(action=_next)


def _diagnose(options: argparse.Namespace) -> int:
    from ident.records.store import is_log

    log = is_log(options.campaign[0])
    document, said = _log_diagnosed(options) if log else _diagnosed(options)
    out = Path(options.out)
    if options.json:
        print(json.dumps(document))
    else:
        robot = "robot.toml" if not log else "identified.urdf"
        others = "identified.urdf, identified.xml (MuJoCo), J.casadi, J.c" if not log else "J.casadi, J.c"
        print(said)
        print(f"\nReport:  {out / 'report.html'}")
        print(f"Verdict: {out / 'verdict.json'}")
        print(f"Robot:   {out / robot} with {others}")
    return 0 if document["status"] == "explained" else 1


def _diagnosed(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Diagnoses and writes everything; the verdict, and the same in words."""
    from ident.loop.diagnosis_json import FILE, result_document, verdict_document, write
    from ident.loop.diagnosis_report import html, text
    from ident.loop.held_out import with_few_lines
    from ident.plain import replace_file
    from ident.records.inputs import joined, told

    minutes = MINUTES if options.minutes is None else options.minutes
    campaign = joined(options.campaign)
    earlier = joined([options.baseline]) if options.baseline is not None else None
    begin = time.perf_counter()
    found, notes = _search(campaign, earlier, options.believe_zeros, minutes, progress.line(options))
    seconds = {"diagnose": time.perf_counter() - begin}
    out = Path(options.out)
    made_with = {
        "believe_zeros": options.believe_zeros,
        "minutes": minutes if isfinite(minutes) else None,
        "baseline": told([options.baseline]) if earlier else None,
        "out": str(out),
    }
    document = verdict_document(found, options.campaign, notes, made_with)
    page = html(found, document)
    write(document, out / FILE)
    write(result_document(found, seconds), out / "result.json")
    replace_file(out / "report.html", page)
    _write_robot(found, out)
    return document, text(document, options.brief, with_few_lines(found))


def _log_diagnosed(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """The same of a log of trajectories."""
    from ident.logs.diagnose import diagnose_log
    from ident.logs.report import html, text
    from ident.logs.robot import write_robot
    from ident.logs.verdict import result_document, verdict_document
    from ident.loop.diagnosis_json import FILE, write
    from ident.plain import replace_file
    from ident.records.store import read_log

    file = options.campaign[0]
    if len(options.campaign) > 1 or options.baseline is not None:
        raise IdentError(f"{file}: a log of trajectories is diagnosed by itself; import all of them into one file")
    for option, value in (("--believe-zeros", options.believe_zeros), ("--minutes", options.minutes)):
        if value is not None:
            raise IdentError(f"{file}: a log of trajectories; expected no {option}, which goes with campaigns")
    begin = time.perf_counter()
    found = diagnose_log(read_log(file), progress.line(options))
    seconds = {"diagnose": time.perf_counter() - begin}
    out = Path(options.out)
    document = verdict_document(found, options.campaign, {"out": str(out)})
    page = html(found, document)
    write(document, out / FILE)
    write(result_document(found, seconds), out / "result.json")
    replace_file(out / "report.html", page)
    write_robot(found, out)
    return document, text(document, options.brief)


def _search(
    campaign: Campaign, earlier: Campaign | None, believe_zeros: bool | None, minutes: float, say: Callable[[str], None]
) -> tuple[Diagnosis, tuple[str, ...]]:
    """What is found in a campaign beyond its declared robot, or beyond that of an `earlier` one; and notes."""
    from ident.loop.baseline import declared_by
    from ident.loop.either_model import diagnose_either
    from symgen.forked import WORKERS

    notes: tuple[str, ...] = ()
    if earlier is not None:
        known, _ = diagnose_either(earlier, believe_zeros, workers=WORKERS, say=say, seconds=60.0 * minutes)
        campaign, notes = declared_by(known, campaign)
    found, more = diagnose_either(campaign, believe_zeros, workers=WORKERS, say=say, seconds=60.0 * minutes)
    return found, (*notes, *more)


def report_again(verdict: Mapping[str, Any], say: Callable[[str], None]) -> str:
    """Returns the report of a diagnosis, made of the same files in the same way. IdentError where they are not there."""
    from ident.loop.diagnosis_report import html
    from ident.records.inputs import again

    if verdict["input"]["kind"] == "log":
        return _log_report_again(verdict, say)
    made = verdict["made_with"]
    earlier = again(made["baseline"]) if made["baseline"] else None
    minutes = inf if made["minutes"] is None else made["minutes"]
    found, _ = _search(again(verdict["input"]), earlier, made["believe_zeros"], minutes, say)
    told = [effect["name"] for effect in verdict["effects"]]
    if [a.effect.name for a in found.added] != told[: len(found.added)] or len(told) != len(found.added) + len(
        found.off
    ):
        raise IdentError(
            f"other effects are found now than verdict.json tells ({', '.join(told)}); run ident diagnose again"
        )
    return html(found, dict(verdict))


def _log_report_again(verdict: Mapping[str, Any], say: Callable[[str], None]) -> str:
    """The same of a log."""
    from ident.logs.diagnose import diagnose_log
    from ident.logs.report import html
    from ident.records.inputs import file_again
    from ident.records.store import read_log

    found = diagnose_log(read_log(file_again(verdict["input"])), say)
    if [step.term.name for step in found.found.steps] != [effect["name"] for effect in verdict["effects"]]:
        raise IdentError("other effects are found now than verdict.json tells; run ident diagnose again")
    return html(found, dict(verdict))


def _write_robot(d: Diagnosis, out: Path) -> None:
    from ident.identification.export import write_files
    from ident.identification.identified import of_parts
    from ident.search.spread import spread

    p = d.end.problem.parameters(d.end.minimum.vector)
    covariance, unseen, _ = spread(d.split, d.end)
    effects = ", ".join(a.effect.name for a in d.added) or "nothing"
    source = f"{d.campaign.source}; diagnosed, {effects} added"
    numbers = (p.alpha, covariance, unseen, p.K, p.J_m, p.D, p.D_spring)
    write_files(of_parts(d.campaign, d.model, *numbers, source=source), out)


def _next(options: argparse.Namespace) -> int:
    from ident.loop.next_experiment import plan_next

    found = plan_next(options.result, seed=options.seed)
    if options.json:
        print(json.dumps(found.document()))
    else:
        print(found.text)
    return 0
