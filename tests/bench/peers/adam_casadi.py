"""adam: URDFs -> a C program of M(q), its fixed-base part. Arguments: output directory, URDFs. Prints JSON."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import casadi as ca
from adam.casadi import KinDynComputations
from casadi_c import export


def main(directory: Path, urdfs: list[Path]) -> None:
    document = {"version": version("adam-robotics"), "arms": {}}
    for urdf in urdfs:
        joints = [joint for joint in ElementTree.parse(urdf).getroot().findall("joint") if joint.get("type") != "fixed"]
        seconds = []
        for _ in range(5):
            start = time.perf_counter()
            with contextlib.redirect_stdout(sys.stderr):
                kindyn = KinDynComputations(str(urdf), [joint.get("name") for joint in joints])
            q = ca.SX.sym("q", len(joints))
            M = kindyn.mass_matrix_fun()(ca.DM.eye(4), q)[6:, 6:]
            seconds.append(time.perf_counter() - start)
        program = export(directory, f"adam_J_{urdf.stem}", q, M)
        document["arms"][urdf.stem] = {"derive": min(seconds), "programs": {"J": program}}
    print(json.dumps(document))


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
