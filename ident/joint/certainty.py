"""How well J(q) is known: what the uncertainty of the constants does to the matrix, and which combination of them does most.

A constant near zero may be known to no digit and matter to none; another may be known to a percent and spoil an entry. So a
constant is judged by the standard deviation of J_ij(q) over sqrt(J_ii J_jj), at postures all over the workspace.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.joint.solve import inertia_std
from ident.records.campaign import Array
from symgen.plan import Model

#: Postures at which J(q) is judged.
POSTURES = 400
#: An entry whose standard deviation is above this share of sqrt(J_ii J_jj) is hardly known.
HARDLY = 0.1
#: Constants named of a direction: those with at least this share of its largest component.
NAMED_SHARE, MOST_NAMED = 0.3, 3


@dataclass(frozen=True)
class Certainty:
    """`per_entry` [n, n]: largest standard deviation of J_ij(q) over sqrt(J_ii J_jj), infinite where it needs what was not
    measured. The `direction` [D] of the constants that adds most to it, alone up to `share`, mostly the constants `names`.
    """

    per_entry: Array
    direction: Array
    share: float
    names: tuple[str, ...]

    @property
    def worst(self) -> tuple[int, int]:
        """The entry known least (i, j from 0, i <= j)."""
        i, j = np.unravel_index(int(np.argmax(np.triu(self.per_entry))), self.per_entry.shape)
        return int(i), int(j)


def certainty(model: Model, covariance: Array, unseen: Array) -> Certainty:
    """Returns what `covariance` [D, D] of the constants, `unseen` [D, k] left out, means for J(q); sizes are CAD's."""
    q = model.random_postures(POSTURES, np.random.default_rng(0))
    rows = model.J_rows(q)
    size = np.sqrt(np.maximum(np.einsum("mii->mi", model.J_cad(q)), 1e-300))
    rows = rows / (size[:, :, None] * size[:, None, :])[..., None]
    per_entry = inertia_std(rows, covariance, unseen).max(axis=0)
    flat = rows.reshape(-1, rows.shape[-1])
    blind = np.eye(len(covariance)) - unseen @ unseen.T
    half = _root(blind @ covariance @ blind)
    strength, shapes = np.linalg.eigh(half.T @ (flat.T @ flat) @ half)
    direction = half @ shapes[:, -1] if strength[-1] > 0 else np.zeros(len(covariance))
    effect = np.abs(flat @ direction)
    weight = np.abs(direction) * np.sqrt(np.mean(flat**2, axis=0))
    order = np.argsort(-weight)
    named = [model.names[k] for k in order[:MOST_NAMED] if weight[k] >= NAMED_SHARE * weight[order[0]]]
    return Certainty(per_entry, direction, float(effect.max()), tuple(named))


def thin(found: Certainty) -> tuple[str, ...]:
    """One line for every entry of J(q) that is hardly known though measured, worst first, and for the direction behind it."""
    n = len(found.per_entry)
    poor = [
        (float(found.per_entry[i, j]), f"J_{i + 1}{j + 1}" if n < 10 else f"J_{i + 1}_{j + 1}")
        for i in range(n)
        for j in range(i, n)
        if HARDLY < found.per_entry[i, j] < np.inf
    ]
    lines = [
        f"{name} hardly known: standard deviation up to {100 * value:.2g} % of sqrt(J_ii J_jj)"
        for value, name in sorted(poor, reverse=True)
    ]
    if lines:
        lines.append(
            f"a thin direction of the constants, mostly {', '.join(found.names)}, alone moves J(q) by up to "
            f"{100 * found.share:.2g} %: measure a posture at which it shows"
        )
    return tuple(lines)


def _root(matrix: Array) -> Array:
    """A square root [D, D] of a positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
