"""The time that a foreign file tells, or its sampling rate: by names, and by numbers that grow evenly."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from ident.machines.mapping import TIME_UNITS
from ident.machines.readers import Variables
from ident.machines.toml_table import RATES
from ident.records.campaign import Array

_TIME = r"^t($|[^a-z])|^tout$|time|stamp|zeit"
#: How names say the units of time; an MCAP file's clocks are in s.
_WORDS = {
    "s": r"s|secs?|seconds?",
    "ms": r"ms|msecs?|millis\w*",
    "us": r"us|[µμ]s|usecs?|micros\w*",
    "ns": r"ns|nsecs?|nanos\w*",
}
_IN_SECONDS = ("/header/stamp", "/log_time")
_RATE = r"^(fs|f_s|fsamp\w*|sampl\w*rate\w*|rate_?hz)$"
#: Steps of a time without a name are alike up to this share of them.
_EVEN = 0.1


@dataclass(frozen=True)
class Time:
    """The time of a file: its variable, the column (from 0), its unit, the sampling rate [Hz]; not `sure` if its name does not say that it is one,
    or another unit fits as well."""

    name: str
    column: int | None
    unit: str
    rate: float
    sure: bool


def find_time(name: str, column: int | None, values: Array, variables: Variables) -> Time | None:
    """Returns the time that increasing values are: by their name, or where nothing is named by their even steps, which no counter has."""
    told, steps = column is None and bool(re.search(_TIME, _last(name))), np.diff(values)
    step = float(np.median(steps))
    if not told:
        counter = step == 1.0
        if counter or not (column is not None or name.isdecimal()) or np.abs(steps - step).max() > _EVEN * step:
            return None
    rates = {unit: 1 / (step * size) for unit, size in TIME_UNITS.items()}
    fits = {unit: rate for unit, rate in rates.items() if RATES[0] <= rate <= RATES[1]}
    said = [unit for unit, words in _WORDS.items() if re.search(rf"(^|[^a-zµμ])({words})($|[^a-z])", _last(name))]
    if name in variables.in_seconds or name.endswith(_IN_SECONDS):
        said = ["s"]
    if not fits:
        return None
    unit = next((unit for unit in said if unit in fits), max(fits, key=fits.__getitem__))
    return Time(name, column, unit, fits[unit], told and (unit in said or (len(fits) == 1 and not said)))


def stated_rate(variables: Variables) -> float | None:
    """A sampling rate that the file states [Hz]."""
    for name, value in variables.items():
        if value.ndim == 0 and re.search(_RATE, _last(name)) and value > 0:
            return float(value)
    return None


def _last(name: str) -> str:
    """The name without those of the structs or groups that it is in."""
    return re.split(r"[./](?=[^\W\d])", name.lower())[-1]
