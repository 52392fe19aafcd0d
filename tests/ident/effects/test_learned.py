"""Curves that nobody named: they go through their heights, repeat where they should, and are found in records with their period."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import diagnosed
import numpy as np
import pytest
from fitting import bench_of
from outside import OUTSIDE

import ident.search.curves
from ident.arm.arm_fit import hold
from ident.arm.coupled import declared_start
from ident.arm.evidence import gravity_basis
from ident.effects.base import Effect, Law, Parameter
from ident.effects.catalogue import CATALOGUE
from ident.effects.learned import VARIABLES, LearnedLaw, as_damping, at_knots, bent, learned
from ident.effects.motion import Motion, State
from ident.search.added import drawn_over, outdone, pruned
from ident.search.alike import names_alike
from ident.search.candidates import Candidate, added
from ident.search.curves import PARTS, _columns, _repeating, _shape, _wide_at_ends, curves, wave
from ident.search.minima import fully, told
from ident.search.periods import Spectrum, spectrum
from ident.search.refits import Bench, Refit, fitted, linearised, reduced_chi2, without_effects
from ident.search.refits import State as Fitted
from ident.search.rest import _mended
from ident.search.trace import Linearised, linearise
from ident.search.tried import refitted
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot
from symgen.robot import load_robot

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
SHORT = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=2.0, periods=3, fs=500.0))
FINE = replace(SHORT, experiment=replace(SHORT.experiment, fs=1000.0))
#: Laws so steep at standstill that they are drawn to the noise by finer samples only.
STEEP = ("root-damper", "falling-friction")
#: One record at each rest of the joint: 150 rad of the motor apart, all within 2 rad each.
JOINT, RESTS, NEAR = 1, (-1.1, 0.31, 1.3), (0.31, 0.32)
FOUR = (-1.1, -0.2, 0.31, 1.3)
TEETH = 3.0


class DamagedTooth(Law):
    """One tooth of the motor's gear that winds the spring where it meshes, a quarter of a radian wide."""

    name, port = "damaged-tooth", "spring"
    parameters = (
        Parameter("height", "rad", -1.0, 1.0, (0.1,), linear=True),
        Parameter("place", "rad", 0.0, 7.0, (1.0,), zero=None),
    )

    def law(self, at: State) -> Any:
        off = np.mod(at.theta - self["place"] + np.pi, 2.0 * np.pi) - np.pi
        return at.K * self["height"] * np.exp(-((off / 0.25) ** 2))


LAWS: dict[str, type[Effect]] = {**OUTSIDE, **CATALOGUE, DamagedTooth.name: DamagedTooth}


def state(theta: object, omega: object = 1.0) -> State:
    return State(theta, omega, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 100.0, 5000.0)


def test_a_curve_is_straight_between_its_knots() -> None:
    kind = learned("motor", "position", [-1.0, 0.0, 2.0])
    law = kind(0, (1.0, 3.0, -1.0))
    assert isinstance(law, Law)
    np.testing.assert_allclose(law.law(state(np.array([-1.5, -0.5, 0.0, 1.0, 9.0]))), [1.0, 2.0, 3.0, 1.0, -1.0])


def test_what_a_curve_of_place_passes_on_is_a_share_of_the_load() -> None:
    """Of that of the spring at its motor, and of nothing else."""
    law = learned("motor", "passing", [-1.0, 0.0, 2.0])(0, (0.1, 0.3, -0.1))
    assert isinstance(law, Law)
    assert law.law(replace(state(1.0, 9.0), spring=50.0, tau=7.0)) == pytest.approx(0.1 * 50.0 / 100.0)
    assert "passing" in VARIABLES["motor"]


def test_a_curve_goes_on_beyond_its_ends_as_steeply_as_it_ends() -> None:
    """So adding a slope to all heights adds it everywhere; one of a place stays level."""
    law = learned("motor", "velocity", [-1.0, 0.0, 2.0])(0, (1.0, 3.0, -1.0))
    assert isinstance(law, Law)
    np.testing.assert_allclose(law.law(state(0.3, np.array([-1.5, -1.0, 2.0, 4.0]))), [0.0, 1.0, -1.0, -5.0])
    knots = np.array([-3.0, -1.0, 0.5])
    sloped = learned("spring", "position", knots.tolist())(0, tuple((2.0 * knots).tolist()))
    assert isinstance(sloped, Law)
    x = np.linspace(-9.0, 9.0, 50)
    np.testing.assert_allclose(sloped.law(replace(state(0.0), deflection=x)), 2.0 * x, atol=1e-12)


