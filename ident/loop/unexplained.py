"""What a diagnosis leaves unexplained: band by band, where a free force would explain most of it, and torques that moved nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.arm.arm_fit import hold
from ident.loop.artefacts import artefacts
from ident.loop.diagnose import Diagnosis
from ident.search.departures import Band
from ident.search.rest import SAME_PORT
from ident.search.trace import PORTS, linearise, port_shares

#: A port explains what is left when a free force there takes this share of it.
SOURCE = 0.5


@dataclass(frozen=True)
class Source:
    """Where a free force explains most of what is left: joint (from 0), ports, the likeliest first, and its share. A joint that
    moves no other has several: they can not be told apart by where they act."""

    joint: int
    ports: tuple[str, ...]
    share: float


def sources(d: Diagnosis, bands: Sequence[Band]) -> list[Source | None]:
    """Returns for each band what would explain most of what the last model leaves there; None where nothing is left."""
    problem, vector = d.end.problem, d.end.minimum.vector
    lin = linearise(problem, vector, hold(problem, vector))
    return [_source(port_shares(lin, *band)) for band in bands]


def _source(shares: Sequence[tuple[str, int, float]]) -> Source | None:
    if not any(share for _, _, share in shares):
        return None
    _, joint, best = shares[0]
    own = {port: share for port, j, share in shares if j == joint}
    return Source(joint, tuple(port for port in PORTS if own[port] >= SAME_PORT * best), best)


def unexplained(d: Diagnosis) -> list[dict[str, Any]]:
    """Returns what stays, band by band, largest first, for verdict.json: where a free force would explain most of it, else where it is
    measured; odd and even lines (None where the excited ones alone tell and are of both kinds); torques `unmoved` that no motion
    follows. A band without end ends [Hz] at half the sample rate."""
    bands = list(dict.fromkeys(one.band for one in d.departures))
    if not bands:
        return []
    joints = d.campaign.joints
    odd_only = all(bool(np.all(record.lines % 2)) for record in d.campaign.records)
    unmoved = artefacts(d, bands)
    rows = []
    for band, source in zip(bands, sources(d, bands), strict=True):
        here = [one for one in d.departures if one.band == band]
        kinds = {one.kind for one in here}
        clear = source if source is not None and source.share > SOURCE else None
        rows.append(
            {
                "joint": joints[clear.joint if clear else max(here, key=lambda one: one.share).joint],
                "port": clear.ports[0] if clear else None,
                "ports": clear.ports if clear else (),
                "band_hz": [band.low, min(band.high, d.campaign.fs / 2.0)],
                "odd": True if "odd" in kinds or ("excited" in kinds and odd_only) else None if "excited" in kinds else False,
                "even": True if "even" in kinds else None if "excited" in kinds and not odd_only else False,
                "share": sum(one.share for one in here),
                "chi2_per_dof": max(one.level for one in here),
                "measured_at": sorted({joints[one.joint] for one in here}),
                "source_share": source.share if source else None,
                "unmoved": [
                    {"joint": joints[one.joint], "lines": "even" if one.even else "odd", "torque_share": one.share,
                     "left_without": one.left} for one in unmoved if one.band == band
                ],
            }
        )  # fmt: skip
    return sorted(rows, key=lambda row: -float(row["share"]))
