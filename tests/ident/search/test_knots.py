"""A curve that leaves something may have its knots too far apart where it bends; and so may another, at the port where the law acts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ident.search.knots
from ident.effects.learned import LearnedCurve, learned
from ident.effects.spring import Backlash
from ident.search.choice import Tried
from ident.search.knots import MORE_KNOTS, _closer, drawn_closely

KNOTS = np.linspace(-3.0, 3.0, 13)
DOF = 1000.0
BENCH: Any = SimpleNamespace(split=SimpleNamespace(select=()), late=False, say=lambda line: None)


def drawn(port: str, variable: str, *, bends: bool = False) -> LearnedCurve:
    """A spring that is softer about zero."""
    heights = -KNOTS * np.exp(-((KNOTS / 0.8) ** 2))
    return learned(port, variable, KNOTS.tolist(), bends=bends)(2, tuple(heights.tolist()))


def tried(curve: Any, left: float) -> Tried:
    count = len(curve.values)
    state: Any = SimpleNamespace(
        effects=(curve,), select=left * DOF, left=left, minimum=SimpleNamespace(vector=np.array(curve.values)), scales=(1.0,) * count,
        limits=((-1.0, 1.0),) * count,
    )  # fmt: skip
    return Tried(SimpleNamespace(effect=curve), state)  # type: ignore[arg-type]


@pytest.mark.parametrize("bends", [False, True])
def test_knots_come_closer_where_a_curve_bends_and_it_stays_what_it_is(bends: bool) -> None:
    curve = drawn("spring", "position", bends=bends)
    closer = _closer(curve)
    assert isinstance(closer, LearnedCurve) and closer.smooth == bends
    assert set(curve.knots) < set(closer.knots) and len(closer.knots) <= len(KNOTS) + MORE_KNOTS
    assert all(abs(x) <= 2.0 for x in set(closer.knots) - set(curve.knots)), "straight beyond that"
    x = np.linspace(-4.0, 4.0, 101)
    assert closer.height(x) == pytest.approx(curve.height(x), abs=0.02 if bends else 1e-12)


@pytest.mark.parametrize(
    ("left", "other", "closely", "port"),
    [
        pytest.param(
            1.6, 3.0, 0.97, "spring", id="a soft centre of the spring, taken for a force of its load on the link"
        ),
        pytest.param(1.6, 3.0, 1.6, "link", id="it does not leave less"),
        pytest.param(1.6, 6.0, 0.97, "link", id="it is far behind"),
        pytest.param(1.05, 1.2, 0.97, "link", id="nothing is left"),
        pytest.param(20.0, 30.0, 0.97, "link", id="much is: something else is missing"),
    ],
)
def test_a_curve_where_the_law_acts_is_not_lost_for_its_knots(
    left: float, other: float, closely: float, port: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By 25 knots the curve of a deflection left 3.0 noise powers, that of a load on the link 1.6 by 17; by closer ones 0.97 and 1.5."""
    monkeypatch.setattr(ident.search.knots, "degrees", lambda data: DOF)
    monkeypatch.setattr(ident.search.knots, "reduced_chi2", lambda bench, state: state.left)
    monkeypatch.setattr(
        ident.search.knots,
        "Refit",
        SimpleNamespace(of=lambda state: SimpleNamespace(**vars(state), curve=state.effects[-1])),
    )
    monkeypatch.setattr(
        ident.search.knots, "replace", lambda refit, **new: SimpleNamespace(curve=new["effects"][-1], left=refit.left)
    )

    def fitted(bench: Any, refit: Any) -> Any:
        fine = refit.curve.port == "spring" and len(refit.curve.knots) > len(KNOTS)
        return tried(refit.curve, closely if fine else refit.left).state

    monkeypatch.setattr(ident.search.knots, "fitted", fitted)
    best, behind, name = (
        tried(drawn("link", "torque"), left),
        tried(drawn("spring", "position"), other),
        Backlash(2, (1e-5,)),
    )
    found = drawn_closely(BENCH, best, [best, behind, tried(name, 4.0)])
    assert found.state.effects[-1].port == port
    assert found is not best or port == "link"


def test_a_name_has_no_knots(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ident.search.knots, "reduced_chi2", lambda bench, state: 2.0)
    name = tried(Backlash(2, (1e-5,)), 2.0)
    assert drawn_closely(BENCH, name, [name]) is name
