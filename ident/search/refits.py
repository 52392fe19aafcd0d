"""Models of an arm with effects, refitted: hastily to compare them, finely to choose one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ident.arm.arm_fit import Problem, Slides, chi_squared, hold, slides, unexpected
from ident.arm.arm_model import Parameters
from ident.arm.coupled import DOUBTS, problem_of
from ident.arm.descent import Minimum, minimise
from ident.arm.evidence import Evidence
from ident.arm.following import follow
from ident.arm.parts import Split, degrees, few_lines, few_records, sampled
from ident.arm.sliding import TURNS
from ident.effects.base import Effect, winds_up
from ident.effects.carried import of_declared_links
from ident.effects.learned import Learned, as_damping
from ident.effects.waves import order_of
from ident.records.campaign import Array, Campaign
from ident.search.slopes import drawn_again, drawn_besides
from ident.search.trace import FEW_LINES, FEW_RECORDS, Linearised, linearise
from symgen.forked import forked
from symgen.plan import Model

#: Fall of chi^2 that ends a descent: of a candidate, of a finalist, of what is chosen; times that the weights of this are made
#: anew.
HASTILY, FINELY, FAINTLY, FULLY = 0.03, 0.002, 1e-4, 8
#: Times that motions are found anew for a model whose force follows from them, hastily and finely.
WOUND, WOUND_FINELY = 3, 5
#: Turns to the force of dry friction for a candidate; samples a line until one is chosen.
FEW_TURNS, FEW_SAMPLES = 15, 6
#: Lines of a record by which the arm without effects is looked for; by all, and a model at its minimum, where chi^2 per degree of
#: freedom is less than this.
FIRST_LINES, BY_ALL = 100, 10.0
#: chi^2 per degree of freedom above which something is left that is no noise.
NAMED = 1.1
#: chi^2 per degree of freedom so far beyond any noise that effects are looked for from the declared arm first.
FAR = 1000.0
#: How many times the noise the error of a model is that is near; chi^2 per degree of freedom so far beyond any noise that effects are
#: looked for from the declared arm, too.
CLOSE, BENT = 3.0, 100.0
#: Share of itself to which a fit makes chi^2 fall that goes on.
FALLING = 0.8
#: Times chi^2 per degree of freedom from which a last descent began that the choosing records then leave where it went astray.
ASTRAY = 3.0
#: chi^2 of a height of a learned curve of the size of all, so that one that no record shows stays at nothing.
UNSEEN_HEIGHT = 1e-4


@dataclass(frozen=True, eq=False)
class Bench:
    """The tools of one diagnosis: how to make a problem of records and effects, and the weights of the choosing records.

    The arm that is fitted begins at `guess`; chi^2 grows by `firm` where a number of it is off by all of its size. Nothing new is looked
    for once `time.monotonic()` is `until`. `at_first` is chi^2 on the choosing records without effects; lines on the way go to `say`.
    `declared` is the declared arm where `guess` is another. Where `only_names` are wanted no curves are drawn, and nothing is tried that
    promises nothing.
    """

    campaign: Campaign
    model: Model
    basis: Array
    split: Split
    guess: Parameters
    workers: int
    firm: float = 0.0
    until: float = np.inf
    say: Callable[[str], None] = lambda line: None
    at_first: float = np.inf
    declared: Parameters | None = None
    only_names: bool = False

    @property
    def late(self) -> bool:
        """Whether it is time to tell what was found."""
        return time.monotonic() > self.until

    def problem(
        self, data: tuple[Evidence, ...], effects: Sequence[Effect], scales: Sequence[float], limits: Sequence[tuple[float, float]],
        turns: int = TURNS,
    ) -> Problem:  # fmt: skip
        problem = problem_of(self.campaign, self.model, self.basis, data, self.guess, effects, scales, limits)
        held = [p.whole or p.declared or drawn_again(e, effects) for e in effects for p in e.parameters]
        free = problem.free.copy()
        free[problem.base :] = ~np.array(held, dtype=bool)
        free[[k for e in effects if (k := drawn_besides(e, problem.n)) is not None]] = False
        weights = [1.0 if p.aside else UNSEEN_HEIGHT * isinstance(e, Learned) for e in effects for p in e.parameters]
        weight = np.concatenate([np.full(problem.base, self.firm), weights])
        centre = np.concatenate([self.guess.vector(), np.zeros(len(weights))])
        expected = (centre, weight) if weight.any() else None
        return replace(problem, free=free, turns=turns, workers=self.workers, expected=expected, until=self.until)


@dataclass(frozen=True, eq=False)
class State:
    """A fitted model: its effects, its minimum on the fit records, chi^2 on the choosing ones, how `roughly` it was fitted (fall of
    chi^2 that ended it), whether with motions `followed`; both chi^2, and the information, as all lines would have it."""

    effects: tuple[Effect, ...]
    scales: tuple[float, ...]
    limits: tuple[tuple[float, float], ...]
    minimum: Minimum
    problem: Problem
    select: float
    roughly: float = 0.0
    followed: bool = False


@dataclass(frozen=True, eq=False)
class Refit:
    """A fit to be made: from where, with which effects, how finely (fall of chi^2 that ends it), first with `doubts`; dry friction
    from where it was found last, `slid`; by so many `lines` of a record, None: all, or few if hastily. Motions are held while values change, or
    `followed` where a force winds up, or rubs; by those records alone that move the joint of the last effect, its `own`; with the values
    of that effect `kept`."""

    vector: Array
    effects: tuple[Effect, ...]
    scales: tuple[float, ...]
    limits: tuple[tuple[float, float], ...]
    outer: int = 2
    roughly: float = FINELY
    doubts: tuple[float, ...] = ()
    slid: Slides = field(default_factory=dict)
    lines: int | None = None
    followed: bool = False
    own: bool = False
    kept: bool = False

    @staticmethod
    def of(state: State) -> Refit:
        """The same model, fitted finely."""
        outer = WOUND_FINELY if winding(state.effects) else 2
        return Refit(
            state.minimum.vector, state.effects, state.scales, state.limits, outer, slid=state.minimum.slid, followed=state.followed
        )  # fmt: skip


def _as_declared(bench: Bench, refit: Refit) -> Array:
    """Where the fit begins: with dampings that curves draw, too, as declared. What one that was found without its curve is more than that
    begins as part of the curve."""
    declared, vector = bench.guess.vector(), refit.vector.copy()
    n, base = len(bench.guess.K), len(vector) - len(refit.scales)
    for effect, slots in zip(refit.effects, _slots(refit), strict=True):
        k = drawn_besides(effect, n)
        if isinstance(effect, Learned) and k is not None and k >= 2 * n:
            more = (np.exp(vector[k]) - np.exp(declared[k])) * as_damping(effect)
            low, high = np.transpose([refit.limits[i] for i in slots])
            vector[base + slots] = np.clip(vector[base + slots] + more, low, high)
            vector[k] = declared[k]
    return vector


def all_fitted(bench: Bench, refits: Sequence[Refit]) -> Iterator[State]:
    """The models of `refits`, made by all workers; once it is late those that are not begun stay as they are, with chi^2 infinite."""

    def work(refit: Refit) -> tuple[Minimum, float]:
        if bench.late:
            return _unfitted(refit), np.inf
        state = fitted(bench, refit)
        return state.minimum, state.select

    for refit, (minimum, select) in zip(refits, forked(work, refits, bench.workers), strict=True):
        problem = bench.problem(bench.split.fit, refit.effects, refit.scales, refit.limits)
        problem = replace(problem, slid=minimum.slid)
        effects = problem.effects_at(minimum.vector)
        yield State(effects, refit.scales, refit.limits, minimum, problem, select, refit.roughly, refit.followed)


def lowest(bench: Bench, starts: Sequence[Refit]) -> State:
    """The model that fits best of those from these starts, hastily compared, or the first that leaves nothing."""
    found = until_nothing(bench, [replace(one, outer=1, roughly=HASTILY) for one in starts])
    return fitted(bench, Refit.of(min(found, key=lambda other: other.minimum.chi2)))


def until_nothing(bench: Bench, refits: Sequence[Refit]) -> list[State]:
    """The models of `refits`, up to the first that leaves nothing."""
    found = []
    for state in all_fitted(bench, refits):
        found.append(state)
        if reduced_chi2(bench, state) <= NAMED:
            break
    return found


def as_declared(bench: Bench, state: State) -> Array:
    """The declared arm with the effects of a model."""
    return np.concatenate([bench.guess.vector(), state.minimum.vector[state.problem.base :]])


def begun(bench: Bench) -> tuple[Bench, State]:
    """The bench, with what the arm without effects leaves, and that arm."""
    start = without_effects(bench)
    return replace(bench, at_first=start.select), start


def without_effects(bench: Bench) -> State:
    """The arm without effects: from what is declared, or by a detour where something is left; hastily where effects are looked for from
    what is declared anyway, closely where little is left."""
    start = Refit(bench.guess.vector(), (), (), (), lines=FIRST_LINES)
    best = detour = fitted(bench, replace(start, roughly=HASTILY))
    if reduced_chi2(bench, best) > NAMED:
        detour = fitted(bench, replace(start, outer=1, roughly=HASTILY, doubts=DOUBTS))
        best = min(best, detour, key=lambda state: state.minimum.chi2)
    if BY_ALL < reduced_chi2(bench, best) <= FAR:
        best = fitted(bench, start)
        if detour.minimum.chi2 < best.minimum.chi2:
            finely = fitted(bench, replace(Refit.of(detour), lines=FIRST_LINES))
            best = min(best, finely, key=lambda state: state.minimum.chi2)
    return best if reduced_chi2(bench, best) > BY_ALL else fitted(bench, Refit.of(best))


def fitted(bench: Bench, refit: Refit) -> State:
    """The model of `refit` at its minimum; chi^2 infinite where its response is no number. Its problem has the lines and samples that were
    fitted: of a hasty fit few."""
    hasty = refit.roughly == HASTILY
    more = (refit.effects, refit.scales, refit.limits, FEW_TURNS if hasty else TURNS)
    fit, select = bench.split.fit, bench.split.select
    # few samples tell what rubs so roughly that the very truth leaves more than noise
    rubs = any(effect.dry for effect in refit.effects)
    if refit.roughly > (FINELY if rubs else FAINTLY):
        fit, select = (tuple(sampled(one, FEW_SAMPLES) for one in part) for part in (fit, select))
    if refit.own:
        fit, select = (own_records(part, refit.effects[-1]) for part in (fit, select))
    lines = refit.lines or (FEW_LINES if hasty else None)
    if lines is not None:
        fit, select = (tuple(few_lines(one, lines) for one in part) for part in (fit, select))
    every = select
    if hasty:
        fit, select = few_records(fit, FEW_RECORDS), few_records(select, FEW_RECORDS)
    problem = replace(bench.problem(fit, *more), slid=refit.slid)
    if refit.kept:
        problem.free[-len(refit.effects[-1].values) :] = False
    try:
        with np.errstate(all="ignore"):
            if refit.followed and _moving(refit.effects):
                minimum = follow(problem, _as_declared(bench, refit), _moving(refit.effects), refit.roughly)
            else:
                minimum = minimise(problem, _as_declared(bench, refit), refit.doubts, refit.outer, refit.roughly)
            problem = replace(problem, slid=minimum.slid)
            chi2, slid = _left(problem, minimum.vector, select)
            if minimum.weighed is not None and chi2 / degrees(select) > ASTRAY * minimum.weighed[1] / degrees(fit):
                vector, before = minimum.weighed  # the motions held were no longer those of where it went
                less, there = _left(problem, vector, select)
                if less < chi2:
                    minimum, chi2, slid = replace(minimum, vector=vector, chi2=before), less, there
            if len(select) < len(every) and chi2 <= NAMED * degrees(select):  # which others may leave more of
                select, (chi2, slid) = every, _left(problem, minimum.vector, every)
            minimum = _by_all_lines(problem, replace(minimum, slid=slid), degrees(bench.split.fit) / degrees(fit))
    except (ValueError, np.linalg.LinAlgError):  # an effect so strong that the arm's response is no number
        minimum, chi2 = _unfitted(refit), np.inf
    effects, left = problem.effects_at(minimum.vector), chi2 * degrees(bench.split.select) / degrees(select)
    problem = replace(problem, turns=TURNS, slid=minimum.slid)  # what it is asked later it tells as closely as any
    return State(effects, refit.scales, refit.limits, minimum, problem, left, refit.roughly, refit.followed)


def _unfitted(refit: Refit) -> Minimum:
    """Where a fit begins, chi^2 infinite."""
    nothing = np.zeros((len(refit.vector), len(refit.vector)))
    return Minimum(refit.vector, nothing, np.inf, False, refit.slid)


def _left(problem: Problem, vector: Array, select: tuple[Evidence, ...]) -> tuple[float, Slides]:
    """chi^2 of records that choose, and where dry friction was found in these, too."""
    chosen = replace(problem, data=select)
    held = hold(chosen, vector, hurries=True)
    return chi_squared(chosen, vector, held), slides(chosen, held)


def own_records(part: Sequence[Evidence], effect: Effect) -> tuple[Evidence, ...]:
    """Those of some records that move the joint of an effect."""
    return tuple(one for one in part if one.excited == effect.joint)


def winding(effects: Sequence[Effect]) -> set[int | None]:
    """The joints that named effects wind up."""
    return {effect.joint for effect in effects if winds_up(effect) and not isinstance(effect, Learned)}


def _moving(effects: Sequence[Effect]) -> list[int]:
    """The joints that named effects wind up, or rub at: motions follow what is there most."""
    rubbing = {effect.joint for effect in effects if effect.dry and not isinstance(effect, Learned)}
    return sorted(joint for joint in winding(effects) | rubbing if joint is not None)


def _by_all_lines(problem: Problem, minimum: Minimum, times: float) -> Minimum:
    """A minimum by some lines as all, so many `times` as many, would have it; they tell no more of what is known beforehand."""
    beforehand = unexpected(problem, minimum.vector)[2]
    information = times * minimum.information - (times - 1.0) * beforehand
    return replace(minimum, chi2=times * minimum.chi2, information=information)


def linearised(problem: Problem, vector: Array) -> Linearised:
    """The fit about `vector`, forces told by as many samples as a candidate's."""
    problem = replace(problem, data=tuple(sampled(one, FEW_SAMPLES) for one in problem.data))
    return linearise(problem, vector, hold(problem, vector))


