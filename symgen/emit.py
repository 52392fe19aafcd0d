"""Factoring -> files for use: CasADi functions, the same as plain C99, and the URDF's own constants.

What is written depends on the input alone: no time, no path, every constant rounded to 14 digits, everything in a fixed
order. The caller hands in a directory of its own and moves the files when all are there.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import casadi as ca

from symgen.basis import Factoring
from symgen.chain import Array
from symgen.formula import Formula, alpha_cad, alpha_formulas, named_lengths, rounded
from symgen.graph import inertia_graph

#: Length at which a robot's name is cut in identifiers and file names.
_LONGEST_NAME = 48


@dataclass(frozen=True)
class _Emitted:
    """A function: what it takes; of its C form the shape of the result, row by row, and what it says there."""

    inputs: tuple[str, ...]
    shape: tuple[str, ...]
    meaning: str


_FUNCTIONS = {
    "J_diag": _Emitted(("q", "alpha"), ("N",), "J_diag[i]: inertia that joint i feels, the other joints held"),
    "J": _Emitted(("q", "alpha"), ("N", "N"), "J[i][j]: the inertia matrix, symmetric"),
    "C_rows": _Emitted(("q",), ("N", "D_DIAG"), "C_rows[i][k]: J_diag[i] is the sum over k of C_rows[i][k] alpha[k]"),
    "dJ_dq": _Emitted(("q", "alpha"), ("N", "N", "N"), "dJ_dq[k][i][j]: derivative of J[i][j] with respect to q[k]"),
    "regressor": _Emitted(
        ("q",), ("N", "N", "D"), "regressor[i][j][k]: J[i][j] is the sum over k of regressor[i][j][k] alpha[k]"
    ),
}

#: Results that CasADi, which stores columns, has to transpose for C; the others are symmetric or vectors.
_BY_ROWS = ("C_rows", "regressor")

#: How CasADi's C reads a number of an array that may not be given.
_ASKED = re.compile(r"arg\[\d+\]\? (arg\[\d+\]\[\d+\]) : 0")


def write_functions(factoring: Factoring, directory: Path, robot_name: str) -> list[str]:
    """Writes `function_texts` into `directory`; returns the file names. Raises OSError."""
    texts = function_texts(factoring, robot_name, alpha_formulas(factoring), Expressions(factoring))
    for name, text in texts.items():
        Path(directory, name).write_text(text, encoding="utf-8")
    return list(texts)


def function_texts(
    factoring: Factoring, robot_name: str, formulas: Sequence[Formula], expressions: Expressions
) -> dict[str, str]:
    """Returns the files with the functions of one arm, text by name.

    One `<function>.casadi` for each of `functions`, `alpha_cad.json` (names, value, unit, formula of the D constants and
    the lengths the formulas speak of), `symgen_<robot>.c` and `.h` with <robot> = `identifier(robot_name)`. `formulas` and
    `expressions` are those of the factoring.
    """
    robot = identifier(robot_name)
    return {
        "alpha_cad.json": _constants(factoring, robot_name, formulas),
        f"symgen_{robot}.h": _header(factoring, robot, robot_name),
        f"symgen_{robot}.c": _source(factoring, robot, expressions),
        **{f"{name}.casadi": _serialized(expressions.function(name)) for name in _FUNCTIONS},
    }


def save(function: ca.Function, path: Path) -> None:
    """Writes a CasADi function as its own `save` does, which neither tells of a full disk nor opens a path that is no text."""
    path.write_text(_serialized(function), encoding="ascii")


def _serialized(function: ca.Function) -> str:
    serializer = ca.StringSerializer()
    serializer.pack(function)
    text: str = serializer.encode()
    return text


def functions(factoring: Factoring, names: Sequence[str] = tuple(_FUNCTIONS)) -> dict[str, ca.Function]:
    """Returns the CasADi functions of an arm by name, all results dense; of `names`, where not all are needed.

    `J_diag` (q [n], alpha [D]) -> [n]; `J` (q, alpha) -> [n, n]; `C_rows` (q) -> [n, d], row i times alpha[:d] is J_ii;
    `dJ_dq` (q, alpha) -> [n, n n], the matrices dJ/dq_1, dJ/dq_2, .. side by side; `regressor` (q) -> [n n, D], times
    alpha it is J column by column. q in rad or m, alpha in the units of `factoring.alphas`.
    """
    expressions = Expressions(factoring)
    return {name: expressions.function(name) for name in names}


def identifier(name: str) -> str:
    """Returns a C identifier (and file name) for a robot's name: ASCII letters, digits and single underscores."""
    ascii_name = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    word = re.sub(r"[^A-Za-z0-9]+", "_", ascii_name)[:_LONGEST_NAME].strip("_")
    return word if word and not word[0].isdigit() else f"robot_{word}".rstrip("_")


