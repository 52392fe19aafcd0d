"""The catalogue: complete, of one mind about signs and units, refusing in one line; its impedances are those of bodies."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ident.effects.base import PORTS, SCALES, Effect, Known, Law, scale
from ident.effects.catalogue import CATALOGUE, parse, truth
from ident.effects.hysteresis import MotorHysteresis
from ident.effects.impedance import coupling, inertia_and_weight, posed, slopes, weighed
from ident.effects.learned import learned
from ident.effects.motion import SIGNALS, Motion, State
from ident.effects.structure import BaseCompliance, Giving, LinkFlexibility, LockedJointElasticity, all_that_gives
from ident.errors import IdentError
from symgen.plan import chain_of_robot
from symgen.robot import load_robot
from symgen.urdf import load_chain

ROBOTS = Path(__file__).parents[3] / "robots"
ROBOT = load_robot(ROBOTS / "ypp3")
N = 100.0
FORMAT = {
    "motor": "motor-viscous motor-coulomb motor-stribeck motor-quadratic-drag motor-hysteresis motor-inertia torque-ripple "
    "torque-scale torque-offset torque-lag input-delay motor-coupling",
    "spring": "spring-damping spring-hardening backlash transmission-error",
    "link": "link-viscous link-coulomb cable-stiffness payload inertial-parameters gravity-stiffness",
    "sensor": "joint-zero-offset time-offset encoder-eccentricity",
    "structure": "locked-joint-elasticity base-compliance link-flexibility attached-resonator rigid-body-coupling",
}


def test_every_name_of_the_format_is_there() -> None:
    for port, names in FORMAT.items():
        assert {CATALOGUE[name].port for name in names.split()} == {port}
    assert {"load-dependent-friction", "change-between-records"} < set(CATALOGUE)


@pytest.mark.parametrize("name", CATALOGUE)
def test_parameters_are_sound(name: str) -> None:
    cls = CATALOGUE[name]
    assert cls.name == name and cls.port in PORTS and cls.__doc__
    scales = dict.fromkeys(SCALES, 2.0)
    for p in cls.parameters:
        assert p.low < p.high and p.sizes
        assert all(p.low <= size <= p.high for size in p.sizes), p
        assert scale(p.relative, scales) > 0
        assert p.zero is None or p.low <= p.zero <= p.high
    effect = cls.of(0, {})
    assert effect.with_values(effect.values) == effect


def test_a_scale_is_a_product() -> None:
    scales = {"torque": 3.0, "rate": 2.0, "K": 8.0, "angle": 0.5}
    assert scale("", scales) == 1.0
    assert scale("torque/rate^2", scales) == 0.75
    assert scale("K/angle^2", scales) == 32.0


def motion(amplitude: float = 0.5, harmonics: int = 3) -> Motion:
    """One joint at rest at 0.3 rad, swinging, over a period of a second."""
    t = np.arange(4000) / 4000
    w = 2 * np.pi * harmonics
    one = np.ones_like(t)
    theta, omega = amplitude * np.sin(w * t), amplitude * w * np.cos(w * t)
    x, x_rate = 1e-3 * np.sin(w * t + 1), 1e-3 * w * np.cos(w * t + 1)
    columns = (theta + 30.0, omega, 0.01 * one, 0.3 + theta / N - x, omega / N - x_rate, x, x_rate, 5000.0 * x + 2.0)
    told = dict(zip(SIGNALS, columns, strict=True))
    return Motion(1 / 4000, np.array([N]), np.array([5000.0]), lambda name, _: told[name])


LAWS = [name for name, cls in CATALOGUE.items() if issubclass(cls, Law)]
DISSIPATIVE = [
    "motor-coulomb",
    "motor-stribeck",
    "motor-quadratic-drag",
    "load-dependent-friction",
    "link-coulomb",
    "link-viscous",
]
CONSERVATIVE = ["torque-ripple", "torque-offset", "spring-hardening", "backlash", "cable-stiffness"]


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_one_function_of_arrays_and_of_floats(name: str) -> None:
    law = CATALOGUE[name].of(0, {})
    state = motion().state(0)
    together = np.broadcast_to(law.law(state), (4000,))
    for k in (0, 1, 1234):
        one = State(*(float(getattr(state, name)[k]) for name in SIGNALS), state.N, state.K)
        assert float(law.law(one)) == pytest.approx(together[k], rel=1e-12)


def work(name: str) -> float:
    """What the law gives in a period [J], relative to what it moves."""
    law, moved = CATALOGUE[name].of(0, {}), motion()
    assert isinstance(law, Law)
    force = np.broadcast_to(law.law(moved.state(0)), (4000,))
    rate = moved.state(0).at(law.port)[1]
    return float(np.sum(force * rate) / np.sum(np.abs(force * rate)))


@pytest.mark.parametrize("name", DISSIPATIVE)
def test_friction_only_ever_takes(name: str) -> None:
    assert work(name) == pytest.approx(-1.0, abs=1e-12)


@pytest.mark.parametrize("name", CONSERVATIVE)
def test_what_depends_on_the_position_gives_back_what_it_took(name: str) -> None:
    assert abs(work(name)) < 1e-9


def test_the_teeth_give_back_what_they_took_at_spring_and_motor_together() -> None:
    law = CATALOGUE["transmission-error"].of(0, {"amplitude": 1e-3, "order": 3.0, "phase": 0.4})
    moved = motion()
    state = moved.state(0)
    at_spring = -law.law(state) * state.deflection_rate  # a torque of the spring is against its winding
    ((port, joint, at_motor),) = law.loads([state])
    assert (port, joint) == ("motor", 0)
    # the spring's linear torque does work on the error, too, which the motor's load takes
    total = at_spring + at_motor * state.omega
    assert abs(total.sum()) < 1e-9 * np.abs(at_spring).sum()


def test_hysteresis_is_a_loop_of_dahl() -> None:
    """Large swings: a loop of height 2 level, area 4 level amplitude less the rounded corners; small ones: a spring."""
    law = MotorHysteresis(0, (0.02, 0.01))
    force = law.force(motion(5.0))
    assert np.abs(force).max() == pytest.approx(0.02, rel=1e-6)
    lost = -float(np.sum(force * motion(5.0).signal("omega", 0)) / 4000) / 3
    # from -level to level the force lags by the integral of 2 exp(-x/distance): 2 distance, at both turns
    assert lost == pytest.approx(0.02 * (4 * 5.0 - 2 * 2 * 0.01 * 1.0), rel=2e-3)
    small = motion(1e-5)
    swing = small.signal("theta", 0) - 30
    stiffness = -law.force(small) @ swing / np.sum(swing**2)
    assert stiffness == pytest.approx(0.02 / 0.01, rel=1e-2)
    start, remember = law.start(1e-3)
    state = motion().state(0)
    found = []
    for theta in np.tile(motion(5.0).signal("theta", 0), 2).tolist():
        state.theta = theta
        found.append(start(state))
        remember(state)
    assert np.abs(np.array(found[4000:]) - force).max() < 1e-9, "steady from the second period on"


def test_a_spring_that_lags_takes_what_its_loop_encloses() -> None:
    """1 mrad either way, three times a period: 4 level amplitude a loop less its rounded corners."""
    law = CATALOGUE["spring-hysteresis"].of(0, {"level": 0.02, "distance": 1e-6})
    moved = motion()
    taken = float(np.sum(law.force(moved) * moved.signal("deflection_rate", 0)) / 4000) / 3
    assert taken == pytest.approx(0.02 * (4e-3 - 4e-6), rel=2e-3)


def test_a_joint_that_drifts_goes_to_another_one_by_records() -> None:
    drift = CATALOGUE["drift-over-records"].of(1, {"records": 4.0, "stiffness": -0.2, "damping": 1.0})
    assert drift.shares(0) == {}
    assert drift.shares(4) == pytest.approx({"K": -0.2 * (1 - np.exp(-1)), "D": 1 - np.exp(-1)})


def test_a_spring_that_relaxes_gives_what_its_impedance_says() -> None:
    """Wound to and fro at 3 Hz, from rest for 1 s: what begins is gone by then."""
    law = CATALOGUE["spring-relaxation"].of(0, {"stiffness": 100.0, "time": 0.05})
    step, omega = 2e-4, 2 * np.pi * 3.0
    torque, remember = law.start(step)
    found = []
    for t in np.arange(0.0, 1.0, step).tolist():
        remember(State(*(None,) * 5, np.sin(omega * t), *(None,) * 2, N, 1.0))
        found.append(torque(State(*(None,) * 5, np.sin(omega * (t + 0.5 * step)), *(None,) * 2, N, 1.0)))
    last = np.arange(0.0, 1.0, step)[-1] + 0.5 * step
    Z = law.impedance(np.array([1j * omega]), known("ypp3", np.zeros(3))[0])[0]
    assert found[-1] == pytest.approx(np.imag(Z[0, 0] * np.exp(1j * omega * last)), rel=1e-3)
    assert Z[[0, 3]][:, [0, 3]] == pytest.approx(Z[0, 0] * np.array([[1, -1], [-1, 1]]))


def known(name: str, q: np.ndarray) -> tuple[Known, pin.Model, pin.Data]:
    robot = load_robot(ROBOTS / name)
    chain = load_chain(robot.urdf)
    model = pin.buildModelFromUrdf(str(robot.urdf))
    data = model.createData()
    J = pin.crba(model, data, q)
    J = np.triu(J) + np.triu(J, 1).T
    N, K = (np.array([getattr(robot.drive(j), f) for j in chain.names]) for f in ("N", "K"))
    return Known(N, K, J, q, chain, np.zeros(3)), model, data


@pytest.mark.parametrize("name", ["ypp3", "arm6"])
def test_geometry_is_pinocchios(name: str) -> None:
    n = len(load_robot(ROBOTS / name).drives)
    q = np.random.default_rng(5).uniform(-1, 1, n)
    arm, model, data = known(name, q)
    assert arm.chain is not None
    axes = posed(arm.chain, q).twists
    C, _ = coupling(arm.chain, q, axes)  # every joint's own motion, but carrying all links: only the first row is J's
    assert C[0] == pytest.approx(arm.J[0], rel=1e-9, abs=1e-12)
    for i in range(n):
        C, own = coupling(arm.chain, q, axes[[i]], i)
        assert C[0] == pytest.approx(arm.J[i], rel=1e-9, abs=1e-10)
        assert own[0, 0] == pytest.approx(arm.J[i, i], rel=1e-9)
    # the base: what pin's free-flyer would feel, about the base's origin
    C, own = coupling(arm.chain, q, np.hstack([np.zeros((3, 3)), np.eye(3)]))
    pin.centerOfMass(model, data, q)
    pin.ccrba(model, data, q, np.zeros(n))
    assert data.oMi[0].translation == pytest.approx(np.zeros(3))
    momentum = data.Ag[3:] + np.cross(data.com[0], data.Ag[:3].T).T
    assert C == pytest.approx(momentum, rel=1e-9, abs=1e-10)


@pytest.mark.parametrize("name", ["ypp3", "arm6"])
def test_gravity_stiffness_of_a_base_that_turns_is_pinocchios(name: str) -> None:
    """Second differences of the potential with gravity turned the other way."""
    n = len(load_robot(ROBOTS / name).drives)
    q, h = np.random.default_rng(6).uniform(-1, 1, n), 1e-3
    arm, model, data = known(name, q)
    assert arm.chain is not None
    gravity = np.array([1.0, -2.0, -9.0])
    with_joints, own = weighed(arm.chain, q, gravity, np.hstack([np.zeros((3, 3)), np.eye(3)]))

    def potential(turn: np.ndarray, q: np.ndarray) -> float:
        model.gravity.linear = pin.exp3(turn).T @ gravity
        return float(pin.computePotentialEnergy(model, data, q))

    def second(a: np.ndarray, b: np.ndarray) -> float:
        """Mixed difference along two steps of (turn [3], q [n])."""
        at = [potential((i * a + j * b)[:3], q + (i * a + j * b)[3:]) for i, j in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
        return (at[0] - at[1] - at[2] + at[3]) / (4 * h * h)

    steps = h * np.eye(3 + n)
    hessian = np.array([[second(a, b) for b in steps] for a in steps[:3]])
    assert own == pytest.approx(hessian[:, :3], abs=2e-5 * np.abs(hessian).max())
    assert with_joints == pytest.approx(hessian[:, 3:], abs=2e-5 * np.abs(hessian).max())


LINEAR = {
    "attached-resonator": {"inertia": 0.01, "frequency": 30.0},
    "link-flexibility": {"stiffness": 8e3},
    "base-compliance": {"rock": 5e4, "turn": 5e4},
    "motor-coupling": {"ratio": 0.05},
    "link-viscous": {"damping": 1.0},
    "cable-stiffness": {"stiffness": 10.0},
    "locked-joint-elasticity": {"stiffness": 5e3},
}  # fmt: skip


@pytest.mark.parametrize("name", LINEAR)
def test_impedances_are_symmetric_and_passive(name: str) -> None:
    """Reciprocal, and never giving energy: what adds to Z has a Hermitian part of j w Z that is not negative."""
    arm, _, _ = known("ypp3", np.array([0.2, 0.5, -0.9]))
    if name == "locked-joint-elasticity":
        J = np.array(arm.J)
        J[1], J[:, 1] = 0.0, 0.0
        arm = replace(arm, J=J)
    effect = CATALOGUE[name].of(None if CATALOGUE[name].scope == ("arm",) else 1, LINEAR[name])
    w = 2 * np.pi * np.geomspace(0.5, 200, 60)
    Z = effect.impedance(1j * w, arm)
    assert Z is not None and np.abs(Z).max() > 0
    assert np.abs(Z - np.swapaxes(Z, 1, 2)).max() <= 1e-9 * np.abs(Z).max()
    lossy = (Z - np.conj(np.swapaxes(Z, 1, 2))) / 2j  # of Z = -w^2 M + j w D + K: w D
    assert np.linalg.eigvalsh(lossy).min() >= -1e-9 * np.abs(Z).max()


BASE = BaseCompliance(None, (5e4, 8e4, 60.0, 2e-4))
LOCKED, SLIDE = LockedJointElasticity(1, (9e3, 3e-4)), LockedJointElasticity(2, (9e5, 3e-4))
LINKS = (LinkFlexibility(1, (7e3, 0.6, 2e-4, 0.0)), LinkFlexibility(2, (8e3, 0.4, 2e-4, 1.0)), LinkFlexibility(3, (2e3, 0.5, 2e-4, 0.0)))  # fmt: skip


@pytest.mark.parametrize(
    ("name", "effects", "gravity"),
    # what the weight of a base that turns about more than one axis is depends on how its turns are told
    [
        ("arm6", (LOCKED, *LINKS), [1.0, -2.0, -9.0]), ("arm6", LINKS, [1.0, -2.0, -9.0]), ("arm6", (BASE, LOCKED, *LINKS), [0.0] * 3),
        ("scara4", (LINKS[0], SLIDE, LINKS[1], LINKS[2]), [1.0, -2.0, -9.0]), ("scara4", (BASE, SLIDE, LINKS[2]), [0.0] * 3),
    ],
)  # fmt: skip
def test_things_that_give_are_joints_more_of_the_arm(
    name: str, effects: tuple[Giving, ...], gravity: list[float]
) -> None:
    """On springs, and followed to where these have them: what the other joints feel beyond their own inertia and weight."""
    chain, g = chain_of_robot(load_robot(ROBOTS / name)), np.array(gravity)
    q, s = np.random.default_rng(7).uniform(-1, 1, chain.n), 2j * np.pi * np.array([3.0, 14.0, 60.0])
    locked = [effect.joint for effect in effects if isinstance(effect, LockedJointElasticity)]
    live = np.setdiff1d(range(chain.n), locked)
    J = inertia_and_weight(chain, q, g)[0]
    J[locked], J[:, locked] = 0.0, 0.0
    whole, places, springs = chain, [], []
    for effect in reversed(effects):
        whole, more = effect.opened(whole)
        places = [*more, *(place + len(more) for place in places)]
        k = [effect.values[0], effect.values[0], effect.values[1]] if effect is BASE else [effect.values[0]]
        springs = [*(stiffness * (1.0 + s * effect["damping"]) for stiffness in k), *springs]
    links = np.setdiff1d(range(whole.n), places)
    posture = np.zeros(whole.n)
    posture[links] = q
    M, W = inertia_and_weight(whole, posture, g)
    Z = s[:, None, None] ** 2 * M + W
    Z[:, places, places] += np.array(springs).T
    B = Z[:, places][:, :, links[live]]
    expected = -np.swapaxes(B, 1, 2) @ np.linalg.solve(Z[:, places][:, :, places], B)
    found = all_that_gives(s, replace(known(name, q)[0], chain=chain, gravity=g, J=J), effects)
    assert found is not None
    of_links = found[:, chain.n + live][:, :, chain.n + live]
    assert np.abs(of_links - expected).max() < 1e-9 * np.abs(expected).max()


def test_what_gives_is_added_to_what_gives_beside_it() -> None:
    arm, _, _ = known("ypp3", np.array([0.2, 0.5, -0.9]))
    s = 2j * np.pi * np.array([3.0, 14.0, 60.0])
    disc = CATALOGUE["attached-resonator"].of(2, {"inertia": 0.02, "frequency": 30.0})
    effects: list[Effect] = [LinkFlexibility(1, (2e4, 0.5, 2e-4, 0.0)), disc, BASE]
    total = all_that_gives(s, arm, effects)
    assert total is not None
    steps = [effect.impedance(s, replace(arm, beside=tuple(effects[:k]))) for k, effect in enumerate(effects)]
    assert np.abs(sum(steps) - total).max() < 1e-9 * np.abs(total).max()
    assert np.abs(all_that_gives(s, arm, effects[::-1]) - total).max() < 1e-12 * np.abs(total).max(), "in any order"
    apart = sum(effect.impedance(s, arm) for effect in effects)
    assert np.abs(apart - total).max() > 0.1 * np.abs(total).max()
    for effect in effects:
        alone = all_that_gives(s, arm, [effect])
        assert np.abs(effect.impedance(s, arm) - alone).max() < 1e-9 * np.abs(alone).max()
    lossy = (total - np.conj(np.swapaxes(total, 1, 2))) / 2j
    assert np.linalg.eigvalsh(lossy).min() >= -1e-9 * np.abs(total).max()


def test_a_link_on_a_slide_turns_on_its_spring() -> None:
    """About the slide's axis, as the joints before and behind it do: these feel it, the slide does not."""
    arm, _, _ = known("scara4", np.array([0.3, 0.0, 0.05, 0.4]))
    n, s = len(arm.N), 2j * np.pi * np.array([3.0, 30.0])
    Z = LinkFlexibility(2, (1500.0, 0.5, 2e-4, 0.0)).impedance(s, arm)[:, n:, n:]
    assert all(np.abs(Z[:, k, k]).min() > 0 for k in (0, 1, 3)) and not Z[:, 2].any() and not Z[:, :, 2].any()


