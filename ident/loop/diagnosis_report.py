"""A diagnosis for the person who opens it: report.html, and the same in a few lines of text. Every number is verdict.json's."""

from __future__ import annotations

import shlex
from collections.abc import Collection
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.arm.arm_model import DRIVES
from ident.arm.parts import degrees
from ident.effects.base import Effect
from ident.effects.by_record import ByRecord
from ident.effects.learned import LearnedCurve
from ident.effects.response import Response
from ident.effects.ringing import Ringing
from ident.identification.verdict import entry, number
from ident.loop.confounded import UNPLAYED
from ident.loop.diagnose import Diagnosis
from ident.loop.effect_words import (
    extent,
    joined,
    meaning,
    name_of,
    named,
    named_with_others,
    percent,
    place,
    remarks,
    share_off,
    values,
)
from ident.loop.either_model import ENDED
from ident.loop.growth import growth, nearest
from ident.loop.held_out import HeldOut, felt, gains, held_out, reconstructed, with_few_lines
from ident.loop.repeats import unrepeated
from ident.records.left_out import LEFT_OUT
from ident.search.deviations import ALONE, BESIDE, SIGMAS
from ident.search.trace import PORTS

if TYPE_CHECKING:
    from markupsafe import Markup

#: Held-out error, of noise alone, up to which the records are explained.
EXPLAINED = 1.5
#: The same from which what was found with something unexplained is told as what comes nearest only.
FAR = 10.0
#: The same of a joint or a band, which a few loud lines may make: of clean records it is 1.5 or 1.6 at times.
BEYOND = 2.0
#: More declared numbers that are off than these are counted in a sentence, not named.
NAMED = 2
#: Records of which what a learned curve wants is drawn.
DRAWN = 6
#: The numbers of a drive as they are written, and their units: of a slide, where that is another one.
OF_DRIVES = {
    "K": ("K", "N m/rad", "N/m"), "J_m": ("J<sub>m</sub>", "kg m²", ""), "D": ("D", "N m s/rad", ""),
    "D_spring": ("D<sub>spring</sub>", "N m s/rad", "N s/m"),
}  # fmt: skip


def html(d: Diagnosis, verdict: dict[str, Any]) -> str:
    """Returns the report of a diagnosis whose verdict.json is `verdict`, as one HTML file that needs nothing else."""
    from markupsafe import Markup

    from ident.loop.diagnosis_figures import before_after_figure
    from ident.reports.report import environment, software

    rows, ids = held_out(d), [record.id for record in d.campaign.records]
    shown = _telling(rows, verdict, d.campaign.joints)
    return (
        environment()
        .get_template("diagnosis.html.jinja")
        .render(
            v=verdict,
            sentence=sentence(verdict, with_few_lines(d)),
            detail=detail(verdict),
            artefacts=sensor_artefacts(verdict),
            picture=Markup(before_after_figure(shown)) if shown else None,
            picture_record=ids[shown.record] if shown else "",
            picture_joint=d.campaign.joints[shown.joint] if shown else "",
            parts="lines" if d.split.note else "records",
            both_fitted=degrees(d.end.problem.data) > degrees(d.split.fit),
            not_held_out=not_held_out(verdict),
            effects=[
                (e, meaning(e), _law(d, a.effect, a.std)) for e, a in zip(_lacking(verdict), d.added, strict=True)
            ],
            numbers=[(e, meaning(e), share_off(verdict, e)) for e in _off(verdict)],
            drives=_drives(verdict, [d.model.chain.slides(j) for j in range(d.model.chain.n)]),
            ports=_port_map(d),
            entries=_entries(verdict, d.campaign.n),
            todo=todo(verdict),
            software=software(),
            name_of=name_of,
            remarks=remarks,
            nearest=nearest(verdict),
            extent=extent,
            unplayed=UNPLAYED,
        )
    )


def sentence(verdict: dict[str, Any], few: Collection[str] = ()) -> str:
    """What was found, in one sentence, and what is left out, in another; the errors of joints and bands of `few` lines say nothing."""
    notes = [note.removeprefix(LEFT_OUT) for note in verdict["notes"] if note.startswith(LEFT_OUT)]
    out = [f" What stands alone at {note.split(' Hz')[0]} Hz is left out." for note in notes]
    return "".join([_sentence(verdict, few), *out])


