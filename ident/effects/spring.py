"""The gear as a spring that is not linear: stiffening, play, teeth that are not where they should be."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from ident.effects.base import Law, Parameter
from ident.effects.motion import State


@final
class SpringHardening(Law):
    """A spring that stiffens (or, negative, softens) as it is wound: cubic x^3 besides K x."""

    name, port = "spring-hardening", "spring"
    parameters = (Parameter("cubic", "Nm/rad3", -1.0, 10.0, (0.3, -0.1), linear=True, relative="K/angle^2"),)

    def law(self, at: State) -> Any:
        return self["cubic"] * at.deflection * at.deflection * at.deflection


@final
class Backlash(Law):
    """Play: no torque within +-gap/2 of zero deflection, K beyond."""

    name, port = "backlash", "spring"
    parameters = (Parameter("gap", "rad", 0.0, 5.0, (0.3, 0.1), relative="angle"),)

    def law(self, at: State) -> Any:
        half = self["gap"] / 2
        return -at.K * np.minimum(np.maximum(at.deflection, -half), half)


@final
class TransmissionError(Law):
    """Teeth and wave generator off the pitch: the spring is wound by theta/N + amplitude sin(order theta + phase) - q.

    What it stores it gives back: besides the spring's torque, the slope of the error loads the motor.
    """

    name, port = "transmission-error", "spring"
    parameters = (
        Parameter("amplitude", "rad", -1.0, 1.0, (0.1, 0.03), linear=True, relative="angle"),
        Parameter("order", "1/rev", 1.0, 200.0, (1.0, 2.0, 4.0), zero=None, whole=True),
        Parameter("phase", "rad", -np.pi, np.pi, (0.0, np.pi / 2), zero=None),
    )

    def law(self, at: State) -> Any:
        amplitude, order, phase = self.values
        return at.K * amplitude * np.sin(order * at.theta + phase)

    def loads(self, states: Sequence[State]) -> tuple[tuple[str, int, Any], ...]:
        amplitude, order, phase = self.values
        assert self.joint is not None
        at = states[self.joint]
        wound = at.deflection + amplitude * np.sin(order * at.theta + phase)
        return (("motor", self.joint, -at.K * wound * amplitude * order * np.cos(order * at.theta + phase)),)
