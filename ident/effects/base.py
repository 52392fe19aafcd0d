"""What an effect is: its parameters, what it does to the fitted arm, what it does to the simulated one.

An effect acts at a port of a joint. Motor ports are motor side (angle theta [rad], torque [N m]), spring and link ports
joint side: the spring's position is its deflection theta/N - q, the link's is q. A method an effect does not need keeps
its default, which changes nothing; so effects combine.
"""

from __future__ import annotations

from abc import ABC
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from ident.errors import IdentError

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PORTS = ("motor", "spring", "link", "sensor", "structure")


@dataclass(frozen=True)
class Parameter:
    """A number an effect has: `unit`, bounds `low` < `high`, and `sizes`, plausible values from which a search starts.

    `linear`: the effect's force is proportional to it. `zero`: its value where the effect vanishes, None for a shape
    parameter (a frequency, a phase), which has none. `relative` names what `low`, `high` and `sizes` are shares of
    ("torque": rms torque of the port, "angle": rms angle, "rate", "K", "J", ""): a size fits a watch and a crane then.
    """

    name: str
    unit: str
    low: float
    high: float
    sizes: tuple[float, ...]
    linear: bool = False
    zero: float | None = 0.0
    relative: str = ""


@dataclass(frozen=True, eq=False)
class Motion:
    """How all n joints move in one record: one period, S samples `dt` [s] apart; positions are absolute, means included.

    theta, omega, tau [S, n] motor side; q, q_rate [S, n] link side; deflection = theta/N - q, deflection_rate and spring
    (its torque) [S, n] joint side. N [n]. An array that cannot be known is zero (a clamped joint).
    """

    dt: float
    N: Array
    theta: Array
    omega: Array
    tau: Array
    q: Array
    q_rate: Array
    deflection: Array
    deflection_rate: Array
    spring: Array

    def at(self, port: str, joint: int) -> tuple[Array, Array, Array]:
        """Position, velocity and torque [S] at a port of a joint."""
        if port == "spring":
            return self.deflection[:, joint], self.deflection_rate[:, joint], self.spring[:, joint]
        if port == "link":
            return self.q[:, joint], self.q_rate[:, joint], self.spring[:, joint]
        return self.theta[:, joint], self.omega[:, joint], self.tau[:, joint]


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of the arm where an effect is put: n joints, `N`, `K`, `J_m`, `D`, `D_spring` [n], J [n, n] at the record's
    `posture` [n], and `fs` [Hz]. `base_inertia` [6, n + 6]: rows of the six base motions, (coupling to q, base itself)."""

    N: Array
    K: Array
    J_m: Array
    D: Array
    D_spring: Array
    J: Array
    posture: Array
    fs: float
    base_inertia: Array | None = None


@dataclass(frozen=True)
class Effect(ABC):
    """One effect at one joint (`joint` from 0; None: the whole arm) with its parameter `values` in the order of `parameters`."""

    name: ClassVar[str]
    port: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    #: Whether it belongs to a joint, to the whole arm, or may be either.
    scope: ClassVar[tuple[str, ...]] = ("joint",)

    joint: int | None
    values: tuple[float, ...]

    @classmethod
    def of(cls, joint: int | None, given: Mapping[str, float]) -> Self:
        """The effect with the `given` parameters, the first plausible size for the others. IdentError: an unknown one, out of bounds."""
        known = {p.name: p for p in cls.parameters}
        for name, value in given.items():
            if name not in known:
                raise IdentError(f"effect {cls.name}: unknown parameter {name!r}; expected {', '.join(known)}")
            p = known[name]
            if not (np.isfinite(value) and (p.relative or p.low <= value <= p.high)):
                raise IdentError(f"effect {cls.name}: {name} = {value:g}; expected {p.low:g} to {p.high:g} {p.unit}")
        return cls(joint, tuple(float(given.get(p.name, p.sizes[0])) for p in cls.parameters))

    def with_values(self, values: Sequence[float]) -> Self:
        return replace(self, values=tuple(float(v) for v in values))

    def __getitem__(self, parameter: str) -> float:
        return self.values[[p.name for p in self.parameters].index(parameter)]

    # What it does to the fitted arm -----------------------------------------------------------------------------------

    def force(self, motion: Motion) -> Array | None:
        """Its torque [S] at its port: on the motor (motor side), on the link (joint side), or added to the spring's."""
        return None

    def impedance(self, s: Complex, arm: Known) -> Complex | None:
        """What it adds to the dynamic stiffness [S, 2n, 2n] of (theta/N, q), joint side, at s [S]."""
        return None

    def torque_gain(self, s: Complex, arm: Known) -> Complex | None:
        """The factor [S, n] on the commanded torques."""
        return None

    def angle_gain(self, s: Complex, arm: Known) -> Complex | None:
        """The factor [S, n] on the measured motor angles."""
        return None

    def reading(self, motion: Motion) -> Array | None:
        """The error [S] that it adds to the measured angle theta of its joint, rad motor side."""
        return None

    def posture(self, q: Array) -> Array:
        """The posture [n] at which the arm really is when it reads q [n]."""
        return q
