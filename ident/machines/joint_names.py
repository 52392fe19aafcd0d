"""Which joint a channel of a foreign file speaks of: by the numbers, or the words, in the channels' names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os.path import commonprefix
from pathlib import Path

import numpy as np

from ident.errors import ImportingError
from ident.records.campaign import Array

COMMANDED = r"ref|cmd|command|desired|target|setp|(^|[^a-z])(des|set)($|[^a-z])"
LINK = r"link|load|output|second|joint_?(pos|ang)"
MOTOR = r"motor|rotor"
#: A name's parts: words also where a capital begins them, numbers, and what separates them.
_PART = r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+|[\W_]+|\w"
#: What tells the readings of one joint apart, and so is no joint's name.
_ROLE = (
    rf"{LINK}|{MOTOR}|{COMMANDED}|act(ual)?|dem(and)?|meas(ured)?|feedback|fb|est(imated)?|filt(ered)?|raw|err(or)?|"
    "mean|min|max|[dq]|in|out|abs|inc|ext"
)


@dataclass(frozen=True, eq=False)
class Channel:
    """One reading: variable, column (from 0), values [T]; `group` is the name without the joint, `joint` its number; of the values `missing` ones
    were not finite and are interpolated."""

    name: str
    column: int | None
    values: Array
    group: str
    joint: str
    kind: str = ""
    missing: int = 0

    @property
    def still(self) -> bool:
        return bool(np.ptp(self.values) == 0)

    @property
    def commanded(self) -> bool:
        return bool(re.search(COMMANDED, self.name.lower()))


def split_name(name: str, joints: Sequence[str]) -> tuple[str, str]:
    """A name without the joint it speaks of, and that joint: one of the URDF's, else a number."""
    for k, joint in sorted(enumerate(joints), key=lambda item: -len(item[1])):
        if joint in name:
            return name.replace(joint, "#"), f"{k:04d}"
    number = re.search(r"\d+", name)
    return (re.sub(r"\d+", "#", name), f"{int(number[0]):04d}") if number else (name, "")


def words_of_joints(channels: Sequence[Channel], path: Path) -> tuple[str, ...]:
    """The joints' names where words tell them: what differs among the names of torques and again among those of angles.

    () where numbers tell them, or there is one joint. ImportingError where different words are in either kind.
    """
    alone = [channel for channel in channels if channel.column is None]
    angles = [channel for channel in alone if channel.kind == "angle" and not channel.commanded]
    driven = [channel for channel in alone if channel.kind in ("torque", "current")]
    driven = [channel for channel in driven if not channel.commanded] or driven
    kinds = [[channel for channel in driven if channel.kind == kind] for kind in ("torque", "current")]
    for torques in kinds:
        for words in _candidates(torques):
            if all(_have_all(either, words) for either in (torques, angles)):
                return words
    untold = next((torques for torques in kinds if _candidates(torques) and len(by_joint(torques)[0]) == 1), None)
    if untold and _candidates(angles):
        raise ImportingError(
            f"{path}: names do not tell which of {', '.join(channel.name for channel in untold)} and of "
            f"{', '.join(channel.name for channel in angles)} belong to one joint; expected the joints' names in both, "
            "or --urdf"
        )
    return ()


def _candidates(channels: Sequence[Channel]) -> list[tuple[str, ...]]:
    """Words that may be joints: last parts of names of one path, or what is left without the parts common to all."""
    names = [channel.name for channel in channels]
    paths: dict[str, list[str]] = {}
    for name in names:
        path, _, last = name.rpartition("/")
        paths.setdefault(path, []).append(last)
    parts = [re.findall(_PART, name) for name in names]
    for _ in range(2):  # common to all in front, then behind
        common = len(commonprefix(parts))
        parts = [part[common:][::-1] for part in parts]
    rest = [re.sub(r"^[\W_]+|[\W_]+$", "", "".join(part)) for part in parts]
    found = [*(words for path, words in paths.items() if path), rest]
    return [tuple(words) for words in found if len(words) > 1 and _are_joints(words)]


def _are_joints(words: Sequence[str]) -> bool:
    """Whether the words may name joints: all different, not all with a number, none a kind of reading."""
    numbered = all(re.search(r"\d", word) for word in words)
    return (
        all(words)
        and len(set(words)) == len(words)
        and not numbered
        and not any(re.fullmatch(_ROLE, word.lower()) for word in words)
    )


def _have_all(channels: Sequence[Channel], words: Sequence[str]) -> bool:
    """Whether some group of channels has one of every word."""
    return any(len(group) == len(words) for group in by_joint([of_word(channel, words) for channel in channels]))


def of_word(channel: Channel, words: Sequence[str]) -> Channel:
    """The channel, of the joint whose word is among the parts of its name, else of none."""
    if channel.column is not None:
        return channel
    parts = re.findall(_PART, channel.name)
    for k, word in sorted(enumerate(words), key=lambda item: -len(item[1])):
        own = re.findall(_PART, word)
        for at in range(len(parts) - len(own) + 1):
            if parts[at : at + len(own)] == own:
                group = "".join([*parts[:at], "#", *parts[at + len(own) :]])
                return replace(channel, group=group, joint=f"{k:04d}")
    return replace(channel, group=channel.name, joint="")


def by_joint(channels: Sequence[Channel]) -> list[list[Channel]]:
    """Channels of one kind by group, each in the order of its joints; largest groups first."""
    groups: dict[str, list[Channel]] = {}
    for channel in channels:
        groups.setdefault(channel.group, []).append(channel)
    ordered = [sorted(group, key=lambda channel: channel.joint) for group in groups.values()]
    return sorted(ordered, key=len, reverse=True)
