"""A document as a list of blocks, and the two ways it is printed: Markdown with GitHub's math, and LaTeX.

Plain text may hold $math$ and `code`; both are passed on as such, everything else is escaped for LaTeX. Names from files
go in as `code(name)`.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from typing import assert_never


@dataclass(frozen=True)
class Heading:
    level: int
    text: str


@dataclass(frozen=True)
class Text:
    text: str


@dataclass(frozen=True)
class Display:
    """Lines of one displayed formula, aligned at &."""

    lines: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """`widths` are the shares of the line each column gets in LaTeX; 0 for a column as wide as its text."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    widths: tuple[float, ...]


@dataclass(frozen=True)
class Fold:
    """Blocks that a reader opens on demand (in print: a paragraph with a title)."""

    title: str
    blocks: tuple[Block, ...]


Block = Heading | Text | Display | Table | Fold

#: Formulas are broken into lines of about this many printed characters.
LINE = 84


def code(name: str) -> str:
    """Returns a name from a file as code that neither Markdown nor LaTeX can take for markup."""
    clean = re.sub(r"[`|$<>\\]|\s+|[^ -\U0010ffff]", " ", name).strip()
    return f"`{clean or '?'}`"


def width(math: str) -> int:
    """Returns about how many characters a piece of LaTeX math prints."""
    return len(re.sub(r"\\[a-zA-Z]+ ?|[{}_^&]", "", math))


def wrapped(pieces: Sequence[str]) -> list[str]:
    """Returns the pieces of a sum joined to lines of about `LINE` printed characters."""
    lines: list[str] = []
    for piece in pieces:
        if lines and width(lines[-1]) + width(piece) <= LINE:
            lines[-1] += " " + piece
        else:
            lines.append(piece)
    return lines


def inline(formula: str) -> str:
    """Returns a long sum as several inline formulas, so that a table cell can break it."""
    pieces = re.split(r" (?=[+-] )", formula)
    chunks: list[str] = []
    for piece in pieces:
        if chunks and width(chunks[-1]) + width(piece) <= 2 * LINE // 3:
            chunks[-1] += " " + piece
        else:
            chunks.append(piece)
    return " ".join(f"${'{} ' if k else ''}{chunk}$" for k, chunk in enumerate(chunks))


# Markdown ------------------------------------------------------------------------------------------------------------


def markdown(blocks: Sequence[Block]) -> str:
    """Returns the document as Markdown; formulas in ```math fences and $..$, which GitHub renders."""
    return "\n\n".join(_markdown(block) for block in blocks) + "\n"


def _markdown(block: Block) -> str:
    match block:
        case Heading(level, text):
            return "#" * level + " " + text
        case Text(text):
            return text
        case Display((line,)):
            return f"```math\n{line}\n```"
        case Display(lines):
            body = " \\\\\n".join(lines)
            return f"```math\n\\begin{{aligned}}\n{body}\n\\end{{aligned}}\n```"
        case Table(header, rows, _):
            return "\n".join("| " + " | ".join(row) + " |" for row in (header, ("---",) * len(header), *rows))
        case Fold(title, inside):
            return f"<details>\n<summary>{title}</summary>\n\n{markdown(inside)}\n</details>"
        case _:
            assert_never(block)


# LaTeX ---------------------------------------------------------------------------------------------------------------

_PREAMBLE = r"""\documentclass[10pt]{article}
\usepackage[T1]{fontenc}
\usepackage[a4paper,margin=2cm]{geometry}
\usepackage{amsmath}
\usepackage{array}
\usepackage{longtable}
\allowdisplaybreaks
\setcounter{MaxMatrixCols}{64}
\setlength{\parindent}{0pt}
\setlength{\parskip}{4pt}
\setlength{\emergencystretch}{3em}
\begin{document}
"""

_SECTIONS = {1: r"\section*", 2: r"\subsection*", 3: r"\subsubsection*"}

_SPECIAL = {character: "\\" + character for character in "&%$#_{}"} | {
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "\\": r"\textbackslash{}",
}


def latex(blocks: Sequence[Block]) -> str:
    """Returns the document as a LaTeX article in plain ASCII that compiles as it is."""
    return _PREAMBLE + "\n\n".join(_latex(block) for block in blocks) + "\n\\end{document}\n"


def _latex(block: Block) -> str:
    match block:
        case Heading(level, text):
            return f"{_SECTIONS[level]}{{{_escaped(text)}}}"
        case Text(text):
            return _escaped(text)
        case Display(lines):
            body = " \\\\\n".join(lines)
            return f"\\begin{{align*}}\n{body}\n\\end{{align*}}"
        case Table(header, rows, widths):
            columns = "".join(
                rf">{{\raggedright\arraybackslash}}p{{{share:g}\linewidth}}" if share else "l" for share in widths
            )
            body = "\n".join(" & ".join(map(_escaped, row)) + r" \\" for row in rows)
            top = " & ".join(map(_escaped, header)) + r" \\ \hline \endhead"
            return f"\\begin{{longtable}}{{{columns}}}\n{top}\n{body}\n\\end{{longtable}}"
        case Fold(title, inside):
            return "\n\n".join([rf"\paragraph*{{{_escaped(title)}}}\mbox{{}}", *map(_latex, inside)])
        case _:
            assert_never(block)


def _escaped(text: str) -> str:
    out = []
    for part in re.split(r"(\$[^$]*\$|`[^`]*`)", text):
        if part.startswith("$"):
            out.append(part)
        elif part.startswith("`"):
            out.append(rf"\texttt{{{_plain(part[1:-1])}}}")
        else:
            out.append(_plain(part))
    return "".join(out)


def _plain(text: str) -> str:
    out = "".join(_SPECIAL.get(character, character) for character in unicodedata.normalize("NFKD", text))
    return "".join(c for c in out if not unicodedata.combining(c)).encode("ascii", "replace").decode()
