"""The drawing of a plan: the arm where Pinocchio has it, every cell once, small, the same each time, and well-formed."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from arms import arm, model_of
from chains import REPOSITORY, general_chain, own, postures

from symgen.chain import Chain, Inertia
from symgen.cli import main
from symgen.plan import Cell, make_model, make_plan
from symgen.plot import draw, is_drawing, stick

SVG = "{http://www.w3.org/2000/svg}"
YPP3 = REPOSITORY / "robots/ypp3/ypp3.urdf"


@cache
def drawn(name: str) -> tuple[str, list[Cell]]:
    plan = make_plan(arm(name), believe_zeros=name == "ypp3", effort="draft")
    return draw(plan.model, plan.cells, plan.document["plan"]["amplification_per_joint"]), list(plan.cells)


def ids(svg: str) -> list[str]:
    return [group.get("id", "") for group in ElementTree.fromstring(svg).iter(f"{SVG}g")]


def points(svg: str, name: str) -> np.ndarray:
    """The corners [m, 2] of the paths in a group, in points, y down."""
    (group,) = (g for g in ElementTree.fromstring(svg).iter(f"{SVG}g") if g.get("id") == name)
    words = " ".join(path.get("d", "") for path in group.iter(f"{SVG}path"))
    return np.array([float(word) for word in words.replace("M", " ").replace("L", " ").split()]).reshape(-1, 2)


@pytest.mark.parametrize("chain", [arm("panda"), own("scara4"), own("ypp3_general")], ids=lambda chain: chain.name)
def test_the_arm_stands_where_pinocchio_has_it(chain: Chain) -> None:
    model = model_of(chain)
    data = model.createData()
    for q in postures(chain, 5):
        pin.forwardKinematics(model, data, q)
        pin.computeJointJacobians(model, data, q)
        arm_drawn = stick(chain, q)
        assert arm_drawn.points.shape == (chain.n + 2, 3) and not arm_drawn.points[0].any()
        size = np.abs(arm_drawn.points).max()
        for k, joint in enumerate(chain.joints):
            assert np.abs(arm_drawn.points[k + 1] - data.oMi[k + 1].translation).max() < 1e-12 * size
            column = pin.getJointJacobian(model, data, k + 1, pin.LOCAL_WORLD_ALIGNED)[:, k]
            axis = column[3:] if joint.type == "revolute" else column[:3]
            assert np.abs(arm_drawn.axes[k] - axis).max() < 1e-12
        com = data.oMi[chain.n] * chain.joints[-1].inertia.com
        half_way = (arm_drawn.points[-1] + arm_drawn.points[-2]) / 2
        assert np.abs(half_way - com).max() < 1e-12 * size


@pytest.mark.parametrize("name", ["ypp3", "panda"])
def test_every_cell_is_drawn_once_and_the_spare_ones_are_marked(name: str) -> None:
    svg, cells = drawn(name)
    n = make_model(arm(name)).chain.n
    assert len(cells) == {"ypp3": 8, "panda": 47}[name]
    groups = ids(svg)
    for k, cell in enumerate(cells, start=1):
        assert groups.count(f"cell-{k}-spare") == cell.spare and groups.count(f"cell-{k}") == (not cell.spare)
        assert groups.count(f"arm-{k}") == groups.count(f"excited-{k}") == 1
    assert groups.count("rank-gap") == 1 and sum(g.startswith("amplification-") for g in groups) == n
    assert len(svg) < 1_000_000
    names = sorted(g for g in groups if g.startswith("pair-") and g.endswith("-0"))
    assert len(names) == (n - 1) * (n - 2) // 2


def test_what_is_on_the_page_is_the_arm_and_the_excited_joint() -> None:
    """The drawn polyline is an affine image of the arm, the same one in every frame up to a shift; the excited axis goes
    through its joint."""
    svg, cells = drawn("ypp3")
    chain = arm("ypp3")
    maps = []
    for k, cell in enumerate(cells, start=1):
        seen, there = points(svg, f"arm-{k}"), stick(chain, cell.q).points
        assert len(seen) == chain.n + 2
        joint = chain.names.index(cell.joint)
        # two decimals of a point
        assert np.abs(points(svg, f"excited-{k}").mean(axis=0) - seen[joint + 1]).max() < 0.02
        maps.append((there - there[0], seen - seen[0]))
    space, page = (np.concatenate(parts) for parts in zip(*maps, strict=True))
    affine = np.linalg.lstsq(space, page, rcond=None)[0]
    assert np.abs(space @ affine - page).max() < 0.05
    assert affine[2, 1] < 0 and abs(affine[2, 0]) < 0.1, "up is up"


def test_coverage_shows_only_cells_that_depend_on_the_joint() -> None:
    svg, cells = drawn("panda")
    tree = ElementTree.fromstring(svg)
    for k in range(7):
        for spare in (False, True):
            expected = sum(c.spare == spare and arm("panda").names.index(c.joint) < k for c in cells)
            wanted = f"coverage-{k + 1}-{'spare' if spare else 'planned'}"
            (group,) = (g for g in tree.iter(f"{SVG}g") if g.get("id") == wanted)
            assert len(list(group.iter(f"{SVG}use"))) == expected


def test_the_same_plan_gives_the_same_bytes_whatever_the_users_style() -> None:
    import matplotlib

    first, _ = drawn("ypp3")
    with matplotlib.rc_context({"font.size": 30, "lines.linewidth": 9, "axes.facecolor": "red"}):
        assert drawn.__wrapped__("ypp3")[0] == first
    assert not any(stamp in first for stamp in ("<dc:date>", "Matplotlib v", "metadata"))


def test_names_no_font_has_and_open_joints_are_drawn_too() -> None:
    chain = arm("ypp3")
    joints = [replace(joint, name=f"<&$_{{{joint.name}}}\u5173\u8282") for joint in chain.joints]
    odd = replace(chain, name='a"<b>\u96e8', joints=tuple(joints))
    cells = [Cell(odd.names[2], np.zeros(3))]
    svg = draw(make_model(odd), cells, [None, None, 1.0])
    assert ElementTree.fromstring(svg).get("aria-label") == 'Plan of a"<b>?'
    assert ids(svg).count("amplification-3") == 1 and "amplification-1" not in ids(svg) and ">open<" in svg


@pytest.mark.parametrize("n", [1, 2])
def test_the_shortest_arms_are_drawn(n: int) -> None:
    plan = make_plan(general_chain(3, n))
    svg = draw(plan.model, plan.cells, plan.document["plan"]["amplification_per_joint"])
    groups = ids(svg)
    assert sum(name.startswith("arm-") for name in groups) == len(plan.cells)
    assert not [name for name in groups if name.startswith("pair-")], "no J_ii depends on the first joint"


def test_a_bench_of_one_joint_all_at_one_point_is_drawn() -> None:
    """A balanced disk on a motor at the origin: only its axis has a length."""
    (joint,) = general_chain(3, 1).joints
    disk = Inertia(1.0, np.zeros(3), np.diag([1.0, 1.0, 2.0]))
    bench = Chain("bench", (replace(joint, p=np.zeros(3), inertia=disk),), "base", "disk")
    plan = make_plan(bench, spare=0)
    svg = draw(plan.model, plan.cells, plan.document["plan"]["amplification_per_joint"])
    assert "nan" not in svg and "inf" not in svg
    (start, end), arm_drawn = points(svg, "excited-1"), points(svg, "arm-1")
    assert np.linalg.norm(end - start) > 20 and np.ptp(arm_drawn, axis=0).max() == 0.0


# The command ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plot") / "arm"
    assert main([str(YPP3), "-o", str(folder), "--no-verify"]) == 0
    return folder


def test_the_command_writes_one_file(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["plan", str(folder), str(YPP3), "--plot"]) == 0
    assert main(["plan", str(folder), str(YPP3), "--plot", "-o", "mine.svg"]) == 0
    assert capsys.readouterr().out.splitlines() == ["arm_plan.svg", "mine.svg"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm_plan.svg", "mine.svg"]
    assert Path("arm_plan.svg").read_bytes() == Path("mine.svg").read_bytes()
    assert is_drawing(Path("mine.svg").read_bytes()) and not is_drawing(YPP3.read_bytes())
    assert len([name for name in ids(Path("mine.svg").read_text()) if name.startswith("cell-")]) == 8


def test_the_committed_plan_needs_no_urdf_argument(tmp_path: Path) -> None:
    out = tmp_path / "plan.svg"
    assert main(["plan", str(REPOSITORY / "generated/ypp3"), "--plot", "-o", str(out)]) == 0
    ElementTree.parse(out)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--plot"], "expected the URDF as an argument too"),
        ([str(YPP3)], "nothing to do; expected --plot"),
        ([str(REPOSITORY / "robots/arm6/arm6.urdf"), "--plot"], "plan.json: made for another URDF"),
        ([str(YPP3), "--plot", "-o", "."], "-o .: a directory; expected a file to write"),
    ],
)
def test_what_can_not_be_drawn_is_refused_in_one_line(
    words: list[str], message: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["plan", str(folder), *words]) == 2
    out, err = capsys.readouterr()
    assert out == "" and message in err and err.count("\n") == 1


def test_a_plan_without_its_amplification_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = json.loads((folder / "plan.json").read_text())
    for wrong in ([1.0], "high", [1.0, "x", 1.0], [1.0, float("inf"), 1.0], [1.0, 1.0, float("nan")]):
        document["plan"]["amplification_per_joint"] = wrong
        (tmp_path / "plan.json").write_text(json.dumps(document))
        assert main(["plan", str(tmp_path), str(YPP3), "--plot", "-o", str(tmp_path / "p.svg")]) == 2
        assert "amplification_per_joint: expected 3 numbers" in capsys.readouterr().err
        assert not (tmp_path / "p.svg").exists()
    document["plan"] |= {"amplification_per_joint": [1.0, 1.0, 1.0], "cells": []}
    (tmp_path / "plan.json").write_text(json.dumps(document))
    assert main(["plan", str(tmp_path), str(YPP3), "--plot", "-o", str(tmp_path / "p.svg")]) == 2
    assert "plan.json: cells: none to draw" in capsys.readouterr().err
