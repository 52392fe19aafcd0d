"""The lock as it runs is the lock as it is analysed, and the analysis tells stable from unstable."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.signal import cont2discrete

from ident.errors import ExperimentError
from ident.simulator.dob import (
    GRAVITY_ERROR,
    GRAVITY_MARGIN,
    Servo,
    check_stable,
    close_loop,
    controller,
    hold_servo,
    lock_servo,
)

TS = 1e-3
EPS = np.finfo(float).eps


def two_joint_arm() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sampled plant of two coupled flexible joints, gear ratios 100 and -80, discretised by scipy."""
    J, K = np.array([[0.7, 0.2], [0.2, 0.12]]), np.diag([4500.0, 3000.0])
    B, N, d = np.diag([0.4, 0.1]), np.diag([100.0, -80.0]), np.diag([0.3, 0.2, 1.0, 0.5])
    M = np.block([[B, np.zeros((2, 2))], [np.zeros((2, 2)), J]])
    S = np.block([[K, -K], [-K, K]])
    A = np.block([[np.zeros((4, 4)), np.eye(4)], [-np.linalg.solve(M, S), -np.linalg.solve(M, d)]])
    inputs = np.vstack([np.zeros((4, 2)), np.linalg.solve(M, np.vstack([N, np.zeros((2, 2))]))])
    C = np.hstack([N, np.zeros((2, 6))])
    Ad, Bd, *_ = cont2discrete((A, inputs, C, np.zeros((2, 2))), TS)
    return Ad, Bd, C


SERVOS = (hold_servo(100.0, 1.1, 20.0), lock_servo(0.1 / 80**2, 5.0, 30.0))


def test_controller_in_the_loop_moves_as_the_closed_loop_matrix_says() -> None:
    A, B, C = two_joint_arm()
    loop = close_loop(A, B, C, SERVOS, TS)
    rest, preload = [3.0, -7.0], [0.2, -0.1]
    command = controller(SERVOS, rest, preload, TS)
    r = np.random.default_rng(0).standard_normal((2000, 2))
    x, state = np.zeros(8), np.zeros(len(loop.A))
    torque, predicted = np.zeros((2, *r.shape))
    for k in range(len(r)):
        torque[k] = np.array(command((C @ x + rest).tolist())) - preload
        predicted[k] = loop.U @ state
        x = A @ x + B @ (torque[k] + r[k])
        state = loop.A @ state + loop.B @ r[k]
    # 2000 samples; rest angles of 7 rad cost digits in the difference quotient, 7 eps / Ts in the velocity
    assert np.abs(torque - predicted).max() <= 1e-9 * np.abs(predicted).max()
    assert np.abs(x - state[:8]).max() <= 1e-9 * np.abs(x).max()


def test_controller_starts_with_the_preload() -> None:
    assert controller(SERVOS, [3.0, -7.0], [0.2, -0.1], TS)([3.0, -7.0]) == [0.2, -0.1]


def test_response_is_that_of_the_simulated_steady_state() -> None:
    loop = close_loop(*two_joint_arm(), SERVOS, TS)
    period, lines = 500, np.array([7])  # 14 Hz, near the first mode
    expected = loop.response(lines / (period * TS), 0)[0]
    drive = np.cos(2 * np.pi * lines[0] * np.arange(period) / period)
    state, states = np.zeros(len(loop.A)), np.zeros((period, len(loop.A)))
    for k in range(40 * period):
        states[k % period] = state
        state = loop.A @ state + loop.B[:, 0] * drive[k % period]
    measured = np.fft.rfft(states, axis=0)[lines[0]] / (period / 2)
    decayed = np.exp(loop.growth * 39 * period * TS)
    assert np.abs(measured - expected).max() <= (10 * decayed + 1e-9) * np.abs(expected).max()


def test_observer_carries_a_constant_load_without_offset() -> None:
    A, B, C = two_joint_arm()
    locks = [lock_servo(0.4 / 100**2, 5.0, 30.0), lock_servo(0.1 / 80**2, 5.0, 30.0)]
    loop = close_loop(A, B, C, locks, TS)
    load = np.array([0.05, -0.02])
    settled = np.linalg.solve(np.eye(len(loop.A)) - loop.A, loop.B @ load)
    plain = [replace(servo, dob=0.0) for servo in locks]
    without = close_loop(A, B, C, plain, TS)
    offset = np.linalg.solve(np.eye(len(without.A)) - without.A, without.B @ load)
    assert np.abs(C @ settled[:8]).max() <= 1e-6 * np.abs(C @ offset[:8]).max()
    assert loop.U @ settled == pytest.approx(-load, rel=1e-6)
    assert (C @ offset[:8]) == pytest.approx(load / [servo.kp for servo in plain], rel=1e-6)


