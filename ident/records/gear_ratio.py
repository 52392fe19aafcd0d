"""A gear ratio that is off by a little, as angles at rest tell, or by much, as the motion of a joint does that rested at 0."""

from __future__ import annotations

import numpy as np

from ident.records.campaign import Campaign
from ident.records.free_drive import BETTER, judges, least, misfit
from ident.records.joint_faults import AT_REST, RATIO, deflection, load_of
from ident.records.looks import Look, posture_of
from ident.records.sag import beside_zero
from ident.records.signal_faults import FLAG, REFUSE, Fault

#: Times that a ratio which is off must show in angles at rest over what they scatter.
SCATTER = 4.0
#: A gear ratio is wrong when the motion fits another one better by `BETTER`, which must not be within what drives and links may be wrong by;
#: ratios that are tried, and share of the misfit at their ends above which a least one is none.
RATIO_IN_MOTION, FACTORS, ALIKE = 1.6, np.geomspace(1 / 256, 256, 65), 0.8
#: Misfit up to which numbers other than declared explain a motion; records that are enough to tell.
MISSES, MANY = 0.03, 4

_ONE = np.ones(1)


def wrong_ratio(campaign: Campaign, looks: list[Look], j: int) -> list[Fault]:
    """A gear ratio that is off by a little, seen at rest, or where nothing is seen at rest by much, seen in motion.

    Motion knows of N through J/N^2 and K/N^2 beside J_m.
    """
    name, N, q = campaign.joints[j], float(campaign.N[j]), posture_of(looks, j)
    if np.ptp(q) > 2 * AT_REST and len(looks) > 2:
        errors = np.array([look.rest[j] for look in looks]) - q
        line_of = np.stack([q, np.ones_like(q)], axis=1)
        slope, scatter = np.inf, 0.0
        for straight in (errors, errors - deflection(campaign, looks, j)):  # the torque may have a wrong unit
            found = np.linalg.lstsq(line_of, straight, rcond=None)[0]
            if abs(found[0]) < abs(slope):
                slope, scatter = float(found[0]), float(np.abs(straight - line_of @ found).max())
        bent = errors - beside_zero(load_of(looks, j), errors, campaign.K[j]) * load_of(looks, j)
        sags = np.abs(bent - bent.mean()).max() <= scatter  # by a K that is not the declared one
        if abs(slope) <= RATIO or sags or np.abs(slope * (q - q.mean())).max() < SCATTER * scatter:
            return []
        line = f"{name}: its angles at rest say N = {N * (1 + slope):.5g}, declared is {N:g}: correct the gear ratio"
        return [Fault("wrong gear ratio", name, "", line, REFUSE)]
    if np.abs(q).max() > AT_REST or not np.isfinite(campaign.K[j]):
        return []
    return _in_motion(campaign, judges(campaign, looks, j), j)


def _in_motion(campaign: Campaign, own: list[Look], j: int) -> list[Fault]:
    """The ratio that the motion fits, in the records `own` that excite joint j, where it fits none near the declared one, whatever K, J_m and
    J within what datasheets and CAD are off by. A doubt where all ratios from some on fit alike, as the links are then not felt."""
    if not own:
        return []
    name, N = campaign.joints[j], float(campaign.N[j])
    declared = np.mean([misfit(campaign, one, FACTORS, campaign.K[[j]], _ONE, _ONE) for one in own], axis=0).ravel()
    best = float(FACTORS[declared.argmin()])
    if 1 / RATIO_IN_MOTION < best < RATIO_IN_MOTION or BETTER * declared.min() > declared[len(FACTORS) // 2]:
        return []
    few = FACTORS[::2]  # K and J of CAD and datasheets go with its square, farther than from one to the next
    by_ratio = least(campaign, own[:: 1 + len(own) // MANY], j, few)
    explains = max(MISSES, BETTER * by_ratio.min())
    if by_ratio[len(few) // 2] < explains:
        return []
    numbers = "none explains it with the declared one that is off by up to 70 % in K, J_m and CAD"
    if ALIKE * min(by_ratio[0], by_ratio[-1]) < by_ratio.min():
        line = (
            f"{name}: it does not move as the declared N = {N:g} has it, nor another ({numbers}): check the gear ratio, J_m and K, and the units "
            "of theta and tau"
        )
        return [Fault("doubtful gear ratio", name, "", line, FLAG)]
    best = best if declared.min() < explains else float(few[by_ratio.argmin()])
    line = (
        f"{name}: resonances and inertia fit a gear ratio of about {N * best:.3g} better than the declared {N:g}, the angles at rest being 0 "
        f"({numbers}): check the gear ratio"
    )
    return [Fault("wrong gear ratio", name, "", line, REFUSE)]
