"""Column plans: all of J(q) from few runs, the stated amplification the one that noise really has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from chains import calibrated

from symgen.basis import factor
from symgen.cells import spread
from symgen.chain import Chain
from symgen.columns import plan_columns
from symgen.errors import NoPlanError
from symgen.holding import Holding, box
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


def test_an_arm_that_is_nearly_special_has_a_plan_too(chain: Chain) -> None:
    """Two of its constants hardly matter, but any run tells them as well as they matter."""
    near = calibrated(chain, 3e-4)
    factoring = factor(near)
    plan = plan_columns(factoring)
    assert len(factoring.alphas) == 15 and len(plan.joint) <= 10 and plan.amplification.max() < 1.3


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


@pytest.mark.parametrize("narrow", [0.08, 0.04])
def test_postures_are_found_where_hardly_any_is_held(chain: Chain, narrow: float) -> None:
    """Two of the first 250 looked at lie within so much of the limits' span of a posture, or none."""
    centre, (low, high) = np.array([0.4, -0.7, 1.1]), chain.limits.T

    def held(q: np.ndarray) -> np.ndarray:
        return (np.abs(q - centre) / (high - low) < narrow).all(axis=1)

    assert held(spread(box(chain.limits), 250, 0.5)).sum() == {0.08: 2, 0.04: 0}[narrow]
    plan = plan_columns(factor(chain), feasible=held)
    assert np.isfinite(plan.amplification).all() and held(plan.q).all()


@pytest.mark.parametrize("count", [0, 1])
def test_where_there_is_no_column_plan_it_is_said_in_one_line(chain: Chain, count: int) -> None:
    """No posture that is held, or one, to which three of the seven runs that are needed go."""
    some = Holding(chain, box(chain.limits), None).found(10_000)[:count]
    with pytest.raises(NoPlanError, match="^ypp3_general: no column plan: the postures .* all 13 constants") as caught:
        plan_columns(factor(chain), feasible=lambda q: np.isin(q, some).all(axis=1))
    assert "\n" not in str(caught.value)
