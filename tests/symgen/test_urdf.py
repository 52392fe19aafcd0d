"""A Chain equals the robot its URDF describes, by pinocchio's and yourdfpy's reading; bad input ends in one line."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from arms import model_of

from symgen.angles import about
from symgen.chain import REVOLUTE, Chain, Joint
from symgen.errors import UrdfError
from symgen.urdf import load_chain, parse_chain, turned, with_arm

ROBOTS = Path(pin.__file__).parents[4] / "share/example-robot-data/robots"
YPP3 = Path(__file__).parents[2] / "robots/ypp3/ypp3.urdf"
# Both sides sum the same few dozen products in another order.
ROUNDING = 1e-12


# Judges --------------------------------------------------------------------------------------------------------------


def with_full_pi(text: str) -> str:
    """The URDF with angles that are a rounded multiple of pi/12 (within 1e-9 rad) written in full, for a fair judge."""

    def full(match: re.Match[str]) -> str:
        step = np.pi / 12
        angles = (float(word) for word in match[2].split())
        exact = (step * round(a / step) if abs(a - step * round(a / step)) < 1e-9 else a for a in angles)
        return f'{match[1]}"{" ".join(repr(float(a)) for a in exact)}"'

    return re.sub(r'(rpy\s*=\s*)"([^"$]*)"', full, text)


def configuration(model: pin.Model, values: dict[str, float]) -> np.ndarray:
    q = pin.neutral(model)
    for name, value in values.items():
        joint = model.joints[model.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
    return q


def inertia_matrix(model: pin.Model, values: dict[str, float]) -> np.ndarray:
    """The rows and columns of the joints named in `values`, by pinocchio; every other joint stands at neutral."""
    M = pin.crba(model, model.createData(), configuration(model, values))
    index = [model.joints[model.getJointId(name)].idx_v for name in values]
    return (np.triu(M) + np.triu(M, 1).T)[np.ix_(index, index)]


def disagreement(chain: Chain, judge: pin.Model, q: np.ndarray, frozen: dict[str, float] | None = None) -> float:
    """Largest |M - M_judge| of the chain's joints at q, entry by entry relative to sqrt(M_ii M_jj)."""
    values = dict(zip(chain.names, map(float, q), strict=True))
    ours = inertia_matrix(model_of(chain), values)
    theirs = inertia_matrix(judge, {**values, **(frozen or {})})[: chain.n, : chain.n]
    scale = np.sqrt(np.diag(theirs))
    return float(np.max(np.abs(ours - theirs) / np.outer(scale, scale)))


