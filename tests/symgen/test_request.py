"""What is asked for and what robot.toml says go together: the arm, where joints stand, and which way gravity points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from chains import REPOSITORY

from symgen.errors import SymgenError
from symgen.plan import Plan
from symgen.request import Request, chain_for, plan_for

YPP3 = REPOSITORY / "robots/ypp3"


def robot(where: Path, **changes: str) -> Path:
    """The URDF of the paper's arm in a directory of its own; `changes` are lines of [robot] by key."""
    (where / "ypp3.urdf").write_bytes((YPP3 / "ypp3.urdf").read_bytes())
    kept = [line for line in (YPP3 / "robot.toml").read_text().splitlines() if line.split(" =")[0] not in changes]
    kept[kept.index("[robot]") + 1 : 1] = [f"{key} = {value}" for key, value in changes.items()]
    weak = "\n".join(kept).replace(
        "torque_limit_Nm = 1.0", "torque_limit_Nm = 0.01"
    )  # joint 3 can not hold its link level
    (where / "robot.toml").write_text(weak)
    return where / "ypp3.urdf"


def judged(urdf: Path, q3: float, **options: Any) -> Plan:
    """The plan of one cell: joint 3, the only one of its arm, at q3."""
    (urdf.parent / "cells.csv").write_text(f"joint3,{q3}\n")
    return plan_for(urdf, Request(base="link2", postures=str(urdf.parent / "cells.csv"), **options))


def held(urdf: Path, q3: float, **options: Any) -> bool:
    return not judged(urdf, q3, **options).document["plan"]["infeasible"]


UP = 1.570796


def test_gravity_is_the_roots_whatever_the_base(tmp_path: Path) -> None:
    """Link 3 hangs from link 2, which joint 2 lifts: level at 0, straight up at 90 deg."""
    urdf = robot(tmp_path)
    assert [held(urdf, q3) for q3 in (0.0, UP)] == [False, True]
    up = judged(urdf, 0.0, at=f"joint2={UP}")
    assert not up.document["plan"]["infeasible"] and up.document["frozen"] == {"joint2": UP}
    assert not held(urdf, UP, at=f"joint2={UP}")

    (tmp_path / "robot.toml").unlink()
    weak = urdf.read_text().replace('effort="100"', 'effort="1"')
    urdf.write_text(weak)
    assert [held(urdf, q3, at=f"joint2={UP}") for q3 in (0.0, UP)] == [True, False]


def test_gravity_of_robot_toml_is_in_the_axes_of_its_own_base(tmp_path: Path) -> None:
    """Given along -y of link 2, which is horizontal in the URDF: the arm hangs on a wall."""
    own = {"base": '"link2"', "gravity_m_per_s2": "[0, -9.81, 0]"}
    urdf = robot(tmp_path, **own)
    assert [held(urdf, q3) for q3 in (0.0, UP)] == [True, False]
    urdf = robot(tmp_path, gravity_m_per_s2="[0, -9.81, 0]", base='"link1"', at=f"{{joint2 = {UP}}}")
    assert [held(urdf, q3) for q3 in (0.0, UP)] == [False, True], "link 2 stands up, gravity is level"


def test_where_joints_stand_is_asked_for_one_by_one(tmp_path: Path) -> None:
    urdf = robot(tmp_path, at="{joint3 = 0.5}")
    assert chain_for(urdf, Request())[0].frozen == {"joint3": 0.5}
    assert chain_for(urdf, Request(at="joint1=0.2"))[0].frozen == {"joint1": 0.2, "joint3": 0.5}
    assert chain_for(urdf, Request(at="joint3=0.2"))[0].frozen == {"joint3": 0.2}


def test_a_joint_that_changes_nothing_is_refused(tmp_path: Path) -> None:
    text = (YPP3 / "ypp3.urdf").read_text()
    link = text[text.index('<link name="link3">') : text.index("</link>", text.index('<link name="link3">')) + 7]
    side = '<joint name="side" type="continuous"><parent link="base_link"/><child link="side"/></joint></robot>'
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(text.replace("</robot>", link.replace("link3", "side") + side))
    assert chain_for(urdf, Request(at="side=0.2"))[0].frozen == {"side": 0.2}
    with pytest.raises(SymgenError, match="--at 'side=0.2': 'side' is neither behind link 'link1' nor before it"):
        chain_for(urdf, Request(base="link1", at="side=0.2"))
