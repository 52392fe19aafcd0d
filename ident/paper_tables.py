"""The paper's two tables as printed, what `ident.paper` makes of them, and both as text and JSON.

Equations and tables are those of K. Choi et al., "Identification of Flexible Joint Robot Inertia Matrix Using Frequency
Response Analysis". The tables are quoted as printed; every other number shown is computed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, is_dataclass
from math import pi
from typing import Any

import numpy as np

from ident.identification.physical import YPP_ALPHA
from ident.records.campaign import Array
from symgen.robot import Experiment

#: Section IV: (q_2, q_23) [rad] of the postures, and the (posture, joint) measured there in the order of the tables.
POSTURES = {"POS1": (0.0, 0.0), "POS2": (0.0, -pi / 2), "POS3": (pi / 2, pi / 2)}
CELLS = (("POS1", 1), ("POS1", 2), ("POS1", 3), ("POS2", 1), ("POS2", 2), ("POS3", 1))
#: Table I, "with uncertainty": the load inertias are off by this, relative to the identified value.
UNCERTAINTY = 0.3
#: Assumed standard deviation of a measured J_ii, relative: the paper states none.
NOISE = 0.01

_Column = tuple[str, Iterable[Any], str]


@dataclass(frozen=True)
class Printed:
    """One table as printed [kg m2, %]: J_ii in the order of `CELLS`, alphas in the order of `YPP_ALPHA`.

    `alpha` solved from `J`; `error` and `mean_error` belong to the alphas of `identified`.
    """

    name: str
    J: tuple[float, ...]
    alpha: tuple[float, ...]
    identified: tuple[float, ...]
    error: tuple[float, ...]
    mean_error: float | None


#: Tables I and II, row "CAD".
CAD = (0.1362, 0.4544, 0.0152, 0.0928, 0.5072, 0.0466)
TABLE_I = Printed(
    "Table I",
    J=(0.6987, 0.6929, 0.0466, 0.696, 0.5072, 0.0152),
    alpha=(0.1362, 0.4544, 0.0152, 0.0928, 0.5072, 0.0466),  # row "Simulation"
    identified=(0.1946, 0.6492, 0.0217, 0.1326, 0.7246, 0.0666),  # row "with uncertainty"
    error=(29.99, 30.01, 29.95, 30.04, 30.00, 35.74),
    mean_error=None,
)
TABLE_II = Printed(
    "Table II",
    J=(0.9381, 0.92, 0.07, 0.57, 0.6242, 0.0223),
    alpha=(0.2202, 0.5477, 0.0223, 0.1479, 0.6242, 0.07),  # row "Experiment"
    identified=(0.2202, 0.5477, 0.0223, 0.1479, 0.6242, 0.07),
    error=(38.15, 17.03, 31.84, 37.25, 18.74, 38.86),
    mean_error=30.31,  # section IV-B
)


@dataclass(frozen=True)
class Simulated:
    """Table I by simulation of an arm whose links are `scale` times CAD's.

    J [6, kg m2] in the order of `CELLS`: declared, by weighted fit with standard deviation, by the paper's three
    points. alpha [6, kg m2] in the order of `YPP_ALPHA`; its relative differences [%]: `off` from the simulated arm,
    `error` (x - CAD)/x as in the paper, `error_of_cad` (x - CAD)/CAD. `notes` of the identification, none when all is
    well.
    """

    scale: float
    J_cad: Array
    J: Array
    J_std: Array
    J_three_point: Array
    alpha_cad: Array
    alpha: Array
    alpha_std: Array
    off: Array
    error: Array
    error_of_cad: Array
    explained: bool
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Violation:
    """A broken condition for bodies to exist: `text`, broken `by` [its own unit], and that in standard deviations."""

    text: str
    by: float
    sigmas: float


@dataclass(frozen=True)
class Verdict:
    """Whether rigid bodies with these alphas exist.

    `violated` of the four closed conditions (any length l_2); `possible` and the `distance` [standard deviations at
    `NOISE`] to the nearest alphas of real bodies by semidefinite program, on an arm with the lengths of the URDF.
    """

    alphas: str
    possible: bool
    distance: float
    within_noise: bool
    violated: tuple[Violation, ...]


@dataclass(frozen=True)
class Comparison:
    """J_ii [kg m2] at one posture: by (17)-(19) with the printed alphas, and put right; `gap` in percent."""

    entry: str
    where: str
    measured: bool
    printed: float
    corrected: float
    gap: float


@dataclass(frozen=True)
class Reworked:
    """One printed table solved again: J [6, kg m2] in the order of `CELLS`, alphas [6, kg m2] in that of `YPP_ALPHA`.

    `J` is the table's with J_11 at POS2 as the printed alphas have it. `literal`: alpha_21 c_2 c_23 as in (17), J as
    printed; `single`: (17), `J`: what the paper did; `corrected`: 2 alpha_21 c_2 c_23, with `std` at `NOISE`.
    Errors [%]: `error` (x - CAD)/x of the row of identified alphas recomputed, `error_corrected` with the factor 2 in x
    and in CAD, `error_of_cad` the same relative to CAD.
    """

    table: Printed
    J: Array
    literal: Array
    single: Array
    corrected: Array
    std: Array
    error: Array
    error_corrected: Array
    error_of_cad: Array
    verdicts: tuple[Verdict, ...]
    comparisons: tuple[Comparison, ...]


@dataclass(frozen=True)
class PaperTables:
    """Table I simulated with CAD's links and with heavier ones, by this `experiment`; Tables I and II reworked."""

    experiment: Experiment
    simulated: tuple[Simulated, ...]
    reworked: tuple[Reworked, ...]


