"""Realisations of a record: the same lines in other phases, and what differs between them beyond noise."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ident.cli import main
from ident.effects.catalogue import parse
from ident.identification.realisations import Distortion, distortions, text
from ident.records.campaign import Campaign
from ident.records.frf import Frf, estimate
from ident.records.store import read_campaign
from ident.simulator.bench import design, prepare, simulate
from ident.simulator.resume import digest
from symgen.robot import Experiment, load_robot
from symgen.urdf import load_chain

ROBOT = replace(
    load_robot(Path(__file__).parents[3] / "robots" / "ypp3"),
    experiment=Experiment(f0=1.0, band=(1.0, 120.0), periods=3, swing=0.002),
)
YPP = load_chain(ROBOT.urdf)
CELLS = [("joint3", [0.0, 0.4, 0.1]), ("joint2", [0.2, 0.5, -0.9])]


def campaign(*effects: str, realisations: int = 3) -> Campaign:
    found = [parse(text, [ROBOT.drive(name) for name in YPP.names]) for text in effects]
    return simulate(YPP, ROBOT, CELLS, seed=2, effects=found, realisations=realisations, workers=1)


def told(data: Campaign) -> tuple[Distortion, ...]:
    return distortions(data.records, [estimate(record, data) for record in data.records])


@pytest.fixture(scope="module")
def linear() -> Campaign:
    return campaign()


def test_realisations_are_alike_but_for_their_phases() -> None:
    jobs = design(YPP, ROBOT, CELLS, seed=2, realisations=3)
    assert [job.id for job in jobs] == [f"{k:04d}" for k in range(1, 7)]
    for own in (jobs[:3], jobs[3:]):
        first = own[0].setup
        for job in own[1:]:
            e = job.setup.excitation
            np.testing.assert_array_equal(e.lines, first.excitation.lines)
            assert len(e.lines) < len(range(e.lines[0], e.lines[-1] + 1, 2)), "detection lines are left out"
            np.testing.assert_allclose(e.amplitude, first.excitation.amplitude, rtol=1e-12)
            assert abs(np.mean(np.exp(1j * (e.phase - first.excitation.phase)))) < 0.5
            assert job.setup.joint == first.joint and job.setup.servos == first.servos
        for job in own:
            assert job.setup.swing <= ROBOT.experiment.swing * (1 + 1e-9)
            assert digest(job.seed) != digest(first) and job.setup.periods == first.periods
    assert len({digest(job.seed) for job in jobs}) == 6


def test_swing_and_torque_of_each_are_those_of_its_motion(linear: Campaign) -> None:
    """As the simulated robot moves: of the joints' motors, in the last period."""
    jobs = design(YPP, ROBOT, CELLS, seed=2, realisations=3)
    for job, record in zip(jobs, linear.records, strict=True):
        tau = record.tau[-record.samples_per_period :]
        np.testing.assert_allclose(
            np.abs(tau).max(axis=0)[job.setup.joint], job.setup.torque[job.setup.joint], rtol=0.05
        )


def test_one_is_what_it_always_was_and_more_are_the_same_again() -> None:
    one, three = design(YPP, ROBOT, CELLS, seed=2), design(YPP, ROBOT, CELLS, seed=2, realisations=3)
    for job, (name, q), cell in zip(one, CELLS, np.random.SeedSequence(2).spawn(len(CELLS)), strict=True):
        draw, noise = cell.spawn(2)
        setup = prepare(YPP, ROBOT, name, q, lock="dob", rng=np.random.default_rng(draw))
        assert digest([job.setup, job.seed]) == digest([setup, noise])
    assert digest(three) == digest(design(YPP, ROBOT, CELLS, seed=2, realisations=3))
    np.testing.assert_array_equal(one[0].setup.excitation.phase, three[0].setup.excitation.phase)


def test_a_linear_arm_differs_by_noise(linear: Campaign) -> None:
    found = told(linear)
    assert [one.records for one in found] == [("0001", "0002", "0003"), ("0004", "0005", "0006")]
    for one in found:
        assert one.level == 0.0 and 0.5 < one.chi2_per_dof < one.chi2_limit and 0.0 < one.noise < 0.05
    assert text(found) == "Realisations differ by no more than noise in all 2 cells: no nonlinear distortion is seen"