def test_gains_are_those_of_their_joint() -> None:
    arm, _, _ = known("ypp3", np.zeros(3))
    s = 2j * np.pi * np.array([10.0])
    delayed = CATALOGUE["input-delay"].of(1, {"time": 1e-3}).torque_gain(s, arm)
    assert delayed[0] == pytest.approx([1, np.exp(-2j * np.pi * 0.01), 1])
    assert CATALOGUE["time-offset"].of(None, {"time": 1e-3}).angle_gain(s, arm)[0] == pytest.approx([delayed[0, 1]] * 3)
    assert CATALOGUE["torque-lag"].of(2, {"time": 1e-3}).torque_gain(s, arm)[0, 2] == pytest.approx(
        1 / (1 + s[0] * 1e-3)
    )
    assert CATALOGUE["torque-scale"].of(0, {"error": 0.1}).torque_gain(s, arm)[0] == pytest.approx([1.1, 1, 1])
    assert CATALOGUE["joint-zero-offset"].of(2, {"offset": 0.1}).posture(np.ones(3)) == pytest.approx([1, 1, 1.1])


def test_text_becomes_an_effect() -> None:
    effect = parse("motor-coulomb:level=0.02@joint2", ROBOT.drives)
    assert (effect.name, effect.joint, effect["level"]) == ("motor-coulomb", 1, 0.02)
    base = parse("base-compliance:turn=1e5", ROBOT.drives)
    assert (base.joint, base["turn"], base["rock"]) == (None, 1e5, 10 * 5500.0)
    assert parse("torque-lag", ROBOT.drives).joint is None
    assert truth([effect], ROBOT.drives) == {
        "effects": [
            {"name": "motor-coulomb", "joint": "joint2", "port": "motor", "parameters": {"level": {"value": 0.02, "unit": "Nm"}}}
        ]
    }  # fmt: skip


