"""A URDF's text with other inertias: read back by pinocchio, every other byte as it was."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest

from ident.identification.urdf_text import read_inertias, replace_inertias
from symgen.chain import Inertia

TEXT = """<?xml version="1.0" encoding="{encoding}"?>
<!-- A robot. <inertial> in a comment stays. -->
<robot name="r">
  <link name="base"/>
  <link name="a">  <!-- tabs\tand spaces -->
    <inertial><origin xyz="0.1 0 0" rpy="0.3 -0.2 0.9"/><mass value="2"/>
       <inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.04"/></inertial >
    <visual><geometry><box size="1 1 1"/></geometry></visual>
  </link>
  <link name="b > c"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name='j2' type='revolute'><parent link='a'/><child link="b > c"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <link name="d"></link>
  <joint name="j3" type="revolute"><parent link="b > c"/><child link="d"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <gazebo><link name="a"><inertial>not this one</inertial></link></gazebo>
</robot>
"""
UTF8 = TEXT.format(encoding="utf-8")


def body(seed: int) -> Inertia:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(3, 6))
    return Inertia(rng.uniform(1, 3), rng.normal(size=3), np.trace(points @ points.T) * np.eye(3) - points @ points.T)


NEW = {"a": body(1), "b > c": body(2), "d": body(3)}


def test_inertias_are_read_as_pinocchio_reads_them() -> None:
    found = read_inertias(UTF8)
    assert {name for name, one in found.items() if one is None} == {"base", "b > c", "d"}
    judge = pin.buildModelFromXML(replace_inertias(UTF8, {name: NEW[name] for name in ("b > c", "d")}, "x")).inertias[1]
    assert found["a"] is not None
    assert found["a"].mass == judge.mass
    np.testing.assert_allclose(found["a"].com, judge.lever, rtol=1e-15)
    np.testing.assert_allclose(found["a"].I, judge.inertia, rtol=1e-12, atol=1e-16)


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
@pytest.mark.parametrize("start", ["", "\ufeff"])
def test_new_inertias_stand_in_the_file_and_nothing_else_changed(line_end: str, start: str) -> None:
    text = start + UTF8.replace("\n", line_end)
    made = replace_inertias(text, NEW, "What was -- done --")
    model = pin.buildModelFromXML(made.removeprefix("\ufeff"))
    for judge, expected in zip(list(model.inertias)[1:], NEW.values(), strict=True):
        assert judge.mass == expected.mass
        np.testing.assert_allclose(judge.lever, expected.com, rtol=1e-15)
        np.testing.assert_allclose(judge.inertia, expected.I, rtol=1e-12)

    def rest(whole: str) -> str:
        whole = re.sub(r"(?s)\s*<inertial>\s*<origin.*?</inertial\s*>", "", whole)
        for name in ("b > c", "d"):
            whole = re.sub(rf'<link name="{name}">\s*</link>', f'<link name="{name}"/>', whole)
        return whole

    assert made.count("<!-- What was - - done -->") == 1
    assert rest(made.replace("<!-- What was - - done -->\n", "")) == rest(text)
    assert made.count("</inertial") == 4  # three, and one of gazebo
    assert read_inertias(made).keys() == read_inertias(text).keys()


def test_the_text_says_the_encoding_it_has() -> None:
    made = replace_inertias(TEXT.format(encoding="gbk"), {}, "x")
    assert made.startswith('<?xml version="1.0" encoding="utf-8"?>')
    assert replace_inertias(UTF8, {}, "x") == UTF8.replace("<robot", "<!-- x -->\n<robot", 1)
