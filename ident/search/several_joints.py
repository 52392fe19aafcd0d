"""Names of several joints at once. Drives of one make have the same friction, the same ripple, the same springs in every joint, and what acts at
one hides what acts at another: each alone leaves nearly all there is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from ident.arm.parts import degrees
from ident.effects.base import Effect, only_shares
from ident.effects.catalogue import CATALOGUE
from ident.search.candidates import Candidate, best_of, catalogue, nearer, sized_together
from ident.search.choice import DOUBT, TIE, Tried, as_much, best_names, left_by
from ident.search.from_declared import LIKELY
from ident.search.minima import told
from ident.search.naming import is_clear
from ident.search.refits import (
    CLOSE,
    FINELY,
    Bench,
    Refit,
    State,
    all_fitted,
    as_declared,
    beyond_noise,
    fitted,
    linearised,
    reduced_chi2,
    same,
    some,
)
from ident.search.resized import as_strong, smallest
from ident.search.trace import Linearised
from ident.search.tried import with_candidates

#: Share of what there was that a name leaves at most which does some of it; of what the best one leaves, that those of several joints leave
#: at most which are more than that.
SOME, FEWER = 0.95, 0.6
#: Share of the best promise that dry friction makes which may do some, though alone it leads the arm astray.
HIDDEN = 0.2
#: Kinds that are tried at all joints; names that are tried in the place of one, at most.
KINDS, RIVALS = 2, 2


def at_several_joints(bench: Bench, state: State, tried: Sequence[Tried]) -> State | None:
    """The model with names of several joints that leave far less than any one that was `tried` beyond `state`, finely fitted: the best name of each
    joint where one does some, or is friction that promises much, or one kind at all joints. None where one name leaves little, or they leave much more."""
    most = max((one.candidate.gain for one in tried), default=0.0)
    names = [
        one
        for one in best_names(tried)
        if _of_a_joint(one)
        and (_does_some(state, one) or (one.candidate.effect.dry and one.candidate.gain > HIDDEN * most))
    ]
    least = min([state.select, *map(left_by, tried)])
    if (
        least <= CLOSE * degrees(bench.split.select)
        or len({one.candidate.effect.joint for one in names}) < 2
        or bench.late
    ):
        return None
    lin = linearised(state.problem, as_declared(bench, state))
    likely = [sized_together(lin, beside) for beside in _likely(bench, state, lin, names)]
    models = list(all_fitted(bench, [with_candidates(state, beside, lin) for beside in likely if len(beside) > 1]))
    for new in models:
        _say(bench, "at once", state, new)
    limit = min((new.select for new in models), default=0.0) + TIE + DOUBT * degrees(bench.split.select)
    best = min((new for new in models if new.select <= limit), key=lambda new: len(new.scales), default=state)
    if best.select > FEWER * least:
        return None
    finely = fitted(bench, Refit.of(best))
    return _rubbing_plainly(bench, state, lin, min(best, finely, key=lambda new: new.select))


def _rubbing_plainly(bench: Bench, state: State, lin: Linearised, new: State) -> State:
    """The model, or one with the plainest friction, as strong, in the place of all beyond `state` that has more numbers, not all of them clear,
    if it leaves as much: in haste, from any size, the motion that friction leaves is hardly found, and one more number helps to."""
    found = new.effects[len(state.effects) :]
    unclear = [e for e in found if e.dry and e.numbers > 1 and not is_clear(bench, new, e)]
    plain = [(_plainest(lin, e) if e in unclear else None) or e for e in found]
    if all(map(same, found, plain)) or bench.late:
        return new
    names = [Candidate(e, 0.0, tuple(map(abs, e.values))) for e in plain]
    beside = some(new, range(len(state.effects)))
    refit = with_candidates(state, names, replace(lin, vector=beside.vector))
    plainly = fitted(bench, replace(refit, roughly=FINELY, slid=new.minimum.slid))
    _say(bench, "as strong", state, plainly)
    return plainly if plainly.select <= as_much(bench, new.select) else new


def _say(bench: Bench, how: str, state: State, new: State) -> None:
    names = " and ".join(map(told, new.effects[len(state.effects) :]))
    bench.say(f"  {how}, {names}: {reduced_chi2(bench, new):.4g}")


def _plainest(lin: Linearised, effect: Effect) -> Effect | None:
    """The friction of one number at the port of another, as strong as that; None at a port that has none."""
    kinds = (kind for kind in CATALOGUE.values() if kind.dry and not kind.by_load and len(kind.parameters) == 1)
    kind = next((kind for kind in kinds if kind.port == effect.port), None)
    return None if kind is None else as_strong(lin, smallest(lin, kind, effect.joint), effect).effect


def _of_a_joint(one: Tried) -> bool:
    return one.candidate.effect.joint is not None and not only_shares(one.candidate.effect)


def _does_some(state: State, one: Tried) -> bool:
    """Whether a name alone leaves less than there was."""
    return left_by(one) < SOME * state.select


def _likely(bench: Bench, state: State, lin: Linearised, names: Sequence[Tried]) -> Iterator[list[Candidate]]:
    """The best name of each joint, and the kinds of names of more than one joint at all joints that they promise something at; each of the
    shape in which it was found, or promised."""
    found = {
        one.candidate.key: replace(one.candidate, effect=one.state.effects[-1])
        if _does_some(state, one)
        else one.candidate
        for one in names
    }
    by_joint: dict[int | None, Candidate] = {}
    for one in found.values():
        by_joint.setdefault(one.effect.joint, one)
    choices = [list(by_joint.values())]
    kinds = [type(one.effect) for one in found.values()]
    for kind in [kind for k, kind in enumerate(kinds) if kinds.index(kind) == k and kinds.count(kind) > 1][:KINDS]:
        everywhere = []
        for joint in range(bench.model.chain.n):
            known = [one for one in found.values() if type(one.effect) is kind and one.effect.joint == joint]
            new = known[0] if known else best_of(lin, kind, joint)
            if new is not None and new.gain > 0.0 and all(not same(new.effect, e) for e in state.effects):
                everywhere.append(new if known else nearer(lin, new))
        choices.append(everywhere)
    told_of: set[frozenset[tuple[str, int | None, str]]] = set()
    for choice in choices:
        which = frozenset(one.key for one in choice)
        if which not in told_of:
            yield choice
        told_of.add(which)


def instead_of(bench: Bench, state: State, lin: Linearised, one: Candidate) -> list[tuple[Candidate, Linearised]]:
    """The names elsewhere, or of more numbers, that promise to do beyond `state`, linearised in `lin`, most of what one name does there."""
    names = catalogue(lin, state.effects, bench.workers)
    own = [other.gain for other in names if other.key == one.key]  # dry friction promises less than it does
    least = LIKELY * min([beyond_noise(state, lin), *own])
    plainer = [c for c in names if c.key[1:] == one.key[1:] and c.effect.numbers < one.effect.numbers]
    return [(c, lin) for c in names if c.gain > least and c.key != one.key and c not in plainer][:RIVALS]
