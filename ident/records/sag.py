"""What a spring gives at rest: a joint's mean load times a compliance, the same one in all records, whatever K is declared.

A zero that is off is the same under any load, a joint that fell is off alone, a ratio goes with the angle: none goes with the load.
"""

from __future__ import annotations

import numpy as np

from ident.records.campaign import Array

#: Least and largest K found over K declared that is sag, not a slip; any K where none is declared.
SOFTER, STIFFER = 0.4, 2.5
#: How far [rad or m] from load times compliance a joint may rest, as a zero is set by eye; share of the rms deflection that this leaves at
#: most, of one by any K too, and that where loads are all alike, and a zero leaves less by chance.
ASIDE, LEFT, LEFT_BY_ANY, ALIKE = 0.05, 0.5, 0.2, 0.02

#: Least number of records that tell a compliance and something beside it.
ENOUGH = 4


def compliance(load: Array, error: Array, K: float) -> float:
    """Returns the compliance [rad/(N m)] by which mean angles lie off their postures, `error` [R, rad], under mean loads [R, N m]; 0
    where they do not go with the load, or by none that K [N m/rad, NaN: unknown] allows. Metres and newtons for what slides."""
    found = common(load, error, K)
    left = error - found * load
    size, scatter = _rms(left), _rms(error - error.mean())
    part = LEFT_BY_ANY if np.isnan(K) else LEFT
    sag = np.abs(left).max() <= ASIDE and size <= part * _rms(error) and size <= max(scatter, ALIKE * _rms(error))
    return found if sag else 0.0


def common(load: Array, error: Array, K: float) -> float:
    """Returns the compliance that most of the records share, by load, however far off the others are; 0 where K does not allow it."""
    loaded = load != 0.0
    if not loaded.any():
        return 0.0
    each, weight = error[loaded] / load[loaded], np.abs(load[loaded])
    order = np.argsort(each)
    half = np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)
    found = float(each[order][half])
    return found if _allowed(found, K) else 0.0


def beside_zero(load: Array, error: Array, K: float) -> float:
    """Returns the compliance that there is beside a zero that is off; 0 where too few records tell, or K does not allow it."""
    if len(load) < ENOUGH or np.ptp(load) == 0.0:
        return 0.0
    return common(load - load.mean(), error - error.mean(), K)


def beside_ratio(load: Array, angle: Array, q: Array, K: float) -> float:
    """Returns the compliance, by the loads as told, that there is where mean angles [R] are a multiple of those `q` at which the spring holds; 0
    as above. A gear ratio that is off has the loads off the other way."""
    columns = np.stack([q, load], axis=1)
    if len(load) < ENOUGH or np.linalg.matrix_rank(columns) < 2:
        return 0.0
    ratio, given = np.linalg.lstsq(columns, angle, rcond=None)[0]
    return float(given / ratio) if _allowed(given / ratio**2, K) else 0.0


def _allowed(found: float, K: float) -> bool:
    return bool(found > 0.0 and (np.isnan(K) or SOFTER <= 1 / (found * K) <= STIFFER))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
