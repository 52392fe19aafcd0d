"""A response that changes while it is recorded is told from noise, and from all that leaks into lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import Arm, campaign, record

from ident.records.frf import estimate
from ident.records.steady import SURE, drift

JOINT = Arm.joint(J_m=4e-5, K=4500, J_l=0.6929, D=3e-5, D_spring=1.1, K_g=-8)
SOFT = [[0.002, 0.001]]
#: Records of each number of periods, and lines of one.
RECORDS, LINES = 15, np.arange(1, 121, 2)


def recorded(periods: int, seed: int = 0, **more: object):
    rng = np.random.default_rng(seed)
    return record(JOINT, 0, gains=SOFT, periods=periods, f0=0.5, lines=LINES, rng=rng, **more)


def growing(made, share: float, joint: int = 0):
    """The record, its angles larger by so much at the end than at the beginning, about where they are on the mean."""
    theta, mean = made.theta.copy(), made.theta[:, joint].mean()
    theta[:, joint] = mean + (theta[:, joint] - mean) * (1.0 + share * np.linspace(-0.5, 0.5, len(theta)))
    return replace(made, theta=theta)


@pytest.mark.parametrize("periods", [3, 6])
def test_noise_and_what_leaks_are_no_drift(periods: int) -> None:
    assert RECORDS * SURE < 1e-3
    for seed in range(RECORDS):
        made = recorded(periods, seed)
        ramp = np.linspace(0.0, 5.0 * np.ptp(made.theta), len(made.theta))[:, None]
        for one in (made, replace(made, theta=made.theta + ramp)):
            assert drift(one, 1, 0) == 0.0


def test_a_response_that_changes_is_told_with_its_size() -> None:
    for periods in (4, 6):
        made = recorded(periods)
        # the first period is left out: what is left of the change is that of the others
        expected = pytest.approx(0.3 * (periods - 1) / periods, rel=0.1)
        assert drift(growing(made, 0.3), 1, 0) == expected


def test_a_response_that_changes_is_a_status_of_its_record() -> None:
    made = recorded(6)
    assert not any("while it is recorded" in line for line in estimate(made, campaign(JOINT)).status)
    (line,) = [line for line in estimate(growing(made, 0.3), campaign(JOINT)).status if "while it is recorded" in line]
    assert f"the response of {made.excited} changes by 0.2" in line
