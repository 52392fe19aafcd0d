"""Faults of a joint that two relations show which hold for every arm: at rest motor i reads N_i q_i but for its spring's
deflection, and it answers its torque as the declared arm's does, up to what a CAD file and a datasheet may be wrong by.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ident.records.campaign import Array, Campaign
from ident.records.free_drive import agrees, refutes
from ident.records.looks import Look, hold_gain, posture_of
from ident.records.sag import beside_ratio, beside_zero, common, compliance
from ident.records.signal_faults import FLAG, REFUSE, Fault

#: How far [rad or m] a mean angle may be from the posture: sag, an encoder zero that was set by eye.
AT_REST = 0.05
#: A relation explains a joint's mean angles when it leaves this much [rad or m], or this part of the angles themselves.
EXPLAINED, EXPLAINED_PART = 0.02, 0.02
#: A gear ratio is wrong when the angles at rest say so by more than this part.
RATIO = 0.008
#: Logarithm of a ratio that motion does not tell a gear from a unit by, as drives and links may be off by as much.
UNSURE = 0.3
#: Least gear ratio of which a turn of the motor is little of the joint's, how near to whole turns [turns] angles are that lost some, and how
#: many these are at most.
GEARED, WHOLE, MANY = 10.0, 0.1, 1e4
#: Mean cosine between measured and declared response: 1 is agreement, below minus this the sign is wrong. Arms whose links
#: and springs are 30 % off keep above 0.4; a joint that friction holds answers at random, below 0.2: nothing is said then.
#: Of a joint whose K is not known some spring must agree as `SURELY` but for the sign.
AGREES, SURELY = 0.35, 0.8
#: Motion per torque that is wrong by this factor is not an error of CAD or datasheet, nor friction's; a slip is named when it
#: is this near, and a factor without a name is told of from the last one on.
WRONG_SCALE, NEAR, UNNAMED = 6.0, 2.0, 10.0

_DEGREES = 180 / np.pi


# at rest ----------------------------------------------------------------------------------------------------


def errors_at_rest(campaign: Campaign, looks: list[Look], j: int, column: int | None = None) -> Array:
    """Mean angle [R] of joint j minus its posture, read from its own encoder or that of joint `column`; of its own with the spring's
    deflection taken off where that leaves less, as torques may have a wrong unit."""
    column = j if column is None else column
    angle = np.array([look.rest[column] for look in looks]) * campaign.N[column] / campaign.N[j]
    error = np.asarray(angle - posture_of(looks, j))
    return straightened(campaign, looks, j, error) if column == j else error


def straightened(campaign: Campaign, looks: list[Look], j: int, error: Array) -> Array:
    """An `error` [R] of joint j with its spring's deflection taken off, by the declared K or another, where that leaves less."""
    load = load_of(looks, j)
    given = np.stack([0 * load, deflection(campaign, looks, j), compliance(load, error, campaign.K[j]) * load])
    straight = error - given
    return np.asarray(straight[np.abs(straight).argmin(axis=0), np.arange(len(error))])


def deflection(campaign: Campaign, looks: list[Look], j: int) -> Array:
    """By how much [R] the declared spring of joint j gives at rest under its torque; zero where K is not known."""
    K = campaign.K[j]
    return load_of(looks, j) / K if np.isfinite(K) else np.zeros(len(looks))


def load_of(looks: list[Look], j: int) -> Array:
    """The mean torque [R, joint side] of joint j in every record."""
    return np.array([look.load[j] for look in looks])


# joint by joint -------------------------------------------------------------------------------------------------------


def at_rest(campaign: Campaign, looks: list[Look], j: int) -> list[Fault]:
    """Sign, unit, gear ratio, zero or posture, where mean angles say so: one fault that explains all, or the records apart.

    What goes with the load is sag by a K that is not the declared one, and no fault.
    """
    K, load = float(campaign.K[j]), load_of(looks, j)
    given = deflection(campaign, looks, j)
    off = np.array([look.rest[j] for look in looks]) - posture_of(looks, j)
    errors = np.where(np.abs(off - given) < np.abs(off), off - given, off)
    if not (np.abs(errors) > AT_REST).any():
        return []
    for bent in (lambda _: 0.0 * load, lambda _: given):
        if (slip := _slip(campaign, looks, j, bent)) is not None:
            return [slip]
    if _is_spring(campaign, looks, j, compliance(load, off, K)) and not _answer(campaign, looks, j)[0] < -AGREES:
        return []
    posed = np.abs(posture_of(looks, j)).max() > AT_REST  # any spring's deflection looks like a slip of itself
    if posed and (slip := _slip(campaign, looks, j, lambda error: compliance(load, error, K) * load)) is not None:
        return [slip]
    if (shifted := _shifted_of_any(campaign, looks, j, off)) is not None:
        return [shifted]
    return _apart(campaign, looks, j, off, errors)