def document(tables: PaperTables) -> dict[str, Any]:
    """Returns the tables as plain JSON values: the fields of `PaperTables`, their arrays' order, and the verdict."""
    order = {"J": _cell_names(), "alpha": list(YPP_ALPHA)}
    return {"order": order, **_plain(tables), "verdict": _conclusions(tables)}


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def text(tables: PaperTables) -> str:
    """Returns the tables for a terminal of 100 columns, ending with three lines of verdict."""
    parts = [_simulated_text(tables), *map(_reworked_text, tables.reworked), _bodies_text(tables), _unseen_text(tables)]
    numbered = [f"{k}  {part}" for k, part in enumerate(parts, start=1)]
    return "\n\n".join([*numbered, "\n".join(["Verdict", *_conclusions(tables)])])


def _grid(columns: Iterable[_Column]) -> str:
    """Columns of (head, values, format) side by side: numbers flush right, text (no format) flush left."""
    aligned = []
    for head, values, form in columns:
        cells = [head, *(format(value, form) for value in values)]
        width = max(map(len, cells))
        aligned.append([cell.rjust(width) if form else cell.ljust(width) for cell in cells])
    return "\n".join("  " + "  ".join(line).rstrip() for line in zip(*aligned, strict=True))


def _cell_names() -> list[str]:
    return [f"J_{joint}{joint} {name}" for name, joint in CELLS]


def _simulated_text(tables: PaperTables) -> str:
    e, first = tables.experiment, tables.simulated[0]
    inertias: list[_Column] = [("kg m2", _cell_names(), ""), ("CAD", first.J_cad, ".4f")]
    alphas: list[_Column] = [("kg m2", YPP_ALPHA, ""), ("CAD", first.alpha_cad, ".4f")]
    for s in tables.simulated:
        true = s.scale * s.J_cad
        links = f"links x {s.scale:.3g}"
        inertias += [(links, s.J, ".5f"), ("off %", 100 * (s.J / true - 1), "+z.3f")]
        inertias += [("3-point off %", 100 * (s.J_three_point / true - 1), "+z.1f")]
        alphas += [(links, s.alpha, ".5f"), ("off %", s.off, "+z.3f"), ("sd %", 100 * s.alpha_std / s.alpha, ".3f")]
    alphas += [("error %", s.error, "z.2f"), ("of CAD %", s.error_of_cad, "z.2f")]
    how = f"{e.periods} periods of {1 / e.f0:g} s, {e.band[0]:g} .. {e.band[1]:g} Hz"
    lines = [
        f"Table I simulated: {how}, other joints rigid, links x 1 and x 1/{1 - UNCERTAINTY:g}",
        "   off: from the simulated arm; error: the paper's, (x - CAD)/x; 3-point: the paper's reading of",
        "   dip, peak and top of the band, which fails where they are close, J_l << N^2 J_m",
        _grid(inertias),
        _grid(alphas),
    ]
    return "\n".join([*lines, *(f"   ! {note}" for s in tables.simulated for note in s.notes)])


