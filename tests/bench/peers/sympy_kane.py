"""SymPy mechanics: one arm, as numbers, -> a C program of M(q) by Kane's method and cse. Arguments: output directory, JSON."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import sympy as sp
from sympy.physics import mechanics


def _clean(values: Any) -> sp.Matrix:
    """A matrix whose entries within 1e-12 of a whole number are that number: structural zeros stay zero."""
    return sp.Matrix(values).applyfunc(lambda x: sp.Integer(round(x)) if abs(x - round(x)) < 1e-12 else x)


def _vector(values: Any, frame: mechanics.ReferenceFrame) -> mechanics.Vector:
    return sum((c * e for c, e in zip(_clean(values), (frame.x, frame.y, frame.z), strict=True)), mechanics.Vector(0))


def mass_matrix(joints: list[dict[str, Any]]) -> tuple[list[sp.Symbol], sp.Matrix]:
    """Returns plain symbols q [n] and M(q) [n, n], unsimplified."""
    n = len(joints)
    q, u = mechanics.dynamicsymbols(f"q1:{n + 1}"), mechanics.dynamicsymbols(f"u1:{n + 1}")
    world = frame = mechanics.ReferenceFrame("N")
    origin = mechanics.Point("O")
    origin.set_vel(world, 0)
    bodies = []
    for k, joint in enumerate(joints):
        placed, link = mechanics.ReferenceFrame(f"P{k}"), mechanics.ReferenceFrame(f"L{k}")
        placed.orient_explicit(frame, _clean(joint["R"]))
        axis = _vector(joint["axis"], placed)
        link.orient_axis(placed, axis, q[k])
        link.set_ang_vel(placed, u[k] * axis)
        before, origin = origin, origin.locatenew(f"O{k}", _vector(joint["p"], frame))
        origin.v2pt_theory(before, world, frame)
        com = origin.locatenew(f"C{k}", _vector(joint["com"], link))
        com.v2pt_theory(origin, world, link)
        I = _clean(joint["I"])
        inertia = mechanics.inertia(link, I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[1, 2], I[0, 2])
        bodies.append(mechanics.RigidBody(f"B{k}", com, link, joint["mass"], (inertia, com)))
        frame = link
    rates = [sp.diff(qk) - uk for qk, uk in zip(q, u, strict=True)]
    kane = mechanics.KanesMethod(world, q_ind=list(q), u_ind=list(u), kd_eqs=rates)
    kane.kanes_equations(bodies, [])
    plain = list(sp.symbols(f"angle:{n}"))  # cse takes the names x0, x1, ..
    return plain, kane.mass_matrix.subs(dict(zip(q, plain, strict=True)))


def main(directory: Path, arm: Path) -> None:
    joints = json.loads(arm.read_text())
    n, name = len(joints), f"sympy_J_{arm.stem}"
    start = time.perf_counter()
    q, M = mass_matrix(joints)
    derive = time.perf_counter() - start
    shared, (result,) = sp.cse(M)
    lines = [f"  const double {symbol} = q[{k}];" for k, symbol in enumerate(q)]
    lines += [f"  const double {sp.ccode(symbol)} = {sp.ccode(value)};" for symbol, value in shared]
    lines += [f"  out[{k}] = {sp.ccode(value)};" for k, value in enumerate(result)]
    operations = int(sum(sp.count_ops(value) for _, value in shared) + sp.count_ops(result))
    (directory / f"{name}.c").write_text(
        f"#include <math.h>\nvoid {name}(const double *q, double *out)\n{{\n" + "\n".join(lines) + "\n}\n"
        "void run(const double *q, const double *alpha, long count, double *out)\n"
        f"{{\n  for (long k = 0; k < count; ++k) {name}(q + k * {n}, out + k * {n * n});\n}}\n"
    )
    program = {"operations": operations, "source": f"{name}.c", "symbol": name}
    print(json.dumps({"derive": derive, "share": time.perf_counter() - start - derive, "programs": {"J": program}}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
