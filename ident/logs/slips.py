"""Slips that make a log another robot's: a sign, a unit, a gear ratio, columns, a sampling rate. Each is put right, and what the declared arm leaves
is compared: that it falls to a part, at a joint, and grows nowhere, is nothing that links, friction, zeros and delays of a sound log do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import minimize_scalar

from ident.logs.plausible_arm import Left, Sight, left
from ident.loop.effect_words import percent
from ident.records.log import Array, Log
from ident.records.signal_faults import REFUSE, Fault

#: A log whose plausible arm leaves less than this of each joint's torque has no slip that is looked for by what it leaves.
SOUND = 0.1
#: A slip's own joint leaves more than this part of that.
OWN = 0.5
#: Put right, a slip leaves of some joint's torque less than this part of what is left with it, or `FINE`; all counts half, and no joint much more.
PART, FINE, HALF, WORSE = 0.25, 0.02, 0.5, 1.5
#: First these are looked at with so much to spare, zeros that are off left aside.
ROUGH = 1.6
#: A unit explains what others by this factor do not explain better.
BESIDE = 1.6
#: Slips that leave the same but for this are both told.
SAME = 0.1
#: Gear ratios, and sampling rates, in declared ones, that are looked at before the best is looked for; nearer to 1 than so it is none,
#: a rate where no gravity tells it from rotors nearer than the last.
RATIOS, RATES = (0.25, 0.35, 0.5, 0.7, 1.4, 2.0, 2.8, 4.0), np.geomspace(0.1, 10.0, 21)
CLOSE, CLOSE_RATE, FAR_RATE = 1.15, 1.03, 1.8
#: A rate that is off leaves this many times as much of squares, with all links and rotors as declared, and explains torques to this.
CLEARLY, EXPLAINS = 16.0, 0.05
_DEGREES = 180 / np.pi


@dataclass(frozen=True)
class Slip:
    """`name` and `joint` (empty: all) of a fault, `line` what is wrong and what to do, `right` the log without it. A slip of a `factor` is right for
    another one, too: is it the best one?"""

    name: str
    joint: str
    line: str
    right: Callable[[float], Sight]
    factor: bool = False


def _always(right: Callable[..., Sight], *how: object) -> Callable[[float], Sight]:
    """What puts a slip right that has no factor."""
    return lambda _: right(*how)


def slips(log: Log, sight: Sight) -> tuple[Fault, ...]:
    """Returns the slips of a log, the one that explains most first."""
    found: list[Fault] = []
    before = left(sight)
    for _ in range(2 * log.n):
        best = _best(log, sight, before) if np.any(before.share > SOUND) else None
        if best is None:
            break
        fault, sight, before = best
        found.append(fault)
    if not found and (rate := _slightly_off(log, sight)) is not None:
        found.append(rate)
    return tuple(found)


def _best(log: Log, sight: Sight, before: Left) -> tuple[Fault, Sight, Left] | None:
    """The slip that explains most of what is left, the log without it, and what is left then."""
    tried, roughly = [], left(sight, zeros=False)
    for slip in _slips(log, sight, before):
        right = slip.right(1.0)
        if _better(roughly, left(right, zeros=False), ROUGH) and _better(before, after := left(right)):
            tried.append((slip, right, after))
    tried.sort(key=lambda one: one[2].count)
    good = [one for one in tried if one[2].count < (1 + SAME) * tried[0][2].count + log.n and not _other(*one)]
    if not good:
        return None
    (slip, right, after), more = good[0], [one[0].line for one in good[1:3]]
    j = int(np.argmax(before.share / np.maximum(after.share, FINE)))
    line = (
        f"{'; or '.join([slip.line, *more])}: {percent(before.share[j])} of {log.joints[j]}'s torque is none of the declared arm's, and with that put "
        f"right {percent(after.share[j])}"
    )
    return Fault(slip.name, slip.joint, "", line, REFUSE), right, after


def _better(before: Left, after: Left, rough: float = 1.0) -> bool:
    """Whether what is left falls as it does where a slip is put right."""
    falls = bool(np.any(np.maximum(after.share, FINE) < rough * PART * before.share))
    return (
        falls
        and after.count < rough * HALF * before.count
        and bool(np.all(after.share < rough * WORSE * before.share + FINE))
    )


def _other(slip: Slip, _: Sight, after: Left) -> bool:
    """Whether another factor than the slip's is better: then it is none of this unit."""
    return slip.factor and any(left(slip.right(k)).count < after.count for k in (BESIDE, 1 / BESIDE))


