"""symgen beside its peers: time to derive, size and run time of J(q), all in one run. Writes RESULTS.md. `make bench`.

Peers come from PyPI into .venv-peers on first use. A peer that can not be had here is listed with the reason.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from peers import build, symgen_c
from peers.build import Program, Skipped
from peers.report import Command, Row, Table, document
from peers.robots import Arm, arms, inertia_of, model_of, write_random_arm

from symgen.basis import Factoring, factor
from symgen.emit import functions
from symgen.urdf import load_chain

HERE = Path(__file__).parent
POSTURES, ROUNDS, PROCESSES = 1024, 300, 3
SYMPY_LIMIT = 60.0
RANDOM_JOINTS = 10

#: The command in a fresh process; exit status, CPU time [s] and largest memory [MB] on the last line.
_COMMAND = """
import sys, time
from symgen.cli import main
status = main(sys.argv[1:])
high = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(f"\\n{status} {time.process_time()} {int(high.split()[1]) / 1024}")
"""


def main() -> int:
    """Measures all, prints and writes RESULTS.md; exit status 0 even where a target is missed."""
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        robots = arms(directory)
        say("peers: installing and deriving (SymPy up to a minute an arm)")
        crba = attempt(build.compile_pinocchio)
        graphs = {
            "casadi_kin_dyn": attempt(casadi_kin_dyn, directory, robots),
            "adam": attempt(adam, directory, robots),
        }
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            kane = list(pool.map(lambda arm: attempt(sympy, directory, arm), robots))
        tables = []
        for arm, by_sympy in zip(robots, kane, strict=True):
            found = {
                name: graph if isinstance(graph, Skipped) else graph["arms"][arm.name] for name, graph in graphs.items()
            }
            tables.append(bench(arm, directory, found | {"SymPy mechanics": by_sympy}, crba))
        say("symgen: the command")
        text = document(tables, graphs, commands(robots, directory))
    print(text)
    beside = HERE / ".RESULTS.md"
    beside.write_text(text, encoding="utf-8")
    os.replace(beside, HERE / "RESULTS.md")
    return 0


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def attempt(measure: Callable[..., Any], *arguments: Any) -> Any:
    """What `measure` returns, or the Skipped it raised."""
    try:
        return measure(*arguments)
    except Skipped as reason:
        return reason


def casadi_kin_dyn(directory: Path, robots: list[Arm]) -> dict[str, Any]:
    """Derivation times and C programs of casadi_kin_dyn, by arm. Raises Skipped."""
    python = build.python_with("kindyn", "cmeel-casadi-kin-dyn")
    libraries = next(python.parents[1].glob("lib/python*/site-packages/cmeel.prefix/lib"), None)
    return graphs_of(python, "kindyn.py", directory, robots, LD_LIBRARY_PATH=str(libraries))


def adam(directory: Path, robots: list[Arm]) -> dict[str, Any]:
    """Derivation times and C programs of adam, by arm. Raises Skipped."""
    return graphs_of(build.python_with("adam", "adam-robotics[casadi]"), "adam_casadi.py", directory, robots)


def graphs_of(python: Path, script: str, directory: Path, robots: list[Arm], **more: str) -> dict[str, Any]:
    """What a peer's script says of all arms, run by the peer's own Python. Raises Skipped."""
    command = [str(python), str(HERE / "peers" / script), str(directory), *(str(arm.peers_file) for arm in robots)]
    return json.loads(build.run(command, 120, **more).splitlines()[-1])


def sympy(directory: Path, arm: Arm) -> dict[str, Any]:
    """Derivation time and C program of SymPy mechanics for one arm. Raises Skipped."""
    numbers = directory / f"{arm.name}.json"
    numbers.write_text(json.dumps(arm.joints))
    script = HERE / "peers/sympy_kane.py"
    return json.loads(build.run([sys.executable, str(script), str(directory), str(numbers)], SYMPY_LIMIT))


def bench(arm: Arm, directory: Path, peers: dict[str, Any], crba: Path | Skipped) -> Table:
    """All programs of one arm: compiled, run in turns and judged by Pinocchio."""
    say(f"{arm.name}: symgen, compiling, running")
    own = stages(arm)
    factoring, rows = symgen(arm, directory, own["seconds"])
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for of_peer in pool.map(lambda item: peer(item[0], item[1], directory, arm.model.nv), peers.items()):
            rows += of_peer
    rows.append(pinocchio_cpp(arm, directory, crba))
    floor = build.compile_c(HERE / "peers/floor.c", directory / f"floor_{arm.name}.so", f"-DN={arm.model.nv}")
    rows.append(Row("sine and cosine of every joint", "", program=Program(ctypes.CDLL(str(floor)), 2 * arm.model.nv)))
    q = arm.postures(POSTURES, seed=1)
    binding = take_turns([row.program for row in rows if row.program], arm, q)
    judge(rows, arm, q, factoring)
    d, D = factoring.d, len(factoring.alphas)
    return Table(arm.name, tuple(rows), binding, d, D, own["seconds"], own["cpu"], own["runs"], own["amplification"])


def stages(arm: Arm) -> dict[str, Any]:
    """Seconds of each stage of symgen, imports apart, of the process that took least CPU; and what its plan promises."""
    command = [sys.executable, str(HERE / "peers/stages.py"), str(arm.urdf)]
    return min((json.loads(build.run(command, 120)) for _ in range(PROCESSES)), key=lambda run: run["cpu"])


def symgen(arm: Arm, directory: Path, seconds: dict[str, float]) -> tuple[Factoring, list[Row]]:
    """The factoring of an arm, and its three functions compiled from the C file that symgen writes."""
    factoring = factor(load_chain(arm.urdf))
    graphs = functions(factoring)
    source = symgen_c.write(factoring, directory, arm.name)
    library = build.compile_c(source, source.with_suffix(".so"))
    loaded, n = ctypes.CDLL(str(library)), arm.model.nv
    derive = seconds["parse"] + seconds["derive"] + seconds["functions"]
    rows = []
    for name, size in {"J_diag": n, "J": n * n, "C_rows": n * factoring.d}.items():
        machine = build.machine_instructions(library, f"{arm.name}_{name}")
        program = Program(loaded, size, f"run_{name}", factoring.alpha_cad)
        rows.append(Row("symgen", name, derive, graphs[name].n_instructions(), machine, program))
    return factoring, rows


def peer(name: str, found: dict[str, Any] | Skipped, directory: Path, n: int) -> list[Row]:
    """The programs a peer wrote for one arm, compiled; or one row that says why there is none."""
    if isinstance(found, Skipped):
        return [Row(name, "J", reason=str(found))]
    rows = []
    for result, program in found["programs"].items():
        try:
            source = directory / program["source"]
            library = build.compile_c(source, source.with_suffix(".so"))
            machine = build.machine_instructions(library, program["symbol"])
            compiled = Program(ctypes.CDLL(str(library)), n if result == "J_diag" else n * n)
            rows.append(Row(name, result, found["derive"], program["operations"], machine, compiled))
        except Skipped as reason:
            rows.append(Row(name, result, found["derive"], program["operations"], reason=str(reason)))
    return rows


def pinocchio_cpp(arm: Arm, directory: Path, crba: Path | Skipped) -> Row:
    """Pinocchio's C++ CRBA with the arm's numbers; a copy of the library for each arm, because it holds the model."""
    if isinstance(crba, Skipped):
        return Row("Pinocchio C++ CRBA", "J", reason=str(crba))
    own = directory / f"pinocchio_{arm.name}.so"
    own.write_bytes(crba.read_bytes())
    library = ctypes.CDLL(str(own))
    for joint in arm.joints:
        numbers = [np.array(joint[key], dtype=float) for key in ("axis", "R", "p", "com", "I")]
        axis, R, p, com, I = (build.pointer(values) for values in numbers)
        library.add_joint(axis, R, p, ctypes.c_double(joint["mass"]), com, I)
    return Row("Pinocchio C++ CRBA", "J", program=Program(library, arm.model.nv**2, upper=True))


def take_turns(programs: list[Program], arm: Arm, q: np.ndarray) -> float:
    """Runs each program once a round, so that a busy moment meets all alike; returns ns a call of Pinocchio's binding."""
    data = arm.model.createData()
    best = np.inf
    for k in range(ROUNDS):
        for program in programs:
            program(q)
        if k % 10 == 0:
            start = time.perf_counter_ns()
            for posture in q:
                pin.crba(arm.model, data, posture)
            best = min(best, (time.perf_counter_ns() - start) / len(q))
    return best


