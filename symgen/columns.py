"""A plan whose every run tells a column of J(q): excite joint i and read also what it asks of the joints that are held.

The held joint j has to be given the torque J_ji(q) times the acceleration of joint i, so one record at posture q shows
J_1i .. J_ni, off-diagonals included: far fewer runs than one for each constant. A run is a block of rows over all D
constants; each entry is taken to be measured with sigma_ij = sqrt(sigma_i sigma_j), sigma_i as in `postures`.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from symgen.basis import Factoring
from symgen.cells import spread
from symgen.chain import Array, readonly
from symgen.errors import NoPlanError
from symgen.holding import ROUNDING, Holding, Mask, box
from symgen.regressor import J_rows

#: A column plan is long enough when no entry's error over the workspace is worse than this, per unit error of an entry.
AMPLIFICATION = 1.3

_CANDIDATES, _WORKSPACE = 250, 400

#: Where fewer of the candidates are feasible, more postures are looked at.
_ENOUGH = 50

#: Steps [rad or m] tried around every run, smaller each time.
_REACHES, _STEPS = (0.6, 0.2, 0.07), 8

#: Singular value of the rows of runs, of the largest, below which they do not determine what they tell.
_UNTOLD = 1e-7

#: Runs are exchanged until no exchange raises log det by more than this.
_GAIN = 1e-3


@dataclass(frozen=True)
class ColumnDesign:
    """Runs that together tell all of J(q): run k excites joint `joint[k]` (from 0) at `q[k]`.

    `amplification` [n, n]: rms over the workspace of the standard deviation of J_ij(q) / sigma_ij for unit error of a
    measured entry.
    """

    joint: NDArray[np.int64]
    q: Array
    amplification: Array


class _Blocks:
    """Rows of runs over the constants, scaled: blocks [m, n, D] of (joint [m], q [m, n]).

    The constants are mixed so that all of J over the workspace tells each as well as another: some hardly matter.
    """

    def __init__(self, factoring: Factoring, rotor: Array, workspace: Array):
        self.factoring, self.rotor = factoring, rotor
        self.alike = np.eye(len(factoring.alphas))
        everywhere = self.everything(workspace).reshape(-1, len(self.alike)) / np.sqrt(len(workspace))
        size = np.maximum(np.linalg.norm(everywhere, axis=0), np.finfo(float).tiny)
        with suppress(np.linalg.LinAlgError):  # where limits are so narrow that some is not told at all
            self.alike = np.linalg.inv(np.linalg.qr(everywhere / size, mode="r")) / size[:, None]

    def everything(self, q: Array) -> Array:
        """All entries [m, n, n, D], scaled by sigma_ij."""
        rows = J_rows(self.factoring, q)
        sigma = np.sqrt(np.einsum("miid,d->mi", rows, self.factoring.alpha_cad) + self.rotor)
        return rows / (sigma[:, :, None] * sigma[:, None, :])[..., None] @ self.alike


def _gain(blocks: Array, covariance: Array) -> Array:
    """log det of 1 + B P B' for blocks B [m, n, D]: what one more run adds to log det of the information."""
    inner = np.einsum("mid,de,mje->mij", blocks, covariance, blocks, optimize=True)
    return np.linalg.slogdet(np.eye(inner.shape[1]) + inner)[1]


