"""Records as machines leave them: two clocks, gaps, ramps, drift, zeros, joints named by words, decimal commas."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import synthetic
from mcap.writer import Writer as McapWriter
from scipy.io import savemat
from test_importing import NAMED, SIDE_BY_SIDE, brought, columns, csv, same, settled

from ident.errors import ImportingError
from ident.machines.guess import guess
from ident.machines.importing import import_files
from ident.machines.mapping import load_map
from ident.machines.readers import read_variables
from ident.records.campaign import Record
from ident.records.periodic import find_lines, find_period

STAMPED = NAMED + 'time = {name = "t", unit = "s"}\n'
START = 1_700_000_000 * 10**9


@pytest.fixture(scope="module")
def truth() -> Record:
    return settled()


def refused(folder: Path, text: str, *files: Path) -> str:
    (folder / "map.toml").write_text(text)
    with pytest.raises(ImportingError) as caught:
        import_files(load_map(folder / "map.toml"), files)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def late(record: Record, samples: int = 500) -> dict[str, np.ndarray]:
    """The columns of the record with so many samples of its motion in front."""
    S = record.samples_per_period
    tau, theta = (np.vstack([values[S - samples : S], values]) for values in (record.tau, record.theta))
    return columns(replace(record, tau=tau, theta=theta))


# instants -------------------------------------------------------------------------------------------------------------


def topics(path: Path, messages: dict[str, tuple[int, int, list[dict]]]) -> Path:
    """JSON messages of topics, (first time, time step [ns], messages); those that say `stamped` get a header."""
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        for topic, (start, step, content) in messages.items():
            channel = writer.register_channel(f"/{topic}", "json", schema)
            for k, message in enumerate(content):
                t = START + start + k * step
                stamp = {"header": {"stamp": {"sec": t // 10**9, "nanosec": t % 10**9}}}
                data = message | (stamp if message.pop("stamped", False) else {})
                writer.add_message(channel, log_time=t, publish_time=t, data=json.dumps(data).encode())
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("start", "step", "says", "stamped"),
    [
        (0, 10**6, "", True),
        (-7 * 10**6, 10**6, "+7 samples", True),
        (0, 2 * 10**6, "-2e+03 samples", True),
        (3 * 10**5, 10**6, "-0.3 samples", True),
        # the same, told by the other clock
        pytest.param(0, 10**6, "", False, marks=pytest.mark.bench),
        pytest.param(-7 * 10**6, 10**6, "+7 samples", False, marks=pytest.mark.bench),
        pytest.param(0, 2 * 10**6, "-2e+03 samples", False, marks=pytest.mark.bench),
        pytest.param(3 * 10**5, 10**6, "-0.3 samples", False, marks=pytest.mark.bench),
    ],
)
def test_topics_of_other_instants_are_refused(
    start: int, step: int, says: str, stamped: bool, truth: Record, tmp_path: Path
) -> None:
    """/cmd has the torque and /js the angle, as many messages each: what pairs them is their time."""
    half = replace(truth, periods=2, tau=truth.tau[:4000], theta=truth.theta[:4000])
    content = {
        "cmd": (start, step, [{"stamped": stamped, "effort": row} for row in half.tau.tolist()]),
        "js": (0, 10**6, [{"stamped": stamped, "position": row} for row in half.theta.tolist()]),
    }
    file = topics(tmp_path / "record.mcap", content)
    text = SIDE_BY_SIDE.replace("NAME", "cmd/effort").replace("ANGLE", "js/position") + "sample_rate_Hz = 1000\n"
    if not says:
        same(brought(tmp_path, text, file), half)
        return
    text = text.replace("sample_rate_Hz = 1000", f"sample_rate_Hz = {10**9 // step}")
    found = refused(tmp_path, text, file)
    clock = "header/stamp" if stamped else "log_time"
    assert "js/position" in found and "cmd/effort" in found and clock in found
    assert says in found


def test_clocks_of_topics_have_one_zero_and_all_their_digits(tmp_path: Path) -> None:
    """A stamp that was never set is no time."""
    message = {"stamped": True, "x": 1.0}
    unset = {"header": {"stamp": {"sec": 0, "nanosec": 0}}}
    content = {
        "a": (123_456_789, 1001, [message.copy() for _ in range(4)]),
        "b": (0, 10**6, [message.copy() for _ in range(3)]),
        "c": (0, 1, [unset] * 2),
    }
    found = read_variables(topics(tmp_path / "x.mcap", content))
    for clock in ("log_time", "header/stamp"):
        np.testing.assert_allclose(found[f"a/{clock}"], 1e-9 * (123_456_789 + 1001 * np.arange(4)), rtol=1e-15)
        np.testing.assert_array_equal(found[f"b/{clock}"], [0, 1e-3, 2e-3])
    assert np.ptp(found["c/header/stamp"]) == 0


def test_a_message_may_have_a_log_time_of_its_own(tmp_path: Path) -> None:
    content = {"a": (0, 10**9, [{"log_time": 5.0, "x": 1.0}, {"log_time": 6.5, "x": 2.0}])}
    found = read_variables(topics(tmp_path / "x.mcap", content))
    assert set(found) == {"a/log_time", "a/x"}
    np.testing.assert_array_equal(found["a/log_time"], [5.0, 6.5])


def test_signals_of_other_lengths_are_refused(truth: Record, tmp_path: Path) -> None:
    for longer in (37, -37):
        theta = np.vstack([truth.theta, truth.theta])[: 6000 + longer]
        np.savez(tmp_path / "r.npz", tau=truth.tau, theta=theta)
        text = SIDE_BY_SIDE.replace("NAME", "tau").replace("ANGLE", "theta") + "sample_rate_Hz = 1000\n"
        found = refused(tmp_path, text + "periods = 2\n", tmp_path / "r.npz")
        assert f"'theta' has {6000 + longer} samples, expected 6000 as 'tau'" in found


def test_rates_that_time_stamps_tell_alike_are_one(truth: Record, tmp_path: Path) -> None:
    """Stamps to 1 us of 1041.6667 Hz, one of them late; 1042.5 Hz is another rate, which may be said to be the same."""
    first, second = columns(truth), {name: values[:4000] for name, values in columns(truth).items()}
    for table in (first, second):
        table["t"] = np.round(0.3 + np.arange(len(table["t"])) * 0.96e-3, 6)
    second["t"][-1] += 1e-6
    np.savez(tmp_path / "1.npz", **first)
    np.savez(tmp_path / "2.npz", **second)
    (tmp_path / "map.toml").write_text(STAMPED)
    files = [tmp_path / "1.npz", tmp_path / "2.npz"]
    found = import_files(load_map(tmp_path / "map.toml"), files).campaign
    assert found.fs == pytest.approx(1 / 0.96e-3, rel=1e-6)
    assert found.records[0].f0 == found.records[1].f0
    second["t"] = np.arange(4000) / 1042.5
    np.savez(tmp_path / "2.npz", **second)
    assert "sample_rate_Hz" in refused(tmp_path, STAMPED, *files)
    assert brought(tmp_path, STAMPED + "sample_rate_Hz = 1042\n", *files).f0 == 1042 / 2000


# what is left out -----------------------------------------------------------------------------------------------------


def gap_in_front(c: dict[str, np.ndarray]) -> None:
    c.update({name: np.delete(values, range(100, 110)) for name, values in c.items()})


def nan_in_front(c: dict[str, np.ndarray]) -> None:
    for name in ("t", "tau2", "theta3"):
        c[name] = c[name].copy()
        c[name][40] = np.nan


@pytest.mark.parametrize(("spoil", "skip"), [(gap_in_front, 490), (nan_in_front, 500)])
def test_what_is_skipped_may_be_anything(spoil: Callable, skip: int, truth: Record, tmp_path: Path) -> None:
    table = late(truth)
    spoil(table)
    np.savez(tmp_path / "r.npz", **table)
    same(brought(tmp_path, STAMPED + f"skip_samples = {skip}\n", tmp_path / "r.npz"), truth)
    assert "r.npz" in refused(tmp_path, STAMPED + "skip_samples = 20\n", tmp_path / "r.npz")


def test_what_is_behind_the_periods_may_be_anything(truth: Record, tmp_path: Path) -> None:
    """The remedy that the message names."""
    table = {name: np.delete(values, range(4100, 4103)) for name, values in columns(truth).items()}
    table["theta1"][5000] = np.inf
    np.savez(tmp_path / "r.npz", **table)
    found = refused(tmp_path, STAMPED + "periods = 2\n", tmp_path / "r.npz")
    assert "3 samples were dropped" in found and "period_samples and periods" in found and "skip_samples" in found
    text = STAMPED + "period_samples = 2000\nperiods = 2\n"
    record = brought(tmp_path, text, tmp_path / "r.npz")
    same(record, replace(truth, periods=2, tau=truth.tau[:4000], theta=truth.theta[:4000]))


def test_turns_are_counted_from_the_first_sample(truth: Record, tmp_path: Path) -> None:
    """The joint comes from zero, 40 rad motor side away, in what is skipped; the encoder jumps every 2 pi."""
    ramp = np.linspace(0, 1, 500)[:, None]
    theta = np.vstack([truth.theta[0] * ramp, truth.theta])
    theta[77] = np.nan
    np.savez(tmp_path / "r.npz", tau=np.vstack([0 * ramp * truth.tau[0], truth.tau]), theta=np.mod(theta, 2 * np.pi))
    text = SIDE_BY_SIDE.replace("NAME", "tau").replace("ANGLE", "theta") + "sample_rate_Hz = 1000\n"
    text = text.replace('unit = "rad"', f'unit = "rad", wrap = {2 * np.pi!r}') + "skip_samples = 500\n"
    record = brought(tmp_path, text, tmp_path / "r.npz")
    np.testing.assert_allclose(record.theta, truth.theta, atol=1e-12 * np.abs(truth.theta).max())


@pytest.mark.parametrize("skip", [6000, 7000])
def test_no_more_can_be_skipped_than_there_is(skip: int, truth: Record, tmp_path: Path) -> None:
    np.savez(tmp_path / "r.npz", **columns(truth))
    assert f"skip_samples = {skip}" in refused(tmp_path, STAMPED + f"skip_samples = {skip}\n", tmp_path / "r.npz")
    assert "r.npz" in refused(tmp_path, STAMPED + "skip_samples = 5998\n", tmp_path / "r.npz")


# units, zeros, sides --------------------------------------------------------------------------------------------------


def test_zeros_and_jumps_are_in_the_unit(truth: Record, tmp_path: Path) -> None:
    """As --keys says: what the file has, times gain, is in the unit; so in counts with quarters of them, too."""
    text = SIDE_BY_SIDE.replace("NAME", "tau").replace("ANGLE", "theta") + "sample_rate_Hz = 1000\n"
    milli = 1000 * (truth.theta + 0.5)
    turns = truth.theta / (2 * np.pi)
    quarters = np.mod(4 * (-4096 * turns + 100), 4 * 4096)
    for written, how in (
        (milli, 'unit = "rad", gain = 0.001, offset = 0.5'),
        (-milli, 'unit = "rad", gain = -0.001, offset = 0.5'),
        (-milli, 'unit = "rad", gain = 0.001, sign = -1, offset = -0.5'),
        (quarters, 'unit = "counts", counts_per_rev = 4096, gain = 0.25, sign = -1, offset = 100, wrap = 4096'),
        (-quarters, 'unit = "counts", counts_per_rev = 4096, gain = -0.25, sign = -1, offset = 100, wrap = 4096'),
    ):
        np.savez(tmp_path / "r.npz", tau=truth.tau, theta=written)
        theta = brought(tmp_path, text.replace('unit = "rad"', how), tmp_path / "r.npz").theta
        whole = 2 * np.pi * np.round((theta - truth.theta)[0] / (2 * np.pi)) if "wrap" in how else 0.0
        np.testing.assert_allclose(theta - whole, truth.theta, atol=1e-12 * np.abs(truth.theta).max())


def test_the_zero_of_a_torque_behind_the_gear_is_behind_the_gear(truth: Record, tmp_path: Path) -> None:
    np.savez(tmp_path / "r.npz", tau=100 * truth.tau + 7.0, theta=truth.theta)
    text = SIDE_BY_SIDE.replace("NAME", "tau").replace("ANGLE", "theta") + "sample_rate_Hz = 1000\n"
    text = text.replace('unit = "Nm"', 'unit = "Nm", side = "joint", offset = 7')
    same(brought(tmp_path, text, tmp_path / "r.npz"), truth, rel=1e-12)


# ramps and drift ------------------------------------------------------------------------------------------------------


def played(lines: np.ndarray, periods: int) -> np.ndarray:
    """As `ident export-excitation` says: the first quarter of the first period is ramped."""
    S = 2000
    x = np.tile(synthetic.multisine(lines, S, 0.1, np.random.default_rng(3), 0.5), periods)
    x[: S // 4] *= (1 - np.cos(np.pi * np.arange(S // 4) / (S // 4))) / 2
    return x


@pytest.mark.parametrize("periods", [3, 4, 6])
@pytest.mark.parametrize("lines", [np.arange(1, 240), np.arange(1, 120, 2)], ids=["full", "odd"])
def test_lines_are_found_behind_a_ramp_and_on_a_drift(lines: np.ndarray, periods: int) -> None:
    x = played(lines, periods)
    for y in (x, x + np.linspace(0, 0.1, len(x))):
        assert find_period(y) == 2000
        found = find_lines(y, 2000)
        assert found is not None
        np.testing.assert_array_equal(found, lines)


def test_a_record_with_its_ramp_is_guessed_and_read(tmp_path: Path) -> None:
    lines = np.arange(1, 240)
    np.savez(tmp_path / "r.npz", fs=1000.0, tau=played(lines, 4), theta=-played(lines, 4) * 0.1)
    record = brought(tmp_path, guess([tmp_path / "r.npz"]), tmp_path / "r.npz")
    np.testing.assert_array_equal(record.lines, lines)
    assert record.periods == 4


# names and numbers of other people ------------------------------------------------------------------------------------

WORDS = ("shoulder_pan_joint", "elbow_joint", "wrist_1_joint")


@pytest.mark.parametrize(
    ("torque", "angle", "words", "joints"),
    [
        ("js/effort/@", "js/position/@", WORDS, WORDS),
        ("tau_@", "q_@", WORDS, ("shoulder_pan", "elbow", "wrist_1")),
        ("@Torque", "@Position", ("Shoulder", "Elbow", "Wrist"), ("Shoulder", "Elbow", "Wrist")),
        ("robot.@.tau [Nm]", "robot.@.q [rad]", ("slew", "slide", "lift"), ("slew", "slide", "lift")),
    ],
)
def test_joints_may_be_named_by_words(
    torque: str, angle: str, words: tuple[str, ...], joints: tuple[str, ...], truth: Record, tmp_path: Path
) -> None:
    """Angles come in another order than torques, and there are encoders behind the springs as well."""
    table = {torque.replace("@", word): truth.tau[:, k] for k, word in enumerate(words)}
    table |= {angle.replace("@", word): truth.theta[:, k] for k, word in reversed(list(enumerate(words)))}
    table |= {"link_" + angle.replace("@", word): truth.theta[:, k] / 100 for k, word in enumerate(words)}
    np.savez(tmp_path / "r.npz", fs=1000.0, **table)
    found = tomllib.loads(guess([tmp_path / "r.npz"]))
    assert found["robot"]["joints"] == list(joints) and found["record"]["excited"] == joints[1]
    for word, joint in zip(words, joints, strict=True):
        signals = found["joint"][joint]
        assert signals["torque"]["name"] == torque.replace("@", word)
        assert signals["motor_angle"]["name"] == angle.replace("@", word)
        assert signals["link_angle"]["name"] == "link_" + angle.replace("@", word)


def test_words_that_do_not_agree_are_refused_and_readings_of_one_joint_are_not(truth: Record, tmp_path: Path) -> None:
    tau, theta = truth.tau, truth.theta
    np.savez(tmp_path / "r.npz", tau_upper=tau[:, 1], tau_lower=tau[:, 0], q_shoulder=theta[:, 1], q_elbow=theta[:, 0])
    with pytest.raises(ImportingError, match=r"r.npz: .*tau_upper, tau_lower.*q_shoulder, q_elbow.*--urdf"):
        guess([tmp_path / "r.npz"])
    link = theta[:, 1] / 100
    np.savez(tmp_path / "r.npz", tau_meas=tau[:, 1], tau_raw=tau[:, 1] * 0.99, q_meas=theta[:, 1], q_load=link)
    found = tomllib.loads(guess([tmp_path / "r.npz"]))
    assert found["robot"]["joints"] == ["joint1"]
    assert found["joint"]["joint1"]["link_angle"]["name"] == "q_load"


@pytest.mark.parametrize(
    ("name", "step", "unit", "rate", "check"),
    [
        ("t_ms", 0.05, "ms", 20e3, False),
        ("time [us]", 50.0, "us", 20e3, False),
        ("timestamp_ns", 1e7, "ns", 100, False),
        ("Time (s)", 0.01, "s", 100, False),
        ("js/header/stamp", 0.02, "s", 50, False),
        ("t", 0.02, "ms", 50e3, True),
        ("time", 0.001, "s", 1000, False),
        ("time_ms", 0.001, "s", 1000, True),
    ],
)
def test_the_unit_of_time_is_as_named_else_of_the_higher_rate(
    name: str, step: float, unit: str, rate: float, check: bool, truth: Record, tmp_path: Path
) -> None:
    table = {name: step * np.arange(6000), "tau": truth.tau[:, 1], "theta": truth.theta[:, 1]}
    np.savez(tmp_path / "r.npz", **table)
    text = guess([tmp_path / "r.npz"])
    (line,) = re.findall("(?m)^time = .*$", text)
    assert f'unit = "{unit}"' in line and f"# {rate:g} Hz" in line and ("CHECK" in line) == check


def test_decimal_commas_behind_rows_of_whole_numbers(truth: Record, tmp_path: Path) -> None:
    """One row of zeros, as the clock starts; and more of them than the head that is looked at."""
    for separator in (";", "\t"):
        file = csv(tmp_path / "r.csv", truth, separator, ",")
        for zeros in (1, 300):
            lines = file.read_text().splitlines()
            lines[2:2] = [separator.join(["0"] * 7)] * zeros
            (tmp_path / "zeros.csv").write_text("\n".join(lines) + "\n")
            found = read_variables(tmp_path / "zeros.csv")
            np.testing.assert_array_equal(found["theta2"], np.concatenate([np.zeros(zeros), truth.theta[:, 1]]))


def test_cells_of_many_shapes_do_not_hide_the_rest(tmp_path: Path) -> None:
    cell = np.empty(2, dtype=object)
    cell[:] = [{"a": 1.0}, np.arange(3.0)]
    savemat(tmp_path / "r.mat", {"config": cell, "tau": np.arange(5.0)})
    found = read_variables(tmp_path / "r.mat")
    assert set(found) == {"tau"}
    np.testing.assert_array_equal(found["tau"], np.arange(5.0))


def test_fields_of_structured_arrays_are_columns(tmp_path: Path) -> None:
    """Struct arrays of MATLAB, structured ones of numpy, compounds of HDF5."""
    x = np.zeros(5, dtype=[("tau", float), ("axis", [("q", float, 2)])])
    x["tau"], x["axis"]["q"] = np.arange(5.0), np.arange(10.0).reshape(5, 2)
    np.savez(tmp_path / "r.npz", data=x)
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file["data"] = x
    for name, mark in (("r.npz", "."), ("r.h5", "/")):
        found = read_variables(tmp_path / name)
        np.testing.assert_array_equal(found[f"data{mark}tau"], x["tau"])
        np.testing.assert_array_equal(found[f"data{mark}axis{mark}q"], x["axis"]["q"])
    savemat(tmp_path / "r.mat", {"run": np.array([{"tau": np.arange(5.0)}, {"tau": np.ones(3)}], dtype=object)})
    found = read_variables(tmp_path / "r.mat")
    np.testing.assert_array_equal(found["run(1).tau"], np.arange(5.0))
    np.testing.assert_array_equal(found["run(2).tau"], np.ones(3))


def test_what_is_no_array_of_numbers_is_told(truth: Record, tmp_path: Path) -> None:
    np.savez(tmp_path / "r.npz", tau=truth.tau * 1j, note="text")
    with pytest.raises(ImportingError, match="a NPZ file without numbers, but 'tau' is complex; 'note' is text"):
        read_variables(tmp_path / "r.npz")
    np.savez(tmp_path / "r.npz", tau=truth.tau, theta=truth.theta * 1j)
    text = SIDE_BY_SIDE.replace("NAME", "tau").replace("ANGLE", "theta") + "sample_rate_Hz = 1000\n"
    assert "motor_angle: 'theta' is complex; expected numbers" in refused(tmp_path, text, tmp_path / "r.npz")


def test_signals_in_rows_are_called_transposed(truth: Record, tmp_path: Path) -> None:
    text = SIDE_BY_SIDE.replace("NAME", "tau").replace("ANGLE", "theta")
    for changed in ({"tau": truth.tau.T}, {"theta": truth.theta.T}):
        np.savez(tmp_path / "r.npz", **({"t": np.arange(6000) / 1e3, "tau": truth.tau, "theta": truth.theta} | changed))
        for rate in ("sample_rate_Hz = 1000\n", 'time = {name = "t", unit = "s"}\n'):
            found = refused(tmp_path, text + rate, tmp_path / "r.npz")
            assert f"{next(iter(changed))!r} is 3 x 6000: transposed; expected a row a sample" in found
