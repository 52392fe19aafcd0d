"""What the studies of the estimators share: true arms that are not the declared ones, and what counts as an error."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ident.arm.coupled import CoupledFit, fit_coupled
from ident.records.campaign import Campaign
from ident.records.frf import estimate
from ident.simulator.bench import simulate
from symgen.chain import Chain, Inertia
from symgen.kinematics import inertia_matrix
from symgen.plan import Model, chain_of_robot, make_model, plan_of_robot
from symgen.robot import Drive, Robot

#: CAD is off by this much per link (mass, lever arm and inertia each on their own), drives by up to the other.
CAD_OFF, DRIVES_OFF = (0.05, 0.30), 0.10
UNSEEN_POSTURES = 1000

RESULTS = Path(__file__).parent / "RESULTS-ident.md"
HEAD = """# ident on robots that are not as declared

Written by `pytest -m bench tests/bench/test_estimators_*.py`, a study a section. Simulated robots unless said otherwise: 17-bit
encoders, torque noise 0.5 % of the excitation, gravity on, other joints held by PD and disturbance observer on their motors, springs
as they are. CAD is off by 5-30 % per link (mass, lever arm, inertia each on their own), K and J_m by up to 10 %, dampings by up to
a factor 2. Errors are |J_ij(q) - truth| / sqrt(J_ii J_jj), the largest over 1000 postures nobody has seen.
"""


def off(rng: np.random.Generator) -> float:
    """A factor 5 to 30 % off 1, upwards or downwards."""
    return float(1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(*CAD_OFF))


def true_chain(chain: Chain, rng: np.random.Generator) -> Chain:
    """The arm as it is, CAD being off; zeros stay zeros."""
    joints = []
    for joint in chain.joints:
        body = joint.inertia
        made = Inertia(body.mass * off(rng), body.com * off(rng), body.I * off(rng))
        joints.append(replace(joint, inertia=made))
    return replace(chain, joints=tuple(joints))


def true_drives(chain: Chain, robot: Robot, rng: np.random.Generator) -> list[Drive]:
    """The drives as they are, the datasheet being off by up to 10 %; damping is anybody's guess: up to a factor 2."""
    drives = []
    for name in chain.names:
        drive = robot.drive(name)
        K, J_m = 1.0 + DRIVES_OFF * rng.uniform(-1.0, 1.0, 2)
        D, D_spring = 2.0 ** rng.uniform(-1.0, 1.0, 2)
        drives.append(
            replace(drive, K=drive.K * K, J_m=drive.J_m * J_m, D=drive.D * D, D_spring=drive.D_spring * D_spring)
        )
    return drives


@dataclass(frozen=True)
class Case:
    """A declared robot, the arm that it is, and the records of that arm."""

    robot: Robot
    model: Model
    truth: Chain
    drives: list[Drive]
    campaign: Campaign


def case(
    robot: Robot, cells: Sequence[tuple[str, np.ndarray]], seed: int, *, believe: bool = False, workers: int = 2, **options: object
) -> Case:  # fmt: skip
    """A campaign of `cells` on an arm that is not as declared; `options` go to the simulation."""
    rng = np.random.default_rng(seed)
    chain = chain_of_robot(robot)
    truth, drives = true_chain(chain, rng), true_drives(chain, robot, rng)
    records = simulate(chain, robot, cells, seed=seed, truth=truth, truth_drives=drives, workers=workers, **options)  # type: ignore[arg-type]
    return Case(robot, make_model(chain, believe_zeros=believe), truth, drives, records)


def error(model: Model, truth: Chain, alpha: np.ndarray, seed: int = 5) -> np.ndarray:
    """|J_ij - truth| / sqrt(J_ii J_jj) [m, n, n] at postures nobody has seen."""
    q = model.random_postures(UNSEEN_POSTURES, np.random.default_rng(seed))
    true = inertia_matrix(truth, q)
    size = np.sqrt(np.einsum("mii->mi", true))
    return np.asarray(np.abs(model.J(q, alpha) - true) / size[:, :, None] / size[:, None, :])


def planned(robot: Robot, *, spare: bool = True) -> list[tuple[str, np.ndarray]]:
    """The (joint, posture) cells of the robot's plan."""
    return [(cell.joint, np.array(cell.q)) for cell in plan_of_robot(robot).cells if spare or not cell.spare]


def fitted(case: Case, campaign: Campaign | None = None) -> CoupledFit:
    """The coupled fit of a case, or of other records of it."""
    data = campaign or case.campaign
    return fit_coupled(data, case.model, [estimate(record, data) for record in data.records])


def publish(title: str, text: str) -> None:
    """Prints a study's result and puts it into RESULTS-ident.md as the section of that title."""
    print(f"\n{title}\n{text}")
    known = RESULTS.read_text(encoding="utf-8") if RESULTS.exists() else HEAD
    head, *sections = known.split("\n## ")
    found = {section.split("\n", 1)[0]: section.split("\n", 1)[1].strip() for section in sections}
    found[title] = text.strip()
    body = "".join(f"\n## {name}\n\n{found[name]}\n" for name in sorted(found))
    beside = RESULTS.with_name(f".{RESULTS.name}.{os.getpid()}")
    beside.write_text(head.rstrip() + "\n" + body, encoding="utf-8")
    os.replace(beside, RESULTS)


def markdown(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)
