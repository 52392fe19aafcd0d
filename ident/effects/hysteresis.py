"""Presliding: before it slides a dry contact is a spring that forgets (P. Dahl, Aerospace Corp. TOR-0158 (1968)). So is a
harmonic drive that is wound (H.D. Taghirad, P.R. Belanger, Proc. 35th Conf. Decision and Control (1996))."""

from __future__ import annotations

from collections.abc import Callable
from math import exp
from typing import ClassVar, final

import numpy as np
from scipy.linalg.lapack import dtbtrs

from ident.effects.base import Array, Parameter, PeriodicLaw
from ident.effects.motion import State


class Hysteresis(PeriodicLaw):
    """Dahl's friction F of a position x: F' = (level / distance) (1 - F/level sign(x')) x'.

    F depends on the path only: along a stretch of one direction it goes to +-level exponentially in `distance`, exactly.
    """

    #: It is against the motion of a motor, adds to the torque of a spring.
    sign: ClassVar[float]
    parameters = (
        Parameter("level", "Nm", 0.0, 1.0, (0.1, 0.03), linear=True, relative="torque", sliding="N"),
        Parameter("distance", "rad", 0.005, 5.0, (0.1, 0.5), zero=None, relative="angle", sliding="m"),
    )

    def over_period(self, at: State) -> Array:
        """The recursion is affine, so its fixed point is known."""
        level, distance = self.values
        x = at.at(self.port)[0]
        step = np.diff(x, prepend=x[-1])
        kept = np.exp(-np.abs(step) / distance)
        added = np.sign(step) * (1.0 - kept)
        values, left = recursion(kept, added)
        start = values[-1] / (1.0 - left[-1]) if left[-1] < 1.0 else 0.0
        return np.asarray(self.sign * level * (values + left * start))

    def start(self, step: float) -> tuple[Callable[[State], float], Callable[[State], None]]:
        level, distance = self.values
        memory: list[float] = []  # position and F / level where it was last asked to remember

        def friction(x: float) -> float:
            before, F = memory or (x, 0.0)
            kept = exp(-abs(x - before) / distance)
            return kept * F + (1.0 - kept if x > before else kept - 1.0)

        def remember(at: State) -> None:
            x = at.at(self.port)[0]
            memory[:] = [x, friction(x)]

        return lambda at: self.sign * level * friction(at.at(self.port)[0]), remember


@final
class MotorHysteresis(Hysteresis):
    """Dahl's friction on the motor."""

    name, port, sign = "motor-hysteresis", "motor", -1.0


@final
class SpringHysteresis(Hysteresis):
    """Dahl's friction between the ends of the spring: its torque lags behind its winding."""

    name, port, sign = "spring-hysteresis", "spring", 1.0


@final
class LinkHysteresis(Hysteresis):
    """Dahl's friction of the output bearing and its seals."""

    name, port, sign = "link-hysteresis", "link", -1.0


def recursion(a: Array, b: Array) -> tuple[Array, Array]:
    """F[k] = a[k] F[k-1] + b[k] from F = 0, and the product of a up to k: both [S]."""
    bands = np.ones((2, len(a)))
    bands[1, :-1] = -a[1:]
    return np.asarray(dtbtrs(bands, b[:, None], uplo="L", diag="U")[0][:, 0]), np.asarray(np.cumprod(a))
