"""A campaign survives the file bit by bit, and no broken file becomes a campaign."""

import os
import re
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from ident.errors import CampaignError
from ident.records.campaign import Campaign, Record
from ident.records.log import Log, Trajectory
from ident.records.store import read_campaign, write_campaign, write_log

URDF = (Path(__file__).parents[3] / "robots" / "ypp3" / "ypp3.urdf").read_text()


def a_record(k: int, samples_per_period: int = 500, periods: int = 2, n: int = 3) -> Record:
    rng = np.random.default_rng(k)
    shape = (samples_per_period * periods, n)
    return Record(
        id=f"{k:04d}",
        excited=f"joint{k}",
        posture=[0.0, 0.1 * k, -0.2],
        f0=2.0,
        lines=[1, 3, 5, 9],
        samples_per_period=samples_per_period,
        periods=periods,
        rms=0.1,
        tau=rng.standard_normal(shape),
        theta=rng.standard_normal(shape),
        omega=rng.standard_normal(shape) if k == 2 else None,
    )


def a_campaign() -> Campaign:
    return Campaign(
        urdf=URDF,
        joints=("joint1", "joint2", "joint3"),
        fs=1000.0,
        hold="zoh",
        N=[100, -100, 0.5],
        J_m=[4e-5, np.nan, 1e-5],
        K=[5500, 4500, np.nan],
        gravity=[0, 0, -9.81],
        source="a bench in Zürich",
        D=[3e-5, np.nan, 0],
        records=tuple(a_record(k) for k in (1, 2, 3)),
    )


def assert_same(one: object, two: object) -> None:
    for field in fields(one):  # type: ignore[arg-type]
        a, b = getattr(one, field.name), getattr(two, field.name)
        if field.name == "records":
            assert len(a) == len(b)
            for left, right in zip(a, b, strict=True):
                assert_same(left, right)
        elif isinstance(a, np.ndarray):
            assert a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), field.name
        else:
            assert a == b and type(a) is type(b), field.name


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("store") / "sound.h5"
    write_campaign(a_campaign(), path)
    return path.read_bytes()


@pytest.fixture
def file(image: bytes, tmp_path: Path) -> Path:
    path = tmp_path / "c.h5"
    path.write_bytes(image)
    return path


def refusal(path: Path) -> str:
    with pytest.raises(CampaignError) as error:
        read_campaign(path)
    text = str(error.value)
    assert "\n" not in text and text.startswith(str(path))
    return text


def test_round_trip_keeps_every_bit(file: Path) -> None:
    assert_same(read_campaign(file), a_campaign())


def test_layout_is_that_of_the_format(file: Path) -> None:
    """Read with h5py alone, as a stranger's program would."""
    with h5py.File(file) as f:
        assert (f.attrs["format"], f.attrs["version"], f.attrs["hold"], f.attrs["fs_hz"]) == (
            "frf-campaign",
            1,
            "zoh",
            1000,
        )
        assert f.attrs["source"] == "a bench in Zürich"
        assert f["robot/urdf"].asstr()[()] == URDF
        assert list(f["robot/joint_names"].asstr()) == ["joint1", "joint2", "joint3"]
        assert [f[f"drive/{name}"].shape for name in ("gear_ratio", "motor_inertia", "stiffness", "gravity")] == [
            (3,)
        ] * 4
        group = f["experiments/0002"]
        assert (group.attrs["excited"], group.attrs["f0_hz"], group.attrs["rms"]) == ("joint2", 2.0, 0.1)
        assert (group.attrs["samples_per_period"], group.attrs["periods"]) == (500, 2)
        assert list(group.attrs["lines"]) == [1, 3, 5, 9] and list(group.attrs["posture"]) == [0, 0.2, -0.2]
        assert set(group) == {"tau", "theta", "omega"} and set(f["experiments/0001"]) == {"tau", "theta"}
        for dataset in (group["tau"], group["theta"], group["omega"], f["drive/stiffness"], f["robot/joint_names"]):
            assert dataset.fletcher32 and dataset.chunks and dataset.compression == "gzip"


def test_same_campaign_gives_the_same_bytes(image: bytes, tmp_path: Path) -> None:
    write_campaign(a_campaign(), tmp_path / "again.h5")
    assert (tmp_path / "again.h5").read_bytes() == image


