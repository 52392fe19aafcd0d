"""An effect that nobody named: a torque at a port as a curve of what the port does, its heights fitted.

A curve of a position may repeat itself: magnets, teeth and bent shafts come back every so much of a turn. A record swings
over a small part of that, but the records of a campaign rest at many places, and together they show a period.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, ClassVar

import numpy as np

from ident.effects.base import Array, Law, Parameter
from ident.effects.motion import State, direction

#: What a curve may be a function of at each port: "torque" is that of the load (a spring's is its deflection), "drive" the motor's
#: own; "friction" is dry friction by position, "sliding" by velocity.
VARIABLES = {
    "motor": ("position", "velocity", "torque", "drive", "friction", "sliding"),
    "spring": ("position", "velocity"),
    "link": ("position", "velocity", "torque", "friction", "sliding"),
}
#: What is against the motion, and may stop it.
RUBBING = ("friction", "sliding")
#: Points at which a curve that repeats itself is tabled: straight lines between them are within 1e-3 of it.
TABLED = 512


class Learned(Law):
    """A torque that follows a curve of a `variable` of the port, its heights at `knots` the parameters: straight between them.

    Beyond its ends a curve goes on as steeply, so that it does not matter what of a slope is told by a damping or a stiffness
    besides; one of a place, of which nothing is known where nobody was, stays as high.
    With a `period` the curve repeats itself, knots are one period's, evenly spread, and the curve is the smoothest one through
    them: their Fourier series.
    """

    name = "unknown"
    variable: ClassVar[str]
    knots: ClassVar[tuple[float, ...]]
    period: ClassVar[float | None]

    def law(self, at: State) -> Any:
        x, v = variable(at, self.port, self.variable)
        if self.period is None:
            height = np.interp(x, self.knots, self.values) + self._beyond(x)
        else:
            height = np.interp(np.mod(x, self.period), *_tabled(self.values, self.period))
        return -height * direction(v, at.N if self.port == "motor" else 1.0) if self.dry else height

    def _beyond(self, x: Any) -> Any:
        """What the slopes at both ends add where x is beyond them."""
        if self.dry or (self.variable == "position" and self.port != "spring"):
            return 0.0
        first, last = (np.diff(self.values)[[0, -1]] / np.diff(self.knots)[[0, -1]]).tolist()
        return first * np.minimum(x - self.knots[0], 0.0) + last * np.maximum(x - self.knots[-1], 0.0)


@cache
def _series(count: int) -> Array:
    """What every one of an odd `count` of heights, evenly spread over a period, does to the points of the table [T + 1, count]."""
    x = 2.0 * np.pi * (np.arange(TABLED + 1)[:, None] / TABLED - np.arange(count) / count)
    orders = np.arange(1, count // 2 + 1)
    return np.asarray((1.0 + 2.0 * np.cos(x[..., None] * orders).sum(axis=-1)) / count)


def _tabled(heights: Sequence[float], period: float) -> tuple[Array, Array]:
    """Positions and heights of a curve that repeats itself."""
    return np.linspace(0.0, period, TABLED + 1), _series(len(heights)) @ np.asarray(heights)


def variable(at: State, port: str, name: str) -> tuple[Any, Any]:
    """The variable of a curve at a port, and the port's velocity."""
    x, v = at.at(port)
    if name == "drive":
        return at.tau, v
    if name == "torque":
        return (at.spring / at.N if port == "motor" else at.spring), v
    return (v if name in ("velocity", "sliding") else x), v


def learned(port_name: str, variable_name: str, at: Sequence[float], repeats: float | None = None) -> type[Learned]:
    """The kind of curve with knots `at` for a port, that `repeats` itself or not: the units of its heights are the port's torque."""
    low, high = 0.0 if variable_name in RUBBING else -1e3, 1e3  # friction gives nothing back
    heights = tuple(
        Parameter(f"height_{k + 1}", "Nm", low, high, (0.0,), linear=True, relative="torque") for k in range(len(at))
    )

    class Curve(Learned):
        port = port_name
        parameters = heights
        variable = variable_name
        knots = tuple(float(x) for x in at)
        period = repeats
        dry = variable_name in RUBBING

    return Curve
