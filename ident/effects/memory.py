"""A memory that nobody named: what lags behind a signal, as a sum of stops.

A stop follows its signal up to a threshold each way and slips beyond, like a dry contact on a spring; a soft one gives way gradually, as
in Dahl's law. The sum of a few, each by its height, is a loop: of an iron core, of a wound gear, of an encoder that is turned with play
(L. Prandtl, ZAMM 8 (1928), DOI 10.1002/zamm.19280080202); over a place it is friction that gives before it slides (generalised
Maxwell slip: F. Al-Bender, V. Lampaert, J. Swevers, IEEE T-AC 50 (2005), DOI 10.1109/TAC.2005.858676).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ident.effects.base import Array, Parameter, PeriodicLaw
from ident.effects.hysteresis import recursion
from ident.effects.learned import Learned
from ident.effects.motion import Motion, State

#: What curves with a memory are called by their variable: what lags behind a signal by shares of it, and what sticks at a place before it slips.
HYSTERESIS, PRESLIDING = "hysteresis", "presliding"
#: Steps of a loop that is told, each way.
DRAWN = 40


class Loop(NamedTuple):
    """What lags at a port behind a `signal`, which a curve of the kind `of` is over, too; the `sign` of what it adds there."""

    signal: str
    of: str
    sign: float = -1.0


#: The loops that are looked for, by variable and port: of a torque that is commanded, of an angle that is read, in the same unit, heights
#: being shares of it; of a place at which something sticks, heights being the torques at which it slips.
LOOPS = {
    (HYSTERESIS, "motor"): Loop("tau", "drive"),
    (HYSTERESIS, "sensor"): Loop("theta", "position"),
    (PRESLIDING, "motor"): Loop("theta", "position"),
    (PRESLIDING, "spring"): Loop("deflection", "position", 1.0),
    (PRESLIDING, "link"): Loop("q", "position"),
}
#: The bound of a height.
HIGH = 9.0


class Remembering(Learned, PeriodicLaw):
    """A sum of stops of a signal at thresholds `knots`, the last `soft` of them soft, by its heights: where it has turned it has another
    slope than where it goes on."""

    loop: ClassVar[Loop]
    soft: ClassVar[int]

    def curve(self, slides: bool = False) -> dict[str, Any]:
        """Besides its heights how many of its last stops are soft, and the loop: its `output` `over` a swing to the largest threshold and
        back."""
        swing = max(self.knots)
        x = swing * np.concatenate([np.linspace(-1.0, 1.0, DRAWN + 1), np.linspace(1.0, -1.0, DRAWN + 1)[1:-1]])
        loop = {"over": x.tolist(), "output": self.lags(x).tolist()}
        return super().curve(slides) | {"soft": self.soft, "loop": loop}

    def over_period(self, at: State) -> Array:
        return self.lags(getattr(at, self.loop.signal))

    def lags(self, x: Array) -> Array:
        """What it makes of a period [S] of its signal."""
        return np.asarray(np.asarray(self.values) * self._units @ stops(x, self.knots, self.soft))

    def force(self, motion: Motion) -> Array | None:
        return self._lagging(motion)

    def _lagging(self, motion: Motion) -> Array:
        """What it makes of a motion, whose stops do for all heights."""
        return np.asarray(np.asarray(self.values) @ self.each(motion))

    def each(self, motion: Motion) -> Array:
        """What a unit of each height makes of a motion [K, S]."""
        assert self.joint is not None
        name, joint, thresholds, soft = self.loop.signal, self.joint, self.knots, self.soft
        which = ("stops", name, joint, thresholds, soft, self.variable)
        return motion.made(which, lambda: self._units[:, None] * stops(motion.signal(name, joint), thresholds, soft))

    @property
    def _units(self) -> Array:
        """What a unit of each height makes of its stop [K]."""
        per = np.asarray(self.knots) if self.variable == PRESLIDING else np.ones(len(self.knots))
        return self.loop.sign / per

    def start(self, step: float) -> tuple[Callable[[State], float], Callable[[State], None]]:
        r, slopes = np.asarray(self.knots), np.asarray(self.values) * self._units
        is_soft = np.arange(len(r)) >= len(r) - self.soft
        memory: list[tuple[float, Array]] = []  # the signal and the stops where it was last asked to remember

        def there(x: float) -> Array:
            before, stop = memory[0] if memory else (x, np.zeros(len(r)))
            kept = np.exp(-abs(x - before) / r)
            return np.where(
                is_soft, kept * stop + np.sign(x - before) * (1.0 - kept) * r, np.clip(stop + x - before, -r, r)
            )

        def remember(at: State) -> None:
            x = getattr(at, self.loop.signal)
            memory[:] = [(x, there(x))]

        return lambda at: float(slopes @ there(getattr(at, self.loop.signal))), remember


class RememberingReading(Remembering):
    """The same of the angle that an encoder reads."""

    def force(self, motion: Motion) -> None:
        return None

    def reading(self, motion: Motion) -> Array:
        return self._lagging(motion)


def stops(x: Array, thresholds: Sequence[float], soft: int = 0) -> Array:
    """Stops [K, S] of a signal [S] at thresholds [K] when its period goes on for ever, the last so many soft."""
    sharp = len(thresholds) - soft
    return np.concatenate([_sharp(x, np.array(thresholds[:sharp])[:, None]), _soft(x, thresholds[sharp:])])


def _soft(x: Array, thresholds: Sequence[float]) -> Array:
    """Soft stops [K, S]."""
    step = np.diff(x, prepend=x[-1])
    found = np.zeros((len(thresholds), len(x)))
    for row, r in zip(found, thresholds, strict=True):
        kept = np.exp(-np.abs(step) / r)
        values, left = recursion(kept, np.sign(step) * (1.0 - kept))
        row[:] = r * (values + left * (values[-1] / (1.0 - left[-1]) if left[-1] < 1.0 else 0.0))
    return found


def _sharp(x: Array, r: Array) -> Array:
    """Sharp stops [K, S], at thresholds r [K, 1]."""
    step = x - np.roll(x, 1)
    turns = np.flatnonzero(step * np.roll(step, -1) <= 0.0)
    if not len(turns):
        return np.zeros((len(r), len(x)))
    last = (
        np.searchsorted(turns, np.arange(len(x))) - 1
    )  # the turn before each sample, of the first ones a period before
    return np.asarray(x - np.clip(_play(x[turns], r)[:, last], x - r, x + r))


def _play(x: Array, r: Array) -> Array:
    """Plays [K, T] of the turns x [T] of a signal, at thresholds r [K, 1], for ever.

    What a turn does to a play is to clip it, and so does what several do: of twice as many turns that follows from half as many. A play
    that no turn moves is in the middle of where it may be.
    """
    low, high = x - r, x + r
    reach = 1
    while reach < len(x):
        low, high = (np.clip(np.roll(limit, reach, axis=1), low, high) for limit in (low, high))
        reach *= 2
    return np.asarray(0.5 * (low + high))


def remembering(of: str, port_name: str, at: Sequence[float], how_many_soft: int) -> type[Learned]:
    """The kind of memory of a variable, with thresholds `at` for a port, the last so many of them soft."""
    unit, relative, sliding = ("Nm", "torque", "N") if of == PRESLIDING else ("", "", "")
    heights = tuple(
        Parameter(f"height_{k + 1}", unit, -HIGH, HIGH, (0.0,), linear=True, relative=relative, sliding=sliding)
        for k in range(len(at))
    )

    class Curve(RememberingReading if port_name == "sensor" else Remembering):  # type: ignore[misc]
        port = port_name
        variable = of
        parameters = heights
        knots = tuple(float(x) for x in at)
        loop = LOOPS[of, port_name]
        soft = how_many_soft

    return Curve