def random_q(chain: Chain, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(chain.limits[:, 0], chain.limits[:, 1])


# Vendors' arms -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Vendor:
    file: str
    n: int
    tip: str | None = None
    base: str | None = None
    at: dict[str, float] = field(default_factory=dict)


VENDORS = [
    Vendor("ur_description/urdf/ur3_robot.urdf", 6),
    Vendor("ur_description/urdf/ur5_robot.urdf", 6),
    Vendor("ur_description/urdf/ur5_gripper.urdf", 6),
    Vendor("ur_description/urdf/ur10_robot.urdf", 6),
    Vendor("panda_description/urdf/panda.urdf", 7),
    Vendor("panda_description/urdf/panda.urdf", 7, at={"panda_finger_joint1": 0.04, "panda_finger_joint2": 0.01}),
    Vendor("panda_description/urdf/panda.urdf", 8, tip="panda_leftfinger"),
    Vendor("panda_description/urdf/panda.urdf", 4, base="panda_link2", at={"panda_joint5": -1.1}),
    Vendor("xarm_description/urdf/xarm7.urdf", 7),
    Vendor("kinova_description/robots/kinova.urdf", 6),
    Vendor("z1_description/urdf/z1.urdf", 7),
    Vendor("so_arm_description/urdf/so100.urdf", 6),
    Vendor("so_arm_description/urdf/so101.urdf", 6),
    Vendor("talos_data/robots/talos_left_arm.urdf", 7),
    Vendor("talos_data/robots/talos_full_v2.urdf", 7, base="torso_2_link", tip="gripper_left_base_link"),
    Vendor("baxter_description/urdf/baxter.urdf", 7, tip="left_gripper_base_link"),
    Vendor("tiago_description/robots/tiago_no_hand.urdf", 8),
    Vendor("anymal_b_simple_description/robots/anymal-kinova.urdf", 6),
    Vendor("b1_description/urdf/b1-z1.urdf", 7),
    Vendor("pr2_description/urdf/pr2.urdf", 7, base="torso_lift_link", tip="l_gripper_palm_link"),
]


@pytest.mark.parametrize("vendor", VENDORS, ids=lambda v: f"{Path(v.file).stem}-{v.n}")
def test_a_vendors_arm_has_pinocchios_inertia_matrix(vendor: Vendor) -> None:
    chain = load_chain(ROBOTS / vendor.file, base=vendor.base, tip=vendor.tip, at=vendor.at, snap=False)
    judge = pin.buildModelFromXML(with_full_pi(chain.source))
    assert chain.n == vendor.n
    assert {name: chain.frozen[name] for name in vendor.at} == vendor.at
    rng = np.random.default_rng(7)
    assert max(disagreement(chain, judge, random_q(chain, rng), chain.frozen) for _ in range(4)) < ROUNDING


@pytest.mark.parametrize(
    ("file", "base", "tip"),
    [
        ("ur_description/urdf/ur5_robot.urdf", "world", "ee_link"),
        ("tiago_description/robots/tiago_no_hand.urdf", "torso_fixed_link", "arm_7_link"),  # prismatic, then 7 axes
    ],
)
def test_link_frames_are_where_yourdfpy_puts_them(file: str, base: str, tip: str) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    chain = load_chain(ROBOTS / file, base=base, tip=tip, snap=False)
    judge = yourdfpy.URDF.load(str(ROBOTS / file), load_meshes=False, build_collision_scene_graph=False)
    q = random_q(chain, np.random.default_rng(3))
    judge.update_cfg(dict(zip(chain.names, q, strict=True)))
    R, p = np.eye(3), np.zeros(3)
    for joint, value in zip(chain.joints, q, strict=True):
        R, p = R @ joint.R, p + R @ joint.p
        R, p = (R @ about(joint.axis, value, 0.0), p) if joint.type == REVOLUTE else (R, p + R @ joint.axis * value)
        seen = judge.get_transform(joint.link, base)
        # 1e-9: the file's pi/2 = 1.57079632679 is 5e-12 off and taken literally by the judge
        np.testing.assert_allclose(np.column_stack([R, p]), seen[:3], atol=1e-9)


def test_snapping_leaves_only_zeros_and_ones_in_a_right_angled_arm_and_says_what_it_moved() -> None:
    file = ROBOTS / "xarm_description/urdf/xarm7.urdf"  # writes pi/2 as 1.5708
    literal, snapped = load_chain(file, snap=False), load_chain(file)
    assert literal.snapped == ()
    assert {(s.joint, s.found, s.text) for s in snapped.snapped} == {
        (f"joint{i}", sign * 1.5708, "-pi/2" if sign < 0 else "pi/2")
        for i, sign in enumerate((-1, 1, 1, 1, 1, -1), start=2)
    }
    for ours, theirs in zip(snapped.joints, literal.joints, strict=True):
        assert set(np.unique(ours.R)) <= {-1.0, 0.0, 1.0}
        assert set(np.unique(ours.axis)) <= {-1.0, 0.0, 1.0}
        np.testing.assert_array_equal(
            ours.inertia.parameters, theirs.inertia.parameters
        )  # no mass, no length is touched
        assert np.linalg.norm(ours.p) == np.linalg.norm(theirs.p)
    moved = sum(abs(s.found - s.snapped) for s in snapped.snapped)
    change = disagreement(snapped, model_of(literal), random_q(literal, np.random.default_rng(1)))
    assert (
        0.0 < change < 10 * moved
    )  # a frame turned by d changes an entry by some d, through levers no longer than the arm


# Made-up robots ------------------------------------------------------------------------------------------------------


BODY = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'


def robot(*joints: str, body: str = BODY) -> str:
    """A URDF from lines "name type parent child [extra XML]"; every link has the same body."""
    words = [joint.split(maxsplit=4) for joint in joints]
    links = dict.fromkeys(link for _, _, parent, child, *_ in words for link in (parent, child))
    return "\n".join(
        [
            "<robot>",
            *(f'<link name="{link}">{body}</link>' for link in links),
            *(
                f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
                f"{''.join(extra)}</joint>"
                for name, kind, parent, child, *extra in words
            ),
            "</robot>",
        ]
    )


def arm(n: int) -> list[str]:
    return [f"j{i} revolute l{i - 1} l{i}" for i in range(1, n + 1)]


def random_tree(rng: np.random.Generator) -> tuple[str, str, dict[str, float]]:
    """A tree of 12 links with random joints and bodies; returns (URDF, a leaf's name, values of all moving joints)."""

    def numbers(scale: float, size: int = 3) -> str:
        return " ".join(repr(float(x)) for x in rng.uniform(-scale, scale, size))

    links, joints, values = [], [], {}
    for i in range(12):
        a = rng.uniform(0.1, 1.0, 3)  # second moments along the principal axes: any such body exists
        moments = (a[1] + a[2], a[0] + a[2], a[0] + a[1])
        links.append(
            f'<link name="l{i}"><inertial><origin xyz="{numbers(0.3)}" rpy="{numbers(3)}"/>'
            f'<mass value="{rng.uniform(0.5, 5)}"/>'
            f'<inertia ixx="{moments[0]}" ixy="0" ixz="0" iyy="{moments[1]}" iyz="0" izz="{moments[2]}"/>'
            "</inertial></link>"
        )
        if i:
            kind = str(rng.choice(["revolute", "prismatic", "continuous", "fixed"], p=[0.4, 0.2, 0.2, 0.2]))
            joints.append(
                f'<joint name="j{i}" type="{kind}">'
                f'<parent link="l{rng.integers(max(0, i - 3), i)}"/><child link="l{i}"/>'
                f'<origin xyz="{numbers(0.5)}" rpy="{numbers(3)}"/><axis xyz="{numbers(1)}"/>'
                '<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
            )
            if kind != "fixed":
                values[f"j{i}"] = float(rng.uniform(-2, 2))
    return f"<robot name='tree'>{''.join(links)}{''.join(joints)}</robot>", "l11", values


@pytest.mark.parametrize("seed", range(20))
def test_whatever_moves_off_the_chain_is_lumped_where_it_stands(seed: int) -> None:
    text, tip, values = random_tree(np.random.default_rng(seed))
    judge = pin.buildModelFromXML(text)
    probe = parse_chain(text, tip=tip)
    chain = parse_chain(text, tip=tip, at={name: values[name] for name in probe.frozen})
    assert chain.names == probe.names
    assert chain.frozen == {name: values[name] for name in values if name not in chain.names}
    assert disagreement(chain, judge, np.array([values[name] for name in chain.names]), chain.frozen) < ROUNDING
    assert sum(j.inertia.mass for j in chain.joints) <= sum(i.mass for i in judge.inertias) * (1 + ROUNDING)


def test_what_lies_before_the_base_is_dropped() -> None:
    chain = parse_chain(robot(*arm(4), "side revolute l1 s"), base="l1", tip="l4")
    assert (chain.names, chain.base_link, chain.frozen) == (("j2", "j3", "j4"), "l1", {"side": 0.0})
    assert chain.lumped == ()  # the side branch rides on the base, which does not move


GRIPPER = ["finger prismatic l3 f1", 'other prismatic l3 f2 <mimic joint="finger" multiplier="-2" offset="0.1"/>']
MIMIC_OF_J2 = '<mimic joint="j2"/>'


@pytest.mark.parametrize(
    ("joints", "names", "tip"),
    [
        ([*arm(3), *GRIPPER], ("j1", "j2", "j3"), "l3"),
        (
            [*arm(3), "palm fixed l3 p", "a revolute p a1", "b revolute p b1", "c revolute p c1"],
            ("j1", "j2", "j3"),
            "p",
        ),
        ([*arm(3), f"slave revolute l3 s {MIMIC_OF_J2}"], ("j1", "j2", "j3"), "l3"),
        ([*arm(3), "finger prismatic l3 f1"], ("j1", "j2", "j3", "finger"), "f1"),  # one jaw: a joint like any other
        # A rod of a linkage is no finger, whether its joint follows one further down or the one it sits on.
        ([*arm(6), f"rod revolute l4 r {MIMIC_OF_J2}"], tuple(f"j{i}" for i in range(1, 7)), "l6"),
        ([*arm(6), 'rod revolute l4 r <mimic joint="j4"/>'], tuple(f"j{i}" for i in range(1, 7)), "l6"),
        (["w fixed world l0", *arm(2), "cam fixed l1 c", "tool fixed l2 t1", "tcp fixed t1 t2"], ("j1", "j2"), "t2"),
        (["wheel continuous l0 w", *arm(3), "neck revolute l1 head"], ("j1", "j2", "j3"), "l3"),  # the longest run
    ],
)
def test_the_arm_ends_before_its_gripper(joints: list[str], names: tuple[str, ...], tip: str) -> None:
    chain = parse_chain(robot(*joints))
    assert (chain.names, chain.tip_link) == (names, tip)


def test_a_joint_that_mimics_stands_where_its_master_stands() -> None:
    assert parse_chain(robot(*arm(3), *GRIPPER)).frozen == {"finger": 0.0, "other": 0.1}
    assert parse_chain(robot(*arm(3), *GRIPPER), at={"finger": 0.5}).frozen == {"finger": 0.5, "other": -0.9}
    assert parse_chain(robot(*arm(3), *GRIPPER), at={"other": 0.3}).frozen == {"finger": 0.0, "other": 0.3}


def test_at_freezes_joints_of_the_arm_but_does_not_change_where_it_ends() -> None:
    mimicking = robot("j1 revolute a b", 'j2 revolute b c <mimic joint="j1"/>', "j3 revolute c d")
    chain = parse_chain(mimicking, at={"j2": 0.2})  # frozen by hand, so it mimics no more
    assert (chain.names, chain.frozen, chain.tip_link) == (("j1", "j3"), {"j2": 0.2}, "d")
    chain = parse_chain(robot(*arm(3), *GRIPPER), at={"j3": 0.1})
    assert (chain.names, chain.tip_link) == (("j1", "j2"), "l3")


def test_zero_outside_the_limits_is_clamped_into_them() -> None:
    side = 'side revolute l1 s <limit lower="0.4" upper="2" effort="0" velocity="0"/>'
    assert parse_chain(robot(*arm(3), side)).frozen == {"side": 0.4}


def test_a_long_run_of_fixed_links_is_one_body() -> None:
    long = [f"f{i} fixed {'l2' if i == 0 else f'x{i - 1}'} x{i}" for i in range(900)]
    chain = parse_chain(robot(*arm(2), *long))
    assert chain.joints[-1].inertia.mass == 901.0
    assert (chain.tip_link, len(chain.lumped)) == ("x899", 900)


def limited(limit: str, kind: str = "revolute") -> Joint:
    return parse_chain(robot(f"j {kind} a b {limit}")).joints[0]


def test_limits_are_infinite_where_the_file_states_none() -> None:
    inf = np.inf
    stated = limited('<limit lower="-1" upper="2" effort="3" velocity="4"/>')
    assert (stated.lower, stated.upper, stated.effort) == (-1.0, 2.0, 3.0)
    for unstated in (
        limited(""),
        limited('<limit effort="0" velocity="0"/>'),
        limited('<limit lower="0" upper="0" effort="0" velocity="0"/>'),  # what an exporter leaves blank
        limited('<limit lower="-1e16" upper="1e16" effort="1e10" velocity="1e16"/>'),
        limited('<limit lower="-1" upper="1" effort="0" velocity="0"/>', "continuous"),
    ):
        assert (unstated.lower, unstated.upper, unstated.effort) == (-inf, inf, inf)


def test_axes_become_unit_vectors_and_near_coordinate_axes_exact_ones() -> None:
    tilted = parse_chain(robot('j revolute a b <axis xyz="0 -2 4e-5"/>'))
    np.testing.assert_array_equal(tilted.joints[0].axis, [0.0, -1.0, 0.0])
    (snap,) = tilted.snapped
    assert (snap.joint, snap.found, snap.text) == ("j", pytest.approx(2e-5), "axis -y")
    oblique = parse_chain(robot('j revolute a b <axis xyz="0.6 0 -0.8"/>'))
    assert oblique.snapped == ()
    np.testing.assert_allclose(oblique.joints[0].axis, [0.6, 0.0, -0.8], rtol=1e-15)


def test_a_chain_carries_its_source_and_that_reads_back_the_same() -> None:
    chain = load_chain(YPP3)
    assert chain.sha256 == hashlib.sha256(YPP3.read_bytes()).hexdigest()
    again = parse_chain(chain.source)
    assert (again.sha256, again.name, again.names) == (chain.sha256, "ypp3", ("joint1", "joint2", "joint3"))
    np.testing.assert_array_equal(again.parameters, chain.parameters)


@pytest.mark.parametrize(
    ("text", "choice"),
    [
        (robot("j revolute a b"), {}),
        (robot("one revolute a b", "two revolute b c", "three revolute c d"), {"at": {"two": 0.3}}),
        (robot("one revolute a b", "two revolute b c", "three revolute c d"), {"base": "b", "tip": "c"}),
        (robot("one revolute a b", "two revolute b c", "three revolute c d"), {"base": "b", "at": {"one": 0.2, "three": 0.1}}),
        (robot("left revolute a b", "right revolute a c"), {"tip": "c", "at": {"left": -0.25}}),
        (robot("free floating world a", "one revolute a b", "two prismatic b c"), {"base": "a"}),
        (robot("one revolute a b", "two revolute b c").replace('"two"', '"two &amp; &quot;\'"'), {"at": {"two & \"'": 0.2}}),
        (robot("one revolute a b", "two revolute b c", "half revolute c d").replace("</robot>", "<!-- </robot> --></robot>"),
         {"at": {"half": 0.1}}),
    ],
)  # fmt: skip
def test_a_text_with_its_arm_reads_back_the_same_arm(text: str, choice: dict[str, Any]) -> None:
    chain = parse_chain(text, **choice)
    again = parse_chain(with_arm(chain))
    assert (with_arm(chain) == text) == (not choice)
    assert (again.names, again.base_link, again.tip_link, again.frozen) == (
        chain.names, chain.base_link, chain.tip_link, chain.frozen,
    )  # fmt: skip
    np.testing.assert_array_equal(again.parameters, chain.parameters)
    assert with_arm(again) == again.source


def test_who_chooses_an_arm_himself_is_heard() -> None:
    text = with_arm(parse_chain(robot("one revolute a b", "two revolute b c"), at={"two": 0.3}))
    assert parse_chain(text, tip="c").names == ("one", "two")
    with pytest.raises(UrdfError, match="<symgen>: <at>: found .much."):
        parse_chain(text.replace('value="0.3"', 'value="much"'))


def test_what_a_caller_leaves_open_is_as_the_text_means_it() -> None:
    text = with_arm(parse_chain(robot(*arm(5), "side revolute l2 s"), base="l1", tip="l4", at={"j3": 0.3, "side": 0.1}))

    def read(**choice: Any) -> tuple[str, tuple[str, ...], dict[str, float]]:
        chain = parse_chain(text, **choice)
        return chain.base_link, chain.names, chain.frozen

    assert read() == ("l1", ("j2", "j4"), {"j3": 0.3, "j5": 0.0, "side": 0.1})
    assert read(at={"j4": 0.2}) == ("l1", ("j2",), {"j3": 0.3, "j4": 0.2, "j5": 0.0, "side": 0.1})
    assert read(at={"j3": 0.2}) == ("l1", ("j2", "j4"), {"j3": 0.2, "j5": 0.0, "side": 0.1})
    # who names an end of the arm means its joints to move
    assert read(tip="l3") == ("l1", ("j2", "j3"), {"j4": 0.0, "j5": 0.0, "side": 0.1})
    assert read(base="l2") == ("l2", ("j3", "j4"), {"j5": 0.0, "side": 0.1})
    assert read(base="l4") == ("l4", ("j5",), {"j3": 0.3}), "its tip is not behind this base"
    assert read(tip="l1") == ("l0", ("j1",), {"j2": 0.0, "j3": 0.3, "j4": 0.0, "j5": 0.0, "side": 0.1})


@pytest.mark.parametrize("seed", range(4))
def test_a_vector_is_turned_from_one_link_to_another_as_pinocchio_does(seed: int) -> None:
    text, tip, values = random_tree(np.random.default_rng(seed))
    last = parse_chain(text, tip=tip).names[-1]  # it alone moves: all others stand before it, or beside
    base = re.search(rf'name="{last}".*?<parent link="(l\d+)"', text)
    assert base
    chain = parse_chain(text, base=base[1], tip=tip, at={name: q for name, q in values.items() if name != last})
    model, v = pin.buildModelFromXML(text), np.array([0.3, -0.5, 0.8])
    data = model.createData()
    pin.framesForwardKinematics(model, data, configuration(model, chain.frozen))
    root, first, other = (np.array(data.oMf[model.getFrameId(link)].rotation) for link in ("l0", base[1], "l3"))
    assert turned(chain, v) == pytest.approx(first.T @ root @ v, abs=ROUNDING)
    assert turned(chain, v, "l3") == pytest.approx(first.T @ other @ v, abs=ROUNDING)
    with pytest.raises(UrdfError, match="base link 'l99' does not exist"):
        turned(chain, v, "l99")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1", "windows-1252"])
def test_text_encodings_and_odd_names(tmp_path: Path, encoding: str) -> None:
    text = robot("j revolute a b").replace('"j"', '"Gelenk Größe 1"').replace("<robot>", "<!-- é --><robot>")
    declared = "utf-8" if encoding == "utf-8-sig" else encoding
    (tmp_path / "name of file.urdf").write_bytes(f'<?xml version="1.0" encoding="{declared}"?>{text}'.encode(encoding))
    chain = load_chain(tmp_path / "name of file.urdf")
    assert (chain.names, chain.name) == (("Gelenk Größe 1",), "name of file")


def test_simulator_extras_are_ignored() -> None:
    again = '<link name="l1"><inertial/></link><joint name="j1"/>'
    extras = f"<gazebo>{again}</gazebo><transmission>{again}</transmission>"
    namespace = '<robot xmlns:xacro="http://ros.org/wiki/xacro" xmlns="http://drake.mit.edu">'
    chain = parse_chain(robot(*arm(2)).replace("<robot>", namespace + extras))
    assert chain.names == ("j1", "j2")


# Bad input -----------------------------------------------------------------------------------------------------------


def replaced(old: str, new: str, text: str = YPP3.read_text()) -> str:
    assert old in text
    return text.replace(old, new, 1)


BOMB = '<!DOCTYPE robot [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><robot name="&b;"/>'
LINK2_MASS, LINK2_I = 'mass value="7.4"', 'ixx="0.03009"'
AXIS, LIMIT = '<axis xyz="0 0 1"/>', 'lower="-2.6" upper="2.6"'
POINT = '<inertial><mass value="1"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>'
SAME_AS_J = '<mimic joint="j"/>'

BAD_TEXT = {
    "empty": ("", "empty"),
    "blank": ("\ufeff \n", "empty"),
    "no XML": ("robot: ypp3", "not well-formed XML.*line 1"),
    "truncated": (YPP3.read_text()[:1500], "not well-formed XML"),
    "null character": ("<robot>\0</robot>", "not well-formed XML"),
    "lone surrogate": ("<robot name='\ud800'/>", "surrogate"),
    "another format": ("<sdf version='1.6'/>", "<sdf>; expected <robot>"),
    "entity bomb": (BOMB, "DOCTYPE"),
    "external entity": ('<!DOCTYPE robot SYSTEM "file:///etc/passwd"><robot/>', "DOCTYPE"),
    "XML too deep": ("<robot>" + "<a>" * 100_000, "nested deeper than 200"),
    "xacro macro": ('<robot><xacro:macro name="m"/></robot>', "xacro FILE > out.urdf"),
    "xacro expression": (replaced('xyz="0 0 0.15"', 'xyz="0 0 ${height / 2}"'), r"joint2.*xacro FILE > out.urdf"),
    "no link": ("<robot/>", "no <link>"),
    "two links of one name": (replaced('link name="link2"', 'link name="link1"'), "two links are named 'link1'"),
    "two joints of one name": (replaced('joint name="joint2"', 'joint name="joint1"'), "two joints are named 'joint1'"),
    "link without name": (replaced('<link name="link2">', "<link>"), "<link> number 3: <link> has no attribute 'name'"),
    "empty name": (replaced('joint name="joint2"', 'joint name=" "'), "<joint> number 2: the name is empty"),
    "joint without type": (replaced(' type="revolute"', ""), "'joint1': <joint> has no attribute 'type'"),
    "unknown type": (replaced('"revolute"', '"Revolute"'), "'joint1': type 'Revolute'; expected one of revolute"),
    "joint without parent": (replaced('<parent link="link1"/>', ""), "'joint2': <parent> is missing"),
    "joint without child": (replaced('<child link="link2"/>', ""), "'joint2': <child> is missing"),
    "two children": (
        replaced('<child link="link2"/>', '<child link="link2"/><child link="link3"/>'),
        "2 <child> elements",
    ),
    "unknown link": (
        replaced('child link="link2"', 'child link="nowhere"'),
        "'joint2': <child> names the link 'nowhere'",
    ),
    "two parents": (replaced('child link="link3"', 'child link="link1"'), "'link1' is the child of two joints"),
    "two roots": (robot("j revolute a b", "k revolute c d"), "2 links have no parent joint: 'a', 'c'"),
    "circle": (robot("j revolute a b", "k revolute b a"), "circle through link 'a'"),
    "circle beside the tree": (
        robot("j revolute r s", "k revolute a b", "l revolute b a"),
        "circle through link '[ab]'",
    ),
    "joint onto itself": (robot("j revolute r s", "k revolute a a"), "circle through link 'a'"),
    "nan": (
        replaced(LINK2_MASS, 'mass value="nan"'),
        "link 'link2': <inertial> mass: found 'nan', expected a finite number",
    ),
    "inf": (replaced('xyz="0 0.35 0"', 'xyz="0 inf 0"'), "'joint3': <origin> xyz: found 'inf', expected a finite"),
    "overflow": (replaced(LINK2_MASS, 'mass value="1e999"'), "'link2'.*mass: found '1e999', expected at most 1e\\+06"),
    "milli-units": (replaced(LINK2_I, 'ixx="30090000"'), "'link2'.*ixx: found '30090000', expected at most 1e\\+06"),
    "no number": (replaced(LINK2_MASS, 'mass value="7,4"'), "'link2'.*mass: found '7,4'"),
    "underscores": (replaced(LINK2_MASS, 'mass value="7_4"'), "'link2'.*mass: found '7_4'"),
    "two numbers": (replaced('xyz="0 0.35 0"', 'xyz="0 0.35"'), "'joint3': <origin> xyz: found '0 0.35', expected 3"),
    "four numbers": (replaced('rpy="0 0 0"', 'rpy="0 0 0 1"'), "'joint1': <origin> rpy: found '0 0 0 1', expected 3"),
    "axis of zeros": (replaced(AXIS, '<axis xyz="0 0 0"/>'), "'joint1': <axis> xyz is zero"),
    "axis without xyz": (replaced(AXIS, "<axis/>"), "'joint1': <axis> has no attribute 'xyz'"),
    "limits reversed": (
        replaced(LIMIT, 'lower="2.6" upper="-2.6"'),
        "'joint2': <limit>: lower 2.6 is above upper -2.6",
    ),
    "no room": (replaced(LIMIT, 'lower="1" upper="1"'), "'joint2'.*lower = upper = 1"),
    "limits out of reach": (replaced(LIMIT, 'lower="1e7" upper="1e8"'), "'joint2': <limit>.*expected a range"),
    "limit nan": (replaced(LIMIT, 'lower="nan" upper="2"'), "'joint2': <limit> lower: found 'nan'"),
    "limit inf": (replaced(LIMIT, 'lower="0" upper="1e999"'), "'joint2': <limit> upper: found '1e999'"),
    "negative effort": (replaced('effort="200"', 'effort="-200"'), "'joint1': <limit> effort: found -200"),
    "negative mass": (replaced(LINK2_MASS, 'mass value="-7.4"'), "'link2': <inertial> mass: found -7.4, expected >= 0"),
    "no mass": (replaced("<mass " + LINK2_MASS[5:] + "/>", ""), "'link2': <inertial>: <mass> is missing"),
    "no moment": (replaced('izz="0.02789"', ""), "'link2': <inertial>: <inertia> has no attribute 'izz'"),
    "two inertials": (replaced("<inertial>", POINT + "<inertial>"), "'base_link': 2 <inertial> elements"),
    "no rigid body": (
        replaced(LINK2_I, 'ixx="0.3009"'),
        "'link2': <inertial>: principal moments 0.004, 0.02789, 0.3009 kg m2",
    ),
    "negative moment": (replaced(LINK2_I, 'ixx="-0.03009"'), "'link2': <inertial>: principal moments -0.03009"),
    "product too large": (
        replaced('ixy="0" ixz="0" iyy="0.004"', 'ixy="0.03" ixz="0" iyy="0.004"'),
        "'link2'.*principal",
    ),
    "massless link": (replaced(LINK2_MASS, 'mass value="0"'), "'link2' behind joint 'joint2' is massless"),
    "no inertia anywhere": (robot(*arm(2), body=""), "no link has an <inertial>"),
    "point on the axis": (robot("j revolute a b", body=POINT), "'b' has no inertia about the axis of joint 'j'"),
    "points on the axis": (
        robot("j revolute a b", "k prismatic b c", body=POINT),
        "'b' has no inertia about the axis of joint 'j', .* nor has what it carries",
    ),
    "long name": (replaced('joint name="joint2"', f'joint name="{"j" * 2000}"'), "a name of 2000 characters"),
    "1500 fixed joints in a row": (
        robot(*(f"j{k} fixed l{k} l{k + 1}" for k in range(1500)), "k revolute l1500 x"),
        "link 'l1001' is behind more than 1000 joints",
    ),
    "nothing moves": (robot("j fixed a b"), "no moving joint from 'a' to 'b'"),
    "floating base": (robot("j floating w l0", *arm(2)), "'j' from 'w' to 'l2' is floating"),
    "planar joint": (robot(*arm(2), "p planar l2 x", "k revolute x y"), "'p' from 'l0' to 'y' is planar"),
    "mimic in the arm": (
        robot("j revolute a b", f"k revolute b c {SAME_AS_J}", "l revolute c d"),
        "'k'.* mimics 'j'.*--tip",
    ),
    "mimic in a circle": (robot(*arm(2), f"j revolute l0 x {SAME_AS_J}"), "'j': <mimic> leads back"),
    "65 joints": (robot(*arm(65)), "65 moving joints from 'l0' to 'l65'; expected at most 24"),
    "10 000 joints": (robot(*arm(10_000)), "behind more than 1000 joints"),
    "two arms": (
        robot(
            "neck revolute t n", "l1 revolute t a", "l2 revolute a lefthand", "r1 revolute t b", "r2 revolute b right"
        ),
        "2 arms of 2 moving joints each, ending at 'lefthand', 'right'; choose with --tip",
    ),
}


def message_of(action: Callable[[], object], where: str) -> str:
    with pytest.raises(UrdfError) as caught:
        action()
    message = str(caught.value)
    assert message.startswith(f"{where}: ")
    assert "\n" not in message
    assert len(message) < 1000
    return message


@pytest.mark.parametrize(("text", "expected"), BAD_TEXT.values(), ids=BAD_TEXT)
def test_a_bad_file_is_refused_in_one_line_that_says_where(text: str, expected: str) -> None:
    assert re.search(expected, message_of(lambda: parse_chain(text, where="arm.urdf"), "arm.urdf"))


@pytest.mark.parametrize(
    ("choice", "expected"),
    [
        ({"base": "nowhere"}, "base link 'nowhere' does not exist; links are 'base_link', 'link1', 'link2', 'link3'"),
        ({"tip": "nowhere"}, "tip link 'nowhere' does not exist; links are"),
        ({"base": "link3", "tip": "link1"}, "tip link 'link1' is not behind base link 'link3'"),
        ({"base": "link3"}, "no moving joint from 'link3' to 'link3'"),
        ({"at": {"joint9": 0.0}}, "at: no moving joint 'joint9'; moving joints are 'joint1', 'joint2', 'joint3'"),
        ({"at": {"joint2": 3.0}}, r"at: 'joint2' = 3; expected a value within the joint's limits \[-2.6, 2.6\]"),
        ({"at": {"joint2": np.nan}}, "at: 'joint2' = nan; expected a finite number"),
        ({"at": {"joint1": 0.0, "joint2": 0.0, "joint3": 0.0}}, "no moving joint"),
    ],
)
def test_a_choice_that_cannot_be_met_lists_what_exists(choice: dict[str, object], expected: str) -> None:
    assert re.search(expected, message_of(lambda: load_chain(YPP3, **choice), str(YPP3)))  # type: ignore[arg-type]


def test_a_link_before_the_base_or_on_it_need_not_be_a_rigid_body() -> None:
    assert (
        load_chain(ROBOTS / "tiago_description/robots/tiago_no_hand.urdf").n == 8
    )  # antennas on the base: I = (-, +, +)
    impossible = replaced('ixx="0.0071"', 'ixx="0.9"')
    assert re.search("'link1'.*principal", message_of(lambda: parse_chain(impossible), "URDF"))
    assert parse_chain(impossible, base="link1").names == ("joint2", "joint3")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"\xff\xfe<", "not utf-16 text: byte 2 is wrong"),
        (b"<robot name='\xe9'/>", "not utf-8 text: byte 13 is wrong"),
        (b"<?xml version='1.0' encoding='klingon'?><robot/>", "text encoding 'klingon' is not supported"),
        (b"<?xml version='1.0' encoding='unicode_escape'?><robot/>", "text encoding 'unicode_escape' is not supported"),
        (bytes(range(256)), "not utf-8 text"),
    ],
)
def test_bytes_that_are_no_text_are_refused(tmp_path: Path, content: bytes, expected: str) -> None:
    file = tmp_path / "arm.urdf"
    file.write_bytes(content)
    assert expected in message_of(lambda: load_chain(file), str(file))


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf.xacro").write_text("<robot/>")
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "large").open("wb") as large:
        large.truncate(20_000_001)
    for name, expected in {
        "": "a directory",
        "missing.urdf": "no such file",
        "missing/arm.urdf": "no such file",
        "arm.urdf.xacro/arm.urdf": "no such file|cannot be read",
        "arm.urdf.xacro": "run: xacro .* > out.urdf",
        "pipe": "not a regular file",
        "large": "larger than 20 MB",
        "x" * 300: "cannot be read: File name too long",
    }.items():
        assert re.search(expected, message_of(lambda file=tmp_path / name: load_chain(file), str(tmp_path / name)))  # type: ignore[misc]
    assert "no such file" in message_of(lambda: load_chain("a\0b"), "a\0b")


