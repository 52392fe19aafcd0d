"""What a user may get wrong, at the commands themselves: exit status 2, one line that says where and what, nothing left."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import FrameType

import h5py
import numpy as np
import pytest
from undrawn import undrawn

import ident.cli
import symgen.cli
from ident.records.campaign import Campaign, Record
from ident.records.store import write_campaign
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot, make_plan
from symgen.robot import Experiment, load_robot

YPP3 = Path(__file__).parents[2] / "robots/ypp3"
URDF, TOML = (YPP3 / "ypp3.urdf").read_text(), (YPP3 / "robot.toml").read_text()
BODY = re.compile("<inertial>.*?</inertial>", re.DOTALL)

#: Where only the end of a run matters.
BRIEF = ("--spare", "0", "--no-verify", "--no-feasible")

Main = Callable[[list[str]], int]
Bench = Callable[..., str]


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Bench:
    """Runs a command in `tmp_path` and returns the line it was refused with."""
    monkeypatch.chdir(tmp_path)
    capfd.readouterr()

    def run(main: Main, *arguments: str | Path, seconds: int = 10) -> str:
        before = _tree(tmp_path)

        def ring(signum: int, frame: FrameType | None) -> None:
            pytest.fail(f"no end after {seconds} s")

        ringing = signal.signal(signal.SIGALRM, ring)
        signal.alarm(seconds)
        try:
            status: object = main([str(argument) for argument in arguments])
        except SystemExit as exit:
            status = exit.code
        finally:
            signal.alarm(0)
            signal.signal(signal.SIGALRM, ringing)
        out, err = capfd.readouterr()
        assert status == 2
        assert out == ""
        assert _tree(tmp_path) == before, "something was written, changed or left"
        lines = err.splitlines()
        if lines[0].startswith("usage: "):  # argparse: how to call it, then what was wrong
            lines = lines[-1:]
        assert len(lines) == 1 and len(err) < 1500, err
        assert lines[0].startswith(main.__module__.partition(".")[0])
        return lines[0]

    return run


def _tree(folder: Path) -> dict[str, bytes | None]:
    return {str(path): path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


def replaced(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


# symgen --------------------------------------------------------------------------------------------------------------

FILES = {
    "truncated": (URDF[:2000], "arm.urdf: not well-formed XML"),
    "no XML": ("robot: arm", "arm.urdf: not well-formed XML"),
    "empty": ("", "arm.urdf: empty; expected a <robot> element"),
    "no inertia": (BODY.sub("", URDF), "arm.urdf: no link has an <inertial>; expected the mass and inertia"),
    "massless link": (replaced(URDF, 'mass value="7.4"', 'mass value="0"'), "arm.urdf: link 'link2' .*massless.* mass > 0"),
    "negative mass": (replaced(URDF, 'mass value="7.4"', 'mass value="-1"'), "'link2': <inertial> mass: found -1, expected"),
    "no rigid body": (replaced(URDF, 'ixx="0.03009"', 'ixx="0.9"'), "link 'link2': .* 0.9 kg m2 are those of no rigid body"),
    "NaN": (replaced(URDF, 'xyz="0 0.35 0"', 'xyz="0 nan 0"'), "'joint3': <origin> xyz: found 'nan', expected a finite"),
    "a kilometre": (replaced(URDF, 'xyz="0 0.35 0"', 'xyz="0 350000 0"'), "'joint3': <origin> xyz: .* expected at most 1000"),
    "another format": ("<sdf/>", "arm.urdf: root element <sdf>; expected <robot>"),
    "a web page": ("<!DOCTYPE html><html/>", "arm.urdf: a DOCTYPE is not allowed"),
    "circle": (replaced(URDF, 'parent link="base_link"', 'parent link="link3"'), "arm.urdf: .* circle through link"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "expected"), FILES.values(), ids=FILES)
def test_symgen_refuses_a_bad_urdf_and_leaves_nothing(content: str, expected: str, refused: Bench) -> None:
    Path("arm.urdf").write_text(content)
    assert re.search(expected, refused(symgen.cli.main, "arm.urdf", "-o", "out"))


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("nowhere.urdf", "nowhere.urdf: no such file; expected a URDF file"),
        (".", "a directory; expected a URDF file"),
        ("/dev/null", "not a regular file; expected a URDF file"),
        ("a\0b", "no such file"),
        pytest.param("a\nb", "no such file"),
    ],
)  # fmt: skip
def test_symgen_refuses_what_is_no_file(path: str, expected: str, refused: Bench) -> None:
    assert expected in refused(symgen.cli.main, path, "-o", "out")


FLAGS = [
    (["--at", "joint1"], "--at 'joint1': expected NAME=VALUE"),
    (["--at", "joint1=wide"], "--at 'joint1=wide': found 'wide', expected a finite number"),
    (["--at", "joint1=nan"], "--at 'joint1=nan': found 'nan', expected a finite number"),
    (["--at", "joint1=1_0"], "--at 'joint1=1_0': found '1_0', expected a finite number"),
    (["--at", "joint1=1e999"], "--at 'joint1=1e999': found '1e999', expected at most 1e+06"),
    (["--at", "joint1=0,joint1=1"], "'joint1' stands there twice"),
    (["--at", ""], "argument --at: empty"),
    (["-o", ""], "argument -o: empty"),
    (["--at", "joint9=0"], "at: no moving joint 'joint9'; moving joints are 'joint1', 'joint2', 'joint3'"),
    (["--at", "joint2=9"], "at: 'joint2' = 9; expected a value within the joint's limits [-2.6, 2.6]"),
    (["--at", ",;="], "expected NAME=VALUE"),
    (["--at", "joint\n1=0"], "at: no moving joint 'joint\\n1'"),
    (["--at", "joint1=0,joint2=0,joint3=0"], "no moving joint from 'base_link' to 'link3'"),
    (["--base", "nowhere"], "base link 'nowhere' does not exist; links are 'base_link'"),
    (["--tip", "link\n1"], "tip link 'link\\n1' does not exist"),
    (["--tip", "link1", "--base", "link3"], "tip link 'link1' is not behind base link 'link3'"),
    (["--spare", "-1"], "--spare -1: expected 0 or more"),
    (["--spare", "some"], "argument --spare: invalid int value: 'some'"),
    (["--bogus"], "unrecognized arguments: --bogus"),
    (["another.urdf"], "unrecognized arguments: another.urdf"),
]


@pytest.mark.parametrize(("flags", "expected"), FLAGS)
def test_symgen_refuses_flags_that_can_not_be_met(flags: list[str], expected: str, refused: Bench) -> None:
    assert expected in refused(symgen.cli.main, YPP3 / "ypp3.urdf", "-o", "out", *flags)


def test_symgen_refuses_a_million_spare_cells(refused: Bench) -> None:
    assert "--spare" in refused(symgen.cli.main, YPP3 / "ypp3.urdf", "--spare", "1000000", seconds=1)


@pytest.mark.parametrize(
    ("out", "expected"),
    [
        ("file", "file: a file; expected a directory"),
        ("file/sub", "file"),
        ("/proc/out", "/proc"),
        ("x" * 300, "File name too long"),
        pytest.param("a\0b", "-o"),
    ],
)
def test_symgen_refuses_an_output_that_can_not_be(out: str, expected: str, refused: Bench) -> None:
    Path("file").write_text("kept")
    assert expected in refused(symgen.cli.main, YPP3 / "ypp3.urdf", "-o", out, *BRIEF)


@pytest.mark.parametrize(
    "blocked",
    [
        "plan.json",
        pytest.param("symgen_ypp3.h"),
    ],
)
def test_symgen_changes_all_of_its_output_or_nothing(blocked: str, refused: Bench) -> None:
    Path("out", blocked).mkdir(parents=True)
    assert blocked in refused(symgen.cli.main, YPP3 / "ypp3.urdf", "-o", "out", *BRIEF)


def test_symgen_leaves_nothing_on_a_full_disk(refused: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, *_: object, **__: object) -> int:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(Path, "write_text", full)
    assert "No space left on device" in refused(symgen.cli.main, YPP3 / "ypp3.urdf", "-o", "out", *BRIEF)
    assert "No space left on device" in refused(symgen.cli.main, YPP3 / "ypp3.urdf", "-o", "new/and/new", *BRIEF)


def test_an_error_that_names_no_file_is_told_by_itself(refused: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("symgen.output.write_all", full)
    assert refused(symgen.cli.main, YPP3 / "ypp3.urdf", "-o", "out", *BRIEF) == "symgen: No space left on device"


def test_symgen_writes_nothing_beside_its_directory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """DIR may be another file system, and its parent not ours to write in."""
    (tmp_path / "out").mkdir()
    before = os.stat(tmp_path).st_mtime_ns
    assert symgen.cli.main([str(YPP3 / "ypp3.urdf"), "-o", str(tmp_path / "out"), *BRIEF]) == 0
    assert os.stat(tmp_path).st_mtime_ns == before
    assert not [path for path in (tmp_path / "out").iterdir() if path.name.startswith(".")]


def test_names_that_can_not_be_shown_or_encoded_are_replaced(tmp_path: Path) -> None:
    """A file name of bytes that are no UTF-8, a robot without a name, a joint with an umlaut, a terminal that knows ASCII."""
    urdf, out = tmp_path / "arm\udcff.urdf", tmp_path / "out\udcff"
    urdf.write_text(URDF.replace('<robot name="ypp3">', "<robot>").replace("joint2", "gelenk_ä"), encoding="utf-8")
    command = [sys.executable, "-m", "symgen.cli", str(urdf), "-o", str(out), *BRIEF, "--draft"]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    for json_or_not in ([], ["--json"]):
        done = subprocess.run([*command, *json_or_not], env=environment, capture_output=True, timeout=60, check=False)
        assert (done.returncode, done.stderr) == (0, b"")
        assert (b"gelenk_\\xe4" in done.stdout) == (not json_or_not)
    document = json.loads(done.stdout)
    assert (document["robot"], document["joints"][1]) == ("arm?", "gelenk_ä")
    assert document["files"][0] == f"{out}/plan.json"
    assert json.loads((out / "plan.json").read_text(encoding="utf-8"))["joints"][1] == "gelenk_ä"


# robot.toml, by both commands ----------------------------------------------------------------------------------------

SETTINGS = {
    "unknown key": (TOML + "colour = 1\n", r"robot.toml: \[joint.joint3\]: unknown key 'colour'; expected N, K_Nm_per_rad"),
    "no unit": (replaced(TOML, "K_Nm_per_rad", "K"), r"\[joint.joint1\]: unknown key 'K'; expected K_Nm_per_rad"),
    "missing key": (replaced(TOML, "N = 100\n", ""), r"\[joint.joint1\]: key 'N' is missing"),
    "wrong type": (replaced(TOML, "N = 100", 'N = "100"'), r"\[joint.joint1\]: N: found '100', expected a number"),
    "NaN": (replaced(TOML, "= 5500", "= nan"), r"\[joint.joint1\]: K_Nm_per_rad: found nan, expected a number > 0"),
    "not TOML": (TOML.replace("[robot]", "[robot"), "robot.toml: not TOML: .*line 1"),
    "empty": ("", "robot.toml: key 'robot' is missing"),
    "no drive": (TOML.replace("joint.joint3", "joint.elbow"), "robot.toml: joint 'joint3' has no .* table; .*elbow"),
    "other unit": (re.sub("K_Nm_per_rad(.*)\nD(.*)\nD_spring_Nms_per_rad", r"K_N_per_m\1\nD\2\nD_spring_Ns_per_m", TOML.replace("N = 100", "N_rad_per_m = 100")), r"\[joint.joint1\]: the URDF says revolute; expected"),
    "drive of no joint": (TOML + TOML[TOML.index("[joint.joint3]"):].replace("joint3", "joint_3"), r"\[joint.joint_3\]: no such joint in the URDF"),
    "no such tip": (TOML.replace("believe_zeros = true", 'tip = "tool"'), "tip link 'tool' does not exist; links are"),
}  # fmt: skip


def robot_directory(toml: str, urdf: str = URDF) -> Path:
    Path("robot").mkdir()
    Path("robot/robot.toml").write_text(toml)
    Path("robot/ypp3.urdf").write_text(urdf)
    return Path("robot")


@pytest.mark.parametrize(("toml", "expected"), SETTINGS.values(), ids=SETTINGS)
def test_ident_refuses_a_bad_robot_toml(toml: str, expected: str, refused: Bench) -> None:
    assert re.search(expected, refused(ident.cli.main, "simulate", robot_directory(toml), "-o", "campaign.h5"))


@pytest.mark.parametrize(
    "case",
    [
        *("unknown key", "no unit", "missing key", "NaN", "not TOML", "empty", "no such tip"),
        *("other unit", "drive of no joint"),
    ],
)
def test_symgen_refuses_a_bad_robot_toml_beside_its_urdf(case: str, refused: Bench) -> None:
    toml, expected = SETTINGS[case]
    assert re.search(expected, refused(symgen.cli.main, robot_directory(toml) / "ypp3.urdf", "-o", "out"))


FAR = {
    "spring of 1e300": ("K_Nm_per_rad = 5500", "K_Nm_per_rad = 1e300", "K_Nm_per_rad: found 1e+300, expected a number > 0"),
    "weightless rotor": ("J_m_kgm2 = 4e-5", "J_m_kgm2 = 1e-300", "J_m_kgm2: found 1e-300, expected a number > 0, from"),
    "endless gear": ("N = 100", "N = -1e300", "N: found -1e+300, expected a number other than 0, from"),
    "treacle": ("D_Nms_per_rad = 3e-5", "D_Nms_per_rad = 1e300", "D_Nms_per_rad: found 1e+300, expected a number >= 0"),
    "endless torque": ("torque_limit_Nm = 2.0", "torque_limit_Nm = 1e300", "torque_limit_Nm: found 1e+300, expected"),
    "swing of nothing": ("swing_rad = 0.01", "swing_rad = 1e-300", "swing_rad: found 1e-300, expected"),
    "nothing but noise": ("rel = 0.005", "rel = 1e300", "torque_noise_rel: found 1e+300, expected a number >= 0, up to 10"),
    "lock of iron": ("lock_pd_Hz = 5", "lock_pd_Hz = 1e300", "lock_pd_Hz: found 1e+300, expected"),
    "years of records": ("periods = 6", "periods = 10000000", "periods: 10000000 of 10000 samples each; expected a record of"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "expected"), FAR.values(), ids=FAR)
def test_numbers_that_overflow_are_refused_where_they_stand(old: str, new: str, expected: str, refused: Bench) -> None:
    robot = robot_directory(replaced(TOML, old, new))
    assert expected in refused(ident.cli.main, "simulate", robot, "-o", "campaign.h5")


def test_ident_refuses_a_bad_urdf_in_a_robot_directory(refused: Bench) -> None:
    robot = robot_directory(TOML, FILES["massless link"][0])
    assert "ypp3.urdf: link 'link2'" in refused(ident.cli.main, "simulate", robot, "-o", "campaign.h5")
    Path("robot/ypp3.urdf").unlink()
    assert "urdf: no such file" in refused(ident.cli.main, "simulate", robot, "-o", "campaign.h5")


# Campaigns -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    """Six records of some 3 s of the paper's arm, other joints rigid."""
    robot = replace(load_robot(YPP3), experiment=Experiment(f0=1.0, band=(1.0, 120.0), periods=3, swing=0.005))
    chain = chain_of_robot(robot)
    cells = make_plan(chain, believe_zeros=True, spare=0).cells
    return simulate(chain, robot, [(cell.joint, cell.q) for cell in cells], lock="rigid", workers=1)


