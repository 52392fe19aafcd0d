"""A tone that no motor makes bends the whole fit where it is in step with the periods: its line is left out, and said."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import diagnosed
import numpy as np
import pytest

from ident.arm.arm_fit import is_positive
from ident.arm.coupled import CoupledFit, fit_coupled
from ident.arm.evidence import evidence, gravity_basis
from ident.arm.lone_lines import ALONE, _times_others, lone_lines
from ident.arm.parts import degrees
from ident.loop.diagnose import Diagnosis, diagnose
from ident.records.campaign import Campaign, Record
from ident.records.frf import estimate
from ident.records.left_out import left_out, lines_left_out, silenced, without_lines
from ident.records.quantisation import encoder_step
from symgen.plan import Model, chain_of_robot, make_model
from symgen.robot import load_robot


@cache
def model() -> Model:
    return make_model(chain_of_robot(load_robot(diagnosed.ROOT / "robots/ypp3")), believe_zeros=True)


def few() -> Campaign:
    return replace(diagnosed.campaign(0.0), records=diagnosed.campaign(0.0).records[1::2])


def hums(campaign: Campaign, signal: str, frequency: float, share: float, records: int = 99) -> Campaign:
    """The same records, the first `records` with a tone in what was read of the torque or the angles of all joints, of any phase."""
    rng = np.random.default_rng(3)

    def hummed(record: Record) -> Record:
        read, own = getattr(record, signal), campaign.joints.index(record.excited)
        t = np.arange(len(read))[:, None] / campaign.fs
        tone = np.sin(2.0 * np.pi * frequency * t + rng.uniform(0.0, 2.0 * np.pi, campaign.n))
        tone *= share * np.std(read[:, own])
        humming = read + tone
        if signal == "theta":  # encoders count
            humming = np.round(humming / encoder_step(read)) * encoder_step(read)
        return replace(record, **{signal: humming})

    return replace(campaign, records=(*map(hummed, campaign.records[:records]), *campaign.records[records:]))


def fitted(campaign: Campaign) -> CoupledFit:
    return fit_coupled(campaign, model(), [estimate(record, campaign) for record in campaign.records])


def test_an_arm_is_fitted_without_the_line_of_a_tone() -> None:
    """Only that, though it bends the arm so that 13 Hz stands alone in two of the three records, too."""
    plain = few()
    campaign = hums(plain, "tau", 49.0, 0.1)
    fit, other = fitted(campaign), fitted(plain)
    assert fit.explained and not left_out(plain, other.responses)
    assert left_out(campaign, fit.responses)[0].startswith("Left out, in all records and all errors: 49 Hz.")
    for frf in fit.responses:
        J, without = (model().J(frf.posture, one.alpha)[frf.index, frf.index] for one in (fit, other))
        assert abs(J - without) < 1e-3 * without


@pytest.mark.bench
def test_a_diagnosis_has_nothing_to_find_in_a_tone() -> None:
    """Nor at an even line, where motors do nothing."""
    d = diagnose(hums(few(), "theta", 50.0, 0.001), model())
    assert d.status == "explained"
    assert left_out(d.campaign, d.responses)[0].startswith("Left out, in all records and all errors: 50 Hz.")


@pytest.mark.bench
def test_no_line_is_left_out_for_what_acts_in_the_arm() -> None:
    start = diagnosed.diagnosis().start
    assert start.select > 3.0 * degrees(diagnosed.diagnosis().split.select)
    assert not lone_lines(start.problem, start.minimum.vector).size


@pytest.mark.bench
def test_no_line_is_left_out_for_one_record() -> None:
    d = diagnosed.diagnosis()
    of_two, of_one = (lone(hums(d.campaign, "theta", 49.0, 0.01, records), d) for records in (2, 1))
    assert of_two == [49.0] and of_one == []


def lone(campaign: Campaign, d: Diagnosis) -> list[float]:
    """What stands alone in the first three records by an arm that explains the others."""
    basis, arm = gravity_basis(d.model, campaign.gravity), d.end
    data = [evidence(campaign, d.model, basis, estimate(campaign.records[k], campaign), k, "every") for k in range(3)]
    return lone_lines(replace(arm.problem, data=tuple(data)), arm.minimum.vector).tolist()


def test_a_line_stands_alone_above_both_beside_it_and_above_the_noise() -> None:
    left = np.ones(20)
    left[[4, 12, 13]] = 40.0, 500.0, 20.0
    assert np.flatnonzero(_times_others(left) > ALONE).tolist() == [4]
    assert not _times_others(np.array([0.0, 0.0, 1e3, 0.0])).any()  # of four lines none has two on either side
    assert (_times_others(0.05 * left) < ALONE).all()


def test_a_response_without_a_line_has_all_others() -> None:
    campaign = diagnosed.campaign(0.0)
    frf = estimate(campaign.records[0], campaign)
    less = without_lines(frf, np.array([49.0, 50.0, 5000.0]))
    use = frf.frequencies != 49.0
    np.testing.assert_array_equal(less.frequencies, frf.frequencies[use])
    np.testing.assert_array_equal(less.H, frf.H[use])
    np.testing.assert_array_equal(less.usable, frf.usable[use])
    assert frf.band is not None and less.band is not None
    assert set(frf.band.frequencies) - set(less.band.frequencies) == {49.0, 50.0}
    np.testing.assert_array_equal(less.band.theta[less.band.excited], less.theta)


def test_angles_are_silent_at_lines_that_are_left_out() -> None:
    campaign = hums(diagnosed.campaign(0.0), "theta", 50.0, 0.001)
    record = campaign.records[0]
    frf = without_lines(estimate(record, campaign), np.array([50.0]))
    assert lines_left_out(record, frf).tolist() == [50]
    kept = record.theta[-frf.periods * record.samples_per_period :]
    before, after = (np.fft.rfft(theta, axis=0) for theta in (kept, silenced(record, frf)))
    line = 50 * frf.periods
    assert np.abs(before[line]).min() > 1e3 * np.abs(after[line]).max()
    np.testing.assert_allclose(
        np.delete(after, line, axis=0), np.delete(before, line, axis=0), atol=1e-9 * np.abs(before).max()
    )


def test_an_inertia_matrix_that_rounding_alone_makes_positive_explains_nothing() -> None:
    assert is_positive(np.diag([1e-6, 10.0]))
    for scale in (1.0, 1e-9):
        assert not is_positive(scale * (np.ones((2, 2)) + 1e-16 * np.eye(2)))