def test_a_file_without_permission_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(_: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", denied)  # not chmod: root may read every file
    file = tmp_path / "arm.urdf"
    file.write_text(robot(*arm(2)))
    assert "cannot be read: Permission denied" in message_of(lambda: load_chain(file), str(file))


NASTY = [
    "",
    "nan",
    "-inf",
    "1e999",
    "-1",
    "0",
    "1e7",
    "abc",
    "0 0",
    "1 2 3",
    "${x}",
    "link1",
    "joint1",
    "&#10;",
    "é",
    "-" * 300,
]


def mutant(text: str, rng: np.random.Generator) -> str:
    """The text after one to three accidents: a value replaced or copied, an element lost or doubled, a cut."""
    for _ in range(rng.integers(1, 4)):
        values = list(re.finditer(r'"[^"]*"', text))
        elements = list(re.finditer(r"<\w[^<>]*/>", text))
        kind, pick = rng.integers(5), lambda found: found[rng.integers(len(found))]
        if kind == 0 and values:
            v = pick(values)
            text = f'{text[: v.start()]}"{NASTY[rng.integers(len(NASTY))]}"{text[v.end() :]}'
        elif kind == 1 and values:
            v, w = pick(values), pick(values)
            text = text[: v.start()] + w[0] + text[v.end() :]
        elif kind == 2 and elements:
            e = pick(elements)
            text = text[: e.start()] + text[e.end() :]
        elif kind == 3 and elements:
            e, f = pick(elements), pick(elements)
            text = text[: e.start()] + f[0] + text[e.start() :]
        elif kind == 4 and rng.integers(4) == 0:
            text = text[: rng.integers(len(text))] + text[rng.integers(len(text)) :]
    return text


def test_mutants_of_a_urdf_end_in_a_sound_chain_or_one_line() -> None:
    rng = np.random.default_rng(11)
    sources = [YPP3.read_text(), robot(*arm(3), *GRIPPER)]
    accepted = refused = 0
    for i in range(150):
        try:
            chain = parse_chain(mutant(sources[i % 2], rng), where="m")
        except UrdfError as error:
            refused += 1
            assert str(error).startswith("m: ")
            assert "\n" not in str(error)
            continue
        accepted += 1
        q = random_q(chain, rng)
        M = inertia_matrix(model_of(chain), dict(zip(chain.names, q, strict=True)))
        assert np.all(np.isfinite(M))
        # -1e-9: links 1e6 m long or 1e6 kg heavy are allowed, and round the smallest eigenvalue
        assert np.linalg.eigvalsh(M)[0] > -1e-9 * np.trace(M)
    assert min(accepted, refused) > 15  # both happen, so that neither half of the test is idle


def test_a_urdf_that_means_one_arm_can_mean_another() -> None:
    text = robot("one revolute a b", "two revolute b c", "three revolute b d")
    left = parse_chain(text, tip="c", at={"three": 0.3})
    right = parse_chain(with_arm(left), base="a", tip="d", at={"two": 0.1})
    again = parse_chain(with_arm(right))
    assert (again.names, again.tip_link, again.frozen) == (("one", "three"), "d", {"two": 0.1})
    assert with_arm(right).count("<symgen") == 1
