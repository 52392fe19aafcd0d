"""What acts on an arm besides its elastic joints, in one record: effects, and the rigid-body terms of second order.

The forces of an effect follow from how its port moves, and that is measured: motor angles directly; spring torques from
the motors' own equation, links by what those torques do to them. So a force is a known signal, whatever it depends on,
and the arm stays linear under it. Nothing is integrated, no steady state is searched.

Links and springs are found from three equations for two unknowns a joint, weighted by what each is worth: the motors' own
tells the springs' torques, the springs' law what they are wound by, the links' how links answer. Where an effect acts,
its equation is doubted and the others tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ident.arm.arm_model import Extra, Parameters, stiffness
from ident.arm.scene import Scene, known, linear_extra
from ident.arm.small_matrices import inverses, products, times
from ident.effects.base import Effect, Swing, has_forces
from ident.effects.motion import Motion
from ident.effects.structure import Giving
from ident.effects.sway import of_second_order
from ident.records.campaign import Array
from ident.records.frf import Complex
from ident.records.resting import ASIDE

#: Error of every equation, relative to the torque in it; and of that in which a force acts that is not known well.
TRUST, DOUBT = 1e-4, 0.3
#: Samples a period per line where all that is of second order is products of two signals: none of theirs falls back on a line.
OF_PRODUCTS = 3
#: A joint that is nearer to its posture than this share of what its spring is wound by may be there by a spring that is not known that
#: well.
SAGS = 0.3
#: Times the forces, those of second order among them, are computed from the links that they move.
PASSES = 2

#: What a force is of, and itself [S]: a velocity and the dry friction against it, a position and what a law with a memory has there.
Slid = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Moved:
    """How an arm moved in a record, and the rigid-body forces of second order that follow, joint side, at its lines [L, m].

    Where the motion was found together with forces: these, `found` at the lines [L], and in time of the motion alone, `base` [S].
    `springy` are the positions [S] at ports whose force follows from them, `rubbing` the velocities at those with dry friction:
    the best line through force and position is stiffness there, through force and velocity damping. `slid` tells how it was found.
    """

    motion: Motion
    second: Complex | None
    found: Mapping[tuple[str, int], Complex] | None = None
    base: Mapping[tuple[str, int], Array] = field(default_factory=dict)
    springy: Mapping[tuple[str, int], Array] = field(default_factory=dict)
    rubbing: Mapping[tuple[str, int], Array] = field(default_factory=dict)
    slid: Mapping[tuple[str, int], Slid] = field(default_factory=dict)

    @property
    def lined(self) -> bool:
        """Whether the best lines through some forces are told as impedances."""
        return bool(self.springy or self.rubbing)


def moved(scene: Scene, p: Parameters, effects: Sequence[Effect], doubted: str = "") -> Moved | None:
    """Returns how the arm moved, by what was measured and the effects known so far; None where nothing depends on it.

    The equations of all joints at the port `doubted` are, too: what an unknown force there would not spoil.
    """
    if scene.slopes is None and not any(has_forces(e) for e in effects) and not doubted:
        return None
    forceful = [e for e in effects if has_forces(e)]
    wide = scene.wide if forceful or doubted else scene
    inside = np.isin(wide.lines, scene.lines)
    linear = linear_extra(wide, p, effects)
    doubts = {
        port: np.full(len(scene.arm.live), DOUBT if port == doubted else 0.0) for port in ("motor", "spring", "link")
    }
    for e in forceful:
        doubts[e.port if e.port in doubts else "link"][scene.arm.live == e.joint] = DOUBT
    on, second = _nothing(wide), None
    mean_tau = mean_torques(wide, p, effects)
    motion, links = _motion(wide, p, linear, on, doubts, mean_tau, {})
    for _ in range(PASSES):
        now = signals(wide, effects, motion)
        on = _forces(wide, now, Moved(motion, None))
        if scene.slopes is not None:
            second = second_order(scene, p, effects, links[inside], motion)
            on["link"][inside] += second
        means = {key: float(signal.mean()) for key, signal in now.items()}
        misread = {k: mean for (port, k), mean in means.items() if port == "reading"}
        motion, links = _motion(wide.misread(misread), p, linear, on, doubts, mean_tau, means)
    return Moved(motion, second)


def acting(scene: Scene, p: Parameters, effects: Sequence[Effect], how: Moved | None) -> Extra:
    """Everything in `effects` and the rigid-body terms, at the lines of a record in which the arm moved like `how`."""
    linear = linear_extra(scene, p, effects)
    if how is None:
        return linear
    on, linear = _along_lines(scene, linear, signals(scene, effects, how.motion), how)
    if how.second is not None:
        on["link"] += how.second
    return _with_forces(linear, on)


def differences(scene: Scene, effect: Effect, others: Sequence[Effect], how: Moved) -> list[Extra]:
    """What each of `others`, `effect` with a changed value, does beyond `effect` in a record in which the arm moved like `how`:
    forces, readings and the best lines through laws, as in `acting`."""
    now, found = signals(scene, (effect,), how.motion), []
    for other in others:
        more = {key: signal - now[key] for key, signal in signals(scene, (other,), how.motion).items()}
        on, linear = _along_lines(scene, Extra(), more, replace(how, found=None))
        found.append(_with_forces(linear, on))
    return found


def _along_lines(
    scene: Scene, linear: Extra, now: Mapping[tuple[str, int], Array], how: Moved
) -> tuple[dict[str, Complex], Extra]:
    """Forces that are `now` in time but for the best lines through them, and `linear` with these."""
    on, lines = _forces(scene, now, how), _lines(now, how)
    for (port, k), line in lines.items():
        on[port][:, k] -= line.slope * scene.at_lines(line.of)
    return on, _stiffened(scene, linear, lines)


def _with_forces(linear: Extra, on: Mapping[str, Complex]) -> Extra:
    return replace(
        linear, on_motor=on["motor"] - on["spring"], on_link=on["link"] + on["spring"], reading=on["reading"]
    )


def linear_part(scene: Scene, p: Parameters, effects: Sequence[Effect], how: Moved) -> Extra:
    """Impedances and gains of `effects`, and of the best lines through the laws of positions in a record."""
    lines = _lines(signals(scene, effects, how.motion), how)
    return _stiffened(scene, linear_extra(scene, p, effects), lines)


class Line(NamedTuple):
    """The best line through a force and what it is `of` [S], a position or its rate: joint side by the port's own unit."""

    of: Array
    slope: float
    is_rate: bool


