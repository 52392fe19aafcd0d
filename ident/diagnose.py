"""The loop: the residual of the declared arm, the port where it acts, the effect that makes it; added, refitted, judged.

Three kinds of record keep it honest: the model is fitted on some, effects are chosen on others, errors are reported on
the rest. Nothing here knows more than the campaign file: the declared robot, the catalogue, the records.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.arm_fit import chi_squared, hold, minimise, spectrum
from ident.campaign import Campaign
from ident.candidates import Candidate, bounds, catalogue, curves, units
from ident.coupled import declared_start
from ident.departures import Departure, Errors, departures, errors, groups
from ident.deviations import Deviation, deviations
from ident.effects.base import Effect
from ident.effects.catalogue import CATALOGUE
from ident.effects.learned import Learned
from ident.errors import IdentError
from ident.evidence import Evidence, evidence, gravity_basis
from ident.frf import Frf, estimate
from ident.parts import Split, degrees, split, split_lines
from ident.refits import FINELY, FULLY, HASTILY, Bench, Refit, State, all_fitted, excess, first, fitted, same, without
from ident.trace import Linearised, linearise, port_shares
from symgen.plan import Model

#: Effects added at most, and declared numbers corrected.
MOST_EFFECTS, MOST_OFF = 4, 6
#: Candidates of the catalogue refitted in each round (least and most), and learned curves.
REFITTED, CURVES = (6, 40), 2
#: Half of them whatever they promise, as a promise is of first order; as many as make this many numbers to be fitted.
EFFORT = 1.5e5
#: Candidates taken over from the declared arm.
SURELY = 6
#: Candidates fitted finely before one is chosen; while none is near, those whose chi^2 falls to this share go on so many times.
FINALISTS, FALLING, PATIENCE = 3, 0.7, 4
#: An effect earns its place with this fall of chi^2 on the records that chose it, and this share of what was in excess.
LEAST_GAIN, LEAST_SHARE = 40.0, 0.2
#: A learned curve takes a name's place where it leaves less than this share of what the name leaves; it needs this share of
#: all that was in excess to be added.
CURVE_RATIO, CURVE_SHARE = 0.3, 0.05
#: chi^2 per degree of freedom above which a name leaves something for a curve to explain.
NAMED = 1.1
#: The excess of chi^2 on the choosing records is so many times that on the fitting ones where these bend what is free.
BENDS = 30.0
#: Share of the excess that found effects may leave, as laws are known but the motion they act on is measured; below which
#: nothing more is looked for; and how many times the noise the error may be then.
LEFT, ENOUGH, CLOSE = 0.03, 3e-3, 3.0
#: Effects whose chi^2 on the choosing records differ by less than this, or by this share of what both leave, are not told apart.
TIE, ALIKE = 12.0, 0.05


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
    bench = Bench(campaign, model, basis, split(data, model), guess, workers)
    start = first(bench)
    if not bench.split.note and _bends(bench, start):
        bench, start = _by_lines(bench, data, progress)
    state, added = _loop(bench, start, progress)
    left = _left_over(bench, start, state, added)
    if left and not bench.split.note and not groups(bench, state, bench.split.fit):
        bench, start = _by_lines(bench, data, progress)
        state, added = _loop(bench, start, progress)
        left = _left_over(bench, start, state, added)
    final = tuple(replace(a, effect=e, std=_std(state, e)) for e in state.effects for a in added if same(a.effect, e))
    before, after = errors(bench, start, bench.split.report), errors(bench, state, bench.split.report)
    off = () if left else _off(bench, state)
    if off:
        before = errors(bench, off[0].without, bench.split.report) if not final else before
    status = "unexplained" if left else "effect-found" if final or off else "explained"
    return Diagnosis(campaign, model, responses, bench.split, start, state, final, off, before, after, left, status)


def _bends(bench: Bench, state: State) -> bool:
    """Whether a model fits the records that fit so much better than the others that these leave too much of it free."""
    fitting = state.minimum.chi2 / degrees(bench.split.fit)
    return excess(bench, state) - 1.0 > BENDS * (max(fitting - 1.0, 0.0) + 0.1)


def _by_lines(bench: Bench, data: tuple[Evidence, ...], progress: Callable[[str], None]) -> tuple[Bench, State]:
    """All records in each part, and the arm without effects."""
    progress("what departs hardly shows in the records that fit: lines of every record in each part")
    bench = replace(bench, split=split_lines(data, "what departs shows in too few records"))
    return bench, first(bench)


def _loop(bench: Bench, start: State, progress: Callable[[str], None]) -> tuple[State, list[Added]]:
    """The arm with those effects that earned their place beyond `start`, and these in the order in which they were added."""
    state = start
    added: list[Added] = []
    progress(f"the declared arm: chi2 {excess(bench, state):.3g} a degree of freedom")
    for _ in range(MOST_EFFECTS):
        if not _departs(bench, state) or (added and _left(bench, start, state) < ENOUGH):
            break
        step = _round(bench, state, start.select, progress)
        if step is None:
            break
        state, entry = _pruned(bench, *step, progress)
        added.append(entry)
    return state, added


def _left_over(bench: Bench, start: State, state: State, added: Sequence[Added]) -> tuple[Departure, ...]:
    """What stays unexplained, but for the small rest that known effects may leave."""
    little = added and _left(bench, start, state) < LEFT and excess(bench, state) < CLOSE**2
    return () if little else departures(bench, state)


def _off(bench: Bench, state: State) -> tuple[Off, ...]:
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


def _kept(bench: Bench, state: State, declared: Sequence[Deviation]) -> State:
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


def _left(bench: Bench, start: State, state: State) -> float:
    """Share of what was in excess on the choosing records that still is."""
    dof = degrees(bench.split.select)
    return (state.select - dof) / max(start.select - dof, 1.0)


def _departs(bench: Bench, state: State) -> bool:
    """Whether anything but noise may be left, on the records that fit and choose."""
    return bool(groups(bench, state, bench.split.fit + bench.split.select)) or excess(bench, state) > 1.1


def _round(bench: Bench, state: State, first: float, progress: Callable[[str], None]) -> tuple[State, Added] | None:
    """The model with one effect more, if any earns it; `first` is chi^2 on the choosing records before any was added."""
    lin = linearise(state.problem, state.minimum.vector, hold(state.problem, state.minimum.vector))
    tried = _polished(bench, _tried(bench, state, lin, progress), progress)
    best = _chosen(bench, tried, state.select)
    if best is None or not np.isfinite(best[1].select):
        return None
    new = _since(bench, fitted(bench, replace(Refit.of(best[1]), outer=FULLY, roughly=1e-4)))
    less = without(bench, new, new.effects[-1])  # what is gained by a better fit is no gain of the effect
    state = less if less.select < state.select else state
    dof = degrees(bench.split.select)
    gain, before = state.select - new.select, max(state.select - dof, 1.0)
    least = CURVE_SHARE * first if _is_curve(best) else 0.0
    if gain < max(LEAST_GAIN, LEAST_SHARE * before, least, ENOUGH * (first - dof)):
        return None
    others = [pair for pair in tried if pair[0].key != best[0].key and np.isfinite(pair[1].select)]
    rivals = sorted((other for _, other in others), key=lambda other: other.select)
    report = bench.split.report
    entry = Added(
        effect=new.effects[-1],
        std=(),
        before=errors(bench, state, report).all,
        after=errors(bench, new, report).all,
        gain=gain,
        excess=before,
        rivals=tuple((other.effects[-1], error) for other in rivals[:3] if (error := _error(bench, other)) < np.inf),
        tied=tuple(
            other.effects[-1] for other in rivals
            if other.select < new.select + TIE + ALIKE * max(new.select - dof, 0.0) and other.effects[-1].name != "unknown"
        ),
        port_shares=port_shares(lin),
    )  # fmt: skip
    return new, entry


#: A candidate as it was promised, and the model refitted with it.
Tried = tuple[Candidate, State]


def _is_curve(one: Tried) -> bool:
    return one[0].effect.name == "unknown"


def _tried(bench: Bench, state: State, lin: Linearised, progress: Callable[[str], None]) -> list[Tried]:
    """The likeliest candidates beyond `state`, linearised in `lin`, hastily refitted."""
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
    refits = [_with(bench, state, candidate, origin) for candidate, origin in short]
    tried = []
    for (candidate, _), new in zip(short, all_fitted(bench, refits), strict=True):
        tried.append((candidate, new))
        progress(f"  {_name(new.effects[-1])}: {excess(bench, new):.4g}, promised {candidate.gain:.3g}")
    return tried


def _polished(bench: Bench, tried: Sequence[Tried], progress: Callable[[str], None]) -> list[Tried]:
    """The candidates, the best fitted finely; where none of these is near, what promised most besides (it may have been
    far from its place), and what still falls again and again."""
    near = CLOSE**2 * degrees(bench.split.select)
    named = sorted((one for one in tried if not _is_curve(one)), key=_select)
    drawn = sorted((one for one in tried if _is_curve(one)), key=_select)
    best, others = named[:FINALISTS] + drawn[:1], named[FINALISTS:]
    if named and _select(named[0]) > near:
        surest = sorted(others, key=lambda one: -one[0].gain)[:FINALISTS]
        best, others = best + surest, [one for one in others if one not in surest]
    falling, settled = best, []
    for _ in range(1 + PATIENCE):
        new = list(all_fitted(bench, [Refit.of(state) for _, state in falling]))
        finer = [(candidate, state) for (candidate, _), state in zip(falling, new, strict=True)]
        for _, state in finer:
            progress(f"  finely, {_name(state.effects[-1])}: {excess(bench, state):.4g}")
        fell = [now.select < FALLING * before.select for (_, before), now in zip(falling, new, strict=True)]
        settled += [one for one, still in zip(finer, fell, strict=True) if not still]
        falling = [one for one, still in zip(finer, fell, strict=True) if still]
        if not falling or min(map(_select, settled + falling)) <= near:
            break
    return settled + falling + others + drawn[1:]


def _select(one: Tried) -> float:
    return one[1].select


def _chosen(bench: Bench, tried: Sequence[Tried], before: float) -> Tried | None:
    """The candidate that is chosen: the best name, or the best curve where no name earns what that does; `before` is
    chi^2 on the choosing records without any."""
    dof = degrees(bench.split.select)
    name = _plainest([one for one in tried if not _is_curve(one)], dof)
    curve = min((one for one in tried if _is_curve(one)), key=_select, default=None)
    earned = name is not None and before - _select(name) > max(LEAST_GAIN, LEAST_SHARE * (before - dof))
    if name is None or (curve is not None and (not earned or _much_better(bench, _select(curve) - dof, name[1]))):
        return curve
    return name


def _error(bench: Bench, state: State) -> float:
    """The relative error of a model on the records that report; infinite where its response is no number."""
    try:
        return errors(bench, state, bench.split.report).all
    except (ValueError, np.linalg.LinAlgError):
        return float(np.inf)


def _plainest(named: Sequence[Tried], dof: int) -> Tried | None:
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


def _much_better(bench: Bench, by_curve: float, named: State) -> bool:
    """Whether a learned curve, that can play any law of its variable, leaves so much less than a name that the name is wrong."""
    by_name = named.select - degrees(bench.split.select)
    return by_curve < CURVE_RATIO * by_name - LEAST_GAIN and excess(bench, named) > NAMED


def _with(bench: Bench, state: State, candidate: Candidate, lin: Linearised) -> Refit:
    """The model with a candidate, to be refitted hastily."""
    unit = units(lin, type(candidate.effect), candidate.effect.joint)
    limits = tuple(bounds(p, u) for p, u in zip(candidate.effect.parameters, unit, strict=True))
    return Refit(
        np.concatenate([lin.vector, candidate.effect.values]), (*state.effects, candidate.effect),
        state.scales + candidate.scales, state.limits + limits, 1, HASTILY,
    )  # fmt: skip


def _since(bench: Bench, state: State) -> State:
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


def _pruned(bench: Bench, state: State, entry: Added, progress: Callable[[str], None]) -> tuple[State, Added]:
    """The model without those earlier effects that the new one has made superfluous."""
    for old in state.effects[:-1]:
        if entry.effect.name == "unknown" and old.name != "unknown":
            continue  # a curve can play any law of its variable: it takes no name away
        less = without(bench, state, old)
        if less.select < state.select + LEAST_GAIN:
            progress(f"  without {_name(old)} as well: {excess(bench, less):.4g}")
            state = less
    return state, entry


def _std(state: State, effect: Effect) -> tuple[float, ...]:
    """Standard deviations of an effect's values."""
    values, vectors, seen = spectrum(state.minimum.information)
    lifted = np.where(seen, values, np.inf)
    deviation = np.sqrt(np.einsum("ik,k,ik->i", vectors, 1.0 / lifted, vectors)) * state.problem.scale
    k = state.problem.base
    for e in state.effects:
        if same(e, effect):
            return tuple(deviation[k : k + len(e.values)].tolist())
        k += len(e.values)
    return ()


def _name(effect: Effect) -> str:
    place = "" if effect.joint is None else f" at joint {effect.joint + 1}"
    if isinstance(effect, Learned):
        again = "" if effect.period is None else f", again every {effect.period:.4g} rad"
        return f"{effect.name}{place}: {effect.variable} at the {effect.port}{again}"
    return f"{effect.name}{place} {[float(f'{v:.4g}') for v in effect.values][:4]}"
