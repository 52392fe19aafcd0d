"""An effect that nobody named: a torque at a port as a curve of what the port does, or an encoder's error; its heights fitted.

A curve of a position may repeat itself: magnets, teeth and bent shafts come back every so much of a turn. A record swings
over a small part of that, but the records of a campaign rest at many places, and together they show a period.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from functools import cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from ident.effects.base import Array, Effect, Law, Parameter
from ident.effects.motion import AT, Motion, State, Told, direction


class Kind(NamedTuple):
    """What a curve is a function `of` and what it is multiplied by: `times`; units, reference and bounds of its heights, see
    `Parameter`. A `load` is a spring's torque, a `drive` the motor's own, a `turn` the motor's angle; `direction` is against the
    motion of a contact, `way` along the winding of a spring."""

    of: str
    times: str = ""
    unit: str = "Nm"
    relative: str = "torque"
    low: float = -1e3
    high: float = 1e3
    sliding: str = "N"

    @property
    def dry(self) -> bool:
        """Whether it is against the motion, and may stop it."""
        return self.times == "direction"

    @property
    def damps(self) -> bool:
        """Whether its heights are dampings."""
        return self.times == "velocity"

    @property
    def of_place(self) -> bool:
        """Whether it is one of a place: of a spring, of its deflection."""
        return self.of in ("position", "turn")


#: Kinds of curves by their variable. Friction gives nothing back, a spring stays one.
KINDS = {
    "position": Kind("position"),
    "velocity": Kind("velocity"),
    "torque": Kind("load"),
    "drive": Kind("drive"),
    "friction": Kind("position", "direction", low=0.0),
    "sliding": Kind("velocity", "direction", low=0.0),
    "loaded": Kind("load", "direction", low=0.0),
    "driven": Kind("drive", "direction", low=0.0),
    "damping": Kind("position", "velocity", "Nms/rad", "torque/rate", sliding="Ns/m"),
    "laden": Kind("load", "velocity", "Nms/rad", "torque/rate", sliding="Ns/m"),
    "driving": Kind("drive", "velocity", "Nms/rad", "torque/rate"),
    "structural": Kind("position", "way"),
    "gain": Kind("position", "drive", "", "", -0.9, 9.0, sliding=""),
    "passing": Kind("position", "load", "", "", -0.9, 9.0, sliding=""),
    "fading": Kind("velocity", "drive", "", "", -0.9, 9.0, sliding=""),
    "stiffness": Kind("turn", "position", "Nm/rad", "K", -0.5, 2.0, "N/m"),
    "mesh": Kind("turn"),
    "reading": Kind("position", "", "rad", "", -0.5, 0.5, sliding=""),
}
#: The variables of curves that have a stiffness or a damping in them.
LINEAR = ("position", "velocity", *(name for name, kind in KINDS.items() if kind.damps))
#: The variables at each port.
VARIABLES = {
    "motor": (
        "position", "velocity", "torque", "drive", "friction", "sliding", "loaded", "driven", "damping", "laden", "driving",
        "gain", "passing", "fading",
    ),
    "spring": ("position", "velocity", "damping", "structural", "stiffness", "mesh"),
    "link": ("position", "velocity", "torque", "friction", "sliding", "loaded", "damping", "laden"),
    "sensor": ("reading",),
}  # fmt: skip
#: Points at which a curve that repeats itself is tabled: straight lines between them are within 1e-3 of it.
TABLED = 512


class Unnamed(Effect):
    """What no name of the catalogue describes: a curve tells it in plain numbers."""

    name = "unknown"

    @abstractmethod
    def curve(self, slides: bool = False) -> dict[str, Any]:
        """What it is at `knots` of its `variable`, where its joint `slides`, or turns; `at` is the knot of every parameter that is a height."""


class Learned(Unnamed):
    """A curve of a `variable`, whose heights at `knots` are its parameters; with a `period` it repeats itself."""

    variable: ClassVar[str]
    knots: ClassVar[tuple[float, ...]]
    period: ClassVar[float | None] = None
    smooth: ClassVar[bool] = False

    def curve(self, slides: bool = False) -> dict[str, Any]:
        """The curve in plain numbers, where its joint `slides`, or turns; `at` is the knot of every parameter."""
        of_turn = self.variable in KINDS and KINDS[self.variable].of == "turn"
        return {
            "variable": self.variable, "knots": list(self.knots), "period": self.period, "heights": list(self.values),
            "unit": self.unit(self.parameters[0], slides), "at": list(self.knots), "smooth": self.smooth,
            "period_unit": "m" if slides and self.port not in ("motor", "sensor") and not of_turn else "rad",
        }  # fmt: skip


class LearnedCurve(Learned):
    """A curve of what its port does: straight between its knots, or `smooth`, the cubic spline through them.

    Beyond its ends a curve goes on as steeply, so that it does not matter what of a slope is told by a damping or a stiffness
    besides; one of a place, of which nothing is known where nobody was, stays as high.
    With a `period` the curve repeats itself, knots are one period's, evenly spread, and the curve is the smoothest one through
    them: their Fourier series.
    """

    def height(self, x: Any) -> Any:
        """The curve where its variable is x."""
        if self.smooth:
            return self._spline(x)
        if self.period is None:
            return np.interp(x, self.knots, self.values) + self._beyond(x)
        return np.interp(np.mod(x, self.period), *_tabled(self.values, self.period))

    def parts(self, x: Array) -> Array:
        """What a unit of each of its heights is where its variable is x [.., S]: [K, .., S]."""
        knots = np.asarray(self.knots)
        count, last = len(knots), len(knots) - 2
        if self.smooth or count < 2:
            return np.stack(
                [np.broadcast_to(self.with_values(unit).height(x), np.shape(x)) for unit in np.eye(count).tolist()]
            )
        if self.period is not None:
            place = np.mod(x, self.period) * (TABLED / self.period)
            left, table = np.minimum(place.astype(int), TABLED - 1), _series(count).T
            return np.asarray(table[:, left] + (place - left) * (table[:, left + 1] - table[:, left]))
        left = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, last)
        share = (x - knots[left]) / np.diff(knots)[left]
        if self.dry or of_place(self.port, self.variable):
            share = np.clip(share, 0.0, 1.0)
        found = np.zeros((count, np.size(x)))
        every = np.arange(np.size(x))
        found[left.ravel(), every], found[left.ravel() + 1, every] = 1.0 - share.ravel(), share.ravel()
        return found.reshape(count, *np.shape(x))

    @abstractmethod
    def each(self, motion: Motion) -> Array:
        """What a unit of each of its heights makes over a period [K, S]."""

    def _spline(self, x: Any) -> Any:
        """The spline through the knots, that goes on as steeply beyond them, or stays as high."""
        spline = CubicSpline(self.knots, self.values)
        inside = np.clip(x, self.knots[0], self.knots[-1])
        if of_place(self.port, self.variable):
            return spline(inside)
        first, last = spline(self.knots[0], 1), spline(self.knots[-1], 1)
        return spline(inside) + first * np.minimum(x - self.knots[0], 0.0) + last * np.maximum(x - self.knots[-1], 0.0)

    def _beyond(self, x: Any) -> Any:
        """What the slopes at both ends add where x is beyond them."""
        if self.dry or of_place(self.port, self.variable):
            return 0.0
        first, last = (np.diff(self.values)[[0, -1]] / np.diff(self.knots)[[0, -1]]).tolist()
        return first * np.minimum(x - self.knots[0], 0.0) + last * np.maximum(x - self.knots[-1], 0.0)


class LearnedLaw(LearnedCurve, Law):
    """A torque that follows a curve of what the port does."""

    def law(self, at: State) -> Any:
        return self.height(variable(at, self.port, self.variable)) * factor(at, self.port, self.variable)

    def each(self, motion: Motion) -> Array:
        def laws(at: State) -> Array:
            x, times = variable(at, self.port, self.variable), factor(at, self.port, self.variable)
            periods = (1,) * max(np.ndim(times) - np.ndim(x), 0)
            return np.asarray(self.parts(x).reshape(len(self.knots), *periods, *np.shape(x)) * times)

        return np.asarray(self.over_periods(laws, motion))


class LearnedReading(LearnedCurve):
    """An error of an encoder that is a curve of where its motor is."""

    def reading(self, motion: Motion) -> Array:
        assert self.joint is not None
        return np.asarray(self.height(motion.signal("theta", self.joint)))

    def each(self, motion: Motion) -> Array:
        assert self.joint is not None
        return self.parts(motion.signal("theta", self.joint))

    def misread(self, theta: float) -> float:
        return float(self.height(theta))


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
    """Whether a curve of this variable may repeat itself: one of a deflection does not."""
    return KINDS[name].of == "turn" or (KINDS[name].of == "position" and port != "spring")


def variable(at: State, port: str, name: str) -> Any:
    """The variable of a curve at a port."""
    x, v = at.at(port)
    match KINDS[name].of:
        case "position":
            return x
        case "velocity":
            return v
        case "load":
            return at.spring / at.N if port == "motor" else at.spring
        case "drive":
            return at.tau
        case _:
            return at.theta


def factor(at: State, port: str, name: str) -> Any:
    """What a curve of this variable is multiplied by."""
    x, v = at.at(port)
    match KINDS[name].times:
        case "direction":
            return -direction(v, at.N if port == "motor" else 1.0)
        case "velocity":
            return v if port == "spring" else -v  # a spring's torque is that on the link
        case "way":
            return direction(v)
        case "drive":
            return at.tau
        case "load":
            return at.spring / at.N if port == "motor" else at.spring
        case "position":
            return x
        case _:
            return 1.0


def as_damping(curve: Learned) -> Array:
    """Heights with which a curve at a motor or a spring, of a velocity or with which that is multiplied, is a damping of one."""
    kind, knots = KINDS[curve.variable], np.asarray(curve.knots)
    if kind.damps:
        return np.ones(len(knots))
    if kind.dry:
        return np.abs(knots)
    return knots if curve.port == "spring" else -knots


def at_knots(curve: LearnedLaw, law: Law, N: float, K: float) -> Array | None:
    """What another law of its port and joint, with gear ratio `N` and stiffness `K`, gives at the knots of a curve; None where that
    follows from anything else than the curve's variable, or the curve is one that is multiplied or repeats itself."""
    kind, knots = KINDS[curve.variable], np.asarray(curve.knots)
    if kind.times or curve.period is not None:
        return None
    position, velocity, _ = AT[curve.port]
    asked = {"position": position, "velocity": velocity, "load": "spring", "drive": "tau", "turn": "theta"}[kind.of]
    known = N * knots if (curve.port, kind.of) == ("motor", "load") else knots  # that is told motor side
    nothing = np.full(len(knots), np.nan)
    force = np.asarray(law.law(Told(lambda name: known if name == asked else nothing, N, K)))
    return force if force.shape == knots.shape and np.isfinite(force).all() else None


