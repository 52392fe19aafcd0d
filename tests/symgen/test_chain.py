"""The data model's own algebra, judged by pinocchio's spatial inertias."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from symgen.chain import PARAMETERS, PRISMATIC, REVOLUTE, Chain, Inertia, Joint, skew

ROUNDING = 1e-13  # relative to the largest entry: a dozen products in another order


def random_body(rng: np.random.Generator) -> Inertia:
    a = rng.uniform(0.1, 1.0, 3)  # second moments along the principal axes: any such body exists
    R = Rotation.random(random_state=rng).as_matrix()
    return Inertia(float(rng.uniform(0.1, 10)), rng.uniform(-1, 1, 3), R @ np.diag(a.sum() - a) @ R.T)


def judge(body: Inertia) -> pin.Inertia:
    return pin.Inertia(body.mass, body.com, body.I)


def assert_same(body: Inertia, expected: pin.Inertia) -> None:
    numbers = expected.toDynamicParameters()
    np.testing.assert_allclose(body.parameters, numbers, rtol=0, atol=ROUNDING * np.abs(numbers).max())


@pytest.mark.parametrize("seed", range(10))
def test_parameters_moving_and_joining_bodies_are_pinocchios(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, two = random_body(rng), random_body(rng)
    assert len(PARAMETERS) == 10
    assert_same(one, judge(one))
    assert_same(one + two, judge(one) + judge(two))
    R, p = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-2, 2, 3)
    assert_same(one.moved(R, p), pin.SE3(R, p).act(judge(one)))


def test_a_massless_body_adds_only_its_own_inertia() -> None:
    rotor = Inertia(0.0, np.zeros(3), np.diag([0.0, 0.0, 0.3]))
    body = random_body(np.random.default_rng(0))
    total = rotor + body
    assert total.mass == body.mass
    np.testing.assert_allclose(total.com, body.com, rtol=ROUNDING)
    np.testing.assert_allclose(total.I, body.I + rotor.I, rtol=ROUNDING)
    both = rotor + rotor
    assert both.mass == 0.0
    np.testing.assert_array_equal(both.I, 2 * rotor.I)
    np.testing.assert_array_equal(Inertia.zero().parameters, np.zeros(10))


def test_skew_is_the_cross_product() -> None:
    v, w = np.random.default_rng(1).normal(size=(2, 3))
    np.testing.assert_allclose(skew(v) @ w, np.cross(v, w), rtol=1e-14)


def test_a_chain_is_read_only_and_stacks_its_bodies_from_base_to_tip() -> None:
    rng = np.random.default_rng(2)
    bodies = random_body(rng), random_body(rng)
    joints = (
        Joint("turn", REVOLUTE, np.eye(3), np.zeros(3), [0, 0, 1], "a", bodies[0]),  # type: ignore[arg-type]
        Joint("slide", PRISMATIC, np.eye(3), np.zeros(3), [1, 0, 0], "b", bodies[1], lower=-0.2),  # type: ignore[arg-type]
    )
    chain = Chain("arm", joints, "base", "b")
    assert (chain.n, chain.names) == (2, ("turn", "slide"))
    np.testing.assert_array_equal(chain.parameters, np.concatenate([b.parameters for b in bodies]))
    np.testing.assert_array_equal(chain.limits, [[-np.pi, np.pi], [-0.2, 1.0]])
    for array in (chain.parameters, chain.limits, joints[0].R, joints[0].axis, bodies[0].I):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


@pytest.mark.parametrize(
    ("kind", "stated", "limits"),
    [
        (REVOLUTE, (-np.inf, np.inf), (-np.pi, np.pi)),
        (PRISMATIC, (-np.inf, np.inf), (-1.0, 1.0)),
        (REVOLUTE, (-4.0, np.inf), (-4.0, np.pi)),
        (REVOLUTE, (4.0, np.inf), (4.0, 4.0 + np.pi)),
        (REVOLUTE, (-np.inf, -3.5), (-3.5 - np.pi, -3.5)),
        (PRISMATIC, (1.5, np.inf), (1.5, 2.5)),
        (PRISMATIC, (-np.inf, -1.0), (-2.0, -1.0)),
        (PRISMATIC, (-np.inf, 0.5), (-1.0, 0.5)),
    ],
)
def test_an_unstated_limit_is_beyond_the_stated_one(
    kind: str, stated: tuple[float, float], limits: tuple[float, float]
) -> None:
    body = random_body(np.random.default_rng(0))
    joint = Joint("j", kind, np.eye(3), np.zeros(3), np.array([0, 0, 1]), "l", body, *stated)
    assert joint.limits == pytest.approx(limits, rel=1e-15)
