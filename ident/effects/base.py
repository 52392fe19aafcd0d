"""What an effect is: its parameters, what it does to the fitted arm, what it does to the simulated one.

An effect acts at a port of a joint. Motor ports are motor side (angle theta [rad], torque [N m]), spring and link ports
joint side: the spring's position is its deflection theta/N - q, the link's is q. A method an effect does not need keeps
its default, which changes nothing; so effects combine. A law of the state of one joint (`Law`) is one function for both
sides: of arrays in the fit, of floats in the simulation.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ident.effects.motion import Motion, State, over_periods
from ident.errors import IdentError
from symgen.chain import Chain
from symgen.robot import Drive

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PORTS = ("motor", "spring", "link", "sensor", "structure")


@dataclass(frozen=True)
class Parameter:
    """A number an effect has: `unit`, bounds `low` < `high`, and `sizes`, plausible values from which a search starts.

    `linear`: the effect's force is proportional to it. `zero`: its value where the effect vanishes, None for a shape
    parameter (a frequency, a phase), which has none. `relative` names what `low`, `high` and `sizes` are shares of, see
    `scale`: a size fits a watch and a crane then. A `whole` number is one of `sizes`, or another, and never refined. What
    is `declared` is a number that the fitted arm has of its own: it is told by that, the effect's stays where it vanishes.
    What is `aside` is nobody's parameter: it is fitted with the effect and not told; it is about zero, give or take 1.
    `sliding` is its unit beyond the gear of a joint that slides, where that is another one.
    """

    name: str
    unit: str
    low: float
    high: float
    sizes: tuple[float, ...]
    linear: bool = False
    zero: float | None = 0.0
    relative: str = ""
    whole: bool = False
    declared: bool = False
    aside: bool = False
    sliding: str = ""


#: What a parameter may be relative to, at the effect's port and joint: rms "torque", "angle" and "rate", the spring's "K",
#: the inertia "J" (motor's J_m or link's J_ii), its "damping" (D or D_spring), the link's "mass".
SCALES = ("torque", "angle", "rate", "K", "J", "damping", "mass")


def scale(relative: str, scales: Mapping[str, float]) -> float:
    """Returns the unit of a relative parameter: "torque", "torque/rate^2", with `scales` [one number for each name]."""
    product = 1.0
    for k, factor in enumerate(relative.split("/") if relative else ()):
        name, _, power = factor.partition("^")
        product *= scales[name] ** (int(power or 1) * (-1 if k else 1))
    return product


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of the arm where an effect is put: n joints, `N`, `K` [n], J [n, n] at the record's `posture` [n]; rows of J of joints
    that are clamped, motor and link, are zero. `chain` the declared links: where the structure of the arm gives, geometry says who feels
    it. `gravity` [3, m/s2, base axes]. `beside` are other effects that give
    there."""

    N: Array
    K: Array
    J: Array
    posture: Array
    chain: Chain
    gravity: Array
    beside: tuple[Effect, ...] = ()


@dataclass(frozen=True, eq=False)
class Swing:
    """How all joints move about their posture in one period: positions `q`, velocities `v`, accelerations `a` [S, n];
    `at_lines` gives the amplitudes [L, ..] of signals [S, ..], `in_time` signals of amplitudes."""

    q: Array
    v: Array
    a: Array
    at_lines: Callable[[Array], Complex]
    in_time: Callable[[Complex], Array]


@dataclass(frozen=True, eq=False)
class Arm:
    """The numbers of a simulated arm: links, drives [n] in the order of its joints, gravity [3, m/s2]."""

    chain: Chain
    drives: tuple[Drive, ...]
    gravity: Array


class Body(Protocol):
    """The simulated bodies of an arm, as far as an effect may change them; joints from 0, SI units, axes in link frames.

    Every addition is a joint on a spring `stiffness` with `damping`, at rest where the arm rests.
    """

    chain: Chain

    def rock(self, stiffness: Sequence[float], damping: Sequence[float], inertia: Sequence[float]) -> None:
        """Puts the arm on a base that turns about its x, y, z axes, each with its stiffness, damping, own inertia."""

    def split(self, link: int, share: float, axis: Sequence[float], stiffness: float, damping: float) -> None:
        """Lets a `share` of a link's body, and all that it carries, turn about an axis through its joint's origin."""

    def attach_disc(self, link: int, inertia: float, axis: Sequence[float], stiffness: float, damping: float) -> None:
        """Adds a disc to a link that turns about an axis; its moment of inertia is all that it adds."""

    def loosen(self, joint: int, stiffness: float, damping: float) -> None:
        """Puts the link of a joint that the lock has frozen on its spring."""


@dataclass(frozen=True)
class Path:
    """From commanded to acting torque: times `gain`, through first-order lags `lags` [s], `delay` [s] later."""

    gain: float = 1.0
    lags: tuple[float, ...] = ()
    delay: float = 0.0

    def then(self, other: Path) -> Path:
        return Path(self.gain * other.gain, self.lags + other.lags, self.delay + other.delay)

    @property
    def remembers(self) -> bool:
        """Whether what acts depends on what was commanded before."""
        return self.delay > 0.0 or any(lag > 0.0 for lag in self.lags)


