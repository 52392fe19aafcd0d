"""What no record contradicts, as all numbers go with it: told where all joints, or all numbers of one, say the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_faults import clean, every_record

from ident.identification.identify import identify
from ident.records.campaign import Campaign
from ident.records.doubtful import doubts

NONE = [np.nan, np.nan, np.nan]


def told(K: list[float], J_m: list[float], J: list[float], N: list[float] | None = None) -> list[tuple[str, str]]:
    joints = [f"joint{k + 1}" for k in range(len(K))]
    return [(fault.name, fault.joint) for fault in doubts(joints, 1000.0, N or [100.0] * len(K), K, J_m, J)]


def test_drives_and_links_that_are_off_by_themselves_raise_no_doubt() -> None:
    rng = np.random.default_rng(0)
    for n in (1, 2, 3, 6, 7):
        K, J_m, J = (np.exp(rng.normal(0.0, s, (500, n))) for s in (0.1, 0.1, 0.2))
        alarms = sum(bool(told(*(x.tolist() for x in one))) for one in zip(K, J_m, J, strict=True))
        assert alarms <= 1, n
    assert not told([1.0] * 3, [2.0] * 3, [1.0, 1.1, 0.9])  # datasheets that leave out what is on the shaft
    assert not told(NONE, NONE, [4.0] * 3)
    assert not told([4.0] * 3, NONE, [1.0] * 3)
    assert not told([0.0, 1.0], [-1.0, 1.0], [np.nan, 1.0])


def test_what_all_joints_share_is_told_once() -> None:
    assert told([1.52, 1.49, 1.5], [1.5, 1.5, 1.51], [1.3, 1.6, 1.5]) == [("doubtful torque scale", "")]
    assert told([1.02, 0.98, 1.0], [4.0, 4.1, 3.9], [4.4, 3.6, 4.0]) == [("doubtful sampling rate", "")]
    assert told([0.7], [0.7], [0.7]) == [("doubtful torque scale", "")]
    assert told([1.2, 1.45, 1.6], [1.5, 1.3, 1.25], [1.3, 1.6, 1.5]) == [("doubtful torque scale", "")]
    assert told([0.8, 0.8], NONE[:2], NONE[:2]) == []


def test_what_one_joint_has_is_told_of_it() -> None:
    assert told([1.0, 3.0], [1.0, 3.1], [1.0, 2.9]) == [("doubtful torque scale", "joint2")]
    assert told([1.0, 3.0], [1.0, 1.1], [1.0, 2.9]) == [("doubtful gear ratio", "joint2")]
    assert told([1.0, 3.0], [1.0, np.nan], [1.0, 2.9]) == [("doubtful gear ratio", "joint2")]
    assert told([1.3], [1.0], [0.7]) == told([3.0], [1.0], [1.0]) == told([4.0], [1.0], [4.0], [1.0]) == []
    assert told([np.nan], [1.0], [4.0]) == []


@pytest.mark.parametrize(
    ("change", "name", "number"),
    [
        (lambda c: replace(c, fs=2000.0, records=tuple(replace(r, f0=2 * r.f0) for r in c.records)), "doubtful sampling rate", "Hz in place of 2000"),
        (lambda c: every_record(c, lambda r: replace(r, tau=1.356 * r.tau)), "doubtful torque scale", "at every joint"),
    ],
)  # fmt: skip
def test_a_wrong_clock_or_unit_of_all_joints_is_told(change: object, name: str, number: str) -> None:
    """J was 75 % or 36 % off, and the model explained the records."""
    campaign: Campaign = change(clean("ypp3", "rigid", wrong=True))  # type: ignore[operator]
    result = identify(campaign, method="two-mass", believe_zeros=True)
    assert [(fault.name, fault.joint) for fault in result.faults] == [(name, "")]
    assert number in result.faults[0].line
