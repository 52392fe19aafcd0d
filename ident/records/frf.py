"""A record becomes a frequency response: settled periods, mean spectra, and how far they can be trusted.

Everything is angle against torque, motor side, at the excited lines of a periodic excitation. Noise and leakage are
read between the lines of the spectrum over all kept periods, where a periodic response has nothing: the local
polynomial approach for periodic excitation (R. Pintelon, J. Schoukens, System Identification: A Frequency Domain
Approach, 2nd ed., Wiley 2012; R. Pintelon et al., Mech. Syst. Signal Process. 24 (2010) 573-616). Torque and angle
both carry their error, so that feedback does not bias anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainccinv

from ident.errors import CampaignError
from ident.records.campaign import Array, Campaign, Record
from ident.records.leakage import BINS, ORDER, ROUNDING, Complex, between_lines, most_telling, moving_average
from ident.records.quantisation import encoder_step, quantisation
from ident.records.settling import FALSE_ALARM, arrived, settled_from
from ident.records.steady import drift as drift_of_response

__all__ = ["BINS", "ORDER", "ROUNDING", "Complex", "Detection", "Frf", "Spectra", "estimate", "moving_average"]

#: A line is usable for a quotient when its torque is this many times its noise: the variance is then right to 10 %.
USABLE = 10.0
#: Degrees of freedom wanted for a variance: an estimate then scatters by sqrt(2/60) = 18 %.
DOF_WANTED = 60
#: Odd distortion of the excited joint that dry friction makes, and little else.
DRY = 0.02
#: A mean posture further than this from the declared one, rad or m, is reported: J(q) may be off by about 2 %.
POSTURE_TOLERANCE = 0.02
#: A mean that moves by more than this over the kept periods, rad or m, is reported: J(q) is constant to 0.5 % only.
DRIFT_TOLERANCE = 5e-3
#: Share of the sampling rate up to which motion is read.
HIGHEST = 0.45


@dataclass(frozen=True)
class Detection:
    """What the joints did at the lines of the band that were not excited: the nonlinear distortion, and noise.

    `lines` [D], `frequencies` [D, Hz], `odd` [D]; `level` [D, n] |theta| relative to the excited lines around it of the
    same joint, `noise` [D, n] its standard deviation. Feedback acts at these lines too.
    """

    lines: NDArray[np.int64]
    frequencies: Array
    odd: NDArray[np.bool_]
    level: Array
    noise: Array

    def distortion(self, odd: bool, low: float = 0.0, high: float = np.inf) -> Array:
        """Returns the rms level [n] of the odd or even lines in [low, high] Hz with the noise power taken off.

        Zero for a joint whose lines together do not stand out of their noise (chance: `FALSE_ALARM`).
        """
        chosen = (self.odd == odd) & (self.frequencies >= low) & (self.frequencies <= high)
        if not chosen.any():
            return np.zeros(self.level.shape[1])
        level, noise = self.level[chosen] ** 2, self.noise[chosen] ** 2
        R = BINS - ORDER  # level / noise is F(2, 2R) distributed, minus the logarithm of its tail exponential
        tail = R * np.log1p(np.divide(level, R * noise, out=np.zeros_like(level), where=noise > 0.0)).sum(axis=0)
        found = tail > gammainccinv(len(level), FALSE_ALARM)
        return np.where(found, np.sqrt(np.maximum(np.mean(level - noise, axis=0), 0.0)), 0.0)


@dataclass(frozen=True)
class Spectra:
    """One record at every line of its band, excited or not; amplitudes as in `Frf`.

    `lines` [F] harmonics of `f0` [Hz], `excited` [F]; `tau`, `theta` [F, n], `noise` [R, F, 2n] as in `Frf`; `floor` [F, n, rad^2] the
    quantisation variance of theta at each line; `mean_tau` [n, N m] and
    `mean_theta` [n, rad] motor side, over the kept periods. `beyond` are (lines [H], tau, theta [H, n]) below and above the band, where
    a nonlinear motion goes on, noise and all.
    """

    lines: NDArray[np.int64]
    f0: float
    excited: NDArray[np.bool_]
    tau: Complex
    theta: Complex
    noise: Complex
    floor: Array
    mean_tau: Array
    mean_theta: Array
    beyond: tuple[NDArray[np.int64], Complex, Complex]

    @property
    def frequencies(self) -> Array:
        return np.asarray(self.lines * self.f0, dtype=float)


@dataclass(frozen=True)
class Frf:
    """One record as spectra at the excited lines; amplitudes are peak values, rad and N m, motor side.

    `tau`, `theta` [L, n] are the spectra of all joints over the kept periods, leakage taken off. `noise` [R, L, 2n] are
    R independent samples of the error of (tau, theta) at every line: the mean of z z^H is its covariance. `variance`
    [L] is E|dG|^2, smoothed over `width` lines to `dof` degrees of freedom, never below the quantisation floor.
    `first` is the first settled period of the record, `periods` the number kept, `floor` [n, rad^2] the quantisation
    variance of a line of theta, the mean over all lines, `step` [n, rad] the encoder step found in the data, `drift` [n, rad] how far each
    joint's mean moved from the first to the last kept period, `offset` [n, rad] mean link posture minus declared one
    (drift and offset joint side; m for prismatic joints). `status` is empty when all is well. `band` has the lines that were
    not excited too.
    """

    record: str
    joint: str
    index: int
    posture: Array
    frequencies: Array
    tau: Complex
    theta: Complex
    noise: Complex
    variance: Array
    dof: float
    width: int
    first: int
    periods: int
    step: Array
    floor: Array
    detection: Detection
    drift: Array
    offset: Array
    status: tuple[str, ...]
    band: Spectra | None = None

    @property
    def n(self) -> int:
        return int(self.tau.shape[1])

    @property
    def spacing(self) -> int:
        """Harmonics from an excited line to the next, the median. CampaignError for a response without its `band`."""
        if self.band is None:
            raise CampaignError(f"record {self.record}: its spectra are missing; expected those of estimate()")
        return _spacing(self.band.lines[self.band.excited])

    @cached_property
    def H(self) -> Complex:
        """theta_k of all joints over the torque of the excited one [L, n], rad per N m."""
        return np.asarray(self.theta / self.tau[:, [self.index]])

    @property
    def G(self) -> Complex:
        """theta / tau of the excited joint [L], rad per N m."""
        return np.asarray(self.H[:, self.index])

    @cached_property
    def usable(self) -> NDArray[np.bool_]:
        """Lines [L] whose torque is `USABLE` times its noise. Below, feedback has eaten the excitation: G is biased and
        `variance`, which is first order in noise over torque, too small."""
        noise = np.mean(np.abs(self.noise[:, :, self.index]) ** 2, axis=0)
        return np.asarray(np.abs(self.tau[:, self.index]) ** 2 > USABLE**2 * moving_average(noise, self.width))


def _fixed(values: NDArray[np.complex128]) -> Complex:
    array = np.ascontiguousarray(values)
    array.setflags(write=False)
    return array


def estimate(record: Record, campaign: Campaign) -> Frf:
    """Returns the frequency response of the excited joint with its variance, from the settled periods of `record`.

    Only fs, joint names, N and K of the campaign are used (K, where known, to take the spring's static deflection off
    the mean posture). Raises CampaignError for a record with less than 2 periods or that contradicts itself.
    """
    joint = _check(record, campaign)
    P, S, n = record.periods, record.samples_per_period, campaign.n
    lines, band = np.asarray(record.lines), np.arange(record.lines[0], record.lines[-1] + 1)
    step = encoder_step(record.theta)
    first, settled = settled_from(record, band, step**2 / (3.0 * S))
    first, mean, noise = most_telling(record, band, first)
    excited = np.isin(band, lines)
    detection = _detect(band, excited, mean[:, n:], noise[:, :, n:], record)
    if detection.distortion(odd=True)[joint] > DRY and (later := arrived(record, first, step, noise[:, :, n:])) > first:
        first, mean, noise = most_telling(record, band, later)
        detection = _detect(band, excited, mean[:, n:], noise[:, :, n:], record)
    M = P - first
    kept = np.concatenate([record.tau[first * S :], record.theta[first * S :]], axis=1)
    tau, theta = _fixed(mean[excited, :n]), _fixed(mean[excited, n:])
    silent = lines[np.abs(tau[:, joint]) <= ROUNDING * np.abs(tau[:, joint]).max()]
    if silent.size:
        raise CampaignError(
            f"record {record.id}: line {silent[0]} is listed as excited, but {record.excited} has no torque there"
        )
    periods = kept.reshape(M, S, 2 * n)
    floor, floors = quantisation(step, periods[:, :, n:], bool(np.all(lines % 2)), record.f0)
    width, dof = _averaging(len(lines), _spacing(lines), M)
    variance = _variance(
        tau[:, joint], theta[:, joint], noise[:, excited][:, :, [joint, n + joint]], width, floors[lines, joint]
    )

    rest = periods.mean(axis=1)
    drift = (rest[-1] - rest[0])[n:] / campaign.N
    deflection = np.where(np.isfinite(campaign.K), campaign.N * rest.mean(axis=0)[:n] / campaign.K, 0.0)
    offset = rest.mean(axis=0)[n:] / campaign.N - deflection - record.posture
    status = [] if settled else [_unsettled(record, first)]
    status += _drifting(record, drift_of_response(record, first, joint))
    status += _posture_status(record, campaign, drift, offset)
    whole = Spectra(
        band, record.f0, excited, _fixed(mean[:, :n]), _fixed(mean[:, n:]), _fixed(noise), floors[band],
        rest.mean(axis=0)[:n], rest.mean(axis=0)[n:], _beyond(kept, M, band),
    )  # fmt: skip
    return Frf(
        record.id, record.excited, joint, record.posture, _hertz(lines, record), tau, theta, _fixed(noise[:, excited]),
        variance, dof, width, first, M, step, floor, detection, drift, offset, tuple(status), whole,
    )  # fmt: skip


def _beyond(kept: Array, M: int, band: NDArray[np.int64]) -> tuple[NDArray[np.int64], Complex, Complex]:
    """The lines of M periods `kept` [M S, 2n] below `band` and above it, up to `HIGHEST` of the sampling rate, leakage taken off: a
    mean that moves leaks into all of them."""
    S, n = len(kept) // M, kept.shape[1] // 2
    below, above = np.arange(1, band[0]), np.arange(band[-1] + 1, max(int(band[-1]), int(HIGHEST * S)) + 1)
    lines = np.concatenate([below, above])
    spectrum = between_lines(kept, M, lines)[0] if lines.size else np.zeros((0, 2 * n), dtype=complex)
    return lines, _fixed(spectrum[:, :n]), _fixed(spectrum[:, n:])


def _hertz(lines: NDArray[np.int64], record: Record) -> Array:
    return np.asarray(lines * record.f0, dtype=float)


def _unsettled(record: Record, first: int) -> str:
    P = record.periods
    found = f"{P} periods are too few to tell" if P < 3 else f"it still changes after {first} of {P} periods"
    return f"record {record.id}: the response may not have settled: {found}; the last {P - first} are used, record more"


def _drifting(record: Record, share: float) -> list[str]:
    """Returns a line for a response that changes by a `share` while it is recorded."""
    if not share:
        return []
    return [
        f"record {record.id}: the response of {record.excited} changes by {share:.2g} of itself while it is recorded, which "
        + "counts as noise: let it warm up, or record it again with fewer periods"
    ]


def _check(record: Record, campaign: Campaign) -> int:
    """Returns the index of the excited joint; raises CampaignError where the record contradicts itself or its robot."""
    P, S, n = record.periods, record.samples_per_period, campaign.n
    if record.excited not in campaign.joints:
        raise CampaignError(
            f"record {record.id}: excited joint {record.excited!r} is none of {', '.join(campaign.joints)}"
        )
    if P < 2:
        raise CampaignError(
            f"record {record.id}: {P} period recorded, at least 2 are needed to tell noise from response"
        )
    for name, array in (("tau", record.tau), ("theta", record.theta)):
        if array.shape != (P * S, n):
            raise CampaignError(
                f"record {record.id}: {name} has shape {array.shape}, expected {(P * S, n)}:"
                " periods * samples_per_period, joints"
            )
        if not np.isfinite(array).all():
            raise CampaignError(f"record {record.id}: {name} holds a non-finite sample")
    if S < 2 * BINS + 2:
        raise CampaignError(f"record {record.id}: {S} samples per period, at least {2 * BINS + 2} are needed")
    lines = record.lines
    odd = lines[(lines < 1) | (lines >= S / 2) | (np.diff(lines, append=S) == 0)]
    if odd.size or not lines.size:
        raise CampaignError(
            f"record {record.id}: lines must be different ones of 1 .. {(S - 1) // 2},"
            f" found {odd[0] if odd.size else 'none'}"
        )
    return campaign.joints.index(record.excited)


def noise_dof(L: int, spacing: int, M: int) -> float:
    """Returns how many independent complex samples the errors at L lines are, `spacing` harmonics apart, of M periods:
    neighbours share bins, and a bin counts once."""
    return (BINS - ORDER) * (1.0 + (L - 1) * min(BINS, spacing * (M - 1)) / BINS)


def _spacing(lines: NDArray[np.int64]) -> int:
    return int(np.median(np.diff(lines))) if len(lines) > 1 else 1


def _averaging(L: int, spacing: int, M: int) -> tuple[int, float]:
    """Returns over how many of L lines a variance is averaged, and its (real) degrees of freedom."""
    width = 1 + int(np.ceil((DOF_WANTED / 2.0 / (BINS - ORDER) - 1.0) * BINS / min(BINS, spacing * (M - 1))))
    width = min(max(width, 1), L)
    return width, 2.0 * noise_dof(width, spacing, M)


def _variance(tau: Complex, theta: Complex, noise: Complex, width: int, floor: Array) -> Array:
    """Returns the variance of theta / tau [L] from error samples `noise` [R, L, 2] of (tau, theta) and the `floor` [L] of theta's.

    The equation error e = dtheta - G dtau leaves feedback out: it is G times the torque noise plus the encoder noise.
    Its power is therefore scaled by a |G|^2 + b (a, b >= 0, maximum likelihood) before it is smoothed over `width`
    lines: a resonance narrower than the window would otherwise be smeared.
    """
    G = theta / tau
    power = np.mean(np.abs(noise[:, :, 1] - G * noise[:, :, 0]) ** 2, axis=0)
    power = np.maximum(power, (ROUNDING * np.abs(theta)) ** 2)
    shape = _noise_shape(power, np.abs(G) ** 2)
    variance = np.maximum(shape * moving_average(power / shape, width), floor) / np.abs(tau) ** 2
    variance.setflags(write=False)
    return np.asarray(variance)


def _noise_shape(power: Array, gain: Array) -> Array:
    """Returns a * gain + b [L] that fits the noise power [L] best, a, b >= 0.

    Itakura-Saito divergence (the likelihood of a periodogram), multiplicative updates: C. Fevotte et al., Neural
    Computation 21 (2009), DOI 10.1162/neco.2008.04-08-771.
    """
    parts = np.stack([gain / gain.mean(), np.ones_like(gain)])
    weight = np.full(2, power.mean() / 2.0)
    for _ in range(60):
        shape = weight @ parts
        weight = weight * np.sqrt((parts @ (power / shape**2)) / (parts @ (1.0 / shape)))
    return np.asarray(np.maximum(weight @ parts, np.finfo(float).tiny))


def _detect(
    band: NDArray[np.int64], excited: NDArray[np.bool_], theta: Complex, noise: Complex, record: Record
) -> Detection:
    """Returns the levels at lines of `band` [F] not `excited` [F], of `theta` [F, n] with error `noise` [R, F, n]."""
    silent, size = ~excited, np.abs(theta)
    lines, tiny = band[silent], np.finfo(float).tiny
    around = np.stack([np.exp(np.interp(lines, band[excited], np.log(x[excited] + tiny))) for x in size.T], axis=1)
    around[around <= 2.0 * tiny] = np.inf
    deviation = np.sqrt(np.mean(np.abs(noise[:, silent]) ** 2, axis=0))
    return Detection(lines, _hertz(lines, record), lines % 2 == 1, size[silent] / around, deviation / around)


def _posture_status(record: Record, campaign: Campaign, drift: Array, offset: Array) -> list[str]:
    """Returns a line for every joint whose mean drifts or lies away from the declared posture."""
    found = []
    for k, name in enumerate(campaign.joints):
        if abs(drift[k]) > DRIFT_TOLERANCE:
            found.append(
                f"record {record.id}: the mean of {name} drifts by {drift[k]:.2g}, allowed {DRIFT_TOLERANCE:g}"
            )
    return found + off_posture(record.id, campaign.joints, offset)


#: What the lines of `off_posture` say, and no other.
RESTS = "from its declared posture, allowed"


def off_posture(record: str, joints: Sequence[str], offset: Array) -> list[str]:
    """Returns a line for every joint that rests away from the declared posture by its `offset` [n, rad or m]."""
    return [
        f"record {record}: {name} rests {offset[k]:+.3g} {RESTS} {POSTURE_TOLERANCE:g}: it may have fallen to another equilibrium"
        for k, name in enumerate(joints)
        if abs(offset[k]) > POSTURE_TOLERANCE
    ]
