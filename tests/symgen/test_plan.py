"""plan.json: the keys that were promised, cells that come back as written, one line for a file that is not a plan."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import arm
from chains import REPOSITORY, judge, own, postures

from symgen.errors import PlanError, RobotError, SymgenError
from symgen.plan import (
    Plan,
    chain_of_file,
    chain_of_robot,
    load_plan_cells,
    make_model,
    make_plan,
    model_of_urdf,
    reflected_inertia,
)
from symgen.robot import load_robot
from symgen.urdf import parse_chain

#: Rounding of some hundred additions times the condition of W.
ROUNDING = 1e-11


@pytest.fixture(scope="module")
def paper() -> Plan:
    return make_plan(arm("ypp3"), believe_zeros=True)


def test_the_promised_keys(paper: Plan) -> None:
    document = paper.document
    assert set(document) >= {
        *("robot", "joints", "types", "rank_per_joint", "new_per_joint", "shared_rank", "monomials_per_joint"),
        *("full_inertia_rank", "unseen", "singular_value_gap", "snapped", "frozen", "plan"),
    }
    assert set(document["plan"]) >= {
        *("measurements", "spare", "amplification_per_joint", "d_efficiency_at_least", "cond_per_joint", "cells"),
    }
    assert all(set(cell) >= {"joint", "q"} for cell in document["plan"]["cells"])
    assert json.loads(json.dumps(document)) == document, "plain numbers, lists and words only"


def test_the_papers_plan_in_numbers(paper: Plan) -> None:
    document, plan = paper.document, paper.document["plan"]
    assert document["joints"] == ["joint1", "joint2", "joint3"] and document["types"] == ["revolute"] * 3
    assert (document["rank_per_joint"], document["new_per_joint"]) == ([4, 2, 1], [3, 2, 1])
    assert (document["shared_rank"], document["full_inertia_rank"], document["monomials_per_joint"]) == (
        6,
        6,
        [4, 2, 1],
    )
    assert document["unseen"] == [] and document["snapped"] == [] and len(document["believed_zeros"]) == 15
    assert document["alpha"]["names"] == ["alpha_31", "alpha_21", "alpha_22", "alpha_11", "alpha_12", "alpha_13"]
    assert document["alpha"]["cad"] == pytest.approx([0.0466, 0.09285, 0.5072, 0.0434, 0.4544, 0.0152], rel=1e-9)
    assert (plan["measurements"], plan["spare"], len(plan["cells"])) == (6, 2, 8)
    assert [cell["spare"] for cell in plan["cells"]] == [False] * 6 + [True] * 2
    assert max(plan["amplification_per_joint"]) <= 1.01 and plan["d_efficiency_at_least"] >= 0.99
    kept, dropped = document["singular_value_gap"]
    assert kept > 1e10 * dropped


def test_what_the_diagonal_can_not_see_is_stated_with_its_measurement() -> None:
    (unseen,) = make_plan(arm("ur5"), spare=0, effort="draft").document["unseen"]
    assert unseen["entry"] == "J_12" and unseen["measure"] == "cross response 1 -> 2"
    assert unseen["directions"] == unseen["postures"] == len(unseen["alpha"]) == 6


def test_snapped_angles_are_stated_with_their_cost() -> None:
    path = REPOSITORY / "robots/ypp3/ypp3.urdf"
    assert chain_of_file(path)[1] is None
    chain = arm("xarm7")
    assert chain.snapped, "xArm7 writes pi/2 as 1.5708"
    snapped = make_plan(chain, unsnapped=parse_chain(chain.source, snap=False), spare=0, effort="draft").document[
        "snapped"
    ]
    assert {row["to"] for row in snapped} <= {"pi/2", "-pi/2", "pi", "-pi"}
    assert 1e-8 < max(row["cost"] for row in snapped) < 1e-5


def test_what_snapping_a_flange_or_an_inertial_frame_costs_is_stated_too() -> None:
    """Pinocchio tells what all of them change together; joint3, which the flange places, changes as much by itself."""
    flange = '<link name="flange"/><joint name="to flange" type="fixed"><origin rpy="1.5708 0 0"/>'
    flange += '<parent link="link2"/><child link="flange"/></joint><joint name="joint3"'
    text = arm("ypp3").source.replace('<joint name="joint3"', flange)
    text = text.replace(
        '<parent link="link2"/>\n    <child link="link3"/>', '<parent link="flange"/><child link="link3"/>'
    )
    text = text.replace('<origin xyz="0 0.17 0"/>', '<origin xyz="0 0.17 0" rpy="1.5708 0 0"/>')
    chain, unsnapped = parse_chain(text), parse_chain(text, snap=False)
    q = postures(chain, 200)
    expected = np.abs(judge(chain, q) - judge(unsnapped, q)).max() / np.abs(judge(chain, q)).max()
    found = make_plan(chain, unsnapped=unsnapped, spare=0, effort="draft").document["snapped"]
    assert [row["joint"] for row in found] == ["link2 (inertial)", "to flange"]
    assert [row["cost"] for row in found] == pytest.approx([expected] * 2, rel=0.1)  # two digits


def test_the_time_of_each_stage_is_told() -> None:
    plan = make_plan(arm("ypp3"), believe_zeros=True, spare=0, effort="draft")
    assert list(plan.seconds) == ["derive", "rank", "plan"] and min(plan.seconds.values()) > 0


def test_a_plan_file_gives_its_cells_back(paper: Plan, tmp_path: Path) -> None:
    paper.write(tmp_path / "plan.json")
    cells = load_plan_cells(tmp_path / "plan.json", paper.model)
    assert [(cell.joint, cell.q.tolist(), cell.spare) for cell in cells] == [
        (cell["joint"], cell["q"], cell["spare"]) for cell in paper.document["plan"]["cells"]
    ]
    for written, kept in zip(cells, paper.cells, strict=True):
        # twelve digits of a whole multiple of 1e-4
        assert np.abs(written.q - kept.q).max() < 1e-11 and (written.joint, written.spare) == (kept.joint, kept.spare)


def broken(change: Callable[[dict[str, Any]], object]) -> Callable[[str], str]:
    def apply(text: str) -> str:
        document = json.loads(text)
        change(document)
        return json.dumps(document)

    return apply


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda text: text[: len(text) // 2], "not a plan file: JSONDecodeError"),
        (lambda text: "[]", "not a plan file"),
        (lambda text: "\x00", "not a plan file"),
        (broken(lambda d: d.update(format="gcode")), "format gcode 1; expected symgen-plan up to 1"),
        (broken(lambda d: d.update(version=2)), "format symgen-plan 2; expected symgen-plan up to 1"),
        (broken(lambda d: d.update(version="new")), "not a plan file"),
        (broken(lambda d: d.pop("urdf_sha256")), "not a plan file: KeyError 'urdf_sha256'"),
        (
            broken(lambda d: d.update(urdf_sha256="0" * 64)),
            "made for another URDF .sha256 000000000000.; run symgen again",
        ),
        (broken(lambda d: d["plan"].pop("cells")), "not a plan file: KeyError 'cells'"),
        (broken(lambda d: d["plan"]["cells"][2].update(q=["north", 0, 0])), "not a plan file"),
        (broken(lambda d: d["plan"]["cells"][2].update(q=[10**400, 0, 0])), "not a plan file: OverflowError"),
        (lambda text: "[" * 100_000, "not a plan file: RecursionError"),
        (broken(lambda d: d["plan"].update(cells=[{}])), "not a plan file"),
        (
            broken(lambda d: d["plan"]["cells"][1].update(joint="wrist")),
            "cell 2: joint 'wrist' .* expected one of joint1, ",
        ),
        (broken(lambda d: d["plan"]["cells"][7].update(q=[0.0, 1.0])), "cell 8: .* q of 2; .* at 3 finite numbers"),
        (broken(lambda d: d["plan"]["cells"][0].update(q=[0.0, float("nan"), 1.0])), "cell 1: .* at 3 finite numbers"),
        (
            broken(lambda d: d["plan"]["cells"][0].update(q=[0.0, 1e300, 1.0])),
            "cell 1: .* at 3 finite numbers up to 1e.06",
        ),
    ],
)
def test_a_file_that_is_no_plan_of_this_arm_is_refused_in_one_line(
    paper: Plan, tmp_path: Path, edit: Callable[[str], str], message: str
) -> None:
    path = tmp_path / "plan.json"
    paper.write(path)
    path.write_text(edit(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(PlanError, match=message) as caught:
        load_plan_cells(path, paper.model)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_a_plan_file_that_is_not_there(paper: Plan, tmp_path: Path) -> None:
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(PlanError, match="not a plan file"):
            load_plan_cells(path, paper.model)


# The model -----------------------------------------------------------------------------------------------------------


def test_the_model_of_a_campaigns_text_is_that_of_the_file() -> None:
    chain = arm("ypp3")
    model = model_of_urdf(chain.source, chain.names, believe_zeros=True)
    assert (model.d, model.names[0], model.units[0], model.alpha_joint[0]) == (6, "alpha_31", "kg m2", 2)
    assert model.wider.d == 9
    q = postures(chain, 20)
    expected = judge(chain, q)
    largest = np.abs(expected).max()
    assert np.abs(model.J(q, model.alpha_cad) - expected).max() <= ROUNDING * largest
    assert np.abs(model.J_cad(q) - expected).max() <= ROUNDING * largest
    assert np.abs(model.C_rows(q) @ model.alpha_cad[:6] - np.einsum("mii->mi", expected)).max() <= ROUNDING * largest
    drawn = model.random_postures(1000, np.random.default_rng(0))
    assert (drawn >= chain.limits[:, 0]).all() and (drawn <= chain.limits[:, 1]).all()
    assert drawn.std(axis=0) == pytest.approx((chain.limits[:, 1] - chain.limits[:, 0]) / np.sqrt(12), rel=0.1)


def test_joints_that_are_not_driven_are_frozen() -> None:
    chain = arm("ypp3")
    model = model_of_urdf(chain.source, ("joint2", "joint3"))
    assert model.chain.names == ("joint2", "joint3") and model.chain.frozen == {"joint1": 0.0}
    q = postures(model.chain, 10)
    whole = judge(chain, np.column_stack([np.zeros(10), q]))[:, 1:, 1:]
    assert np.abs(model.J_cad(q) - whole).max() <= ROUNDING * np.abs(whole).max()


@pytest.mark.parametrize("joints", [("joint3", "joint2", "joint1"), ("joint1", "joint2", "wrist"), ()])
def test_joints_that_are_no_run_of_the_arm_are_refused(joints: tuple[str, ...]) -> None:
    with pytest.raises(SymgenError, match="joint") as caught:
        model_of_urdf(arm("ypp3").source, joints)
    assert "\n" not in str(caught.value)


def test_a_model_believes_zeros_only_where_asked() -> None:
    assert make_model(own("ypp3_general")).d == 9
    assert make_model(arm("ypp3")).d == 9 and make_model(arm("ypp3"), believe_zeros=True).d == 6


# The robot directory -------------------------------------------------------------------------------------------------


def test_rotors_are_reflected_to_the_joint() -> None:
    robot = load_robot(REPOSITORY / "robots/scara4/robot.toml")
    chain = chain_of_robot(robot)
    expected = [robot.drive(name).N ** 2 * robot.drive(name).J_m for name in chain.names]
    assert reflected_inertia(chain, robot.drives) == pytest.approx(expected, rel=1e-15)
    assert reflected_inertia(chain, robot.drives[:1])[1:].tolist() == [0.0, 0.0, 0.0]


def test_rotors_change_what_is_worth_measuring() -> None:
    light, heavy = (make_plan(arm("ypp3"), rotor=np.full(3, r), spare=0) for r in (0.0, 5.0))
    q = [[cell["q"] for cell in plan.document["plan"]["cells"]] for plan in (light, heavy)]
    assert q[0] != q[1]


def test_a_drive_for_no_joint_of_the_arm_is_named(tmp_path: Path) -> None:
    source = (REPOSITORY / "robots/ypp3/robot.toml").read_text(encoding="utf-8")
    (tmp_path / "ypp3.urdf").write_text(arm("ypp3").source, encoding="utf-8")
    (tmp_path / "robot.toml").write_text(source.replace("[joint.joint2]", "[joint.joint9]"), encoding="utf-8")
    with pytest.raises(RobotError, match="joint2|joint9"):
        chain_of_robot(load_robot(tmp_path / "robot.toml"))
    (tmp_path / "robot.toml").write_text(
        source + source[source.index("[joint.joint2]") : source.index("[joint.joint3]")].replace("joint2", "joint9"),
        encoding="utf-8",
    )
    with pytest.raises(
        RobotError, match=r"\[joint.joint9\]: no such joint in the URDF; its moving joints are joint1, "
    ):
        chain_of_robot(load_robot(tmp_path / "robot.toml"))
