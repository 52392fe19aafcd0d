"""Own postures, grids, triangular plans: each keeps its promise, judged by Pinocchio, by hand, and by plain linear algebra."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from arms import factoring_of
from chains import REPOSITORY, build, judge, own
from scipy.linalg import null_space

from symgen.alternatives import given, grid_steps, gridded, triangular
from symgen.basis import Factoring, factor
from symgen.cells import Cells, Rows
from symgen.chain import PRISMATIC, REVOLUTE, Chain, Inertia, Joint
from symgen.cli import main
from symgen.errors import NoPlanError, PlanError
from symgen.feasible import Feasible
from symgen.holding import Mask
from symgen.judgement import infeasible, judged, undetermined
from symgen.postures import plan
from symgen.regressor import C_rows

YPP3 = REPOSITORY / "robots/ypp3/ypp3.urdf"

#: C(q) is a product with a pseudo-inverse of condition below 1e3.
ROUNDING = 1e-11


def rows_of(factoring: Factoring) -> Rows:
    return Rows(factoring, np.zeros(factoring.chain.n))


def C_of(factoring: Factoring, cells: Cells) -> np.ndarray:
    return C_rows(factoring, cells.q)[np.arange(len(cells)), cells.joint]


def triangular_of(
    name: str, feasible: Mask | None = None, spare: int | None = 0
) -> tuple[Factoring, Cells, np.ndarray]:
    factoring = factoring_of(name, believe_zeros=True)
    cells, extra = triangular(
        rows_of(factoring), factoring_of(name) if name == "ypp3" else factoring, feasible, spare=spare
    )
    return factoring, cells, extra


# Triangular ----------------------------------------------------------------------------------------------------------


def test_the_papers_arm_gets_the_papers_postures() -> None:
    """POS1: q_2 = q_23 = 0; POS2: q_2 = 0, q_23 = -pi/2; POS3: q_2 = q_23 = pi/2, up to mirror images of J."""
    _, cells, _ = triangular_of("ypp3")
    seen = {
        (int(i), *np.round(np.abs(np.cos([q[1], q[1] + q[2]])), 12)) for i, q in zip(cells.joint, cells.q, strict=True)
    }
    assert {(i, c2, c23) for i, c2, c23 in seen if i == 0} == {(0, 1.0, 1.0), (0, 1.0, 0.0), (0, 0.0, 0.0)}
    assert sorted(np.round(np.abs(np.cos(cells.q[cells.joint == 1, 2])), 12)) == [0.0, 1.0]
    assert cells.joint.tolist() == [2, 1, 1, 0, 0, 0]
    assert len(np.unique(np.round(cells.q, 9), axis=0)) == 3, "three postures serve all joints"


@pytest.mark.parametrize("name", ["ypp3", pytest.param("ur5", marks=pytest.mark.bench)])
def test_each_cell_shows_one_constant_more_with_coefficient_one(name: str) -> None:
    """Back substitution without a matrix, from Pinocchio's J_ii, gives the URDF's constants."""
    factoring, cells, spare = triangular_of(name)
    assert len(cells) == factoring.d and not spare.any()
    assert (np.diff(cells.joint) <= 0).all(), "tip to base"
    C, J = C_of(factoring, cells), judge(factoring.chain, cells.q)
    known: dict[int, float] = {}
    for row, i, matrix in zip(C, cells.joint.tolist(), J, strict=True):
        (new,) = set(np.flatnonzero(np.abs(row) > 1e-9).tolist()) - known.keys()
        alpha = factoring.alphas[new]
        assert alpha.i == i, "a new constant of the excited joint"
        assert min(abs(abs(row[new]) - size) for size in (1, alpha.content)) < ROUNDING
        known[new] = (matrix[i, i] - sum(row[k] * value for k, value in known.items())) / row[new]
    solved = np.array([known[k] for k in range(factoring.d)])
    # d back substitutions, each adding the roundings of those before
    assert np.abs(solved - factoring.alpha_cad[: factoring.d]).max() < factoring.d * ROUNDING * np.abs(solved).max()


@pytest.mark.parametrize(("name", "joint"), [("ypp3_general", "joint2"), ("arm6", "joint4"), ("scara4", "joint2")])
def test_where_there_is_none_the_joint_that_prevents_it_is_named(name: str, joint: str) -> None:
    factoring = factor(own(name))
    with pytest.raises(
        NoPlanError, match=f"^{name}: no triangular plan: {joint}: no posture on multiples of 45 deg"
    ) as e:
        triangular(rows_of(factoring), factoring, None)
    assert "\n" not in str(e.value)


def test_there_is_none_by_brute_force_either() -> None:
    """Every order of every 45 deg posture of the general arm's joint 2: no row has a single new constant."""
    factoring = factor(own("ypp3_general"))
    q = np.array([[0, 0, a] for a in np.deg2rad(np.arange(-135, 136, 45))])
    new = [k for k, alpha in enumerate(factoring.alphas[: factoring.d]) if alpha.i == 1]
    C = C_rows(factoring, q)[:, 1][:, new]
    assert len(new) == 3 and (np.count_nonzero(np.abs(C) > 1e-9, axis=1) > 1).any()
    ones = [row for row in C if np.count_nonzero(np.abs(row) > 1e-9) == 1]
    shown = {int(np.argmax(np.abs(row))) for row in ones}
    with_help = [row for row in C if len(set(np.flatnonzero(np.abs(row) > 1e-9).tolist()) - shown) == 1]
    reached = shown | {k for row in with_help for k in np.flatnonzero(np.abs(row) > 1e-9).tolist()}
    assert reached != {0, 1, 2}


