"""The motion of a port that meets what it rattles between, as in play: a law of the position of the moment that bends at once.

Where the port hardly touches, little decides whether and when it does: there may be several motions, or none that repeats.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from ident.arm.likely_motion import Force, Forces, Key, LikelyMotion
from ident.arm.marching import marched
from ident.arm.sliding import closer
from ident.records.campaign import Array
from ident.records.frf import Complex

#: chi^2 per degree of freedom below which no other motion is looked for.
FITS = 1.1
#: Samples for each line, at least: of Newton's steps, and of periods that are followed.
STEPPED, FOLLOWED = 2.2, 4.0
#: Share of a position that is left of it where Newton's steps are made.
NEAR = 0.02
#: Share of a force by which that of the next period differs, below which they repeat; periods at the beginning that tell no mean.
REPEATS, BEGINNING = 1e-3, 3


@dataclass(frozen=True, eq=False)
class Rattling:
    """A port of an arm under the forces `on` besides that of a `law`(x) of its position; it rests at `rest`, and `yields` to a
    constant force."""

    arm: LikelyMotion
    key: Key
    on: Forces
    law: Callable[[Array], Array]
    rest: float
    yields: float

    def likeliest(self, x: Array, force: Array, periods: int) -> Array:
        """That force over a period which explains the record best: the `force` [T] that was found at the position x [T]; that of a motion
        near it that Newton's steps find; or else what becomes of it in up to so many `periods`, by the model alone or with what was
        measured, and of a motion near that. Without `periods` a force that explains it is left as it is.
        """
        if not periods and self._misfit(force) < FITS * self.arm.degrees:
            return force
        alone, gives = self._moves(self.arm, STEPPED)
        S, T = len(alone), len(x)

        def near(x: Array) -> Array:
            return closer(self.law, alone, -gives, x, T, NEAR)[1]

        best = min(force, near(x[:: T // S]), key=self._misfit)
        for arm in (replace(self.arm, trust=np.zeros_like(self.arm.trust)), self.arm) if periods else ():
            if self._misfit(best) < FITS * self.arm.degrees:
                break
            later, repeats = self._later(arm, x, force, periods)
            best = min([best, *later], key=self._misfit)
            if repeats:
                by_lines = gives * np.fft.rfft(best)[: S // 2 + 1] * (S / len(best))
                best = min(best, near(alone + np.fft.irfft(by_lines, S)), key=self._misfit)
        return best

    def _later(self, arm: LikelyMotion, x: Array, force: Array, periods: int) -> tuple[list[Array], bool]:
        """What becomes of a force at x in so many periods [S], or until they repeat, and whether they do: the last; the same mirrored, which
        is as good a motion of what goes either way alike; and the means of all where they do not repeat."""
        alone, gives = self._moves(arm, FOLLOWED)
        found: list[Array] = []
        for F in islice(marched(alone, gives, self.law, x, force[:: len(x) // len(alone)]), periods):
            if found and np.std(F - found[-1]) < REPEATS * np.std(F):
                return [F, _mirrored(F)], True
            found.append(F)
        if len(found) <= BEGINNING:  # it went beyond all bounds, soon
            return [either for F in found[-1:] for either in (F, _mirrored(F))], False
        mean = np.mean(found[BEGINNING:], axis=0)
        return [found[-1], _mirrored(found[-1]), mean, 0.5 * (mean + _mirrored(mean))], False

    def _moves(self, arm: LikelyMotion, per_line: float) -> tuple[Array, Complex]:
        """How the port moves alone [S], and what a unit force at one instant does by harmonics [S/2 + 1], told by so many samples for each
        line at least."""
        scene, S = self.arm.scene, self.arm.scene.samples
        while S % 2 == 0 and S / 2 > per_line * scene.lines[-1]:
            S //= 2
        v0, Y = arm.rate(self.key, self.on)
        alone, gives = np.zeros((2, S // 2 + 1), dtype=complex)
        alone[0], alone[scene.lines] = S * self.rest, v0 / scene.s * (S / 2)
        gives[0], gives[scene.lines] = -self.yields, Y / scene.s
        return np.fft.irfft(alone, S), gives

    def _misfit(self, force: Array) -> float:
        """chi^2 of the record under a force over a period."""
        return self.arm.misfit(self.on | {self.key: Force.of(self.arm.scene, force)})


def _mirrored(force: Array) -> Array:
    """The same the other way, half a period later."""
    return -np.roll(force, len(force) // 2)
