"""Are the standard deviations true, and how far are the estimates from the best that anybody could make of the records?

Linear arms sampled exactly (tests/ident/synthetic.py): the shoulder and elbow of ypp3, two postures, each motor excited once at
each, both held by feedback; torque noise 0.5 %, 17-bit encoders.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm
from study import markdown, publish
from synthetic import ENCODER, FS, Arm, campaign, record

from ident.arm.arm_model import Sampling, motion_and_derivatives
from ident.arm.coupled import Start, fit_coupled
from ident.arm.evidence import gravity_basis, posture_at
from ident.records.campaign import Campaign
from ident.records.frf import estimate
from symgen.plan import Model, make_model
from symgen.urdf import load_chain

ROBOTS = Path(__file__).parents[2] / "robots"
GRAVITY = np.array([0.0, 0.0, -9.81])
LINES = np.arange(3, 240, 2)
POSTURES = ([0.3, 0.6], [-0.4, -1.1])
RUNS, PERIODS, F0, RMS, NOISE = 400, 5, 0.5, 0.1, 0.005
GAINS = np.array([[0.4, 4e-3], [0.2, 2e-3]])
#: Coverage of 95 % intervals, and variance over the Cramer-Rao bound.
COVERAGE, EXCESS = (0.93, 0.97), 1.15


def arm_at(model: Model, q: list[float]) -> Arm:
    K_g = model.gravity_stiffness_rows(np.array(q), GRAVITY) @ model.chain.parameters
    K, J_m, D, D_spring = np.array([[4500.0, 4200], [4e-5, 1e-5], [3e-5, 1e-5], [1.1, 0.3]])
    return Arm(model.J_cad(np.array(q)), K, J_m, D, D_spring, K_g, np.full(2, 100.0))


def measured(model: Model, seed: int) -> Campaign:
    """One draw: the same excitation every time, other noise."""
    records = []
    for k, (q, excited) in enumerate([(q, i) for q in POSTURES for i in range(2)]):
        made = record(
            arm_at(model, q), excited, lines=LINES, f0=F0, periods=PERIODS, rms=RMS, noise=NOISE, step=ENCODER, gains=GAINS,
            rng=Twice(np.random.default_rng(k), np.random.default_rng([seed, k])), id=f"r{k}", posture=np.array(q),
        )  # fmt: skip
        records.append(made)
    whole = campaign(arm_at(model, POSTURES[0]), records)
    return replace(whole, joints=("joint1", "joint2"), gravity=GRAVITY, J_m=arm_at(model, POSTURES[0]).J_m)


class Twice:
    """Draws phases from one generator and noise from another."""

    def __init__(self, phases: np.random.Generator, noise: np.random.Generator) -> None:
        self.random, self.normal = phases.random, noise.normal


def bound(model: Model, truth: Start) -> np.ndarray:
    """The Cramer-Rao bound [P] of the standard deviations: true arm, true noise, settled periods, no transient to be taken off.

    White torque noise of every motor enters through the arm; an encoder's rounding is white, step^2 / 12.
    """
    data = measured(model, 0)
    basis = gravity_basis(model, GRAVITY)
    information = 0.0
    for one in data.records:
        frf = estimate(one, data)
        f = one.lines * one.f0
        arm = posture_at(data, model, basis, np.arange(2), np.array(one.posture))
        G = arm_at(model, list(one.posture)).response(f)
        tau = frf.tau
        slopes = motion_and_derivatives(arm, truth, Sampling(f, FS, "zoh"), tau)[1]
        samples = frf.periods * one.samples_per_period
        amplitude = 4.0 / samples  # E|z|^2 of a line (peak amplitudes) per variance of a sample
        torque, angle = amplitude * (NOISE * RMS) ** 2, amplitude * ENCODER**2 / 12
        covariance = torque * G @ G.conj().swapaxes(1, 2) + angle * np.eye(2)
        white = np.linalg.solve(np.linalg.cholesky(covariance), slopes)
        information = information + 2.0 * np.einsum("lip,liq->pq", white.conj(), white).real
    return np.sqrt(np.diag(np.linalg.inv(information)))


@pytest.mark.bench
def test_intervals_cover_and_variance_is_near_the_bound() -> None:
    model = make_model(load_chain(ROBOTS / "ypp3" / "ypp3.urdf", at={"joint1": 0.0}), believe_zeros=True)
    beta = gravity_basis(model, GRAVITY) @ model.chain.parameters
    arm = arm_at(model, POSTURES[0])
    truth = Start(arm.K, arm.J_m, arm.D, arm.D_spring, model.alpha_cad, beta)
    drives = np.concatenate([arm.K, arm.J_m])
    names = ["K_1", "K_2", "J_m1", "J_m2", *model.names]
    true = np.concatenate([drives, model.alpha_cad])
    values, deviations, misfits = [], [], []
    for seed in range(RUNS):
        data = measured(model, seed)
        found = fit_coupled(data, model, [estimate(one, data) for one in data.records])
        values.append(np.concatenate([found.K, found.J_m, found.alpha]))
        deviations.append(np.concatenate([found.drive_std[0], found.drive_std[1], np.sqrt(np.diag(found.covariance))]))
        misfits.append(found.chi2_per_dof)
    values, deviations = np.array(values), np.array(deviations)
    least = bound(model, truth)
    least = np.concatenate([least[:4] * drives, least[8 : 8 + len(model.names)]])
    covered = np.abs(values - true) < norm.ppf(0.975) * deviations
    excess = np.mean((values - true) ** 2, axis=0) / least**2
    rows = [
        [name, f"{100 * covered[:, k].mean():.1f} %", f"{np.mean((values - true)[:, k]) / deviations[:, k].mean():+.2f}",
         f"{deviations[:, k].mean() / np.std(values[:, k]):.3f}", f"{excess[k]:.3f}", f"{100 * np.std(values[:, k]) / abs(true[k]):.3g} %"]
        for k, name in enumerate(names)
    ]  # fmt: skip
    head = [
        "constant",
        "95 % interval covers",
        "mean error, sigmas",
        "sigma / scatter",
        "variance / Cramer-Rao",
        "scatter",
    ]
    text = f"{RUNS} runs; all constants together: {100 * covered.mean():.2f} % covered, variance {excess.mean():.3f} of the bound; "
    text += f"chi2/dof {np.mean(misfits):.3f}.\n\n" + markdown(head, rows)
    publish("Uncertainty: coverage and Cramer-Rao", text)
    assert COVERAGE[0] <= covered.mean() <= COVERAGE[1]
    assert excess.mean() <= EXCESS
