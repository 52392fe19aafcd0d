"""Curves that could explain a residual where no name does: drawn at every port against every variable, heights by first order."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ident.effects.base import Effect
from ident.effects.learned import KINDS, VARIABLES, Learned, LearnedCurve, learned, of_place, variable
from ident.effects.lubricated import LubricatedLink, LubricatedMotor
from ident.effects.memory import PRESLIDING, Remembering
from ident.effects.response import Response, response
from ident.effects.ringing import Ringing
from ident.records.campaign import Array
from ident.records.frf import Complex
from ident.search.candidates import Candidate, added, best_of, bounds, side_of, units
from ident.search.crosstalks import crosstalks
from ident.search.memories import memories
from ident.search.periods import Spectrum, spectrum
from ident.search.trace import Linearised
from symgen.forked import forked

#: Knots of a learned curve, by its variable, and of any other: more where each record covers all of it than for a position, of
#: which records see parts.
KNOTS = {"torque": 17, "drive": 17, "deflection": 25}
USUAL = 13
#: Parts of the range of a variable: between the places where the records rest there are some that none covers.
PARTS = 512
#: Those of a velocity about standstill, where what rubs changes most, and of a drive's torque about none, where it is dead, as
#: shares of the highest; times the last of these beyond which the others begin.
RESTING, BEGIN = (0.001, 0.004, 0.012, 0.035), 1.6
#: Share of what is covered that the first and the last stretch of a curve are at least.
ENDS = 0.02
#: Highest order [per rad of the motor] of a wave of a curve that repeats itself, its harmonics; at how many places such curves
#: are looked for, peaks there, harmonics that a peak may be, and whole parts
#: of a turn that are tried: one is preferred that does this share of what others do.
HIGHEST, HARMONICS, REPEATING, PEAKS_OF_WAVES, MULTIPLES, WHOLE, AS_WELL = 30.0, 6, 3, 4, 4, 12, 0.9
#: Times as many harmonics of a curve that repeats itself, and share of what the few leave that these leave if they are taken: a wave
#: that is narrow in its period, as of one tooth.
NARROW, MUCH_LESS = 2, 0.5
#: How often a curve that repeats itself does so in what the records cover, at least; the lowest order of a single wave, and the
#: orders tried about a peak.
AGAIN, LONGEST, CLOSER = 1.5, 0.2, 9
#: Knots of a frequency response, few or many; share of what few leave that many leave which are taken.
OF_FREQUENCY, MUCH_FINER = (9, 17), 0.3

#: A kind of curve, and the joint it is of.
Shape = tuple[type[Learned], int]


def curves(lin: Linearised, workers: int = 1) -> list[Candidate]:
    """Learned curves at every port of every joint, of every variable, and of positions that repeat, memories and what comes of other
    joints, best first."""
    lin.prepare()
    shapes: list[Shape | None] = []
    waves: list[tuple[float, str, int, str, Spectrum]] = []
    for joint in range(lin.problem.n):
        for port, names in VARIABLES.items():
            for name in names:
                shapes.append(_shape(lin, port, joint, name))
                if of_place(port, name):
                    highest = HIGHEST * _turns(lin, port, joint)
                    seen = spectrum(lin, port, "link" if port == "link" else "motor", joint, highest, of=name)
                    if seen is not None:
                        waves.append((float(seen.fall.max()), port, joint, name, seen))
    found = _drawn(lin, [shape for shape in [*shapes, *memories(lin), *crosstalks(lin)] if shape is not None], workers)
    for _, port, joint, name, seen in sorted(waves, key=lambda wave: -wave[0])[:REPEATING]:
        found += _repeating(lin, port, joint, name, seen, workers)
    return sorted(found, key=lambda c: -c.gain)


def curve_of(lin: Linearised, port: str, joint: int, name: str) -> Candidate | None:
    """The learned curve at a port of a joint of a variable, nothing at first."""
    lin.prepare()
    shape = _shape(lin, port, joint, name)
    drawn = _drawn(lin, [shape] if shape else [], 1)
    return replace(drawn[0], effect=drawn[0].effect.with_values([0.0] * len(drawn[0].scales))) if drawn else None


def sticking(lin: Linearised, port: str, joint: int) -> list[Candidate]:
    """What sticks at a port of a joint before it slides: a sum of stops, and at a motor or link what is less the faster it slides."""
    lin.prepare()
    wanted = (PRESLIDING, port, joint)
    found = _drawn(lin, [(kind, at) for kind, at in memories(lin) if (kind.variable, kind.port, at) == wanted], 1)
    lubricated = [best_of(lin, kind, joint) for kind in (LubricatedMotor, LubricatedLink) if kind.port == port]
    return [*(c for c in lubricated if c is not None), *found]


def responses(lin: Linearised, least: float, workers: int = 1) -> list[Candidate]:
    """Frequency responses of every joint's torque and angle that promise more than `least`, best first; with more knots where these
    leave much less."""
    lin.prepare()
    places = [(port, joint) for joint in range(lin.problem.n) for port in ("motor", "sensor")]
    few, many = OF_FREQUENCY
    coarse = [(place, one) for place, one in _responding(lin, places, few, workers) if one.gain > least]
    finer = _responding(lin, [place for place, _ in coarse], many, workers)
    found = [
        fine if lin.chi2 - fine.gain < MUCH_FINER * (lin.chi2 - one.gain) else one
        for (_, one), (_, fine) in zip(coarse, finer, strict=True)
    ]
    return sorted(found, key=lambda c: -c.gain)


def resonances(lin: Linearised, taken: Sequence[Effect], least: float, workers: int = 1) -> list[Candidate]:
    """A mass that rings at every joint's motor, if it promises more than `least`, best first; none where one is `taken`."""
    lin.prepare()
    rung = {effect.joint for effect in taken if isinstance(effect, Ringing)}
    joints = [joint for joint in range(lin.problem.n) if joint not in rung]
    found = forked(lambda joint: best_of(lin, Ringing, joint), joints, workers)
    return sorted((c for c in found if c is not None and c.gain > least), key=lambda c: -c.gain)