def test_beyond_the_gear_of_a_slide_units_are_metres_and_newtons() -> None:
    """What is relative to a motion, a force or the spring there, whatever the effect; its motor turns."""
    linear = {"Nm": "N", "rad": "m", "Nm/rad": "N/m", "Nms/rad": "Ns/m", "Nm/rad3": "N/m3"}
    beyond = [kind for kind in CATALOGUE.values() if kind.port in ("spring", "link", "structure") and not kind.turns]
    for kind in [kind for kind in beyond if "joint" in kind.scope]:
        effect = kind.of(2, {})
        for p in [p for p in kind.parameters if p.relative]:
            assert (effect.unit(p, True), effect.unit(p, False)) == (linear[p.unit], p.unit), (kind.name, p.name)
    for text, unit in (("joint-zero-offset", "m"), ("motor-coulomb:level=0.02", "Nm"), ("link-coulomb:level=3", "N")):
        drives = load_robot(ROBOTS / "scara4").drives
        (told,) = truth([parse(text + "@joint3", drives)], drives)["effects"]
        assert [p["unit"] for p in told["parameters"].values()] == [unit]
    for joint, unit in (("joint1", ""), ("joint2", "rad/m"), ("joint3", "m/rad")):  # of this joint, by the next one
        drives = load_robot(ROBOTS / "scara4").drives
        (told,) = truth([parse(f"motor-coupling:ratio=0.003,step=1@{joint}", drives)], drives)["effects"]
        assert [p["unit"] for p in told["parameters"].values()] == [unit, "joints"]
    cogging = learned("link", "friction", (0.0, 0.01, 0.02), 0.03)(2, (0.0,) * 3)
    assert [cogging.curve(slides)[key] for slides in (True, False) for key in ("unit", "period_unit")] == [
        "N",
        "m",
        "Nm",
        "rad",
    ]
    mesh = learned("spring", "mesh", (0.0, 1.0, 2.0), 3.0)(2, (0.0,) * 3).curve(True)
    assert (mesh["unit"], mesh["period_unit"]) == ("N", "rad"), "what repeats itself is the motor's angle"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected name:parameter=value"),
        ("coulomb@joint1", "unknown effect 'coulomb'; expected one of motor-viscous"),
        ("motor-coulomb:level=1", "which joint"),
        ("motor-coulomb:level=1@joint9", "unknown joint 'joint9'; expected one of joint1"),
        ("motor-coulomb:lvl=1@joint1", "unknown parameter 'lvl'; expected level"),
        ("motor-coulomb@joint1", r"level is missing; expected level=<number> \[Nm\]"),
        ("motor-coulomb:level@joint1", "'level'; expected parameter=value"),
        ("motor-coulomb:level=1,level=2@joint1", "each parameter once"),
        ("motor-coulomb:level=x@joint1", "level = 'x'; expected a number"),
        ("motor-coulomb:level=-1@joint1", "level = -1; expected 0 to inf Nm"),
        ("motor-coulomb:level=nan@joint1", "level = nan; expected"),
        ("torque-ripple:amplitude=1,order=1.5@joint1", "expected a whole number"),
        ("input-delay:time=1@joint1", "time = 1; expected 0 to 0.05 s"),
        ("payload:mass=1@joint1", "an effect of the whole arm"),
        ("rigid-body-coupling", "part of every simulated arm"),
        ("motor-coupling:ratio=0.1@joint3", "step = 1 from joint 3 of 3"),
    ],
)
def test_what_can_not_be_is_one_line(text: str, message: str) -> None:
    with pytest.raises(IdentError, match=message) as error:
        parse(text, ROBOT.drives)
    assert "\n" not in str(error.value)


