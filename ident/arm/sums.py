"""What a descent asks of all records of a problem: sums over them, several processes having a share of the records each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ident.arm.arm_fit import (
    Held,
    Problem,
    Slides,
    chi_squared_of,
    hold,
    residual,
    slides,
    unexpected,
    whitened,
    whitened_by,
)
from ident.arm.evidence import Evidence
from ident.records.campaign import Array
from ident.records.frf import Complex
from symgen.forked import standing

#: Numbers of the derivatives of a share's records that are kept for a bend (256 MB); more are found again.
MOST_KEPT = 2**24
#: Change of a parameter, in steps of `scale`, for which motions are found anew.
FOLLOWED = 1e-4


@dataclass
class Share:
    """Some of the records of a problem, what is held of them, and their `whitened` equations where these were asked for last."""

    problem: Problem
    held: list[Held] = field(default_factory=list)
    last: tuple[Array, list[tuple[Complex, Complex, NDArray[np.int64]]]] | None = None

    def hold(self, vector: Array, doubt: float) -> list[Slides]:
        self.held, self.last = hold(self.problem, vector, doubt, hurries=True), None
        slid = slides(self.problem, self.held)
        self.problem = replace(self.problem, slid=slid)
        return [{one.index: slid[one.index]} if one.index in slid else {} for one in self.problem.data]

    def chi_squared(self, vector: Array) -> list[float]:
        pairs = zip(self.problem.data, self.held, strict=True)
        return [chi_squared_of(self.problem, vector, one, kept) for one, kept in pairs]

    def equations(self, vector: Array) -> list[tuple[float, Array, Array, NDArray[np.int64]]]:
        self.last = None
        return [_normal(*of_record) for of_record in self._whitened(vector)]

    def following(
        self, vector: Array, which: Sequence[int], joints: Sequence[int]
    ) -> list[tuple[float, Array, Array, NDArray[np.int64]]]:
        """As `equations`; derivatives by the parameters `which` are differences between motions found anew, and so is what inertia and
        gravity stiffness of each of `joints` do. Once it is late motions are not found anew."""
        found = []
        for one, kept in zip(self.problem.data, self.held, strict=True):
            alone = replace(self.problem, data=(one,))
            white, A, columns = whitened(self.problem, vector, one, kept)
            ways = [(np.arange(len(vector)) == k) * 1.0 for k in which if k in columns]
            for way in ways + _own(self.problem, one, joints):
                if self.problem.late:
                    break
                there = vector + FOLLOWED * self.problem.scale * way
                moved = hold(alone, there)[0].moved
                after = whitened_by(kept.W[one.use], residual(alone, there, one, moved, judged=True)[0]).ravel()
                along = way[columns]
                missing = (after - white) / FOLLOWED - A @ along
                A = A + np.outer(missing, along / (along @ along))
            found.append(_normal(white, A, columns))
        return found

    def curved(self, vector: Array, step: Array, share: float) -> list[tuple[Array, NDArray[np.int64]]]:
        """What the curvature of each record's residual along a step is to the parameters [C], found from a share of it."""
        found, ahead = [], vector + share * self.problem.scale * step
        with np.errstate(all="ignore"):  # a bend beyond numbers is none
            lines = zip(self.problem.data, self.held, self._whitened(vector), strict=True)
            for one, kept, (white, A, columns) in lines:
                r = residual(self.problem, ahead, one, kept.moved, judged=True)[0]
                there = whitened_by(kept.W[one.use], r).ravel()
                bent = 2.0 / share * ((there - white) / share - A @ step[columns])
                found.append((2.0 * (A.conj().T @ bent).real, columns))
        return found

    def _whitened(self, vector: Array) -> list[tuple[Complex, Complex, NDArray[np.int64]]]:
        if self.last is None or not np.array_equal(self.last[0], vector):
            self.last = None
            found = [whitened(self.problem, vector, *pair) for pair in zip(self.problem.data, self.held, strict=True)]
            if sum(A.size for _, A, _ in found) > MOST_KEPT:
                return found
            self.last = vector, found
        return self.last[1]


