"""The robots that come with the project are sound: rigid bodies, ranks, drives, locks and shapes, judged by Pinocchio and MuJoCo."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from ident.simulator.bench import prepare
from ident.simulator.plant import build_plant, linearise
from symgen.basis import factor
from symgen.chain import PRISMATIC, Chain
from symgen.collision import SelfCollision
from symgen.plan import chain_of_robot, make_plan, reflected_inertia
from symgen.robot import Robot, load_robot

ROOT = Path(__file__).parents[2] / "robots"
Array = NDArray[np.float64]

#: rank of each J_ii, of all of them together, of all of J(q)
RANKS = {
    "ypp3": ((7, 3, 1), 9, 13),
    "ypp3_general": ((7, 3, 1), 9, 13),
    "scara4": ((5, 3, 1, 1), 8, 8),
    "arm6": ((27, 19, 17, 7, 3, 1), 32, 36),
    "arm7": ((31, 27, 23, 17, 9, 5, 1), 37, 39),
}
OURS = ("ypp3_general", "scara4", "arm6", "arm7")
every = pytest.mark.parametrize("name", RANKS)
ours = pytest.mark.parametrize("name", OURS)


@cache
def robot(name: str) -> Robot:
    return load_robot(ROOT / name)


@cache
def arm(name: str) -> Chain:
    return chain_of_robot(robot(name))


@cache
def judge(name: str) -> pin.Model:
    return pin.buildModelFromUrdf(str(robot(name).urdf))


def postures(name: str, count: int, seed: int = 0) -> Array:
    low, high = arm(name).limits.T
    return low + (high - low) * np.random.default_rng(seed).random((count, len(low)))


def crba(name: str, q: Array) -> Array:
    upper = np.triu(pin.crba(judge(name), judge(name).createData(), q))
    return upper + np.triu(upper, 1).T


@cache
def diagonals(name: str) -> Array:
    """J_ii at random postures [m, n]."""
    return np.array([np.diag(crba(name, q)) for q in postures(name, 3000)])


# Bodies and files ----------------------------------------------------------------------------------------------------


@every
def test_joints_and_links_have_the_same_names_on_every_robot(name: str) -> None:
    chain = arm(name)
    assert chain.name == robot(name).name == name
    assert chain.names == tuple(f"joint{k + 1}" for k in range(chain.n))
    assert [joint.link for joint in chain.joints] == [f"link{k + 1}" for k in range(chain.n)]
    assert (chain.base_link, chain.tip_link) == ("base_link", "link3" if name == "ypp3" else "tool0")
    assert [drive.joint for drive in robot(name).drives] == list(chain.names)
    assert chain.snapped == ()  # pi is written in full
    assert [joint.type == PRISMATIC for joint in chain.joints] == [drive.linear for drive in robot(name).drives]


@ours
def test_every_moving_body_exists_and_is_symmetric_in_nothing(name: str) -> None:
    for joint in arm(name).joints:
        body = joint.inertia
        moments = np.linalg.eigvalsh(body.I)
        # a solid keeps away from the triangle inequality I1 + I2 > I3 > 0; thin rods come within some 0.1 % of it
        assert moments[0] > 0 and moments[0] + moments[1] > 1.001 * moments[2], joint.link
        products = np.abs(body.I[np.triu_indices(3, 1)])
        assert products.min() > 1e-6 * moments[2], joint.link
        assert np.abs(body.com).min() > 1e-4, joint.link
    assert not robot(name).believe_zeros


# Constants -----------------------------------------------------------------------------------------------------------


@every
def test_symgen_finds_the_ranks_that_pinocchios_regressor_has(name: str) -> None:
    """tau = Y phi at rest without gravity for a = e_i is column i of J(q): row j of that Y is J_ji over the parameters."""
    model = judge(name).copy()
    model.gravity = pin.Motion.Zero()
    data, n, still = model.createData(), model.nv, np.zeros(model.nv)
    Y = np.array(
        [
            [pin.computeJointTorqueRegressor(model, data, q, still, unit) for unit in np.eye(n)]
            for q in postures(name, 150)
        ]
    )

    def rank(rows: Array) -> int:
        return int(np.linalg.matrix_rank(rows.reshape(-1, 10 * n), tol=1e-9 * np.abs(Y).max() * len(Y)))

    own, shared, whole = RANKS[name]
    assert tuple(rank(Y[:, i, i]) for i in range(n)) == own
    assert rank(Y[:, range(n), range(n)]) == shared
    assert rank(Y) == whole
    factoring = factor(arm(name))
    assert (factoring.rank_per_joint, factoring.d, len(factoring.alphas)) == RANKS[name]
    if name in OURS:
        text = f"Ranks of J_11 .. J_{n}{n}: {', '.join(map(str, own))}; shared: {shared}; all of J(q): {whole}."
        assert text in (ROOT / name / "README.md").read_text()


# Drives --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """One row of a README's table of drives, in its units; ranges as (low, high)."""

    joint: str
    J: tuple[float, float]
    rotor: float
    share: tuple[float, float]
    f_AR: tuple[float, float]
    gravity: float
    of_motor: float


