"""Effects with which records that nothing has seen are told worse: none of them is what acts, though nothing comes nearer."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from ident.loop.effect_words import joined, percent
from ident.search.departures import Errors

#: Share by which a joint's error changes that grows, or falls; times its noise that it is, at least, where it grows.
CHANGED, SEEN = 0.05, 1.1

Each = Mapping[str, float]


def is_worse(before: Errors, after: Errors, own: Collection[str]) -> bool:
    """Whether records that nothing has seen are told worse with effects at the joints `own`: all together, or those of these joints
    while those of no other are told better."""
    if after.all > before.all or not own:
        return after.all > before.all
    each = before.per_joint, after.per_joint
    return _fall_nowhere(*each, own) and bool(_grown(*each, after.noise_per_joint, own))


def growth(verdict: Mapping[str, Any]) -> str:
    """How held-out errors grow with the effects of verdict.json, in words; nothing where they do not."""
    e, own = verdict["error"], [str(effect["joint"]) for effect in verdict["effects"]]
    before, after = (e[when]["all"] for when in ("before", "after"))
    each: tuple[Each, Each] = e["before"].get("per_joint", {}), e["after"].get("per_joint", {})
    joints = _grown(*each, e["noise_per_joint"], own)
    if not own or not (after > before or (joints and _fall_nowhere(*each, own))):
        return ""
    first, last = percent(before), percent(after)
    whole = f" grows from {first} to {last}" if first != last else f" stays at {last}"
    of_joints = [f" of {joint} grows from {percent(each[0][joint])} to {percent(each[1][joint])}" for joint in joints]
    told = [whole] * (after > before) + of_joints
    return joined([f"the held-out error{told[0]}", *(f"that{one}" for one in told[1:])])


def nearest(verdict: Mapping[str, Any]) -> str:
    """What is to be said above effects with which held-out errors grow; nothing above others."""
    grows = growth(verdict)
    return f"What follows comes nearest to what acts, and is not it: with it {grows}." if grows else ""


def _grown(before: Each, after: Each, noise: Each, own: Collection[str]) -> list[str]:
    """The joints `own` of which records report, if the errors of all of them grow beyond what noise makes of it."""
    told = [joint for joint in dict.fromkeys(own) if joint in before and joint in after]
    grow = [after[joint] > max((1.0 + CHANGED) * before[joint], SEEN * noise.get(joint, 0.0)) for joint in told]
    return told if all(grow) else []


def _fall_nowhere(before: Each, after: Each, own: Collection[str]) -> bool:
    """Whether the error of no joint falls but of those `own`."""
    return not any(
        after[joint] < (1.0 - CHANGED) * before[joint] for joint in after if joint in before and joint not in own
    )
