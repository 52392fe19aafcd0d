"""Of which lines an error is told."""

from __future__ import annotations

from math import inf
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ident.search.departures import departures, groups, in_bands
from ident.search.refits import BY_ALL


def test_lines_above_the_last_edge_depart_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing limits the sample rate: what a motor rings with above 1 kHz is not explained."""
    f = np.arange(900.0, 1500.0, 10.0)
    every = np.ones(len(f), dtype=bool)
    scene = SimpleNamespace(lines=np.arange(1, len(f) + 1), arm=SimpleNamespace(live=np.array([0])))
    one: Any = SimpleNamespace(index=0, scene=scene, is_excited=every, use=every, sampling=SimpleNamespace(f=f))
    r = np.where(f >= 1000.0, 100.0, 0.1)[:, None] + 0j
    monkeypatch.setattr("ident.search.departures.replace", lambda problem, **of: problem)
    monkeypatch.setattr(
        "ident.search.departures.held_as", lambda *of: [SimpleNamespace(W=np.ones((len(f), 1, 1)), moved=None)]
    )
    monkeypatch.setattr("ident.search.departures.residual", lambda *of: (r,))
    state: Any = SimpleNamespace(problem=None, minimum=SimpleNamespace(vector=None))
    ((record, joint, band, kind, level, power),) = groups(state, [one])
    assert (record, joint, tuple(band), band.name, kind) == (0, 0, (1000.0, inf), "above 1000 Hz", "excited")
    assert level == pytest.approx(1e4) and power == pytest.approx(50 * 2e4)


def test_every_line_is_in_one_band() -> None:
    f = np.array([0.0, 0.5, 1.0, 99.0, 100.0, 999.9, 1000.0, 4e4])
    assert np.all(np.sum([inside for _, inside in in_bands(f)], axis=0) == 1)
    assert [band.name for band, _ in in_bands(f[1:4])] == ["0-1 Hz", "1-3 Hz", "30-100 Hz"]


@pytest.mark.parametrize(("left", "hurries"), [(0.9 * BY_ALL, False), (1.1 * BY_ALL, True)])
def test_what_far_off_models_leave_is_told_in_a_hurry_once_it_is_late(
    left: float, hurries: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Play that rattles on an arm of six joints: errors of a model that left 60 noise powers took three minutes more than the four given."""
    asked = list[bool]()

    def held_as(state: Any, data: Any, hurries: bool = False) -> tuple[()]:
        asked.append(hurries)
        return ()

    monkeypatch.setattr("ident.search.departures.held_as", held_as)
    monkeypatch.setattr("ident.search.departures.reduced_chi2", lambda bench, state: left)
    monkeypatch.setattr("ident.search.departures.told_of", lambda split, state, data: data)
    monkeypatch.setattr("ident.search.departures.replace", lambda problem, **of: problem)
    bench: Any = SimpleNamespace(split=SimpleNamespace(select=(), report=()))
    state: Any = SimpleNamespace(problem=None, minimum=SimpleNamespace(vector=None))
    assert departures(bench, state) == () and asked == [hurries]
