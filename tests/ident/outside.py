"""Effects that are in no catalogue: written for tests only, so that a diagnosis meets what nobody has named for it.

All but three are torques that follow from what their port does, or did, one is a filter, one an encoder's error, one a mass that rings; so what
is learned has a chance where no name has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, final

import numpy as np
from scipy.linalg import expm

from ident.effects.base import Effect, Law, Parameter, Path, PortLaw
from ident.effects.motion import Motion, State, direction


@final
class Detent(Law):
    """Magnets that catch the motor at a few angles of every turn: narrow wells, flat ground between them."""

    name, port = "detent", "motor"
    parameters = (
        Parameter("depth", "Nm", 0.0, 1.0, (0.05,), linear=True, relative="torque"),
        Parameter("teeth", "", 1.0, 20.0, (3.0,), zero=None, whole=True),
        Parameter("at", "rad", -np.pi, np.pi, (0.0,), zero=None),
    )

    def law(self, at: State) -> Any:
        depth, teeth, where = self.values
        x = teeth * at.theta - where
        return -depth * np.sin(x) * np.exp(4.0 * (np.cos(x) - 1.0))


@final
class PlaceFriction(Law):
    """Dry friction that depends on where the motor is: a shaft that is bent."""

    name, port = "place-friction", "motor"
    parameters = (
        Parameter("level", "Nm", 0.0, 1.0, (0.1,), linear=True, relative="torque"),
        Parameter("order", "", 1.0, 20.0, (5.0,), zero=None, whole=True),
    )

    def law(self, at: State) -> Any:
        level, order = self.values
        return -level * (1.0 + np.sin(order * at.theta)) * direction(at.omega, at.N)


@final
class EddyBrake(Law):
    """An eddy-current brake: drag that is largest at one speed and falls beyond it."""

    name, port = "eddy-brake", "motor"
    parameters = (
        Parameter("drag", "Nm", 0.0, 1.0, (0.1,), linear=True, relative="torque"),
        Parameter("speed", "rad/s", 0.02, 5.0, (0.5,), zero=None, relative="rate"),
    )

    def law(self, at: State) -> Any:
        drag, speed = self.values
        v = at.omega / speed
        return -2.0 * drag * v / (1.0 + v * v)


@final
class SaturatingMesh(Law):
    """Preloaded teeth beside the spring: stiff near no load, no more than `torque` beyond."""

    name, port = "saturating-mesh", "spring"
    parameters = (
        Parameter("torque", "Nm", 0.0, 1.0, (0.1,), linear=True, relative="torque"),
        Parameter("width", "rad", 0.02, 5.0, (0.5,), zero=None, relative="angle"),
    )

    def law(self, at: State) -> Any:
        torque, width = self.values
        return torque * np.tanh(at.deflection / width)


@final
class RootDamper(Law):
    """|v|^0.5 against the motion of the link: infinitely stiff at rest."""

    name, port = "root-damper", "link"
    parameters = (Parameter("level", "Nm s^0.5", 0.0, 10.0, (0.1,), linear=True, relative="torque"),)

    def law(self, at: State) -> Any:
        return -self["level"] * np.sign(at.q_rate) * np.sqrt(np.abs(at.q_rate))


@final
class LinkMagnets(Law):
    """Cogging of the link: poles along its bearing, `order` a turn, no whole number of motor turns apart."""

    name, port = "link-magnets", "link"
    parameters = (
        Parameter("amplitude", "Nm", 0.0, 1.0, (0.05,), linear=True, relative="torque"),
        Parameter("order", "", 10.0, 1000.0, (270.0,), zero=None, whole=True),
        Parameter("phase", "rad", -np.pi, np.pi, (0.0,), zero=None),
    )

    def law(self, at: State) -> Any:
        amplitude, order, phase = self.values
        return amplitude * np.sin(order * at.q + phase)


@final
class OneWayDamper(Law):
    """A damper with a check valve: viscous one way, nothing the other."""

    name, port = "one-way-damper", "link"
    parameters = (Parameter("damping", "Nms/rad", 0.0, 10.0, (0.1,), linear=True, relative="torque/rate"),)

    def law(self, at: State) -> Any:
        return -self["damping"] * np.maximum(at.q_rate, 0.0)


@final
class DeadTime(Law):
    """An amplifier whose switches wait at every change: so much torque is lost, whatever is asked for, but near none."""

    name, port = "dead-time", "motor"
    parameters = (
        Parameter("level", "Nm", 0.0, 1.0, (0.05,), linear=True, relative="torque"),
        Parameter("width", "Nm", 0.01, 1.0, (0.1,), zero=None, relative="torque"),
    )

    def law(self, at: State) -> Any:
        level, width = self.values
        return -level * np.tanh(at.tau / width)


@final
class WeakMagnet(Law):
    """A motor whose torque falls behind its current as that grows: `loss` at the torque `at`."""

    name, port = "weak-magnet", "motor"
    parameters = (
        Parameter("loss", "Nm", 0.0, 1.0, (0.05,), linear=True, relative="torque"),
        Parameter("at", "Nm", 0.01, 10.0, (1.0,), zero=None, relative="torque"),
    )

    def law(self, at: State) -> Any:
        x = at.tau / self["at"]
        return -self["loss"] * x * np.abs(x)


@final
class FallingFriction(Law):
    """Dry friction of the link that is lost with speed."""

    name, port = "falling-friction", "link"
    parameters = (
        Parameter("level", "Nm", 0.0, 1.0, (0.1,), linear=True, relative="torque"),
        Parameter("speed", "rad/s", 0.02, 5.0, (0.3,), zero=None, relative="rate"),
    )

    def law(self, at: State) -> Any:
        level, speed = self.values
        return -level * direction(at.q_rate) * np.exp(-np.abs(at.q_rate) / speed)


@final
class PlaceDamper(Law):
    """A damper in the bearing of the link that depends on where it is: `order` waves a turn."""

    name, port = "place-damper", "link"
    parameters = (
        Parameter("damping", "Nms/rad", 0.0, 10.0, (0.1,), linear=True, relative="torque/rate"),
        Parameter("order", "", 10.0, 1000.0, (200.0,), zero=None, whole=True),
    )

    def law(self, at: State) -> Any:
        damping, order = self.values
        return -damping * (1.0 + np.cos(order * at.q)) * at.q_rate


@final
class PressedFriction(Law):
    """Dry friction of the motor that grows with the torque that it gives."""

    name, port = "pressed-friction", "motor"
    parameters = (Parameter("share", "", 0.0, 1.0, (0.1,), linear=True),)

    def law(self, at: State) -> Any:
        return -self["share"] * np.abs(at.tau) * direction(at.omega, at.N)


@final
class Commutation(Law):
    """A motor that gives more of the torque asked for at some angles: a ripple that is a share of it."""

    name, port = "commutation", "motor"
    parameters = (
        Parameter("share", "", 0.0, 1.0, (0.1,), linear=True),
        Parameter("order", "", 1.0, 20.0, (5.0,), zero=None, whole=True),
    )

    def law(self, at: State) -> Any:
        share, order = self.values
        return share * np.sin(order * at.theta) * at.tau


@final
class UnevenTeeth(Law):
    """Teeth that pass the load on unevenly: a ripple that is a share of it."""

    name, port = "uneven-teeth", "motor"
    parameters = (
        Parameter("share", "", 0.0, 1.0, (0.1,), linear=True),
        Parameter("order", "", 1.0, 20.0, (5.0,), zero=None, whole=True),
    )

    def law(self, at: State) -> Any:
        share, order = self.values
        return share * np.sin(order * at.theta) * at.spring / at.N


@final
class MeshStiffness(Law):
    """Teeth that share the load by turns: a spring as stiff as where the motor is."""

    name, port = "mesh-stiffness", "spring"
    parameters = (
        Parameter("stiffness", "Nm/rad", 0.0, 1.0, (0.1,), linear=True, relative="K"),
        Parameter("order", "", 1.0, 20.0, (2.0,), zero=None, whole=True),
    )

    def law(self, at: State) -> Any:
        stiffness, order = self.values
        return stiffness * np.sin(order * at.theta) * at.deflection


@final
class FadingTorque(Law):
    """A drive that runs out of voltage: so much of its torque is lost at a speed."""

    name, port = "fading-torque", "motor"
    parameters = (
        Parameter("share", "", 0.0, 1.0, (0.1,), linear=True),
        Parameter("speed", "rad/s", 0.1, 1e3, (10.0,), zero=None, relative="rate"),
    )

    def law(self, at: State) -> Any:
        return -self["share"] * at.tau * np.minimum(np.abs(at.omega) / self["speed"], 5.0)


@final
class IronLoss(Law):
    """A motor that drags as much as it pulls: viscous, by its own torque."""

    name, port = "iron-loss", "motor"
    parameters = (
        Parameter("damping", "Nms/rad", 0.0, 1.0, (1e-4,), linear=True, relative="torque/rate"),
        Parameter("at", "Nm", 0.01, 10.0, (1.0,), zero=None, relative="torque"),
    )

    def law(self, at: State) -> Any:
        return -self["damping"] * np.abs(at.tau) / self["at"] * at.omega


@final
class LadenDamper(Law):
    """Grease under load: a damper of the link that grows with what its spring carries."""

    name, port = "laden-damper", "link"
    parameters = (
        Parameter("damping", "Nms/rad", 0.0, 100.0, (0.1,), linear=True, relative="torque/rate"),
        Parameter("at", "Nm", 0.01, 100.0, (1.0,), zero=None, relative="torque"),
    )

    def law(self, at: State) -> Any:
        return -self["damping"] * np.abs(at.spring) / self["at"] * at.q_rate


@final
class RubberDamper(Law):
    """A spring that damps the more the farther it is wound."""

    name, port = "rubber-damper", "spring"
    parameters = (
        Parameter("damping", "Nms/rad", 0.0, 1e3, (1.0,), linear=True, relative="torque/rate"),
        Parameter("at", "rad", 1e-6, 1.0, (1e-3,), zero=None, relative="angle"),
    )

    def law(self, at: State) -> Any:
        return self["damping"] * (at.deflection / self["at"]) ** 2 * at.deflection_rate


@final
class EncoderWaves(Effect):
    """Interpolation of an encoder's lines: two waves, not one."""

    name, port = "encoder-waves", "sensor"
    parameters = (
        Parameter("amplitude", "rad", 0.0, 0.05, (2e-3,), linear=True, relative="angle"),
        Parameter("order", "1/rev", 1.0, 64.0, (5.0,), zero=None, whole=True),
    )

    def reading(self, motion: Motion) -> np.ndarray:
        return np.asarray(self._error(motion.signal("theta", int(self.joint or 0))))

    def misread(self, theta: float) -> float:
        return float(self._error(theta))

    def _error(self, theta: Any) -> Any:
        x = self["order"] * theta
        return self["amplitude"] * (np.sin(x) + 0.5 * np.sin(2.0 * x + 1.0))


