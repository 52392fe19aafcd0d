"""What an identification found, as one page of text."""

from __future__ import annotations

from typing import Any

import numpy as np

from ident.identification.identify import UNSEEN_POSTURES, Identification
from ident.identification.verdict import NEXT, number, within

#: Notes of a brief page.
_BRIEF = 3


def doubtful(document: dict[str, Any]) -> bool:
    """Whether the result of this result.json should not be used as it is."""
    return not document["explained"] or any(problem["serious"] for problem in document["problems"])


def page(result: Identification, document: dict[str, Any], brief: bool = False) -> str:
    """Returns records, constants and findings of a result and its result.json; `brief`: the first few notes only."""
    return "\n".join(
        [
            result.campaign.source, "", *_records(result), "", *_constants(document["alpha"]), "",
            *_notes(result.notes, _BRIEF if brief else None), *_findings(document),
        ]
    )  # fmt: skip


def _records(result: Identification) -> list[str]:
    width = 9 * result.campaign.n
    head = ["record", "entry", "posture [rad, m]", "measured", "sigma", "CAD", "error %", "chi2/dof"]
    rows = [head]
    for m in result.measurements:
        posture = " ".join(f"{value:8.4f}" for value in m.frf.posture)
        values = [_within(m.J, m.std), f"{m.std:.2g}", _short(m.J_cad, 5), _percent(m.J, m.J_cad)]
        rows.append([m.record.id, f"J_{m.index + 1}{m.index + 1}", posture, *values, f"{m.chi2_per_dof:.3g}"])
    fits = ["", *("" if m.explained else "  does not fit" for m in result.measurements)]
    lines = [text + fit for text, fit in zip(_columns(rows, (-7, -6, -width, 11, 9, 10, 10, 10)), fits, strict=True)]
    whose = {
        "coupled": f"of all motors that move in a record; of all records {result.chi2_per_dof:.3g}, noise allows "
        f"{result.measurements[0].chi2_limit:.3g}",
        "modal": f"of the modes of each record; of all records {result.chi2_per_dof:.3g}",
    }
    of_two_masses = f"of two masses for the excited motor; of all records {result.chi2_per_dof:.3g}"
    return [*lines, f"chi2/dof: {whose.get(result.method, of_two_masses)}"]


def _constants(alpha: dict[str, Any]) -> list[str]:
    rows = [["constant", "identified", "sigma", "CAD", "error %"]]
    columns = (alpha[key] for key in ("names", "value", "std", "cad"))
    for name, value, std, cad in zip(*columns, strict=True):
        kept = "held at CAD" if np.isclose(value, cad, rtol=1e-9, atol=0.0) else "unknown"
        sigma = kept if std is None else f"{std:.2g}"
        rows.append([name, _within(value, std), sigma, _short(cad), _percent(value, cad)])
    texts = _columns(rows, (-14, 13, 12, 13, 10))
    return [f"{text}  {unit}" for text, unit in zip(texts, ("unit", *alpha["unit"]), strict=True)]


def _columns(rows: list[list[str]], widths: tuple[int, ...]) -> list[str]:
    """The rows in columns of these widths (negative: flush left), or wider where some cell would touch the next."""
    signed = [
        max(width, longest) if width > 0 else -max(-width, longest)
        for width, longest in zip(
            widths, (max(map(len, column)) + 1 for column in zip(*rows, strict=True)), strict=True
        )
    ]
    return [
        "".join(f"{cell:{'>' if w > 0 else '<'}{abs(w)}}" for cell, w in zip(row, signed, strict=True)) for row in rows
    ]


def _notes(notes: tuple[str, ...], most: int | None) -> list[str]:
    rows = [f"! {note}" for note in notes[:most]]
    if len(rows) < len(notes):
        rows.append(f"! {len(notes) - len(rows)} more notes in the report")
    return rows


def _findings(document: dict[str, Any]) -> list[str]:
    against = document["inertia_vs_cad"]
    within = f"within {100 * against['largest']:.3g} % of CAD's, relative to {against['relative_to']}"
    rows = [f"J(q) at {UNSEEN_POSTURES} postures never measured: {within}."]
    if "precision" in document:
        told = document["precision"]
        target, predicted, achieved = (_share(told[key]) for key in ("target", "predicted", "achieved"))
        rows.append(
            f"Largest sigma of J(q) over sqrt(J_ii J_jj): wanted {target}, predicted {predicted}, achieved {achieved}, in "
            f"{told['robot_time_s']:.0f} s of robot time."
        )
    if not document["explained"]:
        lacks = f", and what it lacks by {NEXT}" if document["method"] == "coupled" else ""
        rows.append(f"THE MODEL DOES NOT EXPLAIN THE RECORDS: see the report{lacks}.")
    elif doubtful(document):
        rows.append("The model explains the records, BUT THE RESULT CAN NOT BE RIGHT: see the report.")
    else:
        rows.append("The model explains the records.")
    return rows


def _within(value: float, std: float | None) -> str:
    return within(value, std).replace("−", "-")


def _short(value: float, digits: int = 6) -> str:
    return number(value, digits).replace("−", "-")


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.2g} %"


def _percent(value: float, cad: float) -> str:
    """Error relative to CAD in percent; nothing where CAD says zero."""
    return f"{100 * (value - cad) / abs(cad):.3f}" if cad else ""
