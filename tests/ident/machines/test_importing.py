"""Records written as other programs write them come back as they were; whatever is amiss is one line that says so."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import synthetic
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_ros2.writer import Writer as RosWriter
from scipy.io import savemat

from ident.cli import main
from ident.errors import IdentError, ImportingError
from ident.machines.guess import guess
from ident.machines.importing import import_files
from ident.machines.mapping import load_map
from ident.machines.readers import read_variables
from ident.machines.source_file import in_words
from ident.records.campaign import Record
from ident.records.periodic import find_lines, find_period
from ident.records.store import read_campaign, write_campaign
from symgen.errors import SymgenError
from symgen.plan import model_of_urdf

URDF = Path(__file__).parents[3] / "robots/ypp3/ypp3.urdf"
GAINS = [[0.05, 0.005]] * 3
POSTURE = [0.1, 0.4, -0.3]
JOINT_STATE = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{"=" * 80}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{"=" * 80}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
LINES = np.delete(np.arange(5, 240, 2), slice(3, None, 7))


@pytest.fixture(scope="module")
def truth() -> Record:
    return settled()


def settled() -> Record:
    """Joint 2 of a three-joint arm excited at 118 lines of 0.5 Hz, three settled periods."""
    rng = np.random.default_rng(3)
    record = synthetic.record(
        synthetic.YPP, 1, lines=LINES, periods=6, f0=0.5, gains=GAINS, rng=rng, id="0001", posture=POSTURE
    )
    half = slice(3 * 2000, None)
    return replace(record, periods=3, tau=record.tau[half], theta=record.theta[half])


def columns(record: Record) -> dict[str, np.ndarray]:
    t = np.arange(len(record.tau)) / synthetic.FS
    return {"t": t} | {f"{key}{j + 1}": getattr(record, key)[:, j] for key in ("tau", "theta") for j in range(3)}


def csv(path: Path, record: Record, separator: str = ",", decimal: str = ".") -> Path:
    table = columns(record)
    rows = [separator.join(table)] + [
        separator.join(repr(float(x)).replace(".", decimal) for x in row) for row in zip(*table.values(), strict=True)
    ]
    path.write_text("% a log\n" + "\n".join(rows) + "\n")
    return path


def three_joints(torque: str, angle: str) -> str:
    tables = [
        f"[joint.joint{j}]\nN = 100\nK_Nm_per_rad = {[5500, 4500, 4500][j - 1]}\n"
        f"torque = {torque.replace('@', str(j))}\nmotor_angle = {angle.replace('@', str(j))}\n"
        for j in (1, 2, 3)
    ]
    return (
        f'[campaign]\nhold = "zoh"\n[robot]\nurdf = "{URDF}"\n{"".join(tables)}'
        f"[record]\nexcited = \"joint2\"\nposture_rad = {POSTURE}\n"
    )  # fmt: skip


NAMED = three_joints('{name = "tau@", unit = "Nm"}', '{name = "theta@", unit = "rad"}')
SIDE_BY_SIDE = three_joints('{name = "NAME", column = @, unit = "Nm"}', '{name = "ANGLE", column = @, unit = "rad"}')


def brought(folder: Path, text: str, *files: Path) -> Record:
    (folder / "map.toml").write_text(text)
    found = import_files(load_map(folder / "map.toml"), files)
    write_campaign(found.campaign, folder / "out.h5")  # every rule of the format
    record = read_campaign(folder / "out.h5").records[0]
    return record


def same(record: Record, truth: Record, rel: float = 1e-13) -> None:
    for name in ("excited", "f0", "samples_per_period", "periods"):
        assert getattr(record, name) == getattr(truth, name)
    np.testing.assert_array_equal(record.lines, truth.lines)
    np.testing.assert_array_equal(record.posture, truth.posture)
    for name in ("tau", "theta"):
        expected = getattr(truth, name)
        np.testing.assert_allclose(getattr(record, name), expected, atol=rel * np.abs(expected).max(), rtol=0)


def mat73(path: Path, record: Record) -> None:
    """As MATLAB writes it: a block of its own before the HDF5 file, arrays by columns, a struct as a group."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name in ("tau", "theta"):
            file.create_dataset(f"log/{name}", data=getattr(record, name).T).attrs["MATLAB_class"] = np.bytes_("double")
        file.create_dataset("note", data=np.array([[104], [105]], np.uint16)).attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(128))


def hdf5(path: Path, record: Record) -> None:
    with h5py.File(path, "w") as file:
        file["log/tau"], file["log/theta"], file["note"] = record.tau, record.theta, "text"


