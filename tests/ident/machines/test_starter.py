"""A robot directory to start from, and the doctor's page on it and on robots that are not ready."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from two_joints import two_joints

from ident.cli import main
from ident.errors import ExperimentError, IdentError
from ident.machines.doctor import Examination, examine
from ident.machines.doctor_findings import of_drive, of_encoders, of_locks
from ident.machines.doctor_page import page
from ident.machines.starter import SECOND, new_robot, starting_drives
from ident.simulator.design import prepare
from symgen.errors import PlanError, RobotError
from symgen.plan import chain_of_file, chain_of_robot
from symgen.robot import load_robot, recordable

ROBOTS = Path(__file__).parents[3] / "robots"


@pytest.mark.parametrize("name", ["ypp3", "arm6", "arm7", "scara4"])
def test_the_numbers_to_start_from_put_every_mode_into_the_band(name: str) -> None:
    """f_AR and f_R of two masses, over Pinocchio's inertia at random postures; torque is left beside gravity."""
    urdf = ROBOTS / name / f"{name}.urdf"
    chain, _ = chain_of_file(urdf)
    drives, _, _ = starting_drives(chain, np.array([0.0, 0.0, -9.81]))
    model = pin.buildModelFromUrdf(str(urdf))
    data = model.createData()
    rng = np.random.default_rng(1)
    for _ in range(100):
        q = pin.neutral(model)
        angles = rng.uniform(*np.clip(chain.limits, -np.pi, np.pi).T)
        for joint, value in zip(chain.joints, angles, strict=True):
            k = model.joints[model.getJointId(joint.name)]
            q[k.idx_q : k.idx_q + k.nq] = value if k.nq == 1 else [np.cos(value), np.sin(value)]
        J = np.diag(pin.crba(model, data, q))
        weight = np.abs(pin.computeGeneralizedGravity(model, data, q))
        for i, (drive, joint) in enumerate(zip(drives, chain.joints, strict=True)):
            v = model.joints[model.getJointId(joint.name)].idx_v
            f_AR = np.sqrt(drive.K / J[v]) / (2 * np.pi)
            f_R = f_AR * np.sqrt(1 + J[v] / (drive.N**2 * drive.J_m))
            assert 1 < f_AR < f_R < 120, (name, i)
            assert weight[v] < 0.7 * drive.N * drive.tau_max


def test_a_new_robot_is_ready_and_says_what_to_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    home = tmp_path / "arm"
    assert main(["new", str(ROBOTS / "ypp3/ypp3.urdf"), "-o", str(home)]) == 0
    robot = load_robot(home)
    assert chain_of_robot(robot).names == ("joint1", "joint2", "joint3")
    assert robot.urdf.read_bytes() == (ROBOTS / "ypp3/ypp3.urdf").read_bytes()
    text = (home / "robot.toml").read_text()
    model = tomllib.loads((ROBOTS / "ypp3/robot.toml").read_text())  # knows all keys but four
    more = ("base", "tip", "at", "link_encoder_counts_per_rev")
    for key in (*model["robot"], *model["experiment"], *model["joint"]["joint1"], *more):
        assert re.search(rf"^(# )?{key} = .*#", text, re.MULTILINE), key
    assert text.count("check me") >= 3 * 7
    (tmp_path / "arm/linked.toml").write_text(text.replace("# link_encoder", "link_encoder"))
    assert {drive.link_encoder_counts for drive in load_robot(tmp_path / "arm/linked.toml").drives} == {SECOND}
    capsys.readouterr()
    assert main(["doctor", str(home)]) == 0
    assert capsys.readouterr().out.endswith("Ready for a campaign.\n")


def test_a_torque_says_what_it_was_made_of(tmp_path: Path) -> None:
    """Joint 1 is upright and feels no gravity; no effort is stated, and then one is."""
    text = re.sub(' effort="[^"]*"', "", (ROBOTS / "ypp3/ypp3.urdf").read_text())
    (tmp_path / "arm.urdf").write_text(text)
    toml = new_robot(tmp_path / "arm.urdf", tmp_path / "bare")
    said = re.findall("torque_limit_Nm = (.*?)   # motor side; check me: (.*), over N", toml.read_text())
    assert [what for _, what in said] == ["10 rad/s2 of mean J_ii and N^2 J_m", "4 times gravity", "4 times gravity"]
    robot = load_robot(tmp_path / "bare")
    one = robot.drive("joint1")
    assert one.tau_max * one.N == pytest.approx(10 * 2 * one.N**2 * one.J_m, rel=0.1)  # two digits of each
    (tmp_path / "arm.urdf").write_text(text.replace("<limit", '<limit effort="7"'))
    assert new_robot(tmp_path / "arm.urdf", tmp_path / "full").read_text().count("the URDF's effort, 7 N m") == 3