def _apart(campaign: Campaign, looks: list[Look], j: int, off: Array, errors: Array) -> list[Fault]:
    """The few records whose mean angles lie `off` their postures by more than the declared spring, `errors`, or that of most records
    explains; one fault where they are more."""
    name, K, load = campaign.joints[j], float(campaign.K[j]), load_of(looks, j)
    left = off - common(load, off, K) * load
    near = np.abs(left) <= AT_REST
    most = len(looks) / 2 < np.count_nonzero(near) < len(looks)
    if most and _is_spring(campaign, looks, j, compliance(load[near], off[near], K)):
        errors = np.where(np.abs(left) < np.abs(errors), left, errors)
    away = np.abs(errors) > AT_REST
    if np.count_nonzero(away) <= max(1, len(looks) // 2) and len(looks) > 1:
        return [
            _elsewhere(name, look, j, error) for look, error in zip(looks, errors, strict=True) if abs(error) > AT_REST
        ]
    line = (
        f"{name}: its mean angles lie up to {np.abs(errors).max():.3g} {looks[0].units[j]} from the declared postures, and no sign, unit, "
        "gear ratio or stiffness explains it: check theta, posture and the encoder's zero"
    )
    return [Fault("angles do not fit the postures", name, "", line, REFUSE)]


def _is_spring(campaign: Campaign, looks: list[Look], j: int, found: float) -> bool:
    """Whether a compliance that was found, 0 where none was, may be that of joint j: where K is not declared its motion must not tell another."""
    return found > 0.0 and not (np.isnan(campaign.K[j]) and refutes(campaign, looks, j, 1 / found))


def _shifted_of_any(campaign: Campaign, looks: list[Look], j: int, off: Array) -> Fault | None:
    """What is `_shifted` against the postures, or against where the motor of joint j stands when its spring gives, by the declared K or by
    that which is beside a zero or a ratio that is `off`."""
    q, load, K = posture_of(looks, j), load_of(looks, j), float(campaign.K[j])
    beside = (found for found in (beside_zero(load, off, K), beside_ratio(load, off + q, q, K)))
    sound = [found * load for found in beside if _is_spring(campaign, looks, j, found)]
    tried = (_shifted(campaign, looks, j, q + given) for given in (0.0, deflection(campaign, looks, j), *sound))
    return next((fault for fault in tried if fault is not None), None)


def in_motion(campaign: Campaign, looks: list[Look], j: int) -> list[Fault]:
    """Sign and unit, where the response says so: angles at rest agree, or say nothing."""
    name, at_zero = campaign.joints[j], np.abs(posture_of(looks, j)).max() <= AT_REST
    cosine, size = _answer(campaign, looks, j)
    if cosine < -AGREES:
        which = "theta or tau" if at_zero else "tau"
        at_rest = "it was measured at 0 only, so either" if at_zero else "its angles at rest are right, so"
        line = (
            f"{name}: its motor moves against its torque, where theta/tau is -1/(J_m w^2) at high frequencies; {at_rest} {which} "
            f"has the wrong sign: negate {which} of {name}"
        )
        return [Fault("wrong sign", name, "", line, REFUSE)]
    return _scale(campaign, j, size, at_zero) if cosine > AGREES else []


def _answer(campaign: Campaign, looks: list[Look], j: int) -> tuple[float, float]:
    """Median over the records in which j is excited of: mean cosine between measured and declared response, and the ratio of
    their sizes (its median over the lines). NaN where nothing is known.

    Where K is not, the cosine is the largest by any K, as a motor moves with its torque between anti-resonance and resonance, if it does not
    agree but for the sign; and the size is 1 for all that is between a rigid spring and none, which leaves the rotor alone.
    """
    ratios = [
        look.theta[:, j] / look.expected
        for look in looks
        if look.index == j and np.isfinite(look.expected).all() and np.all(look.theta[:, j])
    ]
    if not ratios:
        return np.nan, np.nan
    cosine = np.median([np.mean(ratio.real / np.abs(ratio)) for ratio in ratios])
    size = float(np.median([np.median(np.abs(ratio)) for ratio in ratios]))
    unknown = bool(np.isnan(campaign.K[j]))
    if unknown and cosine < AGREES:
        least, most = agrees(campaign, looks, j)
        cosine = least if most < AGREES and least < -SURELY else most
    if unknown and size > 1.0:
        size = max(1.0, float(np.median([_over_rotor(campaign, look) for look in looks if look.index == j])))
    return float(cosine), size


def _over_rotor(campaign: Campaign, look: Look) -> float:
    """Motion of the excited motor over that of its rotor alone under its torque, the median over the lines."""
    rotor = look.tau[:, look.index] / (campaign.J_m[look.index] * (2 * np.pi * look.f) ** 2)
    return float(np.median(np.abs(look.theta[:, look.index] / (hold_gain(campaign, look.f) * rotor))))


def _slip(campaign: Campaign, looks: list[Look], j: int, bent: Callable[[Array], Array]) -> Fault | None:
    """The slip of sign, unit or side that brings the mean angles of a joint to its postures, if one does; what its spring gives is
    `bent` of what is left."""
    name, N, q = campaign.joints[j], float(campaign.N[j]), posture_of(looks, j)
    angle = np.array([look.rest[j] for look in looks])

    def fits(measured: Array, expected: Array) -> bool:
        return _fits(measured, expected + bent(measured - expected))

    if fits(angle / _DEGREES, q):
        return Fault("degrees for radians", name, "", f"{name}: theta is in degrees: divide it by 57.29578", REFUSE)
    if fits(angle, q / _DEGREES):
        return Fault(
            "degrees for radians", name, "", f"{name}: the posture is in degrees: divide it by 57.29578", REFUSE
        )
    if fits(-angle, q):
        if _answer(campaign, looks, j)[0] < -AGREES:
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
    return None


def _fits(measured: Array, expected: Array) -> bool:
    allowed = np.maximum(EXPLAINED, EXPLAINED_PART * np.abs(expected))
    return bool(np.all(np.abs(measured - expected) <= allowed) and np.abs(expected).max() > AT_REST)


def _shifted(campaign: Campaign, looks: list[Look], j: int, q: Array) -> Fault | None:
    """Lost turns, a gear ratio or a zero that bring the mean angles of a joint to angles q [R], if one does."""
    name, N = campaign.joints[j], float(campaign.N[j])
    angle = np.array([look.rest[j] for look in looks])
    slope = float(angle @ q / (q @ q)) if q.any() else np.nan
    size = _answer(campaign, looks, j)[1]
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
    if abs(slope - 1) > RATIO and _fits(angle / slope, q) and nearer:
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
