"""The arm as MuJoCo simulates it: rigid links, and per joint a rotor, a gear and a spring (equations (7), (8) of the paper).

Joint i is two coaxial joints of one body: the motor joint turns by theta_i/N_i and carries rotor inertia N^2 J_m and
damping N^2 D; the spring joint turns by the rest, q_i - theta_i/N_i, against K and D_spring. Their sum is the link angle.
No massless body, no constraint: the mass matrix is exactly that of (7) and (8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from ident.errors import ExperimentError
from ident.simulator import rk4
from symgen.chain import REVOLUTE, Chain, Inertia, skew
from symgen.robot import Drive

Array = NDArray[np.float64]

# MuJoCo would write MUJOCO_LOG.TXT into the directory it is called from; whoever simulates looks at the state instead.
mujoco.set_mju_user_warning(lambda message: None)

INTEGRATORS = ("RK4", "implicitfast", "implicit", "Euler")

_DIFFERENCE = 1e-4  # rad or m: gravity is a trigonometric polynomial, so a central difference is good to about 1e-8
_MASSLESS = 1e-12  # least to largest eigenvalue of J(q): below, rounding decides how the link accelerates


@dataclass(frozen=True, eq=False)
class Plant:
    """An arm at rest at `posture` [n, rad], ready to simulate.

    `live` are the joints (from 0) that can move, base to tip; the others are frozen into the bodies. `rest` [n, rad] and
    `preload` [n, N m] are motor angle and motor torque of every joint at rest, `qpos` the state [2 x live] of MuJoCo:
    motor and spring joint by turns. The controls of `model` are the motor torques of the live joints, motor side.
    """

    model: mujoco.MjModel
    drives: tuple[Drive, ...]
    posture: Array
    live: tuple[int, ...]
    rest: Array
    preload: Array
    qpos: Array

    def data(self) -> mujoco.MjData:
        """Fresh simulation data in the static equilibrium."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.qpos
        data.ctrl[:] = self.preload[list(self.live)]
        mujoco.mj_forward(self.model, data)
        return data


@dataclass(frozen=True, eq=False)
class Linear:
    """The plant for small motions about rest: M a + D v + K x = S tau, x = (theta/N [m], q [m]) of the m live joints,
    joint side [kg m2, N m s/rad, N m/rad]; `K` includes gravity. `N` [m] gear ratios; tau [m, N m] motor side."""

    M: Array
    D: Array
    K: Array
    N: Array

    @property
    def link_inertia(self) -> Array:
        """J(q) of the live joints [m, m, kg m2]."""
        m = len(self.N)
        return self.M[m:, m:]

    def gravity_stiffness(self, stiffness: ArrayLike) -> Array:
        """dG/dq of the live joints [m, m, N m/rad], given the spring `stiffness` [m, N m/rad]."""
        m = len(self.N)
        return self.K[m:, m:] - np.diag(np.asarray(stiffness, dtype=float))

    def modes(self) -> Array:
        """Undamped frequencies [2 m, Hz], motors free, ascending; those of unstable or free motion count as 0."""
        squares = np.linalg.eigvals(np.linalg.solve(self.M, self.K)).real
        return np.sort(np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi))

    def generator(self) -> Array:
        """[5m, 5m] whose exponential, times t, takes (x, dx/dt, tau) to where tau, held, brings it after t [s]."""
        m = len(self.N)
        G = np.zeros((5 * m, 5 * m))
        G[: 2 * m, 2 * m : 4 * m] = np.eye(2 * m)
        force = np.hstack([-self.K, -self.D, np.vstack([np.diag(self.N), np.zeros((m, m))])])
        G[2 * m : 4 * m] = np.linalg.solve(self.M, force)
        return G

    def sampled(self, Ts: float) -> tuple[Array, Array, Array]:
        """Exact zero-order hold at Ts [s]: A [4m, 4m], B [4m, m], C [m, 4m] of x+ = A x + B tau, theta = C x."""
        m = len(self.N)
        step = expm(self.generator() * Ts)
        return step[: 4 * m, : 4 * m], step[: 4 * m, 4 * m :], np.hstack([np.diag(self.N), np.zeros((m, 3 * m))])

    def rk4_steps(self, Ts: float, top: float) -> int:
        """Steps of RK4 a sample of Ts [s] for motion up to `top` [Hz], see `rk4.steps_needed`."""
        return rk4.steps_needed(self.generator(), 4 * len(self.N), Ts, top)

    def rk4_defect(self, Ts: float, steps: int) -> Array:
        """[4m, 5m]: what so many of them lack, (x, dx/dt, tau) -> (x, dx/dt), see `rk4.defect`."""
        return rk4.defect(self.generator(), 4 * len(self.N), Ts, steps)


