"""robot.toml of an identified arm, the text that `symgen.robot` reads back."""

from __future__ import annotations

from dataclasses import replace
from math import copysign
from typing import Any

from ident.identification.identified import Identified
from ident.toml_text import key, quoted
from symgen.robot import Drive

#: How the file begins, and by what it is known again.
HEAD = "# Identified from: "

#: What the drives of a robot.toml are worth, for a comment in it.
IDENTIFIED = (
    "K, J_m, D and D_spring are identified. Encoders, torque limits and the experiment are as declared; where only records",
    "were at hand, as these show them: an encoder without visible steps has 2^20, a motor without a limit the largest torque.",
)
#: The least and the largest size that `symgen.robot` takes of a drive's numbers.
_TAKEN = {
    "N": (1e-3, 1e6), "J_m": (1e-12, 1e3), "K": (1e-3, 1e12), "D": (0.0, 1e9), "D_spring": (0.0, 1e9),
    "encoder_counts": (1, 2**53 - 1), "tau_max": (1e-9, 1e6),
}  # fmt: skip


def robot_toml(
    arm: Identified, remark: str, urdf: str = "identified.urdf", drives: tuple[str, ...] = IDENTIFIED
) -> str:
    """Returns robot.toml with the drives of `arm`, for `symgen.robot.load_robot`; its URDF is the file `urdf`.

    A number of a drive that is beyond what robot.toml takes is the nearest that it does, which a comment says.
    `remark` is a comment on how the URDF's inertias relate to what was measured, `drives` one on the drives, line by line.
    """
    e = arm.experiment
    lines = [
        f"{HEAD}{one_line(arm.source)}.",
        f"# {one_line(remark)}",
        *(f"# {line}" for line in drives),
        "[robot]",
        f"urdf = {quoted(urdf)}",
        f"believe_zeros = {str(arm.believes_zeros).lower()}",
        f"gravity_m_per_s2 = [{', '.join(map(_number, arm.gravity))}]",
    ]
    lines += [
        f"{name} = {quoted(value)}" for name, value in (("base", arm.base), ("tip", arm.tip)) if value is not None
    ]
    if arm.at:
        lines.append(f"at = {{ {', '.join(f'{key(name)} = {_number(value)}' for name, value in arm.at.items())} }}")
    lines += [
        "",
        "[experiment]",
        f"sample_rate_Hz = {_number(e.fs)}",
        f"band_Hz = [{_number(e.band[0])}, {_number(e.band[1])}]",
        f"line_spacing_Hz = {_number(e.f0)}",
        f"periods = {e.periods}",
        f"swing_rad = {_number(e.swing)}",
        f"torque_noise_rel = {_number(e.torque_noise)}",
        f"lock_pd_Hz = {_number(e.lock_pd)}",
        f"lock_dob_Hz = {_number(e.lock_dob)}",
    ]
    for drive, note in map(_taken, arm.drives, arm.notes):
        lines += ["", *([f"# {one_line(note)}"] if note else []), *_drive_lines(drive)]
    return "\n".join(lines) + "\n"


def _taken(drive: Drive, note: str) -> tuple[Drive, str]:
    """The nearest drive that robot.toml takes, and the note with what is another number in it."""
    changed: dict[str, Any] = {}
    notes = [note] if note else []
    for name, (low, high) in _TAKEN.items():
        value = getattr(drive, name)
        near = copysign(min(max(abs(value), low), high), value) if name == "N" else min(max(value, low), high)
        if near != value:
            changed[name] = near
            notes.append(f"{name} is {value:.6g}; {near:.6g} is the nearest that robot.toml takes")
    return replace(drive, **changed), "; ".join(notes)


def _drive_lines(drive: Drive) -> list[str]:
    per = ("N_rad_per_m", "K_N_per_m", "D_spring_Ns_per_m")
    N, K, D_spring = per if drive.linear else ("N", "K_Nm_per_rad", "D_spring_Nms_per_rad")
    lines = [
        f"[joint.{key(drive.joint)}]",
        f"{N} = {_number(drive.N)}",
        f"J_m_kgm2 = {_number(drive.J_m)}",
        f"{K} = {_number(drive.K)}",
        f"D_Nms_per_rad = {_number(drive.D)}",
        f"{D_spring} = {_number(drive.D_spring)}",
        f"encoder_counts_per_rev = {drive.encoder_counts}",
        f"torque_limit_Nm = {_number(drive.tau_max)}",
    ]
    if drive.link_encoder_counts is not None:
        lines.append(f"link_encoder_counts_per_{'m' if drive.linear else 'rev'} = {drive.link_encoder_counts}")
    return lines


def _number(value: float) -> str:
    return repr(float(value))


def one_line(text: str) -> str:
    """Returns the text on one line, without what can not stand in a comment."""
    return "".join(c if c.isprintable() else " " for c in " ".join(text.split()))
