"""The loop: the residual of the declared arm, the port where it acts, the effect that makes it; added, refitted, judged.

Three kinds of record keep it honest: the model is fitted on some, effects are chosen on others, errors are reported on
the rest. What was chosen is fitted once more, on all but these. Nothing here knows more than the campaign file: the
declared robot, the catalogue, the records.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from ident.arm.coupled import declared_start
from ident.arm.evidence import Evidence, evidence, gravity_basis
from ident.arm.parts import Split, degrees, split, split_lines
from ident.effects.learned import Learned
from ident.errors import IdentError
from ident.loop.growth import is_worse
from ident.records.campaign import Campaign
from ident.records.frf import Frf, estimate
from ident.search.added import (
    Added,
    but_for_played,
    drawn_on,
    exchanged,
    in_its_place,
    largest_first,
    of_another_size,
    pruned,
    renamed,
    was_named,
)
from ident.search.apart import apart
from ident.search.beginnings import begun_without_tones
from ident.search.changes import told_of
from ident.search.choice import Tried
from ident.search.contradicted import Off, contradicted, merged
from ident.search.departures import Departure, Errors, errors
from ident.search.each_record import in_each_record
from ident.search.from_declared import on_declared_arm
from ident.search.minima import afresh, links_anew, settled
from ident.search.one_more import one_more
from ident.search.refits import (
    BENT,
    CLOSE,
    HASTILY,
    NAMED,
    Bench,
    Refit,
    State,
    all_fitted,
    begun,
    fitted,
    on_declared_links,
    reduced_chi2,
    some,
)
from ident.search.rest import (
    LEFT,
    is_doubtful,
    is_little,
    is_of_another_port,
    is_of_one_joint,
    is_suspect,
    is_uneven,
    is_unseen,
    left_over,
    may_be_bent,
    may_bend,
    share_left,
    something_departs,
)
from ident.search.rounds import another
from ident.search.spread import as_found
from ident.search.unbent import unbent
from ident.search.whole_numbers import each_otherwise, renumbered
from symgen.plan import Model

#: Rounds at most; each adds an effect, or more at once.
MOST_ROUNDS = 4
#: Share of the excess left by the first effect where these may that ends the search.
MUCH = 0.3
#: Noise powers from which effects are looked for so beside those that were found, too.
DOUBTED = 1.0
#: Said where the parts are of lines.
BY_LINES = (
    "what departs hardly shows in the records that fit, or in those that choose: lines of every record in each part"
)
#: Whether what is left of a model by such parts of the records is another's to explain.
GivesWay = Callable[[State, Split], bool]


def _nothing(line: str) -> None:
    """Says nothing."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found. `start` is the arm without effects, `end` with them; `off` declared numbers that it contradicts, dearest first; `status` as in the verdict format."""

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

    @property
    def first(self) -> State:
        """The model that the errors `before` are those of."""
        return _first(self.start, self.added, self.off)

    @property
    def left(self) -> float:
        """chi^2 per degree of freedom on the choosing records."""
        return self.end.select / max(degrees(self.split.select), 1)


def diagnose(campaign: Campaign, model: Model, *, workers: int = 1, say: Callable[[str], None] = _nothing) -> Diagnosis:
    """Returns what explains the records of `campaign` beyond the declared arm `model`, errors before and after.

    Candidates are tried by `workers` processes; the result does not depend on how many.
    Raises IdentError for a campaign without usable records.
    """
    responses = tuple(estimate(record, campaign) for record in campaign.records)
    return begin(campaign, model, responses, workers, say=say).diagnosed()


def _never(state: State, split: Split) -> bool:
    return False


