"""The loop: the residual of the declared arm, the port where it acts, the effect that makes it; added, refitted, judged.

Three kinds of record keep it honest: the model is fitted on some, effects are chosen on others, errors are reported on
the rest. Nothing here knows more than the campaign file: the declared robot, the catalogue, the records.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from ident.arm_fit import (
    Evidence,
    Minimum,
    Problem,
    chi_squared,
    evidence,
    gravity_basis,
    hold,
    minimise,
    residual,
    spectrum,
)
from ident.arm_model import Parameters
from ident.campaign import Array, Campaign
from ident.candidates import Candidate, bounds, catalogue, curves, units
from ident.coupled import DOUBTS, declared_start, problem_of
from ident.deviations import Deviation, deviations
from ident.effects.base import Effect
from ident.effects.catalogue import CATALOGUE
from ident.errors import IdentError
from ident.forked import forked
from ident.frf import Complex, Frf, estimate
from ident.smoothing import TURNS
from ident.trace import PORTS, Linearised, linearise
from symgen.plan import Model

#: Effects added at most, and declared numbers corrected.
MOST_EFFECTS, MOST_OFF = 4, 6
#: Candidates of the catalogue refitted in each round (least and most), and learned curves.
REFITTED, CURVES = (6, 40), 2
#: Half of them whatever they promise, as a promise is of first order; as many as make this many numbers to be fitted.
EFFORT = 1.5e5
#: Candidates taken over from the declared arm.
SURELY = 4
#: Candidates fitted to the end before one is chosen.
FINALISTS = 3
#: Fall of chi^2 that ends a descent: of a candidate, of a finalist; times that the weights of what is chosen are made anew.
HASTILY, FINELY, FULLY = 0.03, 0.002, 8
#: Turns to the force of dry friction, and lines of a record, for a candidate.
FEW_TURNS, FEW_LINES = 15, 250
#: chi^2 per degree of freedom of a group of lines above which the arm is not explained, and the least of a group's degrees.
DEPARTURE, LEAST_DOF = 3.0, 40
#: An effect earns its place with this fall of chi^2 on the records that chose it, and this share of what was in excess.
LEAST_GAIN, LEAST_SHARE = 40.0, 0.2
#: A learned curve takes a name's place where it leaves less than this share of what the name leaves; it needs this share of
#: all that was in excess to be added.
CURVE_RATIO, CURVE_SHARE = 0.3, 0.05
#: Share of the excess that found effects may leave, as laws are known but the motion they act on is measured; below which
#: nothing more is looked for; and how many times the noise the error may be then.
LEFT, ENOUGH, CLOSE = 0.03, 3e-3, 3.0
#: Effects whose chi^2 on the choosing records differ by less than this, or by this share of what both leave, are not told apart.
TIE, ALIKE = 12.0, 0.05
#: Variance of J(q) at a record that does not fit, in units of one record's own: more, and it has to fit.
LEVERAGE = 3.0
#: Excited lines in a row that go to the same kind where lines take the place of records.
BLOCK = 3
#: Bands [Hz] in which errors are told, as far as the records reach.
EDGES = (0.0, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)


@dataclass(frozen=True, eq=False)
class Portion:
    """Lines of a record that belong to one of the three kinds; `lines` [L] of its evidence."""

    index: int
    lines: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Split:
    """Which records fit, choose and report; `note` says where the data did not reach for three different experiments."""

    fit: tuple[Evidence, ...]
    select: tuple[Evidence, ...]
    report: tuple[Evidence, ...]
    note: str


@dataclass(frozen=True)
class Errors:
    """Relative rms of theta - G tau over the excited lines: of all, per joint, per band; and what noise alone makes of it."""

    all: float
    per_joint: dict[str, float]
    per_band: dict[str, float]
    noise: float


@dataclass(frozen=True, eq=False)
class Added:
    """One effect that was added: `before` and `after` held-out errors; `gain` of chi^2 where it was chosen, of `excess`.

    `rivals` are the next best, with the held-out error each leaves; `tied` those that these records do not tell apart.
    `port_shares` is how much of the excess a free force at each (port, joint) would explain.
    """

    effect: Effect
    std: tuple[float, ...]
    before: float
    after: float
    gain: float
    excess: float
    rivals: tuple[tuple[Effect, float], ...]
    tied: tuple[Effect, ...]
    port_shares: tuple[tuple[str, int, float], ...]


@dataclass(frozen=True, eq=False)
class Departure:
    """A group of lines that stays unexplained: joint measured, band [Hz], kind of line, chi^2 per degree of freedom."""

    joint: int
    low: float
    high: float
    kind: str
    level: float
    share: float


@dataclass(frozen=True, eq=False)
class State:
    """A fitted model: its effects, its minimum on the fit records, chi^2 on the choosing ones, and their weights."""

    effects: tuple[Effect, ...]
    scales: tuple[float, ...]
    limits: tuple[tuple[float, float], ...]
    minimum: Minimum
    problem: Problem
    select: float


@dataclass(frozen=True, eq=False)
class Off:
    """A declared number that is off, held-out errors with it (and all less sure ones) as declared, and with it free;
    `without` is the model that keeps it."""

    deviation: Deviation
    before: float
    after: float
    without: State


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found. `start` is the arm without effects, `end` with them; `off` declared numbers that it contradicts, surest first; `status` as in the verdict format."""

    campaign: Campaign
    model: Model
    responses: tuple[Frf, ...]
    split: Split
    start: State
    end: State
    added: tuple[Added, ...]
    off: tuple[Off, ...]
    before: Errors
    after: Errors
    departures: tuple[Departure, ...]
    status: str


