"""The simulated arm with effects in it, and where it rests: the links at their posture, motors carrying what there is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ident.effects.base import Arm, Effect, Law, Path, PortLaw
from ident.effects.declared import Changing, Payload
from ident.effects.motion import State
from ident.effects.structure import AttachedResonator, LockedJointElasticity
from ident.errors import ExperimentError
from ident.simulator.bodies import Bodies
from ident.simulator.plant import Plant, build_plant
from symgen.chain import Chain
from symgen.robot import Drive

Array = NDArray[np.float64]

_DIFFERENCE = 1e-4  # rad or m, as in `ident.simulator.plant`
#: What comes after all else whatever the order it is given in: a load on the link as it is, shares of a drive as it is, a disc on the
#: near part of a link that bends.
_LATER = (Payload, Changing, AttachedResonator)
#: What of a drive has to be positive, and what may be none.
_POSITIVE, _NOT_NEGATIVE = ("J_m", "K"), ("D", "D_spring")
_FAR = 1.0  # rad or m that a spring is wound, beyond which nobody looks for a rest
_ROUNDS = 50  # of the search for the rest: effects that load each other's joints settle in a few


@dataclass(frozen=True)
class Live:
    """A joint that moves: which one (from 0), its two degrees of freedom in the model, its drive, and what effects make of its
    torque (`path`), its reading (`shift` [rad, motor side] and `misread`) and the age `late` [s] of what is recorded."""

    index: int
    motor: int
    spring: int
    drive: Drive
    path: Path
    shift: float
    late: float
    misread: tuple[Effect, ...]

    def read(self, theta: float) -> float:
        """What its encoder reads at the motor angle theta [rad]."""
        return theta - self.shift + sum(effect.misread(theta) for effect in self.misread)


@dataclass(frozen=True, eq=False)
class Injected:
    """An arm at rest with `effects` in it. `plant` is what a controller knows of it: `rest` what the encoders read, `preload`
    what has to be commanded; its `model` has more degrees of freedom where the structure gives. `states` [n] at rest."""

    plant: Plant
    live: tuple[Live, ...]
    effects: tuple[Effect, ...]
    states: tuple[State, ...]

    @property
    def laws(self) -> list[PortLaw]:
        """The laws that act on joints that move."""
        return [
            e for e in self.effects if isinstance(e, PortLaw) and any(e.joint == joint.index for joint in self.live)
        ]

    @property
    def driven(self) -> list[Effect]:
        """The effects that drive joints by the motion of others."""
        rest = [state.theta for state in self.states]
        return [effect for effect in self.effects if effect.driven(self.states, rest)]

    def generator(self) -> Array:
        """[2 nv + m, 2 nv + m] of the arm without its laws, linear about rest: its exponential, times t, takes (positions,
        velocities, motor torques) to where the torques, held, bring them after t [s]."""
        model = self.plant.model
        nv, m = model.nv, len(self.live)
        data = mujoco.MjData(model)
        rows = []
        for x in _DIFFERENCE * np.eye(nv):
            pair = []
            for sign in (1, -1):
                data.qpos[:] = self.plant.qpos + sign * x
                mujoco.mj_forward(model, data)
                pair.append(np.array(data.qfrc_bias))
            rows.append((pair[0] - pair[1]) / (2 * _DIFFERENCE))
        data.qpos[:] = self.plant.qpos
        mujoco.mj_forward(model, data)
        G = np.zeros((2 * nv + m, 2 * nv + m))
        G[:nv, nv : 2 * nv] = np.eye(nv)
        force = np.zeros((nv, 2 * nv + m))
        force[:, :nv] = -np.array(rows).T - np.diag(model.jnt_stiffness)
        force[:, nv : 2 * nv] = -np.diag(model.dof_damping)
        for k, joint in enumerate(self.live):
            force[joint.motor, 2 * nv + k] = joint.drive.N
        G[nv : 2 * nv] = np.linalg.solve(mass_matrix(model, data), force)
        return G


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """The mass matrix [nv, nv] at the state of `data`, which has been stepped or forwarded."""
    mass = np.zeros((model.nv, model.nv))
    for column, unit in zip(mass, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    return mass


def inject(
    chain: Chain,
    drives: Sequence[Drive],
    gravity: ArrayLike,
    posture: ArrayLike,
    effects: Sequence[Effect],
    *,
    record: int = 0,
    free: int | None = None,
    step: float = 2.5e-4,
    integrator: str = "RK4",
) -> Injected:
    """Returns the arm with `effects` at rest where it reads `posture` [n, rad or m]; `record` counts from 0, the rest as in
    `build_plant`. ExperimentError: an effect that this arm can not have, or with which it does not rest."""
    if free is None and any(isinstance(effect, LockedJointElasticity) for effect in effects):
        raise ExperimentError(
            f"effect {LockedJointElasticity.name}: every joint has its elasticity here; expected --lock rigid"
        )
    effects = sorted(effects, key=_in_order)
    declared = np.array(posture, dtype=float)
    arm, q = Arm(chain, tuple(drives), np.asarray(gravity, dtype=float)), declared
    for effect in effects:
        arm, q = effect.arm(arm, record), effect.posture(q)
        _check(effect, arm.drives)
    nominal = build_plant(arm.chain, arm.drives, arm.gravity, q, free=free, step=step, integrator=integrator)
    bodies = Bodies(arm, q, nominal.live, step, integrator)
    for effect in effects:
        effect.structure(bodies)
    model = bodies.model()
    shift = np.array([drive.N for drive in arm.drives]) * (q - declared)
    live = tuple(_live(model, i, arm.drives[i], float(shift[i]), effects) for i in nominal.live)
    states = tuple(
        State(float(theta), 0.0, 0.0, float(at), 0.0, float(theta / d.N - at), 0.0, 0.0, d.N, d.K)
        for theta, at, d in zip(nominal.rest, q, arm.drives, strict=True)
    )
    here = Injected(nominal, live, tuple(effects), states)
    bias = _hang(model, live, q)
    torque = _settle(here, bias)
    qpos = np.zeros(model.nv)
    rest, preload = nominal.rest - shift, np.array(nominal.preload)
    for joint, u in zip(live, torque, strict=True):
        state = states[joint.index]
        qpos[joint.motor], qpos[joint.spring] = state.q + state.deflection, -state.deflection
        rest[joint.index] = joint.read(state.theta)
        preload[joint.index] = u / joint.path.gain
    return replace(here, plant=replace(nominal, model=model, rest=rest, preload=preload, qpos=qpos, posture=q))


def _in_order(effect: Effect) -> tuple[int, str, int, tuple[float, ...]]:
    """What effects are sorted by: the machine is the same in whatever order they are given."""
    later = next((k for k, kind in enumerate(_LATER, 1) if isinstance(effect, kind)), 0)
    return later, effect.name, -1 if effect.joint is None else effect.joint, effect.values


def _check(effect: Effect, drives: Sequence[Drive]) -> None:
    """ExperimentError where an effect has made of a drive what none can be."""
    for drive in drives:
        for name in (*_POSITIVE, *_NOT_NEGATIVE):
            value, least = getattr(drive, name), "> 0" if name in _POSITIVE else ">= 0"
            if value < 0.0 or (name in _POSITIVE and value == 0.0):
                raise ExperimentError(
                    f"effect {effect.name}: {name} of joint {drive.joint!r} would be {value:.3g}; expected {least}"
                )


def _live(model: mujoco.MjModel, i: int, drive: Drive, shift: float, effects: Sequence[Effect]) -> Live:
    mine = [effect for effect in effects if effect.joint in (None, i)]
    path = Path()
    for effect in mine:
        path = path.then(effect.path())
    motor, spring = (int(model.joint(f"{kind}{i}").dofadr[0]) for kind in ("motor", "spring"))
    late = sum(effect.angle_delay() for effect in mine)
    misread = tuple(effect for effect in mine if type(effect).misread is not Effect.misread)
    return Live(i, motor, spring, drive, path, shift, late, misread)


def _hang(model: mujoco.MjModel, live: Sequence[Live], q: Array) -> Array:
    """Gravity forces [nv] with the links at q [n]; the springs that effects added carry theirs there from now on."""
    data = mujoco.MjData(model)
    for joint in live:
        data.qpos[joint.motor] = q[joint.index]
    mujoco.mj_forward(model, data)
    bias = np.array(data.qfrc_bias)
    ours = {dof for joint in live for dof in (joint.motor, joint.spring)}
    for dof in set(range(model.nv)) - ours:
        model.qpos_spring[dof] = bias[dof] / model.jnt_stiffness[dof]
    return bias


def _settle(here: Injected, bias: Array) -> list[float]:
    """Winds the springs of the states as far as they are at rest; returns the torques [m, N m] of the motors."""
    u = [0.0] * len(here.live)
    rest = [state.theta for state in here.states]
    for _ in range(_ROUNDS):
        before = [(joint.index, here.states[joint.index].theta, u[k]) for k, joint in enumerate(here.live)]
        extra: dict[tuple[str, int], float] = {}
        for effect in here.effects:
            for port, index, F in effect.driven(here.states, rest):
                extra[port, index] = extra.get((port, index), 0.0) + F
        for k, joint in enumerate(here.live):
            u[k] = _wind(here, joint, float(bias[joint.spring]), extra)
            rest[joint.index] = here.states[joint.index].theta
        if all(here.states[i].theta == theta and u[k] == old for k, (i, theta, old) in enumerate(before)):
            break
    return u


def _wind(here: Injected, joint: Live, load: float, extra: dict[tuple[str, int], float]) -> float:
    """Winds the spring of one joint until it carries `load` [N m]; returns its motor's torque."""
    i, drive, at = joint.index, joint.drive, here.states[joint.index]

    def total(port: str) -> float:
        mine = [law for law in here.laws if isinstance(law, Law)]  # one with a memory rests without torque
        own = sum(float(law.law(at)) for law in mine if law.joint == i and law.port == port)
        return own + extra.get((port, i), 0.0)

    def excess(x: float) -> float:
        at.deflection, at.theta, at.spring = x, drive.N * (at.q + x), carried
        return drive.K * x + total("spring") - carried

    carried = load - total("link")
    x = _root(excess, carried / drive.K, _FAR)
    if x is None:
        raise ExperimentError(
            f"joint {drive.joint!r} finds no rest with its effects: its spring can not carry {carried:.3g} N m"
        )
    excess(x)
    asked = (load - total("link")) / drive.N

    def lacking(u: float) -> float:
        at.tau = u
        return u + total("motor") - asked

    u = _root(lacking, asked, drive.tau_max + abs(asked))
    if u is None:
        raise ExperimentError(
            f"joint {drive.joint!r} finds no rest with its effects: {asked:.3g} N m are asked of its motor, and no torque up to "
            f"its limit of {drive.tau_max:g} N m leaves them"
        )
    return u


def _root(f: Callable[[float], float], x: float, far: float) -> float | None:
    """The root of f nearest to x, roughly; x itself where f vanishes there. None: not as `far` as that."""
    from scipy.optimize import brentq  # not by every worker: it takes as long as MuJoCo to load

    if f(x) == 0.0:
        return x
    reach = 1e-12 * far + 1e-9 * abs(x)
    while reach < 2.0 * far:
        ends = [f(x - reach), f(x + reach)]
        if ends[0] * ends[1] <= 0.0:
            return float(brentq(f, x - reach, x + reach, xtol=1e-300, rtol=1e-15))
        reach *= 2
    return None
