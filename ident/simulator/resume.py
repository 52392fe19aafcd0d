"""A simulated campaign that survives anything: every record is a file of its own until all are there.

Beside the campaign file stands a directory, its name with ".partial" added: one campaign file a record, complete or not
there at all, named by what it was made from. Started again, the same request finds them; another one leaves them alone. A campaign
file that is complete says what it was made from, too: the same request takes it as it is.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import symgen.robot
from ident.errors import CampaignError, ExperimentError
from ident.records.campaign import Campaign
from ident.records.store import join_campaigns, made_from, read_campaign, write_campaign
from ident.simulator.bench import Job, check_steps, in_parallel, run

_LIBRARIES = ("mujoco", "numpy", "scipy")
_RECORD = re.compile(r"\d{4,}-[0-9a-f]{16}\.h5")
_BEGUN = re.compile(rf"\.{_RECORD.pattern}\.\d+\.part")
_LOCK = "lock"


@dataclass(frozen=True, eq=False)
class _Task:
    job: Job
    empty: Campaign
    path: Path


def run_to_file(
    jobs: Sequence[Job],
    empty: Campaign,
    path: str | os.PathLike[str],
    *,
    workers: int = 2,
    progress: Callable[[int, int], None] | None = None,
    say: Callable[[str], None] | None = None,
) -> None:
    """Writes the campaign of all `jobs` to `path`; `empty` is the campaign without records (`bench.head`).

    A campaign of the same jobs at `path` is taken as it is, and so are records that an earlier run left in "<path>.partial"; those
    of other jobs are kept there. `path` itself appears only complete, and is then the same, byte for byte, as after a run that
    nothing stopped. `progress(done, total)` is called at the start and after every record, `say` with one line about what was found.
    ExperimentError as in `bench.simulate`, CampaignError where a file can not be written: what is done stays.
    """
    path, tell = Path(path), say or (lambda line: None)
    partial = path.with_name(f"{path.name}.partial")
    tasks = _tasks(jobs, empty, partial)
    source = digest([task.path.name for task in tasks])
    if made_from(path) == source and _sound(path, tell):
        tell(f"{path}: holds the {len(tasks)} records of this request already; they are taken")
        if progress:
            progress(len(tasks), len(tasks))
        return
    check_steps(jobs)
    with _owned(partial):
        _look_at_others(partial, {task.path.name for task in tasks}, tell)
        missing = [task for task in tasks if not _sound(task.path, tell)]
        done = len(tasks) - len(missing)
        if done:
            tell(f"{path}: goes on after {done} of {len(tasks)} records, found in {partial}")
        if progress:
            progress(done, len(tasks))
        try:
            for _ in in_parallel(_do, missing, workers):
                done += 1
                if progress:
                    progress(done, len(tasks))
            join_campaigns([task.path for task in tasks], path, source)
        except CampaignError as error:
            kept = sum(task.path.is_file() for task in tasks)
            raise CampaignError(
                f"{error}; {kept} of {len(tasks)} records are kept in {partial}: the same command goes on there"
            ) from None
        _remove(partial, tasks)


def _remove(partial: Path, tasks: Sequence[_Task]) -> None:
    """Removes the records, and the directory where nothing else is in it."""
    with suppress(OSError):  # what stays does no harm
        for task in tasks:
            task.path.unlink()
        if os.listdir(partial) == [_LOCK]:
            (partial / _LOCK).unlink()
            partial.rmdir()


def _do(task: _Task) -> None:
    write_campaign(replace(task.empty, records=(run(task.job),)), task.path)


def _tasks(jobs: Sequence[Job], empty: Campaign, partial: Path) -> list[_Task]:
    rooms = (Path(__file__).parents[1], Path(symgen.robot.__file__).parent)  # a record is made by the code of both
    program = [source.read_bytes() for room in rooms for source in sorted(room.rglob("*.py"))]
    made_by = [program, [version(library) for library in _LIBRARIES], empty]
    return [_Task(job, empty, partial / f"{job.id}-{digest([made_by, job])[:16]}.h5") for job in jobs]


@contextmanager
def _owned(partial: Path) -> Iterator[None]:
    """The directory of the records, for one process at a time; a killed one does not keep it."""
    try:
        partial.mkdir(exist_ok=True)
        lock = os.open(partial / _LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise CampaignError(f"{partial}: cannot be written: {error.strerror}") from None
    try:
        try:
            import fcntl  # POSIX only; elsewhere two runs at once do the same work twice

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:
            pass
        except OSError:
            raise ExperimentError(f"{partial}: another process is writing there; expected one at a time") from None
        yield
    finally:
        os.close(lock)


def _look_at_others(partial: Path, wanted: set[str], tell: Callable[[str], None]) -> None:
    """Tells of records that another request left, which its command goes on with; removes what was begun and never ended."""
    names = os.listdir(partial)
    if others := sum(name not in wanted and _RECORD.fullmatch(name) is not None for name in names):
        tell(
            f"{partial}: {others} records of another request (arguments, robot or program differ) are kept; its command goes on there, "
            "or remove them"
        )
    for name in names:
        if _BEGUN.fullmatch(name):
            with suppress(OSError):
                (partial / name).unlink()


def _sound(path: Path, tell: Callable[[str], None]) -> bool:
    """Whether the record is there and whole."""
    if not path.exists():
        return False
    if path.is_dir():
        raise CampaignError(f"{path}: a directory, where a record is to be written; remove it")
    try:
        read_campaign(path)
    except CampaignError as error:
        tell(f"{error}: simulated again")
        return False
    return True


def digest(thing: Any) -> str:
    """Returns the SHA-256 [hex] of a tree of dataclasses, arrays and plain values; paths do not count, their texts do.

    TypeError for anything else: what is not understood must not be taken for equal.
    """
    return hashlib.sha256(b"".join(_parts(thing))).hexdigest()


def _parts(thing: Any) -> Iterator[bytes]:
    if isinstance(thing, Path):
        return
    head = f"{type(thing).__name__}:"
    if is_dataclass(thing):
        yield head.encode()
        for field in fields(thing):
            yield f"{field.name}=".encode()
            yield from _parts(getattr(thing, field.name))
    elif isinstance(thing, np.ndarray):
        yield f"{head}{thing.dtype.str}{thing.shape}".encode() + thing.tobytes()
    elif isinstance(thing, np.random.SeedSequence):
        yield f"{head}{thing.entropy},{thing.spawn_key}".encode()
    elif isinstance(thing, Mapping):
        yield from _parts(sorted(thing.items()))
    elif isinstance(thing, tuple | list):
        yield f"{head}{len(thing)}[".encode()
        for item in thing:
            yield from _parts(item)
    elif isinstance(thing, bytes | str | bool | int | float | np.generic | None):
        yield f"{head}{thing!r};".encode()
    else:
        raise TypeError(f"no digest of a {type(thing).__name__}")
