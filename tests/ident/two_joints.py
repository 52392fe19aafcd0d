"""A robot of two joints with plain links, whose drives are said: a yaw joint that rests at 0 and a pitch joint behind it."""

from __future__ import annotations

from pathlib import Path

from symgen.robot import Robot, load_robot

_LIMIT = '<limit lower="-2" upper="2" effort="100" velocity="3"/>'
_DRIVE = {
    "N": 100.0, "J_m_kgm2": 1e-5, "K_Nm_per_rad": 2000.0, "D_Nms_per_rad": 1e-5, "D_spring_Nms_per_rad": 0.3,
    "encoder_counts_per_rev": 131072, "torque_limit_Nm": 2.0,
}  # fmt: skip


def two_joints(folder: Path, experiment: str, *drives: dict[str, float]) -> Robot:
    """The robot, its files in `folder`; `experiment` of robot.toml, and what of `drives`, one a joint, is other than usual."""
    bodies = "".join(
        f'<joint name="j{k}" type="revolute"><origin xyz="{xyz}"/><parent link="l{k - 1}"/><child link="l{k}"/>'
        f'<axis xyz="{axis}"/>{_LIMIT}</joint><link name="l{k}"><inertial><origin xyz="0.1 0.02 0.05"/><mass value="2"/>'
        '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial></link>'
        for k, (axis, xyz) in enumerate((("0 0 1", "0 0 0.3"), ("0 1 0", "0.3 0 0.1")), start=1)
    )
    (folder / "r.urdf").write_text(f'<robot name="r"><link name="l0"/>{bodies}</robot>')
    text = f'[robot]\nurdf = "r.urdf"\ngravity_m_per_s2 = [0, 0, -9.81]\n[experiment]\n{experiment}\n'
    for k, other in enumerate(drives, start=1):
        text += f"[joint.j{k}]\n" + "".join(f"{key} = {value}\n" for key, value in {**_DRIVE, **other}.items())
    (folder / "robot.toml").write_text(text)
    return load_robot(folder)