def _sentence(verdict: dict[str, Any], few: Collection[str]) -> str:
    effects, found = verdict["effects"], _found(verdict)
    alike = not unrepeated(verdict["error"]["noise_per_joint"])
    if verdict["status"] == "explained":
        what = "every record within its noise" if alike else "what repeats in the records"
        return f"Nothing is missing: the declared model explains {what}."
    found = f"{found[0].upper()}{found[1:]}" if found else ""
    if verdict["status"] == "effect-found":
        many = len(_off(verdict)) > NAMED
        e, pronoun = verdict["error"], "all corrected" if many else "it" if len(effects) == 1 else "them"
        noise = e["noise_floor"]
        if noise and e["after"]["all"] > EXPLAINED * noise:
            before, after = (f"{e[when]['all'] / noise:.3g}" for when in ("before", "after"))
            return f"{found}; with {pronoun} its error falls from {before} to {after} times the noise."
        but = joined([f"{name} ({times:.2g} times the noise)" for name, times in _beyond(e, few)])
        what = "the records" if alike else "what repeats in the records"
        return f"{found}; with {pronoun} it explains {what}{', but for ' if but else ''}{but}."
    left = place(verdict["unexplained"][0]) if verdict["unexplained"] else "the records"
    left += ", when the search was ended for time" if any(note.startswith(ENDED) for note in verdict["notes"]) else ""
    if not effects:
        return f"Something acts that nothing in the catalogue explains: {left}."
    names = joined([named_with_others(e, effects) for e in effects])
    if grows := growth(verdict):
        where = f"{left}; " if verdict["unexplained"] else ""
        return f"Something acts that nothing in the catalogue explains: {where}with {names} {grows}."
    if _is_far(verdict):
        come = "comes" if len(effects) == 1 else "come"
        return f"Something acts that nothing in the catalogue explains: {left}; {names} {come} nearest, far from it."
    return f"{found}; even so something stays unexplained: {left}."


def _is_far(verdict: dict[str, Any]) -> bool:
    """Whether what was found leaves so much, of the noise and of the error before, that it is hardly what acts."""
    e = verdict["error"]
    before, after = e["before"]["all"], e["after"]["all"]
    return after > FAR * e["noise_floor"] and after > before / 2


def _beyond(e: dict[str, Any], few: Collection[str]) -> list[tuple[str, float]]:
    """The joints and bands whose error is more than noise explains, and how many times the noise it is."""
    ratios = [
        (name, after / e[noise][name])
        for key, noise in (("per_joint", "noise_per_joint"), ("per_band", "noise_per_band"))
        for name, after in e["after"][key].items()
        if name not in few and e[noise].get(name)
    ]
    return [(name, times) for name, times in ratios if times > BEYOND]


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
        return f"the declared model lacks {joined([named_with_others(e, lacking) for e in (*lacking, *off)])}"
    many = f"{len(off)} declared numbers are off{' besides the springs' if _springs(verdict) else ''}"
    names = joined([named_with_others(e, lacking) for e in lacking])
    return f"the declared model lacks {names}, and {many}" if lacking else many


def springs(verdict: dict[str, Any]) -> str:
    """Which springs are not as declared, in a sentence; nothing where all are."""
    off = [f"{joint} {100 * share:+.3g} %" for joint, share in _springs(verdict)]
    only = " (of an arm that does not explain the records)" if verdict["status"] == "unexplained" else ""
    return f"Springs are not as declared{only}: {', '.join(off)}" if off else ""


def _springs(verdict: dict[str, Any]) -> list[tuple[str, float]]:
    """The joints whose springs are not as declared, and by which share of that."""
    granted = BESIDE.J_m if _lacking(verdict) else ALONE.J_m
    declared, found = verdict["declared"]["drives"]["K"], verdict["drives"]["K"]
    rows = zip(verdict["declared"]["joints"], declared, found["value"], found["std"], strict=True)
    return [
        (joint, K / was - 1.0)
        for joint, was, K, std in rows
        if was and std is not None and abs(K - was) > max(SIGMAS * std, granted * was)
    ]


def _drives(verdict: dict[str, Any], slides: list[bool]) -> list[dict[str, Any]]:
    """A row for every number of every drive: as declared, as found, and by how much it is off, each with its standard deviation."""
    rows = []
    for j, joint in enumerate(verdict["declared"]["joints"]):
        for key in DRIVES:
            name, unit, sliding = OF_DRIVES[key]
            declared = (verdict["declared"]["drives"][key] or [None] * (j + 1))[j]
            found, std = (verdict["drives"][key][which][j] for which in ("value", "std"))
            told = declared and std is not None
            rows.append(
                {
                    "joint": joint if key == DRIVES[0] else "", "name": name, "unit": sliding if slides[j] and sliding else unit,
                    "declared": declared, "value": found, "std": std, "off": 100.0 * (found / declared - 1.0) if declared else None,
                    "off_std": 100.0 * std / declared if told else None, "is_off": told and abs(found - declared) > SIGMAS * std,
                }
            )  # fmt: skip
    return rows


