"""A log as linear equations: three kinds of trajectory, and least squares with each joint weighted by what is left of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ident.logs.moves import Moves
from ident.logs.terms import Key, Term
from ident.records.log import Array, Log
from symgen.plan import Model

#: How often joints are weighed anew by what is left of them.
ROUNDS = 5
#: A joint is known no better than to this part of its torque.
FINEST = 1e-5
#: A coefficient is granted to be this many times what makes as much torque as there is.
GRANTED = 10.0
#: Of that, a curve's heights.
CURVED = 0.1
#: Trajectories that differ by less than this share of their motion (rms, every joint) are one, repeated.
SAME = 0.1
#: Samples, at most, that tell noise.
ROWS = 4000
#: Pieces of time of a part that are looked at by themselves.
BLOCKS = 16
#: What is left up to so many times the noise is noise.
SLACK = 1.15
#: No torque is explained better than to this part of it: joints are not rigid.
LEAST = 3e-4


class Span(NamedTuple):
    """Part of a trajectory: its `id`, times [s] of its first and last sample, and how many there are."""

    id: str
    first: float
    last: float
    samples: int


@dataclass(frozen=True, eq=False)
class Part:
    """Some of a log's samples: torques `tau` [S, n], what of them the declared links do not make `y` [S, n], columns `X` [S, n, C] of all terms,
    `block` [S] the piece of time of each sample; of which trajectories, from when to when [s] and by how many samples, `spans` says."""

    tau: Array
    y: Array
    X: Array
    block: NDArray[np.int64]
    spans: tuple[Span, ...]

    @cached_property
    def gram(self) -> tuple[Array, Array, Array]:
        """X'X [n, C, C], X'y [n, C], y'y [n]."""
        X, y = np.moveaxis(self.X, 1, 0), self.y.T
        return X.swapaxes(1, 2) @ X, np.einsum("jsc,js->jc", X, y), np.sum(y**2, axis=1)

    @staticmethod
    def of(parts: Sequence[Part]) -> Part:
        """All of some parts together."""
        tau, y, X = (np.concatenate([getattr(one, name) for one in parts]) for name in ("tau", "y", "X"))
        block = np.concatenate([one.block + BLOCKS * k for k, one in enumerate(parts)])
        return Part(tau, y, X, block, tuple(span for one in parts for span in one.spans))


@dataclass(frozen=True, eq=False)
class Equations:
    """A log's parts, and where in their columns each of the `terms` stands."""

    log: Log
    model: Model
    terms: tuple[Term, ...]
    at: tuple[slice, ...]
    fit: Part
    select: Part
    report: Part
    note: str
    repeats: tuple[tuple[str, str], ...]
    noise: Array

    @cached_property
    def floor(self) -> Array:
        """What of the joints' torques [n, rms, N m] no effect is looked for in: noise, and the part that no rigid joint explains."""
        return np.maximum(SLACK * self.noise, LEAST * np.sqrt(np.mean(self.fit.tau**2, axis=0)))

    def columns(self, chosen: Sequence[Term]) -> NDArray[np.int64]:
        """Numbers of the columns of some of the terms, whatever their width."""
        return np.concatenate([np.zeros(0, dtype=int), *(self._places[term.key] for term in chosen)])

    def prior(self, term: Term) -> Array:
        """How far [c] a term's coefficients may be from 0: one standard deviation."""
        own = self._places[term.key]
        if term.width:
            return np.full(len(own), term.width)
        return self._granted[own] * (CURVED if term.variable else 1.0)

    def told(self, terms: Sequence[Term], x: Array) -> Iterator[tuple[Term, Array]]:
        """Each of some terms, and its part of their coefficients `x`."""
        start = 0
        for term in terms:
            size = len(self._places[term.key])
            yield term, x[start : start + size]
            start += size

    def of(self, fit: Fit) -> Iterator[tuple[Term, Array, Array]]:
        """Each term of a fit, its coefficients [c] and their covariance [c, c]."""
        start = 0
        for term, x in self.told(fit.terms, fit.coefficients):
            own, start = slice(start, start + len(x)), start + len(x)
            yield term, x, fit.covariance[own, own]

    @cached_property
    def _places(self) -> dict[Key, NDArray[np.int64]]:
        return {term.key: np.arange(at.start, at.stop) for term, at in zip(self.terms, self.at, strict=True)}

    @cached_property
    def _granted(self) -> Array:
        """What makes `GRANTED` times as much torque at some joint as there is, of each column; nothing of columns that are nothing."""
        size = np.mean(self.fit.tau**2, axis=0)
        power = np.diagonal(self.fit.gram[0], axis1=1, axis2=2) / (len(self.fit.y) * size[:, None] + 1e-300)
        strongest = np.sqrt(power.max(axis=0))
        return np.divide(GRANTED, strongest, out=np.zeros(len(strongest)), where=strongest > 0.0)