def test_a_disc_that_nothing_turns_is_refused() -> None:
    slides = [replace(drive, linear=True) for drive in ROBOT.drives]
    with pytest.raises(IdentError, match="no joint turns"):
        parse("attached-resonator:inertia=1@joint2", slides)
    assert parse("attached-resonator:inertia=1@joint2", [ROBOT.drives[0], *slides[1:]]).joint == 1
    with pytest.raises(IdentError, match=r"level=<number> \[N\]"):
        parse("link-coulomb@joint2", slides)


def test_declared_effects_need_no_hook_of_the_fit_but_for_what_is_not_declared() -> None:
    """How far the base tilts is no number of the fitted arm, how strong gravity is, is one."""
    for cls in CATALOGUE.values():
        hooks = {
            name
            for name in ("force", "impedance", "torque_gain", "angle_gain", "reading", "posture")
            if getattr(cls, name) is not getattr(Effect, name)
        }
        assert not (cls.declared and hooks) or any(p.declared for p in cls.parameters)
        assert cls.declared or hooks or not cls.injectable


@pytest.mark.parametrize("name", ["arm6", "scara4", "arm7"])
def test_inertia_and_weight_change_with_the_posture_as_their_slopes_say(name: str) -> None:
    chain, gravity, step = chain_of_robot(load_robot(ROBOTS / name)), np.array([1.0, 2.0, -9.81]), 1e-5
    q = np.random.default_rng(2).uniform(-1.0, 1.0, chain.n)
    for k, found in enumerate(slopes(chain, q, gravity)):
        ahead, behind = (
            np.array([inertia_and_weight(chain, q + sign * row, gravity)[k] for row in step * np.eye(chain.n)])
            for sign in (1.0, -1.0)
        )
        expected = (ahead - behind) / (2.0 * step)
        np.testing.assert_allclose(found, expected, atol=1e-8 * max(1.0, np.abs(expected).max()))
