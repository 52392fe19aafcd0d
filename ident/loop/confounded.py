"""Which effects are taken for each other, and the experiment that tells them apart."""

from __future__ import annotations

from dataclasses import dataclass

#: What may be changed in the next experiment, and what it is good for.
RECIPES = {
    "amplitude": "the same postures at another amplitude",
    "postures": "postures far from those measured, light and heavy for gravity",
    "shift": "the same postures, shifted by less than a turn of the motor",
    "others": "the neighbouring joints excited at the same postures",
    "lines": "the same postures, finer and wider lines",
    "repeat": "the same records once more, in the opposite order",
    "mass": "a robot with a known mass at the flange, or without a payload, with a URDF and a diagnosis of its own",
    "link-sensor": "a sensor that no fit and no diagnosis reads",
}
#: What no further records of the same robot do: there is nothing to be played.
UNPLAYED = ("mass", "link-sensor")


@dataclass(frozen=True)
class Separation:
    """What tells two effects apart, in one line, and the recipe (a key of `RECIPES`) that is the most of it."""

    separate_by: str
    recipe: str


_AMPLITUDE = "{a} and {b} grow differently with the amplitude: repeat at half and at three times of it"
_LOADS = "repeat at postures where gravity loads this joint differently, and where it does not load it at all"
_BOTH_SIDES = "motor and link move alike below the anti-resonance and apart around it: finer lines there"
_SHIFTED = "repeat with the joint shifted by fractions of a motor turn: {a} and {b} follow the angle differently"
_SCALED = (
    "no record without a known inertia tells a torque from an inertia: a known mass at the flange, in a URDF of its own"
)
_ELSEWHERE = "excite the other joints, too, at the same postures: those that have it show {a} most"
_EXTRA_MODE = "excite the other joints: {a} and {b} give each of them another share of the extra resonance"

