"""Every constant alpha as a formula in masses m, lengths l, centres of mass r and inertias I, as in (13)-(16).

Link k (from 1) is the body behind joint k. `m_k` is its mass, `r_xk, r_yk, r_zk` its centre of mass in the link frame,
`I_xxk ..` its inertia about the centre of mass in link-frame axes. The offset from joint k to joint k + 1 is a length of
link k: `l_k` if it lies along one axis, `l_kx, l_ky, l_kz` otherwise; its sign is that of the URDF's number.

The lengths are symbols when the arm is built at right angles: the coefficients are then polynomials in the lengths with
whole coefficients (`geometry`). Otherwise, and for a constant that is only part of a coefficient, they are decimal
numbers in front of m, m r and I.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from math import fsum

import numpy as np

from symgen.basis import UNITS, Factoring
from symgen.chain import Array, Chain
from symgen.geometry import Length, Units, at_right_angles, lengths, polynomials
from symgen.kinematics import MOMENTS

_AXES = "xyz"


@dataclass(frozen=True, order=True)
class Symbol:
    """One letter of a formula: `kind` "l", "m", "r" or "I", the link (from 1), and the axes it names ("", "y", "xz")."""

    kind: str
    link: int
    axes: str = ""

    @property
    def text(self) -> str:
        """Plain name: l_2, l_2x, m_3, r_y3, I_xx3."""
        if self.kind == "l":
            return f"l_{self.link}{self.axes}"
        return f"{self.kind}_{self.axes}{self.link}"

    @property
    def latex(self) -> str:
        """LaTeX name: l_2, l_{2x}, m_3, r_{y,3}, I_{xx,3}."""
        if self.kind in "rI":
            return f"{self.kind}_{{{self.axes},{self.link}}}"
        subscript = f"{self.link}{self.axes}"
        return f"{self.kind}_{subscript}" if len(subscript) == 1 else f"{self.kind}_{{{subscript}}}"


@dataclass(frozen=True)
class Term:
    """`coefficient` times the product of `lengths` and `body`; repeated symbols are powers."""

    coefficient: float
    lengths: tuple[Symbol, ...]
    body: tuple[Symbol, ...]


@dataclass(frozen=True)
class Formula:
    """One alpha as a sum of terms, in print order, and the same as plain text and LaTeX (shared factors in brackets)."""

    name: str
    terms: tuple[Term, ...]
    text: str
    latex: str


def rounded(value: float) -> float:
    """Returns the number with the 14 significant digits it has in files: the same whatever the processor's last bit."""
    return float(f"{value:.14g}") + 0.0


def known(value: float, count: int) -> float | None:
    """Returns the number with that many significant digits; None where there is none."""
    return None if np.isnan(value) else digits(value, count)


def digits(value: float, count: int) -> float:
    """Returns the number rounded to that many significant digits, so that files do not depend on the processor."""
    return float(f"{value:.{count}g}") + 0.0


def decade(value: float) -> float:
    """Returns the power of ten just above a value that is rounding noise, and never below 1e-15."""
    return float(f"1e{max(int(np.ceil(np.log10(max(value, 1e-300)))), -15)}")


def alpha_cad(factoring: Factoring) -> list[float]:
    """Returns the constants [D] of the URDF's own bodies as files state them: W phi summed exactly, then rounded."""
    out = []
    for row in factoring.W:
        products = (row * factoring.chain.parameters).tolist()
        total = fsum(products)
        out.append(rounded(total) if abs(total) > 1e-14 * fsum(map(abs, products)) else 0.0)
    return out


def number(value: float) -> str:
    """Returns a coefficient for people: whole numbers as such, others with at most 6 significant digits."""
    value = float(f"{value:.12g}")  # 0.4296875 is a tie in the sixth digit: let no last bit decide it
    return str(round(value)) if value == round(value) and abs(value) < 1e6 else f"{value:.6g}"


def latex_number(value: float) -> str:
    """The same for LaTeX: 1.2e-07 as 1.2 \\cdot 10^{-7}."""
    mantissa, _, exponent = number(value).partition("e")
    return rf"{mantissa} \cdot 10^{{{int(exponent)}}}" if exponent else mantissa


def named_lengths(chain: Chain) -> dict[Symbol, Length]:
    """Returns the lengths [m] that the formulas speak of by name; none when the arm is not built at right angles."""
    if not at_right_angles(chain):
        return {}
    return {Symbol("l", item.link, "" if item.alone else _AXES[item.axis]): item for item in lengths(chain)}


