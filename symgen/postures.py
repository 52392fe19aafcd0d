"""Which joint to excite at which posture: cells (i, q), chosen jointly over the shared constants.

Error model: one measurement of J_ii(q) has a standard deviation proportional to sigma_i(q) = J_ii(q) + N_i^2 J_m,i (see
`cells.Rows`), so a plan of N cells with rows F gives alpha the covariance (F' F)^-1. Choosing cells joint by joint, each
with as many as it has new constants, can be tens of times worse than choosing them together, because the error of a
shared constant is carried inwards.

Amplification of joint i: rms over the workspace of the standard deviation of J_ii(q) / sigma_i(q), for unit error of one
measurement. Exactly d cells can not do better than 1 at the worst (i, q) (Kiefer-Wolfowitz, DOI 10.4153/CJM-1960-030-4).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from symgen.basis import Factoring
from symgen.cells import Cells, Rows, every_joint, spread
from symgen.chain import REVOLUTE, Array, Chain, readonly
from symgen.errors import PlanError
from symgen.optimal import d_efficiency, optimum
from symgen.saturated import CANDIDATES, Merit, Search, candidates, maxvol, saturated

Effort = Literal["quick", "full"]

#: Tells which postures [m, n] an arm may hold: a mask [m].
Mask = Callable[[Array], NDArray[np.bool_]]

#: Left free at either end of a joint's range [rad, m], but no more than this part of it: a swing and a poor zero.
MARGIN, MARGIN_PART = 0.05, 0.05

#: Angles and slides of a plan are whole multiples of this [rad, m], so that a plan is the same on every machine.
ROUNDING = 1e-4

_WORKSPACE = 2000

_SEARCH = {"quick": Search(4, 12, 3, 25, 40), "full": Search(40, 150, 12, 60, 400)}


#: The search among feasible cells: steps [rad or m] around a plan that shrink, how many in all and at least for a cell,
#: other places for the joints that a cell does not depend on, and how many times d cells take part in an exchange.
_REACHES, _STEPS, _LEAST_STEPS, _OTHER_RESTS, _POOL = (1.5, 0.6, 0.3, 0.1, 0.03, 0.01), 360, 10, 5, 8

#: Rows of the feasible cells worse conditioned than this hardly tell the constants apart.
_SEEN = 1e-7


@dataclass(frozen=True)
class Design:
    """A posture plan: cell k excites joint `joint[k]` (from 0) at `q[k]`; cells run tip to base, the spare ones last.

    `amplification` [n] as in the module's docstring, `amplification_p999` its 99.9 % quantile over the workspace;
    `cond` [n] the condition number of each joint's own rows, columns whitened over the workspace; `d_efficiency` proven
    lower bound of (det / best possible det)^(1/d) per measurement for the cells without the spare ones,
    `d_efficiency_all` for all.
    """

    joint: NDArray[np.int64]
    q: Array
    spare: NDArray[np.bool_]
    amplification: Array
    amplification_p999: Array
    cond: Array
    d_efficiency: float
    d_efficiency_all: float


def box(limits: Array) -> Array:
    """Returns the joint intervals a plan may use [n, 2]: the limits less a margin, on whole multiples of `ROUNDING`."""
    low, high = limits.T
    inset = np.minimum(MARGIN, MARGIN_PART * (high - low))
    inner = np.stack([np.ceil((low + inset) / ROUNDING), np.floor((high - inset) / ROUNDING)], axis=1) * ROUNDING
    fits = inner[:, 0] <= inner[:, 1]
    return np.where(fits[:, None], inner, limits.mean(axis=1, keepdims=True))


def home(allowed: Array) -> Array:
    """Returns the resting posture [n]: zero where allowed, else the middle of the interval."""
    inside = (allowed[:, 0] <= 0) & (allowed[:, 1] >= 0)
    return np.where(inside, 0.0, np.round(allowed.mean(axis=1) / ROUNDING) * ROUNDING)


def _spare(
    rows: Rows, wider: Factoring, planned: Cells, pool: Cells, count: int, allowed: Array, feasible: Mask | None
) -> Cells:
    """Cells that discriminate: where a model with every inertial parameter free (`wider`) is least tied down so far.

    A plan of d cells fits its d constants without residual whatever is missing; the cells chosen here are those whose
    prediction by the wider model varies most, given the planned ones and a weak prior.
    """
    G, F = rows.of_cells(pool, of=wider), rows.of_cells(planned, of=wider)
    M = F.T @ F + 1e-2 * G.T @ G / len(G)
    chosen = planned[np.zeros(0, dtype=np.int64)]
    while len(chosen) < count and len(pool):
        leverage = np.einsum("Nd,de,Ne->N", G, np.linalg.inv(M), G, optimize=True)
        best = np.array([int(np.argmax(leverage))])
        cell = _held(rows.factoring.chain, pool[best], allowed, feasible)
        if len(cell):
            M += np.outer(G[best], G[best])
            chosen = chosen + cell
        else:
            pool, G = pool[np.arange(len(pool)) != best], np.delete(G, best, axis=0)
    return chosen


def _ordered(cells: Cells, start: Array) -> Cells:
    """The cells in the order to visit them: tip to base, within a joint always the nearest posture next."""
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


def _settled(chain: Chain, cells: Cells, allowed: Array) -> Cells:
    """The cells as they are run: whole turns taken off, rounded, the joints J_ii does not depend on (1..i) at rest."""
    turning = np.array([joint.type == REVOLUTE for joint in chain.joints])
    turned = cells.q - np.where(turning, 2 * np.pi * np.round(cells.q / (2 * np.pi)), 0.0)
    q = np.where((turned >= allowed[:, 0]) & (turned <= allowed[:, 1]), turned, cells.q)
    rest = home(allowed)
    settled = np.where(np.arange(chain.n) > cells.joint[:, None], np.round(q / ROUNDING) * ROUNDING, rest)
    return Cells(cells.joint, settled)


def _held(chain: Chain, cells: Cells, allowed: Array, feasible: Mask | None) -> Cells:
    """Those of the cells that the arm may hold, the joints J_ii does not depend on moved from rest where that helps."""
    settled = _settled(chain, cells, allowed)
    if feasible is None:
        return settled
    q, ok = settled.q.copy(), feasible(settled.q)
    others = np.round(spread(allowed, _OTHER_RESTS, 0.7) / ROUNDING) * ROUNDING
    joints = np.arange(chain.n)
    for own in (True, False):  # first the excited joint alone, then all that do not matter
        for other in others:
            bad = np.flatnonzero(~ok)
            i = cells.joint[bad, None]
            moved = np.where(joints == i if own else joints <= i, other, q[bad])
            good = feasible(moved)
            q[bad[good]], ok[bad[good]] = moved[good], True
    return Cells(cells.joint, q)[ok]


def _repaired(rows: Rows, cells: Cells, pool: Cells, allowed: Array, feasible: Mask) -> Cells:
    """As good a plan as exchange finds among feasible cells, near `cells` [d] and from the pool.

    Raises PlanError when the feasible cells do not determine all constants.
    """
    chain = rows.factoring.chain
    merit = Merit(rows)
    count = max(_STEPS // len(cells), _LEAST_STEPS)
    near, options = cells, _promising(rows, cells + pool, _POOL)
    for k, reach in enumerate(_REACHES):
        steps = spread(np.array([[-reach, reach]] * chain.n), count, 0.31 * (k + 1))
        q = np.clip((near.q[:, None, :] + steps).reshape(-1, chain.n), *allowed.T)
        options = _held(chain, options + Cells(np.repeat(near.joint, count), q), allowed, feasible)
        options = _promising(rows, options, _POOL)
        near = options = options[merit.exchanged(rows.of_cells(options), np.arange(rows.factoring.d))]
    return near


def _promising(rows: Rows, cells: Cells, times: int) -> Cells:
    """The cells of a good exchange [d], then `times` d of those that could replace them. PlanError if they are too few."""
    d = rows.factoring.d
    F = rows.of_cells(cells)
    if len(F) < d or np.linalg.cond(F / np.linalg.norm(F, axis=0)) * _SEEN > 1:
        raise PlanError(
            f"{rows.factoring.chain.name}: the postures the arm may hold (gravity, self-collision) do not determine all {d} "
            "constants; expected wider effort limits or smaller collision shapes; --no-feasible plans without them"
        )
    even = F @ np.linalg.inv(np.linalg.qr(F, mode="r"))
    start = maxvol(even)
    leverage = ((even @ np.linalg.inv(even[start])) ** 2).sum(axis=1)
    leverage[start] = 0.0
    return cells[np.concatenate([start, np.argsort(-leverage, kind="stable")[: times * d]])]


def plan(
    factoring: Factoring,
    wider: Factoring,
    *,
    rotor: Array | None = None,
    spare: int | None = None,
    effort: Effort = "quick",
    feasible: Mask | None = None,
) -> Design:
    """Returns d cells (i, q) and `spare` more (default a quarter of d), with what they achieve.

    `wider` is the factoring of the same chain without believed zeros (or `factoring` itself), `rotor` [n, kg m2, joint
    side] the reflected motor inertias N^2 J_m where known. `effort` "quick" takes a fraction of a second, "full" some
    seconds, for a better plan and a closer bound. `feasible` tells which postures [m, n] the arm may hold (a mask [m]);
    the certificate is against plans that need not care.

    Raises PlanError when no postures within the limits, or no feasible ones, determine all constants.
    """
    chain, d = factoring.chain, factoring.d
    rows = Rows(factoring, np.zeros(chain.n) if rotor is None else rotor)
    allowed = box(chain.limits)
    search = _SEARCH[effort]
    first, start = candidates(rows, allowed)
    best = optimum(rows, allowed, start, search.rounds)
    cells = saturated(rows, first, best, allowed, search)
    pool = best.cells + every_joint(spread(allowed, CANDIDATES, 0.5))
    held = _held(chain, cells, allowed, feasible)
    if feasible is not None and len(held) < d:
        held = _repaired(rows, cells, pool, allowed, feasible)
    more = _spare(rows, wider, held, pool, int(np.ceil(d / 4)) if spare is None else spare, allowed, feasible)
    both = _ordered(held, home(allowed)) + _ordered(more, home(allowed))
    return judged(rows, both.joint, both.q, np.arange(len(both)) >= d, allowed, best.log_det_bound)


def certificate(rows: Rows, F: Array, allowed: Array, effort: Effort = "quick") -> float:
    """Returns a lower bound of the D-efficiency of the rows F [N, d] among all designs, of any size, in the box [n, 2]."""
    return d_efficiency(F, _log_det_bound(rows, allowed, effort))


def _log_det_bound(rows: Rows, allowed: Array, effort: Effort) -> float:
    return optimum(rows, allowed, candidates(rows, allowed)[1], _SEARCH[effort].rounds).log_det_bound


def judged(
    rows: Rows,
    joint: NDArray[np.int64],
    q: Array,
    spare: NDArray[np.bool_],
    allowed: Array,
    log_det_bound: float | None = None,
) -> Design:
    """Returns the design with its amplification, conditioning and certificate, whoever chose the cells.

    Amplification and whitening are taken over the whole joint limits, the certificate over the box `allowed` [n, 2];
    `log_det_bound` as of `optimal.optimum`, which is called where it is not given.
    """
    n = q.shape[1]
    if log_det_bound is None:
        log_det_bound = _log_det_bound(rows, allowed, "quick")
    everywhere = rows(spread(rows.factoring.chain.limits, _WORKSPACE, 0.123))
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
            [float(np.linalg.cond((needed @ whiten)[own == i])) if (own == i).any() else 0.0 for i in range(n)]
        ),
        d_efficiency=d_efficiency(needed, log_det_bound),
        d_efficiency_all=d_efficiency(F, log_det_bound),
    )
