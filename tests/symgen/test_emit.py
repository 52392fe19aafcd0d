"""What is emitted computes pinocchio's J(q), as CasADi and as C, from any constants, byte for byte the same every time."""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from arms import arm, crba, factoring_of, model_of, random_arm
from chains import build, calibrated, own

from symgen.basis import Factoring, factor
from symgen.chain import PRISMATIC, REVOLUTE, Chain, Inertia
from symgen.emit import (
    functions,
    identified_source,
    identifier,
    save,
    write_functions,
)
from symgen.graph import carriers
from symgen.inertia import monomials, parameter_scale
from symgen.output import of_model, write_all
from symgen.plan import make_plan

#: Every constant has 14 significant digits; a real arm's carriers of alpha are conditioned better than 100.
FOURTEEN_DIGITS = 1e-12

REAL = ["ypp3", "ur5", "panda", "xarm7", "kinova", "z1"]


def draw(chain: Chain, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.5, 1.5, chain.n)


def matrix(function: ca.Function, *arguments: np.ndarray) -> np.ndarray:
    return np.asarray(function(*arguments))


def trigonometric(factoring: Factoring, q: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """J(q) [n, n] summed monomial by monomial, as the equations are printed."""
    J = np.zeros((factoring.chain.n, factoring.chain.n))
    for (i, j), entry in factoring.entries.items():
        J[i, j] = J[j, i] = monomials(entry, q) @ factoring.S[i, j] @ alpha
    return J


@pytest.mark.parametrize("name", REAL)
@pytest.mark.parametrize("believe", [False, True])
def test_every_function_agrees_with_pinocchio(name: str, believe: bool) -> None:
    factoring = factoring_of(name, believe)
    chain, alpha, n = factoring.chain, factoring.alpha_cad, factoring.chain.n
    found = functions(factoring)
    model = model_of(chain)
    for seed in range(3):
        q = draw(chain, seed)
        J = crba(model, q)
        size = FOURTEEN_DIGITS * np.abs(J).max()
        assert matrix(found["J"], q, alpha) == pytest.approx(J, abs=size)
        assert matrix(found["J_diag"], q, alpha).ravel() == pytest.approx(np.diag(J), abs=size)
        assert matrix(found["C_rows"], q) @ alpha[: factoring.d] == pytest.approx(np.diag(J), abs=size)
        assert (matrix(found["regressor"], q) @ alpha).reshape(n, n) == pytest.approx(J, abs=size)


def test_derivatives_are_those_of_pinocchios_matrix() -> None:
    factoring = factoring_of("panda")
    n, model, q = factoring.chain.n, model_of(factoring.chain), draw(factoring.chain, 4)
    found = matrix(functions(factoring)["dJ_dq"], q, factoring.alpha_cad)
    assert found.shape == (n, n * n)
    h = 1e-3  # five-point rule: h^4 |J^(5)| / 30 = 1e-12 of truncation, 1e-16 / h = 1e-13 of rounding
    for k in range(n):
        step = h * np.eye(n)[k]
        ahead, behind = (
            crba(model, q + step) - crba(model, q - step),
            crba(model, q + 2 * step) - crba(model, q - 2 * step),
        )
        assert found[:, k * n : (k + 1) * n] == pytest.approx((8 * ahead - behind) / (12 * h), abs=1e-9)


@pytest.mark.parametrize("name", ["ypp3", "ur5", "kinova", "panda"])
def test_the_fast_form_is_the_trigonometric_form_for_any_constants(name: str) -> None:
    factoring = factoring_of(name, name == "kinova")
    fast = functions(factoring, ["J", "J_diag"])
    for seed in range(3):
        q, alpha = draw(factoring.chain, seed), np.random.default_rng(seed).normal(size=len(factoring.alphas))
        J = trigonometric(factoring, q, alpha)
        for kind, expected in {"J": J, "J_diag": np.diag(J)[:, None]}.items():
            assert matrix(fast[kind], q, alpha) == pytest.approx(expected, abs=FOURTEEN_DIGITS * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(12))
def test_random_arms_with_slides_and_odd_angles(seed: int) -> None:
    chain = random_arm(seed, 1 + seed % 5, right_angles=seed % 2 == 0)
    factoring, q = factor(chain), draw(chain, seed)
    J = crba(model_of(chain), q)
    alpha = np.random.default_rng(seed).normal(size=len(factoring.alphas))
    fast = functions(factoring)["J"]
    assert matrix(fast, q, factoring.alpha_cad) == pytest.approx(J, abs=FOURTEEN_DIGITS * np.abs(J).max())
    J = trigonometric(factoring, q, alpha)
    assert matrix(fast, q, alpha) == pytest.approx(J, abs=FOURTEEN_DIGITS * np.abs(J).max())


@pytest.mark.parametrize("seed", range(4))
def test_zeros_are_believed_in_the_links_own_axes_whatever_the_joint_axis(seed: int) -> None:
    chain = random_arm(seed, 3, right_angles=False)
    rng = np.random.default_rng(seed)
    bodies = [Inertia(1.0, np.array([0.0, y, 0.0]), np.diag(rng.uniform(0.1, 0.15, 3))) for y in rng.normal(size=3)]
    symmetric = [replace(joint, inertia=body) for joint, body in zip(chain.joints, bodies, strict=True)]
    factoring = factor(replace(chain, joints=tuple(symmetric)), believe_zeros=True)
    q, alpha = draw(chain, seed), rng.normal(size=len(factoring.alphas))
    J = trigonometric(factoring, q, alpha)
    assert len(factoring.alphas) < len(factor(chain).alphas)
    assert matrix(functions(factoring)["J"], q, alpha) == pytest.approx(J, abs=FOURTEEN_DIGITS * np.abs(J).max())


@pytest.mark.parametrize(
    ("name", "off"),
    [
        pytest.param(
            name,
            off,
            marks=() if (name, off) in (("panda", 1e-7), ("ur5", 1e-5)) else pytest.mark.bench,
        )
        for name in ("panda", "ur5", "scara4", "arm6", "ypp3_general")
        for off in (3e-3, 1e-5, 1e-7)
    ],
)
def test_an_arm_as_it_was_calibrated_loses_nothing(name: str, off: float) -> None:
    """Its axes are parallel to within `off` [rad]: parameters that tell nothing had carried constants, J(q) up to a third off."""
    chain = calibrated(arm(name) if name in REAL else own(name), off)
    factoring = factor(chain)
    allowed = FOURTEEN_DIGITS + 10.0 * factoring.cost  # what hardly matters was left out
    model, found = model_of(chain), functions(factoring)["J"]
    for seed in range(3):
        q = draw(chain, seed)
        J = crba(model, q)
        assert matrix(found, q, factoring.alpha_cad) == pytest.approx(J, abs=allowed * np.abs(J).max())


@pytest.mark.parametrize("first", ["generic", "right angle"])
@pytest.mark.parametrize(
    "kinds",
    [*(pytest.param(kinds, marks=pytest.mark.bench) for kinds in ((REVOLUTE,), (PRISMATIC,))), (REVOLUTE, PRISMATIC)],
)
def test_rows_of_parallel_axes_have_one_frame_and_are_exact(first: str, kinds: tuple[str, ...]) -> None:
    row = ("parallel", "antiparallel", "antiparallel", "parallel", first, "parallel", "antiparallel")
    for seed in range(2):
        chain = build([(kinds[k % len(kinds)], axis, "generic") for k, axis in enumerate(row)], seed)
        found, model, alpha = functions(factoring := factor(chain)), model_of(chain), factoring.alpha_cad
        q = draw(chain, seed)
        J = crba(model, q)
        assert matrix(found["J"], q, alpha) == pytest.approx(J, abs=FOURTEEN_DIGITS * np.abs(J).max())


def test_pandas_graphs_stay_small() -> None:
    sizes = {name: function.n_instructions() for name, function in functions(factoring_of("panda")).items()}
    assert sizes["J_diag"] <= 300  # seven sines and cosines, 46 inputs, 7 outputs among them; the prototype had 757
    assert sizes["J"] <= 530
    assert sizes["C_rows"] <= 770


def test_graphs_of_parallel_axes_are_smaller_still() -> None:
    sizes = {name: function.n_instructions() for name, function in functions(factoring_of("ur5")).items()}
    assert sizes["J"] <= 370  # 490 where each joint turns what all that follow carry
    assert sizes["dJ_dq"] <= 950  # 1590
    assert sizes["regressor"] <= 1990  # 3300


def test_carriers_are_well_conditioned_and_their_inverse_sparse() -> None:
    factoring = factoring_of("panda")  # all axes z: the turned frames are the link frames
    scale = parameter_scale(factoring.chain)
    columns, inverse = carriers(factoring.W, scale)
    D = len(factoring.alphas)
    assert len(set(columns)) == D
    assert inverse @ factoring.W[:, columns] == pytest.approx(np.eye(D), abs=1e-12)
    assert np.linalg.cond(factoring.W[:, columns] / scale[columns]) < 100
    assert np.count_nonzero(inverse) < 2 * D


# Files ---------------------------------------------------------------------------------------------------------------


def digests(directory: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(directory.iterdir())}


def test_the_files_and_what_they_hold(tmp_path: Path) -> None:
    factoring = factoring_of("ypp3", True)
    names = write_functions(factoring, tmp_path, "ypp3")
    assert sorted(names) == sorted(path.name for path in tmp_path.iterdir())
    assert set(names) == {
        *("J_diag.casadi", "J.casadi", "C_rows.casadi", "dJ_dq.casadi", "regressor.casadi"),
        *("alpha_cad.json", "symgen_ypp3.c", "symgen_ypp3.h"),
    }
    document = json.loads((tmp_path / "alpha_cad.json").read_text())
    table_one = {"alpha_31": 0.0466, "alpha_21": 0.09285, "alpha_22": 0.5072}
    table_one |= {"alpha_11": 0.0434, "alpha_12": 0.4544, "alpha_13": 0.0152}
    assert dict(zip(document["names"], document["value"], strict=True)) == pytest.approx(table_one, rel=1e-9)
    assert document["unit"] == ["kg m2"] * 6
    assert document["formula"][1] == "l_2 m_3 r_y3"
    assert document["lengths"] == {"l_1": 0.15, "l_2": 0.35}
    assert document["urdf_sha256"] == arm("ypp3").sha256
    q = np.array([0.1, -0.4, 0.7])
    J = ca.Function.load(str(tmp_path / "J.casadi"))
    assert (J.name_in(), J.name_out(), J.size_out(0)) == (["q", "alpha"], ["J"], (3, 3))
    assert matrix(J, q, np.array(document["value"])) == pytest.approx(crba(model_of(arm("ypp3")), q), abs=1e-12)
    assert ca.Function.load(str(tmp_path / "C_rows.casadi")).size_out(0) == (3, 6)


def test_all_that_symgen_says_of_an_arm(tmp_path: Path) -> None:
    names = write_all(make_plan(arm("ypp3"), believe_zeros=True), tmp_path)
    assert sorted(names) == sorted(path.name for path in tmp_path.iterdir())
    assert {"plan.json", "equations.md", "equations.tex", "J_diag.casadi"} <= set(names)
    assert "| `joint1` |" in (tmp_path / "equations.md").read_text(encoding="utf-8")


def test_what_another_process_makes_while_the_plan_is_sought_is_the_same(tmp_path: Path) -> None:
    plan = make_plan(arm("ypp3"), effort="draft", meanwhile=of_model)
    for directory, made in (("here", None), ("there", plan.meanwhile)):
        (tmp_path / directory).mkdir()
        write_all(plan, tmp_path / directory, made)
    assert digests(tmp_path / "here") == digests(tmp_path / "there")


def test_a_directory_that_is_not_there_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        write_functions(factoring_of("ypp3", True), tmp_path / "no", "ypp3")


def test_another_process_writes_the_same_bytes(tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    write_functions(factor(arm("ur5")), here, "ur5")
    program = (
        "import sys; from pathlib import Path; sys.path.insert(0, sys.argv[1])\n"
        "from arms import arm; from symgen.basis import factor; from symgen.emit import write_functions\n"
        "write_functions(factor(arm('ur5')), Path(sys.argv[2]), 'ur5')"
    )
    command = [sys.executable, "-c", program, str(Path(__file__).parent), str(there)]
    subprocess.run(command, check=True, env=os.environ | {"PYTHONHASHSEED": "12345"})
    assert digests(here) == digests(there)


@pytest.mark.parametrize("name", ["ypp3", "panda"])
def test_the_last_bit_of_the_processor_does_not_show(name: str, tmp_path: Path) -> None:
    factoring = factoring_of(name)
    noise = 1.0 + 2e-16 * np.random.default_rng(0).integers(-1, 2, factoring.W.shape)
    for directory, W in (("here", factoring.W), ("there", factoring.W * noise)):
        (tmp_path / directory).mkdir()
        write_functions(replace(factoring, W=W), tmp_path / directory, name)
    assert (factoring.W != factoring.W * noise).any()
    assert digests(tmp_path / "here") == digests(tmp_path / "there")


def test_functions_are_written_as_casadi_writes_them_and_a_full_disk_is_told(tmp_path: Path) -> None:
    J = functions(factoring_of("ypp3"))["J"]
    J.save(str(tmp_path / "theirs"))
    save(J, tmp_path / "ours")
    assert (tmp_path / "ours").read_bytes() == (tmp_path / "theirs").read_bytes()
    with pytest.raises(OSError, match="No space left"):
        save(J, Path("/dev/full"))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("panda", "panda"),
        ("my robot (v2)", "my_robot_v2"),
        ("Bras été", "Bras_ete"),
        ("机器人", "robot"),
        ("3dof", "robot_3dof"),
        ("__a__b__", "a_b"),
        ("", "robot"),
        ("../../etc/passwd", "etc_passwd"),
        ("x" * 300, "x" * 48),
    ],
)
def test_any_name_gives_an_identifier(name: str, expected: str) -> None:
    assert identifier(name) == expected


