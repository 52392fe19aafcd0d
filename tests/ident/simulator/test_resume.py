"""A campaign that is killed, runs out of disk or finds other records: what is done stays, and the result is the same file."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from once import once

import ident.records.store
from ident.cli import main
from ident.effects.catalogue import parse
from ident.errors import CampaignError, ExperimentError
from ident.records.campaign import Campaign
from ident.records.store import join_campaigns, read_campaign, write_campaign
from ident.simulator.bench import Job, design, head, run, simulate
from ident.simulator.resume import digest, run_to_file
from symgen.robot import Experiment, load_robot
from symgen.urdf import load_chain

ROBOT = replace(
    load_robot(Path(__file__).parents[3] / "robots" / "ypp3"),
    experiment=Experiment(f0=2.0, band=(2.0, 120.0), periods=3, swing=0.002),
)
YPP = load_chain(ROBOT.urdf)
CELLS = [("joint3", [0.0, 0.4, 0.1]), ("joint1", [0.0, 0.4, 0.1]), ("joint2", [0.2, 0.5, -0.9])]
EMPTY = head(YPP, ROBOT, ())


@cache
def jobs(seed: int = 0) -> tuple[Job, ...]:
    return design(YPP, ROBOT, CELLS, seed=seed)


@pytest.fixture(scope="module", autouse=True)
def simulated_once() -> Iterator[None]:
    """By this process; workers, and whoever is killed, simulate anew."""
    with once("ident.simulator.resume.run", run, digest):
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The file of a run that nothing stopped."""
    path = tmp_path_factory.mktemp("whole") / "c.h5"
    run_to_file(jobs(), EMPTY, path, workers=1)
    assert os.listdir(path.parent) == ["c.h5"]
    return path.read_bytes()


class Killed(BaseException):
    """Nobody catches this, as nobody catches kill -9."""


def stopped_after(count: int, path: Path, seed: int = 0) -> None:
    def stop(done: int, total: int) -> None:
        if done == count:
            raise Killed

    with pytest.raises(Killed):
        run_to_file(jobs(seed), EMPTY, path, workers=1, progress=stop)


def same(one: Campaign, two: Campaign) -> bool:
    return digest(one) == digest(two)


def test_the_file_is_what_simulate_returns(whole: bytes, tmp_path: Path) -> None:
    (tmp_path / "c.h5").write_bytes(whole)
    assert same(read_campaign(tmp_path / "c.h5"), simulate(YPP, ROBOT, CELLS, workers=1))


