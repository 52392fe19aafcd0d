"""robot.toml is read strictly; the robot that comes with the project is the paper's arm, by pinocchio's judgement."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from symgen.chain import PRISMATIC
from symgen.errors import RobotError
from symgen.robot import Drive, Experiment, load_robot
from symgen.urdf import load_chain

YPP3 = Path(__file__).parents[2] / "robots/ypp3"

# Table I with the factor 2 that (17) lacks restored
A11, A12, A13, A21, A22, A31 = 0.0434, 0.4544, 0.0152, 0.09285, 0.5072, 0.0466


def paper_inertia(q: np.ndarray) -> np.ndarray:
    """J(q) of (17)-(20) of the paper, corrected: 2 a21 c2 c23 in J_11, c3 for c3^2 in J_22 and J_23."""
    c2, c3, c23 = np.cos(q[1]), np.cos(q[2]), np.cos(q[1] + q[2])
    J11 = A11 * c23**2 + A12 * c2**2 + 2 * A21 * c2 * c23 + A13
    J23 = A21 * c3 + A31
    return np.array([[J11, 0, 0], [0, 2 * A21 * c3 + A22, J23], [0, J23, A31]])


@pytest.fixture(scope="module")
def ypp3_model() -> pin.Model:
    return pin.buildModelFromUrdf(str(YPP3 / "ypp3.urdf"))


def crba(model: pin.Model, q: np.ndarray) -> np.ndarray:
    M = pin.crba(model, model.createData(), q)
    return np.triu(M) + np.triu(M, 1).T


def test_ypp3_is_the_papers_arm_at_every_posture(ypp3_model: pin.Model) -> None:
    rng = np.random.default_rng(4)
    for q in rng.uniform(-2.6, 2.6, (50, 3)):
        # 1e-11: the URDF states its masses and moments to 12 decimals
        np.testing.assert_allclose(crba(ypp3_model, q), paper_inertia(q), rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("q", "printed"),
    [
        ((0.0, 0.0, 0.0), (0.6987, 0.6929, 0.0466)),  # POS1
        ((0.0, 0.0, -np.pi / 2), (0.4696, 0.5072, 0.0466)),  # POS2; J_11 is misprinted as 0.696
        ((0.0, np.pi / 2, 0.0), (0.0152, 0.6929, 0.0466)),  # POS3
    ],
)
def test_ypp3_has_the_inertias_printed_in_table_1(
    ypp3_model: pin.Model, q: tuple[float, ...], printed: tuple[float, ...]
) -> None:
    assert np.all(np.abs(q) < load_chain(YPP3 / "ypp3.urdf").limits[:, 1])
    np.testing.assert_array_equal(np.round(np.diag(crba(ypp3_model, np.array(q))), 4), printed)


def test_ypp3_lifts_with_positive_angles_and_its_motors_can_hold_it(ypp3_model: pin.Model) -> None:
    robot = load_robot(YPP3)
    data = ypp3_model.createData()
    height = [
        pin.forwardKinematics(ypp3_model, data, np.array([0, q, 0])) or data.oMi[3].translation[2] for q in (0.0, 0.5)
    ]
    assert height[1] > height[0]
    gravity = pin.computeGeneralizedGravity(ypp3_model, data, np.zeros(3))
    for drive, load in zip(robot.drives, gravity, strict=True):
        assert abs(load) < drive.N * drive.tau_max / 2


def test_ypp3_springs_are_damped_by_one_percent() -> None:
    robot = load_robot(YPP3)
    for drive, J in zip(robot.drives, np.diag(paper_inertia(np.zeros(3))), strict=True):
        assert drive.D_spring / (2 * np.sqrt(drive.K * J)) == pytest.approx(0.01, rel=0.1)


def test_ypp3_reads_into_its_dataclasses_from_directory_or_file() -> None:
    robot = load_robot(YPP3)
    assert (robot.name, robot.believe_zeros, robot.base, robot.tip, dict(robot.at)) == ("ypp3", True, None, None, {})
    assert robot.urdf == YPP3 / "ypp3.urdf"
    assert robot.gravity.tolist() == [0.0, 0.0, -9.81]
    assert robot.experiment == Experiment()  # the file states the defaults
    assert robot.experiment.samples_per_period == 10_000
    assert [d.K for d in robot.drives] == [5500.0, 4500.0, 4500.0]
    assert robot.drive("joint3") == Drive("joint3", 100.0, 1e-5, 4500.0, 1e-5, 0.3, 131072, 1.0, linear=False)
    same = load_robot(YPP3 / "robot.toml")
    assert (same.drives, same.experiment, same.name) == (robot.drives, robot.experiment, "ypp3")
    with pytest.raises(
        RobotError, match=r"robot.toml: joint 'joint4' has no .* table; expected one of joint1, joint2, joint3"
    ):
        robot.drive("joint4")


# Small files ---------------------------------------------------------------------------------------------------------

HEAD = '[robot]\nurdf = "a.urdf"\n'
ROTARY = {
    "N": "100",
    "J_m_kgm2": "4e-5",
    "K_Nm_per_rad": "5500",
    "D_Nms_per_rad": "1e-5",
    "D_spring_Nms_per_rad": "2.0",
    "encoder_counts_per_rev": "131072",
    "torque_limit_Nm": "2.0",
}
LINEAR = {
    "N_rad_per_m": "-628.3",
    "K_N_per_m": "1e7",
    "D_spring_Ns_per_m": "100",
    **{key: ROTARY[key] for key in ("J_m_kgm2", "D_Nms_per_rad", "encoder_counts_per_rev", "torque_limit_Nm")},
}


def joint(name: str, keys: dict[str, str]) -> str:
    return f"[joint.{name}]\n" + "".join(f"{key} = {value}\n" for key, value in keys.items())


def written(tmp_path: Path, text: str) -> Path:
    (tmp_path / "a.urdf").write_text("<robot/>")
    (tmp_path / "robot.toml").write_text(text, encoding="utf-8")
    return tmp_path


def test_optional_keys_have_defaults_and_slides_their_own_units(tmp_path: Path) -> None:
    text = (
        HEAD + 'base = "b"\ntip = "t"\n[robot.at]\nfinger = 0.02\n' + joint('"Achse 1 ü"', ROTARY) + joint("z", LINEAR)
    )
    robot = load_robot(written(tmp_path, text))
    assert (robot.base, robot.tip, robot.at, robot.believe_zeros) == ("b", "t", {"finger": 0.02}, False)
    assert robot.experiment == Experiment()
    assert [(d.joint, d.linear, d.N) for d in robot.drives] == [("Achse 1 ü", False, 100.0), ("z", True, -628.3)]
    assert (robot.drive("z").K, robot.drive("z").D_spring) == (1e7, 100.0)


def test_every_key_of_the_experiment_reaches_its_field(tmp_path: Path) -> None:
    stated = {
        "sample_rate_Hz": "2000",
        "band_Hz": "[1, 200.5]",
        "line_spacing_Hz": "0.5",
        "periods": "4",
        "swing_rad": "0.02",
        "torque_noise_rel": "0",
        "lock_pd_Hz": "6",
        "lock_dob_Hz": "25",
    }
    text = "[experiment]\n" + "".join(f"{key} = {value}\n" for key, value in stated.items())
    experiment = load_robot(written(tmp_path, HEAD + text + joint("j", ROTARY))).experiment
    assert dataclasses.astuple(experiment) == (2000.0, (1.0, 200.5), 0.5, 4, 0.02, 0.0, 6.0, 25.0)


J = joint("j", ROTARY)


def with_key(key: str, value: str, base: dict[str, str] = ROTARY) -> str:
    return HEAD + joint("j", {**base, key: value})


def without_key(key: str, base: dict[str, str] = ROTARY) -> str:
    return HEAD + joint("j", {k: v for k, v in base.items() if k != key})


BAD = {
    "not TOML": ("[robot\n", "not TOML: .*line 1"),
    "nested too deeply": (HEAD + "x = " + "[" * 5000, "not TOML"),
    "unknown table": (HEAD + J + "[joints.j]\n", "unknown key 'joints'; expected robot, experiment, joint"),
    "no robot": (J, "key 'robot' is missing"),
    "no joint": (HEAD, "key 'joint' is missing"),
    "no drive": (HEAD + "[joint]\n", r"\[joint\]: found {}, expected one \[joint.<name>\] table"),
    "robot is a number": ("robot = 1\n" + J, r"\[robot\]: found 1, expected a table"),
    "joint is a list": (HEAD + "[[joint]]\n", r"\[joint\]: found .*, expected one \[joint.<name>\] table"),
    "drive is a number": (HEAD + "[joint]\nj = 1\n", r"\[joint.j\]: found 1, expected a table"),
    "no urdf": ("[robot]\n" + J, r"\[robot\]: key 'urdf' is missing"),
    "urdf absent": ('[robot]\nurdf = "b.urdf"\n' + J, r"\[robot\]: urdf: no such file '.*b.urdf'"),
    "urdf is a number": ("[robot]\nurdf = 1\n" + J, r"\[robot\]: urdf: found 1, expected a non-empty string"),
    "a word for a truth": (HEAD + 'believe_zeros = "yes"\n' + J, "believe_zeros: found 'yes', expected true or false"),
    "two gravities": (
        HEAD + "gravity_m_per_s2 = [0, -9.81]\n" + J,
        "gravity_m_per_s2: found .*, expected three numbers",
    ),
    "gravity in mm": (HEAD + "gravity_m_per_s2 = [0, 0, -9810]\n" + J, "expected three numbers of at most 100"),
    "at is a list": (HEAD + "at = [1]\n" + J, r"at: found \[1\], expected a table of joint = value"),
    "at nan": (HEAD + "[robot.at]\nj = nan\n" + J, "at: found .*, expected a finite number"),
    "no unit": (with_key("K", "5500"), r"\[joint.j\]: unknown key 'K'; expected K_Nm_per_rad$"),
    "no unit, linear": (with_key("N", "1", LINEAR), r"\[joint.j\]: unknown key 'N'; expected N_rad_per_m$"),
    "wrong unit": (
        with_key("K_Nm_per_deg", "5500"),
        r"\[joint.j\]: unknown key 'K_Nm_per_deg'; expected N, K_Nm_per_rad, ",
    ),
    "rotary and linear mixed": (with_key("K_N_per_m", "1"), r"\[joint.j\]: unknown key 'N'; expected N_rad_per_m"),
    "missing key": (without_key("J_m_kgm2"), r"\[joint.j\]: key 'J_m_kgm2' is missing"),
    "missing linear key": (without_key("K_N_per_m", LINEAR), r"\[joint.j\]: key 'K_N_per_m' is missing"),
    "N zero": (with_key("N", "0"), r"\[joint.j\]: N: found 0, expected a number other than 0"),
    "N true": (with_key("N", "true"), "N: found True, expected a number other than 0"),
    "K zero": (with_key("K_Nm_per_rad", "0"), "K_Nm_per_rad: found 0, expected a number > 0"),
    "K nan": (with_key("K_Nm_per_rad", "nan"), "K_Nm_per_rad: found nan, expected a number > 0"),
    "K infinite": (with_key("K_Nm_per_rad", "inf"), "K_Nm_per_rad: found inf"),
    "K a word": (with_key("K_Nm_per_rad", '"5500"'), "K_Nm_per_rad: found '5500', expected a number > 0"),
    "K beyond floats": (with_key("K_Nm_per_rad", "1" + "0" * 400), "K_Nm_per_rad: found 1000.*, expected a number > 0"),
    "K beyond printing": (with_key("K_Nm_per_rad", "0x" + "f" * 9000), "K_Nm_per_rad: found a huge integer, expected"),
    "negative damping": (with_key("D_Nms_per_rad", "-1e-5"), "D_Nms_per_rad: found -1e-05, expected a number >= 0"),
    "half a count": (
        with_key("encoder_counts_per_rev", "0.5"),
        "encoder_counts_per_rev: found 0.5, expected a whole number",
    ),
    "half a count of the link": (
        with_key("link_encoder_counts_per_rev", "0.5"),
        "link_encoder_counts_per_rev: found 0.5, expected a whole number",
    ),
    "counts a turn of a slide": (
        with_key("link_encoder_counts_per_rev", "4096", LINEAR),
        "unknown key 'link_encoder_counts_per_rev'; expected .* link_encoder_counts_per_m, ",
    ),
    "an encoder on one link only": (
        HEAD + joint("a", ROTARY) + joint("b", {**LINEAR, "link_encoder_counts_per_m": "100"}),
        r"\[joint.b\]: link_encoder_counts_per_m: found at some joints only, expected at every joint or at none",
    ),
    "no torque": (with_key("torque_limit_Nm", "0"), "torque_limit_Nm: found 0, expected a number > 0"),
    "one period": (
        HEAD + "[experiment]\nperiods = 1\n" + J,
        r"\[experiment\]: periods: found 1, expected a whole number >= 2",
    ),
    "rate without unit": (
        HEAD + "[experiment]\nsample_rate = 1\n" + J,
        "unknown key 'sample_rate'; expected sample_rate_Hz",
    ),
    "band reversed": (HEAD + "[experiment]\nband_Hz = [120, 0.1]\n" + J, r"band_Hz: found \[120, 0.1\], expected"),
    "band of words": (HEAD + '[experiment]\nband_Hz = ["a", 1]\n' + J, "band_Hz: found .*, expected .lower, upper"),
    "band to fs/2": (
        HEAD + "[experiment]\nband_Hz = [1, 500]\n" + J,
        "band_Hz: 500 Hz is not below sample_rate_Hz / 2 = 500",
    ),
    "band without a line": (
        HEAD + "[experiment]\nband_Hz = [0.11, 0.19]\n" + J,
        r"band_Hz .* holds no line k \* 0.1 Hz",
    ),
    "broken period": (
        HEAD + "[experiment]\nline_spacing_Hz = 0.3\n" + J,
        "= 3333.333333 samples per period; expected a whole",
    ),
    "rate beyond floats": (
        HEAD + "[experiment]\nsample_rate_Hz = 1e308\nline_spacing_Hz = 1e-308\n" + J,
        "= inf samples",
    ),
    "name of two lines": (HEAD + '[joint."a\\nb"]\n', r"\[joint.'a\\nb'\]: key 'N' is missing"),
    "urdf name too long": (f'[robot]\nurdf = "{"x" * 300}"\n' + J, r"\[robot\]: urdf: no such file"),
    "endless period": (
        HEAD + "[experiment]\nline_spacing_Hz = 1e-9\n" + J,
        r"1e\+12 samples per period; expected a whole number of at",
    ),
}


@pytest.mark.parametrize(("text", "expected"), BAD.values(), ids=BAD)
def test_a_bad_file_is_refused_in_one_line_naming_file_table_and_key(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(RobotError, match=expected) as caught:
        load_robot(written(tmp_path, text))
    assert str(caught.value).startswith(f"{tmp_path / 'robot.toml'}: ")
    assert "\n" not in str(caught.value)


def test_what_is_no_toml_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "large.toml").write_bytes(b"#" * 1_000_001)
    for name, expected in {
        "": "robot.toml: no such file",
        "missing.toml": "missing.toml: no such file",
        "binary.toml": "not TOML: 'utf-8' codec",
        "large.toml": "larger than 1000000 bytes",
    }.items():
        with pytest.raises(RobotError, match=expected):
            load_robot(tmp_path / name)


def test_drives_are_those_of_the_files_joints_whatever_the_arm() -> None:
    """A shorter arm needs no shorter robot.toml; a name or a kind that the file has not is told."""
    robot = load_robot(YPP3.parent / "scara4")
    chain = load_chain(robot.urdf)
    for part in (
        chain,
        load_chain(robot.urdf, base=chain.joints[1].link),
        load_chain(robot.urdf, tip=chain.joints[1].link),
    ):
        robot.check(part)
    slide = next(k for k, joint in enumerate(chain.joints) if joint.type == PRISMATIC)
    for k, change, expected in (
        (
            0,
            {"joint": "joint_1"},
            r"\[joint.joint_1\]: no such joint in the URDF; its moving joints are joint1, joint2, ",
        ),
        (0, {"linear": True}, r"\[joint.joint1\]: the URDF says revolute; expected keys in N m and rad"),
        (
            slide,
            {"linear": False},
            rf"\[joint.{chain.names[slide]}\]: the URDF says prismatic; expected keys in N and m",
        ),
    ):
        drives = tuple(dataclasses.replace(d, **change) if i == k else d for i, d in enumerate(robot.drives))  # type: ignore[arg-type]
        with pytest.raises(RobotError, match=expected):
            dataclasses.replace(robot, drives=drives).check(chain)