@dataclass(frozen=True, eq=False)
class Fit:
    """The declared links with `terms` beside them: `coefficients` of their `columns`, their covariance, and what is left of each joint, `sigma` [n]
    (rms, N m)."""

    terms: tuple[Term, ...]
    columns: NDArray[np.int64]
    coefficients: Array
    covariance: Array
    sigma: Array

    def left(self, part: Part) -> Array:
        """What is left [S, n, N m] of a part."""
        return np.asarray(part.y - part.X[..., self.columns] @ self.coefficients)


def fitted(equations: Equations, part: Part, terms: Sequence[Term]) -> Fit:
    """Returns the weighted least squares fit of some terms to a part."""
    at = equations.columns(terms)
    G, b, yy = part.gram
    G, b = G[:, at[:, None], at], b[:, at]
    size = np.sqrt(np.mean(part.tau**2, axis=0))
    count = len(part.y)
    prior = np.concatenate([np.zeros(0), *(equations.prior(term) for term in terms)])
    sigma, x = np.sqrt(yy / count), np.zeros(len(at))
    for _ in range(ROUNDS):
        sigma = np.maximum(sigma, FINEST * size + 1e-300)
        H = np.einsum("j,jab->ab", sigma**-2, G) * np.outer(prior, prior) + np.eye(len(at))
        x = prior * np.linalg.solve(H, prior * (sigma**-2 @ b))
        rest = yy - 2 * b @ x + np.einsum("jab,a,b->j", G, x, x)
        sigma = np.sqrt(np.maximum(rest, 0.0) / max(count - len(at) / len(size), 1.0))
    covariance = np.linalg.inv(H) * np.outer(prior, prior)
    return Fit(tuple(terms), at, x, covariance, np.maximum(sigma, FINEST * size))


