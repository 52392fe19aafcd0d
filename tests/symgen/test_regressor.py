"""Rows over alpha: equal to pinocchio for any bodies, of any shape of postures, and to the trigonometric form."""

from __future__ import annotations

import numpy as np
import pytest
from arms import arm, factoring_of
from chains import chains, judge, own, postures, random_body, with_bodies
from hypothesis import given, settings
from hypothesis import strategies as st

from symgen.basis import factor
from symgen.chain import Chain
from symgen.inertia import monomials
from symgen.kinematics import inertia_matrix
from symgen.regressor import C_rows, J_rows

#: Rounding of some hundred additions times the condition of W, below 1e3 on these arms.
ROUNDING = 1e-12

LAW = settings(derandomize=True, deadline=None, max_examples=20)


@pytest.mark.parametrize("name", ["ypp3", "ur3", "ur5", "ur10", "panda", "xarm7", "kinova", "z1", "z1 without gripper"])
def test_constants_of_the_urdf_give_pinocchios_matrix(name: str) -> None:
    found, q = factoring_of(name), postures(arm(name), 200)
    expected = judge(found.chain, q)
    largest = np.abs(expected).max()
    assert np.abs(J_rows(found, q) @ found.alpha_cad - expected).max() <= ROUNDING * largest
    diagonal = C_rows(found, q) @ found.alpha_cad[: found.d]
    assert np.abs(diagonal - np.einsum("mii->mi", expected)).max() <= ROUNDING * largest


@LAW
@given(chains(2, 5), st.integers(0, 2**32 - 1))
def test_constants_of_any_bodies_give_pinocchios_matrix(chain: Chain, seed: int) -> None:
    rng = np.random.default_rng(seed)
    found, other = factor(chain), with_bodies(chain, [random_body(rng) for _ in chain.joints])
    q, alpha = postures(chain, 3), found.W @ other.parameters
    expected = judge(other, q)
    assert np.abs(J_rows(found, q) @ alpha - expected).max() <= ROUNDING * np.abs(expected).max()
    diagonal = C_rows(found, q) @ alpha[: found.d]
    assert np.abs(diagonal - np.einsum("mii->mi", expected)).max() <= ROUNDING * np.abs(expected).max()


def test_rows_are_the_trigonometric_form() -> None:
    found, q = factoring_of("panda"), postures(arm("panda"), 20)
    rows = J_rows(found, q)
    for (i, j), entry in found.entries.items():
        assert np.abs(monomials(entry, q) @ found.S[i, j] - rows[:, i, j]).max() <= ROUNDING * np.abs(rows).max()
    assert np.abs(rows - rows.swapaxes(1, 2)).max() <= ROUNDING * np.abs(rows).max()
    assert np.abs(np.einsum("miid->mid", rows)[..., found.d :]).max() <= ROUNDING * np.abs(rows).max()


def test_postures_may_come_in_any_shape() -> None:
    found = factor(own("scara4"))
    n, d, D = found.chain.n, found.d, len(found.alphas)
    q = postures(found.chain, 6)
    for function, flat in ((C_rows, (n, d)), (J_rows, (n, n, D))):
        whole = function(found, q)
        assert whole.shape == (6, *flat)
        assert np.array_equal(function(found, q[0]), whole[0])
        assert np.array_equal(function(found, q.reshape(2, 3, n)), whole.reshape(2, 3, *flat))
    assert inertia_matrix(found.chain, q[0]).shape == (n, n)
