"""A record is designed so that it works: margins as the loop itself has them, bands that reach the modes, settled periods."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from vendor import NAMES, write_robot

from ident.errors import ExperimentError
from ident.records.frf import estimate
from ident.simulator.bench import design, head, run
from ident.simulator.design import ABOVE, KNEE_SHARE, Setup, prepare, summary
from ident.simulator.dob import Margins, Servo, close_loop, margins
from ident.simulator.locks import DELAY, DISTANCE
from ident.simulator.plant import build_plant, linearise
from symgen.chain import Chain
from symgen.plan import chain_of_robot
from symgen.robot import Robot, load_robot

YPP3 = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
SCARA4 = load_robot(Path(__file__).parents[3] / "robots" / "scara4")
YPP = chain_of_robot(YPP3)
POSTURE = np.array([0.2, 0.5, -0.9])
#: Six periods of 2 s instead of 10 s.
QUICK = {"line_spacing_Hz": 0.5, "band_Hz": [0.5, 120]}


def made(robot: Robot, joint: str, q: np.ndarray, lock: str = "dob") -> Setup:
    return prepare(chain_of_robot(robot), robot, joint, q, lock=lock, rng=np.random.default_rng(0))


# margins --------------------------------------------------------------------------------------------------------------


def growth(robot: Robot, setup: Setup, scaled: int = 0, factor: float = 1.0, late: int = 0) -> float:
    """Of the loop in which motor `scaled` (of those that move) gives `factor` times the torque that its servo asks for, and all
    motors act `late` samples later."""
    chain, n = chain_of_robot(robot), len(setup.live)
    drives, free = [robot.drive(name) for name in chain.names], setup.joint if n < chain.n else None
    A, B, C = linearise(build_plant(chain, drives, robot.gravity, setup.posture, free=free)).sampled(1e-3)
    B = B.copy()
    B[:, scaled] *= factor
    for _ in range(late):
        A = np.block([[A, B], [np.zeros((n, len(A) + n))]])
        B, C = np.vstack([np.zeros_like(B), np.eye(n)]), np.hstack([C, np.zeros((n, n))])
    return close_loop(A, B, C, setup.servos, 1e-3).growth


#: Where gravity pushes joint 2 away, with 3 and with 21 N m/rad.
FALLING, UPRIGHT = np.array([0.2, 1.0, -2.0]), np.array([0.0, np.pi / 2, 0.0])


@pytest.mark.parametrize(
    ("joint", "q", "lock"),
    [("joint1", POSTURE, "dob"), ("joint3", POSTURE, "dob"), ("joint2", FALLING, "dob"), ("joint2", UPRIGHT, "rigid")],
)
def test_at_its_gain_margins_a_loop_begins_to_grow(joint: str, q: np.ndarray, lock: str) -> None:
    """Upright the hold falls at rest, at zero frequency, where nothing is crossed: a third of 3 times gravity is left."""
    setup = made(YPP3, joint, q, lock)
    motors = range(len(setup.live))
    for bound, inside, outside in ((setup.margins.gain_up, 0.99, 1.01), (setup.margins.gain_down, 1.01, 0.99)):
        assert max(growth(YPP3, setup, motor, bound * inside) for motor in motors) < 0
        assert max(growth(YPP3, setup, motor, bound * outside) for motor in motors) > 0
    if joint == "joint2":
        assert setup.margins.gain_down < 1 / 3 + 0.01
    if q is UPRIGHT:  # its preload is nothing, and asks for no more
        assert setup.margins.gain_down == pytest.approx(1 / 3, abs=0.01)


def test_margins_of_a_double_integrator_with_pd() -> None:
    """L = (kd s + kp)/(J s^2), sampled fast: |L| = 1 and its phase by hand; no gain makes it unstable but by the sampling."""
    J, w, damping, Ts = 1e-4, 2 * np.pi * 5, 0.7, 1e-5
    A, B, C = np.array([[1, Ts], [0, 1]]), np.array([[Ts**2 / 2], [Ts]]) / J, np.array([[1.0, 0.0]])
    found = margins(close_loop(A, B, C, [Servo(kp=J * w**2, kd=2 * damping * J * w)], Ts))
    squares = w**2 * (2 * damping**2 + np.sqrt(4 * damping**4 + 1))  # of the crossover
    phase = np.degrees(np.arctan2(2 * damping * np.sqrt(squares), w))
    assert found.phase == pytest.approx(phase, abs=0.2)  # half a sample and half a difference turn it by 0.06 deg
    assert found.delay == pytest.approx(np.radians(phase) / np.sqrt(squares), rel=0.01)
    assert found.gain_down == 0.0 and found.gain_up > 100
    assert 0.7 < found.distance <= 2 * np.sin(np.radians(phase) / 2) + 1e-2


def test_no_loop_is_nearer_than_its_margins_say() -> None:
    found = made(YPP3, "joint2", POSTURE).margins
    assert found.distance <= 2 * np.sin(np.radians(found.phase) / 2) * 1.001
    assert found.distance <= min(1 - 1 / found.gain_up, 1 / found.gain_down - 1) * 1.001
    assert found.distance >= DISTANCE


# locks ----------------------------------------------------------------------------------------------------------------


def test_a_lock_that_would_be_unstable_is_softened_and_says_so() -> None:
    light = replace(YPP3, drives=tuple(replace(drive, J_m=2e-6) for drive in YPP3.drives))
    setup = made(light, "joint3", np.zeros(3))
    assert setup.growth < 0 and setup.margins.distance >= DISTANCE
    assert setup.note.startswith("lock softened to PD") and "as declared it is unstable" in setup.note
    assert "\n" not in setup.note and setup.note in summary(YPP, [setup])[-1]
    assert made(YPP3, "joint3", POSTURE).note == ""


def test_a_lock_bears_that_its_controller_is_a_sample_late() -> None:
    """The observer's loop of SCARA's slide crosses at 152 Hz with 47 deg left: 0.84 ms, at 1 kHz."""
    setup = made(SCARA4, "joint4", [0, 0, 0.09, 0])
    assert setup.margins.delay * 1000 >= DELAY and growth(SCARA4, setup, late=1) < 0
    hasty = replace(setup, servos=tuple(replace(s, J=J, dob=60 * np.pi if J else 0.0) for s, J in zip(
        setup.servos, [drive.J_m for drive in SCARA4.drives[:3]] + [0.0], strict=True)))  # fmt: skip
    assert growth(SCARA4, hasty) < 0 < growth(SCARA4, hasty, late=1)
    assert "no observer" in setup.note


def test_a_lock_that_only_delay_would_make_unstable_says_so() -> None:
    note = made(SCARA4, "joint2", [0, 0, 0.1, -0.4]).note
    assert note == "lock softened to PD 5 Hz, no observer: as declared it bears a delay of 0.79 samples, expected 1.5"


def test_where_no_lock_bears_a_late_torque_the_one_that_bears_most_says_so() -> None:
    slow = replace(YPP3, experiment=replace(YPP3.experiment, fs=100.0, band=(0.1, 39.0)))
    setup = made(slow, "joint2", np.zeros(3))
    assert setup.margins.distance >= DISTANCE and setup.margins.delay * 100 < DELAY
    assert setup.note.endswith("samples, expected 1.5: raise the sampling rate")


def direct(lock_pd: float = 5.0) -> Robot:
    """Motors without gears, small under large links: the shoulder's link has 120 times its rotor's inertia."""
    kinds = ((0.004, 300.0), (0.006, 250.0), (0.0005, 100.0))
    drives = tuple(
        replace(drive, N=1.0, J_m=J_m, K=K, D=0.02, D_spring=0.3, tau_max=100.0)
        for drive, (J_m, K) in zip(YPP3.drives, kinds, strict=True)
    )
    return replace(YPP3, drives=drives, experiment=replace(YPP3.experiment, band=(0.1, 40.0), lock_pd=lock_pd))


@pytest.mark.parametrize("q", [FALLING, UPRIGHT], ids=["falling", "upright"])
def test_small_rotors_that_no_softer_lock_holds_get_a_more_damped_one(q: np.ndarray) -> None:
    setup = made(direct(), "joint1", q)
    assert setup.margins.distance >= DISTANCE and setup.margins.delay * 1000 >= DELAY
    assert growth(direct(), setup) < 0 and growth(direct(), setup, late=1) < 0
    assert setup.note.startswith("lock PD ") and setup.note.endswith(
        "damping 2, no observer: as declared it is unstable"
    )


def test_what_is_advised_where_no_lock_is_safe_makes_it_safer() -> None:
    """A PD on the rotor too soft for gravity is not to be softened."""
    with pytest.raises(
        ExperimentError, match="no lock is safe: .* gravity pushes 'joint2' away with 21 N m/rad, .* holds 0.0"
    ) as told:
        made(direct(0.2), "joint1", UPRIGHT)
    assert "raise lock_pd_Hz" in str(told.value) and "lower" not in str(told.value)
    with pytest.raises(ExperimentError, match=r"no lock is safe: .* \(growth rate \+.*; lower lock_pd_Hz") as told:
        made(direct(2000.0), "joint1", UPRIGHT)
    for error in (str(told.value),):
        assert "--lock rigid" in error and "raise lock_pd" not in error and error.count("; ") == 1


def soft(K: float) -> Robot:
    return replace(YPP3, drives=tuple(replace(one, K=K) if one.joint == "joint2" else one for one in YPP3.drives))


@pytest.mark.parametrize("lock", ["rigid", "dob"])
def test_a_spring_softer_than_gravity_is_named(lock: str) -> None:
    """The stretched arm weighs 21 N m: upright, gravity pushes it away with 21 N m/rad."""
    with pytest.raises(ExperimentError, match=r"joint 'joint2' at posture .*: its spring of 60 N m/rad .* 21 N m/rad"):
        made(soft(60.0), "joint2", UPRIGHT, lock)
    assert made(soft(60.0), "joint2", -UPRIGHT, lock).margins.distance >= DISTANCE
    stiffer = made(soft(80.0), "joint2", UPRIGHT, lock)
    assert stiffer.margins.distance >= DISTANCE and stiffer.margins.gain_down < 1 / 3


def test_a_hold_is_asked_for_the_margins_of_a_lock() -> None:
    """Ten samples a second: the hold's own PD is 0.12 from instability, and there is no lock to be changed."""
    slow = replace(YPP3, experiment=replace(YPP3.experiment, fs=10.0, band=(0.1, 4.0)))
    with pytest.raises(ExperimentError, match=r"its hold is not safe: it is 0.12 from instability") as told:
        made(slow, "joint2", UPRIGHT, "rigid")
    assert "lock_" not in str(told.value) and str(told.value).count("; ") == 1


