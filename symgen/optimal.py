"""How good a plan can be at all: the D-optimal spread of measurements over all cells, and the bound it proves.

A plan of N cells gives alpha the information F' F. Per measurement no plan can have a larger determinant than the best
weighting w of all cells, M(w) = sum w f f', and no weighting a larger log det than, for any w,

    log det M(w) + d log(v / d),    v = the largest variance f' M(w)^-1 f of all cells,

by the equivalence theorem (Kiefer and Wolfowitz, DOI 10.4153/CJM-1960-030-4) with the mean inequality. At the optimum
v = d, so the bound can be driven to the truth. Where not all postures are feasible, "all cells" are the feasible ones.
v is found by ascent from the best of many postures, not by interval arithmetic.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, islice

import numpy as np
from numpy.typing import NDArray

from symgen.ascent import climbed_each
from symgen.cells import Cells, Rows, ranked, spread, steady
from symgen.chain import Array
from symgen.holding import Holding

#: The bound is close enough when no cell's variance exceeds d by more than this factor (a loss of 0.1 % of efficiency).
CLOSE = 1.001

#: The search is over when in so many rounds neither the weights nor the bound gain this part of the efficiency.
_PATIENCE, _GAIN = 8, 1e-3

#: Postures looked at for the largest variance, in each round at other places, and how many of each joint are climbed.
_LOOKED_AT, _CLIMBED = 1000, 4

#: Where not all postures are feasible: how many times `_CLIMBED` are tried to find so many that are; reaches [rad, m]
#: and number of the steps with which a cell stopped by a wall looks for a way along it, and how many of them are tested.
_TRIED, _REACHES, _SIDES, _ASKED = 2, (0.3, 0.1, 0.03, 0.01), 12, 3

#: There, a peak is tested when its variance exceeds d by this part of what the largest of the round before did.
_WORTH = 0.1

#: Steps of the weights (plain, then Newton's) and of the climb in one round.
_PLAIN, _NEWTON, _CLIMB_STEPS = 10, 6, 12

#: Weights are optimal when no used cell's variance differs from d by more than this part of it, and no other's exceeds it.
_LEVEL = 2e-3

#: A cell is new when its variance exceeds d by more than this factor; those in use have just d.
_ABOVE = 1.001

#: How much the model of the weights is stiffened: for two cells close together, and more where crowds of them mislead it;
#: and the lengths of Newton's step that are tried.
_DAMPING, _LENGTHS = (1e-4, 1e-2, 1.0), (1.0, 0.5, 0.25, 0.06)

#: Cells below this weight, relative to 1 / d, are dropped; weight given to the new ones; angle [rad, m] that tells two apart.
_DROPPED, _NEW, _APART = 1e-4, 0.1, 0.02


@dataclass(frozen=True)
class Optimum:
    """Nearly D-optimal weights [M] of `cells`, with information of the determinant `log_det`; `log_det_bound`: what no
    information per measurement can exceed."""

    cells: Cells
    weight: Array
    log_det: float
    log_det_bound: float


def d_efficiency(F: Array, log_det_bound: float) -> float:
    """Returns a lower bound of (det / best possible det)^(1/d) per measurement of the rows F [N, d]."""
    N, d = F.shape
    return float(np.exp(min((np.linalg.slogdet(F.T @ F / N)[1] - log_det_bound) / d, 0.0)))


def further(spreads: Iterator[Optimum], rounds: int, *known: Optimum) -> Optimum:
    """Returns the last of the next `rounds` >= 1 of `optima`; the one `known` where there are no more."""
    return [*known, *islice(spreads, rounds)][-1]


def optima(rows: Rows, holding: Holding, start: Cells) -> Iterator[Optimum]:
    """Yields ever better spreads of measurements, from `start` (feasible cells of full rank) on, until there is no gain.

    Each round makes the weights optimal, drops the cells that have none, and climbs from the others, and from those of
    largest variance elsewhere, to the peaks of the variance. These are the cells to add, with those dropped before that
    have a variance above d again.
    """
    cells, d, largest = start, rows.factoring.d, np.inf
    F, weight, bound = rows.of_cells(cells), np.full(len(cells), 1 / len(cells)), np.inf
    seen, F_seen = cells, F
    history: list[tuple[float, float]] = []
    for k in count():
        weight = _weights(F, weight)
        kept = weight > _DROPPED / d
        cells, F, weight = cells[kept], F[kept], steady(weight[kept] / weight[kept].sum(), 6)
        weight = weight / weight.sum()
        information = (F * weight[:, None]).T @ F
        log_det = float(np.linalg.slogdet(information)[1])
        half = np.linalg.inv(np.linalg.cholesky(information)).T
        high = _highest(rows, half, holding, (0.123 + 0.317 * k) % 1.0)
        worth = max(_ABOVE, 1 + _WORTH * (min(largest, 2 * d) / d - 1))
        peaks, variance, untested = _climbed(rows, half, cells + high, holding, worth * d)
        peaks, variance = peaks + seen, np.concatenate([variance, ((F_seen @ half) ** 2).sum(axis=1)])
        largest = max(float(variance.max()), untested, d)
        bound = min(bound, log_det + d * np.log(largest / d))
        yield Optimum(cells, weight, log_det, bound)
        history.append((log_det, bound))
        if largest < CLOSE * d or _stalled(history, d):
            return
        new = peaks[_distinct(peaks, variance, d)]
        F_new = rows.of_cells(new)
        cells, F = cells + new, np.concatenate([F, F_new])
        seen, F_seen = seen + new, np.concatenate([F_seen, F_new])
        weight = np.concatenate([(1 - _NEW) * weight, np.full(len(new), _NEW / max(len(new), 1))])


def _stalled(history: list[tuple[float, float]], d: int) -> bool:
    """Whether the last rounds (information of the weights, bound) gained nothing to speak of."""
    if len(history) <= _PATIENCE:
        return False
    (log_det, bound), (log_det_before, bound_before) = history[-1], history[-1 - _PATIENCE]
    return max(log_det - log_det_before, bound_before - bound) < _GAIN * d


def _weights(F: Array, weight: Array) -> Array:
    """The optimal weights [M] of the rows F, from any positive ones: multiplicative steps (Silvey, Titterington and Torsney,
    Comm. Statist. A 7, 1379, 1978), then Newton's on log det M - d (sum w - 1), which is largest at the same weights."""
    d = F.shape[1]

    def objective(w: Array) -> float:
        sign, log_det = np.linalg.slogdet((F * w[:, None]).T @ F)
        return float(log_det) - d * float(w.sum()) if sign > 0 else -np.inf

    for _ in range(_PLAIN):
        weight = weight * _variance(F, weight)[1] / d
    for _ in range(_NEWTON):
        Y, variance = _variance(F, weight)
        slope = variance - d
        if slope.max() < _LEVEL * d and np.abs(slope[weight > 0]).max() < _LEVEL * d:
            break
        used = np.flatnonzero((weight > 0) | (slope > 0))
        here = objective(weight)
        tried = (
            _moved(weight, used, length * step)
            for step in (_newton(Y[used], slope[used], weight[used], damping) for damping in _DAMPING)
            for length in _LENGTHS
        )
        better = next((w for w in tried if objective(w) > here), None)
        if better is None:
            break
        weight = better
    return weight / weight.sum()


