"""Can links exist that have these alphas? The nearest ones that can, and the paper's arm in closed form.

A rigid body exists if and only if its pseudo-inertia [[tr(L)/2 - L, m r], [(m r)^T, m]] is positive semidefinite
(P. Wensing, S. Kim, J.-J. Slotine, IEEE RA-L 3 (2018), DOI 10.1109/LRA.2017.2729659); that includes the triangle
inequality of the moments of inertia.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csc_matrix

from ident.errors import IdentError
from ident.records.campaign import Array

#: Distances up to this share of alpha's own length are the solver's accuracy.
DISTANCE_TOLERANCE = 1e-6
#: Weight of the links' own distance from the prior against the distance, both relative: chooses among equal solutions
#: and lengthens the distance by no more than about this share of alpha's own length.
PRIOR_WEIGHT = 1e-6
#: Links further from the prior than this many times the scale of the arm are not considered: keeps the program bounded.
PRIOR_BOUND = 1e4
#: Order of the paper's constants wherever all six stand in one vector.
YPP_ALPHA = ("alpha_11", "alpha_12", "alpha_13", "alpha_21", "alpha_22", "alpha_31")

#: One condition of a cone program: rows [r, x], bound [r] and the cone that holds bound - rows @ x.
Block = tuple[Array, Array, Any]


@dataclass(frozen=True)
class Consistency:
    """Whether links exist for an alpha: `ok` when `distance` is nothing but rounding.

    `nearest` [d] is the closest alpha that links can have, `distance` to it in standard deviations (root of the
    Mahalanobis square), or relative to |alpha| without a covariance; `parameters` [10 n] are links that have it.
    `status` says when the solver stopped short.
    """

    ok: bool
    distance: float
    nearest: Array
    parameters: Array
    status: tuple[str, ...]


@dataclass(frozen=True)
class Inequality:
    """One condition of physical consistency: `text` reads left <= right."""

    text: str
    left: float
    right: float
    ok: bool


def pseudo_inertia(parameters: ArrayLike) -> Array:
    """Returns the pseudo-inertia [.., 4, 4] of `parameters` [.., 10]: m [kg], mx, my, mz [kg m], Lxx, Lxy, Lyy, Lxz,
    Lyz, Lzz [kg m2].

    L is about the link-frame origin. Source: Wensing et al., cited above.
    """
    m, x, y, z, xx, xy, yy, xz, yz, zz = np.moveaxis(np.asarray(parameters, dtype=float), -1, 0)
    P = [
        [(yy + zz - xx) / 2, -xy, -xz, x],
        [-xy, (xx + zz - yy) / 2, -yz, y],
        [-xz, -yz, (xx + yy - zz) / 2, z],
        [x, y, z, m],
    ]
    return np.moveaxis(np.array(P), (0, 1), (-2, -1))


def consistency(
    alpha: ArrayLike, covariance: ArrayLike | None, W: ArrayLike, free: ArrayLike, prior: ArrayLike | None = None
) -> Consistency:
    """Returns whether possible links with W @ parameters = alpha exist, the nearest alpha that has some, and those.

    `alpha` [d], `covariance` [d, d] (None: plain distance), `W` [d, 10 n], `free` [10 n] bool: parameters that are not
    free are exactly zero. W leaves combinations of the parameters open; of these the ones closest to `prior` [10 n] are
    taken (CAD; the smallest without one). Raises IdentError for shapes that do not fit, an alpha of zero and a
    covariance that is not positive definite.
    """
    a, metric, W, free = _checked(alpha, covariance, W, free)
    length = float(np.linalg.norm(metric @ a))
    scale = _scale(a, W)
    guess = np.zeros_like(scale) if prior is None else np.asarray(prior, dtype=float)
    if guess.shape != scale.shape:
        raise IdentError(f"prior has shape {guess.shape}, expected {scale.shape} to fit W of shape {W.shape}")
    found, outcome = _nearest(metric @ (W * scale) / length, metric @ a / length, free, guess / scale)
    nearest = W @ (scale * found)
    distance = float(np.linalg.norm(metric @ (nearest - a)))
    solved = outcome == "Solved"
    status = () if solved else (f"the nearest alpha is not accurate, the semidefinite program ended as {outcome}",)
    return Consistency(solved and distance <= DISTANCE_TOLERANCE * length, distance, nearest, scale * found, status)


def ypp_inequalities(alpha: ArrayLike) -> list[Inequality]:
    """Returns the four conditions for links of the paper's symmetric yaw-pitch-pitch arm to exist.

    `alpha` [6, kg m2] in the order of `YPP_ALPHA`. Necessary and sufficient: the triangle inequalities of links 3 and
    2, the room they leave link 1, and the positive semidefinite first moment of link 3. Raises IdentError for another
    shape.
    """
    a = np.asarray(alpha, dtype=float)
    if a.shape != (len(YPP_ALPHA),):
        raise IdentError(f"alpha must be {', '.join(YPP_ALPHA)}, found shape {a.shape}")
    a11, a12, a13, a21, a22, a31 = a.tolist()
    conditions = [
        ("alpha_11 <= alpha_31", a11, a31),
        ("alpha_12 <= alpha_22 - alpha_31", a12, a22 - a31),
        ("alpha_22 - alpha_12 - alpha_11 <= 2 alpha_13", a22 - a12 - a11, 2 * a13),
        (
            "4 alpha_21^2 <= (alpha_11 + alpha_31) (alpha_12 + alpha_22 - alpha_31)",
            4 * a21**2,
            (a11 + a31) * (a12 + a22 - a31),
        ),
    ]
    return [Inequality(text, left, right, left <= right) for text, left, right in conditions]


def _checked(
    alpha: ArrayLike, covariance: ArrayLike | None, W: ArrayLike, free: ArrayLike
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Returns (alpha, inverse root of the covariance, W, free); raises IdentError for what does not fit."""
    a, W, free = np.asarray(alpha, dtype=float), np.asarray(W, dtype=float), np.asarray(free, dtype=bool)
    if W.ndim != 2 or W.shape[1] % 10 or a.shape != W.shape[:1] or free.shape != W.shape[1:]:
        raise IdentError(f"W must be [d, 10 n], found {W.shape} with alpha {a.shape} and free {free.shape}")
    if not (np.isfinite(a).all() and np.isfinite(W).all() and a.any()):
        raise IdentError("alpha and W must be finite and alpha not all zero")
    if covariance is None:
        return a, np.eye(len(a)) / np.linalg.norm(a), W, free
    V = np.asarray(covariance, dtype=float)
    try:
        if V.shape != (len(a), len(a)):
            raise IdentError(f"covariance has shape {V.shape}, expected {(len(a), len(a))}")
        return a, np.linalg.inv(np.linalg.cholesky(V)), W, free
    except np.linalg.LinAlgError:
        raise IdentError("covariance is not positive definite: leave out the alphas that were not determined") from None


