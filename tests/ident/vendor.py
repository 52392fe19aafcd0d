"""Robot directories of arms by UR, Franka and UFACTORY: vendors' URDFs from example-robot-data, nothing of them copied into
the project, with drives of the size that harmonic drive catalogues list for such joints (J_m, K) and 17-bit encoders."""

from __future__ import annotations

from pathlib import Path

import pinocchio as pin

from symgen.robot import Robot, load_robot

_ROBOTS = Path(pin.__file__).parents[4] / "share/example-robot-data/robots"

#: URDF file, then per joint: gear ratio, rotor [kg m2], stiffness [N m/rad], spring damping [N m s/rad] (1 % of critical
#: at a middling J_ii), torque limit at the motor [N m].
_ARMS = {
    "ur5": (
        "ur_description/urdf/ur5_robot.urdf",
        3 * [(101, 1e-4, 20_000, 4.0, 2.0)] + 3 * [(101, 2e-5, 5_000, 0.3, 0.4)],
    ),
    "panda": (
        "panda_description/urdf/panda.urdf",
        4 * [(100, 6e-5, 14_250, 2.0, 1.2)] + 3 * [(100, 2e-5, 5_000, 0.15, 0.2)],
    ),
    "xarm7": (
        "xarm_description/urdf/xarm7.urdf",
        2 * [(100, 6e-5, 16_000, 2.5, 0.8)] + 3 * [(100, 4e-5, 10_000, 0.8, 0.5)] + 2 * [(100, 2e-5, 5_000, 0.1, 0.3)],
    ),
}
NAMES = tuple(_ARMS)

_JOINT = """
[joint.{name}]
N = {N}
J_m_kgm2 = {J_m}
K_Nm_per_rad = {K}
D_Nms_per_rad = {D}
D_spring_Nms_per_rad = {d}
encoder_counts_per_rev = 131072
torque_limit_Nm = {tau}
"""


def write_robot(name: str, directory: Path, **experiment: object) -> Robot:
    """Writes robot.toml of the named arm into `directory`, with keys of its [experiment] table, and returns the robot."""
    file, drives = _ARMS[name]
    model = pin.buildModelFromUrdf(str(_ROBOTS / file))
    # the fingers of Panda's hand do not belong to the arm
    joints = [joint for joint in model.names[1:] if "finger" not in joint]
    keys = {"band_Hz": [0.1, 120], "line_spacing_Hz": 0.1, "periods": 6, "torque_noise_rel": 0.005} | experiment
    text = f'[robot]\nurdf = "{_ROBOTS / file}"\n\n[experiment]\n'
    text += "".join(f"{key} = {value}\n" for key, value in keys.items())
    for joint, (N, J_m, K, d, tau) in zip(joints, drives, strict=True):
        text += _JOINT.format(name=joint, N=N, J_m=J_m, K=K, D=0.5 * J_m, d=d, tau=tau)
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "robot.toml").write_text(text)
    return load_robot(directory)
