"""What the sensors make of it."""

from __future__ import annotations

from math import sin
from typing import final

import numpy as np

from ident.effects.base import Array, Complex, Effect, Known, Parameter
from ident.effects.motion import Motion


@final
class JointZeroOffset(Effect):
    """The joint's zero is not where it reads zero: it really is at q + offset."""

    name, port = "joint-zero-offset", "sensor"
    parameters = (Parameter("offset", "rad", -np.pi, np.pi, (0.05, -0.05), sliding="m"),)

    def posture(self, q: Array) -> Array:
        assert self.joint is not None
        moved = np.array(q, dtype=float)
        moved[self.joint] += self["offset"]
        return moved


@final
class TimeOffset(Effect):
    """The recorded angle is `time` older than its time stamp, the torque is not: two devices, two clocks.

    The controller has its own reading, without it. Seen from outside an angle read late and a torque that acts late are one.
    """

    name, port = "time-offset", "sensor"
    scope = ("joint", "arm")
    parameters = (Parameter("time", "s", -0.05, 0.05, (5e-4, -5e-4)),)

    def angle_gain(self, s: Complex, arm: Known) -> Complex:
        return self.at_joint(np.exp(-s * self["time"]), 1.0, len(arm.N))

    def angle_delay(self) -> float:
        return self["time"]


@final
class EncoderEccentricity(Effect):
    """The disc's centre beside the shaft's: the reading is off by amplitude sin(order theta + phase), order 2 for a wobble."""

    name, port = "encoder-eccentricity", "sensor"
    parameters = (
        Parameter("amplitude", "rad", -0.05, 0.05, (0.005, 0.02), linear=True),
        Parameter("order", "1/rev", 1.0, 64.0, (1.0, 2.0), zero=None, whole=True),
        Parameter("phase", "rad", -np.pi, np.pi, (0.0, np.pi / 2), zero=None),
    )

    def reading(self, motion: Motion) -> Array:
        amplitude, order, phase = self.values
        assert self.joint is not None
        return np.asarray(amplitude * np.sin(order * motion.signal("theta", self.joint) + phase))

    def misread(self, theta: float) -> float:
        amplitude, order, phase = self.values
        return amplitude * sin(order * theta + phase)