def first_record(campaign: Campaign, **changes: object) -> Campaign:
    first = replace(campaign.records[0], **changes)  # type: ignore[arg-type]
    return replace(campaign, records=(first, *campaign.records[1:]))


def every_record(campaign: Campaign, change: Callable[[Record], dict[str, object]]) -> Campaign:
    return replace(campaign, records=tuple(replace(record, **change(record)) for record in campaign.records))  # type: ignore[arg-type]


def test_the_campaign_itself_is_fitted(campaign: Campaign, tmp_path: Path) -> None:
    """So that what is refused below is refused for its defect alone."""
    write_campaign(campaign, tmp_path / "c.h5")
    with undrawn():
        assert ident.cli.main(["fit", str(tmp_path / "c.h5"), "-o", str(tmp_path / "out"), "--brief"]) == 0
    assert (tmp_path / "out/result.json").is_file()


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda file: None, "c.h5: no such file; expected a campaign file"),
        (lambda file: file.mkdir(), "c.h5: is a directory; expected a campaign file"),
        (lambda file: file.write_text(URDF), "c.h5: not an HDF5 file; expected a campaign file"),
        (lambda file: file.write_bytes(b""), "c.h5: not an HDF5 file; expected a campaign file"),
    ],
)
def test_ident_refuses_what_is_no_campaign(make: Callable[[Path], object], expected: str, refused: Bench) -> None:
    make(Path("c.h5"))
    assert expected in refused(ident.cli.main, "fit", "c.h5", "-o", "out")