def test_growth_is_the_rate_at_which_the_loop_decays() -> None:
    loop = close_loop(*two_joint_arm(), SERVOS, TS)
    start = np.random.default_rng(1).standard_normal(len(loop.A))
    late = [np.linalg.norm(np.linalg.matrix_power(loop.A, k) @ start) for k in range(9000, 18001, 1000)]
    slope = np.polyfit(np.arange(10.0), np.log(late), 1)[0]  # per second, as a step is 1000 samples of 1 ms
    assert loop.growth < 0
    assert slope == pytest.approx(loop.growth, rel=0.02)  # an oscillating mode: the norm ripples about its decay


def test_servos_follow_their_definition() -> None:
    lock = lock_servo(4e-5, 5.0, 30.0)
    assert lock.kp == pytest.approx(4e-5 * (2 * np.pi * 5) ** 2)
    assert (lock.J, lock.dob) == (4e-5, pytest.approx(2 * np.pi * 30))
    heavy, light = hold_servo(-100.0, 0.7, -21.0), hold_servo(100.0, 0.7, 0.0)
    assert heavy.kp * 100**2 == pytest.approx(GRAVITY_MARGIN * 21.0)
    assert 0.3 < np.sqrt(light.kp * 100**2 / 0.7) / (2 * np.pi) < 1.0  # Hz: well below any first mode, and it settles
    assert heavy.kd > 0 and heavy.dob == 0.0


def test_a_preload_that_is_not_known_well_moves_the_joint_little() -> None:
    """Where gravity is largest its stiffness is nothing, and the preload all that holds the link."""
    k = hold_servo(100.0, 0.7, 0.0, gravity=-20.0, sags=0.04).kp * 100**2
    assert GRAVITY_ERROR * 20.0 / k == pytest.approx(0.04)


def test_a_link_that_falls_is_held_through_its_spring() -> None:
    """What the link feels of hold k and spring K is k K/(k + K); a hanging link needs neither of them."""
    K, falls = 100.0, -21.0
    k = hold_servo(100.0, 0.7, falls, spring=K).kp * 100**2
    assert k * K / (k + K) == pytest.approx(GRAVITY_MARGIN * 21.0)
    assert hold_servo(100.0, 0.7, 21.0, spring=10.0).kp * 100**2 == pytest.approx(GRAVITY_MARGIN * 21.0)
    with pytest.raises(ExperimentError, match=r"its spring of 63 N m/rad .* pushes away with 21 N m/rad.*; a stiffer"):
        hold_servo(100.0, 0.7, falls, spring=63.0)


@pytest.mark.parametrize("ratio", [5.0, 10.0, 14.0, 25.0])
def test_routh_bound_of_the_lock(ratio: float) -> None:
    """A rigid load of `ratio` times the rotor: stable up to 16 times, as the constant's comment says."""
    J_m = 1e-4
    A, B, *_ = cont2discrete(
        (np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1 / (J_m * (1 + ratio))]]), np.eye(2), 0), 1e-5
    )
    loop = close_loop(A, B, np.array([[1.0, 0.0]]), [lock_servo(J_m, 5.0, 30.0)], 1e-5)
    w, g = 2 * np.pi * 5, 2 * np.pi * 30
    bound = (2 * w + g) * (w + 2 * g) / (g * w) - 1
    assert (loop.growth < 0) == (ratio < bound)


def test_unstable_lock_is_refused_by_name() -> None:
    A, B, C = two_joint_arm()
    assert check_stable(close_loop(A, B, C, SERVOS, TS), "joint 'j'") < 0
    wild = [lock_servo(servo_J, 60.0, 60.0) for servo_J in (0.4 / 100**2, 0.1 / 80**2)]
    with pytest.raises(ExperimentError, match=r"joint 'j': .* unstable \(growth rate \+"):
        check_stable(close_loop(A, B, C, wild, TS), "joint 'j'")


def test_a_servo_without_observer_adds_no_slow_mode() -> None:
    A, B, C = two_joint_arm()
    for kp, kd in product((1e-2, 1e-3), (1e-3, 1e-4)):
        loop = close_loop(A, B, C, [Servo(kp, kd)] * 2, TS)
        assert np.sum(np.abs(np.linalg.eigvals(loop.A)) > 1 - 1e-9) == 0
