"""A gear that turns the other way round than declared, of a joint whose angles at rest say nothing: seen in what it and others feel of
each other, which has the sign of its gear in it.
"""

from __future__ import annotations

import numpy as np

from ident.records.campaign import Campaign
from ident.records.joint_faults import AGREES, AT_REST
from ident.records.looks import Look, felt_by_motors, hold_gain, posture_of
from ident.records.signal_faults import FLAG, Fault

#: Mean cosine between what a held joint feels of the excited one and what it should, below minus which half of the records must be;
#: lines count where that is this many times all else that it feels.
REVERSED, CLEARLY = 0.6, 1.0
#: Share of what is seen that has the wrong sign: a few that links and springs off by a tenth hide do not.
MOST = 0.9


def reversed_gear(campaign: Campaign, looks: list[Look], j: int) -> list[Fault]:
    """A gear that reverses though nothing is declared of it, of a joint that rested at 0 always: what it does to the other joints, and
    they to it, has the sign of N_j in it, and is against CAD's in nearly every record that shows it."""
    name, N = campaign.joints[j], float(campaign.N[j])
    if np.abs(posture_of(looks, j)).max() > AT_REST:
        return []
    pairs = [(look, k if look.index == j else j) for look in looks for k in range(campaign.n) if j in (look.index, k)]
    cosines = np.array([_reaction(campaign, look, held) for look, held in pairs if held != look.index])
    shown = cosines[np.isfinite(cosines)]
    if len(shown) < 2 or np.mean(shown < -AGREES) < MOST or np.median(shown) > -REVERSED:
        return []
    line = (
        f"{name}: it and the other joints pull at each other as CAD says, but for the sign, in nearly all of {len(shown)} that show it, and "
        f"it rested at 0 in all: its gear may reverse (declare N = {-N:g}), or theta and tau both have the wrong sign"
    )
    return [Fault("doubtful gear ratio", name, "", line, FLAG)]


def _reaction(campaign: Campaign, look: Look, held: int) -> float:
    """Mean cosine between what a joint that is held feels of the excited one and what the declared arm's would; NaN where a drive is not
    known or other motions hide it."""
    live = np.flatnonzero(np.ptp(look.record.theta[-look.record.samples_per_period :], axis=0) > 0)
    if held not in live or look.index not in live or not np.isfinite([campaign.J_m[live], campaign.K[live]]).all():
        return np.nan
    felt, rotor = felt_by_motors(campaign, look.J, live, look.f)
    here, there = np.searchsorted(live, [held, look.index])
    moved = look.theta[:, live] / campaign.N[live]
    parts = felt[:, here] * moved
    expected = parts[:, there]
    beside = np.abs(np.delete(parts, there, axis=1)).sum(axis=1) + np.abs(rotor[:, here] * moved[:, here])
    found = hold_gain(campaign, look.f) * look.tau[:, held] * campaign.N[held]
    found = found - (parts.sum(axis=1) - expected) - rotor[:, here] * moved[:, here]
    clear = (np.abs(expected) > CLEARLY * beside) & (np.abs(found) > 0)
    if np.count_nonzero(clear) < 4:
        return np.nan
    return float(np.mean((found * expected.conj()).real[clear] / np.abs(found * expected)[clear]))
