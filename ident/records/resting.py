"""Where the arm stands in a record: at the posture that is declared, or where its motors and wound springs tell that it rests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.errors import IdentError
from ident.records.campaign import Array, Campaign
from ident.records.frf import Frf

#: A joint [rad or m] farther than this from its declared posture is told by another zero; nearer than that it is there.
ASIDE, THERE = 0.05, 2e-5

#: A mean that lies as far from all postures, up to this share, and farther than this [rad or m], is a zero that is off: J(q) by another angle.
ALIKE, SHIFTED = 0.1, 3e-3


def rested(campaign: Campaign, responses: Sequence[Frf], K: Array) -> tuple[Frf, ...] | None:
    """Returns the `responses` at the postures at which the records rest, if the springs have these stiffnesses K [n, N m/rad joint side].

    None where all rest as declared. A joint that rests farther off than an angle's zero may be is left at its declared posture.
    Raises IdentError for a response without spectra.
    """
    aside = [_aside(campaign, frf, K) for frf in responses]
    if np.all(np.abs(aside) <= THERE):
        return None
    return tuple(replace(frf, posture=frf.posture + away) for frf, away in zip(responses, aside, strict=True))


def _aside(campaign: Campaign, frf: Frf, K: Array) -> Array:
    """How far the links rest from the posture [n, rad or m]."""
    if frf.band is None:
        raise IdentError(f"record {frf.record}: its spectra are missing; expected those of estimate()")
    aside = frf.band.mean_theta / campaign.N - campaign.N * frf.band.mean_tau / K - frf.posture
    return np.where(np.abs(aside) < ASIDE, aside, 0.0)


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