WRITERS: dict[str, tuple[str, Callable[[Path, Record], object]]] = {
    "npz": ("tau theta", lambda path, record: np.savez(path, tau=record.tau, theta=record.theta)),
    "mat": ("log.tau log.theta", lambda path, r: savemat(path, {"log": {"tau": r.tau, "theta": r.theta}, "s": "text"})),
    "mat73": ("log.tau log.theta", mat73),
    "h5": ("log/tau log/theta", hdf5),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_binary_files_with_a_column_a_joint(kind: str, truth: Record, tmp_path: Path) -> None:
    names, write = WRITERS[kind]
    file = tmp_path / f"record.{'mat' if kind == 'mat73' else kind}"
    write(file, truth)
    torque, angle = names.split()
    text = SIDE_BY_SIDE.replace("NAME", torque).replace("ANGLE", angle)
    same(brought(tmp_path, text + "sample_rate_Hz = 1000\nf0_Hz = 0.5\n", file), truth)


@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), ("\t", "."), (";", "."), (" ", ".")])
def test_text_files_of_all_countries(separator: str, decimal: str, truth: Record, tmp_path: Path) -> None:
    file = csv(tmp_path / "record.csv", truth, separator, decimal)
    same(brought(tmp_path, NAMED + 'time = {name = "t", unit = "s"}\n', file), truth)


