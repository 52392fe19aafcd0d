"""The files of an identified arm, each judged by the program it is for: pinocchio, MuJoCo, CasADi, a C compiler, symgen."""

from __future__ import annotations

import ctypes
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin
import pytest

from ident.cli import main
from ident.errors import IdentError
from ident.identification.export import read, write_files, write_identified
from ident.identification.identified import Identified, of_identification, of_parts
from ident.identification.identify import identify
from ident.records.campaign import Campaign, Record
from ident.simulator.bench import simulate
from ident.simulator.plant import build_plant
from symgen.chain import Chain
from symgen.plan import chain_of_robot, make_model, model_of_urdf
from symgen.robot import load_robot
from symgen.urdf import load_chain, parse_chain, with_arm

sys.path.append(str(Path(__file__).parents[2] / "symgen"))

from arms import arm

ROBOTS = Path(__file__).parents[3] / "robots"
FILES = ["J.c", "J.casadi", "J.h", "identified.json", "identified.urdf", "identified.xml", "robot.toml"]
#: What every file has to agree to; angles written with 12 digits in a URDF (UR5's) cost 5e-12.
ACCURACY = 1e-9
#: An angle that was snapped costs this much more: xArm7 writes pi/2 as 1.5708.
SNAPPING = 2e-5
POSTURES = 200


@cache
def chain_of(name: str) -> Chain:
    own = ROBOTS / name / f"{name}.urdf"
    return load_chain(own) if own.exists() else arm(name)


def campaign_of(text: str, joints: tuple[str, ...], records: tuple[Record, ...] = ()) -> Campaign:
    n = len(joints)
    unknown = np.full(n, np.nan)
    return Campaign(text, joints, 1000.0, "zoh", np.full(n, -80.0), unknown, unknown, np.array([0.1, 0, -9.8]), "a bench -- really",
                    records)  # fmt: skip


def identified(
    text: str, joints: tuple[str, ...], seed: int, *, believe: bool = False, possible: bool = True
) -> Identified:
    """An arm whose links are 25 % off CAD; not `possible`: with constants that no links have."""
    rng, n = np.random.default_rng(seed), len(joints)
    model = model_of_urdf(text, joints, believe_zeros=believe)
    cad = model.alpha_cad
    links = model.chain.parameters.reshape(n, 10) * np.exp(0.25 * rng.normal(size=(n, 1)))
    alpha = model.factoring.W @ links.ravel()
    std = 0.01 * np.abs(cad) + 1e-6 * np.abs(cad).max()
    if not possible:
        alpha = alpha * (1 + 0.3 * rng.normal(size=len(cad)))
    drives = rng.uniform(1, 2, (4, n)) * np.array([[4000.0], [3e-5], [2e-5], [1.0]])
    return of_parts(campaign_of(text, joints), model, alpha, np.diag(std**2), np.zeros((len(cad), 0)), *drives)


