"""What an encoder's steps do to the lines of an angle: errors that repeat in every period, where the joint moves, and others.

A joint that moves over thousands of steps a period has errors that are white. One that is held and moves over a few has them where
it moves itself, many times as large: nothing between the lines of the spectrum tells of them.
"""

from __future__ import annotations

import numpy as np

from ident.records.campaign import Array

#: Encoder steps, at most, over which an angle is at rest.
FEW_STEPS = 6
#: Steps, at most, over which a reading hardly tells how its joint moves: its error may all be at one line.
HIDDEN_STEPS = 4
#: Harmonics of the error as a function of the angle that are told apart, the others are white; what a line has beyond this many times
#: its error is motion; passes from a white error to that which the motion makes.
HARMONICS, MOTION, PASSES = 12, 4.0, 4
#: Share of the error that repeats, from which on it matters where it lies.
LEAST = 1e-3
#: Relative error of all lines alike that a loop around the encoder makes of as large an error, beside the motion, as the motion, at least;
#: and where the joint moves more slowly than at twenty hertz this frequency over its own: loops answer up to some tens of hertz. By their
#: work it was 7 to 13 Hz of joints that a PD of 5 Hz and an observer of 30 Hz held at 2 to 5 Hz.
ALIKE, ANSWERED = 0.5, 10.0


def encoder_step(theta: Array) -> Array:
    """Returns the smallest change between two samples [n, rad] of angles [T, n]: the encoder's step, or next to nothing."""
    change = np.abs(np.diff(theta, axis=0))
    change[change == 0.0] = np.inf
    smallest = change.min(axis=0)
    return np.where(np.isfinite(smallest), smallest, 0.0)


def quantisation(step: Array, angles: Array, odd: bool, f0: float) -> tuple[Array, Array]:
    """Returns the quantisation variance of a line, a multiple of `f0` [Hz], of the mean of `angles` [M, S, n]: its mean over all lines [n, rad^2], and that of
    each line 0 .. S/2 [S // 2 + 1, n, rad^2].

    step^2/12 over the DFT, E|X|^2 = 4/S * step^2/12 in peak amplitudes. Noise of standard deviation sigma makes the error another
    one in every period but for a share exp(-(2 pi sigma / step)^2) of its power (B. Widrow, I. Kollar, Quantization Noise, Cambridge
    2008); that share repeats, and with an `odd` excitation (half-wave symmetric, all lines odd) it may gather on the odd lines:
    twice the power. An angle of `FEW_STEPS` in all, of a joint that sticks, flickers without being another: all of it repeats.
    """
    M, S, n = angles.shape
    sigma2 = np.maximum(np.mean(np.var(angles, axis=0, ddof=1), axis=0) - step**2 / 12.0, 0.0)
    same = np.exp(-((2.0 * np.pi) ** 2) * sigma2 / np.where(step > 0.0, step, 1.0) ** 2)
    span = np.ptp(angles, axis=(0, 1))
    same = np.where(span < (FEW_STEPS + 0.5) * step, 1.0, same)
    white = step**2 / (3.0 * S)
    repeats, changes = same * (2.0 if odd else 1.0) * white, (1.0 - same) / M * white
    shape = np.ones((S // 2 + 1, n))
    for k in np.flatnonzero((same > LEAST) & (step > 0.0)):
        hidden = span[k] < (HIDDEN_STEPS + 0.5) * step[k]
        shape[:, k] = S / 2 if hidden else _shape(angles[:, :, k].mean(axis=0), float(step[k]), float(repeats[k]), f0)
    return repeats + changes, repeats * shape + changes


def _shape(angle: Array, step: float, white: float, f0: float) -> Array:
    """The power of the quantisation error of a period of an `angle` [S] at lines 0 .. S/2, in units of the `white` error's.

    For a motion that is a Gaussian process, as that of a multisine nearly is, wherever its mean lies between two steps: the error is
    a sawtooth of the angle, and harmonic k of it correlates as exp(-(2 pi k)^2 D) where the angle changes by a mean square of 2 D
    steps^2. The motion is what stands out of the error, which is first taken for white.
    """
    S, k = len(angle), np.arange(1, HARMONICS + 1)[:, None]
    power = (np.abs(np.fft.rfft(angle)) * (2.0 / S)) ** 2
    power[0] = 0.0
    weight = 6.0 / (np.pi * k) ** 2
    shape = np.ones(S // 2 + 1)
    for _ in range(PASSES):
        moved = np.where(power > MOTION * shape * white, power - shape * white, 0.0)
        correlation = np.fft.irfft(moved / step**2, S) * (S / 4.0)
        change = correlation[0] - correlation
        alike = np.zeros(S)
        near = change < 1.0  # further off, the sawtooth is another one
        alike[near] = (weight * np.exp(-((2.0 * np.pi * k) ** 2) * change[near])).sum(axis=0)
        alike[0] = 1.0
        shape = np.maximum(np.fft.rfft(alike).real, 0.0)
    return shape + _of_the_loop(moved / white, S, f0)


def _of_the_loop(moved: Array, S: int, f0: float) -> Array:
    """What a loop around the encoder adds to the error's power at the lines that `moved` [S // 2 + 1], both in units of a white error's.

    The error is a function of the angle, so it does no work in a period: sum f Im(theta* e) = 0. The loop answers it, at high
    frequencies late; where the joint moves the error must lead by as much: one relative error of all lines, as wrong as that of one, and the
    larger the more slowly it moves.
    """
    total = moved.sum()
    if total == 0.0:
        return np.zeros_like(moved)
    slowly = ANSWERED / (f0 * float(np.arange(len(moved)) @ moved) / total)
    share = min(max(ALIKE, slowly) * S / 2.0 / total, 1.0)
    lines = total**2 / (moved @ moved)
    return np.asarray(lines * share**2 * moved)