# C -------------------------------------------------------------------------------------------------------------------

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler here")


def library(directory: Path, robot: str, *options: str) -> ctypes.CDLL:
    target = directory / "library.so"
    source = directory / f"symgen_{robot}.c"
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC"]
    subprocess.run(["gcc", *strict, *options, str(source), "-o", str(target), "-lm"], check=True)
    return ctypes.CDLL(str(target))


def call(function: Callable[..., None], shape: tuple[int, ...], *arguments: np.ndarray) -> np.ndarray:
    out = np.full(shape, np.nan)
    pointer = ctypes.POINTER(ctypes.c_double)
    function(*(np.ascontiguousarray(a, dtype=float).ctypes.data_as(pointer) for a in (*arguments, out)))
    return out


@needs_gcc
@pytest.mark.parametrize("name", ["ypp3", "panda"])
def test_the_c_code_compiles_strictly_and_equals_pinocchio(name: str, tmp_path: Path) -> None:
    factoring = factoring_of(name)
    n, D, d = factoring.chain.n, len(factoring.alphas), factoring.d
    write_functions(factoring, tmp_path, name)
    c = library(tmp_path, name)
    alpha = np.array((ctypes.c_double * D).in_dll(c, f"{name}_alpha_cad"))
    q = draw(factoring.chain, 7)
    J = crba(model_of(factoring.chain), q)
    size = FOURTEEN_DIGITS * np.abs(J).max()
    assert call(c[f"{name}_J_diag"], (n,), q, alpha) == pytest.approx(np.diag(J), abs=size)
    assert call(c[f"{name}_J"], (n, n), q, alpha) == pytest.approx(J, abs=size)
    assert call(c[f"{name}_C_rows"], (n, d), q) @ alpha[:d] == pytest.approx(np.diag(J), abs=size)
    assert call(c[f"{name}_regressor"], (n, n, D), q) @ alpha == pytest.approx(J, abs=size)
    expected = matrix(functions(factoring)["dJ_dq"], q, alpha).reshape(n, n, n, order="F")
    assert call(c[f"{name}_dJ_dq"], (n, n, n), q, alpha) == pytest.approx(np.moveaxis(expected, 2, 0), abs=size)


