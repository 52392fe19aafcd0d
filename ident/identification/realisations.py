"""What realisations of one record tell differently beyond their noise: stochastic nonlinear distortion, cell by cell.

The same lines, as strong, in other phases have the same best linear approximation; what a nonlinear arm leaves of it is another one
each time. Of M responses with noise variance v, the sample variance has the mean v + v_s, v_s being the distortion of one record:
R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., Wiley 2012, section 4.3 (robust method).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ident.arm.coupled import NOISE_MODEL
from ident.joint.fit import chi2_limit
from ident.records.campaign import Array, Record
from ident.records.frf import USABLE, Frf

#: Realisations are as strong as each other to this share; played at another size a nonlinear arm is another one.
AS_STRONG = 0.02
#: Excitations that are alike to more than this are one played again, which tells noise only.
ALIKE = 0.5


@dataclass(frozen=True)
class Distortion:
    """The realisations `records` of one cell: `joint` excited at `posture` [n, rad].

    `level` rms over the lines of what differs beyond noise, in one record, relative to the response; zero where `chi2_per_dof`, what
    differs over what noise makes differ, stays below `chi2_limit`. `noise` likewise. Over lines that stand out of the noise, NaN
    where none does.
    """

    records: tuple[str, ...]
    joint: str
    posture: tuple[float, ...]
    level: float
    noise: float
    chi2_per_dof: float
    chi2_limit: float


def distortions(records: Sequence[Record], responses: Sequence[Frf]) -> tuple[Distortion, ...]:
    """Returns the distortion in every cell of which there are two realisations or more; `responses` are those of `records`."""
    cells: dict[tuple[str, bytes, float, bytes], list[tuple[Record, Frf]]] = {}
    for record, frf in zip(records, responses, strict=True):
        cell = record.excited, record.posture.tobytes(), record.f0, record.lines.tobytes()
        own = cells.setdefault(cell, [])
        if all(_other_realisation(record, frf, *one) for one in own):
            own.append((record, frf))
    return tuple(_distortion(own) for own in cells.values() if len(own) > 1)


def text(found: Sequence[Distortion]) -> str:
    """One line for a person."""
    beyond = [one for one in found if one.level > 0.0]
    if not beyond:
        return f"Realisations differ by no more than noise in all {len(found)} cells: no nonlinear distortion is seen"
    worst = max(beyond, key=lambda one: one.level)
    return (
        f"Realisations differ beyond noise in {len(beyond)} of {len(found)} cells: nonlinear distortion of up to "
        f"{100 * worst.level:.2g} % of the response, noise {100 * worst.noise:.2g} % ({worst.joint}, records {', '.join(worst.records)})"
    )


def document(found: Sequence[Distortion]) -> list[dict[str, Any]]:
    """Returns what result.json has of it."""
    return [asdict(one) for one in found]


def _other_realisation(record: Record, frf: Frf, other: Record, theirs: Frf) -> bool:
    """Whether the record is as strong as the other one, in other phases."""
    tau, before = frf.tau[:, frf.index], theirs.tau[:, frf.index]
    alike = abs(np.vdot(tau, before)) / (np.linalg.norm(tau) * np.linalg.norm(before))
    return bool(abs(record.rms - other.rms) <= AS_STRONG * other.rms and alike <= ALIKE)


def _distortion(cell: Sequence[tuple[Record, Frf]]) -> Distortion:
    record, frf = cell[0]
    usable = np.all([one.usable for _, one in cell], axis=0)
    G = np.array([one.G for _, one in cell])[:, usable]
    noise = np.mean([one.variance for _, one in cell], axis=0)[usable]
    mean, M = G.mean(axis=0), len(cell)
    spread = np.sum(np.abs(G - mean) ** 2, axis=0) / (M - 1)
    lines = max(int(usable.sum()), 1)
    misfit = float(np.sum(spread / noise) / lines)
    limit = (1.0 + NOISE_MODEL) * chi2_limit(2 * (M - 1) * lines, sum(one.dof for _, one in cell), frf.width)
    clear = np.abs(mean) > USABLE * np.sqrt(noise)
    beyond = _rms(spread - noise, mean, clear) if misfit > limit else 0.0
    ids = tuple(one.id for one, _ in cell)
    posture = tuple(record.posture.tolist())
    return Distortion(ids, record.excited, posture, beyond, _rms(noise, mean, clear), misfit, limit)


def _rms(variance: Array, mean: Array, clear: Array) -> float:
    """The root of a variance [L] relative to the response, on the average of the clear lines."""
    if not clear.any():
        return np.nan
    return float(np.sqrt(max(np.mean(variance[clear] / np.abs(mean[clear]) ** 2), 0.0)))