def test_names_of_several_lines_stay_in_their_comment(tmp_path: Path) -> None:
    text = (ROBOTS / "ypp3/ypp3.urdf").read_text()
    for name in ("ypp3", "base_link"):
        text = text.replace(f'"{name}"', f'"{name}&#10;urdf = 3"')
    (tmp_path / "arm.urdf").write_text(text)
    toml = new_robot(tmp_path / "arm.urdf", tmp_path / "arm")
    assert chain_of_robot(load_robot(toml)).n == 3
    assert toml.read_text().startswith("# ypp3 urdf = 3: 3 joints, base_link urdf = 3 to link3.")


@pytest.mark.parametrize("factor", [1e-12, 1e-9, 1e-6, 3e4])
def test_a_robot_of_any_weight_is_one_that_can_be_read(factor: float, tmp_path: Path) -> None:
    """Placeholders of next to nothing, and their opposites; what the doctor says of such is another matter."""
    text = (ROBOTS / "ypp3/ypp3.urdf").read_text()
    for attribute in ("mass value", "ixx", "iyy", "izz", "ixy", "ixz", "iyz"):
        text = re.sub(f'{attribute}="([^"]*)"', lambda m, a=attribute: f'{a}="{float(m[1]) * factor:.6g}"', text)
    (tmp_path / "arm.urdf").write_text(re.sub(' effort="[^"]*"', "", text))
    assert len(load_robot(new_robot(tmp_path / "arm.urdf", tmp_path / "arm")).drives) == 3


def test_nothing_of_a_person_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    urdf = ROBOTS / "ypp3/ypp3.urdf"
    new_robot(urdf, tmp_path / "arm")
    before = (tmp_path / "arm/robot.toml").read_bytes()
    with pytest.raises(IdentError, match="exists"):
        new_robot(urdf, tmp_path / "arm")
    assert (tmp_path / "arm/robot.toml").read_bytes() == before
    (tmp_path / "other").mkdir()
    (tmp_path / "other/ypp3.urdf").write_text("mine")
    with pytest.raises(IdentError, match="differs"):
        new_robot(urdf, tmp_path / "other")
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["ypp3.urdf"]
    assert main(["new", str(tmp_path / "nowhere.urdf"), "-o", str(tmp_path / "x")]) == 2
    assert not (tmp_path / "x").exists() and capsys.readouterr().err.count("\n") == 1


# the doctor -----------------------------------------------------------------------------------------------------------


