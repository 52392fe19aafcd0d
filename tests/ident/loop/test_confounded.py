"""For every two effects there is an experiment that separates them, or it is said that there is none."""

from __future__ import annotations

from itertools import product

import pytest

from ident.effects.catalogue import CATALOGUE
from ident.loop.confounded import CHANGES, FAMILIES, NEVER, RECIPES, TABLE, UNPLAYED, never_told_apart, separation

NAMES = [*CATALOGUE, "unknown"]


@pytest.mark.parametrize("same_joint", [True, False])
def test_every_pair_has_a_way_in_one_line_whatever_the_order(same_joint):
    for a, b in product(NAMES, NAMES):
        found = separation(a, b, same_joint)
        assert found.recipe in RECIPES and found.separate_by and "\n" not in found.separate_by
        assert "{" not in found.separate_by
        assert separation(b, a, same_joint).recipe == found.recipe, (a, b)


def test_the_table_names_effects_that_there_are():
    assert {name for pair in TABLE for name in pair} <= set(CATALOGUE)
    members = [name for family in FAMILIES.values() for name in family]
    assert len(members) == len(set(members))
    assert set(CATALOGUE) - set(members) == set(CHANGES)


def test_friction_laws_differ_at_small_amplitudes_and_loads_at_postures():
    assert separation("motor-coulomb", "motor-stribeck").recipe == "amplitude"
    assert separation("motor-coulomb", "load-dependent-friction").recipe == "postures"
    assert separation("motor-coulomb", "motor-coulomb", same_joint=False).recipe == "others"
    assert separation("torque-scale", "payload").recipe == "mass"


@pytest.mark.parametrize("same_joint", [True, False])
@pytest.mark.parametrize(
    "name", ["change-between-records", "drift-over-records", "input-delay", "torque-lag", "time-offset"]
)
def test_an_effect_is_told_from_itself_elsewhere_by_exciting_the_other_joints(name: str, same_joint: bool) -> None:
    """Of the whole arm, or at another joint: the first records once more would show the same, whichever of them changed."""
    found = separation(name, name, same_joint)
    assert found.recipe == "others" and found.separate_by.startswith("excite the other joints, too")


def test_a_late_torque_of_a_joint_that_moves_no_other_is_a_late_angle():
    assert never_told_apart("input-delay", alone=True) == ("time-offset",)
    assert never_told_apart("time-offset", alone=False, only=True) == ("input-delay",)
    assert never_told_apart("input-delay", alone=False) == ()
    assert never_told_apart("payload", alone=True, only=True) == ("inertial-parameters",)
    assert never_told_apart("payload", alone=True) == ()
    assert NEVER.recipe in UNPLAYED and set(UNPLAYED) < set(RECIPES)


def test_no_plan_asks_for_an_encoder_that_nothing_reads() -> None:
    for a, b in product(NAMES, NAMES):
        found = separation(a, b)
        assert "encoder on the link" not in found.separate_by and found.recipe != "link-sensor", (a, b)
