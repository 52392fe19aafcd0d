"""Faults of a joint that two relations show which hold for every arm: at rest motor i reads N_i q_i but for its spring's
deflection, and it answers its torque as the declared arm's does, up to what a CAD file and a datasheet may be wrong by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ident.records.campaign import Array, Campaign, Record
from ident.records.signal_faults import FLAG, REFUSE, Fault
from symgen.plan import Model

Complex = NDArray[np.complex128]

#: How far [rad or m] a mean angle may be from the posture: sag, an encoder zero that was set by eye.
AT_REST = 0.05
#: A relation explains a joint's mean angles when it leaves this much [rad or m], or this part of the angles themselves.
EXPLAINED, EXPLAINED_PART = 0.02, 0.02
#: A gear ratio is wrong when the angles at rest say so by more than this part, and by this much more than they scatter; or
#: when the motion fits another one better by this factor, which must not be within what drives and links may be wrong by.
RATIO, SCATTER = 0.008, 4.0
RATIO_IN_MOTION, BETTER = 1.6, 2.0
#: Logarithm of a ratio that motion does not tell a gear from a unit by, as drives and links may be off by as much.
UNSURE = 0.3
#: Least gear ratio of which a turn of the motor is little of the joint's, how near to whole turns [turns] angles are that lost some, and how
#: many these are at most.
GEARED, WHOLE, MANY = 10.0, 0.1, 1e4
#: Mean cosine between measured and declared response: 1 is agreement, below minus this the sign is wrong. Arms whose links
#: and springs are 30 % off keep above 0.4; a joint that friction holds answers at random, below 0.2: nothing is said then.
AGREES = 0.35
#: Motion per torque that is wrong by this factor is not an error of CAD or datasheet, nor friction's; a slip is named when it
#: is this near, and a factor without a name is told of from the last one on.
WRONG_SCALE, NEAR, UNNAMED = 6.0, 2.0, 10.0
#: Lines below this frequency [Hz] are left out: gravity, friction and the hold act there.
LOW = 5.0

_DEGREES = 180 / np.pi
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
    expected = _expected(campaign, J, record, f, tau_f, theta_f)
    units = tuple("m" if model.chain.slides(j) else "rad" for j in range(campaign.n))
    return Look(
        record, i, theta.mean(axis=0) / campaign.N, tau.mean(axis=0) * campaign.N, f, tau_f, theta_f, J, expected, units
    )


def _expected(campaign: Campaign, J: Array, record: Record, f: Array, tau: Complex, theta: Complex) -> Complex:
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


# at rest ----------------------------------------------------------------------------------------------------


def errors_at_rest(campaign: Campaign, looks: list[Look], j: int, column: int | None = None) -> Array:
    """Mean angle [R] of joint j minus its posture, read from its own encoder or that of joint `column`; of its own with the spring's
    deflection taken off where that leaves less, as torques may have a wrong unit."""
    column = j if column is None else column
    angle = np.array([look.rest[column] for look in looks]) * campaign.N[column] / campaign.N[j]
    error = np.asarray(angle - posture_of(looks, j))
    return straightened(campaign, looks, j, error) if column == j else error


def straightened(campaign: Campaign, looks: list[Look], j: int, error: Array) -> Array:
    """An `error` [R] of joint j with its spring's deflection taken off, where that leaves less."""
    straight = error - _deflection(campaign, looks, j)
    return np.where(np.abs(straight) < np.abs(error), straight, error)


def _deflection(campaign: Campaign, looks: list[Look], j: int) -> Array:
    """By how much [R] the spring of joint j gives at rest under its torque; zero where K is not known."""
    K = campaign.K[j]
    return np.array([look.load[j] for look in looks]) / K if np.isfinite(K) else np.zeros(len(looks))


def posture_of(looks: list[Look], j: int) -> Array:
    """The declared angle [R] of joint j in every record."""
    return np.array([look.record.posture[j] for look in looks])


# joint by joint -------------------------------------------------------------------------------------------------------