@dataclass(frozen=True)
class Effect(ABC):
    """One effect at one joint (`joint` from 0; None: the whole arm) with its parameter `values` in the order of `parameters`."""

    name: ClassVar[str]
    port: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    #: Whether it belongs to a joint, to the whole arm, or may be either.
    scope: ClassVar[tuple[str, ...]] = ("joint",)
    #: It changes numbers that the declared model has anyway: no hook of the fitted arm is needed.
    declared: ClassVar[bool] = False
    #: It is a force against the velocity at its motor or link that may stop it: of that velocity it is found together with it.
    dry: ClassVar[bool] = False
    #: It is against that velocity, too, and nothing at rest.
    drags: ClassVar[bool] = False
    #: It depends on the load of its joint, which it changes itself.
    by_load: ClassVar[bool] = False
    #: What of its joint its impedance depends on: "K", or "J", the row of J.
    impedance_of: ClassVar[str] = ""
    #: It carries links, whose inertia is that of the declared ones: what it is depends on them.
    carries: ClassVar[bool] = False
    #: What gives turns, whatever its joint does: its stiffness is a turning one at a slide, too.
    turns: ClassVar[bool] = False
    #: Whether a simulation can have it, or not have it.
    injectable: ClassVar[bool] = True

    #: Where each parameter stands, by its name.
    _places: ClassVar[Mapping[str, int]] = {}

    joint: int | None
    values: tuple[float, ...]

    @classmethod
    def of(cls, joint: int | None, given: Mapping[str, float]) -> Self:
        """The effect with the `given` parameters, the first plausible size for the others. IdentError: an unknown one, out of bounds."""
        known = {p.name: p for p in cls.parameters}
        for name, value in given.items():
            if name not in known:
                raise IdentError(
                    f"effect {cls.name}: unknown parameter {name!r}; expected {', '.join(known) or 'none'}"
                )
            p = known[name]
            low, high = (p.low, p.high) if not p.relative else (-np.inf if p.low < 0 else 0.0, np.inf)
            if not (np.isfinite(value) and low <= value <= high):
                raise IdentError(
                    f"effect {cls.name}: {name} = {value:g}; expected {low:g} to {high:g} {p.unit}".rstrip()
                )
            if p.relative and p.zero is None and p.low > 0 and not value > 0.0:  # a share of what is positive
                raise IdentError(f"effect {cls.name}: {name} = {value:g}; expected more than 0 {p.unit}".rstrip())
            if p.whole and value != round(value):
                raise IdentError(f"effect {cls.name}: {name} = {value:g}; expected a whole number")
        return cls(joint, tuple(float(given.get(p.name, p.sizes[0])) for p in cls.parameters))

    @property
    def numbers(self) -> int:
        """How many numbers it is told by."""
        return sum(not p.aside for p in self.parameters)

    @classmethod
    def unit(cls, parameter: Parameter, slides: bool) -> str:
        """The unit of a parameter where the effect's joint slides, or turns; a motor turns whatever its joint does."""
        there = slides and cls.port != "motor"
        return (parameter.sliding if there else "") or parameter.unit

    def unit_of(self, parameter: Parameter, slides: Callable[[int | None], bool]) -> str:
        """The same in an arm of which `slides` says which joints do."""
        return self.unit(parameter, slides(self.joint))

    def with_values(self, values: Sequence[float]) -> Self:
        return replace(self, values=tuple(float(v) for v in values))

    def with_value(self, k: int, value: float) -> Self:
        """The same effect but for its k-th value."""
        return self.with_values([value if i == k else v for i, v in enumerate(self.values)])

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls._places = {p.name: k for k, p in enumerate(getattr(cls, "parameters", ()))}

    def __getitem__(self, parameter: str) -> float:
        return self.values[self._places[parameter]]

    def at_joint(self, values: Any, elsewhere: Any, n: int) -> NDArray[Any]:
        """[.., n]: `values` [..] at the effect's joint, or at all of them, `elsewhere` at the others."""
        result = np.full((*np.shape(values), n), elsewhere, dtype=np.asarray(values).dtype)
        result[..., slice(None) if self.joint is None else self.joint] = (
            np.asarray(values)[..., None] if self.joint is None else values
        )
        return result

    # What it does to the fitted arm -----------------------------------------------------------------------------------

    def force(self, motion: Motion) -> Array | None:
        """Its torque [S] at its port: on the motor (motor side), on the link (joint side), or added to the spring's."""
        return None

    def impedance(self, s: Complex, arm: Known) -> Complex | None:
        """What it adds to the dynamic stiffness [S, 2n, 2n] of (theta/N, q), joint side, at s [S]."""
        return None

    def second_order(self, s: Complex, arm: Known, swing: Swing) -> Complex | None:
        """Forces [L, n] on the links at s [L] that come back from what gives: of second order in the joints' `swing`."""
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

    def shares(self, record: int) -> dict[str, float]:
        """By what shares K, J_m, D or D_spring of its joint are others in a record (from 0)."""
        return {}

    # What it does to both ---------------------------------------------------------------------------------------------

    def loads(self, states: Sequence[State]) -> tuple[tuple[str, int, Any], ...]:
        """Torques (port, joint, [S] or float) besides that of its law, of the motion of all joints [n]."""
        return ()

    # What it does to the simulated arm --------------------------------------------------------------------------------

    def arm(self, arm: Arm, record: int) -> Arm:
        """The numbers of the arm in a record (from 0) where they are not the declared ones."""
        return arm

    def structure(self, body: Body) -> None:
        """Adds what gives, to the bodies."""

    def driven(self, states: Sequence[State], rest: Sequence[float]) -> tuple[tuple[str, int, float], ...]:
        """`loads` in the simulation, where the motors rest at the angles `rest` [n, rad]."""
        return self.loads(states)

    def path(self) -> Path:
        """What becomes of the commanded torque of its joint."""
        return Path()

    def misread(self, theta: float) -> float:
        """The error of the encoder of its joint [rad, motor side] at the angle theta."""
        return 0.0

    def angle_delay(self) -> float:
        """How much older [s] than its time stamp the recorded angle of its joint is."""
        return 0.0


