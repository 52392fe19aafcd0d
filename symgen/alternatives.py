"""Plans of other kinds: the user's own postures, whole multiples of an angle, and the paper's triangular plan.

Each returns cells and which of them are spare; `judgement` says what they achieve.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symgen.basis import Factoring
from symgen.cells import Cells, Rows, every_joint, spread
from symgen.chain import REVOLUTE, Array, Chain
from symgen.errors import NoPlanError, PlanError
from symgen.holding import ROUNDING, Holding, Mask, box, home
from symgen.judgement import undetermined
from symgen.postures import Effort, ordered, plan, spare_cells
from symgen.regressor import C_rows
from symgen.saturated import CANDIDATES, Merit, maxvol
from symgen.urdf_xml import MAX_NUMBER

#: Cells, and which of them [N] are spare.
Selection = tuple[Cells, NDArray[np.bool_]]
#: Chooses cells from the rows of an arm, its factoring without believed zeros, and what tells feasible postures.
Chooser = Callable[[Rows, Factoring, Mask | None], Selection]

#: Other places tried for the joints that a cell does not depend on, where the arm may not hold it with them at rest; most
#: of them are postures it may hold, among so many looked at.
_OTHER_RESTS, _LOOKED_AT = 5, 200

_UNITS = {"deg": np.pi / 180, "rad": 1.0, "mm": 1e-3, "cm": 1e-2, "m": 1.0}
#: Multiples of this for slides [m] where only an angle is given.
_SLIDE = 0.01
#: The finest grid [rad, m]: that of all other plans.
_FINEST = ROUNDING
#: Rounds of exchange on a grid, neighbours drawn for each cell in a round, and the gain of merit that is worth a round.
_ROUNDS, _NEIGHBOURS, _GAIN = 12, 12, 1e-6

#: Angles tried for a triangular plan [deg], the finest whose grid has no more postures than this.
_ANGLES, _MOST_POSTURES, _CHUNK = (45, 90, 180), 200_000, 10_000
#: Coefficients are products of cosines; below this they are rounding of zero, as close to 1 they are 1.
_EXACT = 1e-9


# The user's own ------------------------------------------------------------------------------------------------------


def given(path: str | Path, chain: Chain) -> Selection:
    """Returns the cells of a file: CSV with one cell a line (joint name, q1, .., qn in rad or m; `#` begins a remark, a
    first line of "joint" and no number is a heading), JSON with a list of {"joint": .., "q": [..]}, or a plan.json.

    Raises PlanError, one line naming file and line or cell, for anything else; OSError.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
        found = _of_json(json.loads(text)) if text.lstrip()[:1] in ("[", "{") else _of_csv(text)
        cells = [(where, joint, [float(x) for x in q], spare) for where, joint, q, spare in found]
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        problem = " ".join(f"{type(error).__name__} {error}".split())
        raise PlanError(
            f"{path}: not a file of postures: {problem}; expected lines of joint name, q1, .., or JSON"
        ) from None
    if not cells:
        raise PlanError(f"{path}: no posture; expected lines of joint name, q1, .., or JSON")
    for where, joint, q, _ in cells:
        if wrong := misfit(chain, joint, q):
            raise PlanError(f"{path}: {where}: joint {joint!r} at {len(q)} values; {wrong}")
    joints = np.array([chain.names.index(joint) for _, joint, _, _ in cells], dtype=np.int64)
    return Cells(joints, np.array([q for _, _, q, _ in cells])), np.array([spare for *_, spare in cells], dtype=bool)


def misfit(chain: Chain, joint: str, q: ArrayLike) -> str:
    """Returns what is expected of a cell that can be none of this arm; "" for one that can."""
    if joint in chain.names and np.shape(q) == (chain.n,) and np.all(np.abs(q) <= MAX_NUMBER):  # nan is not
        return ""
    return f"expected one of {', '.join(chain.names)} at {chain.n} finite numbers up to {MAX_NUMBER:g}"


