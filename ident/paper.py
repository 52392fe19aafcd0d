"""The paper's two tables: Table I simulated, both solved again from their own numbers, and what the errors mean.

Equations and tables are those of K. Choi et al., "Identification of Flexible Joint Robot Inertia Matrix Using Frequency
Response Analysis". (17) prints alpha_21 c_2 c_23 where expanding (13) gives 2 alpha_21 c_2 c_23; the printed alphas
follow (17). At the paper's postures c_2 c_23 = c_23^2, so that any coefficient fits what was measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ident.errors import IdentError
from ident.identification.identify import identify
from ident.identification.physical import YPP_ALPHA, consistency, ypp_inequalities
from ident.joint.solve import solve
from ident.paper_tables import (
    CAD,
    CELLS,
    NOISE,
    POSTURES,
    TABLE_I,
    TABLE_II,
    UNCERTAINTY,
    Comparison,
    PaperTables,
    Printed,
    Reworked,
    Simulated,
    Verdict,
    Violation,
    document,
    text,
)
from ident.records.campaign import Array
from ident.simulator.bench import simulate
from symgen.chain import Chain, Inertia
from symgen.plan import Model, chain_of_robot, make_model
from symgen.robot import Robot, load_robot

__all__ = ["document", "model_of_paper", "rework", "run", "simulate_table", "text"]

#: Postures q_3 [deg] at q_2 = 0 that were not measured and where c_2 c_23 differs from c_23^2.
UNSEEN = (180, 120)
#: Alphas at most this many standard deviations from those of real bodies are not called impossible.
WITHIN_NOISE = 2.0
#: Periods of a simulated record, the settling one included: enough for every alpha to 0.1 %; more only costs time.
PERIODS = 4

#: (17)-(19) at `CELLS`, factor 2 in place: multiples of `YPP_ALPHA`.
_EXPECTED = (
    (1, 1, 1, 2, 0, 0),
    (0, 0, 0, 2, 1, 0),
    (0, 0, 0, 0, 0, 1),
    (0, 1, 1, 0, 0, 0),
    (0, 0, 0, 0, 1, 0),
    (0, 0, 1, 0, 0, 0),
)


def run(robot_dir: str | Path, *, progress: Callable[[str], None] | None = None) -> PaperTables:
    """Returns both tables for the paper's arm in `robot_dir`, simulated and reworked; about 10 s.

    Raises IdentError if the robot is not the paper's yaw-pitch-pitch arm, SymgenError for files that do not fit.
    """
    robot = load_robot(robot_dir)
    robot = replace(robot, experiment=replace(robot.experiment, periods=PERIODS))
    model = model_of_paper(robot)
    scales = (1.0, 1.0 / (1.0 - UNCERTAINTY))
    simulated = tuple(simulate_table(robot, model, scale, seed, progress=progress) for seed, scale in enumerate(scales))
    return PaperTables(robot.experiment, simulated, tuple(rework(model, table) for table in (TABLE_I, TABLE_II)))


def model_of_paper(robot: Robot) -> Model:
    """Returns the model of an arm with symmetric links whose J_ii are (17)-(19) with the factor 2 in place.

    Raises IdentError if they are not, SymgenError for files that do not fit.
    """
    model = make_model(chain_of_robot(robot), believe_zeros=True)
    names = model.names[: model.d]
    if set(names) != set(YPP_ALPHA) or not np.allclose(_rows(model, 2), _EXPECTED):
        raise IdentError(
            f"{robot.path}: J_ii has the constants {', '.join(names)}; expected the paper's yaw-pitch-pitch arm, "
            f"(17)-(19) with {', '.join(YPP_ALPHA)}, joint angles counted as there"
        )
    return model


def simulate_table(
    robot: Robot,
    model: Model,
    scale: float,
    seed: int,
    *,
    workers: int = 2,
    progress: Callable[[str], None] | None = None,
) -> Simulated:
    """Returns Table I from records of an arm with links `scale` times as heavy as CAD's; section IV-A.

    The joints that are not excited are rigid. `seed` and `workers` as in `bench.simulate`, which says what it raises.
    """
    chain = model.chain
    label = "as CAD" if scale == 1.0 else f"{scale:.3f} x CAD"
    cells = [(chain.names[i - 1], _posture(*POSTURES[name])) for name, i in CELLS]
    campaign = simulate(
        chain, robot, cells, lock="rigid", seed=seed, truth=_scaled(chain, scale), workers=workers,
        progress=lambda done, of: progress(f"Table I, links {label}: {done} of {of} records") if progress else None,
    )  # fmt: skip
    found = identify(campaign, method="two-mass", believe_zeros=True)
    order = _order(model)
    cad, alpha = model.alpha_cad[order], found.alpha.value[order]
    measured = found.measurements
    return Simulated(
        scale,
        J_cad=np.array([m.J_cad for m in measured]),
        J=np.array([m.J for m in measured]),
        J_std=np.array([m.std for m in measured]),
        J_three_point=np.array([m.three_point.J_l for m in measured]),
        alpha_cad=cad,
        alpha=alpha,
        alpha_std=found.alpha.std[order],
        off=100 * (alpha / (scale * cad) - 1),
        error=_error(alpha, cad),
        error_of_cad=100 * (alpha / cad - 1),
        explained=found.explained,
        notes=found.notes,
    )


def rework(model: Model, table: Printed) -> Reworked:
    """Returns a printed table solved again by (11), (21), with the paper's coefficient and the right one; judged."""
    printed = np.array(table.J)
    J = printed.copy()
    J[CELLS.index(("POS2", 1))] = round(table.alpha[1] + table.alpha[2], 4)  # (17) there; Table I prints 0.696
    literal, _ = _solved(model, 1, printed)
    single, single_covariance = _solved(model, 1, J)
    corrected, covariance = _solved(model, 2, J)
    identified, cad = (_solved(model, 2, _rows(model, 1) @ np.array(alpha))[0] for alpha in (table.identified, CAD))
    return Reworked(
        table, J, literal, single, corrected, np.sqrt(np.diag(covariance)),
        error=_error(np.array(table.identified), np.array(CAD)),
        error_corrected=_error(identified, cad),
        error_of_cad=100 * (identified / cad - 1),
        verdicts=(
            _verdict(model, f"{table.name}, printed", np.array(table.alpha), single_covariance),
            _verdict(model, f"{table.name}, corrected", corrected, covariance),
        ),
        comparisons=_comparisons(model, np.array(table.alpha), corrected),
    )  # fmt: skip