@dataclass(frozen=True, eq=False)
class Begun:
    """The evidence of all records, `responses` theirs, and `start`, the arm without effects; by lines of every record where those that
    fit tell too little of it."""

    responses: tuple[Frf, ...]
    data: tuple[Evidence, ...]
    bench: Bench
    start: State

    def by_names(self) -> Begun:
        """The same, to be explained by effects of few numbers alone."""
        return replace(self, bench=replace(self.bench, only_names=True))

    @property
    def departs(self) -> bool:
        """Whether anything but noise is left of the records without effects."""
        return something_departs(self.bench, self.start) or is_suspect(self.bench, self.start)

    @property
    def alone(self) -> float:
        """chi^2 per degree of freedom that the arm without effects leaves on the choosing records."""
        return reduced_chi2(self.bench, self.start)

    def beside(self, end: State, split: Split, fewer: int = 0, most: float = np.inf) -> tuple[Bench, State]:
        """This arm with the effects found with another, `end`, by the same parts of the records, or with so many `fewer` of them as do
        best; hastily fitted where that leaves more than `most` noise powers. By lines of every record where its own parts are, as those
        of records tell it too little."""
        bench, n = self.bench, self.bench.model.chain.n
        if split.note or not bench.split.note:
            bench = replace(bench, split=self._parted(split))
        count = len(end.effects)
        parts = [some(end, keep) for keep in combinations(range(count), count - fewer)]
        arms = [self.start.minimum.vector, np.concatenate([end.minimum.vector[: 4 * n], bench.guess.vector()[4 * n :]])]
        values = end.problem.base
        refits = [replace(part, vector=np.concatenate([arm, part.vector[values:]])) for part in parts for arm in arms]
        hastily = all_fitted(bench, [replace(one, roughly=HASTILY) for one in refits])
        best = min(hastily, key=lambda state: state.select)
        return bench, best if reduced_chi2(bench, best) > most else fitted(bench, Refit.of(best))

    def _parted(self, split: Split) -> Split:
        """The evidence of this arm in the same parts as that of another."""
        own = {one.index: one for one in self.data}
        fit, select, report = (
            tuple(replace(own[one.index], judged=one.judged) for one in part)
            for part in (split.fit, split.select, split.report)
        )
        return Split(fit, select, report, split.note)

    @property
    def at_once(self) -> bool:
        """Whether effects explain the records as they are parted, without another look."""
        state, added = self._looked
        return bool(added) and reduced_chi2(self.bench, state) <= CLOSE

    @cached_property
    def _looked(self) -> tuple[State, list[Added]]:
        """The arm with effects, by the records as they are parted, and their entries."""
        return _loop(self.bench, self.start)

    def _searched(
        self, gives_way: GivesWay, elsewhere: Callable[[bool], bool]
    ) -> tuple[Bench, State, State, list[Added], tuple[Departure, ...]]:
        """The bench with which effects were looked for, the arm without them and with them, their entries, and what stays unexplained: by
        lines of every record where parts that are records may tell too little."""
        bench, start = self.bench, self.start
        if bench.split.note:
            bench.say(BY_LINES)
        state, added = self._looked if gives_way is _never else _loop(bench, start, None, gives_way)
        left = left_over(bench, start, state)
        found = bench, start, state, added, left
        if bench.split.note or bench.late or (left and elsewhere(bool(added))):
            return found
        unseen = is_unseen(bench, state)
        if not (unseen or is_doubtful(bench, start, state, bool(left))):
            return found
        bench.say(BY_LINES)
        by_lines = _by_lines(bench, self.data)
        resumed, share = _resumed(*by_lines, state, added), share_left(bench, start, state)
        if resumed is None and not (left and (unseen or not added or share > LEFT)):
            return found
        state, added = _loop(*by_lines, resumed, gives_way)
        if share_left(*by_lines, state) >= (LEFT if unseen else share):
            return found
        return *by_lines, state, added, left_over(*by_lines, state)

    def diagnosed(
        self, gives_way: GivesWay = _never, elsewhere: Callable[[bool], bool] = lambda some: False
    ) -> Diagnosis:
        """What explains the records, see `diagnose`; unexplained once it `gives_way` with what was found to another arm, or where what is left,
        whether some was found or not, is explained `elsewhere`."""
        return self._told(*self._searched(gives_way, elsewhere))

    def going_on(self, found: Diagnosis, bench: Bench, state: State, missing: Sequence[Tried] = ()) -> Diagnosis:
        """What explains the records, see `diagnose`, from the effects on that were `found` with another arm and are those of this `state`, as
        `beside` has both. `missing` are names that were tried beyond it, one of which leaves hardly anything."""
        start = self.start
        if bench is not self.bench:
            bench, start = begun(bench)
        entries = [replace(one, others=(), partly=()) for one in _anew(bench, start, state, found.added)]
        state, added = _loop(bench, start, (state, entries), missing=on_declared_arm(bench, missing))
        return self._told(bench, start, state, added, left_over(bench, start, state))

    def _told(
        self, bench: Bench, start: State, state: State, added: list[Added], left: tuple[Departure, ...]
    ) -> Diagnosis:
        """The diagnosis of what `_searched` has found."""
        if left and (is_of_one_joint(bench, start, state, added) or is_of_another_port(bench, start, state, added)):
            bench.say(f"not named, as it leaves {reduced_chi2(bench, state):.4g}: {added[0].effect.name}")
            state, added = start, []
            left = left_over(bench, start, state)
        bent = bool(left) and reduced_chi2(bench, state) > NAMED  # else few lines depart, and the arm is what it is
        found, contradictions = state, () if bent else contradicted(bench, state)
        state, off = merged(state, contradictions)
        state = settled(bench, state)
        start = state if found is start else _better(start, added)
        final = largest_first(bench, state, as_found(bench.split, state, added, contradictions))
        told = told_of(bench.split, state, bench.split.report)
        before = errors(bench, _first(start, final, off), told)
        after = errors(bench, state, told)
        if final:
            final[-1] = replace(final[-1], after=after.all)
        own = [bench.campaign.joints[one.effect.joint] for one in final if one.effect.joint is not None]
        status = status_of(bool(left), bool(final), bool(off), is_worse(before, after, own))
        campaign, model = bench.campaign, bench.model
        return Diagnosis(
            campaign, model, self.responses, bench.split, start, state, tuple(final), off, before, after, left, status
        )


