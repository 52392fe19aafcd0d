"""What it costs to take the angles of a URDF for the exact ones they were rounded from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from symgen.chain import Chain, Joint
from symgen.kinematics import inertia_matrix

_POSTURES = 200


def snapping_costs(chain: Chain, unsnapped: Chain) -> list[float]:
    """Returns for each of `chain.snapped` the largest change of J(q), relative to its largest entry, if the joint kept the
    angles of the file; for what is of no moving joint (a fixed joint, an inertial frame), if all joints and bodies did.

    `unsnapped` is the same arm with the file's own angles.
    """
    low, high = chain.limits.T
    q = low + (high - low) * np.random.default_rng(0).random((_POSTURES, chain.n))
    J = inertia_matrix(chain, q)

    def cost(joints: tuple[Joint, ...]) -> float:
        return float(np.abs(inertia_matrix(replace(chain, joints=joints), q) - J).max() / np.abs(J).max())

    together, ours = cost(unsnapped.joints), chain.joints
    own = {joint.name: cost((*ours[:k], joint, *ours[k + 1 :])) for k, joint in enumerate(unsnapped.joints)}
    return [own.get(snap.joint, together) for snap in chain.snapped]
