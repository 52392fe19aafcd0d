"""A diagnosis for the person who opens it: report.html, and the same in a few lines of text. Every number is verdict.json's."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.deviations import NAMES
from ident.diagnose import Diagnosis
from ident.effects.base import Effect
from ident.effects.catalogue import CATALOGUE
from ident.effects.response import Response
from ident.held_out import HeldOut, held_out, reconstructed
from ident.trace import PORTS
from ident.verdict import entry, number

if TYPE_CHECKING:
    from markupsafe import Markup

#: Held-out error, of noise alone, up to which the records are explained.
EXPLAINED = 1.5
#: More declared numbers that are off than these are counted in a sentence, not named.
NAMED = 2
#: Which number of a drive an effect says is off.
FIELDS = {name: field for field, name in NAMES.items()}


def html(d: Diagnosis, verdict: dict[str, Any]) -> str:
    """Returns the report of a diagnosis whose verdict.json is `verdict`, as one HTML file that needs nothing else."""
    from markupsafe import Markup

    from ident.diagnosis_figures import before_after_figure
    from ident.report import environment, software

    rows, ids = held_out(d), [record.id for record in d.campaign.records]
    shown = _telling(rows, verdict, d.campaign.joints)
    return (
        environment()
        .get_template("diagnosis.html.jinja")
        .render(
            v=verdict,
            sentence=sentence(verdict),
            detail=detail(verdict),
            artefacts=sensor_artefacts(verdict),
            picture=Markup(before_after_figure(shown)) if shown else None,
            picture_record=ids[shown.record] if shown else "",
            picture_joint=d.campaign.joints[shown.joint] if shown else "",
            effects=[(e, meaning(e), _law(d, a.effect)) for e, a in zip(_lacking(verdict), d.added, strict=True)],
            numbers=[(e, meaning(e), _share(verdict, e)) for e in _off(verdict)],
            drives=_drives(verdict),
            slides=any(map(d.model.chain.slides, range(d.model.chain.n))),
            ports=_port_map(d),
            entries=_entries(verdict, d.campaign.n),
            todo=todo(verdict),
            software=software(),
        )
    )


def sentence(verdict: dict[str, Any]) -> str:
    """What was found, in one sentence."""
    effects, joined = verdict["effects"], _found(verdict)
    if verdict["status"] == "explained":
        return "Nothing is missing: the declared model explains every record within its noise."
    if verdict["status"] == "effect-found":
        many = len(_off(verdict)) > NAMED
        e, pronoun = verdict["error"], "all corrected" if many else "it" if len(effects) == 1 else "them"
        found, noise = f"{joined[0].upper()}{joined[1:]}; with {pronoun}", e["noise_floor"]
        if noise and e["after"]["all"] > EXPLAINED * noise:
            before, after = (f"{e[when]['all'] / noise:.3g}" for when in ("before", "after"))
            return f"{found} its error falls from {before} to {after} times the noise."
        return f"{found} it explains the records."
    place = _place(verdict["unexplained"][0]) if verdict["unexplained"] else "the records"
    if not effects:
        return f"Something acts that nothing in the catalogue explains: {place}."
    return f"{joined[0].upper()}{joined[1:]}; even so something stays unexplained: {place}."


def _lacking(verdict: dict[str, Any]) -> list[dict[str, Any]]:
    """What the declared model does not have at all."""
    return [effect for effect in verdict["effects"] if not effect["declared"]]


def _off(verdict: dict[str, Any]) -> list[dict[str, Any]]:
    """What it has at another value."""
    return [effect for effect in verdict["effects"] if effect["declared"]]


def _found(verdict: dict[str, Any]) -> str:
    """What the declared model lacks, and declared numbers that are off: their names, or how many where they are many."""
    lacking, off = _lacking(verdict), _off(verdict)
    if len(off) <= NAMED:
        return f"the declared model lacks {_names([*lacking, *off])}"
    many = f"{len(off)} declared numbers are off"
    return f"the declared model lacks {_names(lacking)}, and {many}" if lacking else many


def _share(verdict: dict[str, Any], effect: dict[str, Any]) -> float | None:
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


def _drives(verdict: dict[str, Any]) -> list[dict[str, Any]]:
    """A row for every drive: each number as declared, as found, and its standard deviation."""
    declared, found = verdict["declared"]["drives"], verdict["drives"]
    return [
        {
            name: {"declared": declared[name] and declared[name][j], "value": p["value"][j], "std": p["std"][j]}
            for name, p in found.items()
        }
        for j in range(len(verdict["declared"]["joints"]))
    ]


def detail(verdict: dict[str, Any]) -> str:
    """The sentence's numbers."""
    e, worst = verdict["error"], _worst(verdict)
    if not verdict["effects"]:
        return f"Held-out error {_percent(e['after']['all'])}; noise alone makes {_percent(e['noise_floor'])}."
    fell = f"Held-out error {_percent(e['before']['all'])} before, {_percent(e['after']['all'])} after"
    off = f" Without the effects {worst[1]} was off by {_percent(worst[0])} (rms over postures)." if worst else ""
    return f"{fell}; noise alone makes {_percent(e['noise_floor'])}.{off}"


