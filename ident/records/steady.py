"""Whether what answers an excitation is the same from the beginning of a record to its end.

An amplitude that grows or shrinks while it is recorded has sidebands about its line that fall off with the distance in
bins; noise and the leakage of what is not periodic know nothing of the lines. What drifts is taken for noise otherwise:
periods that differ from one to the next in one way differ as those of a noise do that is as large.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincc

from ident.records.campaign import Array, Record
from ident.records.leakage import BINS, ORDER, ROUNDING, windows

#: Probability of calling noise a drift, of one record: of 270 none was below 1e-4, but one of an encoder with play.
SURE = 1e-8
#: Most that one line tells, in logarithms of its probability: a line next to a resonance of the noise is no drift.
MOST = 6.0
#: Samples of the noise at a line besides the one along what a drift does.
OTHERS = BINS - ORDER - 1


def drift(record: Record, first: int, joint: int) -> float:
    """By which share of itself the response of a motor, torque to angle, changes from period `first` of a record to its end, rms over
    its lines; 0 where that is no more than noise makes of it."""
    kept = slice(first * record.samples_per_period, None)
    M, lines = record.periods - first, np.sort(record.lines)
    both = np.stack([record.tau[kept, joint], record.theta[kept, joint]], axis=1)
    spectrum = np.fft.rfft(both - both[0], axis=0)
    bins, offsets = windows(len(spectrum), M, lines)
    tau, theta = spectrum[lines * M].T
    usable = np.abs(tau) > ROUNDING * np.abs(tau).max()
    G = np.where(usable, theta, 0.0) / np.where(usable, tau, 1.0)
    error = spectrum[bins, 1] - G[:, None] * spectrum[bins, 0]  # what feedback does of a drift it does to both
    grown, ratio = np.zeros(len(lines)), np.zeros(len(lines))
    rounding = (ROUNDING * np.abs(theta).max()) ** 2
    for pattern in np.unique(offsets, axis=0):
        at = np.flatnonzero((offsets == pattern).all(axis=1))
        free = np.linalg.qr((pattern[:, None] / np.abs(pattern).max()) ** np.arange(ORDER), mode="complete")[0][
            :, ORDER:
        ]
        left, shape = error[at] @ free, free.T @ (1.0 / pattern)
        size = float(shape @ shape)
        along = np.abs(left @ shape) ** 2 / size
        others = np.sum(np.abs(left) ** 2, axis=1) - along
        ratio[at] = along / np.maximum(others + rounding, np.finfo(float).tiny)
        grown[at] = np.maximum(along - others / OTHERS, 0.0) / size
    told = np.minimum(OTHERS * np.log1p(ratio), MOST)[_apart(bins)]  # exponentially distributed if it is noise
    if gammaincc(len(told), told.sum()) > SURE:
        return 0.0
    return float(2.0 * np.pi * np.sqrt(np.sum(grown) / np.sum(np.abs(theta) ** 2)))


def _apart(bins: Array) -> list[int]:
    """Which of some windows of bins [L, BINS], lowest first, have none in common."""
    chosen, end = [], -1
    for k, (low, high) in enumerate(bins[:, [0, -1]].tolist()):
        if low > end:
            chosen.append(k)
            end = high
    return chosen
