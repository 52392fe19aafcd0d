"""How the periods of a record differ from the motion that repeats: noise moves the arm, and a mean is on its way to rest.

Dry friction is a law of the velocity of the moment: near standstill the mean over periods is not friction of the mean velocity.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ident.records.campaign import Array

#: Samples over which a velocity is smoothed at least.
LEAST = 1.0
#: Variance of third differences of white noise, in its own.
OF_THIRD = 20.0
#: Times as far as the next that a period strays at the beginning of which something died away: so short, its spectrum is smooth, and was
#: taken off as leakage.
DIED_AWAY = 10.0


def strays(angle: Array, repeating: Array, fs: float, quiet: float, samples: int) -> Array:
    """Returns how much faster a joint turns in each of M periods than it does in the one that repeats [M, `samples`, rad/s];
    none of those at the beginning in which a transient died away.

    `angle` [M S, rad] over the periods at `fs` [Hz], `repeating` [S] the period that repeats, without its mean. Smoothed until
    noise of the angle makes no more than `quiet` [rad/s] of it.
    """
    S = len(repeating)
    M = len(angle) // S
    away = angle - np.tile(repeating, M)
    noise = np.sqrt(np.mean(np.diff(away, 3) ** 2) / OF_THIRD) * fs
    # a Gaussian of w samples leaves white noise of a velocity noise / sqrt(4 sqrt(pi) w^3)
    width = max(float((noise / quiet) ** 2 / (4.0 * np.sqrt(np.pi))) ** (1.0 / 3.0), LEAST)
    rate = gaussian_filter1d(away, width, order=1, mode="nearest") * fs
    at = np.arange(M * samples) * (S / samples)
    faster = np.interp(at, np.arange(len(rate)), rate).reshape(M, samples)
    far = np.sqrt(np.mean(faster**2, axis=1))
    still = np.flatnonzero(far[:-1] <= DIED_AWAY * far[1:])
    return faster[still[0] if len(still) else M - 1 :]