def _nan(file: h5py.File) -> None:
    file["experiments/0002/theta"][123, 1] = np.nan


def _infinite(file: h5py.File) -> None:
    file["experiments/0003/tau"][5, 0] = np.inf


def _lost(file: h5py.File) -> None:
    del file["experiments/0001/tau"]


def _future(file: h5py.File) -> None:
    file.attrs["version"] = 9


def _alien(file: h5py.File) -> None:
    file.attrs["format"] = "recipe"


def _fast(file: h5py.File) -> None:
    file["experiments/0001"].attrs["lines"] = [1, 5000]


DAMAGE = [
    (_nan, "c.h5: /experiments/0002: theta: sample 123 of joint 'joint2' is nan, expected finite samples"),
    (_infinite, "c.h5: /experiments/0003: tau: sample 5 of joint 'joint1' is inf, expected finite samples"),
    (_lost, "c.h5: /experiments/0001: tau: missing; expected a dataset"),
    (_future, "c.h5: /: version: found 9, a version from the future; this program reads 1"),
    (_alien, "c.h5: /: format: found 'recipe', expected 'frf-campaign'"),
    (_fast, "c.h5: /experiments/0001: lines: line 5000 is at 5000 Hz, expected none above fs/2 = 500 Hz"),
]


@pytest.mark.parametrize(("damage", "expected"), DAMAGE)
def test_ident_refuses_a_damaged_campaign(
    damage: Callable[[h5py.File], None], expected: str, campaign: Campaign, refused: Bench
) -> None:
    write_campaign(campaign, "c.h5")
    with h5py.File("c.h5", "r+") as file:
        damage(file)
    Path("out").mkdir()  # it exists: whether it is made too early is another test's business
    assert expected in refused(ident.cli.main, "fit", "c.h5", "-o", "out")


