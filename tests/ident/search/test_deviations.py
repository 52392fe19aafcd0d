"""What made the constants of an arm other than declared: told by the fewest numbers, each at its size."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ident.arm.arm_fit import Problem
from ident.arm.descent import Minimum
from ident.arm.evidence import gravity_basis
from ident.effects.base import Effect
from ident.effects.catalogue import CATALOGUE, parse
from ident.effects.declared import GravityStiffness
from ident.effects.link import CableStiffness
from ident.effects.structure import LinkFlexibility
from ident.identification.campaign_model import model_of_campaign
from ident.loop.diagnose import Begun, begin
from ident.records.frf import estimate
from ident.search.bodies import Change, Part
from ident.search.contradicted import Off, contradicted, is_shapeless, merged, standard_deviations
from ident.search.departures import errors
from ident.search.deviations import NAMES, Deviation, _bodies, deviations
from ident.search.refits import State
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot, make_model, plan_of_robot
from symgen.robot import Robot, load_robot

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
#: Standard deviation of every constant, of the largest.
NOISE = 1e-4


def changed(
    mass: float = 0.0, bodies: tuple[float, ...] = (0.0, 0.0, 0.0), gravity: float = 0.0, aside: float = 0.0
) -> Change:
    """The change by a point mass [kg] 0.15 m from the last joint, bodies and gravity heavier by shares, the last one's centre aside [m]."""
    model = make_model(chain_of_robot(ROBOT), believe_zeros=True)
    basis = gravity_basis(model, np.asarray(ROBOT.gravity))
    rows = np.concatenate([model.factoring.W, basis])
    phi = model.chain.parameters.copy()
    was = rows @ phi
    phi *= np.repeat(1.0 + np.array(bodies), 10)
    x, y, z = 0.0, 0.15, 0.0
    phi[20:] += mass * np.array([1.0, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    phi[22] += aside * phi[20]
    now = rows @ phi
    now[len(model.factoring.W) :] *= 1.0 + gravity
    size = NOISE * np.abs(was).max()
    off = now - was + size * np.random.default_rng(4).normal(size=len(was))
    return Change(model, basis, np.eye(len(was)) / size, off, was, np.arange(len(was)))


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ({"bodies": (0.0, 0.2, 0.0)}, {("inertial-parameters", 1): 0.2}),
        ({"bodies": (0.3, -0.2, 0.0)}, {("inertial-parameters", 0): 0.3, ("inertial-parameters", 1): -0.2}),
        ({"bodies": (0.0, 0.0, 0.2), "gravity": 0.1}, {("inertial-parameters", 2): 0.2, ("gravity-stiffness", None): 0.1}),
        ({"mass": 0.5}, {("payload", None): 0.5}),
        ({"mass": 0.5, "gravity": -0.2}, {("payload", None): 0.5, ("gravity-stiffness", None): -0.2}),
        ({"mass": 0.5, "bodies": (-0.3, 0.0, 0.0)}, {("payload", None): 0.5, ("inertial-parameters", 0): -0.3}),
    ],
)  # fmt: skip
def test_what_changed_is_told_with_its_size(how: dict[str, object], told: dict[tuple[str, int | None], float]) -> None:
    change = changed(**how)  # type: ignore[arg-type]
    found = _bodies(change)
    assert all(one.values[0][0] == ("mass" if one.name == "payload" else "share") for one in found)
    sizes = {(one.name, one.joint): one.values[0][1:3] for one in found}
    assert sizes.keys() == told.keys()
    assert all(abs(value - told[key]) < 4.0 * std for key, (value, std) in sizes.items())
    np.testing.assert_allclose(sum(one.change for one in found), change.off, atol=1e-12)  # all undone: as declared


def test_a_body_that_changed_in_another_way_is_told_alone_and_what_does_as_well() -> None:
    change = changed(bodies=(0.0, 0.0, 0.2), aside=-0.05)
    (one,) = _bodies(change)
    assert (one.name, one.joint) == ("inertial-parameters", 2)
    assert [(name, value) for name, value, *_ in one.values] == [("change", change.of_J)]
    (other,) = _bodies(changed(mass=0.5))
    assert ("inertial-parameters", 2) in other.tied