def _of_json(document: Any) -> list[tuple[str, str, list[Any], bool]]:
    cells = list(enumerate(document if isinstance(document, list) else document["plan"]["cells"], 1))
    if wrong := [k for k, cell in cells if not isinstance(cell["q"], list)]:
        raise TypeError(f"cell {wrong[0]}: q is no list")
    return [(f"cell {k}", cell["joint"], cell["q"], cell.get("spare") is True) for k, cell in cells]


def _of_csv(text: str) -> list[tuple[str, str, list[Any], bool]]:
    lines = ((k, line.partition("#")[0].strip()) for k, line in enumerate(text.splitlines(), 1))
    rows = [(k, [field.strip().strip('"') for field in line.split(",")]) for k, line in lines if line]
    if rows and rows[0][1][0].lower() == "joint" and not any(map(_is_number, rows[0][1][1:])):
        del rows[0]
    out = []
    for k, (joint, *values) in rows:
        try:
            out.append((f"line {k}", joint, [float(value) for value in values], False))
        except ValueError:
            raise ValueError(f"line {k}: {','.join(values)[:60]!r} are not all numbers") from None
    return out


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _with_spare(
    rows: Rows, wider: Factoring, planned: Cells, pool: Cells, count: int | None, start: Array
) -> Selection:
    """The planned cells, then `count` (default a quarter) of the pool that discriminate, in the order to visit them."""
    count = int(np.ceil(len(planned) / 4)) if count is None else count
    both = planned + ordered(spare_cells(rows, wider, planned, pool, count), start)
    return both, np.arange(len(both)) >= len(planned)


# Multiples of an angle -----------------------------------------------------------------------------------------------


def grid_steps(text: str, chain: Chain) -> Array:
    """Returns the step of each joint [n, rad or m] of a grid such as "15deg" or "15deg,5mm" (slides: 1 cm unless given).

    Raises PlanError for any other text.
    """
    number = r"\s*(\d+\.?\d*|\.\d+)\s*"
    found = re.fullmatch(f"{number}(deg|rad)\\s*(?:,{number}(mm|cm|m)\\s*)?", text, re.ASCII)
    turn = float(found[1]) * _UNITS[found[2]] if found else 0.0
    slide = float(found[3]) * _UNITS[found[4]] if found and found[3] else _SLIDE
    if not (_FINEST <= turn <= np.pi and _FINEST <= slide <= 1e3):
        raise PlanError(
            f"--grid {text!r}: expected an angle of {_FINEST:g} rad to 180 deg, perhaps with a slide of at least {_FINEST:g} m, "
            "such as 15deg or 15deg,5mm"
        )
    return np.array([turn if joint.type == REVOLUTE else slide for joint in chain.joints])


def gridded(
    rows: Rows,
    wider: Factoring,
    feasible: Mask | None,
    *,
    grid: str,
    spare: int | None = None,
    effort: Effort = "quick",
) -> Selection:
    """Returns a plan whose joint values are all whole multiples of the steps in `grid` (see `grid_steps`).

    Exchange among the multiples near the best plan that knows no grid, over the whole range at first, then around the plan
    found until its merit rises no more. `spare` and `effort` as in `postures.plan`, whose errors are raised; NoPlanError
    when the postures on the grid do not determine all constants, or a joint has no multiple within its range.
    """
    chain = rows.factoring.chain
    lattice = _Lattice(chain, grid_steps(grid, chain), feasible, grid)
    free = plan(rows.factoring, wider, rotor=rows.rotor, spare=spare, effort=effort, feasible=feasible)
    wide = every_joint(spread(lattice.allowed, CANDIDATES, 0.5))
    merit, reached = Merit(rows), -np.inf
    pool = options = lattice.held(Cells(free.joint, free.q) + wide)
    chosen = _independent(rows, options, f"{chain.name}: postures on multiples of {grid}")
    for k in range(_ROUNDS):
        F = rows.of_cells(options)
        chosen = merit.exchanged(F, chosen)
        best, value = options[chosen], merit(F[chosen])
        if value - reached < _GAIN:
            break
        reached = value
        options = best + lattice.held(lattice.around(best, 0.31 * (k + 1)))
        chosen = np.arange(len(best))
    return _with_spare(rows, wider, ordered(best, lattice.rest), pool, spare, lattice.rest)


