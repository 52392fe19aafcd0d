"""A signal of another joint in one's own: what an amplifier gives, or an encoder reads, by a share of what another one does."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from ident.effects.base import Array, Parameter
from ident.effects.learned import Learned
from ident.effects.motion import Motion

#: What it is called by its variable, and the signal of which a share comes, at each port.
CROSSTALK = "crosstalk"
SIGNALS = {"motor": "tau", "sensor": "theta"}
#: The largest share.
MOST = 2.0


class Crosstalk(Learned):
    """A share of the signal of the joint `other`, about its mean: of a constant nothing is told."""

    variable, knots = CROSSTALK, (0.0,)
    parameters = (Parameter("height_1", "", -MOST, MOST, (0.01,), linear=True),)
    other: ClassVar[int]

    def curve(self, slides: bool = False) -> dict[str, Any]:
        """One height, the share; and of which joint, from 1."""
        return super().curve(slides) | {"from_joint": self.other + 1}

    def _heard(self, motion: Motion) -> Array:
        signal = motion.signal(SIGNALS[self.port], self.other)
        return np.asarray(self.values[0] * (signal - signal.mean()))


class TorqueCrosstalk(Crosstalk):
    """Of the torque of another motor."""

    port = "motor"

    def force(self, motion: Motion) -> Array:
        return self._heard(motion)


class AngleCrosstalk(Crosstalk):
    """Of the angle of another motor."""

    port = "sensor"

    def reading(self, motion: Motion) -> Array:
        return self._heard(motion)


def crosstalk(port_name: str, of: int) -> type[Crosstalk]:
    """The kind of crosstalk at a port, `of` another joint (from 0)."""

    class Curve(TorqueCrosstalk if port_name == "motor" else AngleCrosstalk):  # type: ignore[misc]
        other = of

    return Curve
