"""The next experiment: records that tell apart what a diagnosis could not, or show best what it left, ready to be played."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ident.errors import ExperimentError, IdentError
from ident.identification.export import read
from ident.identification.identified import Identified
from ident.identification.robot_text import robot_toml
from ident.loop.confounded import RECIPES, UNPLAYED
from ident.loop.diagnosis_json import FILE, FORMAT, VERSION
from ident.loop.effect_words import name_of, named
from ident.machines.playing import export_excitation
from ident.plain import replace_file
from ident.records.campaign import Array, Campaign
from ident.records.inputs import again, document
from ident.simulator.bench import design
from symgen.plan import FORMAT as PLAN_FORMAT
from symgen.plan import VERSION as PLAN_VERSION
from symgen.plan import Cell, Model, chain_of_robot, feasible_postures, make_model
from symgen.robot import Robot, load_robot

#: Postures of one joint in an experiment at other postures, in one at the postures measured, and records at most.
NEW, SAME, MOST = 5, 2, 10
#: Other amplitudes, relative to the campaign's: smaller where friction is in question, or where a larger one is not `WORTH` times as large.
#: No joint swings further than `SWING` [rad or m].
LARGER, SMALLER, SWING, WORTH = 3.0, 0.3, 0.03, 1.5
#: Effects that small motions show best.
SLOW = ("motor-stribeck", "motor-hysteresis")
#: Finer and wider lines: this many times as dense, up to this share of the sampling rate.
DENSER, TOP = 2, 0.4
#: Postures among which the new ones are chosen.
CANDIDATES = 300


@dataclass(frozen=True)
class Wish:
    """What the next experiment is for: `recipe` as in `confounded.RECIPES`, at the joint (None: all), `because` in one line."""

    recipe: str
    joint: str | None
    because: str
    effects: tuple[str, ...] = ()
    order: float = 1.0


@dataclass(frozen=True)
class Next:
    """The planned experiment: `text` says it in a paragraph; `files` were written, none where nothing is left to be told."""

    text: str
    wish: Wish | None
    cells: tuple[Cell, ...]
    swing: float
    files: tuple[Path, ...]

    def document(self) -> dict[str, Any]:
        """The same as plain numbers and strings."""
        cells = [{"joint": cell.joint, "q": cell.q.tolist()} for cell in self.cells]
        return {
            "recipe": self.wish.recipe if self.wish else None,
            "because": self.wish.because if self.wish else None,
            "cells": cells,
            "swing_rad": self.swing if self.wish else None,
            "files": [str(file) for file in self.files],
            "text": self.text,
        }


def plan_next(result: str | Path, seed: int = 1) -> Next:
    """Writes `result`/next, a robot directory with a plan and what to play, by the verdict.json in `result`.

    The robot is the declared one, so that its records can be diagnosed together with those of the campaign; `seed` is
    of the excitation, and of the simulation that the text advises: not the campaign's, or its noise is drawn again.
    Raises IdentError, one line: no verdict, its campaign moved or changed; ExperimentError where no cell can be run.
    """
    out = Path(result)
    verdict = _verdict(out)
    if verdict["input"].get("kind") == "log":
        raise IdentError(f"{out}: the verdict on a log; expected one on a campaign (ident export-excitation plans one)")
    wish, apart = wanted(verdict), unplayed(verdict, out)
    if wish is None:
        nothing = "Nothing is left to tell apart: no effect is confounded, nothing is unexplained."
        none = "There is nothing to be played: no more records of this robot tell apart what is left."
        return Next("\n".join((none, *apart)) if apart else nothing, None, (), 0.0, ())
    campaign = again(verdict["input"])
    arm = _declared(read(out), campaign)
    place = out / "next"
    robot = _write_robot(arm, wish, campaign, place)
    chain = chain_of_robot(robot)
    model = make_model(chain, believe_zeros=robot.believe_zeros)
    cells = _runnable(_cells(wish, campaign, model, robot), model, robot, seed)
    plan = {
        "format": PLAN_FORMAT,
        "version": PLAN_VERSION,
        "robot": chain.name,
        "urdf_sha256": chain.sha256,
        "because": wish.because,
        "recipe": wish.recipe,
        "plan": {"cells": [{"joint": cell.joint, "q": cell.q.tolist(), "spare": False} for cell in cells]},
    }
    replace_file(place / "plan.json", json.dumps(plan, indent=1, ensure_ascii=False) + "\n")
    played = export_excitation(robot, chain, cells, place, seed=seed)
    files = (place / "robot.toml", place / "plan.json", *played)
    text = _paragraph(wish, cells, robot, campaign)
    then = _then(place, seed, verdict, out)
    return Next("\n".join((text, then, *apart)), wish, cells, robot.experiment.swing, files)


def wanted(verdict: dict[str, Any]) -> Wish | None:
    """Returns what is most worth knowing of what can be played: first what is confounded, in the order of the effects, then what is
    unexplained."""
    for effect in verdict["effects"]:
        for other in effect["confounded_with"]:
            if other["recipe"] in UNPLAYED:
                continue
            names = (effect["name"], other["name"])
            order = effect["parameters"].get("order", {}).get("value") or 1.0
            because = f"to tell {name_of(effect)} from {name_of(other)}: {other['separate_by']}"
            return Wish(other["recipe"], effect["joint"], because, names, float(order))
    for row in verdict["unexplained"]:
        low, high = row["band_hz"]
        lines = [kind for kind in ("odd", "even") if row[kind]]
        shown = f"{low:g}-{high:g} Hz, {' and '.join(lines) or 'excited'} lines"
        because = f"because something at {row['joint']} stays unexplained ({shown}): "
        if row["even"]:
            return Wish(
                "shift", row["joint"], because + "even lines follow the angle or the load, a shifted posture says which"
            )
        if row["odd"]:
            return Wish(
                "amplitude", row["joint"], because + "what is odd and no spring changes its share with the amplitude"
            )
        return Wish(
            "others", row["joint"], because + "excited from its neighbours it shows whether it is this joint's own"
        )
    return None


def unplayed(verdict: dict[str, Any], out: Path) -> list[str]:
    """A line for every two effects that no more records of the robot tell apart, and how a known mass does, where it does."""
    pairs = [
        (effect, other)
        for effect in verdict["effects"]
        for other in effect["confounded_with"]
        if other["recipe"] in UNPLAYED
    ]
    lines = [f"{named(effect)} or {named(other)}: {other['separate_by']}." for effect, other in pairs]
    if any(other["recipe"] == "mass" for _, other in pairs):
        lines.append(
            f"A known mass needs a URDF of its own and a diagnosis of its own: copy {out}, whose robot.toml and identified.urdf are the "
            "arm as found, add the mass to its last link, and plan, record and diagnose that robot by itself."
        )
    return lines


def _verdict(out: Path) -> dict[str, Any]:
    file = out / FILE
    verdict = document(file, "ident diagnose")
    try:
        if verdict["format"] != FORMAT or verdict["version"] > VERSION:
            raise IdentError(f"{file}: format {verdict['format']!r}; expected {FORMAT!r} up to version {VERSION}")
    except (KeyError, TypeError) as error:
        raise IdentError(f"{file}: not a verdict: {type(error).__name__} {error}; run ident diagnose") from None
    return verdict


def _declared(arm: Identified, campaign: Campaign) -> Identified:
    """The arm as it was declared; drives that were not keep what was identified."""

    def told(name: str, i: int, found: float) -> float:
        values = getattr(campaign, name)
        return float(values[i]) if values is not None and np.isfinite(values[i]) else found

    drives = [
        replace(
            drive, K=told("K", i, drive.K), J_m=told("J_m", i, drive.J_m), D=told("D", i, drive.D),
            D_spring=told("D_spring", i, drive.D_spring),
        )
        for i, drive in enumerate(arm.drives)
    ]  # fmt: skip
    return replace(arm, drives=tuple(drives), urdf=campaign.urdf)


def _write_robot(arm: Identified, wish: Wish, campaign: Campaign, place: Path) -> Robot:
    """The robot directory of the next experiment, and what `symgen` reads from it."""
    swing = max(_swings(campaign))
    e = replace(arm.experiment, swing=swing)
    if wish.recipe == "amplitude":
        e = replace(e, swing=_another(swing, bool(set(wish.effects) & set(SLOW))))
    if wish.recipe == "lines":
        e = replace(e, f0=e.f0 / DENSER, band=(e.band[0] / DENSER, max(TOP * e.fs, e.band[1])))
    name = "declared.urdf"
    remark = "The robot as declared for the campaign that was diagnosed, with the next experiment."
    drives = ("Drives as declared, identified where nothing was; torque limits and encoders as the records show them.",)
    replace_file(place / name, arm.urdf)
    replace_file(place / "robot.toml", robot_toml(replace(arm, experiment=e), remark, name, drives))
    return load_robot(place)


def _another(swing: float, slow: bool) -> float:
    """Another swing: smaller where friction is in question, or where a larger one were not much larger."""
    larger = min(LARGER * swing, SWING)
    return SMALLER * swing if slow or larger < WORTH * swing else larger


def _swings(campaign: Campaign) -> list[float]:
    """How far the excited joint swings in each record [rad]."""
    found = []
    for record in campaign.records:
        i = campaign.joints.index(record.excited)
        angle = record.theta[-record.samples_per_period :, i] / abs(campaign.N[i])
        found.append(float(np.abs(angle - angle.mean()).max()))
    return found


def _cells(wish: Wish, campaign: Campaign, model: Model, robot: Robot) -> list[tuple[str, Array]]:
    """(joint, posture) of every record wanted, at most `MOST`."""
    records, joints = campaign.records, campaign.joints
    excited = list(dict.fromkeys(record.excited for record in records))
    mine = excited if wish.joint is None else [wish.joint]
    own = {j: _different([r.posture for r in records if r.excited == j] or [r.posture for r in records]) for j in mine}
    if wish.recipe == "repeat":
        return [(record.excited, record.posture) for record in reversed(records[:MOST])]
    if wish.recipe == "postures":
        share = max(1, min(NEW, MOST // len(mine)))
        return [(joint, q) for joint in mine for q in _far(joint, campaign, model, robot, share)]
    here = [(joint, q) for joint in mine for q in own[joint][:SAME]]
    if wish.recipe == "others":
        around = [(joint, q) for q in _different([q for _, q in here]) for joint in joints]
        return around[:MOST]
    if wish.recipe == "shift":
        cells = []
        for joint, q in here:
            i = joints.index(joint)
            quarter = 2 * np.pi / (4.0 * abs(campaign.N[i]) * max(wish.order, 1.0))
            low, high = model.chain.limits[i]
            sign = 1.0 if q[i] + 3 * quarter <= high else -1.0
            for k in (1, 2, 3):
                moved = np.array(q, dtype=float)
                moved[i] = np.clip(q[i] + sign * k * quarter, low, high)
                cells.append((joint, moved))
        return cells[:MOST]
    return here[:MOST]


def _different(postures: Sequence[Array]) -> list[Array]:
    """Each posture once."""
    found: list[Array] = []
    for q in postures:
        if not any(np.allclose(q, other, atol=1e-6) for other in found):
            found.append(q)
    return found


def _far(joint: str, campaign: Campaign, model: Model, robot: Robot, count: int) -> list[Array]:
    """Postures the arm may hold, each as far as can be from those measured and from each other, in what acts on the joint: its
    inertia, gravity's stiffness, and the angles."""
    i = campaign.joints.index(joint)
    q = np.round(model.random_postures(CANDIDATES, np.random.default_rng(0)), 4)
    q = q[feasible_postures(model.chain, robot.urdf, robot.drives, robot.gravity)(q)]
    if not len(q):
        raise ExperimentError(f"{joint}: no posture among {CANDIDATES} that the arm may hold")
    measured = np.array([record.posture for record in campaign.records])
    everything = np.concatenate([measured, q])
    J = model.J_cad(everything)[:, i, i]
    K = (model.gravity_stiffness_rows(everything, robot.gravity) @ model.chain.parameters)[:, i, i]
    features = np.column_stack([
        J / J.std() if J.std() > 1e-9 * J.max() else 0 * J, K / K.std() if K.std() > 1e-9 * np.abs(K).max() + 1e-12 else 0 * K,
        np.cos(everything) / model.chain.n, np.sin(everything) / model.chain.n,
    ])  # fmt: skip
    nearest = np.full(len(everything), np.inf)
    for feature in features[: len(measured)]:
        nearest = np.minimum(nearest, np.linalg.norm(features - feature, axis=1))
    chosen = []
    for _ in range(min(count, len(q))):
        k = len(measured) + int(np.argmax(nearest[len(measured) :]))
        chosen.append(everything[k])
        nearest = np.minimum(nearest, np.linalg.norm(features - features[k], axis=1))
    return chosen


