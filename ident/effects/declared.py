"""Numbers that the declared model has, and has wrong: the fit only has to be let free of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import exp
from typing import final

import numpy as np

from ident.effects.base import Arm, Array, Complex, Effect, Known, Parameter
from ident.effects.impedance import inertia_and_weight
from symgen.chain import Inertia, skew
from symgen.robot import Drive


def _with_drive(arm: Arm, joint: int | None, change: Callable[[Drive], Drive]) -> Arm:
    drives = tuple(change(d) if i == joint else d for i, d in enumerate(arm.drives))
    return replace(arm, drives=drives)


def _with_body(arm: Arm, joint: int, body: Inertia) -> Arm:
    joints = list(arm.chain.joints)
    joints[joint] = replace(joints[joint], inertia=body)
    return replace(arm, chain=replace(arm.chain, joints=tuple(joints)))


@final
class MotorViscous(Effect):
    """Another viscous friction on the motor than declared."""

    name, port, declared = "motor-viscous", "motor", True
    parameters = (Parameter("damping", "Nms/rad", 0.0, 1.0, (0.05, 0.02), linear=True, relative="torque/rate"),)

    def arm(self, arm: Arm, record: int) -> Arm:
        return _with_drive(arm, self.joint, lambda d: replace(d, D=d.D + self["damping"]))


@final
class MotorInertia(Effect):
    """Another motor inertia than in the datasheet: a brake, a coupling."""

    name, port, declared = "motor-inertia", "motor", True
    parameters = (Parameter("inertia", "kgm2", -0.9, 10.0, (0.2, -0.1), linear=True, relative="J"),)

    def arm(self, arm: Arm, record: int) -> Arm:
        return _with_drive(arm, self.joint, lambda d: replace(d, J_m=d.J_m + self["inertia"]))


@final
class SpringDamping(Effect):
    """Another viscous damping in the gear than declared."""

    name, port, declared = "spring-damping", "spring", True
    parameters = (Parameter("damping", "Nms/rad", 0.0, 50.0, (1.0,), linear=True, relative="damping", sliding="Ns/m"),)

    def arm(self, arm: Arm, record: int) -> Arm:
        return _with_drive(arm, self.joint, lambda d: replace(d, D_spring=d.D_spring + self["damping"]))


@final
class Payload(Effect):
    """A mass at the last link, on the ray from its joint through its centre of mass (along the axis, where that is on it)."""

    name, port, declared, scope = "payload", "link", True, ("arm",)
    parameters = (
        Parameter("mass", "kg", 0.0, 10.0, (0.3,), linear=True, relative="mass"),
        Parameter("offset", "m", 0.0, 10.0, (0.1,), zero=None),
    )

    def arm(self, arm: Arm, record: int) -> Arm:
        last = arm.chain.joints[-1]
        length = np.linalg.norm(last.inertia.com)
        ray = last.inertia.com / length if length else last.axis
        added = Inertia(self["mass"], self["offset"] * ray, np.zeros((3, 3)))
        return _with_body(arm, arm.chain.n - 1, last.inertia + added)


@final
class InertialParameters(Effect):
    """A link is not as in the URDF: its mass and moments by the share `mass`, its centre of mass aside by `aside`."""

    name, port, declared = "inertial-parameters", "link", True
    parameters = (
        Parameter("mass", "", -0.9, 10.0, (0.2, -0.2)),
        Parameter("aside", "m", -0.5, 0.5, (0.0, 0.01)),
    )

    def arm(self, arm: Arm, record: int) -> Arm:
        assert self.joint is not None
        joint = arm.chain.joints[self.joint]
        body = joint.inertia
        side = np.cross(joint.axis, body.com)
        length = np.linalg.norm(side)
        side = side / length if length else np.eye(3)[np.argmin(np.abs(joint.axis))]
        factor = 1.0 + self["mass"]
        moved = Inertia(factor * body.mass, body.com + self["aside"] * side, factor * body.I)
        return _with_body(arm, self.joint, moved)


class GravityStiffness(Effect):
    """Gravity is not as declared: stronger by `share`, or the base tilted about its x and y axes."""

    name, port, declared, scope, carries = "gravity-stiffness", "link", True, ("arm",), True
    parameters = (
        Parameter("share", "", -1.0, 1.0, (0.1, -0.1), declared=True),
        Parameter("tilt_x", "rad", -np.pi, np.pi, (0.0, 0.2)),
        Parameter("tilt_y", "rad", -np.pi, np.pi, (0.0, 0.2)),
    )

    def arm(self, arm: Arm, record: int) -> Arm:
        return replace(arm, gravity=self._pulls(arm.gravity))

    def impedance(self, s: Complex, arm: Known) -> Complex | None:
        """What the declared links weigh more in a tilted base; how strong gravity is, the fitted arm tells by itself."""
        now, untilted = self._pulls(arm.gravity), (1.0 + self["share"]) * arm.gravity
        n = len(arm.N)
        result = np.zeros((len(s), 2 * n, 2 * n), dtype=complex)
        result[:, n:, n:] = inertia_and_weight(arm.chain, arm.posture, now - untilted)[1]
        return result

    def _pulls(self, gravity: Array) -> Array:
        share, x, y = self.values[:3]
        return np.asarray((1.0 + share) * _turned(np.array([x, y, 0.0]), np.asarray(gravity, dtype=float)))


def _turned(by: Array, v: Array) -> Array:
    """v in a base that is turned `by` [3, rad] (Rodrigues)."""
    angle = float(np.linalg.norm(by))
    if angle == 0.0:
        return v
    k = skew(by / angle)
    return np.asarray(v - np.sin(angle) * (k @ v) + (1 - np.cos(angle)) * (k @ k @ v))


class Changing(Effect):
    """A joint that is not the same in all records: some of its numbers are others by `shares` of what they were."""

    port, declared = "spring", True

    def arm(self, arm: Arm, record: int) -> Arm:
        shares = self.shares(record)
        if not shares:
            return arm
        return _with_drive(
            arm,
            self.joint,
            lambda d: replace(d, **{name: getattr(d, name) * (1.0 + by) for name, by in shares.items()}),
        )


@final
class ChangeBetweenRecords(Changing):
    """From one record on the joint is another: K, motor damping D and motor inertia J_m by shares of what they were."""

    name = "change-between-records"
    parameters = (
        Parameter("record", "", 2.0, 1e6, (2.0,), zero=None, whole=True),
        Parameter("stiffness", "", -0.9, 10.0, (-0.1, 0.1)),
        Parameter("damping", "", -0.99, 100.0, (0.0, 1.0)),
        Parameter("inertia", "", -0.9, 10.0, (0.0, 0.1)),
    )

    def shares(self, record: int) -> dict[str, float]:
        first, K, D, J_m = self.values
        return {"K": K, "D": D, "J_m": J_m} if record + 1 >= first else {}


@final
class DriftOverRecords(Changing):
    """A joint that warms up, or settles: K and motor damping D go to others by shares, exponentially in so many `records`."""

    name = "drift-over-records"
    parameters = (
        Parameter("records", "", 1.0, 1e3, (3.0, 10.0, 30.0), zero=None),
        Parameter("stiffness", "", -0.9, 10.0, (-0.1, 0.1)),
        Parameter("damping", "", -0.99, 100.0, (-0.5, 1.0)),
    )

    def shares(self, record: int) -> dict[str, float]:
        records, K, D = self.values
        gone = 1.0 - exp(-record / records)
        return {"K": K * gone, "D": D * gone} if record else {}