def readme_rows(name: str) -> list[Row]:
    def span(cell: str) -> tuple[float, float]:
        numbers = [float(word) for word in cell.split(" .. ")]
        return numbers[0], numbers[-1]

    rows = []
    for line in re.findall(r"^\| (joint.* %) \|$", (ROOT / name / "README.md").read_text(), re.MULTILINE):
        joint, J, rotor, share, f_AR, gravity, percent = line.split(" | ")
        percent = percent.removesuffix(" %")
        rows.append(Row(joint, span(J), float(rotor), span(share), span(f_AR), float(gravity), float(percent) / 100))
    return rows


def largest_gravity(name: str, i: int) -> float:
    """The largest |gravity force| on joint i (from 0) over the box of its limits: climbs from the best of random starts."""
    model, data = judge(name), judge(name).createData()

    def less(q: Array) -> float:
        return -abs(float(pin.computeGeneralizedGravity(model, data, q)[i]))

    starts = sorted(postures(name, 300, seed=1), key=less)[:3]
    return -min(float(minimize(less, q, bounds=arm(name).limits, method="L-BFGS-B").fun) for q in starts)


# The tables have three digits, shares two.
DIGITS, SHARE_DIGITS = 6e-3, 6e-2


@ours
def test_the_readmes_table_of_drives_is_true(name: str) -> None:
    rows, J = readme_rows(name), diagonals(name)
    chain = arm(name)
    assert [row.joint for row in rows] == list(chain.names)
    for i, (row, drive) in enumerate(zip(rows, robot(name).drives, strict=True)):
        low, high = row.J
        assert low * (1 - DIGITS) <= J[:, i].min() and J[:, i].max() <= high * (1 + DIGITS)
        # random postures come near both ends; the smallest of arm7's J_11, upright, is the hardest to hit
        assert J[:, i].min() < 1.5 * low and J[:, i].max() > 0.95 * high
        assert row.rotor == pytest.approx(drive.N**2 * drive.J_m, rel=DIGITS)
        assert row.share == pytest.approx(np.array(row.J) / row.rotor, rel=SHARE_DIGITS)
        assert row.f_AR == pytest.approx(np.sqrt(drive.K / np.array(row.J[::-1])) / (2 * np.pi), rel=DIGITS)
        gravity = largest_gravity(name, i)
        assert row.gravity == pytest.approx(gravity, rel=DIGITS, abs=1e-9)
        torque = drive.N * drive.tau_max
        assert row.of_motor == pytest.approx(gravity / torque, rel=SHARE_DIGITS, abs=1e-9)
        assert row.of_motor <= 0.5, "a margin of two for what the URDF does not know"
        assert chain.joints[i].effort <= torque * (1 + 1e-9)


