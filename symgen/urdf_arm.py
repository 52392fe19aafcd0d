"""Tree -> which joints are the arm, and where the joints stand that are not."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isfinite

from symgen.errors import UrdfError
from symgen.urdf_tree import Choice, RawJoint, Tree
from symgen.urdf_xml import shown

MAX_JOINTS = 24  # takes 14 s and 1.5 GB; from 29 on the monomials outnumber the 64-bit integers


@dataclass(frozen=True)
class Arm:
    """The `moving` joints from link `base` to link `tip`; every other movable joint behind `base` stands at `resting`
    [rad or m], and so does what was frozen before it."""

    base: str
    tip: str
    moving: tuple[RawJoint, ...]
    resting: Mapping[str, float]


def choose_arm(tree: Tree, choice: Choice) -> Arm:
    """Returns the arm that is chosen, without the joints that `at` {joint: rad or m} freezes; `at` does not change where it
    ends. What is left open is as the file means it, else from the root link to `_default_tip`; but joints of an arm whose
    base or tip is chosen move, wherever the file freezes them. UrdfError: an unknown name, no arm, two arms, or joints that
    no serial arm has."""
    base, tip = _ends(tree, choice)
    path, meant = tree.path(base, tip), dict(tree.meant.at)
    if choice.base is not None or choice.tip is not None:
        meant = {name: value for name, value in meant.items() if name not in {joint.name for joint in path}}
    at = meant | dict(choice.at)
    _check_frozen(tree, at)
    moving = tuple(joint for joint in path if joint.movable and joint.name not in at)
    _check_moving(moving, f"from {shown(base)} to {shown(tip)}")
    stand, names = standing(tree, at), {joint.name for joint in moving}
    before = [joint.name for joint in tree.path(tree.root, base) if joint.name in at]
    off = (joint.name for joint in tree.behind(base) if joint.movable and joint.name not in names)
    return Arm(base, tip, moving, {name: stand[name] for name in (*before, *off)})


def _ends(tree: Tree, choice: Choice) -> tuple[str, str]:
    """The first and the last link of the arm; what the file means counts where it is of one run with what is chosen."""
    base, tip = choice.base or tree.meant.base, choice.tip or tree.meant.tip
    check_link(tree, "base", base)
    check_link(tree, "tip", tip)
    if base and tip and base not in (joint.parent for joint in tree.path(tree.root, tip)):
        base, tip = choice.base, choice.tip
    base = base or tree.root
    return base, tip or _default_tip(tree, base)


def check_link(tree: Tree, role: str, link: str | None) -> None:
    """UrdfError, saying what it was to be, where there is no such link."""
    if link is not None and link not in tree.links:
        raise UrdfError(f"{role} link {shown(link)} does not exist; links are {_listed(tree.links)}")


def _listed(names: Iterable[str]) -> str:
    names = list(names)
    return ", ".join(map(shown, names[:20])) + (f", .. ({len(names)} in all)" if len(names) > 20 else "")


def _check_moving(moving: tuple[RawJoint, ...], span: str) -> None:
    if not moving:
        raise UrdfError(f"no moving joint {span}; expected at least one revolute, continuous or prismatic joint")
    if len(moving) > MAX_JOINTS:
        raise UrdfError(f"{len(moving)} moving joints {span}; expected at most {MAX_JOINTS}")
    for joint in moving:
        name = f"joint {shown(joint.name)} {span}"
        if not joint.actuated:
            raise UrdfError(
                f"{name} is {joint.type}; expected revolute, continuous, prismatic or fixed (try --base LINK)"
            )
        if joint.mimic:
            raise UrdfError(
                f"{name} mimics {shown(joint.mimic.joint)}, and a serial arm has no such joint; "
                "end the arm before it with --tip, freeze it (--at, or at in robot.toml), or remove its <mimic>"
            )
        if joint.lower == joint.upper:
            raise UrdfError(f"{name}: <limit> lower = upper = {joint.lower:g}; expected room to move, or a fixed joint")


# Where the other joints stand ----------------------------------------------------------------------------------------


def _check_frozen(tree: Tree, at: Mapping[str, float]) -> None:
    for name, value in at.items():
        joint = tree.joints.get(name)
        if joint is None or not joint.actuated:
            movable = (j.name for j in tree.joints.values() if j.actuated)
            raise UrdfError(f"at: no moving joint {shown(name)}; moving joints are {_listed(movable)}")
        if not isfinite(value):
            raise UrdfError(f"at: {shown(name)} = {value}; expected a finite number (rad or m)")
        if not joint.lower <= value <= joint.upper:
            limits = f"[{joint.lower:g}, {joint.upper:g}]"
            raise UrdfError(f"at: {shown(name)} = {value:g}; expected a value within the joint's limits {limits}")


def standing(tree: Tree, at: Mapping[str, float]) -> dict[str, float]:
    """Returns for every joint the value to freeze it at: `at`, else where it mimics, else 0; clamped to its limits."""
    stand = {name: float(value) for name, value in at.items()}
    for joint in tree.joints.values():
        followers = dict[str, RawJoint]()
        master: RawJoint | None = joint
        while master and master.name not in stand:
            if master.name in followers:
                raise UrdfError(f"joint {shown(master.name)}: <mimic> leads back to the joint itself")
            followers[master.name] = master
            master = tree.master(master)
        for follower in reversed(followers.values()):
            value = 0.0
            if follower.mimic and follower.mimic.joint in stand:
                value = follower.mimic.multiplier * stand[follower.mimic.joint] + follower.mimic.offset
            stand[follower.name] = min(max(value, follower.lower), follower.upper)
    return stand


# The arm that is meant when no tip is given --------------------------------------------------------------------------


@dataclass(frozen=True)
class _Groups:
    """A group is a link (its head) with all that is fixed to it: `head` of each link, the movable joints that leave
    each group (`out`), the longest `run` of counting joints that each of these starts, and each link's `span` of
    positions in the depth-first order (its own, and the last one behind it)."""

    head: Mapping[str, str]
    out: Mapping[str, list[RawJoint]]
    run: Mapping[str, int]
    span: Mapping[str, tuple[int, int]]

    def is_rod(self, master: RawJoint | None, head: str) -> bool:
        """Says whether what mimics `master` at `head` runs alongside the arm; a finger's master would lie behind it."""
        first, last = self.span[head]
        return master is not None and not first < self.span.get(master.child, (-1, -1))[0] <= last