class Expressions:
    """The result of each function of an arm over the symbols q and alpha, made when it is asked for, dense, nothing computed twice."""

    def __init__(self, factoring: Factoring) -> None:
        graph = inertia_graph(factoring)
        self.q, self.alpha, self._J, self._d = graph.q, graph.alpha, ca.cse(graph.J), factoring.d

    def function(self, name: str) -> ca.Function:
        """One of the `functions`."""
        return _function(name, name, self, getattr(self, name))

    @property
    def J(self) -> Any:
        return ca.densify(self._J)

    @property
    def J_diag(self) -> Any:
        return ca.densify(ca.diag(self._J))

    @cached_property
    def C_rows(self) -> Any:
        return ca.cse(ca.densify(ca.jacobian(ca.diag(self._J), self.alpha)[:, : self._d]))

    @cached_property
    def dJ_dq(self) -> Any:
        n = self.q.numel()
        return ca.cse(ca.densify(ca.reshape(ca.jacobian(ca.vec(self._J), self.q), n, n * n)))

    @cached_property
    def regressor(
        self,
    ) -> Any:  # hardly anything twice, and so many numbers that to look for it takes a second for ten joints
        return ca.densify(ca.jacobian(ca.vec(self._J), self.alpha))


def _function(label: str, name: str, expressions: Expressions, result: Any) -> ca.Function:
    inputs = list(_FUNCTIONS[name].inputs)
    return ca.Function(label, [getattr(expressions, key) for key in inputs], [result], inputs, [name])


def _constants(factoring: Factoring, robot_name: str, formulas: Sequence[Formula]) -> str:
    document = {
        "robot": robot_name,
        "urdf_sha256": factoring.chain.sha256,
        "names": list(factoring.names),
        "value": alpha_cad(factoring),
        "unit": [alpha.unit for alpha in factoring.alphas],
        "formula": [formula.text for formula in formulas],
        "lengths": {symbol.text: rounded(length.value) for symbol, length in named_lengths(factoring.chain).items()},
    }
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


# C -------------------------------------------------------------------------------------------------------------------


def _source(factoring: Factoring, robot: str, expressions: Expressions) -> str:
    """The C file: what CasADi generates, and functions with plain arrays around it."""
    generator = ca.CodeGenerator(f"symgen_{robot}.c", {"with_header": False, "with_export": False})
    wrappers = []
    for name, emitted in _FUNCTIONS.items():
        result = getattr(expressions, name)
        result = result.T if name in _BY_ROWS else result
        function = _function(f"{robot}_{name}_graph", name, expressions, result)
        generator.add(function, False)
        first = "[0]" * (len(emitted.shape) - 1)
        wrappers.append(
            f"{_signature(robot, name)}\n{{\n"
            f"  const double *arg[{function.sz_arg()}];\n  double *res[{function.sz_res()}];\n"
            + "".join(f"  arg[{k}] = {key};\n" for k, key in enumerate(emitted.inputs))
            + f"  res[0] = {name}{first};\n  {robot}_{name}_graph(arg, res, 0, 0, 0);\n}}\n"
        )
    values = "".join(f"  {value!r},\n" for value in alpha_cad(factoring))
    macro = robot.upper()
    constants = f"const double {robot}_alpha_cad[{macro}_D] = {{\n{values}}};\n"
    include = f'#include "symgen_{robot}.h"\n'
    return "\n".join([_banner(factoring, robot), include, _graphs(generator), constants, *wrappers])


