"""The likeliest motion of an arm under known forces: what is measured, smoothed line by line by what a model knows (Wiener)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ident.arm.acting import carried_by, mean_torques, motion_of
from ident.arm.arm_model import Parameters, Sampling, hold_gain, response, stiffness, transfer
from ident.arm.scene import Scene, known, linear_extra
from ident.arm.small_matrices import inverses, products, times
from ident.arm.whitening import Powers
from ident.effects.base import Effect, has_forces
from ident.effects.motion import Motion
from ident.records.campaign import Array
from ident.records.frf import Complex

#: A port ("motor", "spring", "link", or the "reading") and a joint, from 0, of those that move.
Key = tuple[str, int]


@dataclass(frozen=True, eq=False)
class Force:
    """A force at all lines [L], and its mean."""

    lines: Complex
    mean: float

    @staticmethod
    def of(scene: Scene, signal: Array) -> Force:
        return Force(scene.at_lines(signal), float(np.mean(signal)))

    def near(self, other: Force, share: float) -> bool:
        """Whether no line differs by more than this share of the largest."""
        return bool(np.abs(self.lines - other.lines).max() <= share * np.abs(self.lines).max())

    def plus(self, other: Force) -> Force:
        return Force(self.lines + other.lines, self.mean + other.mean)


Forces = dict[Key, Force]


@dataclass(frozen=True, eq=False)
class LikelyMotion:
    """The motion of all m live joints at all L lines as a function of the forces on them.

    `alone` [L, m] are the measured angles as the model predicts them without forces; `on_motor`, `on_link` [L, m, m] what these add;
    `carried` links by motors, `yielding` links by forces on them; `gain` of the readings, `tau` the torques that act, `mean_tau` [n] those
    of all motors on the mean.
    `inside` [L] the band; `certainty` [L, m, m] the inverse covariance of measured minus predicted angles, `trust` the part of
    these that belongs to the motion.
    """

    scene: Scene
    p: Parameters
    on_motor: Complex
    on_link: Complex
    carried: Complex
    yielding: Complex
    alone: Complex
    tau: Complex
    mean_tau: Array
    gain: Complex | None
    second: Complex
    inside: NDArray[np.bool_]
    certainty: Complex
    trust: Complex
    effects: tuple[Effect, ...]

    @staticmethod
    def of(
        scene: Scene, p: Parameters, effects: Sequence[Effect], second: Complex | None, sampling: Sampling, powers: Powers
    ) -> LikelyMotion:  # fmt: skip
        """The motion of a record, `second` its rigid-body forces of second order at the lines of the band [L, m]; of these alone where no
        effect forces it."""
        wide, arm = scene.wide if any(map(has_forces, effects)) else scene.narrow, scene.arm
        linear = linear_extra(wide, p, effects)
        on_motor, on_link = transfer(arm, p, wide.s, linear)
        _, _, Z_lm, Z_ll = stiffness(arm, p, wide.s, linear.impedance)
        yielding = inverses(Z_ll)
        beyond = len(wide.lines) > len(powers.G)
        G = response(arm, p, replace(sampling, f=wide.f0 * wide.lines), linear) if beyond else powers.G
        of_model = replace(powers, G=G).of_model()
        inside = np.isin(wide.lines, scene.lines)
        of_angles = np.tile(powers.angle.max(axis=0), (len(wide.lines), 1))  # nobody knows what rings beyond the band
        # beside dry friction what is certain leads a model astray that lacks more
        if not any(effect.dry for effect in effects):
            of_angles[inside] = powers.angle
        certainty = inverses(of_model + of_angles[:, :, None] * np.eye(len(arm.live)))
        rigid = np.zeros_like(wide.theta)
        tau, mean_tau = wide.acting_torque(linear.torque_gain), mean_torques(wide, p, effects)
        rigid[inside] = 0.0 if second is None else second
        return LikelyMotion(
            wide, p, on_motor, on_link, -products(yielding, Z_lm), yielding, times(G, wide.tau), tau, mean_tau,
            linear.angle_gain, rigid, inside, certainty, products(of_model, certainty), tuple(effects),
        )  # fmt: skip

    def predicted(self, on: Forces) -> tuple[Complex, Complex, Complex]:
        """(measured angles that the model predicts under forces `on`, forces on the links, errors of the readings) [L, m]."""
        motor, link, reading = np.zeros_like(self.alone), self.second.copy(), np.zeros_like(self.alone)
        for (port, k), force in on.items():
            F = force.lines
            if port == "reading":
                reading[:, k] += F
                continue
            motor[:, k] += {"motor": F, "spring": -F, "link": np.zeros_like(F)}[port]
            link[:, k] += {"motor": np.zeros_like(F), "spring": F, "link": F}[port]
        return self.alone + times(self.on_motor, motor) + times(self.on_link, link) + reading, link, reading

    def misfit(self, on: Forces) -> float:
        """chi^2 of the measured angles in the band, under forces `on`."""
        return self.felt(self.scene.theta - self.predicted(on)[0])

    def felt(self, moves: Complex) -> float:
        """chi^2 of what moves the angles by `moves` [L, m], in the band."""
        inside = moves[self.inside]
        return 2.0 * float(np.einsum("li,lij,lj->", inside.conj(), self.certainty[self.inside], inside).real)

    def changed(self, before: Forces, on: Forces) -> float:
        """chi^2 of what moves the angles in the band from under forces `before` to under others."""
        return self.felt(self.predicted(on)[0] - self.predicted(before)[0])

    def with_second(self, second: Complex) -> tuple[LikelyMotion, float]:
        """The same with other rigid-body forces of second order at the lines of the band [L, m], and chi^2 of what these move the angles
        by beyond those before."""
        rigid = np.zeros_like(self.second)
        rigid[self.inside] = second
        return replace(self, second=rigid), self.felt(times(self.on_link, rigid - self.second))

    @property
    def degrees(self) -> int:
        """Real numbers measured in the band."""
        return 2 * int(self.inside.sum()) * self.alone.shape[1]

    def rate(self, key: Key, on: Forces) -> tuple[Complex, Complex]:
        """Velocity [L] at a port under forces `on`, and what a unit force there adds to it."""
        v0, Y = self.rates((key,), on)
        return v0[:, 0], Y[:, 0, 0]

    def rates(self, keys: Sequence[Key], on: Forces) -> tuple[Complex, Complex]:
        """Velocities [L, P] at P ports under forces `on`, and what a unit force at each, the last axis, adds to them [L, P, P]."""
        none = {key: Force(np.zeros_like(x.lines), 0.0) for key, x in on.items()}
        unit = Force(np.ones_like(self.alone[:, 0]), 0.0)
        still, s = self._at(keys, none), self.scene.s[:, None]
        units = [self._at(keys, none | {key: unit}) - still for key in keys]
        return s * self._at(keys, on), s[:, None] * np.stack(units, axis=-1)

    def needed(self, key: Key, on: Forces) -> Force:
        """What has to act at a port besides the forces `on` for its joint's angle to be predicted as it was measured."""
        k, nothing = key[1], Force(np.zeros_like(self.alone[:, 0]), 0.0)
        unit = Force(np.ones_like(nothing.lines), 0.0)
        felt = self.predicted({key: unit})[0] - self.predicted({key: nothing})[0]
        return Force((self.scene.theta - self.predicted(on)[0])[:, k] / felt[:, k], 0.0)

    @cached_property
    def images(self) -> Complex:
        """Torques [S/2 + 1, m] of the motors above all lines, at each multiple of f0: what a torque has there that is held
        between samples."""
        scene, harmonics = self.scene, np.arange(self.scene.samples // 2 + 1)
        images = np.zeros((len(harmonics), len(scene.arm.live)), dtype=complex)
        beyond = harmonics[harmonics > scene.lines[-1]]
        if scene.hold != "zoh" or not len(beyond):
            return images
        a_period = round(scene.fs / scene.f0)
        rest = beyond % a_period
        mirrored = rest > a_period // 2
        of_line = np.zeros((a_period // 2 + 1, len(scene.arm.live)), dtype=complex)
        of_line[scene.lines] = scene.tau
        tau = of_line[np.where(mirrored, a_period - rest, rest)]
        s = 2j * np.pi * scene.f0 * beyond
        tau = np.where(mirrored[:, None], tau.conj(), tau) * hold_gain(s, scene.fs)[:, None]
        arm = known(scene, self.p)
        for e in self.effects:
            gain = e.torque_gain(s, arm)
            tau = tau if gain is None else tau * gain[:, scene.arm.live]
        images[beyond] = tau
        return images

    def _at(self, keys: Sequence[Key], on: Forces) -> Complex:
        """The positions [L, P] at P ports."""
        theta, q = self.likely(on)
        places = {"motor": theta, "link": q, "spring": theta / self.scene.arm.N - q}
        return np.stack([places[port][:, k] for port, k in keys], axis=1)

    def likely(self, on: Forces) -> tuple[Complex, Complex]:
        """The likeliest angles of motors and links [L, m] under forces."""
        predicted, link, reading = self.predicted(on)
        theta = predicted + times(self.trust, self.scene.theta - predicted) - reading
        theta = theta if self.gain is None else theta / self.gain
        return theta, times(self.carried, theta / self.scene.arm.N) + times(self.yielding, link)

    def loads(self, on: Forces) -> Array:
        """The mean torques [n] of all springs under forces."""
        return carried_by(self.scene, self.mean_tau, {key: force.mean for key, force in on.items()})

    def moving(self, on: Forces) -> Motion:
        """How all joints move under forces."""
        scene, p, live, s = self.scene, self.p, self.scene.arm.live, self.scene.s[:, None]
        theta, q = self.likely(on)
        spring = (p.K[live] + s * p.D_spring[live]) * (theta / scene.arm.N - q)
        besides = np.zeros(scene.n)
        for (port, k), force in on.items():
            if port == "spring":
                spring[:, k] += force.lines
            besides[live[k]] += force.mean if port == "spring" else 0.0
        scene = scene.misread({k: force.mean for (port, k), force in on.items() if port == "reading"})
        return motion_of(scene, p, theta, (self.mean_tau, self.tau), q, spring, self.loads(on), besides)