def crba(text: str, chain: Chain, q: np.ndarray) -> np.ndarray:
    """J(q) [m, n, n] by pinocchio's own reading of the URDF, joints not in the chain locked where it froze them."""
    whole = pin.buildModelFromXML(text)
    rest = pin.neutral(whole)
    for name, value in chain.frozen.items():
        joint = whole.joints[whole.getJointId(name)]
        rest[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
    model = pin.buildReducedModel(
        whole, [k for k in range(1, whole.njoints) if whole.names[k] not in chain.names], rest
    )
    data = model.createData()
    assert tuple(model.names)[1:] == chain.names
    out = []
    for row in q:
        at = np.concatenate([
            [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
            for value, joint in zip(row, list(model.joints)[1:], strict=True)
        ])  # fmt: skip
        upper = np.triu(pin.crba(model, data, at))
        out.append(upper + np.triu(upper, 1).T)
    return np.array(out)


def simulated(model: mujoco.MjModel, q: np.ndarray) -> np.ndarray:
    """The mass matrix [m, 2 n, 2 n] of MuJoCo with the springs slack at link angles q [m, n]."""
    data, out = mujoco.MjData(model), []
    for row in q:
        data.qpos[::2] = row
        mujoco.mj_forward(model, data)
        M = np.zeros((model.nv, model.nv))
        for column, unit in zip(M, np.eye(model.nv), strict=True):
            mujoco.mj_mulM(model, data, column, unit)
        out.append(M)
    return np.array(out)


def evaluated(folder: Path, q: np.ndarray) -> np.ndarray:
    """J.casadi at postures q [m, n]."""
    J = ca.Function.load(str(folder / "J.casadi"))
    assert (J.n_in(), J.n_out(), J.name_in(0)) == (1, 1, "q")
    n = q.shape[1]
    return np.array(J.map(len(q))(q.T)).reshape(n, len(q), n).transpose(1, 0, 2)


@pytest.mark.parametrize(
    ("name", "believe", "possible"),
    [
        *(
            (name, believe, True)
            for name, believe in (("ypp3", True), ("ypp3_general", False), ("arm6", False), ("scara4", True))
        ),
        *(("panda", False, possible) for possible in (True, False)),
        ("ypp3", True, False),
        *(pytest.param(name, False, True, marks=pytest.mark.bench) for name in ("ur5", "xarm7")),
        *(
            pytest.param(name, name == "scara4", False, marks=pytest.mark.bench)
            for name in ("ypp3_general", "arm6", "scara4", "ur5", "xarm7")
        ),
    ],
)
def test_all_files_say_the_same(name: str, believe: bool, possible: bool, tmp_path: Path) -> None:
    chain = chain_of(name)
    made = identified(chain.source, chain.names, 4, believe=believe, possible=possible)
    assert [path.name for path in write_files(made, tmp_path)] == FILES
    assert sorted(path.name for path in tmp_path.iterdir()) == FILES
    q = made.model.random_postures(POSTURES, np.random.default_rng(0))
    J = evaluated(tmp_path, q)
    scale = np.abs(J).max()
    if possible:
        assert np.abs(J - made.model.J(q, made.alpha)).max() < ACCURACY * scale
    else:
        assert np.linalg.eigvalsh(J).min() > 0.0
        assert "standard deviations away" in (tmp_path / "robot.toml").read_text()
    text = (tmp_path / "identified.urdf").read_text()
    assert np.abs(crba(text, chain, q) - J).max() < (SNAPPING if chain.snapped else ACCURACY) * scale
    M = simulated(mujoco.MjModel.from_xml_path(str(tmp_path / "identified.xml")), q)
    assert np.abs(M[:, 1::2, 1::2] - J).max() < ACCURACY * scale
    rotor = np.diag([drive.N**2 * drive.J_m for drive in made.drives])
    assert np.abs(M[:, ::2, ::2] - J - rotor).max() < ACCURACY * scale


def test_the_mjcf_is_the_plant_with_names(tmp_path: Path) -> None:
    """Parameter by parameter what `build_plant` simulates; it runs, and hangs where gravity and springs put it."""
    chain = chain_of("panda")
    made = identified(chain.source, chain.names, 1)
    write_files(made, tmp_path)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "identified.xml"))
    links = [pin.Inertia.FromDynamicParameters(row) for row in made.model.chain.parameters.reshape(-1, 10)]
    assert [model.body(k + 1).name for k in range(7)] == [joint.link for joint in chain.joints] and len(links) == 7
    assert [model.joint(k).name for k in range(4)] == ["panda_joint1_motor", "panda_joint1_spring", "panda_joint2_motor", "panda_joint2_spring"]  # fmt: skip
    assert [model.actuator(k).name for k in range(7)] == list(chain.names)
    plant = build_plant(chain, made.drives, made.gravity, np.zeros(7)).model
    for field in ("dof_armature", "dof_damping", "jnt_stiffness", "actuator_gear", "body_pos", "body_quat", "jnt_axis"):
        np.testing.assert_allclose(getattr(model, field), getattr(plant, field), rtol=1e-12, atol=1e-15)
    limits = np.array([joint.limits for joint in chain.joints])
    np.testing.assert_allclose(model.jnt_range[::2], limits)
    assert model.jnt_limited.astype(bool).tolist() == [True, False] * 7
    np.testing.assert_allclose(model.actuator_ctrlrange[:, 1], [drive.tau_max for drive in made.drives])
    # held by the motors at a posture, every spring carries what its motor carries
    posture = np.array([0.0, 0.2, 0.0, -1.5, 0.0, 1.8, 0.3])
    data = mujoco.MjData(model)
    data.qpos[::2] = posture
    mujoco.mj_forward(model, data)
    spring = -data.qfrc_bias[1::2] / model.jnt_stiffness[1::2]
    data.qpos[1::2], data.qpos[::2] = spring, posture - spring
    N = np.array([drive.N for drive in made.drives])
    data.ctrl[:] = data.qfrc_bias[1::2] / N
    mujoco.mj_forward(model, data)
    assert np.abs(data.qacc).max() < 1e-6
    assert "NAME_spring" in (tmp_path / "identified.xml").read_text()