def without(bench: Bench, state: State, old: Effect, roughly: float = FINELY) -> State:
    """The model refitted without one of its effects."""
    keep = [k for k, e in enumerate(state.effects) if not same(e, old)]
    return fitted(bench, replace(some(state, keep), roughly=roughly))


def without_each(bench: Bench, state: State, effects: Sequence[Effect]) -> list[State]:
    """The model hastily refitted without each of some of its effects."""
    keep = [[k for k, e in enumerate(state.effects) if not same(e, old)] for old in effects]
    return list(all_fitted(bench, [replace(some(state, others), roughly=HASTILY) for others in keep]))


def reordered(bench: Bench, state: State, order: Sequence[int]) -> State:
    """The same model, its effects in another order."""
    slots, base = _slots(state), state.problem.base
    place = np.concatenate([np.arange(base), *(base + slots[k] for k in order)])
    new, old = some(state, order), state.minimum
    minimum = replace(old, vector=new.vector, information=old.information[np.ix_(place, place)], weighed=None)
    problem = bench.problem(state.problem.data, new.effects, new.scales, new.limits)
    problem = replace(problem, slid=old.slid)
    return replace(state, effects=new.effects, scales=new.scales, limits=new.limits, minimum=minimum, problem=problem)


def some(state: State, keep: Sequence[int]) -> Refit:
    """The model to be refitted with those of its effects at these places, dry friction from anywhere."""
    slots, base = _slots(state), state.problem.base
    use = np.concatenate([slots[k] for k in keep]) if keep else np.zeros(0, dtype=int)
    vector = np.concatenate([state.minimum.vector[:base], state.minimum.vector[base:][use]])
    effects, scales, limits = (
        tuple(state.effects[k] for k in keep), tuple(state.scales[k] for k in use), tuple(state.limits[k] for k in use)
    )  # fmt: skip
    return Refit(vector, effects, scales, limits)