def spoiled(tmp_path: Path, *changes: tuple[str, str]) -> Examination:
    home = tmp_path / "arm"
    shutil.copytree(ROBOTS / "ypp3", home, dirs_exist_ok=True)
    text = (ROBOTS / "ypp3/robot.toml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (home / "robot.toml").write_text(text)
    return examine(str(home))


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Examination:
    return spoiled(tmp_path_factory.mktemp("sound"))


def test_figures_of_a_sound_robot(sound: Examination) -> None:
    """J_33 = 0.0466 by the paper; gravity 2.6 and 21 N m by robot.toml's comment; the rest by (4) and K."""
    one, two, three = sound.joints
    assert sound.ready
    assert three.J == pytest.approx((0.0466, 0.0466), rel=1e-4) and three.rotor == pytest.approx(0.1)
    f_AR = np.sqrt(4500 / 0.0466) / (2 * np.pi)
    assert three.f_AR == pytest.approx((f_AR, f_AR), rel=1e-3)
    assert three.f_R == pytest.approx((f_AR * np.sqrt(1.466),) * 2, rel=1e-3)
    assert three.gravity == pytest.approx(2.6 / 100, rel=0.05) and two.gravity == pytest.approx(21 / 200, rel=0.05)
    assert two.sag == pytest.approx(21 / 4500, rel=0.05) and one.sag == pytest.approx(0, abs=1e-6)
    assert sum(joint.records for joint in sound.joints) == len(sound.plan.cells)
    assert all(joint.swing == pytest.approx(0.01, rel=1e-6) for joint in sound.joints)


def test_the_page_is_a_page_and_the_json_has_the_same(sound: Examination, capsys: pytest.CaptureFixture[str]) -> None:
    text = page(sound)
    assert len(text.splitlines()) < 40
    assert main(["doctor", str(ROBOTS / "ypp3"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["ready"] is True and [one["joint"] for one in found["joints"]] == ["joint1", "joint2", "joint3"]
    assert found["joints"][2]["f_AR"] == pytest.approx(list(sound.joints[2].f_AR))


#: (what to spoil, what the finding must speak of, whether a campaign is impossible)
ILL = [
    ((("band_Hz = [0.1, 120]", "band_Hz = [0.1, 40]"), ("sample_rate_Hz = 1000", "sample_rate_Hz = 100")), "joint1: its anti-resonance", True),
    ((("band_Hz = [0.1, 120]", "band_Hz = [0.1, 55]"),), "joint3: its resonance is at 59.9 Hz", False),
    ((("torque_limit_Nm = 2.0", "torque_limit_Nm = 0.29"),), "joint2: gravity takes", False),
    ((("K_Nm_per_rad = 4500", "K_Nm_per_rad = 900"),), "mrad under gravity", False),
    ((("J_m_kgm2 = 1e-5", "J_m_kgm2 = 1e-4"),), "joint3: J_ii falls to 0.047", False),
    ((("D_spring_Nms_per_rad = 1.1", "D_spring_Nms_per_rad = 0.1"),), "joint2: its sharpest anti-resonance", False),
    ((("encoder_counts_per_rev = 131072", "encoder_counts_per_rev = 4096"),), "times the encoder's noise", False),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "says", "serious"), ILL, ids=[says for _, says, _ in ILL])
def test_each_ailment_is_named(changes: tuple, says: str, serious: bool, sound: Examination, tmp_path: Path) -> None:
    assert not any(says in finding.what for finding in sound.findings)
    found = spoiled(tmp_path, *changes)
    named = [finding for finding in found.findings if says in finding.what]
    assert named and named[0].serious == serious and named[0].remedy
    assert not serious or not found.ready


def advised(found: Examination, joint: str) -> str | None:
    """What is to be done for a joint whose anti-resonance is too sharp."""
    words = f"{joint}: its sharpest anti-resonance"
    return next((finding.remedy for finding in found.findings if finding.what.startswith(words)), None)


@pytest.mark.parametrize(
    "D_spring", [0.7, 0.05, *(pytest.param(between, marks=pytest.mark.bench) for between in (0.33, 0.11))]
)
def test_the_spacing_advised_is_one_that_robot_toml_may_have_and_that_helps(D_spring: float, tmp_path: Path) -> None:
    """Excited lines are odd, two spacings apart; D_spring = 0.7 makes the anti-resonance 0.16 Hz wide."""
    change = ("D_spring_Nms_per_rad = 1.1", f"D_spring_Nms_per_rad = {D_spring}")
    found = spoiled(tmp_path, change)
    width = D_spring / found.joints[1].J[1] / (2 * np.pi)
    (said,) = [f.what for f in found.findings if f.what.startswith("joint2: its sharpest")]
    assert f"is {width:.3g} Hz wide, excited lines are 0.2 Hz apart" in said
    remedy = advised(found, "joint2")
    assert remedy is not None
    spacing = remedy.split("line_spacing_Hz = ")[1].split(",")[0]
    assert width / 5.1 < 2 * float(spacing) <= width
    toml = tmp_path / "arm/robot.toml"
    toml.write_text(re.sub("line_spacing_Hz = .*", f"line_spacing_Hz = {spacing}", toml.read_text()))
    assert load_robot(toml).experiment.f0 == float(spacing)


def test_a_spacing_that_no_record_can_hold_is_not_advised(tmp_path: Path) -> None:
    found = spoiled(tmp_path, ("D_spring_Nms_per_rad = 1.1", "D_spring_Nms_per_rad = 1e-4"))
    remedy = advised(found, "joint2")
    assert remedy is not None and "line_spacing_Hz" not in remedy


@pytest.mark.parametrize(
    ("fs", "f0"), [(1000.0, 0.2), (2000 / 3, 0.2 / 3), (8192.0, 0.125), (333.0, 0.3), (100.0, 3.125)]
)
def test_a_record_is_recordable_where_load_robot_says_so(fs: float, f0: float, tmp_path: Path) -> None:
    shutil.copy(ROBOTS / "ypp3/ypp3.urdf", tmp_path)
    text = (ROBOTS / "ypp3/robot.toml").read_text()
    text = re.sub("sample_rate_Hz = .*", f"sample_rate_Hz = {fs}", text).replace("[0.1, 120]", "[0.1, 45]")
    seen = set()
    for factor in (1.0, 1 / 3, 1 / 3 * (1 + 3e-9), 0.37, 1e-3, 1e-4, 1e-5, 1e-9, 1e-319):
        spacing = f0 * factor
        (tmp_path / "robot.toml").write_text(re.sub("line_spacing_Hz = .*", f"line_spacing_Hz = {spacing!r}", text))
        try:
            may = load_robot(tmp_path).experiment.f0 == spacing
        except RobotError as error:
            assert "samples" in str(error)
            may = False
        assert recordable(fs, spacing, 6) == may
        seen.add(may)
    assert seen == {True, False}


def test_the_encoder_is_judged_at_the_highest_line_played(tmp_path: Path) -> None:
    """Joint 1's anti-resonance reaches 95.7 Hz, far above a band of 40 Hz: that record is excited up to 1.25 f_R."""
    coarse = ("encoder_counts_per_rev = 131072", "encoder_counts_per_rev = 256")
    found = spoiled(tmp_path, coarse, ("band_Hz = [0.1, 120]", "band_Hz = [0.1, 40]"))
    tops = dict(re.findall(r"(\w+): at ([0-9.]+) Hz its motor moves", "\n".join(f.what for f in found.findings)))
    assert float(tops["joint1"]) == pytest.approx(1.25 * 97.5, rel=0.01) and 39 < float(tops["joint3"]) < 40
    assert [float(tops[j.joint]) for j in found.joints] == pytest.approx([j.visible_at for j in found.joints], rel=1e-3)


def one_joint(folder: Path, **other: float) -> Examination:
    """The second joint of two, on its own."""
    robot = two_joints(
        folder, "sample_rate_Hz = 1000\nline_spacing_Hz = 1.0\nband_Hz = [1.0, 90.0]\nperiods = 3", {}, other
    )
    return examine(str(robot.path))


@pytest.mark.parametrize(
    ("slip", "asks", "ready"),
    [
        ({"K_Nm_per_rad": 150.0 / 57.3}, "is K in N m/deg? multiply it by 57.3", False),
        ({"J_m_kgm2": 1e-3, "encoder_counts_per_rev": 16777216}, "is it in g cm2 (1e-7), kg cm2 (1e-4), or", None),
        ({"J_m_kgm2": 1e-9}, "is it in g cm2 (1e-7), kg cm2 (1e-4), or", None),
        ({"N": 0.9, "J_m_kgm2": 0.1, "torque_limit_Nm": 100.0}, "is 1/N meant, N = 1.111?", None),
    ],
)
def test_units_that_no_arm_has_are_asked_for(
    tmp_path: Path, slip: dict[str, float], asks: str, ready: bool | None
) -> None:
    found = one_joint(tmp_path, **slip)
    (finding,) = [finding for finding in found.findings if asks in finding.remedy]
    assert finding.what.startswith("j2: ") and finding.serious is (ready is False)
    assert ready is None or found.ready is ready


def test_direct_drives_and_soft_springs_are_not_asked_for_units(tmp_path: Path) -> None:
    """A rotor of a hundredth of its link's inertia, a spring that gives by 20 mrad and one by 0.2 rad."""
    for k, drive in enumerate(({"N": 1.0, "J_m_kgm2": 5e-4, "torque_limit_Nm": 100.0}, {"K_Nm_per_rad": 20.0})):
        (home := tmp_path / str(k)).mkdir()
        assert not [f.remedy for f in one_joint(home, **drive).findings if "?" in f.remedy]


def test_a_gear_ratio_the_other_way_round_is_asked_for_where_there_is_no_plan(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match=r"j2: is 1/N meant, N = 100\?$"):
        one_joint(tmp_path, N=0.01)


def test_records_that_can_not_be_run_are_problems(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A PD of 60 Hz at 400 samples a second, motors' springs as they are: no lock of it is safe, however softened."""
    found = spoiled(
        tmp_path,
        ("lock_pd_Hz = 5", "lock_pd_Hz = 600"),
        ("lock_dob_Hz = 30", "lock_dob_Hz = 300"),
        ("sample_rate_Hz = 1000", "sample_rate_Hz = 400"),
    )
    assert not found.ready
    assert any("lock is" in finding.what for finding in found.findings)
    assert all(joint.swing is None for joint in found.joints)
    assert main(["doctor", str(tmp_path / "arm")]) == 1
    out = capsys.readouterr().out
    assert "NOT READY" in out and "nan" not in out


def test_a_record_that_can_not_be_run_has_the_remedy_of_its_error(
    sound: Examination, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that nobody knows is not spoken of."""
    told = iter(["transients need 99 s to die; check D", "the arm does nothing"])

    def refused(*_: object, **__: object) -> None:
        raise ExperimentError(next(told, "no"))

    monkeypatch.setattr("ident.machines.doctor.prepare", refused)
    found = examine(str(sound.robot.path))
    first, second = (line for line in page(found).splitlines() if line.startswith(("! record 1:", "! record 2:")))
    assert first.endswith("to die: it can not be run. Remedy: check D.") and second.endswith(
        "nothing: it can not be run."
    )


def test_what_an_encoder_can_not_tell_is_told(sound: Examination) -> None:
    def told(**figures: float | None) -> list[tuple[str, bool]]:
        return [(finding.what, finding.serious) for finding in of_encoders(replace(sound.joints[2], **figures))]

    at = f"{sound.joints[2].visible_at:.4g}"
    assert told() == [] and told(held_counts=None, counts=None, visible=None) == []
    assert told(visible=9.0) == [(f"joint3: at {at} Hz its motor moves 9 times the encoder's noise", False)]
    assert told(visible=0.9) == [(f"joint3: at {at} Hz its motor moves 0.9 times the encoder's noise", True)]
    assert told(counts=1.5, visible=0.1) == [("joint3: its motor moves through 1.5 counts of its encoder", True)]
    few = "joint3: in its records held motors move through as little as 4 counts of their encoders"
    assert told(held_counts=4.0) == [(few, False)] and told(held_counts=11.0) == []


def test_a_spring_that_gives_asks_for_nothing_that_is_not_used(sound: Examination) -> None:
    (found,) = of_drive(replace(sound.joints[1], sag=0.03), sound.robot)
    assert "its spring gives by up to 30 mrad" in found.what and "--method coupled" in found.remedy
    assert "encoder" not in found.remedy


def test_counts_are_those_that_a_motor_moves_through(sound: Examination) -> None:
    """20 mrad from peak to peak, times 100, of 131072 a turn; a joint whose axis is upright moves no other."""
    one, two, three = sound.joints
    for joint in (one, two, three):
        assert joint.counts == pytest.approx(0.02 * 100 * 131072 / (2 * np.pi), rel=0.1)
    assert one.held_counts is None and two.held_counts is not None and three.held_counts is not None
    assert 100 < min(two.held_counts, three.held_counts) < 10_000


def test_a_limit_that_shortens_records_is_told(sound: Examination) -> None:
    chain, rng = sound.plan.model.chain, np.random.default_rng(0)
    setup = prepare(chain, sound.robot, "joint1", np.zeros(3), lock="dob", rng=rng)
    short = replace(setup, note="excited at 41% of what swing and torque allow: 'joint1' is 0.05 rad from its limit")
    told, *_ = of_locks(sound.plan, [short])
    assert "0.05 rad from its limit" in told.why and told.remedy == "other postures" and not told.serious


def test_a_slide_has_its_own_units() -> None:
    """SCARA's slide carries 2.5 kg, its screw's rotor counts as 1.97 kg, and it swings 10 mm."""
    text = page(examine(str(ROBOTS / "scara4")))
    (workspace, planned) = (line for line in text.splitlines() if line.startswith("joint3 "))
    assert re.search(r"^joint3 +2\.5 kg +1\.97 kg .* 0\.027 mm$", workspace) and " 10 mm " in planned
    (hinge, *_) = (line for line in text.splitlines() if line.startswith("joint2 "))
    assert "kg" not in hinge and "mm" not in hinge
    (legend,) = (line for line in text.splitlines() if line.startswith("settles: "))
    assert all(f"{word}: " in legend for word in ("settles", "margin", "delay", "held", "visible"))


def test_what_the_design_changed_is_said(tmp_path: Path) -> None:
    """A soft declared lock is too near to instability at 200 samples a second: the records' own is softer, and that is said."""
    found = spoiled(tmp_path, ("sample_rate_Hz = 1000", "sample_rate_Hz = 250"), ("lock_pd_Hz = 5", "lock_pd_Hz = 12"))
    noted = [finding for finding in found.findings if "lock softened" in finding.why]
    assert noted and not any(finding.serious for finding in noted)
