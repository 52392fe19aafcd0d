"""What an earlier diagnosis ended with is what the next one starts from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnosed import diagnosis

from ident.arm.coupled import declared_start, problem_of
from ident.arm.evidence import evidence, gravity_basis
from ident.errors import IdentError
from ident.loop.baseline import declared_by
from ident.search.deviations import _as_told, deviations
from symgen.plan import model_of_urdf


def test_the_arm_that_was_found_is_the_one_declared():
    d = diagnosis()
    p = d.end.problem.parameters(d.end.minimum.vector)
    campaign, notes = declared_by(d, d.campaign)
    assert np.array_equal(campaign.K, p.K) and np.array_equal(campaign.D_spring, p.D_spring)
    assert campaign.records is d.campaign.records
    model = model_of_urdf(campaign.urdf, campaign.joints, believe_zeros=True)
    # links 2 and 3 are known to 1e-4; joint 1 was seen at one posture: what it lacks is what rigid bodies have
    known = [model.names.index(name) for name in ("alpha_31", "alpha_21", "alpha_22")]
    assert np.allclose(model.alpha_cad[known], p.alpha[known], rtol=2e-3)
    assert len(notes) == 2 and "motor-coulomb at joint2" in notes[1]


def test_another_robot_is_no_baseline():
    d = diagnosis()
    with pytest.raises(IdentError, match="another robot"):
        declared_by(d, replace(d.campaign, urdf=d.campaign.urdf + " "))


@pytest.mark.parametrize(("what", "change"), [("gears", {"N": np.ones(3)}), ("gravity", {"gravity": np.zeros(3)})])
def test_a_baseline_has_the_same_gears_and_gravity(what, change):
    d = diagnosis()
    with pytest.raises(IdentError, match=f"another robot: its {what} differ"):
        declared_by(d, replace(d.campaign, **change))


@pytest.mark.parametrize("believe_zeros", [True, False])
@pytest.mark.parametrize("known", [False, True])
def test_what_the_baseline_left_open_contradicts_nothing(known, believe_zeros):
    d = diagnosis()
    campaign, _ = declared_by(d, d.campaign)
    model = model_of_urdf(campaign.urdf, campaign.joints, believe_zeros=believe_zeros)
    basis = gravity_basis(model, campaign.gravity)
    data = tuple(evidence(campaign, model, basis, frf, k, "every") for k, frf in enumerate(d.responses))
    start = declared_start(campaign, model, d.responses, basis)
    problem = problem_of(campaign, model, basis, data, start, d.end.effects, [1e-3], [(0.0, 1.0)])
    vector = np.concatenate([start.vector(), d.end.minimum.vector[d.end.problem.base :]])
    places = 4 * problem.n
    told, doubt = _as_told(campaign.earlier, np.vstack([model.factoring.W, basis]), places)
    # another time the same, but for what joint 1, seen at one posture, is made of; or for what joint 3 is
    open_ = np.linalg.eigh(doubt[places:, places:])[1][:, -1] * 0.05
    changed = 0.05 * told * (np.arange(len(told)) == model.names.index("alpha_31"))
    vector[places : problem.base] = told + (changed if known else open_)
    found = replace(d.end.minimum, vector=vector, information=np.eye(len(vector)) * 1e12)
    assert bool(deviations(campaign, model, basis, problem, found)) == known
    if not known:  # as though the baseline were sure
        assert deviations(replace(campaign, earlier=None), model, basis, problem, found)
