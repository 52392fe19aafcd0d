"""Whether an arm touches itself at a posture: the URDF's collision shapes, tested by Pinocchio's collision library."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from symgen.chain import REVOLUTE, Array, Chain, Joint, skew
from symgen.holding import Mask
from symgen.quiet import quiet

#: Shapes that touch at this share of random postures overlap by construction (neighbours in a gearbox), not by motion.
_ALWAYS = 0.95
#: Shapes whose bounding spheres are further apart than this [m] do not touch.
_SLACK = 1e-6
_TRIALS = 40


class SelfCollision:
    """The collision shapes of one arm. `note` says in words what is tested; call with postures [m, n] for a mask [m]."""

    def __init__(self, chain: Chain, urdf: Path):
        self._test, self.note = _tester(chain, urdf)

    def __call__(self, q: Array) -> NDArray[np.bool_]:
        """True where the arm touches itself [m]; all False where there is nothing to test."""
        return np.zeros(len(q), dtype=bool) if self._test is None else self._test(q)


def _tester(chain: Chain, urdf: Path) -> tuple[Mask | None, str]:
    text, shapes, missing = _resolved(chain.source, urdf)
    if not shapes:
        return None, "not tested: the URDF has no collision shapes" + (
            f" but {missing} meshes not found" if missing else ""
        )
    import pinocchio as pin

    try:
        with quiet():
            whole = pin.buildModelFromXML(text)
            geometry = pin.buildGeomFromUrdfString(whole, text, pin.GeometryType.COLLISION)
        rest = pin.neutral(whole)
        for name, value in chain.frozen.items():
            joint = whole.joints[whole.getJointId(name)] if whole.existJointName(name) else None
            if joint is not None:
                rest[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        others = [k for k in range(1, whole.njoints) if whole.names[k] not in chain.names]
        model, geometry = pin.buildReducedModel(whole, geometry, others, rest) if others else (whole, geometry)
    except (ValueError, RuntimeError) as error:
        return None, f"not tested: {' '.join(str(error).split())[:120]}"
    test = _pairs(pin, model, geometry, chain)
    note = f"tested with {shapes} collision shapes" + (f", {missing} meshes not found" if missing else "")
    return test, note


def _resolved(text: str, urdf: Path) -> tuple[str, int, int]:
    """The URDF with only collision shapes that exist, meshes by absolute path; counts of those kept and of those missing."""
    root = ET.fromstring(text)
    kept = missing = 0
    for link in root.iter("link"):
        for shape in list(link.findall("visual")) + list(link.findall("collision")):
            mesh = shape.find("geometry/mesh")
            if shape.tag == "visual":
                link.remove(shape)
            elif mesh is not None and (path := _mesh_file(mesh.get("filename", ""), urdf)) is None:
                link.remove(shape)
                missing += 1
            else:
                kept += 1
                if mesh is not None and path is not None:
                    mesh.set("filename", str(path))
    return ET.tostring(root, encoding="unicode"), kept, missing


def _mesh_file(name: str, urdf: Path) -> Path | None:
    """The file behind a mesh name: package:// is looked for in ROS_PACKAGE_PATH and in the folders above the URDF."""
    if not name.startswith("package://"):
        path = urdf.resolve().parent / name.removeprefix("file://")
        return path if path.is_file() else None
    inside = name.removeprefix("package://")
    above = list(urdf.resolve().parents)
    known = [Path(entry) for entry in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if entry]
    for folder in (*known, *above):
        # a package's own folder may bear another name than the package
        for path in (folder / inside, folder / inside.partition("/")[2]):
            if path.is_file():
                return path
    return None


