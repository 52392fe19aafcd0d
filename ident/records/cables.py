"""Cables and columns that are exchanged: a multisine on another motor, encoders or postures of two joints in each other's place."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from ident.records.campaign import Campaign
from ident.records.joint_faults import AT_REST, EXPLAINED, errors_at_rest, straightened
from ident.records.looks import Look, posture_of
from ident.records.signal_faults import REFUSE, Fault

#: Share of its nominal size that the multisine has at least on the motor that plays it, and at most on another.
PLAYED = 0.3
#: How much more uneven a torque must be than three times that of the flat multisine on another motor.
FLAT = 0.1
#: A motor that moves this many times as much as the excited one is the excited one.
ANSWERS = 3.0


def played(campaign: Campaign, looks: list[Look]) -> Iterator[Fault]:
    """Records whose multisine is on another motor than they say: of about its nominal size, or as flat as it was made."""
    for look in looks:
        size = np.abs(look.tau) / (look.record.rms * np.sqrt(2 / len(look.record.lines)))
        upper = size[len(size) // 2 :]  # where feedback has left it alone
        level = np.median(upper, axis=0)
        uneven = np.median(np.abs(upper - level), axis=0) / np.where(level > 0, level, np.inf)
        k, i = int(np.argmax(level)), look.index
        flattest = int(np.argmin(np.where(level > PLAYED, uneven, np.inf)))
        if k == i or not level[i] < PLAYED < level[k]:
            k = flattest
            if k == i or level[k] <= PLAYED or not 3 * uneven[k] < uneven[i] - FLAT:
                continue
        said, name, id = look.record.excited, campaign.joints[k], look.record.id
        line = (
            f"record {id}: {said} is said to be excited, but the multisine is on the motor of {name}: the joints' names or the "
            "torques' columns are exchanged"
        )
        yield Fault("wrong motor", said, id, line, REFUSE)


def swapped(campaign: Campaign, looks: list[Look]) -> Iterator[tuple[int, int, Fault]]:
    """Pairs of joints whose encoders are exchanged, by their angles at rest, or by who answers the excited motor; or whose postures are, where
    angles at rest are and each motor's own encoder answers."""
    for i, k in combinations(range(campaign.n) if looks else (), 2):
        in_motion = _exchanged_in_motion(campaign, looks, i, k)
        one, two = campaign.joints[i], campaign.joints[k]
        if in_motion is False and _postures_exchanged(campaign, looks, i, k):
            line = (
                f"{one} and {two}: each one's encoder reads the angle that the other's posture says, and answers its own motor: the "
                "postures are given in another order of joints; exchange the two in every posture"
            )
            yield i, k, Fault("swapped postures", f"{one}, {two}", "", line, REFUSE)
        elif in_motion or _exchanged_at_rest(campaign, looks, i, k):
            line = (
                f"{one} and {two}: each one's encoder reads the angles of the other: their cables or columns are exchanged; "
                "exchange theta of the two"
            )
            yield i, k, Fault("swapped encoders", f"{one}, {two}", "", line, REFUSE)


def _exchanged_at_rest(campaign: Campaign, looks: list[Look], i: int, k: int) -> bool:
    own = np.abs([errors_at_rest(campaign, looks, i), errors_at_rest(campaign, looks, k)]).max(axis=1)
    crossed = np.abs([errors_at_rest(campaign, looks, i, k), errors_at_rest(campaign, looks, k, i)]).max()
    return bool(own.min() > AT_REST and crossed < EXPLAINED)


def _postures_exchanged(campaign: Campaign, looks: list[Look], i: int, k: int) -> bool:
    """Whether each of two joints rests where the posture of the other is declared."""
    own = np.abs([errors_at_rest(campaign, looks, i), errors_at_rest(campaign, looks, k)]).max(axis=1)
    rest = np.array([look.rest for look in looks])
    crossed = [straightened(campaign, looks, j, rest[:, j] - posture_of(looks, other)) for j, other in ((i, k), (k, i))]
    return bool(own.min() > AT_REST and np.abs(crossed).max() < EXPLAINED)


def _exchanged_in_motion(campaign: Campaign, looks: list[Look], i: int, k: int) -> bool | None:
    """Whether in every record of i it is k that moves, and the other way round; None where records do not tell."""
    votes = []
    for look in looks:
        if look.index in (i, k):
            moved = np.linalg.norm(look.f[:, None] ** 2 * look.theta / campaign.N, axis=0)
            own, other = moved[look.index], moved[k if look.index == i else i]
            votes.append(1 if other > ANSWERS * own else -1 if own > other else 0)
    both = {look.index for look in looks} >= {i, k}
    if both and all(vote == 1 for vote in votes):
        return True
    return False if both and all(vote == -1 for vote in votes) else None
