"""Declared numbers that the records contradict: motor inertia, dampings, the links of the URDF, gravity.

The fit is free of all of them, so nothing is left over in its residual; what they came out as is held against what was
declared. Links are judged together: alpha and the gravity stiffness of a body that is not as declared change in a way
that its ten parameters allow, a payload in a way that a point mass at the last link allows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import chdtri

from ident.arm.arm_fit import Problem, spectrum
from ident.arm.arm_model import DRIVES
from ident.arm.descent import Minimum
from ident.effects.catalogue import CATALOGUE
from ident.records.campaign import Array, Campaign
from symgen.chain import Chain
from symgen.plan import Model

#: A number contradicts what was declared when it is this many standard deviations off, and more than the model is granted.
SIGMAS = 6.0
#: Share of a number in a direction that no record shows from which it is not known.
HIDDEN = 0.1
#: Share of a damping that is none, where none was declared: logarithms are fitted.
NONE = 1e-6
#: A body explains the change of the constants unless chance would do worse this rarely.
CHANCE = 1e-6
#: Several links are off, rather than one, when any one leaves more than so many times what chance does.
SEVERAL = 2.0
#: Which effect of the catalogue, of one parameter, a number of a drive is that is off.
NAMES = {"J_m": "motor-inertia", "D": "motor-viscous", "D_spring": "spring-damping"}
#: An accuracy is granted to a constant as though it were this share of the largest at least: a share of zero would grant none.
LEAST_CONSTANT = 1e-3
#: Variance along a direction that no record shows, in squares of its scale: so much that what lies there decides nothing.
UNKNOWN = 1e6
#: Postures at which J(q) is compared, and their seed: the rms over more is the same to 3 %.
POSTURES, SEED = 200, 0
#: A load that is looked for begins at this mass [kg] and this share of the longest link from the last joint.
LOAD, AWAY = 0.5, 0.3
#: A large step of it: this share of the longest link, and so much [m] where no link has a length; of a body's share or gravity's.
AWAY_STEP, LEAST_STEP, SHARE_STEP = 0.1, 1e-3, 0.1
#: Share of a cost below which another is less, and not that of the same load beyond a plane of symmetry.
MIRRORED = 1.0 - 1e-6
#: Steps after which a load that is looked for has been led away: to no mass, infinitely far.
MOST_STEPS = 100
#: Singular value of what a body's parameters do, of the largest, below which it is rounding.
ROUNDING = 1e-9


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
    values, vectors, seen = spectrum(found.information)
    covariance = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T * np.outer(problem.scale, problem.scale)
    hidden = vectors[:, ~seen] * problem.scale[:, None]
    granted = BESIDE if problem.effects else ALONE
    result = _drives(campaign, model.chain, problem, found, covariance, hidden, granted)
    links = _links(model, basis, problem, found, covariance, hidden, granted)
    return tuple(sorted(result + links, key=lambda d: -d.sigmas))


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
    model: Model, basis: Array, problem: Problem, found: Minimum, covariance: Array, hidden: Array, granted: Granted
) -> list[Deviation]:
    """The bodies, payload or gravity that make alpha and the gravity constants what they are."""
    where = np.arange(4 * problem.n, problem.base)
    D = problem.D
    phi = model.chain.parameters
    was = np.concatenate([model.alpha_cad, basis @ phi])
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


@dataclass(frozen=True, eq=False)
class Change:
    """By how much the constants alpha and of gravity, the parameters at places `where` [D + r], came `off` [D + r] what they `was`
    [D + r]; `white` [D + r, D + r] whitens it."""

    model: Model
    basis: Array
    white: Array
    off: Array
    was: Array
    where: NDArray[np.int64]

    @cached_property
    def y(self) -> Array:
        return np.asarray(self.white @ self.off)

    @cached_property
    def of_J(self) -> float:
        """By how much J(q) changed: rms over postures of the entry that did most, relative to sqrt(J_ii J_jj)."""
        D, q = len(self.model.factoring.W), self.model.random_postures(POSTURES, np.random.default_rng(SEED))
        diagonal = np.sqrt(np.einsum("pii->pi", self.model.J_cad(q)))
        J = self.model.J(q, self.off[:D]) / (diagonal[:, :, None] * diagonal[:, None, :])
        return float(np.sqrt(np.mean(J**2, axis=0)).max())

    @cached_property
    def rows(self) -> Array:
        """What the ten parameters of each body do to it, in the constants [D + r, 10 n]."""
        return np.concatenate([self.model.factoring.W, self.basis])

    def by(self, parts: Sequence[Part], x: Array) -> Array:
        """The change [k, D + r] that each of some parts makes with parameters `x` of all, gravity after the bodies."""
        D, n = len(self.model.factoring.W), self.model.chain.n
        ends = np.cumsum([part.numbers for part in parts])
        found: list[Array] = []
        for part, own in zip(parts, np.split(x, ends[:-1]), strict=True):
            if part.body is None:
                heavier = sum(found, self.was)
                found.append(own[0] * heavier * (np.arange(len(self.was)) >= D))
            elif part.numbers == 1:
                b = slice(10 * part.body, 10 * part.body + 10)
                found.append(own[0] * self.rows[:, b] @ self.model.chain.parameters[b])
            else:
                found.append(self.rows[:, 10 * (n - 1) :] @ _mass_at(self.load(own)))
        return np.array(found)

    def slopes(self, parts: Sequence[Part], x: Array) -> Array:
        """How the change [D + r] that all parts make answers each of their parameters `x` [k]: [D + r, k]."""
        n, gravity = self.model.chain.n, np.arange(len(self.was)) >= len(self.model.factoring.W)
        columns = np.zeros((len(self.was), 0))
        for part in parts:
            own = x[columns.shape[1] :][: part.numbers]
            if part.body is None:
                columns = columns * (1.0 + own[0] * gravity)[:, None]
                more = (gravity * (self.was + self.by(parts[:-1], x[:-1]).sum(axis=0)))[:, None]
            elif part.numbers == 1:
                more = self.by([part], np.ones(1)).T
            else:
                more = self.rows[:, 10 * (n - 1) :] @ _mass_slopes(self.load(own))
                more = more if part.numbers == 4 else np.stack([more[:, 0], more[:, 1:] @ self.ray], axis=1)
            columns = np.hstack([columns, more])
        return columns

    def load(self, x: Array) -> Array:
        """Mass and centre [4] of a point mass on the ray through the last body's centre, at an offset (x [2]), or anywhere (x [4])."""
        return x if len(x) == 4 else np.concatenate([x[:1], x[1] * self.ray])

    @cached_property
    def ray(self) -> Array:
        """From the last joint through its body's centre of mass; along the axis, where that is on it."""
        last = self.model.chain.joints[-1]
        length = float(np.linalg.norm(last.inertia.com))
        return np.asarray(last.inertia.com / length if length else last.axis)

    def level(self, cost: float, rank: int) -> float:
        """A sum of squares over what chance leaves after so many numbers."""
        return cost / max(float(chdtri(max(len(self.off) - rank, 1), CHANCE)), 1e-300)

    def out_of_reach(self, parts: Sequence[Part]) -> bool:
        """Whether some parts can not explain the change, for not even more than they can do does: any last body in the place of a
        load, any constants of gravity."""
        n, size = self.model.chain.n, len(self.off)
        columns = []
        for part in parts:
            if part.body is None:
                columns.append(np.eye(size)[:, len(self.model.factoring.W) :])
            elif part.is_load:
                columns.append(self.rows[:, 10 * (n - 1) :])
            else:
                columns.append(self.by([part], np.ones(1)).T)
        A = self.white @ np.concatenate(columns, axis=1)
        x, *_ = np.linalg.lstsq(A, self.y, rcond=None)
        return self.level(float(np.sum((self.y - A @ x) ** 2)), 0) >= 1.0

    def explained(self, parts: Sequence[Part]) -> tuple[float, Array, Array] | None:
        """(level, parameters, their stds) of the best explanation by some parts, None where a mass would be negative."""
        reach = max(float(np.linalg.norm(joint.p)) for joint in self.model.chain.joints)
        loads = [part.numbers - 1 for part in parts if part.is_load]
        m, step = loads[0] if loads else 0, AWAY_STEP * reach + LEAST_STEP
        best = None
        for point in np.concatenate([np.eye(m), -np.eye(m), np.zeros((1, m))]) * AWAY * reach:
            start = np.concatenate([[LOAD, *point] if part.is_load else [0.0] for part in parts])
            scale = np.concatenate([[LOAD, *[step] * m] if part.is_load else [SHARE_STEP] for part in parts])
            fit = least_squares(
                lambda x: self.white @ self.by(parts, x).sum(axis=0) - self.y,
                start,
                lambda x: self.white @ self.slopes(parts, x),
                x_scale=scale,
                max_nfev=MOST_STEPS,
            )
            if best is None or fit.cost < MIRRORED * best.cost:
                best = fit
        assert best is not None
        first = np.cumsum([0, *(part.numbers for part in parts)])
        if any(part.is_load and best.x[k] <= 0.0 for part, k in zip(parts, first, strict=False)):
            return None
        std = np.sqrt(np.diag(np.linalg.pinv(best.jac.T @ best.jac)))
        return self.level(2.0 * best.cost, int(np.linalg.matrix_rank(best.jac))), best.x, std