def detail(verdict: dict[str, Any]) -> str:
    """The sentence's numbers."""
    e, worst = verdict["error"], _worst(verdict)
    off = f" {springs(verdict)} (see Drives)." if springs(verdict) else ""
    if not verdict["effects"]:
        return f"Held-out error {percent(e['after']['all'])}; noise alone makes {percent(e['noise_floor'])}.{off}"
    fell = f"Held-out error {percent(e['before']['all'])} before, {percent(e['after']['all'])} after"
    wrong = f" Without the effects {worst[1]} was off by {percent(worst[0])} (rms over postures)." if worst else ""
    return f"{fell}; noise alone makes {percent(e['noise_floor'])}.{wrong}{off}"


def todo(verdict: dict[str, Any]) -> list[str]:
    """What to do next, most useful first."""
    lines, plans = [], bool(verdict["unexplained"])
    for effect in verdict["effects"]:
        for other in effect["confounded_with"]:
            plans = plans or other["recipe"] not in UNPLAYED
            begin, join = ("", "or") if other["recipe"] in UNPLAYED else ("To tell ", "from")
            lines.append(f"{begin}{named(effect)} {join} {named(other)}: {other['separate_by']}.")
    if verdict["unexplained"]:
        lines.append(f"Look at {place(verdict['unexplained'][0])}: ident next plans records that show it best.")
    if growth(verdict):
        lines.append(
            "Keep the declared arm: the one in this directory has what comes nearest, with which the held-out error grows."
        )
    elif verdict["effects"]:
        careful = (
            ", but with care: what stays unexplained bends its numbers" if verdict["status"] == "unexplained" else ""
        )
        lines.append(
            f"Use the corrected arm in this directory (robot.toml, identified.urdf, J.casadi) in place of the declared one{careful}."
        )
    if plans:
        out = shlex.quote(verdict["made_with"].get("out", "."))
        lines.append(f"ident next {out} writes that experiment, ready to run.")
    return lines or ["Nothing: use the identified arm in this directory."]


def not_held_out(verdict: dict[str, Any]) -> list[str]:
    """The joints at which something acts, and that no record excites of which errors are told."""
    acted = [row["joint"] for row in (*verdict["effects"], *verdict["unexplained"]) if row["joint"]]
    return [joint for joint in dict.fromkeys(acted) if joint not in verdict["error"]["after"]["per_joint"]]


def text(verdict: dict[str, Any], brief: bool = False, few: Collection[str] = ()) -> str:
    """The verdict as a page of plain text; `brief`: the sentence, the table of errors and the effects only; `few` as in `sentence`."""
    e, once = verdict["error"], verdict["status"] == "explained"  # then nothing was added between before and after
    titles = ("error", "noise") if once else ("before", "after", "noise")
    lines = [sentence(verdict, few), "", f"{'held-out error [%]':<22}" + "".join(f"{title:>9}" for title in titles)]
    rows = [("all", e["before"]["all"], e["after"]["all"], e["noise_floor"])]
    of_joints, of_bands = (
        [(name, e["before"][key][name], after, e[noise].get(name)) for name, after in e["after"][key].items()]
        for key, noise in (("per_joint", "noise_per_joint"), ("per_band", "noise_per_band"))
    )
    lines += _errors(rows + of_joints, once)
    lines += [f"{joint:<22} no held-out record excites it" for joint in not_held_out(verdict)]
    lines += _errors(of_bands, once)
    of_links = [
        (f"{joint}, link encoder", w["before"], w["after"], w["noise"]) for joint, w in verdict["link_encoders"].items()
    ]
    lines += _errors(of_links, once)
    lines += ["", nearest(verdict)] if growth(verdict) else []
    for k, effect in enumerate(verdict["effects"], 1):
        lines += [""] * (not effect["declared"] or k == len(_lacking(verdict)) + 1)
        lines += _of_effect(k, effect, verdict, brief)
    if verdict["unexplained"]:
        left = verdict["unexplained"][: 3 if brief else None]
        lines += [
            "",
            *(f"unexplained: {place(row)}, {percent(row['share'])} of all that is unexplained" for row in left),
        ]
        lines += sensor_artefacts(verdict)
    if springs(verdict) and not brief:
        lines += ["", f"{springs(verdict)}."]
    worst = _worst(verdict)
    if worst and verdict["effects"]:
        lines += ["", f"J(q) without the effects: {worst[1]} off by {percent(worst[0])} rms over the workspace."]
    lines += [""] * bool(verdict["notes"] and not brief) + [f"! {note}" for note in verdict["notes"] if not brief]
    return "\n".join(lines)


def _errors(rows: list[tuple[str, float, float, float | None]], once: bool) -> list[str]:
    """Lines of the table: errors before and after, or `once` the one, and noise."""
    return [f"{name:<22}" + "".join(f"{_cell(value):>9}" for value in values[once:]) for name, *values in rows]


