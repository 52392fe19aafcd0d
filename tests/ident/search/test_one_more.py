"""One name more that does, by stand-ins: a model is what it leaves."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ident.search.one_more
from ident.effects.base import Effect
from ident.effects.catalogue import CATALOGUE
from ident.search.choice import Tried
from ident.search.one_more import _guessed, _of_two_causes, leading_to_one_more, one_more
from ident.search.refits import Refit, State

LEFT = 200.0


def name(joint: int | None, gain: float, left: float, dry: bool = False, numbers: int = 1) -> Tried:
    effect = SimpleNamespace(
        name="friction" if dry else "damping", joint=joint, dry=dry, carries=False, parameters=(), numbers=numbers
    )
    candidate = SimpleNamespace(effect=effect, gain=gain, key=joint)
    minimum = SimpleNamespace(vector=None)
    state = SimpleNamespace(select=left, effects=(effect,), problem=None, minimum=minimum, roughly=0.03)
    return Tried(candidate, state)  # type: ignore[arg-type]


@pytest.fixture
def beyond(monkeypatch: pytest.MonkeyPatch) -> list[Tried]:
    """The names that promise anything beyond a model, as they are once refitted; finely they leave half as much."""
    names: list[Tried] = []
    state_of = {"finer": lambda bench, s: SimpleNamespace(**(vars(s) | {"select": s.select / 2}))}
    stand_ins = state_of | {
        "reduced_chi2": lambda bench, state: state.select,
        "by_links": lambda bench, state: state.effects[-1].carries,
        "_guessed": lambda effect: False,
        "plainest": lambda bench, named: min(named, key=lambda one: one[1].select),
        "_of_two_causes": lambda one, other: other.joint not in (None, one.joint),
        "linearised": lambda problem, vector: SimpleNamespace(chi2=LEFT),
        "something_departs": lambda bench, state: state.select > 1.0,
        "beyond_noise": lambda state, lin: lin.chi2,
        "catalogue": lambda lin, effects, workers: [candidate for candidate, _ in names],
        "refitted": lambda bench, state, short: [
            one for one in names if any(one[0] is candidate for candidate, _ in short)
        ],
    }
    for key, stand_in in stand_ins.items():
        monkeypatch.setattr(ident.search.one_more, key, stand_in)
    return names


BENCH = SimpleNamespace(late=False, workers=1, say=lambda line: None, declared=None)
UNBENT = SimpleNamespace(**vars(BENCH) | {"declared": "the declared arm"})


@pytest.mark.parametrize(
    ("left", "best", "does"),
    [(4.5, 1.2, True), (4.5, 2.6, False), (200.0, 2.9, True), (200.0, 7.0, False), (2.5, 0.9, False)],
)
def test_one_name_more_does_where_it_leaves_hardly_anything_of_much(
    left: float, best: float, does: bool, beyond: list[Tried]
) -> None:
    """Of a little any name may leave nothing."""
    beyond += [name(0, 90.0, 150.0), name(1, 80.0, best)]
    state = name(2, 0.0, left)[1]
    same, tried = one_more(BENCH, state)
    assert same is state and bool(tried) == does


@pytest.mark.parametrize(
    ("plain", "numbers", "alone"),
    [
        (1.9, 3, True),
        (2.1, 3, False),  # which finely leaves something
        (1.9, 1, False),  # of as few numbers the other may be as good
    ],
)
def test_where_a_plain_name_leaves_nothing_none_of_more_numbers_is_fitted_finely(
    plain: float, numbers: int, alone: bool, beyond: list[Tried]
) -> None:
    beyond += [name(0, 90.0, 1.8, dry=True, numbers=numbers), name(0, 80.0, plain), name(1, 70.0, 150.0)]
    _, tried = one_more(BENCH, name(2, 0.0, LEFT)[1])  # type: ignore[arg-type]
    both = [(beyond[0].candidate, 0.9)] * (not alone) + [(beyond[1].candidate, plain / 2)]
    assert [(one.candidate, one.state.select) for one in tried] == [*both, (beyond[2].candidate, 150.0)]


@pytest.mark.parametrize("carries", [False, True])
def test_beside_what_carries_the_declared_links_nothing_more_is_looked_for(carries: bool, beyond: list[Tried]) -> None:
    """What that leaves may be by links that are others."""
    lead, other = name(1, 9.0, 50.0), name(2, 8.0, 150.0)
    lead.candidate.effect.carries = carries  # type: ignore[misc]
    beyond += [name(2, 90.0, 0.9)]
    names, both = leading_to_one_more(BENCH, name(0, 0.0, LEFT)[1], [lead, other])  # type: ignore[arg-type]
    assert (both is None) == carries and [one.candidate for one in names] == [lead.candidate, other.candidate]


@pytest.mark.parametrize(
    ("lead", "other", "second", "found"),
    [
        (name(1, 9.0, 50.0), name(2, 8.0, 150.0), name(2, 90.0, 0.9), True),
        (name(1, 9.0, 2.6), name(2, 8.0, 150.0), name(2, 90.0, 1.02), True),
        (name(1, 9.0, 2.0), name(2, 8.0, 150.0), name(2, 90.0, 0.9), False),  # which finely leaves nothing alone
        (name(1, 9.0, 2.6), name(2, 8.0, 150.0), name(2, 90.0, 2.09), False),  # of less than two noise powers
        (name(1, 9.0, 50.0), name(2, 8.0, 150.0), name(1, 90.0, 0.9), False),  # it may be of one law that has no name
        (name(1, 9.0, 50.0), name(2, 8.0, 150.0), name(None, 90.0, 0.9), False),
        (name(1, 9.0, 190.0), name(2, 8.0, 199.0), name(2, 90.0, 0.9), False),  # most is left
        (name(1, 9.0, 50.0), name(2, 8.0, 150.0), name(2, 90.0, 2.6), False),  # something is left beside both
        (
            name(1, 9.0, 50.0, dry=True),
            name(2, 8.0, 150.0),
            name(2, 90.0, 4.4),
            True,
        ),  # friction's motion is not found yet
        (name(1, 9.0, 50.0, dry=True), name(2, 8.0, 150.0), name(2, 90.0, 7.0), False),
        (name(1, 9.0, 50.0), name(2, 8.0, 150.0), name(2, 90.0, 4.4, dry=True), True),  # nor that of the second's
        (name(1, 9.0, 50.0), name(2, 8.0, 150.0), name(2, 19.0, 0.9), False),  # hardly promised
    ],
)
def test_a_name_leads_to_another_that_leaves_nothing(
    lead: Tried,
    other: Tried,
    second: Tried,
    found: bool,
    beyond: list[Tried],
) -> None:
    beyond.append(second)
    start = name(None, 0.0, LEFT)[1]
    names, both = leading_to_one_more(BENCH, start, [other, lead])
    assert (both is not None) == found
    assert names[0] is other and names[1].candidate is lead.candidate
    assert (names[1].state.select < lead.state.select) == (
        lead.state.select < 0.7 * LEFT
    )  # then it is fitted finely once
    if both is not None:
        assert both[0].effects == lead[1].effects and [one.candidate for one in both[1]] == [second.candidate]


@pytest.mark.parametrize(
    ("bench", "left", "found"), [(BENCH, 300.0, False), (UNBENT, 300.0, True), (UNBENT, 450.0, False)]
)
def test_a_name_from_an_arm_that_is_not_bent_leads_though_it_leaves_more_than_the_bent_one(
    bench: Any, left: float, found: bool, beyond: list[Tried]
) -> None:
    """A delay beside a zero that is off: an arm bent by both left 209 noise powers, the delay alone 293."""
    beyond.append(name(2, 90.0, 0.9))
    assert (leading_to_one_more(bench, name(None, 0.0, LEFT)[1], [name(1, 9.0, left)])[1] is not None) == found


def effect(name: str, joint: int | None) -> Effect:
    kind = CATALOGUE[name]
    return kind(joint, tuple(p.sizes[0] for p in kind.parameters))


@pytest.mark.parametrize(
    ("one", "other", "two"),
    [
        (("link-viscous", 1), ("link-coulomb", 2), True),
        (("link-viscous", 1), ("link-coulomb", 1), False),
        (("torque-lag", 1), ("base-compliance", None), True),
        (("torque-lag", 1), ("time-offset", None), False),
        (("link-viscous", 1), ("gravity-stiffness", None), False),
        (("spring-hysteresis", 1), ("drift-over-records", 1), True),
        (("link-viscous", 1), ("encoder-eccentricity", 1), True),
        (("torque-lag", 1), ("time-offset", 1), False),
        (("torque-lag", 1), ("encoder-eccentricity", 1), True),
        (("time-offset", 1), ("joint-zero-offset", 1), True),
        (("joint-zero-offset", 1), ("joint-zero-offset", 1), False),
    ],
)
def test_two_names_that_take_the_place_of_one_law(
    one: tuple[str, int | None], other: tuple[str, int | None], two: bool
) -> None:
    assert _of_two_causes(effect(*one), effect(*other)) == _of_two_causes(effect(*other), effect(*one)) == two


@pytest.mark.parametrize(
    ("values", "guessed"),
    [((4.0, 0.1, -0.1, 0.1), True), ((4.0, 0.03, -0.1, 0.1), False), ((4.0, 0.3, -0.2, 0.1), False)],
)
def test_a_change_that_wants_more_than_is_allowed_in_all_ways_is_a_guess(
    values: tuple[float, ...], guessed: bool
) -> None:
    assert _guessed(CATALOGUE["change-between-records"](1, values)) == guessed
    assert not _guessed(effect("torque-scale", 1).with_values([0.1]))


def delayed(kind: str, joint: int, left: float, gain: float = 9.0) -> Tried:
    """A name that leaves so much, as it is once refitted."""
    one = effect(kind, joint)
    candidate = SimpleNamespace(effect=one, gain=gain, key=(kind, joint, one.port))
    minimum = SimpleNamespace(vector=None)
    state = SimpleNamespace(select=left, effects=(one,), problem=None, minimum=minimum, roughly=0.002)
    return Tried(candidate, state)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("rival", "both", "lead"),
    [
        (delayed("torque-lag", 1, 55.0), 0.97, "torque-lag"),
        (delayed("torque-lag", 1, 55.0), 3.0, None),  # that leaves something, too
        (delayed("torque-lag", 1, 90.0), 0.97, None),  # it left much more alone
        (delayed("torque-lag", 0, 55.0), 0.97, None),  # of another joint
    ],
)
def test_what_lags_leads_where_what_delays_leaves_something_beside_a_second_name(
    rival: Tried, both: float, lead: str | None, beyond: list[Tried], monkeypatch: pytest.MonkeyPatch
) -> None:
    second = delayed("torque-scale", 2, 6.8, 90.0)
    beyond.append(second)
    asked: list[tuple[str, str]] = []

    def swapped(state: State, old: Effect, other: State) -> Refit:
        asked.append((old.name, other.effects[-1].name))
        return Refit(np.zeros(1), (*other.effects, *state.effects), (), ())

    def fit(bench: object, refit: Refit) -> SimpleNamespace:
        return SimpleNamespace(select=both, effects=refit.effects)

    monkeypatch.setattr(ident.search.one_more, "instead", swapped)
    monkeypatch.setattr(ident.search.one_more, "fitted", fit)
    monkeypatch.setattr(ident.search.one_more, "_of_two_causes", lambda one, other: True)
    delay = delayed("input-delay", 1, 50.0)
    _, found = leading_to_one_more(BENCH, name(None, 0.0, LEFT)[1], [rival, delay])  # type: ignore[arg-type]
    assert (found and found[0].effects[-1].name) == lead
    assert asked == (
        [("input-delay", "torque-lag")] if rival.state.select < 60.0 and rival[0].effect.joint == 1 else []
    )
    if found:
        assert [e.name for e in found[1][0].state.effects] == ["torque-lag", "torque-scale"]


@pytest.mark.parametrize(
    ("rival", "both", "found"),
    [
        (delayed("torque-lag", 1, 55.0), 1.4, "torque-lag"),
        (delayed("torque-lag", 1, 55.0), 5.0, None),
        (delayed("torque-lag", 0, 55.0), 1.4, None),
        (delayed("torque-lag", 1, 90.0), 1.4, None),
    ],
)
def test_one_more_is_tried_beside_what_left_hardly_more_than_the_effect_that_was_added(
    rival: Tried, both: float, found: str | None, beyond: list[Tried], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A delay and a lag leave nearly the same while friction is missing."""
    state, friction = delayed("input-delay", 1, 50.0)[1], name(1, 90.0, 8.0, dry=True)
    beyond.append(friction)
    monkeypatch.setattr(ident.search.one_more, "instead", lambda state, old, other: Refit(np.zeros(1), (), (), ()))
    monkeypatch.setattr(ident.search.one_more, "fitted", lambda bench, refit: SimpleNamespace(select=both))
    model, tried = one_more(BENCH, state, [rival.state])
    assert (model is state) == (not tried) == (found is None)
    if found:
        assert model.effects[-1].name == found
        assert tried[0].candidate is friction.candidate and tried[0].state.select == both
