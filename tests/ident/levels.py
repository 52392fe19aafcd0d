"""What one record leaves of the arm that made it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ident.arm.arm_fit import Problem, hold, residual
from ident.arm.coupled import declared_start, problem_of
from ident.arm.evidence import evidence, gravity_basis
from ident.arm.sliding import TURNS
from ident.effects.base import Effect
from ident.records.campaign import Array
from ident.records.frf import estimate
from ident.simulator.bench import design, head, run
from symgen.chain import Chain
from symgen.plan import Model, chain_of_robot, make_model
from symgen.robot import Robot, load_robot

ROBOTS = Path(__file__).parents[2] / "robots"


@cache
def arm(name: str) -> tuple[Robot, Chain, Model]:
    """A robot of the repository, its chain and its model, whose zeros are believed."""
    robot = load_robot(ROBOTS / name)
    chain = chain_of_robot(robot)
    return robot, chain, make_model(chain, believe_zeros=True)


def recorded(
    effect: Effect,
    joint: str,
    posture: tuple[float, ...],
    *besides: Effect,
    robot: str = "ypp3",
    f0: float = 0.5,
    fs: float = 1000.0,
    seed: int = 4,
) -> tuple[Problem, Array]:
    """One record of an arm with effects, as it is to be fitted, and its true parameters."""
    effects, (declared, chain, model) = (effect, *besides), arm(robot)
    declared = replace(declared, experiment=replace(declared.experiment, f0=f0, fs=fs, periods=3))
    (job,) = design(chain, declared, [(joint, posture)], seed=seed, effects=effects)
    campaign = head(chain, declared, (run(job),))
    basis = gravity_basis(model, campaign.gravity)
    frf = estimate(campaign.records[0], campaign)
    data = (evidence(campaign, model, basis, frf, 0, "every"),)
    start = declared_start(campaign, model, (frf,), basis)
    values = [value for one in effects for value in one.values]
    scales, limits = tuple(map(abs, values)), ((-np.inf, np.inf),) * len(values)
    problem = problem_of(campaign, model, basis, data, start, effects, scales, limits)
    return problem, np.concatenate([start.vector(), values])


def levels(effect: Effect, joint: str, posture: tuple[float, ...], *besides: Effect, **how: Any) -> tuple[float, float]:
    """chi^2 per degree of freedom of the true arm in one record, see `recorded`: with the laws of the measured motion, and of the
    smoothed one."""
    problem, vector = recorded(effect, joint, posture, *besides, **how)
    found = []
    for turns in (0, TURNS):
        tried = replace(problem, turns=turns)
        (kept,) = hold(tried, vector)
        r = residual(tried, vector, problem.data[0], kept.moved)[0]
        found.append(float(np.sum(np.abs(kept.W @ r[..., None]) ** 2)) / r.size)
    return found[0], found[1]
