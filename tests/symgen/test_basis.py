"""The constants: how many there are on every arm, what they are on the paper's, and what the diagonal can not see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from arms import arm, factoring_of, model_of
from chains import (
    REVOLUTE_ONLY,
    body_of,
    build,
    chains,
    general_chain,
    judge,
    own,
    postures,
    pseudo_inertia,
    random_body,
    with_bodies,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from symgen.basis import Factoring, believed_zeros, factor
from symgen.chain import PRISMATIC, REVOLUTE, Chain, Inertia
from symgen.inertia import monomials, parameter_scale
from symgen.regressor import C_rows, J_rows

#: Products with the pseudo-inverse of W, whose condition is below 1e3 on the arms used here.
ROUNDING = 1e-11

LAW = settings(derandomize=True, deadline=None, max_examples=12)


def gap(factoring: Factoring) -> float:
    """How many decades the singular values drop at the rank."""
    kept, dropped = factoring.singular_value_gap
    return float(np.log10(kept / max(dropped, 1e-300)))


def parallel_to_the_second(chain: Chain) -> list[int]:
    """The joints (from 0) in the run of turning joints parallel to joint 2 that begins with it."""
    group, R = [1], np.eye(3)
    for k in range(2, chain.n):
        R = R @ chain.joints[k].R
        if (
            chain.joints[k].type != REVOLUTE
            or np.linalg.norm(np.cross(R @ chain.joints[k].axis, chain.joints[1].axis)) > 1e-9
        ):
            break
        group.append(k)
    return group


# Counts --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("n", "seed"), [(2, 0), (2, 1), (3, 0), (3, 1), (4, 0), (4, 1), (5, 0), (5, 1), (6, 0), (7, 0)]
)
def test_a_general_arm_has_seven_constants_a_joint_less_eight(n: int, seed: int) -> None:
    found = factor(general_chain(seed, n))
    assert found.rank_per_joint == (*(6 * (n - i) - 1 for i in range(1, n)), 1)
    assert found.new_per_joint == (*[7] * (n - 2), 5, 1)
    assert found.d == 7 * n - 8
    assert len(found.alphas) == 7 * n - 6
    assert [len(found.entries[i, i].digits) for i in range(n)] == [5 ** (n - 1 - i) for i in range(n)]
    assert gap(found) > 10


def test_an_arm_of_eight_joints_keeps_the_law_with_entries_that_are_not_written_out() -> None:
    found = factor(general_chain(0, 8))
    assert (found.d, len(found.alphas), found.rank_per_joint[0]) == (48, 50, 41)


@pytest.mark.parametrize(
    ("name", "ranks", "new", "d", "D"),
    [
        ("ypp3", (7, 3, 1), (5, 3, 1), 9, 13),
        ("ur3", (23, 15, 13, 9, 3, 1), (9, 3, 5, 7, 3, 1), 28, 34),
        ("ur5", (23, 15, 13, 9, 3, 1), (9, 3, 5, 7, 3, 1), 28, 34),
        ("ur10", (23, 15, 13, 9, 3, 1), (9, 3, 5, 7, 3, 1), 28, 34),
        ("panda", (31, 27, 23, 17, 9, 5, 1), (5, 5, 7, 9, 5, 5, 1), 37, 39),
        ("xarm7", (31, 27, 23, 17, 9, 5, 1), (5, 5, 7, 9, 5, 5, 1), 37, 39),
        ("kinova", (25, 19, 15, 7, 3, 1), (7, 5, 9, 5, 3, 1), 30, 34),
        ("z1 without gripper", (23, 15, 13, 11, 3, 1), (9, 3, 3, 9, 3, 1), 28, 34),
    ],
)
def test_real_arms(name: str, ranks: tuple[int, ...], new: tuple[int, ...], d: int, D: int) -> None:
    found = factoring_of(name)
    assert (found.rank_per_joint, found.new_per_joint, found.d, len(found.alphas)) == (ranks, new, d, D)
    assert gap(found) > 10


def test_own_arms() -> None:
    scara, general = factor(own("scara4")), factor(own("ypp3_general"))
    assert (scara.rank_per_joint, scara.d, len(scara.alphas)) == ((5, 3, 1, 1), 8, 8)
    assert (general.rank_per_joint, general.d, len(general.alphas)) == ((7, 3, 1), 9, 13)


@LAW
@given(chains(2, 6), st.integers(0, 99))
def test_the_count_is_the_rank_of_pinocchios_regressor(chain: Chain, seed: int) -> None:
    found = factor(chain)
    rows = diagonal_regressor(chain, postures(chain, 20 * chain.n, seed)) / parameter_scale(chain)
    values = np.linalg.svd(rows, compute_uv=False)
    assert int((values > 1e-9 * values[0]).sum()) == found.d


def diagonal_regressor(chain: Chain, q: np.ndarray) -> np.ndarray:
    """Rows over the parameters of all bodies [m n, 10 n] of J_ii(q): joint i's torque for unit acceleration of joint i."""
    model = model_of(chain)
    model.gravity.setZero()
    data, still, unit = model.createData(), np.zeros(chain.n), np.eye(chain.n)
    return np.array(
        [pin.computeJointTorqueRegressor(model, data, one, still, unit[i])[i] for one in q for i in range(chain.n)]
    )


