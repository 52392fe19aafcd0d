"""Whether links are not as symmetric as the URDF draws them: the constants alpha of general links tell.

A spring or a weight that is missing at a link bends the constants of gravity as well as links that are not symmetric do, or
better. Links do both: what makes a first moment not zero makes constants of J(q) not zero, too.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import null_space
from scipy.special import chdtri

from ident.arm.coupled import uncertainty
from ident.search.bodies import CHANCE
from ident.search.deviations import ALONE, BESIDE, LEAST_CONSTANT
from ident.search.refits import State
from symgen.plan import Model


def far_from_zero(general: Model, symmetric: Model, state: State) -> bool:
    """Whether a `state` of general links has constants alpha that no `symmetric` ones have; chance would do so less than `CHANCE`."""
    rows = general.factoring.W
    rows = rows / np.maximum(np.abs(rows).max(axis=0), np.finfo(float).tiny)  # a body's numbers have units of their own
    none = null_space(rows[:, symmetric.factoring.free].T)
    if not none.size:
        return False
    covariance, *_ = uncertainty(state.problem, state.minimum)
    granted = (BESIDE if state.effects else ALONE).constants
    was = np.abs(general.alpha_cad)
    C = covariance + np.diag((granted * np.maximum(was, was.max() * LEAST_CONSTANT)) ** 2)
    off = none.T @ state.problem.parameters(state.minimum.vector).alpha
    return float(off @ np.linalg.solve(none.T @ C @ none, off)) > float(chdtri(len(off), CHANCE))
