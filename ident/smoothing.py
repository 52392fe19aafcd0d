"""How an arm moved under laws that are known: the motion that is likeliest, given what was measured and what a model knows.

A law acts on the true motion, and what is measured of it is noisy: dry friction of a joint that sticks would be all noise.
So the measured angles are smoothed by the model, line by line, each by its own noise (a Wiener filter), and a law's force,
which changes the motion that it is of, is found with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ident.acting import Moved, Scene, linear_extra, signals
from ident.arm_model import Parameters, Sampling, motion, stiffness, transfer
from ident.campaign import Array
from ident.effects.base import Effect, Law, Motion
from ident.frf import Complex
from ident.whitening import Noise, Powers, noise_powers

#: Times all forces are found from the motion under all the others.
SWEEPS = 3
#: They agree when they change by less than this share.
SAME = 1e-4
#: Steps towards a force that follows from a position; towards one that stops what moves it, the change that ends them, and
#: the resistance [of the median one of the port] that damps them.
STEPS, TURNS, SETTLED, DAMPED = 20, 60, 1e-4, 0.5
#: Growth of the change from one step to the next, from the least, that ends them too.
DIVERGED = 100.0
#: chi^2 per degree of freedom below which no other force is looked for.
EXPLAINED = 1.3
#: Steps to the velocity at which a law has a force, each along a tangent as wide as this share of the velocities.
TANGENTS, TANGENT = 12, 1e-6

Key = tuple[str, int]


def smoothed(
    scene: Scene,
    p: Parameters,
    effects: Sequence[Effect],
    start: Moved,
    sampling: Sampling,
    noise: Noise,
    turns: int = TURNS,
) -> Moved:
    """Returns the motion of a record in which the forces of `effects` are those of this very motion; `start` one near to it.

    `sampling` and `noise` are those of the record. Dry friction takes up to `turns`: few are enough to compare by.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a law that is far too strong
        return _smoothed(scene, p, effects, start, sampling, noise, turns)


