"""From which period on a record has settled: transients have died, and no joint is on its way to where it rests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from ident.records.campaign import Array, Record
from ident.records.leakage import BINS, ORDER, ROUNDING, Complex, between_lines

#: A joint on its way to where it rests moves so much of its swing from one period to the next, and so many times as far as later.
#: Noise of a mean is that of the lowest lines; times that which a joint on its way moves at least.
ON_ITS_WAY, SLOWING, LOWEST, BEYOND_NOISE = 0.02, 1.25, 8, 6.0
#: Probability of calling noise a transient, or a distortion, over all tests on one record.
FALSE_ALARM = 1e-3
#: Lines judged together when a transient is looked for; it is also looked for in all lines at once.
GROUP = 10


def settled_from(record: Record, band: NDArray[np.int64], floor: Array) -> tuple[int, bool]:
    """Returns the first settled period and whether that could be tested and was passed, from the angles of all joints.

    Going backwards, a period joins the settled ones as long as it and its successor differ, leakage taken off, by no
    more noise than the pairs after them. Slow noise and the smooth part of a transient leak into all lines alike and
    are taken off with the leakage; what is left of a transient or a disturbance is not. Power ratios of a line are
    F distributed; their geometric mean over a few lines, or all, is compared with that distribution as if it were one
    line, because the lines share bins. `floor` [n] is the quantisation variance of a line of one period.
    """
    P, S = record.periods, record.samples_per_period
    groups = max(len(band) // GROUP, 1)
    dof = 2 * (BINS - ORDER)
    limit = -np.log(fdtri(dof, dof, FALSE_ALARM / (P * (groups + 1) * record.theta.shape[1])))
    later: list[Array] = []
    for start in range(P - 2, -1, -1):
        mean, noise, _ = between_lines(record.theta[start * S : (start + 2) * S], 2, band)
        power = np.mean(np.abs(noise) ** 2, axis=0) + floor + (ROUNDING * np.abs(mean).max(axis=0)) ** 2
        power = np.maximum(power, np.finfo(float).tiny)  # a rigid joint
        if later:
            ratio = np.log(power) - np.log(np.mean(later, axis=0))
            if max(part.mean(axis=0).max() for part in (ratio, *np.array_split(ratio, groups))) > limit:
                return start + 1, start < P - 3
        later.append(power)
    return 0, P > 2


def arrived(record: Record, first: int, step: Array, noise: Complex) -> int:
    """Returns the period, not before `first`, from which on no joint is on its way to where it rests, as far as that is more than
    its encoder `step` [n, rad] and its `noise` [R, F, n, rad] over the periods from `first`; two periods are left at least.

    For an arm under dry friction: a joint that nearly comes to rest does it in one period and not in another. Of a linear arm
    leakage tells all that is on its way.
    """
    periods = record.theta.reshape(record.periods, record.samples_per_period, -1)
    moves = np.abs(np.diff(periods.mean(axis=1), axis=0))
    low = np.sqrt(np.mean(np.abs(noise[:, :LOWEST]) ** 2, axis=(0, 1)) * (record.periods - first))  # of one period
    far = moves > ON_ITS_WAY * periods[-1].std(axis=0) + BEYOND_NOISE * (step + low)
    while first < len(moves) - 1 and np.any(far[first] & (moves[first] > SLOWING * moves[first + 1 :].max(axis=0))):
        first += 1
    return first
