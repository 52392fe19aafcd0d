"""symgen's own C file behind the loop that the peers' programs run in."""

from __future__ import annotations

from pathlib import Path

from symgen.basis import Factoring
from symgen.emit import identifier, write_functions

#: Function -> the shape of its result as the header names it.
SIZES = {"J_diag": "{m}_N", "J": "{m}_N * {m}_N", "C_rows": "{m}_N * {m}_D_DIAG"}


def write(factoring: Factoring, directory: Path, name: str) -> Path:
    """Writes the functions of an arm and a C file with `run_<function>` for each of `SIZES`; returns its path."""
    write_functions(factoring, directory, name)
    robot = identifier(name)
    loops = []
    for function, size in SIZES.items():
        m = robot.upper()
        inputs = f"q + k * {m}_N" + ("" if function == "C_rows" else ", alpha")
        out = f"out + k * {size.format(m=m)}"
        cast = out if function == "J_diag" else f"(double (*)[{size.format(m=m).split(' * ')[1]}])({out})"
        loops.append(
            f"void run_{function}(const double *q, const double *alpha, long count, double *out)\n"
            f"{{\n  for (long k = 0; k < count; ++k) {robot}_{function}({inputs}, {cast});\n}}\n"
        )
    path = directory / f"symgen_{robot}_loop.c"
    path.write_text(f'#include "symgen_{robot}.c"\n' + "\n".join(loops))
    return path
