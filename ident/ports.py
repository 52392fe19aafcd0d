"""Laws as forces on the simulated joints, each solved with the velocity that it changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ident.effects.base import State

Force = Callable[[State], float]

#: A law whose force changes by less than this, relative, when its own effect on the velocity is in it, is not stiff.
_FIXED = 1e-7
#: A smooth law is found by one step along its tangent if that leaves less than this part of its own effect.
_NEAR = 1e-4
_ROOT = 1e-11  # of the change of velocity in a step: how well a stiff law's end velocity is found
_TRIES = 60
_SWEEPS, _SWEPT = 20, 1e-6  # of ports that load each other; of the velocity: how well they have to agree
_PASSES = 8
#: Gauss-Legendre: (part of the way, weight).
_GAUSS = (
    (0.0469100770306680, 0.1184634425280945), (0.2307653449471585, 0.2393143352496832), (0.5, 0.2844444444444444),
    (0.7692346550528415, 0.2393143352496832), (0.9530899229693320, 0.1184634425280945),
)  # fmt: skip


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
        total = 0.0
        for index, factor in self.rate:
            total += factor * v[index]
        return total


def torques(
    ports: Sequence[Port], v: Sequence[float], a: Sequence[float], W: Sequence[Sequence[float]], h: float
) -> None:
    """Finds the torques F of `ports` that hold over a step `h` from velocities v, with accelerations a without them.

    W[i][j]: acceleration at port i per torque at port j. Positions are those half-way, in the states already.
    """
    if len(ports) == 1:
        (port,) = ports
        port.F = _solved(port, port.velocity(v), port.velocity(a), W[0][0], h)
        return
    rates = [port.velocity(v) for port in ports]
    pulls = [port.velocity(a) for port in ports]
    for _ in range(_SWEEPS):
        change = 0.0
        for i, port in enumerate(ports):
            pull = pulls[i]
            for j, other in enumerate(ports):
                if j != i:
                    pull += W[i][j] * other.F
            F = _solved(port, rates[i], pull, W[i][i], h)
            change = max(change, abs((F - port.F) * W[i][i]) * h - _SWEPT * (abs(rates[i]) + h * abs(pulls[i])))
            port.F = F
        if change <= 0.0:
            return


def _solved(port: Port, v: float, a: float, W: float, h: float) -> float:
    """The torque F = law(rate) of one port: at the velocity half-way; where that is stiff, at the end of the step, found from the
    motion, which is exact to rounding."""
    half = 0.5 * h
    rate_1 = v + half * (a + W * port.F)
    F_1 = port.torque(rate_1)
    rate_2 = v + half * (a + W * F_1)
    F_2 = port.torque(rate_2)
    end = 2.0 * rate_2 - v
    settled = abs(F_2 - F_1) <= _FIXED * abs(F_2)
    if settled and v * end >= 0.0:
        return F_2
    gain = 0.0 if settled else half * W * (F_2 - F_1) / (rate_2 - rate_1)
    if abs(gain) < 0.5:
        if not settled:
            rate = rate_2 + (v + half * (a + W * F_2) - rate_2) / (1.0 - gain)  # where the tangent has it
            F = port.torque(rate)
            if abs(v + half * (a + W * F) - rate) <= _NEAR * abs(half * W * F) and v * (2.0 * rate - v) >= 0.0:
                return F
        return _passing(port, v, end, a, W, h)
    end = _implicit(port, v, a, W, h)
    near = 1e-3 * abs(end - v)
    if near and h * abs(W) * abs(port.torque(end + near) - port.torque(end - near)) < 2 * near:
        return _passing(port, v, end, a, W, h)  # it slides on in the other direction: what it does on the way counts
    return ((end - v) / h - a) / W


def _passing(port: Port, v: float, end: float, a: float, W: float, h: float) -> float:
    """The mean torque over a velocity that goes evenly from v to the end of the step, which starts its search at `end`."""
    F = 0.0
    for _ in range(_PASSES):
        before, F = F, sum(weight * port.torque(v + part * (end - v)) for part, weight in _GAUSS)
        if abs(F - before) <= _FIXED * abs(F):
            break
        end = v + h * (a + W * F)
    return F


def _implicit(port: Port, v: float, a: float, W: float, h: float) -> float:
    """Backward Euler: rate = v + h (a + W law(rate)), by secants kept in a bracket."""

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
    return rate
