"""Alphas that links can have, judged by pinocchio and by the closed forms of the paper's arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ident.errors import IdentError
from ident.identification.physical import consistency, pseudo_inertia, ypp_inequalities
from symgen.chain import PARAMETERS

TABLE_I = np.array([0.0434, 0.4544, 0.0152, 0.09285, 0.5072, 0.0466])  # corrected
PRINTED = np.array([0.1362, 0.4544, 0.0152, 0.0928, 0.5072, 0.0466])
TABLE_II = np.array([0.0723, 0.5477, 0.0223, 0.1479, 0.6242, 0.07])  # corrected
# J_11(POS1), J_11(POS2), J_11(POS3), J_22(POS1), J_22(POS2), J_33 of (alpha_11, .. alpha_31)
POSTURES = np.array([
    [1, 1, 1, 2, 0, 0], [0, 1, 1, 0, 0, 0], [0, 0, 1, 0, 0, 0],
    [0, 0, 0, 2, 1, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1],
])  # fmt: skip
L2 = 0.35
URDF = Path(__file__).parents[3] / "robots" / "ypp3" / "ypp3.urdf"


def at(link, name):
    return 10 * (link - 1) + PARAMETERS.index(name)


def ypp_map():
    """W [6, 30] and the parameters that symmetry leaves free, from (13)-(16)."""
    W, free = np.zeros((6, 30)), np.zeros(30, dtype=bool)
    W[0, [at(3, "Lzz"), at(3, "Lyy")]] = 1, -1
    W[1, [at(2, "Lzz"), at(2, "Lyy"), at(3, "m")]] = 1, -1, L2**2
    W[2, [at(1, "Lzz"), at(2, "Lyy"), at(3, "Lyy")]] = 1
    W[3, at(3, "my")] = L2
    W[4, [at(2, "Lxx"), at(3, "Lxx"), at(3, "m")]] = 1, 1, L2**2
    W[5, at(3, "Lxx")] = 1
    free[[at(link, name) for link in (1, 2, 3) for name in ("m", "my", "Lxx", "Lyy", "Lzz")]] = True
    return W, free


W, FREE = ypp_map()


def body(rng, symmetric=True):
    """Ten parameters of a random collection of point masses (any such is a possible body)."""
    points, mass = rng.normal(size=(8, 3)) * 0.1, rng.exponential(size=8) * 0.3
    if symmetric:  # mirrored in x and in z: only my, and no products of inertia
        points = np.concatenate([points * [i, 1, k] for i in (1, -1) for k in (1, -1)])
        mass = np.tile(mass, 4) / 4
    first = mass @ points
    L = np.einsum("p,pi,pi->", mass, points, points) * np.eye(3) - np.einsum("p,pi,pj->ij", mass, points, points)
    return np.array([mass.sum(), *first, L[0, 0], L[0, 1], L[1, 1], L[0, 2], L[1, 2], L[2, 2]])


def test_the_map_from_parameters_to_alpha_is_pinocchios_inertia_matrix():
    model = pin.buildModelFromUrdf(str(URDF))
    data, rng = model.createData(), np.random.default_rng(0)
    for _ in range(5):
        links = np.concatenate([body(rng) for _ in range(3)])
        for k in range(3):
            model.inertias[k + 1] = pin.Inertia.FromDynamicParameters(links[10 * k : 10 * k + 10])
        a11, a12, a13, a21, a22, a31 = W @ links
        q = rng.uniform(-2, 2, 3)
        J = pin.crba(model, data, q)
        c2, c3, c23 = np.cos(q[1]), np.cos(q[2]), np.cos(q[1] + q[2])
        diagonal = [a11 * c23**2 + a12 * c2**2 + 2 * a21 * c2 * c23 + a13, 2 * a21 * c3 + a22, a31]
        assert np.diag(J) == pytest.approx(diagonal, rel=1e-12)
        assert J[1, 2] == pytest.approx(a21 * c3 + a31, rel=1e-12)


def test_pseudo_inertia_is_pinocchios():
    rng = np.random.default_rng(1)
    links = np.array([body(rng, symmetric=False) for _ in range(4)])
    for matrix, parameters in zip(pseudo_inertia(links), links, strict=True):
        expected = pin.PseudoInertia.FromDynamicParameters(parameters).toMatrix()
        assert matrix == pytest.approx(expected, rel=1e-12, abs=1e-15)
        assert np.linalg.eigvalsh(matrix)[0] > 0


def test_corrected_table_1_is_possible_and_the_printed_one_is_not():
    assert all(condition.ok for condition in ypp_inequalities(TABLE_I))
    found = consistency(TABLE_I, None, W, FREE)
    assert found.ok and found.distance < 1e-9 and found.status == ()
    assert W @ found.parameters == pytest.approx(TABLE_I, rel=1e-8)
    assert np.all(found.parameters[~FREE] == 0)

    first = ypp_inequalities(PRINTED)[0]
    assert (first.text, first.left, first.right, first.ok) == ("alpha_11 <= alpha_31", 0.1362, 0.0466, False)
    impossible = consistency(PRINTED, None, W, FREE)
    assert not impossible.ok
    # moving alpha_11 and alpha_31 together is the least that this condition alone asks for; the others add to it
    assert impossible.distance > (0.1362 - 0.0466) / np.sqrt(2) / np.linalg.norm(PRINTED)
    assert impossible.nearest[0] == pytest.approx(impossible.nearest[5], rel=1e-4)


def test_corrected_table_2_misses_by_a_seventh_of_a_standard_deviation():
    inverse = np.linalg.inv(POSTURES)
    covariance = inverse @ np.diag((0.01 * POSTURES @ TABLE_II) ** 2) @ inverse.T  # 1 % of every J_ii
    assert [c.ok for c in ypp_inequalities(TABLE_II)] == [False, True, True, True]
    found = consistency(TABLE_II, covariance, W, FREE)
    assert not found.ok
    # one violated condition g alpha <= 0: the distance to it is g alpha / sqrt(g V g)
    g = np.array([1, 0, 0, 0, 0, -1])
    assert g @ TABLE_II == pytest.approx(0.0023)
    assert found.distance == pytest.approx(0.0023 / np.sqrt(g @ covariance @ g), rel=1e-3)
    assert found.distance == pytest.approx(0.147, abs=0.001)
    assert found.nearest == pytest.approx(TABLE_II - covariance @ g * 0.0023 / (g @ covariance @ g), abs=1e-5)


def test_semidefinite_program_agrees_with_the_closed_forms():
    rng = np.random.default_rng(2)
    seen, broken_alone = [], np.zeros(4, dtype=int)
    for k in range(240):
        links = np.concatenate([body(rng) for _ in range(3)])
        alpha = W @ links * np.exp(0.25 * rng.normal(size=6))
        if k % 2:  # half of them near the limit of alpha_21
            room = max((alpha[0] + alpha[5]) * (alpha[1] + alpha[4] - alpha[5]), 0.0)
            alpha[3] = np.sqrt(room) / 2 * rng.uniform(0.95, 1.05)
        conditions = ypp_inequalities(alpha)
        margin = min((c.right - c.left) / (abs(c.left) + abs(c.right)) for c in conditions)
        if abs(margin) < 1e-4:  # closer than the program can tell
            continue
        found = consistency(alpha, None, W, FREE)
        assert found.status == () and found.ok == all(c.ok for c in conditions), (alpha, margin, found.distance)
        seen.append(found.ok)
        broken = [not c.ok for c in conditions]
        broken_alone += np.array(broken) & (sum(broken) == 1)
    assert 30 < sum(seen) < len(seen) - 30 and broken_alone.min() >= 1


def ur_like():
    """Inertia rows of random postures of a random 6R arm, base parameters W, and possible links."""
    rng = np.random.default_rng(4)
    model = pin.Model()
    joint = 0
    for k in range(6):
        placement = pin.SE3(pin.rpy.rpyToMatrix(*rng.uniform(-2, 2, 3)), rng.uniform(-0.4, 0.4, 3))
        joint = model.addJoint(joint, pin.JointModelRZ(), placement, f"j{k}")
    links = np.concatenate([body(rng, symmetric=False) for _ in range(6)])
    data, zero, rows = model.createData(), np.zeros(6), []
    for _ in range(40):
        q = rng.uniform(-3, 3, 6)
        rest = pin.computeJointTorqueRegressor(model, data, q, zero, zero).copy()
        rows += [pin.computeJointTorqueRegressor(model, data, q, zero, e)[k] - rest[k] for k, e in enumerate(np.eye(6))]
    rows = np.array(rows)
    _, s, V = np.linalg.svd(rows, full_matrices=False)
    basis = V[: int(np.sum(s > 1e-9 * s[0]))]
    weighted = rows @ basis.T / (0.03 * (rows @ links))[:, None]
    return basis, links, np.linalg.inv(weighted.T @ weighted)


def test_nearest_alpha_of_a_six_joint_arm_is_the_projection_on_what_links_can_have():
    basis, links, covariance = ur_like()
    free = np.ones(60, dtype=bool)
    alpha, metric = basis @ links, np.linalg.inv(covariance)
    assert consistency(alpha, covariance, basis, free).ok
    rng = np.random.default_rng(5)
    root, projected = np.linalg.cholesky(covariance), 0
    for _ in range(6):
        noisy = alpha + root @ rng.normal(size=len(alpha)) * 4
        found = consistency(noisy, covariance, basis, free)
        assert found.status == ()
        smallest = np.linalg.eigvalsh(pseudo_inertia(found.parameters.reshape(6, 10)))[:, 0].min()
        assert smallest > -1e-8 * np.abs(found.parameters).max()
        assert found.distance <= np.sqrt((noisy - alpha) @ metric @ (noisy - alpha))
        projected += not found.ok
        # a projection on a convex cone: its own point lies in the plane, no possible alpha on the other side
        step = metric @ (noisy - found.nearest)
        slack = 2e-6 * np.linalg.norm(np.linalg.solve(root, noisy)) * np.sqrt(noisy @ metric @ noisy)
        assert abs(step @ found.nearest) < slack
        others = [basis @ np.concatenate([body(rng, symmetric=False) for _ in range(6)]) for _ in range(20)]
        assert max(step @ other for other in [alpha, *others]) < slack
    assert projected >= 3


def test_of_equal_links_those_nearest_to_the_prior_are_taken():
    basis, links, covariance = ur_like()
    found = consistency(basis @ links, covariance, basis, np.ones(60, dtype=bool), prior=links)
    # the program closes to 1e-9 an objective in which the links' distance from the prior weighs 1e-6
    assert found.ok and np.linalg.norm(found.parameters - links) < 1e-3 * np.linalg.norm(links)
    small = consistency(basis @ links, covariance, basis, np.ones(60, dtype=bool))
    assert small.ok and np.linalg.norm(small.parameters) < np.linalg.norm(links)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: consistency(TABLE_I, None, W[:, :25], FREE[:25]), r"W must be \[d, 10 n\]"),
        (lambda: consistency(TABLE_I[:5], None, W, FREE), r"W must be \[d, 10 n\]"),
        (lambda: consistency(TABLE_I, None, W, FREE[:10]), r"W must be \[d, 10 n\]"),
        (lambda: consistency(TABLE_I * 0, None, W, FREE), "not all zero"),
        (lambda: consistency(TABLE_I * np.nan, None, W, FREE), "finite"),
        (lambda: consistency(TABLE_I, np.eye(5), W, FREE), r"covariance has shape \(5, 5\)"),
        (lambda: consistency(TABLE_I, np.zeros((6, 6)), W, FREE), "not positive definite"),
        (lambda: consistency(TABLE_I, None, W, FREE, prior=[1.0]), r"prior has shape \(1,\)"),
        (lambda: ypp_inequalities(TABLE_I[:4]), "alpha must be alpha_11, alpha_12"),
    ],
)
def test_misuse_is_refused_in_one_line(call, message):
    with pytest.raises(IdentError, match=message) as error:
        call()
    assert "\n" not in str(error.value)
