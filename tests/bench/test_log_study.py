"""How often the loop on logs is right: effects drawn at random, on arms that are as declared or 10 % off, by two to four trajectories."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest
from study import markdown, publish

sys.path.insert(0, str(Path(__file__).parents[1] / "ident"))

from logged import LAWS, found, log

from ident.logs.diagnose import diagnose_log

ROBOTS = ("ypp3_general", "scara4", "arm6", "arm7")
JOINTS = {"ypp3_general": 3, "scara4": 4, "arm6": 6, "arm7": 7}
DRAWS, SEED = 60, 31
#: One draw in so many has nothing in it.
NOTHING = 4


@pytest.mark.bench
def test_what_acts_is_named_first_beside_links_that_are_off() -> None:
    rng = np.random.default_rng(SEED)
    rows: dict[str, list[tuple[bool, bool, bool, float]]] = {}
    for k in range(DRAWS):
        robot = ROBOTS[k % len(ROBOTS)]
        name, _, law, _ = LAWS[rng.integers(len(LAWS))] if k % NOTHING else ("nothing", 0, None, None)
        joint, off = int(rng.integers(JOINTS[robot])), float(rng.choice([0.0, 0.1]))
        own = log(law, joint, robot=robot, off=off, seed=int(rng.integers(10**6)), runs=int(rng.choice([2, 3, 4])))
        began = time.process_time()
        d = diagnose_log(own)
        named = [one for one in found(d) if one[0] != "inertial-parameters"]
        true = [] if law is None else [(name, joint)]
        rows.setdefault("links 10 % off" if off else "links as declared", []).append(
            (named[:1] == true, named == true, d.status != "unexplained", time.process_time() - began)
        )
    table = [
        [
            kind,
            len(own),
            *(f"{sum(one[k] for one in own)}" for k in range(3)),
            f"{np.median([one[3] for one in own]):.1f}",
        ]
        for kind, own in rows.items()
    ]
    head = ["arms", "draws", "named first", "and nothing else", "to the noise", "CPU s (median)"]
    publish("Logs: effects drawn at random", markdown(head, table))
    every = [one for own in rows.values() for one in own]
    assert sum(one[0] for one in every) >= 0.9 * DRAWS