#: For two effects at the same place, in either order.
TABLE: dict[tuple[str, str], tuple[str, str]] = {
    ("input-delay", "time-offset"): (
        ("excite a neighbouring joint while this one is free to move: a late torque delays what this motor drives, a late "
        "angle delays what this encoder reads, whoever drives it"), "others"),
    ("input-delay", "torque-lag"): (
        "lines as far up as the torque reaches: a lag takes size and phase, a delay the phase alone", "lines"),
    ("time-offset", "torque-lag"): (
        "lines as far up as the torque reaches: a lag takes size and phase, a time offset the phase alone", "lines"),
    ("payload", "inertial-parameters"): (
        ("records with the payload taken off, diagnosed by themselves: links that are as declared then carried one; or a known "
        "mass at the flange, in a URDF of its own"), "mass"),
    ("inertial-parameters", "inertial-parameters"): (
        "postures that turn the joints between the two links: only there their inertias act differently", "postures"),
    ("payload", "gravity-stiffness"): ("inertia tells a mass, gravity alone does not: more postures, light and heavy", "postures"),
    ("inertial-parameters", "gravity-stiffness"): (
        "inertia tells a mass, gravity alone does not: more postures, light and heavy", "postures"),
    ("torque-scale", "inertial-parameters"): (_SCALED, "mass"),
    ("torque-scale", "payload"): (_SCALED, "mass"),
    ("torque-scale", "torque-scale"): (
        "of all joints together only a known inertia tells the scale: a known mass at the flange, in a URDF of its own", "mass"),
    ("torque-scale", "motor-inertia"): (
        ("excite the neighbouring joints: what this link does to theirs does not go through this motor's torque; the "
        "absolute scale needs a known mass at the flange, in a URDF of its own"), "others"),
    ("torque-scale", "motor-viscous"): (
        "excite the neighbouring joints: what this link does to theirs does not go through this motor's torque", "others"),
    ("base-compliance", "locked-joint-elasticity"): (
        ("excite every joint: a base is one stiffness for all of them, a held joint is one spring whose resonance "
        "J(q) predicts"), "others"),
    ("base-compliance", "link-flexibility"): (
        "other postures: the base feels the whole arm, whose inertia changes; a link's own mode stays", "postures"),
    ("base-compliance", "attached-resonator"): (
        "other postures: the base feels the whole arm, whose inertia changes; a resonator keeps its frequency", "postures"),
    ("locked-joint-elasticity", "link-flexibility"): (
        "other postures: the resonance of a held joint follows J(q), a link's own mode stays", "postures"),
    ("link-flexibility", "attached-resonator"): (
        "other postures: what hangs on a flexible link changes its resonance, a resonator keeps its frequency", "postures"),
    ("locked-joint-elasticity", "attached-resonator"): (
        "other postures: the resonance of a held joint follows J(q), a resonator keeps its frequency", "postures"),
    ("motor-coupling", "locked-joint-elasticity"): (_EXTRA_MODE, "others"),
    ("motor-coupling", "base-compliance"): (_EXTRA_MODE, "others"),
    ("motor-coulomb", "motor-stribeck"): (
        "much smaller amplitudes: friction that falls with speed is largest where the joint hardly moves", "amplitude"),
    ("motor-coulomb", "motor-hysteresis"): (
        "much smaller amplitudes: before it slides a contact is a spring, dry friction is not", "amplitude"),
    ("motor-stribeck", "motor-hysteresis"): (
        "much smaller amplitudes: before it slides a contact is a spring, friction that falls with speed is not", "amplitude"),
    ("link-coulomb", "link-hysteresis"): (
        "much smaller amplitudes: before it slides a contact is a spring, dry friction is not", "amplitude"),
    ("motor-hysteresis", "link-hysteresis"): (_BOTH_SIDES, "lines"),
    ("spring-hysteresis", "link-hysteresis"): (_BOTH_SIDES, "lines"),
    ("motor-coulomb", "load-dependent-friction"): (_LOADS, "postures"),
    ("motor-stribeck", "load-dependent-friction"): (_LOADS, "postures"),
    ("motor-hysteresis", "load-dependent-friction"): (_LOADS, "postures"),
    ("link-coulomb", "load-dependent-friction"): (_LOADS, "postures"),
    ("motor-viscous", "load-dependent-friction"): (_AMPLITUDE, "amplitude"),
    ("motor-coulomb", "motor-viscous"): (_AMPLITUDE, "amplitude"),
    ("motor-coulomb", "motor-quadratic-drag"): (_AMPLITUDE, "amplitude"),
    ("motor-viscous", "motor-quadratic-drag"): (_AMPLITUDE, "amplitude"),
    ("motor-stribeck", "motor-viscous"): (_AMPLITUDE, "amplitude"),
    ("motor-coulomb", "link-coulomb"): (_BOTH_SIDES, "lines"),
    ("motor-stribeck", "link-coulomb"): (_BOTH_SIDES, "lines"),
    ("motor-hysteresis", "link-coulomb"): (_BOTH_SIDES, "lines"),
    ("motor-viscous", "link-viscous"): (_BOTH_SIDES, "lines"),
    ("motor-viscous", "spring-damping"): (_BOTH_SIDES, "lines"),
    ("link-viscous", "spring-damping"): (_BOTH_SIDES, "lines"),
    ("link-viscous", "link-coulomb"): (_AMPLITUDE, "amplitude"),
    ("torque-ripple", "transmission-error"): (
        ("repeat with the joint shifted by fractions of a motor turn, and at another load: the gear's error is wound up by "
        "the torque it carries, a motor's ripple is not"), "shift"),
    ("torque-ripple", "encoder-eccentricity"): (
        ("repeat with the joint shifted by fractions of a motor turn and at lines below and above the resonance: a torque "
        "moves the joint less with frequency, a wrong reading does not"), "shift"),
    ("transmission-error", "encoder-eccentricity"): (
        "lines around the anti-resonance: there a gear's error pushes and a wrong reading does not", "lines"),
    ("torque-ripple", "torque-offset"): (_SHIFTED, "shift"),
    ("torque-ripple", "cable-stiffness"): (_SHIFTED, "shift"),
    ("spring-hardening", "backlash"): (
        "another amplitude, and postures where gravity winds the gear up: play vanishes there, hardening does not", "amplitude"),
    ("spring-hardening", "transmission-error"): (_SHIFTED, "shift"),
    ("spring-hysteresis", "spring-damping"): (
        "lines far apart in frequency, and another amplitude: what lags behind winding loses as much a turn at any speed", "amplitude"),
    ("spring-hysteresis", "motor-hysteresis"): (_BOTH_SIDES, "lines"),
    ("spring-hysteresis", "link-coulomb"): (_BOTH_SIDES, "lines"),
    ("spring-hysteresis", "motor-coulomb"): (_BOTH_SIDES, "lines"),
    ("spring-relaxation", "spring-damping"): (
        "lines far below and far above where it relaxes: a damping grows with frequency, what relaxes ends as a stiffness", "lines"),
    ("spring-relaxation", "spring-hysteresis"): (_AMPLITUDE, "amplitude"),
    ("backlash", "transmission-error"): (_SHIFTED, "shift"),
    ("backlash", "link-coulomb"): (_LOADS, "postures"),
    ("backlash", "motor-coulomb"): (_LOADS, "postures"),
    ("joint-zero-offset", "gravity-stiffness"): (
        "postures on both sides of the vertical: a wrong zero changes sign there, a wrong gravity does not", "postures"),
    ("joint-zero-offset", "inertial-parameters"): (
        "postures a quarter of a turn away: a wrong zero moves all that depends on the angle, a wrong body its size", "postures"),
    ("joint-zero-offset", "cable-stiffness"): (_LOADS, "postures"),
    ("cable-stiffness", "gravity-stiffness"): (_LOADS, "postures"),
    ("cable-stiffness", "spring-hardening"): (_AMPLITUDE, "amplitude"),
}  # fmt: skip

