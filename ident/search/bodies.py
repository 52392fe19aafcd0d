"""What a body, a load at the last one or gravity does to the constants alpha and of gravity, and which of them explain a change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import chdtri

from ident.records.campaign import Array
from symgen.plan import Model

#: A body explains the change of the constants unless chance would do worse this rarely.
CHANCE = 1e-6
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
        std = np.linalg.norm(np.linalg.pinv(best.jac), axis=1)
        return self.level(2.0 * best.cost, int(np.linalg.matrix_rank(best.jac))), best.x, std


def any_body(change: Change, body: int) -> float:
    """The level of what any change of one body's ten parameters leaves."""
    A = change.white @ change.rows[:, 10 * body : 10 * body + 10]
    phi, *_ = np.linalg.lstsq(A, change.y, rcond=ROUNDING)
    rank = int(np.linalg.matrix_rank(A, tol=ROUNDING * np.linalg.norm(A)))
    return change.level(float(np.sum((change.y - A @ phi) ** 2)), rank)


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
