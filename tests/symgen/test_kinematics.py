"""What gravity and motion ask of the motors, as rows over the bodies' parameters and as numbers, judged by pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from chains import chains, model_of, postures
from hypothesis import given, settings
from hypothesis import strategies as st

from symgen.chain import Chain
from symgen.kinematics import gravity_forces, gravity_rows, torque_rows


@settings(derandomize=True, deadline=None, max_examples=50)
@given(chains(2, 6), st.integers(0, 99))
def test_gravity_is_pinocchios(chain: Chain, seed: int) -> None:
    q, gravity = postures(chain, 5, seed), np.random.default_rng(seed).normal(size=3)
    model = model_of(chain)
    model.gravity.linear = gravity
    data = model.createData()
    expected = np.array([pin.computeGeneralizedGravity(model, data, one) for one in q])
    # both sides add up at most some hundred numbers no larger than the largest
    bound = 1e-12 * np.abs(expected).max()
    assert np.abs(gravity_forces(chain, gravity)(q) - expected).max() <= bound
    assert np.abs(gravity_rows(chain, q, gravity) @ chain.parameters - expected).max() <= bound


@settings(derandomize=True, deadline=None, max_examples=50)
@given(chains(2, 6), st.integers(0, 99))
def test_torques_in_motion_are_pinocchios(chain: Chain, seed: int) -> None:
    q = postures(chain, 5, seed)
    rng = np.random.default_rng(seed)
    v, a, gravity = rng.normal(size=q.shape), rng.normal(size=q.shape), rng.normal(size=3)
    model = model_of(chain)
    model.gravity.linear = gravity
    data = model.createData()
    expected = np.array([pin.rnea(model, data, *one) for one in zip(q, v, a, strict=True)])
    found = torque_rows(chain, q, v, a, gravity) @ chain.parameters
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()
