"""Inverses of many small matrices: those of LAPACK, whatever the units of their rows and columns."""

from __future__ import annotations

import numpy as np
import pytest

from ident.arm.inverses import inverses

RNG = np.random.default_rng(2)


@pytest.mark.parametrize("m", [1, 2, 3, 4])
def test_inverses_are_those_of_lapack(m: int) -> None:
    units = 10.0 ** RNG.uniform(-6.0, 6.0, m)
    A = RNG.normal(size=(50, m, m)) + 1j * RNG.normal(size=(50, m, m))
    found = inverses(units[:, None] * A * units)
    np.testing.assert_allclose(found * units[:, None] * units, np.linalg.inv(A), rtol=1e-9)


@pytest.mark.parametrize("m", [1, 2, 3, 4])
def test_what_has_no_inverse_is_refused(m: int) -> None:
    A = np.broadcast_to(np.eye(m, dtype=complex), (3, m, m)).copy()
    A[1, 0] = 0.0
    with pytest.raises(np.linalg.LinAlgError):
        inverses(A)
