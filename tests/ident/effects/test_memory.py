"""What remembers: stops are those of the definition, in the fit as in a simulation; a torque or an encoder that lags is seen as that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, final

import numpy as np
import pytest
from fitting import bench_of
from outside import OUTSIDE

from ident.effects.hysteresis import Hysteresis
from ident.effects.memory import LOOPS, PRESLIDING, Remembering, remembering, stops
from ident.effects.motion import State
from ident.search.candidates import added, side_of
from ident.search.curves import curves
from ident.search.minima import told
from ident.search.refits import Bench, Refit, fitted, linearised, reduced_chi2, without_effects
from ident.search.refits import State as Fitted
from ident.search.slips import _closer, with_closer_stops
from ident.search.trace import Linearised
from ident.search.tried import refitted
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=2.0, periods=3, fs=500.0))
JOINT, RESTS = 1, (-1.1, 0.31)
THRESHOLDS = (0.05, 0.3, 0.9, 0.1, 1.0)


@final
class Magnetic(Hysteresis):
    """The iron of a motor: what it gives lags behind what is asked for."""

    name, port, sign = "magnetic", "motor", -1.0

    def over_period(self, at: State) -> Any:
        return super().over_period(at.moved("motor", at.tau, at.omega))

    def start(self, step: float) -> tuple[Callable[[State], float], Callable[[State], None]]:
        law, remember = super().start(step)
        return (lambda at: law(at.moved("motor", at.tau, 0.0))), lambda at: remember(at.moved("motor", at.tau, 0.0))


def signal(samples: int = 400) -> np.ndarray:
    """A period that covers 4: more than twice what any threshold of `THRESHOLDS` is."""
    rng, t = np.random.default_rng(1), np.arange(samples) / samples
    x = np.sum([rng.normal() * np.cos(2.0 * np.pi * (k * t + rng.random())) / k for k in range(1, 9)], axis=0)
    return np.asarray(4.0 * x / np.ptp(x))


def at(signal: str, x: object) -> State:
    rest = State(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 100.0, 5000.0)
    return replace(rest, **{signal: x})


def test_a_stop_follows_its_signal_and_slips_at_its_threshold() -> None:
    """Sample by sample, until a period is as the one before."""
    x, r = signal(), np.array(THRESHOLDS[:3])
    play, expected = np.full(len(r), x[0]), np.empty((len(r), len(x)))
    for _ in range(2):
        for k, there in enumerate(x):
            play = np.clip(play, there - r, there + r)
            expected[:, k] = there - play
    np.testing.assert_allclose(stops(x, THRESHOLDS[:3]), expected, atol=1e-12)


def test_what_hardly_moves_does_not_slip_and_what_stands_still_does_nothing() -> None:
    x = signal()
    found = stops(x, [2.0 * np.ptp(x)])[0]
    np.testing.assert_allclose(found - found.mean(), x - x.mean(), atol=1e-12)
    assert not stops(np.full(9, 3.0), THRESHOLDS, 2).any()


@pytest.mark.parametrize("kind", [kind for kind in LOOPS if kind[1] != "sensor"])
def test_a_memory_is_the_same_in_a_simulation_that_goes_on(kind: tuple[str, str]) -> None:
    law, over = remembering(*kind, THRESHOLDS, 2)(JOINT, (0.1, -0.2, 0.3, 0.2, 0.4)), LOOPS[kind].signal
    assert isinstance(law, Remembering)
    torque, remember = law.start(1e-3)
    x, found = signal(), np.empty(400)
    for _ in range(8):
        for k, here in enumerate(x):
            found[k] = torque(at(over, here))
            remember(at(over, here))
    np.testing.assert_allclose(found, law.over_period(at(over, x)), atol=1e-6 * np.ptp(x))


@pytest.mark.parametrize(("port", "against"), [("motor", -1.0), ("link", -1.0), ("spring", 1.0)])
def test_what_sticks_has_the_torque_of_its_height_where_it_slips(port: str, against: float) -> None:
    """Against the motion of a motor or a link; a spring that is wound by friction, too, has more torque."""
    law = remembering(PRESLIDING, port, [0.02], 0)(JOINT, (0.3,))
    up = np.concatenate([np.linspace(-1.0, 1.0, 200), np.linspace(1.0, -1.0, 200)])
    found = law.over_period(at(LOOPS[PRESLIDING, port].signal, up))  # type: ignore[attr-defined]
    np.testing.assert_allclose(found[[100, 300]], [against * 0.3, -against * 0.3])


def test_stops_stand_closer_where_they_carry() -> None:
    """And the law is the same, as yet."""
    sharp = np.geomspace(0.01, 1.0, 9)
    heights = np.where(np.arange(9) == 3, 1.0, 0.0)
    law = remembering(PRESLIDING, "motor", [*sharp, 0.5], 1)(JOINT, (*heights.tolist(), 0.2))
    assert isinstance(law, Remembering)
    closer = _closer(law)
    assert closer.soft == 1 and len(closer.knots) == 3 + 2 * 3 + 1
    assert (min(closer.knots), closer.knots[-2]) == pytest.approx((sharp[2], sharp[4]))
    np.testing.assert_allclose(closer.lags(signal()), law.lags(signal()), atol=1e-12)


@cache
def bench() -> Bench:
    """Short records of a motor whose torque lags, the same to fit, choose and report."""
    chain = chain_of_robot(SHORT)
    cells = [(chain.names[JOINT], angle * np.eye(chain.n)[JOINT]) for angle in RESTS]
    c = simulate(chain, SHORT, cells, effects=[Magnetic(JOINT, (2e-3, 0.05))], workers=1, seed=3)
    return bench_of(c, chain)


@cache
def declared() -> tuple[Fitted, Linearised]:
    start = without_effects(bench())
    return start, linearised(start.problem, start.minimum.vector)


@pytest.mark.bench
def test_a_torque_that_lags_is_drawn_to_the_noise() -> None:
    start, lin = declared()
    likely = curves(lin)[0]
    assert told(likely.effect) == "unknown at joint 2: hysteresis at the motor"
    ((_, hasty),) = refitted(bench(), start, [(likely, lin)])
    found = fitted(bench(), Refit.of(hasty))
    assert reduced_chi2(bench(), found) < 1.1 < 0.1 * reduced_chi2(bench(), start)


@pytest.mark.bench
def test_friction_that_gives_before_it_slides_is_drawn_to_the_noise() -> None:
    """Bristles that slip one after the other, whose motion is found with theirs."""
    chain = chain_of_robot(SHORT)
    cells = [(chain.names[JOINT], angle * np.eye(chain.n)[JOINT]) for angle in RESTS]
    c = simulate(chain, SHORT, cells, effects=[OUTSIDE["bristles"](JOINT, (6e-3, 0.03))], workers=1, seed=3)
    own = bench_of(c, chain)
    start = without_effects(own)
    lin = linearised(start.problem, start.minimum.vector)
    likely = curves(lin)[0]
    assert told(likely.effect) == "unknown at joint 2: presliding at the motor"
    ((_, hasty),) = refitted(own, start, [(likely, lin)])
    found = fitted(own, Refit.of(hasty))
    assert reduced_chi2(own, found) < 1.1 < 0.01 * reduced_chi2(own, start)
    assert with_closer_stops(own, found) is found  # nothing is left


@pytest.mark.parametrize(
    ("kind", "size"),
    [
        pytest.param(
            kind,
            0.01 if kind[0] == PRESLIDING else 0.5,
            marks=() if kind[1] == "motor" else pytest.mark.bench,
        )
        for kind in LOOPS
    ],
)
def test_play_is_seen_where_it_is(kind: tuple[str, str], size: float) -> None:
    """To first order: of a residual that is one stop's, at a threshold between those that are tried."""
    _, lin = declared()
    swing = 0.5 * max(np.ptp(m.signal(LOOPS[kind].signal, JOINT)) for m in lin.motions[side_of(kind[1])])
    play = remembering(*kind, [0.1 * swing], 0)(JOINT, (size,))
    r = tuple(np.zeros_like(r) if x is None else x for r, x in zip(lin.r, added(lin, play), strict=True))
    likely = curves(replace(lin, r=r))[0]
    assert told(likely.effect) == f"unknown at joint 2: {kind[0]} at the {kind[1]}"
