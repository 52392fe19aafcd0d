"""What the numbers of the corrected arm make doubtful of clocks, units and gears."""

from __future__ import annotations

import numpy as np

from ident.loop.diagnose import Diagnosis
from ident.records.doubtful import doubts, joint_medians


def doubtful(d: Diagnosis) -> list[str]:
    """The scales that drives and links at their minimum make doubtful, one line each; see `ident.records.doubtful`."""
    c, p = d.campaign, d.end.problem.parameters(d.end.minimum.vector)
    q = np.array([record.posture for record in c.records])
    index = np.array([c.joints.index(record.excited) for record in c.records])
    found, declared = (J[np.arange(len(q)), index, index] for J in (d.model.J(q, p.alpha), d.model.J_cad(q)))
    own = joint_medians(found / declared, index, c.n)
    return [f"{doubt.line}." for doubt in doubts(c.joints, c.fs, c.N, p.K / c.K, p.J_m / c.J_m, own)]
