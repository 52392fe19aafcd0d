"""Many small matrices: their inverses and products are those of LAPACK, whatever the units of their rows and columns."""

from __future__ import annotations

import numpy as np
import pytest

from ident.arm.small_matrices import by_component, inverses, products, times

RNG = np.random.default_rng(2)


@pytest.mark.parametrize("m", [1, 2, 3, 4])
def test_inverses_are_those_of_lapack(m: int) -> None:
    units = 10.0 ** RNG.uniform(-6.0, 6.0, m)
    A = RNG.normal(size=(50, m, m)) + 1j * RNG.normal(size=(50, m, m))
    found = inverses(units[:, None] * A * units)
    np.testing.assert_allclose(found * units[:, None] * units, np.linalg.inv(A), rtol=1e-9)


@pytest.mark.parametrize(("m", "inner", "k"), [(1, 1, 1), (2, 2, 1), (3, 9, 3), (3, 3, 8), (6, 6, 6)])
def test_products_are_those_of_numpy(m: int, inner: int, k: int) -> None:
    A, B = (RNG.normal(size=(50, *shape)) + 1j * RNG.normal(size=(50, *shape)) for shape in ((m, inner), (inner, k)))
    for left in (A, by_component(np.moveaxis(A, 0, 2))):
        np.testing.assert_allclose(products(left, B), A @ B, rtol=1e-12)
        np.testing.assert_allclose(times(left, B[..., 0]), (A @ B)[..., 0], rtol=1e-12)


def test_lines_stay_in_a_row() -> None:
    A = by_component(RNG.normal(size=(3, 3, 50)))
    for made in (A, inverses(A), products(A, A), products(A, np.swapaxes(A.conj(), 1, 2))):
        assert made.shape == (50, 3, 3) and made.strides[0] == made.itemsize


@pytest.mark.parametrize("m", [1, 2, 3, 4])
def test_what_has_no_inverse_is_refused(m: int) -> None:
    A = np.broadcast_to(np.eye(m, dtype=complex), (3, m, m)).copy()
    A[1, 0] = 0.0
    with pytest.raises(np.linalg.LinAlgError):
        inverses(A)
