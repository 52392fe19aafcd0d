"""Log: a robot that moved along trajectories, with the torques that moved it. No multisine, no postures: joint side, rigid joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ident.errors import CampaignError
from ident.plain import storable

Array = NDArray[np.float64]

#: What a text has to be to be kept.
STORABLE = "text of UTF-8 without null characters"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One run: joint angles `q` and torques `tau` [T, n], rad and N m joint side (m and N where a joint slides), at the same instants."""

    id: str
    q: Array
    tau: Array


@dataclass(frozen=True, eq=False)
class Log:
    """Trajectories of one robot, sampled at `fs` [Hz].

    `urdf` is the declared robot, `joints` its n driven ones from base to tip, `N` [n] their gear ratios, `J_m` [n, kg m2] the motors'
    inertias, motor side, NaN where nobody knows: there links have all the inertia. `gravity` [3, m/s2] in the base frame. `currents` are joints
    whose torque is a current, for no torque constant is known: A for N m.
    """

    urdf: str
    joints: tuple[str, ...]
    fs: float
    N: Array
    J_m: Array
    gravity: Array
    source: str
    trajectories: tuple[Trajectory, ...]
    currents: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        return len(self.joints)


def check_log(log: Log, where: str) -> None:
    """CampaignError, one line naming `where`, field and rule, if a log is none."""
    n = log.n
    rules = (
        ("robot/joint_names", n > 0 and len(set(log.joints)) == n, "at least one, all different"),
        ("source", storable(log.source), STORABLE),
        ("robot/urdf", storable(log.urdf), STORABLE),
        ("robot/joint_names", all(map(storable, log.joints)), STORABLE),
        ("trajectories", all(storable(one.id) for one in log.trajectories), f"ids that are {STORABLE}"),
        ("fs_hz", 0 < log.fs < np.inf, "a finite number > 0"),
        ("drive/gear_ratio", np.all(np.isfinite(log.N) & (log.N != 0)), "finite numbers other than 0"),
        ("drive/motor_inertia", np.all(np.isnan(log.J_m) | ((log.J_m > 0) & (log.J_m < np.inf))), "numbers > 0, NaN where unknown"),
        ("drive/gravity", np.all(np.isfinite(log.gravity)), "3 finite numbers"),
        ("drive/currents", set(log.currents) <= set(log.joints), "names of joints"),
        ("trajectories", len(log.trajectories) > 0, "at least one"),
        *((f"trajectories/{one.id}", one.q.shape == one.tau.shape == (len(one.q), n), f"q and tau of shape [T, {n}]")
          for one in log.trajectories),
        *((f"trajectories/{one.id}", np.isfinite(one.q).all() and np.isfinite(one.tau).all(), "finite samples")
          for one in log.trajectories),
    )  # fmt: skip
    for field, good, expected in rules:
        if not good:
            raise CampaignError(f"{where}: {field}: expected {expected}")
