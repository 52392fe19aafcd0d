"""A record is designed so that it works: margins as the loop itself has them, bands that reach the modes, settled periods."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from vendor import NAMES, write_robot

from ident.bench import design, head, run
from ident.design import ABOVE, DISTANCE, KNEE_SHARE, Setup, prepare, summary
from ident.dob import Margins, Servo, close_loop, margins
from ident.errors import ExperimentError
from ident.frf import estimate
from ident.plant import build_plant, linearise
from symgen.plan import chain_of_robot
from symgen.robot import Robot, load_robot

YPP3 = load_robot(Path(__file__).parents[2] / "robots" / "ypp3")
YPP = chain_of_robot(YPP3)
POSTURE = np.array([0.2, 0.5, -0.9])
#: Six periods of 2 s instead of 10 s.
QUICK = {"line_spacing_Hz": 0.5, "band_Hz": [0.5, 120]}


def made(robot: Robot, joint: str, q: np.ndarray, lock: str = "dob") -> Setup:
    return prepare(chain_of_robot(robot), robot, joint, q, lock=lock, rng=np.random.default_rng(0))


# margins --------------------------------------------------------------------------------------------------------------


def growth(robot: Robot, setup: Setup, scaled: int, factor: float) -> float:
    """Of the loop in which motor `scaled` gives `factor` times the torque that its servo asks for."""
    chain = chain_of_robot(robot)
    plant = build_plant(chain, [robot.drive(name) for name in chain.names], robot.gravity, setup.posture)
    A, B, C = linearise(plant).sampled(1e-3)
    B = B.copy()
    B[:, scaled] *= factor
    return close_loop(A, B, C, setup.servos, 1e-3).growth


@pytest.mark.parametrize("joint", ["joint1", "joint3"])
def test_at_its_gain_margins_a_loop_begins_to_grow(joint: str) -> None:
    setup = made(YPP3, joint, POSTURE)
    for bound, inside, outside in ((setup.margins.gain_up, 0.99, 1.01), (setup.margins.gain_down, 1.01, 0.99)):
        assert max(growth(YPP3, setup, motor, bound * inside) for motor in range(3)) < 0
        assert max(growth(YPP3, setup, motor, bound * outside) for motor in range(3)) > 0


def test_margins_of_a_double_integrator_with_pd() -> None:
    """L = (kd s + kp)/(J s^2), sampled fast: |L| = 1 and its phase by hand; no gain makes it unstable but by the sampling."""
    J, w, damping, Ts = 1e-4, 2 * np.pi * 5, 0.7, 1e-5
    A, B, C = np.array([[1, Ts], [0, 1]]), np.array([[Ts**2 / 2], [Ts]]) / J, np.array([[1.0, 0.0]])
    found = margins(close_loop(A, B, C, [Servo(kp=J * w**2, kd=2 * damping * J * w)], Ts))
    squares = w**2 * (2 * damping**2 + np.sqrt(4 * damping**4 + 1))  # of the crossover
    phase = np.degrees(np.arctan2(2 * damping * np.sqrt(squares), w))
    assert found.phase == pytest.approx(phase, abs=0.2)  # half a sample and half a difference turn it by 0.06 deg
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


@pytest.mark.parametrize(
    "vendor", ["ur5", "panda", pytest.param("xarm7", marks=pytest.mark.bench)], indirect=True
)  # seven joints once
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


def test_a_joint_beyond_the_sampling_rate_is_told_of(tmp_path: Path) -> None:
    robot = write_robot("xarm7", tmp_path, **QUICK)
    setup = made(robot, "joint7", np.array(BENT["xarm7"]))
    assert "too high for 1000 samples a second: J_ii is not seen here without sample_rate_Hz >=" in setup.note
    assert setup.excitation.lines[-1] * 0.5 <= 120


def test_the_anti_resonance_is_that_of_one_spring_where_the_others_are_rigid() -> None:
    """sqrt(K/J_33)/(2 pi), J_33 by hand; with flexible neighbours the mode that tells most of J_33 lies elsewhere."""
    assert made(YPP3, "joint3", POSTURE, lock="rigid").f_AR == pytest.approx(np.sqrt(4500 / 0.0466) / (2 * np.pi))
    assert made(YPP3, "joint3", POSTURE).f_AR != pytest.approx(np.sqrt(4500 / 0.0466) / (2 * np.pi), rel=0.1)


def test_slow_arms_get_more_periods() -> None:
    short = replace(YPP3, experiment=replace(YPP3.experiment, f0=2.0, band=(2.0, 120.0), periods=3))
    setup = made(short, "joint1", POSTURE)
    assert setup.settle > 3 and setup.periods == setup.settle + 3


def test_the_summary_tells_the_worst_of_all_records() -> None:
    setups = [made(YPP3, joint, POSTURE) for joint in YPP.names]
    near = Margins(0.9, 1.2, 5.0, 0.01)
    lines = summary(YPP, [*setups, replace(setups[1], margins=near, held=3.0, note="odd")])
    assert "keeps 0.01 or more from -1" in lines[0] and "0.90 and 1.20, worst phase margin 5 deg" in lines[0]
    assert "joint 'joint2'" in lines[0] and "3.00 of the excited" in lines[1] and lines[-1].endswith(": odd")
    assert all("\n" not in line for line in lines)
