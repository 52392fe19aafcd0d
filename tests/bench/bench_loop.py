"""The blind study of the loop: effects drawn at random, simulated, diagnosed from the campaign file alone, judged.

python tests/bench/bench_loop.py                          all of it (resumable), tests/bench/RESULTS_LOOP.md at its end
python tests/bench/bench_loop.py --only one --count 30    a quick look: the table on the screen
python tests/bench/bench_loop.py --only faint             single effects made so small that they just show
python tests/bench/bench_loop.py --case one-1-004         one case again, with all that the diagnosis says on its way
python tests/bench/bench_loop.py --robot DIR --only one --count 30    draws of another robot
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import hashlib
import json
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "ident"))

from loop.cases import KINDS_OF_CASE, OURS, Case, cases, drawn, truth, twin, write_json
from loop.judge import ASKED, NEAR_CLEAN, bias, judged
from loop.table import failures, table

from ident.diagnosis_commands import MINUTES
from ident.errors import ExperimentError
from ident.loop.diagnosis_json import verdict_document
from ident.loop.either_model import diagnose_either
from ident.records.store import read_campaign, write_campaign
from ident.simulator.bench import in_parallel

COUNTS = {"clean": 100, "one": 156, "two": 52, "outside": 56}
#: How many faint ones where these are asked for.
FAINT = 30
RESULTS = HERE / "RESULTS_LOOP.md"
#: One case in so many, on the average, is of a given robot and effect.
RAREST = 400
#: What makes records, and what makes and judges results.
MAKERS = ("symgen", "draws", "outside", "loop.cases", "ident.effects", "ident.simulator", *(f"ident.records.{name}" for name in (
    "campaign_rules", "excitation", "hdf5_node", "store")))  # fmt: skip
JUDGES = ("symgen", "draws", "outside", "loop", "ident")
CACHE = HERE.parents[1] / "out" / "bench-loop"


@dataclass(frozen=True)
class Job:
    """A case, and the directories of what is drawn and of its result; `keep` the campaign for another time."""

    case: Case
    directory: Path
    results: Path
    keep: bool


def main() -> int:
    options = _options()
    results = options.cache / "results" / _fingerprint(*JUDGES)
    records = options.cache / "records" / _fingerprint(*MAKERS)
    if options.case:
        kind, seed, index = options.case.split("-")
        chosen = [list(cases(kind, int(index) + 1, int(seed), _other(options)))[-1]]
        print(json.dumps(_worked(Job(chosen[0], records, results, True), print), indent=1))
        return 0
    kinds = [options.only] if options.only else list(COUNTS)
    counts = {kind: COUNTS.get(kind, FAINT) if options.count is None else options.count for kind in kinds}
    wanted = [case for kind in kinds for case in _wanted(kind, counts[kind], options)]
    jobs = [Job(case, records, results, options.keep) for case in wanted if not (results / f"{case.id}.json").exists()]
    jobs.sort(
        key=lambda job: job.case.index / counts[job.case.kind]
    )  # by turns: what is stopped has some of every kind
    for done, line in enumerate(in_parallel(result, jobs, options.workers), 1):
        print(f"{done}/{len(jobs)} {line}", flush=True)
    found = list(_found(results, wanted))
    text = table(found)
    print(text + failures(found))
    if not (options.only or options.robot or options.effect or options.count is not None):
        write_text(text + failures(found), RESULTS)
    return 0


def _wanted(kind: str, count: int, options: argparse.Namespace) -> list[Case]:
    """The first `count` cases of a kind; where a count of one robot or effect is asked, the first so many that are of it."""
    some = options.count is not None and (options.robot in OURS or options.effect)
    mine = [case for case in cases(kind, count * RAREST if some else count, options.seed, _other(options))
            if (_other(options) or options.robot in (None, case.robot)) and options.effect in (None, case.name)]  # fmt: skip
    return mine[:count]


def _other(options: argparse.Namespace) -> str:
    """The directory of a robot that is none of ours; with a cache of its own: a case's name does not say the robot."""
    return "" if options.robot in (None, *OURS) else str(Path(options.robot).resolve())


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=KINDS_OF_CASE)
    parser.add_argument("--count", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--robot", help="draws of this robot only: ypp3, arm6 or the directory of another")
    parser.add_argument("--effect", help="draws of this effect only")
    parser.add_argument("--case", help="one case by its id, with the diagnosis' own words")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--keep", action="store_true", help="keep the campaign files, and take those that were kept")
    parser.add_argument("--cache", type=Path, default=CACHE)
    return parser.parse_args()


def result(job: Job) -> str:
    """Works a case out and writes its result; returns one line about it."""
    found = _worked(job, lambda line: None)
    write_json(found, job.results / f"{job.case.id}.json")
    wrong = [name for name, good in found["scores"].items() if not good]
    return f"{job.case.id} {_said(found)} {', '.join(wrong) or 'right'}, {found['seconds']:.0f} s"


def _said(found: dict[str, Any]) -> str:
    true = [f"{t['name']}@{t['joint']}" for t in found["truth"]]
    named = [f"{e['name']}@{e['joint']}" for e in found["effects"]]
    return f"{' + '.join(true)} -> {found['status']} {' + '.join(named)}:"


def _worked(job: Job, tell: Callable[[str], None]) -> dict[str, Any]:
    """The result of a case: what was put in, what the diagnosis says, how it is judged."""
    case = job.case
    kept = job.directory / "campaigns" / f"{case.id}.h5"
    file = kept if job.keep else kept.with_suffix(f".{os.getpid()}.h5")
    file.parent.mkdir(parents=True, exist_ok=True)
    begin = time.process_time()
    try:
        known, campaign = drawn(case, job.directory, reuse=kept if kept.exists() and job.keep else None)
        if campaign is not None:
            write_campaign(campaign, file)
    except ExperimentError as error:
        return _entry(case, []) | {"status": f"not drawn: {error}"}
    entry = _entry(case, truth(case, known.effects)) | {
        "shows": [known.refitted, known.declared], "draws": known.draws, "simulated": time.process_time() - begin
    }  # fmt: skip
    lines: list[str] = []
    began = (time.perf_counter(), time.process_time())

    def progress(line: str) -> None:
        lines.append(line)
        tell(line)

    try:
        verdict = blind(file, progress)
    except Exception:  # noqa: BLE001 - whatever it is, it is a verdict that was not given: count it, tell it, go on
        wrong = dict.fromkeys(ASKED[case.kind], False)
        return entry | {"status": "error", "scores": wrong, "said": [*lines, traceback.format_exc(limit=-3)]}
    finally:
        if not job.keep:
            file.unlink(missing_ok=True)
    took = {"seconds": time.perf_counter() - began[0], "cpu": time.process_time() - began[1]}
    scores, off = judged(case, entry["truth"], verdict), bias(case, known.effects, verdict)
    if case.kind == "one":
        clean = _clean_bias(job)
        entry["clean bias"] = clean
        scores["J(q)"] = clean is not None and off <= NEAR_CLEAN * clean
    return entry | {
        "status": verdict["status"], "effects": [_short(e) for e in verdict["effects"]], "scores": scores, "bias": off,
        "error": [verdict["error"]["before"]["all"], verdict["error"]["after"]["all"], verdict["error"]["noise_floor"]],
        "unexplained": verdict["unexplained"][:3], "said": lines,
    } | took  # fmt: skip


def blind(file: Path, progress: Callable[[str], None]) -> dict[str, Any]:
    """The verdict on a campaign file, as `ident diagnose FILE` has it, but by one process: nothing is known but what is in it."""
    found, notes = diagnose_either(read_campaign(file), say=progress, seconds=60.0 * MINUTES)
    return verdict_document(found, [file], notes)


def _entry(case: Case, true: list[dict[str, Any]]) -> dict[str, Any]:
    return {"id": case.id, "kind": case.kind, "robot": Path(case.robot).name, "truth": true, "name": case.name, "effects": [],
            "status": "", "scores": {}, "said": [], "seconds": 0.0, "cpu": 0.0}  # fmt: skip


def _short(effect: dict[str, Any]) -> dict[str, Any]:
    """What is kept of an effect of a verdict."""
    keep = {k: effect[k] for k in ("name", "joint", "port", "before", "after", "rivals")}
    values = {name: p["value"] for name, p in effect["parameters"].items()}
    return keep | {"values": values, "confounded_with": [[c["name"], c["joint"]] for c in effect["confounded_with"]],
                   "ports": [[p["port"], p["joint"], round(p["share"], 3)] for p in effect["evidence"]["port_shares"][:3]]}  # fmt: skip


def _clean_bias(job: Job) -> float | None:
    """How wrong J(q) comes out of the same records without the effect: a clean case of its own where the lock is the usual one."""
    case = twin(job.case)
    results = job.results if (case.lock, case.built) == ("dob", False) else job.results / f"{case.lock}-{case.built}"
    own = Job(case, job.directory, results, False)
    path = results / f"{case.id}.json"
    if not path.exists():
        result(own)
    found: float | None = json.loads(path.read_text()).get("bias")
    return found


def _found(results: Path, wanted: list[Case]) -> Iterator[dict[str, Any]]:
    for case in wanted:
        path = results / f"{case.id}.json"
        if path.exists():
            yield json.loads(path.read_text())


def _fingerprint(*packages: str) -> str:
    """Of the code in these packages or modules: what other code made is not taken for its own."""
    names = [name for name in sys.modules if any(name == p or name.startswith(p + ".") for p in packages)]
    files = [sys.modules[name].__file__ for name in sorted(names)]
    return hashlib.sha256(b"".join(Path(file).read_bytes() for file in files if file)).hexdigest()[:12]


def write_text(text: str, path: Path) -> None:
    beside = path.with_suffix(".tmp")
    beside.write_text(text)
    os.replace(beside, path)


if __name__ == "__main__":
    sys.exit(main())
