"""What was measured -> RESULTS.md: the targets first, then the tables they are read from."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
from peers import build
from peers.build import Program, Skipped


@dataclass
class Row:
    """One program of one arm: derived in `derive` s, with `operations` of its graph, `machine` instructions, or a `reason` why not."""

    tool: str
    result: str
    derive: float | None = None
    operations: int | None = None
    machine: int | None = None
    program: Program | None = None
    error: float | None = None
    error_snapped: float | None = None
    reason: str = ""

    @property
    def ns(self) -> float:
        """Nanoseconds a call, the fastest turn; not a number where there is no program."""
        return min(self.program.times) if self.program else float("nan")


@dataclass(frozen=True)
class Table:
    """All programs of one arm; `binding`: ns a call of Pinocchio from Python; `d`, `D`: constants of the diagonal and of J;
    `stages`: seconds of symgen by stage, `cpu`: of CPU in all; `runs` of its plan, `amplification` of its worst joint."""

    arm: str
    rows: tuple[Row, ...]
    binding: float
    d: int
    D: int
    stages: dict[str, float]
    cpu: float
    runs: int
    amplification: float

    def ns(self, tool: str, result: str) -> float:
        """Nanoseconds a call of one program; not a number where there is none."""
        return next((row.ns for row in self.rows if (row.tool, row.result) == (tool, result)), float("nan"))


@dataclass(frozen=True)
class Command:
    """A command in a fresh process: s on the clock, s of CPU, MB of memory."""

    label: str
    wall: float
    cpu: float
    memory: float


def document(tables: list[Table], graphs: dict[str, Any], commands: list[Command]) -> str:
    """Returns RESULTS.md."""
    lines = ["# symgen beside its peers", "", "Written by `make bench` (`python tests/bench/bench_peers.py`).", ""]
    lines += [f"- {line}" for line in _environment(graphs)]
    lines += ["", "## Targets", "", "| target | measured | |", "|---|---|---|"]
    lines += [f"| {text} | {measured} | {verdict} |" for text, measured, verdict in _targets(tables, commands)]
    lines += ["", "## J(q): derived, compiled, run", "", *_HOW, ""]
    for table in tables:
        lines += [*_table(table), ""]
    lines += ["## What no peer gives", "", *_only(tables), "", "## symgen by stage and as a command", ""]
    lines += ["| arm | parse | derive, ranks | plan | functions | all [s] | CPU [s] |", "|---|---|---|---|---|---|---|"]
    for table in tables:
        values = [table.stages[key] for key in ("parse", "derive", "plan", "functions")]
        lines.append(f"| {table.arm} | " + " | ".join(f"{x:.3f}" for x in [*values, sum(values), table.cpu]) + " |")
    lines += [
        "",
        "The fresh process of three that took least CPU, imports apart; postures not tested for gravity and collision.",
        "",
    ]
    lines += ["| command | clock [s] | CPU [s] | memory [MB] |", "|---|---|---|---|"]
    lines += [f"| `{c.label}` | {c.wall:.2f} | {c.cpu:.2f} | {c.memory:.0f} |" for c in commands]
    lines += [
        "",
        "Least of three, imports, plan within motors and collision shapes, and check against Pinocchio included.",
    ]
    return "\n".join(lines) + "\n"


_HOW = [
    "- *derive*: seconds from the URDF's text to the expression, imports apart. symgen: parse, all ranks and constants, all",
    "  five functions. SymPy: joints as numbers, then Kane. The others: the matrix.",
    "- *graph*: CasADi instructions, for SymPy operations after `cse`. *machine*: instructions of the compiled function, what",
    "  libm does apart.",
    "- *ns*: per call, the fastest of 300 turns over 1024 random postures, all programs of an arm in turn; *median* of the turns.",
    "- *error*: largest |J_ij - Pinocchio's| over the largest |J_ij|, on the file as written; in brackets on the arm with its",
    "  angles snapped (xArm7 writes pi/2 as 1.5708).",
    "- symgen's constants are arguments, the peers' numbers are compiled in.",
]


def _environment(graphs: dict[str, Any]) -> Iterator[str]:
    gcc = subprocess.run(["gcc", "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
    yield f"load {os.getloadavg()[2]:.1f} on {os.cpu_count()} processors while measuring: times on the clock suffer, ratios do not"
    yield f"{build.cpu()}; {gcc}, `gcc {' '.join(build.FLAGS[:2])}`"
    yield ", ".join(f"{name} {version(name)}" for name in ("symgen", "casadi", "numpy", "sympy", "pin"))
    for peer, found in graphs.items():
        yield f"{peer}: {f'left out, {found}' if isinstance(found, Skipped) else found['version']}"


def _table(table: Table) -> Iterator[str]:
    yield f"### {table.arm}"
    yield ""
    yield "| | result | derive [s] | graph | machine | ns | median | error |"
    yield "|---|---|---|---|---|---|---|---|"
    for row in table.rows:
        if row.program is None:
            yield f"| {row.tool} | {_SHOWN[row.result]} | {row.reason} | | | | | |"
            continue
        snapped = "" if row.error_snapped is None else f" ({row.error_snapped:.0e} as snapped)"
        numbers = [
            "" if row.derive is None else f"{row.derive:.4f}",
            str(row.operations or ""),
            str(row.machine or ""),
            f"{row.ns:.0f}",
            f"{np.median(row.program.times):.0f}",
            "" if row.error is None else f"{row.error:.0e}{snapped}",
        ]
        yield f"| {row.tool} | {_SHOWN[row.result]} | " + " | ".join(numbers) + " |"
    yield f"| Pinocchio from Python | J(q) | | | | {table.binding:.0f} | | |"


_SHOWN = {"J_diag": "J_ii", "J": "J(q)", "C_rows": "C_i(q)", "": ""}


def _only(tables: list[Table]) -> Iterator[str]:
    yield "The constants alpha as arguments, the fewest there are, and where to measure them; a peer's program holds one set of"
    yield "numbers. C_i(q) as rows is symgen's alone."
    yield ""
    yield "| arm | constants of all J_ii | of all of J(q) | runs of the plan | error of J_ii per error of a run, worst joint |"
    yield "|---|---|---|---|---|"
    for table in tables:
        yield f"| {table.arm} | {table.d} | {table.D} | {table.runs} | {table.amplification:.2f} |"


def _targets(tables: list[Table], commands: list[Command]) -> Iterator[tuple[str, str, str]]:
    """Each target in words, what was measured, and whether it is met (empty where it could not be measured)."""
    panda = next(table for table in tables if table.arm == "panda")
    own = next(row for row in panda.rows if (row.tool, row.result) == ("symgen", "J_diag"))
    size = own.operations or 0
    yield (
        "J_ii(q, alpha), Panda: at most 760 instructions",
        f"{size} in the graph, {own.machine} machine",
        _met(size, 760),
    )
    for tool, mine, theirs, factor, text in (
        ("casadi_kin_dyn", "J_diag", "J_diag", 1.1, "J_ii at most 1.10 x casadi_kin_dyn's numeric diagonal"),
        ("Pinocchio C++ CRBA", "J_diag", "J", 1 / 3, "J_ii at least 3 x faster than Pinocchio's C++ CRBA"),
        ("casadi_kin_dyn", "J", "J", 1.0, "J(q, alpha) faster than casadi_kin_dyn's M"),
        ("adam", "J", "J", 1.0, "J(q, alpha) faster than adam's M"),
    ):
        for table in tables:
            ours, others = table.ns("symgen", mine), table.ns(tool, theirs)
            share = f"{ours:.0f} / {others:.0f} ns = {ours / others:.2f}"
            yield (f"{table.arm}: {text}", share, _met(ours / others, factor))
    total = sum(panda.stages.values())
    yield (
        "Panda, ranks + plan (`--draft`) + functions, imports apart: at most 0.3 s",
        f"{total:.2f} s ({panda.cpu:.2f} s of CPU)",
        _met(total, 0.3),
    )
    by_label = {command.label: command for command in commands}
    whole = by_label["symgen panda.urdf"]
    yield ("`symgen panda.urdf`: at most 2 s", f"{whole.wall:.2f} s ({whole.cpu:.2f} s of CPU)", _met(whole.wall, 2.0))
    large = commands[-1]
    yield (f"`{large.label}`: at most 5 s", f"{large.wall:.2f} s ({large.cpu:.2f} s of CPU)", _met(large.wall, 5.0))
    yield (f"`{large.label}`: at most 1 GB", f"{large.memory:.0f} MB", _met(large.memory, 1024))


def _met(value: float, limit: float) -> str:
    if np.isnan(value):
        return "not measured"
    return "met" if value <= limit else f"**missed** by {100 * (value / limit - 1):.0f} %"