@pytest.mark.parametrize(("count", "workers"), [(0, 1), (1, 2), (2, 1), (3, 1)])
def test_it_goes_on_at_the_next_record(count: int, workers: int, whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "c.h5"
    stopped_after(count, path)
    assert not path.exists()
    for record in sorted((tmp_path / "c.h5.partial").glob("*.h5")):
        assert len(read_campaign(record).records) == 1, "a record is a campaign of its own"
    said: list[str] = []
    seen: list[tuple[int, int]] = []
    run_to_file(jobs(), EMPTY, path, workers=workers, progress=lambda *now: seen.append(now), say=said.append)
    assert seen == [(k, 3) for k in range(count, 4)]
    assert path.read_bytes() == whole
    assert len(said) == (count > 0) and all(f"goes on after {count} of 3 records" in line for line in said)
    assert os.listdir(tmp_path) == ["c.h5"]


def test_kill_9_at_any_moment(whole: bytes, tmp_path: Path) -> None:
    """The real signal, in the middle of a record and of a write, workers and all."""
    script = "import sys; sys.path[:0] = sys.argv[1:]; from test_resume import *\n"
    script += "if __name__ == '__main__': run_to_file(jobs(), EMPTY, 'c.h5')"
    (tmp_path / "run.py").write_text(script)
    paths = [Path(__file__).parent, Path(__file__).parents[1]]
    process = subprocess.Popen([sys.executable, "run.py", *paths], cwd=tmp_path, start_new_session=True)
    partial = tmp_path / "c.h5.partial"
    while process.poll() is None and not list(partial.glob("0*.h5")):
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    left = sorted(partial.glob("0*.h5"))
    assert left and not (tmp_path / "c.h5").exists()
    deadline = time.monotonic() + 10
    while _group_lives(process.pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not _group_lives(process.pid), "workers end with their parent"
    for path in left:
        read_campaign(path)
    run_to_file(jobs(), EMPTY, tmp_path / "c.h5", workers=1)
    assert (tmp_path / "c.h5").read_bytes() == whole


def _group_lives(group: int) -> bool:
    """Whether a process of the group still runs; a zombie that nobody has waited for does not."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, pgrp = stat.read_text().rpartition(")")[2].split()[:3]
        except OSError:
            continue
        if int(pgrp) == group and state != "Z":
            return True
    return False


def test_records_of_another_request_are_kept_for_it(whole: bytes, tmp_path: Path) -> None:
    """A mistyped seed costs nothing: neither its records nor what a person put beside them is removed."""
    path, said = tmp_path / "c.h5", list[str]()
    partial = path.with_name("c.h5.partial")
    stopped_after(2, path, seed=1)
    theirs = {record.name: record.read_bytes() for record in partial.glob("0*.h5")}
    (partial / "mine.txt").write_text("not ours to remove")
    run_to_file(jobs(), EMPTY, path, workers=1, say=said.append)
    assert said == [
        f"{partial}: 2 records of another request (arguments, robot or program differ) are kept; its command goes on there, or remove them"
    ]
    assert path.read_bytes() == whole
    assert {record.name: record.read_bytes() for record in partial.glob("0*.h5")} == theirs
    assert (partial / "mine.txt").read_text() == "not ours to remove"
    said.clear()
    run_to_file(jobs(1), EMPTY, path, workers=1, say=said.append)
    assert said == [f"{path}: goes on after 2 of 3 records, found in {partial}"]
    assert sorted(os.listdir(partial)) == ["lock", "mine.txt"]


def test_a_finished_campaign_is_taken_as_it_is(whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was killed while fitting has its records; another request, or a damaged file, is simulated."""
    path, said, seen = tmp_path / "c.h5", list[str](), list[tuple[int, int]]()
    path.write_bytes(whole)
    with monkeypatch.context() as patch:
        patch.setattr("ident.simulator.resume.in_parallel", lambda *_: pytest.fail("simulated again"))
        run_to_file(jobs(), EMPTY, path, workers=1, progress=lambda *now: seen.append(now), say=said.append)
    assert said == [f"{path}: holds the 3 records of this request already; they are taken"] and seen == [(3, 3)]
    assert path.read_bytes() == whole and os.listdir(tmp_path) == ["c.h5"]
    said.clear()
    data = bytearray(whole)
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    run_to_file(jobs(), EMPTY, path, workers=1, say=said.append)
    assert path.read_bytes() == whole and len(said) == 1 and "damaged" in said[0] and "simulated again" in said[0]
    run_to_file(jobs(1), EMPTY, path, workers=1)
    assert path.read_bytes() != whole


def test_a_part_that_is_cut_off_before_it_is_joined_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "c.h5"

    def cut(done: int, total: int) -> None:
        if done == total:
            record = max(path.with_name("c.h5.partial").glob("0*.h5"))
            record.write_bytes(record.read_bytes()[:5000])

    with pytest.raises(
        CampaignError, match=r"0003-\w+\.h5: damaged: .*; 3 of 3 records are kept in .*partial"
    ) as error:
        run_to_file(jobs(), EMPTY, path, workers=1, progress=cut)
    assert "\n" not in str(error.value) and not path.exists()


def test_a_directory_named_like_a_record_is_one_line(tmp_path: Path) -> None:
    """Of this request, and of another one."""
    path, said = tmp_path / "c.h5", list[str]()
    partial = path.with_name("c.h5.partial")
    stopped_after(1, path)
    (record,) = partial.glob("0*.h5")
    (partial / "0007-0123456789abcdef.h5").mkdir()
    (partial / ".0007-0123456789abcdef.h5.12.part").mkdir()
    data = record.read_bytes()
    record.unlink()
    record.mkdir()
    with pytest.raises(CampaignError, match=r"0001-\w+\.h5: a directory, where a record is to be written; remove it$"):
        run_to_file(jobs(), EMPTY, path, workers=1)
    record.rmdir()
    record.write_bytes(data)
    run_to_file(jobs(), EMPTY, path, workers=1, say=said.append)
    assert len(read_campaign(path).records) == 3 and f"{path}: goes on after 1 of 3 records, found in {partial}" in said


def test_drives_that_can_not_be_followed_are_found_before_the_first_record(tmp_path: Path) -> None:
    """Only the last record has them."""
    first, *_, last = jobs()
    stiff = replace(last, drives=tuple(replace(drive, K=1e13) for drive in last.drives))
    with pytest.raises(ExperimentError, match="'joint2' at posture .* steps of the integrator a sample, at most 1000"):
        run_to_file((first, stiff), EMPTY, tmp_path / "c.h5", workers=1)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("source", ["ident/simulator/bench.py", "symgen/robot.py"])
def test_records_of_another_program_are_not_taken(
    source: str, whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, said, read = tmp_path / "c.h5", list[str](), Path.read_bytes
    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_bytes", lambda self: read(self) + b"#" * self.as_posix().endswith(source))
        stopped_after(1, path)
    run_to_file(jobs(), EMPTY, path, workers=1, say=said.append)
    assert len(said) == 1 and "1 records of another request (arguments, robot or program differ) are kept" in said[0]
    assert path.read_bytes() == whole


def test_a_damaged_record_is_simulated_again(whole: bytes, tmp_path: Path) -> None:
    path, said = tmp_path / "c.h5", list[str]()
    stopped_after(2, path)
    record = sorted(path.with_name("c.h5.partial").glob("0*.h5"))[1]
    data = bytearray(record.read_bytes())
    data[len(data) // 2] ^= 1
    record.write_bytes(data)
    run_to_file(jobs(), EMPTY, path, workers=1, say=said.append)
    assert any("damaged" in line and "simulated again" in line for line in said)
    assert path.read_bytes() == whole


@pytest.fixture
def small_disk() -> Iterator[None]:
    """No file may grow beyond 150 kB: the second of the records, of 168 kB, or the file of all of them."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.usefixtures("small_disk")
def test_a_file_too_large_for_its_disk(tmp_path: Path) -> None:
    path = tmp_path / "c.h5"
    with pytest.raises(CampaignError, match=r"cannot be written: File too large; . of 3 records are kept in .*partial"):
        run_to_file(jobs(), EMPTY, path, workers=1)
    assert not path.exists() and not list(tmp_path.rglob("*.part"))


def test_a_full_disk_is_one_line_and_what_is_done_stays(
    whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, room, sync = tmp_path / "c.h5", [2], os.fsync

    def full(handle: int) -> None:
        room[0] -= 1
        if room[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(handle)

    with monkeypatch.context() as patch:
        patch.setattr(ident.records.store.os, "fsync", full)
        with pytest.raises(CampaignError, match="No space left on device; 1 of 3 records are kept") as error:
            run_to_file(jobs(), EMPTY, path, workers=1)
    assert "\n" not in str(error.value)
    run_to_file(jobs(), EMPTY, path, workers=1)
    assert path.read_bytes() == whole


def test_one_process_at_a_time(tmp_path: Path) -> None:
    path, refused = tmp_path / "c.h5", list[str]()

    def again(done: int, total: int) -> None:
        if not refused:
            with pytest.raises(ExperimentError) as error:
                run_to_file(jobs(), EMPTY, path, workers=1)
            refused.append(str(error.value))

    run_to_file(jobs()[:1], EMPTY, path, workers=1, progress=again)
    assert refused == [f"{path}.partial: another process is writing there; expected one at a time"]


def test_a_place_that_can_not_be_written(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="cannot be written: No such file or directory"):
        run_to_file(jobs(), EMPTY, tmp_path / "nowhere" / "c.h5", workers=1)


def test_the_digest_tells_every_difference_that_matters() -> None:
    first, other = jobs()[0], jobs(1)[0]
    assert digest(first) == digest(jobs()[0]) != digest(other)
    assert digest(first) == digest(replace(first, robot=replace(ROBOT, path=Path("elsewhere"))))
    changed = [
        replace(first, steps=3),
        replace(first, id="0002"),
        replace(first, effects=(parse("motor-coulomb:level=0.01@joint1", first.drives),)),
        replace(first, effects=(parse("motor-coulomb:level=0.02@joint1", first.drives),)),
        replace(first, robot=replace(ROBOT, gravity=np.zeros(3))),
        replace(first, drives=(replace(first.drives[0], D=0.0), *first.drives[1:])),
        replace(first, setup=replace(first.setup, posture=np.nextafter(first.setup.posture, 1))),
    ]
    assert len({digest(job) for job in (first, other, *changed)}) == 2 + len(changed)
    with pytest.raises(TypeError, match="no digest of a object"):
        digest([object()])


def test_joined_campaigns_are_the_campaign(tmp_path: Path) -> None:
    campaign = simulate(YPP, ROBOT, CELLS[:2], workers=1)
    parts = [tmp_path / record.id for record in campaign.records]
    for part, record in zip(parts, campaign.records, strict=True):
        write_campaign(replace(campaign, records=(record,)), part)
    join_campaigns(parts, tmp_path / "all.h5")
    assert same(read_campaign(tmp_path / "all.h5"), campaign)


def test_a_campaign_that_is_replaced_while_it_is_read_is_no_result(
    whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By a second command at the same place: a result tells the hash of what it was made of, or there is none."""
    path, other = tmp_path / "c.h5", tmp_path / "other.h5"
    for one in (path, other):
        one.write_bytes(whole)

    def read(file: Path) -> Campaign:
        found = read_campaign(file)
        os.replace(other, file)
        return found

    monkeypatch.setattr("ident.records.store.read_campaign", read)
    assert main(["fit", str(path), "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"{path}: was replaced while it was read" in error
    assert not (tmp_path / "out").exists()
