"""J(q) as exact polynomials, judged by pinocchio on arms of every kind, and by what an inertia matrix must obey."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import arm
from chains import Kind, build, chains, general_chain, judge, postures, with_bodies
from hypothesis import given, settings
from hypothesis import strategies as st

from symgen.basis import degrees
from symgen.chain import PRISMATIC, REVOLUTE, Chain
from symgen.inertia import LOW_DEGREE, angles, derive, length_scale, monomials, parameter_scale
from symgen.kinematics import inertia_matrix, torque_rows

#: Both sides add up at most some hundred numbers no larger than the largest entry of J, in another order.
ROUNDING = 1e-12

LAW = settings(derandomize=True, deadline=None, max_examples=25)


def by_monomials(chain: Chain, q: np.ndarray) -> np.ndarray:
    """J(q) [m, n, n] by the derived polynomials."""
    J = np.zeros((len(q), chain.n, chain.n))
    for i in range(chain.n):
        for j in range(i, chain.n):
            entry = derive(chain, i, j)
            J[:, i, j] = J[:, j, i] = monomials(entry, q) @ (entry.A @ chain.parameters)
    return J


@LAW
@given(chains(2, 5), st.integers(0, 99))
def test_every_entry_is_pinocchios(chain: Chain, seed: int) -> None:
    q = postures(chain, 5, seed)
    expected = judge(chain, q)
    largest = np.abs(expected).max()
    assert np.abs(by_monomials(chain, q) - expected).max() <= ROUNDING * largest
    assert np.abs(inertia_matrix(chain, q) - expected).max() <= ROUNDING * largest


@pytest.mark.parametrize("n", [6, 7])
def test_every_entry_is_pinocchios_on_general_arms_of_six_and_seven_joints(n: int) -> None:
    chain = general_chain(3, n)
    q = postures(chain, 5)
    expected = judge(chain, q)
    assert np.abs(by_monomials(chain, q) - expected).max() <= ROUNDING * np.abs(expected).max()


@pytest.mark.parametrize("name", ["ypp3", "ur3", "ur5", "ur10", "panda", "xarm7", "kinova", "z1", "z1 without gripper"])
def test_every_entry_is_pinocchios_on_real_arms(name: str) -> None:
    chain = arm(name)
    q = postures(chain, 200)
    expected = judge(chain, q)
    assert np.abs(by_monomials(chain, q) - expected).max() <= ROUNDING * np.abs(expected).max()
    assert np.abs(inertia_matrix(chain, q) - expected).max() <= ROUNDING * np.abs(expected).max()


@LAW
@given(chains(2, 6))
def test_the_matrix_is_one_of_inertia(chain: Chain) -> None:
    q = postures(chain, 3)
    J = by_monomials(chain, q)
    assert np.linalg.eigvalsh(J).min() > 0
    for i in range(chain.n):
        other = np.concatenate([postures(chain, 3, 1)[:, : i + 1], q[:, i + 1 :]], axis=1)
        moved = inertia_matrix(chain, other)[:, i, i]
        assert np.abs(moved - J[:, i, i]).max() <= ROUNDING * np.abs(J).max(), f"J_{i + 1}{i + 1} feels q_1..q_{i + 1}"


@LAW
@given(chains(2, 4), st.integers(0, 2**32 - 1))
def test_it_is_linear_in_the_bodies(chain: Chain, seed: int) -> None:
    q = postures(chain, 2)
    others = build([(REVOLUTE, "generic", "none")] * chain.n, seed)
    theirs = [joint.inertia for joint in others.joints]
    both = with_bodies(chain, [joint.inertia + body for joint, body in zip(chain.joints, theirs, strict=True)])
    heavier = [replace(joint.inertia, mass=3 * joint.inertia.mass, I=3 * joint.inertia.I) for joint in chain.joints]
    J, J_both = by_monomials(chain, q), by_monomials(both, q)
    assert np.abs(by_monomials(with_bodies(chain, theirs), q) + J - J_both).max() <= ROUNDING * np.abs(J_both).max()
    assert np.abs(by_monomials(with_bodies(chain, heavier), q) - 3 * J).max() <= ROUNDING * 3 * np.abs(J).max()


def test_a_general_arm_has_five_functions_a_joint() -> None:
    chain = general_chain(0, 7)
    assert [len(derive(chain, i, i).digits) for i in range(7)] == [5**k for k in range(6, -1, -1)]


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("ypp3", [7, 3, 1]),
        ("ur5", [55, 37, 19, 11, 3, 1]),
        ("kinova", [99, 41, 27, 9, 3, 1]),
        ("z1 without gripper", [61, 49, 25, 11, 3, 1]),
        ("panda", [805, 309, 119, 43, 11, 5, 1]),
        ("xarm7", [805, 309, 119, 43, 11, 5, 1]),
    ],
)
def test_cumulative_angles_keep_real_arms_short(name: str, counts: list[int]) -> None:
    chain = arm(name)
    assert [len(derive(chain, i, i).digits) for i in range(chain.n)] == counts


def test_angles_add_up_along_parallel_axes_only() -> None:
    kinds: list[Kind] = [
        (REVOLUTE, "generic", "generic"),
        (REVOLUTE, "generic", "generic"),
        (REVOLUTE, "parallel", "generic"),
        (REVOLUTE, "antiparallel", "generic"),
        (PRISMATIC, "parallel", "generic"),
        (REVOLUTE, "parallel", "generic"),
    ]
    chain = build(kinds, 0)
    assert angles(chain, 1) == (((1, 1),), ((1, 1), (2, 1)), ((1, 1), (2, 1), (3, -1)), ((4, 1),), ((5, 1),))
    assert angles(chain, 3) == (((3, 1),), ((4, 1),), ((5, 1),))


def test_a_slide_enters_with_its_square() -> None:
    chain = build([(REVOLUTE, "generic", "generic"), (PRISMATIC, "generic", "generic")], 1)
    entry = derive(chain, 0, 0)
    assert entry.turning == (False,)
    assert degrees(entry).tolist() == [0, 1, 2]
    assert monomials(entry, np.array([9.0, 3.0])).tolist() == [1.0, 3.0, 9.0]


def test_only_the_wanted_monomials_are_derived() -> None:
    chain = arm("panda")
    entry = derive(chain, 0, 2)
    rows = [3, 40, 200]
    wanted = derive(chain, 0, 2, entry.digits[rows])
    assert {tuple(digits) for digits in entry.digits[rows]} <= {tuple(digits) for digits in wanted.digits}
    for digits, row in zip(entry.digits[rows], entry.A[rows], strict=True):
        same = (wanted.digits == digits).all(axis=1)
        assert np.abs(wanted.A[same].sum(axis=0) - row).max() <= ROUNDING * np.abs(row).max()


def test_an_entry_too_long_to_write_out_says_so_and_keeps_its_low_degrees() -> None:
    chain = general_chain(0, 8)
    long, short = derive(chain, 0, 0), derive(chain, 1, 1)
    assert not long.complete and degrees(long).max() <= LOW_DEGREE
    assert short.complete and len(short.digits) == 5**6


def test_a_row_over_the_parameters_is_the_polynomial_evaluated() -> None:
    chain = build(
        [(REVOLUTE, "generic", "generic"), (PRISMATIC, "right angle", "none"), (REVOLUTE, "generic", "none")], 5
    )
    q = postures(chain, 4)
    for i, j in [(0, 0), (0, 2), (1, 2)]:
        entry = derive(chain, i, j)
        pushed = np.broadcast_to(np.eye(3)[j], q.shape)  # J e_j are the torques of a unit acceleration of joint j
        rows = torque_rows(chain, q, np.zeros(q.shape), pushed, np.zeros(3))[:, i]
        assert np.abs(monomials(entry, q) @ entry.A - rows).max() <= ROUNDING * np.abs(rows).max()


def test_scales_make_parameters_comparable() -> None:
    chain = arm("ypp3")
    half_reach = (0.15 + 0.35) / 2
    assert length_scale(chain) == pytest.approx(half_reach, rel=1e-15)
    assert parameter_scale(chain)[:10] == pytest.approx([half_reach**2, *[half_reach] * 3, *[1.0] * 6], rel=1e-15)
    assert length_scale(general_chain(0, 1)) == 1.0
