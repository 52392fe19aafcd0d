"""Pinocchio as judge: J(q) of the factoring against the composite-rigid-body algorithm at random postures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from symgen.basis import Factoring
from symgen.chain import REVOLUTE, Array, Chain
from symgen.errors import SymgenError
from symgen.inertia import monomials
from symgen.quiet import quiet
from symgen.regressor import J_rows

#: What exactness means: rounding of a few hundred additions of numbers of the size of the largest entry of J.
TOLERANCE = 1e-12

#: Where constants that hardly matter were dropped, what they cost may be this many times larger at other postures.
_ELSEWHERE = 10.0


@dataclass(frozen=True)
class Verdict:
    """Largest error of any J_ij over `postures` random postures, relative to the largest entry of J.

    `error` of the trigonometric form and of the regressor on the chain as snapped; `as_written` against Pinocchio's own
    reading of the file (that error holds what snapping changed); None where Pinocchio can not read the file. `allowed`:
    `TOLERANCE`, and what dropping constants cost (`Factoring.cost`).
    """

    postures: int
    error: float
    as_written: float | None
    allowed: float = TOLERANCE

    @property
    def ok(self) -> bool:
        return self.error <= self.allowed


def verify(factoring: Factoring, postures: int = 200, seed: int = 0) -> Verdict:
    """Returns how far J(q) = C(q) alpha of the declared robot is from Pinocchio's CRBA.

    Raises SymgenError if the error on the chain itself is beyond what is allowed: the derivation would be wrong.
    """
    chain = factoring.chain
    low, high = chain.limits.T
    q = low + (high - low) * np.random.default_rng(seed).random((postures, chain.n))
    turning = [joint.type == REVOLUTE for joint in chain.joints]
    q = np.where(turning, np.remainder(q + np.pi, 2 * np.pi) - np.pi, q)  # a cosine of 1e5 rad has lost five digits
    J = _crba(_model_of_chain(chain), chain, q)
    largest = float(np.abs(J).max())
    alpha = factoring.alpha_cad
    error = float(np.abs(J_rows(factoring, q) @ alpha - J).max())
    for (i, j), entry in factoring.entries.items():
        if entry.complete:
            trigonometric = monomials(entry, q) @ (factoring.S[i, j] @ alpha)
            error = max(error, float(np.abs(trigonometric - J[:, i, j]).max()))
    written = _model_of_file(chain)
    verdict = Verdict(
        postures=postures,
        error=error / largest,
        as_written=None if written is None else float(np.abs(J - _crba(written, chain, q)).max()) / largest,
        allowed=TOLERANCE + _ELSEWHERE * factoring.cost,
    )
    if not verdict.ok:
        raise SymgenError(
            f"{chain.name}: J(q) differs from Pinocchio's by {verdict.error:.1e} of its largest entry (expected <= "
            f"{verdict.allowed:g}): please report this robot"
        )
    return verdict


def _model_of_chain(chain: Chain) -> Any:
    import pinocchio as pin

    model, parent = pin.Model(), 0
    for joint in chain.joints:
        kind = pin.JointModelRevoluteUnaligned if joint.type == REVOLUTE else pin.JointModelPrismaticUnaligned
        parent = model.addJoint(
            parent, kind(np.array(joint.axis)), pin.SE3(np.array(joint.R), np.array(joint.p)), joint.name
        )
        body = joint.inertia
        model.appendBodyToJoint(
            parent, pin.Inertia(body.mass, np.array(body.com), np.array(body.I)), pin.SE3.Identity()
        )
    return model


def _model_of_file(chain: Chain) -> Any:
    """Pinocchio's own model of the URDF with every joint that is not in the chain locked where the chain froze it."""
    import pinocchio as pin

    if not chain.source:
        return None
    try:
        with quiet():  # urdfdom prints what it dislikes
            whole = pin.buildModelFromXML(chain.source)
        rest = pin.neutral(whole)
        for name, value in chain.frozen.items():
            if whole.existJointName(name):
                joint = whole.joints[whole.getJointId(name)]
                rest[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        others = [k for k in range(1, whole.njoints) if whole.names[k] not in chain.names]
        return pin.buildReducedModel(whole, others, rest) if others else whole
    except (ValueError, RuntimeError):
        return None


def _crba(model: Any, chain: Chain, q: Array) -> Array:
    """J(q) [m, n, n] of the chain's joints at postures q [m, n]."""
    import pinocchio as pin

    data = model.createData()
    joints = [model.joints[model.getJointId(name)] for name in chain.names]
    order = [joint.idx_v for joint in joints]
    configuration = np.zeros((len(q), model.nq))
    for k, joint in enumerate(joints):
        values = q[:, [k]] if joint.nq == 1 else np.stack([np.cos(q[:, k]), np.sin(q[:, k])], axis=1)
        configuration[:, joint.idx_q : joint.idx_q + joint.nq] = values
    out = np.empty((len(q), model.nv, model.nv))
    for row, posture in enumerate(configuration):
        upper = np.triu(pin.crba(model, data, posture))
        out[row] = upper + np.triu(upper, 1).T
    J: Array = out[:, order][:, :, order]
    return J
