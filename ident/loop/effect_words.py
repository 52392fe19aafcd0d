"""An effect of verdict.json in words: its name, its numbers, its curve, and what these records can not tell it from."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from itertools import compress, repeat
from typing import Any

from ident.effects.catalogue import CATALOGUE
from ident.effects.crosstalk import CROSSTALK
from ident.effects.learned import KINDS
from ident.effects.lubricated import LUBRICATED
from ident.effects.memory import HYSTERESIS, LOOPS, PRESLIDING
from ident.identification.verdict import number
from ident.search.deviations import NAMES

#: What verdict.json calls "unknown", and by the variable of its curve.
UNKNOWN = "an unknown law"
KNOWN_AS = {
    "resonance": "an unknown resonance",
    LUBRICATED: "an unknown friction (LuGre)",
    PRESLIDING: "an unknown friction (Maxwell slip)",
}
#: Which number of a drive an effect says is off.
FIELDS = {name: field for field, name in NAMES.items()}
#: Units as figures write them.
WRITTEN = {"Nm": "N m", "Nms/rad": "N m s/rad", "Nm/rad": "N m/rad", "Ns/m": "N s/m"}


def name_of(effect: dict[str, Any]) -> str:
    """The name of an effect, or of what it is not told from."""
    if effect["name"] == "unknown":
        of = f" of {effect['of']}" if "of" in effect else ""
        return KNOWN_AS.get(variable_of(effect), UNKNOWN + of)
    return str(effect["name"])


def named(effect: dict[str, Any]) -> str:
    """Its name and where it is."""
    return name_of(effect) + _at(effect)


def _at(effect: dict[str, Any]) -> str:
    return f" at {effect['joint']}" if effect["joint"] else ""


def named_with_others(effect: dict[str, Any], among: Sequence[dict[str, Any]] = ()) -> str:
    """The same with all that these records do not tell it from; a wave with its order, where another one of the kind is `among` those at
    its joint."""
    others = [other for other in effect["confounded_with"] if other["name"] != effect["name"]]
    here = dict.fromkeys(name_of(other) for other in others if other["joint"] == effect["joint"])
    elsewhere = [other for other in effect["confounded_with"] if other["joint"] != effect["joint"]]
    place = _at(effect) + (f" (or {joined([named(other) for other in elsewhere], 'or')})" if elsewhere else "")
    alike = [one for one in among if (one["name"], one["joint"]) == (effect["name"], effect["joint"])]
    order = effect["parameters"].get("order") if len(alike) > 1 else None
    wave = f" of order {order['value']:g}" if order else ""
    return name_of(effect) + wave + (f" (or {joined([*here], 'or')})" if here else "") + place


def joined(names: Sequence[str], last: str = "and") -> str:
    """Some names as one writes them."""
    return f"{', '.join(names[:-1])} {last} {names[-1]}" if len(names) > 1 else "".join(names)


def meaning(effect: dict[str, Any]) -> str:
    """What an effect is, in a sentence: the first line of its class in the catalogue."""
    if effect["name"] == "unknown":
        if variable_of(effect) in ("frequency", "resonance"):
            return f"What no name of the catalogue describes, learned from the records: {_kind_of(effect)}."
        if variable_of(effect) == "record":
            return f"A joint that is another one in every record, as no change or drift describes: {_kind_of(effect)}."
        misread = effect["port"] == "sensor" and variable_of(effect) in ("reading", HYSTERESIS, CROSSTALK)
        what = "An error of the encoder" if misread else "A torque"
        return f"{what} that no law of the catalogue describes, learned from the records as {_kind_of(effect)}."
    if effect["name"] == "inertial-parameters" and "share" in effect["parameters"]:
        return "This link's mass, and its moments with it, are not as in the URDF: all by this share."
    if effect["name"] == "inertial-parameters" and "change" in effect["parameters"]:
        many = effect["joint"] is None
        links = "Several links are not as in the URDF, or carry a load" if many else "This link is not as in the URDF"
        return f"{links}: J(q) changes by this share of sqrt(J_ii J_jj), rms of the entry that changes most."
    if "centre_x" in effect["parameters"]:
        return "A mass at the last link, wherever its centre was found: x, y, z in the link frame."
    found = CATALOGUE.get(effect["name"])
    return (inspect.getdoc(found) or "").split("\n\n")[0].replace("`", "") if found else ""


def variable_of(effect: dict[str, Any]) -> str:
    """What a learned effect is a curve of; nothing for others."""
    return str(effect.get("curve", {}).get("variable", ""))


def values(effect: dict[str, Any]) -> str:
    """Its numbers in one line, or what its curve is of, how large and how far."""
    if effect["name"] == "unknown":
        more = (
            _numbers(effect)
            if variable_of(effect) in ("resonance", LUBRICATED)
            else extent(effect)
            if "curve" in effect
            else ""
        )
        return ", ".join(filter(None, [_kind_of(effect), more]))
    return _numbers(effect)


def _numbers(effect: dict[str, Any]) -> str:
    """Its parameters in one line."""
    said, parts = remarks(effect), []
    by = "off by " if effect["declared"] and effect["name"] in FIELDS else ""
    for name, p in effect["parameters"].items():
        std = "" if p["std"] is None else f" +- {p['std']:.2g}"
        parts.append(
            f"{name} {said[name]}" if name in said else f"{name} {by}{p['value']:.5g}{std} {p['unit']}".rstrip()
        )
    return ", ".join(parts)


def remarks(effect: dict[str, Any]) -> dict[str, str]:
    """What is said of a parameter in the place of its value, where the records do not tell it."""
    kinds = {p.name: p for p in getattr(CATALOGUE.get(effect["name"]), "parameters", ())}
    said = {}
    for name, p in effect["parameters"].items():
        kind = kinds.get(name)
        if p["std"] is None and not (kind and kind.whole):
            told = "as declared" if kind and kind.declared else "not told by these records"
            said[name] = (
                told if told == "as declared" else f"{told} (kept at {p['value']:.3g} {p['unit']}".rstrip() + ")"
            )
    return said


def extent(effect: dict[str, Any]) -> str:
    """How large a learned curve is, and over which range of its variable."""
    curve = effect["curve"]
    sizes = f"{_range(curve['heights'])} {curve['unit']}".rstrip()
    if curve["variable"] == "frequency":
        told = [p["std"] is not None for name, p in effect["parameters"].items() if name.startswith("delay")]
        delays = compress(curve["delays"], told if any(told) else repeat(True))
        sizes = f"gain {sizes}, delay {_range([1e3 * delay for delay in delays])} ms"
    if curve["variable"] == CROSSTALK:
        return f"{number(100 * curve['heights'][0])} % of it"
    _, unit = _variable(curve, effect["port"])
    if curve["variable"] in (HYSTERESIS, PRESLIDING):
        lag, made = max(map(abs, curve["loop"]["output"])), curve["unit"] or unit
        return f"up to {number(lag)} {made} in a loop of +- {number(max(curve['knots']))} {unit}"
    reach = [0.0, curve["period"]] if curve.get("period") else curve["knots"]
    over = "records " * (curve["variable"] == "record")
    return f"{sizes} over {over}{_range(reach)} {unit}".rstrip()


def _range(numbers: Sequence[float]) -> str:
    return f"{number(min(numbers))} to {number(max(numbers))}"


def _kind_of(effect: dict[str, Any]) -> str:
    """What a learned curve is a function of."""
    curve, port = effect.get("curve"), effect["port"]
    if curve is None:
        return "a curve"
    place = "deflection" if port == "spring" else "position"
    what = {
        "position": f"a curve of {place}",
        "friction": "dry friction that is a curve of position",
        "torque": "a curve of the load",
        "drive": "a curve of the drive's torque",
        "sliding": "dry friction that is a curve of velocity",
        "loaded": "dry friction that is a curve of the load",
        "driven": "dry friction that is a curve of the drive's torque",
        "damping": f"damping that is a curve of {place}",
        "laden": "damping that is a curve of the load",
        "driving": "damping that is a curve of the drive's torque",
        "structural": f"damping by a torque, not a velocity, that is a curve of {place}",
        "gain": "a share of its torque that is a curve of position",
        "passing": "a share of its load that is a curve of position",
        "fading": "a share of its torque that is a curve of velocity",
        "reading": "an error that is a curve of the motor's position",
        "stiffness": "stiffness that is a curve of the motor's position",
        "mesh": "a curve of the motor's position",
    }
    if curve["variable"] == "frequency":
        signal = "angle that is measured" if port == "sensor" else "torque that is commanded"
        return f"gain and delay of the {signal}, as curves of frequency"
    if curve["variable"] == "resonance":
        return f"a mass that rings at {effect['parameters']['frequency']['value']:.3g} Hz at the {port}"
    if curve["variable"] == "record":
        return f"a stiffness of its own in each record at the {port}, by shares of what it is in the first"
    if curve["variable"] == HYSTERESIS:
        return f"a lag that depends on what was before, a loop over {_variable(curve, port)[0]}"
    if curve["variable"] == LUBRICATED:
        return f"friction that gives before it slides, and is less the faster it does, at the {port}"
    if curve["variable"] == PRESLIDING:
        return f"friction that gives before it slides, a loop over {_variable(curve, port)[0]}"
    if curve["variable"] == CROSSTALK:
        signal = "angle" if port == "sensor" else "torque"
        return f"a share of the {signal} of the motor of joint {curve['from_joint']}"
    again = f", again every {curve['period']:.4g} {curve['period_unit']}" if curve.get("period") else ""
    return f"{what.get(curve['variable'], 'a curve of ' + curve['variable'])} at the {port}{again}"


def _variable(curve: dict[str, Any], port: str) -> tuple[str, str]:
    """What a learned curve is drawn over, and its unit."""
    if curve["variable"] in ("frequency", "record"):
        return curve["variable"], "Hz" if curve["variable"] == "frequency" else ""
    slides, motor = curve["period_unit"] == "m", port in ("motor", "sensor")
    length, force, torque = ("m", "N", "force") if slides else ("rad", "Nm", "torque")
    turning = "link position" if slides else "link angle"
    loop = LOOPS.get((curve["variable"], port))
    of = "velocity" if curve["variable"] == LUBRICATED else loop.of if loop else KINDS[curve["variable"]].of
    match of:
        case "position":
            name = "motor angle" if motor else "deflection" if port == "spring" else turning
            return name, length
        case "velocity":
            name = "motor velocity" if motor else "rate of deflection" if port == "spring" else "link velocity"
            return name, f"{length}/s"
        case "load":
            return "load at the motor" if motor else f"spring {torque}", force
        case "drive":
            return "motor torque", "Nm"
        case _:
            return "motor angle", "rad"


def abscissa(curve: dict[str, Any], port: str) -> str:
    """The label of what a learned curve is drawn over."""
    name, unit = _variable(curve, port)
    return f"{name} [{WRITTEN.get(unit, unit)}]"


def ordinate(curve: dict[str, Any], port: str) -> str:
    """The label of its heights."""
    what = {
        "direction": "dry friction", "velocity": "damping", "drive": "share of the torque", "position": "stiffness",
        "load": "share of the load",
    }  # fmt: skip
    plain = "error of the angle" if port == "sensor" else "torque" if curve["unit"] != "N" else "force"
    unit = WRITTEN.get(curve["unit"], curve["unit"]) or "1"
    return f"{what.get(KINDS[curve['variable']].times, plain)} [{unit}]"


def share_off(verdict: dict[str, Any], effect: dict[str, Any]) -> float | None:
    """By which share of itself a declared number is off, where it is one number and not 0."""
    declared, (parameter, *more) = verdict["declared"], effect["parameters"].values()
    if more or parameter["unit"] and effect["name"] not in FIELDS:
        return None
    was = (
        declared["drives"][FIELDS[effect["name"]]][declared["joints"].index(effect["joint"])]
        if parameter["unit"]
        else 1.0
    )
    return float(parameter["value"] / was) if was else None


def place(row: dict[str, Any]) -> str:
    """Where and how something unexplained shows."""
    lines = " and ".join(kind for kind in ("odd", "even") if row[kind]) or "excited"
    low, high = row["band_hz"]
    port = f"{' or '.join(row['ports'])} of {row['joint']}" if row["ports"] else row["joint"]
    return f"{port}, {low:g}-{high:g} Hz, {lines} lines"


def percent(share: float | None) -> str:
    """A share in percent."""
    return "–" if share is None else f"{number(100 * share, 3)} %"
