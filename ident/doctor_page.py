"""What the doctor found, on one page of text or as JSON."""

from __future__ import annotations

from typing import Any

from ident.doctor import Examination, JointCheck


def document(found: Examination) -> dict[str, Any]:
    """The examination as JSON: {"robot", "ready", "records", "minutes", "band_Hz", "joints": [..], "findings": [..]}.

    Keys of a joint are the fields of `JointCheck`, ranges as [least, largest]; those of a finding the fields of `Finding`.
    """
    return {
        "robot": found.robot.name,
        "ready": found.ready,
        "records": len(found.plan.cells),
        "minutes": found.minutes,
        "band_Hz": list(found.robot.experiment.band),
        "joints": [vars(check) for check in found.joints],
        "findings": [vars(finding) for finding in found.findings],
    }


def page(found: Examination) -> str:
    """The examination as one page of text; SI units, with m, N and kg for slides."""
    e, plan = found.robot.experiment, found.plan
    chain = plan.model.chain
    width = max(17, *(len(name) + 2 for name in chain.names))
    spare = sum(cell.spare for cell in plan.cells)
    records = f"{len(plan.cells)} records planned, {spare} of them spare, {found.minutes:.3g} min"
    rows = [
        f"{found.robot.name}: {chain.n} joints, {chain.base_link} to {chain.tip_link}; {records}",
        f"{e.band[0]:g} to {e.band[1]:g} Hz, lines {e.f0:g} Hz apart, {e.periods} periods of {1 / e.f0:g} s at {e.fs:g} Hz",
        "",
        _cells("workspace", width, *_WORKSPACE),
        *(_workspace(check, width) for check in found.joints),
        "",
        _cells("planned records", width, *_PLANNED),
        *(_planned(check, width) for check in found.joints),
        "",
    ]
    for finding in found.findings:
        mark = "!" if finding.serious else "-"
        rows.append(f"{mark} {finding.what}: {finding.why}. Remedy: {finding.remedy or 'none known'}.")
    serious = sum(finding.serious for finding in found.findings)
    rows.append(
        "Ready for a campaign." if found.ready else f"NOT READY: {serious} problem{'s' * (serious > 1)}, marked !."
    )
    return "\n".join(rows)


_WORKSPACE = ("J_ii [kg m2]", "N^2 J_m", "J_ii / N^2 J_m", "f_AR [Hz]", "f_R [Hz]", "gravity", "sag [mrad]")
_PLANNED = ("number", "f_AR [Hz]", "f_R [Hz]", "swing [mrad]", "torque", "lock [s]", "angle/encoder")


def _cells(name: str, width: int, *cells: str) -> str:
    return f"{name:<{width}}{cells[0]:>17}" + "".join(
        f"{cell:>{size}}" for cell, size in zip(cells[1:], (16, 16, 14, 14, 10, 14), strict=True)
    )


def _workspace(check: JointCheck, width: int) -> str:
    return _cells(
        check.joint, width, _span(check.J), f"{check.rotor:.3g}", _span(check.ratio), _span(check.f_AR), _span(check.f_R),
        f"{check.gravity:.0%}", f"{1e3 * check.sag:.2g}",
    )  # fmt: skip


def _planned(check: JointCheck, width: int) -> str:
    """`lock`: the time in which a transient under the lock falls by 1/e; `angle/encoder`: at the highest line, over noise."""
    none = (None, None, None, None)
    figures = (check.swing, check.torque, check.settling, check.visible) if check.visible is not None else none
    swing, torque, settling, visible = figures
    return _cells(
        check.joint, width, str(check.records), _span(check.planned_f_AR), _span(check.planned_f_R),
        "-" if swing is None else f"{1e3 * swing:.3g}", "-" if torque is None else f"{torque:.0%}",
        "-" if settling is None else f"{settling:.2g}", "-" if visible is None else f"{visible:.3g}",
    )  # fmt: skip


def _span(values: tuple[float, float] | None) -> str:
    if values is None:
        return "-"
    low, high = (f"{value:.3g}" for value in values)
    return low if low == high else f"{low} .. {high}"
