"""From inertias to alpha: whatever the plan, the weighted solution of all measurements, and what they can not tell."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, kstest

from ident.errors import IdentError
from ident.joint.solve import combine, inertia_std, solve

# The paper's arm: alpha_11, alpha_12, alpha_13, alpha_21, alpha_22, alpha_31; (17)-(19) with 2 alpha_21 c_2 c_23.
JOINT_OF_ALPHA = [0, 0, 0, 1, 1, 2]
POS1, POS2, POS3 = (0, 0), (0, -np.pi / 2), (np.pi / 2, 0)  # q_2, q_3


def row(joint, q):
    c2, c3, c23 = np.cos(q[0]), np.cos(q[1]), np.cos(q[0] + q[1])
    return [[c23**2, c2**2, 1, 2 * c2 * c23, 0, 0], [0, 0, 0, 2 * c3, 1, 0], [0, 0, 0, 0, 0, 1]][joint]


CELLS = [(2, POS1), (1, POS1), (1, POS2), (0, POS1), (0, POS2), (0, POS3)]
TABLE_I = [0.0466, 0.6929, 0.5072, 0.6987, 0.4696, 0.0152]  # J_11 at POS2 is printed 0.696
ALPHA = np.array([0.0434, 0.4544, 0.0152, 0.09285, 0.5072, 0.0466])


def rows(cells):
    return np.array([row(*cell) for cell in cells])


def joints(cells):
    return [joint for joint, _ in cells]


def test_table_1_gives_the_corrected_constants_from_tip_to_base():
    found = solve(rows(CELLS), TABLE_I, np.full(6, 0.01), joints(CELLS), JOINT_OF_ALPHA)
    assert found.value == pytest.approx(ALPHA, rel=1e-9)  # 4-digit numbers, six of them
    assert found.determined.all() and found.status == () and found.dof == 0
    assert np.all(found.redundancy == 0) and np.all(found.standardised == 0)


def test_a_saturated_plan_can_not_see_its_own_error_and_one_spare_posture_can():
    wrong = rows(CELLS)
    wrong[:, 3] = np.where(np.array(joints(CELLS)) == 0, wrong[:, 3] / 2, wrong[:, 3])  # (17) as printed
    std = 0.01 * np.array(TABLE_I)
    saturated = solve(wrong, TABLE_I, std, joints(CELLS), JOINT_OF_ALPHA)
    assert saturated.value[0] == pytest.approx(0.1362, abs=1e-4) and saturated.agrees and saturated.chi2 < 1e-12
    spare = (0, (0, np.pi))  # J_11 = 0.3273, by the printed formula 0.5130
    truth = np.array(row(*spare)) @ ALPHA
    assert truth == pytest.approx(0.3273, abs=1e-4)
    printed = np.array(row(*spare))
    printed[3] /= 2
    cells = [*CELLS, spare]
    checked = solve([*wrong, printed], [*TABLE_I, truth], [*std, 0.01 * truth], joints(cells), JOINT_OF_ALPHA)
    assert not checked.agrees and checked.dof == 1 and "the measurements disagree" in checked.status[0]
    right = solve(rows(cells), [*TABLE_I, truth], [*std, 0.01 * truth], joints(cells), JOINT_OF_ALPHA)
    assert right.agrees and right.chi2 == pytest.approx(0, abs=1e-20)


def test_correlated_measurements_of_a_joint_give_the_generalised_solution_and_check_each_other():
    rng = np.random.default_rng(6)
    cells = [*CELLS, (0, (0, np.pi)), (1, (0, 2.0)), (0, (0.7, 0.9))]
    C, M = rows(cells), len(cells)
    same = np.equal.outer(joints(cells), joints(cells))
    V = np.where(same, 0.9e-4, 0) + 1e-5 * np.eye(M)  # a common drive error of every joint, and noise
    J = C @ ALPHA + np.linalg.cholesky(V) @ rng.normal(size=M)
    found = solve(C, J, V, joints(cells), JOINT_OF_ALPHA)
    information = C.T @ np.linalg.solve(V, C)
    tolerance = 100 * np.finfo(float).eps * np.linalg.cond(information)
    assert found.value == pytest.approx(np.linalg.solve(information, C.T @ np.linalg.solve(V, J)), rel=tolerance)
    assert found.covariance == pytest.approx(np.linalg.inv(information), rel=tolerance, abs=tolerance * 1e-4)
    for k in np.flatnonzero(found.redundancy):  # what the others, and the errors they share with it, say of it
        rest = np.arange(M) != k
        other = solve(C[rest], J[rest], V[np.ix_(rest, rest)], np.array(joints(cells))[rest], JOINT_OF_ALPHA)
        shared = V[k, rest] @ np.linalg.solve(V[np.ix_(rest, rest)], J[rest] - C[rest] @ other.value)
        assert found.left_out[k] == pytest.approx(J[k] - C[k] @ other.value - shared, rel=1e-6)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(0, 6), st.integers(1, 5))
def test_any_plan_in_any_order_gives_the_global_weighted_solution(seed, d, spare, n):
    rng = np.random.default_rng(seed)
    C = rng.normal(size=(d + spare, d))
    std = np.exp(rng.uniform(np.log(1e-3), 0, d + spare))
    J = rng.normal(size=d + spare)
    found = solve(C, J, std, rng.integers(n, size=d + spare), rng.integers(n, size=d))
    A = C / std[:, None]
    y, singular = J / std, np.linalg.svd(A, compute_uv=False)
    # with a large residual as sensitive as the condition squared, relative to |y| over the smallest singular value
    tolerance = 100 * np.finfo(float).eps * (singular[0] / singular[-1]) ** 2
    expected, misfit = np.linalg.lstsq(A, y, rcond=None)[:2]
    covariance = np.linalg.inv(A.T @ A)
    assert np.linalg.norm(found.value - expected) <= tolerance * np.linalg.norm(y) / singular[-1]
    assert np.linalg.norm(found.covariance - covariance) <= tolerance * np.linalg.norm(covariance)
    assert found.dof == spare and found.determined.all()
    assert sum(found.redundancy) == pytest.approx(spare, abs=max(tolerance, 1e-6))
    if spare:
        assert found.chi2 == pytest.approx(float(misfit[0]), abs=tolerance * y @ y)


def test_an_alpha_its_own_joint_can_not_determine_stays_open_until_a_later_joint_closes_it():
    # joint 2 measured once only: alpha_21 and alpha_22 wait for J_11, measured at four postures
    cells = [(2, POS1), (1, POS1), (0, POS1), (0, POS2), (0, POS3), (0, (0, np.pi))]
    J = rows(cells) @ ALPHA
    found = solve(rows(cells), J, np.full(6, 1e-3), joints(cells), JOINT_OF_ALPHA)
    before = solve(rows(cells)[:2], J[:2], np.full(2, 1e-3), joints(cells)[:2], JOINT_OF_ALPHA)
    assert np.flatnonzero(before.determined).tolist() == [5] and found.determined.all()
    assert found.value == pytest.approx(ALPHA, rel=1e-12)


def test_what_was_never_measured_is_named_and_the_rest_stays_exact():
    cells = CELLS[:5]  # without J_11 at POS3 alpha_12 and alpha_13 are known in sum only
    found = solve(rows(cells), rows(cells) @ ALPHA, np.full(5, 1e-3), joints(cells), JOINT_OF_ALPHA)
    assert found.determined.tolist() == [True, False, False, True, True, True]
    assert found.status == ("not determined by these measurements: alpha[1] of joint 1, alpha[2] of joint 1",)
    assert found.value[found.determined] == pytest.approx(ALPHA[found.determined], rel=1e-12)
    assert np.isinf(found.std[1]) and np.isfinite(found.value).all() and np.isfinite(found.covariance).all()
    seen, unseen = row(0, (0, 1.0)), row(0, (1.0, 1.0))
    std = inertia_std([seen, unseen], found.covariance, found.unseen)
    assert np.isfinite(std[0]) and np.isinf(std[1])
    assert np.array(seen) @ found.value == pytest.approx(np.array(seen) @ ALPHA, rel=1e-12)


def test_covariance_and_chi_square_are_those_of_repeated_measurements():
    rng = np.random.default_rng(1)
    cells = [*CELLS, (0, (0, np.pi)), (1, (0, 2.0)), (0, (0.7, 0.9))]
    C, J = rows(cells), rows(cells) @ ALPHA
    std = 0.01 * J
    distance, misfit, alarms, worst = [], [], 0, []
    for _ in range(400):
        found = solve(C, J + std * rng.normal(size=len(J)), std, joints(cells), JOINT_OF_ALPHA)
        error = found.value - ALPHA
        distance.append(error @ np.linalg.solve(found.covariance, error))
        misfit.append(found.chi2)
        alarms += not found.agrees
        worst.append(found.standardised)
    # p-values of 400 draws: one in ten thousand honest runs fails each
    assert kstest(distance, chi2(6).cdf).pvalue > 1e-4
    assert kstest(misfit, chi2(3).cdf).pvalue > 1e-4
    assert alarms <= 4
    checked = np.array(worst)[:, found.redundancy > 0]
    assert kstest(checked[:, -1], "norm").pvalue > 1e-4


def test_a_wrong_measurement_stands_out_by_its_standardised_residual():
    rng = np.random.default_rng(2)
    postures = rng.uniform(-2.5, 2.5, (8, 2))
    cells = [*CELLS, *[(0, q) for q in postures]]
    J = rows(cells) @ ALPHA
    std = np.full(len(J), 1e-3)
    J[9] += 0.02
    found = solve(rows(cells), J, std, joints(cells), JOINT_OF_ALPHA)
    assert not found.agrees and np.argmax(np.abs(found.standardised)) == 9


def test_inertia_std_is_the_spread_of_the_predicted_inertia():
    std = 0.01 * np.array(TABLE_I)
    found = solve(rows(CELLS), TABLE_I, std, joints(CELLS), JOINT_OF_ALPHA)
    assert inertia_std(rows(CELLS), found.covariance, found.unseen) == pytest.approx(std, rel=1e-9)
    assert inertia_std(row(0, (0, np.pi)), found.covariance).shape == ()
    # J_11(0, pi) = J_11(POS1) - 4 alpha_21 = J_11(POS1) - 2 J_22(POS1) + 2 J_22(POS2)
    expected = np.sqrt(std[3] ** 2 + 4 * std[1] ** 2 + 4 * std[2] ** 2)
    assert inertia_std(row(0, (0, np.pi)), found.covariance) == pytest.approx(expected, rel=1e-9)


def test_the_papers_stiffness_of_one_joint_is_a_model_error_not_a_mean():
    found = combine([5500, 4000, 4000], [55, 40, 40])
    assert not found.agrees and found.dof == 2
    # weights 1/55^2, 1/40^2, 1/40^2
    assert found.value == pytest.approx((5500 / 55**2 + 8000 / 40**2) / (1 / 55**2 + 2 / 40**2))
    assert found.spread > 500 and found.std == pytest.approx(np.sqrt(found.chi2 / 2) / np.sqrt(1 / 55**2 + 2 / 40**2))


def test_records_that_agree_are_averaged_and_seldom_called_different():
    rng = np.random.default_rng(3)
    s = np.array([55.0, 40, 20, 90])
    found = [combine(5000 + s * rng.normal(size=4), s) for _ in range(2000)]
    score = [(x.value - 5000) / x.std for x in found if x.agrees]
    assert kstest(score, "norm").pvalue > 1e-4
    assert sum(not x.agrees for x in found) <= 9  # 2 expected; 9 once in ten thousand times
    single = combine([7.0], [0.5])
    assert (single.value, single.std, single.agrees, single.spread) == (7.0, 0.5, True, 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"J": [1, 2]}, r"J has shape \(2,\), expected \(6,\)"),
        ({"std": [1] * 5}, r"std has shape \(5,\)"),
        ({"std": [1, 1, 1, 0, 1, 1]}, "std: measurement 3 has 0, expected more than 0"),
        ({"J": [1, np.nan, 1, 1, 1, 1]}, "J: measurement 1 is not finite"),
        (
            {"rows": np.where(np.arange(36).reshape(6, 6) == 7, np.inf, rows(CELLS))},
            "rows: measurement 1 is not finite",
        ),
        ({"rows": np.zeros((0, 6))}, "rows must be"),
        ({"std": np.ones((6, 5))}, r"std: a covariance must be symmetric \[6, 6\], found shape \(6, 5\)"),
        ({"std": np.eye(6) + np.eye(6, k=1)}, "std: a covariance must be symmetric"),
        ({"std": np.ones((6, 6))}, "std: the covariance of J is not positive definite"),
        ({"joint_of_measurement": [0]}, "joint_of_measurement has shape"),
        ({"joint_of_alpha": [0]}, "joint_of_alpha has shape"),
    ],
)
def test_misuse_is_refused_in_one_line(change, message):
    arguments = {
        "rows": rows(CELLS), "J": TABLE_I, "std": np.ones(6), "joint_of_measurement": joints(CELLS),
        "joint_of_alpha": JOINT_OF_ALPHA,
    } | change  # fmt: skip
    with pytest.raises(IdentError, match=message) as error:
        solve(**arguments)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("values", "std"), [([], []), ([1, 2], [1]), ([1, np.nan], [1, 1]), ([1, 2], [1, 0])])
def test_nothing_to_combine_is_refused(values, std):
    with pytest.raises(IdentError, match="values and std must be"):
        combine(values, std)
