"""Dry friction at ports of an arm, and the velocities that it leaves them.

Friction f(v) = w - g v and what moves the port, v = v0 - Y f, are met in turns (J. Douglas, H. H. Rachford, Trans. AMS 82
(1956), DOI 10.1090/S0002-9947-1956-0084194-4; P.-L. Lions, B. Mercier, SIAM J. Numer. Anal. 16 (1979), DOI
10.1137/0716071): it converges for any friction that grows with speed at any port that gives back no more than it got,
slowly where a joint slides; so the turns are mixed. So it does at several ports at once, Y a matrix: one after the other they may
answer each other by more than they were asked.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.arm.acting import Slid
from ident.arm.likely_motion import Force, Forces, Key, LikelyMotion
from ident.arm.sliding import EVERYWHERE, TURNS, Friction, Where, balanced, in_turns, in_turns_at_once, told_by
from ident.effects.base import PeriodicLaw
from ident.effects.motion import Motion, over_periods
from ident.records.campaign import Array

#: Resistances [of the median one of the port] that damp turns to dry friction, tried by turns; behind a spring this share of them.
DAMPED, BEHIND = (0.5, 2.0, 0.125), 0.25
#: chi^2 per degree of freedom below which no other force is looked for.
EXPLAINED = 2.0


@dataclass(frozen=True, eq=False)
class Rubbing:
    """A port where dry laws act: their `friction` against velocities beyond `reach`, the `measured` velocity [S], and the `side` [+-1] that
    its motor turns the joint to."""

    key: Key
    friction: Friction
    reach: float
    measured: Array
    side: float

    @staticmethod
    def of(arm: LikelyMotion, key: Key, laws: Sequence[PeriodicLaw], motion: Motion) -> Rubbing:
        """The port `key` of an arm that moves like `motion`, `laws` at it."""
        port, k = key
        joint = int(arm.scene.arm.live[k])
        N = float(arm.scene.arm.N[k]) if port == "motor" else 1.0
        state, astray = motion.state(joint), motion.astray(port, joint)
        position, measured = state.at(port)

        def friction(where: Where) -> Callable[[Array], Array]:
            here, place = state if where is EVERYWHERE else state.when(where), position[where]
            away = astray if astray is None or where is EVERYWHERE else astray.when(where)

            def force(v: Array) -> Array:
                moved = here.moved(port, place, v)
                forces = over_periods(lambda at: sum(law.over_period(at) for law in laws), moved, port, away)
                return np.asarray(-abs(N) * forces, dtype=float)

            return force

        reach = 0.0 if astray is None else float((np.abs(astray.mean) + astray.most).max())
        return Rubbing(key, friction, reach, measured, float(np.sign(N)))

    def resists(self, times: float, Y: Array) -> float:
        """The resistance that damps turns at a port that gives Y [L]."""
        return times * (BEHIND if self.key[0] == "link" else 1.0) / float(np.median(np.abs(Y)))

    def driven(self, arm: LikelyMotion) -> Array:
        """The torques [S/2 + 1] that drive its motor beyond the lines."""
        port, k = self.key
        by_motor = arm.images[:, k] * abs(arm.scene.arm.N[k])
        return by_motor if port == "motor" else np.zeros_like(by_motor)

    def on_joint(self, force: Force) -> Force:
        """The force as it acts on the joint."""
        return Force(self.side * force.lines, self.side * force.mean)


def as_last(arm: LikelyMotion, key: Key, last: Slid) -> Force:
    """The dry force at a port as it was found `last`."""
    scene, (port, k) = arm.scene, key
    side = float(np.sign(scene.arm.N[k])) if port == "motor" else 1.0
    return Force.of(scene, -side * told_by(last[1].astype(float), scene.samples))


def sliding(
    arm: LikelyMotion, port: Rubbing, on: Forces, start: Force, turns: int, last: Slid | None
) -> tuple[Force, Slid]:
    """The dry force at a port, of the velocity that it leaves, from `start` under the forces `on` besides, or from where it was found `last`."""
    scene, key, friction = arm.scene, port.key, port.friction(EVERYWHERE)
    v0, Y = arm.rate(key, on)
    Y = port.side * Y
    best, found, least = start, last, np.inf
    alone = scene.in_time(np.stack([v0, port.side * start.lines], axis=1))
    driven = port.driven(arm)

    def likely(g: float) -> list[Array]:
        return [friction(v) + g * v for v in (port.measured, balanced(scene, friction, v0, Y))]

    ways: list[Callable[[float], list[Array]]] = [likely, lambda g: [g * alone[:, 0] - alone[:, 1]]]
    tries = [(times, way) for times in DAMPED for way in ways]
    if last is not None:
        v, f = (told_by(x, scene.samples) for x in last)
        tries.insert(0, (DAMPED[0], lambda g: [f + g * v]))
    for times, way in tries:
        g = port.resists(times, Y)
        force, slope, ends = in_turns(scene, port.friction, g, v0, Y, way(g), turns, port.reach, driven)
        force = port.on_joint(force)
        misfit = arm.misfit(on | {key: on[key].plus(force)})
        found = ends if found is None else found
        if misfit < least:  # else it is no number: a law that is far too strong
            best, found, least = force, ends, misfit
        if turns < TURNS or least < EXPLAINED * arm.degrees or slope.min() >= 0.0:
            break  # friction that never falls with speed is met in one motion only
    assert found is not None
    return best, found


def sliding_together(
    arm: LikelyMotion, ports: Sequence[Rubbing], on: Forces, turns: int, last: Mapping[Key, Slid]
) -> tuple[Forces, dict[Key, Slid]]:
    """As `sliding` at several ports that move each other, under the forces `on` besides: from where all were found `last`, or from the
    measured velocities."""
    scene, keys = arm.scene, [port.key for port in ports]
    v0, Y = arm.rates(keys, on)
    Y = Y * np.array([port.side for port in ports])
    driven = np.stack([port.driven(arm) for port in ports], axis=1)
    begins = [[(port.friction(EVERYWHERE)(port.measured), port.measured) for port in ports]]
    if all(key in last for key in keys):
        there = [[told_by(x.astype(float), scene.samples) for x in last[key]] for key in keys]
        begins.insert(0, [(f, v) for v, f in there])
    best: tuple[Forces, dict[Key, Slid]] | None = None
    least = np.inf
    for times, begin in ((times, begin) for times in DAMPED for begin in begins):
        g = np.array([port.resists(times, Y[:, i, i]) for i, port in enumerate(ports)])
        starts = [f + by * v for by, (f, v) in zip(g, begin, strict=True)]
        reaches = [port.reach for port in ports]
        forces, rises, ends = in_turns_at_once(
            scene, [port.friction for port in ports], g, v0, Y, starts, turns, reaches, driven
        )
        found = {key: port.on_joint(force) for key, port, force in zip(keys, ports, forces, strict=True)}
        misfit = arm.misfit(on | {key: on[key].plus(force) for key, force in found.items()})
        if best is None or misfit < least:
            best, least = (found, dict(zip(keys, ends, strict=True))), misfit
        if turns < TURNS or least < EXPLAINED * arm.degrees or rises:
            break
    assert best is not None
    return best
