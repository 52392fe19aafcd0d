"""The arm by the records that one joint's own excitation does not disturb: a far better start than one that its effect has bent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.arm.arm_fit import is_positive
from ident.arm.arm_model import Parameters
from ident.arm.coupled import DOUBTS
from ident.arm.parts import united
from ident.records.campaign import Array
from ident.search.refits import FIRST_LINES, HASTILY, Bench, Refit, State, fitted, reduced_chi2
from symgen.forked import forked

#: chi^2 that a number of the arm costs which is off by all of its size: no record may show it without a joint excited. On the way
#: little, as declared numbers may be far off; at its end much, as what is missing at that joint moves the others a little, which
#: numbers that no record shows would follow as far as they are let.
FIRM, FIRMLY = 1.0, 1e4
#: Share of the excess of all records, and of those without any other joint's, that is left without those of the joint that bends
#: the arm; fewest records that tell one.
FAR_LESS, FEWEST = 0.1, 4
#: A stiffness or motor inertia of that joint which is farther from the declared one [log] is not believed, nor is a damping.
DOUBTED = 0.2


def unbent(bench: Bench, start: State) -> Bench:
    """The bench with the arm that the records tell in which one joint is held, in place of the declared one, if they fit far
    better than others: what is missing acts at that joint, and where it is held it hardly moves it."""
    joints = sorted({one.excited for one in bench.split.fit + bench.split.select})
    benches = {joint: _without(bench, joint) for joint in joints}
    told = {joint: one for joint, one in benches.items() if len(one.split.fit) >= FEWEST}

    def work(one: Bench) -> tuple[float, Array]:
        state = fitted(one, Refit(bench.guess.vector(), (), (), (), 1, HASTILY, DOUBTS, lines=FIRST_LINES))
        return reduced_chi2(one, state), state.minimum.vector

    found = forked(work, list(told.values()), bench.workers)
    left = sorted(((*one, joint) for joint, one in zip(told, found, strict=True)), key=lambda one: one[0])
    if not left or left[0][0] > FAR_LESS * min([reduced_chi2(bench, start), *(least for least, _, _ in left[1:])]):
        return bench
    _, vector, joint = left[0]
    firmly, declared = replace(told[joint], firm=FIRMLY), bench.guess.vector()
    # From the declared one, too: what no record shows may be anywhere in `vector`.
    ends = [fitted(firmly, Refit(begin, (), (), (), lines=FIRST_LINES)) for begin in (vector, declared)]
    ends = [end for end in ends if _is_an_arm(bench, end)]
    if not ends:
        return bench
    least, vector = min(((reduced_chi2(firmly, end), end.minimum.vector) for end in ends), key=lambda one: one[0])
    bench.say(f"  without records of joint {joint + 1} the arm leaves {least:.3g}: from there")
    n, D = bench.model.chain.n, len(bench.guess.alpha)
    own = joint + n * np.arange(4)  # of its drive these records tell little, or what is missing, too
    off = own[(own >= 2 * n) | (np.abs(vector[own] - declared[own]) > DOUBTED)]
    vector[off] = declared[off]
    return replace(bench, guess=Parameters.of(vector, n, D), declared=bench.guess)


def _is_an_arm(bench: Bench, state: State) -> bool:
    """Whether the inertia matrix of a model is one at the postures of all records: at those that do not fit it need not be."""
    p, split = state.problem.parameters(state.minimum.vector), bench.split
    return all(is_positive(one.scene.arm.J(p)) for one in united(*split.fit, *split.select, *split.report))


def _without(bench: Bench, joint: int) -> Bench:
    """The bench of the records, those that fit and those that choose, that excite other joints; the arm lightly held to the declared
    one."""
    told = tuple(one for one in united(*bench.split.fit, *bench.split.select) if one.excited != joint)
    return replace(bench, split=replace(bench.split, fit=told, select=told), firm=FIRM)