class _Lattice:
    """The postures on whole multiples of `step` [n] within the limits: rounding to them, and the neighbours of cells."""

    def __init__(self, chain: Chain, step: Array, feasible: Mask | None, grid: str):
        self.step, self.feasible = step, feasible
        inside = box(chain.limits)
        self.low, self.high = np.ceil(inside[:, 0] / step - 1e-9), np.floor(inside[:, 1] / step + 1e-9)
        for k in np.flatnonzero(self.low > self.high).tolist():
            raise NoPlanError(
                f"{chain.name}: {chain.names[k]}: no multiple of {step[k]:.6g} rad or m (--grid {grid}) within "
                f"{inside[k, 0]:.4g} .. {inside[k, 1]:.4g}; expected a finer grid or wider limits"
            )
        self.allowed = np.stack([self.low, self.high], axis=1) * step[:, None]
        self.rest = self.rounded(home(inside))
        self.others = rests(self.rounded(spread(self.allowed, _LOOKED_AT, 0.7)), feasible)

    def rounded(self, q: Array) -> Array:
        """The nearest multiples."""
        nearest: Array = np.clip(np.round(q / self.step), self.low, self.high) * self.step
        return nearest + 0.0

    def held(self, cells: Cells) -> Cells:
        """The distinct cells on the lattice near the given ones that the arm may hold."""
        q = self.rounded(cells.q)
        q = np.where(np.arange(q.shape[1]) > cells.joint[:, None], q, self.rest)
        _, first = np.unique(np.column_stack([cells.joint, np.round(q / self.step)]), axis=0, return_index=True)
        distinct = Cells(cells.joint[np.sort(first)], q[np.sort(first)])
        return holdable(distinct, self.others, self.feasible)

    def around(self, cells: Cells, offset: float) -> Cells:
        """Cells one step away along each joint, and some up to two steps away in all."""
        n = cells.q.shape[1]
        far = spread(np.tile([-2.0, 2.0], (n, 1)), _NEIGHBOURS, offset % 1.0)
        moves = np.concatenate([np.eye(n), -np.eye(n), np.round(far)]) * self.step
        return Cells(np.repeat(cells.joint, len(moves)), (cells.q[:, None] + moves).reshape(-1, n))


def rests(q: Array, feasible: Mask | None) -> Array:
    """Returns where to try the joints that a cell does not depend on: the first few of q [m, n], then of those that are
    `feasible` as they stand."""
    held = q if feasible is None else q[feasible(q)]
    return np.concatenate([q[:_OTHER_RESTS], held[:_OTHER_RESTS]])


def holdable(cells: Cells, others: Array, feasible: Mask | None) -> Cells:
    """Returns the cells that are feasible, the joints J_ii does not depend on moved to one of `others` [m, n] if need be:
    the excited one alone, or all of them."""
    if feasible is None or not len(cells):
        return cells
    q, ok = cells.q.copy(), feasible(cells.q)
    joints, own = np.arange(q.shape[1]), cells.joint[:, None]
    for moving, other in product((joints == own, joints <= own), others):
        bad = np.flatnonzero(~ok)
        if not len(bad):
            break
        moved = np.where(moving[bad], other, q[bad])
        good = feasible(moved)
        q[bad[good]], ok[bad[good]] = moved[good], True
    return Cells(cells.joint, q)[ok]


def _independent(rows: Rows, cells: Cells, what: str) -> NDArray[np.int64]:
    """d of the cells, well told apart. NoPlanError, beginning with `what`, if they determine fewer constants."""
    d = rows.factoring.d
    rank, open_ = undetermined(rows, cells) if len(cells) else (0, rows.factoring.names[:d])
    if rank < d:
        raise NoPlanError(
            f"{what} determine only {rank} of {d} constants (open: {', '.join(open_)}); expected a finer grid"
        )
    F = rows.of_cells(cells)
    return maxvol(F @ np.linalg.inv(np.linalg.qr(F, mode="r")))


# The paper's kind of plan --------------------------------------------------------------------------------------------


