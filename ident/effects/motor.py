"""What the motor's torque meets on its way: ripple, offset, wrong scale, lag, delay, another motor's train."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, final

import numpy as np

from ident.effects.base import Complex, Effect, Known, Law, Parameter, Path
from ident.effects.motion import State
from ident.errors import IdentError


@final
class TorqueRipple(Law):
    """Cogging and the ripple of the motor's field: amplitude sin(order theta + phase)."""

    name, port = "torque-ripple", "motor"
    parameters = (
        Parameter("amplitude", "Nm", -1.0, 1.0, (0.1, 0.03), linear=True, relative="torque"),
        Parameter("order", "1/rev", 1.0, 200.0, (1.0, 2.0, 4.0, 6.0, 8.0, 12.0, 24.0), zero=None, whole=True),
        Parameter("phase", "rad", -np.pi, np.pi, (0.0, np.pi / 2), zero=None),
    )

    def law(self, at: State) -> Any:
        amplitude, order, phase = self.values
        return amplitude * np.sin(order * at.theta + phase)


@final
class TorqueOffset(Law):
    """A constant torque: the current sensor's zero."""

    name, port = "torque-offset", "motor"
    parameters = (Parameter("offset", "Nm", -1.0, 1.0, (0.1,), linear=True, relative="torque"),)

    def law(self, at: State) -> Any:
        return self["offset"] + 0.0 * at.theta


@final
class TorqueScale(Effect):
    """The torque constant is off: the motor gives (1 + error) of what is commanded."""

    name, port = "torque-scale", "motor"
    parameters = (Parameter("error", "", -0.9, 10.0, (0.05, -0.05)),)

    def torque_gain(self, s: Complex, arm: Known) -> Complex:
        return self.at_joint(np.full(len(s), 1.0 + self["error"] + 0j), 1.0, len(arm.N))

    def path(self) -> Path:
        return Path(gain=1.0 + self["error"])


@final
class TorqueLag(Effect):
    """The current loop: a first-order lag."""

    name, port = "torque-lag", "motor"
    scope = ("joint", "arm")
    parameters = (Parameter("time", "s", 0.0, 0.05, (5e-4, 2e-3)),)

    def torque_gain(self, s: Complex, arm: Known) -> Complex:
        return self.at_joint(1.0 / (1.0 + s * self["time"]), 1.0, len(arm.N))

    def path(self) -> Path:
        return Path(lags=(self["time"],))


@final
class InputDelay(Effect):
    """The torque acts later than it is commanded: bus and controller."""

    name, port = "input-delay", "motor"
    scope = ("joint", "arm")
    parameters = (Parameter("time", "s", 0.0, 0.05, (5e-4, 2e-3)),)

    def torque_gain(self, s: Complex, arm: Known) -> Complex:
        return self.at_joint(np.exp(-s * self["time"]), 1.0, len(arm.N))

    def path(self) -> Path:
        return Path(delay=self["time"])


@final
class MotorCoupling(Effect):
    """Gear trains that share a wrist: the motor `step` joints further turns this joint, too, by `ratio` of its own joint's
    turn. The spring here is wound by theta/N + ratio theta'/N' - q, and loads both motors."""

    name, port, impedance_of = "motor-coupling", "motor", "K"
    parameters = (
        Parameter("ratio", "", -2.0, 2.0, (0.02, -0.02)),
        Parameter("step", "joints", 1.0, 6.0, (1.0, 2.0), zero=None, whole=True),
    )

    def unit_of(self, parameter: Parameter, slides: Callable[[int | None], bool]) -> str:
        assert self.joint is not None
        here, there = ("m" if slides(j) else "rad" for j in (self.joint, self.joint + round(self["step"])))
        return f"{here}/{there}" if parameter.name == "ratio" and here != there else self.unit(parameter, False)

    def other(self, n: int) -> int:
        """The joint (from 0) whose motor loads this one's. IdentError where the arm ends before."""
        assert self.joint is not None
        other = self.joint + round(self["step"])
        if other >= n:
            raise IdentError(
                f"effect {self.name}: step = {self['step']:g} from joint {self.joint + 1} of {n}; expected a joint that is there"
            )
        return other

    def impedance(self, s: Complex, arm: Known) -> Complex:
        n, i, r = len(arm.N), self.joint, self["ratio"]
        assert i is not None
        j = self.other(n)
        result = np.zeros((len(s), 2 * n, 2 * n), dtype=complex)
        for a, b, factor in ((i, j, r), (j, i, r), (j, j, r * r), (n + i, j, -r), (j, n + i, -r)):
            result[:, a, b] = factor * arm.K[i]
        return result

    def driven(self, states: Sequence[State], rest: Sequence[float]) -> tuple[tuple[str, int, float], ...]:
        i, r = self.joint, self["ratio"]
        assert i is not None
        j = self.other(len(states))
        here, there = states[i], states[j]
        more = r * (there.theta - rest[j]) / there.N
        return ("spring", i, here.K * more), ("motor", j, -r * here.K * (here.deflection + more) / there.N)
