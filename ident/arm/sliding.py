"""Dry friction and the velocity that it leaves a joint, over a period: each is a function of the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray
from scipy.signal import resample
from scipy.sparse.linalg import LinearOperator, gmres

from ident.arm.acting import Slid
from ident.arm.likely_motion import Force
from ident.arm.scene import Scene
from ident.records.campaign import Array
from ident.records.frf import Complex

#: Turns to a force and what it stops, turns that are mixed, the change that ends them; times that the best line is found from
#: which they start; turns after which Newton's steps are tried where slopes of friction are the same but for this share.
TURNS, MEMORY, SLID, BALANCES = 60, 8, 1e-4, 3
SOON, EVENLY = 8, 0.5
#: Share by which inner products of a turn with itself are lifted where turns are mixed.
RIDGE = 1e-4
#: Share by which turns change that are near to settle and do not; Newton's steps to a motion, shares of a step that are tried, what
#: is left when they end; what of a slope is felt, samples at which it is solved for at once, and directly where gmres does not; what
#: that leaves, and takes.
NEARLY, CLOSER, SHARES, CLOSE = 0.1, 12, (1.0, 0.5, 0.25), 1e-6
FELT, AT_ONCE, MOST_DENSE = 1e-3, 400, 2500
LEFT, KRYLOV, RESTARTS = 1e-2, 60, 4
#: Share of itself by which a turn changes what has settled; how far aside, as a share of it, and of its change, a tangent is told,
#: and what gmres leaves of that along it; its steps for one of Newton's, and most of these.
SETTLED, ASIDE, ALONG, INNER, OUTER = 1e-5, 1e-3, 0.1, 40, 12
#: Steps to the velocity at which a law has a force, each along a tangent as wide as this share of the velocities.
TANGENTS, TANGENT = 12, 1e-6
#: Share of the largest torque to which that force is found; least slope of force and line, as a share of that of the line.
MET, STEEP = 1e-9, 1e-3
#: Samples that are not there yet are looked at alone when they are less than this share.
FEWER, EVERYWHERE = 0.7, slice(None)

#: Friction at some k of the samples: its force [k] by the velocity [k] there.
Where = NDArray[np.int64] | slice
Friction = Callable[[Where], Callable[[Array], Array]]


def told_by(x: Array, samples: int) -> Array:
    """A period x [S] told by so many samples."""
    S = len(x)
    return x if S == samples else np.interp(np.arange(samples) * (S / samples), np.arange(S), x, period=S)


def balanced(scene: Scene, friction: Callable[[Array], Array], v0: Complex, Y: Complex) -> Array:
    """The velocity [S] v = v0 - Y friction(v), the best line through friction and velocity in friction's place: right for a
    joint that sticks."""
    v = scene.in_time(v0[:, None])[:, 0]
    for _ in range(BALANCES):
        slope = float(friction(v) @ v) / max(float(v @ v), 1e-300)
        v = scene.in_time((v0 / (1.0 + Y * slope))[:, None])[:, 0]
    return v


def in_turns(
    scene: Scene,
    friction: Friction,
    g: float,
    v0: Complex,
    Y: Complex,
    starts: Sequence[Array],
    turns: int,
    reach: float = 0.0,
    driven: Complex | None = None,
) -> tuple[Force, Array, Slid]:
    """The force of `friction` where v = v0 - Y friction(v), from the w = friction(v) + g v of `starts` that a turn changes
    least; the slope of friction [S] there; v and friction. Friction is against velocities beyond `reach`."""
    S = scene.samples
    by_ports = _by_harmonics(scene, v0[:, None], Y[:, None, None], None if driven is None else driven[:, None])
    alone, gives = by_ports[0][:, 0], by_ports[1][:, 0, 0]
    met, force = Meeting(friction, g, reach, starts[0] / g, starts[0], np.zeros(S)), np.zeros_like(alone)

    def turn(w: Array) -> Array:
        """By how much w changes."""
        nonlocal force
        v = met.goes(w)
        f = w - g * v
        left = np.fft.rfft(f - g * v)
        v_lines = (alone - gives * left) / (1.0 + g * gives)
        force = left + g * v_lines
        force[0] = f.sum()
        v_lines[0] = 0.0  # a constant torque moves nothing for ever: what is needed is there
        return np.asarray(np.fft.irfft(force + g * v_lines, S) - w)

    def step(w: Array, evenly: bool = False) -> Array | None:
        """Newton's step from the w of the last turn; none where friction does not give `evenly` all the time, if it is to."""
        v = met.v
        slope = _slope(friction(EVERYWHERE), v)
        if evenly and np.ptp(slope) > EVENLY * np.abs(np.median(slope)):
            return None
        left = np.fft.irfft(alone - gives * np.fft.rfft(w - g * v), S) - v
        return (slope + g) * along_tangent(gives, slope, left)

    turned = [(turn(w), w) for w in starts]
    change, w = min(turned, key=lambda one: norm(one[0]) / (norm(one[0] + one[1]) + 1e-300))
    w = w + change
    enough = SLID * float(norm(w))
    w, left = _mixed(turn, w, min(turns, SOON), enough)
    if left > SLID:  # what sticks all the time is there in a step or two
        w, left = _stepped(turn, lambda _, w: step(w, evenly=True), w, enough)
    if left > SLID and turns > SOON:
        w, left = _mixed(turn, w, turns - SOON, enough)
        if left > SLID and turns >= TURNS:
            w, left = _stepped(turn, lambda _, w: step(w), w, enough)
    v, f = met.v, w - g * met.v
    slope = _slope(friction(EVERYWHERE), v)
    there = Force(np.asarray(-force[scene.lines] * (2.0 / S), dtype=complex), -float(force[0].real) / S)
    return there, slope, (v.astype(np.float32), f.astype(np.float32))


