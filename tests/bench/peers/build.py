"""Environments for peers that can not share ours, C programs compiled all alike, and their times taken turn by turn."""

from __future__ import annotations

import ctypes
import hashlib
import os
import re
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import casadi
import numpy as np
import pinocchio as pin

ENVIRONMENTS = Path(__file__).parents[3] / ".venv-peers"
FLAGS = ["-O3", "-march=native", "-fPIC", "-shared"]

_INCLUDE = Path(pin.__file__).parents[4] / "include"
_EIGEN = Path(casadi.__file__).parent / "include/eigen3"
#: What Pinocchio's own CMake files define.
_PINOCCHIO = [
    "-std=c++17",
    "-DNDEBUG",
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "-DBOOST_FUSION_INVOKE_MAX_ARITY=12",
    f"-I{_INCLUDE}",
    f"-I{_EIGEN}",
]

_DOUBLES = ctypes.POINTER(ctypes.c_double)


class Skipped(Exception):
    """A peer that can not be measured here; the text says why."""


def python_with(name: str, requirement: str) -> Path:
    """Returns the Python of the environment `name` with `requirement` installed, made on first use. Raises Skipped."""
    directory = ENVIRONMENTS / name
    python, done = directory / "bin/python", directory / "installed"
    if not done.is_file() or done.read_text() != requirement:
        ENVIRONMENTS.mkdir(exist_ok=True)
        (ENVIRONMENTS / ".gitignore").write_text("*\n")
        shutil.rmtree(directory, ignore_errors=True)
        run([sys.executable, "-m", "venv", str(directory)], 120)
        run([str(python), "-m", "pip", "install", "-q", "--disable-pip-version-check", requirement], 600)
        done.write_text(requirement)
    return python


def run(command: list[str], limit: float, **more: str) -> str:
    """Returns what a command prints; `more` environment variables. Raises Skipped after `limit` seconds or on failure."""
    try:
        done = subprocess.run(
            command, check=False, capture_output=True, text=True, timeout=limit, env=os.environ | more
        )
    except subprocess.TimeoutExpired:
        raise Skipped(f"not finished in {limit:.0f} s") from None
    except OSError as error:
        raise Skipped(f"{command[0]}: {error.strerror}") from None
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no message"]
        last = next((line for line in lines if "error:" in line), lines[-1])
        raise Skipped(f"{' '.join(Path(word).name for word in command[:4])}: {last[:160]}")
    return done.stdout


def compile_c(source: Path, target: Path, *defines: str) -> Path:
    """Compiles a C file into a shared object and returns its path. Raises Skipped."""
    run(["gcc", *FLAGS, *defines, str(source), "-o", str(target), "-lm"], 240)
    return target


def compile_pinocchio() -> Path:
    """Returns the shared object of pinocchio_crba.cpp; compiled (a minute) where it or the flags changed. Raises Skipped."""
    source = Path(__file__).with_name("pinocchio_crba.cpp")
    if not (_EIGEN / "Eigen/Core").is_file():
        raise Skipped("no Eigen headers (CasADi's wheel brings them)")
    key = source.read_text() + " ".join(FLAGS + _PINOCCHIO) + pin.__version__ + cpu()
    target = ENVIRONMENTS / f"pinocchio-{hashlib.sha256(key.encode()).hexdigest()[:12]}.so"
    if not target.is_file():
        ENVIRONMENTS.mkdir(exist_ok=True)
        (ENVIRONMENTS / ".gitignore").write_text("*\n")
        beside = target.with_suffix(".part")
        run(["g++", *FLAGS, *_PINOCCHIO, str(source), "-o", str(beside)], 600)
        os.replace(beside, target)
    return target


def machine_instructions(library: Path, symbol: str) -> int:
    """Returns the number of machine instructions of a function and those it leads to here (libm apart). Raises Skipped."""
    text = run(["objdump", "-d", "--no-show-raw-insn", str(library)], 60)
    bodies = dict(re.findall(r"^[0-9a-f]+ <(.+)>:\n((?:.+\n)*)", text, re.MULTILINE))
    found: set[str] = set()
    ahead = {symbol}
    while ahead:
        found |= ahead
        calls = {
            name for body in ahead for name in re.findall(r"(?:call|jmp) +[0-9a-f]+ <([^+@>]+)(?:@plt)?>", bodies[body])
        }
        ahead = (calls & bodies.keys()) - found
    lines = [line for name in found for line in bodies[name].splitlines()]
    return sum(not re.search(r"\t(?:cs |data16 )*nop|\txchg +%ax,%ax", line) for line in lines)


@dataclass
class Program:
    """A compiled `run(q, alpha, count, out)` and its result [size] per posture; `times` [ns a call] of each turn.

    `upper`: a matrix stored by columns of which only the upper triangle counts.
    """

    library: ctypes.CDLL
    size: int
    entry: str = "run"
    alpha: np.ndarray | None = None
    upper: bool = False
    times: list[float] = field(default_factory=list)
    _out: np.ndarray | None = None  # one memory for all turns: new pages cost more than a call

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """Results [count, size] at postures q [count, n], overwritten by the next call; the time is kept."""
        if self._out is None or len(self._out) != len(q):
            self._out = np.zeros((len(q), self.size))
        out = self._out
        alpha = None if self.alpha is None else pointer(self.alpha)
        function = getattr(self.library, self.entry)
        start = time.perf_counter_ns()
        function(pointer(q), alpha, ctypes.c_long(len(q)), pointer(out))
        self.times.append((time.perf_counter_ns() - start) / len(q))
        return out


def pointer(values: np.ndarray) -> ctypes._Pointer[ctypes.c_double]:
    """The address of an array's numbers for C."""
    return values.ctypes.data_as(_DOUBLES)


def cpu() -> str:
    """Returns the processor's name."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    facts = dict(line.split(":", 1) for line in lines if ":" in line)
    facts = {key.strip(): value.strip() for key, value in facts.items()}
    return f"{facts['model name']} (family {facts['cpu family']}, model {facts['model']})"