class Part(NamedTuple):
    """What may have changed, by so many `numbers`: a body as a whole (1), a point mass at the last one, on a ray (2) or anywhere
    (4), gravity (1; None)."""

    numbers: int
    body: int | None

    @property
    def is_load(self) -> bool:
        return self.numbers > 1

    @property
    def named(self) -> tuple[str, int | None]:
        if self.body is None:
            return "gravity-stiffness", None
        return ("payload", None) if self.is_load else ("inertial-parameters", self.body)


def _bodies(change: Change) -> list[Deviation]:
    """What makes alpha and the gravity constants what they are: one thing, or two that take fewer numbers than a whole body; else
    several links, and perhaps a load, that nobody can tell one by one."""
    n = change.model.chain.n
    sigmas = float(np.linalg.norm(change.y))
    whole = [_any_body(change, b) for b in range(n)]
    good = [("inertial-parameters", b) for b in range(n) if whole[b][0] < 1.0]
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
    best = max((b for _, b in good), default=int(np.argmin([level for level, _ in whole])))
    if whole[best][0] > SEVERAL:
        values = (("change", change.of_J, change.of_J / sigmas, ""),)
        return [Deviation("inertial-parameters", None, values, sigmas, change.where, change.off, (load.named,))]
    cad = change.model.chain.parameters[10 * best : 10 * best + 10]
    size = float(np.linalg.norm(whole[best][1] * np.abs(cad)) / max(float(cad @ cad), 1e-300))
    tied = tuple(one for one in good if one[1] != best)
    values = (("change", size, size / sigmas, ""),)
    return [Deviation("inertial-parameters", best, values, sigmas, change.where, change.off, tied)]


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
            values = (("share" if part.body is None else "change", float(own[0]), float(error[0]), ""),)
        sigmas = float(np.linalg.norm(change.white @ by))
        result.append(Deviation(*part.named, values, sigmas, change.where, by, tied))
    return result


