"""Work shared out by forking: the same results, in order, errors included."""

from __future__ import annotations

import os
import signal

import pytest

from symgen.forked import beside, forked, standing


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_items(workers: int) -> None:
    offset = 10  # a closure: what a fresh process would not have
    assert list(forked(lambda x: x + offset, range(7), workers)) == list(range(10, 17))


def test_two_workers_are_other_processes() -> None:
    assert os.getpid() not in list(forked(lambda _: os.getpid(), range(4), 2))
    assert list(forked(lambda _: os.getpid(), range(4), 1)) == [os.getpid()] * 4


def test_an_interrupt_is_for_the_process_that_asks() -> None:
    """Else each worker prints where it was."""
    assert list(forked(lambda _: signal.getsignal(signal.SIGINT), range(2), 2)) == [signal.SIG_IGN] * 2


def test_an_error_is_raised_here() -> None:
    with pytest.raises(ZeroDivisionError):
        list(forked(lambda x: 1 / x, [1, 0], 2))


def test_standing_shares_work_at_once_and_remember() -> None:
    seen: list[list[int]] = [[], []]

    def work(k: int, x: int) -> tuple[int, list[int]]:
        seen[k].append(x)
        return os.getpid(), list(seen[k])

    with standing(work, 2) as ask:
        ask(1)
        (here, mine), (there, other) = ask(2)
    assert here == os.getpid() != there
    assert mine == other == [1, 2]
    assert seen == [[1, 2], []]  # what the other share keeps is its own


def test_an_error_of_a_standing_share_is_raised_here() -> None:
    with pytest.raises(ZeroDivisionError), standing(lambda k, x: x / (1 - k), 2) as ask:
        ask(1)


def test_a_worker_has_all_shares_itself() -> None:
    def work(item: int) -> bool:
        with standing(lambda k, x: os.getpid(), 2) as ask:
            return set(ask(item)) == {os.getpid()}

    assert list(forked(work, range(2), 2)) == [True, True]


def test_two_things_at_once_are_done_here_and_there() -> None:
    counts = {"here": 0, "there": 0}

    def count(name: str) -> int:
        counts[name] += 1
        return os.getpid()

    here, there = beside(lambda: count("here"), lambda: count("there"))
    assert here == os.getpid() != there
    assert counts == {"here": 1, "there": 0}, "what the other process changed is its own"
    with pytest.raises(ZeroDivisionError):
        beside(lambda: 1, lambda: 1 / 0)
