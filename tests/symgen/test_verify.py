"""The judge: passes what is right whatever the limits, and refuses what is wrong."""

from __future__ import annotations

from dataclasses import replace

import pytest
from arms import arm, factoring_of
from chains import own

import symgen.graph
from symgen.basis import factor
from symgen.chain import Inertia, Snap
from symgen.errors import SymgenError
from symgen.urdf import parse_chain
from symgen.verify import TOLERANCE, verify


@pytest.mark.parametrize("name", ["ypp3", "ur5", "panda"])
def test_a_right_factoring_passes(name: str) -> None:
    verdict = verify(factoring_of(name))
    assert verdict.ok and verdict.allowed == TOLERANCE
    assert verdict.as_written is not None and verdict.as_written < 1e-8


def test_limits_of_many_turns_cost_no_digits() -> None:
    """A sum of two angles of 1e5 rad has an error of 1e-11 rad."""
    chain = arm("ur5")
    far = replace(chain, joints=tuple(replace(joint, lower=-1e5) for joint in chain.joints))
    assert verify(factor(far)).error <= TOLERANCE


def test_what_was_dropped_is_allowed_and_no_more() -> None:
    found = factoring_of("ypp3")
    wrong = replace(found, W=found.W * (1 + 1e-9))
    with pytest.raises(SymgenError, match="differs from Pinocchio's by 1.0e-09 of its largest entry"):
        verify(wrong)
    assert verify(replace(wrong, cost=1e-9)).ok
    with pytest.raises(SymgenError, match="expected <= "):
        verify(replace(wrong, cost=1e-11))


def test_functions_that_are_written_otherwise_than_derived_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    inverse = symgen.graph._inverse
    monkeypatch.setattr(symgen.graph, "_inverse", lambda B: inverse(B) * (1 + 1e-9))
    with pytest.raises(SymgenError, match="differs from Pinocchio's by 1.0e-09 of its largest entry"):
        verify(factoring_of("ypp3"))


def test_slides_are_judged_over_their_limits() -> None:
    assert verify(factor(own("scara4"))).ok


def test_bodies_that_are_not_those_of_the_file_are_refused() -> None:
    """Whatever the derivation: what the chain says of the file is judged too, unless angles were snapped."""
    chain = arm("ypp3")
    heavy = Inertia.of(chain.joints[1].inertia.parameters * (1 + 1e-7))
    wrong = replace(chain, joints=(chain.joints[0], replace(chain.joints[1], inertia=heavy), chain.joints[2]))
    with pytest.raises(SymgenError, match="ypp3: .* Pinocchio's, which reads the file itself, by .*e-08 .* <= 1e-08"):
        verify(factor(wrong))
    snapped = replace(wrong, snapped=(Snap("joint1", 1.57, 1.5708, "pi/2"),))
    assert verify(factor(snapped)).as_written == pytest.approx(6e-8, rel=0.5)


SIDE = """<robot name="r"><link name="base"/><link name="a">{0}</link><link name="b">{0}</link><link name="c">{0}</link>
 <joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" effort="9" velocity="1"/></joint>
 <joint name="side" type="{1}"><parent link="a"/><child link="b"/><origin xyz="0 0.2 0" rpy="0.3 0 0"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" effort="9" velocity="1"/></joint>
 <joint name="j2" type="revolute"><parent link="a"/><child link="c"/><origin xyz="0 0 0.4"/><axis xyz="1 0 0"/>
  <limit lower="-2" upper="2" effort="9" velocity="1"/></joint>
</robot>"""
BODY = (
    '<inertial><origin xyz="0.1 0 0.1"/><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    '</inertial><collision><geometry><box size="0.3 0.1 0.1"/></geometry></collision>'
)


@pytest.mark.parametrize("kind", ["floating", "planar", "continuous", "prismatic", "fixed"])
def test_a_joint_of_any_kind_beside_the_arm_stands_as_pinocchio_has_it(kind: str) -> None:
    """Floating and planar joints stand at their origin, whatever number of coordinates they have; the others at 0.3."""
    chain = parse_chain(
        SIDE.format(BODY, kind), tip="c", at={"side": 0.3} if kind in ("continuous", "prismatic") else {}
    )
    assert chain.names == ("j1", "j2")
    verdict = verify(factor(chain))
    assert verdict.as_written is not None and verdict.as_written < TOLERANCE


@pytest.mark.parametrize("name", ["j1", "side"])
@pytest.mark.parametrize("hostile", ["a\there", "universe"])
def test_a_name_that_pinocchio_reads_otherwise_leaves_the_file_unread(name: str, hostile: str) -> None:
    """A tab is a space to an XML parser, and a tab to urdfdom; "universe" is Pinocchio's name of the ground."""
    chain = parse_chain(SIDE.format(BODY, "continuous").replace(f'"{name}"', f'"{hostile}"'), tip="c")
    assert hostile.replace("\t", " ") in (*chain.names, *chain.frozen)
    assert verify(factor(chain)).as_written is None