def _responding(
    lin: Linearised, places: Sequence[tuple[str, int]], count: int, workers: int
) -> list[tuple[tuple[str, int], Candidate]]:
    """The response with so many knots that fits best at each of the places (port, joint) that lines tell of, with its place."""
    kinds = []
    for port, joint in places:
        if len(knots := knots_of_frequency(lin, joint, count)) > 1:
            kinds.append((response(port, knots.tolist()), joint))
    found = []
    for (kind, joint), (gains, fall) in zip(kinds, forked(lambda one: _gains(lin, *one), kinds, workers), strict=True):
        effect = kind.of_gains(joint, gains)
        found.append(((kind.port, joint), Candidate(effect, fall, scales_of_response(effect))))
    return found


def knots_of_frequency(lin: Linearised, joint: int, count: int) -> Array:
    """So many knots [K, Hz], or fewer, spread evenly over the logarithm of what excites the joint, each at a line that does: between
    these nothing tells of it. None where no record has it."""
    live = [one for one in lin.problem.data if joint in one.scene.arm.live]
    own = [one for one in live if one.excited == joint] or live
    told = [one.sampling.f[one.use & one.is_excited & (one.sampling.f > 0.0)] for one in own]
    lines = np.unique(np.concatenate([np.zeros(0), *told]))
    if not len(lines):
        return lines
    even = np.geomspace(lines[0], lines[-1], count)
    return np.unique(lines[np.argmin(np.abs(np.subtract.outer(lines, even)), axis=0)])


