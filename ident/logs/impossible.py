"""What no arm has: inertia below zero at some posture, rotors and payloads of negative mass. A fit that needs it explains nothing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ident.logs.terms import Term
from ident.records.log import Array, Log
from symgen.plan import Model

#: Random postures at which J(q) is looked at, and their seed.
POSTURES, SEED = 300, 2
#: Standard deviations below zero from which on a number is negative.
BELOW = 2.0


def impossible(
    log: Log, model: Model, alpha: Array, covariance: Array, terms: Iterable[tuple[Term, Array, Array]]
) -> Iterator[tuple[Term | None, str]]:
    """Yields what no arm has: of the constants `alpha` [D] with their `covariance` (None), or of one of the `terms`, each with its coefficients and
    their covariance."""
    q = model.random_postures(POSTURES, np.random.default_rng(SEED))
    rows = np.moveaxis(np.diagonal(model.J_rows(q), axis1=1, axis2=2), -1, 1)  # [P, n, D]
    J = rows @ alpha
    std = np.sqrt(np.maximum(np.einsum("pid,de,pie->pi", rows, covariance, rows), 0.0))
    for j, name in enumerate(log.joints):
        worst = int(np.argmin(J[:, j] + BELOW * std[:, j]))
        if J[worst, j] + BELOW * std[worst, j] < 0.0:
            unit = "kg" if model.chain.slides(j) else "kg m2"
            yield None, f"J_{j + 1}{j + 1} of {name} would be {J[worst, j]:.3g} {unit} at some posture"
    for term, x, spread in terms:
        value, above = float(x[0]), float(x[0]) + BELOW * float(np.sqrt(spread[0, 0]))
        if term.name == "motor-inertia" and term.joint is not None:
            declared, gear = log.J_m[term.joint], float(log.N[term.joint]) ** 2
            least = float(declared) if np.isfinite(declared) else float(np.max(J[:, term.joint])) / gear
            if least + above < 0.0:
                what = "its motor's inertia" if np.isfinite(declared) else "all inertia that it moves"
                yield term, f"{what} at {log.joints[term.joint]} would be {least + value:.3g} kg m2 (motor side)"
        elif term.name == "payload" and above < 0.0:
            yield term, f"the payload would be {value:.3g} kg"