def on_declared_links(state: State) -> Refit | None:
    """The model, to be refitted with effects that carry the declared links. None where they do."""
    effects = tuple(map(of_declared_links, state.effects))
    if effects == state.effects:
        return None
    base = state.problem.base
    use = np.concatenate([slots[: len(e.values)] for slots, e in zip(_slots(state), effects, strict=True)])
    vector = np.concatenate([state.minimum.vector[:base], state.minimum.vector[base:][use]])
    return Refit(vector, effects, tuple(state.scales[i] for i in use), tuple(state.limits[i] for i in use))


def standing(bench: Bench, state: State, keep: Sequence[int]) -> tuple[State, Linearised]:
    """The model with those of its effects at these places, the arm left as it is, and what is linearised there. Its chi^2 on the choosing
    records is what the others have, of as many lines; its minimum is that of all effects."""
    less = some(state, keep)
    problem = bench.problem(state.problem.data, less.effects, less.scales, less.limits)
    lin = linearised(problem, less.vector)
    left = lin.chi2 * degrees(bench.split.select) / degrees(problem.data)
    return replace(state, effects=less.effects, scales=less.scales, limits=less.limits, select=left), lin


def with_last(state: State, k: int) -> list[int]:
    """The places of all effects, that of effect k the last."""
    return [*(other for other in range(len(state.effects)) if other != k), k]