def test_the_c_code_is_the_same_function(tmp_path: Path) -> None:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    chain = chain_of("arm6")
    write_files(identified(chain.source, chain.names, 2), tmp_path)
    strict = [
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Wpedantic",
        "-Wno-unused-parameter",
        "-Werror",
        "-O1",
        "-shared",
        "-fPIC",
    ]
    subprocess.run([compiler, *strict, "J.c", "-o", "J.so", "-lm"], cwd=tmp_path, check=True)
    function = ctypes.CDLL(str(tmp_path / "J.so")).arm6_J_identified
    double = ctypes.POINTER(ctypes.c_double)
    q = np.random.default_rng(0).uniform(-2, 2, (20, 6))
    for row, expected in zip(q, evaluated(tmp_path, q), strict=True):
        J = np.zeros((6, 6))
        function(row.ctypes.data_as(double), J.ctypes.data_as(double))
        np.testing.assert_allclose(J, expected, rtol=1e-13, atol=1e-13 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["ypp3", "scara4", "panda"])
def test_the_directory_is_a_robot_directory(name: str, tmp_path: Path) -> None:
    """What was written comes back through symgen: drives, experiment, gravity, and constants alpha."""
    chain = chain_of(name)
    made = identified(chain.source, chain.names, 5, believe=name != "panda")
    write_files(made, tmp_path)
    robot = load_robot(tmp_path)
    assert robot.drives == made.drives
    assert robot.experiment == made.experiment
    assert robot.gravity.tolist() == made.gravity.tolist()
    assert robot.believe_zeros == (name == "ypp3")  # the others' files hold no exact zeros, or are not asked to
    again = chain_of_robot(robot)
    assert again.names == chain.names and again.frozen == chain.frozen
    model = model_of_urdf((tmp_path / "identified.urdf").read_text(), chain.names, believe_zeros=robot.believe_zeros)
    assert model.names == made.model.names
    assert model.alpha_cad == pytest.approx(made.alpha, rel=1e-9, abs=1e-11 * np.abs(made.alpha).max())


def test_a_robot_directory_lends_what_no_record_tells(tmp_path: Path) -> None:
    robot = load_robot(ROBOTS / "scara4")
    chain = chain_of_robot(robot)
    model = model_of_urdf(chain.source, chain.names, believe_zeros=True)
    declared = [robot.drive(name) for name in chain.names]
    numbers = np.array([[drive.K, drive.J_m, drive.D, drive.D_spring] for drive in declared]).T * 1.1
    campaign = replace(campaign_of(chain.source, chain.names), N=np.array([drive.N for drive in declared]))
    D = len(model.names)
    arm = of_parts(campaign, model, model.alpha_cad, np.eye(D), np.zeros((D, 0)), *numbers, robot=robot)
    write_files(arm, tmp_path)
    found = load_robot(tmp_path)
    assert found.experiment == robot.experiment
    for old, new, K in zip(declared, found.drives, numbers[0], strict=True):
        for name in ("encoder_counts", "tau_max", "linear", "N", "link_encoder_counts"):
            assert getattr(new, name) == getattr(old, name)
        assert new.K == K


