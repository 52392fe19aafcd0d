"""Column plans: all of J(q) from few runs, the stated amplification the one that noise really has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from symgen.basis import factor
from symgen.chain import Chain
from symgen.columns import plan_columns
from symgen.postures import box
from symgen.regressor import J_rows
from symgen.urdf import load_chain

ROBOTS = Path(__file__).parents[2] / "robots"


@pytest.fixture(scope="module")
def chain() -> Chain:
    return load_chain(ROBOTS / "ypp3_general" / "ypp3_general.urdf")


def test_the_runs_tell_all_of_the_matrix(chain: Chain) -> None:
    factoring = factor(chain)
    plan = plan_columns(factoring)
    assert len(plan.joint) == 7, "findings: 7 runs for the 13 constants of a general yaw-pitch-pitch arm"
    rows = J_rows(factoring, plan.q)[np.arange(len(plan.q)), plan.joint].reshape(-1, len(factoring.alphas))
    found = np.linalg.lstsq(rows, rows @ factoring.alpha_cad, rcond=None)[0]
    np.testing.assert_allclose(found, factoring.alpha_cad, atol=1e-9 * np.abs(factoring.alpha_cad).max())
    low, high = box(chain.limits).T
    assert (plan.q >= low).all() and (plan.q <= high).all()
    assert plan.amplification.max() <= 1.3


def test_the_stated_amplification_is_what_noise_does(chain: Chain) -> None:
    """Noise of sigma_ij on every measured entry, 400 times; the error of J(q) at postures of its own."""
    factoring, rng = factor(chain), np.random.default_rng(2)
    rotor = np.array([0.4, 0.4, 0.1])
    plan = plan_columns(factoring, rotor=rotor)
    blocks = J_rows(factoring, plan.q)

    def sigma(rows: np.ndarray) -> np.ndarray:
        own = np.sqrt(np.einsum("miid,d->mi", rows, factoring.alpha_cad) + rotor)
        return own[:, :, None] * own[:, None, :]

    pick = np.arange(len(plan.q)), plan.joint
    A = blocks[pick].reshape(-1, len(factoring.alphas))
    weight = 1 / sigma(blocks)[pick].ravel()
    low, high = chain.limits.T
    elsewhere = J_rows(factoring, low + (high - low) * rng.random((300, chain.n)))
    solve = np.linalg.pinv(A * weight[:, None])
    noise = rng.standard_normal((400, len(A)))
    error = np.einsum("mijd,kd->kmij", elsewhere, noise @ solve.T) / sigma(elsewhere)
    seen = np.sqrt((error**2).mean(axis=(0, 1)))
    # rms over 400 draws and 300 postures against the workspace average: a few percent
    np.testing.assert_allclose(seen, plan.amplification, rtol=0.12)


def test_a_mask_is_obeyed_and_the_plan_is_the_same_twice(chain: Chain) -> None:
    factoring = factor(chain)
    plan = plan_columns(factoring, feasible=lambda q: q[:, 1] > 0)
    assert (plan.q[:, 1] > 0).all()
    again = plan_columns(factoring, feasible=lambda q: q[:, 1] > 0)
    np.testing.assert_array_equal(plan.q, again.q)
    assert len(plan_columns(factoring, most=9, amplification=0.0).joint) == 9
