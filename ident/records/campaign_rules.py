"""The rules of the campaign file, format "frf-campaign", version 1: what is written and what was read keep the same ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from ident.errors import CampaignError, message, short
from ident.plain import storable
from ident.records.campaign import HOLDS, Array, Campaign, Record
from ident.records.log import STORABLE

#: Signals that a record may lack.
OPTIONAL = ("omega", "q_link")

_MOVING = ("revolute", "continuous", "prismatic")
_WHOLE = 1e-9  # relative: samples_per_period f0 = fs up to a few roundings
_LIMIT_SLACK = 1e-6  # rad: limits and postures are written with a few digits


def check_campaign(c: Campaign, where: str) -> None:
    """CampaignError naming `where`, group, field and rule, if the campaign breaks a rule of the format."""
    n = c.n
    limits = _urdf_limits(c.urdf, f"{where}: /: robot/urdf")
    for name in c.joints:
        if name not in limits:
            known = ", ".join(limits) or "none"
            raise CampaignError(f"{where}: /: robot/joint_names: the URDF has no moving joint {name!r}; it has {known}")
    rules = (
        ("robot/joint_names", c.joints, n > 0 and len(set(c.joints)) == n, "at least one, all different"),
        ("source", c.source, storable(c.source), STORABLE),
        ("hold", c.hold, c.hold in HOLDS, " or ".join(HOLDS)),
        ("fs_hz", c.fs, 0 < c.fs < np.inf, "a finite number > 0"),
        ("drive/gear_ratio", c.N, _finite(c.N, (n,)) and np.all(c.N != 0), "n finite numbers other than 0"),
        ("drive/motor_inertia", c.J_m, _positive_or_nan(c.J_m, n), "n finite numbers > 0, NaN where unknown"),
        ("drive/stiffness", c.K, _positive_or_nan(c.K, n), "n finite numbers > 0, NaN where unknown"),
        *(
            (f"drive/{name}", D, _not_negative_or_nan(D, n), "n finite numbers >= 0, NaN where unknown")
            for name, D in damping(c)
        ),
        ("drive/gravity", c.gravity, _finite(c.gravity, (3,)), "3 finite numbers"),
        ("experiments", len(c.records), len(c.records) > 0, "at least one record"),
    )
    _require(rules, f"{where}: /")
    ids = [record.id for record in c.records]
    for k, id in enumerate(ids):
        if not id or "/" in id or id == "." or not storable(id) or (k and id <= ids[k - 1]):
            raise CampaignError(
                f"{where}: /experiments: id {id!r}; expected names without '/', ascending in the order of recording"
            )
    for record in c.records:
        _check_record(record, c, limits, f"{where}: /experiments/{record.id}")


def _check_record(r: Record, c: Campaign, limits: Mapping[str, tuple[float, float]], where: str) -> None:
    n, samples = c.n, r.samples_per_period * r.f0
    _require(
        (
            ("excited", r.excited, r.excited in c.joints, f"one of {', '.join(c.joints)}"),
            ("posture", r.posture, _finite(r.posture, (n,)), f"{n} finite numbers"),
            ("f0_hz", r.f0, 0 < r.f0 < np.inf, "a finite number > 0"),
            ("periods", r.periods, r.periods >= 2, "at least 2, to tell noise from response"),
            ("samples_per_period", r.samples_per_period, r.samples_per_period >= 1, "at least 1"),
            (
                "samples_per_period",
                r.samples_per_period,
                abs(samples - c.fs) <= _WHOLE * c.fs,
                f"samples_per_period * f0_hz = fs_hz, which is {samples:.10g} against {c.fs:.10g}",
            ),
            ("rms", r.rms, 0 < r.rms < np.inf, "a finite number > 0"),
            ("lines", r.lines, r.lines.ndim == 1 and r.lines.size > 0, "a list of at least one harmonic"),
            ("lines", r.lines, bool(np.all(r.lines >= 1)), "harmonics >= 1"),
            ("lines", r.lines, len(np.unique(r.lines)) == r.lines.size, "harmonics that are all different"),
        ),
        where,
    )
    top = int(r.lines.max())
    if 2 * top >= r.samples_per_period:
        raise CampaignError(
            f"{where}: lines: line {top} is at {top * r.f0:g} Hz, expected none above fs/2 = {c.fs / 2:g} Hz nor at it"
        )
    for name, value in zip(c.joints, r.posture, strict=True):
        low, high = limits[name]
        if not low - _LIMIT_SLACK <= value <= high + _LIMIT_SLACK:
            raise CampaignError(
                f"{where}: posture: {name!r} = {value:g}, expected within its limits [{low:g}, {high:g}]"
            )
    shape = (r.periods * r.samples_per_period, n)
    for name in ("tau", "theta", *OPTIONAL):
        values = getattr(r, name)
        if values is None:
            continue
        if values.shape != shape:
            raise CampaignError(f"{where}: {name}: found shape {values.shape}, expected {shape}")
        if not np.all(np.isfinite(values)):
            k, j = np.argwhere(~np.isfinite(values))[0]
            raise CampaignError(
                f"{where}: {name}: sample {k} of joint {c.joints[j]!r} is {values[k, j]}, expected finite samples"
            )


def _require(rules: tuple[tuple[str, Any, Any, str], ...], where: str) -> None:
    for field, found, ok, expected in rules:
        if not ok:
            raise CampaignError(f"{where}: {field}: found {short(found)}, expected {expected}")


def _finite(values: Array, shape: tuple[int, ...]) -> bool:
    return values.shape == shape and bool(np.all(np.isfinite(values)))


def _positive_or_nan(values: Array, n: int) -> bool:
    return values.shape == (n,) and bool(np.all(np.isnan(values) | ((values > 0) & np.isfinite(values))))


def _not_negative_or_nan(values: Array, n: int) -> bool:
    return values.shape == (n,) and bool(np.all(np.isnan(values) | ((values >= 0) & np.isfinite(values))))


def damping(c: Campaign) -> tuple[tuple[str, Array], ...]:
    """Beyond the format: the declared damping, where there is any."""
    return (("damping", c.D), ("spring_damping", c.D_spring))


class _Plain(ET.TreeBuilder):
    """XML of a text that says it all: no document type declares anything beside it."""

    def doctype(self, *_: object) -> None:
        raise ValueError("found a document type declaration, expected plain URDF")


def _urdf_limits(urdf: str, where: str) -> dict[str, tuple[float, float]]:
    """(lower, upper) of every moving joint of a URDF, infinite where it states none."""
    try:
        root = ET.fromstring(urdf, ET.XMLParser(target=_Plain()))
        joints = [joint for joint in root.findall("joint") if joint.get("type") in _MOVING]
        return {joint.get("name", ""): _limits(joint) for joint in joints}
    except (ET.ParseError, ValueError) as error:
        raise CampaignError(f"{where}: not a readable URDF: {message(error)}") from None


def _limits(joint: ET.Element) -> tuple[float, float]:
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return -np.inf, np.inf
    return float(limit.get("lower", "0")), float(limit.get("upper", "0"))
