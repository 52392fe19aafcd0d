"""URDF text -> Tree: links and joints as the file states them, every number checked, no physics yet."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import copysign, inf

import numpy as np

from symgen.chain import Array, readonly
from symgen.errors import UrdfError
from symgen.urdf_xml import MAX_LENGTH, MAX_NUMBER, attribute, needed, number, only, root_element, shown, triple

_ACTUATED = ("revolute", "continuous", "prismatic")
_TYPES = (*_ACTUATED, "fixed", "floating", "planar")
_LARGEST_FLOAT = 1.7976931348623157e308
_LONGEST_NAME = 1000  # characters
_LONGEST_ROW = 1000  # joints behind each other, fixed ones too: other readers of URDFs recurse on them


@dataclass(frozen=True, eq=False)
class Body:
    """The <inertial> of a link: mass [kg], centre of mass `xyz` [3, m] and axes `rpy` [3, rad] in the link frame, and
    the inertia `I` [3, 3, kg m2] about the centre of mass in those axes."""

    mass: float
    xyz: Array
    rpy: Array
    I: Array


@dataclass(frozen=True)
class Mimic:
    """A joint that stands at multiplier * (value of `joint`) + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class RawJoint:
    """One <joint>: origin `xyz` [3, m], `rpy` [3, rad], `axis` [3] as written; limits in rad or m and N m or N, infinite
    where not stated."""

    name: str
    type: str
    parent: str
    child: str
    xyz: Array
    rpy: Array
    axis: Array
    mimic: Mimic | None = None
    lower: float = -inf
    upper: float = inf
    effort: float = inf

    @property
    def movable(self) -> bool:
        return self.type != "fixed"

    @property
    def actuated(self) -> bool:
        """Revolute, continuous or prismatic: moved by one number."""
        return self.type in _ACTUATED


@dataclass(frozen=True)
class Choice:
    """Which arm of a file is meant: from link `base` to link `tip`, None where left open; joints `at` [rad or m] stand still."""

    base: str | None = None
    tip: str | None = None
    at: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Tree:
    """All links (name -> body, or None) and joints; `above` the joint over each link, `below` those under it; the arm that the
    file itself says is meant."""

    name: str
    root: str
    links: Mapping[str, Body | None]
    joints: Mapping[str, RawJoint]
    above: Mapping[str, RawJoint]
    below: Mapping[str, list[RawJoint]]
    meant: Choice = Choice()

    def behind(self, link: str) -> Iterator[RawJoint]:
        """Yields every joint behind the link: depth first, in file order."""
        todo = list(reversed(self.below.get(link, [])))
        while todo:
            joint = todo.pop()
            yield joint
            todo += reversed(self.below.get(joint.child, []))

    def master(self, joint: RawJoint) -> RawJoint | None:
        """Returns the joint that this one mimics; None if it mimics none, or one that the file lacks."""
        return self.joints.get(joint.mimic.joint) if joint.mimic else None

    def path(self, base: str, tip: str) -> list[RawJoint]:
        """Returns the joints from link `base` to link `tip`. UrdfError if the tip is not behind the base."""
        joints, link = list[RawJoint](), tip
        while link != base:
            if link not in self.above:
                raise UrdfError(f"tip link {shown(tip)} is not behind base link {shown(base)}")
            joints.append(self.above[link])
            link = joints[-1].parent
        return joints[::-1]


def read_tree(text: str) -> Tree:
    """Returns the tree of a URDF text. UrdfError, one line without the file's name, at the first thing wrong."""
    root = root_element(text)
    links: dict[str, Body | None] = {}
    for element in root.findall("link"):
        name = _new_name(element, links)
        links[name] = _body(element, f"link {shown(name)}")
    if not links:
        raise UrdfError("<robot> has no <link>")
    joints: dict[str, RawJoint] = {}
    for element in root.findall("joint"):
        name = _new_name(element, joints)
        joints[name] = _joint(element, name, links)
    return replace(_connected(root.get("name", ""), links, joints), meant=_meant(root))


def _meant(root: ET.Element) -> Choice:
    """The arm that a <symgen base=".." tip=".."> element says is meant, its <at joint=".." value=".."/> where others stand."""
    stated = only(root, "symgen", "<robot>")
    if stated is None:
        return Choice()
    where = "<symgen>: <at>"
    at = {attribute(one, "joint", where): number(attribute(one, "value", where), where) for one in stated.findall("at")}
    return Choice(stated.get("base"), stated.get("tip"), at)


def _new_name(element: ET.Element, taken: Mapping[str, object]) -> str:
    name = attribute(element, "name", f"<{element.tag}> number {len(taken) + 1}")
    if not name.strip():
        raise UrdfError(f"<{element.tag}> number {len(taken) + 1}: the name is empty")
    if len(name) > _LONGEST_NAME:
        raise UrdfError(
            f"{element.tag} {shown(name)}: a name of {len(name)} characters; expected at most {_LONGEST_NAME}"
        )
    if name in taken:
        raise UrdfError(f"two {element.tag}s are named {shown(name)}; expected distinct names")
    return name


# Elements ------------------------------------------------------------------------------------------------------------