# limits ---------------------------------------------------------------------------------------------------------------


def between(joint: str, lower: float, upper: float) -> Chain:
    return replace(YPP, joints=tuple(
        replace(one, lower=lower, upper=upper) if one.name == joint else one for one in YPP.joints))  # fmt: skip


@pytest.mark.parametrize("f0", [1.0, 2.0])
def test_a_record_stays_within_the_limits_from_its_start(f0: float) -> None:
    """With periods of half a second the arm goes three times as far at the start as later."""
    chain = between("joint3", -0.95, -0.85)
    wide = replace(YPP3, experiment=replace(YPP3.experiment, swing=0.1, f0=f0, band=(f0, 120.0), periods=4))
    (job,) = design(chain, wide, [("joint3", POSTURE)])
    setup = job.setup
    assert "what swing and torque allow: 'joint3' is 0.05 rad from its limit" in setup.note
    angle = (run(job).theta[:, 2] / 100)[:, None] - [-0.95, -0.85]
    assert np.all(angle[:, 0] > 0) and np.all(angle[:, 1] < 0)
    assert np.abs(angle).min() < 0.02  # and what there is of room is used
    assert setup.swing < 0.05 and setup.motion[2] <= setup.swing


def test_without_room_no_record_is_made() -> None:
    with pytest.raises(ExperimentError, match="no room: 'joint3' is 1e-06 rad from its limit .*; another posture"):
        prepare(between("joint3", -0.9, 0), YPP3, "joint2", POSTURE, lock="dob", rng=np.random.default_rng(0))
    near = prepare(between("joint3", -1.0, 0), YPP3, "joint2", POSTURE, lock="dob", rng=np.random.default_rng(0))
    assert near.note == "" and near.swing == pytest.approx(YPP3.experiment.swing)


