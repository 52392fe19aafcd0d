"""The same records read by several methods: what each says of every J_ii and of J(q), and how well it explains the data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.identification.identify import UNSEEN_POSTURES, Identification
from ident.identification.verdict import within


def comparison(identifications: Sequence[Identification]) -> list[dict[str, Any]]:
    """Returns one row a method: J_ii [kg m2] and its sigma record by record, chi2/dof and whether it `explained` the records,
    and the largest difference of any J_ij(q) from the first method's, over sqrt(J_ii J_jj), at postures nobody measured.

    All of one campaign; where their constants differ (zeros believed or not), J(q) is compared all the same.
    """
    first = identifications[0]
    q = first.model.random_postures(UNSEEN_POSTURES, np.random.default_rng(0))
    J = first.J(q)
    size = np.sqrt(np.abs(np.einsum("mii->mi", J)))
    rows = []
    for one in identifications:
        away = np.abs(one.J(q) - J) / (size[:, :, None] * size[:, None, :])
        rows.append(
            {
                "method": one.method,
                "chi2_per_dof": one.chi2_per_dof if one.method != "three-point" else None,
                "explained": one.explained if one.method != "three-point" else None,
                "J": {m.record.id: m.J for m in one.measurements},
                "std": {m.record.id: m.std for m in one.measurements},
                "entry": {m.record.id: f"J_{m.index + 1}{m.index + 1}" for m in one.measurements},
                "away_per_entry": away.max(axis=0).tolist(),
                "away": float(away.max()),
                "seconds": one.seconds["fit"],
            }
        )
    return rows


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Returns the comparison as text: a column a method, the first in kg m2, the others as their difference from it in percent."""
    first = rows[0]
    head = "".join(f"{row['method'] + ' %':>14}" for row in rows[1:])
    lines = [f"{'record':<7}{'entry':<6}{first['method']:>12}{'sigma':>10}{head}"]
    for record, value in first["J"].items():
        others = "".join(f"{100 * (row['J'][record] / value - 1):>+14.3f}" for row in rows[1:])
        told = within(value, first["std"][record]).replace("−", "-")
        lines.append(f"{record:<7}{first['entry'][record]:<6}{told:>12}{first['std'][record]:>10.2g}{others}")
    lines.append("")

    def line(name: str, values: Sequence[str]) -> str:
        return f"{name:<25}{values[0]:>10}" + "".join(f"{value:>14}" for value in values[1:])

    lines.append(line("chi2/dof", [_number(row["chi2_per_dof"]) for row in rows]))
    lines.append(line("explained", [{True: "yes", False: "no", None: "-"}[row["explained"]] for row in rows]))
    lines.append(line(f"J(q) off {first['method']}, %", ["-", *[_number(100 * row["away"]) for row in rows[1:]]]))
    lines.append(line("seconds", [_number(row["seconds"]) for row in rows]))
    return "\n".join(lines) + "\n"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