#: What an effect is like: what separates it from those that the table does not hold it against.
FAMILIES = {
    "amplitude": (
        "motor-coulomb", "motor-stribeck", "motor-hysteresis", "motor-quadratic-drag", "link-coulomb", "link-hysteresis", "spring-hardening",
        "spring-hysteresis", "backlash", "load-dependent-friction", "rigid-body-coupling",
    ),
    "shift": ("torque-ripple", "transmission-error", "encoder-eccentricity"),
    "others": ("base-compliance", "locked-joint-elasticity", "motor-coupling", "torque-scale"),
    "postures": (
        "payload", "inertial-parameters", "gravity-stiffness", "joint-zero-offset", "cable-stiffness", "link-flexibility",
        "attached-resonator", "torque-offset",
    ),
    "lines": (
        "motor-viscous", "link-viscous", "spring-damping", "spring-relaxation", "motor-inertia", "torque-lag", "input-delay", "time-offset",
    ),
}  # fmt: skip

#: A machine that is not the same in all records.
CHANGES = ("change-between-records", "drift-over-records")


#: What separates a joint that is another one at each posture from one that changed in time, where no posture was measured again.
AGAIN = Separation(
    "the first records once more, last: at the same posture a joint that changed in time is another one, a curve of place is not",
    "repeat",
)


def separation(a: str, b: str, same_joint: bool = True) -> Separation:
    """Returns what tells effect `a` from effect `b`, at the same joint or at another; from itself at another, or of the whole arm."""
    if a == b and (a, b) not in TABLE:
        return Separation(_ELSEWHERE.format(a=a), "others")
    changed = [name for name in (a, b) if name in CHANGES]
    if len(changed) == 2:
        return Separation("one record again and again: what drifts goes on, what changed stays", "repeat")
    if changed:
        other = b if a in CHANGES else a
        return Separation(
            f"the first records once more, last: a machine that changed stays changed, {other} does not", "repeat"
        )
    for pair in ((a, b), (b, a)):
        if pair in TABLE and (same_joint or a == b):
            text, recipe = TABLE[pair]
            return Separation(text.format(a=a, b=b), recipe)
    if not same_joint:
        return Separation("excite each of the two joints alone, at the same postures", "others")
    for recipe in ("amplitude", "shift", "others", "postures"):
        if (a in FAMILIES[recipe]) != (b in FAMILIES[recipe]):
            return Separation(f"{RECIPES[recipe]}: it changes one of the two and not the other", recipe)
    for recipe in ("amplitude", "shift", "others", "postures"):
        if a in FAMILIES[recipe]:
            return Separation(f"{RECIPES[recipe]}: it changes both, by different laws", recipe)
    return Separation(f"{RECIPES['lines']}: the two differ in how they follow frequency", "lines")


def never_told_apart(name: str, alone: bool, only: bool = False) -> tuple[str, ...]:
    """Effects that no record of motor torques and angles tells from this one, whatever is excited.

    `alone`: all joints share the effect, or its joint moves no other one: then a torque that acts late is an angle read
    late, as both turn the phase of all there is to see by the same angle. `only`: the arm has one joint, whose link is
    its payload, too.
    """
    pairs = [("input-delay", "time-offset")] if alone or only else []
    if only:
        pairs.append(("payload", "inertial-parameters"))
    return tuple(b if name == a else a for a, b in pairs if name in (a, b))


#: What separates two effects that motor signals never tell apart.
NEVER = Separation(
    "motor records never tell them apart; an encoder on the link with a clock of its own does: the diagnosis says how early or late it "
    "reads against the model",
    "link-sensor",
)
