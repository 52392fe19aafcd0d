"""Laws as forces on the simulated joints, each solved with the velocity that it changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ident.effects.base import State

Force = Callable[[State], float]

#: A law whose force changes by less than this, relative, when its own effect on the velocity is in it, is not stiff.
_FIXED = 1e-7
_ROOT = 1e-11  # of the change of velocity in a step: how well a stiff law's end velocity is found
_TRIES = 60


@dataclass
class Port:
    """The laws at one port of one joint, and what turns their torque F into motion: `push` (generalised force [nv] as
    (index, factor)) and `rate`, the velocity there as (index, factor); `name` of the velocity in the state."""

    state: State
    name: str
    laws: tuple[Force, ...]
    push: tuple[tuple[int, float], ...]
    rate: tuple[tuple[int, float], ...]
    F: float = 0.0
    end: float = field(default=0.0)

    def torque(self, rate: float) -> float:
        """The torque of its laws when its velocity is `rate`."""
        setattr(self.state, self.name, rate)
        total = 0.0
        for law in self.laws:
            total += float(law(self.state))
        return total

    def velocity(self, v: Sequence[float]) -> float:
        return sum(factor * v[index] for index, factor in self.rate)


def torques(
    ports: Sequence[Port], v: Sequence[float], a: Sequence[float], W: Sequence[Sequence[float]], h: float
) -> None:
    """Finds the torques F of `ports` that hold over a step `h` from velocities v, with accelerations a without them.

    W[i][j]: acceleration at port i per torque at port j. Positions are those half-way, in the states already.
    """
    rates = [port.velocity(v) for port in ports]
    pulls = [port.velocity(a) for port in ports]
    for _ in range(1 if len(ports) == 1 else 20):
        change = 0.0
        for i, port in enumerate(ports):
            pull = pulls[i]
            for j, other in enumerate(ports):
                if j != i:
                    pull += W[i][j] * other.F
            F = _solved(port, rates[i], pull, W[i][i], h)
            change = max(change, abs(F - port.F) * abs(W[i][i]) * h - 1e-9 * abs(rates[i]) - 1e-12)
            port.F = F
        if change <= 0.0:
            return


def _solved(port: Port, v: float, a: float, W: float, h: float) -> float:
    """The torque F = law(rate) of one port: at the velocity half-way, or at the end of the step where that is stiff."""
    half = 0.5 * h
    rate_1 = v + half * (a + W * port.F)
    F_1 = port.torque(rate_1)
    rate_2 = v + half * (a + W * F_1)
    F_2 = port.torque(rate_2)
    if abs(F_2 - F_1) <= _FIXED * abs(F_2):
        return F_2
    slope = (F_2 - F_1) / (rate_2 - rate_1)
    if abs(h * W * slope) < 0.5:  # contracts to a quarter each time
        for _ in range(_TRIES):
            rate_1, F_1 = rate_2, F_2
            rate_2 = v + half * (a + W * F_1)
            F_2 = port.torque(rate_2)
            if abs(F_2 - F_1) <= _FIXED * abs(F_2):
                break
        return F_2
    return _implicit(port, v, a, W, h)


def _implicit(port: Port, v: float, a: float, W: float, h: float) -> float:
    """Backward Euler: rate = v + h (a + W law(rate)), by secants kept in a bracket; F from the motion, exact to rounding."""

    def residual(rate: float) -> float:
        return rate - v - h * (a + W * port.torque(rate))

    free = v + h * a
    reach = abs(free) + abs(v) + abs(h * W * port.F) + 1e-300
    low, high = min(0.0, free), max(0.0, free)
    r_low, r_high = residual(low), residual(high)
    while r_low > 0.0:
        low -= reach
        r_low, reach = residual(low), 2 * reach
    while r_high < 0.0:
        high += reach
        r_high, reach = residual(high), 2 * reach
    accuracy = _ROOT * (abs(v) + abs(h * a)) + 1e-300
    rate = min(max(port.end, low), high)
    for k in range(_TRIES):
        r = residual(rate)
        if abs(r) <= accuracy:
            break
        if r < 0.0:
            slope = (r_low - r) / (low - rate) if rate > low else 0.0
            low, r_low = rate, r
        else:
            slope = (r_high - r) / (high - rate) if rate < high else 0.0
            high, r_high = rate, r
        guess = rate - r / slope if slope > 0.0 else low
        regula = high - r_high * (high - low) / (r_high - r_low)
        rate = guess if low < guess < high and k % 4 < 2 else regula if k % 4 == 2 else 0.5 * (low + high)
        if high - low <= accuracy:
            break
    port.end = rate
    return ((rate - v) / h - a) / W
