"""Declared numbers that the records contradict: motor inertia, dampings, the links of the URDF, gravity.

The fit is free of all of them, so nothing is left over in its residual; what they came out as is held against what was
declared. Links are judged together: alpha and the gravity stiffness of a body that is not as declared change in a way
that its ten parameters allow, a payload in a way that a point mass at the last link allows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import chdtri

from ident.arm.arm_fit import Problem, spectrum
from ident.arm.arm_model import DRIVES
from ident.arm.descent import Minimum
from ident.effects.catalogue import CATALOGUE
from ident.records.campaign import Array, Campaign, Earlier
from ident.search.bodies import CHANCE, ROUNDING, Change, Part, any_body
from symgen.chain import Chain
from symgen.plan import Model

#: A number contradicts what was declared when it is this many standard deviations off, and more than the model is granted.
SIGMAS = 6.0
#: Share of a number in a direction that no record shows from which it is not known.
HIDDEN = 0.1
#: Share of a damping that is none, where none was declared: logarithms are fitted.
NONE = 1e-6
#: Several links are off, rather than one, when any one leaves more than so many times what chance does.
SEVERAL = 2.0
#: Which effect of the catalogue, of one parameter, a number of a drive is that is off.
NAMES = {"J_m": "motor-inertia", "D": "motor-viscous", "D_spring": "spring-damping"}
#: An accuracy is granted to a constant as though it were this share of the largest at least: a share of zero would grant none.
LEAST_CONSTANT = 1e-3
#: Variance along a direction that no record shows, in squares of its scale: so much that what lies there decides nothing.
UNKNOWN = 1e6


@dataclass(frozen=True)
class Granted:
    """The accuracy granted to the model: shares of the numbers of a drive, of J(q) where links change it, of each constant where
    bodies are compared (the last digits are not the bodies')."""

    J_m: float
    D: float
    D_spring: float
    J: float
    constants: float


#: Where no effect is needed to explain the records, and beside those that were found: their laws may bend these numbers.
ALONE = Granted(J_m=1e-3, D=1e-2, D_spring=5e-3, J=2e-4, constants=2e-5)
BESIDE = Granted(J_m=1e-2, D=0.1, D_spring=0.1, J=5e-3, constants=2e-3)


@dataclass(frozen=True, eq=False)
class Deviation:
    """A declared number that is off: a name of the catalogue, its joint (from 0; None: the arm), (parameter, value, std,
    unit) each, how many standard deviations off, the places (`indices` [k]) in the vector of the parameters that it changed and by
    how much (`change` [k]): taken off, it is undone.

    `tied` are other (name, joint) that explain it as well.
    """

    name: str
    joint: int | None
    values: tuple[tuple[str, float, float, str], ...]
    sigmas: float
    indices: NDArray[np.int64]
    change: Array
    tied: tuple[tuple[str, int | None], ...] = ()


def deviations(
    campaign: Campaign, model: Model, basis: Array, problem: Problem, found: Minimum
) -> tuple[Deviation, ...]:
    """What came out otherwise than declared, surest first."""
    covariance, hidden = told(problem, found)
    was = np.concatenate([model.alpha_cad, basis @ model.chain.parameters])
    if campaign.earlier is not None:
        before, doubt = _as_told(campaign.earlier, np.vstack([model.factoring.W, basis]), 4 * problem.n)
        was, covariance = before, covariance + block_diag(doubt, np.zeros((len(covariance) - len(doubt),) * 2))
    granted = BESIDE if problem.effects else ALONE
    result = _drives(campaign, model.chain, problem, found, covariance, hidden, granted)
    links = _links(model, basis, problem, was, found, covariance, hidden, granted)
    return tuple(sorted(result + links, key=lambda d: -d.sigmas))


def told(problem: Problem, found: Minimum) -> tuple[Array, Array]:
    """Returns the covariance [P, P] of the fitted parameters in the directions that the records show, and the others [P, h]."""
    values, vectors, seen = spectrum(found.information)
    covariance = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T * np.outer(problem.scale, problem.scale)
    return covariance, vectors[:, ~seen] * problem.scale[:, None]


def _as_told(earlier: Earlier, rows: Array, drives: int) -> tuple[Array, Array]:
    """The constants [k] that follow by `rows` [k, 10 n] from the links as earlier records told their own, perhaps fewer; and the covariance
    of the logarithms of the `drives` and these."""
    same = rows.shape == earlier.rows.shape and np.allclose(rows, earlier.rows)
    to_these = np.eye(len(rows)) if same else rows @ np.linalg.pinv(earlier.rows, rcond=ROUNDING)
    whole = block_diag(np.eye(drives), to_these)
    return to_these @ earlier.vector[drives:], whole @ earlier.covariance @ whole.T


def _drives(
    campaign: Campaign,
    chain: Chain,
    problem: Problem,
    found: Minimum,
    covariance: Array,
    hidden: Array,
    granted: Granted,
) -> list[Deviation]:
    p, n = problem.parameters(found.vector), problem.n
    result = []
    for block, field in enumerate(DRIVES):
        declared = getattr(campaign, field)
        if field not in NAMES:
            continue
        for j in range(n):
            k, now, was = block * n + j, float(getattr(p, field)[j]), float(declared[j])
            if np.isnan(was) or np.abs(hidden[k]).max(initial=0.0) > HIDDEN:
                continue
            std = float(np.sqrt(covariance[k, k])) * now
            off = now - was
            if abs(off) > SIGMAS * std and abs(off) > getattr(granted, field) * was:
                kind = CATALOGUE[NAMES[field]]
                (parameter,) = kind.parameters
                values = ((parameter.name, off, std, kind.unit(parameter, chain.slides(j))),)
                change = np.log([now / max(was, NONE * now)])
                result.append(Deviation(kind.name, j, values, abs(off) / std, np.array([k]), change))
    return result


def _links(
    model: Model,
    basis: Array,
    problem: Problem,
    was: Array,
    found: Minimum,
    covariance: Array,
    hidden: Array,
    granted: Granted,
) -> list[Deviation]:
    """The bodies, payload or gravity that make alpha and the gravity constants what they are, and not what they `was`."""
    where = np.arange(4 * problem.n, problem.base)
    D = problem.D
    off = found.vector[where] - was
    C = covariance[np.ix_(where, where)]
    C = C + np.diag((granted.constants * np.maximum(np.abs(was), np.abs(was).max() * LEAST_CONSTANT)) ** 2)
    if hidden.size:
        C = C + UNKNOWN * hidden[where] @ hidden[where].T
    white: Array = np.linalg.inv(np.linalg.cholesky(C))
    y = white @ off
    alone = chdtri(len(y), CHANCE)
    if float(y @ y) < alone:
        return []
    links = np.linalg.inv(np.linalg.cholesky(C[:D, :D])) @ off[:D]
    change = Change(model, basis, white, off, was, where)
    if float(links @ links) < chdtri(D, CHANCE) or change.of_J < granted.J:
        return _gravity(off[D:], was[D:], C[D:, D:], where[D:])
    return _bodies(change)


def _gravity(off: Array, was: Array, C: Array, where: Array) -> list[Deviation]:
    """Gravity stronger or weaker than declared, by the share that fits best."""
    inverse = np.linalg.inv(C)
    weight = float(was @ inverse @ was)
    if not weight > 0.0:
        return []
    share, std = float(was @ inverse @ off) / weight, weight**-0.5
    if abs(share) < SIGMAS * std:
        return []
    values = (("share", share, std, ""),)
    return [Deviation("gravity-stiffness", None, values, abs(share) / std, where, off)]


def _bodies(change: Change) -> list[Deviation]:
    """What makes alpha and the gravity constants what they are: one thing, or two that take fewer numbers than a whole body; else
    several links, and perhaps a load, that nobody can tell one by one."""
    n = change.model.chain.n
    sigmas = float(np.linalg.norm(change.y))
    whole = [any_body(change, b) for b in range(n)]
    good = [("inertial-parameters", b) for b in range(n) if whole[b] < 1.0]
    scaled, gravity = [Part(1, b) for b in range(n)], Part(1, None)
    on_ray, load = Part(2, n - 1), Part(4, n - 1)
    fewest_first: list[list[tuple[Part, ...]]] = [
        [(one,) for one in scaled],
        [*combinations(scaled, 2), *((one, gravity) for one in scaled), (on_ray,)],
        [*((one, on_ray) for one in scaled[:-1]), (on_ray, gravity)],  # the last body with a load is another last body
        [(load,)],
        [*((one, load) for one in scaled[:-1]), (load, gravity)],
    ]
    for tried in fewest_first:
        found = [
            (parts, fit)
            for parts in tried
            if not change.out_of_reach(parts) and (fit := change.explained(parts)) is not None
        ]
        if not found:
            continue
        parts, (level, x, std) = min(found, key=lambda one: one[1][0])
        if level < 1.0:
            return _told(change, parts, x, std, _as_well(change, parts, load, good))
    best = max((b for _, b in good), default=int(np.argmin(whole)))
    several = whole[best] > SEVERAL
    tied = (load.named,) if several else tuple(one for one in good if one[1] != best)
    values = (("change", change.of_J, change.of_J / sigmas, ""),)
    joint = None if several else best
    return [Deviation("inertial-parameters", joint, values, sigmas, change.where, change.off, tied)]


def _as_well(
    change: Change, parts: Sequence[Part], load: Part, good: Sequence[tuple[str, int | None]]
) -> tuple[tuple[str, int | None], ...]:
    """What explains the change as well as the one part that does: a load, a body."""
    if len(parts) > 1:
        return ()
    loaded = None if parts[0].is_load else change.explained((load,))
    others = [*good, load.named] if loaded is not None and loaded[0] < 1.0 else good
    return tuple(one for one in others if one != parts[0].named)


def _told(
    change: Change, parts: Sequence[Part], x: Array, std: Array, tied: tuple[tuple[str, int | None], ...]
) -> list[Deviation]:
    """A deviation for each part; the last one is all that the others are not."""
    made = change.by(parts, x)
    made[-1] = change.off - made[:-1].sum(axis=0)
    result, k = [], 0
    for part, by in zip(parts, made, strict=True):
        own, error = x[k : k + part.numbers], std[k : k + part.numbers]
        k += part.numbers
        if part.is_load:
            names, units = ("mass", "centre_x", "centre_y", "centre_z"), ("kg", "m", "m", "m")
            values = tuple(
                zip(names, change.load(own).tolist(), np.abs(change.load(error)).tolist(), units, strict=True)
            )
        else:
            values = (("share", float(own[0]), float(error[0]), ""),)
        sigmas = float(np.linalg.norm(change.white @ by))
        result.append(Deviation(*part.named, values, sigmas, change.where, by, tied))
    return result
