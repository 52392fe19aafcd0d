"""URDF -> Chain: the moving joints from base to tip, every link that does not move on its own lumped into the one that
carries it.

Vendors' files are read as they are; a broken or hostile one ends in one UrdfError. Nothing recurses on the depth of the
file.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from symgen import angles
from symgen.chain import PRISMATIC, REVOLUTE, Array, Chain, Inertia, Joint, Snap, readonly
from symgen.errors import UrdfError
from symgen.kinematics import inertia_matrix
from symgen.urdf_arm import Arm, check_link, choose_arm, standing
from symgen.urdf_tree import Body, Choice, RawJoint, Tree, read_tree
from symgen.urdf_xml import decode, read_bytes, shown

# Principal moments of a body obey I1 + I2 >= I3 >= 0. In the 69 URDFs of example-robot-data every link either does so
# to its last digit or breaks it by 0.2 % and more (mostly 10-100 %: made up, or copied from another link).
_PHYSICAL = 1e-3
_POINT_RADIUS = 1e-6  # m: moments of m (1 um)^2 are those of a point mass, written with rounding
_POSTURES = 8  # at which a joint is asked whether it feels any inertia
_Pose = tuple[Array, Array]  # rotation [3, 3] and origin [3, m] of a frame


def load_chain(
    path: str | Path,
    *,
    base: str | None = None,
    tip: str | None = None,
    at: Mapping[str, float] | None = None,
    snap: bool = True,
) -> Chain:
    """Returns the serial arm in the URDF file `path`; arguments and errors are those of `parse_chain`, every message
    starts with the path, `Chain.sha256` is the hash of the file's bytes."""
    path = Path(path)
    data = read_bytes(path)
    try:
        text = decode(data)
        stem = path.stem.encode(errors="replace").decode()  # the name of a file may be no text
        return _chain(text, hashlib.sha256(data).hexdigest(), stem, Choice(base, tip, at or {}), snap)
    except UrdfError as error:
        raise UrdfError(f"{path}: {error}") from None


def parse_chain(
    text: str,
    *,
    where: str = "URDF",
    base: str | None = None,
    tip: str | None = None,
    at: Mapping[str, float] | None = None,
    snap: bool = True,
) -> Chain:
    """Returns the serial arm in the URDF `text`, from link `base` to link `tip`.

    `base` defaults to the root link, `tip` to the end of the longest run of moving joints that mimic no other, grippers
    left out. What lies before `base` is dropped (it turns gravity: `turned`); everything behind it that moves but is not on
    the way to `tip` is frozen where `at` {joint: rad or m} says, else at 0 or the limit next to 0 (or where it mimics), and
    lumped. `at` may freeze joints of the arm as well. What is not given is as the text itself says (`with_arm`), except that
    the joints of an arm whose base or tip is given move. With `snap`, angles within 1e-4 rad of a multiple of pi/12 and
    axes within 1e-4 rad of a coordinate axis are set exactly and reported in `Chain.snapped`; without it only those within
    1e-9 rad.

    Raises UrdfError, one line that starts with `where`: not XML, not a tree, a number missing or impossible, a link
    that no rigid body can be, a name that does not exist, or a choice between arms that only the caller can make.
    """
    try:
        data = text.encode()
        return _chain(text, hashlib.sha256(data).hexdigest(), "robot", Choice(base, tip, at or {}), snap)
    except UnicodeEncodeError as error:
        raise UrdfError(f"{where}: not text: character {error.start} is a lone surrogate") from None
    except UrdfError as error:
        raise UrdfError(f"{where}: {error}") from None


#: What a URDF says of the arm that is meant.
_MEANT = re.compile(r"<symgen\b(?:[^>]*/>|.*?</symgen>)\n?", re.DOTALL)


