"""The corrected arm of a log as files of other programs: its links; a log tells nothing of springs and motors."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ident.identification.export import write_links
from ident.identification.identified import Identified
from ident.logs.diagnose import LogDiagnosis
from symgen.robot import Experiment


def write_robot(d: LogDiagnosis, directory: str | Path) -> tuple[Path, ...]:
    """Writes identified.urdf, J.casadi, J.c and J.h of the corrected arm into `directory`; returns the paths.

    All hold `LogDiagnosis.links`. Raises IdentError naming the file that can not be written.
    """
    alpha, spread = d.alpha
    terms = ", ".join(dict.fromkeys(step.term.name for step in d.found.steps)) or "nothing"
    arm = Identified(
        d.model, d.log.urdf, alpha, spread, np.zeros((len(alpha), 0)), (), (), d.log.gravity, Experiment(),
        f"{d.log.source}; a log, diagnosed, {terms} added",
    )  # fmt: skip
    return write_links(arm, d.links, directory)
