"""Measured inertias become alpha: one linear system, solved from the tip to the base as the measurements come in.

J_ii at a posture is a row of known functions times the constants alpha (K. Choi et al., (9)-(11)). A constant found at
a distal joint is used again at the proximal ones, with its covariance, and improved by what they add: recursive least
squares in square-root information form (G. J. Bierman, Factorization Methods for Discrete Sequential Estimation, 1977,
chapter V), so that the end result is the weighted least-squares solution of all measurements together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri

from ident.errors import IdentError
from ident.records.campaign import Array

#: A direction of alpha that moves the measurements by less than this share of the best-seen one is unseen: rows of
#: exact functions leave 1e-16, plans worth measuring stay above 1e-4.
RANK_TOLERANCE = 1e-9
#: A constant, or a J_ij, with less than this part of it in unseen directions counts as determined: a fit tells these to rounding of what
#: it found last.
SEEN = 1e-4
#: Agreement is denied when chance alone would disagree more only once in a thousand times.
CONFIDENCE = 0.999


@dataclass(frozen=True)
class Alpha:
    """The constants `value` [d] with `covariance` [d, d] (units of alpha), and how well the measurements agree.

    `determined` [d]: alphas fixed by the data; `unseen` [d, k]: orthonormal directions the data say nothing about (k =
    0 when all is well; else value is the smallest of all equally good ones, and covariance leaves these directions
    out). `residual` [M] measured minus solved J; `redundancy` [M] in 0 .. 1: the share of a measurement checked by the
    others, 0 where nothing does; `left_out` [M] measured minus what the others say of it, `standardised` [M] the same
    over its own standard deviation, both 0 where nothing checks it. `agrees` when chi2 is below its 99.9 % limit.
    """

    value: Array
    covariance: Array
    determined: NDArray[np.bool_]
    unseen: Array
    residual: Array
    redundancy: Array
    left_out: Array
    standardised: Array
    chi2: float
    dof: int
    agrees: bool
    status: tuple[str, ...]

    @property
    def std(self) -> Array:
        """Standard deviations [d]; of an undetermined alpha infinite."""
        return np.where(self.determined, np.sqrt(np.diag(self.covariance)), np.inf)


@dataclass(frozen=True)
class Combined:
    """One number from several records: weighted mean `value`, `std` of it, and whether the records agree within their
    noise.

    When they do not, the number changes from record to record (a model error): `spread` is the weighted rms scatter
    about the mean and `std` is multiplied by sqrt(chi2 / dof) (R. T. Birge, Phys. Rev. 40 (1932), DOI
    10.1103/PhysRev.40.207).
    """

    value: float
    std: float
    chi2: float
    dof: int
    agrees: bool
    spread: float


def solve(
    rows: ArrayLike, J: ArrayLike, std: ArrayLike, joint_of_measurement: ArrayLike, joint_of_alpha: ArrayLike
) -> Alpha:
    """Returns alpha [d] from rows @ alpha = J, joint by joint from the tip (highest index) to the base.

    `rows` [M, d, 1], `J` [M, kg m2] with `std` [M], or with a covariance [M, M] where measurements of one joint (never
    of two) are correlated, `joint_of_measurement` [M] and `joint_of_alpha` [d] joint indices (a joint's own new alphas;
    used to name and order, never to weigh). An alpha its own joint can not determine stays open until a later joint
    closes it; those open at the end are named in `status`. Raises IdentError for shapes that do not fit, non-finite
    numbers and standard deviations or a covariance that are not positive.
    """
    C, b, L, of_row, of_alpha = _checked(rows, J, std, joint_of_measurement, joint_of_alpha)
    M, d = C.shape
    A, y = np.linalg.solve(L, C), np.linalg.solve(L, b)
    root = np.zeros((0, d + 1))  # [R z]: R alpha = z carries all information so far
    for joint in sorted(set(of_row.tolist()), reverse=True):
        chosen = of_row == joint
        root = np.linalg.qr(np.vstack([root, np.column_stack([A[chosen], y[chosen]])])).R
    estimate = _Estimate.of(root)
    known, misfit = estimate.determined, estimate.misfit
    residual = b - C @ estimate.value
    # Q = V^-1 - V^-1 C P C' V^-1: what the measurements say of each other once alpha is taken out
    inverse = np.linalg.inv(L)
    seen = inverse.T @ A
    Q = inverse.T @ inverse - seen @ estimate.covariance @ seen.T
    redundancy = np.clip(np.diag(Q) * np.diag(L @ L.T), 0.0, 1.0)
    checked = redundancy > np.sqrt(np.finfo(float).eps)
    redundancy = np.where(checked, redundancy, 0.0)
    left_out = np.divide(Q @ residual, np.diag(Q), out=np.zeros(M), where=checked)
    standardised = np.where(checked, left_out * np.sqrt(np.maximum(np.diag(Q), 0.0)), 0.0)
    dof = M - estimate.rank
    agrees = dof == 0 or misfit <= noise_allows(dof)
    return Alpha(
        estimate.value, estimate.covariance, known, estimate.unseen, residual, redundancy, left_out, standardised,
        misfit, dof, agrees, _status(known, of_alpha, misfit, dof, agrees),
    )  # fmt: skip


def inertia_std(J_rows: ArrayLike, covariance: ArrayLike, unseen: ArrayLike | None = None) -> Array:
    """Returns the standard deviation [..] of J_rows @ alpha for `J_rows` [.., d] and `covariance` [d, d].

    With `unseen` [d, k] of an `Alpha`, infinite where a row needs a direction that was not measured.
    """
    C, V = np.asarray(J_rows, dtype=float), np.asarray(covariance, dtype=float)
    std = np.sqrt(np.maximum(np.einsum("...d,de,...e->...", C, V, C), 0.0))
    if unseen is not None and np.size(unseen):
        blind = np.linalg.norm(C @ np.asarray(unseen, dtype=float), axis=-1)
        std = np.where(blind > SEEN * np.linalg.norm(C, axis=-1), np.inf, std)
    return np.asarray(std)


def noise_allows(dof: int) -> float:
    """Returns the chi^2 of `dof` degrees of freedom that noise alone stays below with probability `CONFIDENCE`."""
    return float(chdtri(dof, 1.0 - CONFIDENCE))


def combine(values: ArrayLike, std: ArrayLike) -> Combined:
    """Returns the weighted mean of `values` [R] with standard deviations `std` [R] and whether they agree.

    For K, J_m and D of one joint read from several records: the paper's K changes from 5500 to 4000 N m/rad between
    postures of one joint, a model error and not a mean. Raises IdentError for no values, different lengths, std that is
    not positive.
    """
    x, s = np.asarray(values, dtype=float), np.asarray(std, dtype=float)
    if x.ndim != 1 or x.shape != s.shape or not x.size:
        raise IdentError(f"values and std must be lists of one length, found shapes {x.shape} and {s.shape}")
    if not (np.isfinite(x).all() and np.isfinite(s).all() and (s > 0).all()):
        raise IdentError("values and std must be finite and std positive")
    weight = 1.0 / s**2
    mean = float(weight @ x / weight.sum())
    misfit, dof = float(np.sum(((x - mean) / s) ** 2)), len(x) - 1
    agrees = dof == 0 or misfit <= noise_allows(dof)
    inflation = 1.0 if agrees else np.sqrt(misfit / dof)
    spread = float(np.sqrt(weight @ (x - mean) ** 2 / weight.sum()))
    return Combined(mean, float(inflation / np.sqrt(weight.sum())), misfit, dof, bool(agrees), spread)


@dataclass(frozen=True)
class _Estimate:
    """The least-squares solution of [R z]: minimum norm in columns scaled to one, with what stays unseen."""

    value: Array
    covariance: Array
    unseen: Array
    determined: NDArray[np.bool_]
    misfit: float
    rank: int

    @staticmethod
    def of(root: Array) -> _Estimate:
        R, z = root[:, :-1], root[:, -1]
        size = np.linalg.norm(R, axis=0)
        noise = size <= 1e-12 * size.max(initial=0.0)
        size[noise] = size.max(initial=0.0) or 1.0  # scaling would lift rounding errors to one
        U, s, Vt = np.linalg.svd(R / size, full_matrices=True)
        rank = int(np.sum(s > RANK_TOLERANCE * s[0])) if s.size else 0
        V = Vt[:rank].T
        coordinates = U[:, :rank].T @ z
        half = V / s[:rank] / size[:, None]
        null = np.linalg.qr(Vt[rank:].T / size[:, None])[0]
        determined = np.linalg.norm(Vt[rank:], axis=0) < np.sqrt(RANK_TOLERANCE)
        misfit = float(np.sum((z - U[:, :rank] @ coordinates) ** 2))
        return _Estimate(half @ coordinates, half @ half.T, null, determined, misfit, rank)


def _checked(
    rows: ArrayLike, J: ArrayLike, std: ArrayLike, joint_of_measurement: ArrayLike, joint_of_alpha: ArrayLike
) -> tuple[Array, Array, Array, NDArray[np.int64], NDArray[np.int64]]:
    """Returns rows, J, L (L L' the covariance of J), joints; raises IdentError naming the first that does not fit."""
    C, b, sigma = (np.asarray(a, dtype=float) for a in (rows, J, std))
    square = sigma.ndim == 2
    of_row, of_alpha = np.asarray(joint_of_measurement, dtype=np.int64), np.asarray(joint_of_alpha, dtype=np.int64)
    if C.ndim != 2 or 0 in C.shape:
        raise IdentError(f"rows must be [measurements, alphas], found shape {C.shape}")
    M, d = C.shape
    for name, array, length in (
        ("J", b, M), ("std", sigma[:, 0] if square else sigma, M), ("joint_of_measurement", of_row, M),
        ("joint_of_alpha", of_alpha, d),
    ):  # fmt: skip
        if array.shape != (length,):
            raise IdentError(f"{name} has shape {array.shape}, expected ({length},) to fit rows of shape {C.shape}")
    for name, array in (("rows", C), ("J", b), ("std", sigma)):
        if not np.isfinite(array).all():
            raise IdentError(f"{name}: measurement {np.argwhere(~np.isfinite(array))[0][0]} is not finite")
    spread = np.diag(sigma) if square else sigma
    if not (spread > 0).all():
        raise IdentError(f"std: measurement {np.argmin(spread)} has {spread.min():g}, expected more than 0")
    if square and (
        sigma.shape != (M, M) or not np.allclose(sigma, sigma.T, rtol=1e-9, atol=1e-12 * np.abs(sigma).max())
    ):
        raise IdentError(f"std: a covariance must be symmetric [{M}, {M}], found shape {sigma.shape}")
    try:
        return C, b, np.linalg.cholesky(sigma) if square else np.diag(sigma), of_row, of_alpha
    except np.linalg.LinAlgError:
        raise IdentError("std: the covariance of J is not positive definite") from None


def _status(
    known: NDArray[np.bool_], of_alpha: NDArray[np.int64], misfit: float, dof: int, agrees: bool
) -> tuple[str, ...]:
    lines = []
    if not known.all():
        names = ", ".join(f"alpha[{k}] of joint {of_alpha[k] + 1}" for k in np.flatnonzero(~known))
        lines.append(f"not determined by these measurements: {names}")
    if not agrees:
        lines.append(
            f"the measurements disagree: chi2 {misfit:.3g} over {dof} degrees of freedom,"
            f" noise allows {noise_allows(dof):.3g}"
        )
    return tuple(lines)
