"""Text files as named columns of numbers: CSV of all countries."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ident.errors import ImportingError, short

Array = NDArray[np.float64]

#: Marks of text that is not in bytes, and how it is read.
BYTE_ORDERS = {codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
#: Rows that tell how a file is laid out; they are taken from its second half, where no heading is.
_ROWS = 200
#: Separators of cells and whether their numbers may have decimal commas, in this order where both fit; None: blanks.
_LAYOUTS = ((",", False), (";", True), ("\t", True), (None, False), (None, True), (",", True))
#: Kinds of cells that numbers are made of.
_TOLD = ("number", "date")
_DATE = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d([.,]\d+)?)?(Z|[+-]\d\d:?\d\d)?")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(\.\d{3})+(\.\d+)?")
#: What a line of units beneath the names consists of.
_UNIT = re.compile(
    r"[\[(]?(-|1|%|n/a|([kmuµμn]?(s|A|V|W|m|N|Nm|N m|N\*m|N·m|Hz|rad|deg|rev)|°|°C|rpm|counts?|inc)(/(s|min)|²|\^2)*)?[\])]?"
)


class Seconds(NamedTuple):
    """Dates of a column as s since the first of them."""

    values: Array


@dataclass(frozen=True)
class _Layout:
    """How the cells of a row are told apart, and what the columns are: "number", "date", "text" or "" (empty)."""

    separator: str | None
    commas: bool
    kinds: tuple[str, ...]

    def cells(self, line: str) -> list[str]:
        return _cells(line, self.separator, self.commas)

    def kind(self, cell: str) -> str:
        return _kind(cell, self.commas)

    def fits(self, line: str) -> bool:
        """Whether a line has a number wherever its column has them; some may be empty."""
        kinds = [self.kind(cell) for cell in self.cells(line)]
        pairs = [pair for pair in zip(kinds, self.kinds, strict=False) if pair[1] in _TOLD]
        return len(kinds) == len(self.kinds) and any(mine for mine, _ in pairs) and all(m in (k, "") for m, k in pairs)


@dataclass(frozen=True)
class _Table:
    """The rows of a file by their line (from 1), and the names of its columns."""

    path: Path
    layout: _Layout
    names: list[str]
    rows: dict[int, str]

    def error(self, line: int, column: int, problem: str) -> ImportingError:
        return ImportingError(f"{self.path}: line {line}: column {self.names[column]!r} {problem}")

    def cells(self, line: int) -> list[str]:
        """The cells of that line. ImportingError where there are more or fewer than in others."""
        cells = self.layout.cells(self.rows[line])
        if len(cells) != len(self.names):
            count = f"has {len(cells)} cell{'s' * (len(cells) != 1)}, expected {len(self.names)} as in other rows"
            raise ImportingError(f"{self.path}: line {line} {count}; correct it or take it out")
        return cells


def read_text(path: Path) -> Iterator[tuple[str, Array | Seconds | str]]:
    """The columns of a text file: numbers, dates in ISO 8601, or in words what else they are.

    Cells are separated by commas, semicolons, tabs or blanks, with either decimal sign, of which a file has one, and may be quoted (where commas
    are both they must). An empty cell among numbers is NaN. ImportingError, one line that names line and column, for a cell that is no number.
    """
    lines = _lines(path)
    filled = {k: line.partition("#")[0] for k, line in enumerate(lines, 1) if line.partition("#")[0].strip()}
    layout = _layout(list(filled.values()))
    first = None if layout is None else _first_row(layout, filled)
    if layout is None or first is None:
        raise ImportingError(f"{path}: no row of numbers; expected MAT, CSV, NPZ, HDF5 or MCAP")
    names = _heading([line for line in lines[: first - 1] if line.strip()], layout)
    table = _Table(path, layout, names, {k: line for k, line in filled.items() if k >= first})
    _one_decimal_sign(table)
    numbers = _numbers(table)
    for k, (name, kind) in enumerate(zip(names, layout.kinds, strict=True)):
        if kind == "number":
            yield name, numbers[k]
        elif kind == "date":
            yield name, _seconds(table, k)
        else:
            yield name, f"text, as {short(table.cells(first)[k])}" if kind else "empty"


def _lines(path: Path) -> list[str]:
    content = path.read_bytes()
    encoding = next((name for mark, name in BYTE_ORDERS.items() if content.startswith(mark)), "utf-8-sig")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:  # an older Windows
        text = content.decode("cp1252", errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _cells(line: str, separator: str | None, commas: bool) -> list[str]:
    if separator is None or '"' not in line:
        cells = line.split(separator)
    else:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    bare = [cell.strip().strip("\"'").strip() for cell in cells]
    return [cell.replace(",", ".") for cell in bare] if commas else bare


def _kind(cell: str, commas: bool) -> str:
    if not cell:
        return ""
    try:
        float(cell.replace("_", "x"))
    except ValueError:
        return "date" if _DATE.fullmatch(cell) else "number" if commas and _THOUSANDS.fullmatch(cell) else "text"
    return "number"


def _layout(lines: Sequence[str]) -> _Layout | None:
    """What the rows in the second half of the file are best read as; None if they have no numbers."""
    half = lines[len(lines) // 2 :]
    sample = half[:: max(1, len(half) // _ROWS)]
    best, most = None, (False, 0)
    for separator, commas in _LAYOUTS:
        rows = [_cells(line, separator, commas) for line in sample]
        count = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
        columns = zip(*(row for row in rows if len(row) == count), strict=True)
        kinds = tuple(_usual([_kind(cell, commas) for cell in column]) for column in columns)
        told = sum(kind in _TOLD for kind in kinds)
        if told and (separator is not None or 2 * told >= count) and (told == count, told) > most:
            best, most = _Layout(separator, commas, kinds), (told == count, told)
    return best


def _usual(kinds: Sequence[str]) -> str:
    filled = Counter(kind for kind in kinds if kind)
    return filled.most_common(1)[0][0] if filled else ""


def _first_row(layout: _Layout, lines: dict[int, str]) -> int | None:
    """The first line that fits and has no names beneath it; None where there is none."""
    for (k, line), below in zip(lines.items(), [*list(lines.values())[1:], ""], strict=True):
        kinds = {layout.kind(cell) for cell in layout.cells(below)}
        if layout.fits(line) and kinds != {"text"}:
            return k
    return None


def _heading(above: Sequence[str], layout: _Layout) -> list[str]:
    """The names of the columns, their numbers from 1 where there are none: of the lines above, with as many cells, the fullest that is no line
    of units; of equals the nearest."""
    count = len(layout.kinds)
    used = max(k + 1 for k, kind in enumerate(layout.kinds) if kind)
    best, most = [""] * count, (False, 0)
    for line in reversed(above):
        cells = _cells(line.lstrip("#% "), layout.separator, False)
        cells += [""] * (count - len(cells) if len(cells) >= used else 0)
        names = [cell for cell in cells if cell]
        if len(cells) != count or all(_kind(name, layout.commas) == "number" for name in names):
            continue
        score = (not all(map(_UNIT.fullmatch, names)), len(set(names)))
        if score > most:
            best, most = cells, score
    return [cell if cell and best.index(cell) == k else str(k + 1) for k, cell in enumerate(best)]


def _one_decimal_sign(table: _Table) -> None:
    """Raises ImportingError if some numbers have decimal commas and others points: one of them marks thousands."""
    layout = table.layout
    if not layout.commas or not all(any(sign in line for line in table.rows.values()) for sign in ",."):
        return
    seen: dict[str, tuple[int, int, str]] = {}
    for line, text in table.rows.items():
        for column, (cell, kind) in enumerate(zip(_cells(text, layout.separator, False), layout.kinds, strict=False)):
            for sign in ",." if kind == "number" else "":
                if sign in cell:
                    seen.setdefault(sign, (line, column, cell))
        if len(seen) == 2:
            (first, k, comma), (second, other, point) = seen[","], seen["."]
            raise table.error(
                second,
                other,
                f"has {point!r}, line {first} {comma!r} under {table.names[k]!r}: decimal commas and points in one file; "
                "expected one decimal sign and no signs between thousands: export it again without them",
            )


def _numbers(table: _Table) -> dict[int, Array]:
    """The columns of numbers, by where they are. ImportingError names the cell that is none."""
    layout = table.layout
    which = [k for k, kind in enumerate(layout.kinds) if kind == "number"]
    separator, count = layout.separator, len(layout.kinds)
    quoted = layout.commas and separator == ","  # commas of two meanings
    lines = [line.replace(",", ".") if layout.commas else line for line in table.rows.values()]
    if (
        which
        and not quoted
        and all((line.count(separator) + 1 if separator else len(line.split())) == count for line in lines)
    ):
        try:
            values = np.loadtxt(lines, delimiter=separator, usecols=which, ndmin=2, comments=None, quotechar='"')
        except ValueError:
            values = np.empty((0, 0))  # what is amiss is found cell by cell
        if values.shape == (len(lines), len(which)):  # no quote that is left open takes lines together
            return dict(zip(which, values.T, strict=True))
    found = np.full((len(table.rows), count), np.nan)
    for row, line in enumerate(table.rows):
        cells = table.cells(line)
        for k in which:
            if cells[k]:
                try:
                    found[row, k] = float(cells[k].replace("_", "x"))
                except ValueError:
                    raise table.error(line, k, f"has {short(cells[k])}, expected a number") from None
    return {k: found[:, k] for k in which}


def _seconds(table: _Table, column: int) -> Seconds:
    dates = []
    for line in table.rows:
        cell = table.cells(line)[column]
        try:
            dates.append(datetime.fromisoformat(cell))
            dates[-1] - dates[0]  # both or none in a time zone
        except (ValueError, TypeError):
            raise table.error(
                line, column, f"has {short(cell)}, expected a date as {dates[0] if dates else cell}"
            ) from None
    return Seconds(np.array([(date - dates[0]).total_seconds() for date in dates]))
