"""How an arm moved under laws that are known: the motion that is likeliest, given what was measured and what a model knows.

A law acts on the true motion, and what is measured of it is noisy: dry friction of a joint that sticks would be all noise.
So the measured angles are smoothed by the model, line by line, each by its own noise (a Wiener filter), and a law's force,
which changes the motion that it is of, is found with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.arm.acting import Moved, Slid, second_order, signals, slope
from ident.arm.arm_model import Parameters, Sampling
from ident.arm.likely_motion import Force, Forces, Key, LikelyMotion
from ident.arm.rattling import Rattling
from ident.arm.rubbing import Rubbing, as_last, sliding, sliding_together
from ident.arm.scene import Scene
from ident.arm.sliding import MEMORY, RIDGE, TURNS, Meeting, settled, told_by
from ident.arm.whitening import Powers
from ident.effects.base import Effect, Law, PeriodicLaw
from ident.effects.motion import Motion
from ident.records.campaign import Array
from ident.records.frf import Complex

#: Times all forces are found from the motion under all the others, and most of them where these load each other.
SWEEPS, MOST_SWEEPS = 3, 30
#: They agree when they change by less than this share, or nearly when the angles do so, by chi^2, by less than that share of the misfit;
#: they never will when this is so many times the least, or has not been less so many times in a row.
SAME, NEARLY, AWAY, IN_VAIN = 1e-4, 0.03, 10.0, 8
#: Later forces agree better: they are taken where they leave less than so many times the least.
HARDLY_MORE = 1.01
#: Steps towards a force that follows from a position, the change that ends them.
STEPS, SETTLED = 20, 1e-4
#: Dry friction stops a joint within so small a part of a sample that it takes so many times as many.
STOPS = 2
#: chi^2 of what the motion changes by where forces of second order, or dry friction, are those of it, below which it is not found again.
MOVED = 1.0
#: Growth of the change from one step to the next, from the least, that ends them too.
DIVERGED = 100.0
#: Share of its stiffness that a spring has everywhere whose torque tells where it is.
TENSE = 0.5
#: Most periods that play is followed for, and in haste: with one turn, none.
PERIODS, SHORT = 12, 4


def smoothed(
    scene: Scene,
    p: Parameters,
    effects: Sequence[Effect],
    start: Moved,
    sampling: Sampling,
    powers: Powers,
    turns: int = TURNS,
    slid: Mapping[Key, Slid] | None = None,
) -> Moved:
    """Returns the motion of a record in which the forces of `effects` are those of this very motion; `start` one near to it.

    `sampling` and noise `powers` are those of the record. Dry friction takes up to `turns`: few are enough to compare by; it is
    looked for from where it was found last, `slid`, and from anywhere if that led away: forces that load each other may do so by more
    than they were.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a law that is far too strong
        found, left, led_away = _smoothed(scene, p, effects, start, sampling, powers, turns, dict(slid or {}))
        if led_away and slid:
            anew, less, _ = _smoothed(scene, p, effects, start, sampling, powers, turns, {})
            found = anew if less < left else found
        return found


