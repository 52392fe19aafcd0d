"""What a log's declared model lacks: terms added, exchanged and dropped by what they leave of trajectories that did not fit them.

A move adds a term, two at one joint, or one of a kind at every joint: friction is seldom alone. A model is worth what it takes of the joints'
residual power on trajectories that choose, less a price for each of its numbers; it must do so in most pieces of time, not in one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ident.effects.catalogue import CATALOGUE
from ident.logs.equations import Equations, Fit, Part, fitted
from ident.logs.terms import BENT, STRAIGHT, WHOLE, WIDTHS, Term
from ident.records.log import Array

Terms = tuple[Term, ...]

#: Price of a number, as a share of a joint's residual power; what a curve that has no name costs more, and how many numbers it counts as.
PRICE, NAMELESS, CURVE = 0.05, 0.1, 2
#: What a move takes must be this many times its scatter over pieces of time.
CERTAIN = 2.0
#: Moves that are looked at the other way round, the best ones.
TRIED = 5
#: Terms that take most of the fitted squares are weighed anew: where one joint is off by much, others hold what all depend on.
REWEIGHED = 10
#: The best terms of a joint of which pairs are tried.
PAIRED = 8
#: A term is not told from another one that takes as much but for this share.
AS_GOOD = 0.05
#: Rivals that are told, and moves at most, a joint.
RIVALS, MOVES = 3, 4


@dataclass(frozen=True)
class Gain:
    """What one model leaves less than another of a part: the sum over the joints of the logarithms of their residual `power`, before over after; and its
    `certainty`, what is won of it over how that scatters from one piece of time to the next."""

    power: float
    certainty: float


@dataclass(frozen=True, eq=False)
class Step:
    """A term that was added, what the choosing trajectories lose with it, the next best terms with the error [relative rms] that they leave of those
    that report, and terms that are not told from it."""

    term: Term
    gain: Gain
    rivals: tuple[tuple[Term, float], ...] = ()
    tied: Terms = ()


@dataclass(frozen=True, eq=False)
class Found:
    """The search's end: `start` the declared model, `end` the corrected one, fitted to all that fits or chooses; `steps` its terms, and `errors`
    [relative rms] of trajectories that report, before the first and after each."""

    start: Fit
    end: Fit
    steps: tuple[Step, ...]
    errors: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class _Move:
    """Terms added to a model, and what that is worth."""

    added: Terms
    gain: Gain
    worth: float


class _Beside:
    """What a model leaves, and what is left with more terms beside it: all other columns are taken across what the model has, once."""

    def __init__(self, equations: Equations, now: Fit) -> None:
        self.equations, self.now = equations, now
        G, b, _ = equations.fit.gram
        weights = now.sigma**-2
        G, b = np.einsum("j,jab->ab", weights, G), weights @ b
        own = now.columns
        across = now.covariance @ G[own]
        self._G, self._b = G - G[:, own] @ across, b - across.T @ b[own]
        self.before = now.left(equations.select)
        self._X = equations.select.X - equations.select.X[..., own] @ across

    def with_(self, added: Terms) -> _Move | None:
        """What terms beside the model are worth, joints weighed as they are; None where their numbers are out of bounds."""
        at, x = self._solved(added)
        if not all(_possible(term, own) for term, own in self.equations.told(added, x)):
            return None
        return self._worth(added, self.before - self._X[..., at] @ x)

    def weighed_anew(self, added: Terms) -> _Move | None:
        """The same, joints weighed by what is left of them with these terms."""
        fit = fitted(self.equations, self.equations.fit, (*self.now.terms, *added))
        if not all(_possible(term, own) for term, own in self.equations.told(fit.terms, fit.coefficients)):
            return None
        return self._worth(added, fit.left(self.equations.select))

    def fall(self, added: Terms) -> float:
        """What terms take of the weighted squares of the part that fits."""
        at, x = self._solved(added)
        return float(self._b[at] @ x)

    def _solved(self, added: Terms) -> tuple[NDArray[np.int64], Array]:
        at = self.equations.columns(added)
        prior = np.concatenate([self.equations.prior(term) for term in added])
        H = self._G[np.ix_(at, at)] * np.outer(prior, prior) + np.eye(len(at))
        x, *_ = np.linalg.lstsq(H, prior * self._b[at])  # columns may be combinations of what is there
        return at, np.asarray(prior * x)

    def _worth(self, added: Terms, left: Array) -> _Move:
        won = gain(self.equations.select, self.before, left, self.equations.floor)
        return _Move(added, won, won.power - sum(map(_price, added)))

    def fit(self, move: _Move) -> Fit:
        return fitted(self.equations, self.equations.fit, (*self.now.terms, *move.added))


def searched(equations: Equations, say: Callable[[str], None] = lambda line: None) -> Found:
    """Returns what the declared model lacks by these equations.

    It is looked for beside the declared links, and beside links that are not quite these; what leaves less is told.
    """
    start = fitted(equations, equations.fit, ())
    beside = _Beside(equations, start)
    free = [beside.with_((term,)) for term in _candidates(equations, ()) if term.width]
    likely = max(
        (move for move in free if move is not None and move.worth > 0.0), key=lambda move: move.worth, default=None
    )
    ends = [_from(equations, start, say)] + ([_from(equations, beside.fit(likely), say)] if likely else [])
    now = max(ends, key=lambda end: _worth(equations, start, end))
    both = Part.of([equations.fit, equations.select])
    order = _in_order(equations, now.terms)
    errors = tuple(relative(fitted(equations, both, order[:k]), equations.report) for k in range(len(order) + 1))
    end = fitted(equations, both, order)
    return Found(start, end, tuple(_step(equations, order, k) for k in range(len(order))), errors)


def _worth(equations: Equations, one: Fit, other: Fit) -> float:
    """What another model is worth more than one."""
    won = gain(equations.select, one.left(equations.select), other.left(equations.select), equations.floor).power
    return won - sum(map(_price, other.terms)) + sum(map(_price, one.terms))


def _from(equations: Equations, now: Fit, say: Callable[[str], None]) -> Fit:
    """What a model ends as that is added to as long as that is worth it: first what has a name, then curves of what is left."""
    named = True
    for _ in range(MOVES * equations.log.n):
        beside = _Beside(equations, now)
        best = _best(beside, named)
        better = beside.fit(best) if best else now
        better = _settled(equations, better) if named else better
        if best is None or _worth(equations, now, better) <= 0.0:
            if not named:
                break
            named = False
            continue
        now = better
        names = " + ".join(dict.fromkeys(term.name for term in best.added))
        say(f"{names}: {100 * relative(now, equations.select):.3g} % of the torques that choose are left")
    return now


def relative(fit: Fit, part: Part) -> float:
    """What is left of all torques of a part, relative rms."""
    return float(np.sqrt(np.sum(fit.left(part) ** 2) / np.sum(part.tau**2)))


def gain(part: Part, before: Array, after: Array, noise: Array) -> Gain:
    """What is gained from one residual [S, n] of a part to another; residual powers are at least those of the `noise` [n, N m]."""
    powers = [np.maximum(np.mean(left**2, axis=0), noise**2) + 1e-300 for left in (before, after)]
    won = np.sum((before**2 - after**2) / powers[0], axis=1)
    pieces = np.bincount(part.block, won)[np.bincount(part.block) > 0]
    scatter = float(np.std(pieces, ddof=1)) * np.sqrt(len(pieces))
    return Gain(float(np.sum(np.log(powers[0] / powers[1]))), float(np.sum(pieces)) / max(scatter, 1e-300))


def _price(term: Term) -> float:
    return PRICE * CURVE + NAMELESS if term.name == "unknown" else PRICE * len(term.parameters)


def _best(beside: _Beside, named: bool) -> _Move | None:
    """The move that is worth most, if any is worth something: of terms that are `named`, or of curves."""
    there = [(term,) for term in _candidates(beside.equations, beside.now.terms) if (term.name != "unknown") == named]
    singles = [move for move in map(beside.with_, there) if move is not None]
    singles += filter(None, map(beside.weighed_anew, sorted(there, key=beside.fall)[-REWEIGHED:]))
    more = (beside.with_(terms) for terms in (_together(beside.equations, singles) if named else ()))
    good = [
        move for move in (*singles, *more) if move is not None and move.worth > 0.0 and move.gain.certainty > CERTAIN
    ]
    good.sort(key=lambda move: -move.worth)
    return next((move for move in good[:TRIED] if _either_way(beside, move)), None)


def _either_way(beside: _Beside, move: _Move) -> bool:
    """Whether it gains something, too, where what chose fits and what fitted chooses."""
    e, now = beside.equations, beside.now
    one, other = (fitted(e, e.select, terms) for terms in (now.terms, (*now.terms, *move.added)))
    return gain(e.fit, one.left(e.fit), other.left(e.fit), e.floor).power > 0.0


def _candidates(equations: Equations, have: Iterable[Term]) -> Iterator[Term]:
    """Every term that is not there yet; of the links' parameters, all widths."""
    have = tuple(have)
    there = {term.place for term in have}
    for term in equations.terms:
        if term.place not in there and term.shape == _shape(term, have):
            yield from [replace(term, width=width) for width in WIDTHS] if term.width else [term]


