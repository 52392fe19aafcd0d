"""The examples that README points to compile, run, and give Pinocchio's inertia matrix of the same URDF."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

ROOT = Path(__file__).parents[2]
FOLDER, EXAMPLES = ROOT / "generated/ypp3", ROOT / "tests/examples"
POSTURES = ([0.0, 0.0, 0.0], [0.4, -1.1, 2.3], [-2.0, 0.7, -0.9])

#: alpha_cad.json holds 14 digits; J is a sum of four of them times numbers up to 2.
ROUNDING = 1e-13


def crba(q: list[float]) -> np.ndarray:
    model = pin.buildModelFromUrdf(str(ROOT / "robots/ypp3/ypp3.urdf"))
    upper = np.triu(pin.crba(model, model.createData(), np.array(q)))
    return upper + np.triu(upper, 1).T


def run(*words: object) -> str:
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("examples")
    strict = ("-Wall", "-Wextra", "-Werror", "-O1")
    run("gcc", "-std=c99", *strict, "-c", FOLDER / "symgen_ypp3.c", "-o", folder / "symgen_ypp3.o")
    source = (EXAMPLES / "use_c.cpp", folder / "symgen_ypp3.o")
    run("g++", "-std=c++17", *strict, f"-I{FOLDER}", *source, "-o", folder / "use_c")
    return folder / "use_c"


@pytest.mark.parametrize("q", POSTURES)
def test_the_cpp_example_prints_the_inertia_matrix(program: Path, q: list[float]) -> None:
    printed = np.array([[float(word) for word in line.split()] for line in run(program, *q).splitlines()])
    assert np.abs(printed - crba(q)).max() <= ROUNDING * np.abs(crba(q)).max()


def test_the_cpp_example_says_how_to_call_it(program: Path) -> None:
    done = subprocess.run([str(program), "1"], capture_output=True, text=True, timeout=10, check=False)
    assert done.returncode == 2 and "usage" in done.stderr


def test_the_casadi_example_goes_from_measured_diagonals_to_the_whole_matrix_elsewhere(tmp_path: Path) -> None:
    """The measured numbers are Pinocchio's, 10 % heavier than the URDF: the constants must come from them."""
    plan = json.loads((FOLDER / "plan.json").read_text())
    cells = [(plan["joints"].index(cell["joint"]), cell["q"]) for cell in plan["plan"]["cells"]]
    (tmp_path / "measured.json").write_text(json.dumps([1.1 * crba(q)[i, i] for i, q in cells]))
    q = POSTURES[1]
    J = np.array(json.loads(run(sys.executable, EXAMPLES / "use_casadi.py", FOLDER, *q, tmp_path / "measured.json")))
    # the plan's condition number is below 100
    assert np.abs(J - 1.1 * crba(q)).max() <= 100 * ROUNDING * np.abs(crba(q)).max()


def test_the_casadi_example_runs_without_measurements() -> None:
    J = np.array(json.loads(run(sys.executable, EXAMPLES / "use_casadi.py", FOLDER, *POSTURES[2])))
    assert np.abs(J - crba(POSTURES[2])).max() <= 100 * ROUNDING * np.abs(J).max()