def bag(path: Path, record: Record, compression: CompressionType = CompressionType.ZSTD) -> Path:
    """As ROS 2 records it: one JointState a sample, a topic that is no number, one that nobody can decode."""
    start = 1_700_000_000 * 10**9 + 999_500_000  # seconds change between two samples
    with path.open("wb") as stream:
        writer = RosWriter(stream, compression=compression)
        states = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        words = writer.register_msgdef("std_msgs/msg/String", "string data")
        writer.write_message("/log", words, {"data": "begin"}, log_time=start, publish_time=start)
        for k, (theta, tau) in enumerate(zip(record.theta, record.tau, strict=True)):
            t = start + k * 10**9 // int(synthetic.FS)
            header = {"stamp": {"sec": t // 10**9, "nanosec": t % 10**9}, "frame_id": ""}
            state = {
                "name": ["joint1", "joint2", "joint3"],
                "position": theta.tolist(),
                "velocity": [],
                "effort": tau.tolist(),
            }
            writer.write_message("/joint_states", states, {"header": header, **state}, log_time=t, publish_time=t)
        writer.finish()
    return path


def test_bags_of_ros_2(truth: Record, tmp_path: Path) -> None:
    torque, angle = '"joint_states/effort/joint@", unit = "Nm"', '"joint_states/position/joint@", unit = "rad"'
    text = three_joints(f"{{name = {torque}}}", f"{{name = {angle}}}")
    text += 'time = {name = "joint_states/header/stamp", unit = "s"}\n'
    same(brought(tmp_path, text, bag(tmp_path / "record.mcap", truth)), truth)
    guessed = guess([tmp_path / "record.mcap"], URDF)
    assert "joint_states/effort/joint2" in guessed and "joint_states/header/stamp" in guessed


def test_json_topics_of_an_mcap_file_and_what_is_left_out(tmp_path: Path) -> None:
    with (tmp_path / "x.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        topics = {
            name: writer.register_channel(f"/{name}", kind, schema)
            for name, kind in (("drive", "json"), ("p", "protobuf"))
        }
        for k in range(3):
            message = {"on": True, "pair": [k, 2.5], "ragged": [0] * k, "axes": [{"i": k}, {"i": -k}], "text": "t"} | (
                {"once": 1} if k == 1 else {}
            )
            for topic in topics.values():
                writer.add_message(topic, log_time=k * 10**9, publish_time=0, data=json.dumps(message).encode())
        writer.finish()
    found = read_variables(tmp_path / "x.mcap")
    assert set(found) == {f"drive/{name}" for name in ("log_time", "on", "pair", "axes/1/i", "axes/2/i")}
    np.testing.assert_array_equal(found["drive/pair"], [[0, 2.5], [1, 2.5], [2, 2.5]])
    np.testing.assert_array_equal(found["drive/axes/2/i"], [0, -1, -2])
    np.testing.assert_array_equal(found["drive/log_time"], [0, 1, 2])


def test_an_mcap_file_of_other_messages_says_which(tmp_path: Path) -> None:
    with (tmp_path / "x.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        topic = writer.register_channel("/states", "protobuf", writer.register_schema("any", "protobuf", b""))
        writer.add_message(topic, log_time=0, publish_time=0, data=b"\x01")
        writer.finish()
    with pytest.raises(
        ImportingError, match=r"x.mcap: no topic that can be decoded, but /states \(protobuf\); expected"
    ):
        read_variables(tmp_path / "x.mcap")


def test_units_signs_sides_and_zeros_are_undone(truth: Record, tmp_path: Path) -> None:
    """A controller that counts joint angles in 12 500 counts a turn with another zero, and reads currents the wrong way."""
    N, constant, lost = 100.0, 0.2, 1234.5
    written = {
        "i": -truth.tau / constant * 1e3,
        "enc": np.mod(truth.theta / N / (2 * np.pi) * 12500 + lost, 3000.0),
        "link": np.degrees(truth.theta / N) + 2.0,
        "speed": np.gradient(truth.theta, axis=0) * 60 / (2 * np.pi),
    }
    np.savez(tmp_path / "record.npz", **written)
    angle = f'{{name = "enc", column = @, unit = "counts", counts_per_rev = 12500, side = "joint", wrap = 3000, offset = {lost}}}'
    text = three_joints(
        f'{{name = "i", column = @, unit = "mA", sign = -1, torque_constant_Nm_per_A = {constant}}}', angle
    )
    for j in (1, 2, 3):
        text = text.replace(
            f"[joint.joint{j}]\n",
            f'[joint.joint{j}]\nlink_angle = {{name = "link", column = {j}, unit = "deg", offset = 2}}\n'
            f'motor_velocity = {{name = "speed", column = {j}, unit = "rpm"}}\n',
        )
    record = brought(tmp_path, text + "sample_rate_Hz = 1000\n", tmp_path / "record.npz")
    same(record, replace(truth, tau=truth.tau, theta=truth.theta), rel=1e-11)
    np.testing.assert_allclose(record.q_link, truth.theta / N, atol=1e-13)
    np.testing.assert_allclose(record.omega, np.gradient(truth.theta, axis=0), atol=1e-10)


def test_a_zero_may_be_taken_from_the_posture_or_the_posture_from_the_angles(truth: Record, tmp_path: Path) -> None:
    np.savez(tmp_path / "record.npz", tau=truth.tau, theta=truth.theta + [5.0, -3.0, 100.0])
    text = SIDE_BY_SIDE.replace("NAME", "tau").replace("ANGLE", "theta") + "sample_rate_Hz = 1000\n"
    shifted = text.replace('unit = "rad"', 'unit = "rad", offset = "posture"')
    record = brought(tmp_path, shifted, tmp_path / "record.npz")
    np.testing.assert_allclose(record.theta[-2000:].mean(axis=0), 100 * np.array(POSTURE), rtol=1e-12)
    np.testing.assert_allclose(np.diff(record.theta, axis=0), np.diff(truth.theta, axis=0), atol=1e-12)
    asked = measured = re.sub("posture_rad.*", 'posture_rad = "measured"', text)
    record = brought(tmp_path, measured, tmp_path / "record.npz")
    mean = record.theta[-2000:].mean(axis=0) / 100
    sag = 100 * record.tau[-2000:].mean(axis=0) / [5500, 4500, 4500]  # what the springs give, of the K of the map
    np.testing.assert_allclose(record.posture, mean - sag, rtol=1e-12)
    loose = brought(tmp_path, re.sub("K_Nm_per_rad.*", "", measured), tmp_path / "record.npz")
    np.testing.assert_allclose(loose.posture, mean, rtol=1e-12)
    for j in (1, 2, 3):
        link = f'[joint.joint{j}]\nlink_angle = {{name = "theta", column = {j}, unit = "mrad"}}\n'
        measured = measured.replace(f"[joint.joint{j}]\n", link)
    read = brought(tmp_path, measured, tmp_path / "record.npz")
    np.testing.assert_allclose(read.posture, mean / 10, rtol=1e-12)
    for own in ("link_angle", "motor_angle"):
        taken = re.sub(f"({own} = .*)}}", r'\1, offset = "posture"}', measured if own == "link_angle" else asked)
        with pytest.raises(ImportingError, match=f'"measured" and offset "posture" of its {own} take each from the ot'):
            brought(tmp_path, taken, tmp_path / "record.npz")


def test_a_reading_that_wraps_tells_no_posture(truth: Record, tmp_path: Path) -> None:
    """Of the motor: it reads the same at a hundred angles of the joint. That of the joint's own turn tells which."""
    np.savez(tmp_path / "record.npz", tau=truth.tau, theta=np.mod(truth.theta, 2 * np.pi))
    text = SIDE_BY_SIDE.replace("NAME", "tau").replace("ANGLE", "theta") + "sample_rate_Hz = 1000\n"
    text = re.sub("posture_rad.*", 'posture_rad = "measured"', text)
    wraps = text.replace('unit = "rad"', f'unit = "rad", wrap = {2 * np.pi!r}')
    with pytest.raises(ImportingError, match="joint1: .*wraps within a turn of the joint"):
        brought(tmp_path, wraps, tmp_path / "record.npz")
    np.savez(tmp_path / "record.npz", tau=truth.tau, theta=np.mod(truth.theta / 100 + 1.0, 2 * np.pi))
    brought(
        tmp_path,
        wraps.replace('unit = "rad", wrap', 'unit = "rad", side = "joint", offset = 1.0, wrap'),
        tmp_path / "record.npz",
    )


def test_currents_of_joints_that_pull_on_each_other_need_their_constants(truth: Record, tmp_path: Path) -> None:
    text = NAMED.replace('unit = "Nm"', 'unit = "A"', 1) + "sample_rate_Hz = 1000\n"
    with pytest.raises(ImportingError, match="torque of joint1 in A without torque_constant_Nm_per_A"):
        brought(tmp_path, text, csv(tmp_path / "record.csv", truth))


def test_each_file_may_be_told_apart(truth: Record, tmp_path: Path) -> None:
    """The second file has another number of periods and half a second before the first."""
    csv(tmp_path / "one.csv", truth)
    late = replace(
        truth, tau=np.vstack([truth.tau[:500], truth.tau]), theta=np.vstack([truth.theta[:500], truth.theta])
    )
    csv(tmp_path / "two.csv", late)
    text = NAMED + 'time = {name = "t", unit = "s"}\n[file."two.csv"]\nskip_samples = 500\nperiods = 2\n'
    (tmp_path / "map.toml").write_text(text)
    found = import_files(load_map(tmp_path / "map.toml"), [tmp_path / "one.csv", tmp_path / "two.csv"])
    one, two = found.campaign.records
    assert (one.periods, two.periods, two.id) == (3, 2, "0002")
    np.testing.assert_array_equal(two.tau, one.tau[:4000])
    alone = import_files(load_map(tmp_path / "map.toml"), [tmp_path / "one.csv"])
    assert any("two.csv" in note for note in alone.notes)


def test_a_record_is_brought_in_once(truth: Record, tmp_path: Path) -> None:
    """Its copy, whatever it is called and however it is written, would count as a second measurement."""
    np.savez(tmp_path / "one.npz", **columns(truth))
    csv(tmp_path / "two.csv", truth)
    (tmp_path / "map.toml").write_text(NAMED + "sample_rate_Hz = 1000\n")
    with pytest.raises(ImportingError, match=r"two.csv: has the samples of .*one.npz; expected each record once"):
        import_files(load_map(tmp_path / "map.toml"), [tmp_path / "one.npz", tmp_path / "two.csv"])


def test_a_file_may_have_a_name_that_is_no_text(truth: Record, tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"r\xe9c.npz")
    with path.open("wb") as file:
        np.savez(file, **columns(truth))
    brought(tmp_path, NAMED + 'time = {name = "t", unit = "s"}\n', path)
    assert read_campaign(tmp_path / "out.h5").source == "a measured machine; files r?c.npz"
    assert in_words("said", ["a/b.csv", path]) == "said; files b.csv, r?c.npz"


def test_a_complex_variable_of_matlab_is_called_that(tmp_path: Path) -> None:
    """MATLAB 7.3 has complex numbers as pairs "real" and "imag"."""
    with h5py.File(tmp_path / "x.mat", "w", userblock_size=512) as file:
        pair = np.zeros((1, 300), dtype=[("real", float), ("imag", float)])
        file["wave"], file["t"], file["pairs"] = pair, np.arange(300.0), pair.astype([("a", float), ("b", float)])
        file["wave"].attrs["MATLAB_class"] = np.bytes_("double")
    with (tmp_path / "x.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    found = read_variables(tmp_path / "x.mat")
    assert list(found) == ["t"] and found.left_out == {"wave": "complex", "pairs": "a table of several fields"}


def test_a_stand_in_has_the_inertias_that_were_said(truth: Record, tmp_path: Path) -> None:
    text = NAMED.replace(f'urdf = "{URDF}"', 'joints = ["joint1", "joint2", "joint3"]')
    for j, J in ((1, 0.5), (2, 0.3), (3, 0.2)):
        text = text.replace(f"[joint.joint{j}]\n", f"[joint.joint{j}]\nJ_l_kgm2 = {J}\n")
    (tmp_path / "map.toml").write_text(text + "sample_rate_Hz = 1000\n")
    mapping = load_map(tmp_path / "map.toml")
    model = model_of_urdf(mapping.urdf, ("joint1", "joint2", "joint3"))
    for q in np.random.default_rng(0).uniform(-3, 3, (5, 3)):
        np.testing.assert_allclose(np.diag(model.J_cad(q)), [1.0, 0.5, 0.2], rtol=1e-12)


def test_wrong_signs_and_gears_are_noted(truth: Record, tmp_path: Path) -> None:
    np.savez(tmp_path / "record.npz", tau=truth.tau, theta=-truth.theta, link=-truth.theta / 40)
    text = SIDE_BY_SIDE.replace("NAME", "tau").replace("ANGLE", "theta") + "sample_rate_Hz = 1000\n"
    for j in (1, 2, 3):
        link = f'[joint.joint{j}]\nlink_angle = {{name = "link", column = {j}, unit = "rad"}}\n'
        text = text.replace(f"[joint.joint{j}]\n", link)
    (tmp_path / "map.toml").write_text(text)
    notes = import_files(load_map(tmp_path / "map.toml"), [tmp_path / "record.npz"]).notes
    assert any("opposite sign" in note and "torque" in note for note in notes)
    assert any("moves 2.5 times" in note for note in notes)


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ('column = @, unit = "rad/s"', ""),
        ('column = @, unit = "deg/s"', "is 0.017 times the slope"),
        ('column = @, unit = "rad/s", sign = -1', "is -1 times the slope"),
        ('column = 1, unit = "rad/s"', "times the slope"),
    ],
)
def test_a_velocity_that_is_not_the_slope_of_its_angle_is_noted(
    how: str, says: str, truth: Record, tmp_path: Path
) -> None:
    speed = np.gradient(truth.theta, 1 / synthetic.FS, axis=0)
    np.savez(tmp_path / "record.npz", tau=truth.tau, theta=truth.theta, speed=speed)
    text = SIDE_BY_SIDE.replace("NAME", "tau").replace("ANGLE", "theta") + "sample_rate_Hz = 1000\n"
    for j in (1, 2, 3):
        velocity = f'[joint.joint{j}]\nmotor_velocity = {{name = "speed", {how.replace("@", str(j))}}}\n'
        text = text.replace(f"[joint.joint{j}]\n", velocity)
    (tmp_path / "map.toml").write_text(text)
    notes = import_files(load_map(tmp_path / "map.toml"), [tmp_path / "record.npz"]).notes
    told = [note for note in notes if "motor_velocity of joint2" in note]
    assert len(told) == bool(says) and all(says in note for note in told)


def test_a_gear_that_no_angle_at_rest_tells_of_is_noted(truth: Record, tmp_path: Path) -> None:
    np.savez(tmp_path / "record.npz", tau=truth.tau, theta=truth.theta)
    text = SIDE_BY_SIDE.replace("NAME", "tau").replace("ANGLE", "theta") + "sample_rate_Hz = 1000\n"
    for posture, noted in (
        ([0.0, 0.4, -0.2], ["joint1"]),
        ([0.0, 0.4, 0.0], ["joint1, joint3"]),
        ([0.3, 0.4, -0.2], []),
    ):
        (tmp_path / "map.toml").write_text(text.replace(str(POSTURE), str(posture)))
        notes = import_files(load_map(tmp_path / "map.toml"), [tmp_path / "record.npz"]).notes
        told = [note for note in notes if "taken as declared" in note]
        assert [note.split(" of ")[1].split(" are ")[0] for note in told] == noted


# what may be amiss ----------------------------------------------------------------------------------------------------

BAD_MAPS = [
    ('unit = "rad"', 'unit = "radians"', "unit"),
    ('unit = "rad"', 'unt = "rad"', "unknown key 'unt'"),
    ('unit = "rad"', 'unit = "counts"', "counts_per_rev"),
    ('unit = "Nm"', 'unit = "Nm", torque_constant_Nm_per_A = 2', "goes with a current"),
    ('"tau1", unit = "Nm"', '"tau1"', "unit is missing"),
    ("N = 100", "N = 0", "other than 0"),
    ("N = 100", "ratio = 100", "unknown key 'ratio'"),
    ('hold = "zoh"', "", "hold is missing"),
    ('hold = "zoh"', 'hold = "foh"', "'zoh' or 'band-limited'"),
    ('excited = "joint2"', 'excited = "elbow"', "'joint1' or 'joint2' or 'joint3'"),
    ("[0.1, 0.4, -0.3]", "[0.1, 0.4]", "3 numbers"),
    ("[record]", "[record]\nlines = [5, 5]", "increasing"),
    ("[record]", '[record]\nlines = "9:2:3:4"', "first:step:last"),
    ("[record]", "[recording]", "unknown key 'recording'"),
    ("[joint.joint3]", "[joint.joint4]", "joint3"),
    ("[robot]", '[robot]\njoints = ["joint2", "joint1"]', "in this order"),
    ("[robot]", '[robot]\nJ = "x"', "unknown key 'J'"),
    (f'urdf = "{URDF}"', "", "neither urdf nor joints"),
    (f'urdf = "{URDF}"', 'urdf = "nowhere.urdf"', "nowhere.urdf"),
    ("[joint.joint1]", "[joint.joint1]\nJ_l_kgm2 = 1", "the URDF says it"),
    ("[joint.joint1]", '[joint.joint1]\nlink_angle = {name = "x", unit = "rad"}', "of every joint or of none"),
    ("[record]", "[record]\nsample_rate_Hz = 2", "the sampling rate in Hz, from 5 to 200000"),
    ('"theta1", unit = "rad"', '"theta1", unit = "mm"', "joint1: motor_angle in mm, but the joint is revolute"),
    ("[joint.joint2]", '[joint.joint2]\nmotor_velocity = {name = "w", unit = "m/s"}', "joint2: motor_velocity in m/s"),
    ("[campaign]", "[campaign", "not TOML"),
]


@pytest.mark.parametrize(("old", "new", "says"), BAD_MAPS, ids=[says for *_, says in BAD_MAPS])
def test_a_map_is_read_strictly(old: str, new: str, says: str, tmp_path: Path) -> None:
    assert old in NAMED
    (tmp_path / "map.toml").write_text(NAMED.replace(old, new, 1))
    with pytest.raises((IdentError, SymgenError)) as caught:
        load_map(tmp_path / "map.toml")
    assert says in str(caught.value) and "\n" not in str(caught.value)


SLIDE = """[campaign]\nhold = "zoh"\n[robot]\njoints = ["z"]\n[joint.z]\nm_l_kg = 2\ntorque = {name = "f", unit = "Nm"}
motor_angle = {name = "x", ANGLE}\n[record]\n"""


@pytest.mark.parametrize(
    ("angle", "says"),
    [
        ('unit = "mm"}', ""),
        ('unit = "mm", side = "joint"}\nN_rad_per_m = 300', ""),
        ('unit = "deg"}\nN_rad_per_m = 300', ""),
        ('unit = "deg"}', "z: motor_angle in deg, but the joint slides; expected m or mm, or the N_rad_per_m of a motor"),
        ('unit = "rad", side = "joint"}\nN_rad_per_m = 300', "z: motor_angle in rad, but the joint slides; expected m or mm"),
        ('unit = "mm"}\nN_rad_per_m = 300', 'says that the motor turns; expected side = "joint"'),
        ('unit = "mm"}\nmotor_velocity = {name = "v", unit = "rpm"}', "motor_velocity in rpm, but the joint slides; expected m/s or mm/s"),
    ],
)  # fmt: skip
def test_a_slide_is_measured_in_lengths_and_its_motor_may_turn(angle: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(SLIDE.replace("ANGLE}", angle))
    if not says:
        load_map(tmp_path / "map.toml")
        return
    with pytest.raises(ImportingError, match=re.escape(says)):
        load_map(tmp_path / "map.toml")


BAD_FILES = [
    ("", lambda c: c.pop("tau2"), "no variable 'tau2'"),
    ("", lambda c: c["theta3"].__setitem__(77, np.nan), "sample 77 of 'theta3' is nan"),
    ("", lambda c: c.update({k: np.delete(v, [800, 801, 3000]) for k, v in c.items()}), "3 samples were dropped, the first 2 after sample 799"),
    ("", lambda c: c["t"].__setitem__(5, 0.0), "does not increase after sample 4"),
    ("", lambda c: c["t"].__setitem__(4000, c["t"][4000] + 4e-4), "from an even grid"),
    ("", lambda c: c["t"].__setitem__(4000, c["t"][4000] + 4e-4), "sample_rate_Hz in the place of time"),
    ("", lambda c: c.update(t=c["t"] * 1e3), "says 1 Hz, expected 5 to 200000 Hz; its unit is more likely ms (1000 Hz)"),
    ("sample_rate_Hz = 500", lambda c: None, "sample_rate_Hz = 500"),
    ("sample_rate_Hz = 1010", lambda c: None, "expected one rate"),
    ("f0_Hz = 0.7", lambda c: None, "f0_Hz = 0.7"),
    ("periods = 4", lambda c: None, "3 whole periods"),
    ("period_samples = 4000", lambda c: None, "1 whole periods"),
    ('lines = "1:1000"', lambda c: None, "not below half"),
    ("", lambda c: c.update(tau2=np.random.default_rng(0).normal(size=6000)), "no period found"),
    ("", lambda c: c.update(tau2=np.sin(2 * np.pi * c["t"] * 0.5)), "no multisine"),
]  # fmt: skip


@pytest.mark.parametrize(("key", "spoil", "says"), BAD_FILES, ids=[says for *_, says in BAD_FILES])
def test_a_record_that_is_amiss_is_one_line(
    key: str, spoil: Callable, says: str, truth: Record, tmp_path: Path
) -> None:
    table = {name: values.copy() for name, values in columns(truth).items()}
    spoil(table)
    np.savez(tmp_path / "record.npz", **table)
    (tmp_path / "map.toml").write_text(NAMED + f'time = {{name = "t", unit = "s"}}\n{key}\n')
    with pytest.raises(ImportingError) as caught:
        import_files(load_map(tmp_path / "map.toml"), [tmp_path / "record.npz"])
    assert says in str(caught.value) and "record.npz" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "no row of numbers"),
        (b"some words\nand more\n", "no row of numbers"),
        (b"a,b\n1,2\n3\n", "line 3 has 1 cell, expected 2"),
        (b"\x89MCAP0\r\n", "MCAP"),
        (b"PK\x03\x04 no archive", "NPZ"),
        (b"MATLAB 5.0 MAT-file" + b" " * 105 + b"\x00\x01IM" + b"\x0f\x00\x00\x00\xff\x00\x00\x00junk", "MAT"),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "HDF5"),
        (b"\x7fELF\x00\x00", "unknown kind"),
    ],
)
def test_files_that_are_none(content: bytes, says: str, tmp_path: Path) -> None:
    (tmp_path / "x.dat").write_bytes(content)
    with pytest.raises(ImportingError) as caught:
        read_variables(tmp_path / "x.dat")
    assert says in str(caught.value) and "x.dat" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["npz", "mat73", "h5", "csv", "mcap"])  # scipy itself can crash on a damaged MAT file