@final
class CurrentLoop(Effect):
    """A current loop of second order, critically damped."""

    name, port = "current-loop", "motor"
    parameters = (Parameter("time", "s", 0.0, 0.05, (1e-3,)),)

    def path(self) -> Path:
        return Path(lags=(self["time"], self["time"]))


@final
class BrakeDisc(PortLaw):
    """The disc of a brake, or a fan, that a motor turns by a spring: it rings."""

    name, port, linear = "brake-disc", "motor", True
    parameters = (
        Parameter("inertia", "kgm2", 0.0, 10.0, (0.1,), relative="J"),
        Parameter("frequency", "Hz", 0.5, 1e3, (50.0,), zero=None),
        Parameter("damping", "s", 0.0, 0.1, (2e-4,), zero=None),
    )

    def start(self, step: float) -> tuple[Callable[[State], float], Callable[[State], None]]:
        """Exact where the motor's acceleration is even from before where it was last remembered."""
        J, frequency, damping = self.values
        square = (2.0 * np.pi * frequency) ** 2
        moving = np.diag([1.0, 0.0, 1.0, 1.0], 1)  # of the disc's angle and rate, the motor's angle, rate, acceleration
        moving[1] = [-square, -square * damping, square, square * damping, 0.0]
        whole, half = expm(moving * step), expm(moving * 0.5 * step)
        disc: list[float] = []  # its angle and rate, the motor's angle, and that a step before

        def begin(at: State, later: float) -> np.ndarray:
            angle, rate, here, before = disc or (at.theta, 0.0, at.theta, at.theta)
            came, goes = (here - before) / step, (at.theta - here) / later
            acceleration = 2.0 * (goes - came) / (step + later)
            return np.array([angle, rate, here, goes - 0.5 * later * acceleration, acceleration])

        def remember(at: State) -> None:
            state = whole @ begin(at, step)
            disc[:] = [*state[:2].tolist(), at.theta, disc[2] if disc else at.theta]

        def law(at: State) -> float:
            angle, rate, theta, *_ = half @ begin(at, 0.5 * step)
            return float(J * square * (angle - theta + damping * (rate - at.omega)))

        return law, remember


