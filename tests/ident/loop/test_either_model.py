"""Which constants a diagnosis has: general links where they explain the records, the URDF's zeros where that does it with fewer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from once import once

import ident.loop.either_model
from ident.effects.motor import InputDelay
from ident.loop.diagnose import begin
from ident.loop.either_model import MAYBE, diagnose_either
from ident.records.campaign import Campaign
from ident.search.refits import NAMED, reduced_chi2
from ident.simulator.bench import simulate
from symgen.plan import Model, chain_of_robot, make_model, plan_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=1.0, periods=3, fs=500.0))
#: For those that a stand-in diagnoses.
BRIEF = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=2.0, periods=3, fs=500.0))
#: The delay put in [s].
DELAY, JOINT = 3e-4, 1


@cache
def campaign(delay: float, times: int = 2) -> Campaign:
    """All cells of the plan so many times, so that the records determine general links, too."""
    cells = [(cell.joint, np.array(cell.q)) for cell in plan_of_robot(SHORT).cells] * times
    effects = [InputDelay(JOINT, (delay,))] if delay else []
    robot = SHORT if times > 1 else BRIEF
    return simulate(chain_of_robot(robot), robot, cells, effects=effects, workers=1, seed=5)


@pytest.fixture(autouse=True, scope="module")
def _read_once() -> Iterator[None]:
    """The records of a campaign are found sound, and their responses found, for all tests."""
    own = ident.loop.either_model
    with (
        once("ident.loop.either_model.refuse", own.refuse, lambda c, model: id(c)),
        once("ident.loop.either_model.estimate", own.estimate, lambda record, c: (id(c), record.id)),
    ):
        yield


@pytest.mark.bench  # e2e/test_diagnose has it of half as many records
def test_records_that_lack_nothing_leave_no_zeros_believed() -> None:
    found, notes = diagnose_either(campaign(0.0))
    assert found.status == "explained" and not found.model.factoring.believed and not notes


@pytest.mark.bench
def test_zeros_are_believed_where_an_effect_then_explains_the_records() -> None:
    found, notes = diagnose_either(campaign(DELAY))
    assert [(e.name, e.joint) for e in found.end.effects] == [("input-delay", JOINT)]
    assert found.model.factoring.believed
    assert len(notes) == 1 and "believed to be zero" in notes[0]


@pytest.mark.bench
def test_general_links_beside_what_was_found_leave_as_much() -> None:
    found, _ = diagnose_either(campaign(DELAY))
    general = begin(campaign(DELAY), make_model(chain_of_robot(SHORT)), found.responses)
    assert len(general.bench.model.alpha_cad) > len(found.model.alpha_cad)
    assert reduced_chi2(*general.beside(found.end, found.split)) == pytest.approx(found.left, rel=0.1)


class Left:
    """A diagnosis that leaves so much, and has so many declared numbers off."""

    status = "explained"

    def __init__(
        self, model: Model, left: float, values: int, off: int = 0, far: bool = True, name: str = "motor-inertia"
    ) -> None:
        self.model, self.left, self.split, self.added = model, left, None, [None] * bool(values)
        self.off = [SimpleNamespace(deviation=SimpleNamespace(name=name))] * off
        self.end = SimpleNamespace(effects=[SimpleNamespace(values=(0.0,) * values)] if values else [], far=far)


@pytest.fixture(autouse=True)
def _stand_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in of a model is what it leaves."""
    monkeypatch.setattr(
        ident.loop.either_model,
        "reduced_chi2",
        lambda bench, state: (
            state
            if isinstance(state, float)
            else state.left
            if isinstance(state, SimpleNamespace)
            else reduced_chi2(bench, state)
        ),
    )
    monkeypatch.setattr(ident.loop.either_model, "far_from_zero", lambda general, symmetric, end: end.far)


@dataclass(frozen=True)
class Parts:
    """A bench of which only the parts and the clock are asked for."""

    split: None
    late: bool