def _smoothed(
    scene: Scene, p: Parameters, effects: Sequence[Effect], start: Moved, sampling: Sampling, powers: Powers, turns: int,
    slid: dict[Key, Slid],
) -> tuple[Moved, float, bool]:  # fmt: skip
    """The motion that leaves least, chi^2 that it leaves, and whether forces at several ports led away from it."""
    if any(effect.dry for effect in effects):
        scene = replace(scene, oversampled=STOPS * scene.oversampled)
    arm = LikelyMotion.of(scene, p, effects, start.second, sampling, powers)
    on = {key: Force.of(arm.scene, x) for key, x in signals(arm.scene, effects, start.motion).items()}
    # a force that is not that of the motion it leaves may leave less than noise
    best, least, kept = on, max(arm.misfit(on), float(arm.degrees)), dict(slid)
    laws = {key: _laws(effects, key[0], int(scene.arm.live[key[1]])) for key in on}
    on = on | {key: as_last(arm, key, slid[key]) for key in slid.keys() & on.keys() if laws[key][0]}
    rubbing, springy = ([key for key, at in laws.items() if at[kind]] for kind in (0, 1))
    at_once = all(_at_once(effects, port, int(scene.arm.live[k])) for port, k in on)
    at_once = at_once and (len(on) <= 1 or all(dry for dry, _ in laws.values()))
    hopeless = False
    mixture, vain, most = Mixture(), 0, MOST_SWEEPS if not at_once and turns >= TURNS else SWEEPS
    marches = SWEEPS if rubbing else 1  # a march is of the motion under the friction found until then
    for sweep in range(most):
        before, on = on, _swept(arm, effects, laws, on, slid, turns, sweep < marches)
        misfit = arm.misfit(on)
        vain = 0 if misfit < least else vain + 1
        hopeless = not misfit < AWAY * least or vain == IN_VAIN
        if misfit < HARDLY_MORE * least:  # later sweeps may lead away, and any from what they found
            best, least, kept = on, min(misfit, least), dict(slid)
        agree = all(now.near(on[key], SAME) for key, now in before.items())
        agree = agree or (bool(rubbing) and (at_once or arm.changed(before, on) < MOVED))
        if start.second is not None:  # told by a motion under forces that followed from what was measured
            links = arm.likely(best)[1][arm.inside]
            arm, felt = arm.with_second(second_order(scene, p, effects, links, arm.moving(best)))
            least = arm.misfit(best)
            agree = agree and (felt < MOVED or turns < TURNS)
        if agree or (sweep + 1 >= SWEEPS and (hopeless or arm.changed(before, on) < NEARLY * misfit)):
            break
        on = mixture.leads(before, on) if most > SWEEPS else on
    motion = arm.moving(best)
    moved = replace(
        start, motion=motion, second=None if start.second is None else arm.second[arm.inside],
        found={key: force.lines[arm.inside] for key, force in best.items()},
        base=signals(arm.scene, effects, motion),
        springy={(port, k): motion.at(port, int(scene.arm.live[k]))[0] for port, k in springy},
        rubbing={(port, k): motion.at(port, int(scene.arm.live[k]))[1] for port, k in rubbing},
        slid=kept if len(on) > 1 else slid,
    )  # fmt: skip
    return moved, least, hopeless and len(on) > 1


#: At a port: laws that are dry, or drag beside these, and else others that are no impedances.
Laws = tuple[list[PeriodicLaw], list[PeriodicLaw]]


def _laws(effects: Sequence[Effect], port: str, joint: int) -> Laws:
    springs = _forcing(effects, port, joint)
    if any(law.dry for law in springs):
        return [law for law in springs if law.dry or law.drags], []
    return [], springs


def _forcing(effects: Sequence[Effect], port: str, joint: int) -> list[PeriodicLaw]:
    """The laws at a port that are no impedances."""
    here = [e for e in effects if isinstance(e, PeriodicLaw) and (e.port, e.joint) == (port, joint)]
    return [law for law in here if not law.linear]


def _at_once(effects: Sequence[Effect], port: str, joint: int) -> bool:
    """Whether one sweep finds the force at a port: of friction of its velocity alone, or where nothing is dry."""
    here = _forcing(effects, port, joint)
    return not any(law.dry for law in here) or all((law.dry or law.drags) and not law.by_load for law in here)


def _swept(
    arm: LikelyMotion,
    effects: Sequence[Effect],
    laws: Mapping[Key, Laws],
    on: Forces,
    slid: dict[Key, Slid],
    turns: int,
    march: bool,
) -> Forces:
    """The forces found at one port after the other, those of what is dry at several ports together, each of the motion under those found last;
    `slid` is told, too."""
    rubbing = [key for key in on if laws[key][0]]
    together = rubbing if len(rubbing) > 1 else []  # one after the other each answers the others by more than it was
    if together:
        on = _rubbed(arm, effects, laws, on, slid, turns, together)
    for key in [key for key in on if key not in together]:
        now, motion, (dry, springs) = on[key], arm.moving(on), laws[key]
        others = [e for e in effects if e not in dry and e not in springs]
        beside = signals(arm.scene, others, motion).get(key, np.zeros(arm.scene.samples))
        on = on | {key: Force.of(arm.scene, beside)}
        if dry:
            force, slid[key] = sliding(arm, Rubbing.of(arm, key, dry, motion), on, now, turns, slid.get(key))
            on = on | {key: on[key].plus(force)}
        elif springs:
            force, found = _yielding(arm, key, springs, motion, on, turns, slid.get(key), march)
            on = on | {key: on[key].plus(force)}
            if found is not None:
                slid[key] = found
    return on