def _smoothed(
    scene: Scene, p: Parameters, effects: Sequence[Effect], start: Moved, sampling: Sampling, noise: Noise, turns: int
) -> Moved:
    linear = linear_extra(scene, p, effects)
    powers = noise_powers(scene.arm, p, sampling, noise, scene.theta, linear)
    whole = _Whole.of(scene, p, effects, start, sampling, powers)
    motion = start.motion
    on = {key: _Force.of(whole.scene, x) for key, x in signals(whole.scene, effects, motion).items()}
    best, least = on, whole.misfit(on)
    loose: dict[Key, Array] = {}
    springy: set[Key] = set()
    for _ in range(SWEEPS):
        before = on
        for key, now in before.items():
            motion = whole.moving(on)
            dry = [e for e in effects if e.dry and (e.port, e.joint) == (key[0], scene.arm.live[key[1]])]
            smooth = [e for e in effects if _smooth(e) and (e.port, e.joint) == (key[0], scene.arm.live[key[1]])]
            rest = signals(whole.scene, [e for e in effects if e not in dry and e not in smooth], motion).get(key)
            other = _Force.of(whole.scene, np.zeros(whole.scene.samples) if rest is None else rest)
            if smooth and not dry:
                springy.add(key)
                other = other.plus(_yielding(whole, key, smooth, motion, on, other))
            elif dry:
                rest = signals(whole.scene, smooth, motion).get(key)
                other = other if rest is None else other.plus(_Force.of(whole.scene, rest))
                force, loose[key] = _sliding(whole, key, dry, motion, on | {key: other}, now, turns)
                other = other.plus(force)
            on = on | {key: other}
        misfit = whole.misfit(on)
        if misfit < least:
            best, least = on, misfit
        if len(on) == 1 and loose:
            break
        if all(
            np.allclose(on[key].lines, before[key].lines, rtol=0.0, atol=SAME * abs(before[key].lines).max())
            for key in on
        ):
            break
    inside = np.isin(whole.scene.lines, scene.lines)
    motion = whole.moving(best)
    return replace(
        start, motion=motion, found={key: force.lines[inside] for key, force in best.items()},
        base=signals(whole.scene, effects, motion), loose=loose,
        springy={(port, k): motion.at(port, int(scene.arm.live[k]))[0] for port, k in springy},
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Force:
    """A force at all lines [L], and its mean."""

    lines: Complex
    mean: float

    @staticmethod
    def of(scene: Scene, signal: Array) -> _Force:
        return _Force(scene.at_lines(signal), float(np.mean(signal)))

    def plus(self, other: _Force) -> _Force:
        return _Force(self.lines + other.lines, self.mean + other.mean)


def _sliding(
    whole: _Whole, key: Key, laws: Sequence[Effect], motion: Motion, on: Mapping[Key, _Force], start: _Force,
    turns: int,
) -> tuple[_Force, Array]:  # fmt: skip
    """The force of dry `laws` at a port, of the velocity that it leaves, from `start` under the forces `on` besides; and how freely it
    follows its parameters [S]: 0 where the joint sticks and the force is what holds it, 1 where it slides.

    Friction f(v) = w - g v and what moves the port, v = v0 - Y f, are met in turns (J. Douglas, H. H. Rachford, Trans. AMS 82
    (1956), DOI 10.1090/S0002-9947-1956-0084194-4; P.-L. Lions, B. Mercier, SIAM J. Numer. Anal. 16 (1979), DOI
    10.1137/0716071): it converges for any friction that grows with speed at any port that gives back no more than it got.
    """
    scene, (port, k) = whole.scene, key
    joint = int(scene.arm.live[k])
    N = float(scene.arm.N[k]) if port == "motor" else 1.0
    name = "omega" if port == "motor" else "q_rate"
    state = motion.state(joint)

    def friction(v: Array) -> Array:
        moved = replace(state, **{name: v})
        return np.asarray(-N * sum(law.law(moved) for law in laws), dtype=float)

    v0, Y = whole.rate(key, on)
    g = DAMPED / float(np.median(np.abs(Y)))
    measured = getattr(state, name)
    best, free, least = start, np.ones(scene.samples), np.inf
    for w in (friction(measured) + g * measured, scene.in_time((g * v0 - start.lines)[:, None])[:, 0]):
        force, slope = _in_turns(scene, friction, g, v0, Y, w, turns)
        misfit = whole.misfit(on | {key: on[key].plus(force)})
        if misfit < least:
            best, free, least = force, g / (g + np.maximum(slope, 0.0)), misfit
        if turns < TURNS or least < EXPLAINED * whole.degrees:
            break
    return best, free


def _in_turns(
    scene: Scene, friction: Callable[[Array], Array], g: float, v0: Complex, Y: Complex, w: Array, turns: int
) -> tuple[_Force, Array]:
    """The force of `friction` where v = v0 - Y friction(v), from w = friction(v) + g v; and the slope of friction [S] there."""
    v = w / g
    slope = np.zeros_like(w)
    force, mean = np.zeros_like(v0), 0.0
    for _ in range(turns):
        v, slope = _met(friction, g, w, v)
        f = w - g * v
        left = scene.at_lines(f - g * v)
        v_lines = (v0 - Y * left) / (1.0 + g * Y)
        force, mean = left + g * v_lines, float(f.mean())
        before = w  # a constant torque moves nothing for ever: what is needed is there
        w = scene.in_time((force + g * v_lines)[:, None])[:, 0] + mean
        if np.std(w - before) < SETTLED * np.std(w):
            break
    return _Force(-force, -mean), slope


def _smooth(effect: Effect) -> bool:
    """A law without kinks in time that depends on the position at its port, at this moment."""
    return isinstance(effect, Law) and not effect.dry and type(effect).force is Law.force and effect.start()[1] is None


def _yielding(
    whole: _Whole, key: Key, laws: Sequence[Effect], motion: Motion, on: Mapping[Key, _Force], besides: _Force
) -> _Force:
    """The force of `laws` at a port, of the position that it leaves, under the forces `on`, of which it is a part with `besides`.

    The best line through force and position is solved for exactly, what is left of the law in turns.
    """
    scene, (port, k) = whole.scene, key
    joint = int(scene.arm.live[k])
    N = float(scene.arm.N[k]) if port == "motor" else 1.0
    position, velocity = {
        "motor": ("theta", "omega"),
        "spring": ("deflection", "deflection_rate"),
        "link": ("q", "q_rate"),
    }[port]
    state = motion.state(joint)
    v0, Y = whole.rate(key, on | {key: besides})
    x0, Y = v0 / scene.s, Y / scene.s
    x, mean = getattr(state, position), float(np.mean(getattr(state, position)))
    K = float(whole.p.K[joint])

    def force(x: Array, v: Array) -> Array:
        moved = replace(state, **{position: x, velocity: v})
        return np.asarray(N * sum(law.law(moved) for law in laws), dtype=float)

    v = getattr(state, velocity)
    F = force(x, v)
    load = float(scene.N[joint] * scene.means[0, joint]) - besides.mean
    best, least, size = F, np.inf, np.std(F)
    for _ in range(STEPS):
        swing = x - x.mean()
        line = float(swing @ F) / max(float(swing @ swing), 1e-300)
        left = scene.at_lines(F) - line * scene.at_lines(x)
        lines = (x0 + Y * left) / (1.0 - line * Y)
        if port == "spring":  # it carries what its motor does, on the mean
            mean += (load - K * mean - float(F.mean())) / max(K + line, 0.1 * K)
        x, v = scene.in_time(np.stack([lines, scene.s * lines], axis=1)).T + np.array([[mean], [0.0]])
        before, F = F, force(x, v)
        change = float(np.std(F - before))
        if change < least:
            best, least = F, change
        if not DIVERGED * least > change > SETTLED * size:
            break
    return _Force.of(scene, best)


def _met(friction: Callable[[Array], Array], g: float, w: Array, v: Array) -> tuple[Array, Array]:
    """Velocities [S] where friction(v) + g v = w, from `v`, and the slope of friction there; Newton's steps, kept in a bracket:
    friction is against v."""
    low, high = np.minimum(w / g, 0.0), np.maximum(w / g, 0.0)
    v = np.clip(v, low, high)
    h = TANGENT * float(np.abs(v).max() + 1e-300)
    slope = np.zeros_like(w)
    for _ in range(TANGENTS):
        f = friction(v)
        error = f + g * v - w
        low, high = np.where(error < 0.0, v, low), np.where(error > 0.0, v, high)
        slope = (friction(v + h) - f) / h
        step = v - error / np.maximum(slope + g, 1e-3 * g)
        inside = (step > low) & (step < high)
        v = np.where(inside, step, 0.5 * (low + high))
        if np.max(np.abs(error)) < 1e-9 * np.max(np.abs(w)):
            break
    return v, slope


@dataclass(frozen=True, eq=False)
class _Whole:
    """The motion of all m live joints at all L lines as a function of the forces on them.

    `alone` [L, m] are the measured angles as the model predicts them without forces; `on_motor`, `on_link` [L, m, m] what these add;
    `carried` links by motors, `yielding` links by forces on them; `gain` of the readings. `inside` [L] the band; `certainty` [L, m, m]
    the inverse covariance of measured minus predicted angles, `trust` the part of these that belongs to the motion.
    """

    scene: Scene
    p: Parameters
    on_motor: Complex
    on_link: Complex
    carried: Complex
    yielding: Complex
    alone: Complex
    gain: Complex | None
    second: Complex
    inside: NDArray[np.bool_]
    certainty: Complex
    trust: Complex

    @staticmethod
    def of(
        scene: Scene, p: Parameters, effects: Sequence[Effect], start: Moved, sampling: Sampling, powers: Powers
    ) -> _Whole:  # fmt: skip
        wide, arm = scene.wide, scene.arm
        linear = linear_extra(wide, p, effects)
        on_motor, on_link = transfer(arm, p, wide.s, linear)
        _, _, Z_lm, Z_ll = stiffness(arm, p, wide.s, linear.impedance)
        yielding = np.linalg.inv(Z_ll)
        m, at = len(arm.live), Sampling(wide.f0 * wide.lines, sampling.fs, sampling.hold)
        G = motion(arm, p, at, np.broadcast_to(np.eye(m, dtype=complex), (len(wide.lines), m, m)), linear)
        of_model = replace(powers, G=G).of_model()
        noise = of_model + np.diag(powers.angle.max(axis=0))
        second = np.zeros_like(wide.theta) if start.second is None else start.second
        return _Whole(
            wide, p, on_motor, on_link, -yielding @ Z_lm, yielding, _times(G, wide.tau), linear.angle_gain, second,
            np.isin(wide.lines, scene.lines), np.linalg.inv(noise), of_model @ np.linalg.inv(noise),
        )  # fmt: skip

    def predicted(self, on: Mapping[Key, _Force]) -> tuple[Complex, Complex, Complex]:
        """(measured angles that the model predicts under forces `on`, forces on the links, errors of the readings) [L, m]."""
        motor, link, reading = np.zeros_like(self.alone), self.second.copy(), np.zeros_like(self.alone)
        for (port, k), force in on.items():
            F = force.lines
            if port == "reading":
                reading[:, k] += F
                continue
            motor[:, k] += {"motor": F, "spring": -F, "link": np.zeros_like(F)}[port]
            link[:, k] += {"motor": np.zeros_like(F), "spring": F, "link": F}[port]
        return self.alone + _times(self.on_motor, motor) + _times(self.on_link, link) + reading, link, reading

    def misfit(self, on: Mapping[Key, _Force]) -> float:
        """chi^2 of the measured angles in the band, under forces `on`."""
        error = (self.scene.theta - self.predicted(on)[0])[self.inside]
        return 2.0 * float(np.einsum("li,lij,lj->", error.conj(), self.certainty[self.inside], error).real)

    @property
    def degrees(self) -> int:
        """Real numbers measured in the band."""
        return 2 * int(self.inside.sum()) * self.alone.shape[1]

    def rate(self, key: Key, on: Mapping[Key, _Force]) -> tuple[Complex, Complex]:
        """Velocity [L] at a port under forces `on`, and what a unit force there adds to it."""
        none = {key: _Force(np.zeros_like(x.lines), 0.0) for key, x in on.items()}
        unit = none | {key: _Force(np.ones_like(none[key].lines), 0.0)}
        moved = [self._at(key, forces) for forces in (on, unit, none)]
        return self.scene.s * moved[0], self.scene.s * (moved[1] - moved[2])

    def _at(self, key: Key, on: Mapping[Key, _Force]) -> Complex:
        """The position [L] at a port."""
        port, k = key
        theta, q = (angles[:, k] for angles in self.likely(on))
        return theta if port == "motor" else q if port == "link" else theta / self.scene.arm.N[k] - q

    def likely(self, on: Mapping[Key, _Force]) -> tuple[Complex, Complex]:
        """The likeliest angles of motors and links [L, m] under forces."""
        predicted, link, reading = self.predicted(on)
        theta = predicted + _times(self.trust, self.scene.theta - predicted) - reading
        theta = theta if self.gain is None else theta / self.gain
        return theta, _times(self.carried, theta / self.scene.arm.N) + _times(self.yielding, link)

    def moving(self, on: Mapping[Key, _Force]) -> Motion:
        """How all joints move under forces."""
        scene, p, live, s = self.scene, self.p, self.scene.arm.live, self.scene.s[:, None]
        theta, q = self.likely(on)
        x = theta / scene.arm.N
        spring = (p.K[live] + s * p.D_spring[live]) * (x - q)
        still = np.zeros(scene.n)
        wound, push = scene.N * scene.means[0], still.copy()
        for (port, k), force in on.items():
            if port == "spring":
                spring[:, k] += force.lines
            wound[live[k]] += force.mean if port == "motor" else 0.0
            push[live[k]] += force.mean if port == "spring" else 0.0
        twist = (wound - push) / p.K
        stack = np.stack([theta, s * theta, scene.tau, q, s * q, x - q, s * (x - q), spring], axis=1)
        periods = scene.in_time(stack).transpose(1, 0, 2)
        mean_tau, mean_theta = scene.means
        means = [mean_theta, still, mean_tau, mean_theta / scene.N - twist, still, twist, still, wound]
        signal = np.repeat(np.stack(means)[:, None, :], scene.samples, axis=1)
        signal[:, :, live] += periods
        return Motion(1.0 / (scene.f0 * scene.samples), scene.N, *signal, p.K)


def _times(matrix: Complex, vector: Complex) -> Complex:
    """Matrices [L, m, m] times vectors [L, m]."""
    return np.asarray((matrix @ vector[..., None])[..., 0])
