"""The model whose constants the records of a campaign determine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.arm.evidence import live_joints
from ident.records.campaign import Campaign
from ident.records.frf import Frf
from symgen.plan import Model, model_of_urdf


def model_of_campaign(
    campaign: Campaign, responses: Sequence[Frf], believe_zeros: bool | None, method: str
) -> tuple[Model, tuple[str, ...]]:
    """The model whose constants the records determine, and a note where that took believing zeros nobody declared."""
    model = model_of_urdf(campaign.urdf, campaign.joints, believe_zeros=bool(believe_zeros))
    if believe_zeros is not None or _determined(responses, model, method):
        return model, ()
    symmetric = model_of_urdf(campaign.urdf, campaign.joints, believe_zeros=True)
    if not _determined(responses, symmetric, method):
        return model, ()
    zeros = zeros_believed(len(symmetric.factoring.believed))
    note = f"The records do not determine all constants of general links: {zeros[0].lower()}{zeros[1:]}."
    return symmetric, (note,)


def zeros_believed(count: int) -> str:
    """That so many zeros of the URDF are believed, as a sentence without its stop."""
    which, are = (
        (f"{count} inertial parameters that are", "are") if count > 1 else ("one inertial parameter that is", "is")
    )
    return f"The {which} exactly zero in the URDF {are} believed to be zero"


def _determined(responses: Sequence[Frf], model: Model, method: str) -> bool:
    """Whether the records show every constant: one J_ii each, or with "coupled" the matrix of the joints that move."""
    q = np.array([frf.posture for frf in responses])
    if method == "coupled":
        blocks = [
            rows[np.ix_(live, live)] for rows, live in zip(model.J_rows(q), map(live_joints, responses), strict=True)
        ]
        rows = np.concatenate([block.reshape(-1, block.shape[-1]) for block in blocks])
        return bool(np.linalg.matrix_rank(rows) == rows.shape[-1])
    index = [frf.index for frf in responses]
    return bool(np.linalg.matrix_rank(model.C_rows(q)[np.arange(len(q)), index]) == model.d)
