"""A plan determines the constants, within the limits, the same every time, and achieves what it states."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from time import process_time

import numpy as np
import pytest
from arms import _FILES, arm, factoring_of
from chains import general_chain, judge, own, postures, random_body, with_bodies
from numpy.typing import NDArray

from symgen.basis import Factoring, factor
from symgen.cells import Cells, Rows, every_joint, spread
from symgen.chain import Chain, Inertia
from symgen.holding import MARGIN, MARGIN_PART, ROUNDING, Holding, box, home
from symgen.plan import feasible_postures
from symgen.postures import Design, Effort, certificate, judged, plan
from symgen.regressor import C_rows
from symgen.saturated import maxvol

VENDORS = ["ur5", "ur10", "kinova", "z1 without gripper", "panda", "xarm7"]
#: Of the two arms that every plan is tried on the easier one.
UR5 = pytest.param("ur5", marks=pytest.mark.bench)


@cache
def factored(name: str) -> Factoring:
    """The paper's arm, an arm of this repository or a vendor's, or a general arm "6R 1" (joints, seed)."""
    if name == "paper":
        return factoring_of("ypp3", believe_zeros=True)
    if name in ("ypp3_general", "scara4"):
        return factor(own(name))
    if name[1:3] == "R ":
        return factor(general_chain(int(name[3:]), int(name[0])))
    return factoring_of(name)


@cache
def designed(name: str, effort: Effort = "quick", spare: int | None = None) -> Design:
    found = factored(name)
    return plan(found, factored("ypp3") if name == "paper" else found, spare=spare, effort=effort)


def rows_of(name: str) -> Rows:
    return Rows(factored(name), np.zeros(factored(name).chain.n))


def cell_rows(found: Factoring, design: Design) -> np.ndarray:
    return C_rows(found, design.q)[np.arange(len(design.q)), design.joint]


def measured(chain: Chain, design: Design) -> np.ndarray:
    """J_ii of each cell by pinocchio."""
    J = judge(chain, design.q)
    return J[np.arange(len(J)), design.joint, design.joint]


# What a plan is ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["paper", "ypp3_general", "scara4", UR5, pytest.param("panda", marks=pytest.mark.bench), "4R 0"]
)
def test_a_plan_has_d_cells_that_determine_alpha_and_spare_ones(name: str) -> None:
    found, design = factored(name), designed(name)
    d = found.d
    assert len(design.joint) == len(design.q) == d + int(np.ceil(d / 4))
    assert not design.spare[:d].any() and design.spare[d:].all()

    rng = np.random.default_rng(0)
    other = found.chain if name == "paper" else with_bodies(found.chain, [random_body(rng) for _ in found.chain.joints])
    C, J, needed = cell_rows(found, design), measured(other, design), ~design.spare
    alpha = np.linalg.solve(C[needed], J[needed])
    q = postures(other, 50)
    expected = np.einsum("mii->mi", judge(other, q))
    # rounding of J, amplified by at most the condition of the square system
    bound = 1e-15 * np.linalg.cond(C[needed]) * 10
    assert np.abs(C_rows(found, q) @ alpha - expected).max() <= bound * np.abs(expected).max()
    assert np.abs(C @ alpha - J).max() <= bound * np.abs(J).max()


@pytest.mark.parametrize("name", ["paper", "scara4", UR5, pytest.param("panda", marks=pytest.mark.bench)])
def test_cells_run_tip_to_base_within_the_limits_on_round_numbers(name: str) -> None:
    chain, design = factored(name).chain, designed(name)
    for part in (design.joint[~design.spare], design.joint[design.spare]):
        assert (np.diff(part) <= 0).all()
    low, high = chain.limits.T
    margin = np.minimum(MARGIN, MARGIN_PART * (high - low))
    assert (design.q >= low + margin - 1e-12).all() and (design.q <= high - margin + 1e-12).all()
    assert np.abs(design.q / ROUNDING - np.round(design.q / ROUNDING)).max() < 1e-6
    at_rest = np.arange(chain.n) <= design.joint[:, None]
    assert np.array_equal(design.q[at_rest], np.broadcast_to(home(box(chain.limits)), design.q.shape)[at_rest])
    turns = np.abs(design.q) > np.pi + ROUNDING
    fewer = (np.abs(design.q) - 2 * np.pi) * np.sign(design.q)
    assert not (turns & (fewer >= low + margin) & (fewer <= high - margin)).any(), "whole turns are taken off"
    with pytest.raises(ValueError, match="read-only"):
        design.q[0, 0] = 1.0


@pytest.mark.parametrize(
    ("effort", "processes"),
    [("quick", (2, 2)), pytest.param("full", (1, 3), marks=pytest.mark.bench)],
    ids=["quick", "full"],
)
def test_the_same_arm_gives_the_same_plan_by_any_number_of_processes(
    effort: Effort, processes: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = factored("ypp3_general")
    designs = []
    for workers in processes:
        monkeypatch.setattr("symgen.postures.WORKERS", workers)
        designs.append(plan(found, found, effort=effort))
    one, *others = designs
    for two in others:
        assert np.array_equal(one.q, two.q) and np.array_equal(one.joint, two.joint)
        assert one.d_efficiency == two.d_efficiency


SMALL = (("paper", "quick"), ("ypp3_general", "quick"))


@pytest.mark.parametrize(
    "plans",
    [SMALL, (("ypp3_general", "full"), ("ur5", "quick"), ("panda", "quick"))],
    ids=["small", "large"],
)
@pytest.mark.bench
def test_another_processor_gives_the_same_plan(plans: tuple[tuple[str, Effort], ...]) -> None:
    """OpenBLAS made to compute as on a processor of 2004: other last bits in every product, the same postures."""
    code = f"""