def identified_source(factoring: Factoring, alpha: Array, robot_name: str) -> dict[str, str]:
    """Returns J.h and J.c: `<robot>_J_identified(q, J)`, the inertia matrix with the constants alpha [D] put in.

    `J.c` needs nothing but `J.h`, `J.h` nothing; <robot> = `identifier(robot_name)`.
    """
    robot, n = identifier(robot_name), factoring.chain.n
    q = ca.SX.sym("q", n)
    J = functions(factoring, ["J"])["J"](q, ca.DM(alpha))
    function = ca.Function(f"{robot}_J_identified_graph", [q], [J], ["q"], ["J"])
    generator = ca.CodeGenerator("J.c", {"with_header": False, "with_export": False})
    generator.add(function, False)
    call = f"void {robot}_J_identified(const double q[{n}], double J[{n}][{n}])"
    guard = f"{robot.upper()}_J_IDENTIFIED_H"
    banner = _banner(factoring, robot_name).replace("change the URDF, not this file", "identify again, do not edit")
    header = (
        f'{banner}\n#ifndef {guard}\n#define {guard}\n\n#ifdef __cplusplus\nextern "C" {{\n#endif\n\n'
        "/* J[i][j]: the inertia matrix, symmetric, with the identified constants; q in rad or m, joints base to tip:\n"
        f" * {', '.join(_comment(name) for name in factoring.chain.names)} */\n"
        f"{call};\n\n#ifdef __cplusplus\n}}\n#endif\n\n#endif\n"
    )
    body = (
        f"{call}\n{{\n  const double *arg[{function.sz_arg()}];\n  double *res[{function.sz_res()}];\n"
        f"  arg[0] = q;\n  res[0] = J[0];\n  {robot}_J_identified_graph(arg, res, 0, 0, 0);\n}}\n"
    )
    return {"J.h": header, "J.c": "\n".join([banner, '#include "J.h"\n', _graphs(generator), body])}


def _graphs(generator: ca.CodeGenerator) -> str:
    """What CasADi generates. Its functions take workspace, needed or not: no warning of that is of any use. They ask of every number
    whether its array was given; the functions around them give all, and asking is a third of the instructions."""
    quiet, loud = (
        f"#if defined(__GNUC__)\n#pragma GCC diagnostic {action}\n{more}#endif\n"
        for action, more in (("push", '#pragma GCC diagnostic ignored "-Wunused-parameter"\n'), ("pop", ""))
    )
    text = _ASKED.sub(r"\1", generator.dump().strip()).replace("if (res[0]!=0) ", "")
    return f"{quiet}{text}\n{loud}"


def _signature(robot: str, name: str) -> str:
    macro = robot.upper()
    sizes = {"q": f"[{macro}_N]", "alpha": f"[{macro}_D]"}
    arguments = [f"const double {key}{sizes[key]}" for key in _FUNCTIONS[name].inputs]
    result = "".join(f"[{macro}_{size}]" for size in _FUNCTIONS[name].shape)
    return f"void {robot}_{name}({', '.join(arguments)}, double {name}{result})"


def _banner(factoring: Factoring, robot_name: str) -> str:
    return (
        f"/* Inertia matrix J(q) of the robot {_comment(robot_name)}.\n"
        f" * Written by symgen {version('symgen')} with CasADi {ca.CasadiMeta.version()}"
        f" from the URDF with SHA-256\n * {_comment(factoring.chain.sha256) or 'unknown'}\n"
        " * Written by a program: change the URDF, not this file. */\n"
    )


def _comment(text: str) -> str:
    """Text that can not end or break a C comment."""
    return re.sub(r"[^A-Za-z0-9_. +-]", "_", unicodedata.normalize("NFKD", text).encode("ascii", "replace").decode())


def _header(factoring: Factoring, robot: str, robot_name: str) -> str:
    """The C header: sizes, names of the constants, the functions."""
    chain, macro = factoring.chain, robot.upper()
    joints = "".join(
        f" *   q[{k}]  {_comment(joint.name)}, {joint.type}, {'rad' if joint.type == 'revolute' else 'm'}\n"
        for k, joint in enumerate(chain.joints)
    )
    names = "".join(
        f"  {macro}_{alpha.name.upper()} = {k}{',' if k + 1 < len(factoring.alphas) else ''} /* {alpha.unit} */\n"
        for k, alpha in enumerate(factoring.alphas)
    )
    declarations = "".join(f"/* {f.meaning} */\n{_signature(robot, name)};\n\n" for name, f in _FUNCTIONS.items())
    return f"""{_banner(factoring, robot_name)}
#ifndef SYMGEN_{macro}_H
#define SYMGEN_{macro}_H

#ifdef __cplusplus
extern "C" {{
#endif

/* Joints, base to tip:
{joints} */
#define {macro}_N {chain.n} /* joints */
#define {macro}_D {len(factoring.alphas)} /* constants alpha of all of J */
#define {macro}_D_DIAG {factoring.d} /* the first of them: all that the diagonal of J depends on */

/* Place of each constant in alpha, and its unit. Formulas: alpha_cad.json. */
enum {robot}_alpha {{
{names}}};

/* The constants of the URDF's own masses and inertias. */
extern const double {robot}_alpha_cad[{macro}_D];

{declarations}#ifdef __cplusplus
}}
#endif

#endif
"""
