"""What a real robot is given to play: played by the simulated one, recorded as CSV, brought back, it is the campaign."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ident.bench import simulate
from ident.campaign import Campaign
from ident.cli import main
from ident.dob import Servo, controller
from ident.playing import export_excitation
from ident.store import read_campaign
from symgen.plan import Cell, chain_of_robot, make_plan
from symgen.robot import Robot, load_robot

ROBOT = Path(__file__).parents[2] / "robots" / "ypp3"
SEED = 5
CELLS = (Cell("joint3", np.array([0.2, 0.3, -0.4])), Cell("joint1", np.array([0.0, 0.7, 0.5]), spare=True))
CONSTANTS = {"joint1": 0.08}


@pytest.fixture(scope="module")
def robot() -> Robot:
    robot = load_robot(ROBOT)
    return replace(robot, experiment=replace(robot.experiment, f0=0.5, periods=4))


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