def status_of(left: bool, effects: bool, off: bool, worse: bool) -> str:
    """Status of the verdict: whether anything is `left` of the records, there are `effects`, declared numbers are `off`. Effects with which
    records that nothing has seen are told `worse` are none of those that act."""
    if left or (effects and worse):
        return "unexplained"
    return "effect-found" if effects or off else "explained"


def _first(start: State, added: Sequence[Added], off: Sequence[Off]) -> State:
    """The arm without effects; where only declared numbers are off, with those as declared."""
    return off[0].without if off and not added else start


def _better(start: State, added: Sequence[Added]) -> State:
    """The arm without effects, as it was fitted best: from what is declared, or from where the first effect has led it, which may
    have been made superfluous by another."""
    others = [one.besides for one in added if one.besides is not None and not one.besides.effects]
    return min([start, *others], key=lambda state: state.select)


def begin(
    campaign: Campaign,
    model: Model,
    responses: tuple[Frf, ...],
    workers: int = 1,
    until: float = np.inf,
    say: Callable[[str], None] = _nothing,
) -> Begun:
    """Returns what a diagnosis begins with; `responses` are those of all records; nothing new is looked for once `time.monotonic()` is
    `until`. Raises IdentError for none."""
    if not campaign.records:
        raise IdentError("the campaign holds no records; expected at least one")
    basis = gravity_basis(model, campaign.gravity)

    def bench_of(responses: Sequence[Frf]) -> tuple[tuple[Evidence, ...], Bench]:
        data = tuple(evidence(campaign, model, basis, frf, k, "every") for k, frf in enumerate(responses))
        guess = declared_start(campaign, model, responses, basis)
        return data, Bench(campaign, model, basis, split(data, model), guess, workers, until=until, say=say)

    responses, data, bench, start = begun_without_tones(responses, bench_of)
    if not bench.split.note and is_uneven(bench, start):
        bench, start = _by_lines(bench, data)
    return Begun(responses, data, bench, start)