def _slips(log: Log, sight: Sight, before: Left) -> Iterator[Slip]:
    """Every slip that this log may have."""
    n = log.n
    own = [j for j in range(n) if before.share[j] > OWN * SOUND]
    groups = ([list(range(n))] if n > 1 else []) + [[j] for j in own]
    for group in groups:
        yield from _of(log, sight, group)
    yield from _exchanged(log, sight, own)
    for j in own:
        yield from _zero(log, sight, j)
    if (sight.heavy or n > 1) and not log.currents:
        yield from _rate(log, sight)


def _of(log: Log, sight: Sight, group: Sequence[int]) -> Iterator[Slip]:
    """Signs, units and gear ratios of a joint, or of all."""
    n, one = log.n, np.ones(log.n)
    alone = len(group) == 1
    joint = log.joints[group[0]] if alone else ""
    who = joint or "all joints"
    N = np.abs(log.N[list(group)])
    slide = all(sight.motion.model.chain.slides(j) for j in group)

    def of(factor: Array | float) -> Array:
        result = np.ones(n)
        result[list(group)] = factor
        return result

    def slip(name: str, line: str, angle: Array | float, torque: Array | float, factor: bool = False) -> Slip:
        beside = (of(angle), of(torque))

        def right(k: float) -> Sight:
            moved, pulled = (x if np.all(x == one) else of(k) * x for x in beside)
            return sight.scaled(moved, pulled)

        return Slip(name, joint, f"{who}: {line}", right, factor)

    yield slip("wrong sign", "the torque has the wrong sign: negate it (sign of torque in the map)", 1.0, -1.0)
    yield slip("wrong sign", "the angle has the wrong sign: negate it (sign of motor_angle)", -1.0, 1.0)
    if alone and n > 1:
        yield slip(
            "wrong gear ratio",
            f"its gear reverses: declare N = {-log.N[group[0]]:g}, or negate both angle and torque",
            -1.0,
            -1.0,
        )
    if not set(log.currents) & {log.joints[j] for j in group}:
        yield slip("wrong unit", "the torque is in mN m: divide it by 1000 (its unit)", 1.0, 1e-3, True)
        yield slip("wrong unit", "the torque is 1000 times too small: is it in N m, not mN m?", 1.0, 1e3, True)
        yield slip("wrong unit", "the torque is in N cm: divide it by 100 (gain = 0.01)", 1.0, 1e-2, True)
        if np.any(N != 1.0):
            yield slip(
                "wrong side of the gear",
                'the torque is the one behind the gear: divide it by N (side = "joint")',
                1.0,
                1.0 / N,
                True,
            )
    if slide:
        yield slip("wrong unit", "the position is in mm: divide it by 1000 (its unit)", 1e-3, 1.0, True)
        yield slip("wrong unit", "the position is 1000 times too small: is it in m, not mm?", 1e3, 1.0, True)
    yield slip("wrong unit", "the angle is in degrees: divide it by 57.29578 (its unit)", 1.0 / _DEGREES, 1.0, True)
    yield slip(
        "wrong unit",
        f"the angle is 57.3 times too small: is it in {'m' if slide else 'rad'}, not deg?",
        _DEGREES,
        1.0,
        True,
    )
    yield slip("wrong unit", "the angle is in revolutions: multiply it by 2 pi (its unit)", 2 * np.pi, 1.0, True)
    if np.any(N != 1.0):
        yield slip(
            "wrong side of the gear",
            'the angle is the one behind the gear: multiply it by N (side = "joint")',
            N,
            1.0,
            True,
        )
        if np.all(N < 1.0):
            yield _inverse(log, sight, joint, who, of(N**2))
        if alone:
            yield from _ratio(log, sight, group[0])


def _inverse(log: Log, sight: Sight, joint: str, who: str, square: Array) -> Slip:
    line = f"{who}: N is declared the wrong way round: it is motor revolutions per joint revolution, declare {_inverses(log, square)}"
    return Slip("wrong gear ratio", joint, line, _always(sight.scaled, square, 1.0 / square, True))


def _inverses(log: Log, square: Array) -> str:
    return "N = " + ", ".join(
        dict.fromkeys(f"{1 / N:g}" for N, other in zip(log.N, square, strict=True) if other != 1.0)
    )


