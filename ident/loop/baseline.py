"""The same robot at an earlier time, as the declared one: what has changed since is all that is left to be found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.arm.evidence import gravity_basis
from ident.errors import IdentError
from ident.identification.export import urdf
from ident.identification.identified import of_parts
from ident.identification.links import nearest_links
from ident.loop.diagnose import Diagnosis
from ident.records.campaign import Campaign, Earlier
from ident.search.deviations import UNKNOWN, told
from ident.search.spread import scatter, spread


def declared_by(earlier: Diagnosis, campaign: Campaign) -> tuple[Campaign, tuple[str, ...]]:
    """Returns `campaign` with the arm that `earlier` ended with as the declared one, and notes of what that leaves out.

    Drives and links are those of the earlier records, as sure as these told them: what they left open contradicts nothing.
    Effects found there are not part of a declared arm: they are named in the notes, and found again. Raises IdentError where
    the two campaigns are not of one robot.
    """
    ours, theirs = (
        {"joints": c.joints, "URDF": c.urdf, "gears": c.N.tolist(), "gravity": c.gravity.tolist()}
        for c in (earlier.campaign, campaign)
    )
    for what, own in ours.items():
        if own != theirs[what]:
            raise IdentError(f"the baseline is another robot: its {what} differ from the campaign's")
    p = earlier.end.problem.parameters(earlier.end.minimum.vector)
    covariance, unseen, _ = spread(earlier.split, earlier.end)
    arm = of_parts(
        earlier.campaign, earlier.model, p.alpha, covariance, unseen, p.K, p.J_m, p.D, p.D_spring,
        source=earlier.campaign.source,
    )  # fmt: skip
    text = urdf(arm, nearest_links(arm.model, arm.alpha, arm.covariance, arm.unseen))
    notes = [f"Declared is what the baseline ended with ({earlier.status}): its drives and links."]
    for a in earlier.added:
        place = "" if a.effect.joint is None else f" at {campaign.joints[a.effect.joint]}"
        notes.append(
            f"The baseline has {a.effect.name}{place} already; a declared arm can not hold it, so it is found again."
        )
    declared = replace(campaign, urdf=text, K=p.K, J_m=p.J_m, D=p.D, D_spring=p.D_spring, earlier=_as_told(earlier))
    return declared, tuple(notes)


def _as_told(earlier: Diagnosis) -> Earlier:
    """The numbers of the arm as the earlier records told them, and how surely."""
    problem, minimum, factoring = earlier.end.problem, earlier.end.minimum, earlier.model.factoring
    covariance, hidden = told(problem, minimum)
    covariance, base = scatter(earlier.split, earlier.end) ** 2 * covariance + UNKNOWN * hidden @ hidden.T, problem.base
    rows = np.vstack([factoring.W * factoring.free, gravity_basis(earlier.model, earlier.campaign.gravity)])
    return Earlier(minimum.vector[:base], covariance[:base, :base], rows)
