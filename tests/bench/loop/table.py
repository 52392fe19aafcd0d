"""What the blind study tells: its table, the rates effect by effect, and every failure with its seed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from loop.judge import NEAR_CLEAN

Result = dict[str, Any]

#: (kind, score, what is asked, target).
ASKED = (
    ("clean", "explained", 'clean data: "explained"', 0.98),
    ("one", "named first", "one effect: right name and joint first, or named as confounded with the first", 0.95),
    ("one", "port", "one effect: right port", 0.98),
    ("two", "both named", "two effects: both named", 0.85),
    ("outside", "not misnamed", "outside the catalogue: no confident wrong name", 0.95),
    ("outside", "place", "outside the catalogue: right joint and port", 0.85),
    ("outside", "cut", "outside the catalogue: error cut by half", None),
    ("one", "near noise", "one effect: held-out error after at most 1.1 x noise floor", 0.95),
    ("one", "J(q)", "one effect: J(q) at most twice as wrong as of clean records", None),
    ("faint", "named first", "one effect that just shows: right name and joint first, or confounded with the first", 0.95),
    ("faint", "port", "one effect that just shows: right port", 0.98),
    ("faint", "near noise", "one effect that just shows: held-out error after at most 1.1 x noise floor", 0.95),
)  # fmt: skip
#: Seconds a diagnosis may take, and for how many records.
SECONDS = {"ypp3": 20.0, "arm6": 180.0}
MEANING = {
    "one": "one effect of the catalogue",
    "outside": "outside the catalogue",
    "faint": "one effect that just shows",
}


def table(found: Sequence[Result]) -> str:
    """The study in Markdown."""
    lines = [
        "# The loop, blind",
        "",
        (
            "Effects drawn at random (name, joint, size, robot), simulated, diagnosed from the campaign file alone. Written by "
            "`make bench-loop`."
        ),
        "",
        "| asked | target | found | of | by robot |",
        "|---|---|---|---|---|",
    ]
    for kind, score, text, target in ASKED:
        mine = [r for r in found if r["kind"] == kind and score in r["scores"]]
        if mine:
            goal = f"{target:.0%}" if target else "-"
            robots = ", ".join(f"{name} {_rate(part, score)}" for name, part in _by(mine, "robot"))
            lines.append(
                f"| {text} | {goal} | {np.mean([r['scores'][score] for r in mine]):.1%} | {len(mine)} | {robots} |"
            )
    for robot, mine in _by([r for r in found if r["seconds"]], "robot"):
        seconds = [r["seconds"] for r in mine]
        limit = SECONDS.get(robot, SECONDS["arm6"])
        inside = np.mean([s <= limit for s in seconds])
        middle, most = np.quantile(seconds, [0.5, 0.95])
        lines.append(
            f"| {robot}: seconds a diagnosis, as many at once as cores | {limit:g} | {inside:.0%} within | {len(mine)} | "
            f"median {middle:.0f}, 95 % below {most:.0f}, longest {max(seconds):.0f} |"
        )
    pairs = [(r["bias"], r["clean bias"]) for r in found if r.get("clean bias") and r.get("bias") is not None]
    if pairs:
        with_it, clean = np.array(pairs).T
        other = clean[:, None] / clean
        chance = other[~np.eye(len(clean), dtype=bool)] > NEAR_CLEAN
        lines += [
            "",
            (
                f"J(q) with the effect found against the same records without it: {np.median(with_it / clean):.2f} times as wrong "
                f"(median). Both are errors of noise, so that their ratio scatters: of two clean campaigns one is over "
                f"{NEAR_CLEAN:g} times as wrong as the other in {chance.mean() if chance.size else 0.0:.0%}."
            ),
        ]
    undrawn = [r for r in found if r["status"].startswith("not drawn")]
    if undrawn:
        lines += [
            "",
            f"Not drawn (nothing that shows and leaves the arm standing): {', '.join(r['id'] for r in undrawn)}.",
        ]
    for kind in MEANING:
        lines += _per_effect([r for r in found if r["kind"] == kind and r["scores"]], kind)
    return "\n".join(lines) + "\n"


def _per_effect(found: Sequence[Result], kind: str) -> list[str]:
    if not found:
        return []
    asked = [score for k, score, _, _ in ASKED if k == kind]
    lines = [
        "",
        f"## {MEANING[kind]}, name by name",
        "",
        f"| effect | draws | {' | '.join(asked)} | after / noise (median) |",
    ]
    lines.append("|---" * (len(asked) + 3) + "|")
    for name, mine in _by(found, "name"):
        rates = " | ".join(_rate(mine, score) for score in asked)
        ratios = [r["error"][1] / r["error"][2] for r in mine if r.get("error")]
        lines.append(f"| {name} | {len(mine)} | {rates} | {np.median(ratios) if ratios else np.nan:.2f} |")
    return lines


def failures(found: Sequence[Result]) -> str:
    """Every case that is not all right: what was there, what was said."""
    lines = ["", "## What went wrong", "", "| case | robot | there was | said | not |", "|---|---|---|---|---|"]
    for r in found:
        wrong = [name for name, good in r["scores"].items() if not good]
        if wrong or r["status"] == "error":
            there = " + ".join(f"{t['name']}@{t['joint']} {_values(t)}" for t in r["truth"]) or "nothing"
            said = " + ".join(f"{e['name']}@{e['joint']} {_values(e)}" for e in r["effects"])
            rest = "; ".join(
                f"{u['port']}@{u['joint']} {u['band_hz'][0]:g}-{u['band_hz'][1]:g} Hz"
                for u in r.get("unexplained", [])[:1]
            )
            error = (
                " {:.2g} -> {:.2g} (noise {:.2g})".format(*r["error"])
                if r.get("error")
                else f" {r['said'][-1][-200:]!r}"
            )
            lines.append(
                f"| {r['id']} | {r['robot']} | {there} | {r['status']}: {said} {rest}{error} | {', '.join(wrong)} |"
            )
    return "\n".join(lines) + "\n"


def _values(effect: Result) -> str:
    return "{" + ", ".join(f"{k} {v:.3g}" for k, v in list(effect["values"].items())[:3] if v is not None) + "}"


def _rate(found: Sequence[Result], score: str) -> str:
    return f"{sum(r['scores'].get(score, False) for r in found)}/{len(found)}"


def _by(found: Iterable[Result], key: str) -> list[tuple[str, list[Result]]]:
    groups: dict[str, list[Result]] = defaultdict(list)
    for one in found:
        groups[one[key]].append(one)
    return sorted(groups.items())