@dataclass(frozen=True, eq=False)
class _Bench:
    """The tools of one diagnosis: how to make a problem of records and effects, and the weights of the choosing records."""

    campaign: Campaign
    model: Model
    basis: Array
    split: Split
    guess: Parameters
    workers: int

    def problem(
        self, data: tuple[Evidence, ...], effects: Sequence[Effect], scales: Sequence[float], limits: Sequence[tuple[float, float]],
        turns: int = TURNS,
    ) -> Problem:  # fmt: skip
        problem = problem_of(self.campaign, self.model, self.basis, data, self.guess, effects, scales, limits)
        whole = [p.whole for e in effects for p in e.parameters]
        free = problem.free.copy()
        free[problem.base :] = ~np.array(whole, dtype=bool) if whole else free[problem.base :]
        return replace(problem, free=free, turns=turns)


def diagnose(
    campaign: Campaign, model: Model, *, workers: int = 1, progress: Callable[[str], None] = lambda line: None
) -> Diagnosis:
    """Returns what explains the records of `campaign` beyond the declared arm `model`, errors before and after.

    Candidates are tried by `workers` processes; the result does not depend on how many.
    Raises IdentError for a campaign without usable records.
    """
    if not campaign.records:
        raise IdentError("the campaign holds no records; expected at least one")
    responses = tuple(estimate(record, campaign) for record in campaign.records)
    basis = gravity_basis(model, campaign.gravity)
    data = tuple(evidence(campaign, model, basis, frf, k, "every") for k, frf in enumerate(responses))
    guess = declared_start(campaign, model, responses, basis)
    bench = _Bench(campaign, model, basis, split(data, model), guess, workers)
    start, state, added = _loop(bench, progress)
    left = _left_over(bench, start, state, added)
    if left and not bench.split.note and not _groups(bench, state, bench.split.fit):
        progress("only records that do not fit depart: once more with lines of every record in each part")
        bench = replace(bench, split=_split_lines(data, "what departs shows in too few records"))
        start, state, added = _loop(bench, progress)
        left = _left_over(bench, start, state, added)
    final = tuple(replace(a, effect=e, std=_std(state, e)) for e in state.effects for a in added if _same(a.effect, e))
    before, after = errors(bench, start, bench.split.report), errors(bench, state, bench.split.report)
    off = () if left else _off(bench, state)
    if off:
        before = errors(bench, off[0].without, bench.split.report) if not final else before
    status = "unexplained" if left else "effect-found" if final or off else "explained"
    return Diagnosis(campaign, model, responses, bench.split, start, state, final, off, before, after, left, status)


def _loop(bench: _Bench, progress: Callable[[str], None]) -> tuple[State, State, list[Added]]:
    """The arm without effects, with those that earned their place, and these in the order in which they were added."""
    start = state = _first(bench)
    added: list[Added] = []
    progress(f"the declared arm: chi2 {_excess(bench, state):.3g} a degree of freedom")
    for _ in range(MOST_EFFECTS):
        if not _departs(bench, state) or (added and _left(bench, start, state) < ENOUGH):
            break
        step = _round(bench, state, start.select, progress)
        if step is None:
            break
        state, entry = _pruned(bench, *step, progress)
        added.append(entry)
    return start, state, added


