"""The first real machine: a two-inertia bench, one joint, no URDF. The data are not part of the project."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from motorbench import FILES, around_the_modes, imported, needs_records
from scipy.io import loadmat

from ident.joint.fit import two_mass
from ident.loop.diagnose import diagnose
from ident.machines.importing import Imported
from ident.records.frf import estimate
from ident.records.store import read_campaign, write_campaign
from symgen.plan import model_of_urdf

pytestmark = needs_records


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Imported:
    return imported(tmp_path_factory.mktemp("bench"))


def test_the_records_are_what_the_readme_of_the_data_says(found: Imported) -> None:
    campaign = found.campaign
    a, b = campaign.records
    assert campaign.fs == 2500 and campaign.hold == "band-limited"
    assert [r.samples_per_period for r in (a, b)] == [2500, 2500] and [r.periods for r in (a, b)] == [20, 20]
    assert a.lines.tolist() == list(range(11, 251))
    assert b.lines.tolist() == list(range(13, 250, 4))


def test_samples_units_and_signs_are_those_of_the_file(found: Imported) -> None:
    for record, file in zip(found.campaign.records, FILES, strict=True):
        raw = loadmat(file, squeeze_me=True)
        np.testing.assert_array_equal(record.tau[:, 0], raw["iq_adx"])
        np.testing.assert_allclose(np.diff(record.theta[:, 0]), np.diff(raw["theta_mx"]), atol=1e-14)
        np.testing.assert_allclose(np.diff(record.q_link[:, 0]), -np.diff(raw["theta_my"]), atol=1e-14)
    assert [note for note in found.notes if "sign" in note] == []
    assert any("A s2/rad" in note for note in found.notes)


def test_the_campaign_fits_and_the_second_encoder_agrees(found: Imported, tmp_path: Path) -> None:
    """The load encoder never enters the fit: it says J_l/J_m and f_AR by itself.

    Momentum of the free bench: J_m theta + J_l q = tau/s^2 at every line, so J_m and J_l follow from the motions alone.
    """
    write_campaign(found.campaign, tmp_path / "bench.h5")
    campaign = read_campaign(tmp_path / "bench.h5")
    for record in campaign.records:
        frf = estimate(record, campaign)
        fit = two_mass(frf, 1.0, campaign.fs, campaign.hold)
        assert not fit.explained  # friction behind the spring and a delay: nobody has declared them
        f, tau, theta, q = around_the_modes(record)
        columns = np.stack([theta, q], axis=1)
        A = np.concatenate([columns.real, columns.imag])
        rhs = -tau / (2 * np.pi * f) ** 2
        (J_m, J_l), *_ = np.linalg.lstsq(A, np.concatenate([rhs.real, rhs.imag]), rcond=None)
        assert fit.J_l == pytest.approx(J_l, rel=0.1)
        assert fit.J_m == pytest.approx(J_m, rel=0.1)
        assert fit.f_AR == pytest.approx(frf.frequencies[np.argmin(np.abs(frf.G) * frf.frequencies**2)], rel=0.03)


@pytest.mark.bench
def test_what_the_bench_lacks_is_named(found: Imported) -> None:
    """The load's own damping, then a delay of about 0.1 ms; reported on parts of the other record, which neither fitted nor chose."""
    model = model_of_urdf(found.campaign.urdf, found.campaign.joints, believe_zeros=True)
    d = diagnose(found.campaign, model, workers=2)
    damping, delay = (added.effect for added in d.added[:2])
    assert (damping.name, delay.name) == ("link-viscous", "input-delay")
    assert delay["time"] == pytest.approx(1e-4, abs=2e-5) and 0.05 < damping["damping"] < 0.15
    assert d.before.all > 0.1 and d.after.all < 0.065
    assert d.status == "unexplained"