def _ratio(log: Log, sight: Sight, j: int) -> Iterator[Slip]:
    """Another gear ratio: the best there is, where one is better than the declared one."""
    e = np.arange(log.n) == j

    def right(k: float) -> Sight:
        return sight.scaled(np.where(e, 1.0 / k, 1.0), np.where(e, k, 1.0), gear=True)

    k = _least(right, np.array(RATIOS), 1.3)
    if max(k, 1 / k) > CLOSE:
        line = f"{log.joints[j]}: its angle and torque fit N = {k * log.N[j]:.3g}, declared is {log.N[j]:g}: correct the gear ratio"
        yield Slip("wrong gear ratio", log.joints[j], line, _always(right, k))


def _least(right: Callable[[float], Sight], tried: Array, step: float) -> float:
    """The factor that leaves least, to 1 %."""
    at = min(tried, key=lambda k: left(right(float(k)), zeros=False).count)
    ends = (float(np.log(at / step)), float(np.log(at * step)))
    found = minimize_scalar(
        lambda x: left(right(float(np.exp(x))), zeros=False).count,
        bounds=ends,
        method="bounded",
        options={"xatol": 0.005, "maxiter": 14},
    )
    return float(np.exp(found.x))


def _exchanged(log: Log, sight: Sight, own: Sequence[int]) -> Iterator[Slip]:
    """Columns of two joints that are exchanged."""
    slides = sight.motion.model.chain.slides
    for i, k in combinations(own, 2):
        if slides(i) != slides(k):
            continue
        who = f"{log.joints[i]} and {log.joints[k]}"
        for what, angles, torques in (
            ("angles", True, False),
            ("torques", False, True),
            ("angles and torques", True, True),
        ):
            line = f"{who}: each one's {what} are the other's: exchange them (cables, or column in the map)"
            yield Slip("swapped columns", who, line, _always(sight.exchanged, i, k, angles, torques))


def _zero(log: Log, sight: Sight, j: int) -> Iterator[Slip]:
    """An angle whose zero is a quarter or half of a turn elsewhere."""
    if sight.motion.model.chain.slides(j):
        return
    for text, turn in (("90 deg", 0.5 * np.pi), ("-90 deg", -0.5 * np.pi), ("180 deg", np.pi)):
        line = f"{log.joints[j]}: its zero is not the URDF's: add {text} to the angle (offset of motor_angle)"
        away = np.where(np.arange(log.n) == j, turn, 0.0)
        yield Slip("encoder zero", log.joints[j], line, _always(sight.turned, away))


def _rate(log: Log, sight: Sight) -> Iterator[Slip]:
    """Another sampling rate: inertia goes with its square, gravity does not."""
    k = _least(sight.faster, RATES, 1.3)
    if max(k, 1 / k) > (CLOSE if sight.heavy else FAR_RATE):
        yield Slip("wrong sampling rate", "", _rate_line(log, sight, k), _always(sight.faster, k))


def _rate_line(log: Log, sight: Sight, k: float) -> str:
    weight = "what gravity does is not" if sight.heavy else "or all links and rotors are declared so"
    return (
        f"the motion fits a sampling rate of {k * log.fs:.3g} Hz, declared is {log.fs:g} Hz: what inertia asks for is {1 / k**2:.3g} times as large as it "
        f"should be at every joint, {weight}: correct sample_rate_Hz, or the unit of time"
    )


def _slightly_off(log: Log, sight: Sight) -> Fault | None:
    """A rate that is off by as little as links may be: where links and rotors are exactly as declared but for it."""
    if not sight.heavy or log.n == 1 or log.currents:
        return None
    here = left(sight, as_declared=True).share
    k = minimize_scalar(
        lambda x: left(sight.faster(float(np.exp(x))), as_declared=True).count,
        bounds=(-0.7, 0.7),
        method="bounded",
        options={"xatol": 1e-3},
    )
    k = float(np.exp(k.x))
    there = left(sight.faster(k), as_declared=True).share
    others = left(sight, as_declared=True, rotors=True).share
    falls = [np.sum(one**2) / np.sum(np.maximum(there, 1e-3) ** 2) for one in (here, others)]
    if max(k, 1 / k) < CLOSE_RATE or there.max() > EXPLAINS or falls[0] < CLEARLY or falls[1] < np.sqrt(CLEARLY):
        return None
    line = f"{_rate_line(log, sight, k)}; with it the declared arm leaves {percent(there.max())} of a torque at most, without it {percent(here.max())}"
    return Fault("wrong sampling rate", "", "", line, REFUSE)
