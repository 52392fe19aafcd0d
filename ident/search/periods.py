"""At which orders of a position what is left of a fit repeats itself: many records, each a small swing about its own rest.

What a wave of the position would explain is a sum over time of the wave times what is left, seen through the port: sorted
by position, that is the Fourier transform of a histogram, for all orders at once (as in J. D. Scargle, Astrophysical Journal
263 (1982), DOI 10.1086/160554, with W. H. Press, G. B. Rybicki, Astrophysical Journal 338 (1989), DOI 10.1086/167197).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.effects.learned import factor
from ident.records.campaign import Array
from ident.search.trace import Linearised

#: Cells of the histogram in a wave of the highest order; orders in what the range of positions resolves; powers computed.
CELLS, FINE, POWERS = 8, 4, 24
#: Lowest order: waves in the range of positions.
WAVES = 3.0
#: No joint turns so far in a record [rad, joint side].
FARTHEST = 200.0


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The fall of chi^2 by a wave of each of the `orders` [O, 1/rad], nothing else refitted; `resolved` the least difference of
    orders that the positions tell apart."""

    orders: Array
    fall: Array
    resolved: float

    def peaks(self, count: int) -> list[float]:
        """The orders of the highest peaks, highest first."""
        rest, found = self.fall.copy(), []
        for _ in range(count):
            k = int(np.argmax(rest))
            if rest[k] <= 0.0:
                break
            found.append(float(self.orders[k]))
            rest[np.abs(self.orders - self.orders[k]) < self.resolved] = 0.0
        return found

    def at(self, orders: Array) -> Array:
        """The fall by waves of these orders."""
        return np.interp(orders, self.orders, self.fall, left=0.0, right=0.0)


def spectrum(
    lin: Linearised, port: str, side: str, joint: int, highest: float, lowest: float | None = None, of: str = "position"
) -> Spectrum | None:
    """What waves of the position of a joint at a `side` would explain, acting at a `port`, in the records that excite it.

    Orders [1/rad] from the `lowest` (None: that repeats itself in what the records cover) to the `highest`; `of`: the variable of
    a learned curve of such a wave. None where nothing moves, or so little that it tells none of these orders apart, or farther than a
    joint does.
    """
    own = [k for k, one in enumerate(lin.problem.data) if one.excited == joint]
    places = [lin.motions[side][k].state(joint).at(side)[0] for k in own]
    if not own or not max(x.max() for x in places) > min(x.min() for x in places):
        return None
    low, span = min(x.min() for x in places), max(x.max() for x in places) - min(x.min() for x in places)
    if span > FARTHEST * (float(abs(lin.problem.data[0].scene.N[joint])) if side == "motor" else 1.0):
        return None  # the arm is so far from the true one that its links' motion means nothing
    lowest = min(WAVES * 2.0 * np.pi / span, highest) if lowest is None else lowest
    orders = np.geomspace(lowest, highest, POWERS)
    cell = 2.0 * np.pi / (CELLS * highest)
    count = int(span / cell) + 1
    n = int(2 ** np.ceil(np.log2(FINE * count)))
    every = 2.0 * np.pi / (n * cell) * np.arange(n // 2)
    use = (every >= lowest) & (every <= highest)
    if not use.any():
        return None
    weight, powers = np.zeros(count), np.zeros(POWERS)
    for k, x in zip(own, places, strict=True):
        scene, a = lin.problem.data[k].scene, lin.ports[k][port, joint]
        moves = lin.motions["spring" if of == "stiffness" else side][k]
        times = factor(moves.state(joint), port, of) * np.ones_like(x)
        left = scene.in_time(np.sum(a.conj() * lin.r[k], axis=1)[:, None])[:, 0]
        weight += np.bincount(((x - low) / cell).astype(np.int64), times * left * (2.0 / scene.samples), count)
        square = np.sum(np.abs(a) ** 2, axis=1)
        wave = scene.at_lines(times[:, None] * np.exp(1j * x[:, None] * orders).view(float))
        powers += 0.25 * (square @ np.abs(wave) ** 2).reshape(POWERS, 2).sum(axis=1)
    fall = np.abs(np.fft.fft(weight, n)[: n // 2][use]) ** 2 / np.maximum(np.interp(every[use], orders, powers), 1e-300)
    return Spectrum(every[use], fall, 2.0 * np.pi / span)
