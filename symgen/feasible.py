"""Which postures an arm may hold: its motors carry gravity with a reserve, and it does not touch itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symgen.chain import Array, Chain, readonly
from symgen.collision import SelfCollision
from symgen.kinematics import gravity_forces

#: Share of a joint's force limit that gravity may take; the rest is for the excitation and for a CAD file that is wrong.
GRAVITY_SHARE = 0.7


class Feasible:
    """Call with postures [m, n] for a mask [m] of those the arm may hold; `notes` say in words what is tested.

    `limit` [n, N m or N, joint side] is the smaller of the URDF's effort and the drives' limits, infinite where neither
    is known; `gravity` [3, m/s2] in the base frame.
    """

    def __init__(self, chain: Chain, urdf: Path, limit: ArrayLike, gravity: ArrayLike):
        self.chain = chain
        self._gravity_forces = gravity_forces(chain, gravity)
        effort = [joint.effort for joint in chain.joints]
        self.limit = readonly(GRAVITY_SHARE * np.minimum(effort, np.asarray(limit, dtype=float)))
        self.touches = SelfCollision(chain, urdf)
        known = int(np.isfinite(self.limit).sum())
        self.notes = {
            "gravity": f"within {GRAVITY_SHARE:.0%} of the force limit on the {known} of {chain.n} joints that state one",
            "self_collision": self.touches.note,
        }

    def __call__(self, q: Array) -> NDArray[np.bool_]:
        held = (np.abs(self._gravity_forces(q)) <= self.limit).all(axis=1)
        mask = np.array(held, dtype=bool)
        mask[held] = ~self.touches(q[held])
        return mask

    def hopeless(self, q: Array, joint: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Returns a mask [m] of postures at which links behind joint `joint` [m] touch each other: it may hold none of these,
        wherever that joint and those before it are."""
        mask: NDArray[np.bool_] = self.touches.nearer(q) > joint
        return mask
