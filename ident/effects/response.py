"""A frequency response that nobody named: what a drive or a sensor makes of its signal, as a curve of frequency."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any, Self

import numpy as np
from scipy.interpolate import CubicSpline

from ident.effects.base import Array, Complex, Known, Parameter
from ident.effects.learned import Learned


class Response(Learned):
    """The signal comes through gain(f) exp(-2 pi i f delay(f)): the logarithm of the gain, and the delay [s], are smooth curves of
    log f through their heights at `knots` [Hz]. The gain is one at the first knot: what it is at rest `torque-scale` tells.
    Beyond its ends a curve stays as it is.
    """

    variable = "frequency"

    def curve(self, slides: bool = False) -> dict[str, Any]:
        """Its heights are gains; besides them, `delays` [s]."""
        gains, delays = np.split(np.asarray(self.values), [len(self.knots) - 1])
        heights = [1.0, *np.exp(gains).tolist()]
        return super().curve(slides) | {
            "heights": heights,
            "delays": delays.tolist(),
            "at": [*self.knots[1:], *self.knots],
        }

    def response(self, s: Complex) -> Complex:
        """What becomes of the signal [S] at s."""
        gain, delay = self.at_frequencies(s.imag / (2.0 * np.pi))
        return np.asarray(gain * np.exp(-1j * s.imag * delay))

    def at_frequencies(self, f: Array) -> tuple[Array, Array]:
        """Gain and delay [s] at frequencies f [S, Hz]."""
        gain, delay = np.split(np.asarray(self.values), [len(self.knots) - 1])
        shapes = _shapes(self.knots, np.abs(f).tobytes())
        return np.exp(shapes[:, 1:] @ gain), shapes @ delay

    @classmethod
    def shapes(cls, s: Complex) -> Array:
        """What a height of one at each knot makes of a curve at s [S, K]."""
        return _shapes(cls.knots, np.abs(s.imag / (2.0 * np.pi)).tobytes())

    @classmethod
    def of_gains(cls, joint: int, gains: Complex) -> Self:
        """The response with complex `gains` at its knots, the first as if it were one."""
        delays = -np.unwrap(np.angle(gains)) / (2.0 * np.pi * np.asarray(cls.knots))
        both = zip(cls.parameters, (*np.log(np.abs(gains[1:])), *delays), strict=True)
        return cls(joint, tuple(float(np.clip(value, p.low, p.high)) for p, value in both))


class TorqueResponse(Response):
    """Of the commanded torque: filters, current loop, bus."""

    port = "motor"

    def torque_gain(self, s: Complex, arm: Known) -> Complex:
        return self.at_joint(self.response(s), 1.0, len(arm.N))


class AngleResponse(Response):
    """Of the measured motor angle: filters of the encoder."""

    port = "sensor"

    def angle_gain(self, s: Complex, arm: Known) -> Complex:
        return self.at_joint(self.response(s), 1.0, len(arm.N))


@cache
def _spline(knots: tuple[float, ...]) -> CubicSpline:
    return CubicSpline(np.log(knots), np.eye(len(knots)), bc_type="not-a-knot")


@lru_cache(maxsize=64)
def _shapes(knots: tuple[float, ...], f: bytes) -> Array:
    """What a height of one at each knot makes of the frequencies [S, K]."""
    return np.asarray(_spline(knots)(np.log(np.clip(np.frombuffer(f), knots[0], knots[-1]))))


def response(port_name: str, at: Sequence[float]) -> type[Response]:
    """The kind of response with knots `at` [Hz] of a joint's torque (port motor) or angle (port sensor)."""
    gains = tuple(Parameter(f"log_gain_{k + 2}", "", -5.0, 5.0, (0.0,), linear=True) for k in range(len(at) - 1))
    delays = tuple(Parameter(f"delay_{k + 1}", "s", -0.1, 0.1, (0.0,), linear=True) for k in range(len(at)))

    class Curve(TorqueResponse if port_name == "motor" else AngleResponse):  # type: ignore[misc]
        parameters = gains + delays
        knots = tuple(float(f) for f in at)

    return Curve
