"""A log's diagnosis for the person who opens it: report.html, and the same in a few lines of text. Every number is verdict.json's."""

from __future__ import annotations

from typing import Any

import numpy as np

from ident.logs.diagnose import LogDiagnosis
from ident.loop.effect_words import extent, joined, meaning, name_of, named, named_with_others, percent, values
from ident.reports.canvas import CAD, DATA, FIT, drawing
from ident.reports.report import environment, software

#: More effects than these are counted in the sentence, kind by kind.
NAMED = 3
#: Samples drawn of a joint, at most.
DRAWN = 1200


def sentence(v: dict[str, Any]) -> str:
    """What was found, in one sentence."""
    e = v["error"]
    if v.get("impossible"):
        return (
            f"What fits these torques is no arm: {joined(v['impossible'])}. Nothing found here is a result: look for a sign, unit, column or gear ratio of "
            "the log, or a declared mass or motor inertia, that is wrong."
        )
    if v["status"] == "explained":
        return "Nothing is missing: the declared arm explains every trajectory within its noise."
    if not v["effects"]:
        return f"Something acts that nothing in the catalogue explains: {percent(e['after']['all'])} of the torques."
    if e["after"]["all"] > e["before"]["all"]:
        grows = f"grows from {percent(e['before']['all'])} to {percent(e['after']['all'])}"
        return f"Something acts that nothing in the catalogue explains: with {_lacks(v)} the held-out error {grows}."
    fell = f"held out, {percent(e['before']['all'])} of the torques was left and {percent(e['after']['all'])} is"
    times = e["after"]["all"] / max(e["noise_floor"], 1e-300)
    rest = f", {times:.2g} times the noise: that much is unexplained" if v["status"] == "unexplained" else ""
    return f"The declared arm lacks {_lacks(v)}; {fell}{rest}."


def _lacks(v: dict[str, Any]) -> str:
    """The names of what is lacking, or how many joints have each."""
    effects = v["effects"]
    if len(effects) <= NAMED:
        return joined([named_with_others(effect) for effect in effects])
    joints: dict[str, list[str]] = {}
    for effect in effects:
        joints.setdefault(name_of(effect), []).append(effect["joint"])
    return joined([
        name if at == [None] else f"{name} at {joined(at)}" if len(at) <= NAMED else f"{name} at {len(at)} joints"
        for name, at in joints.items()
    ])  # fmt: skip


def text(v: dict[str, Any], brief: bool = False) -> str:
    """The verdict as a page of plain text; `brief`: the sentence, the table of errors and the effects only."""
    lines = [sentence(v), "", f"{'held-out error [%]':<22}{'before':>9}{'after':>9}{'noise':>9}"]
    lines += [f"{name:<22}" + "".join(f"{_cell(value):>9}" for value in row) for name, *row in errors(v)]
    for k, effect in enumerate(v["effects"], 1):
        lines += ["", f"{k}. {named(effect)}: {size(effect)} ({_fall(effect)})"]
        lines += [f"   impossible: {effect['impossible']}"] if "impossible" in effect else []
        lines += [f"   not told from {others}: {by}" for by, others in _others(effect).items()]
        rivals = ", ".join(f"{named(rival)} {percent(rival['after'])}" for rival in effect["rivals"])
        lines += [f"   next best: {rivals}"] if rivals and not brief else []
    if v["unexplained"]:
        lines += ["", *(f"unexplained: {place(row)}" for row in v["unexplained"][: 3 if brief else None])]
    lines += [] if brief or not v["notes"] else ["", *(f"! {note}" for note in v["notes"])]
    return "\n".join(lines)


def size(effect: dict[str, Any]) -> str:
    """Its numbers in one line."""
    if effect["name"] == "inertial-parameters":
        return f"J(q) is off by {percent(effect['parameters']['change']['value'])} of sqrt(J_ii J_jj), rms"
    return values(effect)


