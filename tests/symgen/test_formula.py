"""Every constant's formula, read back as text and put to numbers, is the constant; and reads as the paper prints it."""

from __future__ import annotations

import math
import re
import time
from dataclasses import replace

import numpy as np
import pytest
from arms import arm, factoring_of, random_arm, with_random_bodies

from symgen.basis import Factoring, factor
from symgen.chain import Chain
from symgen.formula import Formula, alpha_cad, alpha_formulas, latex_number, named_lengths, number, rounded

#: Sums of some dozen products of exact factors: rounding, relative to the sum of the magnitudes.
ROUNDING = 1e-13
#: Decimal coefficients are printed with six digits.
SIX_DIGITS = 5e-6

ARMS = [(name, believe) for name in ("ypp3", "ur5", "panda", "xarm7", "kinova", "z1") for believe in (False, True)]


def letters(chain: Chain) -> dict[str, float]:
    """The value of every letter a formula of this arm may use: l_2, l_2x, m_3, r_y3, I_xy3."""
    values = {symbol.text: length.value for symbol, length in named_lengths(chain).items()}
    for k, joint in enumerate(chain.joints, start=1):
        values[f"m_{k}"] = joint.inertia.mass
        for x, a in enumerate("xyz"):
            values[f"r_{a}{k}"] = joint.inertia.com[x]
            values |= {f"I_{a}{b}{k}": joint.inertia.I[x, y] for y, b in enumerate("xyz") if y >= x}
    return values


def value(text: str, values: dict[str, float]) -> float:
    """What a plain formula says: names, juxtaposition as product, ^, + and -."""
    python = re.sub(r"(?<=[\w)]) (?=[\w(])", " * ", text).replace("^", "**")
    return float(eval(python, {"__builtins__": {}}, dict(values)))


def worst_error(factoring: Factoring, formulas: list[Formula], seed: int) -> float:
    """The largest error of a formula on random bodies, relative to the magnitude of what is summed."""
    other = with_random_bodies(factoring, seed)
    values = letters(other)
    errors = [
        abs(value(formula.text, values) - alpha.row @ other.parameters) / (abs(alpha.row) @ abs(other.parameters))
        for alpha, formula in zip(factoring.alphas, formulas, strict=True)
    ]
    return max(errors)


def test_the_papers_arm_reads_as_in_the_paper() -> None:
    formulas = {formula.name: formula.text for formula in alpha_formulas(factoring_of("ypp3", True))}
    assert formulas == {
        "alpha_31": "I_xx3 + m_3 r_y3^2",
        "alpha_21": "l_2 m_3 r_y3",
        "alpha_22": "I_xx2 + I_xx3 + l_2^2 m_3 + m_2 r_y2^2 + m_3 r_y3^2",
        "alpha_11": "I_zz3 - I_yy3 + m_3 r_y3^2",
        "alpha_12": "I_zz2 - I_yy2 + l_2^2 m_3 + m_2 r_y2^2",
        "alpha_13": "I_zz1 + I_yy2 + I_yy3",
    }


@pytest.mark.parametrize(("name", "believe"), ARMS)
def test_a_formula_is_its_constant_whatever_the_bodies(name: str, believe: bool) -> None:
    factoring = factoring_of(name, believe)
    formulas = alpha_formulas(factoring)
    assert [formula.name for formula in formulas] == list(factoring.names)
    assert max(worst_error(factoring, formulas, seed) for seed in range(2)) < ROUNDING


@pytest.mark.parametrize("seed", range(12))
def test_arms_at_right_angles_with_slides_have_exact_formulas(seed: int) -> None:
    factoring = factor(random_arm(seed, 1 + seed % 5, right_angles=True))
    assert worst_error(factoring, alpha_formulas(factoring), seed) < ROUNDING


@pytest.mark.parametrize("seed", range(6))
def test_arms_at_other_angles_have_decimal_coefficients(seed: int) -> None:
    factoring = factor(random_arm(seed, 2 + seed % 3, right_angles=False))
    formulas = alpha_formulas(factoring)
    assert not named_lengths(factoring.chain)
    # Six digits of a parameter's coefficient, and of m r^2 from L = I + m r^2: twice the error.
    assert worst_error(factoring, formulas, seed) < 2 * SIX_DIGITS
    values = letters(factoring.chain)
    for alpha, formula in zip(factoring.alphas, formulas, strict=True):
        exact = [term.coefficient * math.prod(values[s.text] for s in term.body) for term in formula.terms]
        assert sum(exact) == pytest.approx(alpha.row @ factoring.chain.parameters, abs=ROUNDING * sum(map(abs, exact)))


