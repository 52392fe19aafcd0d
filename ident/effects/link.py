"""What hangs beside the gear between one link and the next."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from ident.effects.base import Complex, Known, Law, Parameter
from ident.effects.impedance import at_link
from ident.effects.motion import State


@final
class CableStiffness(Law):
    """A dress pack that pulls the link to where it was laid out: -stiffness (q - neutral)."""

    name, port, linear = "cable-stiffness", "link", True
    parameters = (
        Parameter("stiffness", "Nm/rad", 0.0, 1.0, (0.005, 0.02), linear=True, relative="K", sliding="N/m"),
        Parameter("neutral", "rad", -10.0, 10.0, (0.0,), zero=None, sliding="m"),
    )

    def law(self, at: State) -> Any:
        return -self["stiffness"] * (at.q - self["neutral"])

    def impedance(self, s: Complex, arm: Known) -> Complex:
        return at_link(np.full(len(s), self["stiffness"] + 0j), self.joint, len(arm.N))
