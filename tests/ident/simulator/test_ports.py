"""Laws as forces over a step, against the differential equation that they are."""

from __future__ import annotations

from math import exp, tanh

import pytest
from scipy.integrate import solve_ivp

from ident.effects.motion import State
from ident.simulator.ports import Force, Port, torques

#: A step [s], what its port is moved by a torque [1/(kg m2)], and what accelerates it besides [rad/s2] and how that grows [rad/s3].
H, W, A, MORE = 2.5e-4, 2e3, -300.0, 4e4


def friction(creep: float) -> Force:
    return lambda at: -0.5 * tanh(at.omega / creep)


def stribeck(at: State) -> float:
    return -(0.2 + 0.6 * exp(-((at.omega / 0.05) ** 2))) * tanh(at.omega / 2e-3)


def damper(at: State) -> float:
    return -2.0 * at.omega


def one_way(at: State) -> float:
    return -3.0 * max(at.omega, 0.0)


@pytest.mark.parametrize("v", [0.0, 0.02, -0.02, 0.3, 3.0])
@pytest.mark.parametrize(
    "law",
    [friction(1e-3), friction(0.05), stribeck, damper, one_way],
    ids=["stiff", "soft", "falling", "damper", "one way"],
)
def test_velocity_and_travel_at_the_end_of_a_step_are_those_of_the_equation(law: Force, v: float) -> None:
    asked = []

    def counted(at: State) -> float:
        asked.append(at.omega)
        return law(at)

    state = State(0.0, v, 0.0, 0.0, v, 0.0, 0.0, 0.0, 1.0, 1.0)
    port = Port(state, "omega", (counted,), ((0, 1.0),), ((0, 1.0),), more=MORE)
    torques([port], [v], [A], [[W]], H)

    def motion(t: float, y: list[float]) -> list[float]:
        state.omega = y[1]
        return [y[1], A + MORE * t + W * law(state)]

    true = solve_ivp(motion, (0.0, H), [0.0, v], method="LSODA", rtol=1e-10, atol=1e-14, max_step=H / 200).y[:, -1]
    rate = v + H * (A + 0.5 * MORE * H + W * port.F)
    travel = H * v + H**2 * (0.5 * (A + W * port.F) + MORE * H / 6.0) + port.ahead
    own = H * W * max(abs(law(state)), abs(port.F))
    assert rate == pytest.approx(true[1], abs=5e-4 * own + 1e-9)
    assert travel == pytest.approx(true[0], abs=2e-3 * H * own + 1e-12)
    assert len(asked) < 200


def test_a_law_that_drives_is_followed_however_it_grows() -> None:
    state = State(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0)
    steep = Port(state, "omega", (lambda at: tanh(at.omega / 1e-4),), ((0, 1.0),), ((0, 1.0),))
    torques([steep], [0.0], [1e-3], [[1e4]], 1.0)
    assert steep.F == pytest.approx(1.0, abs=1e-6)
