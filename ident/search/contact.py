"""Candidates of dry friction, told as their contact creeps before it slides: until then the true law may leave much; of what winds a spring up,
by the records that move it; and of what is balanced by friction that is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from ident.arm.parts import degrees
from ident.effects.base import Effect
from ident.effects.creeping import Creeping
from ident.effects.hysteresis import Hysteresis
from ident.effects.learned import KINDS, VARIABLES
from ident.effects.motor import TorqueScale
from ident.search.candidates import Candidate, best_of, of_kinds, units
from ident.search.choice import Tried, is_curve, left_by, with_model
from ident.search.curves import curve_of, sticking
from ident.search.minima import CREPT, creeping_like, crept, told
from ident.search.own_records import by_own
from ident.search.refits import (
    BY_ALL,
    FALLING,
    HASTILY,
    NAMED,
    Bench,
    Refit,
    State,
    all_fitted,
    fitted,
    reduced_chi2,
    same,
    winding,
)
from ident.search.resized import smallest
from ident.search.trace import Linearised
from ident.search.tried import refitted, with_candidate

#: Share of what a name leaves beyond noise that other friction of its kind leaves, at most, which is tried beside it.
STICKS = 0.3


def as_it_creeps(bench: Bench, tried: list[Tried], near: float) -> list[Tried]:
    """The candidates, the best one as its contact creeps, if it is dry and leaves more than `near` times the noise power; plainer laws of
    its port likewise."""
    best = min(tried, key=left_by, default=None)
    if best is None or reduced_chi2(bench, best.state) <= near or (state := crept(bench, best.state)) is best.state:
        return tried
    if state.select > CREPT * best.state.select:
        return tried
    law = state.effects[-1]
    creeps = isinstance(law, Creeping)
    bench.say(f"  {'as it creeps' if creeps else 'on'}, {told(law)}: {reduced_chi2(bench, state):.4g}")
    alike = [
        one for one in tried
        if creeps and one.state.effects[-1].dry and not is_curve(one) and one.candidate.key[1:] == best.candidate.key[1:] and one.candidate.effect.numbers < law.numbers
    ]  # fmt: skip
    found = {id(best): state}
    for one in alike:
        likewise = min(all_fitted(bench, _likewise(one.state, state)), key=lambda other: other.select)
        if bench.late:  # it was not begun, or not ended
            break
        bench.say(f"  likewise, {told(likewise.effects[-1])}: {reduced_chi2(bench, likewise):.4g}")
        found[id(one)] = likewise
    return [one.refitted(found.get(id(one), one.state)) for one in tried]


def as_it_winds(bench: Bench, tried: list[Tried], near: float) -> list[Tried]:
    """The candidates, the best one, if it winds a spring up and leaves more than `near` times the noise power, from where the records that
    move its joint are explained with motions that follow it, if that leaves less."""
    best = min(tried, key=left_by, default=None)
    if best is None or reduced_chi2(bench, best.state) <= near or bench.late or not winding(best.state.effects[-1:]):
        return tried
    new = by_own(bench, best.state, near)
    if not new.select < FALLING * best.state.select:
        return tried
    bench.say(f"  by its own records first, {told(new.effects[-1])}: {reduced_chi2(bench, new):.4g}")
    return with_model(tried, best, new)


def as_it_sticks(bench: Bench, state: State, lin: Linearised, tried: list[Tried]) -> list[Tried]:
    """The candidates beyond a model, linearised in `lin`, and where the best is friction that gives before it slides, and leaves more than
    noise, what sticks at its port in another way and leaves a share `STICKS` of that."""
    best = min(tried, key=left_by, default=None)
    if best is None:
        return tried
    law, dof = best.candidate.effect, degrees(bench.split.select)
    if not isinstance(law, Hysteresis) or law.joint is None or bench.late or reduced_chi2(bench, best.state) <= NAMED:
        return tried
    others = refitted(bench, state, [(c, lin) for c in sticking(lin, law.port, law.joint)])
    return tried + [one for one in others if left_by(one) - dof < STICKS * (left_by(best) - dof)]


def balanced(lin: Linearised, effects: Sequence[Effect]) -> list[Candidate]:
    """Motor torques at the joints of dry friction that are off by as much as is plausible, either way: friction of another level balances
    most of that, so that as long as its motion is held none is missed."""
    here = [best_of(lin, TorqueScale, e.joint) for e in effects if e.dry]
    return [
        replace(one, effect=one.effect.with_values([size]))
        for one in here
        if one is not None and all(not same(one.effect, e) for e in effects)
        for size in TorqueScale.parameters[0].sizes
    ]


def besides(lin: Linearised, effects: Sequence[Effect]) -> tuple[list[Candidate], list[Candidate]]:
    """Names, and curves, of the velocity at the ports of dry friction, whatever they promise: friction of another level does nearly what
    they do, so that as long as its motion is held none is missed."""
    rubs = {(e.port, e.joint): None for e in effects if e.dry}
    kinds = of_kinds(lin, lambda kind, joint: kind.drags and (kind.port, joint) in rubs, effects)
    curves = [curve_of(lin, port, joint, "velocity") for port, joint in rubs if joint is not None]
    new = [c for c in curves if c is not None and all(not same(c.effect, e) for e in effects)]
    return [smallest(lin, kind, joint) for kind, joint in kinds], new


def rubbing(bench: Bench, lin: Linearised, tried: Sequence[Tried]) -> list[tuple[Candidate, Linearised]]:
    """Curves of dry friction by all that its level may follow, whatever they promise, where the best that was `tried` is a name of such a
    friction that leaves much: at its port and level, each with the arm that it found. Where a joint rests its friction could be any,
    so that to first order none is missed."""
    if (rubs := _rubbing_most(bench, lin, tried)) is None:
        return []
    law, level, there = rubs
    assert law.joint is not None
    names = [name for name in VARIABLES.get(law.port, ()) if KINDS[name].dry]
    curves = [c for name in names if (c := curve_of(lin, law.port, law.joint, name)) is not None]
    size = [(level,) * len(c.scales) for c in curves]
    return [(replace(c, effect=c.effect.with_values(s), scales=s), there) for c, s in zip(curves, size, strict=True)]


def rubbing_anew(bench: Bench, state: State, lin: Linearised, tried: Sequence[Tried]) -> list[Tried]:
    """Names of dry friction of more numbers than the best that was `tried`, where that is one that leaves much, at its port and level and with
    the arm that it found, hastily fitted with motions that follow them: a fit that holds motions is led anywhere by friction of another size."""
    if (rubs := _rubbing_most(bench, lin, tried)) is None or bench.late:
        return []
    law, level, there = rubs
    kinds = of_kinds(lin, lambda kind, at: kind.dry and (kind.port, at) == (law.port, law.joint), state.effects)
    found = []
    for kind, joint in kinds:
        parts = [p.relative == "torque" for p in kind.parameters]
        if len(parts) <= law.numbers or not any(parts):
            continue
        unit = units(lin, kind, joint)
        sizes = [
            [level / sum(parts)] if part else [u * size for size in p.sizes]
            for p, part, u in zip(kind.parameters, parts, unit, strict=True)
        ]
        for values in product(*sizes):
            candidate = Candidate(kind(joint, values), 0.0, values)
            new = fitted(bench, replace(with_candidate(state, candidate, there), followed=True))
            if NAMED < reduced_chi2(bench, new) <= BY_ALL:
                more = fitted(bench, replace(Refit.of(new), roughly=HASTILY))
                new = more if more.select < new.select else new
            bench.say(f"  its motion followed, {told(new.effects[-1])}: {reduced_chi2(bench, new):.4g}")
            found.append(Tried(candidate, replace(new, followed=False)))
            if bench.late or reduced_chi2(bench, new) <= BY_ALL:
                break
    return found


def _rubbing_most(bench: Bench, lin: Linearised, tried: Sequence[Tried]) -> tuple[Effect, float, Linearised] | None:
    """The best that was `tried`, where it is a name of dry friction that leaves much: its law, its level, and the arm that it found."""
    best = min(tried, key=left_by, default=None)
    if best is None or is_curve(best) or reduced_chi2(bench, best.state) <= BY_ALL:
        return None
    law = best.state.effects[-1]
    level = max(
        (abs(v) for p, v in zip(law.parameters, law.values, strict=True) if p.relative == "torque"), default=0.0
    )
    if not law.dry or law.joint is None or not level:
        return None
    return law, level, replace(lin, vector=best.state.minimum.vector[: len(lin.vector)])


def _likewise(one: State, other: State) -> list[Refit]:
    """The model `one` beside what is fitted in the `other`, its dry last effect creeping as there: of its own size, and of that there."""
    law, last = one.effects[-1], other.effects[-1]
    refit = creeping_like(one, last.values[-1])
    besides = other.minimum.vector[: -len(last.values)]
    there = dict(zip((p.name for p in last.parameters), last.values, strict=True))
    sizes = [law.values, [there.get(p.name, value) for p, value in zip(law.parameters, law.values, strict=True)]]
    return [replace(refit, vector=np.concatenate([besides, values, last.values[-1:]])) for values in sizes]
