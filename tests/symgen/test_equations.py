"""The printed equations, read back and put to numbers, are pinocchio's inertia matrix; and they read as the paper's."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import arm, crba, factoring_of, model_of, random_arm

from symgen.basis import Factoring, factor
from symgen.chain import Chain, Joint, Snap
from symgen.equations import document
from symgen.notation import alpha_latex, angle_subscript, entry_text, terms
from symgen.typeset import latex, markdown

#: Coefficients are printed with six significant digits.
SIX_DIGITS = 5e-6


def equations_md(factoring: Factoring, plan: Mapping[str, Any] | None = None) -> str:
    return markdown(document(factoring, plan))


def displays(md: str) -> list[str]:
    """All displayed formulas, line ends and alignment removed."""
    blocks = re.findall(r"```math\n(.*?)\n```", md, flags=re.DOTALL)
    return [re.sub(r"\\begin\{aligned\}|\\end\{aligned\}|\\\\\n|&|\\quad", " ", block).strip() for block in blocks]


def printed_entries(md: str) -> dict[tuple[int, int], str]:
    """The right-hand sides of J_ij = .. (i, j from 0), left out those that are cut."""
    found = {}
    for text in displays(md):
        match = re.fullmatch(r"J_\{(\d)(\d)\} (?:= J_\{\d\d\} )?=([^\[=]*)", " ".join(text.split()))
        if match and "cdots" not in text:
            found[int(match[1]) - 1, int(match[2]) - 1] = match[3]
    return found


def value(latex: str, q: np.ndarray, alpha: dict[str, float]) -> float:
    """A printed sum at a posture: c_{2-3}^2, s_4, q_2 and alpha_{..} with juxtaposition as product."""
    values: list[float] = []

    def kept(number: float) -> str:
        values.append(number)
        return f"v[{len(values) - 1}]"

    def angle(match: re.Match[str]) -> str:
        psi = sum((-1.0 if sign else 1.0) * q[int(k) - 1] for sign, k in re.findall(r"(-?)(\d)", match[2]))
        return kept({"c": np.cos, "s": np.sin, "q": float}[match[1]](psi))

    latex = re.sub(r" \\cdot 10\^\{(-\d+)\}", r"e\1", latex)
    python = re.sub(r"\\alpha_\{[^}]*\}", lambda match: kept(alpha[match[0]]), latex)
    python = re.sub(r"([csq])_(\{[^}]*\}|\d)", angle, python).replace("^2", "**2")
    python = re.sub(r"(?<=[\w)\]]) +(?=[\w(])", " * ", python.strip())
    return float(eval(python, {"__builtins__": {}, "v": values}))


def errors_of_print(factoring: Factoring, md: str, seed: int) -> dict[tuple[int, int], float]:
    """Relative error of each printed entry against pinocchio at a random posture, constants of the URDF."""
    q = np.random.default_rng(seed).uniform(-1.5, 1.5, factoring.chain.n)
    J = crba(model_of(factoring.chain), q)
    alpha = {alpha_latex(n): float(v) for n, v in zip(factoring.names, factoring.alpha_cad, strict=True)}
    entries = printed_entries(md)
    return {
        (i, j): abs(value(text, q, alpha) - J[i, j]) / np.sqrt(J[i, i] * J[j, j]) for (i, j), text in entries.items()
    }


def test_the_papers_equations_as_corrected() -> None:
    md = equations_md(factoring_of("ypp3", True))
    assert displays(md)[:5] == [
        r"J(q) = \begin{bmatrix} J_{11}(q_2, q_3)  0  0 \\ 0  J_{22}(q_3)  J_{23}(q_3) \\ 0  J_{23}(q_3)  \alpha_{31} "
        r"\end{bmatrix}".replace("  ", "   "),
        r"J_{33} = \alpha_{31}",
        r"J_{22} = 2 \alpha_{21} c_3 + \alpha_{22}",
        r"J_{11} = \alpha_{11} c_{23}^2 + \alpha_{12} c_2^2 + 2 \alpha_{21} c_2 c_{23} + \alpha_{13}",
        r"J_{23} = J_{32} = \alpha_{21} c_3 + \alpha_{31}",
    ]
    assert r"C_1(q) \, \alpha = \begin{bmatrix} c_{23}^2 & c_2^2 & 2 c_2 c_{23} & 1 \end{bmatrix}" in md
    assert "Zero in every posture: $J_{12}$, $J_{13}$." in md
    assert r"| $\alpha_{11}$ | kg m2 | 0.0434 | $J_{11}$, `joint1` | $I_{zz,3} - I_{yy,3} + m_3 r_{y,3}^2$ |" in md
    assert "Believed to be exactly zero, because the URDF says so: mx, my, Lxy, Lxz, Lyz of `link1`;" in md
    assert r"$c_{23}$ is $\cos(q_2 + q_3)$." in md


@pytest.mark.parametrize(("name", "believe"), [("ypp3", True), ("ypp3", False), ("ur5", True), ("kinova", True)])
def test_what_is_printed_is_pinocchios_matrix(name: str, believe: bool) -> None:
    factoring = factoring_of(name, believe)
    md = equations_md(factoring)
    errors = errors_of_print(factoring, md, 0)
    uncut = {pair for pair, S in factoring.S.items() if S.any() and not _cut(factoring, pair)}
    assert set(errors) == uncut
    assert len(errors) >= factoring.chain.n
    assert max(errors.values()) < SIX_DIGITS


def _cut(factoring: Factoring, pair: tuple[int, int]) -> bool:
    per_constant = (factoring.S[pair] != 0).sum(axis=0)
    return per_constant.sum() > 60 and per_constant.max() > 8


@pytest.mark.parametrize("seed", range(12))
def test_slides_and_other_angles_print_right(seed: int) -> None:
    factoring = factor(random_arm(seed, 3, right_angles=seed % 2 == 0))
    errors = errors_of_print(factoring, equations_md(factoring), seed)
    assert {(k, k) for k in range(3)} <= set(errors)
    assert max(errors.values()) < SIX_DIGITS


def test_opposite_parallel_axes_subtract() -> None:
    flipped = list(arm("ypp3").joints)
    flipped[2] = replace(flipped[2], axis=-flipped[2].axis)
    factoring = factor(replace(arm("ypp3"), joints=tuple(flipped)), believe_zeros=True)
    md = equations_md(factoring)
    assert r"J_{11} = \alpha_{11} c_{2-3}^2 + \alpha_{12} c_2^2 + 2 \alpha_{21} c_2 c_{2-3} + \alpha_{13}" in md
    assert r"$c_{2-3}$ is $\cos(q_2 - q_3)$." in md
    assert max(errors_of_print(factoring, md, 1).values()) < SIX_DIGITS


def test_every_sum_of_angles_that_is_printed_is_explained() -> None:
    """Yaw, then three pitch joints, the second of which turns the other way."""
    yaw, pitch, elbow = arm("ypp3").joints
    flipped = replace(elbow, name="flipped", axis=-elbow.axis)
    chain = replace(arm("ypp3"), joints=(yaw, pitch, flipped, replace(elbow, name="wrist")))
    factoring = factor(chain, believe_zeros=True)
    md = equations_md(factoring)
    printed = set(re.findall(r"[cs](_\{[\d+-]+\})", md))
    assert printed == {"_{2-3}", "_{2-3+4}", "_{3-4}"}
    for subscript in printed:
        cosine = re.sub(r"(\d)", r" q_\1", subscript[2:-1]).replace("-", " -").replace("+", " +").strip()
        assert f"$c{subscript}$ is $\\cos({cosine})$." in md
    assert max(errors_of_print(factoring, md, 1).values()) < SIX_DIGITS


def test_subscripts_of_ten_joints_stay_readable() -> None:
    assert [entry_text(9, 0, 8), entry_text(10, 0, 1), entry_text(12, 0, 11)] == ["J_19", "J_1_2", "J_1_12"]
    assert angle_subscript(((8, 1), (9, 1))) == "_{9+10}"
    assert angle_subscript(((8, 1), (9, -1))) == "_{9-10}"
    assert angle_subscript(((1, 1), (2, 1), (3, -1))) == "_{2+3-4}"
    assert angle_subscript(((1, 1), (2, 1), (3, 1))) == "_{234}"
    assert alpha_latex("alpha_1_10") == r"\alpha_{1,10}"
    assert alpha_latex("alpha_1x2_3") == r"\alpha_{1 \times 2,3}"


def test_long_sums_are_grouped_folded_and_cut_and_say_by_how_much() -> None:
    factoring = factoring_of("panda")
    md = equations_md(factoring)
    total = len(terms(factoring, 0, 0))
    block = re.search(rf"<summary>J_11: {total} terms in 31 constants</summary>(.*?)</details>", md, flags=re.DOTALL)
    assert block
    more = re.search(r"… and (\d+) terms more: see `J_diag.casadi`.", block[1])
    shown = len(re.findall(r"(?<![(&])[+-] (?!\\cdots)|= |\((?!q)", block[1]))  # one per term, one more per bracket
    brackets = len(re.findall(r"\\alpha_\{\d+\} \(", block[1]))
    assert more
    assert shown - brackets + int(more[1]) == total
    assert md.index("## Structure") < md.index("## Diagonal entries") < md.index("J_11: ") < md.index("## Constants")
    assert len(md) < 100_000


def test_what_no_diagonal_shows_what_was_snapped_and_what_is_held_is_said() -> None:
    ur5 = equations_md(factoring_of("ur5"))
    assert r"No diagonal entry shows $\alpha_{1 \times 2,1}$, " in ur5
    assert "$J_{12}$, at 6 postures." in ur5
    assert "No inertial parameter is believed to be zero" in ur5
    xarm = equations_md(factoring_of("xarm7"))
    assert "Taken as exact: 1.5708 rad at `joint3` as `pi/2`." in xarm
    assert "Held still: `panda_finger_joint1` at 0, `panda_finger_joint2` at 0." in equations_md(factoring_of("panda"))


def test_the_plan_is_listed() -> None:
    cells = [
        {"joint": "joint3", "q": [0.0, 0.0, 0.0], "spare": False},
        {"joint": "joint1", "q": [0, 1.25, -2], "spare": True},
    ]
    plan: dict[str, Any] = {"measurements": 6, "spare": 2, "cells": cells, "rank": 6, "open": [], "infeasible": []}
    md = equations_md(factoring_of("ypp3", True), {"plan": plan})
    assert "6 measurements determine the 6 constants of the diagonal; 2 more" in md
    assert "| `joint1` | spare | 0, 1.25, -2 |" in md and "Open" not in md and "can not be held" not in md

    refused = [{"cell": 2, "joint": "joint1", "why": "a|b beyond its limits"}]
    short = plan | {"measurements": 5, "rank": 5, "open": ["alpha_12", "alpha_13"], "infeasible": refused}
    md = equations_md(factoring_of("ypp3", True), {"plan": short})
    assert "5 measurements determine 5 combinations of the 6 constants of the diagonal; 2 more" in md
    assert r"Open stay $\alpha_{12}$, $\alpha_{13}$." in md
    assert "Posture 2 (`joint1`) can not be held: `a b beyond its limits`." in md


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_the_last_bit_of_the_processor_does_not_show(name: str) -> None:
    factoring, rng = factoring_of(name), np.random.default_rng(0)
    noisy = {pair: S * (1.0 + 2e-16 * rng.integers(-1, 2, S.shape)) for pair, S in factoring.S.items()}
    assert any((noisy[pair] != S).any() for pair, S in factoring.S.items())
    assert equations_md(replace(factoring, S=noisy)) == equations_md(factoring)


HOSTILE = "a|b`c$d<script>\\x\n% #_{}~^&é机"


def hostile_arm() -> Chain:
    def renamed(joint: Joint, k: int) -> Joint:
        return replace(joint, name=f"{HOSTILE}{k}", link=f"{HOSTILE}{k}")

    joints = tuple(renamed(joint, k) for k, joint in enumerate(arm("ypp3").joints))
    snap = Snap(HOSTILE, 1.57, np.pi / 2, "pi/2")
    return replace(arm("ypp3"), name=HOSTILE, joints=joints, snapped=(snap,), frozen={HOSTILE: 0.5})


def test_names_can_not_break_the_markdown() -> None:
    md = equations_md(factor(hostile_arm(), believe_zeros=True))
    assert "<script>" not in md
    tables = [line for line in md.splitlines() if line.startswith("|")]
    assert {line.count("|") for line in tables} == {6, 5, 4}
    for line in tables:
        assert line.count("`") % 2 == 0
    outside = re.sub(r"```.*?```|`[^`\n]*`", "", md, flags=re.DOTALL)
    assert outside.count("$") % 2 == 0
    for math in re.findall(r"\$([^$]*)\$", outside):  # what GitHub would take for Markdown inside a formula
        assert not re.search(r"[|*<\n]|\\\\|\}_|\\[{},]", math)


@pytest.mark.parametrize("name", ["ypp3", "panda", "hostile"])
def test_the_article_is_ascii_and_balanced(name: str) -> None:
    tex = latex(document(factor(hostile_arm()) if name == "hostile" else factoring_of(name)))
    assert tex.isascii()
    depth = 0
    for character in re.sub(r"\\[\\{}]", "", tex):
        depth += (character == "{") - (character == "}")
        assert depth >= 0
    assert depth == 0
    stack: list[str] = []
    for kind, environment in re.findall(r"\\(begin|end)\{(\w+\*?)\}", tex):
        if kind == "begin":
            stack.append(environment)
        else:
            assert stack.pop() == environment
    assert not stack
    outside = re.sub(r"\\begin\{align\*\}.*?\\end\{align\*\}", "", tex, flags=re.DOTALL)
    assert outside.replace(r"\$", "").count("$") % 2 == 0


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX here")
@pytest.mark.parametrize("name", ["ypp3", "hostile"])
def test_the_article_compiles(name: str, tmp_path: Path) -> None:
    factoring = factor(hostile_arm()) if name == "hostile" else factoring_of(name, True)
    (tmp_path / "equations.tex").write_text(latex(document(factoring)), encoding="ascii")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "equations.tex"]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
    assert run.returncode == 0, run.stdout[-2000:]
    assert b"Overfull \\hbox" not in run.stdout