def equations(log: Log, model: Model, moved: Sequence[Moves], terms: Sequence[Term]) -> Equations:
    """Returns the equations of a log with every term that may be needed."""
    declared = model.chain.parameters.reshape(-1)
    rotors = log.N**2 * np.nan_to_num(log.J_m)
    sizes: list[int] = []
    above: list[tuple[Array, Array]] = []

    every = max(1, sum(len(m.q) for m in moved) // ROWS)

    def whole(m: Moves) -> Part:
        y = m.tau - model.torque_rows(m.q, m.v, m.a, log.gravity) @ declared - rotors * m.a
        kept, beyond = [], []
        for term in terms:
            columns = term.columns(m)
            kept.append(m.kept(columns))
            beyond.append(m.above(columns)[::every])
        sizes[:] = [one.shape[-1] for one in kept]
        above.append((m.above(y)[::every], np.concatenate(beyond, axis=-1)))
        tau, times = m.kept(m.tau), m.times
        span = Span(m.id, float(times[0]), float(times[-1]), len(times))
        return Part(tau, m.kept(y), np.concatenate(kept, axis=-1), np.zeros(len(tau), dtype=int), (span,))

    wholes = [whole(m) for m in moved]
    groups = _groups(moved)
    kinds, note = _dealt(wholes, groups)
    ends = np.cumsum(sizes)
    at = tuple(slice(int(end - size), int(end)) for end, size in zip(ends, sizes, strict=True))
    repeats = tuple((moved[g[0]].id, moved[k].id) for g in groups for k in g[1:])
    fit, select, report = (Part.of(kinds[name]) for name in ("fit", "select", "report"))
    return Equations(log, model, tuple(terms), at, fit, select, report, note, repeats, _noise(moved, groups, above))


def _groups(moved: Sequence[Moves]) -> list[list[int]]:
    """The trajectories by what is one motion, repeated."""
    groups: list[list[int]] = []
    for k, one in enumerate(moved):
        for group in groups:
            other = moved[group[0]]
            size = min(len(one.q), len(other.q))
            apart = one.q[:size] - other.q[:size]
            motion = np.maximum(other.q.std(axis=0), 1e-9)
            if size > 0.8 * max(len(one.q), len(other.q)) and np.all(apart.std(axis=0) < SAME * motion):
                group.append(k)
                break
        else:
            groups.append([k])
    return groups


def _noise(moved: Sequence[Moves], groups: Sequence[Sequence[int]], left: Sequence[tuple[Array, Array]]) -> Array:
    """What torques scatter by [n, N m] beyond what any motion explains: what all columns together leave above the equations' band, were it as strong
    within; or what repetitions of a motion differ by, where that is less. `left` are torques [S, n] and columns [S, n, C] there."""
    y, X = (np.concatenate([one[k] for one in left]) for k in (0, 1))
    within, samples = moved[0].beyond[0], min(sum(m.beyond[1] for m in moved), len(y))
    level = []
    for j in range(y.shape[1]):
        own = X[:, j, np.any(X[:, j] != 0.0, axis=0)]
        rest = y[:, j] - own @ np.linalg.lstsq(own, y[:, j])[0]
        level.append(within * np.mean(rest**2) * samples / max(samples - own.shape[1], 1.0))
    again = [np.var(np.stack(torques), axis=0, ddof=1).mean(axis=0) for torques in _alike(moved, groups)]
    return np.asarray(np.sqrt(np.minimum.reduce([np.array(level), *again])))


def _alike(moved: Sequence[Moves], groups: Sequence[Sequence[int]]) -> Iterator[list[Array]]:
    """The torques of motions that were repeated, of equal length."""
    for group in groups:
        size = min(len(moved[k].times) for k in group)
        if len(group) > 1:
            yield [moved[k].kept(moved[k].tau)[:size] for k in group]


def _dealt(wholes: Sequence[Part], groups: Sequence[Sequence[int]]) -> tuple[dict[str, list[Part]], str]:
    """Which trajectories fit, choose and report, and what there is to say of that: different motions, where there are enough."""
    motions = [[wholes[k] for k in group] for group in groups]
    if len(motions) >= 3:
        kinds: dict[str, list[Part]] = {"fit": [], "select": [], "report": []}
        for k, motion in enumerate(motions):
            kinds[("fit", "select", "report", "fit")[k % 4]] += [_cut(one, 0.0, 1.0) for one in motion]
        return kinds, ""
    if len(motions) == 2:
        long, short = sorted(motions, key=lambda motion: -sum(len(one.y) for one in motion))
        kinds = {"fit": [_cut(one, 0.0, 1.0) for one in long]}
        kinds |= {
            name: [_cut(one, *ends) for one in short] for name, ends in (("select", (0.0, 0.5)), ("report", (0.5, 1.0)))
        }
        return kinds, "two motions: one fits, the other's first half chooses and its second half reports"
    thirds = {"fit": (0.0, 0.5), "select": (0.5, 0.75), "report": (0.75, 1.0)}
    kinds = {name: [_cut(one, *ends) for one in motions[0]] for name, ends in thirds.items()}
    return kinds, "one motion: its first half fits, the next quarter chooses and the last one reports"


def _cut(one: Part, begin: float, end: float) -> Part:
    """A share of a trajectory's time, in pieces."""
    count = len(one.y)
    use = slice(round(begin * count), round(end * count))
    size = use.stop - use.start
    (whole,) = one.spans
    step = (whole.last - whole.first) / max(count - 1, 1)
    span = Span(whole.id, whole.first + use.start * step, whole.first + (use.stop - 1) * step, size)
    return Part(one.tau[use], one.y[use], one.X[use], np.arange(size) * BLOCKS // size, (span,))
