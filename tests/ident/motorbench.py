"""The records of the two-inertia motor bench, which are not part of the project, and how they become a campaign."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from ident.machines.importing import Imported, import_files
from ident.machines.mapping import load_map
from ident.records.campaign import Record

DATA = Path(os.environ.get("IDENT_DATA") or Path(__file__).parents[3] / "shared/data") / "motorbench"
FILES = [DATA / "MultisineTypeA.mat", DATA / "MultisineTypeB.mat"]
needs_records = pytest.mark.skipif(
    not all(file.is_file() for file in FILES), reason=f"no records of the motor bench in {DATA}; set IDENT_DATA"
)

#: What a person knows of the bench: the load encoder counts the other way, K_t is unknown, inertias are a guess.
MAP = """
[campaign]
source = "two-inertia motor bench"
hold = "band-limited"
[robot]
joints = ["motor"]
[joint.motor]
J_l_kgm2 = 0.005
torque = {name = "iq_adx", unit = "A"}
motor_angle = {name = "theta_mx", unit = "rad", offset = "posture"}
link_angle = {name = "theta_my", unit = "rad", sign = -1, offset = "posture"}
[record]
posture_rad = [0]
time = {name = "time", unit = "us"}
reference = "iq_refx"
"""


def imported(directory: Path) -> Imported:
    """Both records, by the map written into `directory`."""
    (directory / "map.toml").write_text(MAP)
    return import_files(load_map(directory / "map.toml"), FILES)


def around_the_modes(record: Record) -> tuple[np.ndarray, ...]:
    """Frequencies [L, Hz] where friction is small beside the forces of the masses; there torque, motor and load angle [L]."""
    periods = np.stack([record.tau[:, 0], record.theta[:, 0], record.q_link[:, 0]])
    spectra = np.fft.rfft(periods.reshape(3, -1, record.samples_per_period)[:, 10:].mean(axis=1))[:, record.lines]
    f = record.lines * record.f0
    near = (f > 40) & (f < 100)
    return f[near], *spectra[:, near]
