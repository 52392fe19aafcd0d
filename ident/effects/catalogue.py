"""The list of all effects, and how one is written on a command line: name:parameter=value,parameter=value@joint."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from ident.effects import declared, friction, hysteresis, link, motor, sensor, spring, structure
from ident.effects.base import Effect
from ident.errors import IdentError
from symgen.robot import Drive

CATALOGUE: dict[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        declared.MotorViscous,
        friction.MotorCoulomb,
        friction.MotorStribeck,
        friction.MotorQuadraticDrag,
        hysteresis.MotorHysteresis,
        declared.MotorInertia,
        motor.TorqueRipple,
        motor.TorqueScale,
        motor.TorqueOffset,
        motor.InputDelay,
        motor.TorqueLag,
        motor.MotorCoupling,
        declared.SpringDamping,
        spring.SpringHardening,
        spring.Backlash,
        hysteresis.SpringHysteresis,
        spring.SpringRelaxation,
        spring.TransmissionError,
        friction.LinkViscous,
        friction.LinkCoulomb,
        hysteresis.LinkHysteresis,
        friction.LoadDependentFriction,
        link.CableStiffness,
        declared.Payload,
        declared.InertialParameters,
        declared.GravityStiffness,
        sensor.JointZeroOffset,
        sensor.TimeOffset,
        sensor.EncoderEccentricity,
        structure.LockedJointElasticity,
        structure.BaseCompliance,
        structure.LinkFlexibility,
        structure.AttachedResonator,
        structure.RigidBodyCoupling,
        declared.ChangeBetweenRecords,
        declared.DriftOverRecords,
    )
}

_FORM = "name:parameter=value,parameter=value@joint"


def parse(text: str, drives: Sequence[Drive]) -> Effect:
    """Returns the effect that `text` names, to be injected in an arm with `drives` [n] in the order of its joints.

    Values are absolute, in the units of the catalogue. A parameter not given takes its first plausible size; one that is
    relative to K takes that share of the joint's, any other relative one must be given.
    IdentError, one line: unknown effect, parameter or joint, a value out of bounds, one that is missing.
    """
    match = re.fullmatch(r"([^:@=,]+)(?::([^@]*))?(?:@(.+))?", text.strip())
    if match is None:
        raise IdentError(f"effect {text!r}: expected {_FORM}")
    name, given, joint = match.groups()
    if name not in CATALOGUE:
        raise IdentError(f"effect {text!r}: unknown effect {name!r}; expected one of {', '.join(CATALOGUE)}")
    cls = CATALOGUE[name]
    if not cls.injectable:
        raise IdentError(f"effect {text!r}: {name} is part of every simulated arm; it can not be added")
    index = _joint(text, cls, joint, drives)
    values = _values(text, given or "")
    for p in cls.parameters:
        if p.relative and p.name not in values and set(values) <= {known.name for known in cls.parameters}:
            if p.relative != "K":
                unit = cls.unit(p, index is not None and drives[index].linear)
                raise IdentError(f"effect {text!r}: {p.name} is missing; expected {p.name}=<number> [{unit or '1'}]")
            values[p.name] = p.sizes[0] * stiffness(cls, index, drives)
    effect = cls.of(index, values)
    if isinstance(effect, motor.MotorCoupling):
        effect.other(len(drives))
    if isinstance(effect, structure.AttachedResonator) and all(d.linear for d in drives[: (index or 0) + 1]):
        raise IdentError(f"effect {text!r}: no joint turns what carries it, so nothing would feel it")
    return effect


def truth(effects: Sequence[Effect], drives: Sequence[Drive]) -> dict[str, Any]:
    """Returns what was injected, as a document for a file: names, joints, ports, parameters with their units."""
    return {
        "effects": [
            {
                "name": effect.name,
                "joint": None if effect.joint is None else drives[effect.joint].joint,
                "port": effect.port,
                "parameters": {
                    p.name: {
                        "value": value,
                        "unit": effect.unit_of(p, lambda joint: joint is not None and drives[joint].linear),
                    }
                    for p, value in zip(effect.parameters, effect.values, strict=True)
                },
            }
            for effect in effects
        ]
    }


def _joint(text: str, cls: type[Effect], joint: str | None, drives: Sequence[Drive]) -> int | None:
    names = [drive.joint for drive in drives]
    if joint is None:
        if "arm" not in cls.scope:
            raise IdentError(f"effect {text!r}: which joint? expected @ and one of {', '.join(names)}")
        return None
    if "joint" not in cls.scope:
        raise IdentError(f"effect {text!r}: {cls.name} is an effect of the whole arm; expected no @joint")
    if joint not in names:
        raise IdentError(f"effect {text!r}: unknown joint {joint!r}; expected one of {', '.join(names)}")
    return names.index(joint)


def stiffness(cls: type[Effect], joint: int | None, drives: Sequence[Drive]) -> float:
    """What a stiffness of an effect is a share of: its joint's, or the largest one that is turned where the effect turns."""
    if joint is not None and not (cls.turns and drives[joint].linear):
        return drives[joint].K
    return max([drive.K for drive in drives if not drive.linear] or [drive.K for drive in drives])


def _values(text: str, given: str) -> dict[str, float]:
    values: dict[str, float] = {}
    for item in given.split(",") if given else ():
        name, equals, value = item.partition("=")
        if not equals or not name or name in values:
            raise IdentError(f"effect {text!r}: {item!r}; expected parameter=value, each parameter once")
        try:
            values[name.strip()] = float(value)
        except ValueError:
            raise IdentError(f"effect {text!r}: {name.strip()} = {value!r}; expected a number") from None
    return values
