"""The simulated arm with an effect is the arm that the effect's fit side describes; where it is zero nothing has changed."""

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import RANGES, draws
from explaining import Judged, judge
from levels import levels
from outside import OUTSIDE

from ident.arm.arm_fit import Problem, hold, residual
from ident.arm.coupled import declared_start, problem_of
from ident.arm.evidence import evidence, gravity_basis
from ident.arm.sliding import TURNS
from ident.cli import main
from ident.effects.base import Arm, Effect, Known, Law, Parameter
from ident.effects.catalogue import CATALOGUE, parse
from ident.effects.motion import State
from ident.effects.structure import Giving
from ident.errors import ExperimentError
from ident.records.campaign import Campaign, Record
from ident.records.frf import estimate
from ident.simulator import bench
from ident.simulator.bench import Job, design, head, simulate
from ident.simulator.injection import inject
from ident.simulator.machine import Machine
from ident.simulator.plant import build_plant, linearise
from symgen.chain import Chain
from symgen.plan import Model, make_model
from symgen.robot import Experiment, Robot, load_robot
from symgen.urdf import load_chain

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
YPP = load_chain(ROBOT.urdf)
POSTURE = np.array([0.2, 0.5, -0.9])
BENT = np.array([0.0, 0.5, -0.9, 0.3, 0.7, 0.1])
SHORT = Experiment(f0=2.0, band=(2.0, 120.0), periods=3, fs=500.0, swing=0.003, torque_noise=0.0)
QUIET = replace(ROBOT, experiment=SHORT, drives=tuple(replace(d, encoder_counts=2**44) for d in ROBOT.drives))
SMALL = replace(QUIET, experiment=replace(SHORT, swing=1e-3))
#: Lines half as far apart: for what is of second order, for numbers that are off by little, for laws that are narrow.
FINE = replace(QUIET, experiment=replace(SHORT, f0=1.0, band=(1.0, 120.0), fs=1000.0))
#: Twice as many samples: for what is exact.
EXACT = replace(QUIET, experiment=replace(SHORT, fs=1000.0))
NARROW = ("motor-stribeck", "detent")


def run(effects: Sequence[Effect], joint: int = 2, lock: str = "rigid", robot: Any = QUIET, **options: Any) -> Campaign:
    return simulate(YPP, robot, [(YPP.names[joint], POSTURE)], lock=lock, effects=effects, workers=1, **options)


def brief(job: Job) -> Record:
    """The record of a job, one period long beyond what it takes to settle."""
    return bench.run(replace(job, setup=replace(job.setup, periods=job.setup.settle + 1)))


def settled(
    effects: Sequence[Effect], joint: int = 2, lock: str = "rigid", robot: Any = QUIET, **options: Any
) -> Record:
    """The record of `run`, where only its last period matters."""
    (job,) = design(YPP, robot, [(YPP.names[joint], POSTURE)], lock=lock, effects=effects, **options)
    return brief(job)


@cache
def clean() -> Record:
    """The third joint of the arm without any effect."""
    return settled([], robot=FINE)


def judged(effect: Effect, joint: int, lock: str, robot: Any = QUIET, record: Record | None = None) -> Judged:
    """Of `record`, or of one that is simulated for it."""
    record = record or settled([effect], joint, lock, robot)
    drives = tuple(robot.drive(name) for name in YPP.names)
    arm, q = effect.arm(Arm(YPP, drives, np.asarray(robot.gravity)), 0), effect.posture(POSTURE)
    plant = build_plant(arm.chain, arm.drives, arm.gravity, q, free=joint if lock == "rigid" else None)
    linear, J = linearise(plant), np.zeros((3, 3))
    J[np.ix_(plant.live, plant.live)] = linear.link_inertia
    N, K = (np.array([getattr(d, f) for d in arm.drives]) for f in ("N", "K"))
    return judge(record, linear, plant.live, N, Known(N, K, J, q, YPP, np.zeros(3)), plant.preload * N, [effect])