def _shape(term: Term, have: Terms) -> tuple[float, ...]:
    """The shape that a curve has beside those that are there; that of other terms is their own."""
    if not term.variable:
        return term.shape
    straight = any(one.joint == term.joint and one.name in STRAIGHT[term.variable] for one in have)
    return BENT if straight else WHOLE


def _together(equations: Equations, singles: Sequence[_Move]) -> Iterator[Terms]:
    """Pairs of the best terms at one joint, and terms of one name at every joint."""
    best: dict[tuple[str, int | None, str], Term] = {}
    for move in sorted(singles, key=lambda move: -move.worth):
        best.setdefault(move.added[0].place, move.added[0])
    terms = [term for term in best.values() if term.joint is not None]
    for j in range(equations.log.n):
        yield from combinations([term for term in terms if term.joint == j][:PAIRED], 2)
    if equations.log.n > 1:
        for name in dict.fromkeys(term.name for term in terms):
            yield tuple(term for term in terms if term.name == name)


def _settled(equations: Equations, now: Fit) -> Fit:
    """The same with terms exchanged for others at their joint that are better by now, and without those that are not worth their price any more."""
    part = equations.select
    for term in sorted(now.terms, key=lambda term: -_price(term)):
        rest = tuple(one for one in now.terms if one is not term)
        beside = _Beside(equations, fitted(equations, equations.fit, rest))
        own = gain(part, beside.before, now.left(part), equations.floor).power - _price(term)
        others = (
            other for other in _candidates(equations, rest) if other.joint == term.joint and other.name != "unknown"
        )
        tried = [move for other in others if (move := beside.with_((other,))) is not None]
        better = max(tried, key=lambda move: move.worth, default=None)
        if better is not None and better.worth > max(own + PRICE, 0.0):
            now = beside.fit(better)
        elif own <= 0.0 or not all(_possible(one, x) for one, x in equations.told(now.terms, now.coefficients)):
            now = beside.now
    return now


