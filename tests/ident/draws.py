"""Effects drawn at random, of sizes that a campaign can see and that leave an arm an arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from outside import OUTSIDE, OUTSIDE_RANGES

from ident.effects.base import Effect, scale
from ident.effects.catalogue import CATALOGUE, stiffness
from ident.effects.motor import MotorCoupling
from ident.records.campaign import Record
from ident.simulator.bench import simulate
from symgen.chain import Chain
from symgen.robot import Robot

#: Of each parameter the range from which it is drawn, in the unit of `Parameter.relative` at the joint (rms values of a
#: record that excites it). Positive pairs are drawn log-uniformly; a leading "+-" draws the sign; a tuple of whole
#: numbers under "one of" is a choice; what is not here has its first plausible size.
#: Dry friction of a tenth of the rms torque shows at every line, of half of it stops the joint; ripple that outweighs the
#: hold puts the joint into another notch; a tenth of K in series or in parallel moves f_AR by 5 %.
RANGES: dict[str, Mapping[str, tuple[object, ...]]] = {
    "motor-viscous": {"damping": (0.03, 0.3)},
    "motor-coulomb": {"level": (0.05, 0.3)},
    "motor-stribeck": {"level": (0.03, 0.1), "peak": (0.1, 0.3), "speed": (0.2, 0.6)},
    "motor-quadratic-drag": {"drag": (0.03, 0.2)},
    "motor-hysteresis": {"level": (0.05, 0.3), "distance": (0.1, 0.6)},
    "motor-inertia": {"inertia": ("+-", 0.1, 0.4)},
    "torque-ripple": {"amplitude": (0.02, 0.06), "order": ("one of", 1, 2, 3, 4, 6), "phase": ("+-", 0.1, 3.1)},
    "torque-scale": {"error": ("+-", 0.03, 0.15)},
    "torque-offset": {"offset": ("+-", 0.1, 1.0)},
    "torque-lag": {"time": (3e-4, 2e-3)},
    "input-delay": {"time": (3e-4, 2e-3)},
    "motor-coupling": {"ratio": ("+-", 0.03, 0.15), "step": ("one of", 1, 2)},
    "spring-damping": {"damping": (0.5, 4.0)},
    "spring-hardening": {"cubic": (0.03, 0.2)},
    "backlash": {"gap": (0.2, 1.0)},
    "spring-hysteresis": {"level": (0.05, 0.2), "distance": (0.1, 0.6)},
    "spring-relaxation": {"stiffness": (0.03, 0.3), "time": (0.005, 0.2)},
    "transmission-error": {"amplitude": (0.05, 0.3), "order": ("one of", 1, 2, 4), "phase": ("+-", 0.1, 3.1)},
    "link-viscous": {"damping": (0.03, 0.2)},
    "link-coulomb": {"level": (0.03, 0.2)},
    "link-hysteresis": {"level": (0.03, 0.2), "distance": (0.1, 0.6)},
    "load-dependent-friction": {"share": (0.05, 0.3)},
    "cable-stiffness": {"stiffness": (3e-4, 2e-3), "neutral": ("+-", 0.1, 1.0)},
    "payload": {"mass": (0.1, 0.5), "offset": (0.05, 0.2)},
    "inertial-parameters": {"mass": ("+-", 0.05, 0.3), "aside": ("+-", 2e-3, 0.02)},
    "gravity-stiffness": {"share": ("+-", 0.2, 0.6), "tilt_x": ("+-", 0.03, 0.3), "tilt_y": ("+-", 0.03, 0.3)},
    "joint-zero-offset": {"offset": ("+-", 0.03, 0.15)},
    "time-offset": {"time": ("+-", 3e-4, 2e-3)},
    "encoder-eccentricity": {"amplitude": (0.003, 0.03), "order": ("one of", 1, 2), "phase": ("+-", 0.1, 3.1)},
    "locked-joint-elasticity": {"stiffness": (0.5, 2.0), "damping": (5e-5, 2e-3)},
    "base-compliance": {"rock": (5.0, 40.0), "turn": (10.0, 80.0), "own": (40.0, 600.0), "damping": (5e-5, 2e-3)},
    "link-flexibility": {
        "stiffness": (1.0, 6.0),
        "share": (0.4, 0.8),
        "damping": (5e-5, 2e-3),
        "across": ("one of", 0, 1),
    },
    "attached-resonator": {"inertia": (0.03, 0.2), "frequency": (10.0, 80.0), "damping": (5e-5, 2e-3)},
    "drift-over-records": {"records": (2.0, 12.0), "stiffness": ("+-", 0.03, 0.15), "damping": ("+-", 0.1, 0.5)},
    "change-between-records": {
        "stiffness": ("+-", 0.05, 0.2),
        "damping": ("+-", 0.1, 0.5),
        "inertia": ("+-", 0.03, 0.2),
    },
}
#: Ripple of higher orders is so much smaller that it is no steeper: it would outweigh the hold.
STEEP = 3.0
#: All that can be drawn.
KINDS = CATALOGUE | OUTSIDE
#: Seen only by a motor that gives a constant torque; a shift of rest that no line shows.
SILENT = ("torque-offset",)
#: What a gear under load never shows.
UNLOADED = ("backlash", "saturating-mesh")
#: What depends on all that a spring carries, gravity included.
LOADED = ("spring-hardening", "load-dependent-friction")
#: What a rigid lock is needed for.
RIGID = ("locked-joint-elasticity",)


@dataclass(frozen=True)
class Draw:
    """One effect, and what to call it."""

    effect: Effect
    text: str


def draw(
    rng: np.random.Generator,
    name: str,
    joint: int,
    chain: Chain,
    robot: Robot,
    scales: Mapping[str, Mapping[str, float]],
    records: Sequence[int],
) -> Draw:
    """An effect of the catalogue, or outside it, at a joint (from 0) that these `records` (from 1) excite, sizes as in `RANGES`."""
    cls, ranges = KINDS[name], (RANGES | OUTSIDE_RANGES)[name]
    at = None if cls.scope == ("arm",) else joint
    unit = scales["loaded" if name in LOADED else "link" if cls.port in ("structure", "sensor") else cls.port]
    share = scales["loaded"]["torque"] if name == "load-dependent-friction" else 1.0
    stiff = {"K": stiffness(cls, joint, [robot.drive(name) for name in chain.names])}
    values = {}
    for p in cls.parameters:
        if p.name in ranges:
            values[p.name] = _drawn(rng, ranges[p.name]) * scale(p.relative, unit | stiff) * share
    if name == "torque-ripple":
        values["amplitude"] *= min(1.0, STEEP / values["order"])
    if cls is MotorCoupling:
        values["step"] = min(values["step"], chain.n - 1)
        at = min(joint, chain.n - 1 - int(values["step"]))
    if name == "change-between-records":
        between = range(min(records) + 1, max(records) + 1) or (
            2,
        )  # what changes while the joint is held is not seen to change
        values["record"] = float(rng.choice(between))
    effect = cls.of(at, values)
    return Draw(
        effect,
        f"{name}@{'arm' if at is None else chain.names[at]}: {dict(zip([p.name for p in cls.parameters], effect.values, strict=True))}",
    )


def draws(
    rng: np.random.Generator,
    count: int,
    chain: Chain,
    robot: Robot,
    cells: Sequence[tuple[str, np.ndarray]],
    *,
    lock: str = "dob",
) -> list[Draw]:
    """`count` effects over all of the catalogue by turns, at random joints that `cells` excite and that can show them."""
    names = [name for name in RANGES if name not in SILENT and (lock == "rigid" or name not in RIGID)]
    order = [name for _ in range(-(-count // len(names))) for name in rng.permutation(names)][:count]
    known: dict[int, Mapping[str, Mapping[str, float]]] = {}
    return [draw_at_random(rng, str(name), chain, robot, cells, known, lock=lock) for name in order]


def draw_at_random(
    rng: np.random.Generator,
    name: str,
    chain: Chain,
    robot: Robot,
    cells: Sequence[tuple[str, np.ndarray]],
    known: dict[int, Mapping[str, Mapping[str, float]]],
    *,
    lock: str = "dob",
) -> Draw:
    """The effect `name` at a random joint that `cells` excite and that can show it; `known` scales of joints, completed."""
    excited = sorted({chain.names.index(cell) for cell, _ in cells})
    upright = [j for j in excited if _unloaded(chain, robot, j)]
    joints = upright or excited if name in UNLOADED else excited
    if name == "joint-zero-offset":  # turned about gravity an arm is the same arm
        joints = [j for j in excited if j not in upright] or excited
    joint = int(rng.choice(joints))
    if joint not in known:
        posture = next(q for cell, q in cells if cell == chain.names[joint])
        known[joint] = scales(chain, robot, joint, posture, lock=lock)
    mine = [k for k, (cell, _) in enumerate(cells, 1) if cell == chain.names[joint]]
    return draw(rng, name, joint, chain, robot, known[joint], mine)


def scales(
    chain: Chain, robot: Robot, joint: int, posture: np.ndarray, *, lock: str = "dob"
) -> dict[str, dict[str, float]]:
    """{port: {unit of a relative parameter: its size}} at a joint, from one clean record that excites it.

    "loaded" is the spring with gravity in it: its whole angle, and the dynamic share of its torque.
    """
    e = robot.experiment
    short = replace(robot, experiment=replace(e, f0=max(e.f0, 0.5), band=(max(e.band[0], 0.5), e.band[1]), periods=3))
    (record,) = simulate(chain, short, [(chain.names[joint], posture)], lock=lock, workers=1).records
    drive = robot.drive(chain.names[joint])
    theta, tau = last_period(record)
    omega, acceleration = derivatives(theta[:, joint], e.fs, record)
    spring = drive.N * (tau[:, joint] - drive.J_m * acceleration - drive.D * omega)
    x = spring / drive.K
    x_rate = derivatives(x, e.fs, record)[0]
    rms = lambda v: float(np.std(v))
    J_link = rms(spring) / max(rms(derivatives(theta[:, joint] / drive.N - x, e.fs, record)[1]), 1e-300)
    load = float(np.mean(spring)) / drive.K
    whole = float(np.hypot(rms(x), load))
    common = {"K": drive.K, "mass": chain.joints[-1].inertia.mass}
    at = {"torque": rms(spring), "J": J_link, "damping": drive.D_spring}
    return {
        "motor": common | {"torque": rms(tau[:, joint]), "angle": rms(theta[:, joint]), "rate": rms(omega), "J": drive.J_m, "damping": drive.D},
        "spring": common | at | {"angle": rms(x), "rate": rms(x_rate)},
        "loaded": common | {"angle": whole, "torque": rms(x) / whole},
        "link": common | at | {"angle": rms(theta[:, joint] / drive.N - x), "rate": rms(omega / drive.N - x_rate)},
    }  # fmt: skip


def last_period(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """theta and tau [S, n] of the last period."""
    S = record.samples_per_period
    return record.theta[-S:], record.tau[-S:]


def derivatives(x: np.ndarray, fs: float, record: Record) -> tuple[np.ndarray, np.ndarray]:
    """First and second derivative of one period [S], of its lines up to the highest excited one."""
    X = np.fft.rfft(x)
    X[record.lines.max() + 1 :] = 0.0
    s = 2j * np.pi * np.fft.rfftfreq(len(x), 1 / fs)
    return np.fft.irfft(X * s, len(x)), np.fft.irfft(X * s * s, len(x))


def _drawn(rng: np.random.Generator, how: tuple[object, ...]) -> float:
    if how[0] == "one of":
        return float(rng.choice(np.array(how[1:], dtype=float)))
    low, high = (float(v) for v in how[-2:])  # type: ignore[arg-type]
    value = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return value if how[0] != "+-" or rng.random() < 0.5 else -value


def _unloaded(chain: Chain, robot: Robot, joint: int) -> bool:
    """A joint along gravity: a gear under load never crosses its play."""
    R = np.eye(3)
    for one in chain.joints[: joint + 1]:
        R = R @ one.R  # axes of the joints before are along gravity, too, or this one is loaded somewhere
    axis, g = R @ chain.joints[joint].axis, np.asarray(robot.gravity)
    return bool(
        np.linalg.norm(np.cross(axis, g)) < 1e-6
        and all(np.allclose(np.abs(j.axis @ chain.joints[0].axis), 1) for j in chain.joints[:joint])
    )