def scales_of_response(effect: Response) -> tuple[float, ...]:
    """The scales of its values: of the logarithms of its gains, and of its delays."""
    count = len(effect.knots)
    sizes, delays = np.split(np.abs(effect.values), [count - 1])
    scales = max(float(sizes.max()), 1e-3), max(float(delays[count // 2 :].max()), 1e-6)
    return tuple(np.repeat(scales, [count - 1, count]).tolist())


def _gains(lin: Linearised, kind: type[Response], joint: int) -> tuple[Complex, float]:
    """Complex gains at its knots that fit best while the arm moves on as it did, and by how much chi^2 falls."""
    port = kind.port
    columns: list[list[Complex | None]] = [[] for _ in 2 * kind.knots]
    for at, one in enumerate(lin.problem.data):
        live = one.scene.arm.live.tolist()
        pushed: list[Complex | None] = [None] * len(kind.knots)
        if joint in live:
            here, k = lin.judged[at], live.index(joint)
            signal = (here.torque if port == "motor" else here.theta)[:, k]
            pushed = [here.pushes[port][:, :, k] * (signal * shape)[:, None] for shape in kind.shapes(here.s).T]
        for column, push in zip(
            columns, (*pushed, *(None if push is None else 1j * push for push in pushed)), strict=True
        ):
            column.append(push)
    x, fall = lin.step(columns)
    real, imaginary = np.split(x, 2)
    return 1.0 + real + 1j * imaginary, fall


def _shape(lin: Linearised, port: str, joint: int, name: str) -> Shape | None:
    """A learned curve, half of its knots where the records are most of the time, half spread evenly over what they cover; a position's
    in the records that excite the joint: where others hold it, it hardly moves. What they cover of a deflection is that of all: its
    slope where a load rests is the stiffness there."""
    live = [
        (one, m)
        for one, m in zip(lin.problem.data, lin.motions[side_of(port)], strict=True)
        if joint in one.scene.arm.live
    ]
    every = [variable(m.state(joint), port, name) for _, m in live]
    own = [there for (one, _), there in zip(live, every, strict=True) if one.excited == joint and KINDS[name].of_place]
    if not live:
        return None
    x = np.concatenate(own or every)
    reached = np.concatenate(every) if (port, name) == ("spring", "position") else x
    low, high = float(reached.min()), float(reached.max())
    if not high > low:
        return None
    share = np.linspace(0.0, 1.0, KNOTS.get("deflection" if port == "spring" and name == "position" else name, USUAL))
    cells, edges = np.histogram(reached, PARTS)
    covered = np.concatenate([[low], 0.5 * (edges[1:] + edges[:-1])[cells > 0], [high]])
    both = [np.quantile(of, np.linspace(0.0, 1.0, PARTS), method="nearest") for of in (x, covered)]
    knots: Array = np.quantile(np.concatenate(both), share, method="nearest")
    if KINDS[name].of in ("velocity", "drive") and KINDS[name].times in ("", "direction"):
        about = np.outer([-1.0, 1.0], RESTING[-2:] if name == "sliding" else RESTING).ravel() * np.abs(x).max()
        knots = np.sort(np.concatenate([knots[np.abs(knots) > BEGIN * about.max()], about]))
    if np.any(np.diff(knots) <= 1e-9 * (high - low)):
        knots = np.linspace(low, high, len(knots))
    knots = knots if of_place(port, name) else _wide_at_ends(knots)
    return learned(port, name, knots.tolist()), joint


def _wide_at_ends(knots: Array) -> Array:
    """The knots but for those near the first or the last one: beyond them a curve goes on as steeply as there."""
    (first, *_, last), inner = knots, knots[1:-1]
    least = ENDS * (last - first)
    return np.concatenate([[first], inner[(inner - first > least) & (last - inner > least)], [last]])


def _turns(lin: Linearised, port: str, joint: int) -> float:
    """Turns of the motor in one of what a motor or link port turns."""
    return float(abs(lin.problem.data[0].scene.N[joint])) if port == "link" else 1.0


def _round(port: str, joint: int, name: str, count: int, order: float) -> Shape:
    """A learned curve of so many heights that repeats itself with an order [1/rad]."""
    period = 2.0 * np.pi / order
    return learned(port, name, (period * np.arange(count) / count).tolist(), period), joint


def _repeating(lin: Linearised, port: str, joint: int, name: str, seen: Spectrum, workers: int) -> list[Candidate]:
    """The curve of position that repeats itself and fits best: a whole part of a turn, or a peak of the spectrum is a harmonic
    of it, if that is much better; of more harmonics, if these leave much less."""

    def best(orders: Iterable[float], harmonics: int = HARMONICS) -> Candidate | None:
        count = 2 * harmonics + 1
        shapes = [_round(port, joint, name, count, order) for order in orders if order >= AGAIN * seen.resolved]
        return max(_drawn(lin, shapes, workers), key=lambda one: one.gain, default=None)

    whole = best(float(k) for k in range(1, WHOLE + 1)) if port != "link" else None
    other = best(peak / k for peak in seen.peaks(PEAKS_OF_WAVES) for k in range(1, MULTIPLES + 1))
    one = whole if whole and (other is None or whole.gain > AS_WELL * other.gain) else other
    if one is None:
        return []
    assert isinstance(one.effect, Learned) and one.effect.period is not None
    narrow = best([2.0 * np.pi / one.effect.period], NARROW * HARMONICS)
    much_less = narrow is not None and lin.chi2 - narrow.gain < MUCH_LESS * (lin.chi2 - one.gain)
    return [narrow if narrow is not None and much_less else one]


def wave(lin: Linearised, port: str, joint: int, highest: float, workers: int = 1) -> Candidate | None:
    """The one wave of a position that fits best, of any order up to the `highest` [per rad of the motor], whole in a turn or not."""
    lin.prepare()
    turns = _turns(lin, port, joint)
    seen = spectrum(lin, port, port, joint, highest * turns, LONGEST * turns)
    if seen is None:
        return None
    orders = np.add.outer(seen.peaks(REPEATING), np.linspace(-0.5, 0.5, CLOSER) * seen.resolved).ravel()
    shapes = [_round(port, joint, "position", 3, order) for order in orders[orders >= LONGEST * turns].tolist()]
    return max(_drawn(lin, shapes, workers), key=lambda one: one.gain, default=None)


def _drawn(lin: Linearised, shapes: Sequence[Shape], workers: int) -> list[Candidate]:
    """The curves of these shapes whose heights fit best to first order."""
    found = []
    for (kind, joint), (heights, gain) in zip(
        shapes, forked(lambda shape: _heights(lin, *shape), shapes, workers), strict=True
    ):
        if gain > 0.0:
            size = max(float(np.abs(heights).max()), 1e-300)
            found.append(Candidate(kind(joint, tuple(heights.tolist())), gain, (size,) * len(heights)))
    return found


def _heights(lin: Linearised, kind: type[Effect], joint: int) -> tuple[Array, float]:
    """Heights of a curve that fit best to first order, and by how much chi^2 falls."""
    columns = _columns(lin, kind, joint)
    if all(part is None for column in columns for part in column):
        return np.zeros(len(columns)), 0.0
    heights, gain = lin.step(columns)
    low, high = np.transpose([bounds(p, u) for p, u in zip(kind.parameters, units(lin, kind, joint), strict=True)])
    return np.clip(heights, low, high), gain


def _columns(lin: Linearised, kind: type[Effect], joint: int) -> list[list[Complex | None]]:
    """What a unit of each height of a curve adds, as `added` has it: of all at once, where they are those of one curve."""
    curve = kind(joint, (0.0,) * len(kind.parameters))
    if not isinstance(curve, LearnedCurve | Remembering):
        return [added(lin, curve.with_values(row)) for row in np.eye(len(curve.values)).tolist()]
    columns: list[list[Complex | None]] = [[] for _ in curve.values]
    for here, one, motion in zip(lin.judged, lin.problem.data, lin.motions[side_of(kind.port)], strict=True):
        at = np.flatnonzero(one.scene.arm.live == joint)
        lines = np.zeros((len(columns), int(one.use.sum())), dtype=complex)
        if at.size:
            lines = one.scene.at_lines(curve.each(motion).T).T[:, one.use]
        for column, line in zip(columns, lines, strict=True):
            column.append(here.pushes[kind.port][:, :, at[0]] * line[:, None] if line.any() else None)
    return columns