def test_several_links_that_changed_are_the_whole_arm_and_not_the_one_that_explains_most() -> None:
    (one,) = _bodies(changed(bodies=(0.2, -0.15, 0.1), aside=0.02))
    assert (one.name, one.joint, one.tied) == ("inertial-parameters", None, (("payload", None),))
    ((name, size, std, _),) = one.values
    assert name == "change" and 0.02 < size < 0.3 and std < 0.1 * size


def test_what_is_out_of_reach_explains_nothing() -> None:
    change = changed(bodies=(0.2, -0.15, 0.1), aside=0.02)
    parts = [
        (Part(1, 0),),
        (Part(1, 0), Part(1, None)),
        (Part(2, 2),),
        (Part(4, 2), Part(1, None)),
        (Part(1, 1), Part(4, 2)),
    ]
    beyond = [some for some in parts if change.out_of_reach(some)]
    assert beyond
    assert all((found := change.explained(some)) is None or found[0] >= 1.0 for some in beyond)
    assert not changed(mass=0.5).out_of_reach((Part(4, 2),))


@pytest.mark.parametrize(
    "parts",
    [(Part(1, 0), Part(4, 2)), (Part(2, 2), Part(1, None)), (Part(4, 2), Part(1, None))],
    ids=["a body and a load", "a load on the ray and gravity", "a load and gravity"],
)
def test_slopes_are_those_of_the_change(parts: tuple[Part, ...]) -> None:
    change, x = changed(), np.random.default_rng(5).normal(size=sum(part.numbers for part in parts))
    steps = 1e-6 * np.eye(len(x))
    there, back = (np.array([change.by(parts, x + sign * h).sum(axis=0) for h in steps]) for sign in (1.0, -1.0))
    slopes = change.slopes(parts, x)
    np.testing.assert_allclose(slopes, (there - back).T / 2e-6, atol=1e-8 * np.abs(slopes).max())


def short_campaign(robot: Robot, *effects: Effect, f0: float = 2.0, seed: int = 3) -> Begun:
    """What a diagnosis begins with of a few short records."""
    short = replace(robot, experiment=replace(robot.experiment, f0=f0, periods=3, fs=500.0))
    chain = chain_of_robot(short)
    cells = [(cell.joint, np.array(cell.q)) for cell in plan_of_robot(short).cells if not cell.spare]
    campaign = simulate(chain, short, cells, effects=effects, workers=1, seed=seed)
    responses = tuple(estimate(record, campaign) for record in campaign.records)
    return begin(campaign, model_of_campaign(campaign, responses, True, "coupled")[0], responses)


def test_what_is_far_beyond_its_error_is_told_but_not_what_the_law_of_an_effect_may_bend() -> None:
    """A spring's damping 3 % off, of which the records tell 0.1 %."""
    off = parse("spring-damping:damping=0.036@joint1", ROBOT.drives)
    begun = short_campaign(ROBOT, off)
    bench, problem, found = begun.bench, begun.start.problem, begun.start.minimum
    campaign, model = bench.campaign, bench.model
    (one,) = deviations(campaign, model, bench.basis, problem, found)
    ((_, value, std, _),) = one.values
    assert (one.name, one.joint) == ("spring-damping", 0)
    assert value == pytest.approx(0.036, abs=4.0 * std) and std < 0.003
    assert deviations(campaign, model, bench.basis, replace(problem, effects=(off,)), found) == ()


def test_a_number_of_a_drive_is_the_only_parameter_of_its_effect_in_the_unit_of_its_joint() -> None:
    units = {}
    for field, name in NAMES.items():
        kind = CATALOGUE[name]
        (parameter,) = kind.parameters
        units[field] = [kind.unit(parameter, slides) for slides in (False, True)]
        assert kind.declared
    assert units == {"J_m": ["kgm2"] * 2, "D": ["Nms/rad"] * 2, "D_spring": ["Nms/rad", "Ns/m"]}  # motors turn


def undamped(*joints: str) -> Robot:
    """Declared without damping in the springs of these."""
    drives = tuple(replace(drive, D_spring=0.0) if drive.joint in joints else drive for drive in ROBOT.drives)
    return replace(ROBOT, drives=drives)