def triangular(rows: Rows, wider: Factoring, feasible: Mask | None, *, spare: int | None = None) -> Selection:
    """Returns a plan as the paper's POS1..POS3: for each joint, tip to base, as many postures as it has new constants, in
    an order in which each shows one more of them, with coefficient 1 (2 where the constant itself comes with a 2).

    Searched on multiples of 45 deg (90 or 180 where these are too many) and the ends of the ranges. Adding a usable posture
    never spoils another one, so that taking any finds a plan on this grid if there is one. Postures of joints further out
    are used again where they serve. Raises NoPlanError naming the joint that prevents such a plan.
    """
    factoring = rows.factoring
    allowed = box(factoring.chain.limits)
    found = Cells(np.zeros(0, dtype=np.int64), np.zeros((0, factoring.chain.n)))
    for i in reversed(range(factoring.chain.n)):
        new = [k for k, alpha in enumerate(factoring.alphas[: factoring.d]) if alpha.i == i]
        if new:
            found = found + _staircase(factoring, i, new, allowed, found.q, feasible)
    holding = Holding(factoring.chain, allowed, feasible)
    passed, pool = holding.placed(every_joint(spread(allowed, CANDIDATES, 0.5)))
    return _with_spare(rows, wider, found, found + pool[passed], spare, holding.rest)


def _staircase(
    factoring: Factoring, i: int, new: list[int], allowed: Array, used: Array, feasible: Mask | None
) -> Cells:
    """The postures of joint i, in the order in which they show its `new` constants one by one."""
    chain, (q, angle) = factoring.chain, _grid(factoring.chain, i, allowed)
    C = np.concatenate([C_rows(factoring, q[k : k + _CHUNK])[:, i] for k in range(0, len(q), _CHUNK)])
    there = np.abs(C) > _EXACT
    content = np.array([factoring.alphas[k].content for k in new])
    size = np.abs(C[:, new])
    unit = (np.abs(size - 1) < _EXACT) | (np.abs(size - content) < _EXACT)
    again = {np.round(row, 9).tobytes() for row in used}
    fresh = np.array([np.round(row, 9).tobytes() not in again for row in q])
    order = np.lexsort((np.round(np.abs(q).sum(axis=1), 9), there.sum(axis=1), fresh))
    others = rests(spread(allowed, _LOOKED_AT, 0.7), feasible)
    cells: list[Cells] = []
    left = list(range(len(new)))
    while left:
        usable = (there[:, new][:, left].sum(axis=1) == 1) & (there[:, new] & unit)[:, left].any(axis=1)
        rows = order[usable[order]]
        tried = (holdable(Cells(np.array([i]), q[[row]]), others, feasible) for row in rows)
        cell, row = next(((cell, row) for cell, row in zip(tried, rows, strict=False) if len(cell)), (None, None))
        if cell is None:
            names = ", ".join(factoring.alphas[new[k]].name for k in left)
            held = " that the arm may hold" if len(rows) else ""
            raise NoPlanError(
                f"{chain.name}: no triangular plan: {chain.names[i]}: no posture{held} on multiples of {angle} deg shows "
                f"just one of {names} with coefficient 1; expected a plan without --triangular"
            )
        cells.append(cell)
        left.remove(next(k for k in left if there[row, new[k]]))
    return Cells(np.concatenate([c.joint for c in cells]), np.concatenate([c.q for c in cells]))


def _grid(chain: Chain, i: int, allowed: Array) -> tuple[Array, int]:
    """All postures [m, n] on a grid for the joints beyond i, the others at rest, and the angle of the grid [deg]."""
    for angle in _ANGLES:
        values = [np.array([rest]) for rest in home(allowed)]
        for k in range(i + 1, chain.n):
            turning = chain.joints[k].type == REVOLUTE
            multiples = np.deg2rad(np.arange(-360, 361, angle)) if turning else np.array([-1.0, 0.0, 1.0])
            inside = multiples[(multiples >= allowed[k, 0]) & (multiples <= allowed[k, 1])]
            values[k] = np.union1d(inside, allowed[k])
        if np.prod([len(v) for v in values], dtype=float) <= _MOST_POSTURES:
            return np.array(list(product(*values))), angle
    raise NoPlanError(
        f"{chain.name}: no triangular plan: {chain.names[i]}: too many joints beyond it to try all postures"
    )
