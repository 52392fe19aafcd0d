"""The MuJoCo plant is Spong's flexible-joint arm: judged by Pinocchio (inertia, gravity) and by its own simulated motion."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from ident.errors import ExperimentError
from ident.simulator.plant import Linear, Plant, build_plant, linearise
from symgen.chain import PRISMATIC, REVOLUTE, Chain, Inertia, Joint
from symgen.robot import Drive, load_robot
from symgen.urdf import load_chain

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
YPP = load_chain(ROBOT.urdf)
GRAVITY = np.array([0.3, -0.2, -9.81])
ROUNDING = 1e-12  # relative to the largest entry: two implementations of the same sums in double precision


def random_arm(rng: np.random.Generator, types: str) -> Chain:
    """A serial arm of random geometry and physically possible links; `types` such as "RRP"."""
    joints = []
    for k, kind in enumerate(types):
        axis, points = rng.standard_normal(3), rng.standard_normal((6, 3)) * 0.1
        inertia = sum((Inertia(0.5, point, np.zeros((3, 3))) for point in points), Inertia.zero())
        R = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        joints.append(
            Joint(
                name=f"j{k}",
                type=REVOLUTE if kind == "R" else PRISMATIC,
                R=R * np.linalg.det(R),
                p=rng.uniform(-0.4, 0.4, 3),
                axis=axis / np.linalg.norm(axis),
                link=f"l{k}",
                inertia=inertia,
            )
        )
    return Chain("random", tuple(joints), "base", joints[-1].link)


def drives_for(chain: Chain) -> list[Drive]:
    return [
        Drive(
            joint=joint.name,
            N=(-1) ** k * (80.0 + k),
            J_m=4e-5,
            K=5000.0 + 100 * k,
            D=3e-5,
            D_spring=1.0,
            encoder_counts=131072,
            tau_max=2.0,
            linear=joint.type == PRISMATIC,
        )
        for k, joint in enumerate(chain.joints)
    ]


def pinocchio_model(chain: Chain) -> pin.Model:
    model = pin.Model()
    model.gravity.linear = GRAVITY
    parent = 0
    for joint in chain.joints:
        kind = pin.JointModelRevoluteUnaligned if joint.type == REVOLUTE else pin.JointModelPrismaticUnaligned
        parent = model.addJoint(parent, kind(joint.axis), pin.SE3(joint.R, joint.p), joint.name)
        body = pin.Inertia(joint.inertia.mass, joint.inertia.com, joint.inertia.I)
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    return model


ARMS = {"ypp3": YPP} | {types: random_arm(np.random.default_rng(7), types) for types in ("RRRRRR", "PRPR", "R")}


@pytest.fixture(params=ARMS, scope="module")
def case(request: pytest.FixtureRequest) -> tuple[Chain, list[Drive], np.ndarray, pin.Model]:
    chain = ARMS[request.param]
    q = np.random.default_rng(3).uniform(-1.5, 1.5, chain.n)
    return chain, drives_for(chain), q, pinocchio_model(chain)


def test_mass_matrix_is_links_and_rotors_apart(case: tuple[Chain, list[Drive], np.ndarray, pin.Model]) -> None:
    chain, drives, q, model = case
    J = pin.crba(model, model.createData(), q)
    J = np.triu(J) + np.triu(J, 1).T
    plant = build_plant(chain, drives, GRAVITY, q)
    linear = linearise(plant)
    n = chain.n
    assert np.abs(linear.link_inertia - J).max() <= ROUNDING * np.abs(J).max()
    assert linear.M[:n, :n] == pytest.approx(np.diag([d.N**2 * d.J_m for d in drives]), rel=1e-15)
    assert not linear.M[:n, n:].any()
    # and in MuJoCo's own coordinates (motor, q - motor): both see the link, the rotor only its own joint
    full, data = np.zeros((2 * n, 2 * n)), plant.data()
    for row, unit in zip(full, np.eye(2 * n), strict=True):
        mujoco.mj_mulM(plant.model, data, row, unit)
    expected = np.kron(J, np.ones((2, 2)))
    expected[::2, ::2] += np.diag([d.N**2 * d.J_m for d in drives])
    assert np.abs(full - expected).max() <= ROUNDING * np.abs(expected).max()


def test_rest_is_the_loaded_equilibrium_at_the_declared_posture(
    case: tuple[Chain, list[Drive], np.ndarray, pin.Model],
) -> None:
    chain, drives, q, model = case
    force = pin.computeGeneralizedGravity(model, model.createData(), q)
    N, K = np.array([d.N for d in drives]), np.array([d.K for d in drives])
    plant = build_plant(chain, drives, GRAVITY, q)
    assert np.abs(plant.preload * N - force).max() <= ROUNDING * np.abs(force).max()
    assert np.abs(plant.rest / N - (q + force / K)).max() <= ROUNDING * max(1.0, np.abs(q).max())
    data = plant.data()
    assert data.qpos[::2] + data.qpos[1::2] == pytest.approx(q, rel=1e-14)
    force_left = np.zeros(plant.model.nv)
    mujoco.mj_mulM(plant.model, data, force_left, data.qacc)
    assert np.abs(force_left).max() <= 1e-11 * np.abs(force).max()  # K q / g digits are lost in the spring's deflection


def test_gravity_stiffness_is_pinocchios_derivative(case: tuple[Chain, list[Drive], np.ndarray, pin.Model]) -> None:
    chain, drives, q, model = case
    slope = pin.computeGeneralizedGravityDerivatives(model, model.createData(), q)
    stiffness = [d.K for d in drives]
    found = linearise(build_plant(chain, drives, GRAVITY, q)).gravity_stiffness(stiffness)
    # central difference of 1e-4: h^2/6 of the third derivative, and 1e-12 of K lost when K was added
    assert np.abs(found - slope).max() <= 1e-7 * max(np.abs(slope).max(), 1.0)


@pytest.mark.parametrize("free", [0, 1, 2])
def test_rigid_lock_leaves_one_joint_with_its_own_inertia(free: int) -> None:
    q = np.array([0.3, 0.5, -0.7])
    model = pinocchio_model(YPP)
    J = pin.crba(model, model.createData(), q)
    slope = pin.computeGeneralizedGravityDerivatives(model, model.createData(), q)
    whole = build_plant(YPP, ROBOT.drives, GRAVITY, q)
    plant = build_plant(YPP, ROBOT.drives, GRAVITY, q, free=free)
    linear = linearise(plant)
    assert (plant.model.nv, plant.model.nu, plant.live) == (2, 1, (free,))
    assert linear.link_inertia[0, 0] == pytest.approx(J[free, free], rel=1e-12)
    assert linear.gravity_stiffness([ROBOT.drives[free].K])[0, 0] == pytest.approx(slope[free, free], abs=2e-6)
    assert np.array_equal(plant.rest, whole.rest) and np.array_equal(plant.preload, whole.preload)
    assert np.abs(plant.data().qacc).max() < 1e-9


def move(plant: Plant, linear: Linear, torque: np.ndarray, steps: int, Ts: float) -> np.ndarray:
    """Deviation of (theta/N, q) after each held torque [T, n] beyond the preload, as MuJoCo integrates it [T, 2 n]."""
    data = plant.data()
    plant.model.opt.timestep = Ts / steps
    rest, states = np.array(data.qpos), []
    for u in torque:
        data.ctrl[:] = plant.preload[list(plant.live)] + u
        mujoco.mj_step(plant.model, data, steps)
        away = data.qpos - rest
        states.append(np.concatenate([away[::2], away[::2] + away[1::2]]))
    return np.array(states)


def test_small_motion_follows_the_sampled_linear_model() -> None:
    """Torques, gear signs, damping, springs and gravity at once: the error falls with the square of the amplitude."""
    chain = ARMS["RRRRRR"]
    q = np.random.default_rng(4).uniform(-1.5, 1.5, chain.n)
    plant = build_plant(chain, drives_for(chain), GRAVITY, q)
    linear = linearise(plant)
    A, B, C = linear.sampled(1e-3)
    shape = np.random.default_rng(5).standard_normal((200, chain.n))
    errors = []
    for size in (1e-3, 1e-4):
        x, states = np.zeros(len(A)), []
        for u in shape * size:
            x = A @ x + B @ u
            states.append(x[: 2 * chain.n])
        expected = np.array(states)
        errors.append(np.abs(move(plant, linear, shape * size, 20, 1e-3) - expected).max() / np.abs(expected).max())
    assert errors[0] < 1e-3
    assert errors[1] < 0.2 * errors[0]
    assert np.array_equal(C[:, : chain.n], np.diag(linear.N))


def test_modes_are_those_of_the_two_mass_formula() -> None:
    plant = build_plant(YPP, ROBOT.drives, [0, 0, 0], [0, 0, 0], free=2)
    rotor, K, J = 100.0**2 * 1e-5, 4500.0, 0.0466
    assert linearise(plant).modes() == pytest.approx([0, np.sqrt(K * (1 / rotor + 1 / J)) / (2 * np.pi)], abs=1e-4)


def test_rk4_steps_keep_every_pole_within_the_region_of_stability() -> None:
    """A stiff spring, a stiff damper: the first adds fast modes, the second real poles."""
    for change in ({}, {"K": 1e7}, {"D_spring": 3000.0}, {"D": 20.0}):
        drives = [replace(drive, **change) for drive in ROBOT.drives]
        linear = linearise(build_plant(YPP, drives, GRAVITY, [0, 0.5, -0.5]))
        poles = np.linalg.eigvals(linear.generator()[:12, :12])

        def growth(steps: int, poles: np.ndarray = poles) -> float:
            z = poles * 1e-3 / steps
            return float(np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24).max())

        steps = linear.rk4_steps(1e-3, 120.0)
        assert growth(steps) <= np.exp(max(0.0, poles.real.max()) * 1e-3) * (1 + 1e-9)
        assert steps == 1 or growth(steps // 2) > 1, "no more than twice what is needed"


def test_rk4_with_its_defect_is_the_exact_map() -> None:
    linear = linearise(build_plant(YPP, ROBOT.drives, GRAVITY, [0, 0.5, -0.5]))
    A, B, _ = linear.sampled(1e-3)
    H = linear.generator() * 5e-4
    step = np.eye(15) + H @ (np.eye(15) + H / 2 @ (np.eye(15) + H / 3 @ (np.eye(15) + H / 4)))
    whole = (step @ step)[:12] + linear.rk4_defect(1e-3, 2)
    assert np.abs(whole - np.hstack([A, B])).max() <= 1e-12 * np.abs(B).max()


def test_frozen_slides_and_turns_stay_where_they_are() -> None:
    chain = ARMS["PRPR"]
    q = np.array([0.2, -0.8, 0.4, 1.1])
    data = {
        free: build_plant(chain, drives_for(chain), GRAVITY, q, free=free, integrator="implicitfast").data()
        for free in (None, 3)
    }
    tip = [d.xipos[-1] for d in data.values()]
    assert tip[0] == pytest.approx(tip[1], rel=1e-12)


def test_a_drive_that_does_not_fit_its_joint_is_refused() -> None:
    drives = [replace(ROBOT.drives[0], linear=True), *ROBOT.drives[1:]]
    with pytest.raises(ExperimentError, match="joint 'joint1' is revolute, but robot.toml gives it a linear drive"):
        build_plant(YPP, drives, GRAVITY, [0, 0, 0])


@pytest.mark.parametrize("I", [[0.1, 0.0, 0.1], [0.1, 0.2, 0.3 + 1e-9], [0.1, 0.1, 0.0]])
def test_rods_and_rounded_triangle_inequalities_are_simulated_as_they_are(I: list[float]) -> None:
    last = replace(YPP.joints[-1], inertia=Inertia(1.0, np.array([0.0, 0.1, 0.0]), np.diag(I)))
    chain = replace(YPP, joints=(*YPP.joints[:-1], last))
    linear = linearise(build_plant(chain, ROBOT.drives, GRAVITY, [0.2, 0.3, 0.4]))
    model = pinocchio_model(chain)
    J = pin.crba(model, model.createData(), np.array([0.2, 0.3, 0.4]))
    assert np.abs(np.triu(linear.link_inertia - J)).max() <= ROUNDING * np.abs(J).max()


def test_a_joint_that_moves_no_inertia_is_named() -> None:
    last = replace(YPP.joints[-1], inertia=Inertia(1.0, np.zeros(3), np.zeros((3, 3))))
    plant = build_plant(replace(YPP, joints=(*YPP.joints[:-1], last)), ROBOT.drives, GRAVITY, [0, 0, 0])
    with pytest.raises(ExperimentError, match="joint 'joint3' moves nothing"):
        linearise(plant)
