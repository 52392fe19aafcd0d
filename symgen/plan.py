"""The contract between symgen and whoever measures: the model J = C alpha, the posture plan, and both as one JSON file."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symgen import kinematics, postures, regressor
from symgen.alternatives import Chooser, misfit
from symgen.basis import Entries, Factoring, derived, factor
from symgen.cells import Cells, Rows
from symgen.chain import Array, Chain
from symgen.columns import plan_columns
from symgen.errors import PlanError
from symgen.feasible import Feasible
from symgen.forked import beside
from symgen.formula import alpha_cad, decade, digits, known
from symgen.judgement import infeasible, judged, undetermined
from symgen.notation import entry_text
from symgen.robot import Drive, Robot
from symgen.snapping import snapping_costs
from symgen.urdf import load_chain, parse_chain, with_arm

FORMAT, VERSION = "symgen-plan", 1


@dataclass(frozen=True)
class Cell:
    """One measurement: excite `joint` with the arm at `q` [n, rad or m]. A `spare` cell is kept for validation."""

    joint: str
    q: Array
    spare: bool = False


@dataclass(frozen=True)
class Model:
    """J(q) of one arm as a linear function of its constants alpha: numbers, at any posture.

    `factoring` holds the algebra; `wider` the same without believed zeros. alpha [D] are first the `d` constants that
    the diagonal shows, then those of the off-diagonals.
    """

    chain: Chain
    factoring: Factoring
    wider: Factoring

    @property
    def d(self) -> int:
        return self.factoring.d

    @property
    def names(self) -> tuple[str, ...]:
        return self.factoring.names

    @property
    def units(self) -> tuple[str, ...]:
        return tuple(alpha.unit for alpha in self.factoring.alphas)

    @property
    def alpha_cad(self) -> Array:
        """The constants [D] of the declared robot."""
        return self.factoring.alpha_cad

    @property
    def alpha_joint(self) -> tuple[int, ...]:
        """For each constant the joint (from 0) whose J_ii shows it first, tip to base; for the rest the lower joint."""
        return tuple(alpha.i for alpha in self.factoring.alphas)

    def C_rows(self, q: Array) -> Array:
        """Rows C_i(q) of eq. (10) over the shared constants: [.., n, d] at postures q [.., n]."""
        return regressor.C_rows(self.factoring, q)

    def J_rows(self, q: Array) -> Array:
        """The regressor of the whole matrix: J(q) = J_rows(q) . alpha, [.., n, n, D] at postures q [.., n]."""
        return regressor.J_rows(self.factoring, q)

    def J(self, q: Array, alpha: Array) -> Array:
        """The inertia matrix [.., n, n, kg m2] at postures q [.., n] for constants alpha [D]."""
        J: Array = self.J_rows(q) @ alpha
        return J

    def J_cad(self, q: Array) -> Array:
        """The declared robot's inertia matrix [.., n, n] at postures q [.., n]."""
        return kinematics.inertia_matrix(self.chain, q)

    def gravity_stiffness_rows(self, q: Array, gravity: ArrayLike) -> Array:
        """Rows over the bodies' parameters phi [10 n]: dG_i/dq_k = rows[.., i, k] . phi, [.., n, n, 10 n] at q [.., n].

        `gravity` [3, m/s2] in the base frame. Columns of parameters believed to be zero are zero.
        """
        flat = np.asarray(q, dtype=float).reshape(-1, self.chain.n)
        rows = kinematics.gravity_stiffness_rows(self.chain, flat, np.asarray(gravity, dtype=float))
        return (rows * self.factoring.free).reshape(*np.shape(q)[:-1], *rows.shape[1:])

    def torque_rows(self, q: Array, v: Array, a: Array, gravity: ArrayLike) -> Array:
        """Rows over the bodies' parameters phi of the joint torques of the rigid arm: see `kinematics.torque_rows`."""
        return kinematics.torque_rows(self.chain, q, v, a, np.asarray(gravity, dtype=float))

    def random_postures(self, count: int, rng: np.random.Generator) -> Array:
        """Postures [count, n], uniform within the joint limits."""
        low, high = self.chain.limits.T
        return low + (high - low) * rng.random((count, self.chain.n))


