"""What is asked of symgen for one URDF, as plan.json remembers it, and the plan that answers it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from symgen import alternatives, plan
from symgen.chain import Array, Chain
from symgen.errors import PlanError, SymgenError
from symgen.postures import Effort
from symgen.robot import Robot, load_robot
from symgen.urdf import turned
from symgen.urdf_tree import read_tree
from symgen.urdf_xml import number

PLAN_FILE = "plan.json"

#: Nobody measures more spare cells than this; each takes a search.
_MOST_SPARE = 500


@dataclass(frozen=True)
class Request:
    """The options of the command line that shape a plan, as they were written; what is None, and where joints stand that `at`
    does not name, is as robot.toml says.

    `at` "name=value,..", `grid` "15deg,5mm", `postures` a file (see `alternatives.given`).
    """

    base: str | None = None
    tip: str | None = None
    at: str | None = None
    believe_zeros: bool | None = None
    snap: bool = True
    spare: int | None = None
    refine: bool = False
    draft: bool = False
    feasible: bool = True
    grid: str | None = None
    triangular: bool = False
    postures: str | None = None
    columns: bool = False

    @property
    def effort(self) -> Effort:
        return "full" if self.refine else "draft" if self.draft else "quick"

    def document(self) -> dict[str, Any]:
        """What differs from the default, for plan.json. A file of postures is not named: its cells are in plan.json itself."""
        given = {name: value for name, value in asdict(self).items() if value != getattr(Request(), name)}
        return given | ({"postures": PLAN_FILE} if "postures" in given else {})


def recorded(directory: Path) -> Request:
    """Returns the request that the plan.json in a directory written by symgen -o answers.

    Raises PlanError naming the file, where there is none, or it is no plan.json.
    """
    path = directory / PLAN_FILE
    try:
        options = json.loads(path.read_text(encoding="utf-8")).get("options", {})
        kinds = {field.name: str(field.type).split(" | ")[0] for field in fields(Request)}
        wrong = [name for name, value in options.items() if kinds.get(name) != type(value).__name__]
    except FileNotFoundError:
        raise PlanError(f"{path}: no such file; expected a directory that symgen -o wrote") from None
    except (OSError, ValueError, AttributeError, RecursionError) as error:
        raise PlanError(f"{path}: not a plan file: {type(error).__name__}; run symgen again") from None
    if wrong:
        raise PlanError(
            f"{path}: options: {wrong[0]!r} = {options[wrong[0]]!r}; expected options of symgen; run it again"
        )
    return Request(**options | ({"postures": str(path)} if "postures" in options else {}))


def urdf_of(directory: Path) -> Path:
    """Returns robots/<name>/<name>.urdf for a directory generated/<name>. PlanError, asking for the URDF, if there is none."""
    here = directory.resolve()
    path = here.parent.parent / "robots" / here.name / f"{here.name}.urdf"
    if not path.is_file():
        raise PlanError(f"{directory}: no {path} to go with it; expected the URDF as an argument too")
    return path


def chain_for(urdf: Path, request: Request) -> tuple[Chain, Chain | None]:
    """Returns the arm asked for, as snapped and (if that differs) as written. Raises UrdfError, RobotError, SymgenError."""
    robot, given = _robot_of(urdf), _frozen_at(request.at)
    chain, unsnapped = plan.chain_of_file(
        urdf,
        snap=request.snap,
        base=request.base or (robot.base if robot else None),
        tip=request.tip or (robot.tip if robot else None),
        at={**(robot.at if robot else {}), **given},
    )
    if idle := [name for name in given if name not in chain.frozen]:
        raise SymgenError(
            f"--at {request.at!r}: {idle[0]!r} is neither behind link {chain.base_link!r} nor before it; "
            "expected a joint that matters"
        )
    return chain, unsnapped


def model_for(urdf: Path, request: Request) -> plan.Model:
    """Returns the model of the arm asked for; errors as `chain_for`."""
    return plan.make_model(chain_for(urdf, request)[0], believe_zeros=_believe_zeros(_robot_of(urdf), request))


def plan_for(urdf: Path, request: Request, meanwhile: Callable[[plan.Model], Any] | None = None) -> plan.Plan:
    """Returns the plan that answers a request; what it says not, the robot.toml beside the URDF says. `meanwhile` as of
    `plan.make_plan`.

    Raises SymgenError (NoPlanError where there is no plan of the kind asked for) and OSError.
    """
    start = time.perf_counter()
    if request.spare is not None and not 0 <= request.spare <= _MOST_SPARE:
        raise SymgenError(f"--spare {request.spare}: expected 0 or more, and at most {_MOST_SPARE}")
    robot = _robot_of(urdf)
    drives = robot.drives if robot else ()
    chain, unsnapped = chain_for(urdf, request)
    if robot:
        robot.check(chain)
    choose = _chooser(request, chain)
    parsed = time.perf_counter() - start
    result = plan.make_plan(
        chain,
        unsnapped=unsnapped,
        believe_zeros=_believe_zeros(robot, request),
        rotor=plan.reflected_inertia(chain, drives),
        spare=request.spare,
        effort=request.effort,
        feasible=plan.feasible_postures(chain, urdf, drives, _gravity(chain, robot)) if request.feasible else None,
        choose=choose,
        columns=request.columns,
        meanwhile=meanwhile,
    )
    document: Mapping[str, Any] = {**result.document, "options": request.document()}
    return replace(result, document=document, seconds={"parse": parsed, **result.seconds})


def _chooser(request: Request, chain: Chain) -> alternatives.Chooser | None:
    """What chooses the cells, where it is not `postures.plan`."""
    kinds = [f"--{name}" for name in ("postures", "grid", "triangular") if getattr(request, name)]
    if request.refine and request.draft:
        raise SymgenError("--refine and --draft: expected one of them at most")
    if len(kinds) > 1:
        raise SymgenError(f"{' and '.join(kinds)}: expected one of them at most")
    efforts = [f"--{name}" for name in ("refine", "draft") if getattr(request, name) and not request.grid]
    spare = ["--spare"] if request.spare is not None and request.postures is not None else []
    if kinds and (unused := [*efforts, *spare]):
        raise SymgenError(f"{kinds[0]}: expected without {unused[0]}, which has no effect")
    if request.postures is not None:
        selection = alternatives.given(request.postures, chain)
        return lambda rows, wider, feasible: selection
    if request.grid is not None:
        alternatives.grid_steps(request.grid, chain)  # a bad text is refused before the work
        return partial(alternatives.gridded, grid=request.grid, spare=request.spare, effort=request.effort)
    return partial(alternatives.triangular, spare=request.spare) if request.triangular else None


def _gravity(chain: Chain, robot: Robot | None) -> Array:
    """Gravity [3, m/s2] in the axes of the arm's base link: robot.toml gives it in those of its own base; without one it is
    along -z of the root link."""
    if robot is None:
        return turned(chain, (0.0, 0.0, -9.81))
    return turned(chain, robot.gravity, robot.base or read_tree(chain.source).meant.base)


def _believe_zeros(robot: Robot | None, request: Request) -> bool:
    return bool(robot and robot.believe_zeros) if request.believe_zeros is None else request.believe_zeros


def _robot_of(urdf: Path) -> Robot | None:
    """The robot.toml beside a URDF, where there is one that speaks of it."""
    beside = urdf.parent / "robot.toml"
    robot = load_robot(beside) if beside.is_file() else None
    return robot if robot is not None and robot.urdf.resolve() == urdf.resolve() else None


def _frozen_at(text: str | None) -> dict[str, float]:
    out: dict[str, float] = {}
    for item in text.split(",") if text else ():
        name, _, value = item.rpartition("=")
        if not name.strip():
            raise SymgenError(f"--at {item!r}: expected NAME=VALUE with a number in rad or m")
        if name.strip() in out:
            raise SymgenError(f"--at {text!r}: {name.strip()!r} stands there twice; expected once")
        out[name.strip()] = number(value, f"--at {item!r}")
    return out