def _in_order(equations: Equations, terms: Terms) -> Terms:
    """The terms by what each is worth beside those before it."""
    order: Terms = ()
    while len(order) < len(terms):
        beside = _Beside(equations, fitted(equations, equations.fit, order))
        left = [move for term in terms if term not in order and (move := beside.with_((term,))) is not None]
        order += (
            max(left, key=lambda move: move.gain.power).added if left else tuple(t for t in terms if t not in order)
        )
    return order


def _step(equations: Equations, order: Terms, k: int) -> Step:
    """What the others would leave in the place of a term, all other terms being there."""
    term, rest = order[k], order[:k] + order[k + 1 :]
    beside = _Beside(equations, fitted(equations, equations.fit, rest))
    own = gain(
        equations.select, beside.before, fitted(equations, equations.fit, order).left(equations.select), equations.floor
    )
    best: dict[tuple[str, int | None, str], _Move] = {}
    for other in _candidates(equations, order):
        move = beside.with_((other,))
        if move is not None and move.worth > 0.0 and (other.place not in best or move.worth > best[other.place].worth):
            best[other.place] = move
    here = [move for place, move in best.items() if place[1] == term.joint or None in (place[1], term.joint)]
    others = sorted(here, key=lambda move: -move.gain.power)
    rivals = tuple((move.added[0], relative(beside.fit(move), equations.report)) for move in others[:RIVALS])
    tied = [move.added[0] for move in others if move.gain.power > own.power - max(PRICE, AS_GOOD * own.power)]
    return Step(term, own, rivals, tuple(term for term in tied if term.name != "unknown"))


def _possible(term: Term, coefficients: Array) -> bool:
    """Whether the numbers of a term are what they can be: friction does not push."""
    if term.name not in CATALOGUE or term.width:
        return True
    low, high = term.bounds
    values = term.told(coefficients)
    return bool(np.all((low <= values) & (values <= high)))