@final
class Bristles(PortLaw):
    """Dry friction of the motor that gives before it slides: three bristles of a contact, each a spring that slips sooner than the next."""

    name, port = "bristles", "motor"
    parameters = (
        Parameter("level", "Nm", 0.0, 1.0, (0.1,), linear=True, relative="torque"),
        Parameter("distance", "rad", 1e-4, 5.0, (0.05,), zero=None, relative="angle"),
    )

    def start(self, step: float) -> tuple[Callable[[State], float], Callable[[State], None]]:
        level, distance = self.values
        levels, slips = level * np.array([0.5, 0.3, 0.2]), distance * np.array([1.0, 4.0, 16.0])
        bent: list[np.ndarray] = []  # where the motor was, and how far each is bent

        def now(at: State) -> np.ndarray:
            before, here = bent or (at.theta, np.zeros(3))
            return np.asarray(np.clip(here + at.theta - before, -slips, slips))

        def remember(at: State) -> None:
            bent[:] = [at.theta, now(at)]

        return lambda at: -float(levels @ (now(at) / slips)), remember


@final
class OiledBristles(PortLaw):
    """The same of one kind of bristle, that slides by less the faster it does, and has a damping of its own."""

    name, port = "oiled-bristles", "motor"
    parameters = (
        Parameter("level", "Nm", 0.0, 1.0, (0.1,), linear=True, relative="torque"),
        Parameter("distance", "rad", 1e-4, 5.0, (0.05,), zero=None, relative="angle"),
        Parameter("speed", "rad/s", 0.02, 5.0, (0.4,), zero=None, relative="rate"),
    )

    def start(self, step: float) -> tuple[Callable[[State], float], Callable[[State], None]]:
        level, distance, speed = self.values
        stiffness, damping, bent, last = level / distance, 5e-4, [0.0], [0.0]

        def later(v: float, time: float) -> tuple[float, float]:
            slips = level * (1.0 + 0.5 * np.exp(-((v / speed) ** 2))) / stiffness
            there = bent[0] + (np.sign(v) * slips - bent[0]) * -np.expm1(-abs(v) * time / slips)
            return there, v - abs(v) * there / slips

        def law(at: State) -> float:
            last[0] = at.omega
            there, rate = later(at.omega, 0.5 * step)
            return -float(stiffness * (there + damping * rate))

        def remember(at: State) -> None:
            bent[0] = later(last[0], step)[0]

        return law, remember


