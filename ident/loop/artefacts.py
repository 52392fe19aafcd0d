"""Torques that were read but did not act: what is measured of them at detection lines that no motion follows.

A current sensor that distorts reads lines that are not there. A force of the arm that a controller works against looks the
same at the lines of one record (force and torque cancel, nothing moves): only where a torque answers no motion, as on a bench
without a lock, is one told from the other. So this is said beside what stays unexplained, never in its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ident.arm.arm_fit import chi_squared_of_lines, hold
from ident.arm.evidence import Evidence
from ident.loop.diagnose import Diagnosis
from ident.records.campaign import Array
from ident.search.departures import Band

#: What is left without the torque there, in shares of what is left with it, below which no motion follows it.
UNFOLLOWED = 0.5
#: Size of the torque in its noise, and real numbers, from which this is asked.
CLEAR, LEAST = 3.0, 10


@dataclass(frozen=True)
class Artefact:
    """Torque of a joint (from 0) in a band at its even or odd detection lines: `left` is the chi^2 without it in shares of
    that with it, `share` the torque in shares of that at the excited lines, rms."""

    joint: int
    band: Band
    even: bool
    left: float
    share: float


def artefacts(d: Diagnosis, bands: Sequence[Band]) -> tuple[Artefact, ...]:
    """Returns where the excited motor's torque at detection lines, as it was read, moves nothing, in these bands."""
    problem, vector = d.end.problem, d.end.minimum.vector
    every = {one.index: replace(one, judged=None) for one in d.split.fit + d.split.select + d.split.report}
    records = tuple(every.values())
    rows: dict[tuple[int, Band, bool], Array] = {}
    for one, held in zip(records, hold(replace(problem, data=records), vector), strict=True):
        k = one.place
        size = np.abs(one.scene.tau[:, k]) ** 2
        largest = float(size[one.is_excited].mean())
        for even in (False, True):
            lines = ~one.is_excited & (one.scene.lines % 2 == (0 if even else 1))
            left = [chi_squared_of_lines(problem, vector, o, held) for o in (one, _without(one, lines, k))]
            for band in bands:
                use = lines & band.has(one.sampling.f)
                if 2 * int(use.sum()) >= LEAST and size[use].mean() > (CLEAR * one.scene.noise[0, k]) ** 2:
                    row = np.array([left[0][use].sum(), left[1][use].sum(), size[use].mean() / largest, 1.0])
                    rows[one.excited, band, even] = rows.get((one.excited, band, even), np.zeros(4)) + row
    return tuple(
        Artefact(*key, float(row[1] / row[0]), float(np.sqrt(row[2] / row[3])))
        for key, row in rows.items()
        if row[1] < UNFOLLOWED * row[0]
    )


def _without(one: Evidence, lines: NDArray[np.bool_], k: int) -> Evidence:
    """The record without the torque of its k-th live joint at these lines."""
    tau = one.scene.tau.copy()
    tau[lines, k] = 0.0
    return replace(one, scene=replace(one.scene, tau=tau))