@pytest.mark.bench
def test_a_damping_where_none_is_declared_is_told_and_what_it_costs_to_keep_none() -> None:
    damped = parse("spring-damping:damping=1.1@joint2", ROBOT.drives)
    begun = short_campaign(undamped("joint2"), damped, f0=1.0, seed=4)
    (off,) = contradicted(begun.bench, begun.start)
    ((_, value, std, _),) = off.deviation.values
    assert (off.deviation.name, off.deviation.joint) == ("spring-damping", 1)
    assert value == pytest.approx(1.1, abs=4.0 * std) and std < 0.01
    assert off.without.problem.parameters(off.without.minimum.vector).D_spring[1] < 1e-5
    # others taken ten times as far as they can follow leave 60 % of the motion, refitted ones 3 %
    noise = errors(begun.bench, begun.start, begun.bench.split.report).noise
    assert 0.02 < off.before < 0.1 and off.after < min(2e-3, 1.1 * noise)


@pytest.mark.bench
def test_no_damping_where_none_is_declared_is_as_declared() -> None:
    begun = short_campaign(undamped("joint2"))
    start = begun.start
    assert deviations(begun.bench.campaign, begun.bench.model, begun.bench.basis, start.problem, start.minimum) == ()


def test_what_no_record_shows_has_no_standard_deviation() -> None:
    """Where a cable pulls to is told by gravity's load on a joint that is measured, if at all."""
    effect, base = CableStiffness(0, (20.0, 0.0)), 6
    values, wide = np.append(np.ones(base), effect.values), np.full(base + 2, 9.0)
    problem = Problem((), 1, 1, 1, (effect,), 2.0 * np.ones(base + 2), -wide, wide, wide > 0.0, lambda scene, q: scene)
    information = np.diag([*np.full(base + 1, 4.0), 0.0])
    state = State((effect,), (2.0,) * 2, ((-9.0, 9.0),) * 2, Minimum(values, information, 1.0, True), problem, 1.0)
    stiffness, neutral = standard_deviations(state, effect, ())
    assert stiffness == pytest.approx(1.0) and np.isnan(neutral)


@pytest.mark.parametrize(
    ("share", "damping", "std", "shapeless"),
    [(0.05, 0.001, 0.14, True), (0.05, 0.001, 0.01, False), (0.2, 0.001, 0.3, False), (0.2, 0.0, 0.01, False)],
)
def test_a_shape_at_its_bound_of_which_no_record_tells_is_none(
    share: float, damping: float, std: float, shapeless: bool
) -> None:
    effect, base = LinkFlexibility(0, (5e3, share, damping, 0.0)), 6
    values, low = np.append(np.ones(base), effect.values), np.array([10.0, 0.05, 0.0, 0.0])
    wide, limits = np.full(base + 4, 1e5), tuple((least, 1e5) for least in low.tolist())
    problem = Problem((), 1, 1, 1, (effect,), np.ones(base + 4), -wide, wide, wide > 0.0, lambda scene, q: scene)
    information = np.diag([*np.ones(base), 1.0, std**-2, 1.0, 1.0])
    state = State((effect,), (1.0,) * 4, limits, Minimum(values, information, 1.0, True), problem, 1.0)
    assert is_shapeless(state) == shapeless


def test_a_number_that_an_effect_has_too_leaves_the_steps_of_its_information_as_they_are() -> None:
    """Those of the arm that the fit began at, which need not be the declared one."""
    effect, base = GravityStiffness(None, (0.0, 0.1, 0.2)), 6
    values, wide = np.append(np.ones(base), effect.values), np.full(base + 3, 9.0)
    problem = Problem((), 1, 1, 1, (effect,), 7.0 * np.ones(base + 3), -wide, wide, wide > 0.0, lambda scene, q: scene)
    minimum = Minimum(values, np.eye(base + 3), 1.0, True)
    state = State((effect,), (7.0,) * 3, ((-9.0, 9.0),) * 3, minimum, problem, 1.0)
    heavier, damped = (
        Off(
            Deviation(name, joint, ((what, -0.2, 0.01, ""),), 9.0, np.zeros(1, dtype=int), np.zeros(1)), 0.2, 0.1, state
        )
        for name, joint, what in (("gravity-stiffness", None, "share"), ("spring-damping", 0, "damping"))
    )
    found, others = merged(state, (heavier, damped))
    assert others == (damped,) and found.effects[0].values == (-0.2, 0.1, 0.2)
    assert found.problem.scale is problem.scale and found.problem.effects_at(found.minimum.vector) == found.effects
