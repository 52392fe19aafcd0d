"""Plans that no exchange betters: some of their cells are replaced at random, and exchange goes on from there.

Local optima of a plan of d cells are many, and the better ones lie near each other: what is found from a good plan with a few
cells changed is better than what is found from anywhere. (Iterated local search, H. R. Lourenco, O. C. Martin and
T. Stuetzle, DOI 10.1007/0-306-48056-5_11.)
"""

from __future__ import annotations

import numpy as np

from symgen.cells import Cells, Rows
from symgen.chain import Array
from symgen.optimal import Optimum, d_efficiency
from symgen.saturated import Merit
from symgen.search import Better

#: D-efficiency that is enough.
ENOUGH = 0.9

#: Power of the determinant in the merit of the plans compared here (`saturated.Merit`).
POWER = 30

#: Kicks at once, the best of which is taken, and how often at most.
_AT_ONCE, _ROUNDS = 4, 40

#: Cells replaced by one kick, at most; steps and sweeps after it.
_REPLACED, _STEPS, _SWEEPS = 5, 30, 3


def enough(rows: Rows, merit: Merit, plan: Cells, best: Optimum, better: Better) -> Cells:
    """Returns the d cells of `plan` kicked towards others until their D-efficiency is certified to be `ENOUGH`, or for
    `_ROUNDS`. They are feasible, if `plan` and the cells of the spread `best` are, and `better` keeps them so."""
    random = np.random.default_rng(0)
    F = rows.of_cells(plan)
    for _ in range(_ROUNDS):
        if d_efficiency(F, best.log_det_bound) >= ENOUGH:
            break
        kicked = better([_kicked(rows, plan, best.cells, random) for _ in range(_AT_ONCE)], _STEPS, _SWEEPS)
        plan = max([plan, *kicked], key=lambda cells: merit.of_choice(rows.of_cells(cells)))
        F = rows.of_cells(plan)
    return plan


def _kicked(rows: Rows, plan: Cells, options: Cells, random: np.random.Generator) -> Cells:
    """The plan with some of its cells replaced by some of `options`, likelier those that leave the determinant large."""
    d = len(plan)
    out = random.choice(d, random.integers(1, _REPLACED + 1), replace=False)
    cells = plan[np.setdiff1d(np.arange(d), out)]
    missing: Array = np.linalg.qr(rows.of_cells(cells).T, mode="complete")[0][:, len(cells) :]
    left = rows.of_cells(options) @ missing  # what each option shows of the constants that the others do not
    for _ in out:
        chance = (left**2).sum(axis=1) ** 2
        row = random.choice(len(left), p=chance / chance.sum())
        cells = cells + options[np.array([row])]
        direction = left[row] / np.linalg.norm(left[row])
        left = left - np.outer(left @ direction, direction)
    return cells
