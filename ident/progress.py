"""How far a command is, on standard error where that is a terminal; never with --json."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def line(options: argparse.Namespace) -> Callable[[str], None]:
    """Returns what says what is being done, each time in place of the last."""
    if _quiet(options):
        return lambda text: None
    return lambda text: print(f"\r\x1b[K{text}"[:200], end="", file=sys.stderr, flush=True)


@contextmanager
def bar(options: argparse.Namespace) -> Iterator[Callable[[int, int], None]]:
    """A bar of records, moved by calls (done, total)."""
    from tqdm import tqdm

    with tqdm(unit="record", disable=_quiet(options), leave=False) as shown:

        def update(done: int, total: int) -> None:
            if shown.total is None:
                shown.reset(total)
                shown.initial = done
            shown.update(done - shown.n)

        yield update


def _quiet(options: argparse.Namespace) -> bool:
    return bool(options.json) or not sys.stderr.isatty()
