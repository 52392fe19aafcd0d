"""The corrected arm of a log as files of other programs: its links; a log tells nothing of springs and motors."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ident.identification.export import write_links
from ident.identification.identified import Identified
from ident.identification.links import Links, nearest_links
from ident.logs.diagnose import LogDiagnosis
from symgen.robot import Experiment


def write_robot(d: LogDiagnosis, directory: str | Path) -> tuple[Path, ...]:
    """Writes identified.urdf, J.casadi, J.c and J.h of the corrected arm into `directory`; returns the paths.

    The links are those of the fit, or, where no bodies have these, the nearest to CAD that have their J(q). Raises IdentError naming the file that can
    not be written.
    """
    phi, covariance = d.parameters
    W, n = d.model.factoring.W, d.log.n
    alpha, spread = W @ phi, W @ covariance @ W.T
    if d.bodies:
        links = Links(phi.reshape(n, 10), alpha, True, True, 0.0, np.zeros(n), ())
    else:
        links = nearest_links(d.model, alpha, spread + np.diag(np.full(len(alpha), 1e-12 * np.abs(alpha).max() ** 2)))
    terms = ", ".join(dict.fromkeys(step.term.name for step in d.found.steps)) or "nothing"
    arm = Identified(
        d.model, d.log.urdf, alpha, spread, np.zeros((len(alpha), 0)), (), (), d.log.gravity, Experiment(),
        f"{d.log.source}; a log, diagnosed, {terms} added",
    )  # fmt: skip
    return write_links(arm, links, directory)
