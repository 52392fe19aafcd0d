"""robot.toml of an identified arm, the text that `symgen.robot` reads back."""

from __future__ import annotations

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


def robot_toml(
    arm: Identified, remark: str, urdf: str = "identified.urdf", drives: tuple[str, ...] = IDENTIFIED
) -> str:
    """Returns robot.toml with the drives of `arm`, for `symgen.robot.load_robot`; its URDF is the file `urdf`.

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
    for drive, note in zip(arm.drives, arm.notes, strict=True):
        lines += ["", *([f"# {one_line(note)}"] if note else []), *_drive_lines(drive)]
    return "\n".join(lines) + "\n"


def _drive_lines(drive: Drive) -> list[str]:
    per = ("N_rad_per_m", "K_N_per_m", "D_spring_Ns_per_m")
    N, K, D_spring = per if drive.linear else ("N", "K_Nm_per_rad", "D_spring_Nms_per_rad")
    return [
        f"[joint.{key(drive.joint)}]",
        f"{N} = {_number(drive.N)}",
        f"J_m_kgm2 = {_number(drive.J_m)}",
        f"{K} = {_number(drive.K)}",
        f"D_Nms_per_rad = {_number(drive.D)}",
        f"{D_spring} = {_number(drive.D_spring)}",
        f"encoder_counts_per_rev = {drive.encoder_counts}",
        f"torque_limit_Nm = {_number(drive.tau_max)}",
    ]


def _number(value: float) -> str:
    return repr(float(value))


def one_line(text: str) -> str:
    """Returns the text on one line, without what can not stand in a comment."""
    return "".join(c if c.isprintable() else " " for c in " ".join(text.split()))
