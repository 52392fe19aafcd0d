"""Trajectories of a foreign file come in as they are; whatever is amiss is one line that says so."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from logged import FS, log

from ident.cli import main
from ident.errors import ImportingError
from ident.machines.guess import guess
from ident.machines.log_importing import import_log
from ident.machines.mapping import load_map
from ident.records.log import Trajectory
from ident.records.store import read_log

ROBOT = Path(__file__).parents[3] / "robots/ypp3_general/ypp3_general.urdf"
MAP = f'[log]\nsource = "an arm"\n[robot]\nurdf = "{ROBOT}"\n' + "".join(
    f'[joint.joint{j}]\nN = 50\ntorque = {{name = "tau", column = {j}, unit = "Nm", side = "joint"}}\n'
    f'motor_angle = {{name = "q", column = {j}, unit = "deg", side = "joint"}}\n'
    for j in (1, 2, 3)
)
TIMED = '[record]\ntime = {name = "t", unit = "s"}\n'
RATED = f"[record]\nsample_rate_Hz = {FS:g}\n"


@pytest.fixture(scope="module")
def run() -> Trajectory:
    return log(runs=1).trajectories[0]


def brought(tmp_path: Path, run: Trajectory, text: str = MAP + TIMED, **changed: np.ndarray):
    t = np.arange(len(run.q)) / FS
    np.savez(tmp_path / "run.npz", **({"t": t, "q": np.rad2deg(run.q), "tau": run.tau} | changed))
    (tmp_path / "map.toml").write_text(text)
    return import_log(load_map(tmp_path / "map.toml"), [tmp_path / "run.npz"])


@pytest.mark.parametrize("text", [MAP + TIMED, MAP + RATED])
def test_a_trajectory_comes_in_joint_side(text: str, run: Trajectory, tmp_path: Path) -> None:
    found = brought(tmp_path, run, text)
    (back,) = found.log.trajectories
    assert found.log.fs == FS and found.notes == () and found.log.N.tolist() == [50.0] * 3
    np.testing.assert_allclose(back.q, run.q, atol=1e-12)
    np.testing.assert_allclose(back.tau, run.tau, atol=1e-12)


def test_stamps_that_jitter_are_interpolated_and_that_is_said(run: Trajectory, tmp_path: Path) -> None:
    t = (np.arange(len(run.q)) + np.random.default_rng(0).uniform(-0.45, 0.45, len(run.q))) / FS
    at = np.arange(len(run.q)) / FS
    q = np.stack([np.interp(t, at, column) for column in run.q.T], axis=1)
    found = brought(tmp_path, run, t=t, q=np.rad2deg(q))
    (note,) = found.notes
    assert "interpolated" in note
    even = t[0] + np.arange(len(found.log.trajectories[0].q)) / FS
    expected = np.stack([np.interp(even, at, column) for column in run.q.T], axis=1)
    np.testing.assert_allclose(found.log.trajectories[0].q[5:-5], expected[5:-5], atol=2e-5)


def test_samples_before_and_behind_are_left_out(run: Trajectory, tmp_path: Path) -> None:
    found = brought(tmp_path, run, MAP + TIMED + "skip_samples = 1000\nsamples = 4000\n")
    np.testing.assert_allclose(found.log.trajectories[0].q, run.q[1000:5000], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "changed", "says"),
    [
        (MAP + TIMED + "[campaign]\nhold = \"zoh\"\n", {}, "found both [campaign] and [log]"),
        (MAP + TIMED + 'excited = "joint1"\n', {}, "excited"),
        (MAP + "[record]\n", {}, "neither sample_rate_Hz nor time"),
        (MAP + TIMED, {"t": np.delete(np.arange(10_010) / FS, slice(500, 510))}, "10 samples are missing after sample 499"),
        (MAP + TIMED, {"t": np.zeros(10_000)}, "does not increase"),
        (MAP + TIMED, {"tau": np.ones((5000, 3))}, "has 10000 samples, expected 5000"),
        (MAP + TIMED, {"q": np.full((10_000, 3), np.nan)}, "expected finite samples"),
        (MAP.replace('"deg"', '"deg", offset = "posture"', 1) + TIMED, {}, "motor_angle: offset = \"posture\": a log has no posture"),
        (MAP + TIMED, {"t": np.arange(10_000.0) * 2}, "says 0.5 Hz, expected 5 to 200000 Hz; its unit is more likely ms (500 Hz)"),
        (MAP + TIMED + "skip_samples = 9950\n", {}, "expected at least 100"),
        (MAP + TIMED + "samples = 20000\n", {}, "expected at least 20000"),
    ],
)  # fmt: skip
def test_what_is_amiss_is_said_in_one_line(text: str, changed, says: str, run: Trajectory, tmp_path: Path) -> None:
    with pytest.raises(ImportingError) as error:
        brought(tmp_path, run, text, **changed)
    assert says in str(error.value) and "\n" not in str(error.value)


def test_a_trajectory_is_brought_in_once(run: Trajectory, tmp_path: Path) -> None:
    brought(tmp_path, run)
    shutil.copy(tmp_path / "run.npz", tmp_path / "again.npz")
    with pytest.raises(ImportingError, match=r"again.npz: has the samples of .*run.npz"):
        import_log(load_map(tmp_path / "map.toml"), [tmp_path / "run.npz", tmp_path / "again.npz"])


def test_topics_of_other_instants_are_refused(run: Trajectory, tmp_path: Path) -> None:
    """Two milliseconds are one sample: the torques' messages are ten samples older than the angles'."""
    t = np.arange(len(run.q)) / FS
    text = MAP.replace('"tau"', '"cmd/tau"').replace('"q"', '"js/q"') + TIMED
    changed = {"cmd/tau": run.tau, "js/q": np.rad2deg(run.q), "cmd/log_time": t}
    brought(tmp_path, run, text, **changed, **{"js/log_time": t})
    with pytest.raises(ImportingError, match=r"samples from that of 'cmd/tau', allowed"):
        brought(tmp_path, run, text, **changed, **{"js/log_time": t + 10 / FS})


def test_the_command_writes_a_log(run: Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    brought(tmp_path, run)
    out = tmp_path / "log.h5"
    assert (
        main(["import", "--json", "--map", str(tmp_path / "map.toml"), str(tmp_path / "run.npz"), "-o", str(out)]) == 0
    )
    assert json.loads(capsys.readouterr().out)["kind"] == "log"
    np.testing.assert_allclose(read_log(out).trajectories[0].q, run.q, atol=1e-12)


def test_a_guess_of_a_file_without_a_multisine_is_the_map_of_a_log(
    run: Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t = np.arange(len(run.q)) / FS
    np.savez(tmp_path / "run.npz", times=t, positions=run.q, torques=run.tau, target_positions=run.q + 1.0)
    assert main(["import", "--guess", str(tmp_path / "run.npz"), "--urdf", str(ROBOT)]) == 0
    (tmp_path / "map.toml").write_text(capsys.readouterr().out)
    (back,) = import_log(load_map(tmp_path / "map.toml"), [tmp_path / "run.npz"]).log.trajectories
    np.testing.assert_allclose(back.q, run.q, atol=1e-12)
    np.testing.assert_allclose(back.tau, run.tau, atol=1e-12)


def test_joints_of_a_log_may_be_named_by_words_and_rest_or_only_go_forward(run: Trajectory, tmp_path: Path) -> None:
    words = ("base", "shoulder", "elbow")
    q, tau = run.q.copy(), run.tau.copy()
    q[:, 0], tau[:, 1] = np.linspace(0.0, 1.0, len(q)), 0.0
    table = {"time": np.arange(len(q)) / FS}
    table |= {f"tau {word}": tau[:, k] for k, word in enumerate(words)}
    table |= {f"theta {word}": q[:, k] for k, word in enumerate(words)}
    np.savez(tmp_path / "run.npz", **table)
    found = tomllib.loads(guess([tmp_path / "run.npz"]))
    assert found["robot"]["joints"] == list(words) and found["record"]["time"]["unit"] == "s"
    assert [found["joint"][word]["torque"]["name"] for word in words] == [f"tau {word}" for word in words]
    assert [found["joint"][word]["motor_angle"]["name"] for word in words] == [f"theta {word}" for word in words]
    with pytest.raises(ImportingError, match="names speak of base, shoulder, elbow, .*urdf of joint1, joint2, joint3"):
        guess([tmp_path / "run.npz"], ROBOT)


def test_a_rate_that_a_log_does_not_say_is_left_open(run: Trajectory, tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", q=run.q, tau=run.tau)
    assert tomllib.loads(guess([tmp_path / "run.npz"]))["record"]["sample_rate_Hz"] == "?"