NOTHING = [
    "motor-coulomb:level=0@joint3", "link-coulomb:level=0@joint2", "torque-ripple:amplitude=0,order=4@joint3",
    "spring-hardening:cubic=0@joint3", "backlash:gap=0@joint3", "motor-coupling:ratio=0@joint2", "torque-scale:error=0@joint3",
    "torque-lag:time=0", "input-delay:time=0", "time-offset:time=0", "encoder-eccentricity:amplitude=0@joint3",
    "joint-zero-offset:offset=0@joint3", "attached-resonator:inertia=0@joint3", "motor-viscous:damping=0@joint1",
    "motor-hysteresis:level=0,distance=1@joint2", "spring-hysteresis:level=0,distance=1@joint2",
    "link-hysteresis:level=0,distance=1@joint2", "spring-relaxation:stiffness=0,time=0.01@joint2", "payload:mass=0", "gravity-stiffness:share=0",
    "inertial-parameters:mass=0@joint2", "change-between-records:stiffness=0@joint3", "drift-over-records:stiffness=0,damping=0@joint3", "cable-stiffness:stiffness=0@joint3",
]  # fmt: skip


def test_an_effect_of_size_zero_changes_nothing() -> None:
    clean = settled([], lock="dob", steps=4)
    with_all = settled([parse(text, QUIET.drives) for text in NOTHING], lock="dob", steps=4)
    size = np.abs(clean.theta - clean.theta[0]).max()
    assert np.abs(with_all.theta - clean.theta).max() <= 1e-9 * size  # encoder steps of 2^-44 rev, chains of roundings
    assert np.abs(with_all.tau - clean.tau).max() <= 1e-9 * np.abs(clean.tau).max()


#: Effects the fit explains by its hooks, each at the joint of ypp3 where it shows: name, parameters, joint excited, lock.
SEEN = [
    ("motor-coulomb:level=0.0006@joint3", 2, "rigid"), ("motor-stribeck:level=0.0003,peak=0.0006,speed=0.5@joint3", 2, "rigid"),
    ("motor-quadratic-drag:drag=2e-5@joint3", 2, "rigid"), ("motor-hysteresis:level=0.0006,distance=0.05@joint3", 2, "rigid"),
    ("spring-hysteresis:level=0.06,distance=2e-5@joint3", 2, "rigid"),
    ("link-hysteresis:level=0.06,distance=2e-5@joint3", 2, "rigid"), ("spring-relaxation:stiffness=100,time=0.02@joint3", 2, "rigid"),
    ("torque-ripple:amplitude=0.0001,order=2,phase=0.3@joint3", 2, "rigid"), ("torque-scale:error=0.05@joint3", 2, "rigid"),
    ("motor-coupling:ratio=0.04@joint2", 2, "dob"),
    ("spring-hardening:cubic=1e7@joint2", 1, "rigid"), ("backlash:gap=5e-5@joint1", 0, "rigid"),
    ("transmission-error:amplitude=2e-5,order=2,phase=0.5@joint3", 2, "rigid"), ("link-viscous:damping=0.5@joint3", 2, "rigid"),
    ("link-coulomb:level=0.05@joint3", 2, "rigid"), ("load-dependent-friction:share=0.01@joint2", 1, "rigid"),
    ("cable-stiffness:stiffness=15@joint3", 2, "rigid"), ("time-offset:time=-0.0015", 2, "rigid"),
    ("link-flexibility:stiffness=15000,across=1@joint2", 0, "dob"),
    ("attached-resonator:inertia=0.003,frequency=40@joint3", 2, "dob"),
]  # fmt: skip
#: Those which `arm/test_smoothing.py` explains to the noise.
TO_THE_NOISE = ("motor-coulomb", "motor-stribeck", "spring-hardening", "link-coulomb", "load-dependent-friction", "backlash",
                "transmission-error", "motor-coupling", "spring-hysteresis")  # fmt: skip
