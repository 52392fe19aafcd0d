"""Lines that are left out of responses, as no motor makes what was read there: a tone of the mains or of a fan, which comes back in every period and
is no noise then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ident.records.campaign import Array, Campaign, Record
from ident.records.frf import Frf

#: How the note on what is left out begins; its frequencies follow, and Hz.
LEFT_OUT = "Left out, in all records and all errors: "


def without_lines(frf: Frf, frequencies: Array) -> Frf:
    """Returns the response without the lines at these `frequencies` [Hz]; those that it has not are ignored."""

    def kept(lines: Array) -> Array:
        return np.asarray(~np.isclose(lines[:, None], frequencies, rtol=1e-9, atol=0.0).any(axis=1))

    band, own = frf.band, kept(frf.frequencies)
    if band is not None:
        use = kept(band.frequencies)
        band = replace(
            band, lines=band.lines[use], excited=band.excited[use], tau=band.tau[use], theta=band.theta[use],
            noise=band.noise[:, use], floor=band.floor[use],
        )  # fmt: skip
    return replace(
        frf, frequencies=frf.frequencies[own], tau=frf.tau[own], theta=frf.theta[own], noise=frf.noise[:, own],
        variance=frf.variance[own], band=band,
    )  # fmt: skip


def lines_left_out(record: Record, frf: Frf) -> NDArray[np.int64]:
    """Returns the harmonics of its f0 in the band of a record that its response is without."""
    band = np.arange(record.lines[0], record.lines[-1] + 1)
    return np.setdiff1d(band, band if frf.band is None else frf.band.lines)


def silenced(record: Record, frf: Frf) -> Array:
    """Returns the angles [T, n, rad] of the periods that its response was made of, motor side, without what is left out of that."""
    S = record.samples_per_period
    theta = record.theta[-frf.periods * S :]
    for line in lines_left_out(record, frf):
        tone = np.exp(2j * np.pi * line / S * np.arange(len(theta)))[:, None]
        theta = theta - 2.0 * np.real((theta * tone.conj()).mean(axis=0) * tone)
    return theta


def left_out(campaign: Campaign, responses: Sequence[Frf]) -> list[str]:
    """Returns a note on the lines of `campaign` that `responses` are without; none where they have all."""
    pairs = zip(campaign.records, responses, strict=True)
    found = {float(f) for record, frf in pairs for f in lines_left_out(record, frf) * record.f0}
    if not found:
        return []
    told = ", ".join(f"{f:.6g}" for f in sorted(found))
    line = (
        f"{LEFT_OUT}{told} Hz. What was read there stands far above the lines beside it in record after record, as "
        f"a tone of the mains or of a fan does, or a resonance narrower than {campaign.records[0].f0:.3g} Hz"
    )
    return [line]