def meaning(effect: dict[str, Any]) -> str:
    """What an effect is, in a sentence: the first line of its class in the catalogue."""
    if effect["name"] == "unknown":
        if _variable(effect) == "frequency":
            return f"What no name of the catalogue describes, learned from the records: {_values(effect)}."
        what = "An error of the encoder" if _variable(effect) == "reading" else "A torque"
        return f"{what} that no law of the catalogue describes, learned from the records as {_values(effect)}."
    if effect["name"] == "inertial-parameters" and effect["joint"] is None:
        return (
            "Several links are not as in the URDF, or carry a load: J(q) changes by this share of sqrt(J_ii J_jj), rms."
        )
    found = CATALOGUE.get(effect["name"])
    return (inspect.getdoc(found) or "").split("\n\n")[0].replace("`", "") if found else ""


def todo(verdict: dict[str, Any]) -> list[str]:
    """What to do next, most useful first."""
    lines = []
    for effect in verdict["effects"]:
        for other in effect["confounded_with"]:
            lines.append(f"To tell {_named(effect)} from {_named(other)}: {other['separate_by']}.")
    if verdict["unexplained"]:
        lines.append(f"Look at {_place(verdict['unexplained'][0])}: ident next plans records that show it best.")
    if verdict["effects"]:
        lines.append(
            "Use the corrected arm in this directory (robot.toml, identified.urdf, J.casadi) in place of the declared one."
        )
    if lines and lines[0].startswith(("To tell", "Look")):
        lines.append("ident next OUT writes that experiment, ready to run.")
    return lines or ["Nothing: use the identified arm in this directory."]


def text(verdict: dict[str, Any], brief: bool = False) -> str:
    """The verdict as a page of plain text; `brief`: the sentence, the table of errors and the effects only."""
    e = verdict["error"]
    lines = [sentence(verdict), "", f"{'held-out error [%]':<22}{'before':>9}{'after':>9}{'noise':>9}"]
    rows = [("all", e["before"]["all"], e["after"]["all"], e["noise_floor"])]
    for key, noise in (("per_joint", "noise_per_joint"), ("per_band", "noise_per_band")):
        rows += [(name, e["before"][key][name], after, e[noise].get(name)) for name, after in e["after"][key].items()]
    for name, before, after, noise in rows:
        lines.append(f"{name:<22}" + "".join(f"{_cell(value):>9}" for value in (before, after, noise)))
    for k, effect in enumerate(verdict["effects"], 1):
        share = _share(verdict, effect) if effect["declared"] else None
        lines += [""] * (not effect["declared"] or k == len(_lacking(verdict)) + 1)
        lines += [f"{k}. {_named(effect)}: {_values(effect)}" + (f" ({100 * share:+.3g} %)" if share else "")]
        lines += [f"   not told from {_named(other)}: {other['separate_by']}" for other in effect["confounded_with"]]
        rivals = ", ".join(f"{_named(rival)} {_percent(rival['after'])}" for rival in effect["rivals"])
        if rivals and not brief:
            lines.append(f"   next best: {rivals}")
    if verdict["unexplained"]:
        lines += [
            "",
            *(
                f"unexplained: {_place(row)}, {_percent(row['share'])} of it"
                for row in verdict["unexplained"][: 3 if brief else None]
            ),
        ]
        lines += sensor_artefacts(verdict)
    worst = _worst(verdict)
    if worst and verdict["effects"]:
        lines += ["", f"J(q) without the effects: {worst[1]} off by {_percent(worst[0])} rms over the workspace."]
    return "\n".join(lines)


def sensor_artefacts(verdict: dict[str, Any]) -> list[str]:
    """A line for every torque that was read and moved nothing."""
    return [
        f"Sensor artefact: torque of {one['joint']} at the {one['lines']} lines, {row['band_hz'][0]:g}-{row['band_hz'][1]:g} Hz "
        f"({_percent(one['torque_share'])} of that at the excited ones): no motion follows it; or its controller cancels a force"
        for row in verdict["unexplained"]
        for one in row.get("unmoved", ())
    ]


