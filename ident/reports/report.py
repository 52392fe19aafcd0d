"""The result of an identification for programs (result.json) and for the engineer who has to use it (report.html)."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.identification import verdict
from ident.identification.identify import OF_TWO_MASSES, UNSEEN_POSTURES, Identification, Measurement
from ident.joint.certainty import certainty
from ident.joint.fit import PARAMETERS, TwoMass
from ident.plain import plain, replace_file

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

#: Releases that decide digits and looks of a report.
SOFTWARE = ("symgen", "numpy", "scipy", "clarabel", "matplotlib")


def result_document(
    identification: Identification, precision: Mapping[str, float] | None = None, made: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Returns result.json: plain numbers, lists and strings; what is unknown or infinite is None, never NaN.

    Units kg m2 (kg for a sliding joint), N m/rad, N m s/rad, Hz; K joint side, J_m and D motor side. `precision` is what the
    campaign was planned for, where it was: `target` and `predicted`, sigmas of J(q) over sqrt(J_ii J_jj), and `robot_time_s`;
    told with the largest that was `achieved`. `made` of what and how: `input` and `made_with`.
    """
    r = identification
    drives = {drive.joint: drive for drive in r.drives}

    def shared(name: str) -> dict[str, list[float | None]]:
        own = [getattr(drives[joint], name) if joint in drives else None for joint in r.campaign.joints]
        return {key: [getattr(one, key) if one else None for one in own] for key in ("value", "std")}

    known = certainty(r.model, r.covariance, r.unseen)
    document: dict[str, Any] = {
        "robot": r.model.chain.name,
        "urdf_sha256": r.model.chain.sha256,
        "joints": r.campaign.joints,
        "alpha": {
            "names": r.model.names,
            "value": r.alpha_all,
            "std": r.alpha_std,
            "unit": r.model.units,
            "cad": r.model.alpha_cad,
        },
        "K": shared("K"),
        "J_m": shared("J_m"),
        "D": shared("D"),
        "D_spring": shared("D_spring"),
        "drives_agree": {drive.joint: drive.agrees for drive in r.drives},
        "chi2_per_dof": r.chi2_per_dof,
        "explained": r.explained,
        "problems": [asdict(problem) for problem in verdict.problems(r)],
        "not_identifiable": verdict.not_identifiable(r),
        "certainty": {
            "per_entry": known.per_entry,
            "thin_direction": dict(zip(r.model.names, known.direction, strict=True)),
            "share": known.share,
        },
        "physically_consistent": {
            "ok": r.consistency.ok,
            "distance": r.consistency.distance,
            "alpha": r.consistency.nearest,
        },
        "method": r.method,
        "inertia_vs_cad": _inertia_vs_cad(r),
        "validation": _validation(r),
        "records": {m.record.id: _record(m) for m in r.measurements},
        "notes": r.notes,
        "seconds": r.seconds,
        **(made or {}),
    }
    if precision is not None:
        document["precision"] = {**precision, "achieved": known.per_entry.max()}
    found: dict[str, Any] = plain(document)
    return found


