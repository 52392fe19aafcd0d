"""The loop on simulated records: nothing found where nothing is, the right name, joint and size where something is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import diagnosed as by_hand
import numpy as np
import pytest

import ident.loop.diagnose
import ident.search.rest
from ident.arm.arm_fit import hold
from ident.arm.coupled import declared_start
from ident.arm.evidence import evidence, gravity_basis
from ident.arm.parts import Split, split, split_lines, united
from ident.effects.base import Effect
from ident.effects.catalogue import CATALOGUE, parse
from ident.effects.friction import LinkViscous, MotorCoulomb
from ident.effects.hysteresis import MotorHysteresis
from ident.effects.learned import learned
from ident.effects.ringing import Ringing
from ident.effects.spring import Backlash
from ident.errors import IdentError
from ident.loop.diagnose import Begun, Diagnosis, _better, _loop, _resumed, begin, diagnose
from ident.records.campaign import Array, Campaign
from ident.records.frf import estimate
from ident.search.added import Added, renamed
from ident.search.candidates import catalogue, otherwise
from ident.search.departures import Band, Departure, groups
from ident.search.refits import HASTILY, Bench, Refit, State, fitted, linearised, reduced_chi2
from ident.search.rest import (
    _fits_alone,
    _hardly_chooses,
    is_little,
    is_of_another_port,
    is_of_one_joint,
    is_unseen,
    may_be_bent,
    share_left,
)
from ident.search.trace import linearise
from ident.simulator.bench import simulate
from symgen.plan import Model, chain_of_robot, make_model, plan_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=1.0, periods=3))
CELLS = [(cell.joint, np.array(cell.q)) for cell in plan_of_robot(SHORT).cells] * 2
LINK_VISCOUS = LinkViscous(1, (0.1,))
FAINT = "input-delay:time=3e-6@joint2"
#: A curve, whose heights mean nothing.
DRAWN = learned("motor", "velocity", [-1.0, 1.0])(0, (0.1, -0.1))


def _instead(monkeypatch: pytest.MonkeyPatch, stand_ins: dict[str, Any]) -> None:
    """Puts functions in the places of those that the loop and its judgement of what is left call."""
    for name, stand_in in stand_ins.items():
        for module in (ident.loop.diagnose, ident.search.rest):
            if hasattr(module, name):
                monkeypatch.setattr(module, name, stand_in)


@pytest.fixture(scope="module")
def model() -> Model:
    return make_model(chain_of_robot(ROBOT), believe_zeros=True)


@cache
def campaign(*effects: str, brief: bool = False) -> Campaign:
    robot = replace(SHORT, experiment=replace(SHORT.experiment, f0=2.0, fs=500.0)) if brief else SHORT
    chain = chain_of_robot(robot)
    drives = [robot.drive(name) for name in chain.names]
    return simulate(
        chain,
        robot,
        CELLS[: 12 if brief else 16],
        effects=[parse(text, drives) for text in effects],
        workers=1,
        seed=11,
    )


def diagnosed(model: Model, *effects: str) -> Diagnosis:
    return diagnose(campaign(*effects), model)


@pytest.mark.bench
def test_nothing_is_found_where_nothing_is(model: Model) -> None:
    found = diagnose(campaign(brief=True), model)
    assert (found.status, found.added, found.off, found.departures) == ("explained", (), (), ())
    assert found.after.all < 1.1 * found.after.noise
    kinds = [{one.index for one in part} for part in (found.split.fit, found.split.select, found.split.report)]
    assert all(kinds) and sum(map(len, kinds)) == len(set.union(*kinds)) == len(
        campaign(brief=True).records
    )  # they share no record
    lone = split(found.split.fit[:1], model)
    lines = [part[0].use for part in (lone.fit, lone.select, lone.report)]
    assert lone.note and np.all(np.sum(lines, axis=0) == 1)  # nor a line
    short = replace(found.split.fit[0], judged=np.cumsum(found.split.fit[0].is_excited) <= 8)
    with pytest.raises(IdentError, match="too few to fit by some"):
        split((short,), model)
    by_lines = split_lines(found.split.fit, "few")
    told = united(*by_lines.fit, *by_lines.select)
    assert len(told) == len(by_lines.fit)
    for one, kept in zip(told, by_lines.report, strict=True):
        assert np.all(one.use ^ kept.use)
    information = found.end.minimum.information
    assert np.linalg.slogdet(information)[1] > np.linalg.slogdet(fewer(found))[1]


@pytest.mark.bench
def test_an_effect_that_no_group_of_lines_shows_is_looked_for(model: Model) -> None:
    faint, clean = (begun(model, *effects) for effects in ((FAINT,), ()))
    parts = faint.bench.split
    assert reduced_chi2(faint.bench, faint.start) < 1.1 and not groups(faint.start, parts.fit + parts.select)
    assert faint.departs and not clean.departs


@pytest.mark.bench
def test_an_effect_that_no_group_of_lines_shows_is_found(model: Model) -> None:
    found = begun(model, FAINT).diagnosed()
    assert found.status == "effect-found"
    (effect,) = found.end.effects
    assert (effect.name, effect.joint) == ("input-delay", 1) and effect.values[0] == pytest.approx(3e-6, rel=0.15)


def begun(model: Model, *effects: str) -> Begun:
    measured = campaign(*effects)
    return begin(measured, model, tuple(estimate(record, measured) for record in measured.records))


def fewer(found: Diagnosis) -> Array:
    """What the fitting records alone tell of the parameters that were found."""
    lin = linearised(replace(found.end.problem, data=found.split.fit), found.end.minimum.vector)
    return lin.information


@pytest.mark.parametrize(
    ("text", "name", "joint", "values"),
    [
        pytest.param("torque-lag:time=0.0008@joint3", "torque-lag", 2, [0.0008], marks=pytest.mark.bench),
        pytest.param("link-viscous:damping=0.3@joint2", "link-viscous", 1, [0.3], marks=pytest.mark.bench),
        pytest.param("motor-coulomb:level=0.001@joint2", "motor-coulomb", 1, [0.001], marks=pytest.mark.bench),
    ],
)
def test_an_effect_is_named_sized_and_gone(model: Model, text: str, name: str, joint: int, values: list[float]) -> None:
    """To 5 %: what three short records of a joint tell; held-out errors are at the noise again."""
    found = diagnosed(model, text)
    assert found.status == "effect-found"
    (added,) = found.added
    assert (added.effect.name, added.effect.joint) == (name, joint)
    np.testing.assert_allclose(added.effect.values, values, rtol=0.05)
    assert found.before.all > 3.0 * found.after.all and found.after.all < 1.1 * found.after.noise


@pytest.mark.parametrize(
    ("text", "name", "joint", "value"),
    [
        ("motor-viscous:damping=3e-5@joint2", "motor-viscous", 1, 3e-5),
        pytest.param("motor-inertia:inertia=8e-6@joint1", "motor-inertia", 0, 8e-6, marks=pytest.mark.bench),
    ],
)
@pytest.mark.bench
def test_a_declared_number_that_is_off_is_named(model: Model, text: str, name: str, joint: int, value: float) -> None:
    found = diagnosed(model, text)
    assert found.status == "effect-found" and not found.added
    first = found.off[0]
    assert (first.deviation.name, first.deviation.joint) == (name, joint)
    assert first.deviation.values[0][1] == pytest.approx(value, rel=0.05)
    assert first.before > 2.0 * first.after


@pytest.mark.bench
def test_a_tilted_base_is_told_with_how_strong_gravity_is(model: Model) -> None:
    """The fitted arm is free to be heavier, not to hang aside; together they are one effect."""
    found = diagnosed(model, "gravity-stiffness:share=-0.2,tilt_x=0.15,tilt_y=-0.1")
    (added,) = found.added
    assert added.effect.name == "gravity-stiffness" and not found.off
    off = np.abs(np.array(added.effect.values) - [-0.2, 0.15, -0.1])
    assert np.all(off < 5.0 * np.array(added.std)) and max(added.std) < 0.02
    assert found.after.all < 1.1 * found.after.noise


@pytest.mark.bench
def test_a_load_is_told_beside_a_link_that_bends(model: Model) -> None:
    found = diagnosed(model, "link-flexibility:stiffness=9000@joint3", "payload:mass=0.6,offset=0.15")
    assert [(e.name, e.joint) for e in found.end.effects] == [("link-flexibility", 2)]
    assert [(one.deviation.name, one.deviation.joint) for one in found.off] == [("payload", None)]
    assert found.off[0].deviation.values[0][1] == pytest.approx(0.6, rel=0.05)


@pytest.mark.bench
def test_what_leaves_a_thousandth_of_what_another_left_is_told_where_it_is_all_that_is_left(model: Model) -> None:
    found = diagnosed(
        model, "motor-coupling:ratio=-0.035@joint2", "encoder-eccentricity:amplitude=0.012,order=1@joint3"
    )
    assert [(e.name, e.joint) for e in found.end.effects] == [("motor-coupling", 1), ("encoder-eccentricity", 2)]
    assert found.after.all < 1.1 * found.after.noise


@pytest.mark.parametrize(("does", "late"), [(False, False), (True, False), (True, True)])
def test_an_arm_that_is_still_bent_is_fitted_afresh_before_more_is_looked_for_unless_one_name_more_does(
    does: bool, late: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By stand-ins: a model is what it leaves, per degree of freedom. A name that does is taken though it was found `late`."""
    start, bent, straight = (
        SimpleNamespace(select=left, left=left, effects=(SimpleNamespace(name="link-viscous", joint=0, parameters=()),))
        for left in (9.0, 5.0, 1.0)
    )
    asked: list[State] = []

    def another(bench: Bench, state: State, *_: object) -> tuple[State, list[SimpleNamespace]]:
        asked.append(state)
        return (bent if state is start else straight), [SimpleNamespace(partly=(), others=())]

    def one_more(bench: Any, state: State, others: object) -> tuple[State, list[str]]:
        bench.late = late
        return state, ["name"] * does

    stand_ins = dict.fromkeys(
        ("apart", "exchanged", "pruned", "in_each_record", "but_for_played"),
        lambda bench, state, added, *more: (state, added),
    ) | {
        "reduced_chi2": lambda bench, state: state.left,
        "something_departs": lambda bench, state: state.left > 1.1,
        "is_suspect": lambda bench, state: False,
        "is_little": lambda bench, start, state: False,
        "another": another,
        "one_more": one_more,
        "elsewhere": lambda bench, state, effect: state,
        "explains": lambda *of: True,
        "afresh": lambda bench, state: straight,
    }
    _instead(monkeypatch, stand_ins)
    bench = SimpleNamespace(split=SimpleNamespace(note="by lines"), late=False, say=lambda line: None)
    added = [SimpleNamespace(partly=(), others=())] * (2 if does else 1)
    assert _loop(bench, start) == (straight, added)
    assert asked == ([start, bent] if does else [start])