def build_plant(
    chain: Chain,
    drives: Sequence[Drive],
    gravity: ArrayLike,
    posture: ArrayLike,
    *,
    free: int | None = None,
    step: float = 2.5e-4,
    integrator: str = "RK4",
) -> Plant:
    """Returns the plant at rest with link angles exactly at `posture` [n, rad or m], motors carrying the load.

    `drives` [n] in the order of the chain's joints; `gravity` [3, m/s2] in the base frame; `step` [s]. With `free` (a
    joint, from 0) only that joint moves and the others are rigid: the paper's simulation. The motor at rest reads
    N (q + g/K) and needs g/N, with g(q) [n, N m] the gravity forces that MuJoCo itself finds.
    ExperimentError: a drive that does not fit its joint, an unknown integrator.
    """
    if integrator not in INTEGRATORS:
        raise ExperimentError(f"integrator = {integrator!r}; expected one of {', '.join(INTEGRATORS)}")
    q = np.array(posture, dtype=float)
    drives = tuple(drives)
    for joint, drive in zip(chain.joints, drives, strict=True):
        if drive.linear != (joint.type != REVOLUTE):
            kind = "linear" if drive.linear else "rotary"
            raise ExperimentError(f"joint {joint.name!r} is {joint.type}, but robot.toml gives it a {kind} drive")
    everything = tuple(range(chain.n))
    live = everything if free is None else (free,)
    model = _compile(chain, drives, gravity, q, live, step, integrator)
    whole = model if free is None else _compile(chain, drives, gravity, q, everything, step, integrator)
    force = _gravity_forces(whole, q[None])[0]
    N, K = (np.array([getattr(drive, name) for drive in drives]) for name in ("N", "K"))
    at_rest = np.stack([q + force / K, -force / K], axis=1)[list(live)].ravel()
    return Plant(model, drives, q, live, N * (q + force / K), force / N, at_rest)


