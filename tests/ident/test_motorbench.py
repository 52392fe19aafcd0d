"""The first real machine: a two-inertia bench, one joint, no URDF. The data are not part of the project."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from ident.fit import two_mass
from ident.frf import estimate
from ident.importing import Imported, import_files
from ident.mapping import load_map
from ident.store import read_campaign, write_campaign

DATA = Path(os.environ.get("IDENT_DATA") or Path(__file__).parents[3] / "shared/data") / "motorbench"
FILES = [DATA / "MultisineTypeA.mat", DATA / "MultisineTypeB.mat"]
pytestmark = pytest.mark.skipif(
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


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Imported:
    file = tmp_path_factory.mktemp("bench") / "map.toml"
    file.write_text(MAP)
    return import_files(load_map(file), FILES)


def test_the_records_are_what_the_readme_of_the_data_says(imported: Imported) -> None:
    campaign = imported.campaign
    a, b = campaign.records
    assert campaign.fs == 2500 and campaign.hold == "band-limited"
    assert [r.samples_per_period for r in (a, b)] == [2500, 2500] and [r.periods for r in (a, b)] == [20, 20]
    assert a.lines.tolist() == list(range(11, 251))
    assert b.lines.tolist() == list(range(13, 250, 4))


def test_samples_units_and_signs_are_those_of_the_file(imported: Imported) -> None:
    for record, file in zip(imported.campaign.records, FILES, strict=True):
        raw = loadmat(file, squeeze_me=True)
        np.testing.assert_array_equal(record.tau[:, 0], raw["iq_adx"])
        np.testing.assert_allclose(np.diff(record.theta[:, 0]), np.diff(raw["theta_mx"]), atol=1e-14)
        np.testing.assert_allclose(np.diff(record.q_link[:, 0]), -np.diff(raw["theta_my"]), atol=1e-14)
    assert [note for note in imported.notes if "sign" in note] == []
    assert any("A s2/rad" in note for note in imported.notes)


def test_the_campaign_fits_and_the_second_encoder_agrees(imported: Imported, tmp_path: Path) -> None:
    """The load encoder never enters the fit: it says J_l/J_m and f_AR by itself.

    Momentum of the free bench: J_m theta + J_l q = tau/s^2 at every line, so J_m and J_l follow from the motions alone.
    """
    write_campaign(imported.campaign, tmp_path / "bench.h5")
    campaign = read_campaign(tmp_path / "bench.h5")
    for record in campaign.records:
        frf = estimate(record, campaign)
        fit = two_mass(frf, 1.0, campaign.fs, campaign.hold)
        assert not fit.explained  # friction behind the spring and a delay: nobody has declared them
        S = record.samples_per_period
        periods = np.stack([record.tau[:, 0], record.theta[:, 0], record.q_link[:, 0]]).reshape(3, -1, S)
        tau, theta, q = np.fft.rfft(periods[:, 10:].mean(axis=1))[:, record.lines]
        f = record.lines * record.f0
        columns = np.stack([theta, q], axis=1)
        near = (f > 40) & (f < 100)  # around the modes friction is small beside the masses' forces
        A = np.concatenate([columns[near].real, columns[near].imag])
        rhs = -tau[near] / (2 * np.pi * f[near]) ** 2
        (J_m, J_l), *_ = np.linalg.lstsq(A, np.concatenate([rhs.real, rhs.imag]), rcond=None)
        assert fit.J_l == pytest.approx(J_l, rel=0.1)
        assert fit.J_m == pytest.approx(J_m, rel=0.1)
        assert fit.f_AR == pytest.approx(f[np.argmin(np.abs(frf.G) * f**2)], rel=0.03)
