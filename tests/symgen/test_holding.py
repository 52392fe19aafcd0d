"""Cells as they are run: inside the limits, on round numbers, at rest where it does not matter, where the arm may be."""

from __future__ import annotations

import numpy as np
import pytest
from arms import arm
from chains import build, postures

from symgen.cells import Cells
from symgen.chain import PRISMATIC, REVOLUTE
from symgen.holding import ROUNDING, Holding, box, home


def some(name: str, joints: list[int]) -> Cells:
    return Cells(np.array(joints), postures(arm(name), len(joints)))


def test_a_box_keeps_a_margin_and_the_rest_lies_in_it() -> None:
    limits = np.array([[-3.0, 3.0], [0.5, 0.6], [0.1, 0.1], [-2.0, -1.0]])
    inner = box(limits)
    assert inner[:2] == pytest.approx(np.array([[-2.95, 2.95], [0.505, 0.595]]), abs=1.01 * ROUNDING)
    assert inner[2] == pytest.approx([0.1, 0.1], abs=1e-12)
    assert home(inner) == pytest.approx([0.0, 0.55, 0.1, -1.5], abs=1.01 * ROUNDING)


def test_a_range_that_holds_no_round_number_is_not_left() -> None:
    limits = np.array([[1.00003, 1.00006], [-3.0, 3.0], [-3.0, 3.0]])
    holding = Holding(arm("ypp3"), box(limits), None)
    _, placed = holding.placed(Cells(np.array([0, 2]), np.array([[1.00004, 0.12344, 0.1], [1.00004, 2.0, 0.1]])))
    assert placed.q == pytest.approx(np.array([[1.000045, 0.1234, 0.1], [1.000045, 0.0, 0.0]]), abs=1e-12)


def test_without_a_test_all_cells_may_be_run_and_what_does_not_matter_rests() -> None:
    holding = Holding(arm("ur5"), box(arm("ur5").limits), None)
    cells = some("ur5", [0, 1, 2, 3, 4, 5])
    passed, placed = holding.placed(cells)
    assert passed.all() and holding.keeps(cells).all()
    for k in range(6):
        assert placed.q[k, : k + 1].tolist() == [0.0] * (k + 1)
        turns = (placed.q[k, k + 1 :] - cells.q[k, k + 1 :]) / (2 * np.pi)
        assert np.abs(turns - np.round(turns)).max(initial=0) <= ROUNDING
    assert np.abs(placed.q).max() <= np.pi + ROUNDING, "UR5 turns twice each way; whole turns are taken off"


def test_slides_are_not_turned() -> None:
    chain = build([(REVOLUTE, "generic", "generic"), (PRISMATIC, "generic", "generic")], 0)
    holding = Holding(chain, np.array([[-3.0, 3.0], [-9.0, 9.0]]), None)
    assert holding.placed(Cells(np.array([0]), np.array([[1.0, 7.5]])))[1].q.tolist() == [[0.0, 7.5]]


def test_joints_that_do_not_matter_move_off_rest_only_where_that_helps() -> None:
    allowed = box(arm("ur5").limits)
    cells = some("ur5", [3, 3, 4])
    free = Holding(arm("ur5"), allowed, None).placed(cells)[1]

    at_rest = Holding(arm("ur5"), allowed, lambda q: np.ones(len(q), dtype=bool))
    assert np.array_equal(at_rest.placed(cells)[1].q, free.q)

    own_must_move = Holding(arm("ur5"), allowed, lambda q: np.abs(q[:, 3]) > 0.1)
    passed, placed = own_must_move.placed(cells)
    assert passed.all() and (np.abs(placed.q[:, 3]) > 0.1).all()
    assert np.array_equal(placed.q[:2, [0, 1, 2, 4, 5]], free.q[:2, [0, 1, 2, 4, 5]]), "the excited joint alone first"
    assert np.array_equal(placed.q[2, 4:], np.array([*placed.q[2, 4:5], free.q[2, 5]]))

    base_must_turn = Holding(arm("ur5"), allowed, lambda q: np.abs(q[:, 0]) > 0.1)
    passed, placed = base_must_turn.placed(cells)
    assert passed.all() and np.array_equal(placed.q[:, 5], free.q[:, 5])

    never = Holding(arm("ur5"), allowed, lambda q: q[:, 5] > 99)
    assert not never.placed(cells)[0].any() and not never.keeps(cells).any()


def test_what_is_tested_is_what_is_run() -> None:
    seen: list[np.ndarray] = []

    def note(q: np.ndarray) -> np.ndarray:
        seen.append(q.copy())
        return q[:, 1] > 0

    holding = Holding(arm("ur5"), box(arm("ur5").limits), note)
    passed, placed = holding.placed(some("ur5", [0, 0, 0, 0, 2, 2]))
    holding.keeps(placed)
    assert all(np.abs(q / ROUNDING - np.round(q / ROUNDING)).max() < 1e-6 for q in seen)
    assert np.array_equal(passed, placed.q[:, 1] > 0)
