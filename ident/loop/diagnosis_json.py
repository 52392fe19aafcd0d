"""A diagnosis for programs: verdict.json, and the corrected arm in the words of result.json. No NaN: what is unknown is null."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ident.arm.arm_model import DRIVES
from ident.arm.coupled import degrees_of_freedom
from ident.arm.evidence import Evidence
from ident.arm.parts import degrees
from ident.effects.base import Effect, only_shares
from ident.effects.carried import of_declared_links
from ident.effects.catalogue import CATALOGUE
from ident.effects.learned import Unnamed
from ident.effects.response import Response
from ident.identification.links import nearest_links
from ident.joint.solve import inertia_std
from ident.loop.confounded import AGAIN, NEVER, Separation, never_told_apart, separation
from ident.loop.diagnose import Diagnosis
from ident.loop.held_out import carried
from ident.loop.link_encoders import remarks_on_links, told_by_links
from ident.loop.repeats import remarks_on
from ident.loop.scales import doubtful
from ident.loop.unexplained import unexplained
from ident.plain import plain, replace_file
from ident.records.campaign import Array, Campaign
from ident.records.inputs import told
from ident.records.left_out import left_out
from ident.records.resting import elsewhere, statuses
from ident.search.added import Added
from ident.search.changes import not_closer, told_of
from ident.search.choice import LEAST_SHARE
from ident.search.contradicted import Off
from ident.search.departures import Errors
from ident.search.deviations import SIGMAS
from ident.search.minima import LEAST_GAIN
from ident.search.refits import State
from ident.search.spread import spread
from symgen.plan import Model

FORMAT, VERSION = "frf-verdict", 1
#: The file of this name in a result's directory.
FILE = "verdict.json"
#: Postures at which J(q) before and after is compared, and their seed.
POSTURES, SEED = 1000, 0
#: Share of a constant in a direction that no record shows up to which it is known: rounding.
SHOWN = 1e-6
#: A rival that leaves at most this times the held-out error is not told apart by these records.
AS_GOOD = 1.02
#: A joint moves no other whose J_ij is below this part of sqrt(J_ii J_jj): zeros that were measured are not quite none.
DECOUPLED = 1e-3
#: Postures closer than this [rad, m] are the same one.
SAME_POSTURE = 0.02
#: An effect's port shares that are told.
SHARES_TOLD = 6


def verdict_document(
    d: Diagnosis, files: Sequence[str | Path], notes: Sequence[str] = (), made_with: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Returns verdict.json (format frf-verdict, version 1): plain numbers, lists and strings.

    `files` are where the records were read, first the campaign's own; `made_with` the options of the command. Units as in the catalogue of effects; errors are relative rms of the excited joint's
    angle at the excited lines of the records that report, but for bands without the few lines that are mostly noise.
    """
    records = d.campaign.records
    reported = told_of(d.split, d.end, d.split.report)
    kinds = {"fit": d.split.fit, "select": d.split.select, "report": reported}
    links = told_by_links(d)
    split = {kind: [records[one.index].id for one in those] for kind, those in kinds.items()} | {
        "note": _note(d, reported)
    }
    document: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "input": {**told(files), "records": len(records), "kind": "campaign", "source": d.campaign.source},
        "status": d.status,
        "declared": _declared(d),
        "effects": [_added(d, added) for added in d.added] + [_off(d, off) for off in d.off],
        "error": {
            "metric": "relative-rms",
            "split": split,
            "before": _errors(d.before),
            "after": _errors(d.after),
            "noise_floor": d.after.noise,
            "noise_per_joint": d.after.noise_per_joint,
            "noise_per_band": d.after.noise_per_band,
        },
        "link_encoders": links,
        "inertia": _inertia(d),
        "drives": _drives(d),
        "unexplained": unexplained(d),
        "notes": [
            *notes,
            *doubtful(d),
            *remarks_on(d.after.noise_per_joint),
            *remarks_on_links(links),
            *not_closer(d.split, d.end),
            *left_out(d.campaign, d.responses),
            *elsewhere(d.campaign, d.responses),
            *statuses(d.campaign.joints, d.responses),
        ],
        "made_with": made_with or {},
    }
    return dict(plain(document))


