"""What cells achieve, whoever chose them, even if that is not enough: what stays open, and what the arm can not hold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from symgen import postures
from symgen.cells import Cells, Rows
from symgen.chain import Array, Chain, readonly
from symgen.feasible import Feasible
from symgen.holding import Holding, Mask, box
from symgen.postures import Design

#: A combination of constants that cells show less than this, relative to the one they show best, stays open.
SEEN = 1e-6

#: Beyond a limit by more than the rounding of a text [rad or m].
_OUTSIDE = 1e-6


def undetermined(rows: Rows, cells: Cells) -> tuple[int, tuple[str, ...]]:
    """Returns how many combinations of constants the cells determine, and the constants that stay open, by name."""
    visible, _ = _visible(rows, cells, rows.workspace)
    share = 1 - (visible**2).sum(axis=0)
    names = rows.factoring.names[: rows.factoring.d]
    return len(visible), tuple(name for name, left in zip(names, share, strict=True) if left > SEEN)


def judged(rows: Rows, cells: Cells, spare: NDArray[np.bool_], feasible: Mask | None = None) -> Design:
    """Returns what the cells achieve, whoever chose them, beside those that are `feasible`; `spare` [N] as in `Design`, and
    not counted.

    Where the cells do not determine all constants the D-efficiency is 0, `cond` is nan, and so is the amplification of the
    joints whose J_ii(q) they do not determine everywhere.
    """
    factoring, everywhere = rows.factoring, rows.workspace
    visible, scaled = _visible(rows, cells[~spare], everywhere)
    if len(visible) == factoring.d:
        return postures.judged(
            rows, cells.joint, cells.q, spare, Holding(factoring.chain, box(factoring.chain.limits), feasible)
        )
    E = everywhere / _size(everywhere)
    hidden = np.linalg.norm(E - E @ visible.T @ visible, axis=(0, 2)) > SEEN * np.linalg.norm(E, axis=(0, 2))
    variance = ((E @ visible.T @ np.linalg.pinv(scaled @ visible.T)) ** 2).sum(axis=2)
    return Design(
        joint=cells.joint,
        q=readonly(cells.q),
        spare=spare,
        amplification=readonly(np.where(hidden, np.nan, np.sqrt(variance.mean(axis=0)))),
        amplification_p999=readonly(np.where(hidden, np.nan, np.sqrt(np.quantile(variance, 0.999, axis=0)))),
        cond=readonly(np.full(factoring.chain.n, np.nan)),
        d_efficiency=0.0,
        d_efficiency_all=0.0,
    )


def infeasible(chain: Chain, cells: Cells, feasible: Feasible | None) -> dict[int, str]:
    """Returns the cells (counted from 0) that the arm may not hold, and why; without `feasible` only limits are looked at."""
    low, high = np.array([(joint.lower, joint.upper) for joint in chain.joints]).T  # infinite where none is stated
    beyond = (cells.q < low - _OUTSIDE) | (cells.q > high + _OUTSIDE)
    why = {k: [f"{chain.names[j]} beyond its limits" for j in np.flatnonzero(beyond[k])] for k in range(len(cells))}
    if feasible is not None:
        for k in np.flatnonzero(~feasible(cells.q)).tolist():
            why[k].append("self-collision" if feasible.touches(cells.q[k : k + 1])[0] else "gravity beyond the motors")
    return {k: ", ".join(reasons) for k, reasons in why.items() if reasons}


def _size(everywhere: Array) -> Array:
    """How much each constant matters over the workspace [d]: makes constants comparable."""
    size: Array = np.sqrt((everywhere**2).sum(axis=1).max(axis=0))
    return size


def _visible(rows: Rows, cells: Cells, everywhere: Array) -> tuple[Array, Array]:
    """An orthonormal basis [rank, d] of what the cells determine of the scaled constants, and their scaled rows [N, d].

    Asked of rows of length 1: a cell where J_ii nearly vanishes (points near its axis) hides no other by its weight.
    """
    scaled = rows.of_cells(cells) / _size(everywhere)
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    _, values, basis = np.linalg.svd(scaled / np.where(length > 0.0, length, 1.0), full_matrices=False)
    return basis[values > SEEN * values.max(initial=0.0)], scaled
