"""Constants are judged by what they do to J(q)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ident.joint.certainty import HARDLY, certainty, thin
from symgen.plan import Model, make_model
from symgen.urdf import load_chain

ROBOTS = Path(__file__).parents[3] / "robots"


@pytest.fixture(scope="module")
def model() -> Model:
    return make_model(load_chain(ROBOTS / "ypp3_general" / "ypp3_general.urdf"))


def small(model: Model) -> np.ndarray:
    return np.eye(len(model.names)) * (1e-5 * np.abs(model.alpha_cad).max()) ** 2


def test_a_constant_near_zero_is_not_hardly_known(model: Model) -> None:
    """A thousand times its own size uncertain, and next to nothing to J(q)."""
    k = int(np.argmin(np.abs(model.alpha_cad)))
    covariance = small(model)
    covariance[k, k] = (1e3 * abs(model.alpha_cad[k]) + 1e-9) ** 2 * 1e-6
    none = np.zeros((len(model.names), 0))
    assert certainty(model, covariance, none).per_entry.max() < HARDLY
    assert thin(certainty(model, covariance, none)) == ()


def test_standard_deviations_are_those_of_draws(model: Model) -> None:
    rng = np.random.default_rng(1)
    A = rng.normal(size=(len(model.names),) * 2) * 1e-3
    covariance = A @ A.T
    found = certainty(model, covariance, np.zeros((len(A), 0)))
    q = model.random_postures(400, np.random.default_rng(0))
    J = model.J_cad(q)
    size = np.sqrt(np.einsum("mii->mi", J))
    rows = model.J_rows(q)
    draws = np.array([rows @ (A @ rng.normal(size=len(A))) for _ in range(300)])
    spread = (np.sqrt(np.mean(draws**2, axis=0)) / size[:, :, None] / size[:, None, :]).max(axis=0)
    # the largest of 400 sample deviations of 300 draws each is up to 3 / sqrt(2 * 300) too large
    np.testing.assert_allclose(spread, found.per_entry, rtol=0.15)
    assert found.share <= found.per_entry.max() * (1 + 1e-9)


def test_a_thin_direction_is_named(model: Model) -> None:
    """J_12 and J_13 of generic links rest on constants of their own: one of them unknown shows in these entries alone."""
    k = len(model.names) - 1
    assert k >= model.d
    covariance = small(model)
    covariance[k, k] = np.abs(model.alpha_cad).max() ** 2
    found = certainty(model, covariance, np.zeros((len(model.names), 0)))
    lines = thin(found)
    assert found.names == (model.names[k],) and model.names[k] in lines[-1]
    assert {line.split()[0] for line in lines[:-1]} <= {"J_12", "J_13"} and found.worst[0] == 0
    assert np.diag(found.per_entry).max() < 1e-3


def test_what_was_not_measured_is_infinite_and_not_thin(model: Model) -> None:
    unseen = np.zeros((len(model.names), 1))
    unseen[-1] = 1.0
    found = certainty(model, small(model), unseen)
    assert np.isinf(found.per_entry[0, 1:]).any() and np.isfinite(np.diag(found.per_entry)).all()
    assert thin(found) == ()
