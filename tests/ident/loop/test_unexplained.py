"""What stays unexplained is told where it acts, in bands that end."""

from __future__ import annotations

from dataclasses import replace
from math import inf

from diagnosed import JOINT, diagnosis
from diagnosed import unexplained as nothing_found

from ident.loop.unexplained import sources, unexplained
from ident.search.departures import Band, Departure


def test_what_is_left_acts_where_the_friction_does():
    (source,) = sources(nothing_found(), [Band(1.0, 30.0)])
    assert source is not None and (source.joint, source.ports) == (JOINT, ("motor",)) and source.share > 0.8


def test_the_ports_of_a_joint_that_moves_no_other_are_one():
    """Joint 1 with a wrong spring: whatever is left of it could be at its motor, spring, link or encoder."""
    d = diagnosis()
    alone = replace(d.end.problem, data=d.split.fit[:1])
    worse = d.end.minimum.vector.copy()
    worse[0] += 0.01  # K of joint 1
    (source,) = sources(
        replace(d, end=replace(d.end, problem=alone, minimum=replace(d.end.minimum, vector=worse))), [Band(1.0, 100.0)]
    )
    assert source is not None and (source.joint, source.ports) == (0, ("motor", "spring", "link", "sensor"))


def test_a_band_without_end_ends_at_half_the_sample_rate():
    """JSON has no infinity."""
    d = replace(nothing_found(), departures=(Departure(JOINT, Band(30.0, inf), "odd", 9.0, 1.0),))
    (row,) = unexplained(d)
    assert row["band_hz"] == [30.0, d.campaign.fs / 2.0] and row["joint"] == "joint2" and row["source_share"] > 0.0
