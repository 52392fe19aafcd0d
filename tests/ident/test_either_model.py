"""Which constants a diagnosis has: general links where they explain the records, the URDF's zeros where that does it with fewer."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import ident.either_model
from ident.bench import simulate
from ident.campaign import Campaign
from ident.effects.motor import InputDelay
from ident.either_model import diagnose_either
from symgen.plan import Model, chain_of_robot, plan_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[2] / "robots" / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=1.0, periods=4))
#: The delay put in [s].
DELAY, JOINT = 3e-4, 1


@cache
def campaign(delay: float) -> Campaign:
    """All cells of the plan, so that the records determine general links, too."""
    cells = [(cell.joint, np.array(cell.q)) for cell in plan_of_robot(SHORT).cells] * 2
    effects = [InputDelay(JOINT, (delay,))] if delay else []
    return simulate(chain_of_robot(SHORT), SHORT, cells, effects=effects, workers=1, seed=5)


def test_records_that_general_links_explain_leave_no_zeros_believed() -> None:
    found, notes = diagnose_either(campaign(0.0))
    assert found.status == "explained" and not found.model.factoring.believed and not notes


def test_zeros_are_believed_where_an_effect_then_explains_the_records() -> None:
    found, notes = diagnose_either(campaign(DELAY))
    assert [(e.name, e.joint) for e in found.end.effects] == [("input-delay", JOINT)]
    assert found.model.factoring.believed
    assert len(notes) == 1 and "believed to be zero" in notes[0]


class Left:
    """A diagnosis that leaves so much."""

    def __init__(self, model: Model, left: float) -> None:
        self.model, self.left = model, left


@pytest.mark.parametrize(
    ("believe", "by_zeros", "by_general", "tried", "believed"),
    [
        (None, 1.0, 9.0, 1, True),  # explained: nothing else is tried
        (None, 5.0, 1.0, 2, False),  # zeros that are none
        (None, 5.0, 4.9, 2, True),  # as much with more constants
        (True, 5.0, 1.0, 1, True),
        (False, 1.0, 5.0, 1, False),
    ],
)
def test_general_links_are_taken_where_they_leave_less(
    monkeypatch: pytest.MonkeyPatch,
    believe: bool | None,
    by_zeros: float,
    by_general: float,
    tried: int,
    believed: bool,
) -> None:
    runs: list[bool] = []

    def diagnose(campaign: Campaign, model: Model, **_: object) -> Left:
        runs.append(bool(model.factoring.believed))
        return Left(model, by_zeros if model.factoring.believed else by_general)

    monkeypatch.setattr(ident.either_model, "diagnose", diagnose)
    monkeypatch.setattr(ident.either_model, "departs_alone", lambda *_: True)
    found, notes = diagnose_either(campaign(0.0), believe)
    assert bool(found.model.factoring.believed) == believed and len(runs) == tried
    assert bool(notes) == (believed and believe is None)