def test_a_curve_that_bends_is_the_spline_through_its_heights() -> None:
    """So it is any cubic, and the straight line that touches it beyond its ends; friction, waves and three knots do not bend."""
    knots = np.array([-2.0, -0.5, 0.3, 1.0, 3.0])
    cubic = np.polynomial.Polynomial([0.2, -1.0, 0.5, 0.3])
    law = bent(learned("motor", "velocity", knots.tolist())(0, tuple(cubic(knots).tolist())))
    assert isinstance(law, Law)
    x = np.linspace(-2.0, 3.0, 41)
    np.testing.assert_allclose(law.law(state(0.0, x)), cubic(x), atol=1e-12)
    np.testing.assert_allclose(law.law(state(0.0, np.array([4.0]))), [cubic(3.0) + cubic.deriv()(3.0)], rtol=1e-12)
    friction, waves = learned("motor", "sliding", knots.tolist()), learned("motor", "position", knots.tolist(), 6.0)
    few = learned("motor", "velocity", [-1.0, 0.0, 1.0])
    assert all(bent(kind(0, (0.0,) * len(kind.parameters))) is None for kind in (friction, waves, few))
    assert bent(law) is None


def test_what_is_the_slope_of_a_curve_besides_stays_as_it_is() -> None:
    one = bench("detent", 2e-3, TEETH, 0.4)
    n = one.model.chain.n

    def held(port: str, variable: str) -> list[int]:
        curve = learned(port, variable, [-1.0, 0.0, 1.0])(JOINT, (0.0, 0.0, 0.0))
        problem = one.problem(one.split.fit, [curve], [1.0] * 3, [(-1.0, 1.0)] * 3)
        return np.flatnonzero(~problem.free).tolist()

    assert held("spring", "position") == [JOINT]
    assert held("motor", "velocity") == [2 * n + JOINT]
    assert held("spring", "velocity") == [3 * n + JOINT]
    assert held("link", "velocity") == held("motor", "position") == []


def test_a_curve_that_repeats_is_the_fourier_series_of_its_heights() -> None:
    """To 1e-3: the table between whose points lines are straight, at the sixth harmonic."""
    period, order = 0.7, 2.0 * np.pi / 0.7
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 6))

    def series(x: np.ndarray) -> np.ndarray:
        k = order * np.arange(1, 7)
        return 0.3 + np.cos(np.multiply.outer(x, k)) @ a + np.sin(np.multiply.outer(x, k)) @ b

    knots = period * np.arange(13) / 13
    law = learned("motor", "position", knots.tolist(), period)(0, tuple(series(knots).tolist()))
    assert isinstance(law, Law)
    x = rng.uniform(-40.0, 40.0, 500)
    found = law.law(state(x))
    np.testing.assert_allclose(found, series(x), atol=1e-3 * np.abs(found).max())
    assert float(law.law(state(float(x[0])))) == pytest.approx(found[0], rel=1e-12)


def test_friction_by_position_is_against_the_motion_and_gives_nothing_back() -> None:
    kind = learned("motor", "friction", [0.0, 1.0])
    law = kind(0, (2.0, 4.0))
    assert isinstance(law, Law)
    np.testing.assert_allclose(law.law(state(0.5, np.array([5.0, -5.0]))), [-3.0, 3.0])
    assert [p.low for p in kind.parameters] == [0.0, 0.0]


@pytest.mark.parametrize(
    ("port", "variable"),
    [("spring", "velocity"), ("spring", "damping")]
    + [("motor", variable) for variable in ("velocity", "damping", "sliding", "laden", "driving")],
)
def test_a_curve_may_be_a_damping(port: str, variable: str) -> None:
    kind = learned(port, variable, [-9.0, -1.0, 2.0, 9.0])
    law = kind(0, tuple(as_damping(kind(0, (0.0,) * 4)).tolist()))
    moving = State(0.5, 3.0, 0.2, 0.5, 7.0, 1e-3, 3.0, -40.0, 100.0, 5000.0)
    assert isinstance(law, Law)
    assert float(law.law(moving)) == pytest.approx(3.0 if port == "spring" else -3.0)  # that of a spring is on the link


def test_a_curve_that_is_a_factor() -> None:
    """Of the velocity, of the motor's own torque, of a spring's winding; what is dry grows with the load or the drive."""
    moving = State(0.5, 3.0, 0.2, 0.5, 7.0, 1e-3, 0.0, -40.0, 100.0, 5000.0)
    found = []
    for port, variable in [
        ("link", "damping"),
        ("motor", "gain"),
        ("motor", "fading"),
        ("spring", "stiffness"),
        ("spring", "structural"),
    ]:
        law = learned(port, variable, [0.0, 1.0])(0, (2.0, 4.0))
        assert isinstance(law, Law) and not law.dry
        found.append(float(law.law(moving)))
    assert found == pytest.approx([-3.0 * 7.0, 3.0 * 0.2, 8.0 * 0.2, 3.0 * 1e-3, 0.0])
    assert [learned(port, "damping", [0.0, 1.0]).parameters[0].low for port in ("link", "motor")] == [0.0, -1e3]
    for port, variable, expected in [("motor", "driven", -2.4), ("motor", "loaded", -2.4), ("link", "loaded", -3.0)]:
        kind = learned(port, variable, [-50.0, 0.0, 1.0])
        law = kind(0, (3.25, 2.0, 4.0))
        assert isinstance(law, Law) and law.dry and kind.parameters[0].low == 0.0
        assert float(law.law(replace(moving, spring=-40.0 if port == "link" else 20.0))) == pytest.approx(expected)


