"""A spring that hardens by as much as it is stiff: where a fit with motions that are held goes astray, one that they follow does not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fitting import bench_of

from ident.arm.arm_fit import Held, Problem, chi_squared, hold
from ident.arm.descent import minimise
from ident.arm.following import follow
from ident.arm.parts import degrees, sampled
from ident.arm.sums import summed
from ident.effects.spring import SpringHardening, SpringRelaxation
from ident.records.campaign import Array
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot
from symgen.robot import load_robot

HARD, SLOW = SpringHardening(1, (1e7,)), SpringRelaxation(1, (290.0, 0.087))


@cache
def problem() -> tuple[Problem, Array]:
    """Records of a spring that hardens and creeps; the drive of the joint, and both effects, are to be fitted. The true parameters."""
    robot = load_robot(Path(__file__).parents[3] / "robots/ypp3")
    chain = chain_of_robot(robot)
    short = replace(robot, experiment=replace(robot.experiment, f0=1.0, periods=3))
    cells = [("joint2", q) for q in ([0.0, 0.4, 0.8], [0.0, 1.57, 0.0])]
    bench = bench_of(simulate(chain, short, cells, effects=[HARD, SLOW], workers=1), chain)
    effects, sizes = (HARD, SLOW), (1e7, 290.0, 0.087)
    data = tuple(sampled(one, 6) for one in bench.split.fit)
    whole = bench.problem(data, effects, sizes, [(0.0, np.inf), (0.0, np.inf), (5e-4, np.inf)])
    free, n = np.zeros_like(whole.free), chain.n
    free[[1, n + 1, 2 * n + 1, 3 * n + 1]] = free[whole.base :] = True
    return replace(whole, free=free), np.concatenate([bench.guess.vector(), *(e.values for e in effects)])


def left(p: Problem, vector: Array) -> float:
    return chi_squared(p, vector, hold(p, vector)) / degrees(p.data)


def test_derivatives_are_of_the_motion_that_follows() -> None:
    """Those with the motion held are off by a twelfth."""
    whole, true = problem()
    p = replace(whole, data=whole.data[:1])
    which, step = np.flatnonzero(p.free), 1e-3
    vector = true + np.where(p.free, 0.01, 0.0) * p.scale
    with summed(p) as sums:
        sums.hold(vector)
        held, following = sums.equations(vector)[1], sums.following(vector, which.tolist(), [1])[1]
    weights = [kept.W for kept in hold(p, vector)]

    def chi2(parameter: int, away: float) -> float:
        there = vector + np.where(np.arange(len(true)) == parameter, away, 0.0) * p.scale
        return chi_squared(p, there, [Held(W, kept.moved) for W, kept in zip(weights, hold(p, there), strict=True)])

    rises = np.array([(chi2(k, step) - chi2(k, -step)) / (4.0 * step) for k in which])
    np.testing.assert_allclose(following[which], rises, rtol=0.02)
    assert np.abs(held[which] / rises - 1.0).max() > 0.05


@pytest.mark.parametrize("times", [(1.01, 0.9, 0.9), (1.1, 1.3, 1.5)])
@pytest.mark.bench
def test_a_descent_that_motions_follow_ends_where_one_that_holds_them_does_not(times: tuple[float, ...]) -> None:
    """That one comes near: from farther off the other finds a minimum that is none of the true motion."""
    p, true = problem()
    start = true.copy()
    start[p.base :] *= times
    near = minimise(p, start, outer=8, roughly=1e-4).vector
    found = follow(p, near, [1], 1e-4)
    assert left(p, near) > 3.0
    assert found.converged
    assert left(p, found.vector) < 0.95 < left(p, minimise(p, near, outer=8, roughly=1e-4).vector)


def test_a_record_in_which_the_joint_is_clamped_tells_nothing_of_it() -> None:
    robot = load_robot(Path(__file__).parents[3] / "robots/ypp3")
    chain = chain_of_robot(robot)
    short = replace(robot, experiment=replace(robot.experiment, f0=2.0, periods=3))
    cells = [(joint, [0.0, 0.4, 0.8]) for joint in ("joint1", "joint2")]
    bench = bench_of(simulate(chain, short, cells, lock="rigid", effects=[HARD], workers=1), chain)
    every = (*bench.split.fit, *bench.split.select, *bench.split.report)
    (clamped,) = {one.index: one for one in every if one.excited == 0}.values()
    p = bench.problem((clamped,), [HARD], (1e7,), [(0.0, np.inf)])
    vector = np.concatenate([bench.guess.vector(), HARD.values])
    with summed(p) as sums:
        sums.hold(vector)
        _, slope, information = sums.following(vector, [1, p.base], [1])
    assert np.isfinite(information).all()
    assert not slope[[1, p.base]].any() and slope.any()