def make_model(chain: Chain, *, believe_zeros: bool = False, entries: Entries | None = None) -> Model:
    """Returns the model of a chain; `believe_zeros` takes exact zeros in it as known, `entries` are those of `basis.derived`."""
    entries = entries or derived(chain)
    wider = factor(chain, entries=entries)
    return Model(chain, factor(chain, believe_zeros=True, entries=entries) if believe_zeros else wider, wider)


@lru_cache(maxsize=8)
def model_of_urdf(text: str, joints: tuple[str, ...], *, believe_zeros: bool = False) -> Model:
    """Returns the model of the arm in a URDF text whose driven joints, base to tip, are `joints`; others are frozen where the text
    says (`urdf.with_arm`), else at 0.

    Raises UrdfError, or PlanError if `joints` are not a base-to-tip run of that arm.
    """
    chain = parse_chain(text, where="the campaign's URDF")
    if set(joints) != set(chain.names):
        chain = parse_chain(text, where="the campaign's URDF", at=dict.fromkeys(set(chain.names) - set(joints), 0.0))
    if joints != (arm := chain.names):
        raise PlanError(f"joints {', '.join(joints)}: not the moving joints of the URDF, base to tip: {', '.join(arm)}")
    return make_model(chain, believe_zeros=believe_zeros)