def bench(name: str, *values: float, rests: tuple[float, ...] = RESTS) -> Bench:
    """Short records with an effect, of no catalogue or of ours, the same to fit, choose and report."""
    return _bench(name, values, rests)  # a cache tells calls apart by how they are written, too


@cache
def _bench(name: str, values: tuple[float, ...], rests: tuple[float, ...]) -> Bench:
    robot = FINE if name in STEEP else SHORT
    chain = chain_of_robot(robot)
    cells = [(chain.names[JOINT], angle * np.eye(chain.n)[JOINT]) for angle in rests]
    c = simulate(chain, robot, cells, effects=[LAWS[name](JOINT, values)], workers=1, seed=3)
    return bench_of(c, chain)


def declared(name: str, *values: float, rests: tuple[float, ...] = RESTS) -> Fitted:
    """The declared arm, fitted to such records."""
    return FIRST(bench(name, *values, rests=rests))


FIRST = cache(without_effects)


def left(name: str, *values: float, rests: tuple[float, ...] = RESTS) -> Linearised:
    """What it leaves of them."""
    return _left(declared(name, *values, rests=rests))


@cache
def _left(found: Fitted) -> Linearised:
    return linearise(found.problem, found.minimum.vector, hold(found.problem, found.minimum.vector))


def test_waves_are_looked_for_beside_dry_friction() -> None:
    """Records are told more finely where friction is found than where more is looked for."""
    end = diagnosed.diagnosis().end
    lin = linearise(end.problem, end.minimum.vector, hold(end.problem, end.minimum.vector))
    seen = spectrum(lin, "motor", "motor", diagnosed.JOINT, 20.0, of="friction")
    assert seen is not None and np.isfinite(seen.fall).all() and seen.fall.max() > 0.0


@pytest.mark.parametrize(
    ("port", "variable", "how"),
    [
        ("link", "velocity", {}),
        ("motor", "position", {}),
        ("link", "friction", {}),
        ("motor", "position", {"repeats": 0.7}),
        ("spring", "position", {"bends": True}),
        ("motor", "fading", {"bends": True}),
    ],
)
def test_the_parts_of_a_curve_make_it(port: str, variable: str, how: dict[str, Any]) -> None:
    """Within its knots and beyond, in some periods at once."""
    knots = np.array([-0.3, -0.1, 0.05, 0.1, 0.2]) if "repeats" not in how else 0.7 * np.arange(5) / 5
    heights = np.array([0.2, -0.4, 0.1, 0.3, -0.2])
    curve = learned(port, variable, knots.tolist(), **how)(1, tuple(heights.tolist()))
    x = np.linspace(-0.5, 0.9, 60).reshape(3, 20)
    np.testing.assert_allclose(np.tensordot(heights, curve.parts(x), 1), curve.height(x), atol=1e-12)
    assert curve.parts(x[:, :0]).shape == (5, 3, 0)
    (single,) = learned("motor", "friction", [0.0])(1, (0.3,)).parts(x)
    assert np.array_equal(single, np.ones_like(x))


def test_curves_are_scored_at_once_as_each_height_alone() -> None:
    """Dry ones, too, where the periods differ, those that repeat themselves, and an encoder's."""
    end = diagnosed.diagnosis().end
    lin = linearise(end.problem, end.minimum.vector, hold(end.problem, end.minimum.vector))
    lin.prepare()
    steps = {"sliding": 0.05, "friction": 0.02, "position": 0.02, "reading": 0.02}
    for port, name in (("motor", "sliding"), ("link", "friction"), ("motor", "position"), ("sensor", "reading")):
        for repeats in (None, 0.1)[: 1 + (name == "position")]:
            knots = steps[name] * (np.arange(5) if repeats else np.arange(-2, 3))
            kind = learned(port, name, knots.tolist(), repeats)
            for heights, column in zip(np.eye(5).tolist(), _columns(lin, kind, diagnosed.JOINT), strict=True):
                for at_once, alone in zip(column, added(lin, kind(diagnosed.JOINT, tuple(heights))), strict=True):
                    assert (at_once is None) == (alone is None)
                    if at_once is not None and alone is not None:
                        np.testing.assert_allclose(at_once, alone, atol=1e-9 * np.abs(alone).max())


