"""Dry friction that gives before it slides and is less the faster it does: bristles of a contact, which a film of oil lifts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, final

import numpy as np

from ident.effects.base import Array, Parameter, PeriodicLaw
from ident.effects.hysteresis import recursion
from ident.effects.learned import Unnamed
from ident.effects.motion import State, bell

#: What its curve is called by its variable; knots of it, up to so many times its speed.
LUBRICATED, KNOTS, REACH = "lubricated", 25, 3.0
#: Share of what slides at rest that is left at any speed, at least: where nothing slides nothing is bent.
LEAST = 1e-9


class Lubricated(Unnamed, PeriodicLaw):
    """LuGre's friction F + time F' of a position x: F' = (g x' - F |x'|) / a, where g = level + peak exp(-(x'/speed)^2) is what slides
    at x' for long and a = distance g / (level + peak) how far bristles bend (C. Canudas de Wit, H. Olsson, K. Astrom, P. Lischinsky,
    IEEE T-AC 40 (1995), DOI 10.1109/9.376053)."""

    variable = LUBRICATED
    port: ClassVar[str]
    parameters = (
        Parameter("level", "Nm", 0.0, 1.0, (0.1,), linear=True, relative="torque", sliding="N"),
        Parameter("peak", "Nm", 0.0, 1.0, (0.05,), linear=True, relative="torque", sliding="N"),
        Parameter("distance", "rad", 0.005, 5.0, (0.03, 0.1, 0.3), zero=None, relative="angle", sliding="m"),
        Parameter("speed", "rad/s", 0.02, 5.0, (0.2, 0.6), zero=None, relative="rate", sliding="m/s"),
        Parameter("time", "s", 0.0, 0.1, (2e-4,), zero=None),
    )

    def slides(self, v: Any) -> Any:
        """What it is where it slides at v for long."""
        return self["level"] + self["peak"] * bell(v / self["speed"])

    def _bends(self, slides: Any) -> Any:
        """How far bristles bend that slide at so much."""
        most = self["level"] + self["peak"]
        return self["distance"] * (np.maximum(slides / most, LEAST) if most else 1.0)

    def over_period(self, at: State) -> Array:
        """The recursion is affine, so its fixed point is known."""
        x, v = at.at(self.port)
        g = self.slides(v)
        a, step = self._bends(g), np.diff(x, prepend=x[-1])
        kept = np.exp(-np.abs(step) / a)
        values, left = recursion(kept, np.sign(step) * (1.0 - kept) * g)
        F = values + left * (values[-1] / (1.0 - left[-1]) if left[-1] < 1.0 else 0.0)
        return np.asarray(-self._damped(F, g, a, v))

    def _damped(self, F: Any, g: Any, a: Any, v: Any) -> Any:
        """What bristles carry that bend."""
        return F + self["time"] * (g * v - F * abs(v)) / a

    def start(self, step: float) -> tuple[Callable[[State], float], Callable[[State], None]]:
        carried, last = [0.0], [0.0]  # by the bristles, where it was last asked to remember; the velocity since

        def later(v: float, time: float) -> tuple[float, float, float]:
            g = float(self.slides(v))
            a = float(self._bends(g))
            kept = float(np.exp(-abs(v) * time / a))
            return kept * carried[0] + (1.0 - kept) * g * float(np.sign(v)), g, a

        def law(at: State) -> float:
            v = last[0] = float(at.at(self.port)[1])
            return -float(self._damped(*later(v, 0.5 * step), v))

        def remember(at: State) -> None:
            carried[0] = later(last[0], step)[0]

        return law, remember

    def curve(self, slides: bool = False) -> dict[str, Any]:
        """What it is where it slides for long, over speed. Its parameters are none of the heights."""
        v = np.linspace(0.0, REACH * self["speed"], KNOTS)
        return {
            "variable": self.variable, "knots": v.tolist(), "period": None, "heights": self.slides(v).tolist(),
            "unit": self.unit(self.parameters[0], slides), "at": [], "smooth": True,
            "period_unit": "m" if slides and self.port != "motor" else "rad",
        }  # fmt: skip


@final
class LubricatedMotor(Lubricated):
    """That of a motor."""

    port = "motor"


@final
class LubricatedLink(Lubricated):
    """That of a link's bearing."""

    port = "link"