def with_arm(chain: Chain) -> str:
    """Returns the chain's URDF text, which says itself which arm is meant where that is not the usual one: whoever parses it,
    with no choice of his own, gets the same arm."""
    from xml.sax.saxutils import quoteattr  # brings half of the web with it

    def arm(text: str, choice: Choice) -> Chain | None:
        try:
            return _chain(text, chain.sha256, chain.name, choice, True)
        except UrdfError:
            return None

    def same(other: Chain | None) -> bool:
        ours, theirs = ((one.names, one.base_link, one.tip_link, one.frozen) if one else None for one in (chain, other))
        return ours == theirs

    if not chain.source or same(arm(chain.source, Choice())):
        return chain.source
    source = _MEANT.sub("", chain.source)  # what it said of another arm
    usual = arm(source, Choice(chain.base_link, chain.tip_link))
    stand = {name: value for name, value in chain.frozen.items() if usual is None or usual.frozen.get(name) != value}
    rows = "".join(f"<at joint={quoteattr(name)} value={quoteattr(repr(value))}/>" for name, value in stand.items())
    meant = f"<symgen base={quoteattr(chain.base_link)} tip={quoteattr(chain.tip_link)}>{rows}</symgen>\n"
    end = source.rindex("</robot")
    text = f"{source[:end]}{meant}{source[end:]}"
    if not same(arm(text, Choice())):
        raise UrdfError(f"{chain.name}: its text can not be made to say which arm is meant")
    return text


def _chain(text: str, digest: str, stem: str, choice: Choice, snap: bool) -> Chain:
    tree = read_tree(text)
    if not any(tree.links.values()):
        raise UrdfError("no link has an <inertial>; expected the mass and inertia of every link that moves")
    arm = choose_arm(tree, choice)
    tolerance = angles.SNAP if snap else angles.ROUNDING
    placed, bodies, lumped = _lump(tree, arm, tolerance)
    _check_masses(arm, bodies)
    joints = tuple(_joint(raw, placed[raw.name], bodies[raw.name], tolerance) for raw in arm.moving)
    snaps = tuple(found for raw in tree.behind(arm.base) for found in _snaps(raw, tree.links[raw.child], tolerance))
    chain = Chain(tree.name or stem, joints, arm.base, arm.tip, text, digest, snaps, dict(arm.resting), lumped)
    _check_inertia(chain)
    return chain


def turned(chain: Chain, v: ArrayLike, of: str | None = None) -> Array:
    """Returns a vector [3], given in the axes of link `of` (default: the root) of the chain's URDF, in those of its base link.

    Joints between the two stand where `chain.frozen` says, else at 0 as in `parse_chain`. UrdfError: no such link.
    """
    tree = read_tree(chain.source)
    check_link(tree, "base", of)
    stand = standing(tree, chain.frozen)

    def axes(link: str) -> Array:
        R = np.eye(3)
        for joint in tree.path(tree.root, link):
            origin = angles.from_rpy(joint.rpy, angles.ROUNDING), np.zeros(3)
            R = R @ _moved(origin, joint, stand[joint.name], angles.ROUNDING)[0]
        return R

    of, found = of or tree.root, readonly(v)
    return found if of == chain.base_link else axes(chain.base_link).T @ axes(of) @ found


def _lump(
    tree: Tree, arm: Arm, tolerance: float
) -> tuple[dict[str, _Pose], dict[str, Inertia], tuple[tuple[str, str], ...]]:
    """Returns for each moving joint its frame at q = 0 in the frame of the link that moves before it, and the body it
    carries; and the pairs (link, link it was lumped into)."""
    here: _Pose = (np.eye(3), np.zeros(3))
    carrier: dict[str, RawJoint | None] = {arm.base: None}  # link -> the moving joint that carries it
    pose: dict[str, _Pose] = {arm.base: here}  # link -> its frame seen from its carrier's link
    placed: dict[str, _Pose] = {}
    bodies: dict[str, Inertia] = {}
    lumped: list[tuple[str, str]] = []
    moving = {joint.name for joint in arm.moving}
    for joint in tree.behind(arm.base):
        link, body = joint.child, tree.links[joint.child]
        R, p = pose[joint.parent]
        origin = angles.cleaned(R @ angles.from_rpy(joint.rpy, tolerance)), p + R @ joint.xyz
        if joint.name in moving:
            placed[joint.name], carrier[link], pose[link] = origin, joint, here
            bodies[joint.name] = _inertia(link, body, tolerance)
            continue
        onto = carrier[link] = carrier[joint.parent]
        pose[link] = _moved(origin, joint, arm.resting.get(joint.name, 0.0), tolerance)
        if onto and body:
            bodies[onto.name] += _inertia(link, body, tolerance).moved(*pose[link])
            lumped.append((link, onto.child))
    return placed, bodies, tuple(lumped)


