"""A mass on a spring that nobody declared, on a motor's shaft: the disc of a brake, a fan, half of a coupling."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from ident.effects.base import Complex, Known, Parameter
from ident.effects.learned import Unnamed

#: Its curve goes so many times below and beyond its frequency, at so many knots; and some half-widths of its peak about that.
REACH, KNOTS = 8.0, 33
ABOUT = (-4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0)


@final
class Ringing(Unnamed):
    """A mass on a spring that turns with a motor, and rings; motor side. Far below its frequency the motor feels its inertia, far
    beyond hardly anything."""

    port = "motor"
    variable = "resonance"
    parameters = (
        Parameter("inertia", "kgm2", 0.0, 10.0, (0.1, 0.03), relative="J"),
        Parameter("frequency", "Hz", 0.5, 1e3, (10.0, 20.0, 40.0, 80.0), zero=None),
        Parameter("damping", "s", 0.0, 0.1, (2e-4,), zero=None),
    )

    def felt(self, s: Complex) -> Complex:
        """The inertia [S, kg m2] that the motor feels at s: J (s d + k) / (s^2 J + s d + k)."""
        J, frequency, damping = self.values
        square = (2.0 * np.pi * frequency) ** 2
        sprung = square * (1.0 + s * damping)
        return np.asarray(J * sprung / (s**2 + sprung))

    def impedance(self, s: Complex, arm: Known) -> Complex:
        n, i = len(arm.N), self.joint
        assert i is not None
        result = np.zeros((len(s), 2 * n, 2 * n), dtype=complex)
        result[:, i, i] = arm.N[i] ** 2 * s**2 * self.felt(s)
        return result

    def curve(self, slides: bool = False) -> dict[str, Any]:
        """The inertia that is felt at frequencies [Hz]; besides its heights, `phases` [rad]. Its parameters are none of the heights."""
        _, frequency, damping = self.values
        width = max(np.pi * frequency * damping, 1e-3)
        shares = np.append(np.geomspace(1.0 / REACH, REACH, KNOTS), 1.0 + width * np.array(ABOUT))
        f = frequency * np.unique(shares[shares > 0.0])
        felt = self.felt(np.asarray(2j * np.pi * f, dtype=complex))
        return {
            "variable": self.variable, "knots": f.tolist(), "period": None, "heights": np.abs(felt).tolist(),
            "phases": np.angle(felt).tolist(), "unit": "kgm2", "at": [], "smooth": True, "period_unit": "rad",
        }  # fmt: skip