@dataclass(frozen=True)
class Plan:
    """What symgen found about an arm and where to measure it; `document` holds the keys of plan.json, `seconds` the time taken,
    `meanwhile` what was asked to be made of the model besides."""

    model: Model
    cells: tuple[Cell, ...]
    document: Mapping[str, Any]
    seconds: Mapping[str, float]
    meanwhile: Any = None

    def write(self, path: Path) -> None:
        """Writes plan.json at `path`."""
        path.write_text(json.dumps(self.document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def load_plan_cells(path: str | Path, model: Model) -> tuple[Cell, ...]:
    """Returns the cells of a plan.json written for this model's arm.

    Raises PlanError if the file is no plan, of a later version, of another URDF, or has a cell that is none of this arm.
    """
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
        if document["format"] != FORMAT or document["version"] > VERSION:
            raise PlanError(
                f"{path}: format {document['format']} {document['version']}; expected {FORMAT} up to {VERSION}"
            )
        if document["urdf_sha256"] != model.chain.sha256:
            raise PlanError(f"{path}: made for another URDF (sha256 {document['urdf_sha256'][:12]}); run symgen again")
        cells = tuple(
            Cell(cell["joint"], np.array(cell["q"], dtype=float), bool(cell["spare"]))
            for cell in document["plan"]["cells"]
        )
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise PlanError(f"{path}: not a plan file: {type(error).__name__} {error}; run symgen again") from None
    for k, cell in enumerate(cells):
        if wrong := misfit(model.chain, cell.joint, cell.q):
            raise PlanError(f"{path}: cell {k + 1}: joint {cell.joint!r} at q of {cell.q.size}; {wrong}")
    return cells


def make_plan(
    chain: Chain,
    *,
    unsnapped: Chain | None = None,
    believe_zeros: bool = False,
    rotor: Array | None = None,
    spare: int | None = None,
    effort: postures.Effort = "quick",
    feasible: Feasible | None = None,
    choose: Chooser | None = None,
    columns: bool = False,
    meanwhile: Callable[[Model], Any] | None = None,
) -> Plan:
    """Returns the plan of an arm: ranks, constants, what the diagonals can not see, and the cells to measure.

    `unsnapped` is the same chain with the file's own angles, to state what snapping costs; `rotor` [n, kg m2] the
    reflected motor inertias N^2 J_m; `spare`, `effort` and `feasible` as in `postures.plan`, which chooses the cells
    unless `choose` does (see `alternatives`). Cells of `choose` may be too few, or infeasible: the document says so.
    With `columns` it holds a second plan, whose runs tell a column of J(q) each (`columns.plan_columns`). While the cells are
    chosen another process does `meanwhile` with the model; the result must pickle.
    """
    seconds = {}
    start = time.perf_counter()
    entries = derived(chain)
    seconds["derive"] = time.perf_counter() - start
    start = time.perf_counter()
    model = make_model(chain, believe_zeros=believe_zeros, entries=entries)
    seconds["rank"] = time.perf_counter() - start
    start = time.perf_counter()
    rows = Rows(model.factoring, np.zeros(chain.n) if rotor is None else rotor)

    def chosen() -> postures.Design:
        if choose is not None:
            return judged(rows, *choose(rows, model.wider, feasible), feasible)
        return postures.plan(
            model.factoring, model.wider, rotor=rotor, spare=spare, effort=effort, feasible=feasible, rows=rows
        )

    design, made = (chosen(), None) if meanwhile is None else beside(chosen, partial(meanwhile, model))
    seconds["plan"] = time.perf_counter() - start
    cells = tuple(
        Cell(chain.names[i], q, bool(extra)) for i, q, extra in zip(design.joint, design.q, design.spare, strict=True)
    )
    document = _document(model, design, cells, unsnapped)
    planned = Cells(design.joint, design.q)
    rank, open_ = undetermined(rows, planned[~design.spare])
    refused = [
        {"cell": k + 1, "joint": cells[k].joint, "why": why} for k, why in infeasible(chain, planned, feasible).items()
    ]
    document["plan"] |= {"rank": rank, "open": list(open_), "infeasible": refused}
    document["plan"]["feasible"] = feasible.notes if feasible is not None else None
    among = "cells within the joint limits" if feasible is None else "cells the arm may hold"
    document["plan"]["d_efficiency_among"] = f"{among}, as far as the search found them"
    if columns:
        start = time.perf_counter()
        document["column_plan"] = _column_plan(model, rotor, feasible)
        seconds["column_plan"] = time.perf_counter() - start
    return Plan(model, cells, document, seconds, made)


def _column_plan(model: Model, rotor: Array | None, feasible: Feasible | None) -> dict[str, Any]:
    """The plan of column runs: how many, the worst amplification of a diagonal and of any entry of J(q), and the runs."""
    design = plan_columns(model.factoring, rotor=rotor, feasible=feasible)
    names = model.chain.names
    return {
        "runs": len(design.joint),
        "amplification_diagonal": digits(float(design.amplification.diagonal().max()), 4),
        "amplification": digits(float(design.amplification.max()), 4),
        "error_model": "each J_ji read from a run that excites i with sigma_ij = sqrt(sigma_i sigma_j)",
        "cells": [
            {"joint": names[i], "q": [digits(value, 12) for value in q]}
            for i, q in zip(design.joint, design.q, strict=True)
        ],
    }


def _document(
    model: Model, design: postures.Design, cells: tuple[Cell, ...], unsnapped: Chain | None
) -> dict[str, Any]:
    chain, factoring = model.chain, model.factoring
    kept, dropped = factoring.singular_value_gap
    return {
        "format": FORMAT,
        "version": VERSION,
        "robot": chain.name,
        "urdf_sha256": chain.sha256,
        "joints": list(chain.names),
        "types": [joint.type for joint in chain.joints],
        "base": chain.base_link,
        "tip": chain.tip_link,
        "rank_per_joint": list(factoring.rank_per_joint),
        "new_per_joint": list(factoring.new_per_joint),
        "shared_rank": factoring.d,
        "monomials_per_joint": [len(factoring.entries[i, i].digits) for i in range(chain.n)],
        "full_inertia_rank": len(factoring.alphas),
        "unseen": _unseen(factoring),
        "singular_value_gap": [digits(kept, 3), decade(dropped)],
        **({"dropped": {"cost": digits(factoring.cost, 2)}} if factoring.cost else {}),
        "snapped": _snapped(chain, unsnapped),
        "frozen": dict(chain.frozen),
        "lumped": [list(pair) for pair in chain.lumped],
        "believed_zeros": list(factoring.believed),
        "alpha": {
            "names": list(factoring.names),
            "unit": [alpha.unit for alpha in factoring.alphas],
            "cad": alpha_cad(factoring),
        },
        "plan": {
            "measurements": int((~design.spare).sum()),
            "spare": int(design.spare.sum()),
            "error_model": "sigma(J_ii) proportional to J_ii + N^2 J_m (N^2 J_m = 0 where the drive is not known)",
            "amplification_over": "evenly spread postures of the whole joint limits, feasible or not",
            "amplification_per_joint": [known(value, 4) for value in design.amplification],
            "amplification_p999_per_joint": [known(value, 4) for value in design.amplification_p999],
            "d_efficiency_at_least": float(np.floor(design.d_efficiency * 1e3) / 1e3),
            "d_efficiency_with_spare_at_least": float(np.floor(design.d_efficiency_all * 1e3) / 1e3),
            "cond_per_joint": [known(value, 4) for value in design.cond],
            "cond_scaling": "rows of one joint's cells over sigma, columns whitened over the workspace",
            "cells": [
                {"joint": cell.joint, "q": [digits(value, 12) for value in cell.q], "spare": cell.spare}
                for cell in cells
            ],
        },
    }


def _unseen(factoring: Factoring) -> list[dict[str, Any]]:
    """What J(q) holds that no J_ii shows: by entry, and the measurement that shows it."""
    counts: dict[tuple[int, int], int] = {}
    for alpha in factoring.alphas[factoring.d :]:
        counts[alpha.i, alpha.j] = counts.get((alpha.i, alpha.j), 0) + 1
    return [
        {
            "entry": entry_text(factoring.chain.n, i, j),
            "directions": count,
            "measure": f"cross response {i + 1} -> {j + 1}",
            "postures": count,
            "alpha": [alpha.name for alpha in factoring.alphas if (alpha.i, alpha.j) == (i, j)],
        }
        for (i, j), count in counts.items()
    ]


def _snapped(chain: Chain, unsnapped: Chain | None) -> list[dict[str, Any]]:
    """Each snapped angle with its cost (`snapping.snapping_costs`)."""
    if unsnapped is None:
        return []
    return [
        {"joint": snap.joint, "from": snap.found, "to": snap.text, "cost": digits(cost, 2)}
        for snap, cost in zip(chain.snapped, snapping_costs(chain, unsnapped), strict=True)
    ]


def reflected_inertia(chain: Chain, drives: Sequence[Drive]) -> Array:
    """Returns N^2 J_m of each joint [n, kg m2 or kg], zero where `drives` say nothing of it."""
    known = {drive.joint: drive.N**2 * drive.J_m for drive in drives}
    return np.array([known.get(name, 0.0) for name in chain.names])


def feasible_postures(chain: Chain, urdf: Path, drives: Sequence[Drive], gravity: ArrayLike) -> Feasible:
    """Returns what tells the postures the arm may hold: the drives' limits (or the URDF's effort) and its collision shapes."""
    known = {drive.joint: abs(drive.N) * drive.tau_max for drive in drives}
    return Feasible(chain, urdf, [known.get(name, np.inf) for name in chain.names], gravity)


def plan_of_robot(robot: Robot) -> Plan:
    """Returns the plan of a robot directory, quickly made, within its motors and its collision shapes."""
    chain = chain_of_robot(robot)
    return make_plan(
        chain,
        believe_zeros=robot.believe_zeros,
        rotor=reflected_inertia(chain, robot.drives),
        feasible=feasible_postures(chain, robot.urdf, robot.drives, robot.gravity),
    )


def chain_of_file(path: str | Path, **options: Any) -> tuple[Chain, Chain | None]:
    """Returns the chain of a URDF file as snapped, and as written (None where nothing was snapped or snap is off)."""
    chain = load_chain(path, **options)
    return chain, load_chain(path, **(options | {"snap": False})) if chain.snapped else None


def chain_of_robot(robot: Robot) -> Chain:
    """Returns the arm of a robot directory; each of its joints has its drive.

    Raises UrdfError, or RobotError naming the joint whose drive is missing or wrong (`Robot.check`).
    """
    chain = load_chain(robot.urdf, base=robot.base, tip=robot.tip, at=robot.at)
    for name in chain.names:
        robot.drive(name)
    robot.check(chain)
    return chain


def text_of_arm(chain: Chain) -> str:
    """Returns the arm's URDF text, from which anybody who parses it gets the same arm (`urdf.with_arm`)."""
    return with_arm(chain)


def write_J(model: Model, alpha: Array, path: Path) -> None:
    """Writes the CasADi function J (q [n]) -> [n, n] with the constants alpha [D] put in."""
    import casadi as ca

    from symgen.emit import functions, save

    q = ca.SX.sym("q", model.chain.n)
    J = functions(model.factoring, ["J"])["J"](q, ca.DM(alpha))
    beside = path.with_name(f".{path.name}")
    save(ca.Function("J", [q], [J], ["q"], ["J"]), beside)
    beside.replace(path)


def source_of_J(model: Model, alpha: Array, robot_name: str) -> dict[str, str]:
    """Returns the same function as C99: the text of J.h and J.c (see `emit.identified_source`)."""
    from symgen.emit import identified_source

    return identified_source(model.factoring, alpha, robot_name)