@cache
def environment() -> Environment:
    """Returns where the pages are made: the templates of this directory and how they write numbers."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    folder = FileSystemLoader(Path(__file__).parent)
    found = Environment(loader=folder, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    found.filters |= {"number": verdict.number, "percent": _percent, "within": verdict.within, "constant": _constant}
    return found


def software() -> dict[str, str]:
    """Returns the releases that decide digits and looks of a report."""
    return {"Python": platform.python_version()} | {name: version(name) for name in SOFTWARE}


def html(identification: Identification, methods: Sequence[Mapping[str, Any]] = ()) -> str:
    """Returns the report as one HTML file that needs nothing else: offline, on paper, on a dark or narrow screen.

    `methods` are rows of `side_by_side.comparison`, this identification's first.
    """
    from markupsafe import Markup

    from ident.reports import figures

    r, n, document = identification, identification.campaign.n, result_document(identification)
    drives = {drive.joint: drive for drive in r.drives}
    joints = [
        {"name": name, "linear": joint.type == "prismatic", "drive": drives.get(name)}
        for name, joint in zip(r.campaign.joints, r.model.chain.joints, strict=True)
    ]
    rows: list[dict[str, Any]] = [
        {
            "m": m,
            "name": verdict.entry(m.index, m.index, n),
            "posture": _posture(m, r),
            "lines": m.record.lines * m.record.f0,
            "figure": Markup(figures.frf_figure(m, r.campaign)),
            "distortion": Markup(figures.distortion_figure(m) or ""),
            "seen": ", ".join(verdict.distorted(m)),
        }
        for m in r.measurements
    ]
    sweeps = [
        {"name": verdict.entry(i, i, n), "along": r.campaign.joints[j], "sigma": sigma, "figure": Markup(svg)}
        for i, j, sigma, svg in figures.sweep_figures(r)
    ]
    return (
        environment()
        .get_template("report.html.jinja")
        .render(
            r=r,
            document=document,
            joints=joints,
            rows=rows,
            sweeps=sweeps,
            facts=_facts(r, document),
            methods=methods,
            serious=any(problem["serious"] for problem in document["problems"]),
            suspects=list(dict.fromkeys(row["name"] for row in rows if not row["m"].explained)),
            bands=tuple(verdict.BANDS),
            entry_name=lambda i, j: verdict.entry(i, j, n),
            inf=np.inf,
            software=software(),
        )
    )


def write(
    identification: Identification, directory: str | Path, document: Mapping[str, Any] | None = None
) -> tuple[Path, Path]:
    """Writes result.json and report.html into `directory`, made where missing, and returns their paths.

    `document` is the result's where it tells more than the identification does, `methods` side by side among it. Each file is
    replaced only by a finished one. IdentError naming the file that can not be written.
    """
    directory = Path(directory)
    document = result_document(identification) if document is None else plain(document)
    text = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    result, report = directory / "result.json", directory / "report.html"
    page = html(identification, document.get("methods", ()))
    replace_file(result, text)
    replace_file(report, page)
    return result, report


def summary_plot(identification: Identification, path: str | Path) -> None:
    """Writes the responses of all records as one compact SVG file. IdentError if it can not be written."""
    from ident.reports import figures

    replace_file(Path(path), figures.summary_figure(identification))


def _record(m: Measurement) -> dict[str, Any]:
    fit, three = m.two_mass, m.three_point
    f_AR, f_R = m.pair
    return {
        "excited": m.record.excited,
        "posture": m.frf.posture,
        "J_l": m.J,
        "std": m.std,
        "J_cad": m.J_cad,
        "two_mass": fit and _two_mass(fit),
        "three_point": {name: getattr(three, name) for name in ("f_AR", "f_R", "J_m", "K", "J_l", "status")},
        "chi2_per_dof": m.chi2_per_dof,
        "explained": m.explained,
        "f_AR": f_AR,
        "f_R": f_R,
        "inertia_ratio": m.inertia_ratio,
        "band_ratio": f_AR / m.frf.frequencies[m.frf.usable][-1] if m.frf.usable.any() else None,
        "periods_used": m.frf.periods,
        "distortion": {name: verdict.distortion(m, *band) for name, band in verdict.BANDS.items()},
        "status": (*m.frf.status, *(fit.status if fit and m.method in OF_TWO_MASSES else ())),
    }


def _two_mass(fit: TwoMass) -> dict[str, Any]:
    return {name: getattr(fit, name) for name in PARAMETERS} | {
        "std": dict(zip(PARAMETERS, fit.std_inflated, strict=True)),
        "dof": fit.dof,
        "chi2_limit": fit.chi2_limit,
    }


def _inertia_vs_cad(r: Identification) -> dict[str, Any]:
    """J(q) against CAD at random postures: differences and sigma relative to the largest entry of CAD's J over them, or, as kg and kg m2
    do not compare, to the largest sqrt(J_ii J_jj) where a joint slides (`relative_to`).

    Entry by entry [n, n] and over all entries; `own_per_entry` relative to that entry's own largest value, None where
    it is zero; sigma is the largest over the postures, None where it needs a constant that was not measured.
    """
    q = r.model.random_postures(UNSEEN_POSTURES, np.random.default_rng(0))
    J_cad = r.model.J_cad(q)
    scale = np.abs(J_cad).max()
    own = np.abs(J_cad).max(axis=0)
    present = own > 1e-9 * scale
    sizes = np.sqrt(own.diagonal())
    mixed = any(map(r.model.chain.slides, range(r.campaign.n)))
    over = np.outer(sizes, sizes) if mixed else np.full_like(own, scale)
    off = np.abs(r.J(q) - J_cad) / over
    largest, rms = off.max(axis=0), np.sqrt(np.mean(off**2, axis=0))
    return {
        "postures": len(q),
        "seed": 0,
        "scale": scale,
        "relative_to": "sqrt(J_ii J_jj) at its largest" if mixed else "the largest entry",
        "largest": largest.max(),
        "rms": np.sqrt(np.mean(off**2)),
        "own_per_entry": np.where(present, largest * over / np.where(present, own, 1.0), np.nan),
        "largest_per_entry": largest,
        "rms_per_entry": rms,
        "sigma_per_entry": r.J_std(q).max(axis=0) / over,
    }


def _facts(r: Identification, document: dict[str, Any]) -> list[dict[str, Any]]:
    """The result at a glance: label, value, note, and whether that is good (None: neither)."""
    fits = r.measurements
    explained, (fixed, shown) = sum(m.explained for m in fits), _determined(r)
    aside = len(r.alpha_all) - shown
    worst = max(fits, key=lambda m: m.chi2_per_dof / m.chi2_limit)
    per_entry = np.array(document["certainty"]["per_entry"], dtype=float)
    known, blind = np.isfinite(per_entry), not np.isfinite(per_entry).all()
    uncertain = float(per_entry[known].max(initial=0.0))
    close = f"{', where seen' if blind else ''}{'' if r.explained else ', were the model right'}"
    close += f"; {aside} more, which no Jᵢᵢ shows, are CAD’s" if aside else ""
    checks = [abs(check["sigmas"]) for check in document["validation"].values()]
    against, number = document["inertia_vs_cad"], verdict.number
    own = np.array(against["own_per_entry"], dtype=float)
    i, j = (int(k) for k in np.unravel_index(np.nanargmax(own), own.shape))
    largest = f"{verdict.entry(i, j, r.campaign.n)} by {number(100 * own[i, j], 2)} % of its own size"
    checked = f"{len(checks)} of {len(fits)} checked by others"
    agree = r.alpha.agrees and all(drive.agrees for drive in r.drives)
    misfit = (worst.chi2_per_dof, worst.chi2_limit) if r.coupled is None else (r.chi2_per_dof, r.coupled.chi2_limit)
    which = "largest " if r.coupled is None else "all motors: "
    possible = r.consistency.ok
    rows = [
        ("records explained", f"{explained} of {len(fits)}", explained == len(fits),
         f"{which}χ²/dof {number(misfit[0], 3)}, noise allows {number(misfit[1], 3)}"),
        ("constants determined", f"{fixed} of {shown}", _good(fixed == shown, r.explained),
         f"J(q) to {number(100 * uncertain, 2)} % of √(Jᵢᵢ Jⱼⱼ), one σ{close}"),
        ("measurements agree", "yes" if agree else "no", agree,
         checked + (f", worst by {number(max(checks), 2)} σ" if checks else "")),
        ("rigid bodies with these constants", "exist" if possible else "do not exist", _good(possible, r.explained),
         "" if possible else f"nearest ones {number(r.consistency.distance, 2)} σ away"),
        ("largest difference from CAD", f"{number(100 * against['largest'], 2)} %", None,
         f"relative to {against['relative_to'].replace('sqrt(J_ii J_jj)', '√(Jᵢᵢ Jⱼⱼ)')}; {largest}"),
    ]  # fmt: skip
    if r.coupled is not None:  # one fit: nothing is left to agree or not
        rows = [row for row in rows if row[0] != "measurements agree"]
    return [dict(zip(("label", "value", "ok", "note"), row, strict=True)) for row in rows]


def _determined(r: Identification) -> tuple[int, int]:
    """How many constants the records fix, and how many they might: all, or read one by one those that J_ii shows."""
    shown = r.model.d if r.coupled is None else len(r.alpha_all)
    return int(np.isfinite(r.alpha_std[:shown]).sum()), shown


def _good(ok: bool, matters: bool) -> bool | None:
    """Whether something is good; neither where it is, but does not matter."""
    return ok if matters or not ok else None


def _validation(r: Identification) -> dict[str, Any]:
    """Each record that others check: its J_ii minus what the others predict for it."""
    a = r.alpha
    return {
        m.record.id: {"absolute": a.left_out[k], "relative": a.left_out[k] / m.J, "sigmas": a.standardised[k]}
        for k, m in enumerate(r.measurements)
        if a.redundancy[k] > 0
    }


def _posture(m: Measurement, r: Identification) -> str:
    """The posture as one reads it: degrees, metres (and said so) for a sliding joint."""
    parts = [
        f"{q:.4g} m" if joint.type == "prismatic" else f"{round(np.degrees(q), 1) + 0.0:g}"
        for q, joint in zip(m.frf.posture, r.model.chain.joints, strict=True)
    ]
    return ", ".join(parts).replace("-", "−")


def _percent(value: float | None, reference: float | None) -> str:
    """How far the value is from the reference, in percent of the reference with its sign."""
    if value is None or reference is None or not np.isfinite(reference) or reference == 0.0:
        return "–"
    off = 100.0 * (value - reference) / abs(reference)
    digits = 3 if abs(off) < 10.0 else 1
    return f"{round(off, digits) + 0.0:+.{digits}f}".replace("-", "−")


def _constant(name: str) -> Markup:
    """A constant's name as one writes it: alpha_21 as alpha with index, alpha_1x2_1 with index 1×2,1."""
    from markupsafe import Markup

    head, _, index = name.partition("_")
    index = index.replace("_", ",").replace("x", "×")
    return Markup("<i>{}</i><sub>{}</sub>").format("α" if head == "alpha" else head, index)