@needs_gcc
def test_hostile_names_give_valid_c_and_cpp(tmp_path: Path) -> None:
    joints = [replace(joint, name=f"*/ #error \\\n ??/ é {k}") for k, joint in enumerate(arm("ypp3").joints)]
    factoring = factor(replace(arm("ypp3"), joints=tuple(joints), sha256=""), believe_zeros=True)
    write_functions(factoring, tmp_path, "*/ 7 Zwerge\n机")
    assert {path.name for path in tmp_path.glob("*.[ch]")} == {"symgen_robot_7_Zwerge.c", "symgen_robot_7_Zwerge.h"}
    library(tmp_path, "robot_7_Zwerge")
    main = '#include "symgen_robot_7_Zwerge.h"\n#include "symgen_robot_7_Zwerge.h"\n'
    main += 'static_assert(ROBOT_7_ZWERGE_D == 6 && ROBOT_7_ZWERGE_ALPHA_21 == 1, "");\n'
    if shutil.which("g++"):
        (tmp_path / "main.cpp").write_text(main)
        subprocess.run(
            ["g++", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fsyntax-only", "main.cpp"], cwd=tmp_path, check=True
        )


def test_c_does_not_ask_whether_its_arrays_are_there(tmp_path: Path) -> None:
    factoring = factoring_of("ypp3", True)
    write_functions(factoring, tmp_path, "ypp3")
    written = (tmp_path / "symgen_ypp3.c").read_text() + identified_source(factoring, np.ones(6), "ypp3")["J.c"]
    assert "arg[1][5]" in written
    assert not re.findall(r"arg\[\d\]\s*\?|res\[\d\]\s*!=", written)


@needs_gcc
def test_two_robots_link_into_one_program(tmp_path: Path) -> None:
    write_functions(factoring_of("ypp3", True), tmp_path, "one")
    write_functions(factoring_of("ypp3", True), tmp_path, "two")
    sources = [str(tmp_path / f"symgen_{name}.c") for name in ("one", "two")]
    subprocess.run(
        ["gcc", "-std=c99", "-shared", "-fPIC", *sources, "-o", str(tmp_path / "both.so"), "-lm"], check=True
    )


def test_the_header_names_its_origin(tmp_path: Path) -> None:
    write_functions(factoring_of("ypp3", True), tmp_path, "ypp3")
    header = (tmp_path / "symgen_ypp3.h").read_text(encoding="ascii")
    assert "Written by symgen 0.1.0 with CasADi 3.8.2 from the URDF with SHA-256" in header
    assert arm("ypp3").sha256 in header
    assert "void ypp3_J_diag(const double q[YPP3_N], const double alpha[YPP3_D], double J_diag[YPP3_N]);" in header
    assert "#define YPP3_N 3 " in header
    assert "YPP3_ALPHA_21 = 1, /* kg m2 */" in header


@pytest.mark.bench
@needs_gcc
def test_pandas_compiled_diagonal_takes_at_most_twice_its_sines_and_cosines(tmp_path: Path) -> None:
    write_functions(factoring_of("panda"), tmp_path, "panda")
    program = r"""
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdio.h>
#include <time.h>
#include "symgen_panda.h"
static double q[1024][PANDA_N], out[PANDA_N], sum;
static double now(void) { struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t); return t.tv_sec + 1e-9 * t.tv_nsec; }
int main(void)
{
  double best[2] = {1e9, 1e9};
  for (int i = 0; i < 1024; i++) for (int j = 0; j < PANDA_N; j++) q[i][j] = 3.0 * sin(1.0 + 7.0 * i + j * j);
  for (int round = 0; round < 200; round++) {
    double t = now();
    for (int i = 0; i < 1024; i++) { panda_J_diag(q[i], panda_alpha_cad, out); sum += out[0]; }
    t = now() - t; if (t < best[0]) best[0] = t;
    t = now();
    for (int i = 0; i < 1024; i++) for (int j = 0; j < PANDA_N; j++) sum += sin(q[i][j]) * cos(q[i][j]);
    t = now() - t; if (t < best[1]) best[1] = t;
  }
  printf("%g %g %g\n", best[0] / 1024 * 1e9, best[1] / 1024 * 1e9, sum);
  return 0;
}
"""
    (tmp_path / "bench.c").write_text(program)
    command = ["gcc", "-std=c99", "-O3", "bench.c", "symgen_panda.c", "-o", "bench", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    diagonal, sines, _ = map(
        float, subprocess.run([tmp_path / "bench"], capture_output=True, check=True).stdout.split()
    )
    print(f"J_diag {diagonal:.0f} ns, of that sines and cosines {sines:.0f} ns")
    assert diagonal < 2.5 * sines
