"""Campaigns for a precision: what is predicted is what a fit of such records finds, and more costs more."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from unittest.mock import ANY

import numpy as np
import pytest
from once import once

from ident.arm.coupled import fit_coupled
from ident.errors import ExperimentError
from ident.identification.precision import ALLOWANCE, SPACINGS, Precision, for_target
from ident.joint.certainty import certainty
from ident.records.frf import estimate
from ident.simulator.bench import design, head, run
from ident.simulator.design import prepare
from symgen.chain import Chain
from symgen.plan import Model, plan_of_robot
from symgen.robot import Robot, load_robot, recordable

ROBOT = Path(__file__).parents[3] / "robots" / "ypp3"


@pytest.fixture(scope="module")
def planned() -> tuple[Model, Robot, list[tuple[str, np.ndarray]]]:
    """The cells that the constants need."""
    robot = load_robot(ROBOT)
    plan = plan_of_robot(robot)
    return plan.model, robot, [(cell.joint, cell.q) for cell in plan.cells if not cell.spare]


@pytest.fixture(scope="module", autouse=True)
def prepared_once() -> Iterator[None]:
    """A record of the one robot is prepared once, for whatever precision."""

    def key(chain: Chain, robot: Robot, joint: str, q: np.ndarray, *, lock: str, rng: np.random.Generator) -> str:
        return repr((robot.experiment, joint, q.tolist(), lock, rng.bit_generator.state))

    with once("ident.identification.precision.prepare", prepare, key):
        yield


def seconds(found: Precision) -> float:
    return sum(found.periods) / found.robot.experiment.f0


def test_the_fit_achieves_what_is_predicted(planned: tuple[Model, Robot, list[tuple[str, np.ndarray]]]) -> None:
    model, robot, _ = planned
    cells = [(cell.joint, cell.q) for cell in plan_of_robot(robot).cells]
    found = for_target(model, robot, cells, 0.01, seed=3)
    jobs = design(model.chain, found.robot, cells, seed=3)
    records = [
        run(replace(job, setup=replace(job.setup, periods=k))) for job, k in zip(jobs, found.periods, strict=True)
    ]
    data = head(model.chain, found.robot, tuple(records))
    assert sum(len(record.tau) for record in records) / data.fs == pytest.approx(found.seconds) == seconds(found)
    responses = [estimate(record, data) for record in records]
    fit = fit_coupled(data, model, responses)
    achieved = certainty(model, fit.covariance, fit.unseen).per_entry.max()
    # what leakage may cost need not be, and periods thought to settle may have: three of nine were counted
    kept = [one.periods / (k - job.setup.settle) for one, k, job in zip(responses, found.periods, jobs, strict=True)]
    assert found.sigma / np.sqrt(1.1 * ALLOWANCE * max(kept)) < achieved < 1.1 * found.sigma < 0.01
    q = model.random_postures(500, np.random.default_rng(1))
    true = model.J_cad(q)
    size = np.sqrt(np.einsum("mii->mi", true))
    off = np.abs(model.J(q, fit.alpha) - true) / size[:, :, None] / size[:, None, :]
    assert off.max() < 4 * achieved


@pytest.fixture(scope="module")
def fine(planned: tuple[Model, Robot, list[tuple[str, np.ndarray]]]) -> Precision:
    return for_target(*planned, 2e-4)


@pytest.mark.bench
def test_no_other_spacing_is_quicker(
    planned: tuple[Model, Robot, list[tuple[str, np.ndarray]]], fine: Precision, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither the widest lines nor the narrowest: all of them searched to their ends, one by one."""
    model, robot, cells = planned
    seconds = {}
    monkeypatch.setattr("ident.identification.precision.SPACINGS", ())
    for f0 in SPACINGS:
        alone = replace(robot, experiment=replace(robot.experiment, f0=f0, band=(f0, robot.experiment.band[1])))
        with contextlib.suppress(ExperimentError):
            seconds[f0] = for_target(model, alone, cells, 2e-4).seconds
    assert fine.seconds == min(seconds.values()) == seconds[fine.robot.experiment.f0]
    assert 0.1 < fine.robot.experiment.f0 < 2.0