def test_a_formula_holds_for_another_arm_of_the_same_build() -> None:
    assert [f.text for f in alpha_formulas(factoring_of("ur5"))] == [
        f.text for f in alpha_formulas(factoring_of("ur10"))
    ]


def test_constants_are_divided_by_a_number_that_divides_them_for_any_lengths() -> None:
    for name in ("kinova", "z1"):
        factoring = factoring_of(name)
        assert {alpha.content for alpha in factoring.alphas} == {1, 2}
        coefficients = [term.coefficient for formula in alpha_formulas(factoring) for term in formula.terms]
        assert all(c == round(c) for c in coefficients)


def test_shared_factors_stand_before_brackets() -> None:
    formulas = {formula.name: formula for formula in alpha_formulas(factoring_of("ur5"))}
    assert formulas["alpha_21"].text == "l_2z l_3 (m_4 + m_5 + m_6) + l_2z m_3 r_z3"
    assert formulas["alpha_21"].latex == "l_{2z} l_3 (m_4 + m_5 + m_6) + l_{2z} m_3 r_{z,3}"
    assert formulas["alpha_61"].text == "I_yy6 + m_6 (r_x6^2 + r_z6^2)"


@pytest.mark.parametrize("name", ["ypp3", "panda"])
def test_latex_and_text_say_the_same(name: str) -> None:
    for formula in alpha_formulas(factoring_of(name)):
        plain = re.sub(r"_\{(\d*)([xyz]*),?(\d*)\}", r"_\1\2\3", formula.latex)
        assert plain == formula.text


def test_lengths_have_the_urdfs_sign_and_joint() -> None:
    found = {symbol.text: (length.value, length.joint) for symbol, length in named_lengths(arm("panda")).items()}
    assert found == {
        "l_2": (-0.316, "panda_joint3"),
        "l_3": (0.0825, "panda_joint4"),
        "l_4x": (-0.0825, "panda_joint5"),
        "l_4y": (0.384, "panda_joint5"),
        "l_6": (0.088, "panda_joint7"),
    }


def test_file_constants_are_those_of_the_urdf() -> None:
    for name in ("ypp3", "panda"):
        factoring = factoring_of(name)
        size = np.abs(factoring.W) @ np.abs(factoring.chain.parameters)
        assert (np.abs(np.array(alpha_cad(factoring)) - factoring.alpha_cad) <= ROUNDING * size).all()


def test_a_constant_that_is_rounding_of_zero_is_zero_in_files() -> None:
    factoring = factoring_of("ypp3")
    W = factoring.W.copy()
    W[0] = 0.0
    W[0, [0, 10, 20]] = np.array([0.1, 0.2, -0.3]) / factoring.chain.parameters[[0, 10, 20]]
    doubtful = replace(factoring, W=W)
    assert 0.0 < abs(doubtful.alpha_cad[0]) < 1e-16
    assert alpha_cad(doubtful)[0] == 0.0
    assert alpha_cad(doubtful)[1:] == alpha_cad(factoring)[1:]


@pytest.mark.parametrize(
    ("x", "text", "latex"),
    [
        (2.0, "2", "2"),
        (-1.875, "-1.875", "-1.875"),
        (1 / 3, "0.333333", "0.333333"),
        (0.4296875 * (1 - 1e-15), "0.429688", "0.429688"),
        (2.0000000000000004, "2", "2"),
        (1.25e-7, "1.25e-07", r"1.25 \cdot 10^{-7}"),
    ],
)
def test_numbers_for_people(x: float, text: str, latex: str) -> None:
    assert (number(x), latex_number(x)) == (text, latex)


def test_numbers_for_files() -> None:
    assert rounded(0.35**2) == 0.1225
    assert str(rounded(-0.0)) == "0.0"


@pytest.mark.bench
def test_pandas_formulas_take_less_than_half_a_second() -> None:
    factoring = factoring_of("panda")
    start = time.perf_counter()
    alpha_formulas(factoring)
    assert time.perf_counter() - start < 0.5