def test_triangular_postures_are_feasible_ones() -> None:
    """No elbow at -90 deg, and joint 1 not at rest: other postures, still a plan."""

    def allowed(q: np.ndarray) -> np.ndarray:
        return (np.abs(q[:, 2] + np.pi / 2) > 0.1) & (np.abs(q[:, 0]) > 0.1)

    factoring, cells, spare = triangular_of("ypp3", allowed, None)
    assert allowed(cells.q).all() and spare.sum() == 2
    assert undetermined(rows_of(factoring), cells[~spare]) == (6, ())

    with pytest.raises(NoPlanError, match="joint3: no posture that the arm may hold on multiples"):
        triangular_of("ypp3", lambda q: np.zeros(len(q), dtype=bool))


def test_spare_cells_see_what_the_triangular_plan_can_not() -> None:
    """The paper's six cells leave constants of generic links open: c_2 c_23 = c_23^2 at all of them."""
    cells, spare = triangular_of("ypp3", None, 4)[1:]
    wider = rows_of(factoring_of("ypp3"))
    rank, _ = undetermined(wider, cells[~spare])
    assert rank <= 6 and undetermined(wider, cells) == (9, ())


# Grids ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "grid", "angle"),
    [
        ("ypp3_general", "15deg", 15),
        pytest.param("arm6", "30deg", 30, marks=pytest.mark.bench),
        ("ypp3", "0.5rad", 28.64788975654116),
    ],
)
def test_all_joints_are_on_multiples_within_limits_and_nothing_stays_open(name: str, grid: str, angle: float) -> None:
    factoring = factor(own(name))
    cells, spare = gridded(rows_of(factoring), factoring, None, grid=grid)
    steps = np.rad2deg(cells.q) / angle
    assert np.abs(steps - np.round(steps)).max() < 1e-9
    low, high = own(name).limits.T
    assert (cells.q > low).all() and (cells.q < high).all()
    assert len(cells) - spare.sum() == factoring.d and spare.sum() == int(np.ceil(factoring.d / 4))
    assert (np.diff(cells.joint[~spare]) <= 0).all()
    assert undetermined(rows_of(factoring), cells[~spare]) == (factoring.d, ())


def test_searching_on_the_grid_beats_rounding_to_it() -> None:
    factoring = factor(own("ypp3_general"))
    rows, step = rows_of(factoring), np.deg2rad(45)
    free = plan(factoring, factoring, spare=0)
    low, high = np.ceil(factoring.chain.limits[:, 0] / step), np.floor(factoring.chain.limits[:, 1] / step)
    rounded = Cells(free.joint, np.clip(np.round(free.q / step), low, high) * step)
    cells, _ = gridded(rows, factoring, None, grid="45deg", spare=0)
    ours, theirs = (judged(rows, c, np.zeros(len(c), dtype=bool)) for c in (cells, rounded))
    assert ours.d_efficiency > theirs.d_efficiency and ours.amplification.max() < 1.3


