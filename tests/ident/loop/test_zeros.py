"""Whether zeros of the URDF are none: general links that came out as symmetric ones, and others."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from ident.loop.zeros import far_from_zero
from ident.records.campaign import Array
from ident.search.refits import State
from symgen.plan import chain_of_robot, make_model
from symgen.robot import load_robot

CHAIN = chain_of_robot(load_robot(Path(__file__).parents[3] / "robots" / "ypp3"))
GENERAL, SYMMETRIC = make_model(CHAIN), make_model(CHAIN, believe_zeros=True)
FREE = SYMMETRIC.factoring.free
#: Shares of each constant, or of 1 where it is zero, up to which records tell it: well and hardly.
WELL, HARDLY = 1e-4, 10.0


def fitted_with(phi: Array, told: float) -> State:
    """A state whose constants alpha are those of bodies `phi`, `told` up to this share."""
    n, alpha = GENERAL.chain.n, GENERAL.factoring.W @ phi
    scale = np.concatenate([np.ones(4 * n), np.maximum(np.abs(alpha), 1e-3 * np.abs(alpha).max())])
    problem = SimpleNamespace(
        n=n, D=len(alpha), scale=scale, parameters=lambda vector: SimpleNamespace(alpha=vector[4 * n :])
    )
    vector = np.concatenate([np.zeros(4 * n), alpha])
    minimum = SimpleNamespace(vector=vector, information=np.eye(len(vector)) / told**2)
    return cast(State, SimpleNamespace(problem=problem, minimum=minimum, effects=()))


@pytest.mark.parametrize(
    ("symmetric", "told", "far"), [(True, WELL, False), (False, WELL, True), (False, HARDLY, False)]
)
def test_links_are_no_symmetric_ones_where_the_records_tell_that(symmetric: bool, told: float, far: bool) -> None:
    size = np.abs(CHAIN.parameters).reshape(-1, 10).max(axis=1).repeat(10)
    phi = CHAIN.parameters + 0.2 * np.random.default_rng(1).normal(size=size.shape) * size * (FREE == symmetric)
    assert far_from_zero(GENERAL, SYMMETRIC, fitted_with(phi, told)) == far


def test_where_no_parameter_is_zero_none_can_be_off() -> None:
    assert not far_from_zero(GENERAL, GENERAL, fitted_with(2.0 * CHAIN.parameters, WELL))