def _left_over(bench: _Bench, start: State, state: State, added: Sequence[Added]) -> tuple[Departure, ...]:
    """What stays unexplained, but for the small rest that known effects may leave."""
    little = added and _left(bench, start, state) < LEFT and _excess(bench, state) < CLOSE**2
    return () if little else departures(bench, state)


def _off(bench: _Bench, state: State) -> tuple[Off, ...]:
    """Declared numbers that the fitted arm contradicts, with the errors when they are kept: all, then one less at a time."""
    found = deviations(bench.campaign, bench.model, bench.basis, state.problem, state.minimum)[:MOST_OFF]
    result = []
    report, dof = bench.split.report, degrees(bench.split.select)
    kept_last = state
    for k in range(len(found) - 1, -1, -1):  # keep the least sure one, then the two least sure, ..
        kept = _kept(bench, state, found[k:])
        if kept.select < kept_last.select + LEAST_GAIN + max(state.select - dof, 0.0) / 2.0:
            continue
        result.append(Off(found[k], errors(bench, kept, report).all, errors(bench, kept_last, report).all, kept))
        kept_last = kept
    return tuple(reversed(result))


def _kept(bench: _Bench, state: State, declared: Sequence[Deviation]) -> State:
    """The model refitted with these numbers as declared."""
    problem, vector = state.problem, state.minimum.vector.copy()
    free = problem.free.copy()
    for one in declared:
        vector[one.indices] = one.declared
        free[one.indices] = False
    problem = replace(problem, free=free)
    minimum = minimise(problem, vector, (), 1, FINELY)
    chosen = replace(problem, data=bench.split.select)
    select = chi_squared(chosen, minimum.vector, hold(chosen, minimum.vector))
    return replace(state, minimum=minimum, problem=problem, select=select)


def _same(a: Effect, b: Effect) -> bool:
    return (a.name, a.joint, a.port) == (b.name, b.joint, b.port)


def split(data: tuple[Evidence, ...], model: Model) -> Split:
    """Three kinds of record: of each joint's records in turn one reports, one chooses, the others fit, as far as they reach.

    Everything about J(q) and gravity that all records show must be shown by those that fit, and every joint excited by one
    that chooses. Where there are too few records for that, lines take their place: blocks of neighbouring ones by turns.
    """
    kinds = {k: "fit" for k in range(len(data))}
    turn = 0
    for joint in sorted({one.excited for one in data}):
        own = [k for k, one in enumerate(data) if one.excited == joint]
        for place in range(len(own) - 1, 0, -1):
            if (len(own) - 1 - place) % 4 < 2:
                kinds[own[place]] = ("report", "select")[turn % 2]
                turn += 1
    kinds = _enough(data, model, kinds)
    fit, select, report = (
        tuple(one for k, one in enumerate(data) if kinds[k] == kind) for kind in ("fit", "select", "report")
    )
    if report and {one.excited for one in select} == {one.excited for one in data}:
        return Split(fit, select, report, "")
    return _split_lines(data, "too few records")


def _enough(data: tuple[Evidence, ...], model: Model, kinds: dict[int, str]) -> dict[int, str]:
    """Moves records to those that fit, the one least told by them first, until these tell what the arm is at all the others.

    What they tell: the variance of J_ij(q) / sqrt(J_ii J_jj) there and of the gravity stiffness, each entry measured once
    by each record, unit error.
    """
    rows = []
    for one in data:
        size = np.sqrt(np.diag(model.J_cad(one.scene.posture)))
        J = (model.J_rows(one.scene.posture) / np.outer(size, size)[..., None]).reshape(-1, len(model.names))
        rows.append(block_diag(J, one.scene.arm.K_rows.reshape(-1, one.scene.arm.K_rows.shape[2])))
    scale = np.linalg.norm(np.concatenate(rows), axis=0)
    rows = [row / np.where(scale > 0.0, scale, 1.0) for row in rows]
    while True:
        fitting = [rows[k] for k, kind in kinds.items() if kind == "fit"]
        others = [k for k, kind in kinds.items() if kind != "fit"]
        if not others:
            return kinds
        spread = np.linalg.pinv(sum(row.T @ row for row in fitting), rcond=1e-9, hermitian=True)
        seen = spread @ sum(row.T @ row for row in fitting)
        told = {
            k: float(np.einsum("ia,ab,ib->i", rows[k], spread, rows[k]).max())
            + 1e6 * float(np.abs(rows[k] @ (np.eye(len(seen)) - seen)).max() > 1e-6)
            for k in others
        }
        worst = max(told, key=lambda k: told[k])
        if told[worst] <= LEVERAGE:
            return kinds
        kinds[worst] = "fit"