def _body(link: ET.Element, where: str) -> Body | None:
    inertial = only(link, "inertial", where)
    if inertial is None:
        return None
    where = f"{where}: <inertial>"
    mass = number(attribute(needed(inertial, "mass", where), "value", where), f"{where} mass")
    if mass < 0.0:
        raise UrdfError(f"{where} mass: found {mass:g}, expected >= 0 kg")
    inertia = needed(inertial, "inertia", where)
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    xx, xy, xz, yy, yz, zz = (number(attribute(inertia, key, where), f"{where} {key}") for key in keys)
    return Body(mass, *_origin(inertial, where), readonly([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def _origin(element: ET.Element, where: str) -> tuple[Array, Array]:
    """Returns (xyz [m], rpy [rad]) of the element's <origin>; zeros where not stated."""
    origin = element.find("origin")  # the first of several, as urdfdom reads it; vendors' files have them
    stated: Mapping[str, str] = {} if origin is None else origin.attrib
    where = f"{where}: <origin>"
    xyz = triple(stated.get("xyz", "0 0 0"), f"{where} xyz", MAX_LENGTH)
    return xyz, triple(stated.get("rpy", "0 0 0"), f"{where} rpy")


def _joint(element: ET.Element, name: str, links: Mapping[str, object]) -> RawJoint:
    where = f"joint {shown(name)}"
    kind = attribute(element, "type", where)
    if kind not in _TYPES:
        raise UrdfError(f"{where}: type {shown(kind)}; expected one of {', '.join(_TYPES)}")
    parent, child = (attribute(needed(element, tag, where), "link", where) for tag in ("parent", "child"))
    for tag, link in (("parent", parent), ("child", child)):
        if link not in links:
            raise UrdfError(f"{where}: <{tag}> names the link {shown(link)}, which does not exist")
    pose, axis = _origin(element, where), readonly([1.0, 0.0, 0.0])  # the format's default axis
    if kind not in _ACTUATED:
        return RawJoint(name, kind, parent, child, *pose, axis)
    stated = only(element, "axis", where)
    if stated is not None:
        axis = triple(attribute(stated, "xyz", where), f"{where}: <axis> xyz")
        if np.linalg.norm(axis) < 1e-9:
            raise UrdfError(f"{where}: <axis> xyz is zero; expected a direction")
    return RawJoint(name, kind, parent, child, *pose, axis, _mimic(element, where), *_limit(element, kind, where))


def _mimic(joint: ET.Element, where: str) -> Mimic | None:
    mimic = only(joint, "mimic", where)
    if mimic is None:
        return None
    where = f"{where}: <mimic>"
    multiplier = number(mimic.get("multiplier", "1"), f"{where} multiplier")
    return Mimic(attribute(mimic, "joint", where), multiplier, number(mimic.get("offset", "0"), f"{where} offset"))


def _limit(joint: ET.Element, kind: str, where: str) -> tuple[float, float, float]:
    """Returns (lower, upper, effort).

    Unstated is infinite: no <limit>, no bound at all or four zeros (an exporter's blank), a continuous joint's angles,
    an effort of 0, and anything beyond 1e6 (1e16 is an exporter's infinity). One bound alone makes the other 0, as the
    format says.
    """
    limit = only(joint, "limit", where)
    if limit is None:
        return -inf, inf, inf
    where = f"{where}: <limit>"
    keys = ("lower", "upper", "velocity", "effort")
    lower, upper, velocity, effort = (number(limit.get(key, "0"), f"{where} {key}", _LARGEST_FLOAT) for key in keys)
    for key, value in (("velocity", velocity), ("effort", effort)):
        if value < 0.0:
            raise UrdfError(f"{where} {key}: found {value:g}, expected >= 0")
    if lower > upper:
        raise UrdfError(f"{where}: lower {lower:g} is above upper {upper:g}")
    blank = not any((lower, upper, velocity, effort))
    if blank or kind == "continuous" or not {"lower", "upper"} & limit.attrib.keys():
        lower, upper = -inf, inf
    if lower > MAX_NUMBER or upper < -MAX_NUMBER:
        raise UrdfError(f"{where}: [{lower:g}, {upper:g}]; expected a range of rad or m")
    lower, upper = (bound if abs(bound) <= MAX_NUMBER else copysign(inf, bound) for bound in (lower, upper))
    return lower, upper, effort if 0.0 < effort <= MAX_NUMBER else inf


# The tree ------------------------------------------------------------------------------------------------------------


def _connected(name: str, links: Mapping[str, Body | None], joints: Mapping[str, RawJoint]) -> Tree:
    """Returns the tree. UrdfError unless every link but one has exactly one parent and hangs on that one."""
    above: dict[str, RawJoint] = {}
    below: dict[str, list[RawJoint]] = {}
    for joint in joints.values():
        if joint.child in above:
            both = f"{shown(above[joint.child].name)} and {shown(joint.name)}"
            raise UrdfError(f"link {shown(joint.child)} is the child of two joints, {both}; expected one")
        above[joint.child] = joint
        below.setdefault(joint.parent, []).append(joint)
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        names = ", ".join(map(shown, roots[:8])) + (", .." if len(roots) > 8 else "")
        raise UrdfError(f"{len(roots)} links have no parent joint: {names}; expected one root and all links connected")
    tree = Tree(name, roots[0] if roots else "", links, joints, above, below)
    depth = dict.fromkeys(roots, 0)
    for joint in tree.behind(tree.root):
        depth[joint.child] = depth[joint.parent] + 1
    for link in links:
        if link not in depth:
            raise UrdfError(f"the joints form a circle through link {shown(_on_circle(link, above))}; expected a tree")
        if depth[link] > _LONGEST_ROW:
            raise UrdfError(
                f"link {shown(link)} is behind more than {_LONGEST_ROW} joints; expected fewer, fixed ones too"
            )
    return tree


def _on_circle(link: str, above: Mapping[str, RawJoint]) -> str:
    seen = set[str]()
    while link not in seen:
        seen.add(link)
        link = above[link].parent
    return link
