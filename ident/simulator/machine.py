"""How an arm with effects moves from one sample to the next.

A law acts as a force held over a step of the integrator at its value half-way: second order. A friction that stops or turns a
joint is found with the motion that it stops, followed within the step: a dry contact neither creeps nor rings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import ceil, floor
from operator import mul

import mujoco
import numpy as np
from numpy.typing import NDArray

from ident.effects.motion import State
from ident.simulator import rk4
from ident.simulator.delay import Line
from ident.simulator.injection import Injected, Live, mass_matrix
from ident.simulator.ports import Port, torques

Array = NDArray[np.float64]

#: MuJoCo's stage up to which nothing is found again that forces do not change.
_MOVED = int(mujoco.mjtStage.mjSTAGE_VEL)

#: Least steps a sample where forces of effects are held over a step, or torques and angles change or are read within samples.
STEPS = 4
#: What a torque at one port does at another is brought up to date every so many samples: at swings of 0.01 rad J(q) hardly moves.
REFRESH = 20


def steps_for(arm: Injected, Ts: float, top: float) -> int:
    """Steps of the integrator a sample of `Ts` [s] that follow the arm, up to `top` [Hz]; at least `STEPS` where it takes these."""
    within = arm.laws or arm.driven or any(joint.late or joint.path.remembers for joint in arm.live)
    return max(STEPS if within else 1, rk4.steps_needed(arm.generator(), 2 * arm.plant.model.nv, Ts, top))


class Machine:
    """An arm with effects in motion, from rest: `angles` and `advance` in turns, once a sample of `Ts` [s].

    `steps` of the integrator a sample. Angles that are recorded older or newer than their time stamp are read on the way, see
    `recorded`.
    """

    def __init__(self, arm: Injected, Ts: float, steps: int) -> None:
        self._arm, self._live, self._steps, self._h = arm, arm.live, steps, Ts / steps
        model = self._model = arm.plant.model
        model.opt.timestep = self._h
        data = self._data = mujoco.MjData(model)
        self._x, self._v, self._a = data.qpos, data.qvel, data.qacc
        self._u, self._applied = data.ctrl, data.qfrc_applied
        self._x[:] = arm.plant.qpos
        preload = [float(arm.plant.preload[joint.index]) for joint in arm.live]
        self._lines = [
            (k, Line(joint.path, preload[k], steps, self._h))
            for k, joint in enumerate(arm.live)
            if joint.path.remembers
        ]
        self._gains = [joint.path.gain for joint in arm.live]
        self._ctrl = np.array([u * joint.path.gain for u, joint in zip(preload, arm.live, strict=True)])
        self._u[:] = self._ctrl
        mujoco.mj_forward(model, data)
        self._of_rk4 = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        self._lacking = rk4.defect(arm.generator(), 2 * model.nv, Ts, steps) if self._of_rk4 else None
        self._states = [replace(state) for state in arm.states]
        self._rest = [state.theta for state in arm.states]
        self._driven, self._driving = arm.driven, np.zeros(model.nv)  # and their forces of the last step
        self._ports, self._memories = _ports(arm, self._states, self._h)
        acting = {law.joint for law in arm.laws}
        self._moving = [(k, joint) for k, joint in enumerate(arm.live) if self._driven or joint.index in acting]
        self._W: list[list[float]] = []
        self._by_motors: list[list[float]] = []
        self._moved_by_ports: list[Array] = []
        self._moved_by_motors: list[Array] = []
        self._pulls: list[float | None] = [None] * len(self._ports)
        self._away = np.zeros(2 * model.nv + len(arm.live))
        self._done = 0
        self._last: list[float] = preload
        self._moments = [(k, *_moment(joint.late, Ts, steps)) for k, joint in enumerate(arm.live) if joint.late]
        self._late: dict[int, list[float]] = {k: [] for k, *_ in self._moments}

    def angles(self) -> list[float]:
        """What the encoders of the live joints read now [m, rad joint side], not yet rounded to counts."""
        x = self._x.tolist()
        return [joint.read(joint.drive.N * x[joint.motor]) / joint.drive.N for joint in self._live]

    def links(self) -> list[float]:
        """The angles of the links of the live joints [m, rad] now."""
        x = self._x.tolist()
        return [x[joint.motor] + x[joint.spring] for joint in self._live]

    def recorded(self, theta: Array, resolution: Array) -> Array:
        """What is recorded [T, m] of the angles that the controller read [T, m, rad motor side], rounded to `resolution` [m]."""
        theta = np.array(theta)
        for k, rows, _, _ in self._moments:
            for _ in range(
                -rows
            ):  # the record ends before the last angles of it are read: the torque is held for those
                self.advance(self._last, [0.0] * len(self._last))
            read = resolution[k] * np.round(np.array(self._late[k]) / resolution[k])
            theta[max(rows, 0) :, k] = read[max(-rows, 0) :][: len(theta) - max(rows, 0)]
            theta[: max(rows, 0), k] = theta[0, k]
        return theta

    def advance(self, command: Sequence[float], disturbance: Sequence[float]) -> None:
        """One sample on, with the commanded torques [m, N m], and others that act besides."""
        x, v, u, nv = self._x, self._v, self._u, self._model.nv
        self._last = list(command)
        for k, line in self._lines:
            line.push(command[k])
        direct = [gain * a + b for gain, a, b in zip(self._gains, command, disturbance, strict=True)]
        away = self._away
        np.subtract(x, self._arm.plant.qpos, out=away[:nv])
        away[nv : 2 * nv] = v
        if (self._ports or self._lines) and self._done % REFRESH == 0:
            self._share()
        self._done += 1
        if not self._lines:
            u[:] = direct
            np.subtract(u, self._ctrl, out=away[2 * nv :])
        if not (self._lines or self._ports or self._driven or self._moments):
            mujoco.mj_step(self._model, self._data, self._steps)
        else:
            mean = [0.0] * len(direct)
            for j in range(self._steps):
                short: list[tuple[int, float]] = []
                if self._lines:
                    for k, line in self._lines:
                        torque, missing = line.over(j)
                        direct[k] = torque + disturbance[k]
                        if missing:
                            short.append((k, missing))
                    u[:] = direct
                    mean = [a + b for a, b in zip(mean, direct, strict=True)]
                self._step(j)
                for k, missing in short:
                    x += missing * self._moved_by_motors[k]
            if self._lines:
                away[2 * nv :] = np.array(mean) / self._steps - self._ctrl
        if self._lacking is not None:
            lacking = self._lacking @ away
            x += lacking[:nv]
            v += lacking[nv:]

    def _step(self, j: int) -> None:
        before = [self._motor(k) for k, _, _, step in self._moments if step == j] if self._moments else None
        if self._ports or self._driven:
            self._push()
            self._move()
        else:
            mujoco.mj_step(self._model, self._data)
        for k, port in enumerate(self._ports):
            if port.ahead:
                self._x += (port.ahead / self._W[k][k]) * self._moved_by_ports[k]
        if before:
            here = [moment for moment in self._moments if moment[3] == j]
            for (k, _, part, _), (x, v) in zip(here, before, strict=True):
                self._late[k].append(self._live[k].read(_between(x, v, *self._motor(k), part, self._h)))

    def _motor(self, k: int) -> tuple[float, float]:
        joint = self._live[k]
        N = joint.drive.N
        return N * float(self._x[joint.motor]), N * float(self._v[joint.motor])

    def _push(self) -> None:
        """Puts the forces of all laws for the next step into the simulation."""
        self._applied[:] = self._driving
        mujoco.mj_forward(self._model, self._data)
        x, v, a, u = self._x.tolist(), self._v.tolist(), self._a.tolist(), self._u.tolist()
        for joint, remember in self._memories:
            state = self._states[joint.index]
            state.theta, state.q = joint.drive.N * x[joint.motor], x[joint.motor] + x[joint.spring]
            state.deflection = -x[joint.spring]
            remember(state)
        self._half_way(x, v, a, u)
        applied = [0.0] * len(v)
        if self._driven:
            at = {joint.index: joint for joint in self._live}
            for effect in self._driven:
                for port, index, F in effect.driven(self._states, self._rest):
                    for dof, factor in _push_of(at[index], port) if index in at else ():
                        applied[dof] += factor * F
            self._applied[:] = self._driving = np.array(applied)
            if self._ports:
                mujoco.mj_forwardSkip(self._model, self._data, _MOVED, 1)
                a = self._a.tolist()
        if self._ports:
            self._foresee(a, u)
            torques(self._ports, v, a, self._W, self._h)
            for port_ in self._ports:
                for dof, factor in port_.push:
                    applied[dof] += factor * port_.F
        self._applied[:] = applied

    def _move(self) -> None:
        """One step of the integrator; what follows from positions and velocities alone `_push` has found already."""
        if not self._of_rk4:
            mujoco.mj_step(self._model, self._data)
            return
        mujoco.mj_forwardSkip(self._model, self._data, _MOVED, 1)
        mujoco.mj_RungeKutta(self._model, self._data, 4)

    def _foresee(self, a: Sequence[float], u: Sequence[float]) -> None:
        """Tells each port how its acceleration without its torque grows, as it has grown since the last step; what the motors' own torques do
        jumps where these are held, and is left out."""
        for k, port in enumerate(self._ports):
            pull = port.velocity(a) - sum(map(mul, self._by_motors[k], u))
            port.more = 0.0 if self._pulls[k] is None else (pull - self._pulls[k]) / self._h
            self._pulls[k] = pull

    def _half_way(self, x: list[float], v: list[float], a: list[float], u: list[float]) -> None:
        """Puts the motion in the middle of the next step into the states, as far as it is foreseen without the laws."""
        h = self._h
        for k, joint in self._moving:
            state, i, j, N = self._states[joint.index], joint.motor, joint.spring, joint.drive.N
            motor = x[i] + 0.5 * h * v[i] + 0.125 * h * h * a[i]
            spring = x[j] + 0.5 * h * v[j] + 0.125 * h * h * a[j]
            w, s = v[i] + 0.5 * h * a[i], v[j] + 0.5 * h * a[j]
            state.theta, state.omega, state.tau = N * motor, N * w, u[k]
            state.q, state.q_rate = motor + spring, w + s
            state.deflection, state.deflection_rate = -spring, -s
            state.spring = -joint.drive.K * spring - joint.drive.D_spring * s

    def _share(self) -> None:
        """Brings up to date what a torque at each port, and at each motor, does to all velocities, and to that at every port."""
        mass = mass_matrix(self._model, self._data)
        pushes, motors = np.zeros((len(mass), len(self._ports))), np.zeros((len(mass), len(self._live)))
        rates = np.zeros((len(self._ports), len(mass)))
        for k, port in enumerate(self._ports):
            for dof, factor in port.push:
                pushes[dof, k] = factor
            for dof, factor in port.rate:
                rates[k, dof] = factor
        for k, joint in enumerate(self._live):
            motors[joint.motor, k] = joint.drive.N
        by_ports, by_motors = np.linalg.solve(mass, pushes), np.linalg.solve(mass, motors)
        self._W, self._by_motors = (rates @ by_ports).tolist(), (rates @ by_motors).tolist()
        self._moved_by_ports, self._moved_by_motors = list(by_ports.T), list(by_motors.T)


def _ports(
    arm: Injected, states: Sequence[State], step: float
) -> tuple[list[Port], list[tuple[Live, Callable[[State], None]]]]:
    """The ports at which laws act, and what has to be remembered after each step."""
    at = {joint.index: joint for joint in arm.live}
    ports: dict[tuple[int, str], Port] = {}
    memories = []
    for law in arm.laws:
        assert law.joint is not None
        joint = at[law.joint]
        force, remember = law.start(step)
        if remember:
            memories.append((joint, remember))
        if (law.joint, law.port) not in ports:
            name = {"motor": "omega", "spring": "deflection_rate", "link": "q_rate"}[law.port]
            push, rate = _push_of(joint, law.port), _rate_of(joint, law.port)
            ports[law.joint, law.port] = Port(states[law.joint], name, (), push, rate)
        port = ports[law.joint, law.port]
        port.laws = (*port.laws, force)
        port.linear = (*port.linear, force) if law.linear else port.linear
    return list(ports.values()), memories


def _push_of(joint: Live, port: str) -> tuple[tuple[int, float], ...]:
    """What a torque at a port is in the model's coordinates theta/N and q - theta/N: (degree of freedom, factor)."""
    if port == "motor":
        return ((joint.motor, joint.drive.N),)
    return ((joint.spring, 1.0),) if port == "spring" else ((joint.motor, 1.0), (joint.spring, 1.0))


def _rate_of(joint: Live, port: str) -> tuple[tuple[int, float], ...]:
    return ((joint.spring, -1.0),) if port == "spring" else _push_of(joint, port)


def _moment(late: float, Ts: float, steps: int) -> tuple[int, float, int]:
    """(rows further on, part of the step, step of the sample) at which an angle `late` [s] is read: the sample that begins at
    row k holds the angle of time k Ts + (step + part) h, which is what the row `rows` further on reads."""
    rows = ceil(late / Ts - 1e-9)
    position = max(rows - late / Ts, 0.0) * steps
    step = min(floor(position), steps - 1)
    return rows, position - step, step


def _between(x0: float, v0: float, x1: float, v1: float, part: float, h: float) -> float:
    """The cubic through two states h [s] apart, at `part` of the way."""
    t, u = part, 1.0 - part
    return x0 * u * u * (1 + 2 * t) + x1 * t * t * (1 + 2 * u) + h * t * u * (v0 * u - v1 * t)
