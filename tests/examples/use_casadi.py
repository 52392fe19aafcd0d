"""From measured J_ii to J(q) anywhere, with what symgen wrote and nothing else.

python tests/examples/use_casadi.py generated/ypp3 0 0.5 -1.2 [measured.json]

measured.json lists the J_ii measured at the cells of plan.json, in order; without it the URDF's own constants stand in.
"""

import json
import sys
from pathlib import Path

import casadi as ca
import numpy as np

folder = Path(sys.argv[1])
J, C_rows = (ca.Function.load(str(folder / f"{name}.casadi")) for name in ("J", "C_rows"))
plan = json.loads((folder / "plan.json").read_text())
cells = [(plan["joints"].index(cell["joint"]), cell["q"]) for cell in plan["plan"]["cells"]]
n, d = len(plan["joints"]), plan["shared_rank"]
q = [float(word) for word in sys.argv[2 : 2 + n]]

# One row of C and one measured number for each cell; J_ii = C_i(q) alpha.
C = np.array([np.array(C_rows(posture))[i] for i, posture in cells])
alpha = np.array(json.loads((folder / "alpha_cad.json").read_text())["value"])
measured = json.loads(Path(sys.argv[2 + n]).read_text()) if len(sys.argv) > 2 + n else C @ alpha[:d]

# Weighted as in the plan: an error of J_ii is proportional to J_ii. Constants that only off-diagonals show stay the URDF's.
weight = 1 / np.asarray(measured)
alpha[:d] = np.linalg.lstsq(C * weight[:, None], np.ones(len(C)), rcond=None)[0]
for name, value in zip(plan["alpha"]["names"], alpha, strict=True):
    print(f"{name:<12}{value:.10g}", file=sys.stderr)
print(json.dumps(np.array(J(q, alpha)).tolist()))
