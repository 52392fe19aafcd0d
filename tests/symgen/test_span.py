"""Spans of rows, on rows whose spans are known."""

from __future__ import annotations

import numpy as np
import pytest

from symgen.span import Growing, coordinates, nested, reached

ROUNDING = 1e-13


def test_a_direction_counts_down_to_the_tolerance() -> None:
    Q = np.linalg.qr(np.random.default_rng(0).normal(size=(6, 6)))[0]
    basis, dropped = reached(np.diag([1, 1e-3, 1e-8, 0, 0, 0]) @ Q)
    assert basis.shape == (6, 3) and not dropped
    basis, dropped = reached(np.diag([1, 1e-3, 1e-10, 0, 0, 0]) @ Q)
    assert basis.shape == (6, 2) and dropped


@pytest.mark.parametrize("weak", [1e-2, 1e-5, 1e-8])
def test_a_direction_poorly_seen_first_and_plainly_later_is_found_within_the_whole(weak: float) -> None:
    """Rounding of 1e-16 of the first rows turns their weak direction by 1e-16 / weak; the spans must not tell."""
    rng = np.random.default_rng(1)
    u, v, w = np.linalg.qr(rng.normal(size=(8, 3)))[0].T
    first = np.array([u + weak * v, u - weak * v, u]) + rng.normal(0, 1e-16, (3, 8))
    second = np.array([u, v, w, v + w])
    whole, _ = reached(np.concatenate([first, second]))
    (inner, outer), dropped = nested([first, second], whole)
    assert (inner.shape[1], outer.shape[1], dropped) == (2, 3, False)
    assert np.abs(inner - outer @ outer.T @ inner).max() <= ROUNDING

    growing = Growing(8)
    order = np.arange(4)
    taken = [
        growing.complete(first, order[:3], inner, exact=False),
        growing.complete(second, order, outer, exact=False),
    ]
    assert [len(rows) for rows in taken] == [2, 1]
    assert np.abs(growing.residual(np.concatenate([first, second]))).max() <= ROUNDING


def test_coordinates_do_not_mind_the_size_of_rows() -> None:
    rng = np.random.default_rng(2)
    W = rng.normal(size=(5, 9)) * np.array([1, 1e-9, 1e3, 1e-5, 1])[:, None]
    rows = (rng.normal(size=(20, 5)) / np.linalg.norm(W, axis=1)) @ W
    assert np.abs(rows @ coordinates(W) @ W - rows).max() <= ROUNDING * np.abs(rows).max()
    assert np.abs(W[:3] @ coordinates(W[:3]) - np.eye(3)).max() <= 1e-13 * 1e12  # entries of any ratio of sizes


def test_rows_in_the_order_preferred_unless_they_reach_little() -> None:
    A = np.array([[1e-4, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 2.0, 0.0], [1.0, 1e-5, 0.0]])
    span = np.eye(3)[:, :2]
    (first, first_part), (second, second_part) = Growing(3).complete(A, np.arange(4), span, exact=False)
    assert (first, first_part, second, second_part) == (1, None, 2, None)
