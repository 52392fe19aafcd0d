"""What a real robot is given to play: played by the simulated one, recorded as CSV, brought back, it is the campaign."""

from __future__ import annotations

import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ident.cli import main
from ident.errors import IdentError
from ident.machines.importing import import_files
from ident.machines.mapping import load_map
from ident.machines.playing import check_place, export_excitation
from ident.records.campaign import Campaign
from ident.records.store import read_campaign
from ident.simulator.bench import simulate
from ident.simulator.dob import Servo, controller
from symgen.plan import Cell, chain_of_robot, make_plan
from symgen.robot import Robot, load_robot

ROBOT = Path(__file__).parents[3] / "robots" / "ypp3"
SEED = 5
CELLS = (Cell("joint3", np.array([0.2, 0.3, -0.4])), Cell("joint1", np.array([0.0, 0.7, 0.5]), spare=True))
CONSTANTS = {"joint1": 0.08}


@pytest.fixture(scope="module")
def robot() -> Robot:
    robot = load_robot(ROBOT)
    return replace(robot, experiment=replace(robot.experiment, f0=2.0, periods=4))


@pytest.fixture(scope="module")
def exported(robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("play")
    export_excitation(robot, chain_of_robot(robot), CELLS, directory, seed=SEED, constants=CONSTANTS)
    return directory


@pytest.fixture(scope="module")
def simulated(robot: Robot) -> Campaign:
    return simulate(chain_of_robot(robot), robot, [(cell.joint, cell.q) for cell in CELLS], seed=SEED, workers=1)


def test_played_recorded_and_imported_it_is_the_campaign(
    robot: Robot, exported: Path, simulated: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for record in simulated.records:
        t = np.arange(len(record.tau)) / robot.experiment.fs
        current = record.tau / [CONSTANTS.get(name, 1.0) for name in simulated.joints]
        head = ["t", "i_joint1", "tau_joint2", "tau_joint3", *(f"theta_{name}" for name in simulated.joints)]
        table = np.column_stack([t, current, record.theta])
        np.savetxt(tmp_path / f"{record.id}.csv", table, "%.12g", ",", header=",".join(head), comments="")
    out = tmp_path / "campaign.h5"
    files = [str(tmp_path / f"{record.id}.csv") for record in simulated.records]
    assert main(["import", "--map", str(exported / "map.toml"), *files, "-o", str(out)]) == 0
    assert capsys.readouterr().err == ""  # no sign, no gear to be doubted
    found = read_campaign(out)
    for name in ("urdf", "joints", "fs", "hold"):
        assert getattr(found, name) == getattr(simulated, name)
    for name in ("N", "J_m", "K", "gravity"):
        np.testing.assert_array_equal(getattr(found, name), getattr(simulated, name))
    for ours, theirs in zip(found.records, simulated.records, strict=True):
        for name in ("id", "excited", "f0", "samples_per_period", "periods"):
            assert getattr(ours, name) == getattr(theirs, name)
        np.testing.assert_array_equal(ours.lines, theirs.lines)
        np.testing.assert_array_equal(ours.posture, theirs.posture)
        for name in ("tau", "theta"):  # twelve digits were written
            scale = np.abs(getattr(theirs, name)).max()
            np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), atol=1e-11 * scale, rtol=0)