def _split_lines(data: tuple[Evidence, ...], why: str) -> Split:
    """Of every record two blocks of lines in four fit, one chooses, one reports."""
    note = f"{why}: fitting, choosing and reporting lines are blocks of each record by turns"
    fit, select, report = (
        tuple(lines_of(one, np.isin(np.cumsum(one.is_excited) // BLOCK % 4, turns)) for one in data)
        for turns in ((0, 2), (1,), (3,))
    )
    return Split(fit, select, report, note)


def lines_of(one: Evidence, use: NDArray[np.bool_]) -> Evidence:
    """The same record, judged at some of its lines; its motion is still that of all."""
    return replace(one, judged=use if one.judged is None else use & one.judged)


def _first(bench: _Bench) -> State:
    """The arm without effects: from what is declared, at once and by detours."""
    states = [_fitted(bench, _Refit(bench.guess.vector(), (), (), ()), doubts) for doubts in ((), DOUBTS)]
    return min(states, key=lambda s: s.minimum.chi2)


def _fitted(bench: _Bench, refit: _Refit, doubts: Sequence[float] = ()) -> State:
    hasty = refit.roughly == HASTILY
    more = (refit.effects, refit.scales, refit.limits, FEW_TURNS if hasty else TURNS)
    fit, select = (tuple(map(_few_lines, part)) if hasty else part for part in (bench.split.fit, bench.split.select))
    problem, chosen = bench.problem(fit, *more), bench.problem(select, *more)
    minimum = minimise(problem, refit.vector, doubts, refit.outer, refit.roughly)
    chi2 = chi_squared(chosen, minimum.vector, hold(chosen, minimum.vector))
    share = degrees(bench.split.select) / degrees(select)
    return State(problem.effects_at(minimum.vector), refit.scales, refit.limits, minimum, problem, chi2 * share)


def _few_lines(one: Evidence) -> Evidence:
    """The same record, judged at `FEW_LINES` of its lines at most."""
    judged = np.flatnonzero(one.use)
    if len(judged) <= FEW_LINES:
        return one
    few = np.zeros(len(one.use), dtype=bool)
    few[judged[np.linspace(0, len(judged) - 1, FEW_LINES).round().astype(int)]] = True
    return lines_of(one, few)


def degrees(data: Sequence[Evidence]) -> int:
    """Real numbers measured at the lines judged."""
    return sum(2 * one.scene.theta.shape[1] * one.count for one in data)


def _excess(bench: _Bench, state: State) -> float:
    """chi^2 per degree of freedom on the choosing records."""
    return state.select / max(degrees(bench.split.select), 1)


def _left(bench: _Bench, start: State, state: State) -> float:
    """Share of what was in excess on the choosing records that still is."""
    dof = degrees(bench.split.select)
    return (state.select - dof) / max(start.select - dof, 1.0)


def _departs(bench: _Bench, state: State) -> bool:
    """Whether anything but noise may be left, on the records that fit and choose."""
    return bool(_groups(bench, state, bench.split.fit + bench.split.select)) or _excess(bench, state) > 1.1


def _round(bench: _Bench, state: State, first: float, progress: Callable[[str], None]) -> tuple[State, Added] | None:
    """The model with one effect more, if any earns it; `first` is chi^2 on the choosing records before any was added."""
    lin = linearise(state.problem, state.minimum.vector, hold(state.problem, state.minimum.vector))
    shares = port_shares(lin)
    wanted = LEAST_SHARE * max(lin.chi2 - degrees(state.problem.data), 1.0)
    most = int(np.clip(EFFORT / degrees(state.problem.data), *REFITTED))
    likely = [
        c for k, c in enumerate(catalogue(lin, state.effects, bench.workers)[:most]) if c.gain > wanted or k < most // 2
    ]
    short = [(c, lin) for c in (*likely, *(c for c in curves(lin)[:CURVES] if c.gain > wanted))]
    if not state.effects:  # a fit that is far off bends everything else: look from the declared arm, too
        vector = bench.guess.vector()
        declared = linearise(state.problem, vector, hold(state.problem, vector))
        short += [(c, declared) for c in catalogue(declared, (), bench.workers)[:SURELY]]
    tried: list[tuple[Candidate, State]] = []
    refits = [_with(bench, state, candidate, origin) for candidate, origin in short]
    for (candidate, _), new in zip(short, _all_fitted(bench, refits), strict=True):
        tried.append((candidate, new))
        progress(f"  {_name(new.effects[-1])}: {_excess(bench, new):.4g}, promised {candidate.gain:.3g}")
    dof = degrees(bench.split.select)
    named = [pair for pair in tried if pair[0].effect.name != "unknown"]
    drawn = [pair for pair in tried if pair[0].effect.name == "unknown"]
    for kind in (named, drawn):
        kind.sort(key=lambda pair: pair[1].select)
    finalists = named[:FINALISTS] + drawn[:1]
    polished = _all_fitted(bench, [_Refit.of(new) for _, new in finalists])
    better = [(candidate, new) for (candidate, _), new in zip(finalists, polished, strict=True)]
    named[:FINALISTS], drawn[:1] = better[: len(named[:FINALISTS])], better[len(named[:FINALISTS]) :]
    tried = named + drawn
    best = _plainest(named, dof)
    curve = min(drawn, key=lambda pair: pair[1].select, default=None)
    if best is None or (curve is not None and _much_better(bench, curve[1].select - dof, best[1])):
        best = curve
    if best is None:
        return None
    best = (best[0], _since(bench, _fitted(bench, replace(_Refit.of(best[1]), outer=FULLY))))
    less = _without(bench, best[1], best[1].effects[-1])  # what is gained by a better fit is no gain of the effect
    state = less if less.select < state.select else state
    gain, excess = state.select - best[1].select, max(state.select - dof, 1.0)
    least = CURVE_SHARE * first if best is curve else 0.0
    if gain < max(LEAST_GAIN, LEAST_SHARE * excess, least, ENOUGH * (first - dof)):
        return None
    report = bench.split.report
    winner = best[0].key
    rivals = sorted((pair for pair in tried if pair[0].key != winner), key=lambda pair: pair[1].select)
    entry = Added(
        effect=best[1].effects[-1],
        std=(),
        before=errors(bench, state, report).all,
        after=errors(bench, best[1], report).all,
        gain=gain,
        excess=excess,
        rivals=tuple((pair[1].effects[-1], errors(bench, pair[1], report).all) for pair in rivals[:3]),
        tied=tuple(
            pair[1].effects[-1] for pair in rivals
            if pair[1].select < best[1].select + TIE + ALIKE * max(best[1].select - dof, 0.0) and pair[0].effect.name != "unknown"
        ),
        port_shares=shares,
    )  # fmt: skip
    return best[1], entry


def _plainest(named: Sequence[tuple[Candidate, State]], dof: int) -> tuple[Candidate, State] | None:
    """The best of the named candidates; of those that are not told apart from it the one with the fewest parameters."""
    if not named:
        return None
    least = min(pair[1].select for pair in named)
    limit = least + TIE + ALIKE * max(least - dof, 0.0)
    order = list(CATALOGUE)
    return min(
        (pair for pair in named if pair[1].select <= limit),
        key=lambda pair: (len(pair[0].effect.values), order.index(pair[0].effect.name), pair[1].select),
    )


def _much_better(bench: _Bench, by_curve: float, named: State) -> bool:
    """Whether a learned curve, that can play any law of its variable, leaves so much less than a name that the name is wrong."""
    by_name = named.select - degrees(bench.split.select)
    return by_curve < CURVE_RATIO * by_name - LEAST_GAIN and _excess(bench, named) > (CLOSE / 2.0) ** 2


@dataclass(frozen=True, eq=False)
class _Refit:
    """A fit to be made: from where, with which effects, how finely (fall of chi^2 that ends it)."""

    vector: Array
    effects: tuple[Effect, ...]
    scales: tuple[float, ...]
    limits: tuple[tuple[float, float], ...]
    outer: int = 2
    roughly: float = FINELY

    @staticmethod
    def of(state: State) -> _Refit:
        """The same model, fitted finely."""
        return _Refit(state.minimum.vector, state.effects, state.scales, state.limits)


def _all_fitted(bench: _Bench, refits: Sequence[_Refit]) -> Iterator[State]:
    """The models of `refits`, made by all workers."""

    def fitted(refit: _Refit) -> tuple[Minimum, float]:
        state = _fitted(bench, refit)
        return state.minimum, state.select

    for refit, (minimum, select) in zip(refits, forked(fitted, refits, bench.workers), strict=True):
        problem = bench.problem(bench.split.fit, refit.effects, refit.scales, refit.limits)
        yield State(problem.effects_at(minimum.vector), refit.scales, refit.limits, minimum, problem, select)


def _with(bench: _Bench, state: State, candidate: Candidate, lin: Linearised) -> _Refit:
    """The model with a candidate, to be refitted hastily."""
    unit = units(lin, type(candidate.effect), candidate.effect.joint)
    limits = tuple(bounds(p, u) for p, u in zip(candidate.effect.parameters, unit, strict=True))
    return _Refit(
        np.concatenate([lin.vector, candidate.effect.values]), (*state.effects, candidate.effect),
        state.scales + candidate.scales, state.limits + limits, 1, HASTILY,
    )  # fmt: skip


def _since(bench: _Bench, state: State) -> State:
    """The same model, its last effect since the record that the choosing ones tell, of those between two that fit."""
    effect = state.effects[-1]
    names = [p.name for p in effect.parameters]
    if "record" not in names:
        return state
    place = state.problem.base + sum(len(e.values) for e in state.effects[:-1]) + names.index("record")
    now = int(effect["record"])
    earlier = [one.index + 1 for one in bench.split.fit if one.index + 1 < now]
    best = state
    for record in range(max(earlier, default=1) + 1, now):
        vector = state.minimum.vector.copy()
        vector[place] = record
        chosen = replace(state.problem, data=bench.split.select)
        select = chi_squared(chosen, vector, hold(chosen, vector))
        if select < best.select:
            minimum = replace(state.minimum, vector=vector)
            best = replace(state, effects=state.problem.effects_at(vector), minimum=minimum, select=select)
    return best


def _pruned(bench: _Bench, state: State, entry: Added, progress: Callable[[str], None]) -> tuple[State, Added]:
    """The model without those earlier effects that the new one has made superfluous."""
    for old in state.effects[:-1]:
        if entry.effect.name == "unknown" and old.name != "unknown":
            continue  # a curve can play any law of its variable: it takes no name away
        less = _without(bench, state, old)
        if less.select < state.select + LEAST_GAIN:
            progress(f"  without {_name(old)} as well: {_excess(bench, less):.4g}")
            state = less
    return state, entry


def _without(bench: _Bench, state: State, old: Effect) -> State:
    """The model refitted without one of its effects."""
    keep = [k for k, e in enumerate(state.effects) if not _same(e, old)]
    slots = np.split(np.arange(len(state.scales)), np.cumsum([len(e.values) for e in state.effects])[:-1])
    use = np.concatenate([slots[k] for k in keep]) if keep else np.zeros(0, dtype=int)
    base = state.problem.base
    vector = np.concatenate([state.minimum.vector[:base], state.minimum.vector[base:][use]])
    effects, scales, limits = (
        tuple(state.effects[k] for k in keep), tuple(state.scales[k] for k in use), tuple(state.limits[k] for k in use)
    )  # fmt: skip
    return _fitted(bench, _Refit(vector, effects, scales, limits))


def _std(state: State, effect: Effect) -> tuple[float, ...]:
    """Standard deviations of an effect's values."""
    values, vectors, seen = spectrum(state.minimum.information)
    lifted = np.where(seen, values, np.inf)
    deviation = np.sqrt(np.einsum("ik,k,ik->i", vectors, 1.0 / lifted, vectors)) * state.problem.scale
    k = state.problem.base
    for e in state.effects:
        if _same(e, effect):
            return tuple(deviation[k : k + len(e.values)].tolist())
        k += len(e.values)
    return ()


def port_shares(lin: Linearised) -> tuple[tuple[str, int, float], ...]:
    """How much of what is in excess of noise a free force at each (port, joint) explains, largest first.

    One complex number a line for every port: each takes 2 of its 2 m degrees of freedom. 1 means that all of the residual
    points where that port pushes.
    """
    left: dict[tuple[str, int], float] = {}
    total = 0.0
    for one, r, ports in zip(lin.problem.data, lin.r, lin.ports, strict=True):
        use = one.use
        total += 2.0 * float(np.sum(np.abs(r[use]) ** 2)) - 2.0 * r[use].size
        for key, a in ports.items():
            along = np.abs(np.sum(a.conj() * r, axis=1)) ** 2 / np.maximum(np.sum(np.abs(a) ** 2, axis=1), 1e-300)
            left[key] = left.get(key, 0.0) + 2.0 * float(np.sum(along[use])) - 2.0 * int(use.sum())
    shares = [
        (port, joint, value / total if total > 0.0 else 0.0) for (port, joint), value in left.items() if port in PORTS
    ]
    return tuple(sorted(shares, key=lambda share: -share[2]))


def errors(bench: _Bench, state: State, data: Sequence[Evidence]) -> Errors:
    """Relative rms errors of the excited joint's angle at the excited lines of `data`."""
    problem = bench.problem(tuple(data), state.effects, state.scales, state.limits)
    held = hold(problem, state.minimum.vector)
    squares: list[tuple[int, Array, Array, Array]] = []
    for one, kept in zip(data, held, strict=True):
        r, W = residual(problem, state.minimum.vector, one, kept.moved)[0], kept.W
        k = int(np.flatnonzero(one.scene.arm.live == one.excited)[0])
        use = one.is_excited & one.use
        size = np.maximum(np.abs(one.scene.theta[use, k]) ** 2, 1e-300)
        inverse = np.linalg.inv(W[use])
        variance = np.sum(np.abs(inverse[:, k]) ** 2, axis=1)
        squares.append((one.excited, one.sampling.f[use], np.abs(r[use, k]) ** 2 / size, variance / size))
    joints = np.concatenate([np.full(len(f), j) for j, f, _, _ in squares])
    f, error, noise = (np.concatenate([row[k] for row in squares]) for k in (1, 2, 3))

    def rms(values: Array) -> float:
        return float(np.sqrt(values.mean()))

    names = bench.campaign.joints
    return Errors(
        rms(error),
        {names[j]: rms(error[joints == j]) for j in np.unique(joints).tolist()},
        {f"{a:g}-{b:g} Hz": rms(error[(f >= a) & (f < b)]) for a, b in pairwise(EDGES)
         if np.any((f >= a) & (f < b))},
        rms(noise),
    )  # fmt: skip


def _groups(
    bench: _Bench, state: State, data: Sequence[Evidence]
) -> list[tuple[int, int, float, float, str, float, float]]:
    """Groups of lines beyond `DEPARTURE`: (record, joint, low, high, kind, level, chi^2 in excess)."""
    problem = bench.problem(tuple(data), state.effects, state.scales, state.limits)
    held = hold(problem, state.minimum.vector)
    found = []
    for one, kept in zip(data, held, strict=True):
        r, W = residual(problem, state.minimum.vector, one, kept.moved)[0], kept.W
        power = 2.0 * np.abs((W @ r[..., None])[..., 0]) ** 2
        odd = one.scene.lines % 2 == 1
        kinds = {"excited": one.is_excited, "odd": odd & ~one.is_excited, "even": ~odd & ~one.is_excited}
        f = one.sampling.f
        for low, high in pairwise(EDGES):
            for kind, which in kinds.items():
                use = which & one.use & (f >= low) & (f < high)
                if 2 * int(use.sum()) < LEAST_DOF:
                    continue
                for k, joint in enumerate(one.scene.arm.live.tolist()):
                    level = float(power[use, k].mean() / 2.0)
                    if level > DEPARTURE:
                        found.append((one.index, joint, low, high, kind, level, float(power[use, k].sum())))
    return found


def departures(bench: _Bench, state: State) -> tuple[Departure, ...]:
    """What stays unexplained on the choosing and reporting records: joints, bands and kinds of line, largest share first."""
    data = bench.split.select + bench.split.report
    groups = _groups(bench, state, data)
    total = sum(group[6] for group in groups)
    merged: dict[tuple[int, float, float, str], list[float]] = {}
    for _, joint, low, high, kind, level, power in groups:
        entry = merged.setdefault((joint, low, high, kind), [0.0, 0.0])
        entry[0], entry[1] = max(entry[0], level), entry[1] + power
    rows = [
        Departure(j, low, high, kind, level, power / total) for (j, low, high, kind), (level, power) in merged.items()
    ]
    return tuple(sorted(rows, key=lambda d: -d.share))


def _name(effect: Effect) -> str:
    place = "" if effect.joint is None else f" at joint {effect.joint + 1}"
    return f"{effect.name}{place} {[float(f'{v:.4g}') for v in effect.values][:4]}"


Record = Complex