class PortLaw(Effect):
    """An effect that is a torque at its port, by the motion of its joint."""

    #: A linear law is an impedance in the fit, exact; a law in the simulation only.
    linear: ClassVar[bool] = False

    @abstractmethod
    def start(self, step: float) -> tuple[Callable[[State], Any], Callable[[State], None] | None]:
        """Its law in a simulation from rest, asked for in the middle of a `step` [s]; and, for a law with a memory, what has to be
        called at the end of each."""


class PeriodicLaw(PortLaw):
    """A law whose torque over a period is known when that goes on for ever: what a fit needs of one that is not linear."""

    def force(self, motion: Motion) -> Array | None:
        if self.joint is None:
            raise IdentError(f"effect {self.name}: a law of one joint; expected one")
        return None if self.linear else np.asarray(self.over_periods(self.over_period, motion))

    def over_periods(self, law: Callable[[State], Any], motion: Motion) -> Any:
        """What a law, that of its port and joint, makes over the periods, which differ where it is dry."""
        assert self.joint is not None
        astray = motion.astray(self.port, self.joint) if self.dry else None
        return over_periods(law, motion.state(self.joint), self.port, astray)

    @abstractmethod
    def over_period(self, at: State) -> Any:
        """Its torque [S] at its port when the period goes on for ever: on the motor, on the link, or added to the spring's."""


class Law(PeriodicLaw):
    """A law of the moment: its torque follows from the state of its joint, whatever was before."""

    @property
    def creep(self) -> float:
        """Decades by which it creeps faster before it slides than contacts are expected to, if it is dry."""
        return 0.0

    @abstractmethod
    def law(self, at: State) -> Any:
        """Its torque, floats or arrays, at its port: on the motor, on the link, or added to the spring's."""

    def over_period(self, at: State) -> Any:
        return self.law(at)

    def start(self, step: float) -> tuple[Callable[[State], Any], None]:
        return self.law, None


#: What an effect may change besides forces and the dynamic stiffness.
_OTHERS = ("torque_gain", "angle_gain", "posture", "shares")


def has_forces(effect: Effect) -> bool:
    """Whether an effect needs the motion: a law that is no impedance, a load, an error of the reading."""
    by_law = overrides(effect, "force") and not (isinstance(effect, PortLaw) and effect.linear)
    return by_law or overrides(effect, "loads", "reading")


def winds_up(effect: Effect) -> bool:
    """Whether an effect has a force that its own motion follows by more than a line: more than one motion may do."""
    return isinstance(effect, PeriodicLaw) and not effect.linear and not effect.dry


def overrides(effect: Effect | type[Effect], *hooks: str) -> bool:
    """Whether an effect, or all of a kind, does anything by one of these methods."""
    kind = effect if isinstance(effect, type) else type(effect)
    return any(getattr(kind, hook) is not getattr(Effect, hook) for hook in hooks)


def only_forces(effect: Effect) -> bool:
    """Whether an effect changes nothing but forces and readings."""
    return not overrides(effect, "impedance", *_OTHERS)


def only_gains(effect: Effect) -> bool:
    """Whether an effect changes nothing but what becomes of torques and angles at each frequency."""
    return not has_forces(effect) and not overrides(effect, "impedance", "posture", "shares")


def only_shares(effect: Effect) -> bool:
    """Whether an effect changes nothing but drives, from one record to the next."""
    return not has_forces(effect) and not overrides(effect, "impedance", "torque_gain", "angle_gain", "posture")


def only_read(effect: Effect) -> bool:
    """Whether an effect changes nothing but what torques and angles are taken to be: gains and delays, or zeros of joints."""
    return not has_forces(effect) and not overrides(effect, "impedance", "shares")


def only_impedance(effect: Effect) -> bool:
    """Whether an effect changes nothing but the dynamic stiffness."""
    return not has_forces(effect) and not overrides(effect, *_OTHERS)