def _others(effect: dict[str, Any]) -> dict[str, str]:
    """What an effect is not told from, by what would tell it."""
    found: dict[str, list[str]] = {}
    for other in effect["confounded_with"]:
        found.setdefault(other["separate_by"], []).append(
            name_of(other) if other["joint"] == effect["joint"] else named(other)
        )
    return {by: joined(names, "or") for by, names in found.items()}


def _fall(effect: dict[str, Any]) -> str:
    return f"{percent(effect['before'])} to {percent(effect['after'])}"


def place(row: dict[str, Any]) -> str:
    """Where more is left than noise makes."""
    low, high = row["band_hz"]
    return f"{row['joint']}, {low:.2g}-{high:.2g} Hz, {percent(row['share'])} of all that is unexplained"


def errors(v: dict[str, Any]) -> list[tuple[str, float, float, float | None]]:
    """Rows of the table: name, errors before and after, noise."""
    e = v["error"]
    rows = [("all", e["before"]["all"], e["after"]["all"], e["noise_floor"])]
    for key, noise in (("per_joint", e["noise_per_joint"]), ("per_band", {})):
        rows += [(name, e["before"][key][name], after, noise.get(name)) for name, after in e["after"][key].items()]
    return rows


def _cell(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.3g}"


def html(d: LogDiagnosis, v: dict[str, Any]) -> str:
    """Returns the report of a log whose verdict.json is `v`, as one HTML file that needs nothing else."""
    from markupsafe import Markup

    return (
        environment()
        .get_template("log.html.jinja")
        .render(
            v=v, sentence=sentence(v), rows=errors(v), picture=Markup(figure(d)), extent=extent, size=size, meaning=meaning, name_of=name_of, place=place,
            todo=todo(v), software=software(),
        )
    )  # fmt: skip


def todo(v: dict[str, Any]) -> list[str]:
    """What to do next, most useful first."""
    tell: dict[str, list[str]] = {}
    for effect in v["effects"]:
        for by, others in _others(effect).items():
            tell.setdefault(by, []).append(f"{named(effect)} from {others}")
    lines = [f"To tell {joined(pairs)}: {by}." for by, pairs in tell.items()]
    if v["unexplained"]:
        lines.append(
            f"Look at {place(v['unexplained'][0])}: trajectories that excite this joint more there would show it."
        )
    lines.append(
        "Springs, motor inertias and J(q) without friction's doubt: multisine records (ident export-excitation)."
    )
    return lines


def figure(d: LogDiagnosis) -> str:
    """Returns what the declared and the corrected arm leave of each joint's torque where neither was fitted, over time, as SVG."""
    part = d.equations.report
    before, after = d.before.left(part), d.after.left(part)
    span = part.spans[0]
    t = np.linspace(span.first, span.last, span.samples)
    every = slice(None, span.samples, max(1, span.samples // DRAWN))
    n = d.log.n
    with drawing(7.4, 0.6 + 1.15 * n, "log before after") as (canvas, svg):
        axes = canvas.subplots(n, 1, sharex=True, squeeze=False)[:, 0]
        for j, (one, joint) in enumerate(zip(axes, d.log.joints, strict=True)):
            for signal, colour, label, width in (
                (part.tau, DATA, "torque", 0.9),
                (before, CAD, "left before", 1.2),
                (after, FIT, "left after", 1.4),
            ):
                one.plot(t[every], signal[: span.samples, j][every], color=colour, linewidth=width, label=label)
            one.set_ylabel(f"{joint}\n[{'N' if d.model.chain.slides(j) else 'N m'}]")
        axes[-1].set_xlabel(f"time in trajectory {span.id} [s]")
        canvas.legend(*axes[0].get_legend_handles_labels(), loc="upper center", ncol=3)
        canvas.subplots_adjust(
            left=0.13, right=0.985, top=1 - 0.35 / (0.6 + 1.15 * n), bottom=0.5 / (0.6 + 1.15 * n), hspace=0.18
        )
        return svg("What each model leaves of the torques, before and after")
