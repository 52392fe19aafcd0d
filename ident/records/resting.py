"""Where the arm stands in a record: at the posture that is declared, or where its motors and wound springs tell that it rests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.errors import IdentError
from ident.records.campaign import Array, Campaign
from ident.records.frf import POSTURE_TOLERANCE, RESTS, Frf, off_posture

#: A joint [rad or m] farther than this from its declared posture, and than this share of what its spring sags, is told by another zero;
#: nearer than that it is there.
ASIDE, SAGS, THERE = 0.05, 1.5, 2e-5

#: A mean that lies as far from all postures, up to this share, and farther than this [rad or m], is a zero that is off: J(q) by another angle.
ALIKE, SHIFTED = 0.1, 3e-3


def rested(campaign: Campaign, responses: Sequence[Frf], K: Array) -> tuple[Frf, ...]:
    """Returns the `responses` at the postures at which the records rest, if the springs have these stiffnesses K [n, N m/rad joint side]:
    the same postures where all rest as these say.

    A joint that rests farther off than an angle's zero may be, or a spring that sags by another stiffness, is left at its posture, and said
    to be off. Raises IdentError for a response without spectra.
    """
    return tuple(_rested(campaign, frf, K) for frf in responses)


def farthest_apart(responses: Sequence[Frf], others: Sequence[Frf]) -> float:
    """How far apart the postures of two readings of the same records are at most [rad or m]."""
    return max(float(np.abs(one.posture - other.posture).max()) for one, other in zip(responses, others, strict=True))


def _rested(campaign: Campaign, frf: Frf, K: Array) -> Frf:
    if frf.band is None:
        raise IdentError(f"record {frf.record}: its spectra are missing; expected those of estimate()")
    sag = campaign.N * frf.band.mean_tau / K
    aside = frf.band.mean_theta / campaign.N - sag - frf.posture
    away = np.where(np.abs(aside) < np.maximum(ASIDE, SAGS * np.abs(sag)), aside, 0.0)
    moved = frf.posture + away if np.abs(away).max() > THERE else frf.posture
    status = [line for line in frf.status if RESTS not in line] + off_posture(frf.record, campaign.joints, aside - away)
    return replace(frf, posture=moved, offset=aside - away, status=tuple(status))


def elsewhere(campaign: Campaign, responses: Sequence[Frf]) -> list[str]:
    """Returns a line for each joint that rests away from its declared postures in `responses`, as `rested` has them."""
    aside = np.array([frf.posture - one.posture for frf, one in zip(responses, campaign.records, strict=True)])
    return [
        f"{name} rests up to {far:.3g} from its declared postures, as its motor says by the spring that was found: J(q) is told of where it rests"
        for name, far in zip(campaign.joints, np.abs(aside).max(axis=0), strict=True)
        if far > POSTURE_TOLERANCE
    ]


def statuses(joints: Sequence[str], responses: Sequence[Frf]) -> list[str]:
    """Returns what is doubtful of the records, one line each; of a joint that lies as far off in all of them, one line for all."""
    offset = np.array([frf.offset for frf in responses]).reshape(len(responses), len(joints))
    mean, apart = offset.mean(axis=0), np.ptp(offset, axis=0)
    shifted = {
        name: f"{name} rests {mean[k]:+.3g} from its declared posture in all records: its encoder's zero is off, or the postures are; J(q) is told "
        "by the declared angles"
        for k, name in enumerate(joints)
        if len(responses) > 2 and abs(mean[k]) > SHIFTED and apart[k] < ALIKE * abs(mean[k])
    }
    rests = tuple(f": {name} rests " for name in shifted)
    return [
        *shifted.values(),
        *(line for frf in responses for line in frf.status if not any(one in line for one in rests)),
    ]
