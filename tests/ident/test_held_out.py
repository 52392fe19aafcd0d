"""What a diagnosis shows is what was put into the simulated arm."""

from __future__ import annotations

from dataclasses import fields, replace
from math import inf

import numpy as np
import pytest
from diagnosed import JOINT, LEVEL, REPORT, diagnosis, errors

from ident import departures
from ident.effects.declared import ChangeBetweenRecords
from ident.effects.motor import TorqueLag
from ident.effects.structure import AttachedResonator
from ident.held_out import carried, held_out, reconstructed, without
from ident.refits import Bench


def test_held_out_rows_are_the_excited_joint_of_the_reporting_records():
    d = diagnosis()
    (row,) = held_out(d)
    record = d.campaign.records[REPORT[0]]
    assert row.record == REPORT[0] and d.campaign.joints[row.joint] == record.excited
    assert np.array_equal(row.f, record.lines * record.f0)
    frf = d.responses[REPORT[0]]
    assert np.allclose(row.theta, frf.theta[:, frf.index], rtol=1e-12)
    # the model with friction leaves a tenth at most of what the one without it leaves: friction is most of the misfit
    assert np.linalg.norm(row.after) < 0.1 * np.linalg.norm(row.before)


def test_an_error_of_noise_alone_is_as_large_as_the_noise_says():
    """Joint 1 has no friction and turns alone: what the fit leaves of its 50 lines is noise, its square known to 15 %."""
    d = diagnosis()
    (row,) = held_out(replace(d, split=replace(d.split, report=d.split.fit[:1])))
    assert d.campaign.joints[row.joint] == "joint1"
    assert 0.6 < np.mean(np.abs(row.after / row.noise) ** 2) < 1.5


def test_errors_and_noise_are_those_of_their_definition():
    d = diagnosis()
    bench = Bench(d.campaign, d.model, np.zeros(0), d.split, d.end.problem.parameters(d.end.minimum.vector), 1)
    found, told = departures.errors(bench, d.end, d.split.report), errors(d, "after")
    for field in fields(told):
        assert getattr(found, field.name) == pytest.approx(getattr(told, field.name), rel=1e-9)
    assert set(found.noise_per_band) == set(found.per_band) and found.noise_per_joint == {"joint2": found.noise}


def test_a_record_that_the_errors_leave_out_is_not_held_out():
    """Nobody saw whether the fourth record was before the change that the fifth one shows: its noise is no share of the floor."""
    d = diagnosis()
    unseen = replace(d.split, fit=d.split.fit[:3], report=(d.split.fit[3], *d.split.report))
    change = ChangeBetweenRecords(JOINT, (5.0, 0.2, 0.0, 0.0))
    told = held_out(replace(d, split=unseen, end=replace(d.end, effects=(*d.end.effects, change))))
    assert [row.record for row in told] == [*REPORT]
    assert [row.record for row in held_out(replace(d, split=unseen))] == [3, *REPORT]


def test_the_reconstructed_force_is_the_friction_that_was_put_in():
    d = diagnosis()
    force = reconstructed(d, d.added[0].effect)
    assert force is not None
    assert d.campaign.records[force.record].excited == "joint2" and (force.port, force.joint) == ("motor", JOINT)
    moving = np.abs(force.velocity) > 0.3 * np.abs(force.velocity).max()
    sliding = -LEVEL * np.sign(force.velocity[moving])
    # the band ends at 100 Hz and cuts the corners: an eighth of the level between them (Gibbs is 9 % each side)
    assert np.sqrt(np.mean((force.found[moving] - sliding) ** 2)) < 0.25 * LEVEL
    assert abs(np.mean(force.found[moving] / sliding) - 1.0) < 0.05
    assert np.corrcoef(force.found, force.law)[0, 1] > 0.9
    assert 0.8 < force.share < 1.1


def test_what_has_no_force_of_its_own_is_drawn_by_what_it_explains():
    """A lag changes the torque of a motor: what the records want there, by as many samples as the motion it is drawn against."""
    d, lag = diagnosis(), TorqueLag(JOINT, (1e-3,))
    problem = replace(d.end.problem, effects=(lag,))
    force = reconstructed(replace(d, end=replace(d.end, effects=(lag,), problem=problem)), lag)
    assert force is not None and np.std(force.found) > 0.1 * LEVEL
    assert force.found.shape == force.law.shape == force.position.shape == force.velocity.shape == force.torque.shape


def test_an_effect_without_a_port_has_no_force():
    d = diagnosis()
    assert reconstructed(d, TorqueLag(None, (1e-3,))) is None
    assert reconstructed(d, AttachedResonator(JOINT, (0.1, 20.0, 2e-4))) is None


def test_without_leaves_the_elastic_arm():
    d = diagnosis()
    problem, vector = without(d.end, d.added[0].effect)
    assert problem.effects == () and len(vector) == problem.base == len(problem.scale) == len(problem.free)
    assert np.array_equal(vector, d.end.minimum.vector[: problem.base])


def test_the_records_that_choose_carry_the_effect():
    d = diagnosis()
    records, bands = carried(d, d.added[0].effect)
    assert list(records) == ["0005"] and records["0005"] == 1.0
    assert 0.97 < sum(bands.values()) <= 1.0 + 1e-9  # parts below a hundredth are not told
    assert list(bands.values()) == sorted(bands.values(), reverse=True)


def test_lines_above_the_last_edge_carry_the_effect_too(monkeypatch):
    monkeypatch.setattr("ident.departures.EDGES", (0.0, 5.0, inf))
    _, bands = carried(diagnosis(), diagnosis().added[0].effect)
    assert set(bands) == {"0-5 Hz", "above 5 Hz"} and abs(sum(bands.values()) - 1.0) < 1e-9
