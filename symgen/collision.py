"""Whether an arm touches itself at a posture: the URDF's collision shapes, tested by Pinocchio's collision library."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from symgen.chain import Array, Chain
from symgen.holding import Mask
from symgen.kinematics import frames
from symgen.pinocchio_arm import alone, configurations, joint_ids
from symgen.quiet import quiet

#: Shapes that touch at this share of random postures overlap by construction (neighbours in a gearbox), not by motion.
_ALWAYS = 0.95
#: Shapes whose bounding spheres or boxes are further apart than this [m] do not touch.
_SLACK = 1e-6
#: A mesh is solid when its smallest extent is more than this part of its largest.
_SOLID = 1e-5
#: A mesh that its convex hull exceeds by no more than this part of its extent is taken for the hull.
_BULGE = 0.01
_TRIALS = 40


class SelfCollision:
    """The collision shapes of one arm. `note` says in words what is tested; call with postures [m, n] for a mask [m]."""

    def __init__(self, chain: Chain, urdf: Path):
        self._test, self.note = _tester(chain, urdf)

    def __call__(self, q: Array) -> NDArray[np.bool_]:
        """True where the arm touches itself [m]; all False where there is nothing to test."""
        return self.nearer(q) >= 0

    def nearer(self, q: Array) -> NDArray[np.int64]:
        """Of the first two links found that touch each other, how many joints are before the nearer one [m]; -1 where none touch."""
        return np.full(len(q), -1) if self._test is None else self._test(q)


#: How many joints are before the nearer of two links that touch at postures [m, n]; -1 where none do [m].
_Test = Callable[[Array], NDArray[np.int64]]


def _tester(chain: Chain, urdf: Path) -> tuple[_Test | None, str]:
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
        model, geometry = alone(whole, chain, geometry)
    except (ValueError, RuntimeError) as error:
        return None, f"not tested: {' '.join(str(error).split())[:120]}"
    test = _pairs(pin, model, geometry, chain)
    if test is None:
        return None, f"not tested: no two of the {shapes} collision shapes are on links that may touch"
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


def _pairs(pin: Any, model: Any, geometry: Any, chain: Chain) -> _Test | None:
    """A test of all pairs of shapes on links that are no neighbours and do not overlap by construction."""
    shapes = geometry.geometryObjects
    at = [shape.parentJoint for shape in shapes]
    pairs = [
        (a, b)
        for a, b in combinations(range(len(shapes)), 2)
        if at[a] != at[b] and model.parents[at[a]] != at[b] and model.parents[at[b]] != at[a]
    ]
    if not pairs:
        return None
    _set_pairs(pin, geometry, pairs)
    ids = joint_ids(model, chain.names)
    low, high = chain.limits.T
    trials = low + (high - low) * np.random.default_rng(0).random((_TRIALS, chain.n))
    test, hits = _Pair(pin, model, geometry), np.zeros(len(pairs))
    for q in configurations(model, ids, trials):
        hits += [test(k, q) for k in range(len(pairs))]
    by_hits = np.argsort(-hits, kind="stable").tolist()  # what touches often is tested first
    pairs = [pairs[k] for k in by_hits if hits[k] < _ALWAYS * _TRIALS]
    if not pairs:
        return None
    _set_pairs(pin, geometry, pairs)
    hulls_touch, shapes_touch = _Pair(pin, model, _hulls(geometry)), _Pair(pin, model, geometry)
    is_hull = [_is_hull(shape.geometry) for shape in shapes]
    exact = [is_hull[a] and is_hull[b] for a, b in pairs]
    close = _closeness(model, geometry, chain, ids)
    before = [ids.index(joint) + 1 if joint in ids else 0 for joint in at]
    nearer = [min(before[a], before[b]) for a, b in pairs]

    def touching(q: Array) -> NDArray[np.int64]:
        found, rows = np.full(len(q), -1), list(configurations(model, ids, q))
        for k, pair in np.argwhere(close(q)).tolist():
            if found[k] < 0 and hulls_touch(pair, rows[k]) and (exact[pair] or shapes_touch(pair, rows[k])):
                found[k] = nearer[pair]
        return found

    return touching


def _set_pairs(pin: Any, geometry: Any, pairs: Sequence[tuple[int, int]]) -> None:
    geometry.removeAllCollisionPairs()
    for a, b in pairs:
        geometry.addCollisionPair(pin.CollisionPair(a, b))


class _Pair:
    """Whether the two shapes of a pair touch at a configuration."""

    def __init__(self, pin: Any, model: Any, geometry: Any):
        self._pin, self._model, self._data, self._geometry = pin, model, model.createData(), geometry
        self._found, self._new = geometry.createData(), geometry.createData()
        for request in self._new.collisionRequests:
            request.enable_contact = True  # without it some touches of convex shapes are missed, deep ones too
        self._at: Array | None = None

    def __call__(self, pair: int, configuration: Array) -> bool:
        if configuration is not self._at:
            self._at = configuration
            # requests remember the last posture's guesses, with which many a touch is missed; these remember nothing
            self._found.collisionRequests = self._new.collisionRequests
            self._pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._found, configuration)
        touch: bool = self._pin.computeCollision(self._geometry, self._found, pair)
        return touch


def _hulls(geometry: Any) -> Any:
    """A copy of the shapes in which a mesh is its convex hull: tested many times faster, and no smaller."""
    hulls = geometry.copy()
    for shape in hulls.geometryObjects:
        if _is_mesh(shape.geometry) and _is_solid(shape.geometry.vertices()):
            shape.geometry.buildConvexHull(True, "Qt")
            shape.geometry = shape.geometry.convex
    return hulls


def _is_solid(points: Array) -> bool:
    """Whether points [m, 3] have a hull: that of flat ones crashes the library."""
    if not np.isfinite(points).all():
        return False
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return len(extent) == 3 and bool(extent[-1] > _SOLID * extent[0])


def _is_mesh(shape: Any) -> bool:
    return hasattr(shape, "buildConvexHull")


def _is_hull(shape: Any) -> bool:
    """Whether a shape is its own convex hull, nearly: what is no mesh, and a mesh on one side of each of its triangles."""
    if not _is_mesh(shape):
        return True
    if shape.convex is None or shape.convex.num_points < shape.num_vertices:
        return False
    points, triangles = shape.vertices(), map(shape.tri_indices, range(shape.num_tris))
    corners = points[[[triangle[0], triangle[1], triangle[2]] for triangle in triangles]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    height = points @ normal.T - np.einsum("td,td->t", normal, corners[:, 0])
    bulge = np.minimum(height.max(axis=0), -height.min(axis=0)).max()
    return bool(bulge < _BULGE * np.ptp(points, axis=0).max())


def _closeness(model: Any, geometry: Any, chain: Chain, ids: list[int]) -> Mask:
    """What tells at postures [m, n] which pairs of shapes may touch [m, pairs]: those whose bounding spheres do and whose bounding
    boxes do, too, as far as the directions of their edges tell."""
    pairs = np.array([(pair.first, pair.second) for pair in geometry.collisionPairs])
    body, place, half, radius = [], [], [], []
    for shape in geometry.geometryObjects:
        shape.geometry.computeLocalAABB()
        within = shape.geometry.aabb_local
        centre = np.eye(4)
        centre[:3, 3] = shape.geometry.aabb_center
        body.append(ids.index(shape.parentJoint) + 1 if shape.parentJoint in ids else 0)
        place.append(shape.placement.homogeneous @ centre)
        half.append((within.max_ - within.min_) / 2)
        radius.append(shape.geometry.aabb_radius)
    places, halves = np.array(place), np.array(half)
    reach = np.array(radius)[pairs].sum(axis=1) + _SLACK
    before = np.array([model.jointPlacements[k].homogeneous for k in ids])
    frames_at = frames(chain.joints, before)

    def close(q: Array) -> NDArray[np.bool_]:
        at = frames_at(q)[:, body] @ places
        centre = at[..., :3, 3]
        near: NDArray[np.bool_] = ((centre[:, pairs[:, 0]] - centre[:, pairs[:, 1]]) ** 2).sum(axis=2) <= reach**2
        m, pair = np.nonzero(near)
        one, other = pairs[pair].T
        near[m, pair] = _boxes_meet(at[m, one], at[m, other], halves[one], halves[other])
        return near

    return close


def _boxes_meet(one: Array, other: Array, half: Array, other_half: Array) -> NDArray[np.bool_]:
    """Whether boxes meet along each other's edges [m], as all do that touch: frames of their centres [m, 4, 4], half edges [m, 3]."""
    turn, apart = one[:, :3, :3].swapaxes(1, 2) @ other[:, :3, :3], (other - one)[:, None, :3, 3]
    reach = half + (np.abs(turn) @ other_half[..., None])[..., 0] + _SLACK
    other_reach = other_half + (half[:, None] @ np.abs(turn))[:, 0] + _SLACK
    meet = np.abs(apart @ one[:, :3, :3])[:, 0] <= reach
    meet &= np.abs(apart @ other[:, :3, :3])[:, 0] <= other_reach
    return np.asarray(meet.all(axis=1))