def _lines(now: Mapping[tuple[str, int], Array], how: Moved) -> dict[tuple[str, int], Line]:
    """The best lines through forces that are `now` in time, by port and live joint."""
    found = {}
    for moves, is_rate in ((how.springy, False), (how.rubbing, True)):
        for key in moves.keys() & now.keys():
            found[key] = Line(moves[key], slope(moves[key], now[key]), is_rate)
    return found


def slope(x: Array, force: Array) -> float:
    """The slope of the best line through a force [S] and what it is of [S]."""
    swing = x - x.mean()
    return float(swing @ force) / max(float(swing @ swing), 1e-300)


def _stiffened(scene: Scene, linear: Extra, lines: Mapping[tuple[str, int], Line]) -> Extra:
    """`linear` with the slopes of `lines`; a motor's position is told motor side."""
    if not lines:
        return linear
    m = len(scene.arm.live)
    Z = np.zeros((len(scene.lines), 2 * m, 2 * m), dtype=complex)
    for (port, k), line in lines.items():
        row, column = np.zeros(2 * m), np.zeros(2 * m)
        if port == "spring":
            row[[k, m + k]] = column[[k, m + k]] = (1.0, -1.0)
        else:
            at = k if port == "motor" else m + k
            row[at], column[at] = -1.0, scene.arm.N[k] if port == "motor" else 1.0
        by = line.slope * (scene.s if line.is_rate else np.ones_like(scene.s))
        Z += by[:, None, None] * np.outer(row, column)
    return replace(linear, impedance=Z if linear.impedance is None else linear.impedance + Z)


def _nothing(scene: Scene) -> dict[str, Complex]:
    return {port: np.zeros(scene.theta.shape, dtype=complex) for port in ("motor", "spring", "link", "reading")}


