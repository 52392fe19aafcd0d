"""How far J(q) is off where nothing was measured, by each estimator, on arms that are not as declared."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from study import case, error, markdown, planned, publish
from vendor import write_robot

from ident.identification.identify import METHODS, identify
from symgen.kinematics import inertia_matrix
from symgen.robot import load_robot

ROBOTS = Path(__file__).parents[2] / "robots"
#: Largest error of any entry of J(q) that the coupled fit may make.
TARGETS = {"ypp3": 1e-3, "ypp3_general": 2e-3, "ur5": 5e-3, "panda": 5e-3}


@pytest.mark.bench
@pytest.mark.parametrize("name", TARGETS)
def test_error_of_J_where_nothing_was_measured(name: str, tmp_path: Path) -> None:
    own = (ROBOTS / name).is_dir()
    robot = load_robot(ROBOTS / name) if own else write_robot(name, tmp_path / name)
    cells = planned(robot, spare=own)
    studied = case(robot, cells, seed=11, believe=robot.believe_zeros)
    q = np.array([record.posture for record in studied.campaign.records])
    index = np.array([studied.campaign.joints.index(record.excited) for record in studied.campaign.records])
    true = inertia_matrix(studied.truth, q)[np.arange(len(q)), index, index]
    rows, worst = [], {}
    for method in METHODS:
        found = identify(studied.campaign, method=method, believe_zeros=robot.believe_zeros)
        off = error(found.model, studied.truth, found.alpha_all)
        own_off = np.array([m.J for m in found.measurements]) / true - 1
        worst[method] = float(off.max())
        distal = own_off[index == index.max()][0]
        rows.append([
            method, f"{100 * off.max():.3g} %", f"{100 * np.sqrt(np.mean(off**2)):.2g} %",
            f"{100 * np.median(np.abs(own_off)):.2g} %", f"{100 * distal:+.3g} %", f"{found.chi2_per_dof:.3g}",
            "-" if method == "three-point" else "yes" if found.explained else "no", f"{found.seconds['fit']:.1f}",
        ])  # fmt: skip
        if method == "coupled":
            entries = "; ".join(
                f"J_{i + 1}{j + 1} {100 * off[:, i, j].max():.2g}"
                for i in range(len(off[0]))
                for j in range(i, len(off[0]))
            )
            assert found.explained, found.notes
    head = [
        "method",
        "J(q), worst entry",
        "rms",
        "J_ii at the records, median",
        "most distal",
        "chi2/dof",
        "explained",
        "fit [s]",
    ]
    text = f"{len(cells)} records, target {100 * TARGETS[name]:g} %.\n\n" + markdown(head, rows)
    publish(f"Accuracy: {name}", text + f"\n\nCoupled, largest error of every entry [%]: {entries}.")
    assert worst["coupled"] <= TARGETS[name]
    assert worst["coupled"] < min(worst[method] for method in METHODS[1:])
