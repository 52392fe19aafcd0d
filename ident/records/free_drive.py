"""How well a joint's motion goes with another gear, spring, rotor or links than declared: datasheets and CAD are off by tens of per cent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.records.campaign import Array, Campaign
from ident.records.looks import Complex, Look, felt_by_motors, hold_gain

#: What K, J_m and J of a joint may be, over what is declared, before another number of it is blamed.
OFF = np.geomspace(1 / 1.7, 1.7, 13)
#: An explanation is worse than another where it misses by this many times as much, and by this part: less is the step of `OFF`.
BETTER, MISSES = 2.0, 0.12
#: Stiffnesses, over the one asked about, that might explain the motion in its place.
_OTHERS = np.geomspace(1 / 64, 64, 25)
_ONE = np.ones(1)


def misfit(campaign: Campaign, look: Look, N: Array, K: Array, J: Array, J_m: Array) -> Array:
    """Median |log ratio| [len(N), len(K), len(J), len(J_m)] over the lines of what the excited motor did and what the declared arm's does
    with its gear ratio, links and rotor `N`, `J`, `J_m` times the declared ones, and its spring `K` [N m/rad]."""
    found = np.empty((len(N), len(K), len(J), len(J_m)))
    for k, m in np.ndindex(len(K), len(J)):
        found[:, k, m] = np.median(
            np.abs(np.log(np.abs(_ratios(campaign, look, N, float(K[k]), float(J[m]), J_m)))), axis=-1
        )
    return found


def _ratios(campaign: Campaign, look: Look, N: Array, K: float, J: float, J_m: Array) -> Complex:
    """Ratios [len(N), len(J_m), L] of what the excited motor did to what it does with these numbers, as in `misfit`."""
    i, tau, gear = look.index, hold_gain(campaign, look.f) * look.tau[:, look.index], N * campaign.N[look.index]
    live = np.flatnonzero(np.ptp(look.record.theta[-look.record.samples_per_period :], axis=0) > 0)
    port = int(np.searchsorted(live, i))
    others = np.delete(np.arange(len(live)), port)
    springs = replace(campaign, K=np.where(np.arange(campaign.n) == i, K, campaign.K))
    felt, rotor = felt_by_motors(springs, J * look.J, live, look.f)
    moved = np.einsum("lk,lk->l", felt[:, port, others], look.theta[:, live[others]] / campaign.N[live[others]])
    force = gear[:, None] * (gear[:, None] * tau - moved)
    rotors = np.multiply.outer(np.multiply.outer(N**2, J_m), rotor[:, port])
    return np.asarray(look.theta[:, i] * (felt[:, port, port] + rotors) / force[:, None])


def least(campaign: Campaign, looks: Sequence[Look], j: int, N: Array) -> Array:
    """Returns how far (see `misfit`) the motion of joint j is from that of each of `N` [G] times the declared gear ratio, by those numbers in
    `OFF` that fit it best."""
    return _mean(campaign, looks, N, OFF * campaign.K[[j]], OFF, OFF).reshape(len(N), -1).min(axis=1)


def _mean(campaign: Campaign, looks: Sequence[Look], N: Array, K: Array, J: Array, J_m: Array) -> Array:
    return np.asarray(np.mean([misfit(campaign, look, N, K, J, J_m) for look in looks], axis=0))


def judges(campaign: Campaign, looks: list[Look], j: int) -> list[Look]:
    """The records whose motion tells of joint j: it is excited, and its J_m known."""
    return [look for look in looks if look.index == j and np.isfinite(look.expected).all()]


def refutes(campaign: Campaign, looks: list[Look], j: int, K: float) -> bool:
    """Whether the motion is not that of a joint whose spring is K [N m/rad], while another spring explains it."""
    own = judges(campaign, looks, j)
    if not own:
        return False
    by_spring = _mean(campaign, own, _ONE, K * _OTHERS, OFF, OFF).reshape(len(_OTHERS), -1).min(axis=1)
    return bool(by_spring[len(_OTHERS) // 2] > max(MISSES, BETTER * by_spring.min()))


def agrees(campaign: Campaign, looks: list[Look], j: int) -> tuple[float, float]:
    """Returns the least and largest mean cosine that there is between what the excited motor of joint j did and does, whatever its spring."""
    own = judges(campaign, looks, j)
    low, high = min(look.f.min() for look in own), max(look.f.max() for look in own)
    stiff = np.mean([look.J[j, j] for look in own]) * (2 * np.pi * np.geomspace(low / 2, 2 * high, len(_OTHERS))) ** 2
    each = [[_ratios(campaign, look, _ONE, K, 1.0, _ONE)[0, 0] for K in stiff] for look in own]
    cosines = np.median([[np.mean(r.real / np.abs(r)) for r in one] for one in each], axis=0)
    return float(cosines.min()), float(cosines.max())
