"""Whether an arm touches itself: the same answer whatever was asked before, and nothing on standard error."""

from __future__ import annotations

import struct
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from arms import _FILES, arm

from symgen.collision import SelfCollision
from symgen.feasible import Feasible
from symgen.quiet import quiet
from symgen.urdf import load_chain


def test_what_was_asked_before_does_not_matter() -> None:
    """Along a path, cylinder beside cylinder on the z1: guesses kept from the posture before miss a third of the touches."""
    chain = arm("z1")
    touches = SelfCollision(chain, _FILES["z1"])
    steps = 0.05 * np.random.default_rng(0).normal(size=(1800, chain.n))
    path = np.clip(np.cumsum(steps, axis=0) % (2 * np.pi) - np.pi, *chain.limits.T)
    along = touches(path)
    assert 0.1 < along.mean() < 0.9
    assert np.array_equal(along, touches(path[::-1])[::-1])
    shuffled = np.random.default_rng(1).permutation(len(path))
    assert np.array_equal(along[shuffled], touches(path[shuffled]))


SLIDING = """<robot name="r">
 <link name="world"/><link name="base">{box}</link><link name="a">{ball}</link><link name="b">{box}</link><link name="c">{ball}</link>
 <joint name="fixed" type="fixed"><parent link="world"/><child link="base"/><origin xyz="0.3 -0.2 0.1" rpy="0.4 0.2 0.1"/></joint>
 <joint name="j1" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0.1 0 0.2" rpy="0 0.3 0"/><axis xyz="0 0.6 0.8"/>
  <limit lower="-3" upper="3" effort="9" velocity="1"/></joint>
 <joint name="j2" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0.1 0.05 0" rpy="0.2 0 0.7"/><axis xyz="0.8 0 0.6"/>
  <limit lower="-0.6" upper="0.6" effort="9" velocity="1"/></joint>
 <joint name="j3" type="continuous"><parent link="b"/><child link="c"/><origin xyz="0.2 0 0"/><axis xyz="0 1 0"/></joint>
</robot>""".format(
    box='<collision><origin xyz="0.05 0 0"/><geometry><box size="0.3 0.1 0.1"/></geometry></collision>{0}',
    ball='<collision><origin xyz="0 0.1 0"/><geometry><sphere radius="0.1"/></geometry></collision>{0}',
).replace("{0}", "<inertial><mass value='1'/><inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial>")


def test_pairs_left_out_because_they_are_far_apart_do_not_touch(tmp_path: Path) -> None:
    """Against a test of every pair at every posture, on an arm with a slide and a base beside its world."""
    pin = pytest.importorskip("pinocchio")
    path = tmp_path / "r.urdf"
    path.write_text(SLIDING)
    chain = load_chain(path)
    assert chain.names == ("j1", "j2", "j3")
    model = pin.buildModelFromXML(SLIDING)
    geometry = pin.buildGeomFromUrdfString(model, SLIDING, pin.GeometryType.COLLISION)
    shapes = geometry.geometryObjects
    for a, b in combinations(range(len(shapes)), 2):
        one, two = shapes[a].parentJoint, shapes[b].parentJoint
        if model.parents[one] != two and model.parents[two] != one:
            geometry.addCollisionPair(pin.CollisionPair(a, b))
    assert len(geometry.collisionPairs) == 3
    q = np.random.default_rng(0).uniform([-3, -0.6, -3], [3, 0.6, 3], (400, 3))
    expected = []
    for row in q:
        full = np.array([row[0], row[1], np.cos(row[2]), np.sin(row[2])])
        expected.append(pin.computeCollisions(model, model.createData(), geometry, geometry.createData(), full, True))
    found = SelfCollision(chain, path)(q)
    assert 0.05 < found.mean() < 0.95
    assert np.array_equal(found, expected)


