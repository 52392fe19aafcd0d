"""How the blind study draws and judges: the same case again and again, a name is right only where it is."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "ident"))

from draws import RANGES, RIGID, SILENT
from loop import cases as study
from loop.cases import KINDS_OF_CASE, LARGE, cases, sized
from loop.judge import ASKED, judged
from loop.table import failures, table
from outside import OUTSIDE, OUTSIDE_RANGES

from ident.effects.base import Effect, Law, PortLaw
from ident.effects.catalogue import CATALOGUE
from ident.effects.motion import SIGNALS, State

STILL = State(0.3, 0.0, 0.1, 0.2, 0.0, 1e-3, 0.0, 5.0, 100.0, 5000.0)


def test_a_case_does_not_depend_on_how_many_there_are() -> None:
    for kind in KINDS_OF_CASE:
        assert list(cases(kind, 70, 3))[:20] == list(cases(kind, 20, 3))
    one = list(cases("one", 2 * len(RANGES), 1))
    assert {c.name for c in one} == set(RANGES) - set(SILENT)
    assert all(c.lock == ("rigid" if c.name in RIGID else "dob") for c in one)
    assert sum(c.robot == "arm6" for c in one) == pytest.approx(len(one) / LARGE, abs=2)
    assert [c.rng().random() for c in cases("two", 3, 1)] == [c.rng().random() for c in cases("two", 3, 1)]


@pytest.mark.parametrize(("law", "expected"), [(1.0, 3.7), (3.0, 4.0)])
def test_a_faint_effect_just_shows(law: float, expected: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """In proportion to its size at once; by the cube of it in steps that do not lose it."""
    (case,) = [one for one in cases("faint", 20, 1) if one.name == "motor-coulomb"]
    start = CATALOGUE["motor-coulomb"](1, (10.0,))
    monkeypatch.setattr(study, "_shown", lambda case: (study.Drawn((start,), 10.0**law, 0.0, 1), None))
    monkeypatch.setattr(study, "measured", lambda case, effects: effects[0])
    monkeypatch.setattr(study, "shows", lambda case, effect: (effect.values[0] ** law, 0.0))
    known, records = study._faint(case)
    assert records is known.effects[0] and study.SHOWS <= known.refitted <= study.FAINT[1]
    assert known.refitted == pytest.approx(expected, rel=0.2)


def test_larger_means_more_of_it() -> None:
    assert sized(CATALOGUE["motor-coulomb"](1, (0.01,)), 2.0).values == (0.02,)
    soft = sized(CATALOGUE["base-compliance"].of(None, {"rock": 1e5, "turn": 2e5}), 2.0)
    assert (soft["rock"], soft["turn"]) == (5e4, 1e5)
    ripple = CATALOGUE["torque-ripple"].of(0, {"amplitude": 0.1, "order": 3.0, "phase": 0.5})
    louder = sized(ripple, 2.0)
    assert (louder["amplitude"], louder["order"]) == (0.2, 3.0)


@pytest.mark.parametrize("name", OUTSIDE)
def test_outside_means_in_no_catalogue_and_seen_in_a_still_joint_only_as_a_hold(name: str) -> None:
    kind = OUTSIDE[name]
    assert name not in CATALOGUE and set(OUTSIDE_RANGES[name]) == {p.name for p in kind.parameters}
    law = kind.of(0, {})
    if kind.path is not Effect.path or kind.misread is not Effect.misread:
        return
    if not isinstance(law, Law):
        assert isinstance(law, PortLaw) and law.start(1e-3)[0](STILL) == pytest.approx(0.0, abs=1e-9)
        return
    together = State(*(np.full(3, getattr(STILL, field)) for field in SIGNALS), STILL.N, STILL.K)
    assert np.broadcast_to(law.law(together), 3) == pytest.approx([float(law.law(STILL))] * 3, rel=1e-12)


def verdict(status: str, *effects: tuple[str, str | None, str], confounded: tuple[str, str | None] | None = None) -> dict[str, Any]:  # fmt: skip
    others = [{"name": confounded[0], "joint": confounded[1]}] if confounded else []
    return {
        "status": status,
        "effects": [{"name": n, "joint": j, "port": p, "confounded_with": others} for n, j, p in effects],
        "error": {"before": {"all": 0.1}, "after": {"all": 0.0105}, "noise_floor": 0.01},
        "unexplained": [{"joint": "joint2", "port": "link"}],
    }


def case(kind: str) -> Any:
    return next(cases(kind, 1, 1))


DRY = {"name": "motor-coulomb", "joint": "joint1", "port": "motor"}
WET = {"name": "link-viscous", "joint": "joint2", "port": "link"}


def test_the_right_name_at_the_right_joint_comes_first() -> None:
    right = judged(case("one"), [DRY], verdict("effect-found", ("motor-coulomb", "joint1", "motor")))
    assert right == {"named first": True, "named": True, "port": True, "near noise": True}
    for effects in ([("motor-coulomb", "joint2", "motor")], [("motor-hysteresis", "joint1", "motor")]):
        wrong = judged(case("one"), [DRY], verdict("effect-found", *effects))
        assert not wrong["named first"] and not wrong["named"] and wrong["port"]
    late = judged(
        case("one"), [DRY], verdict("effect-found", ("unknown", "joint1", "link"), ("motor-coulomb", "joint1", "motor"))
    )
    assert not late["named first"] and late["named"] and not late["port"]
    tied = verdict("effect-found", ("motor-hysteresis", "joint1", "motor"), confounded=("motor-coulomb", "joint1"))
    assert judged(case("one"), [DRY], tied)["named first"]
    assert not judged(case("one"), [DRY], verdict("explained"))["named first"]


def test_two_need_two() -> None:
    found = [("link-viscous", "joint2", "link"), ("motor-coulomb", "joint1", "motor")]
    assert judged(case("two"), [DRY, WET], verdict("effect-found", *found))["both named"]
    half = judged(case("two"), [DRY, WET], verdict("effect-found", found[0]))
    assert not half["both named"] and half["one named"]
    both = verdict("effect-found", found[0], confounded=("motor-coulomb", "joint1"))
    assert not judged(case("two"), [DRY, WET], both)["both named"], "one entry stands for one effect"


def test_outside_the_catalogue_a_name_is_wrong_where_nothing_is_left_open() -> None:
    odd = {"name": "root-damper", "joint": "joint2", "port": "link"}
    named = judged(case("outside"), [odd], verdict("effect-found", ("link-viscous", "joint2", "link")))
    assert not named["not misnamed"] and named["place"]
    doubtful = judged(case("outside"), [odd], verdict("unexplained", ("link-viscous", "joint1", "link")))
    assert doubtful["not misnamed"] and not doubtful["place"]
    nothing = judged(case("outside"), [odd], verdict("unexplained"))
    assert nothing["place"] and nothing["cut"]


def test_the_table_tells_rates_and_failures() -> None:
    result = {"id": "clean-1-000", "kind": "clean", "robot": "ypp3", "truth": [], "name": "", "effects": [], "status": "explained",
              "scores": {"explained": True}, "said": [], "seconds": 2.0, "cpu": 2.0, "error": [0.01, 0.01, 0.01]}  # fmt: skip
    bad = result | {"id": "clean-1-001", "status": "unexplained", "scores": {"explained": False}}
    assert '| clean data: "explained" | 98% | 50.0% | 2 | ypp3 1/2 |' in table([result, bad])
    assert "clean-1-001" in failures([result, bad]) and "clean-1-000" not in failures([result, bad])
    assert set(ASKED) == set(KINDS_OF_CASE)
