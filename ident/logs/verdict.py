"""What was found in a log, for programs: verdict.json and result.json. No NaN: what is unknown is null."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ident.effects.catalogue import CATALOGUE
from ident.logs.diagnose import LogDiagnosis, share
from ident.logs.equations import Part
from ident.logs.search import Step
from ident.logs.terms import Term
from ident.loop.confounded import separation
from ident.loop.diagnosis_json import FORMAT, POSTURES, SEED, VERSION
from ident.loop.effect_words import joined
from ident.plain import plain
from ident.records.inputs import told
from ident.records.log import Array

#: Bands of the residual end at these shares of the highest frequency that is kept.
ENDS = (0.1, 0.3, 1.0)
#: A band that leaves more than noise by this factor is told.
SHOWS = 1.5
#: Least share of all that is left beyond noise that is told.
LEAST_TOLD = 0.02
#: What no log tells from what, and what does.
_SIDES = (
    "multisine records (ident export-excitation, ident diagnose): above the anti-resonance motor and link move apart"
)
_CLOCKS = "multisine records up to some tens of Hz: a lag takes size and phase, a delay the phase alone"
_SCALE = "a known mass at the flange, or a torque sensor: no motion tells a torque that is off by a share from an inertia that is"
NEVER: Mapping[str, Mapping[str, str]] = {
    "motor-viscous": {"link-viscous": _SIDES},
    "motor-coulomb": {"link-coulomb": _SIDES},
    "input-delay": {"torque-lag": _CLOCKS, "time-offset": _CLOCKS},
    "time-offset": {"input-delay": _CLOCKS},
}
#: The same of a robot of one joint.
ALONE: Mapping[str, Mapping[str, str]] = {
    "inertial-parameters": {"motor-inertia": _SIDES, "torque-scale": _SCALE, "payload": "the same motion without it"}
}


def verdict_document(
    d: LogDiagnosis, files: Sequence[str | Path], made_with: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Returns verdict.json (format frf-verdict, version 1) of a log: plain numbers, lists and strings.

    Errors are relative rms of the joints' torques, of trajectories that report; units as in the catalogue of effects.
    """
    e = d.equations
    kinds = {"fit": e.fit, "select": e.select, "report": e.report}
    document: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "input": {**told(files), "records": len(d.log.trajectories), "kind": "log", "source": d.log.source},
        "status": d.status,
        "declared": _declared(d),
        "effects": [_effect(d, k) for k in range(len(d.found.steps))],
        "error": {
            "metric": "relative-rms",
            "split": {kind: [span.id for span in part.spans] for kind, part in kinds.items()}
            | {"spans_s": {kind: [span[:3] for span in part.spans] for kind, part in kinds.items()}, "note": e.note},
            "before": _errors(d, d.before.left(e.report)),
            "after": _errors(d, d.after.left(e.report)),
            "noise_floor": share(d.noise**2, e.report),
            "noise_per_joint": dict(zip(d.log.joints, _relative(d.noise, e.report), strict=True)),
        },
        "inertia": _inertia(d),
        "unexplained": _unexplained(d),
        "impossible": [text for _, text in d.impossible],
        "notes": _notes(d),
        "made_with": made_with or {},
    }
    found: dict[str, Any] = plain(document)
    return found


def result_document(d: LogDiagnosis, seconds: Mapping[str, float]) -> dict[str, Any]:
    """Returns result.json of the corrected arm, the keys that `ident fit` promises; a log tells no spring and no motor inertia."""
    alpha, covariance = d.alpha
    none = {"value": [None] * d.log.n, "std": [None] * d.log.n}
    document: dict[str, Any] = {
        "robot": d.model.chain.name,
        "urdf_sha256": d.model.chain.sha256,
        "joints": d.log.joints,
        "alpha": {
            "names": d.model.names, "value": alpha, "std": np.sqrt(np.diag(covariance)), "unit": d.model.units,
            "cad": d.model.alpha_cad, "in_files": d.links.alpha,
        },
        "K": none, "J_m": none, "D": none,
        "chi2_per_dof": (d.found.errors[-1] / share(d.noise**2, d.equations.report)) ** 2,
        "explained": d.status != "unexplained",
        "not_identifiable": [
            {"what": "springs, motor inertias", "why": "a log is read with rigid joints", "remedy": "multisine records: ident export-excitation"}
        ],
        "physically_consistent": {"ok": d.links.ok, "distance": d.links.distance},
        "method": "log",
        "records": {one.id: {"samples": len(one.q)} for one in d.log.trajectories},
        "seconds": seconds,
    }  # fmt: skip
    result: dict[str, Any] = plain(document)
    return result


