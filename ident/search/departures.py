"""How far measured angles are from a model's: relative errors, and groups of lines beyond noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import compress, pairwise
from math import inf, isinf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ident.arm.arm_fit import Held, hold, residual, whitened_by
from ident.arm.evidence import Evidence
from ident.records.campaign import Array
from ident.search.changes import told_of
from ident.search.refits import BY_ALL, Bench, State, reduced_chi2

#: Where bands [Hz] in which errors are told meet; the last has no end, as nothing limits how far records reach.
EDGES = (0.0, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, inf)
#: chi^2 per degree of freedom of a group of lines above which the arm is not explained; more where a group has
#: fewer degrees than the second, and the least of them.
DEPARTURE, FULL_DOF, LEAST_DOF = 3.0, 40, 10
#: Noise of a line, in medians, above which an error over all lines leaves it out.
LOUD = 4.0


class Band(NamedTuple):
    """Frequencies from `low` [Hz] to below `high`; that is infinite for a band without end."""

    low: float
    high: float

    @property
    def name(self) -> str:
        return f"above {self.low:g} Hz" if isinf(self.high) else f"{self.low:g}-{self.high:g} Hz"

    def has(self, f: Array) -> NDArray[np.bool_]:
        """Which of some frequencies f [L, Hz] are in it [L]."""
        return np.asarray((f >= self.low) & (f < self.high))


def in_bands(f: Array) -> Iterator[tuple[Band, NDArray[np.bool_]]]:
    """Returns every band that has any of the frequencies f [L, Hz], lowest first, and which are in it [L]."""
    for low, high in pairwise(EDGES):
        band = Band(low, high)
        if (inside := band.has(f)).any():
            yield band, inside


@dataclass(frozen=True)
class Errors:
    """Relative rms of theta - G tau over the excited lines: of all, per joint, per band; and what noise alone makes of each.

    But for bands, lines whose noise is over `LOUD` times the median one of their joint are left out: the rms over
    hundreds of lines would be the noise of one.
    """

    all: float
    per_joint: dict[str, float]
    per_band: dict[str, float]
    noise: float
    noise_per_joint: dict[str, float]
    noise_per_band: dict[str, float]


@dataclass(frozen=True, eq=False)
class Departure:
    """A group of lines that stays unexplained: joint measured, band [Hz], kind of line, chi^2 per degree of freedom, and its share of
    what stays."""

    joint: int
    band: Band
    kind: str
    level: float
    share: float


def held_as(state: State, data: tuple[Evidence, ...], hurries: bool = False) -> tuple[Held, ...]:
    """Weights and motions of `data` as a model has them; motions that are hardly looked for once it is late if it `hurries`."""
    return _held_as(state, data, hurries)  # a call that leaves out what is the default would be kept apart


@lru_cache(maxsize=2)  # of the model that is judged: records that choose, and that report
def _held_as(state: State, data: tuple[Evidence, ...], hurries: bool) -> tuple[Held, ...]:
    return tuple(hold(replace(state.problem, data=data), state.minimum.vector, hurries=hurries))


def is_rough(bench: Bench, state: State) -> bool:
    """Whether a model leaves so much that rough motions tell as much as its own."""
    return reduced_chi2(bench, state) > BY_ALL


@lru_cache(maxsize=8)  # those of one diagnosis: what is kept keeps its records
def errors(bench: Bench, state: State, data: tuple[Evidence, ...], held: tuple[Held, ...] = ()) -> Errors:
    """Relative rms errors of the excited joint's angle at the excited lines of `data`, with motions as `held`, else as the state's.

    Of the records those that `told_of` keeps.
    """
    told = {one.index for one in told_of(bench.split, state, data)}
    which = [one.index in told for one in data]
    data, held = tuple(compress(data, which)), tuple(compress(held, which))
    problem = replace(state.problem, data=data)
    held = held or held_as(state, data, is_rough(bench, state))
    squares: list[tuple[int, Array, Array, Array]] = []
    for one, kept in zip(data, held, strict=True):
        r, W = residual(problem, state.minimum.vector, one, kept.moved)[0], kept.W
        k = one.place
        use = one.is_excited & one.use
        size = np.maximum(np.abs(one.scene.theta[use, k]) ** 2, 1e-300)
        inverse = np.linalg.inv(W[use])
        variance = np.sum(np.abs(inverse[:, k]) ** 2, axis=1)
        squares.append((one.excited, one.sampling.f[use], np.abs(r[use, k]) ** 2 / size, variance / size))
    joints = np.concatenate([np.full(len(f), j) for j, f, _, _ in squares])
    f, error, noise = (np.concatenate([row[k] for row in squares]) for k in (1, 2, 3))
    quiet = ~loud(joints, noise)

    def rms(values: Array) -> float:
        return float(np.sqrt(values.mean()))

    def parts(values: Array) -> tuple[float, dict[str, float], dict[str, float]]:
        """Of all, per joint, per band."""
        per_joint = {names[j]: rms(values[quiet & (joints == j)]) for j in np.unique(joints).tolist()}
        return rms(values[quiet]), per_joint, {band.name: rms(values[inside]) for band, inside in in_bands(f)}

    names = bench.campaign.joints
    return Errors(*parts(error), *parts(noise))


def loud(joints: NDArray[np.int64], noise: Array) -> NDArray[np.bool_]:
    """Which lines, of these `joints`, have a `noise` power [relative] that an error over all lines can not have among the others."""
    found = np.zeros(len(noise), dtype=bool)
    for j in np.unique(joints):
        found[joints == j] = noise[joints == j] > LOUD**2 * np.median(noise[joints == j])
    return found


def groups(
    state: State, data: Sequence[Evidence], hurries: bool = False
) -> list[tuple[int, int, Band, str, float, float]]:
    """Groups of lines beyond `DEPARTURE`: (record, joint, band, kind, level, chi^2); motions as `held_as` has them.

    The level is without the line that departs most: one alone is an outlier, no effect.
    """
    data = tuple(data)
    problem, held = replace(state.problem, data=data), held_as(state, data, hurries)
    found = []
    for one, kept in zip(data, held, strict=True):
        r = residual(problem, state.minimum.vector, one, kept.moved)[0]
        power = 2.0 * np.abs(whitened_by(kept.W, r)) ** 2
        odd = one.scene.lines % 2 == 1
        kinds = {"excited": one.is_excited, "odd": odd & ~one.is_excited, "even": ~odd & ~one.is_excited}
        for band, inside in in_bands(one.sampling.f):
            for kind, which in kinds.items():
                use = which & one.use & inside
                if 2 * int(use.sum()) < LEAST_DOF:
                    continue
                for k, joint in enumerate(one.scene.arm.live.tolist()):
                    here = power[use, k]
                    level = float((here.sum() - here.max()) / (len(here) - 1) / 2.0)
                    if level > DEPARTURE * max(1.0, FULL_DOF / (2 * int(use.sum()))):
                        found.append((one.index, joint, band, kind, level, float(here.sum())))
    return found


def departures(bench: Bench, state: State) -> tuple[Departure, ...]:
    """What stays unexplained on the choosing and reporting records: joints, bands and kinds of line, largest share first."""
    data = bench.split.select + told_of(bench.split, state, bench.split.report)
    found = groups(state, data, is_rough(bench, state))
    total = sum(group[-1] for group in found)
    merged: dict[tuple[int, Band, str], list[float]] = {}
    for _, joint, band, kind, level, power in found:
        entry = merged.setdefault((joint, band, kind), [0.0, 0.0])
        entry[0], entry[1] = max(entry[0], level), entry[1] + power
    rows = [Departure(j, band, kind, level, power / total) for (j, band, kind), (level, power) in merged.items()]
    return tuple(sorted(rows, key=lambda d: -d.share))
