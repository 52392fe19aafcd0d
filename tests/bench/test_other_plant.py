"""Diagnoses of records that another simulated arm made: what they find is not how the project's own one is built."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from other_plant import Undeclared, simulate
from study import planned

from ident.loop.either_model import diagnose_either
from symgen.robot import load_robot

pytestmark = pytest.mark.bench
ROBOTS = Path(__file__).parents[2] / "robots"
ROBOT = load_robot(ROBOTS / "ypp3")
#: Times the noise that is left at most where something was found, and names that are told for a law.
NEAR = 1.35


def rubs(level: float, creep: float) -> Callable[[float], float]:
    return lambda speed: -level * float(np.tanh(speed / creep))


@pytest.mark.parametrize(
    ("effect", "name"),
    [
        pytest.param(None, "", id="nothing"),
        pytest.param(Undeclared("motor", 1, lambda at: rubs(0.01, 0.02)(at.omega)), "motor-coulomb", id="a motor that rubs"),
        pytest.param(Undeclared("motor", 2, lambda at: rubs(0.003, 0.02)(at.omega)), "motor-coulomb", id="the last motor rubs"),
        pytest.param(Undeclared("motor", 0, lambda at: rubs(0.01, 0.02)(at.omega)), "motor-coulomb", id="the first motor rubs"),
        pytest.param(Undeclared("link", 0, lambda at: rubs(0.3, 2e-4)(at.rate)), "link-coulomb", id="a link that rubs"),
        pytest.param(Undeclared("link", 1, lambda at: -3.0 * at.rate), "link-viscous", id="a bearing with grease"),
        pytest.param(Undeclared("spring", 0, lambda at: 1e8 * at.deflection**3), "spring-hardening", id="a spring that hardens"),
        pytest.param(Undeclared("motor", 0, lambda at: -2e-5 * at.omega**3), "unknown", id="drag of the cube"),
        pytest.param(Undeclared("spring", 0, lambda at: 550.0 * max(at.deflection, 0.0)), "unknown", id="a spring stiffer one way"),
        pytest.param(Undeclared("link", 2, lambda at: -0.2 * float(np.tanh(at.rate / 0.05))), "unknown", id="a brake that saturates"),
        pytest.param(Undeclared("link", 2, lambda at: 0.2 * float(np.sin(90.0 * at.q))), "unknown", id="magnets of a link"),
    ],
)  # fmt: skip
def test_what_another_plant_lacks_is_found(effect: Undeclared | None, name: str) -> None:
    found, _ = diagnose_either(simulate(ROBOT, planned(ROBOT), effect, seed=11), workers=2)
    told = [(one.effect.name, one.effect.joint) for one in found.added]
    assert told == ([] if effect is None else [(name, effect.joint)])
    assert found.after.all < NEAR * found.after.noise
    assert found.status == ("explained" if effect is None else "effect-found")


@pytest.mark.parametrize(
    ("effect", "name"),
    [
        pytest.param(Undeclared("motor", 1, lambda at: rubs(0.03, 0.02)(at.omega)), "motor-coulomb", id="a motor that rubs"),
        pytest.param(Undeclared("motor", 1, lambda at: rubs(0.15, 0.02)(at.omega)), "motor-coulomb", id="a motor that sticks"),
        pytest.param(Undeclared("spring", 0, lambda at: 5e8 * at.deflection**3), "spring-hardening", id="a spring that hardens"),
    ],
)  # fmt: skip
def test_what_another_plant_of_six_joints_lacks_is_found_in_time(effect: Undeclared, name: str) -> None:
    robot = load_robot(ROBOTS / "arm6")
    campaign = simulate(robot, planned(robot), effect, seed=12)
    begun = time.monotonic()
    found, _ = diagnose_either(campaign, workers=2)
    assert [(one.effect.name, one.effect.joint) for one in found.added] == [(name, effect.joint)]
    assert found.after.all < NEAR * found.after.noise
    assert time.monotonic() - begun < 180.0
