"""How good a plan can be at all: the D-optimal spread of measurements over all cells, and the bound it proves.

A plan of N cells gives alpha the information F' F. Per measurement no plan can have a larger determinant than the best
weighting w of all cells, M(w) = sum w f f', and no weighting a larger log det than, for any w,

    log det M(w) + d log(v / d),    v = the largest variance f' M(w)^-1 f of all cells,

by the equivalence theorem (Kiefer and Wolfowitz, DOI 10.4153/CJM-1960-030-4) with the mean inequality. At the optimum
v = d, so the bound can be driven to the truth. v is found by ascent from the best of many postures, not by interval
arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from symgen.cells import Cells, Rows, ranked, spread, steady
from symgen.chain import Array

#: The bound is close enough when no cell's variance exceeds d by more than this factor (a loss of 0.5 % of efficiency).
CLOSE = 1.005

#: Postures looked at for the largest variance, in each round at other places, and how many of each joint are climbed.
_LOOKED_AT, _CLIMBED = 1000, 10

#: Steps of the weights, the postures and the climb in one round.
_WEIGHT_STEPS, _MOVES, _CLIMB_STEPS = 50, 40, 30

#: A cell is new when its variance exceeds d by more than this factor; those in use have just d.
_ABOVE = 1.001

#: Cells below this weight, relative to 1 / d, are dropped; weight given to the new ones; angle [rad, m] that tells two apart.
_DROPPED, _NEW, _APART = 5e-4, 0.03, 0.02


#: What a minimiser is told of a step to where the determinant is zero: larger than any log det, so it comes back.
FAR = 1e6


@dataclass(frozen=True)
class Optimum:
    """Nearly D-optimal weights [M] of `cells`; `log_det_bound`: what no information per measurement can exceed."""

    cells: Cells
    weight: Array
    log_det_bound: float


def d_efficiency(F: Array, log_det_bound: float) -> float:
    """Returns a lower bound of (det / best possible det)^(1/d) per measurement of the rows F [N, d]."""
    N, d = F.shape
    return float(np.exp(min((np.linalg.slogdet(F.T @ F / N)[1] - log_det_bound) / d, 0.0)))


def optimum(rows: Rows, allowed: Array, start: Cells, rounds: int) -> Optimum:
    """Returns the spread of measurements reached from `start` (cells of full rank) within `rounds`.

    Each round moves weights and postures of the cells in use uphill, then adds the cells of largest variance in the box
    `allowed` [n, 2].
    """
    cells = start
    d = rows.factoring.d
    weight = _weights(rows.of_cells(cells), np.full(len(cells), 1 / len(cells)))
    bound = np.inf
    for k in range(rounds):
        kept = weight > _DROPPED / d
        cells, weight = _moved(rows, cells[kept], weight[kept] / weight[kept].sum(), allowed)
        F = rows.of_cells(cells)
        weight = _weights(F, weight)
        information = (F * weight[:, None]).T @ F
        half = np.linalg.inv(np.linalg.cholesky(information)).T
        peaks, variance = _peaks(rows, half, allowed, 0.123 + 0.317 * k)
        largest = max(float(variance.max()), d)
        bound = min(bound, float(np.linalg.slogdet(information)[1]) + d * np.log(largest / d))
        if largest < CLOSE * d or k == rounds - 1:
            break
        new = peaks[_distinct(peaks, variance, d)]
        cells = cells + new
        weight = np.concatenate([(1 - _NEW) * weight, np.full(len(new), _NEW / max(len(new), 1))])
    return Optimum(cells, weight, bound)


def _weights(F: Array, weight: Array) -> Array:
    """Weights [M] after multiplicative steps uphill (Silvey, Titterington and Torsney, Comm. Statist. A 7, 1379, 1978)."""
    for _ in range(_WEIGHT_STEPS):
        half = np.linalg.inv(np.linalg.cholesky((F * weight[:, None]).T @ F)).T
        weight = weight * ((F @ half) ** 2).sum(axis=1) / F.shape[1]
        weight = weight / weight.sum()
    return weight


def _moved(rows: Rows, cells: Cells, weight: Array, allowed: Array) -> tuple[Cells, Array]:
    """Cells and weights after `_MOVES` quasi-Newton steps up log det M, over postures and the roots of the weights."""
    from scipy.optimize import minimize

    M, n = cells.q.shape

    def negative_log_det(x: Array) -> tuple[float, Array]:
        root, q = x[:M], x[M:].reshape(M, n)
        total = root @ root
        w = root**2 / total
        F, slope = rows.traced(Cells(cells.joint, q))
        information = (F * w[:, None]).T @ F
        try:
            pull = np.linalg.solve(information, F.T).T
        except np.linalg.LinAlgError:
            return FAR, np.zeros_like(x)
        by_root = -2 * root / total * ((pull * F).sum(axis=1) - F.shape[1])
        return -float(np.linalg.slogdet(information)[1]), np.concatenate(
            [by_root, slope(-2 * w[:, None] * pull).ravel()]
        )

    bounds = np.concatenate([np.tile([0.0, np.inf], (M, 1)), np.tile(allowed, (M, 1))])
    x = np.concatenate([np.sqrt(weight * M), cells.q.ravel()])
    x = minimize(negative_log_det, x, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": _MOVES}).x
    root = steady(x[:M], 3)
    return Cells(cells.joint, np.clip(steady(x[M:], 3).reshape(M, n), *allowed.T)), root**2 / (root @ root)


def _peaks(rows: Rows, half: Array, allowed: Array, offset: float) -> tuple[Cells, Array]:
    """Cells [n * _CLIMBED] at local maxima of the variance |f half|^2, and that variance."""
    d, n = rows.factoring.d, len(allowed)
    q = spread(allowed, _LOOKED_AT, offset)
    first = ((rows(q).reshape(-1, d) @ half) ** 2).sum(axis=1).reshape(-1, n)
    best = np.concatenate([ranked(first[:, i])[:_CLIMBED] for i in range(n)])
    return _climbed(rows, half, Cells(np.repeat(np.arange(n), len(best) // n), q[best]), allowed)


def _climbed(rows: Rows, half: Array, cells: Cells, allowed: Array) -> tuple[Cells, Array]:
    """Cells after projected steps up the log of their variance, and the variance; step lengths of Barzilai and Borwein."""

    def value_slope(q: Array) -> tuple[Array, Array]:
        F, slope = rows.traced(Cells(cells.joint, q))
        Y = F @ half
        value = (Y**2).sum(axis=1)
        return value, slope(2 / value[:, None] * (Y @ half.T))

    q = cells.q
    value, slope = value_slope(q)
    step = 0.05 / (np.linalg.norm(slope, axis=1) + 1e-12)
    for _ in range(_CLIMB_STEPS):
        tried = np.clip(q + step[:, None] * slope, *allowed.T)
        new, new_slope = value_slope(tried)
        better = new > value
        moved, bent = tried - q, new_slope - slope
        curvature = -(moved * bent).sum(axis=1)
        newton = (moved**2).sum(axis=1) / np.maximum(curvature, 1e-300)
        longer = np.where(curvature > 0, np.minimum(newton, 10 * step), 3 * step)
        step = np.where(better, longer, step / 4)
        q, slope = np.where(better[:, None], tried, q), np.where(better[:, None], new_slope, slope)
        value = np.where(better, new, value)
    return Cells(cells.joint, np.clip(steady(q, 3), *allowed.T)), value


def _distinct(peaks: Cells, variance: Array, most: int) -> Array:
    """Indices of at most `most` peaks above d = `most`, highest first, none next to a higher one of its joint."""
    chosen: list[int] = []
    for k in ranked(variance).tolist():
        i = peaks.joint[k]
        near = (np.abs(peaks.q[chosen, i + 1 :] - peaks.q[k, i + 1 :]) < _APART).all(axis=1) & (
            peaks.joint[chosen] == i
        )
        if variance[k] > _ABOVE * most and len(chosen) < most and not near.any():
            chosen.append(k)
    return np.array(chosen, dtype=np.int64)
