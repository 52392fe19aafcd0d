"""The whole reading of a campaign on exact synthetic fits is in e2e; here what it does when records are few."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ident.errors import IdentError
from ident.identification import identify as module
from ident.identification.identify import identify
from ident.records.campaign import Campaign
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot
from symgen.robot import load_robot

ROBOT = Path(__file__).parents[3] / "robots" / "ypp3"
POS1, POS2, POS3 = (0.0, 0.0, 0.0), (0.0, 0.0, -np.pi / 2), (0.0, np.pi / 2, 0.0)


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    robot = load_robot(ROBOT)
    quick = replace(robot, experiment=replace(robot.experiment, f0=2.0, periods=3))
    cells = [("joint3", POS1), ("joint2", POS1), ("joint2", POS2), ("joint1", POS1), ("joint1", POS2), ("joint1", POS3)]
    return simulate(chain_of_robot(robot), quick, cells, lock="rigid", seed=5, workers=1)


def some(campaign: Campaign, *index: int) -> Campaign:
    return replace(campaign, records=tuple(campaign.records[k] for k in index))


def test_the_papers_six_cells_need_the_zeros_believed_and_say_so(campaign: Campaign) -> None:
    found = identify(campaign, method="two-mass")
    assert found.model.d == 6 and found.alpha.determined.all()
    assert "believed to be zero" in found.notes[0]
    np.testing.assert_allclose(found.alpha_all, found.model.alpha_cad, rtol=5e-3)
    general = identify(campaign, method="two-mass", believe_zeros=False)
    assert general.model.d == 9 and not general.alpha.determined.all()


@pytest.mark.parametrize("records", [(0,), (1,), (3, 4), (0, 1), (0, 1, 2)])
def test_few_records_keep_what_they_measured_and_cad_for_the_rest(campaign: Campaign, records: tuple[int, ...]) -> None:
    part = some(campaign, *records)
    found = identify(part, method="two-mass", believe_zeros=True)
    assert not found.alpha.determined.all()
    assert any(note.startswith("Not determined by these records: ") for note in found.notes)
    for measured in found.measurements:
        i = measured.index
        J = found.J(measured.record.posture)[i, i]
        assert J == pytest.approx(measured.J, abs=4 * measured.std)
    std = found.J_std(np.array(POS3))
    assert np.isinf(std[0, 0])


def test_the_methods_are_named_and_a_campaign_needs_records(campaign: Campaign) -> None:
    with pytest.raises(IdentError, match="coupled, modal, two-mass, three-point"):
        identify(campaign, method="guess")
    with pytest.raises(IdentError, match="no records"):
        identify(some(campaign))
    paper = identify(campaign, method="three-point")
    assert [m.J for m in paper.measurements] == [m.three_point.J_l for m in paper.measurements]
    assert module.METHODS == ("coupled", "modal", "two-mass", "three-point")