def _variance(F: Array, weight: Array) -> tuple[Array, Array]:
    """Rows whitened by the information of the weights [M, d], and their variances [M]."""
    Y = F @ np.linalg.inv(np.linalg.cholesky((F * weight[:, None]).T @ F)).T
    return Y, (Y**2).sum(axis=1)


def _moved(weight: Array, used: NDArray[np.int64], step: Array) -> Array:
    moved = weight.copy()
    moved[used] += step
    return moved


def _newton(Y: Array, slope: Array, weight: Array, damping: float) -> Array:
    """The step to the maximum of the quadratic model over weights that stay >= 0; those that would not go to 0."""
    H = (Y @ Y.T) ** 2
    H.flat[:: len(H) + 1] *= 1 + damping
    free = np.ones(len(weight), dtype=bool)
    step = np.zeros(len(weight))
    for _ in range(12):
        step[~free] = -weight[~free]
        step[free] = np.linalg.solve(H[np.ix_(free, free)], slope[free] - H[np.ix_(free, ~free)] @ step[~free])
        below = free & (weight + step < 0)
        if not below.any():
            break
        free &= ~below
    return np.maximum(step, -weight)


def _highest(rows: Rows, half: Array, holding: Holding, offset: float) -> Cells:
    """For each joint the `_CLIMBED` feasible cells of largest variance |f half|^2 among evenly spread postures."""
    d, n = rows.factoring.d, len(holding.allowed)
    q = spread(holding.allowed, _LOOKED_AT, offset)
    variance = ((rows(q).reshape(-1, d) @ half) ** 2).sum(axis=1).reshape(-1, n)
    most = _CLIMBED if holding.feasible is None else _TRIED * _CLIMBED
    best = np.concatenate([ranked(variance[:, i], most) for i in range(n)])
    cells = Cells(np.repeat(np.arange(n), most), q[best])
    if holding.feasible is None:
        return cells
    passed, cells = holding.placed(cells)
    place = np.cumsum(passed.reshape(n, most), axis=1).ravel()
    return cells[passed & (place <= _CLIMBED)]


