"""Do fits end where they should, wherever they start? Random starts on one arm, random arms with wrong datasheets.

Linear arms of two joints, sampled exactly, two postures, each motor excited once at each, as in test_estimators_uncertainty.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from study import markdown, publish
from synthetic import ENCODER, Arm, campaign, record
from test_estimators_uncertainty import GAINS, GRAVITY, POSTURES, ROBOTS, arm_at

from ident.arm_fit import gravity_basis
from ident.campaign import Campaign
from ident.coupled import Start, fit_coupled
from ident.frf import estimate
from symgen.plan import Model, make_model
from symgen.urdf import load_chain

TRIES = 25
LINES = np.arange(3, 240, 4)
#: Random starts and datasheets are off by up to this factor in K and J_m, ten times in damping; CAD by up to half.
FACTORS = (1.5, 3.0)


@pytest.fixture(scope="module")
def model() -> Model:
    return make_model(load_chain(ROBOTS / "ypp3" / "ypp3.urdf", at={"joint1": 0.0}), believe_zeros=True)


def records_of(arms: list[Arm], rng: np.random.Generator) -> Campaign:
    records = [
        record(arms[k // 2], k % 2, lines=LINES, f0=0.5, periods=4, step=ENCODER, gains=GAINS, rng=rng, id=f"r{k}",
               posture=np.array(POSTURES[k // 2]))
        for k in range(4)
    ]  # fmt: skip
    whole = campaign(arms[0], records)
    return replace(whole, joints=("joint1", "joint2"), gravity=GRAVITY, J_m=arms[0].J_m)


def wrong(values: np.ndarray, factor: float, rng: np.random.Generator) -> np.ndarray:
    return values * factor ** rng.uniform(-1, 1, np.shape(values))


@pytest.mark.bench
def test_random_starts_end_at_one_optimum(model: Model) -> None:
    rng = np.random.default_rng(1)
    arm = arm_at(model, POSTURES[0])
    data = records_of([arm_at(model, q) for q in POSTURES], rng)
    responses = [estimate(one, data) for one in data.records]
    beta = gravity_basis(model, GRAVITY) @ model.chain.parameters
    best = fit_coupled(data, model, responses)
    rows = []
    for factor in FACTORS:
        good = 0
        for _ in range(TRIES):
            start = Start(wrong(arm.K, factor, rng), wrong(arm.J_m, factor, rng), wrong(arm.D, 10, rng),
                          wrong(arm.D_spring, 10, rng), wrong(model.alpha_cad, 1.5, rng), beta)  # fmt: skip
            found = fit_coupled(data, model, responses, start)
            std = np.sqrt(np.diag(best.covariance))
            good += bool(np.all(np.abs(found.alpha - best.alpha) < 0.1 * std) and found.explained)
        rows.append([f"starts of one arm, K and J_m off by up to a factor {factor:g}", f"{good} of {TRIES}"])
    for factor in FACTORS:
        good = 0
        for _ in range(TRIES):
            K, J_m = wrong(arm.K, 3, rng), wrong(arm.J_m, 3, rng)
            arms = [replace(arm_at(model, q), K=K, J_m=J_m) for q in POSTURES]
            made = records_of(arms, rng)
            made = replace(made, K=wrong(K, factor, rng), J_m=wrong(J_m, factor, rng))
            found = fit_coupled(made, model, [estimate(one, made) for one in made.records])
            std = np.sqrt(np.diag(found.covariance))
            good += bool(np.all(np.abs(found.alpha - model.alpha_cad) < 5 * std) and found.explained)
        rows.append([f"arms, datasheets off by up to a factor {factor:g}", f"{good} of {TRIES}"])
    publish("Start values", markdown(["what was random", "right"], rows))
    assert rows[0][1] == f"{TRIES} of {TRIES}" and rows[len(FACTORS)][1] == f"{TRIES} of {TRIES}"