def but_last(state: State) -> range:
    """The places of all effects but the last."""
    return range(len(state.effects) - 1)


def instead(state: State, old: Effect, other: State) -> Refit:
    """The model to be refitted with the last effect of `other` in the place of one of its own."""
    parts = [(other, -1) if same(e, old) else (state, k) for k, e in enumerate(state.effects)]
    values = [of.minimum.vector[of.problem.base :][_slots(of)[k]] for of, k in parts]
    effects = tuple(of.effects[k] for of, k in parts)
    scales = tuple(of.scales[i] for of, k in parts for i in _slots(of)[k])
    limits = tuple(of.limits[i] for of, k in parts for i in _slots(of)[k])
    return Refit(np.concatenate([state.minimum.vector[: state.problem.base], *values]), effects, scales, limits)


def _slots(state: State | Refit) -> list[NDArray[np.int64]]:
    """Where the values of each effect lie among those of all."""
    return np.split(np.arange(len(state.scales)), np.cumsum([len(e.values) for e in state.effects], dtype=int))[:-1]


def same(a: Effect, b: Effect) -> bool:
    """Whether two effects are one, whatever its values: a wave of another order is another."""
    alike = type(a) is type(b) or a.name == b.name != "unknown"
    return alike and a.joint == b.joint and order_of(a) == order_of(b)


def reduced_chi2(bench: Bench, state: State) -> float:
    """chi^2 per degree of freedom on the choosing records."""
    return state.select / max(degrees(bench.split.select), 1)


def beyond_noise(state: State, lin: Linearised) -> float:
    """chi^2 beyond noise on the records that fit."""
    return max(lin.chi2 - degrees(state.problem.data), 1.0)