def test_damaged_files_end_in_one_line(kind: str, truth: Record, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    short = replace(truth, periods=1, tau=truth.tau[:300], theta=truth.theta[:300])
    file = tmp_path / f"record.{'mat' if kind == 'mat73' else kind}"
    {"csv": csv, "mcap": bag}.get(kind, WRITERS.get(kind, ("", csv))[1])(file, short)
    sound, refused = file.read_bytes(), 0
    for k in range(60):
        damaged = bytearray(sound[: rng.integers(len(sound))] if k % 2 else sound)
        for place in rng.integers(min(len(damaged), 3000), size=3) if len(damaged) else ():
            damaged[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(damaged)
        try:
            read_variables(file)
        except ImportingError as error:
            refused += 1
            assert "record." in str(error) and "\n" not in str(error)
    assert refused > 5


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "no FILE"),
        (["r.npz"], "--map is missing"),
        (["r.npz", "--map", "map.toml"], "-o is missing"),
        (["r.npz", "--guess", "-o", "x.h5"], "does not go with --guess"),
        (["r.npz", "--map", "nowhere.toml", "-o", "x.h5"], "nowhere.toml"),
        (["nowhere.npz", "--map", "map.toml", "-o", "x.h5"], "nowhere.npz"),
        (["r.npz", "r.npz", "--map", "map.toml", "-o", "x.h5"], "two files of one name"),
        (["r.npz", "--map", "map.toml", "-o", "."], "a directory"),
        (["r.npz", "--map", "far.toml", "-o", "x.h5"], "within its limits"),
    ],
)
def test_the_command_refuses_in_one_line(
    arguments: list[str], says: str, truth: Record, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    np.savez("r.npz", **columns(truth))
    text = NAMED + "sample_rate_Hz = 1000\n"
    Path("map.toml").write_text(text)
    Path("far.toml").write_text(text.replace(str(POSTURE), "[0.1, 40.0, -0.3]"))
    before = sorted(tmp_path.iterdir())
    assert main(["import", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == "" and says in err and err.count("\n") == 1 and err.startswith("ident: ")
    assert sorted(tmp_path.iterdir()) == before


def test_what_is_neither_a_multisine_nor_named_is_refused_with_a_line_that_says_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t = np.arange(5000) / 200
    np.savez(tmp_path / "log.npz", time=t, a=np.sin(t) + 0.1 * np.cos(3.3 * t), b=np.cos(t))
    assert main(["import", "--guess", str(tmp_path / "log.npz")]) == 2
    assert "no channel is a multisine" in capsys.readouterr().err


# what the data tell ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_period_and_lines_are_found_whatever_was_played(seed: int) -> None:
    """Noise of 0.3 % to 10 %, 2 to 8 periods and a part of one, full, odd or sparse lines."""
    rng = np.random.default_rng(seed)
    S, periods = int(rng.integers(300, 3000)), int(rng.integers(2, 9))
    top = int(rng.integers(S // 8, S // 2 - 1))
    lines = np.arange(1, top)[:: rng.integers(1, 4)]
    lines = lines[rng.random(len(lines)) < 0.8]
    x = synthetic.multisine(lines, S, 1.0, rng, f0=3.0 * rng.uniform(0.1, 1))
    x = np.tile(x, periods + 1)[: periods * S + int(rng.integers(0, S))]
    x = x + 10 ** rng.uniform(-2.5, -1) * rng.normal(size=len(x)) * 0.1
    assert find_period(x) == S
    found = find_lines(x[: periods * S], S)
    assert found is not None
    np.testing.assert_array_equal(found, lines)


def test_nothing_is_found_in_noise_steps_and_constants() -> None:
    rng = np.random.default_rng(0)
    for x in (rng.normal(size=4000), np.ones(4000), np.cumsum(rng.normal(size=4000)), np.arange(4000.0)):
        assert find_period(x) is None


def test_a_guess_is_a_map_that_gives_the_campaign_back(truth: Record, tmp_path: Path) -> None:
    """Names, columns, joints, the one excited, period, lines, sampling rate: found. N is for a person to say."""
    file = csv(tmp_path / "record.csv", truth)
    text = guess([file], URDF)
    assert "CHECK" in text
    text = text.replace("N = 1 ", "N = 100 ").replace('hold = "band-limited"', 'hold = "zoh"')
    text = re.sub("posture_rad.*", f"posture_rad = {POSTURE}", text)
    same(brought(tmp_path, text, file), truth)


def test_a_guess_knows_thousandths_and_whose_current_is_played(truth: Record, tmp_path: Path) -> None:
    """Not the largest one, which answers a slow motion."""
    tau = truth.tau.copy()
    tau[:, 0] += 9.0 * np.abs(truth.tau).max() * np.sin(0.02 * np.arange(len(tau)))
    file = csv(tmp_path / "record.csv", replace(truth, tau=tau))
    note, heading, *rows = file.read_text().splitlines()
    file.write_text("\n".join([note, re.sub(r"tau(\d)", r"axis\1_current_mA", heading), *rows]))
    found = tomllib.loads(guess([file], URDF))
    assert found["record"]["excited"] == truth.excited
    assert {joint["torque"]["unit"] for joint in found["joint"].values()} == {"mA"}


def test_a_guess_knows_motor_from_link_and_the_gear(tmp_path: Path) -> None:
    """One joint, two encoders under names that tell nothing, the link's the other way round: found by the data."""
    rng = np.random.default_rng(2)
    arm = synthetic.Arm.joint(1e-4, 5000.0, 0.8, 1e-4, 2.0, 0.0, N=60.0)
    S, lines = 2000, np.arange(5, 240, 2)
    f, f0 = lines * 0.5, 0.5
    tau = synthetic.multisine(lines, S, 0.1, rng, f0)
    w = 2 * np.pi * f
    q_over_theta = (5000 + 2j * w) / (5000 + 2j * w - 0.8 * w**2) / 60
    spectrum, theta, q = (np.zeros(S // 2 + 1, complex) for _ in range(3))
    spectrum[lines] = np.fft.rfft(tau)[lines]
    theta[lines] = spectrum[lines] * arm.response(f)[:, 0, 0]
    q[lines] = -theta[lines] * q_over_theta
    table = {"x1": np.fft.irfft(q, S), "x2": np.fft.irfft(theta, S), "drive": tau}
    names = {"alpha": "x1", "beta": "x2", "gamma": "drive"}
    np.savez(tmp_path / "r.npz", fs=1000.0, **{name: np.tile(table[key], 3) for name, key in names.items()})
    found = tomllib.loads(guess([tmp_path / "r.npz"]))
    joint = found["joint"]["joint1"]
    assert joint["torque"]["name"] == "gamma" and joint["motor_angle"]["name"] == "beta"
    assert joint["link_angle"]["name"] == "alpha" and joint["link_angle"]["sign"] == -1
    assert joint["N"] == pytest.approx(60, rel=0.02)
    assert found["record"]["sample_rate_Hz"] == 1000 and found["record"]["period_samples"] == S