def test_ident_refuses_a_truncated_campaign(campaign: Campaign, refused: Bench) -> None:
    write_campaign(campaign, "whole.h5")
    content = Path("whole.h5").read_bytes()
    Path("out").mkdir()
    for share in (0.1, 0.5, 0.99):
        Path("c.h5").write_bytes(content[: int(share * len(content))])
        assert "c.h5: damaged" in refused(ident.cli.main, "fit", "c.h5", "-o", "out")


SILENT = {
    "no torque": (lambda r: {"tau": 0 * r.tau}, "joint3 has no torque there"),
    "another joint": (lambda r: {"excited": "joint1"}, "joint1 is said to be excited, but the multisine is on the motor of"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "expected"), SILENT.values(), ids=SILENT)
def test_ident_refuses_records_that_say_nothing(
    change: Callable[[Record], dict[str, object]], expected: str, campaign: Campaign, refused: Bench
) -> None:
    write_campaign(every_record(campaign, change), "c.h5")
    Path("out").mkdir()
    assert expected in refused(ident.cli.main, "fit", "c.h5", "-o", "out")


def test_ident_refuses_records_of_too_few_lines_for_two_masses(campaign: Campaign, refused: Bench) -> None:
    write_campaign(every_record(campaign, lambda r: {"lines": r.lines[:1]}), "c.h5")
    Path("out").mkdir()
    said = refused(ident.cli.main, "fit", "c.h5", "-o", "out", "--method", "two-mass")
    assert "1 of 1 excited lines are usable, a flexible joint needs at least 6" in said


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("factor", [0.0, 1e-300, 1e200])
def test_ident_refuses_an_encoder_that_is_dead_or_mad(factor: float, campaign: Campaign, refused: Bench) -> None:
    write_campaign(first_record(campaign, theta=factor * campaign.records[0].theta), "c.h5")
    Path("out").mkdir()
    assert "record 0001" in refused(ident.cli.main, "fit", "c.h5", "-o", "out")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_ident_does_not_take_noise_for_an_arm(campaign: Campaign, refused: Bench) -> None:
    rng = np.random.default_rng(0)
    write_campaign(every_record(campaign, lambda r: {"theta": rng.normal(size=r.theta.shape)}), "c.h5")
    Path("out").mkdir()
    assert "mean angles" in refused(ident.cli.main, "fit", "c.h5", "-o", "out")


