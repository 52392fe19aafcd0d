"""What a person should look at in records that were brought in: signs, gears, what nothing tells of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ident.machines.at_rest import opposed, ratio_at_rest
from ident.machines.mapping import Map
from ident.records.campaign import Array, Record

#: A joint that rested no further from 0 than this [rad or m] shows nothing of its gear at rest.
RESTS = 0.05

#: Share of the lines, the lowest ones, at which a velocity is compared with its angle.
_LOWEST = 0.1


def _spectra(record: Record, values: Array) -> NDArray[np.complex128]:
    """The excited lines [L, n] of the mean over all periods but the first."""
    S = record.samples_per_period
    mean = values.reshape(-1, S, values.shape[1])[1:].mean(axis=0)
    return np.asarray(np.fft.rfft(mean, axis=0)[record.lines])


def signs(record: Record, mapping: Map) -> list[str]:
    """A note for the excited joint if torque and motor, or motor and link, seem to turn in opposite directions, the motor's velocity is not the
    slope of its angle, or the link goes elsewhere than the gear says; none where lines do not tell."""
    k = [joint.name for joint in mapping.joints].index(record.excited)
    tau, theta = _spectra(record, record.tau)[:, k], _spectra(record, record.theta)[:, k]
    f, count = record.lines * record.f0, max(1, round(_LOWEST * len(record.lines)))
    notes = []
    if opposed(f, tau, theta):
        notes.append(
            f"record {record.id}: torque and motor angle of {record.excited} seem of opposite sign: check the map"
        )
    if record.omega is not None:
        slope, omega = 2j * np.pi * f * theta, _spectra(record, record.omega)[:, k]
        times = float((np.conj(slope) * omega)[:count].real.sum() / (np.abs(slope[:count]) ** 2).sum())
        if not 0.5 < times < 2:
            notes.append(
                f"record {record.id}: motor_velocity of {record.excited} is {times:.2g} times the slope of its motor_angle at the lowest lines; "
                "expected 1: check its unit, sign and column"
            )
    ratio = None
    if record.q_link is not None:
        ratio = ratio_at_rest(f, theta, _spectra(record, record.q_link)[:, k] * mapping.joints[k].N)
    if ratio is not None and ratio < 0:
        notes.append(
            f"record {record.id}: motor and link angle of {record.excited} are of opposite sign: check the map"
        )
    elif ratio is not None and not 0.5 < ratio < 2:
        notes.append(
            f"record {record.id}: far below its modes the link of {record.excited} moves {1 / ratio:.2g} times as far as its motor says; "
            "expected 1: check N, counts and units"
        )
    return notes


def untold_gears(mapping: Map, records: Sequence[Record]) -> list[str]:
    """A note if there are joints of whose gear no angle at rest tells anything."""
    at_zero = np.abs([record.posture for record in records]).max(axis=0) <= RESTS
    names = [joint.name for joint, zero in zip(mapping.joints, at_zero, strict=True) if zero and joint.N != 1]
    if not names:
        return []
    gears = "gear ratio and sign of" if len(names) == 1 else "gear ratios and signs of"
    was = "it rested" if len(names) == 1 else "they rested"
    return [f"{gears} {', '.join(names)} are taken as declared: {was} at 0 in all records"]