@pytest.mark.parametrize(("left", "asked"), [(1.03, True), (0.93, False)])
def test_what_hardly_leaves_noise_is_looked_for_beside_what_was_found_too(
    left: float, asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = SimpleNamespace(select=left, effects=())
    suspected: list[bool] = []
    stand_ins = {
        "reduced_chi2": lambda bench, state: state.select,
        "degrees": lambda data: 1,
        "something_departs": lambda bench, state: False,
        "is_suspect": lambda bench, state: suspected.append(True),
        "links_anew": lambda bench, state: state,
    }
    _instead(monkeypatch, stand_ins)
    bench = SimpleNamespace(split=SimpleNamespace(note="by lines", select=()), late=False, say=lambda line: None)
    _loop(bench, SimpleNamespace(select=9.0), (found, ["added"]))
    assert suspected == [True] * asked


def test_what_is_resumed_by_lines_has_its_links_told_anew_first(monkeypatch: pytest.MonkeyPatch) -> None:
    start, found, mended = (SimpleNamespace(select=left, left=left, effects=()) for left in (9.0, 5.0, 1.0))
    stand_ins = {
        "reduced_chi2": lambda bench, state: state.left,
        "something_departs": lambda bench, state: state.left > 1.1,
        "links_anew": lambda bench, state: mended,
    }
    _instead(monkeypatch, stand_ins)
    bench = SimpleNamespace(split=SimpleNamespace(note="by lines", select=()), late=False, say=lambda line: None)
    _instead(monkeypatch, {"degrees": lambda data: 1})
    assert _loop(bench, start, (found, ["added"])) == (mended, ["added"])


@pytest.mark.parametrize(("chosen", "unseen", "lines"), [(1.3, False, True), (0.95, False, False), (0.95, True, True)])
def test_what_only_the_choosing_records_doubt_or_those_that_report_is_told_by_lines_of_every_record(
    chosen: float, unseen: bool, lines: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The records that fit are fitted to the noise, and the little that the others leave is no departure."""
    none: Any = SimpleNamespace(all=0.0)
    first, found, other = (
        SimpleNamespace(select=select, minimum=SimpleNamespace(chi2=fit), effects=())
        for select, fit in ((500.0, 500.0), (chosen, 0.93), (0.94, 0.94))
    )
    bench: Any = SimpleNamespace(
        split=SimpleNamespace(note="", fit=(), select=(), report=()),
        late=False,
        campaign=None,
        model=None,
        say=lambda line: None,
    )
    whole: Any = SimpleNamespace(
        **{**vars(bench), "split": SimpleNamespace(note="lines", fit=(), select=(), report=())}
    )
    stand_ins = {
        "degrees": lambda data: 1,
        "_loop": lambda bench, start, resumed=None, gives_way=None: resumed or (found, []),
        "_by_lines": lambda bench, data: (whole, first),
        "_resumed": lambda bench, start, state, added: (other, []),
        "left_over": lambda *of: (),
        "contradicted": lambda bench, state: (),
        "largest_first": lambda bench, state, added: list(added),
        "merged": lambda state, contradictions: (state, ()),
        "settled": lambda bench, state: state,
        "errors": lambda *of: none,
        "told_of": lambda *of: (),
        "is_unseen": lambda bench, state: unseen,
        "as_found": lambda split, state, added, off: tuple(added),
    }
    _instead(monkeypatch, stand_ins)
    monkeypatch.setattr("ident.search.refits.degrees", lambda data: 1)
    told = Begun((), (), bench, first).diagnosed()  # type: ignore[arg-type]
    assert (told.end is other, told.split.note) == (lines, "lines" if lines else "")


def test_entries_are_in_the_order_in_which_they_were_added_and_errors_of_the_same_records(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A name that took a curve's place is the last of the model, not of the entries."""
    second, renamed_first = Backlash(1, (1e-4,)), MotorCoulomb(0, (1e-3,))
    start, found = (
        SimpleNamespace(select=left, effects=of) for left, of in ((9.0, ()), (1.0, (second, renamed_first)))
    )
    added = [Added(e, (), 0.3, 0.2, 1.0, 1.0, (), (), ()) for e in (renamed_first, second)]
    parts: Any = SimpleNamespace(note="lines", fit=(), select=(), report=("first", "unseen"))
    stand_ins = {
        "_loop": lambda *of: (found, added),
        "left_over": lambda *of: (),
        "contradicted": lambda bench, state: (),
        "largest_first": lambda bench, state, added: list(added),
        "merged": lambda state, contradictions: (state, ()),
        "settled": lambda bench, state: state,
        "told_of": lambda split, state, data: data[: -len(state.effects) // 2],
        "errors": lambda bench, state, data: SimpleNamespace(
            all=state.select, of=data, per_joint={}, noise_per_joint={}
        ),
    }
    _instead(monkeypatch, stand_ins)
    monkeypatch.setattr("ident.search.spread.standard_deviations", lambda *of: ())
    monkeypatch.setattr("ident.search.spread.scatter", lambda split, state: 1.0)
    bench: Any = SimpleNamespace(
        split=parts, campaign=SimpleNamespace(joints=("joint1", "joint2", "joint3")), model=None, say=lambda line: None
    )
    told = Begun((), (), bench, start).diagnosed()  # type: ignore[arg-type]
    assert [(one.effect, one.after) for one in told.added] == [(renamed_first, 0.2), (second, 1.0)]
    assert told.before.of == told.after.of == ("first",)  # type: ignore[attr-defined]


@pytest.mark.parametrize("other_parts", [False, True])
def test_effects_found_with_another_arm_are_gone_on_from_without_its_models(
    monkeypatch: pytest.MonkeyPatch, other_parts: bool
) -> None:
    """Its constants are not those of this arm."""
    own, anew, state = (SimpleNamespace(left=left) for left in (9.0, 8.0, 1.0))
    elsewhere: Any = SimpleNamespace()
    entry = Added(LinkViscous(1, (0.1,)), (), 0.0, 0.0, 1.0, 1.0, (), (), (), (elsewhere,), (elsewhere,), elsewhere)
    looped: list[Any] = []

    missing: list[Any] = [SimpleNamespace()]

    def loop(bench: Any, start: Any, resumed: Any, missing: Any) -> Any:
        looped.append((start, *resumed, missing))
        return resumed

    stand_ins = {
        "begun": lambda bench: (bench, anew), "_loop": loop, "left_over": lambda *of: (), "on_declared_arm": lambda bench, tried: [bench, *tried],
        "errors": lambda bench, state, data: SimpleNamespace(all=state.left),
    }  # fmt: skip
    _instead(monkeypatch, stand_ins)
    monkeypatch.setattr(Begun, "_told", lambda self, *of: of)
    benches: list[Any] = [SimpleNamespace(split=SimpleNamespace(report=())) for _ in range(2)]
    found: Any = SimpleNamespace(added=(entry,))
    Begun((), (), benches[0], own).going_on(found, benches[other_parts], state, missing)  # type: ignore[arg-type]
    (start, of, entries, tried) = looped[0]
    assert start is (anew if other_parts else own) and of is state and tried == [benches[other_parts], *missing]
    assert [(e.before, e.after, e.others, e.partly, e.besides) for e in entries] == [(start.left, 1.0, (), (), None)]


@dataclass(frozen=True)
class Piece:
    """A record as a model has it, at so many of its lines."""

    index: int
    of: str
    judged: str | None = None


@pytest.mark.parametrize(
    ("own", "given", "taken"),
    [("", "", True), ("", "lines", True), ("lines", "lines", True), ("lines", "", False)],
)
def test_two_arms_are_compared_by_the_same_parts_of_the_records(
    own: str, given: str, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But by lines where its own records tell one too little."""
    arm = SimpleNamespace(vector=np.ones(4))
    end: Any = SimpleNamespace(effects=(), minimum=arm, problem=SimpleNamespace(base=4))
    monkeypatch.setattr("ident.loop.diagnose.some", lambda end, keep: Refit(arm.vector, (), (), ()))
    monkeypatch.setattr("ident.loop.diagnose.all_fitted", lambda bench, refits: [SimpleNamespace(select=1.0)])
    monkeypatch.setattr("ident.loop.diagnose.fitted", lambda bench, refit: "finely")
    monkeypatch.setattr("ident.loop.diagnose.reduced_chi2", lambda bench, state: state.select)
    monkeypatch.setattr(Refit, "of", lambda state: state)
    data: Any = tuple(Piece(k, "own") for k in range(3))
    one, two, three = data
    bench: Any = Bench(
        None, SimpleNamespace(chain=SimpleNamespace(n=1)), None, Split((one,), (two,), (three,), own),
        SimpleNamespace(vector=lambda: arm.vector), 1,
    )  # type: ignore[arg-type] # fmt: skip
    other: Any = Split(
        (Piece(2, "other", "a"), Piece(0, "other")), (Piece(2, "other", "b"),), (Piece(1, "other"),), given
    )
    begun = Begun((), data, bench, SimpleNamespace(minimum=arm))  # type: ignore[arg-type]
    found = begun.beside(end, other)[0].split
    fit = (Piece(2, "own", "a"), Piece(0, "own"))
    same: Any = Split(fit, (Piece(2, "own", "b"),), (Piece(1, "own"),), given)
    expected = same if taken else bench.split
    assert [getattr(found, part) for part in vars(same)] == [getattr(expected, part) for part in vars(same)]
    finely = [begun.beside(end, other, most=most)[1] == "finely" for most in (0.9, 1.1)]
    assert finely == [False, True], "what leaves too much in haste is not fitted on"


@pytest.mark.parametrize(
    ("fit", "chosen", "alone", "blind"),
    [
        (0.93, 1.3, True, False),
        (0.93, 0.95, False, False),  # explained
        (1.4, 1.9, False, False),  # by no records
        (30.0, 1.02, False, True),
        (30.0, 8.0, False, False),
    ],
)
def test_records_that_fit_but_explain_no_others_tell_too_little_and_those_that_show_nothing_choose_blindly(
    fit: float, chosen: float, alone: bool, blind: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("rest", "refits"):
        monkeypatch.setattr(f"ident.search.{module}.degrees", lambda data: 1)
    bench: Any = SimpleNamespace(split=SimpleNamespace(fit=(), select=()))
    state: Any = SimpleNamespace(select=chosen, minimum=SimpleNamespace(chi2=fit))
    assert _fits_alone(bench, state) == alone and _hardly_chooses(bench, state) == blind


def test_what_the_records_that_fit_still_leave_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an effect that the choosing records do not show, their chi^2 tells no share."""
    monkeypatch.setattr("ident.search.rest.degrees", lambda data: 1000)
    bench: Any = SimpleNamespace(split=SimpleNamespace(fit=(), select=()))
    start, state = (
        cast(Any, SimpleNamespace(select=chosen, minimum=SimpleNamespace(chi2=fit)))
        for chosen, fit in ((1000.0, 91_000.0), (990.0, 46_000.0))
    )
    assert share_left(bench, start, state) == pytest.approx(0.5)


@pytest.mark.parametrize(("left", "goes_on"), [(1.4, True), (9.0, False)])
def test_lines_of_every_record_begin_with_what_was_found_where_that_leaves_little(
    left: float, goes_on: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def entry(before: float, after: float) -> Added:
        return Added(LINK_VISCOUS, (), before, after, 1.0, 1.0, (), (), ())

    start, by_lines = (SimpleNamespace(select=chi2, minimum=SimpleNamespace(chi2=chi2)) for chi2 in (41.0, left))
    stand_ins = {
        "fitted": lambda bench, refit: by_lines,
        "degrees": lambda data: 1,
        "errors": lambda bench, state, report: SimpleNamespace(all=state.select),
    }
    _instead(monkeypatch, stand_ins)
    monkeypatch.setattr(Refit, "of", lambda state: state)
    bench: Any = SimpleNamespace(split=SimpleNamespace(fit=(), select=(), report=()))
    found: Any = SimpleNamespace(effects=())
    led: Any = SimpleNamespace(select=0.5, effects=())  # by fewer records
    entries = [replace(entry(0.3, 0.2), besides=led), entry(0.2, 0.1)]
    resumed = _resumed(bench, start, found, entries)  # type: ignore[arg-type]
    assert (resumed is not None) == goes_on
    assert resumed is None or _better(start, resumed[1]) is start  # type: ignore[arg-type,comparison-overlap]
    assert resumed is None or [(one.before, one.after) for one in resumed[1]] == [(41.0, 0.2), (0.2, left)]
    assert _resumed(bench, start, found, []) is None, "nothing was found"  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("effect", "left", "little", "bent"),
    [
        (LinkViscous(0, (0.1,)), 1.2, True, True),
        (Ringing(0, (4e-6, 55.0, 1e-4)), 1.2, True, True),
        (DRAWN, 1.2, True, False),
        (DRAWN, 5.0, False, True),
        (DRAWN, 1.0, True, False),
    ],
)
def test_a_little_of_what_a_curve_draws_is_always_left(
    effect: Effect, left: float, little: bool, bent: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ident.search.rest.reduced_chi2", lambda bench, state: state.left)
    monkeypatch.setattr("ident.search.rest.is_little", lambda bench, start, state: little)
    state: Any = SimpleNamespace(left=left, effects=(effect,))
    assert may_be_bent(state, state, state) == bent


@pytest.mark.parametrize(
    ("joint", "left", "by_port", "of_one"),
    [
        pytest.param(None, 265.0, 0.9999, True, id="what bends the whole arm, and one joint would do"),
        pytest.param(0, 265.0, 0.9999, False, id="an effect of one joint"),
        pytest.param(None, 265.0, 0.9, False, id="no joint does as much"),
        pytest.param(None, 20.0, 0.9999, False, id="it leaves little"),
    ],
)
def test_what_bends_the_whole_arm_is_not_named_where_one_joint_would_explain_more(
    joint: int | None, left: float, by_port: float, of_one: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ident.search.rest.reduced_chi2", lambda bench, state: state.left)
    monkeypatch.setattr("ident.search.rest.share_left", lambda bench, start, state: state.left / start.left)
    bench, start = SimpleNamespace(model=SimpleNamespace(chain=SimpleNamespace(n=3))), SimpleNamespace(left=1e4)
    state = SimpleNamespace(left=left)
    added = [
        SimpleNamespace(effect=SimpleNamespace(joint=joint), port_shares=(("motor", 0, by_port), ("link", 1, 0.1)))
    ]
    assert is_of_one_joint(bench, start, state, added) == of_one  # type: ignore[arg-type]
    assert not is_of_one_joint(bench, start, state, [])  # type: ignore[arg-type]
    bench.model.chain.n = 1
    assert not is_of_one_joint(bench, start, state, added)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("place", "left", "shares", "elsewhere"),
    [
        pytest.param(("sensor", 2), 0.8, (1.01, 0.96), True, id="a crank at the motor, taken for its encoder"),
        pytest.param(("sensor", 2), 0.8, (1.01, 1.005), False, id="both ports explain as much"),
        pytest.param(("motor", 2), 0.8, (1.01, 0.96), False, id="it acts there"),
        pytest.param(("sensor", 2), 0.3, (1.01, 0.96), False, id="it explains most"),
        pytest.param(("sensor", 2), 0.8, (0.8, 0.6), False, id="no port explains nearly all"),
        pytest.param(("structure", 2), 0.8, (1.01, 0.96), False, id="it is no force at a port"),
        pytest.param(("sensor", None), 0.8, (1.01, 0.96), False, id="one of the whole arm"),
    ],
)
def test_what_explains_little_is_not_named_where_a_force_at_another_port_would_explain_all(
    place: tuple[str, int | None],
    left: float,
    shares: tuple[float, float],
    elsewhere: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("ident.search.rest.share_left", lambda bench, start, state: left)
    state: Any = SimpleNamespace(effects=(SimpleNamespace(port=place[0], joint=place[1]),))
    ports = (("motor", 2, shares[0]), ("sensor", 2, shares[1]), ("link", 1, 0.1))
    added: Any = [SimpleNamespace(port_shares=ports)]
    assert is_of_another_port(state, state, state, added) == elsewhere
    assert not is_of_another_port(state, state, state, [])


@pytest.mark.bench
def test_a_name_takes_a_curves_place_once_it_explains_the_records() -> None:
    """As after another effect was found: friction that was drawn as a curve is one that has a name."""
    d = by_hand.diagnosis()
    guess = declared_start(d.campaign, d.model, d.responses, gravity_basis(d.model, d.campaign.gravity))
    bench = Bench(d.campaign, d.model, gravity_basis(d.model, d.campaign.gravity), d.split, guess, 1)
    knots = [-8.0, -2.0, -0.2, 0.2, 2.0, 8.0]
    curve = learned("motor", "velocity", knots)(by_hand.JOINT, tuple(-by_hand.LEVEL * np.sign(knots)))
    many = len(knots)
    drawn = Refit(
        np.concatenate([guess.vector(), curve.values]), (curve,), (1e-3,) * many, ((-1.0, 1.0),) * many, 1, HASTILY
    )
    state = fitted(bench, drawn)
    entry = replace(d.added[0], effect=state.effects[0])
    new, (added,) = renamed(bench, state, state.effects[0], [entry])
    assert [e.name for e in new.effects] == [added.effect.name] == ["motor-coulomb"]
    assert added.effect.joint == by_hand.JOINT
    assert added.effect.values[0] == pytest.approx(by_hand.LEVEL, rel=0.05)


def test_other_whole_numbers_stay_within_the_arm() -> None:
    """The first motor may be coupled to the third, the second to no fourth."""
    start = by_hand.diagnosis().start
    lin = linearise(start.problem, start.minimum.vector, hold(start.problem, start.minimum.vector))
    kind = CATALOGUE["motor-coupling"]
    assert [c.effect["step"] for c in otherwise(lin, kind(0, (0.05, 1.0)))] == [2.0]
    assert otherwise(lin, kind(1, (0.05, 1.0))) == []


@pytest.mark.bench
def test_a_base_so_soft_that_it_moves_every_mode_promises_most(model: Model) -> None:
    """Its force is that on links which move as springs and motors tell: they do not move as the declared links would."""
    soft = campaign("base-compliance:rock=1e5,turn=1e5,own=150,damping=2e-4")
    basis = gravity_basis(model, soft.gravity)
    responses = [estimate(record, soft) for record in soft.records]
    data = tuple(evidence(soft, model, basis, frf, k, "every") for k, frf in enumerate(responses))
    guess = declared_start(soft, model, responses, basis)
    problem = Bench(soft, model, basis, split(data, model), guess, 1).problem(data, (), (), ())
    lin = linearise(problem, guess.vector(), hold(problem, guess.vector()))
    best, *others = catalogue(lin, ())
    assert best.effect.name == "base-compliance" and best.gain > 1.3 * others[0].gain
    found = diagnose(soft, model)
    (added,) = found.added
    assert added.effect.name == "base-compliance" and found.left < 1.1
    np.testing.assert_allclose(added.effect.values, [1e5, 1e5, 150.0, 2e-4], rtol=0.01)


@pytest.mark.parametrize(
    ("effect", "of", "little"),
    [
        (Backlash(0, (1e-4,)), 201.0, True),
        (MotorHysteresis(0, (1e-3, 0.2)), 201.0, False),
        (MotorCoulomb(0, (1e-3,)), 201.0, False),
        (MotorCoulomb(0, (1e-3,)), 5001.0, True),
        (MotorHysteresis(0, (1e-3, 0.2)), 5001.0, False),
    ],
)
def test_more_is_left_of_a_motion_that_may_not_be_found(
    effect: Effect, of: float, little: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six noise powers: of play it may be its own motion, of much dry friction how it creeps; of a hysteresis, whose motion is found, it is
    another effect's."""
    monkeypatch.setattr("ident.search.rest.reduced_chi2", lambda bench, state: state.select)
    monkeypatch.setattr(
        "ident.search.rest.share_left", lambda bench, start, state: (state.select - 1.0) / (start.select - 1.0)
    )
    monkeypatch.setattr("ident.search.rest._fitting", lambda bench, state: state.select)
    monkeypatch.setattr("ident.search.rest.acts_elsewhere", lambda bench, state: False)
    start, state = (SimpleNamespace(select=left, effects=(effect,)) for left in (of, 6.0))
    assert is_little(SimpleNamespace(), start, state) == little


@pytest.mark.parametrize(
    ("chosen", "reported", "unseen"), [(0.95, 29.0, False), (0.95, 31.0, True), (2.0, 50.0, False)]
)
def test_what_acts_in_records_that_only_report_is_seen_there(
    chosen: float, reported: float, unseen: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A joint that changed before the last record: what fits and chooses is explained without."""
    stand_ins = {
        "told_of": lambda split, state, data: data, "chi_squared": lambda *of: reported, "held_as": lambda *of: (),
        "degrees": lambda data: 1, "replace": lambda problem, data: problem, "_fitting": lambda bench, state: 0.9,
        "reduced_chi2": lambda bench, state: chosen, "is_rough": lambda bench, state: False,
    }  # fmt: skip
    for name, stand_in in stand_ins.items():
        monkeypatch.setattr(f"ident.search.rest.{name}", stand_in)
    state: Any = SimpleNamespace(problem=None, minimum=SimpleNamespace(vector=None))
    bench: Any = SimpleNamespace(split=SimpleNamespace(report=("one",)))
    assert is_unseen.__wrapped__(bench, state) == unseen


@pytest.mark.parametrize("suspect", [True, False])
def test_what_promises_far_beyond_noise_is_tried_where_hardly_more_than_noise_is_left_beside_a_force(
    suspect: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cable beside a spring that hardens: 1.087 noise powers were left, 1.8 times the noise held out."""
    found, tried = SimpleNamespace(select=1.087, effects=()), []
    stand_ins = {
        "reduced_chi2": lambda bench, state: state.select,
        "degrees": lambda data: 1,
        "something_departs": lambda bench, state: True,
        "is_little": lambda bench, start, state: True,
        "is_suspect": lambda bench, state: suspect,
        "links_anew": lambda bench, state: state,
        "another": lambda bench, state, *more: tried.append(state),
    }
    _instead(monkeypatch, stand_ins)
    bench = SimpleNamespace(split=SimpleNamespace(note="by lines", select=()), late=False, say=lambda line: None)
    _loop(bench, SimpleNamespace(select=9.0), (found, [SimpleNamespace(partly=())]))
    assert tried == [found] * suspect


@pytest.mark.bench
def test_declared_numbers_that_are_off_are_told_where_few_lines_depart(
    model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = Departure(2, Band(10.0, 30.0), "excited", 6.4, 1.0)
    _instead(monkeypatch, {"left_over": lambda bench, start, state: (few,)})
    file = campaign("motor-viscous:damping=3e-5@joint2")
    found = diagnose(file, model)
    assert found.left < 1.1 and found.status == "unexplained" and found.departures == (few,)
    assert (found.off[0].deviation.name, found.off[0].deviation.joint) == ("motor-viscous", 1)
