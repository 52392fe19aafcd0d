"""A serial arm as a chain of moving joints, each carrying one rigid body: all that the dynamics need, and no more."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]

#: The ten inertial parameters of a body, in the order used everywhere: mass, first moments m r, and the inertia L about
#: the origin of the link frame (Pinocchio's order, `pin.Inertia.toDynamicParameters`).
PARAMETERS = ("m", "mx", "my", "mz", "Lxx", "Lxy", "Lyy", "Lxz", "Lyz", "Lzz")

REVOLUTE, PRISMATIC = "revolute", "prismatic"


def readonly(values: ArrayLike) -> Array:
    """Returns a float copy of `values` that can not be written to."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def skew(v: ArrayLike) -> Array:
    """Returns the 3x3 matrix [v]x with [v]x w = v x w."""
    x, y, z = np.asarray(v, dtype=float)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@dataclass(frozen=True)
class Inertia:
    """A rigid body: mass [kg], centre of mass [3, m] and rotational inertia about it [3, 3, kg m2], in link-frame axes."""

    mass: float
    com: Array
    I: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "com", readonly(self.com))
        object.__setattr__(self, "I", readonly(self.I))

    @staticmethod
    def zero() -> Inertia:
        return Inertia(0.0, np.zeros(3), np.zeros((3, 3)))

    @staticmethod
    def of(parameters: Array) -> Inertia:
        """The body with these ten parameters [10], in the order of `PARAMETERS`."""
        m, (xx, xy, yy, xz, yz, zz) = float(parameters[0]), parameters[4:]
        com = parameters[1:4] / m if m else np.zeros(3)
        L = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return Inertia(m, com, L + m * skew(com) @ skew(com))

    @cached_property
    def parameters(self) -> Array:
        """The ten parameters [10] in the order of `PARAMETERS`, about the link-frame origin: kg, kg m, kg m2."""
        m, r = self.mass, self.com
        L = self.I - m * skew(r) @ skew(r)
        return readonly([m, *(m * r), L[0, 0], L[0, 1], L[1, 1], L[0, 2], L[1, 2], L[2, 2]])

    def moved(self, R: ArrayLike, p: ArrayLike) -> Inertia:
        """This body seen from a frame in which its own frame has rotation R [3, 3] and origin p [3, m]."""
        R = np.asarray(R, dtype=float)
        return Inertia(self.mass, R @ self.com + np.asarray(p, dtype=float), R @ self.I @ R.T)

    def __add__(self, other: Inertia) -> Inertia:
        """Two bodies rigidly joined (both in the same frame)."""
        mass = self.mass + other.mass
        if mass == 0.0:
            return Inertia(0.0, self.com, self.I + other.I)
        com = (self.mass * self.com + other.mass * other.com) / mass
        total = np.zeros((3, 3))
        for body in (self, other):
            d = skew(body.com - com)
            total += body.I - body.mass * d @ d
        return Inertia(mass, com, total)


@dataclass(frozen=True)
class Joint:
    """One moving joint and the rigid body behind it (fixed and frozen links lumped in).

    `R` [3, 3] and `p` [3, m] place the joint frame in the previous link's frame at q = 0; the link frame is the joint
    frame turned about (revolute) or shifted along (prismatic) the unit `axis` [3] by q. Limits in rad or m (infinite
    for a continuous joint), effort in N m or N; infinite where the URDF states none.
    """

    name: str
    type: str  # REVOLUTE | PRISMATIC
    R: Array
    p: Array
    axis: Array
    link: str
    inertia: Inertia
    lower: float = -np.inf
    upper: float = np.inf
    effort: float = np.inf

    def __post_init__(self) -> None:
        for name in ("R", "p", "axis"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @property
    def limits(self) -> tuple[float, float]:
        """(lower, upper) as a finite interval: an unlimited revolute joint gets (-pi, pi), an unlimited slide (-1, 1) m.

        Where only one end is infinite and the other lies outside these, it is pi or 1 m beyond that other.
        """
        span = np.pi if self.type == REVOLUTE else 1.0
        lower = -span if self.upper > -span else self.upper - span
        upper = span if self.lower < span else self.lower + span
        return (self.lower if np.isfinite(self.lower) else lower, self.upper if np.isfinite(self.upper) else upper)


@dataclass(frozen=True)
class Snap:
    """One angle that was moved to an exact value: where, from, to [rad], and the value in words ("pi/2")."""

    joint: str
    found: float
    snapped: float
    text: str


@dataclass(frozen=True)
class Chain:
    """A serial arm, base to tip.

    `frozen` holds the joints of the file that do not move here, with the value [rad or m] they are frozen at (of those
    before the base only what a caller froze); `lumped` the links whose inertia went into another link. `source` is the URDF
    text, `sha256` its hash.
    """

    name: str
    joints: tuple[Joint, ...]
    base_link: str
    tip_link: str
    source: str = ""
    sha256: str = ""
    snapped: tuple[Snap, ...] = ()
    frozen: dict[str, float] = field(default_factory=dict)
    lumped: tuple[tuple[str, str], ...] = ()

    @property
    def n(self) -> int:
        return len(self.joints)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(joint.name for joint in self.joints)

    def slides(self, joint: int | None) -> bool:
        """Whether a joint slides: metres and newtons are beyond its gear; an arm as a whole, None, does not."""
        return joint is not None and self.joints[joint].type == PRISMATIC

    @cached_property
    def parameters(self) -> Array:
        """The inertial parameters of all bodies, base to tip [10 n]."""
        return readonly(np.concatenate([joint.inertia.parameters for joint in self.joints]))

    @cached_property
    def places(self) -> bytes:
        """What tells where its joints are, whatever their bodies: type, placement and axis of each."""
        return b"".join(
            joint.type.encode() + joint.R.tobytes() + joint.p.tobytes() + joint.axis.tobytes() for joint in self.joints
        )

    def with_parameters(self, phi: Array) -> Chain:
        """The same chain, its bodies with the inertial parameters phi [10 n], in the order of `parameters`."""
        bodies = map(Inertia.of, np.reshape(phi, (-1, 10)))
        return replace(
            self, joints=tuple(replace(joint, inertia=body) for joint, body in zip(self.joints, bodies, strict=True))
        )

    @cached_property
    def limits(self) -> Array:
        """Finite joint limits [n, 2] in rad or m."""
        return readonly([joint.limits for joint in self.joints])


def placements(chain: Chain, q: Array) -> Iterator[tuple[Array, Array]]:
    """Yields for each body its frame in the frame of the body before: rotations [m, 3, 3] and origins [m, 3, m] at q [m, n]."""
    for k, joint in enumerate(chain.joints):
        if joint.type == REVOLUTE:
            c, s = np.cos(q[:, k])[:, None, None], np.sin(q[:, k])[:, None, None]
            A0 = np.outer(joint.axis, joint.axis)
            yield (
                joint.R @ (A0 + c * (np.eye(3) - A0) + s * skew(joint.axis)),
                np.broadcast_to(joint.p, (len(q), 3)),
            )
        else:
            yield np.broadcast_to(joint.R, (len(q), 3, 3)), joint.p + q[:, k, None] * (joint.R @ joint.axis)