#: Those which the two tests after this one hold to 1e-5 and 2e-4.
EXACTLY_SEEN = [
    ("torque-lag:time=0.0005@joint3", 2, "rigid"), ("input-delay:time=0.0027@joint3", 2, "rigid"),
    ("time-offset:time=0.0007@joint3", 2, "rigid"), ("encoder-eccentricity:amplitude=0.01,order=2@joint3", 2, "rigid"),
    ("base-compliance:rock=60000,turn=60000", 1, "dob"), ("link-flexibility:stiffness=15000@joint3", 2, "rigid"),
    ("locked-joint-elasticity:stiffness=4500@joint2", 2, "rigid"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "joint", "lock"),
    [
        *(pytest.param(*one, marks=pytest.mark.bench if one[0].split(":")[0] in TO_THE_NOISE else ()) for one in SEEN),
        *(pytest.param(*one, marks=pytest.mark.bench) for one in EXACTLY_SEEN),
    ],
)
def test_the_fit_side_explains_the_simulated_side(text: str, joint: int, lock: str) -> None:
    """With the true parameters at least nine tenths of what an effect did to the record are explained.

    What is left is friction's harmonics beyond the band and, where all joints move, Coriolis and gravity at this swing.
    """
    effect = parse(text, QUIET.drives)
    found = judged(effect, joint, lock, SMALL if lock == "dob" else FINE if effect.name in NARROW else QUIET)
    assert found.without > 2e-3, "it shows"
    assert found.with_it < 0.1 * found.without


@pytest.mark.parametrize(
    "text",
    [
        *("torque-lag:time=0.0005@joint3", "input-delay:time=0.0016@joint1", "time-offset:time=-0.00035@joint1"),
        *("time-offset:time=0.0007@joint3", "encoder-eccentricity:amplitude=0.02,order=2@joint3"),
        "link-flexibility:stiffness=9000,share=0.6@joint2",
        # the same effects at another joint, in other units of a sample
        pytest.param("torque-lag:time=0.00035@joint1", marks=pytest.mark.bench),
        pytest.param("input-delay:time=0.00034@joint3", marks=pytest.mark.bench),
        pytest.param("encoder-eccentricity:amplitude=0.03,order=1,phase=1@joint1", marks=pytest.mark.bench),
    ],
)
def test_the_fit_is_exact_where_torque_and_angle_arrive_otherwise_or_a_link_bends(text: str) -> None:
    """Switches within samples, aliases of held torques, what is misread on the mean, the weight of what bends: J(q) pays for all."""
    effect = parse(text, QUIET.drives)
    left, theta = unexplained(effect, run([effect], YPP.names.index(text[-6:]), robot=EXACT))
    assert np.linalg.norm(left) < 1e-5 * np.linalg.norm(theta)


def test_in_a_tilted_base_the_declared_links_weigh_aside() -> None:
    effect = parse("gravity-stiffness:share=0,tilt_x=0.2,tilt_y=-0.1", QUIET.drives)
    c = run([effect], 2)
    left, theta = unexplained(effect, c)
    upright, _ = unexplained(effect.with_values([0.0, 0.0, 0.0]), c)
    assert np.linalg.norm(upright) > 1e-3 * np.linalg.norm(theta), "it shows"
    assert np.linalg.norm(left) < 1e-5 * np.linalg.norm(theta)


