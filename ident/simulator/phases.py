"""Further realisations of a record: the same lines, as strong, in other phases. What they then tell differently is not linear.

R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., Wiley 2012, section 4.3 (robust method).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ident.simulator.design import Setup
from ident.simulator.plant import build_plant
from symgen.chain import Chain
from symgen.robot import Robot


def realised(
    chain: Chain,
    robot: Robot,
    prepared: Callable[[np.random.Generator], Setup],
    draws: Sequence[np.random.SeedSequence],
) -> tuple[Setup, ...]:
    """Returns what is `prepared` from the first of `draws`, and for each further one a record like it in phases from that draw.

    All are as large as the smallest of them: as none may be larger, and a nonlinear arm is another one at another size.
    """
    first = prepared(np.random.default_rng(draws[0]))
    every = [first, *(prepared(_SameLines(draws[0], draw)) for draw in draws[1:])]
    rms = min(setup.excitation.rms for setup in every)
    return tuple(_as_large(chain, robot, setup, rms) for setup in every) if len(every) > 1 else (first,)


class _SameLines(np.random.Generator):
    """Draws what is whole, the lines left out, from one seed, and what is not, the phases, from another."""

    def __init__(self, lines: np.random.SeedSequence, phases: np.random.SeedSequence) -> None:
        super().__init__(np.random.PCG64(lines))
        self._phases = np.random.default_rng(phases)

    def uniform(self, *args: Any, **options: Any) -> Any:
        return self._phases.uniform(*args, **options)


def _as_large(chain: Chain, robot: Robot, setup: Setup, rms: float) -> Setup:
    """The record with another rms, and what is predicted of it."""
    live = list(setup.live)
    free = None if len(live) == chain.n else setup.joint
    drives = [robot.drive(name) for name in chain.names]
    preload = np.abs(build_plant(chain, drives, robot.gravity, setup.posture, free=free).preload[live])
    share = rms / setup.excitation.rms
    return replace(
        setup, excitation=setup.excitation.scaled(rms), swing=share * setup.swing, motion=share * setup.motion,
        torque=preload + share * (setup.torque - preload),
    )  # fmt: skip
