"""Arms to judge symgen by: real ones, random ones, and the same arms as pinocchio models."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin

from symgen.basis import Factoring, factor
from symgen.chain import PRISMATIC, REVOLUTE, Chain, Inertia, Joint, skew
from symgen.urdf import load_chain

_ROBOTS = Path(pin.__file__).parents[4] / "share/example-robot-data/robots"
_FILES = {
    "ypp3": Path(__file__).parents[2] / "robots/ypp3/ypp3.urdf",
    "ur3": _ROBOTS / "ur_description/urdf/ur3_robot.urdf",
    "ur5": _ROBOTS / "ur_description/urdf/ur5_robot.urdf",
    "ur10": _ROBOTS / "ur_description/urdf/ur10_robot.urdf",
    "panda": _ROBOTS / "panda_description/urdf/panda.urdf",
    "xarm7": _ROBOTS / "xarm_description/urdf/xarm7.urdf",
    "kinova": _ROBOTS / "kinova_description/robots/kinova.urdf",
    "z1": _ROBOTS / "z1_description/urdf/z1.urdf",
    "z1 without gripper": _ROBOTS / "z1_description/urdf/z1.urdf",
}
_TIPS = {"z1 without gripper": "link06"}


@cache
def arm(name: str) -> Chain:
    return load_chain(_FILES[name], tip=_TIPS.get(name))


@cache
def factoring_of(name: str, believe_zeros: bool = False) -> Factoring:
    return factor(arm(name), believe_zeros=believe_zeros)


def random_arm(seed: int, n: int, *, right_angles: bool) -> Chain:
    """A random arm; one joint in four slides, every other offset has one component, axes at right angles if asked for."""
    rng = np.random.default_rng(seed)
    joints = []
    for k in range(n):
        R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        axis = R[0].copy()
        if right_angles:
            R = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
            axis = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
        R = R * np.linalg.det(R)
        p = rng.uniform(0.1, 0.5, 3) * rng.choice([-1.0, 1.0], 3)
        if rng.random() < 0.5:
            p = p * np.eye(3)[rng.integers(3)]
        kind = PRISMATIC if rng.random() < 0.25 else REVOLUTE
        joints.append(Joint(f"joint{k + 1}", kind, R + 0.0, p, axis + 0.0, f"link{k + 1}", _rigid_body(rng)))
    return Chain(f"random {seed}", tuple(joints), "base", "tip", sha256=f"{seed:064x}")


def _rigid_body(rng: np.random.Generator) -> Inertia:
    spread = rng.normal(size=(3, 3)) * 0.2
    return Inertia(
        rng.uniform(0.5, 2.0), rng.normal(size=3) * 0.1, np.trace(spread @ spread.T) * np.eye(3) - spread @ spread.T
    )


def _any_body(rng: np.random.Generator, there: np.ndarray) -> Inertia:
    """A body with random parameters (of no physical meaning beyond m > 0), zero where `there` [10] is."""
    m, hx, hy, hz, xx, xy, yy, xz, yz, zz = rng.uniform(0.5, 1.5, 10) * rng.choice([-1.0, 1.0], 10) * there
    m = abs(m)
    com = np.array([hx, hy, hz]) / m if m else np.zeros(3)
    L = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return Inertia(m, com, L + m * skew(com) @ skew(com))


def with_random_bodies(factoring: Factoring, seed: int) -> Chain:
    """The factoring's arm with other bodies; parameters believed zero stay zero."""
    rng = np.random.default_rng(seed)
    there = factoring.free.reshape(-1, 10)
    joints = factoring.chain.joints
    bodies = [replace(joint, inertia=_any_body(rng, row)) for joint, row in zip(joints, there, strict=True)]
    return replace(factoring.chain, joints=tuple(bodies))


def model_of(chain: Chain) -> pin.Model:
    """The chain as a pinocchio model, joint by joint."""
    model, parent = pin.Model(), 0
    for joint in chain.joints:
        kind = pin.JointModelPrismaticUnaligned if joint.type == PRISMATIC else pin.JointModelRevoluteUnaligned
        parent = model.addJoint(parent, kind(joint.axis), pin.SE3(joint.R, joint.p), joint.name)
        body = joint.inertia
        model.appendBodyToJoint(parent, pin.Inertia(body.mass, body.com, body.I), pin.SE3.Identity())
    return model


def crba(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """The inertia matrix [n, n] by pinocchio's composite-rigid-body algorithm."""
    upper = np.triu(pin.crba(model, model.createData(), np.asarray(q, dtype=float)))
    return upper + np.triu(upper, 1).T