@LAW
@given(chains(2, 5), st.integers(0, 2**32 - 1))
def test_constants_belong_to_the_geometry_not_to_the_bodies(chain: Chain, seed: int) -> None:
    rng = np.random.default_rng(seed)
    other = with_bodies(chain, [random_body(rng) for _ in chain.joints])
    first, second = factor(chain), factor(other)
    assert first.names == second.names
    assert np.array_equal(first.W, second.W)
    q = postures(chain, 3)
    expected = judge(other, q)
    error = np.abs(J_rows(first, q) @ (first.W @ other.parameters) - expected).max()
    assert error <= ROUNDING * np.abs(expected).max()


@LAW
@given(chains(2, 5))
def test_both_forms_of_the_factoring_are_pinocchios(chain: Chain) -> None:
    found = factor(chain)
    q = postures(chain, 3)
    expected = judge(chain, q)
    largest = np.abs(expected).max()
    assert np.abs(J_rows(found, q) @ found.alpha_cad - expected).max() <= ROUNDING * largest
    for (i, j), entry in found.entries.items():
        trigonometric = monomials(entry, q) @ (found.S[i, j] @ found.alpha_cad)
        assert np.abs(trigonometric - expected[:, i, j]).max() <= ROUNDING * largest


def test_tip_to_base_every_joint_reuses_what_is_known() -> None:
    found = factoring_of("panda")
    owners = [alpha.i for alpha in found.alphas[: found.d]]
    assert owners == sorted(owners, reverse=True)
    for i in range(found.chain.n):
        later = np.array([alpha.i < i for alpha in found.alphas])
        assert not found.S[i, i][:, later].any(), f"J_{i + 1}{i + 1} needs a constant of a joint before it"
        assert not found.S[i, i][:, found.d :].any()


def test_readable_on_real_arms_about_one_constant_a_monomial() -> None:
    for name in ("ur5", "kinova", "panda"):
        found = factoring_of(name)
        n = found.chain.n
        used = sum(int((found.S[i, i] != 0).sum()) for i in range(n))
        assert used <= 1.05 * sum(len(found.entries[i, i].digits) for i in range(n))
        assert max(np.abs(found.S[i, i]).max() for i in range(n)) < 20


# Nearly special arms -------------------------------------------------------------------------------------------------


def turned(chain: Chain, size: float, seed: int) -> Chain:
    """The chain with every joint's frame and axis turned a little at random, as a factory calibration finds them."""
    rng = np.random.default_rng(seed)
    joints = []
    for joint in chain.joints:
        R = joint.R @ pin.exp3(rng.normal(0, size, 3))
        joints.append(replace(joint, R=R, axis=pin.exp3(rng.normal(0, size, 3)) @ joint.axis))
    return replace(chain, joints=tuple(joints))


@pytest.mark.parametrize(
    ("name", "size"), [("ypp3", 1e-4), ("ypp3", 4e-4), ("ur5", 1e-4), ("ur5", 1e-3), ("ur5", 1e-2)]
)
@pytest.mark.parametrize("seed", range(3))
def test_a_calibrated_arm_has_the_constants_of_a_general_one(name: str, size: float, seed: int) -> None:
    agrees_as_a_general_arm(factor(turned(arm(name), size, seed)))


@pytest.mark.parametrize(("name", "size"), [("panda", 1e-3), ("xarm7", 3e-3)])
def test_a_calibrated_arm_of_seven_joints_has_the_constants_of_a_general_one(name: str, size: float) -> None:
    agrees_as_a_general_arm(factor(turned(arm(name), size, 0)))


