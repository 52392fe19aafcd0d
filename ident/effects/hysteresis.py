"""Presliding: before it slides a dry contact is a spring that forgets (P. Dahl, Aerospace Corp. TOR-0158 (1968))."""

from __future__ import annotations

from collections.abc import Callable
from math import exp
from typing import final

import numpy as np

from ident.effects.base import Array, Parameter, PortLaw
from ident.effects.motion import Motion, State


@final
class MotorHysteresis(PortLaw):
    """Dahl's friction on the motor: F' = (level / distance) (1 - F/level sign(omega)) omega.

    F depends on the path only: along a stretch of one direction it goes to +-level exponentially in `distance`, exactly.
    """

    name, port = "motor-hysteresis", "motor"
    parameters = (
        Parameter("level", "Nm", 0.0, 1.0, (0.1, 0.03), linear=True, relative="torque"),
        Parameter("distance", "rad", 0.005, 5.0, (0.1, 0.5), zero=None, relative="angle"),
    )

    def force(self, motion: Motion) -> Array:
        """Its torque [S] when the period goes on for ever: the recursion is affine, so its fixed point is known."""
        level, distance = self.values
        assert self.joint is not None
        theta = motion.signal("theta", self.joint)
        step = np.diff(theta, prepend=theta[-1])
        kept = np.exp(-np.abs(step) / distance)
        added = np.sign(step) * (1.0 - kept)
        values, left = _recursion(kept, added)
        start = values[-1] / (1.0 - left[-1]) if left[-1] < 1.0 else 0.0
        return np.asarray(-level * (values + left * start))

    def start(self) -> tuple[Callable[[State], float], Callable[[State], None]]:
        level, distance = self.values
        memory: list[float] = []  # angle and F / level where it was last asked to remember

        def friction(theta: float) -> float:
            before, F = memory or (theta, 0.0)
            kept = exp(-abs(theta - before) / distance)
            return kept * F + (1.0 - kept if theta > before else kept - 1.0)

        def remember(at: State) -> None:
            memory[:] = [at.theta, friction(at.theta)]

        return lambda at: -level * friction(at.theta), remember


def _recursion(a: Array, b: Array) -> tuple[Array, Array]:
    """F[k] = a[k] F[k-1] + b[k] from F = 0, and the product of a up to k: both [S]. Blocks of samples go side by side."""
    S, count = len(a), int(np.ceil(np.sqrt(len(a))))
    a, b = (np.pad(x, (0, count**2 - S)).reshape(count, count).T for x in (a, b))  # sample in its block, block
    F, product = np.empty_like(b), np.cumprod(a, axis=0)
    now = np.zeros(count)
    for k in range(count):
        F[k] = now = a[k] * now + b[k]
    begin = np.ones((2, count))  # F and the product at the end of the block before
    begin[0, 0] = 0.0
    for k in range(1, count):
        begin[:, k] = product[-1, k - 1] * begin[:, k - 1] + (F[-1, k - 1], 0.0)
    found = np.stack([F, np.zeros_like(F)]) + product * begin[:, None]
    values, products = found.transpose(0, 2, 1).reshape(2, -1)[:, :S]
    return values, products