def test_one_record_leaves_the_other_drives_as_declared_and_says_so(tmp_path: Path) -> None:
    robot = load_robot(ROBOTS / "ypp3")
    quick = replace(robot, experiment=replace(robot.experiment, f0=1.0, periods=3))
    campaign = simulate(chain_of_robot(robot), quick, [("joint3", (0.0, 0.0, 0.0))], lock="rigid", seed=1, workers=1)
    found = identify(campaign, believe_zeros=True)
    write_identified(found, tmp_path)
    drives = load_robot(tmp_path).drives
    for made, true in zip(drives, robot.drives, strict=True):
        assert made.K == pytest.approx(true.K, rel=1e-3) and made.J_m == pytest.approx(true.J_m, rel=1e-3)
        assert made.D > 0 and made.D_spring > 0
    # a joint that is welded shows no encoder
    assert [drive.encoder_counts for drive in drives] == [2**20, 2**20, robot.drives[2].encoder_counts]
    text = (tmp_path / "robot.toml").read_text()
    assert text.count("no record excites this joint") == 2
    q = found.model.random_postures(100, np.random.default_rng(0))
    J = crba((tmp_path / "identified.urdf").read_text(), found.model.chain, q)
    assert np.abs(J - found.J(q)).max() < ACCURACY * np.abs(J).max()


def test_a_spring_that_no_record_shows_is_as_declared(tmp_path: Path) -> None:
    """K of 3e10 +- 3e12 was written, with which MuJoCo's first step is no number."""
    robot = load_robot(ROBOTS / "ypp3")
    quick = replace(robot, experiment=replace(robot.experiment, f0=1.0, periods=3))
    campaign = simulate(chain_of_robot(robot), quick, [("joint3", (0.0, 0.0, 0.0))], lock="rigid", seed=1, workers=1)
    found = identify(campaign, believe_zeros=True)
    assert found.coupled is not None
    std = found.coupled.drive_std.copy()
    std[0, 2] = 2.0 * found.coupled.K[2]
    untold = replace(found, coupled=replace(found.coupled, drive_std=std))
    drive = of_identification(untold).drives[2]
    assert (drive.K, drive.D_spring) == (campaign.K[2], campaign.D_spring[2]) and drive.J_m == found.coupled.J_m[2]
    assert "K is as declared" in of_identification(untold).notes[2] and not of_identification(found).notes[2]
    unknown = replace(untold, campaign=replace(campaign, K=np.full(3, np.nan)))
    assert of_identification(unknown).drives[2].K == found.coupled.K[2]


def test_every_number_of_a_drive_is_the_methods_own() -> None:
    """Held by its motors, the arm is more than two masses: their fit, shown beside the method's own, is far off."""
    robot = load_robot(ROBOTS / "ypp3")
    quick = replace(robot, experiment=replace(robot.experiment, f0=1.0, periods=3))
    campaign = simulate(chain_of_robot(robot), quick, [("joint3", (0.0, 0.0, 0.0))], seed=1, workers=1)
    found = identify(campaign, method="modal", believe_zeros=True)
    (drive,) = found.drives
    made = of_identification(found).drives[2]
    assert (made.K, made.J_m, made.D, made.D_spring) == (
        drive.K.value, drive.J_m.value, drive.D.value, drive.D_spring.value
    )  # fmt: skip
    assert made.D_spring == pytest.approx(robot.drives[2].D_spring, rel=0.1)
    apart = found.measurements[0].two_mass
    assert apart is not None and abs(apart.D_spring / robot.drives[2].D_spring - 1) > 0.3
    negative = replace(drive, D=replace(drive.D, value=-1e-9))  # within noise of zero: no drive for a robot.toml
    assert of_identification(replace(found, drives=(negative,))).drives[2].D == 0.0