def linearise(plant: Plant) -> Linear:
    """Returns the plant's linear model about rest: the mass matrix of MuJoCo and the slope of its gravity forces.

    ExperimentError where a joint moves no inertia.
    """
    model, data, m = plant.model, plant.data(), len(plant.live)
    mass = np.zeros((model.nv, model.nv))
    for column, unit in zip(mass, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    J = mass[1::2, 1::2]
    moments, directions = np.linalg.eigh(J)
    if moments[0] <= _MASSLESS * moments[-1]:
        joint = plant.drives[plant.live[int(np.abs(directions[:, 0]).argmax())]].joint
        raise ExperimentError(f"joint {joint!r} moves nothing: the URDF gives the links behind it no inertia about it")
    drives = [plant.drives[i] for i in plant.live]
    N, J_m, K, D, D_spring = (np.array([getattr(d, k) for d in drives]) for k in ("N", "J_m", "K", "D", "D_spring"))
    q = plant.posture[list(plant.live)]
    away = _DIFFERENCE * np.eye(m)
    slope = _gravity_forces(model, q + away) - _gravity_forces(model, q - away)
    spring, damper, none = np.diag(K), np.diag(D_spring), np.zeros((m, m))
    return Linear(
        M=np.block([[np.diag(N**2 * J_m), none], [none, J]]),
        D=np.block([[np.diag(N**2 * D) + damper, -damper], [-damper, damper]]),
        K=np.block([[spring, -spring], [-spring, spring + slope.T / (2 * _DIFFERENCE)]]),
        N=N,
    )


def gravity_forces(chain: Chain, drives: Sequence[Drive], gravity: ArrayLike, postures: Array) -> Array:
    """Returns the gravity forces [k, n, N m] at link angles `postures` [k, n, rad or m]; the rest as in `build_plant`."""
    return _gravity_forces(build_plant(chain, drives, gravity, postures[0]).model, postures)


def _gravity_forces(model: mujoco.MjModel, q: Array) -> Array:
    """Gravity forces [k, m, N m] on the m live joints at link angles q [k, m, rad]: what holds the arm at rest."""
    data, forces = mujoco.MjData(model), np.empty_like(q)
    for one, force in zip(q, forces, strict=True):
        data.qpos[::2] = one
        mujoco.mj_forward(model, data)
        force[:] = data.qfrc_bias[1::2]
    return forces


def _compile(
    chain: Chain,
    drives: tuple[Drive, ...],
    gravity: ArrayLike,
    q: Array,
    live: tuple[int, ...],
    step: float,
    integrator: str,
) -> mujoco.MjModel:
    return compiled(mjcf(chain, drives, gravity, q, live, step, integrator))


def compiled(root: ET.Element) -> mujoco.MjModel:
    """Returns the model of an arm's MJCF document (see `mjcf`), every body with exactly the inertia the document gives."""
    # Written after compiling because MuJoCo's compiler refuses what real URDFs contain: rods, points, A + B < C in the
    # last digit.
    real = [[element.attrib.pop(key) for key in ("mass", "diaginertia")] for element in root.iter("inertial")]
    for element in root.iter("inertial"):
        element.attrib |= {"mass": "1", "diaginertia": "1 1 1"}
    # a state that has blown up must stay visible: autoreset would put the arm back to rest without a word
    flags = {"contact": "disable", "constraint": "disable", "sensor": "disable", "autoreset": "disable"}
    ET.SubElement(next(root.iter("option")), "flag", flags)
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    model.body_mass[1:] = [float(mass) for mass, _ in real]
    model.body_inertia[1:] = [np.array(moments.split(), dtype=float) for _, moments in real]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def mjcf(
    chain: Chain,
    drives: Sequence[Drive],
    gravity: ArrayLike,
    q: Array,
    live: Sequence[int],
    step: float,
    integrator: str,
) -> ET.Element:
    """Returns the arm as an MJCF document: one body a `live` joint (from 0), base to tip, in it the motor joint "motor<i>"
    and the spring joint of (7), (8), the other joints are frozen at q [n, rad or m]."""
    root = ET.Element("mujoco")
    ET.SubElement(root, "compiler", angle="radian")
    ET.SubElement(root, "option", timestep=_text(step), integrator=integrator, gravity=_text(gravity))
    element = ET.SubElement(root, "worldbody")
    motors = ET.SubElement(root, "actuator")
    for i, R, p, inertia in _moving_bodies(chain, q, tuple(live)):
        joint, drive = chain.joints[i], drives[i]
        element = ET.SubElement(element, "body", pos=_text(p), quat=_quaternion(R))
        kind = {"type": "hinge" if joint.type == REVOLUTE else "slide", "axis": _text(joint.axis), "limited": "false"}
        rotor, damping = _text(drive.N**2 * drive.J_m), _text(drive.N**2 * drive.D)
        ET.SubElement(element, "joint", kind, name=f"motor{i}", armature=rotor, damping=damping)
        ET.SubElement(element, "joint", kind, stiffness=_text(drive.K), damping=_text(drive.D_spring))
        ET.SubElement(motors, "motor", joint=f"motor{i}", gear=_text(drive.N))
        moments, axes = np.linalg.eigh(inertia.I)
        axes[:, 2] *= np.linalg.det(axes)  # right-handed
        ET.SubElement(
            element, "inertial", pos=_text(inertia.com), quat=_quaternion(axes), mass=_text(inertia.mass),
            diaginertia=_text(moments),
        )  # fmt: skip
    return root


def _moving_bodies(chain: Chain, q: Array, live: tuple[int, ...]) -> list[tuple[int, Array, Array, Inertia]]:
    """(joint, R, p, body) of every live joint: its frame in that of the live joint before, and what it carries up to the
    next one, with the joints between frozen at q."""
    bodies: list[tuple[int, Array, Array, Inertia]] = []
    R, p = np.eye(3), np.zeros(3)
    for i, joint in enumerate(chain.joints):
        R, p = R @ joint.R, p + R @ joint.p
        if i in live:
            bodies.append((i, R, p, joint.inertia))
            R, p = np.eye(3), np.zeros(3)
            continue
        if joint.type == REVOLUTE:
            R = R @ expm(skew(joint.axis) * q[i])
        else:
            p = p + R @ joint.axis * q[i]
        if bodies:
            bodies[-1] = (*bodies[-1][:3], bodies[-1][3] + joint.inertia.moved(R, p))
    return bodies


def _quaternion(R: Array) -> str:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R).ravel())
    return _text(quaternion)


def _text(values: ArrayLike) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values, dtype=float).ravel())
