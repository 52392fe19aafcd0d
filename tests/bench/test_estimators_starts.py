"""Do fits end where they should, wherever they start? Random starts on one arm, random arms with wrong datasheets.

The two yaw-pitch-pitch arms at the postures of their plans; their motion is linear and sampled exactly (tests/ident/synthetic.py),
so that an optimum is the truth but for noise.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from study import markdown, planned, publish, true_drives
from synthetic import ENCODER, Arm, campaign, record

from ident.arm.coupled import CoupledFit, Start, fit_coupled
from ident.arm.evidence import gravity_basis
from ident.records.campaign import Campaign
from ident.records.frf import estimate
from symgen.chain import Chain, Inertia
from symgen.kinematics import inertia_matrix
from symgen.plan import Model, chain_of_robot, make_model
from symgen.robot import Drive, Robot, load_robot

ROBOTS = Path(__file__).parents[2] / "robots"
#: Of each kind; four kinds make a hundred.
TRIES = 25
F0, LINES, PERIODS = 0.5, np.arange(3, 240, 2), 4
#: Starts and datasheets are off by up to this factor in K and J_m, ten times in damping.
FACTORS = (1.5, 3.0)
#: Links of a start are off by up to this factor: mass, lever arm and inertia each on their own.
LINKS_OFF = 1.5
#: Other starts end within this share of a standard deviation of the optimum, and every optimum within so many of the truth.
SAME, FAR = 0.05, 5.0
GAINS = np.array([0.4, 4e-3])


def wrong(values: np.ndarray, factor: float, rng: np.random.Generator) -> np.ndarray:
    """`values`, each off by up to `factor`."""
    return values * factor ** rng.uniform(-1, 1, np.shape(values))


def other_links(chain: Chain, factor: float, rng: np.random.Generator) -> Chain:
    """The arm with other bodies; zeros stay zeros."""

    def off(body: Inertia) -> Inertia:
        mass, lever, inertia = wrong(np.ones(3), factor, rng)
        return Inertia(body.mass * float(mass), body.com * lever, body.I * inertia)

    return replace(chain, joints=tuple(replace(joint, inertia=off(joint.inertia)) for joint in chain.joints))


def constants(model: Model, chain: Chain) -> np.ndarray:
    """alpha [D] of `chain` in the basis of `model`."""
    q = model.random_postures(60, np.random.default_rng(0))
    rows = model.J_rows(q).reshape(-1, len(model.names))
    return np.asarray(np.linalg.lstsq(rows, inertia_matrix(chain, q).ravel(), rcond=None)[0])


def records_of(model: Model, robot: Robot, chain: Chain, drives: list[Drive], rng: np.random.Generator) -> Campaign:
    """What the arm of these links and drives answers at the postures of its plan; no datasheet."""
    K, J_m, D, D_spring, N = np.array([[d.K, d.J_m, d.D, d.D_spring, d.N] for d in drives]).T
    records = []
    for k, (joint, q) in enumerate(planned(robot)):
        J, K_g = inertia_matrix(chain, q[None])[0], model.gravity_stiffness_rows(q, robot.gravity) @ chain.parameters
        arm = Arm(J, K, J_m, D, D_spring, K_g, N)
        gains = GAINS * (J_m / 4e-5)[:, None]
        records.append(
            record(arm, chain.names.index(joint), lines=LINES, f0=F0, periods=PERIODS, step=ENCODER, gains=gains, rng=rng,
                   id=f"r{k}", posture=q)
        )  # fmt: skip
    made = campaign(arm, records)
    unknown = np.full(len(K), np.nan)
    return replace(made, joints=chain.names, gravity=robot.gravity, K=unknown, J_m=unknown)


def fitted(model: Model, data: Campaign, start: Start | None = None) -> CoupledFit:
    return fit_coupled(data, model, [estimate(one, data) for one in data.records], start)


def off(found: CoupledFit, alpha: np.ndarray) -> float:
    """How far `found` is from `alpha`: the largest of the principal deviations, in standard deviations."""
    size, axes = np.linalg.eigh(found.covariance)
    return float(np.abs((axes.T @ (found.alpha - alpha)) / np.sqrt(np.maximum(size, 1e-300))).max())


@pytest.mark.bench
@pytest.mark.parametrize("name", ["ypp3", "ypp3_general"])
def test_random_starts_end_at_one_optimum(name: str) -> None:
    rng, robot = np.random.default_rng(1), load_robot(ROBOTS / name)
    chain = chain_of_robot(robot)
    model = make_model(chain, believe_zeros=robot.believe_zeros)
    basis = gravity_basis(model, robot.gravity)

    def arm(links: Chain, K: np.ndarray, J_m: np.ndarray, D: np.ndarray, D_spring: np.ndarray) -> Start:
        return Start(K, J_m, D, D_spring, constants(model, links), basis @ links.parameters)

    drives = [robot.drive(joint) for joint in chain.names]
    K, J_m, D, D_spring = np.array([[d.K, d.J_m, d.D, d.D_spring] for d in drives]).T
    data = records_of(model, robot, chain, drives, rng)
    best = fitted(model, data, arm(chain, K, J_m, D, D_spring))
    assert best.explained and off(best, model.alpha_cad) < FAR
    rows = []
    for factor in FACTORS:
        found = [
            fitted(model, data, arm(other_links(chain, LINKS_OFF, rng), wrong(K, factor, rng), wrong(J_m, factor, rng),
                                    wrong(D, 10 * factor, rng), wrong(D_spring, 10 * factor, rng)))
            for _ in range(TRIES)
        ]  # fmt: skip
        good = sum(one.explained and off(one, best.alpha) < SAME for one in found)
        rows.append([f"starts of one arm, drives off by up to a factor {factor:g}", f"{good} of {TRIES}"])
    for factor in FACTORS:
        good = 0
        for _ in range(TRIES):
            links = other_links(chain, LINKS_OFF, rng)
            own = true_drives(chain, robot, rng)
            made = records_of(model, robot, links, own, rng)
            made = replace(
                made,
                K=wrong(np.array([d.K for d in own]), factor, rng),
                J_m=wrong(np.array([d.J_m for d in own]), factor, rng),
            )
            one = fitted(model, made)
            good += one.explained and off(one, constants(model, links)) < FAR
        rows.append([f"arms, datasheets off by up to a factor {factor:g}", f"{good} of {TRIES}"])
    publish(f"Start values: {name}", markdown(["what was random", "right"], rows))
    assert all(row[1] == f"{TRIES} of {TRIES}" for row in rows)
