"""Records are begun with as the arm was in them: at the postures where soft springs have it rest, a tenth of a radian from the declared
ones where these are told by another stiffness; and without the tones that are none of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ident.arm.evidence import Evidence
from ident.arm.lone_lines import lone_lines
from ident.arm.parts import united
from ident.records.frf import Frf
from ident.records.left_out import without_lines
from ident.records.resting import farthest_apart, rested
from ident.search.refits import Bench, State, begun

#: Times that records are read anew, from such a distance [rad or m] on, and by how much chi^2 must fall for that.
PLACES, SAGGED, LEAST = 4, 2e-3, 1.0
#: Times that lines are left out: a tone that bends the arm less stands alone once a larger one is gone.
TONES = 5

#: What is begun with: responses, their evidence and bench, and the arm without effects.
Beginning = tuple[tuple[Frf, ...], tuple[Evidence, ...], Bench, State]
BenchOf = Callable[[Sequence[Frf]], tuple[tuple[Evidence, ...], Bench]]


def begun_without_tones(responses: tuple[Frf, ...], bench_of: BenchOf) -> Beginning:
    """As `begun_at_rest`, of responses without the lines that stand alone."""
    beginning = begun_at_rest(responses, bench_of)
    for _ in range(TONES):
        responses, _, bench, start = beginning
        every = united(*bench.split.fit, *bench.split.select, *bench.split.report)
        tones = lone_lines(replace(start.problem, data=every), start.minimum.vector)
        if not tones.size:
            break
        beginning = begun_at_rest(tuple(without_lines(frf, tones) for frf in responses), bench_of)
    return beginning


def begun_at_rest(responses: tuple[Frf, ...], bench_of: BenchOf) -> Beginning:
    """Returns the `responses` at the postures where they rest by the springs that are found without effects, where these explain them
    better; their evidence and bench, as `bench_of` makes them, and the arm without effects. Where declared postures do, those."""
    data, bench = bench_of(responses)
    bench, start = begun(bench)
    for _ in range(PLACES):
        there = rested(bench.campaign, responses, start.problem.parameters(start.minimum.vector).K)
        if farthest_apart(responses, there) <= SAGGED:
            responses = tuple(replace(told, posture=frf.posture) for told, frf in zip(there, responses, strict=True))
            break
        others, other = bench_of(there)
        other, sagged = begun(other)
        if sagged.minimum.chi2 + sagged.select > start.minimum.chi2 + start.select - LEAST:
            break
        responses, data, bench, start = there, others, other, sagged
    return responses, data, bench, start