def alpha_formulas(factoring: Factoring) -> list[Formula]:
    """Returns the formula of each of the D constants, in the order of `factoring.alphas`."""
    symbols, units = list(named_lengths(factoring.chain)), Units(factoring.chain)
    formulas: dict[str, Formula] = {}
    for pair, members in groupby(factoring.alphas, key=lambda alpha: (alpha.i, alpha.j)):
        alphas = list(members)
        if at_right_angles(factoring.chain):
            powers = [UNITS.index(alpha.unit) for alpha in alphas]
            tables = polynomials(units, factoring.entries[pair], [alpha.monomial for alpha in alphas], powers)
            tables = np.round(tables)
        else:
            tables = np.zeros((len(alphas), factoring.free.size, 1, 1))
        for table, alpha in zip(tables, alphas, strict=True):
            if alpha.part or not at_right_angles(factoring.chain):
                table[...] = 0.0
                table[:, 0, 0] = alpha.row * alpha.content
        for alpha, table in zip(alphas, tables, strict=True):
            terms = _terms(factoring, symbols, table / alpha.content)
            formulas[alpha.name] = Formula(alpha.name, terms, _join(terms, latex=False), _join(terms, latex=True))
    return [formulas[name] for name in factoring.names]


def _body(factoring: Factoring, p: int) -> Iterator[tuple[float, tuple[Symbol, ...]]]:
    """One inertial parameter in m, r and I about the centre of mass; what is believed zero is left out."""
    k, a = divmod(p, 10)
    m, r = Symbol("m", k + 1), [Symbol("r", k + 1, axis) for axis in _AXES]
    there = factoring.free[10 * k : 10 * k + 4]
    if a == 0:
        yield 1.0, (m,)
    elif a < 4:
        yield 1.0, (m, r[a - 1])
    else:
        x, y = MOMENTS[a - 4]
        yield 1.0, (Symbol("I", k + 1, _AXES[x] + _AXES[y]),)
        if there[0] and x != y and there[1 + x] and there[1 + y]:
            yield -1.0, (m, r[x], r[y])
        for other in range(3):
            if there[0] and x == y and other != x and there[1 + other]:
                yield 1.0, (m, r[other], r[other])


def _terms(factoring: Factoring, symbols: list[Symbol], table: Array) -> tuple[Term, ...]:
    """The polynomial `table` [10 n, 1 + L, 1 + L] in lengths and parameters (index 0: no length), in print order."""
    total: dict[tuple[tuple[Symbol, ...], tuple[Symbol, ...]], float] = {}
    for p, a, b in np.argwhere(np.where(factoring.free[:, None, None], table, 0.0)).tolist():
        factors = tuple(symbols[k - 1] for k in (a, b) if k)
        for sign, body in _body(factoring, p):
            total[factors, body] = total.get((factors, body), 0.0) + sign * float(table[p, a, b])
    largest = max(map(abs, total.values()), default=0.0)
    terms = [Term(value, *key) for key, value in total.items() if abs(value) > 1e-12 * largest]
    return tuple(sorted(terms, key=_print_order))


def _print_order(term: Term) -> tuple[object, ...]:
    """I by link; then m and m r by their lengths; m r r by link. Positive before negative."""
    centres, link, negative = _centres(term), term.body[0].link, term.coefficient < 0
    if term.body[0].kind == "I":
        return (False, link, negative, term.body)
    return (True, centres, term.lengths, link if centres == 2 else 0, abs(term.coefficient), negative, link, term.body)


def _centres(term: Term) -> int:
    return sum(symbol.kind == "r" for symbol in term.body)


def _bracket(term: Term) -> tuple[object, ...]:
    """Terms with the same key share what stands in front: printed as one product with a bracket."""
    if term.body[0].kind == "I":
        return (term.body,)
    return (_centres(term), term.lengths, term.body[0] if _centres(term) == 2 else None, abs(term.coefficient))


def _join(terms: tuple[Term, ...], *, latex: bool) -> str:
    """The sum as it is printed: a (b + c), and (a + d) (b + c) where brackets are alike."""
    products: dict[str, list[tuple[bool, str]]] = {}
    for _, members in groupby(terms, key=_bracket):
        group = list(members)
        negative, size = group[0].coefficient < 0, abs(group[0].coefficient)
        mass = group[0].body[:1] if len(group) > 1 and _centres(group[0]) == 2 else ()
        inner = _sum((negative != (t.coefficient < 0), _product(t.body[len(mass) :], latex)) for t in group)
        factor = [latex_number(size) if latex else number(size)] if size != 1 else []
        factor += [_product(symbols, latex) for symbols in (group[0].lengths, mass) if symbols]
        products.setdefault(f"({inner})" if len(group) > 1 else inner, []).append((negative, " ".join(factor)))
    whole = []
    for inner, factors in products.items():
        negative = factors[0][0]
        front = _sum((negative != minus, text) for minus, text in factors)
        whole.append((negative, " ".join(filter(None, [f"({front})" if len(factors) > 1 else front, inner]))))
    return _sum(whole)


def _sum(products: Iterable[tuple[bool, str]]) -> str:
    """Products, each with whether it is subtracted, as a sum."""
    out = ""
    for negative, product in products:
        out += (" - " if negative else " + ") if out else "-" if negative else ""
        out += product
    return out


def _product(factors: tuple[Symbol, ...], latex: bool) -> str:
    words = []
    for symbol, members in groupby(factors):
        power = len(list(members))
        words.append((symbol.latex if latex else symbol.text) + (f"^{power}" if power > 1 else ""))
    return " ".join(words)
