"""Which joint to excite at which posture: cells (i, q), chosen jointly over the shared constants.

Error model: one measurement of J_ii(q) has a standard deviation proportional to sigma_i(q) = J_ii(q) + N_i^2 J_m,i, from
(5) with a fixed relative error of the frequencies. So a cell is the row f_i(q) = C_i(q) / sigma_i(q), and a plan of N
cells gives alpha the covariance (F' F)^-1. Choosing cells joint by joint, each with as many as it has new constants, can
be tens of times worse than choosing them together, because the error of a shared constant is carried inwards.

Amplification of joint i: rms over the workspace of the standard deviation of J_ii(q) / sigma_i(q), for unit error of one
measurement. Exactly d cells can not do better than 1 at the worst (i, q) (Kiefer-Wolfowitz, DOI 10.4153/CJM-1960-030-4).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from symgen.basis import Factoring
from symgen.chain import Array, readonly
from symgen.errors import PlanError
from symgen.regressor import C_rows

#: Part of each joint's range left free at either end.
MARGIN = 0.05

#: Angles and slides of a plan are whole multiples of this [rad, m], so that a plan is the same on every machine.
ROUNDING = 1e-4

#: Postures tried; the exchange stops when no swap raises the determinant by more than this factor.
CANDIDATES, EXCHANGE_GAIN = 1000, 1.01

_WORKSPACE = 2000


@dataclass(frozen=True)
class Design:
    """A posture plan: cell k excites joint `joint[k]` (from 0) at `q[k]`; cells run tip to base, the spare ones last.

    `amplification` [n] as in the module's docstring, `amplification_p999` its 99.9 % quantile over the workspace;
    `cond` [n] the condition number of each joint's own rows, columns whitened over the workspace; `d_efficiency` proven
    lower bound of (det / best possible det)^(1/d) for the cells without the spare ones.
    """

    joint: NDArray[np.int64]
    q: Array
    spare: NDArray[np.bool_]
    amplification: Array
    amplification_p999: Array
    cond: Array
    d_efficiency: float


def _sequence(count: int, n: int, offset: float) -> Array:
    """An additive low-discrepancy sequence in the unit cube [count, n] (golden ratio, generalised to n dimensions)."""
    phi = 2.0
    for _ in range(64):
        phi = (1 + phi) ** (1 / (n + 1))
    steps: Array = (offset + np.arange(1, count + 1)[:, None] * phi ** -np.arange(1, n + 1)) % 1.0
    return steps


def box(limits: Array) -> Array:
    """Returns the joint intervals a plan may use [n, 2]: the limits less a margin, on whole multiples of `ROUNDING`."""
    low, high = limits.T
    inset = MARGIN * (high - low)
    return np.stack([np.ceil((low + inset) / ROUNDING), np.floor((high - inset) / ROUNDING)], axis=1) * ROUNDING


def home(allowed: Array) -> Array:
    """Returns the resting posture [n]: zero where allowed, else the middle of the interval."""
    inside = (allowed[:, 0] <= 0) & (allowed[:, 1] >= 0)
    return np.where(inside, 0.0, np.round(allowed.mean(axis=1) / ROUNDING) * ROUNDING)


class Rows:
    """The scaled rows f_i(q) = C_i(q) / sigma_i(q) of a factoring, for the URDF's own constants and the drives' rotors."""

    def __init__(self, factoring: Factoring, rotor: Array):
        self.factoring, self.rotor = factoring, rotor

    def __call__(self, q: Array, of: Factoring | None = None) -> Array:
        """All joints' rows at postures q [m, n]: [m, n, d]; with `of`, another factoring's rows in the same scaling."""
        C = C_rows(self.factoring, q)
        sigma = C @ self.factoring.alpha_cad[: self.factoring.d] + self.rotor
        return (C if of is None else C_rows(of, q)) / sigma[..., None]

    def of_cells(self, joint: NDArray[np.int64], q: Array) -> Array:
        """One row a cell [N, d]."""
        return self(q)[np.arange(len(q)), joint]


def maxvol(F: Array) -> NDArray[np.int64]:
    """Returns d rows of F [N, d] with a locally largest determinant: greedy pivots, then exchanges (Fedorov's for N = d).

    Raises PlanError when F has not full rank.
    """
    d = F.shape[1]
    left = F.copy()
    chosen: list[int] = []
    for _ in range(d):
        size = np.einsum("nd,nd->n", left, left)
        row = int(np.argmax(size))
        if size[row] < 1e-20 * np.einsum("nd,nd->n", F, F).max():
            raise PlanError(
                f"postures: the candidates determine only {len(chosen)} of {d} constants; allow more postures"
            )
        direction = left[row] / np.sqrt(size[row])
        left -= np.outer(left @ direction, direction)
        chosen.append(row)
    B = F @ np.linalg.inv(F[chosen])
    while True:
        row, column = divmod(int(np.argmax(np.abs(B))), d)
        if abs(B[row, column]) < EXCHANGE_GAIN:
            return np.array(chosen)
        swap = B[row].copy()
        swap[column] -= 1
        B -= np.outer(B[:, column], swap / B[row, column])
        chosen[column] = row


def _refine(rows: Rows, joint: NDArray[np.int64], q: Array, allowed: Array, iterations: int) -> Array:
    """Moves the postures [N, n] within the box to a local maximum of log det F' F."""
    from scipy.optimize import minimize

    N, n = q.shape
    h = 1e-5
    shifts = np.concatenate([np.zeros((1, n)), h * np.eye(n), -h * np.eye(n)])

    def negative_log_det(x: Array) -> tuple[float, Array]:
        shifted = (x.reshape(N, n) + shifts[:, None, :]).reshape(-1, n)
        values = rows.of_cells(np.tile(joint, len(shifts)), shifted).reshape(len(shifts), N, -1)
        F, slope = values[0], (values[1 : n + 1] - values[n + 1 :]) / (2 * h)
        information = F.T @ F
        gradient = -2 * np.einsum("knd,nd->nk", slope, np.linalg.solve(information, F.T).T)
        return -float(np.linalg.slogdet(information)[1]), gradient.ravel()

    bounds = np.tile(allowed, (N, 1))
    found = minimize(
        negative_log_det, q.ravel(), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": iterations}
    )
    moved: Array = np.clip(found.x.reshape(N, n), *allowed.T)
    return moved


def _spare(rows: Rows, wider: Factoring, F_plan: Array, candidates: Array, count: int) -> tuple[list[int], list[int]]:
    """Cells that discriminate: where a model with every inertial parameter free (`wider`) is least tied down so far.

    A plan of d cells fits its d constants without residual whatever is missing; the cells chosen here are those whose
    prediction by the wider model varies most, given the planned ones and a weak prior.
    """
    G = rows(candidates, of=wider)
    M = F_plan.T @ F_plan + 1e-2 * np.einsum("mid,mie->de", G, G) / len(candidates)
    joints, postures = [], []
    for _ in range(count):
        leverage = np.einsum("mid,de,mie->mi", G, np.linalg.inv(M), G)
        posture, joint = divmod(int(np.argmax(leverage)), G.shape[1])
        M += np.outer(G[posture, joint], G[posture, joint])
        joints.append(joint)
        postures.append(posture)
    return joints, postures


def _ordered(joint: NDArray[np.int64], q: Array, start: Array) -> NDArray[np.int64]:
    """The order to visit cells in: tip to base, within a joint always the nearest posture next."""
    order: list[int] = []
    here = start
    for i in sorted(set(joint.tolist()), reverse=True):
        left = np.flatnonzero(joint == i).tolist()
        while left:
            nearest = min(left, key=lambda k: (float(np.abs(q[k] - here).max()), k))
            left.remove(nearest)
            order.append(nearest)
            here = q[nearest]
    return np.array(order, dtype=np.int64)


def _settled(q: Array, joint: NDArray[np.int64], rest: Array) -> Array:
    """Postures with the joints that J_ii does not depend on (1..i) at rest, rounded."""
    free = np.arange(q.shape[1]) > joint[:, None]
    return np.where(free, np.round(q / ROUNDING) * ROUNDING, rest)


def plan(
    factoring: Factoring,
    wider: Factoring,
    *,
    rotor: Array | None = None,
    spare: int | None = None,
    iterations: int = 60,
) -> Design:
    """Returns d cells (i, q) and `spare` more (default a quarter of d), with what they achieve.

    `wider` is the factoring of the same chain without believed zeros (or `factoring` itself), `rotor` [n, kg m2, joint
    side] the reflected motor inertias N^2 J_m where known, `iterations` those of the refinement off the candidates.
    """
    n, d = factoring.chain.n, factoring.d
    rows = Rows(factoring, np.zeros(n) if rotor is None else rotor)
    allowed = box(factoring.chain.limits)
    rest = home(allowed)
    low, high = allowed.T
    candidates = low + (high - low) * _sequence(CANDIDATES, n, 0.5)
    chosen = maxvol(rows(candidates).reshape(-1, d))
    joint, q = chosen % n, candidates[chosen // n]
    if iterations:
        q = _refine(rows, joint, q, allowed, iterations)
    q = _settled(q, joint, rest)
    order = _ordered(joint, q, rest)
    joint, q = joint[order], q[order]

    count = int(np.ceil(d / 4)) if spare is None else spare
    planned_wide = rows(q, of=wider)[np.arange(d), joint]
    spare_joint, spare_posture = _spare(rows, wider, planned_wide, candidates, count)
    more_joint = np.array(spare_joint, dtype=np.int64)
    more_q = _settled(candidates[spare_posture], more_joint, rest)
    order = _ordered(more_joint, more_q, rest)
    return judged(
        rows,
        np.concatenate([joint, more_joint[order]]),
        np.concatenate([q, more_q[order]]),
        np.arange(d + count) >= d,
        allowed,
    )


def judged(rows: Rows, joint: NDArray[np.int64], q: Array, spare: NDArray[np.bool_], allowed: Array) -> Design:
    """Returns the design with its amplification, conditioning and certificate, whoever chose the cells."""
    n = q.shape[1]
    low, high = allowed.T
    everywhere = rows(low + (high - low) * _sequence(_WORKSPACE, n, 0.123))
    F = rows.of_cells(joint[~spare], q[~spare])
    covariance = np.linalg.inv(F.T @ F)
    variance = np.einsum("mid,de,mie->mi", everywhere, covariance, everywhere)
    whiten = np.linalg.inv(np.linalg.cholesky(np.einsum("mid,mie->de", everywhere, everywhere) / _WORKSPACE)).T
    cond = [
        float(np.linalg.cond((F @ whiten)[joint[~spare] == i])) if (joint[~spare] == i).any() else 0.0 for i in range(n)
    ]
    return Design(
        joint=joint,
        q=readonly(q),
        spare=spare,
        amplification=readonly(np.sqrt(variance.mean(axis=0))),
        amplification_p999=readonly(np.sqrt(np.quantile(variance, 0.999, axis=0))),
        cond=readonly(cond),
        d_efficiency=certificate(rows, F, allowed),
    )


def certificate(rows: Rows, F: Array, allowed: Array, rounds: int = 6) -> float:
    """Returns a lower bound of the D-efficiency of the rows F [N, d] among all designs on the workspace.

    For any weights w with information M(w) and largest variance function v = max f' M(w)^-1 f over all cells,
    log det M* <= log det M(w) + d log(v / d): the equivalence theorem with the mean inequality. Weights by multiplicative
    steps, support pruned as in Harman and Pronzato (DOI 10.1016/j.spl.2006.05.008), maxima of v by ascent from the best
    of many postures and added to the support. v is a maximum found by multistart, not by interval arithmetic.
    """
    N, d = F.shape
    n = len(allowed)
    low, high = allowed.T
    support = np.concatenate([F, rows(low + (high - low) * _sequence(CANDIDATES, n, 0.5)).reshape(-1, d)])
    weight = np.full(len(support), 0.5 / (len(support) - N))
    weight[:N] = 0.5 / N
    bound = np.inf
    for k in range(rounds):
        support, weight = _optimal_weights(support, weight / weight.sum(), d)
        information = (support * weight[:, None]).T @ support
        half = np.linalg.cholesky(np.linalg.inv(information))

        def variance(q: Array, half: Array = half) -> Array:
            return np.einsum("mid->mi", (rows(q) @ half) ** 2)

        starts = low + (high - low) * _sequence(_WORKSPACE, n, 0.123 + 0.317 * k)
        peaks, values = _peaks(variance, starts, allowed)
        bound = min(bound, float(np.linalg.slogdet(information)[1]) + d * np.log(max(float(values.max()), d) / d))
        new = rows(peaks).reshape(-1, d)
        support = np.concatenate([support, new])
        weight = np.concatenate([0.95 * weight, np.full(len(new), 0.05 / len(new))])
    return float(np.exp(min((np.linalg.slogdet(F.T @ F / N)[1] - bound) / d, 0.0)))


def _optimal_weights(support: Array, weight: Array, d: int, steps: int = 60) -> tuple[Array, Array]:
    """Multiplicative steps towards the D-optimal weights; points that can not carry weight at the optimum are dropped."""
    for _ in range(steps):
        information = (support * weight[:, None]).T @ support
        variance = np.einsum("nd,nd->n", support @ np.linalg.inv(information), support)
        excess = max(float(variance.max()) - d, 0.0)
        kept = variance >= d * (1 + excess / (2 * d) - np.sqrt(excess * (4 + excess - 4 / d)) / (2 * np.sqrt(d)) - 0.0)
        weight = weight * variance / d
        if excess < d and kept.sum() >= d:
            support, weight = support[kept], weight[kept]
        weight = weight / weight.sum()
    return support, weight


def _peaks(value: Callable[[Array], Array], starts: Array, allowed: Array, top: int = 10) -> tuple[Array, Array]:
    """Local maxima of each column of `value` by ascent from its best starts: postures [n * top, n] and values [n * top]."""
    n = len(allowed)
    first = value(starts)
    columns = np.repeat(np.arange(first.shape[1]), top)
    x = starts[np.argsort(-first, axis=0)[:top].T.ravel()]
    best = value(x)[np.arange(len(x)), columns]
    step, h = np.full(len(x), 0.05), 1e-4
    for _ in range(20):
        shifted = (x + np.concatenate([h * np.eye(n), -h * np.eye(n)])[:, None, :]).reshape(-1, n)
        v = value(shifted)[np.arange(len(shifted)), np.tile(columns, 2 * n)].reshape(2, n, -1)
        slope = (v[0] - v[1]).T
        slope /= np.linalg.norm(slope, axis=1, keepdims=True) + 1e-300
        y = np.clip(x + step[:, None] * slope, *allowed.T)
        new = value(y)[np.arange(len(y)), columns]
        better = new > best
        x, best = np.where(better[:, None], y, x), np.where(better, new, best)
        step = np.where(better, 1.5 * step, 0.4 * step)
    return x, best
