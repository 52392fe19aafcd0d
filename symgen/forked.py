"""The same work on many things by several processes that know all that this one knows.

A forked process has closures and classes made on the fly, which a fresh one would have to be sent; only what is asked of it
and results travel.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any, TypeVar, cast

#: Processes of a command, at most: each needs a few hundred MB.
WORKERS = min(os.cpu_count() or 1, 8)

In = TypeVar("In")
Out = TypeVar("Out")


def forked(work: Callable[[In], Out], items: Sequence[In], workers: int) -> Iterator[Out]:
    """Yields work(item) of all `items` in their order, by `workers` processes; by this one where that is enough or all there is.

    Results must pickle. An error of `work` is raised here, at its item.
    """
    workers = min(workers, len(items))
    if workers <= 1 or not _can_fork():
        yield from map(work, items)
        return
    fork = multiprocessing.get_context("fork")
    with fork.Pool(workers, initializer=_start, initargs=(work, items)) as pool:
        yield from pool.imap(_one, range(len(items)))


_started: dict[str, Any] = {}


def _start(work: Callable[[Any], Any], items: Sequence[Any]) -> None:
    """What a worker does and to what, handed over by the fork; an interrupt is for the process that asks."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _started.update(work=work, items=items)


def _one(k: int) -> Any:
    return _started["work"](_started["items"][k])


@contextmanager
def standing(work: Callable[[int, In], Out], shares: int) -> Iterator[Callable[[In], list[Out]]]:
    """A function that asks all shares of a work at once: ask(x) is [work(0, x), work(1, x), ...].

    Share 0 is worked on here, every other by a process that stands until the end and keeps what its work has kept; all are
    here where processes can not be forked. An error of `work` is raised by ask, after which nothing more can be asked.
    """
    if shares <= 1 or not _can_fork():
        yield lambda asked: [work(k, asked) for k in range(shares)]
        return
    fork = multiprocessing.get_context("fork")
    ends: list[Connection] = []
    processes = []
    for k in range(1, shares):
        here, there = fork.Pipe()
        process = fork.Process(target=_stand, args=(work, k, there, [here, *ends]), daemon=True)
        process.start()
        there.close()
        ends.append(here)
        processes.append(process)

    def ask(asked: In) -> list[Out]:
        for end in ends:
            end.send(asked)
        answers = [work(0, asked)]
        for end in ends:
            answer, error = end.recv()
            if error is not None:
                raise error
            answers.append(answer)
        return answers

    try:
        yield ask
    finally:
        for end in ends:
            end.close()
        for process in processes:
            process.terminate()
            process.join()


def beside(here: Callable[[], In], there: Callable[[], Out]) -> tuple[In, Out]:
    """Returns (here(), there()), the second found by a process of its own; what it changes is lost."""

    def work(k: int, _: None) -> In | Out:
        return here() if k == 0 else there()

    with standing(work, 2) as ask:
        one, other = ask(None)
    return cast(In, one), cast(Out, other)


def _stand(work: Callable[[int, Any], Any], k: int, end: Connection, others: Sequence[Connection]) -> None:
    """Answers until the other end is closed; `others` are the ends of those who ask, which the fork has left open here."""
    for other in others:
        other.close()
    while True:
        try:
            asked = end.recv()
        except (EOFError, KeyboardInterrupt):
            return
        try:
            end.send((work(k, asked), None))
        except KeyboardInterrupt:
            return
        except Exception as error:  # noqa: BLE001 (whatever it is, it is the asking process's)
            end.send((None, error))


def _can_fork() -> bool:
    """Whether this process may have others of its kind: a worker may not."""
    return "fork" in multiprocessing.get_all_start_methods() and not multiprocessing.current_process().daemon