def record_of(joints: int, theta: np.ndarray, tau: np.ndarray, lines: list[int]) -> Record:
    return Record("0001", "joint1", np.zeros(joints), 0.5, np.array(lines), 2000, len(theta) // 2000, 0.1, tau, theta)


def test_records_tell_encoders_torques_and_the_experiment(tmp_path: Path) -> None:
    chain, rng = chain_of("ypp3"), np.random.default_rng(0)
    theta = 0.2 * np.cumsum(rng.normal(size=(8000, 3)), axis=0) / 80
    steps = 2 * np.pi / np.array([8192, 131072, 1])
    theta[:, :2] = steps[:2] * np.round(theta[:, :2] / steps[:2])
    campaign = campaign_of(
        chain.source, chain.names, (record_of(3, theta, rng.uniform(-1, 1, (8000, 3)), [1, 3, 201]),)
    )
    model = model_of_urdf(chain.source, chain.names)
    D = len(model.names)
    made = of_parts(campaign, model, model.alpha_cad, np.eye(D), np.zeros((D, 0)), *np.ones((4, 3)))
    assert [drive.encoder_counts for drive in made.drives] == [8192, 131072, 2**20]
    assert [drive.tau_max for drive in made.drives] == [200 / 80, 200 / 80, 100 / 80]
    assert (made.experiment.band, made.experiment.f0, made.experiment.periods) == ((0.5, 100.5), 0.5, 4)
    fifths = replace(campaign.records[0], f0=0.2, lines=np.array([3, 399]))  # 399 times 0.2 is 79.80000000000001
    assert of_cad(replace(campaign, records=(fifths,))).experiment.band == (0.6, 79.8)
    mute = chain.source.replace('effort="200"', 'effort="0"')
    made = of_parts(replace(campaign, urdf=mute), model_of_urdf(mute, chain.names), model.alpha_cad, np.eye(D),
                    np.zeros((D, 0)), *np.ones((4, 3)))  # fmt: skip
    assert made.drives[0].tau_max == pytest.approx(1.0, abs=1e-3)


def of_cad(campaign: Campaign, drives: np.ndarray | None = None) -> Identified:
    model = model_of_urdf(campaign.urdf, campaign.joints)
    D = len(model.names)
    own = np.ones((4, campaign.n)) if drives is None else drives
    return of_parts(campaign, model, model.alpha_cad, np.eye(D), np.zeros((D, 0)), *own)


@pytest.mark.parametrize(
    ("fs", "samples", "periods", "lines", "band", "expected"),
    [
        (1000.0, 2000, 4, [51], (25.25, 25.5), (0.5, 4)),  # one line: the band begins below it
        (1000.0, 3, 4, [1], (166.666, 333.334), (1000 / 3, 4)),  # as the highest there is
        (1e5, 10**6, 12, [1, 1201], (0.1, 120.1), (0.1, 10)),
        (1e5, 6 * 10**6, 3, [300, 60_000], (0.04, 1000.0), (0.04, 3)),
        (1e5, 10**9, 2, [1, 2], (0.0001, 0.04), (0.04, 2)),
    ],
)
def test_an_experiment_is_one_that_a_robot_file_may_have(
    fs: float,
    samples: int,
    periods: int,
    lines: list[int],
    band: tuple[float, float],
    expected: tuple[float, int],
    tmp_path: Path,
) -> None:
    chain, few = chain_of("scara4"), np.zeros((2000, 4))
    f0 = fs / samples
    one = replace(record_of(4, few, few, lines), f0=f0, samples_per_period=samples, periods=periods)
    write_files(made := of_cad(replace(campaign_of(chain.source, chain.names, (one,)), fs=fs)), tmp_path)
    found = load_robot(tmp_path).experiment
    assert found == made.experiment and found.band == pytest.approx(band, rel=1e-4)
    assert (found.f0, found.periods) == (pytest.approx(expected[0]), expected[1])


def test_a_drive_beyond_what_a_robot_file_takes_is_the_nearest_and_that_is_said(tmp_path: Path) -> None:
    chain = chain_of("ypp3")
    wild = np.array([[3e12, 4000.0, 1e-4], [1e-13, 3e-5, 1e4], [-1e-9, 2e-5, 1e10], [2e9, 1.0, 1.0]])
    campaign = replace(campaign_of(chain.source, chain.names), N=np.array([-5e-4, -80.0, 3e6]))
    write_files(arm := of_cad(campaign, drives=wild), tmp_path)
    first, sound, last = load_robot(tmp_path).drives
    assert (first.N, first.K, first.J_m, first.D, first.D_spring) == (-1e-3, 1e12, 1e-12, 0.0, 1e9)
    assert (last.N, last.K, last.J_m, last.D, last.D_spring) == (1e6, 1e-3, 1e3, 1e9, 1.0)
    assert sound == arm.drives[1] and arm.drives[0].K == 3e12
    text = (tmp_path / "robot.toml").read_text()
    assert "# N is -0.0005; -0.001 is the nearest that robot.toml takes; J_m is 1e-13; 1e-12 is the nearest" in text
    assert "\nK is 3e+12; 1e+12 is the nearest" in text.replace("takes; ", "takes\n") and text.count("takes") == 9


def welded(own: str) -> str:
    """The paper's arm with a tool of 1.5 kg fixed to link 3, which itself has the inertial `own`."""
    text = chain_of("ypp3").source
    start = text.index('<link name="link3">')
    first, last = text.index("<inertial>", start), text.index("</inertial>", start) + len("</inertial>")
    inertial = text[first:last]
    tool = f"""<link name="tool">{inertial}</link>
      <joint name="weld" type="fixed"><origin xyz="0 0.05 0.02" rpy="0.3 0 0.2"/><parent link="link3"/><child link="tool"/></joint>"""
    return (text[:first] + own + text[last:]).replace("</robot>", tool + "</robot>")


LIGHT = '<inertial><mass value="0.01"/><inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/></inertial>'
HEAVY = '<inertial><mass value="5"/><inertia ixx="0.2" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/></inertial>'


@pytest.mark.parametrize(("own", "scaled"), [(HEAVY, False), (LIGHT, True), ("", True)])
def test_welded_links_stay_unless_their_carrier_were_no_body(own: str, scaled: bool, tmp_path: Path) -> None:
    text = welded(own)
    chain = parse_chain(text)
    model = model_of_urdf(text, chain.names)
    D, lighter = len(model.names), 0.8 * model.chain.parameters
    drives = np.ones((4, 3))
    campaign = campaign_of(text, chain.names)
    arm = of_parts(campaign, model, model.factoring.W @ lighter, np.eye(D), np.zeros((D, 0)), *drives)
    files = write_files(arm, tmp_path)
    made = files[FILES.index("identified.urdf")].read_text()
    q = model.random_postures(200, np.random.default_rng(0))
    J = model.J(q, model.factoring.W @ lighter)
    assert np.abs(crba(made, chain, q) - J).max() < ACCURACY * np.abs(J).max()
    tool = text[text.index('<link name="tool">') : text.index('<joint name="weld"')]
    assert (tool not in made) == scaled
    assert ("tool is scaled by" in made) == scaled
    for body in pin.buildModelFromXML(made.replace('type="fixed"', 'type="continuous"')).inertias[1:]:
        assert np.linalg.eigvalsh(pin.PseudoInertia.FromInertia(body).toMatrix()).min() > 0.0
    parse_chain(made)  # symgen takes every link for a body


def test_joints_that_were_frozen_are_frozen_in_the_robot_file(tmp_path: Path) -> None:
    chain = chain_of("arm6")
    driven = chain.names[1:5]
    made = identified(chain.source, driven, 3)
    write_files(made, tmp_path)
    robot = load_robot(tmp_path)
    assert dict(robot.at) == {chain.names[0]: 0.0, chain.names[5]: 0.0}
    assert chain_of_robot(robot).names == driven
    text = (tmp_path / "identified.urdf").read_text()
    q = made.model.random_postures(100, np.random.default_rng(0))
    J = made.model.J(q, made.alpha)
    assert np.abs(crba(text, made.model.chain, q) - J).max() < ACCURACY * np.abs(J).max()


def test_an_arm_that_its_urdf_chooses_is_chosen_by_it(tmp_path: Path) -> None:
    """Some of its frozen joints stood in robot.toml, which then meant another arm: J_11 was 34 % off."""
    chain = chain_of("arm6")
    part = load_chain(ROBOTS / "arm6" / "arm6.urdf", tip="link4", at={chain.names[1]: 0.7})
    made = identified(with_arm(part), part.names, 3)
    write_files(made, tmp_path)
    again = chain_of_robot(load_robot(tmp_path))
    assert (again.names, again.tip_link, again.frozen) == (part.names, part.tip_link, part.frozen)
    q = made.model.random_postures(20, np.random.default_rng(0))
    J = make_model(again).J_cad(q)
    assert np.abs(J - made.model.J(q, made.alpha)).max() < ACCURACY * np.abs(J).max()


def test_names_no_file_format_likes(tmp_path: Path) -> None:
    text = chain_of("ypp3").source.replace('"joint2"', '"a.b &quot;c&quot; \\ é#"').replace('"link2"', '"l -- 2 &lt;"')
    chain = parse_chain(text)
    write_files(identified(text, chain.names, 0), tmp_path)
    assert chain_of_robot(load_robot(tmp_path)).names[1] == 'a.b "c" \\ é#'
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "identified.xml"))
    assert model.actuator(1).name == 'a.b "c" \\ é#'


