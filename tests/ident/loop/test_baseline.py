"""What an earlier diagnosis ended with is what the next one starts from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnosed import diagnosis

from ident.errors import IdentError
from ident.loop.baseline import declared_by
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
