"""Pinocchio as judge: J(q) of the factoring, and of the functions written, against the composite-rigid-body algorithm at random postures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from symgen.basis import Factoring
from symgen.chain import REVOLUTE, Array, Chain
from symgen.emit import Expressions
from symgen.errors import SymgenError
from symgen.inertia import monomials
from symgen.pinocchio_arm import alone, configurations, joint_ids
from symgen.quiet import quiet
from symgen.regressor import J_rows

#: What exactness means: rounding of a few hundred additions of numbers of the size of the largest entry of J.
TOLERANCE = 1e-12

#: What the same reading of a file means, where nothing is snapped but what is within 1e-9 rad of an exact angle.
READING = 1e-8

#: Where constants that hardly matter were dropped, what they cost may be this many times larger at other postures.
_ELSEWHERE = 10.0


@dataclass(frozen=True)
class Verdict:
    """Largest error of any J_ij over `postures` random postures, relative to the largest entry of J.

    `error` of the trigonometric form, of the regressor and of the functions that are written, on the chain as snapped; `as_written` that of the chain against
    Pinocchio's own reading of the file (it holds what snapping changed); None where Pinocchio does not read the file.
    `allowed`: `TOLERANCE`, and what dropping constants cost (`Factoring.cost`); `allowed_as_written`: `READING`, infinite
    where angles were snapped.
    """

    postures: int
    error: float
    as_written: float | None
    allowed: float = TOLERANCE
    allowed_as_written: float = READING

    @property
    def ok(self) -> bool:
        return self.error <= self.allowed and (self.as_written or 0.0) <= self.allowed_as_written


def verify(factoring: Factoring, postures: int = 200, seed: int = 0, expressions: Expressions | None = None) -> Verdict:
    """Returns how far J(q) = C(q) alpha of the declared robot is from Pinocchio's CRBA. `expressions`, those that are written,
    save work.

    Raises SymgenError if one of the errors is beyond what is allowed: the derivation, or the chain, would be wrong.
    """
    chain = factoring.chain
    low, high = chain.limits.T
    q = low + (high - low) * np.random.default_rng(seed).random((postures, chain.n))
    turning = [joint.type == REVOLUTE for joint in chain.joints]
    q = np.where(turning, np.remainder(q + np.pi, 2 * np.pi) - np.pi, q)  # a cosine of 1e5 rad has lost five digits
    J = _crba(_model_of_chain(chain), range(1, chain.n + 1), q)
    largest = float(np.abs(J).max())
    alpha = factoring.alpha_cad
    error = float(np.abs(J_rows(factoring, q) @ alpha - J).max())
    for (i, j), entry in factoring.entries.items():
        if entry.complete:
            trigonometric = monomials(entry, q) @ (factoring.S[i, j] @ alpha)
            error = max(error, float(np.abs(trigonometric - J[:, i, j]).max()))
    error = max(
        error,
        *(
            float(np.abs(written - J).max())
            for written in _written(factoring, expressions or Expressions(factoring), q)
        ),
    )
    read = _model_of_file(chain)
    verdict = Verdict(
        postures=postures,
        error=error / largest,
        as_written=None if read is None else float(np.abs(J - _crba(*read, q)).max()) / largest,
        allowed=TOLERANCE + _ELSEWHERE * factoring.cost,
        allowed_as_written=np.inf if chain.snapped else READING,
    )
    if not verdict.ok:
        derived = verdict.error > verdict.allowed
        found, allowed = (verdict.error, verdict.allowed) if derived else (verdict.as_written, READING)
        raise SymgenError(
            f"{chain.name}: J(q) differs from Pinocchio's{'' if derived else ', which reads the file itself,'} by {found:.1e} of "
            f"its largest entry (expected <= {allowed:g}): please report this robot"
        )
    return verdict


def _written(factoring: Factoring, expressions: Expressions, q: Array) -> Iterator[Array]:
    """J(q) [m, n, n], or its diagonal put in the place of that of J, as the functions have it that are written."""
    alpha, n = factoring.alpha_cad, factoring.chain.n
    J = np.array(expressions.function("J").map(len(q))(q.T, alpha)).reshape(n, len(q), n).swapaxes(0, 1)
    yield J
    rows = np.array(expressions.function("C_rows").map(len(q))(q.T)).reshape(n, len(q), factoring.d).swapaxes(0, 1)
    by_rows = J.copy()
    by_rows[:, range(n), range(n)] = rows @ alpha[: factoring.d]
    yield by_rows


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


def _model_of_file(chain: Chain) -> tuple[Any, Sequence[int]] | None:
    """Pinocchio's own model of the URDF with every joint that is not in the chain locked where the chain froze it, and its
    numbers of the chain's joints; None where it reads no such model."""
    import pinocchio as pin

    if not chain.source:
        return None
    try:
        with quiet():  # urdfdom prints what it dislikes
            whole = pin.buildModelFromXML(chain.source)
        (model,) = alone(whole, chain)
        return model, joint_ids(model, chain.names)
    except (ValueError, RuntimeError):
        return None


def _crba(model: Any, ids: Sequence[int], q: Array) -> Array:
    """J(q) [m, n, n] of a model's joints with these numbers at postures q [m, n]."""
    import pinocchio as pin

    data = model.createData()
    order = [model.joints[k].idx_v for k in ids]
    out = np.empty((len(q), model.nv, model.nv))
    for row, posture in enumerate(configurations(model, ids, q)):
        upper = np.triu(pin.crba(model, data, posture))
        out[row] = upper + np.triu(upper, 1).T
    J: Array = out[:, order][:, :, order]
    return J