def test_where_no_lock_is_stable_that_is_said() -> None:
    wild = replace(YPP3, experiment=replace(YPP3.experiment, lock_pd=3000.0))
    with pytest.raises(ExperimentError, match=r"joint 'joint3' at posture .* (unstable|no lock is safe)"):
        made(wild, "joint3", POSTURE)


def test_heavy_motor_friction_gets_a_stiffer_hold() -> None:
    heavy = replace(YPP3, drives=tuple(replace(drive, D=0.01) for drive in YPP3.drives))
    assert made(heavy, "joint3", POSTURE).settle <= 2


# vendors' arms --------------------------------------------------------------------------------------------------------

#: A posture with gravity and coupling on every joint, within every arm's limits.
BENT = {"ur5": [0.3, -0.9, 1.1, 0.4, 0.8, 0.2], "panda": [0.3, 0.5, 0.2, -1.6, 0.4, 1.5, 0.3],
        "xarm7": [0.3, 0.5, 0.2, 1.4, 0.4, 0.9, 0.3]}  # fmt: skip


@pytest.fixture(params=NAMES)
def vendor(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[str, Robot]:
    return request.param, write_robot(request.param, tmp_path, **QUICK)


def test_every_joint_of_a_vendors_arm_can_be_measured(vendor: tuple[str, Robot]) -> None:
    name, robot = vendor
    chain = chain_of_robot(robot)
    for joint in chain.names:
        setup = made(robot, joint, np.array(BENT[name]))
        assert setup.growth < -1.0 and setup.margins.distance >= DISTANCE
        assert setup.swing <= robot.experiment.swing * (1 + 1e-9)
        assert 0 < setup.held < 1.5


@pytest.mark.parametrize("vendor", ["ur5", "panda", "xarm7"], indirect=True)
@pytest.mark.bench
def test_a_simulated_record_settles_when_the_design_says(vendor: tuple[str, Robot]) -> None:
    """Judged by the reading side, which finds the first settled period in the record itself."""
    name, robot = vendor
    chain = chain_of_robot(robot)
    cells = [(joint, BENT[name]) for joint in (chain.names[0], chain.names[-1])]
    for job in design(chain, robot, cells):
        record = run(job)
        frf = estimate(record, head(chain, robot, (record,)))
        assert record.periods == job.setup.periods >= job.setup.settle + 3
        assert frf.status == () and frf.first <= job.setup.settle


def test_a_joint_above_the_band_gets_a_wider_one(tmp_path: Path) -> None:
    robot = write_robot("panda", tmp_path, **QUICK)
    setup = made(robot, "panda_joint7", np.array(BENT["panda"]))
    assert setup.f_AR > 120 and f"f_AR = {setup.f_AR:.3g} Hz is above the band's 120 Hz: excited up to" in setup.note
    top = setup.excitation.lines[-1] * 0.5
    assert ABOVE * setup.f_AR < top <= 0.4 * 1000
    flat = setup.excitation.lines * 0.5 > KNEE_SHARE * setup.f_AR
    assert np.ptp(setup.excitation.amplitude[flat]) < 1e-12 * setup.excitation.amplitude.max()
    assert made(robot, "panda_joint4", np.array(BENT["panda"])).excitation.lines[-1] * 0.5 <= 120


def test_a_joint_beyond_the_sampling_rate_is_told_of() -> None:
    """f_AR = 199 Hz, f_R = 241 Hz: both sides of it are seen up to 0.4 times the sampling rate, unless that is too low."""
    stiff = replace(
        YPP3, drives=tuple(replace(one, K=73000.0) if one.joint == "joint3" else one for one in YPP3.drives)
    )
    for fs, top in ((1000.0, 301.0), (700.0, 280.0), (560.0, 224.0), (540.0, 120.0)):
        slow = replace(stiff, experiment=replace(YPP3.experiment, fs=fs, f0=0.5, band=(0.5, 120.0)))
        setup = made(slow, "joint3", POSTURE, "rigid")
        assert setup.f_AR == pytest.approx(199.2, abs=0.1)
        assert top - 5 < setup.excitation.lines[-1] * 0.5 <= top
        assert ("its f_R is 241 Hz" in setup.note) == (fs == 560)
    assert "too high for 540 samples a second: J_ii is not seen here without sample_rate_Hz >= 553.3" in setup.note


def test_the_anti_resonance_is_that_of_one_spring_where_the_others_are_rigid() -> None:
    """sqrt(K/J_33)/(2 pi), J_33 by hand; with flexible neighbours the mode that tells most of J_33 lies elsewhere."""
    assert made(YPP3, "joint3", POSTURE, lock="rigid").f_AR == pytest.approx(np.sqrt(4500 / 0.0466) / (2 * np.pi))
    assert made(YPP3, "joint3", POSTURE).f_AR != pytest.approx(np.sqrt(4500 / 0.0466) / (2 * np.pi), rel=0.1)


def test_where_transients_take_too_long_the_remedy_stands_apart() -> None:
    rapid = replace(YPP3, experiment=replace(YPP3.experiment, f0=20.0, band=(20.0, 120.0)))
    with pytest.raises(ExperimentError, match="transients need .* expected at most 30; check D_Nms_per_rad"):
        made(rapid, "joint1", POSTURE)


def test_slow_arms_get_more_periods() -> None:
    short = replace(YPP3, experiment=replace(YPP3.experiment, f0=2.0, band=(2.0, 120.0), periods=3))
    setup = made(short, "joint1", POSTURE)
    assert setup.settle > 3 and setup.periods == setup.settle + 3


def test_the_summary_tells_the_worst_of_all_records_and_where_each_is() -> None:
    one, two, three = (made(YPP3, joint, POSTURE) for joint in YPP.names)
    setups = [
        replace(one, margins=Margins(0.9, 7.0, 50.0, 0.5, 3e-3)),
        replace(two, margins=Margins(0.1, 8.0, 5.0, 0.01, 4e-3), held=3.0, note="odd"),
        replace(three, margins=Margins(0.1, 1.2, 60.0, 0.5, 2e-3)),
    ]
    first, second, third = (f"(joint {joint!r} at posture [0.2, 0.5, -0.9])" for joint in YPP.names)
    lines = summary(YPP, setups)
    assert lines[:5] == (
        f"Locks: every loop keeps 0.01 or more from -1 {second}",
        f"Worst gain margins: 0.90 {first} and 1.20 {third}",
        f"Worst phase margin: 5 deg {second}",
        f"Least delay margin: 2 ms {third}",
        f"Held motors take up to 3.00 of the excited one's motion {second}",
    )
    assert lines[-1].endswith(": odd") and all("\n" not in line for line in lines)


def test_held_motion_does_not_depend_on_the_unit_of_length() -> None:
    """SCARA in millimetres (kg, mm, s): a slide's velocity is a thousand times the number, and held motion the same."""
    chain, k = chain_of_robot(SCARA4), 1e3
    joints = tuple(replace(one, p=k * one.p, lower=-np.inf, upper=np.inf, inertia=replace(
        one.inertia, com=k * one.inertia.com, I=k**2 * one.inertia.I)) for one in chain.joints)  # fmt: skip
    drives = tuple(replace(one, J_m=k**2 * one.J_m, D=k**2 * one.D, tau_max=k**2 * one.tau_max, N=one.N / k) if one.linear
                   else replace(one, J_m=k**2 * one.J_m, D=k**2 * one.D, tau_max=k**2 * one.tau_max, K=k**2 * one.K,
                                D_spring=k**2 * one.D_spring) for one in SCARA4.drives)  # fmt: skip
    small = replace(SCARA4, drives=drives, gravity=k * SCARA4.gravity)
    for joint in ("joint2", "joint4"):
        q = np.array([0.0, 0.4, 0.1, -0.4])
        expected = made(SCARA4, joint, q).held
        q[2] *= k
        rng = np.random.default_rng(0)
        found = prepare(replace(chain, joints=joints), small, joint, q, lock="dob", rng=rng).held
        assert found == pytest.approx(expected, rel=1e-5) and expected > 0.01