@pytest.mark.parametrize("apart", [0.0, 0.2])
def test_what_each_height_makes_is_the_mean_of_periods_that_differ(apart: float) -> None:
    """Near standstill, or in a period that never stands still in any of them."""
    v = (3.0 if apart == 0.0 else 0.0) + np.sin(np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False))
    faster = apart * np.linspace(-1.0, 1.0, 3)[:, None] * np.ones(40)
    signals = {"theta": 1e-3 * np.cumsum(v), "omega": v, "tau": 2.0 * v}
    motion = Motion(
        1e-3, np.ones(2), np.ones(2), lambda name, joint: signals.get(name, np.zeros(40)), lambda port, joint: faster
    )
    for name in ("sliding", "friction", "driven"):
        friction = learned("motor", name, [-5.0, 0.0, 5.0])(1, (0.1, 0.2, 0.3))
        np.testing.assert_allclose(
            np.array(friction.values) @ friction.each(motion), friction.force(motion), atol=1e-12
        )


def test_no_stretch_at_an_end_is_so_short_that_its_slope_means_nothing() -> None:
    """Where records are most of the time may be the end of what they cover: a record that goes beyond had been told nonsense."""
    assert _wide_at_ends(np.array([-2.220, -2.216, -0.6, 0.0, 3.0, 5.95, 5.956])).tolist() == [
        -2.220,
        -0.6,
        0.0,
        3.0,
        5.956,
    ]
    assert _wide_at_ends(np.array([0.0, 0.001, 1.0])).tolist() == [0.0, 1.0]


def test_a_spectrum_is_what_each_wave_explains() -> None:
    """Against the sum over all lines, wave by wave; to 5 %, cells of positions being an eighth of the shortest wave."""
    lin = left("detent", 2e-3, TEETH, 0.4)
    seen = spectrum(lin, "motor", "motor", JOINT, 20.0)
    assert seen is not None
    for order in seen.peaks(3):
        top, bottom = 0.0 + 0.0j, 0.0
        for one, r, ports, motion in zip(lin.problem.data, lin.r, lin.ports, lin.motions["motor"], strict=True):
            for part, unit in ((np.cos, 1.0), (np.sin, 1.0j)):
                wave = ports["motor", JOINT] * one.scene.at_lines(part(order * motion.of("theta", [JOINT])))
                top += unit * float(np.vdot(wave, r).real)
                bottom += 0.5 * float(np.vdot(wave, wave).real)
        k = int(np.argmin(np.abs(seen.orders - order)))
        assert seen.fall[k] == pytest.approx(2.0 * abs(top) ** 2 / bottom, rel=0.05)


@pytest.mark.parametrize(
    ("name", "values", "variable"),
    [
        ("detent", (2e-3, TEETH, 0.4), "position"),
        ("place-friction", (3e-4, TEETH), "friction"),
    ],
)
def test_a_law_that_comes_back_is_found_with_its_period(name: str, values: tuple[float, ...], variable: str) -> None:
    best = curves(left(name, *values))[0].effect
    kind: type[Effect] = type(best)
    assert (best.joint, best.port, kind.variable) == (JOINT, "motor", variable)  # type: ignore[attr-defined]
    times = kind.period / (2.0 * np.pi / values[1])  # type: ignore[attr-defined]
    assert (
        times == pytest.approx(round(times), rel=1e-3) and 1 <= round(times) <= 3
    )  # so often, within a turn of the motor


def test_an_encoder_misreads_by_its_curve() -> None:
    kind = learned("sensor", "reading", [0.0, 1.0])
    error = kind(JOINT, (2e-3, 4e-3))
    motion = left("detent", 2e-3, TEETH, 0.4).motions["motor"][0]
    theta = motion.signal("theta", JOINT)
    found = error.reading(motion)
    assert found is not None and kind.parameters[0].unit == "rad" and not kind.parameters[0].relative
    np.testing.assert_allclose(found, np.interp(theta, [0.0, 1.0], [2e-3, 4e-3]))
    assert error.misread(0.5) == pytest.approx(3e-3) and error.force(motion) is None


@pytest.mark.bench
def test_a_law_that_comes_back_twice_in_what_the_records_cover_is_no_faster_one() -> None:
    teeth = TEETH + 1.0
    lin = left("detent", 2e-3, teeth, 0.4, rests=NEAR)
    x = np.concatenate([motion.of("theta", [JOINT]) for motion in lin.motions["motor"]])
    assert 1.5 < teeth * np.ptp(x) / (2.0 * np.pi) < 3.0
    kind: type[Effect] = type(curves(lin)[0].effect)
    assert kind.period == pytest.approx(2.0 * np.pi / teeth)  # type: ignore[attr-defined]