class Sums:
    """A problem's sums over its records, for what is held of them; the same whatever the number of processes."""

    def __init__(
        self, problem: Problem, ask: Callable[[tuple[str, tuple[Any, ...]]], list[Any]], places: list[NDArray[np.int64]]
    ) -> None:
        self.problem, self.slid, self._ask, self._places = problem, problem.slid, ask, places

    def hold(self, vector: Array, doubt: float = 0.0) -> None:
        """Makes weights and motions anew, for the arm at `vector`, and says where dry friction was found: `slid`."""
        for found in self._of_records("hold", vector, doubt):
            self.slid = {**self.slid, **found}

    def chi_squared(self, vector: Array) -> float:
        """chi^2; infinite where the arm is not one (J not positive, numbers beyond numbers)."""
        return float(sum(self._of_records("chi_squared", vector), unexpected(self.problem, vector)[0]))

    def equations(self, vector: Array) -> tuple[float, Array, Array]:
        """Returns chi^2, half its gradient [P] and half its Gauss-Newton Hessian [P, P] per step of `scale`: the information."""
        return self._added(vector, self._of_records("equations", vector))

    def following(self, vector: Array, which: Sequence[int], joints: Sequence[int]) -> tuple[float, Array, Array]:
        """As `equations`, where motions follow the parameters `which` and what is moved at `joints`; those at `vector` are held."""
        return self._added(vector, self._of_records("following", vector, which, joints))

    def _added(
        self, vector: Array, of_records: list[tuple[float, Array, Array, NDArray[np.int64]]]
    ) -> tuple[float, Array, Array]:
        chi2, slope, information = unexpected(self.problem, vector)
        for of_record, along, square, columns in of_records:
            chi2 += of_record
            slope[columns] += along
            information[np.ix_(columns, columns)] += square
        return chi2, slope, information

    def curved(self, vector: Array, step: Array, share: float) -> Array:
        """What the curvature of the residuals along a step is to the parameters [P], found from a share of it."""
        pushed = np.zeros(len(vector))
        for along, columns in self._of_records("curved", vector, step, share):
            pushed[columns] += along
        return pushed

    def _of_records(self, what: str, *of: Any) -> list[Any]:
        """The answers of all shares, in the order of the records."""
        answers = [answer for share in self._ask((what, of)) for answer in share]
        return [answers[k] for k in np.argsort(np.concatenate(self._places))]


def _own(problem: Problem, one: Evidence, joints: Sequence[int]) -> list[Array]:
    """The ways [P], in steps of `scale`, along which J_jj and the gravity stiffness of each of `joints` that move in a record grow fastest:
    what constants do to a motion they do by these."""
    arm, n, D = one.scene.arm, problem.n, problem.D
    found = []
    for here in np.flatnonzero(np.isin(arm.live, joints)):
        for rows, slots in ((arm.J_rows, slice(4 * n, 4 * n + D)), (arm.K_rows, slice(4 * n + D, problem.base))):
            way = np.zeros(len(problem.scale))
            way[slots] = rows[here, here] * problem.scale[slots] * problem.free[slots]
            if way.any():
                found.append(way / np.linalg.norm(way))
    return found


def _normal(white: Complex, A: Complex, columns: NDArray[np.int64]) -> tuple[float, Array, Array, NDArray[np.int64]]:
    """chi^2 of a whitened residual, half its gradient and half its Gauss-Newton Hessian, and the parameters of their `columns`."""
    real = np.concatenate([A.real, A.imag])
    return 2.0 * float(np.vdot(white, white).real), 2.0 * (A.conj().T @ white).real, 2.0 * (real.T @ real), columns


@contextmanager
def summed(problem: Problem) -> Iterator[Sums]:
    """The sums of a problem by its `workers`; records of one scene are in one share."""
    scenes = list(dict.fromkeys(id(one.scene) for one in problem.data))
    count = max(1, min(problem.workers, len(scenes)))
    share_of = {scene: k % count for k, scene in enumerate(scenes)}
    belongs = np.array([share_of[id(one.scene)] for one in problem.data], dtype=np.int64)
    places = [np.flatnonzero(belongs == k) for k in range(count)]
    shares = [Share(replace(problem, data=tuple(problem.data[i] for i in which), workers=1)) for which in places]

    def work(k: int, asked: tuple[str, tuple[Any, ...]]) -> Any:
        return getattr(shares[k], asked[0])(*asked[1])

    with standing(work, count) as ask:
        yield Sums(problem, ask, places)
