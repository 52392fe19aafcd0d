"""A record as tests of its joints see it: mean angles and loads, spectra, and what the declared arm would answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ident.records.campaign import Array, Campaign, Record
from symgen.plan import Model

Complex = NDArray[np.complex128]

#: Lines below this frequency [Hz] are left out: gravity, friction and the hold act there.
LOW = 5.0

_LINES = 60  # at most, from which a response is judged


@dataclass(frozen=True, eq=False)
class Look:
    """Record r as these tests see it: mean link angle `rest` [n] and torque `load` [n, joint side], spectra at `f` [L, Hz] of
    torques and angles [L, n], the declared J(q) [n, n], and what the excited motor of the declared arm would do, `expected` [L] (NaN: not known). Joints move by
    `units` [n], rad or m."""

    record: Record
    index: int
    rest: Array
    load: Array
    f: Array
    tau: Complex
    theta: Complex
    J: Array
    expected: Complex
    units: tuple[str, ...]


def observe(campaign: Campaign, model: Model, record: Record) -> Look:
    """Returns what the tests need of one record; `model` is the declared arm's."""
    P, S, i = record.periods, record.samples_per_period, campaign.joints.index(record.excited)
    kept = max(1, P // 2)
    tau, theta = (x[-kept * S :].reshape(kept, S, campaign.n).mean(axis=0) for x in (record.tau, record.theta))
    lines = record.lines[record.lines * record.f0 >= LOW]
    lines = record.lines if len(lines) < 4 else lines
    lines = lines[np.unique(np.linspace(0, len(lines) - 1, _LINES).astype(int))]
    f = np.asarray(lines * record.f0, dtype=float)
    tau_f, theta_f = (np.fft.rfft(x, axis=0)[lines] * (2 / S) for x in (tau, theta))
    J = model.J_cad(record.posture)
    expected = expected_of(campaign, J, record, f, tau_f, theta_f)
    units = tuple("m" if model.chain.slides(j) else "rad" for j in range(campaign.n))
    return Look(
        record, i, theta.mean(axis=0) / campaign.N, tau.mean(axis=0) * campaign.N, f, tau_f, theta_f, J, expected, units
    )


def expected_of(campaign: Campaign, J: Array, record: Record, f: Array, tau: Complex, theta: Complex) -> Complex:
    """theta [L] of the declared arm's excited motor under its torque while the other motors move as they did; NaN where its
    J_m is missing, it does not move or has no torque.

    (7) and (8) with the links' motion eliminated, K - K (K - w^2 J)^-1 K is what the motors feel of them; 2 % damping, springs
    rigid where unknown. A joint that does not move at all is welded.
    """
    i = campaign.joints.index(record.excited)
    live = np.flatnonzero(np.ptp(record.theta[-record.samples_per_period :], axis=0) > 0)
    if i not in live or not np.isfinite(campaign.J_m[i]) or not tau[:, i].all():
        return np.full(len(f), np.nan, dtype=complex)
    felt, rotor = felt_by_motors(campaign, J, live, f)
    port = int(np.searchsorted(live, i))
    others = np.delete(np.arange(len(live)), port)
    moved = np.einsum("lk,lk->l", felt[:, port, others], theta[:, live[others]] / campaign.N[live[others]])
    force = hold_gain(campaign, f) * tau[:, i] * campaign.N[i] - moved
    return np.asarray(campaign.N[i] * force / (felt[:, port, port] + rotor[:, port]))


def felt_by_motors(campaign: Campaign, J: Array, live: NDArray[np.intp], f: Array) -> tuple[Complex, Array]:
    """What the `live` motors [m] feel of springs and links as a dynamic stiffness [L, m, m] at f [L, Hz], joint side, and of their
    own rotors [L, m]. Springs are rigid where K is unknown."""
    J, K, w = J[np.ix_(live, live)], campaign.K[live], 2 * np.pi * f
    rotor = campaign.N[live] ** 2 * campaign.J_m[live]
    K = np.where(np.isfinite(K), K, 1e3 * (np.nanmax(rotor) + np.diag(J)) * w.max() ** 2) * (1 + 0.02j)
    spring = np.broadcast_to(np.diag(K), (len(w), *J.shape))
    felt = spring - spring @ np.linalg.solve(spring - w[:, None, None] ** 2 * J, spring)
    return felt, -(w[:, None] ** 2) * rotor


def hold_gain(campaign: Campaign, f: Array) -> Complex:
    """What a torque held between samples is at its own line f [L, Hz]."""
    if campaign.hold != "zoh":
        return np.ones(len(f), dtype=complex)
    return np.asarray(np.sinc(f / campaign.fs) * np.exp(-1j * np.pi * f / campaign.fs))


def posture_of(looks: list[Look], j: int) -> Array:
    """The declared angle [R] of joint j in every record."""
    return np.array([look.record.posture[j] for look in looks])