def test_export_writes_the_same_bytes_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chain = chain_of("ur5")
    made = identified(chain.source, chain.names, 6, possible=False)
    files = write_files(made, tmp_path / "first")
    assert main(["export", str(tmp_path / "first"), "-o", str(tmp_path / "second"), "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["files"]
    assert [Path(name).name for name in listed] == FILES
    for path in files:
        assert path.read_bytes() == (tmp_path / "second" / path.name).read_bytes(), path.name
    (tmp_path / "first" / "J.casadi").unlink()
    assert main(["export", str(tmp_path / "first" / "identified.json")]) == 0
    assert (tmp_path / "first" / "J.casadi").read_bytes() == (tmp_path / "second" / "J.casadi").read_bytes()
    again = read(tmp_path / "second")
    for name in ("alpha", "covariance", "unseen", "gravity"):
        assert np.array_equal(getattr(again, name), getattr(made, name))
    assert (again.drives, again.notes, again.experiment) == (made.drives, made.notes, made.experiment)


def damaged(folder: Path, **changes: object) -> Path:
    document = json.loads((folder / "identified.json").read_text())
    (folder / "identified.json").write_text(json.dumps(document | changes))
    return folder


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other"}, "format 'other'; expected 'identified-arm'"),
        ({"alpha": [1.0]}, r"alpha: shape \(1,\)"),
        ({"alpha": "x"}, "not an identified arm: ValueError"),
        ({"alpha_cad": [1.0] * 13}, "are not those that symgen derives"),
        ({"drives": []}, "0 drives; expected 3"),
        ({"drives": [{"N": 1}]}, "not an identified arm: TypeError"),
        ({"urdf": None}, "not an identified arm"),
        ({"joints": ["joint1"] * 3}, "joint1"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(changes: dict[str, object], message: str, tmp_path: Path,
                                               capsys: pytest.CaptureFixture[str]) -> None:  # fmt: skip
    chain = chain_of("ypp3_general")
    write_files(identified(chain.source, chain.names, 0), tmp_path)
    assert main(["export", str(damaged(tmp_path, **changes))]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert re.search(message, said), said


def test_a_place_that_can_not_be_written_is_refused_and_left_as_it_was(tmp_path: Path) -> None:
    chain = chain_of("ypp3")
    made = identified(chain.source, chain.names, 0)
    (tmp_path / "file").write_text("x")
    with pytest.raises(IdentError, match="cannot be written"):
        write_files(made, tmp_path / "file")
    shutil.copytree(ROBOTS / "ypp3", tmp_path / "robot")
    before = sorted((path.name, path.read_bytes()) for path in (tmp_path / "robot").iterdir())
    with pytest.raises(IdentError, match="a robot's own file"):
        write_files(made, tmp_path / "robot")
    assert main(["fit", "missing.h5", "-o", str(tmp_path / "robot")]) == 2
    assert sorted((path.name, path.read_bytes()) for path in (tmp_path / "robot").iterdir()) == before
    (tmp_path / "out" / "J.casadi").mkdir(parents=True)
    with pytest.raises(IdentError, match=r"J.casadi: cannot be written"):
        write_files(made, tmp_path / "out")
    assert not [path for path in (tmp_path / "out").iterdir() if path.name.startswith(".")]
    with pytest.raises(IdentError, match="no such file; expected what ident fit wrote"):
        read(tmp_path)
