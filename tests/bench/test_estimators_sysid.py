"""The coupled fit beside `mujoco.sysid` (MuJoCo's own system identification): same arm, same records, ypp3 with springs that give."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from study import Case, case, error, fitted, markdown, planned, publish

from ident.simulator.plant import mjcf
from symgen.chain import Inertia
from symgen.kinematics import inertia_matrix
from symgen.plan import chain_of_robot
from symgen.robot import load_robot

HERE = Path(__file__).parent
ENVIRONMENT = HERE.parents[1] / ".venv-peers" / "mujoco-sysid"
PACKAGES = ("mujoco[sysid]==4.0.0",)
#: Seconds of each record from its start at rest that rollouts can follow: without feedback the arm falls after that.
ALONE = (0.5,)
#: With a spring and a damper between each motor and its measured angle they can follow all; those of so many seconds, held at [Hz].
GUIDED, HELD = (1.0, 4.0), 2.0
#: Seconds after which it is given up.
LIMIT = 600


@pytest.fixture(scope="module")
def python() -> Path:
    """The interpreter of an environment that has mujoco.sysid and what it needs."""
    found = Path(os.environ["SYSID_PYTHON"]) if "SYSID_PYTHON" in os.environ else ENVIRONMENT / "bin" / "python"
    if not found.exists():
        subprocess.run([sys.executable, "-m", "venv", str(ENVIRONMENT)], check=True, timeout=120)
        subprocess.run([str(found), "-m", "pip", "install", "-q", *PACKAGES], check=True, timeout=600)
    return found


def declared(studied: Case, guided: bool) -> str:
    """The declared elastic arm as MJCF, everything named; `guided`: motors follow angles and velocities that they are given, critically
    damped at `HELD`."""
    robot, chain = studied.robot, chain_of_robot(studied.robot)
    drives = [robot.drive(name) for name in chain.names]
    root = mjcf(chain, drives, robot.gravity, np.zeros(chain.n), range(chain.n), 1.0 / robot.experiment.fs, "RK4")
    sensor = ET.SubElement(root, "sensor")
    ET.SubElement(next(root.iter("option")), "flag", contact="disable")
    next(root.iter("compiler")).set("balanceinertia", "true")  # a step may leave what bodies can be
    for i, body in enumerate(root.iter("body")):
        body.set("name", f"link{i}")
        body.findall("joint")[1].set("name", f"spring{i}")
        ET.SubElement(sensor, "jointpos", joint=f"motor{i}", name=f"theta{i}")
    if guided:
        J = np.diag(inertia_matrix(chain, np.zeros((1, chain.n)))[0])
        for kind, gain, power in (("position", "kp", 2), ("velocity", "kv", 1)):
            for i, drive in enumerate(drives):
                by = power % 2 + 1.0  # w^2 J, 2 w J
                size = by * (drive.N**2 * drive.J_m + J[i]) * (2.0 * np.pi * HELD) ** power
                ET.SubElement(next(root.iter("actuator")), kind, {"joint": f"motor{i}", gain: f"{size:.9g}"})
    return ET.tostring(root, encoding="unicode")


def by_sysid(studied: Case, python: Path, horizon: float, guided: bool, place: Path) -> tuple[float, float]:
    """Largest error of J(q), infinite where it did not end within `LIMIT`, and seconds."""
    c = studied.campaign
    T = round(horizon * c.fs)
    theta = np.array([record.theta[:T] / c.N for record in c.records])
    posture = np.array([record.posture for record in c.records])
    rest = np.stack([theta[:, 0], posture - theta[:, 0]], axis=2).reshape(len(theta), -1)
    ctrl = np.array([record.tau[:T] for record in c.records])
    if guided:
        ctrl = np.concatenate([ctrl, theta, np.gradient(theta, 1.0 / c.fs, axis=1)], axis=2)
    np.savez(place / "records.npz", xml=declared(studied, guided), rest=rest, ctrl=ctrl, theta=theta)
    command = [
        str(python),
        str(HERE / "peers" / "mujoco_sysid.py"),
        str(place / "records.npz"),
        str(place / "out.json"),
    ]
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    try:
        subprocess.run(command, check=True, timeout=LIMIT, env=environment, capture_output=True)
    except subprocess.TimeoutExpired:
        return float("inf"), float(LIMIT)
    answer = json.loads((place / "out.json").read_text())
    joints = []
    for joint, link in zip(studied.truth.joints, answer["links"], strict=True):
        w, x, y, z = link["quat"]
        R = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip
        body = Inertia(link["mass"], np.array(link["com"]), R @ np.diag(link["moments"]) @ R.T)
        joints.append(replace(joint, inertia=body))
    q = studied.model.random_postures(1000, np.random.default_rng(5))
    found, true = inertia_matrix(replace(studied.truth, joints=tuple(joints)), q), inertia_matrix(studied.truth, q)
    size = np.sqrt(np.einsum("mii->mi", true))
    return float((np.abs(found - true) / size[:, :, None] / size[:, None, :]).max()), answer["seconds"]


@pytest.mark.bench
def test_ahead_of_mujoco_sysid_in_error_and_time(python: Path, tmp_path: Path) -> None:
    robot = load_robot(HERE.parents[1] / "robots" / "ypp3")
    e = replace(robot.experiment, f0=0.5, periods=6, band=(0.5, robot.experiment.band[1]))
    studied = case(replace(robot, experiment=e), planned(robot), seed=11, believe=True)
    begin = time.perf_counter()
    found = fitted(studied)
    own = (float(error(studied.model, studied.truth, found.alpha).max()), time.perf_counter() - begin)
    whole = len(studied.campaign.records[0].tau) / studied.campaign.fs
    rows, theirs = [["ident, coupled", f"{whole:g} s", f"{100 * own[0]:.3g} %", f"{own[1]:.1f}"]], []
    for guided, horizon in [*((False, seconds) for seconds in ALONE), *((True, seconds) for seconds in GUIDED)]:
        theirs.append(by_sysid(studied, python, horizon, guided, tmp_path))
        wrong, seconds = theirs[-1]
        told = [f"{100 * wrong:.3g} %", f"{seconds:.1f}"] if np.isfinite(wrong) else ["no end", f"> {seconds:g}"]
        rows.append([f"mujoco.sysid, {'guided' if guided else 'alone'}", f"{horizon:g} s", *told])
    off, cad = "CAD, as both start", float(error(studied.model, studied.truth, studied.model.alpha_cad).max())
    rows.append([off, "-", f"{100 * cad:.3g} %", "-"])
    text = (
        f"{len(studied.campaign.records)} records. mujoco.sysid 4.0 fits, by rollouts from rest in MuJoCo's RK4 at 1 ms, the same elastic "
        "arm: drives, dampings, and mass, lever arm and principal moments of the links. Rollouts alone run open loop and fall: they get the "
        f"start of each record only. Guided ones are held to the measured motor angles by springs and dampers of {HELD:g} Hz.\n\n"
    )
    publish(
        "Beside mujoco.sysid: ypp3",
        text + markdown(["estimator", "of each record", "J(q), worst entry", "fit [s]"], rows),
    )
    assert all(own[0] < other and own[1] < seconds for other, seconds in theirs)
