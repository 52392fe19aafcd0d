"""What a fit makes doubtful: a scale of torques or angles, a clock, a gear ratio that no record contradicts, as all numbers go with it.

With torques t times too large K, J_m and J come out t times too large; so they do with angles t times too small. A clock that runs
at the wrong rate leaves K as it is, and makes J_m and J too large by the square of true over declared rate; gear ratios leave J_m.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from ident.records.campaign import Array
from ident.records.joint_faults import NEAR
from ident.records.signal_faults import FLAG, Fault

#: K and J_ii that are both off by this factor, and by the same one up to `NEAR`, are a gear ratio that is off by its root.
TOGETHER = 2.0
#: Least factor common to all torques that is told of, and to all inertias, which those who wrote datasheets and CAD may have left out alike;
#: shares of its logarithm that numbers may scatter about it, and what it is at least where two may agree by chance.
COMMON, OF_INERTIAS, SCATTER = 1.08, 1.25, 0.25
FEW, FEW_SCATTER = 1.25, 0.1
#: Standard deviation of the logarithm of what datasheets are off by, each by itself, and times that of their mean that is no chance.
DATASHEET, NO_CHANCE = 0.15, 4.0
#: What J of CAD may be off by, all joints together.
OF_CAD = 1.4


def doubts(
    joints: Sequence[str], fs: float, N: ArrayLike, K: ArrayLike, J_m: ArrayLike, J: ArrayLike
) -> tuple[Fault, ...]:
    """Returns the doubts that a fit leaves about scales; `K`, `J_m` and `J` [n] are what was found of them, and of J_ii, over what was
    declared, NaN where nothing was; `fs` [Hz] and `N` [n] as declared.

    What all joints share is a unit or a clock, and told alone; else each joint's own.
    """
    N, K, J_m, J = (np.asarray(x, dtype=float) for x in (N, K, J_m, J))
    common = [*_of_clock(fs, K, J_m, J), *_of_torques(K, J_m, J)]
    if common:
        return tuple(common)
    return tuple(
        fault for k, name in enumerate(joints) for fault in _of_joint(name, *map(float, (N[k], K[k], J_m[k], J[k])))
    )


def joint_medians(values: Array, index: Array, n: int) -> Array:
    """The median [n] of the `values` [R] of each joint, that of record r is `index` [R]; NaN for a joint without."""
    return np.array([np.median(values[index == i]) if np.any(index == i) else np.nan for i in range(n)])


def _of_clock(fs: float, K: Array, J_m: Array, J: Array) -> Iterator[Fault]:
    """The doubt about the sampling rate, where K has it as declared, and what has the square of time in it not."""
    factor = _shared(np.concatenate([J_m, J[:1]]) if len(J) == 1 else J_m, OF_INERTIAS)
    stiff, link = _mean_log(K), _mean_log(J)
    if not factor or not abs(stiff) < SCATTER * abs(np.log(factor)) or not abs(link - np.log(factor)) < abs(link):
        return
    line = (
        f"J_m is {factor:.4g} times the declared one at every joint, J {np.exp(link):.3g} times CAD's, and K as declared: that is a "
        f"sampling rate of about {fs * np.sqrt(factor):.4g} Hz in place of {fs:.5g}, or datasheets and CAD that are all off alike"
    )
    yield Fault("doubtful sampling rate", "", "", line, FLAG)


def _of_torques(K: Array, J_m: Array, J: Array) -> Iterator[Fault]:
    """The doubt about the torques of all motors, which all that is found of an arm goes with."""
    factor = _shared(np.concatenate([K, J_m]), COMMON)
    link = _mean_log(J)
    if not factor or not abs(link - np.log(factor)) < np.log(OF_CAD):
        return
    line = (
        f"K and J_m are {factor:.4g} times the declared ones at every joint, J {np.exp(link):.3g} times CAD's: torques are told {factor:.4g} "
        "times as large as they are (a unit, torque constants), or angles as much too small (counts a turn)"
    )
    yield Fault("doubtful torque scale", "", "", line, FLAG)


def _of_joint(joint: str, N: float, K: float, J_m: float, J: float) -> Iterator[Fault]:
    """The doubt about one joint's gear ratio, or its torques: K and J go with both, J_m with these alone."""
    low, high = sorted((K, J))
    alike = low > 0 and high <= NEAR * low
    if not alike or not (low > TOGETHER or high < 1 / TOGETHER):
        return
    factor = float(np.sqrt(K * J))
    said = f"{joint}: K is {K:.3g} times the declared one, J {J:.3g} times CAD's"
    if J_m > 0 and abs(np.log(J_m / K)) < abs(np.log(J_m)):
        line = f"{said} and J_m {J_m:.3g} times its datasheet's: all follow from torques told {K:.3g} times as large as they are, or angles as much too small"
        yield Fault("doubtful torque scale", joint, "", line, FLAG)
    elif abs(N) > 1:
        line = f"{said}: both follow from a gear ratio of about {N / np.sqrt(factor):.3g} in place of {N:g}"
        yield Fault("doubtful gear ratio", joint, "", line, FLAG)


def _shared(values: Array, least: float) -> float:
    """The factor, `least` times at least, that two `values` or more share; 0 where they do not. NaN is no value."""
    known = values[np.isfinite(values)]
    if len(known) < 2 or not (known > 0.0).all():
        return 0.0
    logs = np.log(known)
    factor, apart, several = abs(logs.mean()), np.abs(logs - logs.mean()).max(), len(known) > 2
    least, scatter = (least, SCATTER) if several else (max(least, FEW), FEW_SCATTER)
    alike = factor > np.log(least) and apart < scatter * factor
    by_chance = NO_CHANCE * DATASHEET / np.sqrt(len(known))
    return float(np.exp(logs.mean())) if alike or (several and factor > by_chance and logs.std() < DATASHEET) else 0.0


def _mean_log(values: Array) -> float:
    """The mean logarithm of what is known; NaN where nothing is."""
    known = values[np.isfinite(values) & (values > 0.0)]
    return float(np.log(known).mean()) if len(known) else np.nan
