"""What a signal tells about its own excitation: the period, and which harmonics were played."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ident.records.campaign import Array

#: Largest share of the power that may differ between one period and the next.
CHANGE = 0.2

#: A period within this factor of the best one's change counts as one, so that the shortest is found.
_TIE = 1.5
#: Excited lines stand this many times above the strongest line that is not, and above the noise.
GAP, ABOVE_NOISE = 3.0, 6.0
#: Lines below this part of the strongest are none: shaped spectra fall by 30, numbers in text files have rounding.
_FAINT = 3e-3
#: Fewer lines make no multisine: a trajectory has its first harmonic.
_FEWEST = 4


def find_period(x: Array) -> int | None:
    """Returns the period of x [T] in samples, None where less than two are there or nothing repeats.

    The shortest shift by which x changes as little as by any other: half of mean (x[t + S] - x[t])^2 over the variance.
    Shifts so short that x has not yet changed at all are none (A. de Cheveigne, H. Kawahara, J. Acoust. Soc. Am. 111
    (2002) 1917, DOI 10.1121/1.1458024).
    """
    x = np.asarray(x, dtype=float) - np.mean(x)
    change = _change(x)
    moved = change > 1.0  # a periodic signal without a mean is as often against as with its shifted self
    if not moved.any():
        return None
    start = int(np.argmax(moved))
    best = float(change[start:].min())
    if not best < CHANGE:
        return None
    close = change <= _TIE * best + 1e-12  # rounding of the transforms is no difference
    first = start + int(np.argmax(close[start:]))
    behind = first + int(np.argmin(np.append(close[first:], False)))
    return first + int(np.argmin(change[first:behind]))


def _change(x: Array) -> Array:
    """Relative change of x [T] over every shift from 0 to T/2; empty for a constant."""
    T = len(x)
    power = np.concatenate([[0.0], np.cumsum(x**2)])
    if not power[-1] > 0.0:
        return np.zeros(0)
    size = 1 << (2 * T - 1).bit_length()
    product = np.fft.irfft(np.abs(np.fft.rfft(x, size)) ** 2, size)
    shifts = np.arange(T // 2 + 1)
    both = power[T - shifts] + power[T] - power[shifts]
    return np.asarray((both - 2 * product[shifts]) / np.maximum(both, np.finfo(float).tiny))


def find_lines(x: Array, period: int) -> NDArray[np.int64] | None:
    """Returns the harmonics that x [periods * period] consists of, None where they do not stand out from the others.

    They are the lines above the widest gap in the sorted amplitudes, and above the noise between the lines. Of three
    periods or more the first does not count, as excitations are ramped up in it; a straight drift is taken off.
    """
    periods = x[: len(x) // period * period].reshape(-1, period)
    periods = periods[1:] if len(periods) > 2 else periods
    M = len(periods)
    drift = np.polyfit(np.arange(M), periods.mean(axis=1), 1)[0] if M > 1 else 0.0  # of a periodic signal: none
    flat = periods.ravel() - drift * np.arange(M * period) / period
    spectrum = np.abs(np.fft.rfft(flat - np.mean(flat)))
    amplitude = spectrum[M::M][: (period - 1) // 2]
    bins = np.arange(len(spectrum))
    noise = np.sqrt(np.mean(spectrum[(bins % M != 0)] ** 2)) if M > 1 else 0.0
    floor = max(_FAINT * float(amplitude.max(initial=0.0)), ABOVE_NOISE * float(noise))
    order = np.argsort(amplitude)[::-1]
    count = int(np.count_nonzero(amplitude > floor))
    if not count:
        return None
    level = np.maximum(amplitude[order[: count + 1]], floor / GAP)
    drop = level[:-1] / level[1:]
    if not drop.max(initial=0.0) >= GAP:
        return None
    found = np.sort(order[: int(np.argmax(drop)) + 1]) + 1
    return np.asarray(found, dtype=np.int64) if len(found) >= _FEWEST else None
