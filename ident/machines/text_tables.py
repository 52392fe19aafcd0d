"""Text files as named columns of numbers: CSV of all countries."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ident.errors import ImportingError

Array = NDArray[np.float64]

#: Lines of a text file that are searched for the first row of numbers.
_HEAD_LINES = 200


def read_text(path: Path) -> Iterator[tuple[str, Array]]:
    """Columns of a text file: separated by commas, semicolons or tabs (then with either decimal sign), or blanks."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        head = [line.rstrip("\n") for _, line in zip(range(_HEAD_LINES), file, strict=False)]
    first, separator = _first_row(path, head)
    names = _heading(head[:first], separator, len(_split(head[first], separator)))
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        rows = (_points(line, separator) for line in file)
        try:
            values = np.loadtxt(rows, delimiter=separator, skiprows=first, ndmin=2, comments="#")
        except ValueError as error:
            text = " ".join(str(error).split()).removesuffix(".")
            raise ImportingError(f"{path}: below line {first}: {text}; expected {len(names)} numbers a row") from None
    yield from zip(names, values.T, strict=True)


def _first_row(path: Path, head: list[str]) -> tuple[int, str | None]:
    """Where numbers begin (line, from 0), and what separates them."""
    for k, line in enumerate(head):
        for separator in (",", ";", "\t", None):
            cells = _split(_points(line, separator), separator)
            if cells and not line.lstrip().startswith("#") and all(map(_is_number, cells)):
                return k, separator
    raise ImportingError(
        f"{path}: no row of numbers in the first {len(head)} lines; expected MAT, CSV, NPZ, HDF5 or MCAP"
    )


def _points(line: str, separator: str | None) -> str:
    """The line with decimal points: between semicolons or tabs a comma is nothing else."""
    return line.replace(",", ".") if separator in (";", "\t") else line


def _heading(above: list[str], separator: str | None, count: int) -> list[str]:
    """The names of the columns: the first line above the numbers with as many cells, else their numbers from 1."""
    for line in above:
        cells = [cell.strip().strip("\"'").strip() for cell in _split(line.lstrip("# "), separator)]
        if len(cells) == count and not all(map(_is_number, cells)):
            return [cell if cell and cells.index(cell) == k else str(k + 1) for k, cell in enumerate(cells)]
    return [str(k + 1) for k in range(count)]


def _split(line: str, separator: str | None) -> list[str]:
    return line.split(separator) if line.strip() else []


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
