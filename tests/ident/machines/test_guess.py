"""A guess takes what a file tells, leaves open what it does not, and says which."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from test_importing import URDF, columns, settled

from ident.errors import ImportingError
from ident.machines.guess import guess
from ident.machines.mapping import load_map
from ident.records.campaign import Record


@pytest.fixture(scope="module")
def truth() -> Record:
    return settled()


@pytest.fixture(scope="module")
def joint(truth: Record) -> dict[str, np.ndarray]:
    """What was read of the excited joint."""
    return {"tau": truth.tau[:, 1], "theta": truth.theta[:, 1]}


@pytest.mark.parametrize(("name", "size", "unit"), [("t", 1.0, "s"), ("t_us", 1e6, "us"), ("tout", 1.0, "s")])
def test_time_may_be_in_a_struct_or_a_group(
    name: str, size: float, unit: str, joint: dict[str, np.ndarray], tmp_path: Path
) -> None:
    content = joint | {name: np.arange(6000) / 2500 * size}
    savemat(tmp_path / "r.mat", {"log": content})
    with h5py.File(tmp_path / "r.h5", "w") as file:
        for key, values in content.items():
            file[f"run1/{key}"] = values
    for file, where in (("r.mat", "log."), ("r.h5", "run1/")):
        text = guess([tmp_path / file])
        found = tomllib.loads(text)["record"]
        assert found["time"] == {"name": where + name, "unit": unit} and "# 2500 Hz" in text


@pytest.mark.parametrize(("name", "rate"), [("cfg.fs", 2500.0), ("run1/fs", 2500.0)])
def test_a_rate_may_be_in_a_struct_or_a_group(
    name: str, rate: float, joint: dict[str, np.ndarray], tmp_path: Path
) -> None:
    np.savez(tmp_path / "r.npz", **joint, **{name: rate})
    assert tomllib.loads(guess([tmp_path / "r.npz"]))["record"]["sample_rate_Hz"] == rate


def test_time_may_be_a_column_that_grows_evenly(joint: dict[str, np.ndarray], tmp_path: Path) -> None:
    even = np.arange(6000) * 400.0
    np.savez(tmp_path / "r.npz", data=np.stack([even, *joint.values()], axis=1))
    text = guess([tmp_path / "r.npz"])
    assert tomllib.loads(text)["record"]["time"] == {"name": "data", "column": 1, "unit": "us"}
    assert "# 2500 Hz; CHECK: told by its even steps" in text


def test_dates_and_clocks_of_topics_are_in_seconds(joint: dict[str, np.ndarray], tmp_path: Path) -> None:
    """Though at 50 Hz milliseconds fit as well, and more often."""
    tau, theta = joint.values()
    rows = [
        f"2024-05-01T12:{k // 3000:02d}:{k / 50 % 60:06.3f},{a},{b}"
        for k, (a, b) in enumerate(zip(tau, theta, strict=True))
    ]
    (tmp_path / "r.csv").write_text("\n".join(["time,tau,theta", *rows]))
    np.savez(tmp_path / "r.npz", **joint, **{"js/header/stamp": np.arange(6000) / 50})
    for file, name in (("r.csv", "time"), ("r.npz", "js/header/stamp")):
        text = guess([tmp_path / file])
        assert f'time = {{name = "{name}", unit = "s"}}  # 50 Hz\n' in text


def test_a_rate_that_no_file_says_is_left_open(joint: dict[str, np.ndarray], tmp_path: Path) -> None:
    """Neither by a counter nor by what does not grow evenly; the map is refused until a person fills it in."""
    uneven = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 6000))
    for extra in ({}, {"n": np.arange(6000)}, {"m": np.stack([np.arange(6000.0), uneven], axis=1)}):
        np.savez(tmp_path / "r.npz", **joint, **extra)
        text = guess([tmp_path / "r.npz"])
        (tmp_path / "map.toml").write_text(text)
        with pytest.raises(ImportingError, match=r"sample_rate_Hz: found '\?', expected the sampling rate in Hz"):
            load_map(tmp_path / "map.toml")
        (tmp_path / "map.toml").write_text(text.replace('"?"', "2500"))
        assert load_map(tmp_path / "map.toml").record.fs == 2500


def test_a_sample_that_is_no_number_hides_no_channel(truth: Record, tmp_path: Path) -> None:
    table = {name: values.copy() for name, values in columns(truth).items()}
    table["theta3"][77] = np.nan
    table["tau2"][5:7] = np.inf
    np.savez(tmp_path / "r.npz", **table)
    text = guess([tmp_path / "r.npz"], URDF)
    assert tomllib.loads(text)["joint"]["joint3"]["motor_angle"]["name"] == "theta3"
    said = [line for line in text.splitlines() if "no numbers" in line]
    assert (
        len(said) == 2 and "'tau2'" not in text and '"tau2"} 2 of 6000' in said[0] and '"theta3"} 1 of 6000' in said[1]
    )


@pytest.mark.parametrize(("torque", "angle"), [("tau@", "theta@"), ("u@", "theta@"), ("tau @", "theta @")])
def test_a_joint_at_rest_is_a_joint(torque: str, angle: str, truth: Record, tmp_path: Path) -> None:
    """Its torque is 0 throughout; joints are told by numbers or words, readings by words or by how they behave."""
    tau = truth.tau.copy()
    tau[:, 0] = 0.0
    words = ("base", "shoulder", "elbow") if " " in torque else ("1", "2", "3")
    table = {torque.replace("@", word): tau[:, k] for k, word in enumerate(words)}
    table |= {angle.replace("@", word): truth.theta[:, k] for k, word in enumerate(words)}
    np.savez(tmp_path / "r.npz", fs=1000.0, mode=np.ones(6000), torque_limit=np.full(6000, 9.0), **table)
    found = tomllib.loads(guess([tmp_path / "r.npz"]))
    signals = [found["joint"][name] for name in found["robot"]["joints"]]
    assert [signal["torque"]["name"] for signal in signals] == [torque.replace("@", word) for word in words]
    assert [signal["motor_angle"]["name"] for signal in signals] == [angle.replace("@", word) for word in words]
    assert found["record"]["excited"] == found["robot"]["joints"][1]


def test_names_that_are_not_the_urdfs_are_told(truth: Record, tmp_path: Path) -> None:
    words = ("base", "shoulder", "elbow")
    table = {f"tau {word}": truth.tau[:, k] for k, word in enumerate(words)}
    table |= {f"theta {word}": truth.theta[:, k] for k, word in enumerate(words)}
    np.savez(tmp_path / "r.npz", fs=1000.0, **table)
    with pytest.raises(
        ImportingError, match="names speak of base, shoulder, elbow, .*ypp3.urdf of joint1, joint2, joint3"
    ):
        guess([tmp_path / "r.npz"], URDF)


@pytest.mark.parametrize(
    ("name", "size", "unit"), [("phi@ [°]", 180 / np.pi, "deg"), ("q@_rad", 1.0, "rad"), ("q@ [mrad]", 1e3, "mrad"), ("q@", 180 / np.pi, "deg")]
)  # fmt: skip
def test_angles_of_one_kind_have_one_unit(name: str, size: float, unit: str, truth: Record, tmp_path: Path) -> None:
    """Held joints hardly move: what they swing by tells no unit."""
    theta = truth.theta * 50.0 / np.ptp(truth.theta[:, 1]) * size / (180 / np.pi)
    table = {f"tau{k + 1}": truth.tau[:, k] for k in range(3)}
    table |= {name.replace("@", str(k + 1)): theta[:, k] / (1 if k == 1 else 1000) for k in range(3)}
    np.savez(tmp_path / "r.npz", fs=1000.0, **table)
    found = tomllib.loads(guess([tmp_path / "r.npz"]))
    assert {joint["motor_angle"]["unit"] for joint in found["joint"].values()} == {unit}


def test_gears_of_joints_at_rest_are_told_by_the_angles_at_rest(truth: Record, tmp_path: Path) -> None:
    """A joint that rests at zero tells nothing of its own: its gear is taken as the excited one's, and that is said."""
    theta = truth.theta - [truth.theta[:, 0].mean(), 0.0, 0.0]
    link = np.degrees(theta / [100.0, 100.0, 101.0])
    table = columns(replace(truth, theta=theta)) | {f"link_pos_deg{k + 1}": link[:, k] for k in range(3)}
    np.savez(tmp_path / "r.npz", **table)
    text = guess([tmp_path / "r.npz"], URDF)
    assert [joint["N"] for joint in tomllib.loads(text)["joint"].values()] == [100, 100, 101]
    said = [line for line in text.splitlines() if line.startswith("N = ")]
    assert "as joint2's, nothing here tells" in said[0] and "at rest" not in said[1] and "at rest" in said[2]


