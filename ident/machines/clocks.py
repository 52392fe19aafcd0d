"""The time that a foreign file tells, or its sampling rate: by names, and by numbers that grow evenly."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ident.machines.readers import Variables
from ident.machines.toml_table import RATES

_TIME = r"^t($|[^a-z])|time|stamp"
#: Units of time: s each, and how names say them (an MCAP file's clocks are in s).
_TIME_UNITS = {
    "s": (1.0, r"s|secs?|seconds?|/header/stamp|/log_time"),
    "ms": (1e-3, r"ms|msecs?|millis\w*"),
    "us": (1e-6, r"us|[µμ]s|usecs?|micros\w*"),
    "ns": (1e-9, r"ns|nsecs?|nanos\w*"),
}
_RATE = r"^(fs|f_s|fsamp\w*|sampl\w*rate\w*|rate_?hz)$"


@dataclass(frozen=True)
class Time:
    """The time of a file: its variable, its unit, the sampling rate [Hz]; not `sure` if another unit fits as well."""

    name: str
    unit: str
    rate: float
    sure: bool


def is_time(name: str) -> bool:
    """Whether the name is one that times have."""
    return bool(re.search(_TIME, name.lower()))


def time_of(name: str, step: float) -> Time | None:
    """The time of that step: in the unit its name says, else in the one of the highest rate that a machine may have."""
    rates = {unit: 1 / (step * size) for unit, (size, _) in _TIME_UNITS.items()}
    fits = {unit: rate for unit, rate in rates.items() if RATES[0] <= rate <= RATES[1]}
    named = [
        unit
        for unit, (_, words) in _TIME_UNITS.items()
        if re.search(rf"(^|[^a-zµμ]|(?=/))({words})($|[^a-z])", name.lower())
    ]
    if not fits:
        return None
    unit = next((unit for unit in named if unit in fits), max(fits, key=fits.__getitem__))
    return Time(name, unit, fits[unit], unit in named or (len(fits) == 1 and not named))


def stated_rate(variables: Variables) -> float | None:
    """A sampling rate that the file states [Hz]."""
    for name, value in variables.items():
        if value.ndim == 0 and re.search(_RATE, name.lower().split(".")[-1]) and value > 0:
            return float(value)
    return None
