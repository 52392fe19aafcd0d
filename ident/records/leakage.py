"""Spectra of records over whole periods: what is read at a line, what leaks into it, and how far it can be trusted.

The bins between the lines of a periodic response hold nothing but noise and the leakage of whatever differs between the two
ends of the record (the local polynomial approach, see `ident.records.frf`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ident.records.campaign import Array, Record

Complex = NDArray[np.complex128]

#: Bins between the lines from which leakage and noise of one line are read, and the coefficients of its polynomial. A
#: straight line takes settling records for unsettled.
BINS, ORDER = 10, 3
#: A period that gains less than this share of a record's variance is left out: a parabola is not quite what leaks from it, which
#: cost as much as that where a transient rings.
WORTH = 0.1
#: Independent estimates of leakage that are judged together.
LEAKAGES = 16
#: Spectra carry rounding errors of about 1e-16 of the largest line; nothing is trusted beyond this.
ROUNDING = 1e-13


def most_telling(record: Record, band: NDArray[np.int64], first: int) -> tuple[int, Complex, Complex]:
    """Returns the period from which on a record tells most, not before `first`, and mean and errors of torques and angles as
    `between_lines` has them. A period more is no gain where its leakage has to be taken off all of them."""
    P, S = record.periods, record.samples_per_period
    best, least = None, np.inf
    for start in range(first, max(P - 2, first + 1)):
        if (1.0 - WORTH) / (P - start) >= least:
            break
        kept = np.concatenate([record.tau[start * S :], record.theta[start * S :]], axis=1)
        mean, errors, cost = between_lines(kept, P - start, band, sparing=True)
        if (1.0 - WORTH) * cost / (P - start) < least:
            best, least = (start, mean, errors), cost / (P - start)
    assert best is not None
    return best


def between_lines(
    kept: Array, M: int, band: NDArray[np.int64], sparing: bool = False
) -> tuple[Complex, Complex, float]:
    """Returns the spectrum of `kept` [M S, c] at lines `band` [F], leakage taken off [F, c], its errors [R, F, c], and how many
    times their variance that took.

    Over M periods, line k is bin k M; the bins between lines hold noise and the leakage of whatever differs between the
    two ends of the record. A parabola through the nearest BINS of them (line bins left out, excited or not) is the
    leakage at the line; what it leaves, rotated to R = BINS - ORDER independent samples and scaled by the
    interpolation's own variance, is the error. That costs a quarter of the variance: `sparing` takes off only Wiener's
    share, none where no more leaks than noise makes of it; what is left is error.
    """
    spectrum = np.fft.rfft(kept - kept[0], axis=0) * (2.0 / len(kept))
    bins, offsets = windows(len(spectrum), M, band)
    mean = spectrum[band * M]
    leakage, spread = np.empty_like(mean), np.empty(len(band))
    errors = np.empty((BINS - ORDER, *mean.shape), dtype=complex)
    for begin in np.unique(offsets[:, 0]):  # one design for most lines, others at the ends of the spectrum
        at = np.flatnonzero(offsets[:, 0] == begin)
        pattern = offsets[at[0]]
        Q, R = np.linalg.qr((pattern[:, None] / np.abs(pattern).max()) ** np.arange(ORDER), mode="complete")
        at_line = Q[:, :ORDER] @ np.linalg.inv(R[:ORDER]).T[:, 0]
        window = spectrum[bins[at]]
        leakage[at], spread[at] = np.einsum("b,fbc->fc", at_line, window), at_line @ at_line
        errors[:, at] = np.einsum("br,fbc->rfc", Q[:, ORDER:], window)
    share, left = np.ones(len(band)), np.zeros(len(band))
    if sparing:
        rounding = ROUNDING * np.abs(mean).max(axis=0)
        excess = _excess(leakage / np.sqrt(spread)[:, None], errors, rounding, M)
        share, left = 1.0 - 1.0 / excess, (excess - 1.0) / excess**2
    cost = 1.0 + spread * (share**2 + left)
    return mean - share[:, None] * leakage, errors * np.sqrt(cost)[:, None], float(cost.mean())


def windows(count: int, M: int, band: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns the `BINS` bins nearest to each line of `band` [F], of so many over M periods, that are none of a line [F, BINS], and how far
    from it they are."""
    between = np.arange(1, count)
    between = between[between % M != 0]
    first = np.clip(np.searchsorted(between, band * M) - BINS // 2, 0, len(between) - BINS)
    bins = between[first[:, None] + np.arange(BINS)]
    return bins, bins - (band * M)[:, None]


def _excess(leakage: Complex, errors: Complex, rounding: Array, M: int) -> Array:
    """Returns the power of the `leakage` [F, c] over what noise as large as `errors` [R, F, c] makes of it, 1 or more, at each line.

    Compared in the direction that shows it most: feedback moves torque and angle together, and what tells the arm is the
    small difference.
    """
    R, F, c = errors.shape
    wide = min(2 * c, F)
    C = moving_average(np.einsum("rfa,rfb->fab", errors, errors.conj()) / R, wide)
    C[:, np.arange(c), np.arange(c)] += rounding**2 + np.finfo(float).tiny
    size = np.sqrt(np.einsum("faa->fa", C).real)
    white = np.linalg.solve(C / size[:, :, None] / size[:, None, :], (leakage / size)[..., None])[..., 0]
    ratio = np.einsum("fa,fa->f", (leakage / size).conj(), white).real / c * (1.0 - c / (R * wide))
    overlap = max(BINS / (M - 1), 1.0)  # lines that read the same bins
    return np.asarray(np.maximum(moving_average(ratio, min(int(np.ceil(LEAKAGES * overlap)), F)), 1.0))


def moving_average(values: NDArray[Any], width: int) -> NDArray[Any]:
    """Returns the mean of `values` [L, ..] over `width` neighbouring lines, at the ends over the nearest `width`.

    Summed by windows of 1, 2, 4, .. lines: a running sum would have the digits of the largest lines everywhere.
    """
    L = len(values)
    total, window, size, done = np.zeros_like(values[: L - width + 1]), values, 1, 0
    while True:
        if width & size:
            total = total + window[done : done + L - width + 1]
            done += size
        if 2 * size > width:
            break
        window, size = window[:-size] + window[size:], 2 * size
    return np.asarray(total[np.clip(np.arange(L) - width // 2, 0, L - width)] / width)
