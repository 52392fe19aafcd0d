"""symgen's own stages in a fresh process, imports apart. Argument: URDF. Prints JSON, seconds by stage."""

from __future__ import annotations

import json
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

from symgen import emit, plan

_SMALL = Path(__file__).parents[3] / "robots/ypp3/ypp3.urdf"


def stages(urdf: Path) -> dict[str, Any]:
    """Seconds to parse, derive with ranks, plan (a draft), and build all functions; and what the plan promises."""
    cpu, times = time.process_time(), [time.perf_counter()]
    chain, unsnapped = plan.chain_of_file(urdf)
    times.append(time.perf_counter())
    made = plan.make_plan(chain, unsnapped=unsnapped, effort="draft")
    times.append(time.perf_counter())
    emit.functions(made.model.factoring)
    times.append(time.perf_counter())
    parse, planned, functions = (after - before for before, after in pairwise(times))
    derive = made.seconds["derive"] + made.seconds["rank"]
    cpu = time.process_time() - cpu
    promised = made.document["plan"]
    return {
        "seconds": {"parse": parse, "derive": derive, "plan": planned - derive, "functions": functions},
        "cpu": cpu,
        "runs": promised["measurements"],
        "amplification": max(promised["amplification_per_joint"]),
    }


if __name__ == "__main__":
    stages(_SMALL)  # pays for the imports made on first use
    print(json.dumps(stages(Path(sys.argv[1]))))