def _of_effect(k: int, effect: dict[str, Any], verdict: dict[str, Any], brief: bool) -> list[str]:
    """An effect in a line, and what else it could be."""
    share = share_off(verdict, effect) if effect["declared"] else None
    lines = [f"{k}. {named(effect)}: {values(effect)}" + (f" ({100 * share:+.3g} %)" if share else "")]
    lines += [f"   not told from {named(other)}: {other['separate_by']}" for other in effect["confounded_with"]]
    rivals = ", ".join(f"{named(rival)} {percent(rival['after'])}" for rival in effect["rivals"])
    if rivals and not brief:
        lines.append(f"   next best: {rivals}")
    return lines


def sensor_artefacts(verdict: dict[str, Any]) -> list[str]:
    """A line for every torque that was read and moved nothing."""
    return [
        f"Sensor artefact: torque of {one['joint']} at the {one['lines']} lines, {row['band_hz'][0]:g}-{row['band_hz'][1]:g} Hz "
        f"({percent(one['torque_share'])} of that at the excited ones): no motion follows it; or its controller cancels a force"
        for row in verdict["unexplained"]
        for one in row.get("unmoved", ())
    ]


def _worst(verdict: dict[str, Any]) -> tuple[float, str] | None:
    """The entry of J(q) that was off most (rms over postures), of those that changed by more than three times what they are
    known to; none where it was no worse before."""
    J = verdict["inertia"]["J"]
    n = len(J["change_rms"])
    if growth(verdict):
        return None
    rows = [(J["change_rms"][i][j], J["std_after"][i][j], entry(i, j, n)) for i in range(n) for j in range(i, n)]
    return max(((off, name) for off, std, name in rows if off and std is not None and off > 3.0 * std), default=None)


def _cell(share: float | None) -> str:
    return number(None if share is None else 100 * share, 3)


def _telling(rows: tuple[HeldOut, ...], verdict: dict[str, Any], joints: tuple[str, ...]) -> HeldOut | None:
    """The record to show: of the joint of the first effect, where it has one that reports, the one that missed most."""
    wanted = [effect["joint"] for effect in verdict["effects"]] + [row["joint"] for row in verdict["unexplained"]]
    own = [row for row in rows if wanted and joints[row.joint] == wanted[0]] or list(rows)
    return max(own, key=lambda row: float(np.sum(np.abs(row.before / row.noise) ** 2)), default=None)


def _law(d: Diagnosis, effect: Effect, std: tuple[float, ...]) -> dict[str, Markup | str] | None:
    """The figure of an effect's law, where it has a port, and the records that it shows."""
    from markupsafe import Markup

    from ident.loop.diagnosis_figures import (
        curve_figure,
        gains_figure,
        law_figure,
        record_figure,
        resonance_figure,
        response_figure,
    )

    slides = effect.joint is not None and d.model.chain.slides(effect.joint)
    through = felt(d, effect) if isinstance(effect, Ringing) else gains(d, effect)
    forces = () if through else reconstructed(d, effect, DRAWN if isinstance(effect, LearnedCurve) else 1)
    records = through.records if through else tuple(force.record for force in forces)
    if isinstance(effect, Ringing) and through:
        kind, figure = "resonance", resonance_figure(effect, through)
    elif isinstance(effect, Response):
        kind, figure = "curve", response_figure(effect, std, through)
    elif isinstance(effect, ByRecord):
        kind, figure = "curve", record_figure(effect, std)
    elif through:
        kind, figure = "gain", gains_figure(through)
    elif not forces:
        return None
    elif isinstance(effect, LearnedCurve):
        kind, figure = "curve", curve_figure(effect, std, forces, slides)
    else:
        kind, figure = "law", law_figure(forces[0], slides)
    ids = [d.campaign.records[record].id for record in sorted(records)]
    named_records = f"Record{'s' * (len(ids) > 1)} {', '.join(ids)}"
    return {"figure": Markup(figure), "records": named_records if ids else "", "kind": kind}


def _port_map(d: Diagnosis) -> dict[str, list[float | None]]:
    """{port: share [n]} of what the declared model leaves, before anything was added."""
    if not d.added:
        return {}
    shares = {(port, joint): share for port, joint, share in d.added[0].port_shares}
    return {port: [shares.get((port, j)) for j in range(d.campaign.n)] for port in PORTS}


def _entries(verdict: dict[str, Any], n: int) -> list[dict[str, Any]]:
    """How far each entry of J(q) was off, nothing for those that no record tells; those that are zero left out."""
    J = verdict["inertia"]["J"]
    rows = [
        {"name": entry(i, j, n), "rms": J["change_rms"][i][j], "largest": J["change_largest"][i][j], "std": J["std_after"][i][j],
         "cad": J["cad_rms"][i][j]}
        for i in range(n) for j in range(i, n)
    ]  # fmt: skip
    return [row for row in rows if row["cad"] or row["rms"] or row["std"] is None]
