"""The arms every peer gets: vendors' URDFs with all but the arm's own joints fixed, and the same as plain numbers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from symgen.chain import Chain

ROOT = Path(__file__).parents[3]
_VENDORS = Path(pin.__file__).parents[4] / "share/example-robot-data/robots"

#: Arm -> its URDF, and the joints besides the arm's that are fixed for the peers (symgen fixes them itself).
_FILES = {
    "ypp3": (ROOT / "robots/ypp3/ypp3.urdf", ()),
    "ur5": (_VENDORS / "ur_description/urdf/ur5_robot.urdf", ()),
    "panda": (_VENDORS / "panda_description/urdf/panda.urdf", ("panda_finger_joint1", "panda_finger_joint2")),
    "xarm7": (_VENDORS / "xarm_description/urdf/xarm7.urdf", ()),
}

_AXES = {"JointModelRX": (1, 0, 0), "JointModelRY": (0, 1, 0), "JointModelRZ": (0, 0, 1)}


@dataclass(frozen=True)
class Arm:
    """One arm: its name, the vendor's file, and `peers_file`, the same URDF with grippers fixed."""

    name: str
    urdf: Path
    peers_file: Path

    @cached_property
    def model(self) -> pin.Model:
        """Pinocchio's model of `peers_file`; the judge of every program."""
        model = pin.buildModelFromUrdf(str(self.peers_file))
        assert model.nq == model.nv, f"{self.name}: a continuous joint has two coordinates in Pinocchio"
        return model

    @cached_property
    def joints(self) -> list[dict[str, Any]]:
        """For each joint axis [3], R [3, 3] and p [3, m] in the one before, mass [kg], com [3, m], I [3, 3, kg m2]."""
        model, out = self.model, []
        for k in range(1, model.njoints):
            place, body, joint = model.jointPlacements[k], model.inertias[k], model.joints[k]
            axis = _AXES.get(joint.shortname()) or pin.JointModelRevoluteUnaligned(joint.extract()).axis
            out.append(
                {
                    "axis": [float(x) for x in axis],
                    "R": place.rotation.tolist(),
                    "p": place.translation.tolist(),
                    "mass": float(body.mass),
                    "com": body.lever.tolist(),
                    "I": body.inertia.tolist(),
                }
            )
        return out

    def postures(self, count: int, seed: int) -> np.ndarray:
        """Random postures [count, n, rad]."""
        return np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, self.model.nq))


def inertia_of(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """Pinocchio's J(q) [count, n, n, kg m2] at postures q [count, n]."""
    data = model.createData()
    upper = np.array([np.triu(pin.crba(model, data, posture)) for posture in q])
    J: np.ndarray = upper + np.triu(upper, 1).transpose(0, 2, 1)
    return J


def model_of(chain: Chain) -> pin.Model:
    """The Pinocchio model of a chain of turning joints."""
    model, parent = pin.Model(), 0
    for joint in chain.joints:
        kind = pin.JointModelRevoluteUnaligned(joint.axis)
        parent = model.addJoint(parent, kind, pin.SE3(joint.R, joint.p), joint.name)
        body = joint.inertia
        model.appendBodyToJoint(parent, pin.Inertia(body.mass, body.com, body.I), pin.SE3.Identity())
    return model


def arms(directory: Path) -> list[Arm]:
    """Returns the arms, with the URDFs for the peers written into `directory`."""
    out = []
    for name, (urdf, fixed) in _FILES.items():
        tree = ElementTree.parse(urdf)
        for joint in tree.getroot().findall("joint"):
            if joint.get("name") in fixed:
                joint.set("type", "fixed")
        tree.write(directory / f"{name}.urdf")
        out.append(Arm(name, urdf, directory / f"{name}.urdf"))
    return out


def write_random_arm(path: Path, joints: int, seed: int) -> Path:
    """Writes the URDF of an arm with random geometry and bodies, the hardest case for the algebra; returns its path."""
    rng = np.random.default_rng(seed)
    links = ['<link name="link0"/>']
    for k in range(1, joints + 1):
        rpy, xyz, axis = rng.uniform(-3, 3, 3), rng.uniform(-0.3, 0.3, 3), rng.normal(size=3)
        com, spread = rng.uniform(-0.1, 0.1, 3), rng.normal(size=(3, 3)) * 0.1
        moments = np.trace(spread @ spread.T) * np.eye(3) - spread @ spread.T
        names = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
        inertia = " ".join(f'{name}="{float(moments[at])!r}"' for name, at in names.items())
        links.append(
            f'<link name="link{k}"><inertial><origin xyz="{_text(com)}" rpy="0 0 0"/><mass value="1.5"/>'
            f'<inertia {inertia}/></inertial></link>\n<joint name="joint{k}" type="revolute">'
            f'<parent link="link{k - 1}"/><child link="link{k}"/><origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/>'
            f'<axis xyz="{_text(axis / np.linalg.norm(axis))}"/>'
            '<limit lower="-2.5" upper="2.5" effort="100" velocity="2"/></joint>'
        )
    path.write_text(f'<robot name="random{joints}">\n' + "\n".join(links) + "\n</robot>\n", encoding="utf-8")
    return path


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in values)
