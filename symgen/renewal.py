"""A plan bettered: again and again a part of its cells is given up and chosen anew.

Refined plans are local optima, and very many: one has the others' cells in part. What is kept of a good plan makes a better
start than cells chosen from nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from symgen.cells import Cells, Rows
from symgen.chain import Array
from symgen.optimal import Optimum, d_efficiency
from symgen.saturated import Merit, Refine, maxvol

#: Smallest and largest part of the cells given up at once, and steps of the refinement after it.
_GIVEN_UP, _STEPS = (0.2, 0.6), 15

#: Tries from the same plan, which two processes can make at once.
_AT_ONCE = 2


def renewed(
    rows: Rows,
    merit: Merit,
    cells: Cells,
    best: Optimum,
    refine: Refine,
    tries: int,
    enough: float,
    rng: np.random.Generator,
) -> Cells:
    """Returns the d cells of largest merit after `tries` parts of `cells` were given up for cells of the optimal spread.

    Ends before when the D-efficiency is `enough`. All returned are feasible, if `cells` and those of the spread are, and
    `refine` keeps them so.
    """
    F_options = rows.of_cells(best.cells)
    even = np.linalg.inv(np.linalg.qr(F_options, mode="r"))

    def start() -> Cells:
        kept = rng.random(len(cells)) >= rng.uniform(*_GIVEN_UP)
        others = _completing(rows.of_cells(cells[kept]) @ even, F_options @ even)
        return cells[kept] + best.cells[others]

    def worth(cells: Cells) -> float:
        return merit.of_choice(rows.of_cells(cells))

    for at in range(0, tries, _AT_ONCE):
        if d_efficiency(rows.of_cells(cells), best.log_det_bound) >= enough:
            break
        starts = [start() for _ in range(min(_AT_ONCE, tries - at))]
        cells = max([cells, *refine(starts, _STEPS)], key=worth)
    return cells


def _completing(kept: Array, options: Array) -> NDArray[np.int64]:
    """Rows of `options` [N, d], as many as are missing to d, of locally largest determinant with those `kept`."""
    missing = options.shape[1] - len(kept)
    if missing == 0:
        return np.zeros(0, dtype=np.int64)
    beyond = options @ np.linalg.qr(kept.T, mode="complete")[0][:, len(kept) :]
    return maxvol(beyond @ np.linalg.inv(np.linalg.qr(beyond, mode="r")))
