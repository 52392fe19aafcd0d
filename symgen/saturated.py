"""Plans of d cells: what they are made of, their merit, and how it is raised by exchange and by moving the postures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from symgen.ascent import climbed
from symgen.cells import Cells, Rows, every_joint, ranked, spread, steady
from symgen.chain import Array
from symgen.errors import PlanError
from symgen.holding import Holding

#: Postures from which the search starts, and those over which it takes the amplification and its tail.
CANDIDATES, _WORKSPACE, _WIDE = 500, 500, 1000

#: An exchange must raise the determinant, or the merit, by more than this factor.
_EXCHANGE_GAIN = 1.001

#: A chosen row is not looked at for exchange with one that leaves less than this part of the determinant.
_LEAST_PART = 0.3

#: A combination of constants that postures show less than this, relative to the one they show best, is not measurable.
_SEEN = 1e-6

#: A column counts in full down to this part of the magnitudes behind it; rounding, 1e-15 of them, is then not `_SEEN`.
_IN_FULL = 1e-8

#: Power of det(F' F)^(1/d) for one of the worst amplification: what is good for all constants, and for J_ii(q).
_DET_POWER = 6

#: Exponent of the smooth maximum over the joints.
_SHARPNESS = 8

#: Plans whose amplification exceeds the first of these, or the second at one posture in a thousand, are worth less, by so much.
_WORST, _TAIL, _WORSE = 1.12, 1.55, 5.0

#: Steps of one stretch of the refinement, and the gain of merit below which it is over.
_STRETCH, _STALLED = 30, 3e-4

#: How many times d cells are kept to start from.
_OPTIONS = 8


#: Where not all postures are feasible: reaches [rad, m] and number of the steps to all sides of each cell for which it may
#: be exchanged, after each stretch.
_REACHES, _SIDES = (0.3, 0.1, 0.03, 0.01), 12
_WORTH_IT = 1.0


def candidates(rows: Rows, holding: Holding) -> Cells:
    """Returns feasible cells of high variance among evenly spread postures, d of large determinant first.

    Raises PlanError when the postures within the box, or the feasible ones, do not tell all constants apart.
    """
    d, chain, allowed = rows.factoring.d, rows.factoring.chain, holding.allowed
    everywhere = every_joint(spread(allowed, CANDIDATES, 0.5))
    F = rows.of_cells(everywhere)
    rank = _rank(F, rows, everywhere)
    if rank < d:
        k = int(np.argmin(allowed[:, 1] - allowed[:, 0]))
        raise PlanError(
            f"{chain.name}: postures within the joint limits tell only {rank} of {d} constants apart; expected wider limits, "
            f"or joints that hardly move frozen (narrowest: {chain.names[k]}, {allowed[k, 1] - allowed[k, 0]:.3g} rad or m)"
        )
    few = everywhere[_telling(F, everywhere.joint)[: _OPTIONS * d]]
    if holding.feasible is None:
        return few
    for some in (few, everywhere + every_joint(spread(allowed, 3 * CANDIDATES, 0.123)), None):
        if some is None:  # as they stand, no joint moved to rest
            cells = every_joint(holding.found(CANDIDATES))
        else:
            passed, placed = holding.placed(some)
            cells = placed[passed]
        F = rows.of_cells(cells)
        rank = _rank(F, rows, cells)
        if rank == d:
            return cells[_telling(F, cells.joint)[: _OPTIONS * d]]
    raise PlanError(
        f"{chain.name}: the postures the arm may hold (gravity, self-collision) tell only {rank} of {d} "
        "constants apart; expected wider effort limits or smaller collision shapes; --no-feasible plans without them"
    )


def maxvol(F: Array, first: int | None = None) -> NDArray[np.int64]:
    """Returns d rows of F [N, d], of full rank, with a locally largest determinant: greedy pivots, then exchanges.

    The greedy part begins with row `first`, or the longest. (Fedorov's exchange, for as many rows as constants.)
    """
    d = F.shape[1]
    left = F.copy()
    chosen: list[int] = []
    for k in range(d):
        row = first if first is not None and k == 0 else _first_largest(np.einsum("nd,nd->n", left, left))
        direction = left[row] / np.linalg.norm(left[row])
        left -= np.outer(left @ direction, direction)
        chosen.append(row)
    B = F @ np.linalg.inv(F[chosen])
    while True:
        row, column = divmod(_first_largest(np.abs(B)), d)
        if abs(B[row, column]) < _EXCHANGE_GAIN:
            return np.array(chosen)
        swap = B[row].copy()
        swap[column] -= 1
        B -= np.outer(B[:, column], swap / B[row, column])
        chosen[column] = row


def _first_largest(values: Array) -> int:
    """Where the largest value is; mirror images tie in single precision, and the first is taken on every machine."""
    return int(np.argmax(values.astype(np.float32)))


class Merit:
    """How good d cells are: log of det(F' F)^(power/d) / worst amplification, the worst joint as a smooth maximum."""

    def __init__(self, rows: Rows, power: float = _DET_POWER):
        self._power = power
        limits = rows.factoring.chain.limits
        some = rows(spread(limits, _WORKSPACE, 0.123))
        self.moments = np.einsum("mid,mie->ide", some, some, optimize=True) / _WORKSPACE
        self._everywhere = rows(spread(limits, _WIDE, 0.456))

    def __call__(self, F: Array) -> float:
        """The merit of the rows F [d, d]."""
        return self.with_slope(F)[0]

    def of_choice(self, F: Array) -> float:
        """The merit of the rows F [d, d] to choose between plans by, rounded: less where the amplification is large."""
        variance = ((self._everywhere @ np.linalg.inv(F)) ** 2).sum(axis=2)
        worst = float(np.sqrt(variance.mean(axis=0).max()))
        tail = float(np.sqrt(np.quantile(variance, 0.999, axis=0).max()))
        return round(self(F) - _WORSE * (max(worst - _WORST, 0.0) + max(tail - _TAIL, 0.0)), 6)

    def with_slope(self, F: Array) -> tuple[float, Array]:
        """The merit of the rows F [d, d] and its derivative [d, d]. Raises LinAlgError if F is singular."""
        d = len(F)
        G = np.linalg.inv(F)
        power = np.einsum("ide,de->i", self.moments, G @ G.T)
        share = (power / power.max()) ** _SHARPNESS
        worst = power.max() * share.sum() ** (1 / _SHARPNESS)
        M = np.einsum("i,ide->de", share / power / share.sum(), self.moments)
        value = 2 * self._power / d * float(np.linalg.slogdet(F)[1]) - np.log(worst) / 2
        return value, 2 * self._power / d * G.T + G.T @ M @ G @ G.T

    def exchanged(self, F: Array, chosen: NDArray[np.int64]) -> NDArray[np.int64]:
        """Returns d of the rows F [N, d]: `chosen` after the exchanges that raise the merit most, until none does."""
        chosen = chosen.copy()
        d = F.shape[1]
        while True:
            G = np.linalg.inv(F[chosen])
            B = F @ G  # row r in place of chosen row c: the determinant times B_rc
            K = G.T @ self.moments @ G
            factor = np.where(np.abs(B) > _LEAST_PART, B, np.inf)
            own = np.einsum("icc->ic", K)[:, None, :]
            others = own.sum(axis=2, keepdims=True) - own - 2 * (B @ K - B * own) / factor
            power = others + own * ((B**2).sum(axis=1, keepdims=True) - B**2 + 1) / factor**2
            gain = np.full(B.shape, -np.inf)
            open_ = np.isfinite(factor)
            gain[open_] = 2 * self._power / d * np.log(np.abs(B[open_])) - np.log(power.max(axis=0)[open_]) / 2
            gain += np.log(own.sum(axis=2).max()) / 2
            row, column = divmod(_first_largest(gain), d)
            if gain[row, column] < np.log(_EXCHANGE_GAIN):
                return chosen
            chosen[column] = row


def _telling(F: Array, joint: NDArray[np.int64]) -> NDArray[np.int64]:
    """The rows of F [N, d] in order: d of large determinant, then of each joint in turn the one that would add most."""
    even = F @ np.linalg.inv(np.linalg.qr(F, mode="r"))
    chosen = maxvol(even)
    leverage = ((even @ np.linalg.inv(even[chosen])) ** 2).sum(axis=1)
    leverage[chosen] = -1.0
    order = ranked(leverage)[: len(F) - len(chosen)]
    turn = np.empty(len(order), dtype=np.int64)
    for i in range(joint.max() + 1):
        own = joint[order] == i
        turn[own] = np.arange(own.sum())
    return np.concatenate([chosen, order[np.argsort(turn, kind="stable")]])


def _rank(F: Array, rows: Rows, cells: Cells) -> int:
    """How many combinations of constants the cells show, whose rows F [N, d] are."""
    if not len(cells):
        return 0
    scale = np.maximum(np.linalg.norm(F, axis=0), _IN_FULL * rows.sizes(cells))
    values = np.linalg.svd(F / np.maximum(scale, 1e-300), compute_uv=False)
    return int((values > _SEEN * values[0]).sum())


def refined(rows: Rows, merit: Merit, cells: Cells, holding: Holding, steps: int) -> Cells:
    """Returns the d cells with their postures moved within the box up the merit, by at most `steps` quasi-Newton steps.

    In stretches: where not all postures are feasible each cell goes as far towards its aim as it may, and to a feasible
    place beside it where that is better; then all aim again.
    """
    stretch = _STRETCH if holding.feasible is None else _STRETCH // 2
    best, reached = cells, merit(rows.of_cells(cells))
    for k in range(-(-steps // _STRETCH)):
        before = reached
        cells = holding.towards(cells, _climbed(rows, merit, cells, holding.allowed, min(stretch, steps)))
        for reach in () if holding.feasible is None else _REACHES:
            cells = _beside(rows, merit, cells, holding, reach, 0.31 * (k + 1) % 1.0)
        value = merit(rows.of_cells(cells))
        if value > reached:
            best, reached = cells, value
        if reached < before + _STALLED:
            break
    return best


def _beside(rows: Rows, merit: Merit, cells: Cells, holding: Holding, reach: float, offset: float) -> Cells:
    """The cells after exchanges for feasible ones within `reach` of them: a way along the walls."""
    d, n = cells.q.shape
    own, moves = np.repeat(np.arange(d), _SIDES), spread(np.tile([-reach, reach], (n, 1)), _SIDES, offset)
    moves = np.where(np.arange(n) > cells.joint[:, None, None], moves, 0.0)
    near = Cells(cells.joint[own], (cells.q[:, None] + moves).reshape(-1, n))
    near = Cells(near.joint, np.clip(steady(near.q), *holding.allowed.T))
    alone = (rows.of_cells(near) * np.linalg.inv(rows.of_cells(cells)).T[own]).sum(axis=1)
    near = near[np.abs(alone) > _WORTH_IT]
    options = cells + near[holding.keeps(near)]
    return options[merit.exchanged(rows.of_cells(options), np.arange(d))]


def _climbed(rows: Rows, merit: Merit, cells: Cells, allowed: Array, steps: int) -> Cells:
    def hill(x: Array) -> tuple[float, Array] | None:
        F, slope = rows.traced(Cells(cells.joint, x.reshape(cells.q.shape)))
        try:
            value, by_row = merit.with_slope(F)
        except np.linalg.LinAlgError:  # a step too far put two cells on one corner of the box
            return None
        return value, slope(by_row).ravel()

    low, high = np.tile(allowed, (len(cells), 1)).T
    x = climbed(hill, cells.q.ravel(), low, high, steps)
    return Cells(cells.joint, np.clip(steady(x).reshape(cells.q.shape), *allowed.T))