@pytest.mark.parametrize(
    ("believe", "by_zeros", "values", "beside", "by_general", "alone", "tried", "believed"),
    [
        (None, 1.0, 2, 9.0, 9.0, False, 1, True),  # explained: nothing else is tried
        (None, 5.0, 2, 2.0, 1.0, False, 2, False),  # zeros that are none
        (None, 5.0, 2, 4.9, 1.0, False, 1, True),  # as much with more constants
        (None, 5.0, 2, 2.0, 4.9, False, 2, True),
        (None, 1.0, 1, 1.0, 1.0, True, 2, True),  # one number in place of seven
        (None, 1.0, 9, 1.0, 1.0, True, 2, False),
        (None, 1.0, 0, 1.0, 1.0, True, 2, False),  # nothing is missing: nothing need be believed
        (True, 5.0, 2, 1.0, 1.0, False, 1, True),
        (False, 1.0, 2, 5.0, 5.0, False, 1, False),
    ],
)
def test_what_takes_fewer_numbers_is_taken(
    monkeypatch: pytest.MonkeyPatch,
    believe: bool | None,
    by_zeros: float,
    values: int,
    beside: float,
    by_general: float,
    alone: bool,
    tried: int,
    believed: bool,
) -> None:
    runs: list[bool] = []
    by_names: list[bool] = []

    def begun(campaign: Campaign, model: Model, *_: object) -> SimpleNamespace:
        def diagnosed(*_: object) -> Left:
            runs.append(bool(model.factoring.believed))
            return Left(model, by_zeros if model.factoring.believed else by_general, values)

        bench = SimpleNamespace(late=False)
        begins = SimpleNamespace(
            departs=not alone, alone=9.0, diagnosed=diagnosed, beside=lambda *_, **of: (None, beside), bench=bench
        )
        begins.by_names = lambda: by_names.append(True) or begins
        return begins

    monkeypatch.setattr(ident.loop.either_model, "begin", begun)
    found, notes = diagnose_either(campaign(0.0, 1), believe)
    assert bool(found.model.factoring.believed) == believed and len(runs) == tried
    assert by_names == [True] * alone, "what general links explain alone is searched for names only"
    assert bool(notes) == (believed and believe is None)