OUTSIDE: dict[str, type[Effect]] = {
    kind.name: kind
    for kind in (
        Detent,
        PlaceFriction,
        EddyBrake,
        SaturatingMesh,
        RootDamper,
        LinkMagnets,
        OneWayDamper,
        DeadTime,
        WeakMagnet,
        FallingFriction,
        PlaceDamper,
        PressedFriction,
        Commutation,
        UnevenTeeth,
        MeshStiffness,
        FadingTorque,
        IronLoss,
        LadenDamper,
        RubberDamper,
        EncoderWaves,
        CurrentLoop,
        BrakeDisc,
        Bristles,
        OiledBristles,
    )
}

#: As `draws.RANGES`. The root damper's level is in N m at 1 rad/s; links move at some 0.1 rad/s.
OUTSIDE_RANGES: dict[str, Mapping[str, tuple[object, ...]]] = {
    "detent": {"depth": (0.03, 0.1), "teeth": ("one of", 2, 3, 5), "at": ("+-", 0.1, 3.1)},
    "place-friction": {"level": (0.05, 0.15), "order": ("one of", 3, 5, 7)},
    "eddy-brake": {"drag": (0.05, 0.2), "speed": (0.3, 1.0)},
    "saturating-mesh": {"torque": (0.03, 0.2), "width": (0.2, 0.8)},
    "root-damper": {"level": (0.1, 0.5)},
    "link-magnets": {"amplitude": (0.03, 0.1), "order": ("one of", 170, 230, 270), "phase": ("+-", 0.1, 3.1)},
    "one-way-damper": {"damping": (0.05, 0.3)},
    "dead-time": {"level": (0.03, 0.15), "width": (0.03, 0.3)},
    "falling-friction": {"level": (0.05, 0.2), "speed": (0.2, 0.6)},
    "weak-magnet": {"loss": (0.02, 0.1), "at": (0.9, 1.1)},
    "place-damper": {"damping": (0.03, 0.15), "order": ("one of", 170, 230, 270)},
    "pressed-friction": {"share": (0.03, 0.15)},
    "commutation": {"share": (0.02, 0.1), "order": ("one of", 2, 3, 5)},
    "uneven-teeth": {"share": (0.02, 0.1), "order": ("one of", 2, 3, 5)},
    "fading-torque": {"share": (0.02, 0.1), "speed": (0.9, 1.1)},
    "iron-loss": {"damping": (0.03, 0.2), "at": (0.9, 1.1)},
    "laden-damper": {"damping": (0.03, 0.2), "at": (0.9, 1.1)},
    "rubber-damper": {"damping": (0.02, 0.1), "at": (0.9, 1.1)},
    "encoder-waves": {"amplitude": (0.003, 0.03), "order": ("one of", 3, 5, 8)},
    "current-loop": {"time": (2e-4, 1e-3)},
    "brake-disc": {"inertia": (0.05, 0.3), "frequency": (15.0, 80.0), "damping": (5e-5, 2e-3)},
    "bristles": {"level": (0.05, 0.2), "distance": (0.03, 0.2)},
    "oiled-bristles": {"level": (0.05, 0.2), "distance": (0.03, 0.2), "speed": (0.2, 0.6)},
    "mesh-stiffness": {"stiffness": (0.02, 0.1), "order": ("one of", 2, 4)},
}  # fmt: skip
