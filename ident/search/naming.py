"""The name that was chosen, or another one at its place that does as much: of fewer parameters, or a wave of no whole order."""

from __future__ import annotations

from ident.arm.parts import degrees
from ident.effects.base import has_forces
from ident.search.candidates import catalogue
from ident.search.choice import Tried, left_by, plainest
from ident.search.curves import wave
from ident.search.finer import finer
from ident.search.minima import LEAST_GAIN, fully
from ident.search.refits import CLOSE, Bench, beyond_noise, but_last, reduced_chi2, standing
from ident.search.trials import HARDLY, LIKELY
from ident.search.tried import refitted

#: Times what a law leaves that a plainer one leaves in haste that is not it; `CLOSE` times, fitted finely.
HOPELESS = 10.0
#: Orders beyond a whole one up to which another is looked for; chi^2 per degree of freedom that it must leave less.
NEXT, ANOTHER = 2.0, 0.02


def plainer(bench: Bench, one: Tried) -> Tried:
    """A force that was fitted, or one of fewer parameters at its place that does as much: nobody tries that where the other is far
    ahead of all that promised most."""
    effect = one.state.effects[-1]
    if not has_forces(effect) or effect.numbers < 2:
        return one
    plain, lin = standing(bench, one.state, but_last(one.state))
    names = catalogue(lin, plain.effects, bench.workers, at=(effect.port, effect.joint))
    likely = [c for c in names if c.effect.numbers < effect.numbers and c.gain > LIKELY * beyond_noise(plain, lin)]
    tried = refitted(bench, plain, [(c, lin) for c in likely])
    near = [other for other in tried if not HOPELESS * left_by(one) < left_by(other)]
    near = [other.refitted(finer(bench, other.state)) for other in near]  # minima take long
    near = [other for other in near if not CLOSE * left_by(one) < left_by(other)]
    return plainest(bench, [one, *(other.refitted(fully(bench, other.state)) for other in near)])


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