def test_plain_files_of_other_programs_are_read(tmp_path: Path) -> None:
    """No chunks, no checksums, other string and number types, extra content: all within the format."""
    campaign, path = a_campaign(), tmp_path / "plain.h5"
    with h5py.File(path, "w") as f:
        f.attrs.update(
            format=np.bytes_("frf-campaign"), version=1.0, source="x", fs_hz=np.float32(1000), hold="zoh", by="me"
        )
        f["robot/urdf"] = np.bytes_(URDF.encode())
        f["robot/joint_names"] = list(campaign.joints)
        for name in ("gear_ratio", "motor_inertia", "stiffness", "gravity"):
            f[f"drive/{name}"] = np.array([1, 2, 3])
        f["photos/arm"] = b"jpeg"
        for record in campaign.records[::-1]:
            g = f.create_group(f"experiments/{record.id}")
            g.attrs.update(excited=record.excited, posture=record.posture, f0_hz=2, lines=[3.0, 1.0], rms=0.1)
            g.attrs.update(samples_per_period=np.int32(500), periods=np.array([2]))
            g["tau"], g["theta"] = record.tau.astype(np.float32), np.round(100 * record.theta).astype(int)
            g["note"] = "windy"
    found = read_campaign(path)
    assert [record.id for record in found.records] == ["0001", "0002", "0003"]
    assert np.array_equal(found.records[1].tau, campaign.records[1].tau.astype(np.float32))
    assert list(found.records[0].lines) == [1, 3]  # in whatever order they are listed


def test_long_lists_of_lines_fit(tmp_path: Path) -> None:
    record = replace(a_record(1, samples_per_period=25_000), f0=0.04, lines=np.arange(1, 12_500))
    write_campaign(replace(a_campaign(), records=(record,)), tmp_path / "long.h5")
    assert len(read_campaign(tmp_path / "long.h5").records[0].lines) == 12_499


def drop(name: str) -> Callable[[h5py.File], None]:
    def change(f: h5py.File) -> None:
        where, _, leaf = name.rpartition("@")
        if where:
            del f[where].attrs[leaf]
        else:
            del f[name]

    return change


def put(name: str, value: object) -> Callable[[h5py.File], None]:
    def change(f: h5py.File) -> None:
        where, _, leaf = name.rpartition("@")
        if where:
            f[where].attrs[leaf] = value
        else:
            if name in f:
                del f[name]
            f[name] = value

    return change


def poke(name: str, index: tuple[int, ...], value: float) -> Callable[[h5py.File], None]:
    def change(f: h5py.File) -> None:
        f[name][index] = value

    return change


E2 = "experiments/0002"
T = np.zeros((1000, 3))


def one_period(f: h5py.File) -> None:
    put(f"{E2}@periods", 1)(f)
    for name in list(f[E2]):
        put(f"{E2}/{name}", T[:500])(f)