SIDE = """<link name="side"><collision><geometry><sphere radius="0.2"/></geometry></collision></link>
 <joint name="side" type="{0}"><parent link="a"/><child link="side"/><origin xyz="0.3 0.1 0"/>
  <limit lower="-1" upper="1" effort="9" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize("kind", ["floating", "planar", "continuous", "prismatic"])
def test_a_joint_of_any_kind_beside_the_arm_may_carry_shapes(tmp_path: Path, kind: str) -> None:
    """A ball that stands on link a is hit where the same ball, fixed to it, is."""
    path, found = tmp_path / "r.urdf", []
    q = np.random.default_rng(0).uniform([-3, -0.6, -3], [3, 0.6, 3], (400, 3))
    for one in ("fixed", kind):
        path.write_text(SLIDING.replace("</robot>", SIDE.format(one)))
        touches = SelfCollision(load_chain(path, tip="c"), path)
        assert touches.note == "tested with 5 collision shapes"
        found.append(touches(q))
    assert 0.05 < found[0].mean() < 0.95 and np.array_equal(*found)


@pytest.mark.parametrize(
    ("hostile", "note"),
    [("a\there", "tested with 4 collision shapes"), ("universe", "not tested: Pinocchio reads no joint 'universe'")],
)
def test_names_that_mean_something_else_elsewhere(tmp_path: Path, hostile: str, note: str) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(SLIDING.replace('"j2"', f'"{hostile}"'))
    touches = SelfCollision(load_chain(path), path)
    assert touches.note == note and touches(np.zeros((2, 3))).shape == (2,)


def test_what_a_library_prints_by_itself_is_not_seen(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pin = pytest.importorskip("pinocchio")
    noisy = '<robot name="r"><link name="a"><visual><geometry><box size="x"/></geometry></visual></link></robot>'
    pin.buildModelFromXML(noisy)
    assert capfd.readouterr().err, "urdfdom has something to say"
    with quiet():
        pin.buildModelFromXML(noisy)
    assert not capfd.readouterr().err
    with pytest.raises(RuntimeError, match="as it was"), quiet():
        raise RuntimeError("as it was")
    pin.buildModelFromXML(noisy)
    assert capfd.readouterr().err, "and is heard again"


def stl(path: Path, triangles: np.ndarray) -> None:
    """A binary STL file of triangles [t, 3 corners, 3]."""
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *corners.ravel(), 0) for corners in triangles)
    path.write_bytes(bytes(80) + struct.pack("<I", len(triangles)) + body)


def boxes(*corners: tuple[tuple[float, float, float], tuple[float, float, float]]) -> np.ndarray:
    """The triangles of some boxes, each between two corners."""
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    out = []
    for low, high in corners:
        points = np.array([[(low, high)[i >> b & 1][b] for b in range(3)] for i in range(8)])
        out += [points[[q[0], q[k], q[k + 1]]] for q in quads for k in (1, 2)]
    return np.array(out)


U_SHAPE = boxes(
    ((-0.3, -0.1, 0), (-0.2, 0.1, 0.5)), ((0.2, -0.1, 0), (0.3, 0.1, 0.5)), ((-0.3, -0.1, -0.1), (0.3, 0.1, 0))
)
FLAT = np.array([[[-0.1, 0, 0], [0.1, 0, 0], [0, 0.0, 0.2]]])
BAR = boxes(((-0.05, -0.05, -0.05), (0.05, 0.05, 0.05)))

PLUNGING = """<robot name="r">
 <link name="base">{0}<collision><geometry><mesh filename="a.stl"/></geometry></collision></link><link name="a">{0}</link>
 <link name="b">{0}<collision><geometry><mesh filename="b.stl"/></geometry></collision></link>
 <joint name="j1" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
  <limit lower="0" upper="1" effort="9" velocity="1"/></joint>
 <joint name="j2" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>
  <limit lower="-0.5" upper="0.5" effort="9" velocity="1"/></joint>
</robot>""".replace(
    "{0}", "<inertial><mass value='1'/><inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial>"
)


@pytest.mark.parametrize(("held", "solid"), [(U_SHAPE, True), (FLAT, False)])
def test_a_mesh_is_not_its_hull(tmp_path: Path, held: np.ndarray, solid: bool) -> None:
    """A bar plunges into a U, where the hull of the U says touch; and through a sheet, which has no hull."""
    pytest.importorskip("pinocchio")
    path = tmp_path / "r.urdf"
    path.write_text(PLUNGING)
    stl(tmp_path / "a.stl", held)
    stl(tmp_path / "b.stl", BAR)
    touches = SelfCollision(load_chain(path), path)
    assert touches.note == "tested with 2 collision shapes"
    z, x = np.meshgrid(np.linspace(0.01, 0.99, 30), np.linspace(-0.49, 0.49, 40))
    found = touches(np.column_stack([z.ravel(), x.ravel()])).reshape(z.shape)
    if solid:
        expected = ((z < 0.05) & (np.abs(x) < 0.35)) | ((z < 0.55) & (np.abs(np.abs(x) - 0.25) < 0.1))
    else:  # the triangle at height h reaches to 0.1 - h / 2 on either side
        expected = (z < 0.25) & (np.abs(x) < 0.05 + 0.1 - np.maximum(z - 0.05, 0) / 2)
    assert np.array_equal(found, expected)


def test_shapes_that_touch_wherever_the_joints_stand_are_no_test(tmp_path: Path) -> None:
    """They overlap by construction: none is left to be tested."""
    ball = '<collision><geometry><sphere radius="1"/></geometry></collision>'
    body = '<inertial><origin xyz="0.1 0 0"/><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    joints = "".join(
        f'<joint name="j{k}" type="continuous"><parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="0 0 1"/></joint>'
        for k in range(2)
    )
    path = tmp_path / "balls.urdf"
    path.write_text(
        f'<robot name="r"><link name="l0">{ball}</link><link name="l1">{body}</link><link name="l2">{ball}{body}</link>{joints}</robot>'
    )
    touches = SelfCollision(load_chain(path), path)
    assert not touches(np.zeros((3, 2))).any()


def test_what_touches_behind_a_joint_touches_wherever_that_joint_and_those_before_it_are() -> None:
    chain, rng = arm("ur5"), np.random.default_rng(0)
    feasible = Feasible(chain, _FILES["ur5"], np.inf, np.zeros(3))
    q = rng.uniform(*chain.limits.T, (600, chain.n))
    joint = rng.integers(0, chain.n, len(q))
    hopeless = feasible.hopeless(q, joint)
    assert 0.05 < hopeless.mean() < 0.95 * feasible.touches(q).mean()
    moved = np.where(np.arange(chain.n) <= joint[:, None], rng.uniform(*chain.limits.T, q.shape), q)
    assert not feasible(moved[hopeless]).any() and feasible(moved[~hopeless & feasible.touches(q)]).any()