def _pairs(pin: Any, model: Any, geometry: Any, chain: Chain) -> Mask | None:
    """A test of all pairs of shapes on links that are no neighbours and do not overlap by construction."""
    shapes = geometry.geometryObjects
    for a in range(len(shapes)):
        for b in range(a + 1, len(shapes)):
            one, two = shapes[a].parentJoint, shapes[b].parentJoint
            if one != two and model.parents[one] != two and model.parents[two] != one:
                geometry.addCollisionPair(pin.CollisionPair(a, b))
    if not len(geometry.collisionPairs):
        return None
    joints = [model.joints[model.getJointId(name)] for name in chain.names]
    neutral, data = np.array(pin.neutral(model)), model.createData()

    def configurations(q: Array) -> Array:
        full = np.tile(neutral, (len(q), 1))
        for joint, value in zip(joints, q.T, strict=True):
            parts = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
            full[:, joint.idx_q : joint.idx_q + joint.nq] = np.transpose(parts)
        return full

    low, high = chain.limits.T
    trials = low + (high - low) * np.random.default_rng(0).random((_TRIALS, chain.n))
    hits = np.zeros(len(geometry.collisionPairs))
    for q in configurations(trials):
        found = geometry.createData()
        pin.computeCollisions(model, data, geometry, found, q, False)
        hits += [result.isCollision() for result in found.collisionResults]
    always = np.flatnonzero(hits >= _ALWAYS * _TRIALS)
    for pair in [geometry.collisionPairs[int(index)] for index in always]:
        geometry.removeCollisionPair(pair)
    found, unused = geometry.createData(), geometry.createData()
    close = _closeness(pin, model, geometry, chain)

    def touches(q: Array) -> NDArray[np.bool_]:
        mask = np.zeros(len(q), dtype=bool)
        for k, (row, near) in enumerate(zip(configurations(q), close(q), strict=True)):
            # requests remember the last posture's guesses, with which many a touch is missed; these remember nothing
            found.collisionRequests = unused.collisionRequests
            pin.updateGeometryPlacements(model, data, geometry, found, row)
            mask[k] = any(pin.computeCollision(geometry, found, pair) for pair in np.flatnonzero(near).tolist())
        return mask

    return touches


def _closeness(pin: Any, model: Any, geometry: Any, chain: Chain) -> Mask:
    """What tells at postures [m, n] which pairs of shapes may touch [m, pairs]: those whose bounding spheres do."""
    pairs = np.array([(pair.first, pair.second) for pair in geometry.collisionPairs])
    place, centre, radius = [], [], []
    for shape in geometry.geometryObjects:
        shape.geometry.computeLocalAABB()
        place.append(model.names[shape.parentJoint])
        centre.append(shape.placement.act(shape.geometry.aabb_center))
        radius.append(shape.geometry.aabb_radius)
    body = [chain.names.index(name) + 1 if name in chain.names else 0 for name in place]
    centres = np.column_stack([centre, np.ones(len(centre))])[..., None]
    reach = np.array(radius)[pairs].sum(axis=1) + _SLACK
    before = np.array([model.jointPlacements[model.getJointId(name)].homogeneous for name in chain.names])
    one, c, s, slide = before @ np.array([_motions(joint) for joint in chain.joints]).swapaxes(0, 1)

    def close(q: Array) -> NDArray[np.bool_]:
        x = q[:, :, None, None]
        steps = one + c * np.cos(x) + s * np.sin(x) + slide * x
        frames = np.broadcast_to(np.eye(4), (len(q), chain.n + 1, 4, 4)).copy()
        for k in range(chain.n):
            frames[:, k + 1] = frames[:, k] @ steps[:, k]
        at = (frames[:, body] @ centres)[:, :, :3, 0]
        near: NDArray[np.bool_] = ((at[:, pairs[:, 0]] - at[:, pairs[:, 1]]) ** 2).sum(axis=2) <= reach**2
        return near

    return close


def _motions(joint: Joint) -> Array:
    """A joint's motion [4, 4] as the sum of these [4, 4, 4] times 1, cos q, sin q and q."""
    parts = np.zeros((4, 4, 4))
    parts[0] = np.eye(4)
    if joint.type == REVOLUTE:
        along = np.outer(joint.axis, joint.axis)
        parts[:3, :3, :3] = along, np.eye(3) - along, skew(joint.axis)
    else:
        parts[3, :3, 3] = joint.axis
    return parts
