"""Rigid links that have the identified constants: of all those that do, the ones nearest to CAD.

The constants alpha of J(q) fix some 7 n of the links' 10 n inertial parameters; the rest no motion of the arm shows. It is
taken from CAD: of all links that are possible bodies and give alpha exactly, those of least entropic divergence from
CAD, sum over the links of tr(X) - log det(X) - 4 with X the link's pseudo-inertia in units of CAD's (T. Lee, P. Wensing,
F. Park, IEEE T-RO 36 (2020), DOI 10.1109/TRO.2019.2926494). Convex, without units, and infinite at the edge of what bodies
can be. Where no possible links have alpha, first the nearest alpha that some have, in the estimate's own covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
from scipy.linalg import block_diag, null_space

from ident.errors import IdentError
from ident.identification.physical import Block, cone_program, pseudo_inertia, semidefinite
from ident.records.campaign import Array
from symgen.plan import Model

#: A link's pseudo-inertia, in units of CAD's, stays above this: bodies thinner than a thousandth of CAD's are none.
THINNEST = 1e-6
#: Links this thick are a good start for the search, thicker ones no better.
ENOUGH = 0.1
#: Links whose pseudo-inertias, in units of CAD's, are together larger than this are not considered.
LARGEST = 100.0
#: CAD's second moments about the centre of mass count as at least this part of the link's largest, and as those of this
#: radius [m]: vendors' files hold rods, points, and moments of no body, which have no finite divergence.
THIN_CAD, POINT_RADIUS = 1e-4, 1e-3
#: Constants this many times larger or smaller than CAD's are in other units (a torque sensor's volts): CAD is scaled to them.
OTHER_UNITS = 10.0
#: Parameters that are zero in CAD and this small a part of their link are rounding.
ROUNDING = 1e-12
#: Standard deviations below this part of the largest are rounding of a covariance.
LEAST_DEVIATION = 1e-6
#: A distance below this, or below this part of the estimate's own length in standard deviations, is the solver's accuracy.
NO_DISTANCE, NO_SHARE = 1e-3, 1e-8
#: Squared Newton decrements: below the first a full step is safe, below the second it is the last (it squares the error).
NEAR, CLOSE = 0.04, 1e-16
STEPS = 500

#: Orthonormal basis [10, 4, 4] of the symmetric matrices.
_UNITS = np.zeros((10, 4, 4))
for _k, (_i, _j) in enumerate(zip(*np.tril_indices(4), strict=True)):
    _UNITS[_k, _i, _j] = _UNITS[_k, _j, _i] = 1.0 if _i == _j else np.sqrt(0.5)


@dataclass(frozen=True)
class Links:
    """Possible links: `parameters` [n, 10] in the order of `symgen.chain.PARAMETERS`, kg, kg m, kg m2 in link axes.

    `alpha` [D] are their constants; `exact` when these are the estimate, else they are `distance` standard deviations
    from it in the directions that were seen (root of the Mahalanobis square; relative to |alpha| without a covariance),
    and `ok` when that is nothing but rounding: only what was not seen had to give way.
    `divergence` [n] of each link from CAD, zero when equal. `status` says when a search stopped short.
    """

    parameters: Array
    alpha: Array
    exact: bool
    ok: bool
    distance: float
    divergence: Array
    status: tuple[str, ...]


def nearest_links(model: Model, alpha: Array, covariance: Array | None = None, unseen: Array | None = None) -> Links:
    """Returns the possible links nearest to CAD with W . parameters = alpha [D], or with the nearest alpha there is.

    `covariance` [D, D] of alpha (None: plain distance); along `unseen` [D, k], orthonormal directions that nothing
    measured, alpha gives way first. Zeros that the model believes bind alpha, not the links. Raises IdentError for shapes that do
    not fit and numbers that are not finite.
    """
    D, n = len(model.names), model.chain.n
    unseen = np.zeros((D, 0)) if unseen is None else unseen
    shapes = (np.shape(alpha), np.shape(covariance) if covariance is not None else (D, D), np.shape(unseen)[:1])
    if shapes != ((D,), (D, D), (D,)):
        raise IdentError(f"alpha, covariance, unseen have shapes {shapes}; expected {((D,), (D, D), (D,))}")
    if not (np.isfinite(alpha).all() and np.any(alpha) and (covariance is None or np.isfinite(covariance).all())):
        raise IdentError("alpha and its covariance must be finite and alpha not all zero")
    seen = null_space(unseen.T) if unseen.size else np.eye(D)
    arm = _arm(model, _unit(seen.T @ alpha, seen.T @ model.alpha_cad))
    metric = _whitening(alpha, covariance, seen)
    status = list[str]()
    free = null_space(np.vstack([arm.alpha, arm.nothing]))
    start = _inside(arm, free, arm.with_alpha(np.eye(D), alpha))
    exact = start is not None
    if start is None and unseen.size:
        free = null_space(np.vstack([seen.T @ arm.alpha, arm.nothing]))
        start = _inside(arm, free, arm.with_alpha(seen, alpha))
    if start is None:
        start, outcome = _projected(arm, metric, alpha)
        better = _inside(arm, free, start)
        start = start if better is None else better
        if outcome != "Solved":
            status.append(f"the nearest alpha is not accurate, the cone program ended as {outcome}")
    x, solved = _nearest_to_cad(start, free)
    if not solved:
        status.append("the links nearest to CAD are not accurate, the search did not converge")
    found = (arm.parameters @ x).reshape(n, 10)
    size = np.linalg.norm(arm.parameters, axis=1).reshape(n, 10)
    found[(model.chain.parameters.reshape(n, 10) == 0.0) & (np.abs(found) < ROUNDING * size)] = 0.0
    X = _matrices(x)
    divergence = np.trace(X, axis1=1, axis2=2) - np.linalg.slogdet(X)[1] - 4.0
    reached = np.array(alpha) if exact else arm.alpha @ x
    distance = 0.0 if exact else float(np.linalg.norm(metric @ (reached - alpha)))
    ok = not status and distance <= max(NO_DISTANCE, NO_SHARE * float(np.linalg.norm(metric @ alpha)))
    return Links(found, reached, exact, ok, distance, np.maximum(divergence, 0.0), tuple(status))


@dataclass(frozen=True)
class _Arm:
    """Links as x [10 n], the coordinates of their pseudo-inertias in units of CAD's: parameters [10 n] = `parameters` @ x,
    alpha [D] = `alpha` @ x, and `nothing` @ x = 0 [z] where zeros are believed that x need not have."""

    parameters: Array
    alpha: Array
    nothing: Array

    @property
    def cad(self) -> Array:
        """CAD's own x."""
        return np.tile(np.trace(_UNITS, axis1=1, axis2=2), len(self.parameters) // 10)

    def with_alpha(self, seen: Array, alpha: Array) -> Array:
        """The x next to CAD's that has this alpha along `seen` [D, s]; no possible links perhaps."""
        fixed = np.vstack([seen.T @ self.alpha, self.nothing])
        rows = np.maximum(np.linalg.norm(fixed, axis=1), np.finfo(float).tiny)
        target = np.append(seen.T @ alpha, np.zeros(len(self.nothing)))
        short: Array = np.linalg.pinv(fixed / rows[:, None]) @ ((target - fixed @ self.cad) / rows)
        return self.cad + short


def _unit(alpha: Array, cad: Array) -> float:
    """How many times CAD's constants the estimate is, where that is so much that it must have another unit; else 1."""
    found, expected = float(np.linalg.norm(alpha)), float(np.linalg.norm(cad))
    usual = not (found and expected) or 1.0 / OTHER_UNITS < found / expected < OTHER_UNITS
    return 1.0 if usual else found / expected


def _arm(model: Model, unit: float) -> _Arm:
    n, factoring = model.chain.n, model.factoring
    roots = np.sqrt(unit) * np.linalg.cholesky(_sound(pseudo_inertia(model.chain.parameters.reshape(n, 10))))
    T = block_diag(*[_parameters(root @ _UNITS @ root.T).T for root in roots])
    size = np.linalg.norm(T, axis=1)
    wide = model.wider.W @ T
    rows = np.linalg.norm(wide, axis=1)
    wide = wide / rows[:, None]
    if factoring is model.wider:
        return _Arm(T, wide * rows[:, None], np.zeros((0, 10 * n)))
    # alpha of the believed model -> links with these zeros -> constants of general links: a map of full column rank
    believed = np.where(factoring.free, size, 0.0)
    units = np.linalg.norm(factoring.W * believed, axis=1)
    lifted = believed[:, None] * np.linalg.pinv(factoring.W * believed / units[:, None])
    to_wide = model.wider.W @ lifted / rows[:, None]
    return _Arm(T, units[:, None] * (np.linalg.pinv(to_wide) @ wide), null_space(to_wide.T).T @ wide)


def _sound(P: Array) -> Array:
    """CAD's pseudo-inertias [n, 4, 4] with moments of possible, not too thin bodies."""
    P = P.copy()
    for body in P:
        mass, com = body[3, 3], body[:3, 3] / body[3, 3]
        moments, axes = np.linalg.eigh(body[:3, :3] - mass * np.outer(com, com))
        floor = max(THIN_CAD * moments[-1], mass * POINT_RADIUS**2)
        if moments[0] < floor:
            body[:3, :3] += axes @ np.diag(np.maximum(floor - moments, 0.0)) @ axes.T
    return P


def _parameters(P: Array) -> Array:
    """The ten parameters [.., 10] of pseudo-inertias [.., 4, 4]: the inverse of `pseudo_inertia`."""
    xx, yy, zz = (P[..., k, k] for k in range(3))
    return np.stack(
        [P[..., 3, 3], P[..., 0, 3], P[..., 1, 3], P[..., 2, 3], yy + zz, -P[..., 0, 1], xx + zz, -P[..., 0, 2],
         -P[..., 1, 2], xx + yy], axis=-1,
    )  # fmt: skip


def _matrices(x: Array) -> Array:
    """The pseudo-inertias [n, 4, 4] of x [10 n], in units of CAD's."""
    return np.einsum("na,aij->nij", x.reshape(-1, 10), _UNITS)


def _whitening(alpha: Array, covariance: Array | None, seen: Array) -> Array:
    """The matrix that turns an error of alpha into standard deviations along the `seen` directions [D, s]."""
    if covariance is None:
        return seen.T / np.linalg.norm(alpha)
    if not seen.size:
        return np.zeros((0, len(alpha)))
    V = seen.T @ covariance @ seen
    std = np.sqrt(np.maximum(np.diag(V), (LEAST_DEVIATION * ROUNDING * np.abs(alpha).max()) ** 2))
    values, vectors = np.linalg.eigh(V / np.outer(std, std))
    values = np.maximum(values, LEAST_DEVIATION**2 * values[-1])
    return (vectors / np.sqrt(values)).T @ (seen / std).T


def _inside(arm: _Arm, free: Array, x: Array) -> Array | None:
    """Possible links among x + free @ z, none too thin: the ones next to CAD if these are, else the thickest; or None."""
    x = x + free @ (free.T @ (arm.cad - x))
    if _thickness(x) >= THINNEST:
        return x
    count = free.shape[1]
    blocks = [_small(free, x - arm.cad), (np.eye(count + 1)[-1:], np.array([ENOUGH]), clarabel.NonnegativeConeT(1))]
    found, _ = cone_program(np.append(np.zeros(count), -1.0), blocks + _thick(free, x, np.eye(4)))
    x = x + free @ np.nan_to_num(found[:count])
    return x if _thickness(x) >= THINNEST else None


def _thickness(x: Array) -> float:
    """The least eigenvalue of the links' pseudo-inertias, in units of CAD's."""
    return float(np.linalg.eigvalsh(_matrices(x)).min())


def _projected(arm: _Arm, metric: Array, alpha: Array) -> tuple[Array, str]:
    """Possible links x whose alpha is nearest to the estimate, and how the search ended."""
    free = null_space(arm.nothing) if arm.nothing.size else np.eye(len(arm.parameters))
    count, length = free.shape[1], float(np.linalg.norm(metric @ alpha)) or 1.0
    origin = free @ (free.T @ arm.cad)
    misfit = np.hstack([metric @ arm.alpha @ free, np.zeros((len(metric), 1))])
    target = metric @ (alpha - arm.alpha @ origin)
    t = np.eye(count + 1)[-1:]
    blocks = [
        _small(free, origin - arm.cad),
        (np.vstack([-t, -misfit / length]), np.append(0.0, -target / length), clarabel.SecondOrderConeT(len(metric) + 1)),
        *_thick(free, origin - THINNEST * arm.cad, np.zeros((4, 4))),
    ]  # fmt: skip
    found, outcome = cone_program(t[0], blocks)
    step = free @ found[:count] if np.isfinite(found).all() else np.zeros_like(origin)
    while _thickness(origin + step) <= 0.0 and np.any(step):
        step = step / 2.0 if np.linalg.norm(step) > THINNEST else np.zeros_like(step)  # no solution: back towards CAD
    return origin + step, outcome


def _small(free: Array, offset: Array) -> Block:
    """|offset + free @ z| <= LARGEST, in the variables (z, t)."""
    rows = np.vstack([np.zeros(free.shape[1]), -free])
    cone = clarabel.SecondOrderConeT(len(rows))
    return np.hstack([rows, np.zeros((len(rows), 1))]), np.append(LARGEST, offset), cone


def _thick(free: Array, offset: Array, least: Array) -> list[Block]:
    """One condition a link: the matrices of offset + free @ z are at least t `least` [4, 4], in the variables (z, t)."""
    matrices = np.array([_matrices(column) for column in free.T])  # z, n, 4, 4
    constant = _matrices(offset)
    return [semidefinite(np.concatenate([matrices[:, k], -least[None]]), constant[k]) for k in range(constant.shape[0])]


def _nearest_to_cad(x: Array, free: Array) -> tuple[Array, bool]:
    """The links of least divergence among x + free @ z, and whether the search converged.

    Damped Newton; for a self-concordant function its steps never leave the possible links and always end.
    """
    for _ in range(STEPS):
        inverse = np.linalg.inv(_matrices(x))
        slope = free.T @ np.einsum("aij,nij->na", _UNITS, np.eye(4) - inverse).ravel()
        scaled = np.einsum("nij,ajk->naik", inverse, _UNITS)
        curvature = np.einsum("naij,nbji->nab", scaled, scaled)
        bent = np.einsum("nab,nbz->naz", curvature, free.reshape(len(inverse), 10, -1)).reshape(free.shape)
        hessian = free.T @ bent
        size = np.sqrt(np.diag(hessian))
        step = -np.linalg.lstsq(hessian / np.outer(size, size), slope / size)[0] / size
        decrement = float(-slope @ step)
        trial = x + free @ step / (1.0 if decrement < NEAR else 1.0 + np.sqrt(decrement))
        if _thickness(trial) <= 0.0:  # by rounding only, where a link is all but impossible
            return x, False
        x = trial
        if decrement < CLOSE:
            return x, True
    return x, False
