"""Declared numbers that the records contradict: motor inertia, dampings, the links of the URDF, gravity.

The fit is free of all of them, so nothing is left over in its residual; what they came out as is held against what was
declared. Links are judged together: alpha and the gravity stiffness of a body that is not as declared change in a way
that its ten parameters allow, a payload in a way that a point mass at the last link allows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2 as chi2_distribution

from ident.arm_fit import Minimum, Problem, spectrum
from ident.campaign import Array, Campaign
from symgen.plan import Model

#: A number contradicts what was declared when it is this many standard deviations off, and this share of itself.
SIGMAS = 6.0
SHARES = {"J_m": 0.01, "D": 0.1, "D_spring": 0.1, "links": 0.005}
#: Relative accuracy granted to the model where bodies are compared: the last digits are not the bodies'.
MODEL_SHARE = 2e-3
#: A body explains the change of the constants unless chance would do worse this rarely.
CHANCE = 1e-6
NAMES = {"J_m": "motor-inertia", "D": "motor-viscous", "D_spring": "spring-damping"}
PORTS = {"motor-inertia": "motor", "motor-viscous": "motor", "spring-damping": "spring", "payload": "link",
         "inertial-parameters": "link", "gravity-stiffness": "link"}  # fmt: skip
UNITS = {"J_m": ("inertia", "kgm2"), "D": ("damping", "Nms/rad"), "D_spring": ("damping", "Nms/rad")}


@dataclass(frozen=True, eq=False)
class Deviation:
    """A declared number that is off: a name of the catalogue, its joint (from 0; None: the arm), (parameter, value, std,
    unit) each, how many standard deviations off, and the parameters (indices) with their declared values that undo it.

    `tied` are other (name, joint) that explain it as well.
    """

    name: str
    joint: int | None
    values: tuple[tuple[str, float, float, str], ...]
    sigmas: float
    indices: Array
    declared: Array
    tied: tuple[tuple[str, int | None], ...] = ()


def deviations(
    campaign: Campaign, model: Model, basis: Array, problem: Problem, found: Minimum
) -> tuple[Deviation, ...]:
    """What came out otherwise than declared, surest first."""
    values, vectors, seen = spectrum(found.information)
    covariance = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T * np.outer(problem.scale, problem.scale)
    hidden = vectors[:, ~seen] * problem.scale[:, None]
    result = _drives(campaign, problem, found, covariance, hidden)
    links = _links(model, basis, problem, found, covariance, hidden)
    return tuple(sorted(result + links, key=lambda d: -d.sigmas))


def _drives(campaign: Campaign, problem: Problem, found: Minimum, covariance: Array, hidden: Array) -> list[Deviation]:
    p, n = problem.parameters(found.vector), problem.n
    result = []
    for block, field in enumerate(("K", "J_m", "D", "D_spring")):
        declared = getattr(campaign, field)
        if field == "K" or declared is None:
            continue
        for j in range(n):
            k, now, was = block * n + j, float(getattr(p, field)[j]), float(declared[j])
            if not was > 0.0 or np.abs(hidden[k]).max(initial=0.0) > 0.1:
                continue
            std = float(np.sqrt(covariance[k, k])) * now
            off = now - was
            if abs(off) > SIGMAS * std and abs(off) > SHARES[field] * was:
                name, unit = UNITS[field]
                result.append(
                    Deviation(NAMES[field], j, ((name, off, std, unit),), abs(off) / std, np.array([k]), np.log([was]))
                )
    return result


def _links(
    model: Model, basis: Array, problem: Problem, found: Minimum, covariance: Array, hidden: Array
) -> list[Deviation]:
    """The one body, payload or gravity that makes alpha and the gravity constants what they are."""
    where = np.arange(4 * problem.n, problem.base)
    D = problem.D
    phi = model.chain.parameters
    was = np.concatenate([model.alpha_cad, basis @ phi])
    off = found.vector[where] - was
    q = model.random_postures(200, np.random.default_rng(0))
    J, J_now = model.J_cad(q), model.J(q, found.vector[where[:D]])
    size = np.sqrt(np.einsum("pi,pj->pij", *(np.diagonal(J, axis1=1, axis2=2),) * 2))
    share = float(np.sqrt(np.mean(((J_now - J) / size) ** 2, axis=0)).max())
    C = covariance[np.ix_(where, where)]
    C = C + np.diag((MODEL_SHARE * np.maximum(np.abs(was), np.abs(was).max() * 1e-3)) ** 2)
    if hidden.size:
        C = C + 1e6 * hidden[where] @ hidden[where].T
    white: Array = np.linalg.inv(np.linalg.cholesky(C))
    y = white @ off
    alone = chi2_distribution.isf(CHANCE, len(y))
    if float(y @ y) < alone:
        return []
    sigmas = float(np.sqrt(y @ y))
    links = np.linalg.inv(np.linalg.cholesky(C[:D, :D])) @ off[:D]
    if float(links @ links) < chi2_distribution.isf(CHANCE, D) or share < SHARES["links"]:
        return _gravity(off[D:], was[D:], C[D:, D:], where[D:], was[D:])
    rows = white @ np.concatenate([model.factoring.W, basis])
    return [_body(model, rows, y, sigmas, where, was)]


def _gravity(off: Array, was: Array, C: Array, where: Array, declared: Array) -> list[Deviation]:
    """Gravity stronger or weaker than declared, by the share that fits best."""
    inverse = np.linalg.inv(C)
    weight = float(was @ inverse @ was)
    if not weight > 0.0:
        return []
    share, std = float(was @ inverse @ off) / weight, weight**-0.5
    if abs(share) < SIGMAS * std:
        return []
    values = (("share", share, std, ""),)
    return [Deviation("gravity-stiffness", None, values, abs(share) / std, where, declared)]


def _body(model: Model, rows: Array, y: Array, sigmas: float, where: Array, was: Array) -> Deviation:
    """The body whose ten parameters explain the change best: a payload where a point mass at the last does."""
    n = model.chain.n
    left, fits = [], []
    for b in range(n):
        A = rows[:, 10 * b : 10 * b + 10]
        phi, *_ = np.linalg.lstsq(A, y, rcond=1e-9)
        rank = int(np.linalg.matrix_rank(A, tol=1e-9 * np.linalg.norm(A)))
        r = y - A @ phi
        left.append(float(r @ r) / max(chi2_distribution.isf(CHANCE, max(len(y) - rank, 1)), 1e-300))
        fits.append(phi)
    point = _point_mass(rows[:, 10 * (n - 1) :], y, model)
    good = [b for b in range(n) if left[b] < 1.0]
    scaled = _scaled(rows, y, model)
    best = scaled if scaled is not None else max(good, default=int(np.argmin(left)))
    if point is not None and point[2] < 1.0 and scaled is None:
        values = (("mass", point[0], point[3], "kg"), *((f"centre_{a}", float(c), point[3] / max(point[0], 1e-9) * 0.1, "m")
                  for a, c in zip("xyz", point[1], strict=True)))  # fmt: skip
        tied = tuple(("inertial-parameters", b) for b in good)
        return Deviation("payload", None, values, sigmas, where, was, tied)
    cad = model.chain.parameters[10 * best : 10 * best + 10]
    size = float(np.linalg.norm(fits[best] * np.abs(cad)) / max(float(cad @ cad), 1e-300))
    others: tuple[tuple[str, int | None], ...] = tuple(("inertial-parameters", b) for b in good if b != best)
    if point is not None and point[2] < 1.0:
        others = (("payload", None), *others)
    return Deviation("inertial-parameters", best, (("change", size, size / sigmas, ""),), sigmas, where, was, others)


def _scaled(rows: Array, y: Array, model: Model) -> int | None:
    """The one body that explains the change by being heavier or lighter as a whole, if there is one."""
    best: tuple[float, int] | None = None
    for b in range(model.chain.n):
        a = rows[:, 10 * b : 10 * b + 10] @ model.chain.parameters[10 * b : 10 * b + 10]
        square = float(a @ a)
        if square > 0.0:
            r = y - a * float(a @ y) / square
            level = float(r @ r) / chi2_distribution.isf(CHANCE, max(len(y) - 1, 1))
            if level < 1.0 and (best is None or level < best[0]):
                best = (level, b)
    return None if best is None else best[1]


def _point_mass(A: Array, y: Array, model: Model) -> tuple[float, Array, float, float] | None:
    """(mass, centre, chi^2 over its limit, std of the mass) of the point mass at the last link that explains y = A phi best."""
    reach = max(float(np.linalg.norm(joint.p)) for joint in model.chain.joints)

    def phi(x: Array) -> Array:
        m, (a, b, c) = x[0], x[1:]
        return m * np.array([1.0, a, b, c, b * b + c * c, -a * b, a * a + c * c, -a * c, -b * c, a * a + b * b])

    best = None
    for start in np.concatenate([np.eye(3), -np.eye(3), np.zeros((1, 3))]) * 0.3 * reach:
        fit = least_squares(
            lambda x: y - A @ phi(x), np.array([0.5, *start]), x_scale=np.array([0.5, *[0.1 * reach + 1e-3] * 3])
        )
        if best is None or fit.cost < best.cost:
            best = fit
    assert best is not None
    if best.x[0] <= 0.0:
        return None
    information = best.jac.T @ best.jac
    std = float(np.sqrt(np.linalg.pinv(information)[0, 0]))
    limit = chi2_distribution.isf(CHANCE, max(len(y) - int(np.linalg.matrix_rank(best.jac)), 1))
    return float(best.x[0]), best.x[1:], 2.0 * best.cost / limit, std
