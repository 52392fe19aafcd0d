"""An arm of two joints of which one hangs on a soft spring: it sags by up to 0.1 rad, and its links swing far."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from two_joints import two_joints

from ident.records.campaign import Campaign
from ident.simulator.bench import simulate
from symgen.plan import Model, chain_of_robot, make_model

_EXPERIMENT = "sample_rate_Hz = 250\nline_spacing_Hz = 1.0\nband_Hz = [1.0, 60]\nperiods = 3\nswing_rad = {swing}\ntorque_noise_rel = {noise}"
_SOFT = {"K_Nm_per_rad": 25.0, "N": 20.0, "J_m_kgm2": 1e-4, "D_spring_Nms_per_rad": 0.1}
_CELLS = [("j2", 0.2), ("j2", 0.9), ("j1", 0.5), ("j2", -0.7), ("j1", -1.2), ("j1", 1.2), ("j2", 1.3), ("j2", -1.2)]


@cache
def campaign(swing: float = 0.005, noise: float = 0.005) -> tuple[Campaign, Model]:
    """Records at true postures, and the model of the arm."""
    with TemporaryDirectory() as folder:
        robot = two_joints(Path(folder), _EXPERIMENT.format(swing=swing, noise=noise), {}, _SOFT)
        chain = chain_of_robot(robot)
        cells = [(joint, [0.0, q]) for joint, q in _CELLS]
        return simulate(chain, robot, cells, workers=1), make_model(chain, believe_zeros=True)


def declared_by(c: Campaign, K: np.ndarray) -> Campaign:
    """The same records, of which whoever takes springs for these [n] tells the postures; infinite: by the motors alone."""
    records = []
    for r in c.records:
        tau, theta = (x[-r.samples_per_period :].mean(axis=0) for x in (r.tau, r.theta))
        records.append(replace(r, posture=theta / c.N - c.N * tau / K))
    return replace(c, records=tuple(records), K=np.where(np.isfinite(K), K, c.K))