def test_links_that_are_read_come_back_and_tell_the_posture(robot: Robot, tmp_path: Path) -> None:
    """The map asks for every link's encoder where robot.toml has one. Where links rest is told by these, or else by motors less what springs give."""
    counts = 1 << 20
    linked = replace(robot, drives=tuple(replace(drive, link_encoder_counts=counts) for drive in robot.drives))
    chain = chain_of_robot(linked)
    export_excitation(linked, chain, CELLS, tmp_path, seed=SEED)
    text = (tmp_path / "map.toml").read_text()
    assert "and the link angle," in text
    simulated = simulate(chain, linked, [(cell.joint, cell.q) for cell in CELLS], seed=SEED, workers=1)
    for record in simulated.records:
        t = np.arange(len(record.tau)) / robot.experiment.fs
        head = ["t", *(f"{kind}_{name}" for kind in ("tau", "theta", "link") for name in simulated.joints)]
        table = np.column_stack([t, record.tau, record.theta, record.q_link])
        np.savetxt(tmp_path / f"{record.id}.csv", table, "%.12g", ",", header=",".join(head), comments="")
    files = [tmp_path / f"{record.id}.csv" for record in simulated.records]
    asked = re.sub("posture_rad = .*", 'posture_rad = "measured"', text)
    unread = re.sub("link_angle = .*", "", asked)
    without_K = re.sub("K_Nm_per_rad = .*", "", unread)
    off = []
    for mapping in (text, asked, unread, without_K):
        (tmp_path / "map.toml").write_text(mapping)
        found = import_files(load_map(tmp_path / "map.toml"), files)
        assert not found.notes
        off.append(0.0)
        for ours, theirs in zip(found.campaign.records, simulated.records, strict=True):
            off[-1] = max(off[-1], float(np.abs(ours.posture - theirs.posture).max()))
            assert (ours.q_link is None) == ("link_angle" not in mapping)
            if ours.q_link is not None:
                np.testing.assert_allclose(ours.q_link, theirs.q_link, atol=1e-11 * np.abs(theirs.q_link).max(), rtol=0)
    step = 2 * np.pi / counts
    assert off[0] == 0 and max(off[1:3]) < 5 * step
    sag = robot.drives[1].N * np.abs(simulated.records[0].tau[:, 1]).mean() / robot.drives[1].K
    assert off[3] == pytest.approx(sag, rel=0.01) and sag > 100 * step


def test_the_files_are_what_the_simulated_robot_plays(robot: Robot, exported: Path, simulated: Campaign) -> None:
    """Servos as written, run on the recorded angles, plus the file's torque: every torque that was recorded."""
    document = json.loads((exported / "excitation.json").read_text())
    assert [one["excited"] for one in document["records"]] == ["joint3", "joint1"]
    assert [one["spare"] for one in document["records"]] == [False, True]
    for one, record in zip(document["records"], simulated.records, strict=True):
        motors = one["motors"]
        servos = [
            Servo(m["kp_Nm_per_rad"], m["kd_Nms_per_rad"], m["J_kgm2"], m["dob_rad_per_s"]) for m in motors
        ]  # fmt: skip
        command = controller(
            servos, [m["rest_rad"] for m in motors], [m["preload_Nm"] for m in motors], 1 / document["fs_hz"]
        )
        tau = np.array([command(theta) for theta in record.theta.tolist()])
        with (exported / one["file"]).open() as file:
            head = file.readline().strip().split(",")
            table = np.loadtxt(file, delimiter=",")
        assert head[0] == "t" and head[2:] == ["q_joint1", "q_joint2", "q_joint3"]
        np.testing.assert_array_equal(table[:, 2:], np.tile(record.posture, (len(table), 1)))
        assert head[1] == {"joint3": "tau_joint3", "joint1": "i_joint1"}[one["excited"]]
        play = np.tile(table[:, 1] * CONSTANTS.get(one["excited"], 1.0), one["periods"])
        ramp = document["ramp_samples"]
        play[:ramp] *= (1 - np.cos(np.pi * np.arange(ramp) / ramp)) / 2
        tau[:, simulated.joints.index(one["excited"])] += play
        np.testing.assert_allclose(tau, record.tau, atol=1e-9 * np.abs(record.tau).max(), rtol=0)
        assert one["lines"] == record.lines.tolist() and one["rms_Nm"] == pytest.approx(record.rms)