def _declared(d: LogDiagnosis) -> dict[str, Any]:
    return {
        "robot": d.model.chain.name,
        "urdf_sha256": d.model.chain.sha256,
        "joints": d.log.joints,
        "model": [
            "rigid links in a chain, inertia from the URDF",
            "rigid joints without friction, motor inertia as declared",
            "gravity, Coriolis and centrifugal torques",
        ],
        "free": {"total": 0},
        "motor_inertia": d.log.J_m,
        "gravity": d.log.gravity,
        "bands_hz": {"motion": d.bands.motion, "equations": d.bands.equations, "positions": d.bands.positions},
        "effects": [],
    }


def _relative(left: Array, part: Part) -> Array:
    """What is left [n, rms] of each joint's torque."""
    return np.asarray(left / np.sqrt(np.mean(part.tau**2, axis=0)))


def _errors(d: LogDiagnosis, left: Array) -> dict[str, Any]:
    part = d.equations.report
    of_joints = _relative(np.sqrt(np.mean(left**2, axis=0)), part)
    ours, theirs = spectrum(part, left), spectrum(part, part.tau)
    return {
        "all": share(np.mean(left**2, axis=0), part),
        "per_joint": dict(zip(d.log.joints, of_joints, strict=True)),
        "per_band": {
            f"{low:.2g}-{high:.2g} Hz": float(np.sqrt(np.sum(ours(low, high)) / max(np.sum(theirs(low, high)), 1e-300)))
            for low, high in bands(d)
        },
    }


def bands(d: LogDiagnosis) -> list[tuple[float, float]]:
    """The bands [Hz] of the errors."""
    ends = [0.0, *(end * d.bands.equations for end in ENDS)]
    return list(pairwise(ends))


def spectrum(part: Part, signals: Array) -> Any:
    """Returns the function that gives the power [n] of signals [S, n] of a part between two frequencies [Hz]."""
    rows, start = [], 0
    for span in part.spans:
        values, start = signals[start : start + span.samples], start + span.samples
        f = np.fft.rfftfreq(span.samples, (span.last - span.first) / max(span.samples - 1, 1))
        power = np.abs(np.fft.rfft(values, axis=0)) ** 2 / span.samples
        power[1:] *= 2.0
        rows.append((f, power))
    return lambda low, high: sum(power[(low <= f) & (f < high)].sum(axis=0) for f, power in rows)


def _effect(d: LogDiagnosis, k: int) -> dict[str, Any]:
    step, errors = d.found.steps[k], d.found.errors
    term = step.term
    entry: dict[str, Any] = {
        "name": term.name,
        "joint": _joint(d, term),
        "port": term.port,
        "declared": term.joint is None and term.name in CATALOGUE and CATALOGUE[term.name].declared,
        "parameters": _parameters(d, term),
        "before": errors[k],
        "after": errors[k + 1],
        "evidence": {
            "statistic": step.gain.power,
            "threshold": 0.0,
            "meaning": "fall of the logarithm of the residual power on what chose, summed over the joints",
            "certainty": step.gain.certainty,
            "records": {},
            "bands": {},
            "port_shares": [],
        },
        "rivals": [{"name": one.name, "joint": _joint(d, one), "after": after} for one, after in step.rivals],
        "confounded_with": _confounded(d, step),
    }
    if wrong := [text for one, text in d.impossible if one is term or (one is None and term.width)]:
        entry["impossible"] = joined(wrong)
    if term.variable:
        heights, _ = _found(d, term)
        entry["curve"] = {
            "variable": term.variable, "knots": term.knots, "heights": heights, "unit": term.parameters[0][1],
            "period": None, "period_unit": "m" if d.model.chain.slides(term.joint) else "rad",
        }  # fmt: skip
    return entry


def _found(d: LogDiagnosis, term: Term) -> tuple[Array, Array]:
    """The coefficients of a term of the corrected arm, and their covariance."""
    return next((x, covariance) for one, x, covariance in d.equations.of(d.after) if one is term)


def _parameters(d: LogDiagnosis, term: Term) -> dict[str, Any]:
    """The numbers of a term with their standard deviations; those that are chosen, not fitted, have none."""
    x, covariance = _found(d, term)
    if term.width:
        change = _inertia(d)["J"]["change_rms"]
        return {"change": {"value": float(np.sqrt(np.mean(np.square(change)))), "std": None, "unit": ""}}
    values = term.told(x)
    slope = np.stack(
        [(term.told(x + h) - values) / np.abs(h).max() for h in np.diag(1e-6 * np.sqrt(np.diag(covariance)) + 1e-300)],
        axis=1,
    )
    std = np.sqrt(np.diag(slope @ covariance @ slope.T))
    return {
        name: {"value": value, "std": None if one == 0.0 else one, "unit": unit}
        for (name, unit), value, one in zip(term.parameters, values, std, strict=True)
    }


