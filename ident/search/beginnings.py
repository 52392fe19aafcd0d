"""Records are begun with as the arm was in them: at the postures where soft springs have it rest, a tenth of a radian from the declared
ones where these are told by another stiffness."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ident.arm.evidence import Evidence
from ident.records.frf import Frf
from ident.records.resting import farthest_apart, rested
from ident.search.refits import Bench, State, begun

#: Times that records are read anew, from such a distance [rad or m] on, and by how much chi^2 must fall for that.
PLACES, SAGGED, LEAST = 4, 2e-3, 1.0


def begun_at_rest(
    responses: tuple[Frf, ...], bench_of: Callable[[Sequence[Frf]], tuple[tuple[Evidence, ...], Bench]]
) -> tuple[tuple[Frf, ...], tuple[Evidence, ...], Bench, State]:
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
