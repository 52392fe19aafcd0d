"""The name that was chosen, or another one at its place that does as much: of fewer parameters, or a wave of no whole order; or two in
the place of a curve."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from ident.arm.parts import degrees
from ident.effects.base import Effect, has_forces
from ident.effects.friction import LinkCoulomb, LoadDependentFriction
from ident.effects.learned import LearnedLaw
from ident.search.candidates import Candidate, catalogue
from ident.search.choice import ALIKE, Tried, as_much, left_by, plainest
from ident.search.contradicted import standard_deviations
from ident.search.curves import wave
from ident.search.finer import finer
from ident.search.from_declared import LIKELY
from ident.search.minima import LEAST_GAIN, fully, told
from ident.search.refits import CLOSE, NAMED, Bench, State, beyond_noise, but_last, fitted, reduced_chi2, same, standing
from ident.search.resized import as_strong
from ident.search.trials import HARDLY
from ident.search.tried import refitted, with_candidates

#: Times what a law leaves that a plainer one leaves in haste that is not it; `CLOSE` times, fitted finely.
HOPELESS = 10.0
#: Orders beyond a whole one up to which another is looked for; chi^2 per degree of freedom that it must leave less.
NEXT, ANOTHER = 2.0, 0.02


def plainer(bench: Bench, one: Tried, hopeless: float = HOPELESS) -> Tried:
    """A force that was fitted, or one of fewer parameters at its place that does as much: nobody tries that where the other is far
    ahead of all that promised most. None that leaves `hopeless` times as much in haste."""
    effect = one.state.effects[-1]
    if not has_forces(effect) or effect.numbers < 2:
        return one
    plain, lin = standing(bench, one.state, but_last(one.state))
    names = catalogue(lin, plain.effects, bench.workers, at=(effect.port, effect.joint))
    own = [c.gain for c in names if c.effect.name == effect.name]  # dry friction promises less than it does
    least = LIKELY * min([beyond_noise(plain, lin), *own])
    likely = [as_strong(lin, c, effect) for c in names if c.effect.numbers < effect.numbers and c.gain > least]
    tried = refitted(bench, plain, [(c, lin) for c in likely])
    near = [other for other in tried if not hopeless * left_by(one) < left_by(other)]
    near = [other.refitted(finer(bench, other.state)) for other in near]  # minima take long
    near = [other for other in near if not CLOSE * left_by(one) < left_by(other)]
    return plainest(bench, [one, *(other.refitted(fully(bench, other.state)) for other in near)])


def is_clear(bench: Bench, state: State, effect: Effect) -> bool:
    """Whether a model without any one of an effect's sizes would leave `HOPELESS` times as much more as what is not told apart, by how well each is
    known."""
    unclear = as_much(bench, state.select) - state.select
    values = zip(effect.values, effect.parameters, standard_deviations(state, effect, ()), strict=True)
    sizes = [(value - p.zero, std) for value, p, std in values if p.zero is not None and not p.aside]
    return all(size**2 > HOPELESS * unclear * std**2 for size, std in sizes)  # nor is one that no record shows


def of_any_order(bench: Bench, one: Tried) -> Tried:
    """A wave of a whole order in a turn of the motor, near the noise, or one of any order at motor or link that leaves much less: then
    its name was wrong."""
    effect = one.state.effects[-1]
    if (
        all(p.name != "order" for p in effect.parameters)
        or effect.joint is None
        or reduced_chi2(bench, one.state) > CLOSE
    ):
        return one
    plain, lin = standing(bench, one.state, but_last(one.state))
    waves = [wave(lin, port, effect.joint, effect["order"] + NEXT, bench.workers) for port in ("motor", "link")]
    likely = [c for c in waves if c is not None and c.gain > HARDLY * beyond_noise(plain, lin)]
    tried = refitted(bench, plain, [(c, lin) for c in likely])
    best = min(tried, key=left_by, default=one)
    if best is not one:  # as closely as the name it is compared with
        best = best.refitted(fully(bench, best.state))
    much = max(LEAST_GAIN, ANOTHER * degrees(bench.split.select))
    return best if left_by(best) < left_by(one) - much else one


def named_by_load(bench: Bench, state: State) -> State | None:
    """The model with friction that is always there and friction in proportion to the load in the place of its last effect, a curve of the
    friction that a load makes, if they leave hardly more; None if they do not."""
    curve, joint = state.effects[-1], state.effects[-1].joint
    if not isinstance(curve, LearnedLaw) or (curve.port, curve.variable) != ("link", "loaded") or joint is None:
        return None
    size, share = nnls(np.stack([np.ones(len(curve.knots)), np.abs(curve.knots)], axis=1), np.asarray(curve.values))[0]
    if bench.late or not (size > 0.0 and share > 0.0):
        return None
    plain, lin = standing(bench, state, but_last(state))
    names = [LinkCoulomb(joint, (float(size),)), LoadDependentFriction(joint, (float(share),))]
    if any(same(name, e) for name in names for e in plain.effects):
        return None
    both = with_candidates(plain, [Candidate(name, 0.0, name.values) for name in names], lin)
    new = fully(bench, fitted(bench, both))
    bench.say(f"  instead of {told(curve)}, {' and '.join(map(told, names))}: {reduced_chi2(bench, new):.4g}")
    most = max(LEAST_GAIN, ALIKE * (state.select - degrees(bench.split.select)))
    return new if new.select <= state.select + most or reduced_chi2(bench, new) <= NAMED else None