import sys
sys.path.insert(0, sys.argv[1])
from test_postures import written
for name, effort in {plans}:
    print(written(name, effort))
"""
    command = [sys.executable, "-c", code, str(Path(__file__).parent)]
    environment = {**os.environ, "OPENBLAS_CORETYPE": "Prescott"}
    other = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    assert other.splitlines() == [written(name, effort) for name, effort in plans]


def written(name: str, effort: Effort) -> str:
    design = designed(name, effort)
    return f"{design.joint.tolist()} {design.q.tolist()}"


def test_the_number_of_spare_cells_is_the_callers() -> None:
    assert not designed("paper", spare=0).spare.any()
    assert designed("paper", spare=5).spare.sum() == 5
    assert np.array_equal(designed("paper", spare=5).q[:6], designed("paper", spare=0).q)


# What a plan achieves ------------------------------------------------------------------------------------------------


#: Plans of as many cells as constants are local optima, and the bound is that of plans of any size. The quick ones of these
#: arms end below 0.9, with `--refine` those of "6R 4" at 0.897, of "7R 4" at 0.885, of "7R 5" at 0.893, of "7R 6" at 0.877.
HARD = ("panda", "6R 0")


@pytest.mark.parametrize(
    "name",
    # the others are tried in the longer studies, ur10, which is ur5 at another scale, too
    [
        *(pytest.param(name, marks=() if name == "panda" else pytest.mark.bench) for name in VENDORS),
        *(pytest.param(name, marks=pytest.mark.bench) for name in ("6R 0", "7R 1")),
    ],
)
def test_a_plan_is_a_good_one_and_certified(name: str) -> None:
    """1 is the floor at the worst (i, q). Random cells are tens to thousands of times worse, a chain of per-joint plans
    two to thirty times (below)."""
    design = designed(name)
    assert design.amplification.max() <= 1.2
    assert design.amplification_p999.max() <= 1.7
    assert (0.89 if name in HARD else 0.9) <= design.d_efficiency <= 1


@pytest.mark.parametrize("name", [UR5, "panda"])
def test_a_draft_determines_all_at_little_more_error_in_a_moment(name: str) -> None:
    found = factored(name)
    began = process_time()
    design = plan(found, found, effort="draft")
    seconds = process_time() - began
    assert design.amplification.max() <= 1.35
    assert design.d_efficiency < designed(name).d_efficiency
    assert seconds < 1.5  # 0.1 to 0.2 on a core of today; a quick plan takes ten times that, a full one a hundred times


@pytest.mark.parametrize("name", ["4R 0", pytest.param("panda", marks=pytest.mark.bench)])
def test_a_full_plan_is_certified(name: str) -> None:
    """Panda is the hardest of the vendors' arms: nothing of 37 measurements can be 10 % better."""
    quick, full = designed(name), designed(name, "full")
    assert full.d_efficiency >= 0.9
    assert full.amplification.max() <= 1.2 and full.amplification_p999.max() <= 1.7
    assert full.d_efficiency > quick.d_efficiency


@pytest.mark.bench
@pytest.mark.parametrize("name", [*VENDORS, "6R 0", "6R 1", "6R 2", "6R 6", "7R 0", "7R 1"])
def test_full_plans_are_certified(name: str) -> None:
    design = designed(name, "full")
    assert design.d_efficiency >= 0.9
    assert design.amplification.max() <= 1.2 and design.amplification_p999.max() <= 1.7


