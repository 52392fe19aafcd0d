"""The multisine is what it says: lines, amplitudes and rms as an independent sum of cosines shows them."""

import numpy as np
import pytest

from ident.errors import ExperimentError
from ident.records.excitation import GROUP, KNEE, Multisine, random_phase_odd, schroeder, synthesise

FS, F0, BAND = 1000.0, 0.1, (0.1, 120.0)
ROUNDING = 1e-10  # relative to the peak: 600 cosines with arguments up to 7e3 rad


def cosines(signal: Multisine, fs: float, count: int) -> np.ndarray:
    angle = 2 * np.pi * np.outer(np.arange(count) / fs, signal.lines * signal.f0) + signal.phase
    return np.cos(angle) @ signal.amplitude


@pytest.mark.parametrize("signal", [schroeder(F0, BAND), random_phase_odd(F0, BAND, np.random.default_rng(0), fs=FS)])
def test_samples_are_the_sum_of_cosines_and_exactly_periodic(signal: Multisine) -> None:
    period = signal.samples(FS)
    direct = cosines(signal, FS, 2 * len(period))
    assert len(period) == 10_000
    assert np.abs(np.tile(period, 2) - direct).max() <= ROUNDING * np.abs(direct).max()
    assert signal.rms == pytest.approx(np.sqrt(np.mean(period**2)), rel=1e-12)
    assert signal.crest(FS) == pytest.approx(np.abs(direct).max() / signal.rms, rel=ROUNDING)
    assert signal.scaled(0.25).rms == pytest.approx(0.25, rel=1e-12)


def test_schroeder_has_every_line_and_a_low_crest_factor() -> None:
    signal = schroeder(F0, BAND, knee=F0)
    assert list(signal.lines) == list(range(1, 1201))
    assert np.ptp(signal.amplitude) == 0.0
    assert signal.crest(FS) < 1.75  # a flat Schroeder multisine has about 1.66; random phases have above 3


def test_amplitude_is_flat_above_the_knee_and_falls_below() -> None:
    signal = schroeder(F0, BAND)
    flat, low = signal.amplitude[signal.lines * F0 >= KNEE], signal.lines * F0 < KNEE
    assert np.ptp(flat) <= 1e-12 * flat[0]
    assert signal.amplitude[low] == pytest.approx(flat[0] * signal.lines[low] * F0 / KNEE, rel=1e-12)


def test_odd_multisine_leaves_one_line_of_each_group_out() -> None:
    signal = random_phase_odd(F0, BAND, np.random.default_rng(1), fs=FS)
    odd = np.arange(1, 1201, 2)
    assert set(signal.lines) < set(odd)
    missing = np.array(sorted(set(odd) - set(signal.lines)))
    assert list((missing - 1) // 2 // GROUP) == list(range(len(odd) // GROUP))
    assert len(set((missing - 1) // 2 % GROUP)) > 1, "the left-out line is random, not always the same"
    assert list(random_phase_odd(F0, BAND, np.random.default_rng(1), fs=FS, detection=False).lines) == list(odd)


def test_random_phases_depend_on_the_generator_alone() -> None:
    one, same, other = (random_phase_odd(F0, BAND, np.random.default_rng(k), fs=FS) for k in (5, 5, 6))
    assert np.array_equal(one.phase, same.phase) and np.array_equal(one.lines, same.lines)
    assert not np.array_equal(one.phase[:10], other.phase[:10])


def test_more_tries_lower_the_crest_factor() -> None:
    one, many = (random_phase_odd(F0, BAND, np.random.default_rng(2), fs=FS, tries=t) for t in (1, 30))
    assert many.crest(FS) < one.crest(FS)


def test_band_edges_are_inside_although_the_ratio_is_not_exact() -> None:
    signal = schroeder(0.1, (0.3, 0.7))  # 0.3 / 0.1 = 2.9999999999999996, 0.7 / 0.1 = 6.999999999999999
    assert list(signal.lines) == [3, 4, 5, 6, 7]


def test_synthesise_several_columns() -> None:
    signal = schroeder(1.0, (1.0, 20.0))
    both = synthesise(signal.lines, np.stack([signal.spectrum, 2 * signal.spectrum], axis=1), 100)
    assert both[:, 1] == pytest.approx(2 * signal.samples(100.0), rel=1e-12)


def test_errors_say_what_was_found() -> None:
    with pytest.raises(ExperimentError, match=r"holds no line of f0 = 1 Hz"):
        schroeder(1.0, (0.2, 0.8))
    with pytest.raises(ExperimentError, match=r"holds no odd line"):
        random_phase_odd(1.0, (2.0, 2.5), np.random.default_rng(0), fs=FS)
    with pytest.raises(ExperimentError, match=r"line at 120 Hz; expected below fs/2 = 100 Hz"):
        schroeder(1.0, BAND).samples(200.0)
    with pytest.raises(ExperimentError, match=r"whole number of samples"):
        schroeder(0.3, BAND).samples(1000.0)
