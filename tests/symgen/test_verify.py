"""The judge: passes what is right whatever the limits, and refuses what is wrong."""

from __future__ import annotations

from dataclasses import replace

import pytest
from arms import arm, factoring_of
from chains import own

from symgen.basis import factor
from symgen.errors import SymgenError
from symgen.verify import TOLERANCE, verify


@pytest.mark.parametrize("name", ["ypp3", "ur5", "panda"])
def test_a_right_factoring_passes(name: str) -> None:
    verdict = verify(factoring_of(name))
    assert verdict.ok and verdict.allowed == TOLERANCE
    assert verdict.as_written is not None and verdict.as_written < 1e-8


def test_limits_of_many_turns_cost_no_digits() -> None:
    """A sum of two angles of 1e5 rad has an error of 1e-11 rad."""
    chain = arm("ur5")
    far = replace(chain, joints=tuple(replace(joint, lower=-1e5) for joint in chain.joints))
    assert verify(factor(far)).error <= TOLERANCE


def test_what_was_dropped_is_allowed_and_no_more() -> None:
    found = factoring_of("ypp3")
    wrong = replace(found, W=found.W * (1 + 1e-9))
    with pytest.raises(SymgenError, match="differs from Pinocchio's by 1.0e-09 of its largest entry"):
        verify(wrong)
    assert verify(replace(wrong, cost=1e-9)).ok
    with pytest.raises(SymgenError, match="expected <= "):
        verify(replace(wrong, cost=1e-11))


def test_slides_are_judged_over_their_limits() -> None:
    assert verify(factor(own("scara4"))).ok