BROKEN = {
    "not a campaign": (put("/@format", "log"), r"/: format: found 'log', expected 'frf-campaign'"),
    "format missing": (drop("/@format"), r"/: format: missing"),
    "future": (put("/@version", 2), r"/: version: found 2, a version from the future; this program reads 1"),
    "version zero": (put("/@version", 0), r"/: version: found 0; this program reads 1"),
    "no rate": (drop("/@fs_hz"), r"/: fs_hz: missing; expected an attribute"),
    "rate text": (put("/@fs_hz", "fast"), r"/: fs_hz: found 'fast', expected numbers"),
    "rate nan": (put("/@fs_hz", np.nan), r"/: fs_hz: found nan, expected a finite number > 0"),
    "hold": (put("/@hold", "foh"), r"/: (hold: found 'foh', expected zoh or band-limited|text_crc32: damaged)"),
    "source number": (put("/@source", 3), r"/: source: found .*3.*, expected a string"),
    "no urdf": (drop("robot/urdf"), r"/: robot/urdf: missing; expected a dataset"),
    "no names": (drop("robot/joint_names"), r"/: robot/joint_names: missing"),
    "unknown joint": (put("robot/joint_names", ["joint1", "joint2", "elbow"]), r"the URDF has no moving joint 'elbow'; it has joint1"),
    "joint twice": (put("robot/joint_names", ["joint1", "joint2", "joint2"]), r"robot/joint_names: .* all different"),
    "names are numbers": (put("robot/joint_names", [1, 2, 3]), r"robot/joint_names: found int64 .* expected UTF-8 strings"),
    "no gear": (drop("drive/gear_ratio"), r"/: drive/gear_ratio: missing"),
    "gear zero": (poke("drive/gear_ratio", (1,), 0.0), r"drive/gear_ratio: .* other than 0"),
    "gear nan": (poke("drive/gear_ratio", (1,), np.nan), r"drive/gear_ratio: "),
    "negative inertia": (poke("drive/motor_inertia", (0,), -1e-5), r"drive/motor_inertia: .* > 0, NaN where unknown"),
    "infinite stiffness": (poke("drive/stiffness", (0,), np.inf), r"drive/stiffness: "),
    "gravity shape": (put("drive/gravity", [0.0, -9.81]), r"drive/gravity: found float64 of shape \(2,\), expected numbers of shape \(3,\)"),
    "no experiments": (drop("experiments"), r"/: experiments: missing; expected a group"),
    "empty": (lambda f: [f["experiments"].pop(id) for id in list(f["experiments"])], r"experiments: .* at least one record"),
    "record is data": (put(E2, 1.0), r"/experiments: 0002: found a dataset, expected a group"),
    "no excited": (drop(f"{E2}@excited"), r"/experiments/0002: excited: missing"),
    "posture nan": (put(f"{E2}@posture", [0, np.nan, 0]), r"/experiments/0002: posture: .* 3 finite numbers"),
    "posture short": (put(f"{E2}@posture", [0.0, 0.0]), r"/experiments/0002: posture: .* 3 finite numbers"),
    "posture outside": (put(f"{E2}@posture", [0, 0, 3.0]), r"posture: 'joint3' = 3, expected within its limits \[-2.6, 2.6\]"),
    "f0 two": (put(f"{E2}@f0_hz", [2.0, 2.0]), r"/experiments/0002: f0_hz: found 2 numbers, expected one"),
    "period": (put(f"{E2}@f0_hz", 2.001), r"samples_per_period \* f0_hz = fs_hz, which is 1000.5 against 1000"),
    "samples": (put(f"{E2}@samples_per_period", 499.5), r"samples_per_period: found .*499.5.*, expected whole numbers"),
    "huge": (put(f"{E2}@periods", 10**12), r"tau: found float64 of shape \(1000, 3\), expected numbers of shape \(5000000+, 3\)"),
    "no period": (put(f"{E2}@periods", 0), r"/experiments/0002: "),
    "one period": (one_period, r"/experiments/0002: periods: found 1, expected at least 2, to tell noise from response"),
    "rms": (put(f"{E2}@rms", -1.0), r"/experiments/0002: rms: found -1.0, expected a finite number > 0"),
    "line above": (put(f"{E2}@lines", [1, 251]), r"lines: line 251 is at 502 Hz, expected none above fs/2 = 500 Hz nor at it"),
    "line at fs/2": (put(f"{E2}@lines", [1, 250]), r"lines: line 250 is at 500 Hz, expected none above fs/2 = 500 Hz nor at it"),
    "line zero": (put(f"{E2}@lines", [0, 3]), r"lines: .* expected harmonics >= 1"),
    "line twice": (put(f"{E2}@lines", [3, 3]), r"lines: .* all different"),
    "line between": (put(f"{E2}@lines", [1.5, 3.0]), r"lines: .* expected whole numbers"),
    "line infinite": (put(f"{E2}@lines", [1.0, np.inf]), r"lines: .* expected whole numbers"),
    "no line": (put(f"{E2}@lines", np.zeros(0, dtype=int)), r"lines: .* at least one harmonic"),
    "no torque": (drop(f"{E2}/tau"), r"/experiments/0002: tau: missing; expected a dataset"),
    "short": (put(f"{E2}/theta", T[:-1]), r"/experiments/0002: theta: found float64 of shape \(999, 3\), expected numbers of shape \(1000, 3\)"),
    "one joint less": (put(f"{E2}/omega", T[:, :2]), r"/experiments/0002: omega: found float64 of shape \(1000, 2\)"),
    "complex": (put(f"{E2}/tau", T * 1j), r"/experiments/0002: tau: found complex128"),
    "not finite": (poke(f"{E2}/theta", (7, 1), np.nan), r"/experiments/0002: theta: sample 7 of joint 'joint2' is nan, expected finite"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_broken_rule_is_named(case: str, file: Path) -> None:
    change, message = BROKEN[case]
    with h5py.File(file, "r+") as f:
        change(f)
    assert re.search(message, refusal(file))


def test_damage_anywhere_is_an_error_and_never_another_campaign(image: bytes, tmp_path: Path) -> None:
    """One bit flipped in 150 places: refused, or (unused space) read unchanged."""
    rng, path, refused = np.random.default_rng(0), tmp_path / "flipped.h5", 0
    for bit in rng.integers(len(image) * 8, size=150):
        flipped = bytearray(image)
        flipped[bit // 8] ^= 1 << (bit % 8)
        path.write_bytes(flipped)
        try:
            assert_same(read_campaign(path), a_campaign())
        except CampaignError as error:
            assert "\n" not in str(error)
            refused += 1
    assert refused > 125


def test_flipped_bit_in_the_samples_is_named(file: Path, image: bytes) -> None:
    with h5py.File(file) as f:
        place = f["experiments/0002/tau"].id.get_chunk_info(0).byte_offset
    flipped = bytearray(image)
    flipped[place + 1000] ^= 1
    file.write_bytes(flipped)
    assert "/experiments/0002: tau: damaged: " in refusal(file)


def test_flipped_bit_in_a_joint_name_is_found(file: Path, image: bytes) -> None:
    """joint1 and joint3 differ in one bit, and HDF5 does not guard the heap they lie in."""
    place = image.rindex(b"joint2")
    flipped = bytearray(image)
    flipped[place + 5] ^= 1
    file.write_bytes(flipped)
    assert "damaged" in refusal(file)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.1, 0.5, 0.99, 0.9999])
def test_truncated_file_is_refused(share: float, file: Path, image: bytes) -> None:
    file.write_bytes(image[: int(share * len(image))])
    refusal(file)


def test_other_things_than_files(tmp_path: Path) -> None:
    assert "is a directory" in refusal(tmp_path)
    assert "no such file" in refusal(tmp_path / "none.h5")
    (tmp_path / "text.h5").write_text("time,angle\n0,0\n")
    assert "not an HDF5 file" in refusal(tmp_path / "text.h5")


@pytest.mark.parametrize(
    ("urdf", "message"),
    [
        ("", "not a readable URDF"),
        ("<robot", "not a readable URDF"),
        ('<!DOCTYPE r [<!ENTITY a "b">]><robot/>', "document type"),
        (URDF.replace('lower="-2.6"', 'lower="low"'), "not a readable URDF: could not convert"),
        (URDF.replace('"joint2" type="revolute"', '"joint2" type="fixed"'), "no moving joint 'joint2'"),
    ],
)
def test_urdf_that_can_not_be_judged_is_refused(urdf: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match=message):
        write_campaign(replace(a_campaign(), urdf=urdf), tmp_path / "c.h5")
    assert not list(tmp_path.iterdir())


def test_a_comment_about_document_types_is_none(tmp_path: Path) -> None:
    comment = "<!-- <!DOCTYPE robot> and <!ENTITY> were taken out of this file -->"
    c = replace(a_campaign(), urdf=URDF.replace("</robot>", f"{comment}</robot>"))
    write_campaign(c, tmp_path / "c.h5")
    assert_same(read_campaign(tmp_path / "c.h5"), c)


@pytest.mark.parametrize("text", ["a\0b", "r\udce9c.csv"])
def test_texts_that_no_file_holds_are_refused(text: str, tmp_path: Path) -> None:
    c = a_campaign()
    log = Log(
        c.urdf, c.joints, c.fs, c.N, c.J_m, c.gravity, c.source, (Trajectory("1", np.zeros((9, 3)), np.ones((9, 3))),)
    )
    run = replace(log.trajectories[0], id=text)
    named = replace(c, records=(replace(c.records[0], id=text),))
    for write, bad, field in (
        (write_campaign, replace(c, source=text), "source"),
        (write_campaign, named, "experiments"),
        (write_campaign, replace(c, urdf=c.urdf.replace("ypp3", text)), "not a readable URDF"),
        (write_log, replace(log, source=text), "source"),
        (write_log, replace(log, urdf=text), "robot/urdf"),
        (write_log, replace(log, joints=(text, "b", "c")), "robot/joint_names"),
        (write_log, replace(log, trajectories=(run,)), "trajectories"),
    ):
        with pytest.raises(CampaignError, match=field) as error:
            write(bad, tmp_path / "c.h5")  # type: ignore[operator]
        assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_a_file_may_be_of_any_name(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"r\xe9c.h5")
    write_campaign(a_campaign(), path)
    assert_same(read_campaign(path), a_campaign())


def test_a_failed_write_leaves_the_old_file_and_nothing_else(file: Path, image: bytes) -> None:
    bad = replace(a_record(1), theta=np.full((1000, 3), np.inf))
    with pytest.raises(CampaignError, match="sample 0 of joint 'joint1' is inf"):
        write_campaign(replace(a_campaign(), records=(bad,)), file)
    with pytest.raises(CampaignError, match="ascending in the order of recording"):
        write_campaign(replace(a_campaign(), records=(a_record(2), a_record(1))), file)
    assert file.read_bytes() == image
    assert [path.name for path in file.parent.iterdir()] == ["c.h5"]


def test_places_that_can_not_be_written(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="none.c.h5: cannot be written"):
        write_campaign(a_campaign(), tmp_path / "none" / "c.h5")
    with pytest.raises(CampaignError, match="cannot be written"):
        write_campaign(a_campaign(), tmp_path)
    assert not list(tmp_path.iterdir()) and not list(tmp_path.parent.glob(f".*{os.getpid()}.part"))