def test_signals_in_rows_are_called_transposed(truth: Record, tmp_path: Path) -> None:
    for more in ({}, {"t": np.arange(6000) / 1e3}):
        np.savez(tmp_path / "r.npz", tau=truth.tau.T, theta=truth.theta.T, **more)
        with pytest.raises(ImportingError, match="'tau' is 3 x 6000: transposed; expected a row a sample"):
            guess([tmp_path / "r.npz"])


def test_a_slide_has_the_gear_of_a_slide(truth: Record, tmp_path: Path) -> None:
    """The map is refused until it says how far a turn of the motor moves it."""
    urdf = URDF.parents[1] / "scara4/scara4.urdf"
    table = {f"{key}{k + 1}": getattr(truth, key)[:, min(k, 2)] for key in ("tau", "theta") for k in range(4)}
    np.savez(tmp_path / "r.npz", fs=1000.0, **table)
    text = guess([tmp_path / "r.npz"], urdf)
    assert [("N" in joint, "N_rad_per_m" in joint) for joint in tomllib.loads(text)["joint"].values()] == [
        (True, False), (True, False), (False, True), (True, False)
    ]  # fmt: skip
    (tmp_path / "map.toml").write_text(text)
    with pytest.raises(ImportingError, match="joint3: motor_angle in rad, but the joint slides; expected m or mm, or"):
        load_map(tmp_path / "map.toml")
    (tmp_path / "map.toml").write_text(text.replace("N_rad_per_m = 1", "N_rad_per_m = 314"))
    assert load_map(tmp_path / "map.toml").joints[2].N == 314


def test_what_was_left_out_is_told_where_nothing_is_found(tmp_path: Path) -> None:
    cell = np.empty(2, dtype=object)
    cell[:] = [np.arange(300.0), np.arange(5.0)]
    savemat(tmp_path / "r.mat", {"data": cell, "x": np.arange(300.0)})
    with pytest.raises(ImportingError, match="no channel is a multisine.*; left out: 'data' is a cell array"):
        guess([tmp_path / "r.mat"])