@pytest.mark.parametrize(("promised", "heights"), [(85.0, 25), (75.0, 13)])
def test_a_wave_that_is_narrow_in_its_period_is_drawn_with_more_heights(
    promised: float, heights: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 100 that are left few heights promise 60."""

    def drawn(lin: Any, shapes: Any, workers: int) -> list[Candidate]:
        kinds = [(kind(joint, (0.0,) * len(kind.knots)), len(kind.knots)) for kind, joint in shapes]
        return [Candidate(effect, 60.0 if count == 13 else promised, ()) for effect, count in kinds]

    monkeypatch.setattr(ident.search.curves, "_drawn", drawn)
    lin: Any = SimpleNamespace(chi2=100.0)
    (found,) = _repeating(lin, "spring", JOINT, "mesh", Spectrum(np.array([3.0]), np.array([50.0]), 0.1), 1)
    assert len(found.effect.values) == heights


@pytest.mark.bench
def test_a_wave_is_found_that_is_not_whole_in_a_turn_of_the_motor() -> None:
    """170 in a turn of the link, 1.7 in one of its motor; its period to 2 %, as far as four rests tell it."""
    found = wave(left("link-magnets", 0.05, 170.0, 0.2, rests=FOUR), "link", JOINT, 4.0)
    assert found is not None
    kind: type[Effect] = type(found.effect)
    assert kind.period == pytest.approx(2.0 * np.pi / 170.0, rel=0.02)  # type: ignore[attr-defined]


def test_a_position_has_its_knots_where_the_records_are() -> None:
    """Three records of 0.02 rad each, 0.9 rad apart and more: none where nothing is, some in each."""
    lin = left("root-damper", 1.0)
    places = [motion.of("q", [JOINT]).ravel() for motion in lin.motions["link"]]
    shape = _shape(lin, "link", JOINT, "position")
    assert shape is not None
    knots = np.array(shape[0].knots)  # type: ignore[attr-defined]
    near = np.ptp(np.concatenate(places)) / PARTS
    covered = [(x.min() - near <= knots) & (knots <= x.max() + near) for x in places]
    assert np.sum(covered) == len(knots) and np.sum(covered, axis=1).min() >= 2


def test_a_deflection_has_knots_where_only_records_of_another_joint_wind_it() -> None:
    """Held there it shows how stiff it is there; but few, as it hardly moves."""
    lin = left("root-damper", 1.0)
    wound = [motion.of("deflection", [JOINT]).ravel() for motion in lin.motions["spring"]]
    most = int(np.argmax([x.max() for x in wound]))
    data = list(lin.problem.data)
    data[most] = replace(data[most], excited=JOINT + 1)
    shape = _shape(replace(lin, problem=replace(lin.problem, data=tuple(data))), "spring", JOINT, "position")
    assert shape is not None
    knots = np.array(shape[0].knots)  # type: ignore[attr-defined]
    highest = max(x.max() for k, x in enumerate(wound) if k != most)
    assert knots[-1] == pytest.approx(wound[most].max()) and highest < knots[-1]
    assert np.sum(knots > highest) < np.sum(knots < highest)


@pytest.mark.bench
def test_a_law_that_is_steepest_at_standstill_is_drawn_to_the_noise() -> None:
    """With as many knots of a velocity that are spread over all of it 1.3 is left."""
    law = "root-damper", 1.0
    (best,) = [c for c in curves(left(*law)) if told(c.effect) == "unknown at joint 2: velocity at the link"]
    tried = refitted(bench(*law), declared(*law), [(best, left(*law))])
    assert reduced_chi2(bench(*law), fitted(bench(*law), Refit.of(tried[0][1]))) < 1.1


@pytest.mark.bench
def test_friction_that_is_lost_with_speed_is_drawn_with_the_motion_that_it_leaves() -> None:
    law = "falling-friction", 0.2, 0.03
    (likely,) = [c for c in curves(left(*law))[:2] if told(c.effect) == "unknown at joint 2: sliding at the link"]
    tried = refitted(bench(*law), declared(*law), [(likely, left(*law))])
    found = fitted(bench(*law), Refit.of(tried[0][1]))
    assert reduced_chi2(bench(*law), declared(*law)) > 10.0
    assert reduced_chi2(bench(*law), found) < 1.1
    v = np.linspace(0.01, 0.2, 50)
    lost = np.concatenate([v, -v])
    drawn, true = found.effects[0], OUTSIDE[law[0]](JOINT, law[1:])
    assert isinstance(drawn, Law) and isinstance(true, Law)
    forces = [np.asarray(one.law(replace(state(0.0), q_rate=lost))) for one in (drawn, true)]
    assert np.abs(forces[0] - forces[1]).max() < 0.1 * law[1]


@pytest.mark.parametrize(
    ("law", "port"),
    [
        pytest.param(("spring-hardening", 1e7), "spring", id="hardening", marks=pytest.mark.bench),
        pytest.param(("torque-ripple", 2e-3, 4.0, 0.5), "motor", id="ripple", marks=pytest.mark.bench),
    ],
)
def test_a_name_that_has_the_force_of_a_curve_is_tried_as_large_as_there(law: tuple[Any, ...], port: str) -> None:
    """From the arm that was found with the curve, which is not bent."""
    tools = bench(*law, rests=FOUR)
    drawn = [
        c
        for c in curves(left(*law, rests=FOUR))
        if told(c.effect).startswith(f"unknown at joint 2: position at the {port}")
    ]
    ((_, state),) = refitted(tools, declared(*law, rests=FOUR), [(drawn[0], left(*law, rests=FOUR))])
    state = fitted(tools, Refit.of(state))
    plain, likely = names_alike(state)
    assert plain.effects == () and likely[0][0].effect.name == law[0]
    assert likely[0][0].effect.values == pytest.approx(law[1:], rel=0.3)
    weaker = likely[1][0].effect
    assert weaker.name == law[0] and weaker.values[0] == pytest.approx(0.8 * likely[0][0].effect.values[0])
    ((_, found),) = refitted(tools, plain, likely[:1])
    assert reduced_chi2(tools, fully(tools, found)) < 1.1


@pytest.mark.parametrize(
    ("law", "expected"),
    [
        pytest.param(("place-damper", 5.0, 170.0), "damping at the link", marks=pytest.mark.bench),
        (("commutation", 0.01, TEETH), "gain at the motor"),
        pytest.param(("uneven-teeth", 0.01, TEETH), "passing at the motor", marks=pytest.mark.bench),
        pytest.param(("mesh-stiffness", 100.0, TEETH), "stiffness at the spring", marks=pytest.mark.bench),
        pytest.param(("pressed-friction", 0.1), "driven at the motor", marks=pytest.mark.bench),
        pytest.param(("fading-torque", 0.02, 20.0), "fading at the motor", marks=pytest.mark.bench),
        pytest.param(("iron-loss", 2e-4, 0.1), "driving at the motor", marks=pytest.mark.bench),
        pytest.param(("laden-damper", 1.0, 10.0), "laden at the link", marks=pytest.mark.bench),
        pytest.param(("rubber-damper", 1.0, 1e-3), "damping at the spring", marks=pytest.mark.bench),
        pytest.param(("encoder-waves", 2e-3, 5.0), "reading at the sensor", marks=pytest.mark.bench),
    ],
)
@pytest.mark.bench
def test_a_law_of_two_signals_is_seen_as_what_it_is(law: tuple[Any, ...], expected: str) -> None:
    assert expected in told(curves(left(*law))[0].effect)


@pytest.mark.bench
def test_a_spring_that_a_tooth_winds_is_seen_as_a_curve_of_its_motor() -> None:
    """By two records, at rests 99 rad of the motor apart."""
    best = curves(left("damaged-tooth", 1e-3, 1.0, rests=RESTS[1:]))[0].effect
    assert isinstance(best, LearnedLaw) and "mesh at the spring" in told(best) and best.joint == JOINT
    assert best.law(replace(state(1.0), deflection=5.0, tau=7.0)) == best.law(state(1.0)), "of nothing else"


@pytest.mark.bench
def test_a_spring_as_stiff_as_where_its_motor_is_is_drawn_to_the_noise() -> None:
    """With its stiffness, fitted besides, held: one of both is told."""
    law = "mesh-stiffness", 100.0, TEETH
    tried = refitted(bench(*law), declared(*law), [(curves(left(*law))[0], left(*law))])
    after = fitted(bench(*law), Refit.of(tried[0][1]))
    assert reduced_chi2(bench(*law), after) < 1.1 < 0.1 * reduced_chi2(bench(*law), declared(*law))
    found, true = after.effects[0], OUTSIDE[law[0]](JOINT, law[1:])
    assert isinstance(found, Law) and isinstance(true, Law)
    x = np.linspace(0.0, 2.0 * np.pi / TEETH, 50) + 100.0 * RESTS[0]
    K = [
        float(after.minimum.vector[JOINT]) + np.asarray(one.law(replace(state(x), deflection=1.0)))
        for one in (found, true)
    ]
    assert np.abs((K[0] - K[0].mean()) - (K[1] - K[1].mean())).max() < 0.1 * law[1]


@pytest.mark.bench  # the next test draws the first of them
@pytest.mark.parametrize("law", [("dead-time", 2e-3, 0.02), ("weak-magnet", 1e-3, 0.1)])
def test_what_an_amplifier_loses_is_seen_in_the_torque_it_gives(law: tuple[Any, ...]) -> None:
    assert told(curves(left(*law))[0].effect) == "unknown at joint 2: drive at the motor"


@pytest.mark.bench
def test_what_an_amplifier_loses_is_drawn_over_the_torque_it_gives() -> None:
    """But for a share of all: records of one joint do not tell that from more inertia."""
    law = "dead-time", 2e-3, 0.02
    tried = refitted(bench(*law), declared(*law), [(curves(left(*law))[0], left(*law))])
    after = fitted(bench(*law), Refit.of(tried[0][1]))
    assert reduced_chi2(bench(*law), after) < 1.1
    t = np.concatenate([motion.of("tau", [JOINT]).ravel() for motion in left(*law).motions["motor"]])
    found, true = after.effects[0], OUTSIDE[law[0]](JOINT, law[1:])
    assert isinstance(found, Law) and isinstance(true, Law)
    forces = [np.asarray(one.law(replace(state(0.0), tau=t))) for one in (found, true)]
    bent = [force - np.polyval(np.polyfit(t, force, 1), t) for force in forces]
    assert np.std(bent[0] - bent[1]) < 0.2 * np.std(bent[1])


@pytest.mark.parametrize(
    ("now", "port", "gain", "expected"),
    [(0.8, "link", 10.0, False), (0.3, "link", 10.0, True), (0.3, "spring", 10.0, False), (0.8, "link", 60.0, True)],
)
def test_curves_outdo_a_name_that_they_leave_little_of(now: float, port: str, gain: float, expected: bool) -> None:
    """A name of size 1 that explained 100 when it was alone."""
    entry = diagnosed.diagnosis().added[0]
    friction = CATALOGUE["link-coulomb"]
    curve = learned(port, "velocity", [-1.0, 1.0])(JOINT, (0.0, 0.0))
    entries = [replace(entry, effect=friction(JOINT, (1.0,)), gain=100.0), replace(entry, effect=curve, gain=gain)]
    assert outdone(friction(JOINT, (now,)), entries) == expected


def test_what_no_record_shows_of_a_curve_stays_at_nothing() -> None:
    tools = bench("detent", 2e-3, TEETH, 0.4)
    start = declared("detent", 2e-3, TEETH, 0.4)
    away = learned("motor", "velocity", [-20.0, 0.0, 20.0, 1000.0, 2000.0])
    heights = (-1e-4, 0.0, 1e-4, 5e-5, 5e-5)
    vector, limits = np.concatenate([start.minimum.vector, heights]), ((-np.inf, np.inf),) * 5
    damping = 2 * len(start.problem.parameters(vector).K) + JOINT
    vector[damping] = tools.guess.vector()[damping]  # what it was more than declared would begin as part of the curve
    found = fitted(tools, Refit(vector, (away(JOINT, heights),), (1e-4,) * 5, limits, 3, 1e-9))
    assert np.abs(found.effects[0].values[-1]) < 1e-6


def test_dry_friction_that_a_curve_outdoes_is_learned_friction_of_one_height() -> None:
    """The same model: of a law that is steep at rest a curve of velocity leaves a step, which is no Coulomb friction."""
    d = diagnosed.diagnosis()
    (named,), entry = d.end.effects, d.added[0]
    curve = learned(named.port, "velocity", [-1.0, 1.0])(named.joint, (1e-6, -1e-6))
    limits, scales = (*d.end.limits, *((-1.0, 1.0),) * 2), (*d.end.scales, 1e-3, 1e-3)
    minimum = replace(d.end.minimum, vector=np.append(d.end.minimum.vector, curve.values))
    both = replace(d.end, effects=(named, curve), scales=scales, limits=limits, minimum=minimum)
    basis = gravity_basis(d.model, d.campaign.gravity)
    tools = Bench(d.campaign, d.model, basis, d.split, declared_start(d.campaign, d.model, d.responses, basis), 1)
    entries = [replace(entry, gain=1.0), replace(entry, effect=curve, gain=100.0)]
    found, left_over = drawn_over(tools, both, d.start, named, entries)
    flat = found.effects[0]
    assert (flat.name, flat.port, flat.joint, flat.values) == ("unknown", named.port, named.joint, named.values)
    assert left_over[0].effect is flat and left_over[1] is entries[1]
    rates = np.array([-3.0, 0.0, 0.01, 5.0])
    assert isinstance(flat, Law) and isinstance(named, Law)
    np.testing.assert_allclose(flat.law(state(0.3, rates)), named.law(state(0.3, rates)))


def with_one_more(tools: Bench, state: Fitted, effect: Effect) -> Fitted:
    """The model with an effect more."""
    size = max(map(abs, effect.values))
    more = (*state.effects, effect), (*state.scales, *(size,) * len(effect.values))
    limits = (*state.limits, *((-np.inf, np.inf),) * len(effect.values))
    return fitted(tools, Refit(np.concatenate([state.minimum.vector, effect.values]), *more, limits))


@pytest.mark.parametrize(
    ("port", "variable", "name", "values", "expected"),
    [
        ("spring", "position", "spring-hardening", (2.0,), [-2.0, 0.25, 16.0]),
        ("spring", "position", "backlash", (1.0,), [2500.0, -2500.0, -2500.0]),
        ("spring", "mesh", "transmission-error", (1e-3, 1.0, 0.5), [5.0 * np.sin(x + 0.5) for x in (-1.0, 0.5, 2.0)]),
        ("motor", "velocity", "motor-quadratic-drag", (3.0,), [3.0, -0.75, -12.0]),
        ("motor", "drive", "motor-quadratic-drag", (3.0,), None),
        ("motor", "sliding", "motor-quadratic-drag", (3.0,), None),
        ("link", "torque", "load-dependent-friction", (0.1,), None),
    ],
)
def test_a_law_at_the_knots_of_a_curve_of_all_that_it_follows_from(
    port: str, variable: str, name: str, values: tuple[float, ...], expected: list[float] | None
) -> None:
    curve, law = learned(port, variable, [-1.0, 0.5, 2.0])(0, (0.0,) * 3), CATALOGUE[name](0, values)
    assert isinstance(curve, LearnedLaw) and isinstance(law, Law)
    heights = at_knots(curve, law, N=100.0, K=5000.0)
    assert (heights is None) == (expected is None)
    if heights is not None and expected is not None:
        np.testing.assert_allclose(heights, expected)


@pytest.mark.bench
def test_a_name_that_a_curve_of_its_variable_outdoes_is_in_its_heights() -> None:
    """The drag of an eddy brake falls beyond one speed: no drag by the square of it."""
    law = "eddy-brake", 2e-3, 5.0
    tools, alone = bench(*law, rests=NEAR), declared(*law, rests=NEAR)
    named = with_one_more(tools, alone, CATALOGUE["motor-quadratic-drag"](JOINT, (1e-6,)))
    here = [c for c in curves(linearised(named.problem, named.minimum.vector)) if c.effect.port == "motor"]
    both = with_one_more(tools, named, next(c.effect for c in here if getattr(c.effect, "variable", "") == "velocity"))
    entries = [replace(diagnosed.diagnosis().added[0], effect=e, gain=1.0) for e in both.effects]
    found, (entry,) = drawn_over(tools, both, alone, both.effects[0], entries)
    assert [type(e) for e in found.effects] == [type(entry.effect)]
    assert entry.effect.name == "unknown" and entry.gain == 2.0
    assert reduced_chi2(tools, found) < 1.1


@pytest.mark.bench
def test_a_name_that_curves_outdo_is_drawn_as_a_curve() -> None:
    """The strongest wave of a law of the position is no torque ripple: most of the law is left for a curve beside it."""
    tools = bench("detent", 2e-3, TEETH, 0.4)
    start = declared("detent", 2e-3, TEETH, 0.4)

    named = with_one_more(tools, start, CATALOGUE["torque-ripple"](JOINT, (1e-4, 2.0 * TEETH, 0.0)))
    lin = linearise(named.problem, named.minimum.vector, hold(named.problem, named.minimum.vector))
    both = with_one_more(tools, named, curves(lin)[0].effect)
    gains = (start.select - named.select, named.select - both.select)
    entry = diagnosed.diagnosis().added[0]
    entries = [replace(entry, effect=e, gain=gain) for e, gain in zip(both.effects, gains, strict=True)]
    found, left_over = pruned(tools, both, entries)
    assert {e.name for e in found.effects} == {"unknown"}
    assert all(any(type(a.effect) is type(e) for a in left_over) for e in found.effects)
    assert found.select < both.select + 100.0


def test_a_name_that_needs_a_curve_at_its_own_port_may_be_another() -> None:
    """One of the motor beside it does not; nor does a number that is declared."""
    curve = learned("spring", "position", [-1.0, 0.0, 1.0])(JOINT, (0.0, 0.1, 0.3))
    play, ripple, damping = (CATALOGUE[name].of(JOINT, {}) for name in ("backlash", "torque-ripple", "spring-damping"))
    assert _mended((play, curve))
    assert not _mended((curve, ripple, damping))
    assert not _mended((play, replace(curve, joint=JOINT + 1)))