def _note(d: Diagnosis, reported: Sequence[Evidence]) -> str:
    """What there is to say of the three kinds of record."""
    out = [d.campaign.records[one.index].id for one in d.split.report if one not in reported]
    left_out = (
        f"{', '.join(out)} left out: no record that fits or chooses tells whether the arm had changed by then"
        if out
        else ""
    )
    return "; ".join(filter(None, [d.split.note, left_out]))


def result_document(d: Diagnosis, seconds: Mapping[str, float]) -> dict[str, Any]:
    """Returns result.json for the corrected arm, the keys that `ident fit` promises: units kg m2, N m/rad, N m s/rad; `seconds` are
    where the time went."""
    problem, found, model = d.end.problem, d.end.minimum, d.model
    p = problem.parameters(found.vector)
    covariance, unseen, _ = spread(d.split, d.end)
    data = max(problem.data, d.split.fit, key=degrees)  # chi^2 is as all of their lines would have it
    dof, limit = degrees_of_freedom(replace(problem, data=data), found)
    links = nearest_links(model, p.alpha, covariance, unseen)
    hidden = [model.names[int(np.argmax(np.abs(direction)))] for direction in unseen.T]
    document: dict[str, Any] = {
        "robot": model.chain.name,
        "urdf_sha256": model.chain.sha256,
        "joints": d.campaign.joints,
        "alpha": {
            "names": model.names,
            "value": p.alpha,
            "std": _deviations(covariance, unseen),
            "unit": model.units,
            "cad": model.alpha_cad,
        },
        **_drives(d),
        "effects": [
            {"name": e.name, "joint": _joint(d.campaign, e.joint), "port": e.port, "parameters": _parameters(d, e, ())}
            for e in d.end.effects
        ],
        "chi2_per_dof": found.chi2 / dof,
        "chi2_limit": limit,
        "explained": d.status != "unexplained" and found.chi2 <= limit * dof,
        "not_identifiable": [
            {"what": f"a direction of alpha, mostly {name}", "why": "no record shows it: its value means nothing",
             "remedy": "measure more postures: symgen plans them"} for name in hidden
        ],
        "physically_consistent": {"ok": links.ok, "distance": links.distance, "alpha": links.alpha},
        "method": "diagnosed",
        "records": {record.id: {"excited": record.excited, "posture": record.posture} for record in d.campaign.records},
        "seconds": seconds,
    }  # fmt: skip
    result: dict[str, Any] = plain(document)
    return result


def _drives(d: Diagnosis) -> dict[str, Any]:
    """K, J_m, D, D_spring of the corrected arm, with standard deviations."""
    p, n = d.end.problem.parameters(d.end.minimum.vector), d.campaign.n
    std = spread(d.split, d.end)[2]
    return {
        name: {"value": values, "std": std[block * n : (block + 1) * n] * values}
        for block, name in enumerate(DRIVES)
        for values in (getattr(p, name),)
    }