def _moved(origin: _Pose, joint: RawJoint, value: float, tolerance: float) -> _Pose:
    """Returns the child's frame of a joint that stands at `value` [rad or m]; floating and planar joints stay put."""
    if not joint.actuated or value == 0.0:
        return origin
    (R, p), (axis, _) = origin, angles.unit_axis(joint.axis, tolerance)
    if joint.type == PRISMATIC:
        return R, p + R @ axis * value
    return angles.cleaned(R @ angles.about(axis, value, angles.ROUNDING)), p


def _joint(raw: RawJoint, placed: _Pose, body: Inertia, tolerance: float) -> Joint:
    kind = PRISMATIC if raw.type == PRISMATIC else REVOLUTE
    axis, _ = angles.unit_axis(raw.axis, tolerance)
    return Joint(raw.name, kind, *placed, axis, raw.child, body, raw.lower, raw.upper, raw.effort)


def _snaps(joint: RawJoint, body: Body | None, tolerance: float) -> list[Snap]:
    """Returns what is moved in a joint's origin and axis and in its child's inertial frame."""
    found = angles.snaps_of_rpy(joint.name, joint.rpy, tolerance)
    if body:
        found += angles.snaps_of_rpy(f"{joint.child} (inertial)", body.rpy, tolerance)
    if joint.actuated:
        axis, tilt = angles.unit_axis(joint.axis, tolerance)
        if tilt > angles.ROUNDING:
            sign = "-" if axis.sum() < 0.0 else ""
            found.append(Snap(joint.name, tilt, 0.0, f"axis {sign}{'xyz'[int(np.argmax(np.abs(axis)))]}"))
    return found


# Bodies --------------------------------------------------------------------------------------------------------------


def _inertia(link: str, body: Body | None, tolerance: float) -> Inertia:
    """Returns the body of one link in link axes. UrdfError if its principal moments are those of no rigid body."""
    if body is None:
        return Inertia.zero()
    moments = np.linalg.eigvalsh(body.I)
    margin = _PHYSICAL * max(moments[2], 0.0) + body.mass * _POINT_RADIUS**2
    if moments[0] < -margin or moments[0] + moments[1] < moments[2] - margin:
        numbers = ", ".join(f"{moment:.4g}" for moment in moments)
        raise UrdfError(
            f"link {shown(link)}: <inertial>: principal moments {numbers} kg m2 are those of no rigid body; "
            "expected none below 0 and none above the sum of the other two"
        )
    R = angles.from_rpy(body.rpy, tolerance)
    return Inertia(body.mass, body.xyz, R @ body.I @ R.T)


def _check_masses(arm: Arm, bodies: Mapping[str, Inertia]) -> None:
    for joint in arm.moving:
        if bodies[joint.name].mass <= 0.0:
            raise UrdfError(
                f"link {shown(joint.child)} behind joint {shown(joint.name)} is massless, with all that is fixed to it"
                "; expected an <inertial> with mass > 0"
            )


def _check_inertia(chain: Chain) -> None:
    """UrdfError where a joint turns points on its own axis only, however the others stand."""
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (_POSTURES, chain.n))
    felt = np.einsum("mii->mi", inertia_matrix(chain, q)).max(axis=0)
    carried = np.cumsum([joint.inertia.mass for joint in chain.joints[::-1]])[::-1]
    for joint, inertia, mass in zip(chain.joints, felt, carried, strict=True):
        if inertia <= mass * _POINT_RADIUS**2:
            raise UrdfError(
                f"link {shown(joint.link)} has no inertia about the axis of joint {shown(joint.name)}, which moves it, nor has what it "
                "carries; expected a body, not points on the axis"
            )