def in_turns_at_once(
    scene: Scene,
    frictions: Sequence[Friction],
    g: Array,
    v0: Complex,
    Y: Complex,
    starts: Sequence[Array],
    turns: int,
    reaches: Sequence[float],
    driven: Complex,
) -> tuple[list[Force], bool, list[Slid]]:
    """As `in_turns` at P ports that move each other, v0 [L, P] and Y [L, P, P], from one w each with its own g [P]: their forces, whether
    no friction falls with speed, and v and friction of each. It converges as at one port: all of them give back no more than they got.
    """
    S, P = scene.samples, len(frictions)
    alone, gives = _by_harmonics(scene, v0, Y, driven)
    eased = np.linalg.inv(np.eye(P) + gives * g)
    alone, gives = (eased @ alone[..., None])[..., 0], eased @ gives
    ports = zip(frictions, g.tolist(), reaches, starts, strict=True)
    met = [Meeting(friction, by, reach, w / by, w, np.zeros(S)) for friction, by, reach, w in ports]
    size, force = np.array([[norm(w) + 1e-300] for w in starts]), np.zeros_like(alone)

    def turn(whole: Array) -> Array:
        """By how much the w of all ports change, each by its size."""
        nonlocal force
        w = size * whole.reshape(P, S)
        v = np.stack([one.goes(at) for one, at in zip(met, w, strict=True)])
        f = w - g[:, None] * v
        left = np.fft.rfft(f - g[:, None] * v).T
        v_lines = alone - (gives @ left[..., None])[..., 0]
        force = left + g * v_lines
        force[0], v_lines[0] = f.sum(axis=1), 0.0
        return np.asarray(((np.fft.irfft((force + g * v_lines).T, S) - w) / size).ravel())

    w = (np.stack(starts) / size).ravel()
    w = w + turn(w)
    w, _ = _mixed(turn, w, turns, SLID * float(norm(w)))
    f = size * w.reshape(P, S) - g[:, None] * np.stack([one.v for one in met])
    rises = all(_slope(friction(EVERYWHERE), one.v).min() >= 0.0 for friction, one in zip(frictions, met, strict=True))
    forces = [Force(-row[scene.lines] * (2.0 / S), -float(row[0].real) / S) for row in force.T]
    return forces, rises, [(one.v.astype(np.float32), own.astype(np.float32)) for one, own in zip(met, f, strict=True)]


