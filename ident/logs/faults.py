"""Faults of a log's recording that would end in a wrong robot, named before anything is looked for: of its signals, and of what they say of the arm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ident.logs.moves import Moves
from ident.logs.plausible_arm import Sight, left, seen
from ident.logs.signals import of_signals
from ident.logs.slips import slips
from ident.records.faults import refuse_first
from ident.records.log import Log
from ident.records.signal_faults import REFUSE, Fault
from symgen.plan import Model

#: A joint that travels this many times the range of its limits has angles in another unit.
RANGE = 2.0
#: A torque that is cut off is another one than recorded where the arm leaves more than this of what it varies by there.
CUT = 0.1


def refuse_signals(log: Log) -> None:
    """IdentError, one line naming the first, if signals of a log are no angles and torques at even times."""
    refuse_first(tuple(of_signals(log)))


def refuse_slips(log: Log, model: Model, moved: Sequence[Moves]) -> None:
    """IdentError, one line naming the first, if a log is that of another robot but for a slip: a sign, a unit, a column, a gear, a rate."""
    sight = seen(log, model, moved)
    refuse_first(slips(log, sight) or (*_out_of_range(log, model), *_cut_off(log, sight)))


def _out_of_range(log: Log, model: Model) -> Iterator[Fault]:
    """Joints that travel farther than they can."""
    for name, joint, unit, N, column in zip(
        log.joints, model.chain.joints, _units(log, model), log.N, range(log.n), strict=True
    ):
        allowed = joint.upper - joint.lower
        travel = max(float(np.ptp(run.q[:, column])) for run in log.trajectories)
        if np.isfinite(allowed) and 0.0 < RANGE * allowed < travel:
            line = (
                f"{name}: its angle travels over {travel:.4g} {unit}, {travel / allowed:.3g} times the range of its limits in the URDF: check its unit, "
                f"its side of the gear and N = {N:g}"
            )
            yield Fault("angle out of range", name, "", line, REFUSE)


def _units(log: Log, model: Model) -> list[str]:
    return ["m" if model.chain.slides(j) else "rad" for j in range(log.n)]


def _cut_off(log: Log, sight: Sight) -> Iterator[Fault]:
    """Torques that end at a limit which the motion does not know of: those of a motor at its limit move the arm as they are recorded."""
    if not sight.cut.any():
        return
    found = left(sight)
    for j, name in enumerate(log.joints):
        if found.cut[j] * sight.size[j] > CUT * sight.tau[:, j].std():
            top = float(np.abs(sight.tau[sight.cut[:, j], j]).max())
            line = (
                f"{name}: its torque is cut off at about {top / abs(log.N[j]):.4g} N m (motor side) in {sight.cut[:, j].mean():.1%} of the samples, and the "
                "motion asks for more there: the range of its sensor or of its file; record again with a wider one, or move less"
            )
            yield Fault("clipped torque", name, "", line, REFUSE)