def bent(curve: Effect) -> Effect | None:
    """The same curve, but smooth: none for one that is, or is dry, or has too few knots."""
    if not isinstance(curve, LearnedCurve) or curve.dry or curve.smooth:
        return None
    if curve.period is not None or len(curve.knots) < 4:
        return None
    return learned(curve.port, curve.variable, curve.knots, bends=True)(curve.joint, curve.values)


def learned(
    port_name: str, variable_name: str, at: Sequence[float], repeats: float | None = None, *, bends: bool = False
) -> type[LearnedCurve]:
    """The kind of curve with knots `at` for a port, that `repeats` itself or not, and `bends` between its knots or is straight: its
    heights are torques at the port, or what makes torques of what it is multiplied by."""
    kind = KINDS[variable_name]
    only_lost = port_name == "link" and kind.damps  # motors and springs have a damping besides, to which it adds
    low = 0.0 if only_lost else kind.low
    heights = tuple(
        Parameter(
            f"height_{k + 1}",
            kind.unit,
            low,
            kind.high,
            (0.0,),
            linear=True,
            relative=kind.relative,
            sliding=kind.sliding,
        )
        for k in range(len(at))
    )

    class Curve(LearnedReading if port_name == "sensor" else LearnedLaw):  # type: ignore[misc]
        port = port_name
        parameters = heights
        variable = variable_name
        knots = tuple(float(x) for x in at)
        period = repeats
        smooth = bends
        dry = kind.dry
        by_load = kind.of == "load"

    return Curve
