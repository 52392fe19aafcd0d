"""The same robot at an earlier time, as the declared one: what has changed since is all that is left to be found."""

from __future__ import annotations

from dataclasses import replace

from ident.arm.coupled import uncertainty
from ident.errors import IdentError
from ident.identification.export import urdf
from ident.identification.identified import of_parts
from ident.identification.links import nearest_links
from ident.loop.diagnose import Diagnosis
from ident.records.campaign import Campaign


def declared_by(earlier: Diagnosis, campaign: Campaign) -> tuple[Campaign, tuple[str, ...]]:
    """Returns `campaign` with the arm that `earlier` ended with as the declared one, and notes of what that leaves out.

    Drives and links are those of the earlier records. Effects found there are not part of a declared arm: they are named in
    the notes, and found again. Raises IdentError where the two campaigns are not of one robot.
    """
    if (earlier.campaign.joints, earlier.campaign.urdf) != (campaign.joints, campaign.urdf):
        raise IdentError("the baseline is another robot: its joints or its URDF differ from those of the campaign")
    problem, minimum = earlier.end.problem, earlier.end.minimum
    p = problem.parameters(minimum.vector)
    covariance, unseen, _ = uncertainty(problem, minimum)
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
    return replace(campaign, urdf=text, K=p.K, J_m=p.J_m, D=p.D, D_spring=p.D_spring), tuple(notes)
