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
#: own; "friction" is dry friction by position, "sliding" by velocity, "loaded" by the load, "driven" by the motor's own torque;
#: "damping" a damping by position, "gain" a share of the motor's torque; "stiffness" that of a spring by its motor's position.
VARIABLES = {
    "motor": ("position", "velocity", "torque", "drive", "friction", "sliding", "loaded", "driven", "damping", "gain"),
    "spring": ("position", "velocity", "stiffness"),
    "link": ("position", "velocity", "torque", "friction", "sliding", "loaded", "damping"),
}
#: What is against the motion, and may stop it.
RUBBING = ("friction", "sliding", "loaded", "driven")
#: Curves of a place, which may repeat themselves (a spring's position is none: its deflection).
OF_PLACES = ("position", "friction", "damping", "gain", "stiffness")
#: Unit of the heights, what they are relative to and their bounds where these are no torques: a spring stays one.
HEIGHTS = {
    "damping": ("Nms/rad", "torque/rate", -1e3, 1e3), "stiffness": ("Nm/rad", "K", -0.5, 2.0), "gain": ("", "", -0.9, 9.0),
}  # fmt: skip
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
        x = variable(at, self.port, self.variable)
        if self.period is None:
            height = np.interp(x, self.knots, self.values) + self._beyond(x)
        else:
            height = np.interp(np.mod(x, self.period), *_tabled(self.values, self.period))
        return height * factor(at, self.port, self.variable)

    def _beyond(self, x: Any) -> Any:
        """What the slopes at both ends add where x is beyond them."""
        if self.dry or of_place(self.port, self.variable):
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


def of_place(port: str, name: str) -> bool:
    """Whether a curve of this variable is one of where the port is."""
    return name in OF_PLACES and (port, name) != ("spring", "position")


def variable(at: State, port: str, name: str) -> Any:
    """The variable of a curve at a port."""
    x, v = at.at(port)
    if name in ("drive", "driven"):
        return at.tau
    if name in ("torque", "loaded"):
        return at.spring / at.N if port == "motor" else at.spring
    if name == "stiffness":
        return at.theta
    return v if name in ("velocity", "sliding") else x


def factor(at: State, port: str, name: str) -> Any:
    """What a curve of this variable is multiplied by."""
    x, v = at.at(port)
    if name in RUBBING:
        return -direction(v, at.N if port == "motor" else 1.0)
    return {"damping": -v, "gain": at.tau, "stiffness": x}.get(name, 1.0)


def learned(port_name: str, variable_name: str, at: Sequence[float], repeats: float | None = None) -> type[Learned]:
    """The kind of curve with knots `at` for a port, that `repeats` itself or not: its heights are torques at the port, or what makes them of a factor."""
    unit, relative, low, high = HEIGHTS.get(variable_name, ("Nm", "torque", -1e3, 1e3))
    if variable_name in RUBBING or (port_name, variable_name) == ("link", "damping"):
        low = 0.0  # it gives nothing back; a motor has a damping besides, to which its curve adds
    heights = tuple(
        Parameter(f"height_{k + 1}", unit, low, high, (0.0,), linear=True, relative=relative) for k in range(len(at))
    )

    class Curve(Learned):
        port = port_name
        parameters = heights
        variable = variable_name
        knots = tuple(float(x) for x in at)
        period = repeats
        dry = variable_name in RUBBING

    return Curve