def plan_columns(
    factoring: Factoring,
    *,
    rotor: Array | None = None,
    feasible: Mask | None = None,
    amplification: float = AMPLIFICATION,
    most: int | None = None,
) -> ColumnDesign:
    """Returns the shortest plan found whose worst amplification is at most `amplification` (or of `most` runs).

    `rotor` [n, kg m2, joint side] and `feasible` as in `postures.plan`. Runs are added one at a time, each the best of many
    candidates, and after each the others are exchanged and moved; log det of the information is what is raised.

    Raises NoPlanError where the postures found do not determine all constants.
    """
    n, D = factoring.chain.n, len(factoring.alphas)
    workspace = spread(factoring.chain.limits, _WORKSPACE, 0.123)
    blocks = _Blocks(factoring, np.zeros(n) if rotor is None else rotor, workspace)
    allowed, everywhere = box(factoring.chain.limits), blocks.everything(workspace)
    q = _allowed(spread(allowed, _CANDIDATES, 0.5), feasible)
    if len(q) < _ENOUGH:
        q = Holding(factoring.chain, allowed, feasible).found(_ENOUGH)
    if not len(q):
        raise _none(factoring)
    joints = np.tile(np.arange(n), len(q))
    postures, rows = np.repeat(q, n, axis=0), blocks.everything(q).reshape(-1, n, D)
    prior = 1e-6 * np.eye(D)
    runs: list[int] = []
    longest = most or D
    while True:
        information = prior + sum((rows[k].T @ rows[k] for k in runs), np.zeros((D, D)))
        runs.append(int(np.argmax(_gain(rows, np.linalg.inv(information)).astype(np.float32))))
        runs = _exchanged(rows, runs, prior)
        if len(runs) * n < D:
            continue
        F = rows[runs].reshape(-1, D)
        worst = _amplification(everywhere, F)
        if worst.max() <= amplification or len(runs) >= longest:
            break
        joints, postures, rows = _with_neighbours(blocks, joints, postures, rows, runs, allowed, feasible)
    if not np.isfinite(worst).all():
        raise _none(factoring)
    order = np.lexsort((np.arange(len(runs)), -joints[runs]))
    chosen = np.array(runs)[order]
    return ColumnDesign(joints[chosen], readonly(postures[chosen]), readonly(worst))


def _none(factoring: Factoring) -> NoPlanError:
    return NoPlanError(
        f"{factoring.chain.name}: no column plan: the postures found that the arm may hold do not determine all "
        f"{len(factoring.alphas)} constants; expected a plan without --columns, or wider limits"
    )


def _allowed(q: Array, feasible: Mask | None) -> Array:
    q = np.round(q / ROUNDING) * ROUNDING
    return q if feasible is None else q[feasible(q)]


def _amplification(everywhere: Array, F: Array) -> Array:
    """Amplification of every entry [n, n] by the runs with rows F [N n, D]; infinite where they do not determine it."""
    _, sizes, directions = np.linalg.svd(F, full_matrices=False)
    if len(sizes) < F.shape[1] or sizes[-1] < _UNTOLD * sizes[0]:
        return np.full(everywhere.shape[1:3], np.inf)
    rms: Array = np.sqrt(((everywhere @ (directions.T / sizes)) ** 2).sum(axis=-1).mean(axis=0))
    return rms


def _exchanged(rows: Array, runs: list[int], prior: Array) -> list[int]:
    """The runs after replacing one by the best candidate in its place, again and again, until that gains nothing."""
    runs = list(runs)
    information = prior + sum(rows[k].T @ rows[k] for k in runs)
    while True:
        best, gained = None, _GAIN
        for position, k in enumerate(runs):
            without = information - rows[k].T @ rows[k]
            gain = _gain(rows, np.linalg.inv(without))
            candidate = int(np.argmax(gain.astype(np.float32)))
            if gain[candidate] - gain[k] > gained:
                best, gained = (position, candidate), float(gain[candidate] - gain[k])
        if best is None:
            return runs
        position, candidate = best
        information += rows[candidate].T @ rows[candidate] - rows[runs[position]].T @ rows[runs[position]]
        runs[position] = candidate


def _with_neighbours(
    blocks: _Blocks,
    joints: NDArray[np.int64],
    postures: Array,
    rows: Array,
    runs: list[int],
    allowed: Array,
    feasible: Mask | None,
) -> tuple[NDArray[np.int64], Array, Array]:
    """The candidates with postures around the runs added."""
    n, D = postures.shape[1], rows.shape[2]
    steps = np.concatenate(
        [spread(np.array([[-reach, reach]] * n), _STEPS, 0.31 * (k + 1)) for k, reach in enumerate(_REACHES)]
    )
    near = np.clip((postures[runs][:, None, :] + steps).reshape(-1, n), *allowed.T)
    near = np.round(near / ROUNDING) * ROUNDING
    own = np.repeat(joints[runs], len(steps))
    if feasible is not None:
        kept = feasible(near)
        near, own = near[kept], own[kept]
    more = blocks.everything(near)[np.arange(len(near)), own].reshape(-1, n, D)
    return np.concatenate([joints, own]), np.concatenate([postures, near]), np.concatenate([rows, more])
