"""Curves that could explain a residual where no name does: drawn at every port against every variable, heights by first order."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ident.campaign import Array
from ident.candidates import Candidate
from ident.effects.base import Effect
from ident.effects.learned import VARIABLES, learned, variable
from ident.frf import Complex
from ident.periods import Spectrum, spectrum
from ident.trace import Linearised

#: Knots of a learned curve: many where each record covers all of it, few for a position, of which records see parts.
KNOTS = {"velocity": 17, "torque": 17, "deflection": 17, "position": 9, "friction": 9}
#: Highest order [per rad of the motor] of a wave of a curve that repeats itself, its harmonics; at how many places such curves
#: are looked for, peaks there, harmonics that a peak may be, and whole parts
#: of a turn that are tried: one is preferred that does this share of what others do.
HIGHEST, HARMONICS, REPEATING, PEAKS_OF_WAVES, MULTIPLES, WHOLE, AS_WELL = 30.0, 6, 3, 4, 4, 12, 0.9


def curves(lin: Linearised) -> list[Candidate]:
    """Learned curves at every port of every joint, of every variable, and of positions that repeat, best first."""
    found: list[Candidate | None] = []
    waves: list[tuple[float, str, int, str, Spectrum]] = []
    for joint in range(lin.problem.n):
        for port in ("motor", "spring", "link"):
            for name in VARIABLES:
                if port == "spring" and name in ("torque", "friction"):
                    continue  # the spring's torque is its deflection
                found.append(_curve(lin, port, joint, name))
                if port != "spring" and name in ("position", "friction"):
                    highest = HIGHEST * (1.0 if port == "motor" else float(abs(lin.problem.data[0].scene.N[joint])))
                    seen = spectrum(lin, port, port, joint, highest, dry=name == "friction")
                    if seen is not None and seen.fall.size:
                        waves.append((float(seen.fall.max()), port, joint, name, seen))
    for _, port, joint, name, seen in sorted(waves, key=lambda wave: -wave[0])[:REPEATING]:
        found.append(_repeating(lin, port, joint, name, seen))
    return sorted((c for c in found if c is not None), key=lambda c: -c.gain)


def _curve(lin: Linearised, port: str, joint: int, name: str) -> Candidate | None:
    """One learned curve, knots between quantiles of what the records cover and an even spread."""
    here = [variable(m.state(joint), port, name)[0] for m, one in zip(lin.motions[port], lin.problem.data, strict=True)
            if joint in one.scene.arm.live]  # fmt: skip
    if not here:
        return None
    x = np.concatenate(here)
    low, high = np.quantile(x, [0.0, 1.0])
    if not high > low:
        return None
    count = KNOTS["deflection" if port == "spring" and name == "position" else name]
    spread: Array = np.quantile(x, np.linspace(0.0, 1.0, count))
    even = np.linspace(low, high, count)
    knots = np.sort(0.5 * (spread + even))
    if np.any(np.diff(knots) <= 1e-9 * (high - low)):
        knots = even
    return _drawn(lin, learned(port, name, knots.tolist()), joint)


def _repeating(lin: Linearised, port: str, joint: int, name: str, seen: Spectrum) -> Candidate | None:
    """The curve of position that repeats itself and fits best: a whole part of a turn, or a peak of the spectrum is a harmonic
    of it, if that is much better."""
    count = 2 * HARMONICS + 1

    def drawn(orders: Iterable[float]) -> Candidate | None:
        periods = [2.0 * np.pi / order for order in orders if order >= seen.orders[0]]
        found = (_drawn(lin, learned(port, name, (p * np.arange(count) / count).tolist(), p), joint) for p in periods)
        return max((one for one in found if one is not None), key=lambda one: one.gain, default=None)

    whole = drawn(float(k) for k in range(1, WHOLE + 1)) if port == "motor" else None
    other = drawn(peak / k for peak in seen.peaks(PEAKS_OF_WAVES) for k in range(1, MULTIPLES + 1))
    return whole if whole and (other is None or whole.gain > AS_WELL * other.gain) else other


def _drawn(lin: Linearised, kind: type[Effect], joint: int) -> Candidate | None:
    """The curve of this kind whose heights fit best to first order."""
    count = len(kind.parameters)
    units = [kind(joint, tuple(row)) for row in np.eye(count).tolist()]
    columns: list[list[Complex | None]] = [[] for _ in units]
    for one, motion, ports in zip(lin.problem.data, lin.motions[kind.port], lin.ports, strict=True):
        if joint not in one.scene.arm.live:
            for column in columns:
                column.append(None)
            continue
        law = np.stack([np.asarray(unit.force(motion)) for unit in units], axis=1)
        for column, force in zip(columns, one.scene.at_lines(law).T, strict=True):
            column.append(ports[kind.port, joint] * force[:, None] if np.any(force) else None)
    if all(part is None for column in columns for part in column):
        return None
    heights, gain = lin.step(columns)
    heights = np.maximum(heights, kind.parameters[0].low)
    size = max(float(np.abs(heights).max()), 1e-300)
    return Candidate(kind(joint, tuple(heights.tolist())), gain, (size,) * count) if gain > 0.0 else None