@pytest.mark.parametrize(
    ("name", "off", "searched"), [("payload", 1, False), ("payload", 2, True), ("inertial-parameters", 1, True)]
)
def test_where_all_that_is_off_of_the_links_is_a_load_no_names_are_looked_for(
    name: str, off: int, searched: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On UR5 names for what it does with the zeros believed took 230 of 319 CPU s."""
    asked: list[bool] = []

    def begun(campaign: Campaign, model: Model, *_: object) -> SimpleNamespace:
        def diagnosed(*_: object) -> Left:
            asked.append(bool(model.factoring.believed))
            return Left(model, 1.0, int(asked[-1]), off, name=name)

        begins = SimpleNamespace(departs=False, alone=1.0, diagnosed=diagnosed)
        begins.by_names = lambda: begins
        return begins

    monkeypatch.setattr(ident.loop.either_model, "begin", begun)
    diagnose_either(campaign(0.0, 1))
    assert asked == [False, True][: 1 + searched]


@pytest.mark.parametrize(
    ("by_zeros", "by_general", "far", "believed"),
    [(0, 1, True, True), (1, 1, True, False), (2, 3, True, True), (1, 1, False, True)],
)
def test_what_has_fewer_causes_is_taken(
    monkeypatch: pytest.MonkeyPatch, by_zeros: int, by_general: int, far: bool, believed: bool
) -> None:
    """One effect and so many numbers that are off, or these alone with more constants, if zeros are `far` from it."""

    def begun(campaign: Campaign, model: Model, *_: object) -> SimpleNamespace:
        zeros = bool(model.factoring.believed)
        found = Left(model, 1.0, int(zeros), by_zeros if zeros else by_general, far)
        begins = SimpleNamespace(departs=False, alone=1.0, diagnosed=lambda *_: found)
        begins.by_names = lambda: begins
        return begins

    monkeypatch.setattr(ident.loop.either_model, "begin", begun)
    assert bool(diagnose_either(campaign(0.0, 1))[0].model.factoring.believed) == believed


@pytest.mark.parametrize(
    ("effects", "beside", "by_general", "believed"),
    [(3, 1.0, 1, False), (3, 5.0, 1, True), (2, 1.0, 1, True), (3, 1.0, 4, True)],
)
def test_links_that_do_without_two_effects_are_taken(
    monkeypatch: pytest.MonkeyPatch, effects: int, beside: float, by_general: int, believed: bool
) -> None:
    """A body that is not symmetric looks like several effects of an arm that is."""

    def begun(campaign: Campaign, model: Model, *_: object) -> SimpleNamespace:
        def left(end: SimpleNamespace, split: None, fewer: int) -> tuple[None, float]:
            assert fewer == 2
            return None, beside

        found = Left(model, 1.0, 1)
        found.end.effects *= effects if model.factoring.believed else by_general
        return SimpleNamespace(departs=True, alone=9.0, diagnosed=lambda *_: found, beside=left)

    monkeypatch.setattr(ident.loop.either_model, "begin", begun)
    assert bool(diagnose_either(campaign(0.0, 1))[0].model.factoring.believed) == believed


@pytest.mark.parametrize(
    ("by_general", "by_zeros", "beside", "named", "order", "believed"),
    [
        (1.0, 1.0, 9.0, False, ["found"], False),  # links that are not symmetric beside an effect
        (1.0, 1.0, 1.0, False, ["found", "gone on"], True),  # the effect does without them
        (1.0, 1.0, 1.5, False, ["found", "believed"], True),  # it nearly does
        (1.0, 1.5, 2.5, False, ["found", "believed"], False),  # they explain, and the zeros believed do not
        (1.0, 1.0, 9.0, True, ["found", "gone on"], True),  # another in their place, as a zero that is off
        (5.0, 1.0, 9.0, False, ["found", "believed"], True),  # they leave something
    ],
)
def test_links_that_leave_far_less_without_effects_come_first(
    monkeypatch: pytest.MonkeyPatch,
    by_general: float,
    by_zeros: float,
    beside: float,
    named: bool,
    order: list[str],
    believed: bool,
) -> None:
    runs: list[str] = []

    def begun(campaign: Campaign, model: Model, *_: object) -> SimpleNamespace:
        zeros = bool(model.factoring.believed)

        def diagnosed(*_: object) -> Left:
            runs.append("believed" if zeros else "found")
            return Left(model, by_zeros if zeros else by_general, 1)

        def going_on(found: Left, split: None, left: float, missing: bool) -> Left:
            runs.append("gone on")
            assert zeros and found.left == by_general and left == beside and missing == named
            return Left(model, by_zeros, 1)

        bench = SimpleNamespace(late=False)
        return SimpleNamespace(
            departs=True,
            alone=90.0 if zeros else 9.0,
            diagnosed=diagnosed,
            going_on=going_on,
            beside=lambda *_, **of: (None, beside),
            bench=bench,
        )

    monkeypatch.setattr(ident.loop.either_model, "begin", begun)
    monkeypatch.setattr(ident.loop.either_model, "one_more", lambda bench, state: (state, named))
    found = diagnose_either(campaign(0.0, 1))[0]
    assert runs == order and bool(found.model.factoring.believed) == believed


@pytest.mark.parametrize(
    ("left", "beside", "named", "gives_way"),
    [(9.0, 1.0, False, True), (9.0, 5.0, False, False), (9.0, 1.0, True, False)],
)
def test_what_general_links_explain_far_better_and_no_name_is_theirs(
    monkeypatch: pytest.MonkeyPatch, left: float, beside: float, named: bool, gives_way: bool
) -> None:
    asked: list[bool] = []
    tried: list[float] = []

    def begun(campaign: Campaign, model: Model, *_: object) -> SimpleNamespace:
        def diagnosed(ask: object = None, *_: object) -> Left:
            if callable(ask):
                asked.extend(
                    ask(SimpleNamespace(effects=of, left=left), None) for of in ((), (), (InputDelay(JOINT, (DELAY,)),))
                )
            return Left(model, 1.0, 1)

        def beside_them(state: SimpleNamespace, split: None, most: float = 0.0) -> tuple[None, float]:
            if most:
                tried.append(most)
            return None, beside

        bench = Parts(None, False)
        return SimpleNamespace(departs=True, alone=9.0, diagnosed=diagnosed, beside=beside_them, bench=bench)

    monkeypatch.setattr(ident.loop.either_model, "begin", begun)
    monkeypatch.setattr(ident.loop.either_model, "one_more", lambda bench, state: (state, named))
    diagnose_either(campaign(0.0, 1))
    assert asked == [gives_way] * 3
    assert tried == [MAYBE * left] * (3 if gives_way else 2), "beside the same effects they are asked once"


@pytest.mark.parametrize(
    ("at_once", "late", "believed"), [(True, False, False), (False, False, True), (True, True, True)]
)
def test_links_that_explain_at_once_what_nothing_does_beside_zeros_are_taken(
    monkeypatch: pytest.MonkeyPatch, at_once: bool, late: bool, believed: bool
) -> None:
    """Friction beside a centre of mass that is off: neither is seen while the other is missing."""

    def begun(campaign: Campaign, model: Model, *_: object) -> SimpleNamespace:
        zeros = bool(model.factoring.believed)

        def diagnosed(gives_way: object = None, elsewhere: object = None) -> Left:
            if callable(elsewhere):
                assert zeros and elsewhere(False) == (at_once and not late) and not elsewhere(True)
                elsewhere(False)
            return Left(model, 9.0 if zeros else 1.0, int(not zeros))

        bench = SimpleNamespace(late=late)
        return SimpleNamespace(
            departs=True,
            alone=9.0,
            diagnosed=diagnosed,
            beside=lambda *_, **of: (None, 9.0),
            bench=bench,
            at_once=at_once,
        )

    monkeypatch.setattr(ident.loop.either_model, "begin", begun)
    assert bool(diagnose_either(campaign(0.0, 1))[0].model.factoring.believed) == believed


def test_what_general_links_explain_alone_gives_way_to_them_unless_one_name_more_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[bool, bool, bool]] = []
    named = False

    def begun(campaign: Campaign, model: Model, *_: object) -> SimpleNamespace:
        def diagnosed(ask: object = None, elsewhere: object = None) -> Left:
            if callable(ask) and callable(elsewhere):
                asked.append((ask(SimpleNamespace(effects=(), left=9.0), None), elsewhere(False), elsewhere(True)))
            return Left(model, 1.0, 1)

        begins = SimpleNamespace(departs=False, alone=1.0, diagnosed=diagnosed, bench=Parts(None, False))
        begins.by_names = lambda: begins
        return begins

    monkeypatch.setattr(ident.loop.either_model, "begin", begun)
    monkeypatch.setattr(ident.loop.either_model, "one_more", lambda bench, state: (state, named))
    diagnose_either(campaign(0.0, 1))
    named = True
    diagnose_either(campaign(0.0, 1))
    assert asked == [(True, True, True), (False, True, True)]


@pytest.mark.parametrize(
    ("status", "left", "says"), [("unexplained", 5.0, 1), ("effect-found", 1.2, 1), ("effect-found", 0.9, 0)]
)
def test_a_search_that_was_ended_says_so(status: str, left: float, says: int, monkeypatch: pytest.MonkeyPatch) -> None:
    ends: list[float] = []

    def begun(
        campaign: Campaign, model: Model, responses: object, workers: int, until: float, say: object
    ) -> SimpleNamespace:
        ends.append(until)
        found = Left(model, left, 1)
        found.status = status
        bench = SimpleNamespace(late=True)
        return SimpleNamespace(departs=True, alone=9.0, diagnosed=lambda *_: found, beside=None, bench=bench)

    monkeypatch.setattr(ident.loop.either_model, "begin", begun)
    _, notes = diagnose_either(campaign(0.0, 1), seconds=0.0)
    assert sum("ended after 0 s" in note for note in notes) == says and len(set(ends)) == 1
    assert any("more constants were not tried for want of time" in note for note in notes) == (left > NAMED)
    assert not any("ended" in note for note in diagnose_either(campaign(0.0, 1), True)[1])
