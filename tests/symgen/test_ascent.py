"""Quasi-Newton steps in a box: never down, never outside, and to the top that scipy finds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize, rosen, rosen_der

from symgen.ascent import climbed


def test_the_top_of_a_quadratic_hill_in_a_box_is_found() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(20, 20))
    A, b = A @ A.T + np.eye(20), rng.normal(size=20)
    low, high = np.full(20, -0.1), np.full(20, 0.15)
    found = climbed(lambda x: (float(b @ x - x @ A @ x / 2), b - A @ x), np.zeros(20), low, high, 400)
    slope = b - A @ found
    inside = (found > low) & (found < high)
    assert 0 < inside.sum() < 20
    # it ends when a step gains less than 1e-8: slopes of the root of that times the largest curvature
    assert np.abs(slope[inside]).max() < 1e-3 * np.linalg.norm(A, 2) ** 0.5
    assert (slope[found == low] <= 0).all() and (slope[found == high] >= 0).all()


@pytest.mark.parametrize("n", [5, 50])
def test_a_bent_valley_is_followed_as_far_as_scipy_does(n: int) -> None:
    x = np.random.default_rng(0).uniform(-1.5, 0.9, n)
    low, high = np.full(n, -1.5), np.full(n, 0.9)
    found = climbed(lambda x: (-float(rosen(x)), -rosen_der(x)), x, low, high, 1000)
    reference = minimize(rosen, x, jac=rosen_der, method="L-BFGS-B", bounds=np.c_[low, high], options={"maxiter": 1000})
    assert (found >= low).all() and (found <= high).all()
    assert rosen(found) <= 1.01 * reference.fun + 1e-6 or rosen(found) <= reference.fun


def test_no_step_goes_down_and_places_without_a_value_are_left_alone() -> None:
    values: list[float] = []

    def hill(x: np.ndarray) -> tuple[float, np.ndarray] | None:
        return None if x[0] > 0.5 else (float(x[0] - x[1] ** 2), np.array([1.0, -2 * x[1]]))

    x = np.array([-2.0, 1.0])
    for steps in range(8):
        there = hill(climbed(hill, x, np.full(2, -3.0), np.full(2, 3.0), steps))
        assert there is not None
        values.append(there[0])
    assert values[0] == hill(x)[0] and (np.diff(values) >= 0).all() and values[-1] > 0.2
    assert climbed(lambda x: None, x, np.full(2, -3.0), np.full(2, 3.0), 5) is x