def test_slides_have_a_grid_of_their_own() -> None:
    chain = build(
        [(REVOLUTE, "generic", "generic"), (REVOLUTE, "generic", "generic"), (PRISMATIC, "generic", "generic")], 5
    )
    factoring = factor(chain)
    for grid, step in (("20deg", 0.01), ("20deg,7mm", 0.007), ("0.4rad,0.02m", 0.02)):
        cells, _ = gridded(rows_of(factoring), factoring, None, grid=grid)
        slides = cells.q[:, 2] / step
        assert np.abs(slides - np.round(slides)).max() < 1e-9 and np.ptp(slides) > 1


def test_a_grid_that_is_too_coarse_is_named_with_what_stays_open() -> None:
    """{0, +-90 deg} is not enough on any yaw-pitch arm with general links; brute force over all such postures agrees."""
    factoring = factor(own("ypp3_general"))
    right = np.array(list(product([0.0], *2 * [np.deg2rad([-90, 0, 90])])))
    rank = np.linalg.matrix_rank(np.concatenate(C_rows(factoring, right)))
    with pytest.raises(NoPlanError, match=f"multiples of 90deg determine only {rank} of 9 constants .open: alpha_"):
        gridded(rows_of(factoring), factoring, None, grid="90deg")


def test_spare_cells_are_chosen_where_the_grid_shows_not_all_of_what_may_be_there() -> None:
    """Of the nine constants of a general arm, this grid shows seven."""
    cells, extra = gridded(rows_of(factoring_of("ypp3", believe_zeros=True)), factoring_of("ypp3"), None, grid="90deg")
    assert (len(cells), extra.sum()) == (8, 2)


def test_a_joint_with_no_multiple_in_its_range_is_named() -> None:
    factoring = factoring_of("panda")
    with pytest.raises(NoPlanError, match="panda_joint4: no multiple of 3.14159 rad"):
        gridded(rows_of(factoring), factoring, None, grid="180deg")


def test_cells_on_a_grid_are_feasible_ones() -> None:
    def allowed(q: np.ndarray) -> np.ndarray:
        return (q[:, 1] > -0.1) & (np.abs(q[:, 0]) > 0.1)

    factoring = factor(own("ypp3_general"))
    cells, _ = gridded(rows_of(factoring), factoring, allowed, grid="15deg")
    assert allowed(cells.q).all()


@pytest.mark.parametrize(
    "text",
    [
        "15",
        "deg",
        "",
        "15deg,",
        "15deg,5",
        "15deg,5deg",
        "5mm",
        "-15deg",
        "0deg",
        "181deg",
        "15deg,5mm,1m",
        "1e3deg",
        "nandeg",
        "0.001deg",
    ],
)
def test_a_grid_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(PlanError, match="--grid .*: expected an angle of") as e:
        grid_steps(text, own("scara4"))
    assert "\n" not in str(e.value)


def test_grids_are_read_with_their_units() -> None:
    assert grid_steps(" 15 deg , 5 mm ", own("scara4")) == pytest.approx(
        np.array([np.pi / 12, np.pi / 12, 5e-3, np.pi / 12])
    )


# Own postures --------------------------------------------------------------------------------------------------------

CSV = "Joint, q1, q2, q3\n# POS1\njoint3, 0, 0, 0\n\n joint2,0,0,0 # stretched\njoint1,0,1.5,-1e-3\n"


def chain() -> Chain:
    return own("ypp3")


