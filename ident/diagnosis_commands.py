"""The commands of the loop, for `cli`: diagnose and next. Each parses, calls and prints."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ident import progress
from ident.commands import NewCommand
from ident.errors import IdentError

if TYPE_CHECKING:
    from ident.campaign import Campaign
    from ident.diagnose import Diagnosis


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
        help="the same robot earlier: what is found there already is declared, only what has changed since is told",
    )  # fmt: skip
    diagnose.add_argument(
        "--believe-zeros", action=argparse.BooleanOptionalAction, default=None,
        help="take inertial parameters that are exactly zero in the URDF as known (default: where the records need it, or are "
        "explained by an effect and fewer constants then)",
    )  # fmt: skip
    diagnose.add_argument(
        "--minutes", type=_minutes, default=MINUTES, metavar="M",
        help=f"tell what was found so far once the search has taken so long (default {MINUTES:g}; inf: never)",
    )  # fmt: skip
    diagnose.add_argument("--brief", action="store_true", help="print the sentence, the errors and the effects only")
    diagnose.set_defaults(action=_diagnose)
    then = command("next", "Plan the records that would tell apart what a diagnosis could not, ready to be played.")
    then.add_argument("result", metavar="OUT", help="directory that ident diagnose wrote")
    then.add_argument("--seed", type=int, default=1, help="of the excitation (default 1: not the campaign's)")
    then.set_defaults(action=_next)


def _diagnose(options: argparse.Namespace) -> int:
    from ident.diagnosis_report import text

    document = _diagnosed(options)
    out = Path(options.out)
    if options.json:
        print(json.dumps(document, ensure_ascii=False))
    else:
        print(text(document, options.brief))
        print(f"\nReport:  {out / 'report.html'}")
        print(f"Verdict: {out / 'verdict.json'}")
        print(f"Robot:   {out / 'robot.toml'} with identified.urdf, identified.xml (MuJoCo), J.casadi, J.c")
    return 0 if document["status"] == "explained" else 1


def _diagnosed(options: argparse.Namespace) -> dict[str, Any]:
    """Diagnoses and writes everything; the verdict."""
    from ident.baseline import declared_by
    from ident.diagnosis_json import FILE, result_document, verdict_document, write
    from ident.diagnosis_report import html
    from ident.either_model import diagnose_either
    from ident.plain import replace_file
    from ident.store import read_campaign
    from symgen.forked import WORKERS

    campaign = _joined(options.campaign)
    say, seconds = progress.line(options), 60.0 * options.minutes
    notes: tuple[str, ...] = ()
    if options.baseline is not None:
        earlier = read_campaign(options.baseline)
        known, _ = diagnose_either(earlier, options.believe_zeros, workers=WORKERS, progress=say, seconds=seconds)
        campaign, notes = declared_by(known, campaign)
    found, more = diagnose_either(campaign, options.believe_zeros, workers=WORKERS, progress=say, seconds=seconds)
    out = Path(options.out)
    document = verdict_document(found, options.campaign, (*notes, *more))
    page = html(found, document)
    write(document, out / FILE)
    write(result_document(found), out / "result.json")
    replace_file(out / "report.html", page)
    _write_robot(found, out)
    return document


def _joined(paths: Sequence[str]) -> Campaign:
    """All records of the campaigns at `paths`; those of later ones have their file's name before their own."""
    from ident.store import read_campaign

    first, *others = (read_campaign(path) for path in paths)
    records = list(first.records)
    for path, other in zip(paths[1:], others, strict=True):
        if (other.urdf, other.joints, other.fs, other.hold) != (first.urdf, first.joints, first.fs, first.hold):
            raise IdentError(
                f"{path}: another robot, sampling or hold than {paths[0]}; expected campaigns of one robot"
            )
        records += [replace(record, id=f"{Path(path).stem}/{record.id}") for record in other.records]
    return replace(first, records=tuple(records))


def _write_robot(d: Diagnosis, out: Path) -> None:
    from ident.coupled import uncertainty
    from ident.export import write_files
    from ident.identified import of_parts

    problem, minimum = d.end.problem, d.end.minimum
    p = problem.parameters(minimum.vector)
    covariance, unseen, _ = uncertainty(problem, minimum)
    effects = ", ".join(a.effect.name for a in d.added) or "nothing"
    source = f"{d.campaign.source}; diagnosed, {effects} added"
    numbers = (p.alpha, covariance, unseen, p.K, p.J_m, p.D, p.D_spring)
    write_files(of_parts(d.campaign, d.model, *numbers, source=source), out)


def _next(options: argparse.Namespace) -> int:
    from ident.next_experiment import plan_next

    found = plan_next(options.result, seed=options.seed)
    if options.json:
        print(json.dumps(found.document(), ensure_ascii=False))
    else:
        print(found.text)
    return 0
