"""What a diagnosis shows is what was put into the simulated arm."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise
from math import inf

import numpy as np
import pytest
from diagnosed import JOINT, LEVEL, REPORT, diagnosis, errors

from ident.arm.parts import lines_of
from ident.effects.learned import learned
from ident.effects.motor import InputDelay, TorqueLag
from ident.effects.sensor import TimeOffset
from ident.effects.structure import AttachedResonator
from ident.loop.held_out import _largest, carried, gains, heights, held_out, reconstructed, with_few_lines, without
from ident.search import departures
from ident.search.refits import Bench


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


def test_a_record_that_the_errors_leave_out_is_not_held_out(monkeypatch):
    """Its noise is no share of the floor."""
    monkeypatch.setattr("ident.loop.held_out.told_of", lambda split, state, data: data[1:])
    assert [row.record for row in held_out(diagnosis())] == [*REPORT][1:]


def test_the_reconstructed_force_is_the_friction_that_was_put_in():
    d = diagnosis()
    force, *others = reconstructed(d, d.added[0].effect, most=5)
    assert {one.record for one in others} and all(d.campaign.records[one.record].excited == "joint2" for one in others)
    assert d.campaign.records[force.record].excited == "joint2" and (force.port, force.joint) == ("motor", JOINT)
    moving = np.abs(force.velocity) > 0.3 * np.abs(force.velocity).max()
    sliding = -LEVEL * np.sign(force.velocity[moving])
    # the band ends at 100 Hz and cuts the corners: an eighth of the level between them (Gibbs is 9 % each side)
    assert np.sqrt(np.mean((force.found[moving] - sliding) ** 2)) < 0.25 * LEVEL
    assert abs(np.mean(force.found[moving] / sliding) - 1.0) < 0.05
    assert np.corrcoef(force.found, force.law)[0, 1] > 0.9


def test_what_has_no_force_of_its_own_is_drawn_by_what_it_explains():
    """A lag changes the torque of a motor: what the records want there, by as many samples as the motion it is drawn against."""
    d, lag = diagnosis(), TorqueLag(JOINT, (1e-3,))
    problem = replace(d.end.problem, effects=(lag,))
    (force,) = reconstructed(replace(d, end=replace(d.end, effects=(lag,), problem=problem)), lag)
    assert np.std(force.found) > 0.1 * LEVEL
    assert force.found.shape == force.law.shape == force.position.shape == force.velocity.shape == force.torque.shape


def test_an_effect_without_a_port_has_no_force():
    d = diagnosis()
    assert reconstructed(d, TorqueLag(None, (1e-3,))) == ()
    assert reconstructed(d, AttachedResonator(JOINT, (0.1, 20.0, 2e-4))) == ()


def test_a_force_is_that_of_all_lines_where_the_parts_are_of_lines():
    d = diagnosis()
    (whole,) = reconstructed(d, d.added[0].effect)
    half = tuple(lines_of(one, np.arange(len(one.use)) % 2 == 0) for one in d.end.problem.data)
    by_lines = replace(d, end=replace(d.end, problem=replace(d.end.problem, data=half)))
    (force,) = reconstructed(by_lines, d.added[0].effect)
    assert force.record == whole.record and np.allclose(force.found, whole.found, rtol=1e-9, atol=1e-9 * LEVEL)


@pytest.mark.parametrize(("kind", "port"), [(InputDelay, "motor"), (TimeOffset, "sensor")])
def test_what_comes_late_turns_the_phase_by_its_delay(kind, port):
    """A record without the delay, held against a model that has it: what is measured is a gain of one."""
    d, late = diagnosis(), kind(JOINT, (1e-3,))
    friction = d.added[0].effect
    problem = replace(
        d.end.problem, effects=(friction, late), scale=np.append(d.end.problem.scale, 1e-3),
        low=np.append(d.end.problem.low, -1.0), high=np.append(d.end.problem.high, 1.0),
        free=np.append(d.end.problem.free, True),
    )  # fmt: skip
    minimum = replace(d.end.minimum, vector=np.append(d.end.minimum.vector, 1e-3))
    found = gains(replace(d, end=replace(d.end, effects=(friction, late), problem=problem, minimum=minimum)), late)
    assert found is not None and {d.campaign.records[k].excited for k in found.records} == {"joint2"}
    assert np.allclose(found.law, np.exp(-2j * np.pi * found.f * 1e-3), rtol=1e-9) and late.port == port
    assert np.median(np.abs(found.measured - 1.0)) < 0.01
    assert gains(d, friction) is None


def test_the_records_want_a_learned_curve_where_the_friction_is():
    """As high as the friction, on both sides of standstill."""
    d = diagnosis()
    curve = learned("motor", "sliding", [-50.0, 0.0, 50.0])(JOINT, (LEVEL,) * 3)
    x, y = heights(curve, reconstructed(d, d.added[0].effect, most=5))
    fast = np.abs(x) > 0.3 * np.abs(x).max()
    assert (
        abs(np.median(y[fast & (x > 0)]) / LEVEL - 1.0) < 0.1 and abs(np.median(y[fast & (x < 0)]) / LEVEL - 1.0) < 0.1
    )


def test_lines_that_are_not_neighbours_are_apart():
    d = diagnosis()
    (row,) = held_out(d)
    assert not row.apart.any()
    blocks = lines_of(d.split.report[0], np.cumsum(d.split.report[0].is_excited) // 3 % 2 == 0)
    (row,) = held_out(replace(d, split=replace(d.split, report=(blocks,))))
    every = held_out(d)[0].f
    between = [bool(((every > low) & (every < high)).any()) for low, high in pairwise(row.f)]
    assert row.apart.tolist() == [False, *between] and sum(between) > 5


def test_joints_and_bands_of_few_lines_are_named():
    d = diagnosis()
    assert "joint2" not in with_few_lines(d) and "1-3 Hz" in with_few_lines(d) and "30-100 Hz" not in with_few_lines(d)


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


def test_what_an_effect_makes_worse_leaves_the_shares_of_others_below_all():
    """A band where the effect does harm is not told, and the others are shares of what misses it."""
    assert _largest({"a": 3.0, "b": 1.0, "c": -2.0, "d": 0.01}) == {
        "a": pytest.approx(3 / 4.01),
        "b": pytest.approx(1 / 4.01),
    }


def test_lines_above_the_last_edge_carry_the_effect_too(monkeypatch):
    monkeypatch.setattr("ident.search.departures.EDGES", (0.0, 5.0, inf))
    _, bands = carried(diagnosis(), diagnosis().added[0].effect)
    assert bands["above 5 Hz"] > 0.0 and sum(bands.values()) <= 1.0 + 1e-9
