"""One record as effects see it: its lines, what was measured there, and what is linear in the effects on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np
from numpy.typing import NDArray

from ident.arm.arm_model import NOTHING, Extra, Parameters, Posture, hold_gain
from ident.arm.strays import strays
from ident.effects.base import Effect, Known
from ident.effects.motion import CREEP
from ident.effects.structure import Giving, all_that_gives
from ident.records.campaign import Array
from ident.records.excitation import synthesise
from ident.records.frf import Complex
from symgen.chain import Chain

#: Samples a period per line of the band: laws with kinks need more than Nyquist's two, and J(q) suffers from too few.
OVERSAMPLED = 12
#: Noise that is left of the velocity of a motor in one period, and of a link [of the speed below which dry friction creeps].
QUIET, QUIET_LINK = 0.1, 0.01
#: Aliases on either side that gains are told of: those of a motor alone fall with the third power.
FOLDED = 8
#: Rows of what J and the gravity stiffness change by, see `Scene`.
Slopes = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Scene:
    """One record as effects see it: m live of n joints at lines `lines` [L] of f0 [Hz], measured `tau`, `theta` [L, m].

    The motion is that of the lines `beyond` the band (lines [H], tau, theta [H, m]), too: dry friction moves a joint there.

    `noise` [2, m] are the rms errors of tau and theta at a line. `means` [2, n] of torques [N m] and motor angles [rad] and `posture` [n] are those of all joints. `slopes` are
    (dJ/dq_k, dK/dq_k), [m, m, m, D] and [m, m, m, r], k first: rows of what J and the gravity stiffness change by. `kept` [M S, n, rad]
    are the motor angles of the M periods that the lines are of. `chain` the declared links.
    """

    arm: Posture
    n: int
    lines: NDArray[np.int64]
    f0: float
    fs: float
    hold: str
    tau: Complex
    theta: Complex
    noise: Array
    means: Array
    posture: Array
    N: Array
    beyond: tuple[NDArray[np.int64], Complex, Complex]
    chain: Chain
    gravity: Array
    slopes: Slopes | None = None
    kept: Array | None = None
    oversampled: int = OVERSAMPLED

    @cached_property
    def wide(self) -> Scene:
        """The same record at all lines, in their order."""
        lines, tau, theta = self.beyond
        if not len(lines):
            return self
        whole = np.concatenate([self.lines, lines])
        order = np.argsort(whole)
        return replace(
            self.narrow, lines=whole[order], tau=np.concatenate([self.tau, tau])[order],
            theta=np.concatenate([self.theta, theta])[order],
        )  # fmt: skip

    @property
    def narrow(self) -> Scene:
        """The same record at the lines of the band alone."""
        lines, tau, theta = self.beyond
        return replace(self, beyond=(lines[:0], tau[:0], theta[:0]))

    def misread(self, errors: Mapping[int, float]) -> Scene:
        """The record where the angles of some live joints (from 0, of those) were read too large by these means [rad]."""
        means = self.means.copy()
        for k, error in errors.items():
            means[1, self.arm.live[k]] -= error
        return replace(self, means=means)

    @cached_property
    def samples(self) -> int:
        """Samples of a period in time, the same for the band and for all lines."""
        last = max(self.lines[-1], self.beyond[0].max(initial=0))
        return int(2 ** np.ceil(np.log2(self.oversampled * (last + 1))))

    @cached_property
    def s(self) -> Complex:
        return np.asarray(2j * np.pi * self.f0 * self.lines)

    @cached_property
    def aliases(self) -> tuple[Complex, Complex]:
        """Those of the lines [L, 2 FOLDED] that gains are told of, and s^-3 there."""
        orders = np.delete(np.arange(-FOLDED, FOLDED + 1), FOLDED)
        s = self.s[:, None] + 2j * np.pi * self.fs * orders
        return s, s**-3

    def acting_torque(self, gain: Complex | None) -> Complex:
        """The torques [L, m] of the motors as they act at their own lines, behind a torque gain and held between samples."""
        tau = self.tau if gain is None else self.tau * gain
        return np.asarray(tau * hold_gain(self.s, self.fs)[:, None]) if self.hold == "zoh" else tau

    def of_live(self, impedance: Complex) -> Complex:
        """The part [S, 2m, 2m] of an impedance [S, 2n, 2n] that belongs to the live joints."""
        if len(self.arm.live) == self.n:
            return impedance
        both = np.concatenate([self.arm.live, self.n + self.arm.live])
        return impedance[:, both[:, None], both]

    def strays(self, port: str, joint: int) -> Array | None:
        """How much faster [M, S] the motor or link of a joint is in each period than in the one that repeats; None where nobody
        knows. A link follows its motor when that moves slowly."""
        place = np.flatnonzero(self.arm.live == joint)
        if self.kept is None or not place.size:
            return None
        wide, N = self.wide, float(self.N[joint])
        repeating = synthesise(wide.lines, wide.theta[:, place[0]], round(self.fs / self.f0))
        creep = CREEP * abs(N)
        if port == "motor":
            return strays(self.kept[:, joint], repeating, self.fs, QUIET * creep, self.samples)
        return strays(self.kept[:, joint], repeating, self.fs, QUIET_LINK * creep, self.samples) / N

    def in_time(self, spectrum: Complex) -> Array:
        """One period [S, ..] of what has these amplitudes [L, ..] at the lines."""
        return synthesise(self.lines, spectrum, self.samples)

    def at_lines(self, signal: Array) -> Complex:
        """The amplitudes [L, ..] of one period, however finely it is told."""
        return np.asarray(np.fft.rfft(signal, axis=0)[self.lines] * (2.0 / len(signal)))


def known(scene: Scene, p: Parameters, beside: Sequence[Effect] = ()) -> Known:
    """The arm as effects know it: J of the live joints, zero rows for the others, and what gives of those that are `beside`."""
    J = np.zeros((scene.n, scene.n))
    J[np.ix_(scene.arm.live, scene.arm.live)] = scene.arm.J(p)
    giving = tuple(e for e in beside if isinstance(e, Giving))
    return Known(scene.N, p.K, J, scene.posture, scene.chain, scene.gravity, giving)


def in_record(p: Parameters, effects: Sequence[Effect], record: int) -> Parameters:
    """The arm as it is in a record (from 0), where an effect changes it from one to the next."""
    for effect in effects:
        shares = effect.shares(record)
        if shares:
            changed = {name: np.array(getattr(p, name)) for name in shares}
            for name, share in shares.items():
                changed[name][effect.joint] *= 1.0 + share
            p = replace(p, **changed)
    return p


def linear_extra(scene: Scene, p: Parameters, effects: Sequence[Effect]) -> Extra:
    """Impedances and gains of `effects` at the lines."""
    if not effects:
        return NOTHING
    live, s = scene.arm.live, scene.s
    arm = known(scene, p)
    giving = [e for e in effects if isinstance(e, Giving)]
    alone = effects if len(giving) < 2 else [e for e in effects if not isinstance(e, Giving)]
    added = [e.impedance(s, arm) for e in alone]
    if len(giving) > 1:
        added.append(all_that_gives(s, arm, giving))
    impedances = [scene.of_live(Z) for Z in added if Z is not None]
    torque = [g[:, live] for e in effects if (g := e.torque_gain(s, arm)) is not None]
    angle = [g[:, live] for e in effects if (g := e.angle_gain(s, arm)) is not None]
    return Extra(
        sum(impedances[1:], impedances[0]) if impedances else None,
        reduce(np.multiply, torque) if torque else None,
        reduce(np.multiply, angle) if angle else None,
        folded=_folded(scene, arm, effects, [*torque, *angle]) if scene.hold == "zoh" else None,
    )


def _folded(scene: Scene, arm: Known, effects: Sequence[Effect], gains: Sequence[Complex]) -> Complex | None:
    """By how much more the aliases of a held torque come through `gains` [L, m] at the line: sum of (g(s_k) / g(s) - 1) / s_k^3."""
    if not gains:
        return None
    live, (s, cubes) = scene.arm.live, scene.aliases
    more = np.zeros_like(gains[0])
    changed = np.flatnonzero(np.any([(gain != 1.0).any(axis=0) for gain in gains], axis=0))
    there: Complex | float = 1.0
    for e in effects:
        for gain in (e.torque_gain(s.ravel(), arm), e.angle_gain(s.ravel(), arm)):
            if gain is not None:
                there = there * gain[:, live[changed]].reshape(*s.shape, -1)
    here = reduce(np.multiply, (gain[:, changed] for gain in gains))
    more[:, changed] = np.einsum("lkc,lk->lc", there / here[:, None] - 1.0, cubes)
    return more