def agrees_as_a_general_arm(found: Factoring) -> None:
    chain = found.chain
    assert found.d == 7 * chain.n - 8
    assert (
        found.cost < 1e-11 and gap(found) > 7
    )  # an entry may show a direction by the square of 1e-4 and more, too little
    allowed = 1e-12 + 10 * found.cost
    q = postures(chain, 20)
    expected = judge(chain, q)
    largest = np.abs(expected).max()
    assert np.abs(J_rows(found, q) @ found.alpha_cad - expected).max() <= allowed * largest
    for (i, j), entry in found.entries.items():
        trigonometric = monomials(entry, q) @ (found.S[i, j] @ found.alpha_cad)
        assert np.abs(trigonometric - expected[:, i, j]).max() <= allowed * largest
    scaled = found.W / parameter_scale(chain)
    assert np.linalg.cond(scaled / np.linalg.norm(scaled, axis=1, keepdims=True)) < 1e3


@pytest.mark.parametrize(
    ("name", "size"),
    [
        pytest.param(name, size, marks=pytest.mark.bench if name == "ur5" and size != 1e-9 else ())
        for name in ("ypp3", "ur5", "panda")
        for size in (1e-10, 1e-9, 3e-9, 1e-8)
    ],
)
def test_what_hardly_matters_is_dropped_and_its_cost_is_told(name: str, size: float) -> None:
    found = factor(turned(arm(name), size, 1))
    q = postures(found.chain, 20)
    expected = judge(found.chain, q)
    error = np.abs(J_rows(found, q) @ found.alpha_cad - expected).max() / np.abs(expected).max()
    assert 0 < found.cost < 2e-8, "constants count from 1e-9 on; some of them together"
    assert error <= ROUNDING + 10 * found.cost


@pytest.mark.parametrize("name", ["ypp3", "ur5", "panda"])
def test_nothing_is_dropped_from_an_arm_as_drawn(name: str) -> None:
    assert factoring_of(name).cost == 0
    assert not any(alpha.part for alpha in factoring_of(name).alphas)


# What the diagonal can not see ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ypp3", "ur5", "panda", "xarm7", "kinova", "z1 without gripper"])
def test_only_the_group_parallel_to_joint_two_hides_from_the_diagonal(name: str) -> None:
    found = factoring_of(name)
    hidden = {pair for pair, S in found.S.items() if S[:, found.d :].any()}
    group = parallel_to_the_second(found.chain)
    assert hidden == {(0, j) for j in group}
    assert len(found.alphas) - found.d == 2 * len(group)
    assert {(alpha.i, alpha.j) for alpha in found.alphas[found.d :]} == {(0, 1)}, "J_12 alone completes J"


def test_two_arms_with_one_diagonal() -> None:
    """Constructed, of bodies that can exist, and judged by pinocchio: equal J_ii everywhere, different J_12."""
    chain = build(REVOLUTE_ONLY[:4], 2)
    found = factor(chain)
    scale = parameter_scale(chain)
    null = np.linalg.svd(found.W[: found.d] / scale)[2][found.d :]
    direction = null.T @ null @ (found.W[-1] / scale) / scale  # the part of the last constant that no diagonal shows
    step = 1.0
    while min(np.linalg.eigvalsh(pseudo_inertia(body)).min() for body in changed(chain, step * direction)) <= 0:
        step /= 2
    assert all(np.linalg.eigvalsh(pseudo_inertia(joint.inertia)).min() > 0 for joint in chain.joints)

    q = postures(chain, 200)
    one, other = judge(chain, q), judge(with_bodies(chain, changed(chain, step * direction)), q)
    diagonal = np.abs(np.einsum("mii->mi", other - one)).max()
    assert diagonal <= 1e-12 * np.abs(one).max()
    assert np.abs((other - one)[:, 0, 1]).max() > 0.01 * np.abs(one[:, 0, 1]).max()
    assert np.abs((other - one)[:, 1:, 1:]).max() <= 1e-12 * np.abs(one).max()


def changed(chain: Chain, difference: np.ndarray) -> list[Inertia]:
    return [body_of(row) for row in (chain.parameters + difference).reshape(-1, 10)]


# The paper's arm -----------------------------------------------------------------------------------------------------


def paper() -> Factoring:
    return factoring_of("ypp3", believe_zeros=True)


def test_the_paper_counts_and_names() -> None:
    found = paper()
    assert (found.rank_per_joint, found.new_per_joint, found.d, len(found.alphas)) == ((4, 2, 1), (3, 2, 1), 6, 6)
    assert found.names == ("alpha_31", "alpha_21", "alpha_22", "alpha_11", "alpha_12", "alpha_13")
    assert {alpha.unit for alpha in found.alphas} == {"kg m2"}