def at_rest(campaign: Campaign, looks: list[Look], j: int) -> list[Fault]:
    """Sign, unit, gear ratio, zero or posture, where mean angles say so: one fault that explains all, or the records apart."""
    name, errors = campaign.joints[j], errors_at_rest(campaign, looks, j)
    away = np.abs(errors) > AT_REST
    if not away.any():
        return []
    if (named := _named_at_rest(campaign, looks, j)) is not None:
        return [named]
    if np.count_nonzero(away) <= max(1, len(looks) // 2) and len(looks) > 1:
        return [
            _elsewhere(name, look, j, error) for look, error in zip(looks, errors, strict=True) if abs(error) > AT_REST
        ]
    line = (
        f"{name}: its mean angles lie up to {np.abs(errors).max():.3g} {looks[0].units[j]} from the declared postures, and no sign, unit or "
        "gear ratio explains it: check theta, posture and the encoder's zero"
    )
    return [Fault("angles do not fit the postures", name, "", line, REFUSE)]


def in_motion(campaign: Campaign, looks: list[Look], j: int) -> list[Fault]:
    """Sign and unit, where the response says so: angles at rest agree, or say nothing."""
    name, at_zero = campaign.joints[j], np.abs(posture_of(looks, j)).max() <= AT_REST
    cosine, size = _answer(looks, j)
    if cosine < -AGREES:
        which = "theta or tau" if at_zero else "tau"
        at_rest = "it was measured at 0 only, so either" if at_zero else "its angles at rest are right, so"
        line = (
            f"{name}: its motor moves against its torque, where theta/tau is -1/(J_m w^2) at high frequencies; {at_rest} {which} "
            f"has the wrong sign: negate {which} of {name}"
        )
        return [Fault("wrong sign", name, "", line, REFUSE)]
    return _scale(campaign, j, size, at_zero) if cosine > AGREES else []


def _answer(looks: list[Look], j: int) -> tuple[float, float]:
    """Median over the records in which j is excited of: mean cosine between measured and declared response, and the ratio of
    their sizes (its median over the lines). NaN where nothing is known."""
    ratios = [
        look.theta[:, j] / look.expected
        for look in looks
        if look.index == j and np.isfinite(look.expected).all() and np.all(look.theta[:, j])
    ]
    if not ratios:
        return np.nan, np.nan
    cosine = np.median([np.mean(ratio.real / np.abs(ratio)) for ratio in ratios])
    return float(cosine), float(np.median([np.median(np.abs(ratio)) for ratio in ratios]))


def _named_at_rest(campaign: Campaign, looks: list[Look], j: int) -> Fault | None:
    """The slip that brings the mean angles of a joint to its postures, or to where its motor stands when its spring gives, if one does."""
    postures = posture_of(looks, j)
    tried = (_named_at(campaign, looks, j, q) for q in (postures, postures + _deflection(campaign, looks, j)))
    return next((fault for fault in tried if fault is not None), None)


def _named_at(campaign: Campaign, looks: list[Look], j: int, q: Array) -> Fault | None:
    """The slip that brings the mean angles of a joint to angles q [R], if one does."""
    name, N = campaign.joints[j], float(campaign.N[j])
    angle = np.array([look.rest[j] for look in looks])
    slope = float(angle @ q / (q @ q)) if q.any() else np.nan
    cosine, size = _answer(looks, j)

    def fits(measured: Array, expected: Array) -> bool:
        allowed = np.maximum(EXPLAINED, EXPLAINED_PART * np.abs(expected))
        return bool(np.all(np.abs(measured - expected) <= allowed) and np.abs(expected).max() > AT_REST)

    if fits(angle / _DEGREES, q):
        return Fault("degrees for radians", name, "", f"{name}: theta is in degrees: divide it by 57.29578", REFUSE)
    if fits(angle, q / _DEGREES):
        return Fault(
            "degrees for radians", name, "", f"{name}: the posture is in degrees: divide it by 57.29578", REFUSE
        )
    if fits(-angle, q):
        if cosine < -AGREES:
            line = f"{name}: theta has the wrong sign, at rest and in motion: negate theta of {name}"
            return Fault("wrong sign", name, "", line, REFUSE)
        line = (
            f"{name}: at rest it reads -N q, though it moves with its torque: its gear reverses (declare N = {-N:g}), or theta "
            "and tau both have the wrong sign"
        )
        return Fault("wrong gear ratio", name, "", line, REFUSE)
    if abs(N) != 1 and fits(angle * N, q):
        line = (
            f"{name}: theta is the angle behind the gear: multiply it by N = {N:g}, or declare N = 1 with tau behind it"
        )
        return Fault("wrong side of the gear", name, "", line, REFUSE)
    turns = (angle - q) * N / (2 * np.pi)
    if abs(N) >= GEARED and 0 < np.ptp(whole := np.round(turns)) < MANY and np.abs(turns - whole).max() < WHOLE:
        line = (
            f"{name}: its angles are {whole.min():+.0f} to {whole.max():+.0f} whole turns of the motor from the postures: an encoder of a "
            "single turn, or one that was switched on again; count the turns"
        )
        return Fault("lost turns", name, "", line, REFUSE)
    offset = float(np.median(angle - q))
    left = float(np.abs(angle - q - offset).max())  # by an offset; a ratio must leave less to be named in its place
    nearer = np.ptp(q) > AT_REST and np.abs(angle / slope - q).max() < left
    if abs(slope - 1) > RATIO and fits(angle / slope, q) and nearer:
        if np.isfinite(size) and abs(np.log(size / abs(slope))) < abs(np.log(size)):
            what, remedy = f"theta is {slope:.4g} times what it should be", "check its unit and encoder_counts_per_rev"
        else:
            what, remedy = f"its angles say N = {slope * N:.5g}, declared is {N:g}", "correct the gear ratio"
        if abs(np.log(abs(slope))) < UNSURE:
            what = f"its angles say N = {slope * N:.5g}, declared is {N:g}, or theta is {slope:.4g} times what it should be"
            remedy = "correct the gear ratio, or check the unit and encoder_counts_per_rev"
        return Fault("wrong gear ratio", name, "", f"{name}: at rest {what}: {remedy}", REFUSE)
    if len(looks) > 1 and left <= EXPLAINED:
        unit = looks[0].units[j]
        motor = unit if abs(N) == 1 else "rad"  # a motor that slides itself reads metres
        line = (
            f"{name}: its encoder's zero is off by {offset:.4g} {unit} (joint side) in all records: subtract {offset * N:.5g} {motor} from "
            "theta, or correct the postures: J(q) is read at the declared ones"
        )
        return Fault("encoder zero", name, "", line, REFUSE)
    return None


def _elsewhere(name: str, look: Look, j: int, error: float) -> Fault:
    id, q = look.record.id, look.record.posture
    line = (
        f"record {id}: {name} rests {error:+.3g} {look.units[j]} from its declared posture: the record of another posture, or a joint that "
        f"fell; declared is [{', '.join(f'{value:.4g}' for value in q)}]"
    )
    return Fault("another posture", name, id, line, REFUSE)


def _scale(campaign: Campaign, j: int, size: float, at_zero: bool) -> list[Fault]:
    """A unit slip that shows in the `size` of the response alone."""
    if not np.isfinite(size) or abs(np.log(size)) < np.log(WRONG_SCALE):
        return []
    name, N = campaign.joints[j], abs(float(campaign.N[j]))
    slips = [
        (1e-3, "tau is in mN m: divide it by 1000"), (1e-2, "tau is in N cm: divide it by 100"),
        (1 / N, f"tau is the torque behind the gear: divide it by N = {N:g}"), (1e3, "tau is in kN m: multiply it by 1000"),
    ]  # fmt: skip
    if at_zero:
        slips += [
            (_DEGREES, "theta is in degrees: divide it by 57.29578"),
            (1 / N, f"theta is the angle behind the gear: multiply it by N = {N:g}"),
            (1 / N**2, f"theta and tau are those behind the gear: multiply by N = {N:g} and divide by it"),
        ]  # fmt: skip
    near = [(abs(np.log(size / factor)), text) for factor, text in slips]
    best = min(distance for distance, _ in near)
    texts = [text for distance, text in near if distance < best + 0.2]
    seen = f"{name}: its motor moves {size:.3g} times as much per torque as the declared arm's"
    if best < np.log(NEAR):
        return [Fault("wrong unit", name, "", f"{seen}: {', or '.join(texts)}", REFUSE)]
    if abs(np.log(size)) < np.log(UNNAMED):
        return []
    line = f"{seen}: check the units of theta and tau, the gear ratio N = {N:g} and the datasheet's J_m"
    return [Fault("wrong scale", name, "", line, FLAG)]


def wrong_ratio(campaign: Campaign, looks: list[Look], j: int) -> list[Fault]:
    """A gear ratio that is off by a little, seen at rest, or where nothing is seen at rest by much, seen in motion.

    Motion knows of N through J/N^2 and K/N^2 beside J_m: errors of CAD and datasheet do not look like it beyond 30 %.
    """
    name, N, q = campaign.joints[j], float(campaign.N[j]), posture_of(looks, j)
    if np.ptp(q) > 2 * AT_REST and len(looks) > 2:
        errors = np.array([look.rest[j] for look in looks]) - q
        line_of = np.stack([q, np.ones_like(q)], axis=1)
        slope, scatter = np.inf, 0.0
        for straight in (errors, errors - _deflection(campaign, looks, j)):  # the torque may have a wrong unit
            found = np.linalg.lstsq(line_of, straight, rcond=None)[0]
            if abs(found[0]) < abs(slope):
                slope, scatter = float(found[0]), float(np.abs(straight - line_of @ found).max())
        if abs(slope) <= RATIO or np.abs(slope * (q - q.mean())).max() < SCATTER * scatter:
            return []
        line = f"{name}: its angles at rest say N = {N * (1 + slope):.5g}, declared is {N:g}: correct the gear ratio"
        return [Fault("wrong gear ratio", name, "", line, REFUSE)]
    own = [look for look in looks if look.index == j and np.isfinite(look.expected).all()]
    if not own or np.abs(q).max() > AT_REST or not np.isfinite(campaign.K[j]):
        return []
    factors = np.geomspace(1 / 8, 8, 49)
    misfit = np.mean([[_misfit(campaign, look, factor) for factor in factors] for look in own], axis=0)
    best = float(factors[np.argmin(misfit)])
    if 1 / RATIO_IN_MOTION < best < RATIO_IN_MOTION or BETTER * misfit.min() > misfit[len(factors) // 2]:
        return []
    line = (
        f"{name}: resonances and inertia fit N = {N * best:.3g} better than the declared {N:g} (J_m, K and CAD taken as declared, "
        "the angles at rest being 0): check the gear ratio"
    )
    return [Fault("wrong gear ratio", name, "", line, REFUSE)]


def _misfit(campaign: Campaign, look: Look, factor: float) -> float:
    """How far the response of the excited joint is from the declared arm's with N times `factor`: median |log ratio|."""
    N = np.array(campaign.N)
    N[look.index] *= factor
    expected = _expected(replace(campaign, N=N), look.J, look.record, look.f, look.tau, look.theta)
    return float(np.median(np.abs(np.log(np.abs(look.theta[:, look.index] / expected)))))