def _error(x: Array, cad: Array) -> Array:
    """The paper's error [%]: relative to the identified value, not to CAD."""
    return 100 * (x - cad) / x


def _posture(q2: float, q23: float) -> Array:
    return np.array([0.0, q2, q23 - q2])


def _order(model: Model) -> list[int]:
    """Where the constants of `YPP_ALPHA` stand among the model's."""
    return [model.names.index(name) for name in YPP_ALPHA]


def _row(model: Model, q: Array, joint: int, coefficient: int) -> Array:
    """C_i(q) [6] of (10) over `YPP_ALPHA`; `coefficient` of alpha_21 c_2 c_23 in J_11: 1 as (17) prints, 2 by (13)."""
    row = np.array(model.C_rows(q)[joint - 1, _order(model)])
    if joint == 1:
        row[YPP_ALPHA.index("alpha_21")] *= coefficient / 2
    return row


def _rows(model: Model, coefficient: int) -> Array:
    """The rows [6, 6] of all `CELLS`."""
    return np.array([_row(model, _posture(*POSTURES[name]), joint, coefficient) for name, joint in CELLS])


def _solved(model: Model, coefficient: int, J: Array) -> tuple[Array, Array]:
    """alpha [6] in the order of `YPP_ALPHA` from the J_ii [6] of `CELLS`, and its covariance at `NOISE`."""
    joints = [joint - 1 for _, joint in CELLS]
    own = [int(name[len("alpha_")]) - 1 for name in YPP_ALPHA]
    alpha = solve(_rows(model, coefficient), J, NOISE * J, joints, own)
    return alpha.value, alpha.covariance


def _scaled(chain: Chain, scale: float) -> Chain:
    """The chain with mass and inertia of every link `scale` times as large."""
    bodies = [joint.inertia for joint in chain.joints]
    heavier = [Inertia(scale * body.mass, body.com, scale * body.I) for body in bodies]
    return replace(chain, joints=tuple(replace(j, inertia=b) for j, b in zip(chain.joints, heavier, strict=True)))


def _verdict(model: Model, alphas: str, alpha: Array, covariance: Array) -> Verdict:
    factoring = model.factoring
    nearest = consistency(alpha, covariance, factoring.W[_order(model)], factoring.free)

    def margins(a: Array) -> Array:
        return np.array([condition.left - condition.right for condition in ypp_inequalities(a)])

    step = 1e-3 * np.diag(np.abs(alpha))  # the conditions are quadratic: a central difference of any width is exact
    slope = np.array([(margins(alpha + h) - margins(alpha - h)) / (2 * h.sum()) for h in step]).T
    std = np.sqrt(np.einsum("ij,jk,ik->i", slope, covariance, slope))
    broken = [
        Violation(condition.text, float(by), float(by / sigma))
        for condition, by, sigma in zip(ypp_inequalities(alpha), margins(alpha), std, strict=True)
        if not condition.ok
    ]
    return Verdict(alphas, nearest.ok, nearest.distance, nearest.distance <= WITHIN_NOISE, tuple(broken))


def _comparisons(model: Model, printed: Array, corrected: Array) -> tuple[Comparison, ...]:
    places = [(name, joint, _posture(*POSTURES[name]), True) for name, joint in CELLS]
    places += [(f"q2 = 0, q3 = {deg} deg", 1, _posture(0.0, np.deg2rad(deg)), False) for deg in UNSEEN]
    found = []
    for where, joint, q, measured in places:
        a = float(_row(model, q, joint, 1) @ printed)
        b = float(_row(model, q, joint, 2) @ corrected)
        found.append(Comparison(f"J_{joint}{joint}", where, measured, a, b, 100 * (a / b - 1)))
    return tuple(found)
