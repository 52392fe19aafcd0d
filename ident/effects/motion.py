"""How joints move in one record or at one instant: what a law is a function of.

Motor ports are motor side (angle theta [rad], torque [N m]), spring and link ports joint side: the spring's position is its
deflection theta/N - q, the link's is q.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from math import exp, tanh
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Speed [rad/s or m/s, joint side] at which dry friction has three quarters of its level.
CREEP = 5e-4
#: Times that from standstill, and times that apart: nearer, and periods that differ by more, a dry law is asked for each by itself.
NEAR, APART = 6.0, 0.1
#: The signals of a joint that moves: motor side, link side, its spring.
SIGNALS = ("theta", "omega", "tau", "q", "q_rate", "deflection", "deflection_rate", "spring")
#: Position, velocity and torque at a port.
AT = {
    "motor": ("theta", "omega", "tau"),
    "sensor": ("theta", "omega", "tau"),
    "spring": ("deflection", "deflection_rate", "spring"),
    "link": ("q", "q_rate", "spring"),
}


@dataclass(slots=True)
class State:
    """How one joint moves: arrays [S] of a period, or floats at one instant.

    theta [rad], omega, tau [N m] motor side; q, q_rate link side; deflection = theta/N - q, deflection_rate and spring (its torque)
    joint side. Positions are absolute, means included.
    """

    theta: Any
    omega: Any
    tau: Any
    q: Any
    q_rate: Any
    deflection: Any
    deflection_rate: Any
    spring: Any
    N: float
    K: float

    def at(self, port: str) -> tuple[Any, Any]:
        """Position and velocity at a port."""
        position, velocity, _ = AT[port]
        return getattr(self, position), getattr(self, velocity)

    def when(self, samples: Any) -> State:
        """The same at some of the samples."""
        return Told(lambda name: getattr(self, name)[samples], self.N, self.K)

    def moved(self, port: str, position: Any, velocity: Any) -> State:
        """The same but for position and velocity at a port."""
        other = Told(lambda name: getattr(self, name), self.N, self.K)
        for name, value in zip(AT[port][:2], (position, velocity), strict=True):
            setattr(other, name, value)
        return other


class Told(State):
    """A state of which each signal is told when it is first asked for: a law needs one or two of them."""

    __slots__ = ("tell",)

    def __init__(self, tell: Callable[[str], Any], N: float, K: float) -> None:
        self.tell, self.N, self.K = tell, N, K

    def __getattr__(self, name: str) -> Any:
        if name not in SIGNALS:
            raise AttributeError(name)
        setattr(self, name, self.tell(name))
        return getattr(self, name)


@dataclass(frozen=True, eq=False)
class Motion:
    """How all n joints move in one record: one period, samples `dt` [s] apart, gear ratios `N` and springs' stiffness `K` [n].

    `tell` gives a signal [S] by its name, as in `State`, and the joint; what cannot be known is zero (a clamped joint). `strays` gives
    how much faster [M, S] a port of a joint is in each of M periods; None where all are one. `means` are those of all links and deflections
    [n, rad]; None where nobody knows.
    """

    dt: float
    N: Array
    K: Array
    tell: Callable[[str, int], Array]
    strays: Callable[[str, int], Array | None] = lambda port, joint: None
    means: tuple[Array, Array] | None = None
    _told: dict[tuple[str, int], Array] = field(default_factory=dict)
    _astray: dict[tuple[str, int], Astray | None] = field(default_factory=dict)
    _made: dict[Hashable, Array] = field(default_factory=dict)

    def state(self, joint: int) -> State:
        """The motion of one joint."""
        return Told(lambda name: self.signal(name, joint), float(self.N[joint]), float(self.K[joint]))

    def signal(self, name: str, joint: int) -> Array:
        """One signal [S] of a joint."""
        if (name, joint) not in self._told:
            self._told[name, joint] = self.tell(name, joint)
        return self._told[name, joint]

    def astray(self, port: str, joint: int) -> Astray | None:
        """How the periods differ in the velocity of a motor or link; None where all are one."""
        if (port, joint) not in self._astray:
            faster = self.strays(port, joint)
            self._astray[port, joint] = None if faster is None else Astray.of(faster)
        return self._astray[port, joint]

    def made(self, what: Hashable, make: Callable[[], Array]) -> Array:
        """What is made of its signals, if that was not the last time: one thing is kept, as it may be large."""
        if what not in self._made:
            self._made.clear()
            self._made[what] = make()
        return self._made[what]

    def at(self, port: str, joint: int) -> tuple[Array, Array, Array]:
        """Position, velocity and torque [S] at a port of a joint."""
        position, velocity, torque = AT[port]
        return self.signal(position, joint), self.signal(velocity, joint), self.signal(torque, joint)

    def of(self, name: str, joints: Sequence[int] | NDArray[np.int64]) -> Array:
        """One signal of these joints [S, ..]."""
        return np.stack([self.signal(name, int(j)) for j in joints], axis=1)


def direction(rate: Any, N: float = 1.0, decades: float = 0.0) -> Any:
    """The smoothed sign of a velocity; a motor's with its gear ratio N. It creeps faster than `CREEP` by so many decades."""
    slides = rate / (CREEP * 10.0**decades * abs(N))
    return tanh(slides) if isinstance(slides, float) else np.tanh(slides)  # a million floats a simulation


def bell(x: Any) -> Any:
    """exp(-x^2)."""
    return exp(-x * x) if isinstance(x, float) else np.exp(-x * x)


@dataclass(frozen=True, eq=False)
class Astray:
    """How much faster than its velocity a motor or link is in each of M periods: on the `mean` [S], each from that `apart` [M, S], by
    `most` [S]."""

    mean: Array
    apart: Array
    most: Array

    @staticmethod
    def of(faster: Array) -> Astray:
        mean = faster.mean(axis=0)
        return Astray(mean, faster - mean, np.ptp(faster, axis=0))

    def when(self, samples: Any) -> Astray:
        """The same at some of the samples."""
        return Astray(self.mean[samples], self.apart.take(samples, axis=1), self.most[samples])


def over_periods(law: Callable[[State], Any], at: State, port: str, astray: Astray | None) -> Any:
    """The mean over the periods of a dry law of the velocity at a port, or of several [.., S], which in each is `astray` from that `at`
    hand.

    Away from standstill friction is nearly straight, and that of the mean velocity is it.
    """
    if astray is None:
        return law(at)
    position, velocity = at.at(port)
    velocity = velocity + astray.mean
    force = np.array(law(at.moved(port, position, velocity)))
    creep = CREEP * (abs(at.N) if port == "motor" else 1.0)
    near = np.flatnonzero((np.abs(velocity) < NEAR * creep + astray.most) & (astray.most > APART * creep))
    forces = law(at.when(near).moved(port, position[near], velocity[near] + astray.apart.take(near, axis=1)))
    periods = (*force.shape[:-1], len(astray.apart), len(near))
    force[..., near] = np.broadcast_to(forces, periods).mean(axis=-2)
    return force