@pytest.mark.bench
def test_friction_differs_beyond_it() -> None:
    found = told(campaign("motor-coulomb:level=0.002@joint3", realisations=2))
    rubbing, free = found
    assert rubbing.level > 2 * rubbing.noise and rubbing.chi2_per_dof > 2 * rubbing.chi2_limit
    assert free.joint == "joint2" and free.level < 0.2 * rubbing.level
    assert f"distortion of up to {100 * rubbing.level:.2g} % of the response" in text(found)
    assert "joint3, records 0001, 0002)" in text(found)


def invented(G: np.ndarray, linear: Campaign) -> tuple[Distortion, ...]:
    """Of responses G [M, L] in place of those of the first cell, their variance 1e-6 of them."""
    frfs: list[Frf] = [estimate(record, linear) for record in linear.records[:3]]
    records = [replace(linear.records[0], id=f"{k:04d}") for k in range(len(G))]
    made = []
    for k, row in enumerate(G):
        frf, tau = frfs[0], frfs[0].tau.copy()
        tau[:, frf.index] *= np.exp(2j * np.pi * np.random.default_rng(k).uniform(size=len(tau)))
        theta = frf.theta.copy()
        theta[:, frf.index] = row * tau[:, frf.index]
        made.append(replace(frf, tau=tau, theta=theta, variance=np.full(len(tau), 1e-6)))
    return distortions(records, made)


@pytest.mark.parametrize("M", [2, 5])
def test_the_level_is_that_of_what_was_put_in(M: int, linear: Campaign) -> None:
    rng, L = np.random.default_rng(M), len(linear.records[0].lines)

    def scatter(size: float) -> np.ndarray:
        return size * (rng.standard_normal((M, L)) + 1j * rng.standard_normal((M, L))) / np.sqrt(2)

    (found,) = invented(1.0 + scatter(1e-3) + scatter(5e-3), linear)
    assert found.level == pytest.approx(5e-3, rel=0.2) and found.noise == pytest.approx(1e-3, rel=0.01)
    (found,) = invented(1.0 + scatter(1e-3), linear)
    assert found.level == 0.0 and found.chi2_per_dof == pytest.approx(1.0, abs=0.3)


def test_a_record_played_again_or_at_another_size_is_none(linear: Campaign) -> None:
    one, two = linear.records[:2]
    again, larger = replace(one, id="0007"), replace(two, id="0008", tau=2 * two.tau, rms=2 * two.rms)
    for records in ((one, again), (one, larger), linear.records[2:4]):
        assert told(replace(linear, records=records)) == ()


@pytest.mark.bench
def test_from_the_command_line_to_the_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every cell twice, fitted together; one line on the page, and in result.json what each cell tells."""
    file, out = tmp_path / "c.h5", tmp_path / "out"
    asked = ["--spacing", "2", "--periods", "3", "--realisations", "2"]
    assert main(["simulate", str(ROBOT.path.parent), *asked, "-o", str(file)]) == 0
    data = read_campaign(file)
    assert len(data.records) == 16
    for one, two in zip(data.records[::2], data.records[1::2], strict=True):
        assert one.excited == two.excited and one.rms == pytest.approx(two.rms)
        np.testing.assert_array_equal(one.posture, two.posture)
        np.testing.assert_array_equal(one.lines, two.lines)
    capsys.readouterr()
    assert main(["fit", str(file), "-o", str(out)]) == 0
    line = [line for line in capsys.readouterr().out.splitlines() if "Realisations differ" in line]
    result = json.loads((out / "result.json").read_text())
    assert len(line) == 1 and line[0].removeprefix("! ") in result["notes"]
    assert [one["records"] for one in result["realisations"]] == [[f"{k:04d}", f"{k + 1:04d}"] for k in range(1, 17, 2)]
    assert result["explained"] and len(result["records"]) == 16