def _worst(verdict: dict[str, Any]) -> tuple[float, str] | None:
    """The entry of J(q) that was off most (rms over postures), of those that changed by more than three times what they are
    known to."""
    J = verdict["inertia"]["J"]
    n = len(J["change_rms"])
    rows = [(J["change_rms"][i][j], J["std_after"][i][j], entry(i, j, n)) for i in range(n) for j in range(i, n)]
    return max(((off, name) for off, std, name in rows if off and std is not None and off > 3.0 * std), default=None)


def _names(effects: list[dict[str, Any]]) -> str:
    names = [_named(effect) for effect in effects]
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else "".join(names)


def _named(effect: dict[str, Any]) -> str:
    unknown = {"frequency": "an unknown frequency response", "reading": "an unknown error of the encoder"}
    name = unknown.get(_variable(effect), "a torque of unknown law") if effect["name"] == "unknown" else effect["name"]
    return f"{name} at {effect['joint']}" if effect["joint"] else name


def _variable(effect: dict[str, Any]) -> str:
    """What a learned effect is a curve of; nothing for others."""
    return str(effect.get("curve", {}).get("variable", ""))


def _values(effect: dict[str, Any]) -> str:
    if effect["name"] == "unknown":
        return _curve(effect["curve"], effect["port"]) if "curve" in effect else "a curve"
    parts = []
    for name, p in effect["parameters"].items():
        std = "" if p["std"] is None else f" +- {p['std']:.2g}"
        parts.append(f"{name} {p['value']:.5g}{std} {p['unit']}".rstrip())
    return ", ".join(parts)


def _curve(curve: dict[str, Any], port: str) -> str:
    """What a learned curve is a function of."""
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
        "fading": "a share of its torque that is a curve of velocity",
        "reading": "an error that is a curve of the motor's position",
        "stiffness": "stiffness that is a curve of the motor's position",
    }
    if curve["variable"] == "frequency":
        signal = "angle that is measured" if port == "sensor" else "torque that is commanded"
        return f"gain and delay of the {signal}, as curves of frequency"
    again = f", again every {curve['period']:.4g} {curve['period_unit']}" if curve.get("period") else ""
    return f"{what.get(curve['variable'], 'a curve of ' + curve['variable'])} at the {port}{again}"


def _place(row: dict[str, Any]) -> str:
    """Where and how something unexplained shows."""
    lines = " and ".join(kind for kind in ("odd", "even") if row[kind]) or "excited"
    low, high = row["band_hz"]
    port = f"{' or '.join(row['ports'])} of {row['joint']}" if row["ports"] else row["joint"]
    return f"{port}, {low:g}-{high:g} Hz, {lines} lines"


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{number(100 * share, 3)} %"


def _cell(share: float | None) -> str:
    return number(None if share is None else 100 * share, 3)


def _telling(rows: tuple[HeldOut, ...], verdict: dict[str, Any], joints: tuple[str, ...]) -> HeldOut | None:
    """The record to show: of the joint of the first effect, where it has one that reports, the one that gained most."""
    wanted = [effect["joint"] for effect in verdict["effects"]] + [row["joint"] for row in verdict["unexplained"]]
    own = [row for row in rows if wanted and joints[row.joint] == wanted[0]] or list(rows)
    return max(own, key=lambda row: float(np.sum(np.abs(row.before / row.noise) ** 2)), default=None)


def _law(d: Diagnosis, effect: Effect) -> dict[str, Markup | str] | None:
    """The figure of an effect's law, where it has a port."""
    from markupsafe import Markup

    from ident.diagnosis_figures import law_figure, response_figure

    if isinstance(effect, Response):
        return {"figure": Markup(response_figure(effect)), "record": ""}

    force = reconstructed(d, effect)
    if force is None:
        return None
    return {
        "figure": Markup(law_figure(force, d.model.chain.slides(force.joint))),
        "record": d.campaign.records[force.record].id,
    }


def _port_map(d: Diagnosis) -> dict[str, list[float | None]]:
    """{port: share [n]} of what the declared model leaves, before anything was added."""
    if not d.added:
        return {}
    shares = {(port, joint): share for port, joint, share in d.added[0].port_shares}
    return {port: [shares.get((port, j)) for j in range(d.campaign.n)] for port in PORTS}


def _entries(verdict: dict[str, Any], n: int) -> list[dict[str, Any]]:
    """How far each entry of J(q) was off; those that are zero left out."""
    J = verdict["inertia"]["J"]
    rows = [
        {"name": entry(i, j, n), "rms": J["change_rms"][i][j], "largest": J["change_largest"][i][j], "std": J["std_after"][i][j],
         "cad": J["cad_rms"][i][j]}
        for i in range(n) for j in range(i, n)
    ]  # fmt: skip
    return [row for row in rows if row["rms"]]
