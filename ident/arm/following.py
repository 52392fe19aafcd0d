"""The descent of a model whose forces follow from its motion, with derivatives for which that motion is found anew.

`minimise` holds motions while it goes down, and makes them anew where it ends: a spring that hardens by as much as it is stiff answers
a change by more than that, and each end may lead away from the last. Gauss-Newton with the derivatives as they are does not.
"""

from __future__ import annotations

from collections.abc import Sequence

from ident.arm.arm_fit import Problem
from ident.arm.descent import Minimum, stepped
from ident.arm.sums import summed
from ident.records.campaign import Array

#: Steps at most, and tries of each; damping of the first, and by what it changes.
STEPS, TRIALS, DAMPING, TIMES = 10, 6, 1e-3, 10.0


def follow(problem: Problem, vector: Array, joints: Sequence[int], roughly: float) -> Minimum:
    """Levenberg-Marquardt from `vector` [P] with motions and weights made anew at every step, until chi^2 falls by less than the share
    `roughly`; so are motions for the derivatives by effects and what is at `joints`, by differences, but not for those by the others."""
    n = problem.n
    which = [
        k
        for k in (*range(4 * n), *range(problem.base, len(vector)))
        if problem.free[k] and (k >= 4 * n or k % n in joints)
    ]
    with summed(problem) as sums:
        sums.hold(vector)
        chi2, slope, information = sums.following(vector, which, joints)
        damping, converged = DAMPING, False
        for _ in range(STEPS):
            for _ in range(TRIALS):
                trial = stepped(problem, vector, slope, information, damping)
                sums.hold(trial)
                left = sums.chi_squared(trial)
                if left < chi2 or problem.late:
                    break
                damping *= TIMES
            if not left < chi2:
                sums.hold(vector)
                break
            fell, vector, damping = chi2 - left, trial, damping / TIMES
            converged = fell < roughly * chi2
            chi2, slope, information = sums.following(vector, which, joints)
            if converged or problem.late:
                break
        return Minimum(vector, information, chi2, converged, sums.slid)