def judge(rows: list[Row], arm: Arm, q: np.ndarray, factoring: Factoring) -> None:
    """Notes for each program its largest error against Pinocchio on the same file, relative to the largest J_ij.

    symgen's is also judged on the arm as it snapped it, where it snapped an angle.
    """
    snapped = inertia_of(model_of(factoring.chain), q) if factoring.chain.snapped else None
    for row in rows:
        if row.program is not None and row.result:
            found = result_of(row.program, row.result, q, factoring)
            row.error = error(found, inertia_of(arm.model, q))
            if row.tool == "symgen" and snapped is not None:
                row.error_snapped = error(found, snapped)


def result_of(program: Program, result: str, q: np.ndarray, factoring: Factoring) -> np.ndarray:
    """J(q) [count, n, n] as far as a program gives it: of the others only the diagonal, all else not a number."""
    n = q.shape[1]
    found = program(q)
    if result == "C_rows":
        found = found.reshape(-1, n, factoring.d) @ factoring.alpha_cad[: factoring.d]
    if result != "J":
        return np.where(np.eye(n), found[:, :, None], np.nan)
    J = found.reshape(-1, n, n)
    return np.where(np.triu(np.ones((n, n))), J.transpose(0, 2, 1), np.nan) if program.upper else J


def error(found: np.ndarray, truth: np.ndarray) -> float:
    """Largest difference where there is a number, relative to the largest entry."""
    return float(np.nanmax(np.abs(found - truth)) / np.abs(truth).max())


def commands(robots: list[Arm], directory: Path) -> list[Command]:
    """The command `symgen URDF`, imports and all: for each arm, with files written, and for a random arm of many joints."""
    files = {arm.name: arm.urdf for arm in robots}
    random = write_random_arm(directory / "random.urdf", RANDOM_JOINTS, seed=0)
    calls = [(f"symgen {name}.urdf", [str(urdf)]) for name, urdf in files.items()]
    calls.append(("symgen panda.urdf -o DIR", [str(files["panda"]), "-o", str(directory / "out")]))
    calls.append((f"symgen random{RANDOM_JOINTS}.urdf -o DIR", [str(random), "-o", str(directory / "random")]))
    out = []
    for label, arguments in calls:
        runs = []
        for _ in range(PROCESSES):
            start = time.perf_counter()
            found = build.run([sys.executable, "-c", _COMMAND, *arguments], 120).split()[-3:]
            runs.append((time.perf_counter() - start, float(found[1]), float(found[2])))
        wall, cpu, memory = np.min(runs, axis=0)
        out.append(Command(label, wall, cpu, memory))
    return out


if __name__ == "__main__":
    sys.exit(main())
