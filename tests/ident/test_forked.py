"""Work shared out by forking: the same results, in order, errors included."""

from __future__ import annotations

import os

import pytest

from ident.forked import forked


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_items(workers: int) -> None:
    offset = 10  # a closure: what a fresh process would not have
    assert list(forked(lambda x: x + offset, range(7), workers)) == list(range(10, 17))


def test_two_workers_are_other_processes() -> None:
    assert os.getpid() not in list(forked(lambda _: os.getpid(), range(4), 2))
    assert list(forked(lambda _: os.getpid(), range(4), 1)) == [os.getpid()] * 4


def test_an_error_is_raised_here() -> None:
    with pytest.raises(ZeroDivisionError):
        list(forked(lambda x: 1 / x, [1, 0], 2))