def _by_lines(bench: Bench, data: tuple[Evidence, ...]) -> tuple[Bench, State]:
    """All records in each part, and the arm without effects."""
    return begun(replace(bench, split=split_lines(data, "what departs shows in too few records")))


def _resumed(bench: Bench, start: State, found: State, added: Sequence[Added]) -> tuple[State, list[Added]] | None:
    """The model with effects that were `found`, and `added`, by other parts of the records, if it leaves little by these, too: on declared
    links, if it then leaves nothing, which the other parts may not have told."""
    if not added:
        return None
    plain = on_declared_links(found)
    state = fitted(bench, plain or Refit.of(found))
    if plain is not None and reduced_chi2(bench, state) > NAMED:
        state = fitted(bench, Refit.of(found))
    return None if share_left(bench, start, state) > LEFT else (state, _anew(bench, start, state, added))


def _anew(bench: Bench, start: State, state: State, added: Sequence[Added]) -> list[Added]:
    """The entries of effects that were `added` by other parts of the records, or another arm, with the errors that these leave of a
    model `state`, and without the models `besides`, which were judged by those."""
    report = bench.split.report
    entries = [replace(one, besides=None) for one in added]
    entries[0] = replace(entries[0], before=errors(bench, start, report).all)
    entries[-1] = replace(entries[-1], after=errors(bench, state, report).all)
    return entries


def _loop(
    bench: Bench,
    start: State,
    resumed: tuple[State, list[Added]] | None = None,
    gives_way: GivesWay = _never,
    missing: Sequence[Tried] = (),
) -> tuple[State, list[Added]]:
    """The arm with those effects that earned their place beyond `start`, or beyond those `resumed`, and these in the order in which
    they were added; `missing` are names tried beyond the latter."""
    state, added = resumed or (start, [])
    bench.say(
        f"the {'arm with what was found' if added else 'declared arm'}: chi2 {reduced_chi2(bench, state):.3g} a degree of freedom"
    )
    state = begun_afresh = links_anew(bench, state) if added and not missing else state
    if not added and reduced_chi2(bench, state) > BENT:
        bench = unbent(bench, state)
    for _ in range(MOST_ROUNDS):
        little = bool(added) and is_little(bench, start, state)
        doubted = not added or reduced_chi2(bench, state) > DOUBTED
        noisy = little and reduced_chi2(bench, state) <= NAMED
        departs = (not noisy and something_departs(bench, state)) or (doubted and is_suspect(bench, state))
        if not departs or (bench.late and not missing):
            break
        if added and not missing and gives_way(state, bench.split):
            break
        bends = not bench.split.note and may_bend(bench, start, state)  # then it is tried by lines next
        partly = [one for entry in reversed(added) for one in entry.partly]
        step = another(bench, state, little, bends, partly, missing)
        if step is None:
            break
        state, more = step
        added += more
        if bench.late:
            break
        state, added = in_each_record(bench, state, added)
        missing, tried_from = (), state
        if may_be_bent(bench, start, state):  # is what was missing the way, or is more missing?
            state, missing = one_more(bench, state, added[-1].others)
            if missing:
                tried_from, added = state, in_its_place(tried_from, state, added)
            else:
                state = begun_afresh = afresh(bench, state)
        by_records = not (missing or bench.split.note)
        if by_records and share_left(bench, start, state) > MUCH and may_bend(bench, start, state):
            break  # lines of every record tell more
        state, added = apart(bench, state, added)
        state, added = exchanged(bench, state, added)
        state, added = drawn_on(bench, *pruned(bench, state, added, more))
        for curve in [e for e in state.effects[:-1] if isinstance(e, Learned) and not was_named(e)]:
            state, added = renamed(bench, state, curve, added)
        missing = missing if state is tried_from else ()
    if added and state is not begun_afresh and not bench.late and may_be_bent(bench, start, state):
        state = afresh(bench, state)
    state, added = of_another_size(bench, state, added)
    new = each_otherwise(bench, state)
    return but_for_played(bench, new, renumbered(state, new, added))
