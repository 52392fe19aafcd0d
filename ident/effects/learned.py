"""An effect that nobody named: a torque at a port as a curve of what the port does, its heights fitted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from ident.effects.base import Effect, Law, Parameter, State
from ident.effects.friction import direction

#: What a curve may be a function of; "friction" is one of position, against the motion.
VARIABLES = ("position", "velocity", "torque", "friction")


class Learned(Law):
    """A torque that follows a curve: straight between `knots` of a `variable` of the port, its heights the parameters."""

    name = "unknown"
    variable: ClassVar[str]
    knots: ClassVar[tuple[float, ...]]

    def law(self, at: State) -> Any:
        x, v = variable(at, self.port, self.variable)
        height = np.interp(x, self.knots, self.values)
        return -height * direction(v, at.N if self.port == "motor" else 1.0) if self.variable == "friction" else height


def variable(at: State, port: str, name: str) -> tuple[Any, Any]:
    """The variable of a curve at a port, and the port's velocity."""
    x, v = at.at(port)
    torque = at.spring / at.N if port == "motor" else at.spring
    return {"position": x, "velocity": v, "torque": torque, "friction": x}[name], v


def learned(port_name: str, variable_name: str, at: Sequence[float]) -> type[Effect]:
    """The kind of curve with knots `at` for a port: the units of its heights are the port's torque."""
    low, high = -1e3, 1e3
    heights = tuple(
        Parameter(f"height_{k + 1}", "Nm", low, high, (0.0,), linear=True, relative="torque") for k in range(len(at))
    )

    class Curve(Learned):
        port = port_name
        parameters = heights
        variable = variable_name
        knots = tuple(float(x) for x in at)

    return Curve
