"""How much of a log's torques an arm leaves that is the declared one but for what sound arms are off by: links, drives, friction, zeros.

Of a sound log that is little, whatever acts; of one with a wrong sign, unit or column it is not, until that is put right.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ident.logs.moves import Moves
from ident.logs.terms import STEP, sizes
from ident.records.log import Array, Log
from ident.records.signal_faults import flat_top
from symgen.plan import Model

#: Samples that are looked at, at most.
SAMPLES = 200
#: This part of a joint's torque [rms] counts like one standard deviation of what an arm may be off by, in so many places.
COARSE, PLACES = 0.1, 100.0
#: One standard deviation of links' parameters, of torques' and rotors' size, and of friction that follows the load, as shares; of other friction, offsets
#: and cables, of torques [rms]; of an angle's zero [rad], of delays [s], of a payload [kg] and where it is [m]. Nothing is further off than `FAR` of them.
LINKS, SHARE, LOADED, FRICTION, OFFSET, CABLE = 0.25, 0.15, 0.2, 2.0, 0.3, 0.1
ZERO, DELAY, PAYLOAD, REACH = 0.1, 0.02, 4.0, 0.3
FAR = 2.0
#: A rotor that nobody knows, in the link's mean inertia; or that of a motor of its own [kg m2, motor side].
ROTOR, MOTOR = 3.0, 3e-4
#: Torques per ampere [N m, joint side] that are tried where nobody knows them.
CONSTANTS = np.geomspace(1e-3, 1e4, 29)
#: Gravity is seen where it makes this share of a torque.
WEIGHT = 0.1
#: Friction turns within this part of a joint's velocity [rms].
TURNS = 0.01
#: Equations that say the same are told apart no better than to this.
ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class Motion:
    """Positions, velocities, accelerations [S, n] of an arm; what of them follows from its declared links is kept."""

    model: Model
    gravity: Array
    q: Array
    v: Array
    a: Array

    @cached_property
    def rows(self) -> Array:
        """The torques [S, n, 10 n] of each of the links' parameters."""
        return self.model.torque_rows(self.q, self.v, self.a, self.gravity)

    @cached_property
    def load(self) -> Array:
        """The torques [S, n] of the declared links."""
        return np.asarray(self.rows @ self.model.chain.parameters.reshape(-1))

    @cached_property
    def zeros_off(self) -> Array:
        """What an angle that is off by 1 rad changes of them [S, n, n]."""
        declared = self.model.chain.parameters.reshape(-1)
        moved = (self.q + STEP * away for away in np.eye(self.q.shape[1]))
        return np.stack(
            [(self.model.torque_rows(q, self.v, self.a, self.gravity) @ declared - self.load) / STEP for q in moved],
            axis=-1,
        )

    @cached_property
    def inertia(self) -> Array:
        """The mean J_ii [n] of the declared links."""
        some = self.q[:: max(1, len(self.q) // 20)]
        return np.diagonal(self.model.J_cad(some), axis1=1, axis2=2).mean(axis=0)


@dataclass(frozen=True, eq=False)
class Sight:
    """Some samples of a log: its motion, torques and their rates [S, n], joint side; `N`, `J_m` [n] as they are declared. `cut` [S, n] are samples at
    which a torque is at its end."""

    motion: Motion
    tau: Array
    rate: Array
    N: Array
    J_m: Array
    cut: NDArray[np.bool_]

    @property
    def n(self) -> int:
        return len(self.N)

    @cached_property
    def size(self) -> Array:
        """The torques' [n, rms]."""
        return np.sqrt(np.mean(self.tau**2, axis=0)) + 1e-300

    @property
    def heavy(self) -> bool:
        """Whether gravity is seen in a torque: what does not change may be an offset."""
        weight = replace(self.motion, v=0.0 * self.motion.v, a=0.0 * self.motion.a).load
        return bool(np.any(weight.std(axis=0) > WEIGHT * self.size))

    def scaled(self, angle: Array, torque: Array, gear: bool = False) -> Sight:
        """The same with angles and torques times factors [n]; `gear`: for the gear ratios are other ones by that."""
        m = self.motion
        if np.any(angle != 1.0):
            m = replace(m, q=angle * m.q, v=angle * m.v, a=angle * m.a)
        N = self.N / angle if gear else self.N
        return replace(self, motion=m, tau=torque * self.tau, rate=torque * self.rate, N=N)

    def exchanged(self, i: int, k: int, angles: bool, torques: bool) -> Sight:
        """The same with angles, torques of joints i and k exchanged, each read through the gear of its joint."""
        order = np.arange(self.n)
        order[[i, k]] = k, i
        gear, m = self.N[order] / self.N, self.motion
        if angles:
            m = replace(m, q=m.q[:, order] * gear, v=m.v[:, order] * gear, a=m.a[:, order] * gear)
        tau, rate = (x[:, order] / gear if torques else x for x in (self.tau, self.rate))
        return replace(self, motion=m, tau=tau, rate=rate)

    def faster(self, factor: float) -> Sight:
        """The same if it was sampled so many times as fast."""
        m = replace(self.motion, v=factor * self.motion.v, a=factor**2 * self.motion.a)
        return replace(self, motion=m, rate=factor * self.rate)

    def turned(self, away: Array) -> Sight:
        """The same with angles so far away [n, rad]."""
        return replace(self, motion=replace(self.motion, q=self.motion.q + away))


def seen(log: Log, model: Model, moved: Sequence[Moves]) -> Sight:
    """Some samples of all trajectories."""
    every = max(1, sum(len(m.q) for m in moved) // SAMPLES)
    some = [
        slice(round(m.times[0] * m.fs), round(m.times[-1] * m.fs), every) for m in moved
    ]  # without what filters spoil
    q, v, a, tau, rate = (
        np.concatenate([getattr(m, name)[use] for m, use in zip(moved, some, strict=True)])
        for name in ("q", "v", "a", "tau", "tau_rate")
    )
    cut = [
        np.stack([_cut(x)[:: round(log.fs / m.fs)][use] for x in run.tau.T], axis=1)
        for run, m, use in zip(log.trajectories, moved, some, strict=True)
    ]
    J_m = np.where([name in log.currents for name in log.joints], np.nan, log.J_m)
    return _known(Sight(Motion(model, log.gravity, q, v, a), tau, rate, log.N, J_m, np.concatenate(cut)), log)


def _cut(tau: Array) -> NDArray[np.bool_]:
    """The samples at which a torque [T] is cut off, at either end."""
    ends = [sign * top[0] for sign in (1.0, -1.0) if (top := flat_top(sign * tau)) is not None]
    return np.isin(tau, ends)


def _known(sight: Sight, log: Log) -> Sight:
    """The same with currents as the torques that they are likeliest to be."""
    for j in 2 * [log.joints.index(name) for name in log.currents]:
        tried = [sight.scaled(np.ones(log.n), np.where(np.arange(log.n) == j, k, 1.0)) for k in CONSTANTS]
        sight = min(tried, key=lambda one: left(one, zeros=False).count)
    return sight


@dataclass(frozen=True, eq=False)
class Left:
    """What an arm leaves of the torques, `share` [n, relative rms] and of those that are cut off `cut` [n]; what that and its deviations from the
    declared one `count`."""

    share: Array
    cut: Array
    count: float


def left(sight: Sight, as_declared: bool = False, rotors: bool = False, zeros: bool = True) -> Left:
    """What the likeliest arm leaves; one whose links are `as_declared`, and its rotors, too, unless `rotors` may be other ones; one whose angles have
    the right `zeros` is faster to tell."""
    m, (S, n), size = sight.motion, sight.tau.shape, sight.size
    y = (sight.tau - m.load - sight.N**2 * np.nan_to_num(sight.J_m) * m.a) / size
    columns, widths, both = map(np.array, zip(*_columns(sight, as_declared, rotors, zeros), strict=True))
    scale = np.sqrt(PLACES / S) / COARSE
    X, Y = scale * widths[:, None] * (columns / size).reshape(len(columns), -1), scale * y.ravel()
    x = _bounded(X @ X.T + np.eye(len(X)), X @ Y, np.where(both, -FAR, 0.0), np.full(len(X), FAR))
    rest = (Y - x @ X).reshape(S, n)
    of_cut = np.sum((rest * sight.cut) ** 2, axis=0) / np.maximum(np.sum(sight.cut, axis=0), 1)
    return Left(np.sqrt(np.mean(rest**2, axis=0)) / scale, np.sqrt(of_cut) / scale, float(np.sum(rest**2) + x @ x))


def _columns(sight: Sight, as_declared: bool, rotors: bool, zeros: bool) -> Iterator[tuple[Array, float, bool]]:
    """What sound arms are off by: torques [S, n], by how much [one standard deviation], and whether in both directions."""
    m, n, size = sight.motion, sight.n, sight.size
    for j in range(n):
        known = bool(np.isfinite(sight.J_m[j])) and not rotors
        gear = float(sight.N[j]) ** 2
        rotor = gear * float(np.nan_to_num(sight.J_m[j]))
        speed, q = np.sqrt(np.mean(m.v[:, j] ** 2)) + 1e-300, m.q[:, j] - m.q[:, j].mean()
        way = np.tanh(m.v[:, j] / (TURNS * speed))
        own: list[tuple[Array, float, bool]] = [
            (m.v[:, j] / speed, FRICTION * size[j], False),
            (way, FRICTION * size[j], False),
            (way * np.abs(m.load[:, j]), LOADED, False),
            (np.ones(len(q)), OFFSET * size[j], True),
            (sight.rate[:, j], DELAY, True),
        ]
        if not known:
            own.append((m.a[:, j], max(ROTOR * m.inertia[j], ROTOR * rotor, MOTOR * gear), rotors))
        if not as_declared:
            own += [
                (q / (q.std() + 1e-300), CABLE * size[j], False),
                (m.load[:, j] + rotor * m.a[:, j], SHARE, True),
                (m.a[:, j], SHARE * rotor, True),
            ]
        for values, width, both in own:
            yield values[:, None] * np.eye(n)[j], width, both
        if zeros:
            yield m.zeros_off[..., j], ZERO, True
    if as_declared:
        return
    for k, one in enumerate(sizes(m.model)):
        yield m.rows[..., k] * one, LINKS, True
    for k in range(4):
        yield m.rows[..., 10 * (n - 1) + k], PAYLOAD * (REACH if k else 1.0), k > 0


def _bounded(H: Array, b: Array, lower: Array, upper: Array) -> Array:
    """The minimum of x'H x/2 - b'x between bounds: what lies beyond one is put there, the others are solved for anew."""
    size = 1.0 / np.sqrt(np.diag(H))
    H, b, lower, upper = size[:, None] * H * size + ROUNDING * np.eye(len(b)), size * b, lower / size, upper / size
    x, free = np.zeros(len(b)), np.ones(len(b), dtype=bool)
    while free.any():
        x[free] = np.linalg.solve(H[np.ix_(free, free)], b[free] - H[np.ix_(free, ~free)] @ x[~free])
        beyond = free & ((x < lower) | (x > upper))
        if not beyond.any():
            break
        x = np.clip(x, lower, upper)
        free &= ~beyond
    return np.asarray(size * x)