def _any_body(change: Change, body: int) -> tuple[float, Array]:
    """(level, ten parameters) of the change of one body that explains most."""
    A = change.white @ change.rows[:, 10 * body : 10 * body + 10]
    phi, *_ = np.linalg.lstsq(A, change.y, rcond=ROUNDING)
    rank = int(np.linalg.matrix_rank(A, tol=ROUNDING * np.linalg.norm(A)))
    return change.level(float(np.sum((change.y - A @ phi) ** 2)), rank), phi


def _mass_at(x: Array) -> Array:
    """The ten parameters of a point mass x[0] [kg] at x[1:] [m]."""
    m, (a, b, c) = x[0], x[1:]
    return np.asarray(m * np.array([1.0, a, b, c, b * b + c * c, -a * b, a * a + c * c, -a * c, -b * c, a * a + b * b]))


def _mass_slopes(x: Array) -> Array:
    """How these answer x [10, 4]."""
    m, (a, b, c) = x[0], x[1:]
    x_slope = [0.0, 1.0, 0.0, 0.0, 0.0, -b, 2.0 * a, -c, 0.0, 2.0 * a]
    y_slope = [0.0, 0.0, 1.0, 0.0, 2.0 * b, -a, 0.0, 0.0, -c, 2.0 * b]
    z_slope = [0.0, 0.0, 0.0, 1.0, 2.0 * c, 0.0, 2.0 * c, -a, -b, 0.0]
    return np.stack([_mass_at(np.array([1.0, a, b, c])), *(m * np.array([x_slope, y_slope, z_slope]))], axis=1)
