"""The gear as a spring that is not the declared one: stiffening, play, creep, teeth that are not where they should be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import exp
from typing import Any, final

import numpy as np

from ident.effects.base import Complex, Known, Law, Parameter, PortLaw
from ident.effects.impedance import at_spring
from ident.effects.motion import State


@final
class SpringHardening(Law):
    """A spring that stiffens (or, negative, softens) as it is wound: cubic x^3 besides K x."""

    name, port = "spring-hardening", "spring"
    parameters = (
        Parameter("cubic", "Nm/rad3", -1.0, 10.0, (0.3, -0.1), linear=True, relative="K/angle^2", sliding="N/m3"),
    )

    def law(self, at: State) -> Any:
        return self["cubic"] * at.deflection * at.deflection * at.deflection


@final
class Backlash(Law):
    """Play: no torque within +-gap/2 of zero deflection, K beyond."""

    name, port = "backlash", "spring"
    parameters = (Parameter("gap", "rad", 0.0, 5.0, (0.3, 0.1), relative="angle", sliding="m"),)

    def law(self, at: State) -> Any:
        half = self["gap"] / 2
        return -at.K * np.minimum(np.maximum(at.deflection, -half), half)


@final
class SpringRelaxation(PortLaw):
    """A spring that gives way while it is held wound, as rubber and flexsplines do: beside K another `stiffness` that is lost with
    `time` (a Maxwell branch: the standard linear solid of J.D. Ferry, Viscoelastic Properties of Polymers (1980), ch. 1)."""

    name, port, linear = "spring-relaxation", "spring", True
    parameters = (
        Parameter("stiffness", "Nm/rad", 0.0, 10.0, (0.1, 0.03), linear=True, relative="K", sliding="N/m"),
        Parameter("time", "s", 5e-4, 20.0, (0.003, 0.01, 0.03, 0.1, 0.3), zero=None),
    )

    def impedance(self, s: Complex, arm: Known) -> Complex:
        stiffness, time = self.values
        return at_spring(stiffness * s * time / (1.0 + s * time), self.joint, len(arm.N))

    def start(self, step: float) -> tuple[Callable[[State], float], Callable[[State], None]]:
        """Exact where the deflection moves evenly from where it was last remembered."""
        stiffness, time = self.values
        memory: list[float] = []  # deflection and torque where it was last asked to remember

        def torque(at: State, later: float) -> float:
            x, F = memory or (at.deflection, 0.0)
            kept = exp(-later / time)
            return kept * F + stiffness * (at.deflection - x) * (1.0 - kept) * time / later

        def remember(at: State) -> None:
            memory[:] = [at.deflection, torque(at, step)]

        return lambda at: torque(at, 0.5 * step), remember


@final
class TransmissionError(Law):
    """Teeth and wave generator off the pitch: the spring is wound by theta/N + amplitude sin(order theta + phase) - q.

    What it stores it gives back: besides the spring's torque, the slope of the error loads the motor.
    """

    name, port = "transmission-error", "spring"
    parameters = (
        Parameter("amplitude", "rad", -1.0, 1.0, (0.1, 0.03), linear=True, relative="angle", sliding="m"),
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
