"""Runge-Kutta's method of order 4 on a linear arm: the steps it needs, and what it lacks of the exact motion.

The generator [k, k] of S states and held inputs is the matrix whose exponential, times t, takes both to t [s] later.
"""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]

_STABLE = 2.5  # |pole| h: stable up to 2.78 on the real axis and 2.83 on the imaginary one
_FOLLOWS = 1.0  # w h at the top of the band: 1 % of a nonlinear term is lost there, (w h)^4 of it below


def steps_needed(generator: Array, S: int, Ts: float, top: float) -> int:
    """Returns the steps a sample of Ts [s] that keep every pole within the region of stability, a real one too, and follow
    motion up to `top` [Hz]. Complete only with `defect`."""
    poles = np.abs(np.linalg.eigvals(generator[:S, :S])).max()
    return max(1, ceil(max(poles / _STABLE, 2 * np.pi * top / _FOLLOWS) * Ts))


def defect(generator: Array, S: int, Ts: float, steps: int) -> Array:
    """Returns [S, k] what `steps` steps a sample of Ts [s] lack, (states, inputs) -> states at the end of it.

    Added to what the method makes of the nonlinear arm, its linear part moves exactly as under a held torque, at any step;
    what is left of the integrator's error is of the size of the nonlinearity.
    """
    H = generator * (Ts / steps)
    step, power = np.eye(len(H)), np.eye(len(H))
    for k in range(1, 5):
        power = power @ H / k
        step += power
    return np.asarray((expm(H * steps) - np.linalg.matrix_power(step, steps))[:S])
