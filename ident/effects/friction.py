"""Friction: laws of the velocity at a port, dry ones smoothed over the creep of real contacts.

A sign that jumps has no linear response and no model error small enough; a real contact creeps before it slides
(B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994), DOI 10.1016/0005-1098(94)90209-7). So
sign(v) is tanh(v / creep) here: creep is about a hundredth of the speeds of a record, and large against the velocity noise of an
encoder. Where it is another, records of a joint that rests show it: see `creeping`.
"""

from __future__ import annotations

from typing import Any, final

from ident.effects.base import Complex, Known, Law, Parameter
from ident.effects.impedance import at_link
from ident.effects.motion import State, bell, direction

_LEVEL = Parameter("level", "Nm", 0.0, 1.0, (0.1, 0.03), linear=True, relative="torque", sliding="N")


@final
class MotorCoulomb(Law):
    """Dry friction of the motor and the fast gear stage."""

    name, port, dry = "motor-coulomb", "motor", True
    parameters = (_LEVEL,)

    def law(self, at: State) -> Any:
        return -self["level"] * direction(at.omega, at.N, self.creep)


@final
class MotorStribeck(Law):
    """Dry friction that falls from level + peak to level as the oil film builds up: peak exp(-(omega/speed)^2) more."""

    name, port, dry = "motor-stribeck", "motor", True
    parameters = (
        Parameter("level", "Nm", 0.0, 1.0, (0.05,), linear=True, relative="torque"),
        Parameter("peak", "Nm", 0.0, 1.0, (0.1, 0.03), linear=True, relative="torque"),
        Parameter("speed", "rad/s", 0.02, 5.0, (0.3, 1.0), zero=None, relative="rate"),
    )

    def law(self, at: State) -> Any:
        level, peak, speed = self.values[:3]
        return -(level + peak * bell(at.omega / speed)) * direction(at.omega, at.N, self.creep)


@final
class MotorQuadraticDrag(Law):
    """Churning oil, a fan: drag with the square of the speed."""

    name, port, drags = "motor-quadratic-drag", "motor", True
    parameters = (Parameter("drag", "Nms2/rad2", 0.0, 1.0, (0.05,), linear=True, relative="torque/rate^2"),)

    def law(self, at: State) -> Any:
        return -self["drag"] * at.omega * abs(at.omega)


@final
class LoadDependentFriction(Law):
    """Dry friction of the output in proportion to the torque that its spring carries: share |spring| against the link."""

    name, port, dry, by_load = "load-dependent-friction", "link", True, True
    parameters = (Parameter("share", "", 0.0, 1.0, (0.05, 0.02), linear=True),)

    def law(self, at: State) -> Any:
        return -self["share"] * abs(at.spring) * direction(at.q_rate, 1.0, self.creep)


@final
class LinkCoulomb(Law):
    """Dry friction of the output bearing and its seals."""

    name, port, dry = "link-coulomb", "link", True
    parameters = (_LEVEL,)

    def law(self, at: State) -> Any:
        return -self["level"] * direction(at.q_rate, 1.0, self.creep)


@final
class LinkViscous(Law):
    """Viscous friction of the output bearing."""

    name, port, linear, drags = "link-viscous", "link", True, True
    parameters = (
        Parameter("damping", "Nms/rad", 0.0, 10.0, (0.1, 0.02), linear=True, relative="torque/rate", sliding="Ns/m"),
    )

    def law(self, at: State) -> Any:
        return -self["damping"] * at.q_rate

    def impedance(self, s: Complex, arm: Known) -> Complex:
        return at_link(s * self["damping"], self.joint, len(arm.N))