@ours
def test_the_readme_states_the_anti_resonances_of_the_arm_with_all_motors_held(name: str) -> None:
    """sqrt of the eigenvalues of J(q)^-1 K: medians over the workspace.

    Medians of 1000 postures scatter by up to 1 % of the mode (1.25 std/sqrt(1000), std a quarter of it), those of the
    README as well; and it rounds to 1 Hz.
    """
    text = " ".join((ROOT / name / "README.md").read_text().split())
    found = re.search(r"anti-resonances are at ([\d, ]+) Hz \(medians", text)
    assert found
    K = np.diag([drive.K for drive in robot(name).drives])
    squares = [np.linalg.eigvals(np.linalg.solve(crba(name, q), K)).real for q in postures(name, 1000, seed=4)]
    medians = np.median(np.sort(np.sqrt(squares), axis=1), axis=0) / (2 * np.pi)
    assert [float(word) for word in found[1].split(",")] == pytest.approx(medians, rel=0.05, abs=1.0)


@ours
def test_drives_are_those_of_real_arms(name: str) -> None:
    for i, drive in enumerate(robot(name).drives):
        J = diagonals(name)[:, i]
        damping = drive.D_spring / (2 * np.sqrt(drive.K * np.median(J)))
        assert 0.005 <= damping <= 0.02
        assert drive.encoder_counts >= 2**17
        # the lock's observer and PD stand at 30 and 5 Hz: with more load than this the rotor alone is no nominal model
        assert J.max() < 11 * drive.N**2 * drive.J_m
        if name == "arm7":
            assert 100 <= drive.N <= 160 and 5e3 <= drive.K <= 20e3


def test_the_last_joint_of_arm7_is_outside_its_band_and_that_of_arm6_near_the_edge() -> None:
    seven, six = readme_rows("arm7")[-1].f_AR[0], readme_rows("arm6")[-1].f_AR[0]
    assert robot("arm7").experiment.band[1] == robot("arm6").experiment.band[1] == 120
    assert seven > 120 * 1.2
    assert 120 * 0.9 < six < 120


# The experiment ------------------------------------------------------------------------------------------------------


@ours
def test_the_lock_is_stable_where_the_plan_goes_and_the_motors_bear_it(name: str) -> None:
    chain, one = arm(name), robot(name)
    plan = make_plan(chain, rotor=reflected_inertia(chain, one.drives), spare=0, effort="draft")
    limits = np.array([drive.tau_max for drive in one.drives])
    first = {cell.joint: cell for cell in plan.cells}
    for cell in first.values():
        setup = prepare(chain, one, cell.joint, cell.q, lock="dob", rng=np.random.default_rng(0))
        assert setup.growth < -1.0  # 1/s: transients die within the first of six periods of 5 s and more
        assert np.all(setup.torque < limits)
        # no motor's torque cuts it short, but where a joint outside the band needs more of it at high frequencies
        assert setup.swing == pytest.approx(one.experiment.swing, rel=1e-9) or "above the band" in setup.note


@ours
def test_mujoco_simulates_the_arm_that_pinocchio_reads(name: str) -> None:
    for q in postures(name, 3, seed=2):
        linear = linearise(build_plant(arm(name), robot(name).drives, robot(name).gravity, q))
        expected = crba(name, q)
        # the same sums in another order
        np.testing.assert_allclose(linear.link_inertia, expected, rtol=0, atol=1e-12 * expected.max())


# Shapes --------------------------------------------------------------------------------------------------------------


def touching(name: str, q: Array) -> NDArray[np.bool_]:
    """Where links touch that are no neighbours, by MuJoCo's reading of the URDF [m]."""
    model = mujoco.MjModel.from_xml_path(str(robot(name).urdf))
    data, out = mujoco.MjData(model), []
    for row in q:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        out.append(any(contact.dist < 0 for contact in data.contact))
    return np.array(out)


@ours
def test_the_shapes_let_the_arm_move_and_stop_it_where_it_folds_into_itself(name: str) -> None:
    hit = touching(name, postures(name, 600, seed=3))
    assert 0.005 < hit.mean() < 0.4
    home = np.zeros((1, arm(name).n))
    assert not touching(name, home)[0] and not SelfCollision(arm(name), robot(name).urdf)(home)[0]


@ours
def test_symgen_sees_the_arm_touch_itself_where_mujoco_does(name: str) -> None:
    q = postures(name, 600, seed=3)
    np.testing.assert_array_equal(SelfCollision(arm(name), robot(name).urdf)(q), touching(name, q))