def test_a_campaign_of_one_record_gives_what_it_can(campaign: Campaign, tmp_path: Path) -> None:
    write_campaign(replace(campaign, records=campaign.records[:1]), tmp_path / "c.h5")
    assert ident.cli.main(["fit", str(tmp_path / "c.h5"), "-o", str(tmp_path / "out"), "--brief"]) in (0, 1)


# ident's flags and outputs -------------------------------------------------------------------------------------------


@pytest.fixture
def no_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever can be known before must be known before minutes of simulation."""

    def simulated(*_: object, **__: object) -> None:
        pytest.fail("simulated first, refused later")

    monkeypatch.setattr("ident.simulator.resume.run_to_file", simulated)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "the following arguments are required: COMMAND"),
        (["dance"], "argument COMMAND: invalid choice: 'dance'"),
        (["simulate", YPP3], "the following arguments are required: -o"),
        (["simulate", YPP3, "-o", "c.h5", "--lock", "glue"], "argument --lock: invalid choice: 'glue'"),
        (["simulate", YPP3, "-o", "c.h5", "--seed", "odd"], "argument --seed: invalid int value: 'odd'"),
        (["simulate", "nowhere", "-o", "c.h5"], "nowhere: no such file; expected a robot.toml or the directory"),
        (["simulate", ".", "-o", "c.h5"], "robot.toml: no such file; expected a robot.toml or the directory"),
        (["simulate", YPP3 / "ypp3.urdf", "-o", "c.h5"], "ypp3.urdf: not TOML"),
        (["run", YPP3, "-o", "file"], "-o file: a file; expected a directory"),
        (["paper", "nowhere"], "nowhere: no such file"),
        (["diagnose", "c.h5", "-o", "out", "--minutes", "0"], "argument --minutes: '0'; expected minutes above 0, or inf"),
        (["paper", YPP3.parent / "scara4"], "expected the paper's yaw-pitch-pitch arm"),
        pytest.param(["run", "nowhere", "-o", "out"], "nowhere: no such file"),
        pytest.param(["simulate", YPP3, "-o", "c.h5", "--seed", "-1"], "--seed -1"),
        pytest.param(["run", YPP3, "-o", "out", "--method", "magic"], "method 'magic'"),
        (["simulate", YPP3, "-o", "c.h5", "--spacing", "1e-320"], "--spacing 9.99989e-321: expected Hz that divide the sampling"),
        (["simulate", YPP3, "-o", "c.h5", "--spacing", "1e-5"], "--spacing 1e-05: expected Hz that divide the sampling rate"),
        (["simulate", YPP3, "-o", "c.h5", "--spacing", "nan"], "--spacing nan: expected Hz that divide the sampling rate"),
        (["simulate", YPP3, "-o", "c.h5", "--periods", "10000000"], "--periods 1e+07: 10000000 periods of 10000 samples each; expected a record of at most 1e+07"),
        (["simulate", YPP3, "-o", "c.h5", "--spacing", "2e-4"], "--spacing 0.0002: 6 periods of 5e+06 samples each; expected"),
        pytest.param(["simulate", YPP3, "-o", "."], "."),
        pytest.param(["simulate", YPP3, "-o", "nowhere/c.h5"], "nowhere"),
        pytest.param(["simulate", YPP3, "-o", "a\0b"], "-o"),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("no_simulation")
def test_ident_refuses_what_can_not_be_done_before_it_begins(
    arguments: list[str | Path], expected: str, refused: Bench
) -> None:
    Path("file").write_text("kept")
    assert expected in refused(ident.cli.main, *arguments)


@pytest.mark.parametrize("command", ["simulate", "run", "doctor", "fit"])
@pytest.mark.parametrize("begun", [True, False])
def test_an_interruption_promises_what_is_kept(
    command: str, begun: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Records of a simulation stay; before the first, after the last and in all other commands nothing does."""
    out = tmp_path / ("c.h5" if command == "simulate" else "out")
    file = out / "campaign.h5" if command == "run" else out

    def stop(*_: object, **__: object) -> None:
        if begun and command in ("simulate", "run"):
            Path(f"{file}.partial").mkdir(parents=True)
        raise KeyboardInterrupt

    for name in (
        "ident.simulator.resume.run_to_file",
        "ident.machines.doctor.examine",
        "ident.records.store.read_campaign",
    ):
        monkeypatch.setattr(name, stop)
    place = [] if command == "doctor" else ["-o", str(out)]
    assert ident.cli.main([command, str(YPP3), *place]) == 130
    kept = "; records that are done stay, the same command goes on there"
    said = f"ident: interrupted{kept if begun and command in ('simulate', 'run') else ''}\n"
    assert capsys.readouterr().err.splitlines(keepends=True)[-1] == said


# As a shell sees it --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "arguments", "expected"),
    [
        ("symgen", ["nowhere.urdf", "-o", "out"], "symgen: nowhere.urdf: no such file; expected a URDF file\n"),
        ("ident", ["simulate", "nowhere", "-o", "c.h5"], "ident: nowhere: no such file; expected a robot.toml or the directory that holds one\n"),
    ],
)  # fmt: skip
def test_the_installed_commands_say_the_same(command: str, arguments: list[str], expected: str, tmp_path: Path) -> None:
    installed = shutil.which(command, path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    assert installed, f"{command} is not installed"
    done = subprocess.run(
        [installed, *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (2, "", expected)
    assert not list(tmp_path.iterdir())
