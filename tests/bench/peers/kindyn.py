"""casadi_kin_dyn: URDFs -> C programs of diag M(q) and M(q). Arguments: output directory, URDFs. Prints JSON."""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version
from pathlib import Path

import casadi as ca
from casadi_c import export
from casadi_kin_dyn import CasadiKinDyn


def main(directory: Path, urdfs: list[Path]) -> None:
    document = {"version": version("cmeel-casadi-kin-dyn"), "arms": {}}
    for urdf in urdfs:
        seconds = []
        for _ in range(5):
            start = time.perf_counter()
            kindyn = CasadiKinDyn(urdf.read_text())
            q = ca.SX.sym("q", kindyn.nq())
            M = kindyn.crba()(q)
            seconds.append(time.perf_counter() - start)
        document["arms"][urdf.stem] = {
            "derive": min(seconds),
            "programs": {
                "J_diag": export(directory, f"kindyn_J_diag_{urdf.stem}", q, ca.diag(M)),
                "J": export(directory, f"kindyn_J_{urdf.stem}", q, M),
            },
        }
    print(json.dumps(document))


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