def _reworked_text(r: Reworked) -> str:
    names = zip(_cell_names(), r.table.J, r.J, strict=True)
    misprints = [f"   (17)*: with {name} = {p:g} as printed; its alphas have {J:.4f}" for name, p, J in names if p != J]
    columns: list[_Column] = [("kg m2", YPP_ALPHA, ""), ("printed", r.table.alpha, ".4f")]
    columns += [("(17)*", r.literal, ".4f")] if misprints else []
    columns += [("(17)", r.single, ".4f"), ("corrected", r.corrected, ".4f"), (f"sd at {NOISE:.0%}", r.std, ".4f")]
    errors = [("recomputed", r.error), ("corrected", r.error_corrected), ("of CAD", r.error_of_cad)]
    columns += [("printed %", r.table.error, ".2f"), *((name, x, ".2f") for name, x in errors)]
    means = [f"{name} {np.mean(x):.2f}" for name, x in errors]
    means = means if r.table.mean_error is None else [f"printed {r.table.mean_error:.2f}", *means]
    title = f"{r.table.name} solved again: alpha_21 c_2 c_23 as in (17); corrected: 2 alpha_21 c_2 c_23, by (13)"
    return "\n".join([title, _grid(columns), f"   mean error %: {', '.join(means)}", *misprints])


def _bodies_text(tables: PaperTables) -> str:
    verdicts = [verdict for r in tables.reworked for verdict in r.verdicts]
    broken = [", ".join(f"{b.text} by {b.by:.4f} = {b.sigmas:.2g} sd" for b in v.violated) for v in verdicts]
    columns: list[_Column] = [("", [v.alphas for v in verdicts], ""), ("bodies", map(_judged, verdicts), "")]
    columns += [("distance sd", [v.distance for v in verdicts], ".2f")]
    columns += [("conditions broken", [line or "none" for line in broken], "")]
    return f"Can rigid bodies have these alphas? sd: {NOISE:.0%} noise on every J_ii\n{_grid(columns)}"


def _judged(verdict: Verdict) -> str:
    return "possible" if verdict.possible else "within noise" if verdict.within_noise else "IMPOSSIBLE"


def _unseen_text(tables: PaperTables) -> str:
    places = tables.reworked[0].comparisons
    columns: list[_Column] = [("kg m2", [f"{c.entry} {c.where}" for c in places], "")]
    columns += [("measured", ["yes" if c.measured else "NO" for c in places], "")]
    for r in tables.reworked:
        columns += [(r.table.name, [c.printed for c in r.comparisons], ".4f")]
        columns += [("corrected", [c.corrected for c in r.comparisons], ".4f")]
        columns += [("apart %", [c.gap for c in r.comparisons], "+z.1f")]
    title = "Six measurements for six alphas: right and wrong ones fit them, and part where nobody looked"
    return f"{title}\n{_grid(columns)}"


def _conclusions(tables: PaperTables) -> list[str]:
    """The verdict in three lines."""
    heavy = tables.simulated[-1]
    off = max(float(np.abs(s.off).max()) for s in tables.simulated)
    trust = "" if all(s.explained for s in tables.simulated) else ", RECORDS NOT EXPLAINED"
    pairs = " and ".join(f"{r.corrected[0]:.4f} (printed {r.table.alpha[0]:.4f})" for r in tables.reworked)
    gaps = " and ".join(f"{max(abs(c.gap) for c in r.comparisons):.0f}" for r in tables.reworked)
    bodies = "; ".join(f"{r.table.name} {', '.join(map(_judged, r.verdicts))}" for r in tables.reworked)
    heavier = f"heavier links: error {heavy.error.mean():.1f} %, {heavy.error_of_cad.mean():+.1f} % of CAD"
    return [
        f"Simulation: alphas within {off:.2f} % of the arm{trust}; {heavier}",
        f"Factor 2: alpha_11 is {pairs}; J_11 off by {gaps} %",
        f"Bodies (printed, corrected): {bodies}",
    ]