@pytest.mark.bench
@pytest.mark.parametrize("name", ["7R 4", "7R 5", "7R 6"])
def test_full_plans_with_spare_cells_are_certified_where_those_of_d_cells_are_not(name: str) -> None:
    """The best plans of d cells that long searches have found come to 0.886, 0.897, 0.883."""
    design = designed(name, "full")
    assert design.d_efficiency_all >= 0.9 > design.d_efficiency >= 0.875
    assert design.amplification.max() <= 1.2 and design.amplification_p999.max() <= 1.7


@pytest.mark.bench
@pytest.mark.parametrize("effort", ["quick", "full"])
@pytest.mark.parametrize("name", VENDORS)
def test_behind_walls_plans_are_certified(name: str, effort: Effort) -> None:
    """Gravity within the motors, no self-collision. At the walls plans of d cells lose more than the bound does."""
    chain = arm(name)
    feasible = feasible_postures(chain, _FILES[name], (), (0.0, 0.0, -9.81))
    design = plan(factored(name), factored(name), effort=effort, feasible=feasible)
    assert feasible(design.q).all()
    assert design.amplification.max() <= 1.2 and design.amplification_p999.max() <= 1.7
    assert design.d_efficiency >= (0.89 if (name, effort) == ("panda", "quick") else 0.9)


@pytest.mark.parametrize("name", [UR5, "panda"])
def test_random_cells_and_plans_made_joint_by_joint_are_no_match(name: str) -> None:
    joint_by_joint = control(name, per_joint(name))
    random = np.median([control(name, chance(name, s)) for s in range(5)])
    planned = designed(name).amplification.max()
    assert joint_by_joint > 1.5 * planned and random > 20 * planned


def control(name: str, cells: Cells) -> float:
    """Worst amplification of other cells."""
    rows = rows_of(name)
    spare = np.zeros(len(cells), dtype=bool)
    holding = Holding(rows.factoring.chain, box(rows.factoring.chain.limits), None)
    return float(judged(rows, cells.joint, cells.q, spare, holding, log_det_bound=np.inf).amplification.max())


def chance(name: str, seed: int) -> Cells:
    """As many random postures for each joint as it has new constants."""
    found = factored(name)
    joint = np.repeat(np.arange(found.chain.n), found.new_per_joint)
    return Cells(joint, postures(found.chain, found.d, seed))


def per_joint(name: str) -> Cells:
    """For each joint the postures of largest determinant for its own new constants, as the paper goes about it."""
    found, chosen = factored(name), Cells(np.zeros(0, dtype=np.int64), np.zeros((0, factored(name).chain.n)))
    q = spread(box(found.chain.limits), 2000, 0.5)
    C = C_rows(found, q)
    for i in range(found.chain.n):
        own_constants = [k for k in range(found.d) if found.alphas[k].i == i]
        rows = maxvol(C[:, i, own_constants])
        chosen = chosen + Cells(np.full(len(rows), i), q[rows])
    return chosen


@pytest.mark.parametrize(
    ("rotor", "name"),
    [*((rotor, name) for name in ("paper", "scara4") for rotor in (0.0, 0.4)), *(pytest.param(rotor, "ur5", marks=pytest.mark.bench) for rotor in (0.0, 0.4))],
)  # fmt: skip
def test_the_amplification_stated_is_that_of_simulated_errors(name: str, rotor: float) -> None:
    """Errors of unit size relative to sigma, drawn; alpha solved; J_ii compared at other postures than the planner's."""
    found = factored(name)
    n, draws = found.chain.n, 400
    design = plan(found, found, rotor=np.full(n, rotor), spare=0) if rotor else designed(name)
    needed, rng = ~design.spare, np.random.default_rng(0)
    C, sigma = cell_rows(found, design)[needed], measured(found.chain, design)[needed] + rotor
    error = np.linalg.solve(C, sigma[:, None] * rng.normal(size=(found.d, draws)))
    low, high = found.chain.limits.T
    q = low + (high - low) * rng.random((1500, n))
    scale = np.einsum("mii->mi", judge(found.chain, q)) + rotor
    squares = (np.einsum("mid,dk->mik", C_rows(found, q), error) / scale[..., None]) ** 2
    for i in range(n):
        mean = squares[:, i].mean()
        scatter = np.hypot(
            squares[:, i].mean(axis=0).std() / np.sqrt(draws), squares[:, i].mean(axis=1).std() / np.sqrt(1500)
        )
        assert abs(mean - design.amplification[i] ** 2) <= 3 * scatter + 1e-6, f"joint {i + 1}"
        assert design.amplification_p999[i] >= design.amplification[i] - 1e-9