def _runnable(cells: Sequence[tuple[str, Array]], model: Model, robot: Robot, seed: int) -> tuple[Cell, ...]:
    """Those that the declared arm can hold and play. ExperimentError, the first reason, where none can."""
    kept, reason = [], None
    for joint, q in cells:
        try:
            design(model.chain, robot, [(joint, q)], seed=seed)
            kept.append(Cell(joint, np.array(q, dtype=float)))
        except ExperimentError as error:
            reason = reason or error
    if not kept:
        raise reason or ExperimentError("the next experiment has no record")
    return tuple(kept)


def _paragraph(wish: Wish, cells: Sequence[Cell], robot: Robot, campaign: Campaign) -> str:
    """What is to be played, and what for."""
    e = robot.experiment
    per_joint = {joint: sum(cell.joint == joint for cell in cells) for joint in dict.fromkeys(c.joint for c in cells)}
    what = ", ".join(f"{joint} at {count} posture{'s' * (count > 1)}" for joint, count in per_joint.items())
    seconds = len(cells) * e.periods / e.f0
    units = {"m" if drive.linear else "rad" for drive in robot.drives if drive.joint in per_joint}
    return (
        f"Next: excite {what}, swinging up to {e.swing:.2g} {' or '.join(sorted(units, reverse=True))} (before: {max(_swings(campaign)):.2g}), lines every {e.f0:g} Hz "
        f"from {e.band[0]:g} to {e.band[1]:g} Hz, {e.periods} periods: {len(cells)} records, {seconds:.0f} s. These are "
        f"{RECIPES[wish.recipe]}, {wish.because}."
    )


def _then(place: Path, seed: int, verdict: dict[str, Any], out: Path) -> str:
    """The commands that play it and diagnose its records with those that the `verdict` is on, in the same way."""
    given, made = verdict["input"], verdict["made_with"]
    files = [str(one["file"]) for one in (given, *given.get("more_files", ()))]
    new = "next.h5" if len(files) == 1 else f"next-{len(files)}.h5"
    diagnose = ["ident", "diagnose", *files, new, "-o", str(out)]
    if made.get("baseline"):
        diagnose += ["--baseline", made["baseline"]["file"]]
    if made.get("believe_zeros") is not None:
        diagnose += ["--believe-zeros" if made["believe_zeros"] else "--no-believe-zeros"]
    if made.get("minutes") is not None:
        diagnose += ["--minutes", f"{made['minutes']:g}"]
    simulate = ["ident", "simulate", str(place), "--plan", str(place / "plan.json"), "--seed", str(seed), "-o", new]
    return (
        f"On the robot: play {place / 'excitation'}, then {shlex.join(['ident', 'import', '--map', str(place / 'map.toml')])}. "
        f"Simulated: {shlex.join(simulate)}. Then: {shlex.join(diagnose)}."
    )
