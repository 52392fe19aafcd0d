"""How J_ij(q) is written: c_23, s_23^2, alpha_21 in LaTeX, and an entry as a list of terms in print order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import overload

import numpy as np
from numpy.typing import NDArray

from symgen.basis import Factoring
from symgen.chain import Array
from symgen.formula import latex_number
from symgen.inertia import Angle


@dataclass(frozen=True)
class Term:
    """coefficient * alpha[alpha] * (monomial of the entry's table); `constant` if it does not depend on q."""

    coefficient: float
    alpha: int
    monomial: int
    constant: bool


def subscript(numbers: Sequence[int]) -> str:
    """Returns _2, _{23}; _{9,10} once a number has two digits."""
    text = ("," if max(numbers) > 9 else "").join(map(str, numbers))
    return f"_{text}" if len(text) == 1 else f"_{{{text}}}"


def entry_latex(i: int, j: int) -> str:
    """Returns J_{23} for the entry (1, 2), joints counted from 0."""
    return "J" + subscript((i + 1, j + 1))


def entry_text(n: int, i: int, j: int) -> str:
    """Returns J_23 for the entry (1, 2) of an arm of n joints, counted from 0; J_2_3 from ten joints on."""
    return f"J_{i + 1}{j + 1}" if n < 10 else f"J_{i + 1}_{j + 1}"


def alpha_latex(name: str) -> str:
    """Returns a constant's name in LaTeX: alpha_21 as \\alpha_{21}, alpha_1x2_1 as \\alpha_{1 \\times 2,1}."""
    numbers = name.removeprefix("alpha_").replace("_", ",").replace("x", r" \times ")
    return rf"\alpha_{{{numbers}}}"


@cache
def angle_subscript(angle: Angle) -> str:
    """Returns the subscript of a (cumulative) angle: _2, _{23} for q_2 + q_3, _{2-3+4} for q_2 - q_3 + q_4."""
    stated = any(k > 8 or sign < 0 for k, sign in angle)
    text = ""
    for k, sign in angle:
        text += ("-" if sign < 0 else "+" if stated and text else "") + str(k + 1)
    return f"_{text}" if len(text) == 1 else f"_{{{text}}}"


def angle_sum(angle: Angle) -> str:
    """Returns a (cumulative) angle in full: q_2 + q_3, q_2 - q_3."""
    words = [("-" if sign < 0 else "+", f"q{subscript([k + 1])}") for k, sign in angle]
    return " ".join(f"{sign} {name}" for sign, name in words).removeprefix("+ ")


class Terms(Sequence[Term]):
    """Terms of one entry in print order; each is made when it is looked at, as of thousands only a few are printed."""

    def __init__(self, coefficient: Array, alpha: Array, monomial: Array, still: Array):
        self._columns = (coefficient, alpha, monomial, still)

    def __len__(self) -> int:
        return len(self._columns[0])

    @overload
    def __getitem__(self, index: int) -> Term: ...
    @overload
    def __getitem__(self, index: slice | NDArray[np.int64]) -> Terms: ...
    def __getitem__(self, index: int | slice | NDArray[np.int64]) -> Term | Terms:
        coefficient, alpha, monomial, still = (column[index] for column in self._columns)
        if isinstance(index, slice | np.ndarray):
            return Terms(coefficient, alpha, monomial, still)
        return Term(float(coefficient), int(alpha), int(monomial), bool(still))

    def by_constant(self) -> dict[int, Terms]:
        """The terms of each constant, in the order in which the constants first appear."""
        alpha = self._columns[1]
        constants, first = np.unique(alpha, return_index=True)
        order = np.argsort(alpha, kind="stable")
        groups = np.split(order, np.searchsorted(alpha[order], constants[1:]))
        return {int(constants[k]): self[groups[k]] for k in np.argsort(first)}


def terms(factoring: Factoring, i: int, j: int) -> Terms:
    """Returns J_ij (i <= j, from 0) in print order: its own constants, those known from joints nearer the tip, and last
    what does not depend on q."""
    S = factoring.S[i, j]
    still: NDArray[np.bool_] = np.all(factoring.entries[i, j].digits == 0, axis=1)
    borrowed = np.array([(alpha.i, alpha.j) != (i, j) for alpha in factoring.alphas])
    monomial, alpha = np.nonzero(S)
    order = np.lexsort((monomial, alpha, borrowed[alpha], still[monomial]))
    monomial, alpha = monomial[order], alpha[order]
    return Terms(S[monomial, alpha], alpha, monomial, still[monomial])


def joints_of(factoring: Factoring, i: int, j: int) -> list[int]:
    """Returns the joints (from 0) whose coordinates J_ij depends on."""
    return sorted({k for angle in _angles_of(factoring, i, j) for k, _ in angle})


def _angles_of(factoring: Factoring, i: int, j: int) -> list[Angle]:
    """The (cumulative) angles that J_ij depends on."""
    entry = factoring.entries[i, j]
    used = entry.digits[np.any(factoring.S[i, j] != 0.0, axis=1)]
    return [angle for position, angle in enumerate(entry.angles) if np.any(used[:, position] != 0)]


def summed_angles(factoring: Factoring) -> list[Angle]:
    """Returns the sums of joint angles that any J_ij depends on, base to tip."""
    angles = dict.fromkeys(angle for pair in factoring.entries for angle in _angles_of(factoring, *pair))
    return sorted((angle for angle in angles if len(angle) > 1), key=lambda angle: [k for k, _ in angle])


def function(factoring: Factoring, i: int, j: int, term: Term) -> str:
    """Returns the trigonometric function of a term of J_ij in LaTeX; "" for the constant 1."""
    entry = factoring.entries[i, j]
    words = []
    for angle, turning, digit in zip(entry.angles, entry.turning, entry.digits[term.monomial].tolist(), strict=True):
        x = angle_subscript(angle)
        words.append(
            ("", f"c{x}", f"s{x}", f"c{x}^2", f"c{x} s{x}")[digit] if turning else ("", f"q{x}", f"q{x}^2")[digit]
        )
    return " ".join(filter(None, words))


def signed(coefficient: float, product: str, first: bool) -> str:
    """Returns one piece of a sum with its sign; a coefficient of 1 is not printed in front of a product."""
    size = latex_number(abs(coefficient))
    text = " ".join(filter(None, ["" if size == "1" and product else size, product]))
    if first:
        return ("-" if coefficient < 0 else "") + text
    return ("- " if coefficient < 0 else "+ ") + text


def flat(factoring: Factoring, i: int, j: int, members: Sequence[Term]) -> list[str]:
    """Returns the pieces of a sum of terms of J_ij: ["\\alpha_{11} c_{23}^2", "+ 2 \\alpha_{21} c_2 c_{23}", ..]."""
    pieces: list[str] = []
    for term in members:
        product = f"{alpha_latex(factoring.names[term.alpha])} {function(factoring, i, j, term)}".rstrip()
        pieces.append(signed(term.coefficient, product, not pieces))
    return pieces


def functions(factoring: Factoring, i: int, j: int, members: Sequence[Term], most: int | None = None) -> list[str]:
    """Returns the pieces of what multiplies one constant in J_ij, at most `most` of them and then an ellipsis."""
    pieces: list[str] = []
    for term in members[:most]:
        pieces.append(signed(term.coefficient, function(factoring, i, j, term), not pieces))
    return pieces + ([r"+ \cdots"] if most is not None and len(members) > most else [])
