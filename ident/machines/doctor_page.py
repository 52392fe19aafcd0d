"""What the doctor found, on one page of text or as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ident.machines.doctor import Examination
from ident.machines.doctor_findings import JointCheck
from ident.plain import plain


def document(found: Examination) -> dict[str, Any]:
    """The examination as JSON: {"robot", "ready", "records", "minutes", "band_Hz", "joints": [..], "findings": [..]}.

    Keys of a joint are the fields of `JointCheck`, ranges as [least, largest]; those of a finding the fields of `Finding`.
    """
    return {
        "robot": found.robot.name,
        "ready": found.ready,
        "records": len(found.plan.cells),
        "minutes": found.seconds / 60,
        "band_Hz": list(found.robot.experiment.band),
        "joints": [plain(vars(check)) for check in found.joints],
        "findings": [vars(finding) for finding in found.findings],
    }


def page(found: Examination) -> str:
    """The examination as one page of text."""
    e, plan = found.robot.experiment, found.plan
    chain = plan.model.chain
    width = max(17, *(len(name) + 2 for name in chain.names))
    spare = sum(cell.spare for cell in plan.cells)
    records = f"{len(plan.cells)} records planned, {spare} of them spare, {found.seconds / 60:.3g} min"
    lines = f"{e.band[0]:g} to {e.band[1]:g} Hz, odd multiples of {e.f0:g} Hz"
    rows = [
        f"{found.robot.name}: {chain.n} joints, {chain.base_link} to {chain.tip_link}; {records}",
        f"{lines}, {e.periods} periods of {1 / e.f0:g} s at {e.fs:g} Hz",
        "",
        _row("workspace", width, _WORKSPACE, _SIZES),
        *(_workspace(check, width) for check in found.joints),
        "",
        _row("planned records", width, _PLANNED, _PLANNED_SIZES),
        *(_planned(check, width) for check in found.joints),
        _LEGEND,
        "",
    ]
    for finding in found.findings:
        mark = "!" if finding.serious else "-"
        remedy = f" Remedy: {finding.remedy}." if finding.remedy else ""
        rows.append(f"{mark} {finding.what}: {finding.why}.{remedy}")
    serious = sum(finding.serious for finding in found.findings)
    rows.append(
        "Ready for a campaign." if found.ready else f"NOT READY: {serious} problem{'s' * (serious > 1)}, marked !."
    )
    return "\n".join(rows)


_WORKSPACE = ("J_ii [kg m2]", "N^2 J_m", "J_ii / N^2 J_m", "f_AR [Hz]", "f_R [Hz]", "gravity", "sag [mrad]")
_PLANNED = (
    "number",
    "f_AR [Hz]",
    "f_R [Hz]",
    "swing [mrad]",
    "torque",
    "settles",
    "margin",
    "delay",
    "held",
    "visible",
)
_SIZES = (17, 16, 16, 14, 14, 10, 12)
_PLANNED_SIZES = (8, 15, 15, 14, 9, 10, 9, 9, 9, 10)
_LEGEND = (
    "settles: periods, of those recorded; margin: least |1 + L|; delay: samples that every loop bears; held: motion of held motors "
    "over the excited one's; visible: motion at the highest line over encoder noise"
)


def _row(name: str, width: int, cells: Sequence[str], sizes: Sequence[int]) -> str:
    return f"{name:<{width}}" + "".join(f"{cell:>{size}}" for cell, size in zip(cells, sizes, strict=True))


def _workspace(check: JointCheck, width: int) -> str:
    mass, far = (" kg", " mm") if check.linear else ("", "")
    cells = (
        _span(check.J) + mass, f"{check.rotor:.3g}{mass}", _span(check.ratio), _span(check.f_AR), _span(check.f_R),
        f"{check.gravity:.0%}", f"{1e3 * check.sag:.2g}{far}",
    )  # fmt: skip
    return _row(check.joint, width, cells, _SIZES)


def _planned(check: JointCheck, width: int) -> str:
    def figure(value: float | None, kind: str, scale: float = 1.0, unit: str = "") -> str:
        return "-" if value is None else format(scale * value, kind) + unit

    settles = "-" if check.settling is None else f"{check.settling} of {check.periods}"
    cells = (
        str(check.records), _span(check.planned_f_AR), _span(check.planned_f_R),
        figure(check.swing, ".3g", 1e3, " mm" if check.linear else ""), figure(check.torque, ".0%"), settles,
        figure(check.margin, ".2f"), figure(check.delay, ".2g"), figure(check.held, ".2g"), figure(check.visible, ".3g"),
    )  # fmt: skip
    return _row(check.joint, width, cells, _PLANNED_SIZES)


def _span(values: tuple[float, float] | None) -> str:
    if values is None:
        return "-"
    low, high = (f"{value:.3g}" for value in values)
    return low if low == high else f"{low} .. {high}"