def test_a_plan_file_is_played_with_its_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """plan.json beside its robot.toml, or elsewhere with --robot; of another arm it is refused."""
    home = tmp_path / "arm"
    shutil.copytree(ROBOT, home)
    text = (home / "robot.toml").read_text().replace("line_spacing_Hz = 0.1", "line_spacing_Hz = 0.5")
    (home / "robot.toml").write_text(text)
    robot = load_robot(home)
    plan = make_plan(chain_of_robot(robot), believe_zeros=True)
    plan.write(tmp_path / "plan.json")
    elsewhere = ["export-excitation", str(tmp_path / "plan.json"), "-o", str(tmp_path / "out")]
    assert main([*elsewhere, "--robot", str(home), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["records"] == len(plan.cells)
    document = json.loads((tmp_path / "out/excitation.json").read_text())
    postures = np.array([one["posture"] for one in document["records"]])
    np.testing.assert_allclose(postures, [cell.q for cell in plan.cells], rtol=1e-11)  # plan.json has twelve digits
    assert main(elsewhere) == 2
    other = ROBOT.parent / "scara4"
    assert main([*elsewhere, "--robot", str(other)]) == 2
    assert "another URDF" in capsys.readouterr().err


def test_without_a_place_it_is_beside_the_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    home = tmp_path / "arm"
    shutil.copytree(ROBOT, home)
    assert main(["export-excitation", str(home), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["directory"] == str(home / "play")
    assert (home / "play" / "map.toml").is_file()


def test_what_can_not_be_played_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for constant in ("joint9=1", "joint1=0", "joint1", "joint1=nan"):
        arguments = ["export-excitation", str(ROBOT), "-o", str(tmp_path / "out"), "--torque-constant", constant]
        assert main(arguments) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and ("joint9" in error or constant in error)
    assert not (tmp_path / "out").exists()


def test_what_a_person_wrote_is_not_replaced(robot: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither the robot's own URDF, by whatever path, nor a map that is not of an export."""
    home = tmp_path / "arm"
    shutil.copytree(ROBOT, home)
    (tmp_path / "same").symlink_to(home)
    before = (home / "ypp3.urdf").read_bytes()
    for place in (home, tmp_path / "same", home / ".." / "arm"):
        assert main(["export-excitation", str(home), "-o", str(place)]) == 2
        error = capsys.readouterr().err
        assert "ypp3.urdf: the robot's own URDF" in error and error.count("\n") == 1
    assert (home / "ypp3.urdf").read_bytes() == before and not (home / "map.toml").exists()
    export_excitation(robot, chain_of_robot(robot), CELLS, tmp_path / "play", seed=SEED)
    check_place(robot, tmp_path / "play")
    with (tmp_path / "play/map.toml").open("r+") as file:
        file.write("# mine")
    with pytest.raises(IdentError, match=r"map.toml: a map that was not exported, .* choose another directory"):
        check_place(robot, tmp_path / "play")


def test_a_place_may_be_of_any_name(robot: Robot, tmp_path: Path) -> None:
    """URDF and directory of names that are no text; the map names what is not there with "?"."""
    odd = tmp_path / os.fsdecode(b"r\xe9b")
    odd.mkdir()
    shutil.copy(ROBOT / "ypp3.urdf", odd / os.fsdecode(b"\xe9.urdf"))
    there = replace(robot, urdf=odd / os.fsdecode(b"\xe9.urdf"), path=odd / "robot.toml", name=odd.name)
    files = export_excitation(there, chain_of_robot(there), CELLS, odd / "play", seed=SEED)
    assert all(file.is_file() for file in files)
    assert json.loads((odd / "play/excitation.json").read_text())["robot"] == "r?b"
    assert load_map(odd / "play/map.toml").source == "measured on r?b"


def test_names_that_can_not_head_a_column_get_one_of_their_own(robot: Robot, tmp_path: Path) -> None:
    """The second joint is called "arm 2" and the first as the second's number would be: every joint keeps its own columns."""
    names = {"joint1": "joint2", "joint2": "arm 2", "joint3": "joint2_"}
    text = re.sub("joint[123]", lambda found: names[found[0]], (ROBOT / "ypp3.urdf").read_text())
    (tmp_path / "ypp3.urdf").write_text(text)
    drives = tuple(replace(drive, joint=names[drive.joint]) for drive in robot.drives)
    odd = replace(robot, urdf=tmp_path / "ypp3.urdf", drives=drives)
    chain = chain_of_robot(odd)
    assert chain.names == tuple(names.values())
    cells = [Cell(names[cell.joint], cell.q) for cell in CELLS]
    export_excitation(odd, chain, cells, tmp_path / "play", seed=SEED)
    found = load_map(tmp_path / "play/map.toml")
    for kind in ("torque", "motor_angle"):
        columns = [joint.signals[kind].name for joint in found.joints]
        assert len(set(columns)) == 3 and not any(" " in column for column in columns)
    head = (tmp_path / "play/excitation/0001.csv").read_text().splitlines()[0].split(",")
    assert len(set(head)) == len(head)


def test_an_export_leaves_no_excitation_of_an_earlier_one(robot: Robot, exported: Path, tmp_path: Path) -> None:
    shutil.copytree(exported, tmp_path, dirs_exist_ok=True)
    recorded = tmp_path / "excitation/0003.csv"
    recorded.write_text("t,tau_joint1,theta_joint1\n0,0,0\n")  # which a person put there
    export_excitation(robot, chain_of_robot(robot), CELLS[:1], tmp_path, seed=SEED)
    assert sorted(path.name for path in (tmp_path / "excitation").iterdir()) == ["0001.csv", "0003.csv"]


def test_a_campaign_for_a_precision_is_played_and_comes_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Records of the periods that were planned, at the planned spacing, are those of the campaign that is simulated."""
    plan = make_plan(chain_of_robot(load_robot(ROBOT)), believe_zeros=True)
    plan.write(tmp_path / "plan.json")
    asked = ["--target", "0.02%", "--seed", "3"]
    play = ["export-excitation", str(tmp_path / "plan.json"), "--robot", str(ROBOT), "-o", str(tmp_path / "play")]
    assert main([*play, *asked, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["precision"]["target"] == 0.0002 > told["precision"]["predicted"]
    document = json.loads((tmp_path / "play/excitation.json").read_text())
    periods = [one["periods"] for one in document["records"]]
    assert sum(periods) / document["f0_hz"] == pytest.approx(told["precision"]["robot_time_s"])
    assert len(set(periods)) > 1, "or records of differing periods are not tried"
    found = load_map(tmp_path / "play/map.toml")
    assert [found.of(Path(one["record_as"])).periods for one in document["records"]] == periods
    S, fs, rng = document["samples_per_period"], document["fs_hz"], np.random.default_rng(0)
    for one in document["records"]:
        t = np.arange(one["periods"] * S) / fs
        head = ["t", *(f"{kind}_joint{k}" for kind in ("tau", "theta") for k in (1, 2, 3))]
        table = np.column_stack([t, rng.standard_normal((len(t), 6))])
        np.savetxt(tmp_path / one["record_as"], table, "%.12g", ",", header=",".join(head), comments="")
    files = [str(tmp_path / one["record_as"]) for one in document["records"]]
    assert main(["import", "--map", str(tmp_path / "play/map.toml"), *files, "-o", str(tmp_path / "c.h5")]) == 0
    assert [record.periods for record in read_campaign(tmp_path / "c.h5").records] == periods
    capsys.readouterr()
    assert main([*play, "--target", "1%", "--spacing", "1"]) == 2
    assert "--target does not go with --spacing" in capsys.readouterr().err


def test_spacing_periods_and_realisations_of_what_is_played(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = make_plan(chain_of_robot(load_robot(ROBOT)), believe_zeros=True)
    plan.write(tmp_path / "plan.json")
    play = ["export-excitation", str(tmp_path / "plan.json"), "--robot", str(ROBOT), "-o", str(tmp_path / "play")]
    assert main([*play, "--spacing", "2", "--periods", "9", "--realisations", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["records"] == 2 * len(plan.cells)
    records = json.loads((tmp_path / "play/excitation.json").read_text())["records"]
    assert [one["id"] for one in records] == [f"{k + 1:04d}" for k in range(2 * len(plan.cells))]
    assert {one["periods"] for one in records} == {9}
    for one, other in zip(records[::2], records[1::2], strict=True):
        for name in ("excited", "posture", "lines", "periods"):
            assert one[name] == other[name]
        assert one["rms_Nm"] == pytest.approx(other["rms_Nm"]) and one["crest"] != other["crest"]
    assert "periods =" not in (tmp_path / "play/map.toml").read_text()  # all that are recorded are taken
    assert main([*play, "--realisations", "0"]) == 2
    assert "--realisations 0: expected 1 or more" in capsys.readouterr().err
