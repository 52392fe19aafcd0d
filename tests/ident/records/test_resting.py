"""What is doubtful of where records rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from test_faults import clean

from ident.records.frf import estimate
from ident.records.resting import statuses


def test_a_zero_that_is_off_in_all_records_is_told_once() -> None:
    campaign = clean("ypp3")
    shifted = replace(
        campaign, records=tuple(replace(r, theta=r.theta + np.array([0.0, 0.0, 0.004 * 100])) for r in campaign.records)
    )
    lines = statuses(shifted.joints, [estimate(r, shifted) for r in shifted.records])
    assert [line.split(":")[0] for line in lines] == ["joint3 rests +0.004 from its declared posture in all records"]
    assert statuses(campaign.joints, [estimate(r, campaign) for r in campaign.records]) == []
    few = [estimate(r, shifted) for r in shifted.records[:2]]
    assert statuses(shifted.joints, few) == []