def _joint(d: LogDiagnosis, term: Term) -> str | None:
    return None if term.joint is None else d.log.joints[term.joint]


def _confounded(d: LogDiagnosis, step: Step) -> list[dict[str, Any]]:
    """What this log does not tell from a term, and what no log does."""
    term, found = step.term, {}
    for name, text in {**NEVER.get(term.name, {}), **(ALONE.get(term.name, {}) if d.log.n == 1 else {})}.items():
        found[name, _joint(d, term)] = {"separate_by": text, "recipe": "campaign"}
    for other in step.tied:
        by = separation(term.name, other.name, other.joint == term.joint or None in (other.joint, term.joint))
        found.setdefault((other.name, _joint(d, other)), {"separate_by": by.separate_by, "recipe": by.recipe})
    have = {(one.term.name, _joint(d, one.term)) for one in d.found.steps}
    return [{"name": name, "joint": joint, **by} for (name, joint), by in found.items() if (name, joint) not in have]


def _inertia(d: LogDiagnosis) -> dict[str, Any]:
    """alpha before and after, and by how much J(q) was wrong at random postures, relative to CAD's sqrt(J_ii J_jj)."""
    q = d.model.random_postures(POSTURES, np.random.default_rng(SEED))
    cad, alpha = d.model.alpha_cad, d.alpha
    before, after = d.model.J_cad(q), d.model.J(q, alpha[0])
    diagonal = np.sqrt(np.einsum("pii->pi", before))
    off = np.abs(before - after) / (diagonal[:, :, None] * diagonal[:, None, :])
    std = np.sqrt(np.diag(alpha[1]))

    def named(values: Array, deviations: Array) -> dict[str, Any]:
        rows = zip(d.model.names, values, deviations, d.model.units, strict=True)
        return {name: {"value": value, "std": one or None, "unit": unit} for name, value, one, unit in rows}

    change = np.sqrt(np.mean(off**2, axis=0))
    return {
        "alpha_before": named(cad, np.zeros(len(cad))),
        "alpha_after": named(alpha[0], std),
        "alpha_cad": cad,
        "alpha_in_files": d.links.alpha,
        "J": {
            "postures": POSTURES, "seed": SEED, "change_rms": change, "change_largest": off.max(axis=0), "cad_rms": change,
            "relative_to": "sqrt(J_ii J_jj) of CAD",
        },
    }  # fmt: skip


def _unexplained(d: LogDiagnosis) -> list[dict[str, Any]]:
    """Where more is left than noise: joint and band, by shares of all that is left beyond it."""
    if d.status != "unexplained":
        return []
    part, noise = d.equations.report, d.noise
    left = spectrum(part, d.after.left(part))
    rows = []
    for low, high in bands(d):
        floor = noise**2 * (high - low) / d.bands.equations * len(part.tau)
        power = left(low, high)
        rows += [
            (float(power[j] - floor[j]), d.log.joints[j], [low, high])
            for j in range(d.log.n)
            if power[j] > SHOWS**2 * floor[j]
        ]
    whole = sum(power for power, _, _ in rows) or 1.0
    rows.sort(key=lambda row: -row[0])
    return [
        {"joint": joint, "port": None, "band_hz": band, "odd": None, "even": None, "share": power / whole}
        for power, joint, band in rows
        if power >= LEAST_TOLD * whole
    ]


def _notes(d: LogDiagnosis) -> list[str]:
    notes = [
        f"trajectories {a} and {b} are one motion: together they fit, choose or report" for a, b in d.equations.repeats
    ]
    if not d.links.exact:
        away = f"{d.links.distance:.3g} standard deviations away" if d.links.distance > 0.0 else "apart by rounding"
        notes.append(
            f"no rigid bodies have the J(q) found here: identified.urdf, J.casadi and J.c hold the nearest that some have ({away}), not the constants "
            "of this verdict and of result.json (alpha_in_files, in_files)"
        )
    elif not d.bodies:
        notes.append(
            "no rigid bodies have the links found here: identified.urdf holds the nearest that have their J(q), and J.casadi and J.c that J(q)"
        )
    return notes
