"""Which joint to excite at which posture: cells (i, q), chosen jointly over the shared constants.

Error model: one measurement of J_ii(q) has a standard deviation proportional to sigma_i(q) = J_ii(q) + N_i^2 J_m,i (see
`cells.Rows`), so a plan of N cells with rows F gives alpha the covariance (F' F)^-1. Choosing cells joint by joint, each
with as many as it has new constants, can be tens of times worse than choosing them together, because the error of a
shared constant is carried inwards.

Amplification of joint i: rms over the workspace of the standard deviation of J_ii(q) / sigma_i(q), for unit error of one
measurement. Exactly d cells can not do better than 1 at the worst (i, q) (Kiefer-Wolfowitz, DOI 10.4153/CJM-1960-030-4).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from symgen.ascent import climbed
from symgen.basis import Factoring
from symgen.cells import Cells, Rows, every_joint, ranked, spread, steady
from symgen.chain import Array, readonly
from symgen.forked import WORKERS, beside, standing
from symgen.holding import Holding, Mask, box
from symgen.kicks import ENOUGH, POWER, enough
from symgen.optimal import d_efficiency, further, optima
from symgen.saturated import CANDIDATES, Merit, candidates
from symgen.search import Better, Search, bettering, saturated

Effort = Literal["draft", "quick", "full"]

#: Spare cells looked at together for one that is feasible.
_AT_ONCE = 8

#: The weak prior of the wider model, in measurements spread over the pool.
_PRIOR = 1e-2

#: Eigenvalue of that, of its largest, below which a direction is not shown by the pool.
_UNSEEN = 1e-13

#: Steps by which the spare cells are moved, together.
_SPARE_STEPS = 60


@dataclass(frozen=True)
class _Work:
    """Rounds of the search for the bound before that for the plan, and beside it; whether its end is kicked on."""

    rounds: int
    beside: int
    search: Search
    kicked: bool = False


_WORK = {
    "draft": _Work(3, 0, Search(3, 1, 0, 1, 0)),
    "quick": _Work(12, 18, Search(12, 3, 30, 1, 10)),
    "full": _Work(40, 0, Search(40, 8, 60, 4, 16), kicked=True),
}


@dataclass(frozen=True)
class Design:
    """A posture plan: cell k excites joint `joint[k]` (from 0) at `q[k]`; cells run tip to base, the spare ones last.

    `amplification` [n] as in the module's docstring, `amplification_p999` its 99.9 % quantile over the workspace;
    `cond` [n] the condition number of each joint's own rows, columns whitened over the workspace, nan where it has none;
    `d_efficiency` lower bound, by the peaks found among all cells that may be held, of (det / best possible det)^(1/d) per
    measurement for the cells without the spare ones, `d_efficiency_all` for all.
    """

    joint: NDArray[np.int64]
    q: Array
    spare: NDArray[np.bool_]
    amplification: Array
    amplification_p999: Array
    cond: Array
    d_efficiency: float
    d_efficiency_all: float


def spare_cells(
    rows: Rows, wider: Factoring, planned: Cells, pool: Cells, count: int, holding: Holding | None = None
) -> Cells:
    """Returns `count` cells of the pool that discriminate: where a model with every inertial parameter free (`wider`) is
    least tied down so far. With `holding`, as they are run, and feasible.

    A plan of d cells fits its d constants without residual whatever is missing; the cells chosen here are those whose
    prediction by the wider model varies most, given the planned ones and a weak prior.
    """
    G, F = rows.of_cells(pool, of=wider), rows.of_cells(planned, of=wider)
    M = F.T @ F + _prior(G)
    chosen, left = planned[np.arange(0)], np.ones(len(pool), dtype=bool)
    while len(chosen) < count and left.any():
        leverage = np.where(left, np.einsum("Nd,de,Ne->N", G, np.linalg.inv(M), G, optimize=True), -1.0)
        best = ranked(leverage, _AT_ONCE if holding else 1)
        passed, cells = holding.placed(pool[best]) if holding else (np.ones(1, dtype=bool), pool[best])
        if not passed.any():
            left[best] = False
            continue
        k = int(np.argmax(passed & left[best]))
        left[best[:k]] = False
        chosen = chosen + cells[np.array([k])]
        M += np.outer(G[best[k]], G[best[k]])
    return chosen


def _prior(G: Array) -> Array:
    """What is known of the wider model beforehand, by its rows of a pool; directions that the pool does not show matter nothing."""
    M: Array = _PRIOR * G.T @ G / len(G)
    sizes, directions = np.linalg.eigh(M)
    unseen = directions[:, sizes < _UNSEEN * sizes[-1]]
    return M + sizes[-1] * unseen @ unseen.T


def moved_spare(wider: Rows, planned: Cells, spare: Cells, pool: Cells, holding: Holding) -> Cells:
    """Returns the cells `spare` with their postures moved, all together, to where the wider model is tied down best; as they
    were where that brings nothing or is not feasible. Prior and `pool` as for `spare_cells`."""
    F, G = wider.of_cells(planned), wider.of_cells(pool)
    known = F.T @ F + _prior(G)

    def information(F: Array) -> Array:
        M: Array = known + F.T @ F
        return M

    def hill(x: Array) -> tuple[float, Array]:
        F, slope = wider.traced(Cells(spare.joint, x.reshape(spare.q.shape)))
        M = information(F)
        return float(np.linalg.slogdet(M)[1]), slope(2 * F @ np.linalg.inv(M)).ravel()

    if not len(spare):
        return spare
    low, high = np.tile(holding.allowed, (len(spare), 1)).T
    x = climbed(hill, np.clip(spare.q.ravel(), low, high), low, high, _SPARE_STEPS)
    aim = Cells(spare.joint, np.clip(steady(x).reshape(spare.q.shape), *holding.allowed.T))
    passed, moved = holding.placed(holding.towards(spare, aim))
    moved = Cells(spare.joint, np.where(passed[:, None], moved.q, spare.q))
    gain = np.linalg.slogdet(information(wider.of_cells(moved)))[1] - hill(spare.q.ravel())[0]
    return moved if gain > 0 else spare


def ordered(cells: Cells, start: Array) -> Cells:
    """Returns the cells in the order to visit them: tip to base, within a joint always the nearest posture next."""
    order: list[int] = []
    here = start
    for i in sorted(set(cells.joint.tolist()), reverse=True):
        left = np.flatnonzero(cells.joint == i).tolist()
        while left:
            nearest = min(left, key=lambda k: (float(np.abs(cells.q[k] - here).max()), k))
            left.remove(nearest)
            order.append(nearest)
            here = cells.q[nearest]
    return cells[np.array(order, dtype=np.int64)]


def plan(
    factoring: Factoring,
    wider: Factoring,
    *,
    rotor: Array | None = None,
    spare: int | None = None,
    effort: Effort = "quick",
    feasible: Mask | None = None,
    rows: Rows | None = None,
) -> Design:
    """Returns d cells (i, q) and `spare` more (default a quarter of d), with what they achieve.

    `wider` is the factoring of the same chain without believed zeros (or `factoring` itself), `rotor` [n, kg m2, joint
    side] the reflected motor inertias N^2 J_m where known. `effort` "quick" takes a second for seven joints, "full" some,
    "draft" a fraction of one, and its bound is loose. `feasible` tells which postures [m, n] the arm may hold (a mask [m]);
    the certificate is against plans of cells that it may hold, as far as the search finds them. `rows` of this factoring and
    rotor, if there are some, save work.

    Raises PlanError when no postures within the limits, or no feasible ones, determine all constants.
    """
    chain, d = factoring.chain, factoring.d
    rows = rows or Rows(factoring, np.zeros(chain.n) if rotor is None else rotor)
    work, holding, merit = _WORK[effort], Holding(chain, box(chain.limits), feasible), Merit(rows)
    start = candidates(rows, holding)
    spreads = optima(rows, holding, start[np.arange(len(start)) < 4 * d])
    best = further(spreads, work.rounds)
    alone = bettering(rows, merit, holding)

    def found(better: Better) -> Cells:
        return saturated(rows, merit, start[np.arange(len(start)) < d], best, better, work.search)

    if work.beside:
        best, cells = beside(lambda: further(spreads, work.beside, best), lambda: found(alone))
    else:
        with _shared(alone, min(WORKERS, work.search.finalists)) as better:
            cells = found(better)
        if work.kicked and d_efficiency(rows.of_cells(cells), best.log_det_bound) < ENOUGH:
            by_det = Merit(rows, POWER)
            with _shared(bettering(rows, by_det, holding), min(WORKERS, work.search.finalists)) as better:
                cells = enough(rows, by_det, cells, best, better)
    _, needed = holding.placed(cells)
    pool = best.cells + every_joint(spread(holding.allowed, CANDIDATES, 0.5))
    more = spare_cells(rows, wider, needed, pool, int(np.ceil(d / 4)) if spare is None else spare, holding)
    if effort != "draft":
        more = moved_spare(Rows(wider, rows.rotor), needed, more, pool, holding)
    both = ordered(needed, holding.rest) + ordered(more, holding.rest)
    return judged(rows, both.joint, both.q, np.arange(len(both)) >= d, holding, best.log_det_bound)


@contextmanager
def _shared(better: Better, workers: int) -> Iterator[Better]:
    """The same for many plans at once, by processes that stand until the end."""

    def share(k: int, asked: tuple[Sequence[Cells], int, int]) -> list[Cells]:
        plans, steps, sweeps = asked
        return better(plans[k::workers], steps, sweeps)

    with standing(share, workers) as ask:

        def shared(plans: Sequence[Cells], steps: int, sweeps: int) -> list[Cells]:
            shares = ask((plans, steps, sweeps))
            return [shares[k % workers][k // workers] for k in range(len(plans))]

        yield shared


def certificate(rows: Rows, F: Array, holding: Holding, effort: Effort = "quick") -> float:
    """Returns a lower bound of the D-efficiency of the rows F [N, d] among designs of any size of the cells of `holding`."""
    return d_efficiency(F, _log_det_bound(rows, holding, effort))


def _log_det_bound(rows: Rows, holding: Holding, effort: Effort) -> float:
    start = candidates(rows, holding)
    spreads = optima(rows, holding, start[np.arange(len(start)) < 4 * rows.factoring.d])
    return further(spreads, _WORK[effort].rounds + _WORK[effort].beside).log_det_bound


def judged(
    rows: Rows,
    joint: NDArray[np.int64],
    q: Array,
    spare: NDArray[np.bool_],
    holding: Holding,
    log_det_bound: float | None = None,
) -> Design:
    """Returns the design with its amplification, conditioning and certificate, whoever chose the cells.

    Amplification and whitening are taken over the whole joint limits, feasible or not, the certificate over the cells that
    may be held; `log_det_bound` as of `optimal.Optimum`, found by a quick search where it is not given.
    """
    n = q.shape[1]
    if log_det_bound is None:
        log_det_bound = _log_det_bound(rows, holding, "quick")
    everywhere = rows.workspace
    F = rows.of_cells(Cells(joint, q))
    needed, own = F[~spare], joint[~spare]
    variance = ((everywhere @ np.linalg.inv(np.linalg.qr(needed, mode="r"))) ** 2).sum(axis=2)
    whiten = np.linalg.inv(np.linalg.qr(everywhere.reshape(-1, needed.shape[1]), mode="r"))
    return Design(
        joint=joint,
        q=readonly(q),
        spare=spare,
        amplification=readonly(np.sqrt(variance.mean(axis=0))),
        amplification_p999=readonly(np.sqrt(np.quantile(variance, 0.999, axis=0))),
        cond=readonly(
            [float(np.linalg.cond((needed @ whiten)[own == i])) if (own == i).any() else np.nan for i in range(n)]
        ),
        d_efficiency=d_efficiency(needed, log_det_bound),
        d_efficiency_all=d_efficiency(F, log_det_bound),
    )
