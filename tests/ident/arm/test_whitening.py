"""The noise of a record: powers under which its samples are likely as vectors, not each angle alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.arm.arm_model import Parameters, Posture, Sampling, response
from ident.arm.whitening import MODEL_ACCURACY, Noise, noise_powers, whitening

RNG = np.random.default_rng(3)
M, R, LINES = 3, 7, 0.5 * np.arange(1, 161)
ARM = Posture(np.arange(M), np.full(M, 100.0), np.eye(M * M).reshape(M, M, M * M), np.zeros((M, M, 0)))
J = np.array([[4.0, 1.5, 0.4], [1.5, 1.2, 0.3], [0.4, 0.3, 0.2]])
P = Parameters(np.full(M, 2e4), np.full(M, 2e-4), np.full(M, 2e-3), np.full(M, 5.0), J.ravel(), np.zeros(0))
SAMPLING = Sampling(LINES, 1000.0, "zoh")
G = response(ARM, P, SAMPLING)
TORQUE, ANGLE = np.array([4e-8, 1e-8, 1e-9]), 1e-14
FLOOR = np.full(M, 1e-15)


def white(*shape: int) -> np.ndarray:
    return (RNG.standard_normal(shape) + 1j * RNG.standard_normal(shape)) / np.sqrt(2.0)


def samples(drift: np.ndarray) -> Noise:
    """(torque, angle) samples of the arm, the angle of its second joint drifting by rms `drift` [L] besides."""
    error = np.einsum("lij,rlj->rli", G, white(R, len(LINES), M) * np.sqrt(TORQUE))
    error += np.sqrt(ANGLE) * white(R, len(LINES), M)
    error[:, :, 1] += drift * white(R, len(LINES))
    return Noise(np.concatenate([np.zeros_like(error), error], axis=2), FLOOR)


def test_powers_of_white_noise_are_found() -> None:
    powers = noise_powers(ARM, P, SAMPLING, samples(np.zeros(len(LINES))), np.zeros((len(LINES), M)))
    assert powers.torque == pytest.approx(TORQUE, rel=0.15)
    assert np.median(powers.angle, axis=0) == pytest.approx(np.full(M, ANGLE), rel=0.5)


@pytest.mark.parametrize("size", [1e-3, 1e-1])
def test_a_joint_that_drifts_leaves_the_others_their_noise(size: float) -> None:
    """Each angle alone, torque noise of one joint explained the drift at the cost of what the others had: a tenth of it was left."""
    drift = size * LINES**-2.0
    powers = noise_powers(ARM, P, SAMPLING, samples(drift), np.zeros((len(LINES), M)))
    assert np.all(powers.torque > 0.7 * TORQUE)
    W = whitening(powers, np.zeros((len(LINES), M)))
    level = (np.abs(np.einsum("lij,rlj->rli", W, samples(drift).samples[:, :, M:])) ** 2).mean(axis=(0, 1))
    assert level[0] < 1.3 and level[2] < 1.3


def test_a_line_at_which_a_transient_rings_has_its_own_power() -> None:
    ringing = np.zeros(len(LINES))
    ringing[40] = 30.0 * np.sqrt(ANGLE + np.sum(np.abs(G[40, 1]) ** 2 * TORQUE))
    noise, still = samples(ringing), np.zeros((len(LINES), M))
    W = whitening(noise_powers(ARM, P, SAMPLING, noise, still), still)
    level = (np.abs(np.einsum("lij,rlj->rli", W, noise.samples[:, :, M:])) ** 2).mean(axis=0)
    assert level[40, 1] < 2.0  # one power for all lines made 50 of it


def test_no_angle_is_quieter_than_the_model_tells_it_whichever_way_gears_turn() -> None:
    theta, turned = np.zeros((len(LINES), M)), replace(ARM, N=-ARM.N)
    theta[:, 0] = 10.0
    nothing = Noise(np.zeros((R, len(LINES), 2 * M), dtype=complex), FLOOR)
    for arm in (ARM, turned):
        powers = noise_powers(arm, P, SAMPLING, nothing, theta)
        np.testing.assert_allclose(powers.angle, (MODEL_ACCURACY * 10.0) ** 2)