def _default_tip(tree: Tree, base: str) -> str:
    """Returns the link that ends the longest run of joints from `base` that move and mimic none.

    Where joints branch behind a trunk of two or more and no branch is as long as that trunk, they are the fingers of a
    gripper, and the arm ends before them. UrdfError if two runs of different joints are the longest: two arms.
    """
    groups = _group(tree, base)
    ends: list[tuple[int, str]] = []
    todo = [(base, 0)]
    while todo:
        here, trunk = todo.pop()
        out = groups.out.get(here, [])
        useful = [joint for joint in out if groups.run[joint.name]]
        branches = [joint for joint in out if groups.run[joint.name] or not groups.is_rod(tree.master(joint), here)]
        fingers = len(branches) > 1 and trunk >= 2 and all(groups.run[joint.name] < trunk for joint in branches)
        if fingers or not useful:
            ends.append((trunk, branches[0].parent if branches else _fixed_leaf(tree, here, groups.head)))
        else:
            todo += [(joint.child, trunk + _counts(joint)) for joint in reversed(useful)]
    longest = max(trunk for trunk, _ in ends)
    tips = [tip for trunk, tip in ends if trunk == longest]
    if len(tips) > 1:
        raise UrdfError(
            f"{len(tips)} arms of {longest} moving joints each, ending at {_listed(tips)}; choose with --tip LINK"
        )
    return tips[0]


def _group(tree: Tree, base: str) -> _Groups:
    head, out, run, span = {base: base}, dict[str, list[RawJoint]](), dict[str, int](), dict[str, tuple[int, int]]()
    behind = list(tree.behind(base))
    for joint in behind:
        if joint.movable:
            head[joint.child] = joint.child
            out.setdefault(head[joint.parent], []).append(joint)
        else:
            head[joint.child] = head[joint.parent]
    for position in range(len(behind) - 1, -1, -1):
        joint = behind[position]
        run[joint.name] = _counts(joint) + max((run[j.name] for j in out.get(joint.child, [])), default=0)
        below = tree.below.get(joint.child)
        span[joint.child] = (position, span[below[-1].child][1] if below else position)
    return _Groups(head, out, run, {base: (-1, len(behind)), **span})


def _counts(joint: RawJoint) -> int:
    return int(joint.actuated and joint.mimic is None)


def _fixed_leaf(tree: Tree, link: str, head: Mapping[str, str]) -> str:
    """Returns the first link without children, in file order, of those fixed to `link`."""
    while children := [j.child for j in tree.below.get(link, []) if head[j.child] == head[link]]:
        link = children[0]
    return link
