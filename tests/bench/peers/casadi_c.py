"""CasADi expression -> C behind the common loop; shared by the peers that build CasADi graphs, each in its own environment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca

_LOOP = """#include "{name}.c"
void run(const double *q, const double *alpha, long count, double *out)
{{
  long long iw[{iw}];
  double w[{w}];
  for (long k = 0; k < count; ++k) {{
    const double *arg[{arg}] = {{q + k * {n}}};
    double *res[{res}] = {{out + k * {size}}};
    {name}(arg, res, iw, w, 0);
  }}
}}
"""


def export(directory: Path, name: str, q: Any, result: Any) -> dict[str, Any]:
    """Writes <name>.c, and <name>_loop.c with `run`, for the expression result(q); returns what the table needs.

    Common subexpressions are shared first (`cse`), the best the peer can do with one option.
    """
    function = ca.Function(name, [q], [ca.densify(result)], {"cse": True})
    generator = ca.CodeGenerator(f"{name}.c", {"with_header": False})
    generator.add(function)
    generator.generate(f"{directory}/")
    loop = _LOOP.format(
        name=name,
        n=q.numel(),
        size=result.numel(),
        iw=function.sz_iw() + 1,
        w=function.sz_w() + 1,
        arg=function.sz_arg() + 1,
        res=function.sz_res() + 1,
    )
    (directory / f"{name}_loop.c").write_text(loop)
    return {"operations": function.n_instructions(), "source": f"{name}_loop.c", "symbol": name}