def signals(scene: Scene, effects: Sequence[Effect], motion: Motion) -> dict[tuple[str, int], Array]:
    """What `effects` do at a port of a live joint (from 0, of those), joint side, and to the "reading", in time [S], when
    the arm moves like this."""
    place = {int(j): k for k, j in enumerate(scene.arm.live)}
    found: dict[tuple[str, int], Array] = {}
    for e in effects:
        if not has_forces(e):
            continue
        loads: list[tuple[str, int, Array]] = []
        if e.joint in place and (law := e.force(motion)) is not None:
            loads.append((e.port if e.port in ("motor", "spring") else "link", int(e.joint or 0), law))
        if type(e).loads is not Effect.loads:
            loads += e.loads([motion.state(j) for j in range(scene.n)])
        if e.joint in place and (error := e.reading(motion)) is not None:
            loads.append(("reading", int(e.joint or 0), error))
        for port, j, load in loads:
            if j in place:
                key = (port, place[j])
                found[key] = found.get(key, 0.0) + load * (scene.arm.N[place[j]] if port == "motor" else 1.0)
    return found


def _forces(scene: Scene, now: Mapping[tuple[str, int], Array], how: Moved) -> dict[str, Complex]:
    """Forces at the lines that are `now` in time, if the motion alone is asked."""
    on = _nothing(scene)
    for port, k in now.keys() | (how.found or {}).keys():
        key = (port, k)
        if how.found is None:
            on[port][:, k] = scene.at_lines(now[key])
        else:
            on[port][:, k] = how.found[key] + scene.at_lines(now.get(key, 0.0) - how.base[key])
    return on


def mean_torques(scene: Scene, p: Parameters, effects: Sequence[Effect]) -> Array:
    """The mean torques [n] of the motors as they act, behind what the gains of `effects` are at rest."""
    arm, mean = known(scene, p), scene.means[0]
    for effect in effects:
        gain = effect.torque_gain(np.zeros(1, dtype=complex), arm)
        mean = mean if gain is None else mean * gain[0].real
    return mean


def carried_by(scene: Scene, mean_tau: Array, means: Mapping[tuple[str, int], float]) -> Array:
    """The mean torques [n] of the springs under those of the motors and the `means` of forces at ports of live joints (joint side)."""
    carried = scene.N * mean_tau
    for (port, k), mean in means.items():
        carried[scene.arm.live[k]] += mean if port == "motor" else 0.0
    return carried


def _motion(
    scene: Scene,
    p: Parameters,
    linear: Extra,
    on: Mapping[str, Complex],
    doubts: Mapping[str, Array],
    mean_tau: Array,
    means: Mapping[tuple[str, int], float],
) -> tuple[Motion, Complex]:
    """The motion of all joints and the angles [L, m] of the links, from the measured angles and torques under the forces found so far,
    and their `means` (joint side)."""
    arm, live, s = scene.arm, scene.arm.live, scene.s[:, None]
    N, m = arm.N, len(live)
    theta = scene.theta - on["reading"]
    theta = theta if linear.angle_gain is None else theta / linear.angle_gain
    tau = scene.acting_torque(linear.torque_gain)
    x, K = theta / N, p.K[live] + s * p.D_spring[live]
    rotor = s**2 * (N**2 * p.J_m[live]) + s * (N**2 * p.D[live])
    by_motor = N * tau + on["motor"] - rotor * x  # but for the `pull` of links on motors
    by_spring = K * x + on["spring"]
    hung = stiffness(arm, p, scene.s, linear.impedance)[3]  # of links on their springs
    links = hung - _diagonal(K)
    by_link, pull = on["link"], np.zeros_like(hung)
    if linear.impedance is not None:
        to_motors, to_links, pull = linear.impedance[:, :m], linear.impedance[:, m:], linear.impedance[:, :m, m:]
        by_motor = by_motor - times(to_motors[:, :, :m], x)
        by_link = by_link - times(to_links[:, :, :m], x)

    tau_error, theta_error = scene.noise
    torque, gear = np.abs(by_motor), np.abs(N)
    errors = {
        "motor": gear * tau_error + np.abs(rotor) / gear * theta_error + TRUST * np.abs(N * tau),
        "spring": np.abs(K) / gear * theta_error + TRUST * torque,
        "link": np.abs(K) / gear * theta_error + TRUST * torque,
    }
    a, b, c = (1.0 / (error + doubts[port] * (torque + np.abs(on[port]))) ** 2 for port, error in errors.items())
    total = a + b + c
    rows = [  # of q, two equations of the springs' torque each
        (np.sqrt(a * b / total), _diagonal(K) - pull, by_spring - by_motor),
        (np.sqrt(a * c / total), links + pull, by_motor + by_link),
        (np.sqrt(b * c / total), hung, by_spring + by_link),
    ]
    A = np.concatenate([w[..., None] * row for w, row, _ in rows], axis=1)
    right = np.concatenate([w * value for w, _, value in rows], axis=1)[..., None]
    adjoint = np.swapaxes(A.conj(), 1, 2)
    q = products(inverses(products(adjoint, A)), products(adjoint, right))[..., 0]
    by_motor = by_motor - times(pull, q)
    by_links = times(links, q) - by_link
    spring = np.asarray((a * by_motor + b * (by_spring - K * q) + c * by_links) / total, dtype=complex)

    carried = carried_by(scene, mean_tau, means)
    return motion_of(scene, p, theta, (mean_tau, tau), q, spring, carried, np.zeros(scene.n)), q


