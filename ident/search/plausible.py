"""Values of the parameters of an effect to try: plausible ones, and those that the residual of a fit tells of by itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from ident.effects.base import Effect, Parameter
from ident.effects.waves import is_harmonic, orders_at
from ident.search.periods import spectrum
from ident.search.trace import Linearised

#: Orders [per revolution] at which cogging, ripple and gear errors are looked for.
ORDERS = tuple(range(1, 101))
#: Frequencies over the band, stiffnesses, and peaks of the residual at which something on a spring is looked for.
FREQUENCIES, STIFFNESSES, PEAKS = 16, 6, 4
#: Peaks no farther apart than this, in the logarithm of their frequency, are one: flanks of a mode with some damping.
ONE_PEAK = 0.1
#: The lowest frequency tried [Hz], as slower ones have few lines; times the highest line: what rings just beyond it bends it still.
SLOWEST, BEYOND = 2.0, 1.2
#: Times the softest and the stiffest plausible stiffness that is tried: farther up, where an effect fades slowly.
SOFTER, STIFFER = 0.4, 4.0


def starts(
    lin: Linearised, kind: type[Effect], joint: int | None, unit: Sequence[float], orders: int
) -> Iterator[tuple[float, ...]]:
    """Start values of an effect at a joint to try, where its `unit`s are these: all combinations of shapes, as many `orders` of a wave,
    sizes at their first plausible value."""
    options = [values_of(lin, kind, joint, p, u, orders) for p, u in zip(kind.parameters, unit, strict=True)]
    yield from product(*options)


def values_of(
    lin: Linearised, kind: type[Effect], joint: int | None, p: Parameter, unit: float, orders: int
) -> tuple[float, ...]:
    """Values of a parameter to try where its `unit` is this, as many `orders` of a wave: frequencies in Hz, records from 1."""
    if p.declared:
        assert p.zero is not None
        return (p.zero,)
    if p.name == "phase":
        return (0.0,)
    if p.name == "order":
        assert joint is not None
        return _orders(lin, kind, joint, p, orders)
    if p.name == "record":
        return tuple(one.index + 1.0 for one in lin.problem.data[1:])
    if p.name == "frequency":
        top = max(float(one.sampling.f[-1]) for one in lin.problem.data)
        grid = np.geomspace(max(p.low, SLOWEST), BEYOND * top, FREQUENCIES).tolist()
        return (*_resonances(lin, "motor" if kind.port == "motor" else "link", joint or 0), *grid)
    if p.relative == "K" and p.zero is None:
        return tuple((unit * np.geomspace(SOFTER * min(p.sizes), STIFFER * max(p.sizes), STIFFNESSES)).tolist())
    if p.zero is None:
        return tuple(unit * size for size in p.sizes)
    return (unit * p.sizes[0],)


def _resonances(lin: Linearised, side: str, joint: int) -> tuple[float, ...]:
    """Frequencies [Hz] at which a `side` of a joint, its motor or its link, seems to carry most: peaks of the dynamic stiffness that is missing there."""
    pushed: dict[float, complex] = {}
    square: dict[float, float] = {}
    for at, one in enumerate(lin.problem.data):
        live = one.scene.arm.live.tolist()
        if joint not in live:
            continue
        a = lin.ports[at][side, joint]
        force = np.sum(a.conj() * lin.r[at], axis=1)
        weight = np.sum(np.abs(a) ** 2, axis=1)
        x = lin.positions[side][at][:, live.index(joint) + (len(live) if side == "link" else 0)]
        for f, top, bottom in zip(one.sampling.f.tolist(), x.conj() * force, np.abs(x) ** 2 * weight, strict=True):
            pushed[f] = pushed.get(f, 0j) + complex(top)
            square[f] = square.get(f, 0.0) + float(bottom)
    f = np.array(sorted(pushed))
    if not len(f):
        return ()
    z = np.array([abs(pushed[k]) ** 2 / max(square[k], 1e-300) for k in f])
    best = []
    for _ in range(PEAKS):
        k = int(np.argmax(z))
        best.append(float(f[k]))
        z[np.abs(np.log(f / f[k])) < ONE_PEAK] = 0.0
    return tuple(best)


def _orders(lin: Linearised, kind: type[Effect], joint: int, order: Parameter, most: int) -> tuple[float, ...]:
    """The `most` orders within their bounds whose waves lie best along the residual, in the records that excite the joint; none that it
    has already, and no wave where a harmonic of one of these does best."""
    port = "sensor" if kind.reading is not Effect.reading else kind.port
    seen = spectrum(lin, port, "motor", joint, float(ORDERS[-1]) + 0.5, 0.5)
    taken = orders_at(lin.problem.effects, kind, joint)
    orders = np.array([k for k in ORDERS if order.low <= k <= order.high and k not in taken], dtype=float)
    if seen is None:
        return tuple(orders[:1].tolist())
    best = orders[np.argsort(seen.at(orders))[::-1][:most]].tolist()
    return () if is_harmonic(best[0], taken) else tuple(k for k in best if not is_harmonic(k, taken))