def test_postures_are_read_from_csv_json_and_plans(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\ufeff" + CSV.replace("\n", "\r\n"), encoding="utf-8")
    listed = [
        {"joint": "joint3", "q": [0, 0, 0]},
        {"joint": "joint2", "q": [0, 0, 0]},
        {"joint": "joint1", "q": [0, 1.5, -1e-3]},
    ]
    (tmp_path / "b.json").write_text(json.dumps(listed))
    (tmp_path / "c.json").write_text(json.dumps({"plan": {"cells": [*listed[:2], {**listed[2], "spare": True}]}}))
    for name, spare in (("a.csv", [0, 0, 0]), ("b.json", [0, 0, 0]), ("c.json", [0, 0, 1])):
        cells, extra = given(tmp_path / name, chain())
        assert cells.joint.tolist() == [2, 1, 0] and extra.tolist() == spare
        assert cells.q.tolist() == [[0, 0, 0], [0, 0, 0], [0, 1.5, -1e-3]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no posture; expected lines of joint name"),
        ("joint,q1,q2,q3\n", "no posture"),
        ("joint3,0,0\n", "line 1: joint 'joint3' at 2 values; expected one of joint1, joint2, joint3 at 3 finite"),
        ("joint3,0,0,0\nwrist,0,0,0\n", "line 2: joint 'wrist' at 3 values"),
        ("joint3,0,zero,0\n", "line 1: '0,zero,0' are not all numbers"),
        ("joint3,0,nan,0\n", "at 3 finite numbers"),
        ("joint3,0,1e300,0\n", "line 1: joint 'joint3' at 3 values; .* at 3 finite numbers up to 1e.06"),
        ("joint3;0;0;0\n", "line 1: joint 'joint3;0;0;0' at 0 values"),
        ("[", "not a file of postures: JSONDecodeError"),
        ("{}", "not a file of postures: KeyError 'plan'"),
        ("[1]", "not a file of postures: TypeError"),
        ('[{"joint": 3, "q": [0, 0, 0]}]', "cell 1: joint 3 at 3 values"),
        ('[{"joint": "joint3", "q": [[0], 0, 0]}]', "not a file of postures: TypeError"),
        ('[{"joint": "joint3", "q": "000"}]', "not a file of postures: TypeError cell 1: q is no list"),
        (f'[{{"joint": "joint3", "q": [{10**400}, 0, 0]}}]', "not a file of postures: OverflowError"),
        ("\x00\xff", "joint|postures"),
    ],
)
def test_a_file_that_holds_no_postures_is_refused_in_one_line(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "mine"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(PlanError, match=message) as e:
        given(path, chain())
    assert str(e.value).startswith(f"{path}: ") and "\n" not in str(e.value)


def test_a_joint_may_be_named_joint(tmp_path: Path) -> None:
    joints = [replace(one, name=name) for one, name in zip(chain().joints, ("base", "tilt", "joint"), strict=True)]
    odd = replace(chain(), joints=tuple(joints))
    for heading in ("", "joint,q1,q2,q3\n", "Joint\n"):
        (tmp_path / "a.csv").write_text(f"{heading}joint,0.5,0,0\ntilt,0,0,0\n")
        assert given(tmp_path / "a.csv", odd)[0].joint.tolist() == [2, 1]
    (tmp_path / "a.csv").write_text("joint,0.5,zero,0\ntilt,0,0,0\n")
    with pytest.raises(PlanError, match="line 1: '0.5,zero,0' are not all numbers"):
        given(tmp_path / "a.csv", odd)


PAPER = [(2, 0, 0), (1, 0, 0), (1, 0, -90), (0, 0, 0), (0, 0, -90), (0, 90, 0)]


def cells_at(degrees: list[tuple[int, int, int]]) -> Cells:
    q = np.deg2rad([(0, q2, q3) for _, q2, q3 in degrees])
    return Cells(np.array([i for i, *_ in degrees]), q)


def test_what_the_papers_postures_leave_open_is_told_by_name() -> None:
    """By (12)-(20): J_11 is alpha_13 at POS3, alpha_12 + alpha_13 at POS2, and with alpha_11 and 2 alpha_21 at POS1."""
    rows = rows_of(factor(own("ypp3"), believe_zeros=True))
    assert undetermined(rows, cells_at(PAPER)) == (6, ())
    assert undetermined(rows, cells_at(PAPER[:5])) == (5, ("alpha_12", "alpha_13"))
    assert undetermined(rows, cells_at(PAPER[:4])) == (4, ("alpha_11", "alpha_12", "alpha_13"))
    assert undetermined(rows, cells_at(PAPER[1:])) == (5, ("alpha_31",))
    assert undetermined(rows, cells_at(PAPER[:1] * 3)) == (1, rows.factoring.names[1:])


@pytest.mark.parametrize("seed", range(4))
def test_open_constants_are_those_the_null_space_moves(seed: int) -> None:
    factoring = factor(own("arm6"))
    rng = np.random.default_rng(seed)
    low, high = own("arm6").limits.T
    count = int(rng.integers(10, 45))
    cells = Cells(rng.integers(0, 6, count), low + (high - low) * rng.random((count, 6)))
    hidden = null_space(C_of(factoring, cells), rcond=1e-10)
    names = factoring.names[: factoring.d]
    moved = tuple(n for n, row in zip(names, hidden, strict=True) if np.abs(row).max(initial=0.0) > 1e-6)
    assert undetermined(rows_of(factoring), cells) == (factoring.d - hidden.shape[1], moved)


def test_the_amplification_of_what_is_determined_is_that_of_linear_propagation() -> None:
    """Joints 3 and 2 at the paper's postures, J_11 at one only: J_11 is open, J_22 has the textbook covariance."""
    factoring = factor(own("ypp3"), believe_zeros=True)
    a21, a22 = factoring.alpha_cad[1:3]
    design = judged(rows_of(factoring), cells_at(PAPER[:4]), np.zeros(4, dtype=bool))
    assert np.isnan(design.amplification[0]) and design.d_efficiency == 0.0 and np.isnan(design.cond).all()
    C = np.array([[2.0, 1.0], [0.0, 1.0]]) / np.array([[2 * a21 + a22], [a22]])
    covariance = np.linalg.inv(C.T @ C)
    low, high = own("ypp3").limits[2]
    c3 = np.cos(np.linspace(low, high, 20001))
    row = np.stack([2 * c3, np.ones_like(c3)], axis=1) / (2 * a21 * c3 + a22)[:, None]
    expected = np.sqrt(np.einsum("md,de,me->m", row, covariance, row).mean())
    # 2000 evenly spread postures against 20001: a mean over a smooth function
    assert design.amplification[1] == pytest.approx(expected, rel=5e-3)
    assert design.amplification[2] == pytest.approx(1.0, rel=1e-9)


def points(slide: bool) -> Chain:
    """A point of 2 kg on a boom that turns about z and tilts about y, or on a slide: J_11 is 0 where it is on z."""
    boom, point = Inertia(1.0, np.zeros(3), np.zeros((3, 3))), Inertia(2.0, np.array([0.5, 0, 0]), np.zeros((3, 3)))
    kind, axis, body = (
        (PRISMATIC, [1, 0, 0], replace(point, com=np.zeros(3))) if slide else (REVOLUTE, [0, 1, 0], point)
    )
    first = Joint("turn", REVOLUTE, np.eye(3), np.zeros(3), np.array([0, 0, 1]), "boom", boom)
    return Chain(
        "points", (first, Joint("out", kind, np.eye(3), np.zeros(3), np.array(axis), "point", body)), "a", "point"
    )


@pytest.mark.parametrize(("slide", "on_axis"), [(False, np.pi / 2), (True, 0.0)])
def test_a_posture_without_inertia_hides_no_other(slide: bool, on_axis: float) -> None:
    """There the least of errors is expected, and a row of weight 1e33, or 0/0, hid all other cells."""
    factoring = factor(points(slide))
    rows, q = rows_of(factoring), np.array([[0, 0.3], [0, on_axis], [0, 0.9], [0, 0.4]])
    cells = Cells(np.array([1, 0, 0, 0]), q)
    assert undetermined(rows, cells) == (factoring.d, ()) and factoring.d == (3 if slide else 4)
    few = judged(rows, cells[:2], np.zeros(2, dtype=bool))
    assert np.isnan(few.amplification[0]) and few.amplification[1] == pytest.approx(1.0)
    assert np.isfinite(plan(factoring, factoring, effort="draft").amplification).all()


def test_a_joint_without_cells_has_no_conditioning() -> None:
    """The mass on the slide is seen from the turning joint."""
    cells = Cells(np.zeros(3, dtype=int), np.array([[0, -0.5], [0, 0.1], [0, 0.5]]))
    design = judged(rows_of(factor(points(True))), cells, np.zeros(3, dtype=bool))
    assert np.isfinite(design.cond[0]) and np.isnan(design.cond[1])


def test_own_postures_that_can_not_be_held_are_named() -> None:
    cells = cells_at([(0, 0, 0), (0, 160, 0), (1, 90, -150)])
    assert infeasible(own("ypp3"), cells, None) == {1: "joint2 beyond its limits", 2: "joint3 beyond its limits"}
    joints = [replace(one, upper=np.inf, lower=-np.inf) for one in own("ypp3").joints]
    assert infeasible(replace(own("ypp3"), joints=tuple(joints)), cells, None) == {}, "no limit, nothing beyond it"


def test_why_a_posture_can_not_be_held_is_told() -> None:
    """The stretched arm weighs 21 Nm on joint 2; pointing straight up it weighs nothing."""
    weak = Feasible(own("ypp3"), YPP3, [np.inf, 5.0, np.inf], (0.0, 0.0, -9.81))
    assert infeasible(own("ypp3"), cells_at([(1, 0, 0), (1, 90, 0)]), weak) == {0: "gravity beyond the motors"}
    weak.touches = lambda q: np.ones(len(q), dtype=bool)  # type: ignore[assignment]
    assert set(infeasible(own("ypp3"), cells_at([(1, 90, 0)]), weak).values()) == {"self-collision"}


# The command ---------------------------------------------------------------------------------------------------------


def said(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    capsys.readouterr()
    status = main([str(word) for word in (*words, "--no-verify")])
    return status, *capsys.readouterr()


def test_the_command_judges_own_postures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "paper.csv"
    lines = [f"joint{i + 1},0,{np.deg2rad(a)},{np.deg2rad(b)}\n" for i, a, b in PAPER]
    path.write_text("".join(lines))
    status, out, _ = said(capsys, YPP3, "--postures", path, "--json")
    document = json.loads(out)["plan"]
    assert status == 0 and document["rank"] == 6 and document["open"] == document["infeasible"] == []
    assert (document["measurements"], document["spare"]) == (6, 0)
    assert min(document["amplification_per_joint"]) > 0 and 0 < document["d_efficiency_at_least"] < 1
    assert [cell["joint"] for cell in document["cells"]] == [f"joint{i + 1}" for i, *_ in PAPER]

    path.write_text("".join(lines[:5]))
    status, out, _ = said(capsys, YPP3, "--postures", path)
    assert status == 1 and "determine 5 of 6 constants; open: alpha_12, alpha_13" in out

    path.write_text("".join([*lines, "joint1,0,2.9,0\n"]))
    status, out, _ = said(capsys, YPP3, "--postures", path)
    assert status == 1 and "Cell 7 (joint1) can not be held: joint2 beyond its limits" in out


def test_a_plan_file_is_judged_as_what_it_was(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert said(capsys, YPP3, "-o", tmp_path)[0] == 0
    written = json.loads((tmp_path / "plan.json").read_text())["plan"]
    status, out, _ = said(capsys, YPP3, "--postures", tmp_path / "plan.json", "--json")
    again = json.loads(out)["plan"]
    assert status == 0 and {k: v for k, v in again.items() if "efficiency" not in k} == {
        k: v for k, v in written.items() if "efficiency" not in k
    }
    # another bound, as valid
    assert again["d_efficiency_at_least"] == pytest.approx(written["d_efficiency_at_least"], abs=0.02)


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (["--triangular"], 1, "no triangular plan: joint2"),
        (["--grid", "90deg"], 1, "determine only 7 of 9"),
        (["--grid", "90"], 2, "--grid '90': expected"),
        (["--grid", "15deg", "--triangular"], 2, "--grid and --triangular: expected one of them"),
        (["--triangular", "--refine"], 2, "--triangular: expected without --refine"),
        (["--postures", "nowhere.csv"], 2, "nowhere.csv: No such file"),
        (["--postures", str(YPP3), "--spare", "1"], 2, "--postures: expected without --spare"),
        (["--postures", str(YPP3)], 2, "ypp3.urdf: not a file of postures"),
    ],
)
def test_what_can_not_be_had_is_one_line(
    words: list[str], status: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found, out, err = said(capsys, REPOSITORY / "robots/ypp3_general/ypp3_general.urdf", *words)
    assert (found, out) == (status, "") and message in err and err.count("\n") == 1


def test_an_interruption_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("symgen.request.plan_for", stop)
    assert said(capsys, YPP3) == (130, "", "symgen: interrupted\n")