def motion_of(
    scene: Scene,
    p: Parameters,
    theta: Complex,
    tau: tuple[Array, Complex],
    q: Complex,
    spring: Complex,
    carried: Array,
    besides: Array,
) -> Motion:
    """The motion of all joints, of what the live ones do at the lines [L, m]: motor angles, torques and their means [n], links, springs'
    torques.

    Springs carry `carried` [n, N m] on the mean, `besides` [n] of it not by K; clamped joints are told at rest.
    """
    s, x = scene.s[:, None], theta / scene.arm.N
    mean_theta = scene.means[1]
    twist, still = (carried - besides) / p.K, np.zeros(scene.n)
    signals = {
        "theta": (mean_theta, theta), "omega": (still, s * theta), "tau": tau,
        "q": (mean_theta / scene.N - twist, q), "q_rate": (still, s * q),
        "deflection": (twist, x - q), "deflection_rate": (still, s * (x - q)), "spring": (carried, spring),
    }  # fmt: skip
    means = signals["q"][0], twist
    return Motion(1.0 / (scene.f0 * scene.samples), scene.N, p.K, Lined(scene, signals), scene.strays, means)


@dataclass(frozen=True, eq=False)
class Lined:
    """Signals of a record, each by its means [n] and what the live joints do at the lines [L, m]."""

    scene: Scene
    signals: Mapping[str, tuple[Array, Complex]]

    def __call__(self, name: str, joint: int) -> Array:
        """One signal of a joint in time [S]."""
        mean, lines = self.signals[name]
        place = np.flatnonzero(self.scene.arm.live == joint)
        return mean[joint] + self.scene.in_time(lines[:, place]).sum(axis=1)


def _diagonal(values: Complex) -> Complex:
    """Diagonal matrices [L, m, m] of `values` [L, m]."""
    return np.asarray(values[..., None] * np.eye(values.shape[1]))


def second_order(scene: Scene, p: Parameters, effects: Sequence[Effect], links: Complex, motion: Motion) -> Complex:
    """Forces [L, m] on the links of second order in their angles [L, m] about the posture, beside which the `motion` may be: Coriolis,
    centrifugal, what J and gravity change by, and what comes back from a structure that gives."""
    scene, live = replace(scene.narrow, oversampled=OF_PRODUCTS), scene.arm.live
    assert scene.slopes is not None
    dJ, dK = scene.slopes[0] @ p.alpha, scene.slopes[1] @ p.gravity  # [k, i, j]
    q, v, a = (scene.in_time(scene.s[:, None] ** order * links) for order in range(3))
    q = q + _aside(scene, effects, motion)
    force = scene.at_lines(of_second_order(dJ, dK, q, v, a))
    giving = [e for e in effects if isinstance(e, Giving)]
    if giving:
        whole = np.zeros((3, len(q), scene.n))
        whole[:, :, live] = q, v, a
        swing = Swing(whole[0], whole[1], whole[2], scene.at_lines, scene.in_time)
        back = giving[-1].second_order(scene.s, known(scene, p, giving[:-1]), swing)
        force += 0.0 if back is None else back[:, live]
    return force


def _aside(scene: Scene, effects: Sequence[Effect], motion: Motion) -> Array:
    """How far the live links are from the posture [m] on the mean, beside which an effect may have put them: stuck, or in another tooth.
    Not where a spring that is stiffer or softer would have them there, or the encoder reads from another zero than the posture is told by."""
    live = scene.arm.live
    if motion.means is None:
        return np.zeros(len(live))
    rest, sag = motion.means
    offset = sum((effect.posture(scene.posture) - scene.posture for effect in effects), np.zeros(scene.n))
    aside = rest + offset - scene.posture
    return np.where((np.abs(aside) > SAGS * np.abs(sag)) & (np.abs(aside) < ASIDE), aside, 0.0)[live]