def _scale(alpha: Array, W: Array) -> Array:
    """Returns units [10 n] that bring all parameters near one: alpha's size, and the longest lever in W."""
    inertia = float(np.abs(alpha).max())
    columns = np.abs(W).max(axis=0).reshape(-1, 10)
    lever = max(float(np.sqrt(columns[:, 0].max())), float(columns[:, 1:4].max())) or 1.0
    link = np.concatenate([[inertia / lever**2], np.full(3, inertia / lever), np.full(6, inertia)])
    return np.tile(link, len(columns))


def _nearest(A: Array, target: Array, free: NDArray[np.bool_], guess: Array) -> tuple[Array, str]:
    """Returns (x [10 n], outcome): minimises |A x - target| + PRIOR_WEIGHT |x - guess| over links x with pseudo-inertia
    >= 0.

    As a cone program in (x, t, u): t >= |A x - target|, PRIOR_BOUND >= u >= |x - guess|, one semidefinite block per
    link. The norm, not its square, makes the distance exactly zero when it can be zero.
    """
    at = np.flatnonzero(free)
    p, d = len(at), len(target)
    last = np.arange(p + 2) >= p  # t, u
    t, u = np.eye(p + 2)[last]
    blocks: list[Block] = [
        (u[None], np.array([PRIOR_BOUND]), clarabel.NonnegativeConeT(1)),
        (np.vstack([-t, -np.hstack([A[:, at], np.zeros((d, 2))])]), np.append(0.0, -target), clarabel.SecondOrderConeT(d + 1)),
        (np.vstack([-u, -np.eye(p, p + 2)]), np.append(0.0, -guess[at]), clarabel.SecondOrderConeT(p + 1)),
    ]  # fmt: skip
    units = pseudo_inertia(np.eye(10))
    for link in np.unique(at // 10):
        mine = at // 10 == link
        matrices = np.zeros((p + 2, 4, 4))
        matrices[np.flatnonzero(mine)] = units[at[mine] % 10]
        blocks.append(semidefinite(matrices, np.zeros((4, 4))))
    found, outcome = cone_program(np.append(np.zeros(p), [1.0, PRIOR_WEIGHT]), blocks)
    x = np.zeros(len(free))
    x[at] = found[:p]
    return x, outcome


def semidefinite(matrices: Array, constant: Array) -> Block:
    """Returns the condition that sum_k x_k matrices[k] + constant, symmetric [4, 4] each, is positive semidefinite."""
    i, j = np.tril_indices(4)  # row by row: the upper triangle column by column, as clarabel packs it
    weight = np.where(i == j, 1.0, np.sqrt(2.0))
    return -(matrices[:, i, j] * weight).T, constant[i, j] * weight, clarabel.PSDTriangleConeT(4)


def cone_program(cost: Array, blocks: Sequence[Block]) -> tuple[Array, str]:
    """Returns (x, outcome): minimises cost . x with bound - rows @ x in the cone of every block (rows, bound, cone).

    `outcome` is clarabel's word for how it ended, "Solved" when all is well.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-9
    rows, bounds, cones = zip(*blocks, strict=True)
    problem = csc_matrix(np.vstack(rows)), np.concatenate(bounds)
    size = len(cost)
    solution = clarabel.DefaultSolver(csc_matrix((size, size)), cost, *problem, list(cones), settings).solve()
    return np.array(solution.x), str(solution.status)