def _rubbed(
    arm: LikelyMotion, effects: Sequence[Effect], laws: Mapping[Key, Laws], on: Forces, slid: dict[Key, Slid], turns: int,
    rubbing: Sequence[Key],
) -> Forces:  # fmt: skip
    """The forces with those of what is dry at several ports, `rubbing`, met together; `slid` is told, too."""
    motion, nothing = arm.moving(on), np.zeros(arm.scene.samples)
    others = [e for e in effects if not any(e in laws[key][0] for key in rubbing)]
    there = signals(arm.scene, others, motion)
    on = on | {key: Force.of(arm.scene, there.get(key, nothing)) for key in rubbing}
    ports = [Rubbing.of(arm, key, laws[key][0], motion) for key in rubbing]
    forces, found = sliding_together(arm, ports, on, turns, slid)
    slid.update(found)
    return on | {key: on[key].plus(force) for key, force in forces.items()}


@dataclass
class Mixture:
    """Forces of sweeps, each from where those before, mixed, seem to lead (D. G. Anderson, J. ACM 12 (1965), DOI 10.1145/321296.321305):
    at two ports of a joint each may answer the other by more than it was, and sweeps alone would lead away."""

    sizes: list[float] = field(default_factory=list)
    swept: list[tuple[Array, Array]] = field(default_factory=list)

    def leads(self, before: Forces, found: Forces) -> Forces:
        """Where the forces lead of which the last sweep made `found`, from those `before`."""
        if not self.sizes:
            self.sizes = [float(np.abs([before[key].lines, found[key].lines]).max()) or 1.0 for key in found]
        start, end = self._row(before), self._row(found)
        self.swept = [*self.swept[-MEMORY:], (end - start, end)]
        changes, ends = (np.diff(rows, axis=0) for rows in zip(*self.swept, strict=True))
        products = changes @ changes.T
        if not len(products) or not np.isfinite(products).all():
            return found
        lifted = products + RIDGE * np.diag(np.diag(products))
        mixed = end - np.linalg.lstsq(lifted, changes @ (end - start), rcond=None)[0] @ ends
        parts = zip(found, self.sizes, np.split(mixed, len(found)), strict=True)
        return {
            key: Force(np.array(part[:-1] * size).view(complex), float(part[-1] * size)) for key, size, part in parts
        }

    def _row(self, on: Forces) -> Array:
        """The forces as numbers in a row, each by its size."""
        rows = zip(on.values(), self.sizes, strict=True)
        return np.concatenate([np.append(np.array(x.lines).view(float), x.mean) / size for x, size in rows])


@dataclass(frozen=True, eq=False)
class Port:
    """How a port moves: by itself, `x0` [L] at the lines, and under a force there, `Y` [L]; a spring of stiffness `K` carries a `load` on
    the mean, without K the mean stays. Where it is: amplitudes at the lines and the mean [2 L + 1]."""

    scene: Scene
    x0: Complex
    Y: Complex
    K: float
    load: float

    def moves(self, at: Array) -> Array:
        """Position and velocity [2, S] of where it is."""
        lines = at[:-1].view(complex)
        moving = self.scene.in_time(np.stack([lines, self.scene.s * lines], axis=1))
        return np.asarray(moving.T + np.array([[at[-1]], [0.0]]))

    def place(self, x: Array) -> Array:
        """Where it is, of its position [S]."""
        return np.append(self.scene.at_lines(x).view(float), float(np.mean(x)))

    def left_by(self, F: Array, at: Array, stiffness: float, damping: float) -> Array:
        """Where a force [S] leaves it that was there, a line through the force solved for."""
        line = stiffness + damping * self.scene.s
        lines = (self.x0 + self.Y * (self.scene.at_lines(F) - line * at[:-1].view(complex))) / (1.0 - line * self.Y)
        missing = self.load - self.K * at[-1] - float(F.mean())
        mean = at[-1] + (missing / max(self.K + stiffness, 0.1 * self.K) if self.K else 0.0)
        return np.append(lines.view(float), mean)

    def wound(self, needed: Force, law: Callable[[Array], Array]) -> Array:
        """Where it is [S] when the spring and a `law`(x) have the torque together that a force that is `needed` leaves them."""
        torque = self.K * (self.x0 + self.Y * needed.lines) + needed.lines
        w = self.load + self.scene.in_time(torque[:, None])[:, 0]
        still = np.zeros_like(w)
        reach = 2.0 * float(np.abs(w).max()) / self.K
        return Meeting(lambda _: law, self.K, reach, still, law(still), still.copy()).goes(w)


