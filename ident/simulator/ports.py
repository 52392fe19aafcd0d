"""Laws as forces on the simulated joints, each solved with the velocity that it changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import expm1

from ident.effects.motion import State

Force = Callable[[State], float]

#: A law whose force changes by less than this, relative, when its own effect on the velocity is in it, is not stiff.
_FIXED = 1e-7
#: A smooth law is found by one step along its tangent if that leaves less than this part of its own effect.
_NEAR = 1e-4
_SWEEPS, _SWEPT = 20, 1e-6  # of ports that load each other; of the velocity: how well they have to agree
#: The shortest part of a step in which a stiff law is followed, and how far, relative to its own effect, it may be from its tangent there.
_LEAST_PART, _BENT = 1.0 / 64.0, 3e-3
#: The most that a velocity grows, e^_GROWS, in a part by a law that drives it; what is left of a step at its end; below which functions
#: of a growth are their series.
_GROWS, _DONE, _SMALL = 10.0, 1e-9, 0.3


@dataclass
class Port:
    """The laws at one port of one joint, and what turns their torque F into motion: `push` (generalised force [nv] as
    (index, factor)) and `rate`, the velocity there as (index, factor); `name` of the velocity in the state; by how much it is
    `ahead` at the end of the step of where an even force takes it. Without its torque it is accelerated `more` every second.
    Those of its laws that are `linear` are no part of what a spring carries: the fit has them as impedances."""

    state: State
    name: str
    laws: tuple[Force, ...]
    push: tuple[tuple[int, float], ...]
    rate: tuple[tuple[int, float], ...]
    F: float = 0.0
    ahead: float = 0.0
    more: float = 0.0
    linear: tuple[Force, ...] = ()

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

    W[i][j]: acceleration at port i per torque at port j. Positions are those half-way, in the states already, and so is what
    springs carry but for the torques of their ports.
    """
    if len(ports) == 1:
        (port,) = ports
        port.F = _solved(port, port.velocity(v), port.velocity(a), W[0][0], h)
        return
    rates = [port.velocity(v) for port in ports]
    pulls = [port.velocity(a) for port in ports]
    springs = [(port, port.state.spring) for port in ports if port.name == "deflection_rate"]
    for _ in range(_SWEEPS):
        change = 0.0
        for spring, carried in springs:
            spring.state.spring = carried + spring.F - sum(float(law(spring.state)) for law in spring.linear)
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
    """The torque F = law(rate) of one port: at the velocity half-way; where that is stiff or the velocity turns, the mean over
    the step."""
    half, port.ahead = 0.5 * h, 0.0
    soon = a + 0.5 * half * port.more  # on the mean, until half-way
    rate_1 = v + half * (soon + W * port.F)
    F_1 = port.torque(rate_1)
    rate_2 = v + half * (soon + W * F_1)
    F_2 = port.torque(rate_2)
    end = 2.0 * rate_2 - v
    settled = abs(F_2 - F_1) <= _FIXED * abs(F_2)
    if settled and v * end >= 0.0:
        return F_2
    gain = 0.0 if settled else half * W * (F_2 - F_1) / (rate_2 - rate_1)
    if not settled and abs(gain) < 0.5:
        rate = rate_2 + (v + half * (soon + W * F_2) - rate_2) / (1.0 - gain)  # where the tangent has it
        F = port.torque(rate)
        if abs(v + half * (soon + W * F) - rate) <= _NEAR * abs(half * W * F) and v * (2.0 * rate - v) >= 0.0:
            return F
    return _through(port, v, a, W, h)


def _through(port: Port, v: float, a: float, W: float, h: float) -> float:
    """The mean torque while the velocity goes as rate' = a + more t + W law(rate), in parts of the step as short as it takes.

    Each is exact for the law's tangent, and for a bend of it in proportion to t^2 (exponential Rosenbrock method `exprb32` with its error
    estimate: M. Hochbruck, A. Ostermann, Acta Numerica 19 (2010), DOI 10.1017/S0962492910000048).
    """
    near, least, more = 1e-7 * (abs(v) + h * abs(a)) + 1e-300, h * _LEAST_PART, port.more
    rate, travel, left, part = v, 0.0, h, h
    F = port.torque(rate)
    while True:
        pull, slope = a + more * (h - left) + W * F, W * (port.torque(rate + near) - F) / near
        part = min(part, _GROWS / slope) if slope > 0.0 else part
        while True:
            one, two, three, four = _phi(part * slope)
            gained = part * (pull * one + more * part * two)
            F_end = port.torque(rate + gained)
            bend = 2.0 * part * (W * (F_end - F) - slope * gained)
            allowed = _BENT * part * abs(W) * max(abs(F), abs(F_end)) + near
            excess = abs(three * bend) / allowed
            if excess <= 1.0 or part <= least:
                break
            part = max(least, part * (0.5 if excess < 8.0 else 0.25))
        travel += part * (rate + part * (pull * two + more * part * three) + four * bend)
        rate += gained + three * bend
        left -= part
        if left <= _DONE * h:
            break
        part = min(left, part * (4.0 if excess < 0.02 else 2.0 if excess < 0.1 else 1.0))
        F = port.torque(rate)
    port.ahead = travel - 0.5 * h * (v + rate) + more * h**3 / 12.0  # what an even force's travel has too much
    return ((rate - v) / h - a - 0.5 * h * more) / W


def _phi(z: float) -> tuple[float, float, float, float]:
    """phi_k(z) for k = 1 to 4: phi_0 = exp z, phi_k+1 = (phi_k - 1 / k!) / z; by their series where z is small."""
    if abs(z) < _SMALL:
        four = 1.0
        for k in range(10, 4, -1):
            four = 1.0 + four * z / k
        four /= 24.0
        three = 1.0 / 6.0 + z * four
        two = 0.5 + z * three
        return 1.0 + z * two, two, three, four
    one = expm1(z) / z
    two = (one - 1.0) / z
    three = (two - 0.5) / z
    return one, two, three, (three - 1.0 / 6.0) / z
