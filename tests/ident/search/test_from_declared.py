"""Which names are tried from the declared arm, by stand-ins: a model is what it leaves."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

import ident.search.finer
import ident.search.from_declared
from ident.effects.base import Effect
from ident.effects.motor import InputDelay, TorqueLag
from ident.effects.sensor import JointZeroOffset
from ident.effects.spring import Backlash, SpringHardening
from ident.search.candidates import Candidate
from ident.search.choice import Tried
from ident.search.from_declared import from_declared, tried_bending

DOF = 1000
LAG, DELAY = TorqueLag(0, (1e-3,)), InputDelay(0, (1e-3,))
ZERO = JointZeroOffset(1, (0.1,))
HARD, PLAY = SpringHardening(0, (1e7,)), Backlash(0, (1e-3,))


@pytest.mark.parametrize(
    ("lag", "finely", "tried"),
    [
        (0.95, 0.95, [LAG, DELAY]),
        (26.0, 0.95, [LAG, DELAY]),  # which it leaves in haste only
        (26.0, 7.0, [LAG, DELAY, HARD, PLAY]),
        (900.0, 0.95, [LAG, DELAY, HARD, PLAY]),  # too much to be looked at more finely
    ],
)
def test_what_is_fitted_at_once_comes_first_whatever_others_promise(
    lag: float, finely: float, tried: list[Effect], monkeypatch: pytest.MonkeyPatch
) -> None:
    promised = {HARD: 4e7, PLAY: 3e7, LAG: 9e6, DELAY: 8e6}
    left = {HARD: 1000.0, PLAY: 1000.0, LAG: lag, DELAY: 1700.0}

    def state(effect: Effect | None, level: float) -> Any:
        return SimpleNamespace(select=level * DOF, effects=(effect,) * (effect is not None), problem=None)

    stand_ins = {
        "degrees": lambda data: DOF,
        "reduced_chi2": lambda bench, model: model.select / DOF,
        "as_declared": lambda bench, model: None,
        "linearised": lambda problem, vector: None,
        "catalogue": lambda lin, effects, workers: [Candidate(e, gain, (1.0,)) for e, gain in promised.items()],
        "nearer": lambda lin, candidate: candidate,
        "larger": lambda candidate, times: Candidate(PLAY, 0.0, ()),
        "refitted": lambda bench, model, short: [Tried(c, state(c.effect, left[c.effect])) for c, _ in short],
        "tried_bending": lambda *of: [],
        "as_it_creeps": lambda bench, found, near: found,
        "as_it_winds": lambda bench, found, near: found,
    }
    for key, stand_in in stand_ins.items():
        monkeypatch.setattr(ident.search.from_declared, key, stand_in)
    monkeypatch.setattr(ident.search.finer, "finer", lambda bench, model: state(model.effects[0], finely))
    bench: Any = SimpleNamespace(workers=1, only_names=False, split=SimpleNamespace(select=()))
    found = from_declared(bench, state(None, 3000.0), None)
    assert list(dict.fromkeys(one.candidate.effect for one in found)) == tried
    # where general links explain alone, a zero that is off is looked at whatever it promises, finely if it leaves less than there was
    promised[ZERO], left[ZERO], left[LAG] = 1e5, 1100.0, 1200.0
    bench.only_names = True
    first = [one.candidate.effect for one in from_declared(bench, state(None, 3000.0), None)][:3]
    assert first == [LAG, DELAY, ZERO]
    assert from_declared(bench, state(None, 3000.0), None)[2].state.select == finely * DOF


@pytest.mark.parametrize("only_names", [False, True])
def test_what_promises_nothing_is_not_tried_where_only_names_are_wanted(
    only_names: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    likely = [Candidate(HARD, 0.0, ()), Candidate(PLAY, 0.0, ())]
    monkeypatch.setattr(ident.search.from_declared, "bending", lambda lin, effects: likely)
    monkeypatch.setattr(ident.search.from_declared, "by_few_lines", lambda bench, state, lin, few: few)
    bench, state, lin = SimpleNamespace(only_names=only_names), SimpleNamespace(effects=()), None
    tried: Any = tried_bending(bench, state, lin, lambda effect: effect is PLAY)  # type: ignore[arg-type]
    assert tried == ([] if only_names else likely[1:])