def _yielding(
    arm: LikelyMotion, key: Key, laws: Sequence[PeriodicLaw], motion: Motion, on: Forces, turns: int, last: Slid | None, march: bool
) -> tuple[Force, Slid | None]:  # fmt: skip
    """The force of `laws` at a port, of the position that it leaves, under the forces `on` besides; and both, if turns to it did not
    settle by themselves: it is looked for from the `last` ones.

    The best lines through force and position, force and velocity are solved for exactly, what is left of the law in turns; where
    these do not settle it may be marched, or is met by Newton's steps.
    """
    scene, (name, k) = arm.scene, key
    joint = int(scene.arm.live[k])
    N = float(scene.arm.N[k]) if name == "motor" else 1.0
    state = motion.state(joint)
    v0, Y = arm.rate(key, on)
    load = float(arm.loads(on)[joint]) - on[key].mean
    port = Port(scene, v0 / scene.s, Y / scene.s, float(arm.p.K[joint]) if name == "spring" else 0.0, load)

    def force(x: Array, v: Array) -> Array:
        moved = state.moved(name, x, v)
        return np.asarray(N * sum(law.over_period(moved) for law in laws), dtype=float)

    x, v = state.at(name)
    at = port.place(x)
    if last is not None:
        at = port.place(told_by(last[0], scene.samples).astype(float))
        x, v = port.moves(at)
    F = force(x, v)
    # the force kept is of this fit from the second sweep on; before, of other parameters
    begin = None if last is None else (x, F if march else told_by(last[1], scene.samples).astype(float))
    best, there, least, size = F, at, np.inf, np.std(F)
    for _ in range(STEPS if last is None else 1):
        at = port.left_by(F, at, slope(x, F), slope(v, F))
        x, v = port.moves(at)
        before, F = F, force(x, v)
        change = float(np.std(F - before))
        if change < least:
            best, there, least = F, at, change
        if not DIVERGED * least > change > SETTLED * size:
            break
    if not least > SETTLED * size:
        return Force.of(scene, best), None if last is None else _kept(port.moves(there)[0], best)
    instant = all(isinstance(law, Law) for law in laws)  # of no memory
    if instant and np.array_equal(F[::-1], force(x[::-1], 0.0 * v)):  # of x alone
        by_place: Callable[[Array], Array] = lambda x: force(x, 0.0 * x)
        found = _as_told(arm, key, on, port, by_place, best) if name == "spring" else None
        if found is None:
            rest, yields = (port.load / port.K, 1.0 / port.K) if port.K else (float(at[-1]), 0.0)
            rattling = Rattling(arm, key, on, by_place, rest, yields)
            periods = PERIODS if turns >= TURNS else SHORT if turns > 1 else 0
            found = rattling.likeliest(*(begin or (x, best)), periods if march else 0)
        return Force.of(scene, found), _kept(port.moves(port.left_by(found, at, 0.0, 0.0))[0], found)
    x, v = port.moves(there)
    line = slope(x, best), slope(v, best)
    x, v = port.moves(settled(lambda at: port.left_by(force(*port.moves(at)), at, *line) - at, there, turns))
    F = force(x, v)
    better = min(best, F, key=lambda force: arm.misfit(on | {key: on[key].plus(Force.of(scene, force))}))
    return Force.of(scene, better), _kept(x, F)


def _as_told(
    arm: LikelyMotion, key: Key, on: Forces, port: Port, law: Callable[[Array], Array], found: Array
) -> Array | None:
    """The force [S] that a spring has by its `law` where it is by the torque that motor and link tell of it, if that explains the record
    better than the one `found`.

    A spring that hardens by more than it is stiff has more than one motion, and turns lead away from all of them; but of its torque
    it is a function that is even softer than that of its stiffness.
    """

    def misfit(force: Array) -> float:
        return arm.misfit(on | {key: on[key].plus(Force.of(arm.scene, force))})

    x = port.wound(arm.needed(key, on), law)
    told, ahead = law(x), np.linspace(x.min(), x.max(), len(x))
    tense = np.diff(port.K * ahead + law(ahead)).min() > TENSE * port.K * (ahead[1] - ahead[0])
    return told if tense and misfit(told) < misfit(found) else None


def _kept(x: Array, F: Array) -> Slid:
    """A position and the force there, to go on from."""
    return x.astype(np.float32), F.astype(np.float32)
