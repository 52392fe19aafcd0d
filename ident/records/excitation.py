"""One period of a multisine: which lines, how strong, in which phase."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ident.errors import ExperimentError

Array = NDArray[np.float64]

#: Above this frequency [Hz] the spectrum is flat, below it falls in proportion to f: a torque of constant amplitude moves
#: a free joint by A/(J w^2), radians at 0.1 Hz.
KNEE = 3.0

#: Odd lines per detection line: one random line of every group is left out, to show odd nonlinear distortion there.
GROUP = 4

_WHOLE = 1e-9  # relative: how close to a whole number a ratio of two decimal frequencies must be


@dataclass(frozen=True)
class Multisine:
    """The sum over l of amplitude[l] cos(2 pi lines[l] f0 t + phase[l]): f0 [Hz], lines [L], amplitude [L, N m], phase [L, rad]."""

    f0: float
    lines: NDArray[np.int64]
    amplitude: Array
    phase: Array

    def __post_init__(self) -> None:
        for name, kind in (("lines", np.int64), ("amplitude", float), ("phase", float)):
            array = np.array(getattr(self, name), dtype=kind)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def rms(self) -> float:
        """Root mean square over a period, in the unit of the amplitude."""
        return float(np.sqrt(np.sum(self.amplitude**2) / 2))

    @property
    def spectrum(self) -> NDArray[np.complex128]:
        """Complex amplitude of each line [L]: the signal is the real part of sum spectrum exp(2 pi j lines f0 t)."""
        return np.asarray(self.amplitude * np.exp(1j * self.phase))

    def samples(self, fs: float) -> Array:
        """One period [fs/f0] sampled at fs [Hz]. ExperimentError if a line is not below fs/2 or fs/f0 is not whole."""
        count = round(fs / self.f0)
        if abs(fs / self.f0 - count) > _WHOLE * count:
            raise ExperimentError(
                f"multisine: fs/f0 = {fs / self.f0:.10g}; expected a whole number of samples a period"
            )
        if 2 * self.lines[-1] >= count:
            top = self.lines[-1] * self.f0
            raise ExperimentError(f"multisine: line at {top:g} Hz; expected below fs/2 = {fs / 2:g} Hz")
        return synthesise(self.lines, self.spectrum, count)

    def crest(self, fs: float) -> float:
        """Crest factor of the samples at fs [Hz]: peak over rms."""
        return float(np.abs(self.samples(fs)).max() / self.rms)

    def scaled(self, rms: float) -> Multisine:
        """The same signal with another rms."""
        return replace(self, amplitude=self.amplitude * (rms / self.rms))


def synthesise(lines: NDArray[np.int64], spectrum: NDArray[np.complex128], count: int) -> Array:
    """One period [count, ..] of the real signal with complex amplitudes spectrum [L, ..] at the harmonics lines [L]."""
    full = np.zeros((count // 2 + 1, *spectrum.shape[1:]), dtype=complex)
    full[lines] = spectrum * (count / 2)
    return np.fft.irfft(full, n=count, axis=0)


def schroeder(f0: float, band: tuple[float, float], *, rms: float = 1.0, knee: float = KNEE) -> Multisine:
    """Every line in `band` [Hz], with Schroeder's phases: low crest factor without a search.

    phase[n] = -2 pi sum over l < n of (n - l) p[l], p the relative power of a line (DOI 10.1109/TIT.1970.1054411).
    ExperimentError if the band holds no line.
    """
    lines = _lines_in(f0, band, step=1)
    amplitude = _shape(lines, f0, knee)
    power = amplitude**2 / np.sum(amplitude**2)
    before = np.concatenate([[0.0], np.cumsum(power)[:-1]])
    return Multisine(f0, lines, amplitude, -2 * np.pi * np.cumsum(before)).scaled(rms)


def random_phase_odd(
    f0: float,
    band: tuple[float, float],
    rng: np.random.Generator,
    *,
    fs: float,
    rms: float = 1.0,
    knee: float = KNEE,
    detection: bool = True,
    tries: int = 30,
) -> Multisine:
    """Odd lines in `band` [Hz] with random phases, the lowest crest factor at fs of `tries` draws from `rng`.

    Even lines then show even nonlinear distortion, and with `detection` one random line of every `GROUP` odd ones is left
    out to show odd distortion (Pintelon & Schoukens, System Identification, 2nd ed., section 4.3).
    ExperimentError if the band holds no odd line.
    """
    lines = _lines_in(f0, band, step=2)
    if detection:
        groups = len(lines) // GROUP
        lines = np.delete(lines, GROUP * np.arange(groups) + rng.integers(GROUP, size=groups))
    amplitude = _shape(lines, f0, knee)
    draws = [Multisine(f0, lines, amplitude, rng.uniform(0, 2 * np.pi, len(lines))) for _ in range(tries)]
    return min(draws, key=lambda draw: draw.crest(fs)).scaled(rms)


def _lines_in(f0: float, band: tuple[float, float], step: int) -> NDArray[np.int64]:
    """Harmonics of f0 in the band: all (step 1) or the odd ones (step 2)."""
    low, high = int(np.ceil(band[0] / f0 * (1 - _WHOLE))), int(np.floor(band[1] / f0 * (1 + _WHOLE)))
    low = max(low, 1)
    if step == 2:
        low += 1 - low % 2
    if high < low:
        kind = "line" if step == 1 else "odd line"
        raise ExperimentError(f"multisine: band {band[0]:g} to {band[1]:g} Hz holds no {kind} of f0 = {f0:g} Hz")
    return np.arange(low, high + 1, step, dtype=np.int64)


def _shape(lines: NDArray[np.int64], f0: float, knee: float) -> Array:
    """Relative amplitudes [L]: flat above the knee, in proportion to the frequency below."""
    return np.asarray(np.minimum(1.0, lines * (f0 / knee)))