@pytest.mark.bench
def test_precision_costs_time(planned: tuple[Model, Robot, list[tuple[str, np.ndarray]]], fine: Precision) -> None:
    model, robot, cells = planned
    rough, finer = (for_target(model, robot, cells, target) for target in (1e-2, 1e-4))
    assert rough.shortest and "the least that settles" in rough.text and not finer.shortest
    for found, target in ((rough, 1e-2), (fine, 2e-4), (finer, 1e-4)):
        assert found.sigma <= target and len(found.periods) == len(cells)
    assert rough.seconds < fine.seconds < finer.seconds < 8 * fine.seconds  # four times the records, settling apart
    assert rough.robot.experiment.f0 > finer.robot.experiment.f0


@pytest.mark.bench
def test_out_of_reach_is_said(planned: tuple[Model, Robot, list[tuple[str, np.ndarray]]]) -> None:
    model, robot, cells = planned
    with pytest.raises(ExperimentError, match=r"target 0\.0001 %: J_\d\d stays at .* % after \d+ periods"):
        for_target(model, robot, cells, 1e-6)
    said = r"^target 1 %: the records hold no information on J_\d\d, however long they are; expected more postures$"
    with pytest.raises(ExperimentError, match=said):
        for_target(model, robot, cells[:1], 0.01)
    with pytest.raises(
        ExperimentError, match=r"more postures, or the other joints held by their motors \(--lock dob\)"
    ):
        for_target(model, robot, cells[:1], 0.01, lock="rigid")


def test_the_declared_spacing_is_tried_whatever_its_digits(
    planned: tuple[Model, Robot, list[tuple[str, np.ndarray]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What robot.toml may have: whole up to a few roundings of a thousand samples."""
    model, robot, cells = planned
    e = replace(robot.experiment, fs=333.3333333333, f0=0.33333333333)
    assert abs(e.fs / e.f0 - 1000) > 1e-9 and recordable(e.fs, e.f0)
    found = for_target(model, replace(robot, experiment=e), cells, 0.05)
    assert found.robot.experiment.f0 == e.f0 and found.sigma <= 0.05
    monkeypatch.setattr("ident.identification.precision.SPACINGS", (2.0,))  # which no such record can have
    assert for_target(model, replace(robot, experiment=e), cells, 0.05) == replace(found, robot=ANY)


def test_no_record_is_longer_than_one_may_be(
    planned: tuple[Model, Robot, list[tuple[str, np.ndarray]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    model, robot, cells = planned
    monkeypatch.setattr("ident.identification.precision.SPACINGS", ())
    coarse = replace(robot, experiment=replace(robot.experiment, f0=1.0, band=(1.0, 120.0)))
    longest = max(for_target(model, coarse, cells, 2e-4).periods)
    monkeypatch.setattr(
        "ident.identification.precision.recordable",
        lambda fs, f0, periods=1: recordable(fs, f0, periods) and periods < longest,
    )
    said = r"J_\d\d stays at .* expected a larger target \(a record has at most 1e\+07 samples\), lines further apart"
    with pytest.raises(ExperimentError, match=said):
        for_target(model, coarse, cells, 2e-4)


def test_realisations_share_what_is_to_be_told(planned: tuple[Model, Robot, list[tuple[str, np.ndarray]]]) -> None:
    """Two of each cell tell what one of twice the settled periods tells, and settle twice."""
    model, robot, cells = planned
    one, two = (for_target(model, robot, cells, 1e-2, realisations=M) for M in (1, 2))
    assert len(two.periods) == 2 * len(cells) and two.periods[::2] == two.periods[1::2]
    assert two.seconds == seconds(two) > one.seconds and two.sigma <= 1e-2
    assert f"from {2 * len(cells)} records of" in two.text
