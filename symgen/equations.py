"""Factoring -> the equations of an arm for people, to be printed by `typeset`: eqs. (9)-(20) for any arm.

The blocks: what robot, the structure of J(q), J_ii(q) = C_i(q) alpha tip to base, the off-diagonals, the
rows C_i, the constants as formulas. Long sums are grouped by constant, folded and cut; the functions hold all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from symgen.basis import Factoring
from symgen.chain import REVOLUTE
from symgen.formula import Formula, alpha_cad, alpha_formulas, named_lengths, number
from symgen.geometry import at_right_angles
from symgen.notation import (
    Term,
    alpha_latex,
    angle_subscript,
    angle_sum,
    entry_latex,
    entry_text,
    flat,
    functions,
    joints_of,
    subscript,
    summed_angles,
    terms,
)
from symgen.typeset import Block, Display, Fold, Heading, Table, Text, code, inline, width, wrapped

#: Sums of more terms than this are grouped by constant and folded.
_LONG = 60

#: Of one constant's functions in a long sum this many are printed.
_SHOWN = 8

#: A row C_i that prints up to this many characters is printed as a row, a longer one as a list.
_ROW = 70

#: Matrices up to this many joints are printed as matrices.
_MATRIX = 10


def document(
    factoring: Factoring, plan_summary: Mapping[str, Any] | None = None, formulas: Sequence[Formula] | None = None
) -> list[Block]:
    """Returns the equations of an arm as blocks.

    `plan_summary` is the document of plan.json (without it no plan is printed); `formulas` saves deriving them again.
    """
    return [
        *_robot(factoring),
        *_structure(factoring),
        *_entries(factoring),
        *_rows(factoring),
        *_constants(factoring, formulas or alpha_formulas(factoring)),
        *measurements(factoring, plan_summary or {}),
    ]


# The robot -----------------------------------------------------------------------------------------------------------


def _robot(factoring: Factoring) -> Iterator[Block]:
    chain = factoring.chain
    yield Heading(1, f"Inertia matrix of {code(chain.name)}")
    yield Text(
        "The inertia $J(q)$ of the links as the joints feel it, without the motors' $N^2 J_m$. "
        f"Written by symgen from the URDF with SHA-256 {code(chain.sha256 or 'unknown')}, "
        f"from link {code(chain.base_link)} to link {code(chain.tip_link)}."
    )
    rows = [
        (str(k + 1), code(joint.name), joint.type, f"{_q(k)} in {_unit(joint.type)}", code(joint.link))
        for k, joint in enumerate(chain.joints)
    ]
    yield Table(("joint", "name", "type", "coordinate", "link behind it"), tuple(rows), (0, 0.3, 0, 0, 0.3))
    if factoring.believed:
        yield Text(
            f"Believed to be exactly zero, because the URDF says so: {_listed(factoring.believed)} (mx .. first "
            "moments, Lxx .. inertias about the origin of the link frame). If a real link is not as symmetric as its file, "
            "the equations below lack terms."
        )
    else:
        yield Text("No inertial parameter is believed to be zero: the equations hold for any bodies on these joints.")
    for snap in chain.snapped:
        yield Text(f"Taken as exact: {number(snap.found)} rad at {code(snap.joint)} as {code(snap.text)}.")
    if not chain.snapped:
        yield Text("No angle of the file was moved to a round value.")
    if chain.frozen:
        yield Text("Held still: " + ", ".join(f"{code(name)} at {number(q)}" for name, q in chain.frozen.items()) + ".")


def _q(k: int) -> str:
    return f"$q{subscript([k + 1])}$"


def _unit(kind: str) -> str:
    return "rad" if kind == REVOLUTE else "m"


def _listed(believed: Sequence[str]) -> str:
    """("mx of link1", "my of link1") as "mx, my of `link1`"."""
    links: dict[str, list[str]] = {}
    for item in believed:
        parameter, _, link = item.partition(" of ")
        links.setdefault(link, []).append(parameter)
    return "; ".join(f"{', '.join(parameters)} of {code(link)}" for link, parameters in links.items())


# Structure -----------------------------------------------------------------------------------------------------------


def _structure(factoring: Factoring) -> Iterator[Block]:
    n, unseen = factoring.chain.n, factoring.alphas[factoring.d :]
    yield Heading(2, "Structure")
    if n <= _MATRIX:
        rows = [" & ".join(_cell(factoring, min(i, j), max(i, j)) for j in range(n)) for i in range(n)]
        yield Display((r"J(q) = \begin{bmatrix} " + r" \\ ".join(rows) + r" \end{bmatrix}",))
    pairs = [(i, j) for i in range(n) for j in range(i, n) if np.any(factoring.S[i, j])]
    listed = tuple(_entry_row(factoring, i, j) for i, j in pairs)
    yield Table(("entry", "depends on", "constants", "terms"), listed, (0, 0.5, 0, 0))
    alone = f"{sum(factoring.rank_per_joint)} if none found at a joint nearer the tip were used again"
    yield Text(
        f"Constants: {factoring.d} give every diagonal entry ({alone}), {len(factoring.alphas)} give all of $J(q)$."
    )
    for i, j in dict.fromkeys((alpha.i, alpha.j) for alpha in unseen):
        names = [f"${alpha_latex(alpha.name)}$" for alpha in unseen if (alpha.i, alpha.j) == (i, j)]
        yield Text(
            f"No diagonal entry shows {', '.join(names)}: they need the cross response of joints {i + 1} and {j + 1}, "
            f"${entry_latex(i, j)}$, at {len(names)} postures."
        )
    if not unseen:
        yield Text("The diagonal entries show every constant of $J(q)$.")


def _cell(factoring: Factoring, i: int, j: int) -> str:
    """An entry of the structure matrix: 0, a constant, or its name with the coordinates it depends on."""
    joints = joints_of(factoring, i, j)
    if len(joints) > 3:
        return entry_latex(i, j) + "(q)"
    members = terms(factoring, i, j)
    if not members:
        return "0"
    if len(members) == 1 and not joints:
        return flat(factoring, i, j, members)[0]
    return entry_latex(i, j) + (f"({', '.join(_q(k)[1:-1] for k in joints)})" if joints else "")


def _entry_row(factoring: Factoring, i: int, j: int) -> tuple[str, ...]:
    S, more = factoring.S[i, j], "" if factoring.entries[i, j].complete else "more than "
    on = ", ".join(map(_q, joints_of(factoring, i, j))) or "nothing"
    return (f"${entry_latex(i, j)}$", on, str(int(S.any(axis=0).sum())), f"{more}{np.count_nonzero(S)}")


# Entries -------------------------------------------------------------------------------------------------------------


def _entries(factoring: Factoring) -> Iterator[Block]:
    n = factoring.chain.n
    off_diagonal = [(i, j) for i in reversed(range(n)) for j in range(i + 1, n)]
    zero = [f"${entry_latex(i, j)}$" for i, j in off_diagonal if not np.any(factoring.S[i, j])]
    sums = [rf" $c{angle_subscript(angle)}$ is $\cos({angle_sum(angle)})$." for angle in summed_angles(factoring)]
    yield Heading(2, "Diagonal entries, tip to base")
    yield Text(r"$c_k$ and $s_k$ stand for $\cos q_k$ and $\sin q_k$." + "".join(sums))
    for i in reversed(range(n)):
        yield _entry(factoring, i, i)
    if off_diagonal:
        yield Heading(2, "Off-diagonal entries")
    for i, j in off_diagonal:
        if np.any(factoring.S[i, j]):
            yield _entry(factoring, i, j)
    if zero:
        yield Text(f"Zero in every posture: {', '.join(zero)}.")


def _entry(factoring: Factoring, i: int, j: int) -> Block:
    """J_ij: as it is when short; grouped by constant, folded and cut when long."""
    members, complete = terms(factoring, i, j), factoring.entries[i, j].complete
    left = entry_latex(i, j) if i == j else f"{entry_latex(i, j)} = {entry_latex(j, i)}"
    if len(members) <= _LONG and complete:
        return _sum(left, wrapped(flat(factoring, i, j, members)))
    groups = members.by_constant()
    lines: list[str] = []
    for k, group in groups.items():
        if len(group) == 1:
            pieces = flat(factoring, i, j, group)
        else:
            pieces = functions(factoring, i, j, group, _SHOWN)
            pieces = [f"{alpha_latex(factoring.names[k])} ({pieces[0]}", *pieces[1:-1], pieces[-1] + ")"]
        if lines:
            pieces[0] = f"- {pieces[0][1:]}" if pieces[0].startswith("-") else f"+ {pieces[0]}"
        lines += wrapped(pieces)
    hidden = sum(max(len(group) - _SHOWN, 0) for group in groups.values())
    blocks: list[Block] = [_sum(left, lines)]
    file = f"`{'J_diag' if i == j else 'J'}.casadi`"
    if hidden or not complete:
        more = f"{hidden} terms more" if complete else "all terms of higher degree"
        blocks.append(Text(f"… and {more}: see {file}."))
    count = f"{len(members)} terms" if complete else f"{len(members)} terms of low degree"
    return Fold(f"{entry_text(factoring.chain.n, i, j)}: {count} in {len(groups)} constants", tuple(blocks))


def _sum(left: str, lines: Sequence[str]) -> Display:
    """left = lines[0] + lines[1] .. as one displayed formula; no line at all is 0."""
    if len(lines) < 2:
        return Display((f"{left} = {lines[0] if lines else 0}",))
    return Display((f"{left} &= {lines[0]}", *(rf"&\quad {line}" for line in lines[1:])))


# Rows and constants --------------------------------------------------------------------------------------------------


def _rows(factoring: Factoring) -> Iterator[Block]:
    yield Heading(2, "Rows C_i of eq. (10)")
    for i in reversed(range(factoring.chain.n)):
        groups = terms(factoring, i, i).by_constant()
        name = f"C{subscript([i + 1])}"
        if not factoring.entries[i, i].complete or sum(map(len, groups.values())) > _LONG:
            where = f"the {len(groups)} brackets of ${entry_latex(i, i)}$ above"
            yield Text(f"${name}$: {where}; `C_rows.casadi` holds all of them.")
        else:
            yield _row(factoring, i, name, groups)


def _row(factoring: Factoring, i: int, name: str, groups: Mapping[int, Sequence[Term]]) -> Block:
    """C_i as a row where it fits in a line, else as a list of what multiplies each constant."""
    cells = [functions(factoring, i, i, group) for group in groups.values()]
    constants = [alpha_latex(factoring.names[k]) for k in groups]
    row = " & ".join(" ".join(cell) for cell in cells)
    if width(row) + 3 * len(cells) <= _ROW:
        column = r" \\ ".join(constants)
        product = rf"\begin{{bmatrix}} {row} \end{{bmatrix}} \begin{{bmatrix}} {column} \end{{bmatrix}}"
        return Display((rf"{entry_latex(i, i)} = {name}(q) \, \alpha = {product}",))
    lines: list[str] = []
    for constant, cell in zip(constants, cells, strict=True):
        first, *rest = wrapped(cell)
        lines += [f"{constant} &: {first}", *(rf"&\quad {line}" for line in rest)]
    title = f"C_{i + 1}: what multiplies each of {len(groups)} constants in {entry_text(factoring.chain.n, i, i)}"
    return Fold(title, (Display(tuple(lines)),))


def _constants(factoring: Factoring, formulas: Sequence[Formula]) -> Iterator[Block]:
    used = {symbol for formula in formulas for term in formula.terms for symbol in term.lengths}
    named = {symbol: length for symbol, length in named_lengths(factoring.chain).items() if symbol in used}
    yield Heading(2, "Constants")
    yield Text(
        "Link $k$ is the body behind joint $k$: $m_k$ its mass, $r_{x,k}$ .. its centre of mass in the link frame, "
        "$I_{xx,k}$ .. its inertia about the centre of mass."
    )
    if named:
        rows = [(f"${symbol.latex}$", number(item.value), code(item.joint)) for symbol, item in named.items()]
        yield Table(("length", "value in m", "of the origin of"), tuple(rows), (0, 0, 0))
    elif not at_right_angles(factoring.chain):
        yield Text("The lengths are in the numbers: not every fixed rotation of this arm is by right angles.")
    constants = tuple(
        (
            f"${alpha_latex(alpha.name)}$",
            alpha.unit,
            f"{value:.6g}",
            f"${entry_latex(alpha.i, alpha.j)}$, {code(factoring.chain.names[alpha.i])}",
            inline(formula.latex),
        )
        for alpha, value, formula in zip(factoring.alphas, alpha_cad(factoring), formulas, strict=True)
    )
    yield Table(("constant", "unit", "CAD value", "first shown by", "formula"), constants, (0, 0, 0, 0.22, 0.4))


def measurements(factoring: Factoring, plan_summary: Mapping[str, Any]) -> Iterator[Block]:
    """Yields the last blocks of a `document`: what is to be measured; none where there is no plan."""
    plan = plan_summary.get("plan")
    if not plan:
        return
    yield Heading(2, "Measurements")
    all_ = "the" if plan["rank"] == factoring.d else f"{plan['rank']} combinations of the"
    yield Text(
        f"{plan['measurements']} measurements determine {all_} {factoring.d} constants of the diagonal; "
        f"{plan['spare']} more are kept for validation. Excite the joint named and hold the others at the posture q (rad, m)."
    )
    if plan["open"]:
        yield Text(f"Open stay {', '.join(f'${alpha_latex(name)}$' for name in plan['open'])}.")
    for row in plan["infeasible"]:
        yield Text(f"Posture {row['cell']} ({code(row['joint'])}) can not be held: {code(row['why'])}.")
    cells = [
        (code(cell["joint"]), "spare" if cell.get("spare") else "", ", ".join(map(number, cell["q"])))
        for cell in plan["cells"]
    ]
    yield Fold(f"{len(cells)} postures", (Table(("excited joint", "use", "posture q"), tuple(cells), (0.25, 0, 0.55)),))