def _by_harmonics(scene: Scene, v0: Complex, Y: Complex, driven: Complex | None) -> tuple[Complex, Complex]:
    """How P ports move by themselves [S/2 + 1, P] and what they give [S/2 + 1, P, P], `driven` by what acts beyond the lines, too.

    Friction has harmonics beyond the lines; there a port is what it is at the last line, a mass.
    """
    S, last = scene.samples, scene.lines[-1]
    beyond = np.arange(last + 1, S // 2 + 1)
    alone, gives = (np.zeros((S // 2 + 1, *of.shape[1:]), dtype=complex) for of in (v0, Y))
    alone[scene.lines], gives[scene.lines] = v0 * (S / 2), Y
    gives[beyond] = Y[-1] * (last / beyond)[:, None, None]
    if driven is not None:
        alone += (gives @ driven[..., None])[..., 0] * (S / 2)
    return alone, gives


def _stepped(
    turn: Callable[[Array], Array],
    step: Callable[[Array, Array], Array | None],
    w: Array,
    enough: float,
    most: int = OUTER,
) -> tuple[Array, float]:
    """Newton's steps from w [W], as `step` has them for what a turn changes there, until that is `enough` or falls no more; returns the w
    of the last turn, and the share by which that changes."""
    change = turn(w)
    for _ in range(most):
        if not norm(change) > enough:
            break
        aside = step(change, w)
        if aside is None:
            break
        for share in SHARES:
            there, left = w + share * aside, turn(w + share * aside)
            if norm(left) < (1.0 - 0.5 * share) * norm(change):
                break
        else:
            turn(w)
            break
        w, change = there, left
    return w, float(norm(change) / (norm(w) + 1e-300))


def closer(
    law: Callable[[Array], Array],
    alone: Array,
    gives: Complex,
    x: Array,
    samples: int | None = None,
    near: float = np.inf,
) -> tuple[Array, Array, float]:
    """Motion x [S] and the force of a `law` there [T], closer to where x = alone - gives law(x), [S] and [S/2 + 1] by harmonics, from x
    near it: Newton's steps; and the share of x that is left. Where that is more than `near` none is made.

    The law is told at T `samples` of the period, S or a power of two more: of what bends at once S of them alone see other harmonics than
    there are.
    """
    S, T = len(x), samples or len(x)

    def finer(x: Array) -> Array:
        return x if T == S else np.asarray(resample(x, T))

    def turn(x: Array) -> Array:
        return alone - np.fft.irfft(gives * np.fft.rfft(law(finer(x)))[: S // 2 + 1] * (S / T), S) - x

    def slope(x: Array) -> Array:
        return np.asarray(np.roll(_slope(law, finer(x)), T // S // 2).reshape(S, -1).mean(axis=1))

    def step(change: Array, x: Array) -> Array:
        return along_tangent(gives, slope(x), change)

    far = not norm(turn(x)) < near * norm(x)
    x, left = _stepped(turn, step, x, CLOSE * float(norm(x)), 0 if far else CLOSER)
    return x, law(finer(x)), left


def settled(turn: Callable[[Array], Array], w: Array, turns: int) -> Array:
    """The w [W] that a turn changes least, from one near to it: `turn` says by how much. Turns are mixed; where these come near but do
    not settle, Newton's steps are made."""
    w, left = _mixed(turn, w, turns, SETTLED * float(norm(w)))
    if turns < TURNS or not SETTLED < left < NEARLY:
        return w
    return _stepped(turn, lambda change, w: _along_turns(turn, w, change), w, SETTLED * float(norm(w)))[0]


def _along_turns(turn: Callable[[Array], Array], w: Array, change: Array) -> Array:
    """The step u [W] from w that takes its `change` away, along a tangent that is told by turns from a little aside."""
    aside = min(ASIDE * float(norm(w)), ALONG * float(norm(change)))

    def by(u: Array) -> Array:
        share = aside / max(float(norm(u)), 1e-300)
        return np.asarray((change - turn(w + share * u)) / share)

    tangent = LinearOperator((len(w), len(w)), matvec=by)
    return np.asarray(gmres(tangent, change, rtol=ALONG, restart=INNER, maxiter=1)[0])


def along_tangent(gives: Complex, slope: Array, left: Array) -> Array:
    """The step u [S] that takes `left` away: u + y = left, where y is what `gives` makes of the force slope u.

    What gives against the usual slope as well is solved for exactly, by harmonics; where the slope is another, at the samples alone if
    they are few, else in Krylov's space, where that is small: what sticks at many samples takes one of their own size.
    """
    S = len(left)
    usual = float(np.median(slope))
    gives = np.append(gives[:-1], gives[-1].real)  # which is all that samples tell of their highest harmonic
    eased, apart = 1.0 / (1.0 + usual * gives), slope - usual

    def given(by: Complex, x: Array) -> Array:
        return np.fft.irfft(by * np.fft.rfft(x), S)

    yields = np.fft.irfft(eased * gives, S)
    felt = np.flatnonzero(np.abs(apart) * np.abs(yields).sum() > FELT)
    if len(felt) > AT_ONCE:
        whole = LinearOperator((S, S), matvec=lambda x: x + given(gives, apart * given(eased, x)))
        dense = len(felt) <= MOST_DENSE
        found, missed = gmres(whole, left, rtol=LEFT, restart=KRYLOV, maxiter=1 if dense else RESTARTS)
        if not (missed and dense):
            return given(eased, found)
    alone = given(eased, left)
    by_samples = yields[(felt[:, None] - felt) % S] * apart[felt] + np.eye(len(felt))
    force = np.zeros(S)
    with suppress(np.linalg.LinAlgError):  # else as if the usual slope were everywhere
        force[felt] = apart[felt] * np.linalg.solve(by_samples, alone[felt])
    return alone - given(eased * gives, force)


def _slope(law: Callable[[Array], Array], v: Array) -> Array:
    """The slope of a law [S] at v."""
    h = _tangent(v)
    return (law(v + h) - law(v)) / h


def _tangent(v: Array) -> float:
    """How wide a tangent is, of a law at velocities v."""
    return TANGENT * float(np.abs(v).max() + 1e-300)


def _mixed(turn: Callable[[Array], Array], w: Array, turns: int, enough: float) -> tuple[Array, float]:
    """Turns from w [S], each from where the last ones, mixed, seem to lead (D. G. Anderson, J. ACM 12 (1965), DOI
    10.1145/321296.321305), until one changes w by `enough` or less; returns the w of the last, and the share by which that changes.

    As scipy.optimize.anderson does, which takes all inner products of what it remembers anew at every turn: three times as long
    as the turn itself.
    """
    changes, leads = np.zeros((2, MEMORY, len(w)))  # of the change, and of where it led, from one turn to the next
    products = np.zeros((MEMORY, MEMORY))
    change = turn(w)
    for k in range(turns):
        if not enough < norm(change) < np.inf:  # or no number
            break
        seen = min(k, MEMORY)
        mixed = change.copy()
        if seen:
            lifted = products[:seen, :seen] + RIDGE * np.diag(np.diag(products)[:seen])
            mixed -= np.linalg.lstsq(lifted, changes[:seen] @ change, rcond=None)[0] @ leads[:seen]
        w = w + mixed
        before, change = change, turn(w)
        now = k % MEMORY
        changes[now] = change - before
        leads[now] = mixed + changes[now]
        products[now] = products[:, now] = changes @ changes[now]
    return w, float(norm(change) / (norm(w) + 1e-300))


@dataclass
class Meeting:
    """Velocities `v` [S] where `friction`(v) + g v is `w` [S], and about the slope of friction there: from one w to the next.

    Friction is against v beyond `reach`.
    """

    friction: Friction
    g: float
    reach: float
    v: Array
    w: Array
    slope: Array

    def goes(self, w: Array) -> Array:
        """The velocities for another w: Newton's steps, kept in a bracket, the first one along the slopes known already; more are made
        only where it is not met yet."""
        g, v, slope = self.g, self.v, self.slope
        low, high = np.minimum(w / g, -self.reach), np.maximum(w / g, self.reach)
        v, more = np.clip(v, low, high), w - self.w
        low, high = np.where(more > 0.0, v, low), np.where(more < 0.0, v, high)
        v = np.clip(v + more / np.maximum(slope + g, STEEP * g), low, high)
        h = _tangent(v)
        small = MET * float(np.abs(w).max())
        where: Where = EVERYWHERE
        for _ in range(TANGENTS):
            force, at = self.friction(where), v[where]
            f = force(at)
            error = f + g * at - w[where]
            far = np.flatnonzero(np.abs(error) >= small)
            if not len(far):
                break
            if len(far) < FEWER * len(at):
                where = far if isinstance(where, slice) else where[far]
                force, at, f, error = self.friction(where), at[far], f[far], error[far]
            lowest, highest = np.where(error < 0.0, at, low[where]), np.where(error > 0.0, at, high[where])
            low[where], high[where] = lowest, highest
            slope[where] = tangent = (force(at + h) - f) / h
            step = at - error / np.maximum(tangent + g, STEEP * g)
            inside = (step >= lowest) & (step <= highest)  # it may be there already
            v[where] = np.where(inside, step, 0.5 * (lowest + highest))
        self.v, self.w = v, w
        return v