def write(document: dict[str, Any], path: str | Path) -> None:
    """Writes a document complete or not at all. IdentError naming the file that can not be written."""
    replace_file(Path(path), json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def _joint(campaign: Campaign, joint: int | None) -> str | None:
    return None if joint is None else campaign.joints[joint]


def _errors(errors: Errors) -> dict[str, Any]:
    return {"all": errors.all, "per_joint": errors.per_joint, "per_band": errors.per_band}


def _declared(d: Diagnosis) -> dict[str, Any]:
    """What the starting model contains, and which of its numbers the fit is free of."""
    c = d.campaign
    return {
        "robot": d.model.chain.name,
        "urdf_sha256": d.model.chain.sha256,
        "joints": c.joints,
        "model": [
            "rigid links in a chain, J(q) from the URDF",
            "every joint an elastic one: motor inertia, spring K, viscous friction of motor and spring",
            "gravity stiffness about each posture",
            "rigid-body terms of second order: Coriolis, centrifugal, and what J(q) and gravity change by",
            "locks that give: held motors move as their records say",
            "torques held between samples" if c.hold == "zoh" else "torques and angles band-limited",
        ],
        "free": {
            "K": c.n, "J_m": c.n, "D": c.n, "D_spring": c.n, "alpha": len(d.model.names),
            "gravity": d.end.problem.r, "total": d.start.problem.base,
        },
        "drives": {name: getattr(c, name) for name in DRIVES},
        "gravity": c.gravity,
        "believed_zeros": len(d.model.factoring.believed),
        "effects": [],
    }  # fmt: skip


def _parameters(d: Diagnosis, effect: Effect, std: Sequence[float]) -> dict[str, Any]:
    deviations = std or (float("nan"),) * len(effect.values)
    return {
        p.name: {
            "value": value,
            "std": None if p.whole or (p.declared and not deviation) else deviation,
            "unit": effect.unit_of(p, d.model.chain.slides),
        }
        for p, value, deviation in zip(effect.parameters, effect.values, deviations, strict=True)
        if not p.aside
    }


def _added(d: Diagnosis, added: Added) -> dict[str, Any]:
    e, c = added.effect, d.campaign
    by_record, by_band = carried(d, e)
    rivals = _distinct(((r.name, r.joint, error) for r, error in added.rivals), e)
    # what a rival left while other effects were missing tells nothing
    complete = d.status != "unexplained" and added is d.added[-1]
    as_good = [
        (name, joint)
        for name, joint, error in rivals
        if complete and error <= AS_GOOD * added.after and name != "unknown"
    ]
    others = {(one.effect.name, one.effect.joint) for one in d.added}
    tied = [pair for pair in [*((t.name, t.joint) for t in added.tied), *as_good] if pair not in others]
    entry: dict[str, Any] = {
        "name": e.name,
        "joint": _joint(c, e.joint),
        "port": e.port,
        "declared": False,
        "parameters": _parameters(d, e, added.std),
        "links_fitted": len(e.values) - len(of_declared_links(e).values),
        "before": added.before,
        "after": added.after,
        "evidence": {
            "statistic": added.gain,
            "threshold": max(LEAST_GAIN, LEAST_SHARE * added.excess),
            "meaning": f"fall of chi^2 on the {'lines' if d.split.note else 'records'} that chose",
            "excess": added.excess,
            "records": by_record,
            "bands": by_band,
            "port_shares": [
                {"port": port, "joint": c.joints[joint], "share": share}
                for port, joint, share in added.port_shares[:SHARES_TOLD]
            ],
        },
        "rivals": [{"name": name, "joint": _joint(c, joint), "after": error} for name, joint, error in rivals],
        "confounded_with": _confounded(d, e.name, e.joint, tied) + _of_place(d, e) + _of_response(d, e),
    }
    if isinstance(e, Unnamed):
        entry["curve"] = e.curve(d.model.chain.slides(e.joint))
    return entry


def _off(d: Diagnosis, off: Off) -> dict[str, Any]:
    """A declared number that is off, as an effect; its errors are those with it alone as declared and with it as found."""
    one, c = off.deviation, d.campaign
    values = {name: {"value": value, "std": std, "unit": unit} for name, value, std, unit in one.values}
    return {
        "name": one.name,
        "joint": _joint(c, one.joint),
        "port": CATALOGUE[one.name].port,
        "declared": True,
        "parameters": values,
        "before": off.before,
        "after": off.after,
        "evidence": {
            "statistic": one.sigmas,
            "threshold": SIGMAS,
            "meaning": "standard deviations between declared and fitted",
            "records": {},
            "bands": {},
            "port_shares": [],
        },
        "rivals": [],
        "confounded_with": _confounded(d, one.name, one.joint, one.tied),
    }


def _distinct(rivals: Iterable[tuple[str, int | None, float]], e: Effect) -> list[tuple[str, int | None, float]]:
    """Each rival once, with its best error; not the effect itself."""
    best: dict[tuple[str, int | None], float] = {}
    for name, joint, error in rivals:
        if (name, joint) != (e.name, e.joint):
            best[name, joint] = min(error, best.get((name, joint), np.inf))
    return [(name, joint, error) for (name, joint), error in best.items()]


def _confounded(
    d: Diagnosis, name: str, joint: int | None, tied: Iterable[tuple[str, int | None]]
) -> list[dict[str, Any]]:
    """What these records do not tell from an effect, and what no record of this kind ever does."""
    c = d.campaign
    never = never_told_apart(name, joint is None or _moves_no_other(d.model, joint), c.n == 1)
    found: dict[tuple[str, int | None], Separation] = {(other, joint): NEVER for other in never}
    for other, place in tied:
        if (other, place) != (name, joint):
            same = joint == place or None in (joint, place)  # what is of the whole arm is at every joint
            found.setdefault((other, place), separation(name, other, same))
    return [
        {"name": other, "joint": _joint(c, place), "separate_by": by.separate_by, "recipe": by.recipe}
        for (other, place), by in found.items()
    ]


def _of_place(d: Diagnosis, effect: Effect) -> list[dict[str, Any]]:
    """A curve of place, "unknown", where that may be what a change from one record to the next is: no posture is measured on both sides."""
    records, joint = d.campaign.records, _joint(d.campaign, effect.joint)
    shares = [effect.shares(k) for k in range(len(records))]
    again = (
        bool(np.all(np.abs(one.posture - other.posture) < SAME_POSTURE)) and shares[i] != shares[k]
        for i, one in enumerate(records)
        for k, other in enumerate(records[:i])
    )
    if not only_shares(effect) or any(again):
        return []
    return [_unknown(joint, "its place", AGAIN)]


def _of_response(d: Diagnosis, effect: Effect) -> list[dict[str, Any]]:
    """A frequency response, "unknown", of a joint that moves no other one: of its torque it is what it is of its angle."""
    if not isinstance(effect, Response) or effect.joint is None or not _moves_no_other(d.model, effect.joint):
        return []
    other = "the torque" if effect.port == "sensor" else "the measured angle"
    return [_unknown(_joint(d.campaign, effect.joint), other, NEVER)]


def _unknown(joint: str | None, of: str, by: Separation) -> dict[str, Any]:
    """What has no name, as what an effect is not told from; what it is a law `of`."""
    return {"name": "unknown", "joint": joint, "of": of, "separate_by": by.separate_by, "recipe": by.recipe}


def _moves_no_other(model: Model, joint: int) -> bool:
    """Whether J_ij of this joint is next to nothing beside sqrt(J_ii J_jj) for every other one, at random postures."""
    J = model.J_cad(model.random_postures(POSTURES, np.random.default_rng(SEED)))
    sizes = np.sqrt(np.einsum("pii->pi", J))
    coupled = np.abs(J[:, joint]) / (sizes * sizes[:, joint, None])
    return bool(np.delete(coupled, joint, axis=1).max(initial=0.0) < DECOUPLED)


def _inertia(d: Diagnosis) -> dict[str, Any]:
    """alpha before and after, and by how much J(q) was wrong at random postures, before and by CAD, relative to CAD's
    sqrt(J_ii J_jj); nothing for entries that need a constant no record shows."""
    q = d.model.random_postures(POSTURES, np.random.default_rng(SEED))
    before, after = (d.model.J(q, state.problem.parameters(state.minimum.vector).alpha) for state in (d.first, d.end))
    cad = d.model.J_cad(q)
    diagonal = np.sqrt(np.einsum("pii->pi", cad))
    size = diagonal[:, :, None] * diagonal[:, None, :]
    covariance, unseen, _ = spread(d.split, d.end)
    std = np.sqrt(np.mean((inertia_std(d.model.J_rows(q), covariance, unseen) / size) ** 2, axis=0))
    change, of_cad = (np.where(np.isfinite(std), np.abs(other - after) / size, np.nan) for other in (before, cad))
    return {
        "alpha_before": _alpha(d, d.first),
        "alpha_after": _alpha(d, d.end),
        "alpha_cad": d.model.alpha_cad,
        "J": {
            "postures": POSTURES,
            "seed": SEED,
            "change_rms": np.sqrt(np.mean(change**2, axis=0)),
            "change_largest": change.max(axis=0),
            "cad_rms": np.sqrt(np.mean(of_cad**2, axis=0)),
            "std_after": std,
            "relative_to": "sqrt(J_ii J_jj) of CAD",
        },
    }


def _alpha(d: Diagnosis, state: State) -> dict[str, Any]:
    """{name: value, std, unit}."""
    value = state.problem.parameters(state.minimum.vector).alpha
    covariance, unseen, _ = spread(d.split, state)
    std = _deviations(covariance, unseen)
    return {
        name: {"value": v, "std": s, "unit": unit}
        for name, v, s, unit in zip(d.model.names, value, std, d.model.units, strict=True)
    }


def _deviations(covariance: Array, unseen: Array) -> Array:
    """Standard deviations of alpha, none for a constant that no record shows."""
    shown = np.abs(unseen).max(axis=1, initial=0.0) <= SHOWN
    return np.where(shown, np.sqrt(np.diag(covariance)), np.nan)
