"""A diagnosis begins with records as the arm was in them."""

from __future__ import annotations

import numpy as np
import pytest
import soft

from ident.loop.diagnose import diagnose


@pytest.mark.bench
def test_a_soft_arm_whose_postures_its_motors_tell_lacks_nothing() -> None:
    """Its links rest 0.09 rad from there: taken for another inertia."""
    c, model = soft.campaign()
    d = diagnose(soft.declared_by(c, np.array([c.K[0], np.inf])), model)
    assert d.status == "explained" and not d.end.effects
    assert not any("rests" in line for one in d.responses for line in one.status)
