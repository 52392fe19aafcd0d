"""The joints of an arm in Pinocchio's model of its whole URDF, and the configurations in which they stand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from symgen.chain import Array, Chain


def joint_ids(model: Any, names: Sequence[str]) -> list[int]:
    """Returns Pinocchio's numbers of the joints. ValueError if it has no such joint, or one of its own by that name."""
    own, *known = list(model.names)  # its own is "universe"
    if missing := [name for name in names if name not in known or name == own]:
        raise ValueError(f"Pinocchio reads no joint {missing[0]!r}")
    return [known.index(name) + 1 for name in names]


def configurations(model: Any, ids: Sequence[int], q: Array) -> Array:
    """Returns the configurations [m, nq] in which these joints, each moved by one number, stand at q [m, rad or m], the others
    neutral."""
    import pinocchio as pin

    full = np.tile(pin.neutral(model), (len(q), 1))
    for joint, value in zip([model.joints[k] for k in ids], q.T, strict=True):
        parts = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
        full[:, joint.idx_q : joint.idx_q + joint.nq] = np.transpose(parts)
    return full


def alone(whole: Any, chain: Chain, *geometry: Any) -> tuple[Any, ...]:
    """Returns a URDF's model, and its shapes where given, with the chain's joints alone: the others are locked where the chain
    froze them, floating and planar ones neutral. ValueError as of `joint_ids`, or what Pinocchio raises."""
    import pinocchio as pin

    own = joint_ids(whole, chain.names)
    frozen = dict(zip(joint_ids(whole, list(chain.frozen)), chain.frozen.values(), strict=True))
    driven = {k: value for k, value in frozen.items() if whole.joints[k].nv == 1}
    others = [k for k in range(1, whole.njoints) if k not in own]
    if not others:
        return whole, *geometry
    for frame in whole.frames:  # a link may bear the name of a joint, which then would not be found
        if frame.type == pin.FrameType.BODY:
            frame.name += " (link)"
    rest = configurations(whole, list(driven), np.array([list(driven.values())]))[0]
    reduced = pin.buildReducedModel(whole, *geometry, others, rest)
    return reduced if geometry else (reduced,)
