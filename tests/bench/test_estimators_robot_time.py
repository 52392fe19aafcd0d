"""Fewer postures and less robot time: Panda by a plan of columns (held joints read too), against one J_ii a record.

The paper's way: six periods of 10 s at each of the 37 cells that the diagonal needs.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from study import case, error, fitted, markdown, publish
from vendor import write_robot

from ident.joint.certainty import certainty
from symgen.plan import chain_of_robot, feasible_postures, make_plan, reflected_inertia
from symgen.robot import Robot

DIAGONAL_ONLY, PAPER = 37, 60.0  # cells, seconds a record
#: Line spacing [Hz] and periods of the records tried.
TRIED = ((0.5, 4), (0.2, 4), (0.1, 6))
TARGET = 0.01


def columns(robot: Robot) -> list[tuple[str, np.ndarray]]:
    chain = chain_of_robot(robot)
    feasible = feasible_postures(chain, robot.urdf, robot.drives, robot.gravity)
    plan = make_plan(chain, rotor=reflected_inertia(chain, robot.drives), feasible=feasible, columns=True)
    return [(cell["joint"], np.array(cell["q"])) for cell in plan.document["column_plan"]["cells"]]


@pytest.mark.bench
def test_half_the_postures_and_a_fifth_of_the_time(tmp_path: Path) -> None:
    robot = write_robot("panda", tmp_path / "panda")
    cells, rows, seconds, sigmas, worst = columns(robot), [], [], [], []
    for f0, periods in TRIED:
        e = replace(robot.experiment, f0=f0, periods=periods, band=(f0, robot.experiment.band[1]))
        studied = case(replace(robot, experiment=e), cells, seed=11)
        found = fitted(studied)
        off = error(studied.model, studied.truth, found.alpha)
        time = sum(len(record.tau) for record in studied.campaign.records) / studied.campaign.fs
        sigma = certainty(studied.model, found.covariance, found.unseen).per_entry.max()
        rows.append([f"{len(cells)} x {periods} periods of {1 / f0:g} s", f"{time:.0f} s", f"{DIAGONAL_ONLY * PAPER / time:.1f}",
                     f"{100 * sigma:.2g} %", f"{100 * off.max():.3g} %", f"{found.chi2_per_dof:.3g}"])  # fmt: skip
        seconds.append(time)
        sigmas.append(float(sigma))
        worst.append(float(off.max()))
        publish(
            "Robot time: Panda by columns",
            f"Diagonal only: {DIAGONAL_ONLY} records of {PAPER:g} s, {DIAGONAL_ONLY * PAPER:.0f} s.\n\n"
            + markdown(
                [
                    "records",
                    "robot time",
                    "times less than the paper's way",
                    "largest sigma",
                    "J(q), worst entry",
                    "chi2/dof",
                ],
                rows,
            ),
        )
    assert len(cells) <= DIAGONAL_ONLY / 2 and max(worst) <= TARGET
    assert any(
        sigma <= TARGET and time <= DIAGONAL_ONLY * PAPER / 5 for sigma, time in zip(sigmas, seconds, strict=True)
    )
