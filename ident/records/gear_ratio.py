"""A gear ratio that is off by a little, as angles at rest tell, or by much, as the motion of a joint does that rested at 0."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.records.campaign import Campaign
from ident.records.joint_faults import AT_REST, RATIO, deflection, load_of
from ident.records.looks import Look, expected_of, posture_of
from ident.records.sag import beside_zero
from ident.records.signal_faults import REFUSE, Fault

#: Times that a ratio which is off must show in angles at rest over what they scatter.
SCATTER = 4.0
#: A gear ratio is wrong when the motion fits another one better by this factor, which must not be within what drives and links may be wrong by.
RATIO_IN_MOTION, BETTER = 1.6, 2.0


def wrong_ratio(campaign: Campaign, looks: list[Look], j: int) -> list[Fault]:
    """A gear ratio that is off by a little, seen at rest, or where nothing is seen at rest by much, seen in motion.

    Motion knows of N through J/N^2 and K/N^2 beside J_m: errors of CAD and datasheet do not look like it beyond 30 %.
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
    own = [look for look in looks if look.index == j and np.isfinite(look.expected).all()]
    if not own or np.abs(q).max() > AT_REST or not np.isfinite(campaign.K[j]):
        return []
    factors = np.geomspace(1 / 8, 8, 49)
    misfit = np.mean([[_misfit(campaign, look, factor) for factor in factors] for look in own], axis=0)
    best = float(factors[np.argmin(misfit)])
    if 1 / RATIO_IN_MOTION < best < RATIO_IN_MOTION or BETTER * misfit.min() > misfit[len(factors) // 2]:
        return []
    line = (
        f"{name}: resonances and inertia fit N = {N * best:.3g} better than the declared {N:g} (J_m, K and CAD taken as declared, "
        "the angles at rest being 0): check the gear ratio"
    )
    return [Fault("wrong gear ratio", name, "", line, REFUSE)]


def _misfit(campaign: Campaign, look: Look, factor: float) -> float:
    """How far the response of the excited joint is from the declared arm's with N times `factor`: median |log ratio|."""
    N = np.array(campaign.N)
    N[look.index] *= factor
    expected = expected_of(replace(campaign, N=N), look.J, look.record, look.f, look.tau, look.theta)
    return float(np.median(np.abs(np.log(np.abs(look.theta[:, look.index] / expected)))))
