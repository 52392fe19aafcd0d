"""What was measured: records of one robot, whoever made them. The data model of the campaign file, without the file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ident.records.log import Trajectory

Array = NDArray[Any]
#: What torque acts between two samples, see `Campaign.hold`.
HOLDS = ("zoh", "band-limited")


def _frozen(values: object, dtype: type = float) -> Array:
    array: Array = np.array(values, dtype=dtype)
    array.setflags(write=False)
    return array


@dataclass(frozen=True)
class Record:
    """One excitation at one posture, with the response of every joint.

    `posture` [n, rad] declared link angles at rest; `lines` [L] excited harmonics of `f0` [Hz], ascending in whatever
    order they are given; `rms` [N m] of the multisine, motor side. `tau` [T, n, N m] commanded motor torque, feedback
    and bias included; `theta` [T, n, rad] motor angle, motor side. `omega` [T, n, rad/s] and `q_link` [T, n, rad] are
    None where not measured. theta[k] is read at the instant from which tau[k] acts. For a prismatic joint read m, N and
    kg for rad, N m and kg m2.
    """

    id: str
    excited: str
    posture: Array
    f0: float
    lines: NDArray[np.int64]
    samples_per_period: int
    periods: int
    rms: float
    tau: Array
    theta: Array
    omega: Array | None = None
    q_link: Array | None = None

    def __post_init__(self) -> None:
        for name in ("posture", "tau", "theta", "omega", "q_link"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _frozen(getattr(self, name)))
        lines = np.array(self.lines, dtype=np.int64)
        object.__setattr__(self, "lines", _frozen(np.sort(lines) if lines.ndim else lines, np.int64))


@dataclass(frozen=True, eq=False)
class Earlier:
    """What earlier records of the same robot told of it: logarithms of its drives, the constants of its links and of gravity, as the
    `vector` [4 n + k] of a fit, their `covariance`, and the `rows` [k, 10 n] by which the constants follow from the links."""

    vector: Array
    covariance: Array
    rows: Array


@dataclass(frozen=True)
class Campaign:
    """All records of one robot, and the robot as its engineer believes it to be.

    `N` [n, 1] gear ratios; `J_m` [n, kg m2, motor side] and `K` [n, N m/rad, joint side] are datasheet values, NaN
    where unknown, and so are `D` [n, N m s/rad, motor side] and `D_spring` [n, N m s/rad, joint side], all NaN where
    not given; `gravity` [3, m/s2] in the base frame; `hold` is "zoh" or "band-limited" (see the campaign format). `earlier`: the
    robot is declared as earlier records had it, which no file tells.
    """

    urdf: str
    joints: tuple[str, ...]
    fs: float
    hold: str
    N: Array
    J_m: Array
    K: Array
    gravity: Array
    source: str
    records: tuple[Record, ...]
    D: Array = field(default_factory=lambda: np.array(np.nan))
    D_spring: Array = field(default_factory=lambda: np.array(np.nan))
    earlier: Earlier | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        for name in ("N", "J_m", "K", "gravity"):
            object.__setattr__(self, name, _frozen(getattr(self, name)))
        for name in ("D", "D_spring"):
            value = getattr(self, name)
            object.__setattr__(self, name, _frozen(value if np.ndim(value) else np.full(self.n, value)))

    @property
    def n(self) -> int:
        return len(self.joints)


def is_copy(record: Record | Trajectory, other: Record | Trajectory) -> bool:
    """Whether two records, or trajectories, have the same samples: noise is never twice the same."""
    angles, others = (one.theta if isinstance(one, Record) else one.q for one in (record, other))
    return np.array_equal(record.tau, other.tau) and np.array_equal(angles, others)
