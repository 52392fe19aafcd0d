"""The noise of a record, as a whole-arm fit weighs it: torque noise through the arm, and angle noise, two powers a joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from ident.arm.arm_model import NOTHING, Extra, Parameters, Posture, Sampling, response
from ident.arm.small_matrices import by_component, inverses, products, times
from ident.records.campaign import Array
from ident.records.frf import Complex, moving_average

#: The model is computed to about this accuracy of an angle: no noise is taken to be smaller.
MODEL_ACCURACY = 1e-8
#: Lines over which the first guess of the noise power is smoothed, and the passes that replace it by its model.
SMOOTHED, NOISE_PASSES = 15, 3
#: Share of the largest torque noise from which a smaller one is looked for, and steps to the likeliest powers.
SMALL, STEPS = 1e-3, 5
#: Power of the samples at a line, over what all lines make of it, from which on it stands out, and from twice which it is the line's own:
#: chance does that once in 100 000 lines.
STANDS_OUT = 3.5
#: Lines over which an angle is averaged that a doubt is relative to: a line that was not excited has none of its own.
NEIGHBOURS = 7


@dataclass(frozen=True)
class Noise:
    """What is known of the noise of m joints at L lines: `samples` [R, L, 2 m] of (tau, theta), the quantisation `floor` [L, m,
    rad^2] of theta, or one of all lines [m]."""

    samples: Complex
    floor: Array


@dataclass(frozen=True, eq=False)
class Powers:
    """Noise powers of m joints: of the torques [m, (N m)^2] and, at L lines, of the angles [L, m, rad^2]; `G` [L, m, m] is how
    the torques' noise gets to the angles."""

    torque: Array
    angle: Array
    G: Complex

    def of_model(self) -> Complex:
        """The covariance [L, m, m] of what torque noise makes of the angles."""
        return products(self.G * self.torque, np.swapaxes(self.G.conj(), 1, 2))


def noise_powers(
    arm: Posture, p: Parameters, sampling: Sampling, noise: Noise, theta: Complex, extra: Extra = NOTHING
) -> Powers:
    """Returns the powers that explain the samples between the lines.

    Two of each joint, constant over the band, weighted by their own prediction (maximum likelihood, P. Whittle); those of
    the angles not below quantisation nor what `theta` [L, m] is computed to, and larger at lines whose samples stand out: what rings
    for many periods leaks at its own line only.
    """
    m, L = len(arm.live), len(sampling.f)
    G = response(arm, p, sampling, extra)
    error = noise.samples[:, :, m:] - times(G, noise.samples[:, :, :m])
    power = np.mean(np.abs(error) ** 2, axis=0)
    largest = (np.abs(theta) / np.abs(arm.N)).max(axis=1)[:, None]
    least = np.maximum(noise.floor, (MODEL_ACCURACY * largest * arm.N) ** 2)
    rows = np.concatenate([np.abs(G) ** 2, np.broadcast_to(np.eye(m), (L, m, m))], axis=2)
    predicted, powers = moving_average(power, min(SMOOTHED, L)), np.zeros(2 * m)
    for _ in range(NOISE_PASSES):
        weight = 1.0 / np.maximum(predicted, least)
        X = (rows * weight[..., None]).reshape(L * m, 2 * m)
        size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
        powers = nnls(X / size, (power * weight).ravel())[0] / size
        predicted = rows @ powers
    torque, angle = _likeliest(G, error, powers[:m], powers[m:], least)
    found = Powers(torque, least + angle, G)
    expected = found.angle + np.einsum("lii->li", found.of_model()).real
    ratio = power / expected
    own = np.clip(ratio / STANDS_OUT - 1.0, 0.0, 1.0) * (ratio - 1.0) * expected
    return Powers(torque, found.angle + own, G)


def _likeliest(G: Complex, error: Complex, torque: Array, angle: Array, least: Array) -> tuple[Array, Array]:
    """The powers [m] of torques and angles, these beyond `least` [L, m], under which samples [R, L, m] of the error are likeliest, as
    vectors: from ones under which each angle alone is.

    A joint that drifts would leave others without noise of their own, and what these do together impossible. Every step makes the
    samples likelier (H. Zhou et al., J. Comput. Graph. Stat. 28 (2019), DOI 10.1080/10618600.2018.1529601).
    """
    m, L, i = len(torque), len(G), np.arange(len(torque))
    torque, angle = np.maximum(torque, SMALL * torque.max()), np.maximum(angle, least.min(axis=0))
    # joints whose noise differs by far are inverted as if they were alike
    unit = 1.0 / np.sqrt((np.abs(G) ** 2) @ torque + angle + least)
    G, error, least, own = G * unit[..., None], error * unit, least * unit**2, unit**2
    columns = np.moveaxis(G, 0, 1)  # m, L, m
    power = columns[:, None] * columns.conj()  # of the angles' covariance, by each torque's: m, m, L, m
    by_torque = np.stack([power.real, power.imag], axis=3).reshape(-1, m)
    found = by_component(np.einsum("rli,rlk->ikl", error, error.conj()) / len(error))
    for _ in range(STEPS):
        covariance = by_component((by_torque @ torque).view(complex).reshape(m, m, L))
        covariance[:, i, i] += angle * own + least
        expected = inverses(covariance)
        seen = products(products(expected, found), expected)
        of_torque = (
            by_torque.T @ np.ascontiguousarray(np.moveaxis(x, 0, 2)).view(float).ravel() for x in (seen, expected)
        )
        torque = torque * _root_of_ratio(*of_torque)
        angle = angle * _root_of_ratio(*((x[:, i, i].real * own).sum(axis=0) for x in (seen, expected)))
    return torque, angle


def _root_of_ratio(seen: Array, expected: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(seen, 0.0) / np.maximum(expected, 1e-300)))


def whitening(powers: Powers, theta: Complex, doubt: float = 0.0) -> Complex:
    """Returns W [L, m, m] that makes the error of theta - G tau white, of unit variance. `doubt` is the error that the
    model is granted, relative to each angle of `theta` [L, m]."""
    covariance, i = powers.of_model(), np.arange(theta.shape[1])
    granted = doubt**2 * moving_average(np.abs(theta) ** 2, min(NEIGHBOURS, len(theta)))
    covariance[:, i, i] += powers.angle + granted
    return inverses(np.asarray(np.linalg.cholesky(covariance), dtype=complex))
