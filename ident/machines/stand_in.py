"""A URDF for a machine that has none: one link a joint, so that every tool that wants a URDF works."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET


@dataclass(frozen=True)
class Body:
    """What joint `joint` moves by itself: `size` is an inertia about its axis [kg m2], of a `slide` a mass [kg]."""

    joint: str
    slide: bool
    size: float


def stand_in(bodies: Sequence[Body]) -> str:
    """Returns the URDF of coaxial joints about z (slides: along z), base to tip, each with a ball as its link.

    J(q) is constant: J_ii is the sum over k >= i of the sizes. Nothing limits the joints, nothing has weight about them.
    """
    root = ET.Element("robot", name="bench")
    ET.SubElement(root, "link", name="base")
    before = "base"
    for body in bodies:
        link = ET.SubElement(root, "link", name=f"{body.joint}_link")
        inertial = ET.SubElement(link, "inertial")
        size = repr(body.size)
        ET.SubElement(inertial, "mass", value=size if body.slide else "1")
        moments = {"ixx": size, "iyy": size, "izz": size, "ixy": "0", "ixz": "0", "iyz": "0"}
        ET.SubElement(inertial, "inertia", moments)
        kind = "prismatic" if body.slide else "continuous"
        joint = ET.SubElement(root, "joint", name=body.joint, type=kind)
        ET.SubElement(joint, "parent", link=before)
        ET.SubElement(joint, "child", link=f"{body.joint}_link")
        ET.SubElement(joint, "axis", xyz="0 0 1")
        if body.slide:
            ET.SubElement(joint, "limit", lower="-1000", upper="1000", effort="1e6", velocity="1e6")
        before = f"{body.joint}_link"
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
