"""The simulated arm with several effects is the one that the fit has; what no arm can have is refused in one line."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from levels import levels

from ident.effects.base import Effect
from ident.effects.catalogue import parse
from ident.effects.declared import ChangeBetweenRecords, InertialParameters, MotorInertia, Payload
from ident.effects.friction import LoadDependentFriction
from ident.effects.spring import Backlash, SpringHardening, SpringRelaxation
from ident.effects.structure import AttachedResonator, LinkFlexibility
from ident.errors import ExperimentError, IdentError
from ident.simulator.injection import Injected, inject
from symgen.robot import load_robot
from symgen.urdf import load_chain

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
YPP = load_chain(ROBOT.urdf)
POSTURE = (0.0, 0.4, 0.8)


def arm(*effects: Effect) -> Injected:
    """In its second record."""
    return inject(YPP, ROBOT.drives, ROBOT.gravity, POSTURE, effects, record=1)


@pytest.mark.parametrize(
    "besides", [Backlash(1, (1e-3,)), SpringHardening(1, (3e7,)), SpringRelaxation(1, (450.0, 0.02))], ids=lambda e: e.name
)  # fmt: skip
def test_friction_by_load_is_of_the_same_load_in_the_simulation_and_in_the_fit(besides: Effect) -> None:
    """Of K and damping alone it leaves 30 times the noise beside play, 19 beside a spring that hardens."""
    friction = LoadDependentFriction(1, (0.02,))
    assert levels(besides, "joint2", POSTURE, friction, f0=2.0, fs=500.0)[1] < 1.1


def test_a_spring_carries_at_rest_what_hangs_on_it_whatever_its_law() -> None:
    plain, played = arm().states[1], arm(Backlash(1, (1e-3,))).states[1]
    assert played.deflection == pytest.approx(plain.deflection + 5e-4 * np.sign(plain.deflection))
    assert played.spring == pytest.approx(plain.spring, rel=1e-12)


@pytest.mark.parametrize(
    "effects",
    [
        (AttachedResonator(1, (0.02, 40.0, 2e-4)), LinkFlexibility(1, (15000.0, 0.5, 2e-4, 0.0))),
        (ChangeBetweenRecords(1, (2.0, -0.1, 0.2, 0.3)), MotorInertia(1, (1e-5,))),
        (Payload(None, (0.5, 0.2)), InertialParameters(2, (0.3, 0.0))),
        (LinkFlexibility(1, (15000.0, 0.5, 2e-4, 0.0)), LinkFlexibility(1, (9000.0, 0.3, 2e-4, 1.0))),
    ],
    ids=lambda effects: " and ".join(effect.name for effect in effects),
)
def test_a_machine_does_not_depend_on_the_order_of_its_effects(effects: tuple[Effect, ...]) -> None:
    one, other = (arm(*order).generator() for order in permutations(effects))
    assert np.array_equal(one, other)


def test_a_disc_is_on_the_part_of_a_bending_link_that_the_joint_moves() -> None:
    """As the fit has it: on the far part it leaves 2100 times the noise."""
    disc, bends = AttachedResonator(1, (0.02, 40.0, 2e-4)), LinkFlexibility(1, (15000.0, 0.5, 2e-4, 0.0))
    assert levels(disc, "joint2", POSTURE, bends, f0=2.0, fs=500.0)[1] < 1.1


def test_a_motor_holds_what_it_can_however_much_that_is() -> None:
    plain, offset = arm(), arm(parse("torque-offset:offset=1.5@joint2", ROBOT.drives))
    assert offset.plant.preload == pytest.approx(plain.plant.preload - [0.0, 1.5, 0.0], rel=1e-9)
    with pytest.raises(ExperimentError, match="'joint2' finds no rest .* up to its limit of 2 N m"):
        arm(parse("torque-offset:offset=9@joint2", ROBOT.drives))


@pytest.mark.parametrize(
    "text",
    [
        "motor-hysteresis:level=0.1,distance=0@joint2", "motor-stribeck:level=0.1,peak=0.1,speed=0@joint2", "base-compliance:turn=0",
        "base-compliance:rock=0", "link-flexibility:stiffness=0@joint2", "locked-joint-elasticity:stiffness=0@joint2",
    ],
)  # fmt: skip
def test_a_shape_of_no_size_is_refused(text: str) -> None:
    with pytest.raises(IdentError, match="= 0; expected more than 0"):
        parse(text, ROBOT.drives)


@pytest.mark.parametrize(
    ("inertia", "would_be"), [(-ROBOT.drives[1].J_m, "0"), (-4.1e-5, "-1e-06"), (-1.0, "-1")], ids=str
)
def test_a_drive_that_none_can_be_is_refused_in_one_line(inertia: float, would_be: str) -> None:
    with pytest.raises(ExperimentError) as error:
        arm(MotorInertia(1, (inertia,)))
    assert str(error.value) == f"effect motor-inertia: J_m of joint 'joint2' would be {would_be}; expected > 0"
