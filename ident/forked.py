"""The same work on many things by several processes that know all that this one knows.

A forked process has closures and classes made on the fly, which a fresh one would have to be sent; only results travel.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

In = TypeVar("In")
Out = TypeVar("Out")


def forked(work: Callable[[In], Out], items: Sequence[In], workers: int) -> Iterator[Out]:
    """Yields work(item) of all `items` in their order, by `workers` processes; by this one where that is enough or all there is.

    Results must pickle. An error of `work` is raised here, at its item.
    """
    workers = min(workers, len(items))
    if (
        workers <= 1
        or "fork" not in multiprocessing.get_all_start_methods()
        or multiprocessing.current_process().daemon
    ):
        yield from map(work, items)
        return
    fork = multiprocessing.get_context("fork")
    with fork.Pool(workers, initializer=_start, initargs=(work, items)) as pool:
        yield from pool.imap(_one, range(len(items)))


_started: dict[str, Any] = {}


def _start(work: Callable[[Any], Any], items: Sequence[Any]) -> None:
    """What a worker does and to what, handed over by the fork."""
    _started.update(work=work, items=items)


def _one(k: int) -> Any:
    return _started["work"](_started["items"][k])
