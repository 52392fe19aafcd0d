"""A table of a map.toml, read strictly: every value has a check, every error names file, table and key."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ident.errors import ImportingError, short

#: Sampling rates [Hz] that a machine may have.
RATES = (5.0, 2e5)
_MAX_BYTES = 1_000_000
_MAX_LINES = 1_000_000


def read_toml(path: Path) -> dict[str, Any]:
    """Returns the document in the TOML file. ImportingError, one line, if it can not be read or is none."""
    try:
        if not path.is_file():
            raise ImportingError(f"{path}: no such file; expected a map.toml (ident import --guess writes one)")
        if path.stat().st_size > _MAX_BYTES:
            raise ImportingError(f"{path}: larger than {_MAX_BYTES} bytes; expected a map.toml")
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise ImportingError(f"{path}: cannot be read: {error.strerror}") from None
    except RecursionError:
        raise ImportingError(f"{path}: not TOML: nested too deeply") from None
    except ValueError as error:
        raise ImportingError(f"{path}: not TOML: {' '.join(str(error).split())}") from None


class _Unfit(Exception):
    """A value that breaks its key's rule; the text says what was expected."""


Check = Callable[[Any], Any]


@dataclass(frozen=True)
class Table:
    """One table of the file, `values`, and how to speak of it, `where`."""

    where: str
    values: Any

    def error(self, problem: str) -> ImportingError:
        """The error to raise for this table."""
        return ImportingError(f"{self.where}: {problem}")

    def table(self, name: str) -> Table:
        """The table of that name inside this one, empty where there is none."""
        return Table(f"{self.where}: {name}" if name.isprintable() else f"{self.where}: {name!r}", self._of(name))

    def _of(self, name: str) -> Any:
        value = self.values.get(name, {})
        if not isinstance(value, dict):
            raise self.error(f"{name}: found {short(value)}, expected a table")
        return value

    def known(self, keys: Mapping[str, str] | Sequence[str], required: Sequence[str]) -> None:
        """Raises ImportingError for a key that is not among `keys`, and for a `required` one that is missing."""
        if not isinstance(self.values, dict):
            raise self.error(f"found {short(self.values)}, expected a table")
        for key in self.values:
            if key not in keys:
                raise self.error(f"unknown key {key!r}; expected {', '.join(keys)}")
        for key in required:
            if key not in self.values:
                raise self.error(f"{key} is missing")

    def get(self, key: str, check: Check, default: Any) -> Any:
        """The checked value of a key, or the default. ImportingError where the check refuses it."""
        if key not in self.values:
            return default
        try:
            return check(self.values[key])
        except _Unfit as error:
            raise self.error(f"{key}: found {short(self.values[key])}, expected {error}") from None


def number(value: Any) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= 1e300:
        raise _Unfit("a finite number")
    return float(value)


def nonzero(value: Any) -> float:
    """A finite number other than 0."""
    if (found := number(value)) == 0:
        raise _Unfit("a number other than 0")
    return found


def positive(value: Any) -> float:
    """A finite number > 0."""
    if (found := number(value)) <= 0:
        raise _Unfit("a number > 0")
    return found


def rate(value: Any) -> float:
    """A sampling rate [Hz] that a machine may have."""
    low, high = RATES
    if isinstance(value, str) or not low <= (found := positive(value)) <= high:
        raise _Unfit(f"the sampling rate in Hz, from {low:g} to {high:g}")
    return found


def whole(least: int) -> Check:
    """Returns the check of a whole number of at least `least`."""

    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value < 2**53:
            raise _Unfit(f"a whole number >= {least}")
        return value

    return check


def text(value: Any) -> str:
    """A string that is not empty."""
    if not isinstance(value, str) or not value or "\0" in value:
        raise _Unfit("a non-empty string")
    return value


def names_of(value: Any) -> tuple[str, ...]:
    """A list of different names."""
    if not isinstance(value, list) or not value or len({text(name) for name in value}) < len(value):
        raise _Unfit("a list of names, all different")
    return tuple(value)


def choice(*known: Any) -> Check:
    """Returns the check of one of the `known` values."""

    def check(value: Any) -> Any:
        if isinstance(value, bool | list | dict) or value not in known:
            raise _Unfit(" or ".join(map(repr, known)))
        return value

    return check


def numbers(count: int) -> Check:
    """Returns the check of a list of `count` finite numbers."""

    def check(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) != count:
            raise _Unfit(f"{count} numbers")
        return tuple(map(number, value))

    return check


def either(word: str, check: Check) -> Check:
    """Returns the check of `word` or of what `check` lets pass."""

    def checked(value: Any) -> Any:
        try:
            return word if value == word else check(value)
        except _Unfit as error:
            raise _Unfit(f'{error}, or "{word}"') from None

    return checked


def lines_of(value: Any) -> tuple[int, ...]:
    """Harmonics: a list, "first:last" or "first:step:last"."""
    expected = 'increasing whole numbers >= 1 as a list, or "first:last" or "first:step:last"'
    if isinstance(value, str) and all(part.isdecimal() and len(part) < 10 for part in value.split(":")):
        first, *step, last = (int(part) for part in ("0:" + value if ":" not in value else value).split(":"))
        if len(step) > 1 or 0 in step or last - first > _MAX_LINES:
            raise _Unfit(expected)
        value = list(range(first, last + 1, *step))
    if not isinstance(value, list) or not value or any(isinstance(k, bool) or not isinstance(k, int) for k in value):
        raise _Unfit(expected)
    if value[0] < 1 or value[-1] >= 2**53 or np.any(np.diff(value) <= 0):
        raise _Unfit(expected)
    return tuple(value)
