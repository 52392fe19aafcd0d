"""The search for a plan of d cells: exchanged over the cells of the optimal spread, refined, and exchanged again.

As many measurements as constants: the determinant of F is all there is to trade, and local optima are many. Exchange
starts from the cells that carry the optimal spread, because good plans are made of cells near those. When what may be
exchanged there, or near a cell, is spent, cells are sought anywhere: with the others as they are the determinant is linear in
the row f of one cell, |f g| times as large, g the column of F^-1 that belongs to it. (Coordinate exchange, R. K. Meyer and
C. J. Nachtsheim, DOI 10.1080/00401706.1995.10485889, of all joints' angles at once.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from symgen.ascent import climbed_each
from symgen.cells import Cells, Rows, ranked, spread, steady
from symgen.chain import Array
from symgen.holding import Holding
from symgen.optimal import Optimum
from symgen.saturated import Merit, maxvol, refined

#: Merits of two designs closer than this: mirror images of each other, or the same.
_SAME = 1e-6

#: Postures looked at for each cell, in each sweep others; how many of their cells are climbed from, and by how many steps.
_LOOKED_AT, _CLIMBED, _CLIMB_STEPS = 1000, 5, 12

#: Steps of the refinement after a sweep; over after so many sweeps without a gain, one less than this being none.
_STEPS, _PATIENCE, _GAIN = 30, 5, 1e-4

#: Betters plans, each by at most so many steps, then so many sweeps.
Better = Callable[[Sequence[Cells], int, int], list[Cells]]


@dataclass(frozen=True)
class Search:
    """Exchanges started over the cells of the optimal spread; designs refined, by so many steps; and how many of these are swept,
    so often."""

    starts: int
    designs: int
    steps: int
    finalists: int
    sweeps: int


def saturated(rows: Rows, merit: Merit, first: Cells, best: Optimum, better: Better, search: Search) -> Cells:
    """Returns the d cells of largest merit found from the cells of the optimal spread, and from the d cells `first` where those
    give fewer designs than are asked for.

    All that are returned are feasible, if `first` and the cells of the spread are, and `better` keeps them so.
    """
    options = best.cells
    F = rows.of_cells(options)
    even = F @ np.linalg.inv(np.linalg.qr(F, mode="r"))
    found: list[tuple[float, NDArray[np.int64]]] = []
    for start in np.unique(np.linspace(0, len(F) - 1, search.starts).astype(np.int64)).tolist():
        chosen = merit.exchanged(F, maxvol(even, start))
        found.append((round(merit(F[chosen]), 6), chosen))
    found.sort(key=lambda one: -one[0])
    distinct = [found[k][1] for k in range(len(found)) if k == 0 or found[k - 1][0] - found[k][0] > _SAME]
    starts = [*(options[chosen] for chosen in distinct), first][: search.designs]

    def worth(cells: Cells) -> float:
        return merit.of_choice(rows.of_cells(cells))

    finalists = sorted(better(starts, search.steps, 0), key=worth, reverse=True)[: search.finalists]
    return max([*finalists, *better(finalists, _STEPS, search.sweeps)], key=worth)


def bettering(rows: Rows, merit: Merit, holding: Holding) -> Better:
    """Returns what betters plans one after the other."""

    def better(plans: Sequence[Cells], steps: int, sweeps: int) -> list[Cells]:
        moved = (refined(rows, merit, cells, holding, steps) for cells in plans)
        return [swept(rows, merit, cells, holding, sweeps) for cells in moved]

    return better


def swept(rows: Rows, merit: Merit, cells: Cells, holding: Holding, sweeps: int) -> Cells:
    """Returns the d cells of largest merit after at most so many sweeps. All are feasible, if `cells` are."""
    reached, idle = merit.of_choice(rows.of_cells(cells)), 0
    for k in range(sweeps):
        better = refined(rows, merit, _exchanged(rows, merit, cells, holding, (0.1 + 0.317 * k) % 1.0), holding, _STEPS)
        value = merit.of_choice(rows.of_cells(better))
        idle = 0 if value > reached + _GAIN else idle + 1
        if value > reached:
            cells, reached = better, value
        if idle == _PATIENCE:
            break
    return cells


def _exchanged(rows: Rows, merit: Merit, cells: Cells, holding: Holding, offset: float) -> Cells:
    """The cells after those exchanges for the best ones anywhere that raise the merit."""
    d, n = len(cells), cells.q.shape[1]
    G = np.linalg.inv(rows.of_cells(cells))
    q = spread(holding.allowed, _LOOKED_AT, offset)
    larger = np.abs(rows(q).reshape(-1, d) @ G)
    best = np.concatenate([ranked(column, _CLIMBED) for column in larger.T])
    passed, found = holding.placed(Cells(best % n, q[best // n]))
    found, g = found[passed], np.repeat(G.T, _CLIMBED, axis=0)[passed]

    def hills(q: Array) -> tuple[Array, Array]:
        F, slope = rows.traced(Cells(found.joint, q))
        value = (F * g).sum(axis=1)
        return np.abs(value), slope(g / value[:, None])

    q, _ = climbed_each(hills, found.q, holding.allowed, _CLIMB_STEPS)
    found = holding.towards(found, Cells(found.joint, np.clip(steady(q), *holding.allowed.T)))
    found = found[np.abs((rows.of_cells(found) * g).sum(axis=1)) > 1.0]
    options = cells + found
    return options[merit.exchanged(rows.of_cells(options), np.arange(d))]