def test_the_papers_equations_12_to_20_corrected() -> None:
    """(17) with 2 alpha_21 in place of alpha_21, (18) and (20) with c_3 in place of c_3^2; see the README of ypp3."""
    found = paper()
    q = postures(found.chain, 50)
    c2, c3, c23 = np.cos(q[:, 1]), np.cos(q[:, 2]), np.cos(q[:, 1] + q[:, 2])
    zero, one = np.zeros(50), np.ones(50)
    expected = {  # over alpha_31, alpha_21, alpha_22, alpha_11, alpha_12, alpha_13
        (0, 0): [zero, 2 * c2 * c23, zero, c23**2, c2**2, one],
        (0, 1): [zero] * 6,
        (0, 2): [zero] * 6,
        (1, 1): [zero, 2 * c3, one, zero, zero, zero],
        (1, 2): [one, c3, zero, zero, zero, zero],
        (2, 2): [one, zero, zero, zero, zero, zero],
    }
    rows = J_rows(found, q)
    for (i, j), columns in expected.items():
        assert np.abs(rows[:, i, j] - np.transpose(columns)).max() <= 1e-12, f"J_{i + 1}{j + 1}"
        assert np.array_equal(found.S[i, j], np.round(found.S[i, j])), "whole numbers only"


def test_the_papers_values() -> None:
    """Table I, alpha_11 and alpha_21 solved with the missing factor 2."""
    named = dict(zip(paper().names, paper().alpha_cad, strict=True))
    table = {
        "alpha_31": 0.0466,
        "alpha_21": (0.6929 - 0.5072) / 2,
        "alpha_22": 0.5072,
        "alpha_12": 0.4544,
        "alpha_13": 0.0152,
    }
    table["alpha_11"] = 0.6987 - table["alpha_12"] - table["alpha_13"] - 2 * table["alpha_21"]
    for name, value in table.items():
        assert named[name] == pytest.approx(value, rel=1e-9), name


def test_the_papers_postures_make_c1_triangular() -> None:
    found = paper()
    q = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -np.pi / 2], [0.0, np.pi / 2, 0.0]])
    own = [found.names.index(name) for name in ("alpha_11", "alpha_12", "alpha_13")]
    C_1 = C_rows(found, q)[:, 0, own]
    assert np.abs(C_1 - np.triu(np.ones((3, 3)))).max() <= 1e-12


def test_believed_zeros_are_named_and_stay_zero() -> None:
    found = paper()
    assert len(found.believed) == 15 == int((~found.free).sum())
    assert "Lxy of link3" in found.believed and "m of link3" not in found.believed
    assert not found.W[:, ~found.free].any()
    other = with_bodies(
        found.chain,
        [Inertia(2.0 + k, [0.0, 0.1 * k, 0.05 * (k == 0)], np.diag([0.03, 0.02, 0.04])) for k in range(3)],
    )
    q = postures(other, 20)
    expected = judge(other, q)
    assert np.abs(J_rows(found, q) @ (found.W @ other.parameters) - expected).max() <= ROUNDING * np.abs(expected).max()


def test_a_zero_is_believed_only_if_it_is_one() -> None:
    chain = arm("ypp3")
    almost = replace(chain.joints[2].inertia, com=[1e-9, 0.15, 0.0])
    assert (
        believed_zeros(chain)[21]
        and not believed_zeros(with_bodies(chain, [*(j.inertia for j in chain.joints[:2]), almost]))[21]
    )


# Words ---------------------------------------------------------------------------------------------------------------


def test_units_follow_what_moves() -> None:
    found = factor(build([(PRISMATIC, "generic", "none"), (REVOLUTE, "generic", "generic")], 0))
    assert {alpha.unit for alpha in found.alphas if (alpha.i, alpha.j) == (0, 0)} == {"kg"}
    assert {alpha.unit for alpha in found.alphas if (alpha.i, alpha.j) == (0, 1)} == {"kg m"}
    reach = factor(build([(REVOLUTE, "generic", "generic"), (PRISMATIC, "generic", "none")], 0))
    assert sorted({alpha.unit for alpha in reach.alphas if (alpha.i, alpha.j) == (0, 0)}) == ["kg m", "kg m2"]
    assert [alpha.unit for alpha in reach.alphas if alpha.i == 1] == ["kg"]


def test_names_part_their_numbers_when_one_is_long() -> None:
    names = factor(own("arm7")).names
    assert "alpha_11" in names and "alpha_1x2_1" in names and len(set(names)) == len(names)
    assert "alpha_1_1" in factor(build([(REVOLUTE, "parallel", "generic")] * 10, 0)).names