@pytest.mark.parametrize(
    ("text", "joint", "lock", "left_of_it"),
    [
        ("base-compliance:rock=40000,turn=90000", 1, "dob", 1e-4), ("link-flexibility:stiffness=6000,share=0.64@joint1", 0, "dob", 1e-5),
        pytest.param("link-flexibility:stiffness=6000@joint2", 1, "dob", 1e-5, marks=pytest.mark.bench), ("locked-joint-elasticity:stiffness=4500@joint2", 2, "rigid", 2e-4),
    ],
)  # fmt: skip
def test_what_gives_is_pushed_at_twice_its_lines(
    text: str, joint: int, lock: str, left_of_it: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    effect = parse(text, QUIET.drives)
    c = run([effect], joint, lock, replace(FINE, experiment=replace(FINE.experiment, swing=0.01)))
    left, theta = unexplained(effect, c)
    monkeypatch.setattr(type(effect), "second_order", Effect.second_order)
    without, _ = unexplained(effect, c)
    size = np.linalg.norm(theta)
    assert np.linalg.norm(without) > 5e-4 * size, "it shows"
    assert np.linalg.norm(left) < left_of_it * size


def unexplained(effect: Effect, c: Campaign) -> tuple[np.ndarray, np.ndarray]:
    """What the fit side leaves of the first record at the true parameters, and the angles [L, m]."""
    problem, vector = at_truth([effect], c, make_model(YPP, believe_zeros=True))
    (one,), (kept,) = problem.data, hold(problem, vector)
    return residual(problem, vector, one, kept.moved)[0], one.scene.theta


def at_truth(effects: Sequence[Effect], c: Campaign, model: Model) -> tuple[Problem, np.ndarray]:
    """The fit of the first record, and the true parameters."""
    frf, basis = estimate(c.records[0], c), gravity_basis(model, c.gravity)
    one, start = evidence(c, model, basis, frf, 0, "every"), declared_start(c, model, (frf,), basis)
    values = np.concatenate([effect.values for effect in effects])
    limits = [(-np.inf, np.inf)] * len(values)
    problem = problem_of(c, model, basis, (one,), start, tuple(effects), [1e-3] * len(values), limits)
    return problem, np.concatenate([start.vector(), values])


@cache
def declared(name: str) -> tuple[Robot, Chain, Model]:
    """A robot of the repository in a short experiment with the noise that it has."""
    robot = load_robot(Path(__file__).parents[3] / "robots" / name)
    noisy = replace(robot.experiment, f0=2.0, band=(2.0, robot.experiment.band[1]), periods=3, swing=0.002)
    chain = load_chain(robot.urdf)
    return replace(robot, experiment=noisy), chain, make_model(chain, believe_zeros=name == "ypp3")


@pytest.mark.parametrize(
    ("name", "joint", "lock", "texts"),
    [
        ("arm6", "joint3", "rigid", ["locked-joint-elasticity:stiffness=60000,damping=0.001@joint2", "locked-joint-elasticity:stiffness=11000,damping=0.001@joint5"]),
        pytest.param("arm6", "joint3", "rigid", ["locked-joint-elasticity:stiffness=60000,damping=0.001@joint2", "link-flexibility:stiffness=96000@joint3"], marks=pytest.mark.bench),
        ("arm6", "joint3", "rigid", ["locked-joint-elasticity:stiffness=60000,damping=0.001@joint2", "base-compliance:rock=180000,turn=180000,damping=0.001"]),
        pytest.param("arm6", "joint3", "rigid", ["locked-joint-elasticity:stiffness=11000,damping=0.001@joint5", "attached-resonator:inertia=0.02,frequency=40@joint5"], marks=pytest.mark.bench),
        pytest.param("arm6", "joint2", "dob", ["link-flexibility:stiffness=180000@joint2", "link-flexibility:stiffness=96000@joint3"], marks=pytest.mark.bench),
        # the last case has each of both pairs, and more
        pytest.param("ypp3", "joint2", "dob", ["base-compliance:rock=60000,turn=60000", "link-flexibility:stiffness=15000@joint2"], marks=pytest.mark.bench),
        pytest.param("ypp3", "joint2", "dob", ["base-compliance:rock=60000,turn=60000", "attached-resonator:inertia=0.03,frequency=40@joint2"], marks=pytest.mark.bench),
        pytest.param("ypp3", "joint2", "dob", ["attached-resonator:inertia=0.03,frequency=40@joint3", "link-flexibility:stiffness=15000@joint2"], marks=pytest.mark.bench),
        ("ypp3", "joint2", "dob", ["attached-resonator:inertia=0.03,frequency=40@joint2", "link-flexibility:stiffness=15000@joint2"]),
        ("ypp3", "joint2", "dob", ["link-flexibility:stiffness=15000@joint3", "attached-resonator:inertia=0.03,frequency=40@joint3",
                                   "link-flexibility:stiffness=15000,across=1@joint2", "base-compliance:rock=60000,turn=60000"]),
    ],
)  # fmt: skip
def test_things_that_give_share_what_they_carry(name: str, joint: str, lock: str, texts: list[str]) -> None:
    """Each as if it were alone, they leave 300 to 130 000 times the noise."""
    robot, chain, model = declared(name)
    effects, q = [parse(text, robot.drives) for text in texts], POSTURE if name == "ypp3" else BENT
    (job,) = design(chain, robot, [(joint, q)], seed=4, effects=effects, lock=lock)
    problem, vector = at_truth(effects, head(chain, robot, (bench.run(job),), lock=lock), model)
    problem = replace(problem, turns=TURNS)
    (kept,) = hold(problem, vector)
    left = kept.W @ residual(problem, vector, problem.data[0], kept.moved)[0][..., None]
    assert np.sum(np.abs(left) ** 2) < 1.5 * left.size


PAIRS = [
    (["base-compliance:rock=60000,turn=60000,damping=0.001", "link-flexibility:stiffness=15000@joint2"], 1, "dob"),
    (["link-flexibility:stiffness=12000@joint2", "link-flexibility:stiffness=9000@joint3"], 1, "dob"),
    (["link-flexibility:stiffness=15000@joint2", "attached-resonator:inertia=0.01,frequency=40@joint3"], 1, "dob"),
    (["locked-joint-elasticity:stiffness=4500,damping=0.001@joint2", "link-flexibility:stiffness=9000@joint3"], 2, "rigid"),
]  # fmt: skip


@pytest.mark.parametrize(("texts", "joint", "lock"), PAIRS)
def test_a_fit_follows_things_that_give_together(texts: list[str], joint: int, lock: str) -> None:
    """Its derivatives by their values, and by the arm's that they depend on, are differences of what it predicts."""
    effects = [parse(text, QUIET.drives) for text in texts]
    problem, vector = at_truth(effects, run(effects, joint, lock), make_model(YPP, believe_zeros=True))
    scale = np.where(np.arange(len(vector)) < problem.base, problem.scale, np.maximum(np.abs(vector), 1e-3))
    problem, (one,) = replace(problem, scale=scale), problem.data
    (kept,) = hold(problem, vector)
    _, slopes, columns = residual(problem, vector, one, kept.moved, derive=True)
    slopes *= scale[columns]
    size = np.linalg.norm(one.scene.theta)
    for k, column in enumerate(columns):
        step = 1e-4 * scale[column] * (np.arange(len(vector)) == column)
        ahead, behind = (residual(problem, vector + way, one, kept.moved)[0] for way in (step, -step))
        expected = (ahead - behind) / 2e-4
        if np.linalg.norm(expected) > 1e-3 * size:
            assert np.linalg.norm(slopes[:, :, k] - expected) < 0.01 * np.linalg.norm(expected), column


@pytest.mark.parametrize(
    ("texts", "joint", "lock"),
    [PAIRS[0], PAIRS[3], *(pytest.param(*pair, marks=pytest.mark.bench) for pair in PAIRS[1:3])],
)
def test_things_that_give_push_each_other(
    texts: list[str], joint: int, lock: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `test_what_gives_is_pushed_at_twice_its_lines`, more than one."""
    effects = [parse(text, QUIET.drives) for text in texts]
    c = run(effects, joint, lock, replace(FINE, experiment=replace(FINE.experiment, swing=0.01)))
    problem, vector = at_truth(effects, c, make_model(YPP, believe_zeros=True))
    (one,), size = problem.data, np.linalg.norm(problem.data[0].scene.theta)

    def left() -> float:
        (kept,) = hold(problem, vector)
        return float(np.linalg.norm(residual(problem, vector, one, kept.moved)[0]) / size)

    together = left()
    monkeypatch.setattr(Giving, "second_order", Effect.second_order)
    without = left()
    assert without > 5e-4, "it shows"
    assert together < 1e-4


@pytest.mark.parametrize(
    "text",
    [
        "motor-viscous:damping=1e-4@joint3", "motor-inertia:inertia=3e-6@joint3", "spring-damping:damping=1@joint3",
        "payload:mass=0.4,offset=0.15", "inertial-parameters:mass=0.2,aside=0.01@joint3", "gravity-stiffness:share=0.3,tilt_y=0.2",
        "joint-zero-offset:offset=0.1@joint3",
    ],
)  # fmt: skip
def test_numbers_that_are_off_make_another_linear_arm(text: str) -> None:
    effect = parse(text, QUIET.drives)
    other = settled([effect], robot=FINE)
    assert judged(effect, 2, "rigid", record=other).without < 2e-4, "judged by the plant of the true numbers"
    assert np.std((other.theta - clean().theta)[-1000:, 2]) > 1e-3 * np.std(clean().theta[-1000:, 2])


@pytest.mark.parametrize(
    "text",
    ["change-between-records:record=2,stiffness=-0.2@joint3", "drift-over-records:records=2,stiffness=-0.2@joint3"],
)
def test_a_change_comes_with_its_record(text: str) -> None:
    effect = parse(text, QUIET.drives)
    cells = [("joint3", POSTURE)] * 3
    clean, changed = (map(brief, design(YPP, QUIET, cells, lock="rigid", effects=e)) for e in ([], [effect]))
    away = [
        np.std((b.theta - a.theta)[-500:, 2]) / np.std(a.theta[-500:, 2]) for a, b in zip(clean, changed, strict=True)
    ]
    assert away[0] < 1e-9 and min(away[1:]) > 1e-3


@pytest.mark.bench  # six joints, five seconds a period
def test_what_couples_a_stiff_gear_to_a_light_joint_is_as_stiff_at_rest_as_at_speed() -> None:
    """Far below the mode of the spring its force is all but cancelled: half a percent of it, of how a step foresees the motion without
    that force, was 11 times the noise, most of it below a hertz."""
    (level, _) = levels(CATALOGUE["motor-coupling"](3, (0.15, 2.0)), "joint6", (0.0,) * 6, robot="arm6", f0=0.2)
    assert level < 1.1


RESTING = ["cable-stiffness:stiffness=20,neutral=-0.5@joint2", "spring-hardening:cubic=1e8@joint2", "torque-ripple:amplitude=0.002,order=4@joint2",
           "transmission-error:amplitude=1e-4,order=2@joint2", "torque-offset:offset=0.01@joint3", "torque-scale:error=0.1@joint2",
           "motor-coupling:ratio=0.05@joint2", "joint-zero-offset:offset=0.1@joint2", "payload:mass=0.5", "motor-coulomb:level=0.01@joint2",
           "base-compliance", "link-flexibility@joint2", "attached-resonator:inertia=0.005@joint2", "input-delay:time=0.0015",
           "torque-lag:time=0.001", "encoder-eccentricity:amplitude=0.05,phase=1@joint2", "motor-hysteresis:level=0.01,distance=0.1@joint3"]  # fmt: skip


def test_an_arm_with_effects_rests_where_it_says_it_does() -> None:
    effects = [parse(text, ROBOT.drives) for text in RESTING]
    arm = inject(YPP, ROBOT.drives, ROBOT.gravity, POSTURE, effects)
    machine = Machine(arm, 1e-3, 8)
    N = np.array([d.N for d in ROBOT.drives])
    for _ in range(300):
        machine.advance(arm.plant.preload.tolist(), [0.0] * 3)
    # unstable where gravity tips it: what little rounding there is grows, over 0.3 s, to far less than an encoder's count
    assert np.abs(np.array(machine.angles()) * N - arm.plant.rest).max() < 1e-6


def test_a_motor_that_loses_torque_holds_the_arm_by_more_of_it() -> None:
    amplifier = OUTSIDE["dead-time"](1, (2e-3, 0.01))
    arm = inject(YPP, ROBOT.drives, ROBOT.gravity, POSTURE, [amplifier])
    sound = inject(YPP, ROBOT.drives, ROBOT.gravity, POSTURE, [])
    more = arm.plant.preload - sound.plant.preload
    assert more == pytest.approx([0.0, 2e-3 * np.sign(sound.plant.preload[1]), 0.0], rel=1e-6, abs=1e-12)


def test_the_campaign_tells_nothing_of_the_effect() -> None:
    effect = parse("motor-coulomb:level=0.0006@joint3", QUIET.drives)
    clean, other = run([]), run([effect])
    for name in ("urdf", "joints", "source", "hold", "fs"):
        assert getattr(clean, name) == getattr(other, name)
    assert np.array_equal(clean.D, [3e-5, 3e-5, 1e-5]) and np.array_equal(other.D_spring, [1.2, 1.1, 0.3])
    for name in ("posture", "lines", "rms", "id"):
        assert np.array_equal(getattr(clean.records[0], name), getattr(other.records[0], name))


def test_a_stuck_joint_stays_where_it_is() -> None:
    """Friction beyond the torque: the motor creeps at the speed at which the smoothed sign has the torque, no faster."""
    arm = inject(YPP, ROBOT.drives, [0, 0, 0], POSTURE, [CATALOGUE["motor-coulomb"].of(2, {"level": 0.1})], free=2)
    machine = Machine(arm, 1e-3, 4)
    start = machine.angles()[0]
    for _ in range(1000):
        machine.advance([0.05], [0.0])
    creep = 5e-4 * np.arctanh(0.5)  # joint side
    assert machine.angles()[0] - start == pytest.approx(creep, rel=2e-2, abs=1e-6)


def test_friction_stops_a_free_motor_in_the_time_it_takes() -> None:
    """A torque of two levels for 50 ms, then none: speed up at one level, slow down at one, and no fake inertia."""
    effect = CATALOGUE["motor-coulomb"].of(2, {"level": 0.05})
    arm = inject(YPP, ROBOT.drives, [0, 0, 0], [0, 0, 0], [effect], free=2)
    J = linearise(build_plant(YPP, ROBOT.drives, [0, 0, 0], [0, 0, 0], free=2)).link_inertia[0, 0]
    machine, whole = Machine(arm, 1e-3, 4), J + 100.0**2 * 1e-5
    start = machine.angles()[0]
    for k in range(400):
        machine.advance([0.1 if k < 50 else 0.0], [0.0])
    # 0.05 N m up for 50 ms, 0.05 N m down for as long; viscous damping of motor D = 1e-5 takes about 3 % off
    free = 0.05 * 100 / whole * 0.05**2
    assert machine.angles()[0] - start == pytest.approx(free, rel=0.05)


class Detent(Law):
    """A magnet near one angle."""

    name, port = "detent", "motor"
    parameters = (Parameter("depth", "Nm", 0.0, 1.0, (1e-3,)), Parameter("width", "rad", 0.0, 10.0, (0.2,)))

    def law(self, at: State) -> Any:
        depth, width = self.values
        x = (at.theta + 90.5) / width
        return -depth * x * np.exp(-x * x / 2)


class RootDamper(Law):
    """|v|^0.5: infinitely stiff at rest."""

    name, port = "root-damper", "link"
    parameters = (Parameter("level", "Nm", 0.0, 10.0, (0.2,)),)

    def law(self, at: State) -> Any:
        return -self["level"] * np.sign(at.q_rate) * np.sqrt(np.abs(at.q_rate))


class PlaceFriction(Law):
    """Dry friction that depends on where the motor is."""

    name, port = "place-friction", "motor"
    parameters = (Parameter("level", "Nm", 0.0, 1.0, (6e-4,)),)

    def law(self, at: State) -> Any:
        return -self["level"] * (1 + np.sin(5 * at.theta)) * np.tanh(at.omega / 0.05)


@pytest.mark.parametrize(
    "effect", [Detent(2, (3e-4, 0.2)), RootDamper(2, (0.2,)), PlaceFriction(2, (3e-4,))], ids=lambda e: e.name
)
def test_laws_outside_the_catalogue_can_be_injected(effect: Effect) -> None:
    found = judged(effect, 2, "rigid", FINE if effect.name in NARROW else QUIET)
    assert found.without > 1e-2
    assert found.with_it < 0.1 * found.without


def test_an_effect_that_the_arm_can_not_have_is_one_line() -> None:
    with pytest.raises(
        ExperimentError, match="joint 'joint3' at posture .*locked-joint-elasticity: .* --lock rigid"
    ) as error:
        run([parse("locked-joint-elasticity@joint2", ROBOT.drives)], lock="dob")
    assert "\n" not in str(error.value)


def test_draws_are_visible_and_not_absurd() -> None:
    """Every name once, at a random joint and size: the record departs from the clean one, and the arm stays where it is."""
    cells = [(name, POSTURE) for name in YPP.names]
    rng, robot = np.random.default_rng(3), replace(ROBOT, experiment=SHORT)
    found = draws(rng, len(RANGES), YPP, robot, cells)
    assert {d.effect.name for d in found} >= set(RANGES) - {"torque-offset", "locked-joint-elasticity"}
    assert all(d.effect.joint is None or 0 <= d.effect.joint < 3 for d in found)
    again = draws(np.random.default_rng(3), len(RANGES), YPP, robot, cells)
    assert [d.text for d in found] == [d.text for d in again]


def test_the_command_line_injects_and_tells_the_truth_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs: list[Any] = []
    monkeypatch.setattr("ident.simulator.resume.run_to_file", lambda all_jobs, *_, **__: jobs.extend(all_jobs))
    arguments = [
        "simulate",
        str(ROBOT.path.parent),
        "-o",
        str(tmp_path / "c.h5"),
        "--truth",
        str(tmp_path / "truth.json"),
    ]
    effects = ["--effect", "motor-coulomb:level=0.001@joint2", "--effect", "base-compliance"]
    assert main([*arguments, *effects]) == 0
    assert jobs and all([effect.name for effect in job.effects] == ["motor-coulomb", "base-compliance"] for job in jobs)
    document = json.loads((tmp_path / "truth.json").read_text())
    assert [effect["name"] for effect in document["effects"]] == ["motor-coulomb", "base-compliance"]
    capsys.readouterr()
    assert main([*arguments, "--effect", "motor-coulomb"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("ident: effect 'motor-coulomb': which joint?") and error.count("\n") == 1


def test_six_joints_held_by_their_motors_with_effects_everywhere() -> None:
    robot = load_robot(Path(__file__).parents[3] / "robots" / "arm6")
    chain = load_chain(robot.urdf)
    robot = replace(robot, experiment=replace(SHORT, swing=0.003))
    texts = ["motor-coulomb:level=0.003@joint4", "link-coulomb:level=0.2@joint5", "link-flexibility@joint2", "input-delay:time=0.0005",
             "attached-resonator:inertia=0.01,frequency=60@joint6"]  # fmt: skip
    q = np.array([0.2, -0.8, 0.9, 0.3, 0.5, 0.1])
    effects = [parse(text, robot.drives) for text in texts]
    clean, other = (brief(*design(chain, robot, [("joint4", q)], effects=e)) for e in ([], effects))
    change = np.std((other.theta - clean.theta)[-500:], axis=0)
    assert np.all(np.isfinite(other.theta)) and change[3] > 1e-3 * np.std(clean.theta[-500:, 3])