@pytest.mark.parametrize(
    "name", [*(pytest.param(name, marks=pytest.mark.bench) for name in ("paper", "ypp3_general", "scara4")), "2R 1"]
)
def test_the_certificate_is_below_what_is_true(name: str) -> None:
    """A better design, found by brute force, bounds the true efficiency from above; the certificate must be below it."""
    rows = rows_of(name)
    allowed = box(rows.factoring.chain.limits)
    holding = Holding(rows.factoring.chain, allowed, None)
    better = by_brute_force(rows, allowed)
    design = designed(name, "full", 0)
    for cells in (Cells(design.joint, design.q), *(chance(name, seed) for seed in range(4))):
        F = rows.of_cells(cells)
        true = float(np.exp((np.linalg.slogdet(F.T @ F / len(F))[1] - better) / F.shape[1]))
        for effort in ("quick", "full"):
            stated = certificate(rows, F, holding, effort)
            assert 0 < stated <= min(true, 1.0) + 1e-12
        assert stated >= 0.97 * min(true, 1.0)
    assert design.d_efficiency == pytest.approx(
        certificate(rows, rows.of_cells(Cells(design.joint, design.q)), holding, "full")
    )


def by_brute_force(rows: Rows, allowed: np.ndarray) -> float:
    """log det of the best weights over the cells of 1500 postures: what some design reaches."""
    F = rows.of_cells(every_joint(spread(allowed, 1500, 0.77)))
    weight = np.full(len(F), 1 / len(F))
    for _ in range(300):
        M = (F * weight[:, None]).T @ F
        weight *= np.einsum("nd,de,ne->n", F, np.linalg.inv(M), F, optimize=True) / F.shape[1]
    return float(np.linalg.slogdet((F * weight[:, None]).T @ F)[1])


def test_conditioning_is_of_whitened_rows_joint_by_joint() -> None:
    rows, design = rows_of("paper"), designed("paper", spare=0)
    everywhere = rows(postures(factored("paper").chain, 20000)).reshape(-1, 6)
    whiten = np.linalg.inv(np.linalg.cholesky(everywhere.T @ everywhere)).T
    F = rows.of_cells(Cells(design.joint, design.q)) @ whiten
    expected = [np.linalg.cond(F[design.joint == i]) for i in range(3)]
    # 2000 evenly spread postures against 20000 random ones
    assert design.cond == pytest.approx(expected, rel=0.05)


# What spare cells are for --------------------------------------------------------------------------------------------


def test_spare_cells_see_a_lateral_centre_of_mass_that_the_planned_ones_fit() -> None:
    """10 mm across links 2 and 3: the six constants fit six cells exactly and miss J_11 by a third elsewhere."""
    found, design = factored("paper"), designed("paper")
    truth = with_bodies(
        found.chain, [shifted(joint.inertia, 0.01 * (k > 0)) for k, joint in enumerate(found.chain.joints)]
    )
    C, J, needed = cell_rows(found, design), measured(truth, design), ~design.spare
    alpha = np.linalg.solve(C[needed], J[needed])
    q = postures(truth, 500)
    missed = np.abs(C_rows(found, q)[:, 0] @ alpha / judge(truth, q)[:, 0, 0] - 1)
    residual = np.abs(C @ alpha / J - 1)
    assert missed.max() > 0.3
    assert residual[needed].max() < 1e-12
    assert residual[design.spare].max() > 0.2, "twenty times an error of 1 %"


def shifted(body: Inertia, across: float) -> Inertia:
    return Inertia(body.mass, body.com + np.array([0.0, 0.0, across]), body.I)


def test_spare_cells_of_a_general_model_add_what_is_known_least() -> None:
    design = designed("panda")
    rows = rows_of("panda")
    F = rows.of_cells(Cells(design.joint, design.q))
    needed: NDArray[np.bool_] = ~design.spare

    def worst(chosen: np.ndarray) -> float:
        everywhere = rows(postures(arm("panda"), 500))
        return float(np.einsum("mid,de,mie->mi", everywhere, np.linalg.inv(chosen.T @ chosen), everywhere).max())

    random = [
        rows.of_cells(Cells(np.random.default_rng(s).integers(0, 7, 10), postures(arm("panda"), 10, s)))
        for s in range(5)
    ]
    assert worst(F) < 0.9 * worst(F[needed])
    assert worst(F) < min(worst(np.concatenate([F[needed], more])) for more in random)
    assert design.d_efficiency_all > 0.92, "0.917 before they are moved"