def _climbed(rows: Rows, half: Array, cells: Cells, holding: Holding, worth: float) -> tuple[Cells, Array, float]:
    """Cells after projected steps up the log of their variance |f half|^2, and the variance; all stay feasible.

    A cell whose peak is not feasible goes as far towards it as it may, and on from
    there with steps to all sides. One whose peak is not above `worth` stays, rather than be tested; the highest of these
    peaks is the third result.
    """

    def hills(q: Array) -> tuple[Array, Array]:
        F, slope = rows.traced(Cells(cells.joint, q))
        Y = F @ half
        value = (Y**2).sum(axis=1)
        return value, slope(2 / value[:, None] * (Y @ half.T))

    before = ((rows.of_cells(cells) @ half) ** 2).sum(axis=1)
    q, value = climbed_each(hills, cells.q, holding.allowed, _CLIMB_STEPS)
    peaks = Cells(cells.joint, np.clip(steady(q, 3), *holding.allowed.T))
    if holding.feasible is None:
        return peaks, value, 0.0
    tried = np.flatnonzero(value > worth)
    passed = holding.keeps(peaks[tried])
    q, reached, stopped = cells.q.copy(), before.copy(), tried[~passed]
    q[tried[passed]], reached[tried[passed]] = peaks.q[tried[passed]], value[tried[passed]]
    at_wall = holding.short_of(cells[stopped], peaks[stopped], np.zeros(len(stopped), dtype=bool))
    there = ((rows.of_cells(at_wall) @ half) ** 2).sum(axis=1)
    higher = there > before[stopped]
    q[stopped[higher]], reached[stopped[higher]] = steady(at_wall.q[higher]), there[higher]
    stopped = stopped[reached[stopped] > worth]
    peaks, reached = _along_walls(rows, half, holding, Cells(cells.joint, q), reached, stopped)
    return peaks, reached, float(value[value <= worth].max(initial=0.0))


def _along_walls(
    rows: Rows, half: Array, holding: Holding, cells: Cells, value: Array, at: NDArray[np.int64]
) -> tuple[Cells, Array]:
    """The cells and their variances after those `at` walls have taken the best feasible of steps to all sides."""
    if not len(at):
        return cells, value
    q, value, n = cells.q.copy(), value.copy(), cells.q.shape[1]
    joint = np.repeat(cells.joint[at], _SIDES)
    matters = np.arange(n) > joint[:, None]
    for k, reach in enumerate(_REACHES):
        sides = spread(np.tile([-reach, reach], (n, 1)), _SIDES, 0.31 * (k + 1) % 1.0)
        tried = (q[at][:, None] + sides).reshape(-1, n)
        tried = steady(np.clip(np.where(matters, tried, np.repeat(q[at], _SIDES, axis=0)), *holding.allowed.T))
        new = ((rows.of_cells(Cells(joint, tried)) @ half) ** 2).sum(axis=1)
        new = new.reshape(len(at), _SIDES)
        higher = (new > value[at][:, None]) & (new >= np.sort(new, axis=1)[:, -_ASKED, None])
        higher, new = higher.ravel(), new.ravel()
        higher[higher] = holding.keeps(Cells(joint[higher], tried[higher]))
        new = np.where(higher, new, -1.0).reshape(len(at), _SIDES)
        best = new.argmax(axis=1)
        gains = higher.reshape(len(at), _SIDES).any(axis=1)
        q[at[gains]] = tried.reshape(len(at), _SIDES, n)[gains, best[gains]]
        value[at[gains]] = new[gains, best[gains]]
    return Cells(cells.joint, q), value


def _distinct(peaks: Cells, variance: Array, most: int) -> Array:
    """Indices of at most `most` peaks above d = `most`, highest first, none next to a higher one of its joint."""
    chosen: list[int] = []
    for k in ranked(variance, int((variance > _ABOVE * most).sum())).tolist():
        i = peaks.joint[k]
        near = (np.abs(peaks.q[chosen, i + 1 :] - peaks.q[k, i + 1 :]) < _APART).all(axis=1)
        if not (near & (peaks.joint[chosen] == i)).any():
            chosen.append(k)
        if len(chosen) == most:
            break
    return np.array(chosen, dtype=np.int64)
