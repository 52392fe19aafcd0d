"""When effects are none of those that act: held-out errors grow with them, all or at their own joints alone."""

from __future__ import annotations

import pytest

from ident.loop.growth import growth, is_worse
from ident.search.departures import Errors

NOISE = {"joint1": 0.001, "joint2": 0.001}


def errors(all_: float, joint1: float, joint2: float) -> Errors:
    return Errors(all_, {"joint1": joint1, "joint2": joint2}, {}, 0.001, NOISE, {})


def told(one: Errors) -> dict[str, object]:
    return {"all": one.all, "per_joint": one.per_joint}


@pytest.mark.parametrize(
    ("after", "worse", "said"),
    [
        (errors(0.004, 0.003, 0.003), True, "the held-out error grows from 0.3 % to 0.4 %"),
        (errors(0.003, 0.003, 0.004), True, "the held-out error of joint2 grows from 0.3 % to 0.4 %"),
        (errors(0.003, 0.002, 0.004), False, ""),  # what it does elsewhere may be right
        (errors(0.003, 0.003, 0.0031), False, ""),  # by chance
        (errors(0.002, 0.003, 0.002), False, ""),
        (errors(0.0030001, 0.003, 0.003), True, "the held-out error stays at 0.3 %"),
    ],
)
def test_errors_grow_with_effects_that_are_none_of_those_that_act(after: Errors, worse: bool, said: str) -> None:
    before = errors(0.003, 0.003, 0.003)
    assert is_worse(before, after, ["joint2"]) == worse
    error = {"before": told(before), "after": told(after), "noise_per_joint": NOISE}
    assert growth({"error": error, "effects": [{"joint": "joint2"}]}) == said
    assert not growth({"error": error, "effects": []})


def test_an_error_that_noise_makes_grows_for_nothing() -> None:
    assert not is_worse(errors(0.001, 0.001, 0.0009), errors(0.001, 0.001, 0.00105), ["joint2"])
