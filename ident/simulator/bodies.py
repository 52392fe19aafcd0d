"""The bodies of a simulated arm, and what effects add to them: joints on springs, between bodies that are there or new."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from ident.effects.base import Arm
from ident.simulator.plant import compiled, mjcf
from symgen.chain import REVOLUTE, skew

Array = NDArray[np.float64]


class Bodies:
    """The arm as an MJCF document, a body a joint, joints that are not `live` (from 0) frozen at `posture` [n, rad or m].

    What an effect adds (`ident.effects.base.Body`) changes the document; `model` compiles it. The joints of a live joint
    are named "motor<i>" and "spring<i>".
    """

    def __init__(self, arm: Arm, posture: Array, live: tuple[int, ...], step: float, integrator: str) -> None:
        self.chain = arm.chain
        n = arm.chain.n
        self._root = mjcf(arm.chain, arm.drives, arm.gravity, posture, range(n), step, integrator)
        self._bodies = list(self._root.iter("body"))
        self._frozen = {}
        for i, element in enumerate(self._bodies):
            motor, spring = element.findall("joint")
            spring.set("name", f"spring{i}")
            if i not in live:
                self._freeze(i, float(posture[i]))
                element.remove(motor)
                element.remove(spring)
                self._frozen[i] = spring
        actuators = next(self._root.iter("actuator"))
        for i, actuator in enumerate(list(actuators)):
            if i not in live:
                actuators.remove(actuator)

    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return compiled(self._root)

    def rock(self, stiffness: Sequence[float], damping: Sequence[float], inertia: Sequence[float]) -> None:
        world = next(self._root.iter("worldbody"))
        base = ET.SubElement(world, "body")
        for axis, k, d in zip(np.eye(3), stiffness, damping, strict=True):
            base.append(_joint({"type": "hinge", "axis": _text(axis)}, k, d))
        ET.SubElement(base, "inertial", pos="0 0 0", mass="0", diaginertia=_text(inertia))
        world.remove(self._bodies[0])
        base.append(self._bodies[0])

    def split(self, link: int, share: float, axis: Sequence[float], stiffness: float, damping: float) -> None:
        near = self._bodies[link]
        far = ET.Element("body")
        far.append(_joint({"type": "hinge", "axis": _text(axis)}, stiffness, damping))
        inertial = near.find("inertial")
        assert inertial is not None
        far.append(ET.Element("inertial", dict(inertial.attrib)))
        for element, part in ((inertial, 1.0 - share), (far[-1], share)):
            for key in ("mass", "diaginertia"):
                element.set(key, _text(part * _numbers(element.get(key, "0"))))
        for child in near.findall("body"):
            near.remove(child)
            far.append(child)
        near.append(far)

    def attach_disc(self, link: int, inertia: float, axis: Sequence[float], stiffness: float, damping: float) -> None:
        disc = ET.SubElement(self._bodies[link], "body")
        disc.append(_joint({"type": "hinge", "axis": _text(axis)}, stiffness, damping))
        aligned = np.zeros(4)
        mujoco.mju_quatZ2Vec(aligned, np.asarray(axis, dtype=float))
        ET.SubElement(disc, "inertial", pos="0 0 0", quat=_text(aligned), mass="0", diaginertia=f"0 0 {inertia!r}")

    def loosen(self, joint: int, stiffness: float, damping: float) -> None:
        spring = self._frozen.get(joint)
        if spring is not None:
            self._bodies[joint].insert(0, spring)
            spring.set("stiffness", repr(stiffness))
            spring.set("damping", repr(damping))

    def _freeze(self, i: int, value: float) -> None:
        element, joint = self._bodies[i], self.chain.joints[i]
        R, p = _rotation(element.get("quat", "1 0 0 0")), _numbers(element.get("pos", "0 0 0"))
        if joint.type == REVOLUTE:
            turned = np.zeros(4)
            mujoco.mju_mat2Quat(turned, np.ascontiguousarray(R @ expm(skew(joint.axis) * value)).ravel())
            element.set("quat", _text(turned))
        else:
            element.set("pos", _text(p + R @ joint.axis * value))


def _joint(kind: dict[str, str], stiffness: float, damping: float) -> ET.Element:
    return ET.Element("joint", kind, limited="false", stiffness=repr(float(stiffness)), damping=repr(float(damping)))


def _rotation(quaternion: str) -> Array:
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, _numbers(quaternion))
    return R.reshape(3, 3)


def _numbers(text: str) -> Array:
    return np.array(text.split(), dtype=float)


def _text(values: ArrayLike) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values, dtype=float).ravel())
