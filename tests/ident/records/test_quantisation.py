"""The error of an encoder's steps where a joint moves over few of them: as large as told, at the lines where it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from two_joints import two_joints

from ident.arm.coupled import fit_coupled
from ident.records.frf import estimate
from ident.records.quantisation import HIDDEN_STEPS, quantisation
from ident.simulator.bench import simulate
from symgen.plan import plan_of_robot

S, M = 2000, 4
LINES = np.arange(1, 241, 2)


def slow(steps: float, rng: np.random.Generator, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """M periods of a motion over so many steps, falling as 1/f^2 above 1 Hz, as it is [S] and as its encoder of step 1 reads it [M, S, 1]."""
    X = np.zeros(S // 2 + 1, complex)
    X[LINES] = np.maximum(LINES * 0.5, 1.0) ** -2.0 * np.exp(2j * np.pi * rng.random(len(LINES)))
    x = np.fft.irfft(X, S)
    x = x * steps / np.ptp(x) + rng.random()
    return x, np.round(np.tile(x, (M, 1)) + noise * rng.standard_normal((M, S)))[..., None]


@pytest.mark.parametrize("steps", [6, 16, 60, 400])
def test_the_error_is_as_large_as_told_at_every_frequency(steps: int) -> None:
    """As a white one it was 20 times as large at the lowest lines, where the joint moves."""
    rng, ratio = np.random.default_rng(1), []
    for _ in range(60):
        x, read = slow(steps, rng)
        error = np.fft.rfft(read[..., 0].mean(axis=0) - x)[LINES] * (2 / S)
        told = quantisation(np.ones(1), read, odd=True, f0=0.2)[1][LINES, 0]
        ratio.append(np.abs(error) ** 2 / told)
    power = np.mean(ratio, axis=0)
    for lines in np.array_split(np.arange(len(LINES)), [10, 30, 60]):
        assert 0.1 < power[lines].mean() < 1.2  # half of it: that it may gather on odd lines is charged always


def test_over_many_steps_it_is_white_and_hidden_it_may_be_anywhere() -> None:
    rng = np.random.default_rng(2)
    mean, each = quantisation(np.ones(1), slow(20000, rng)[1], odd=True, f0=0.2)
    assert mean == pytest.approx(2 / (3 * S)) and each[LINES] == pytest.approx(
        np.full((len(LINES), 1), mean[0]), rel=0.02
    )
    mean, each = quantisation(np.ones(1), slow(HIDDEN_STEPS - 1, rng)[1], odd=True, f0=0.2)
    assert mean == pytest.approx(2 / (3 * S)) and each == pytest.approx(S / 2 * mean[0])


def test_a_joint_at_rest_and_noise_over_steps_have_no_line_of_their_own() -> None:
    mean, each = quantisation(np.zeros(1), np.ones((M, S, 1)), odd=False, f0=0.2)
    assert not mean.any() and not each.any()
    mean, each = quantisation(np.ones(1), slow(40, np.random.default_rng(3), noise=1.0)[1], odd=False, f0=0.2)
    assert each == pytest.approx(np.full_like(each, mean[0]))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.bench
def test_deviations_are_honest_where_held_joints_move_over_few_counts(seed: int, tmp_path: Path) -> None:
    """4096 counts, a held joint moves over 4 to 10: the coupling of the links was off by up to 7 standard deviations."""
    experiment = "sample_rate_Hz = 500\nline_spacing_Hz = 2.0\nband_Hz = [2.0, 60.0]\nperiods = 3"
    robot = two_joints(tmp_path, experiment, *2 * [{"encoder_counts_per_rev": 4096}])
    plan = plan_of_robot(robot)
    cells = [(plan.cells[k].joint, plan.cells[k].q) for k in (0, 1, 2, 4, 6, 7)]
    campaign = simulate(plan.model.chain, robot, cells, seed=seed, workers=1)
    fit = fit_coupled(campaign, plan.model, [estimate(record, campaign) for record in campaign.records])
    off = (fit.alpha - plan.model.alpha_cad) / np.sqrt(np.diag(fit.covariance))
    assert fit.explained and np.abs(off).max() < 3.0


@pytest.mark.bench
def test_a_posture_that_the_encoder_hardly_tells_is_said(tmp_path: Path) -> None:
    """2000 counts behind no gear: the joint is held somewhere within 3 mrad."""
    experiment = "sample_rate_Hz = 500\nline_spacing_Hz = 2.0\nband_Hz = [2.0, 60.0]\nperiods = 3"
    direct = {"N": 1, "J_m_kgm2": 5e-3, "torque_limit_Nm": 30, "encoder_counts_per_rev": 2000}
    robot = two_joints(tmp_path, experiment, {}, direct)
    plan = plan_of_robot(robot)
    cells = [(plan.cells[k].joint, plan.cells[k].q) for k in (0, 1, 2, 4, 6, 7)]
    campaign = simulate(plan.model.chain, robot, cells, seed=1, workers=1)
    fit = fit_coupled(campaign, plan.model, [estimate(record, campaign) for record in campaign.records])
    (said,) = [line for line in fit.status if "counts" in line]
    assert said.startswith("j2: ") and "0.00091 only" in said
    off = (fit.alpha - plan.model.alpha_cad) / np.sqrt(np.diag(fit.covariance))
    assert 1.0 < np.abs(off).max() < 3.0 * float(said.split("off by ")[1].split()[0])
