"""Motion and force found together: against the simulated arm, which knows both, and an integration in time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from levels import levels, recorded
from outside import OneWayDamper
from scipy.integrate import solve_ivp

import ident.arm.smoothing
from ident.arm.acting import _aside
from ident.arm.arm_fit import chi_squared, hold, slides
from ident.arm.arm_model import Posture
from ident.arm.likely_motion import Force, Forces, LikelyMotion
from ident.arm.rattling import Rattling
from ident.arm.scene import Scene
from ident.arm.sliding import TURNS, Meeting, in_turns
from ident.arm.smoothing import SAME, Mixture
from ident.effects.base import Effect
from ident.effects.friction import LinkCoulomb, LoadDependentFriction, MotorCoulomb, MotorQuadraticDrag, MotorStribeck
from ident.effects.hysteresis import LinkHysteresis, SpringHysteresis
from ident.effects.motion import Motion
from ident.effects.motor import MotorCoupling, TorqueOffset, TorqueScale
from ident.effects.sensor import JointZeroOffset
from ident.effects.spring import Backlash, SpringHardening, TransmissionError
from symgen.plan import chain_of_robot, make_model
from symgen.robot import load_robot

ROBOTS = Path(__file__).parents[3] / "robots"
#: What no force of a test asks for.
LINKS = chain_of_robot(load_robot(ROBOTS / "ypp3"))


@pytest.mark.parametrize(
    ("effect", "joint", "f0", "fs", "measured", "smoothed"),
    [
        pytest.param(MotorCoulomb(0, (4e-3,)), "joint2", 1.0, 500.0, 2.0, 1.15, id="a motor that sticks"),
        # it is so beside what drags in another test
        pytest.param(
            MotorCoulomb(1, (3e-2,)),
            "joint2",
            1.0,
            1e3,
            10.0,
            1.1,
            id="a motor that stops and turns often",
            marks=pytest.mark.bench,
        ),
        pytest.param(
            MotorStribeck(0, (5e-3, 3e-2, 2.0)),
            "joint1",
            2.0,
            1e3,
            2.0,
            1.2,
            id="periods that differ near standstill",
            marks=pytest.mark.bench,
        ),
        # other draws: 0.5 to 2.9 with the smoothed motion, 15 to 1070 with the measured one
        pytest.param(
            MotorStribeck(1, (2e-2, 6e-2, 3.0)),
            "joint2",
            0.5,
            1e3,
            100.0,
            3.0,
            id="turns that do not settle",
            marks=pytest.mark.bench,
        ),
        pytest.param(LinkCoulomb(1, (0.4,)), "joint1", 1.0, 500.0, 100.0, 1.15, id="a link that sticks"),
        pytest.param(
            LinkCoulomb(1, (0.4,)), "joint2", 0.5, 1e3, 1.03, 1.0, id="a link that slides", marks=pytest.mark.bench
        ),
        # the next one hardens more
        pytest.param(
            SpringHardening(1, (3e7,)),
            "joint2",
            1.0,
            500.0,
            100.0,
            1.15,
            id="a spring under load",
            marks=pytest.mark.bench,
        ),
        # motions that turns lead to leave 213 times the noise
        pytest.param(
            SpringHardening(0, (2.5e10,)), "joint1", 1.0, 1e3, 100.0, 1.0, id="a spring that hardens threefold"
        ),
        # it is so under another torque in the test of two effects
        pytest.param(
            LoadDependentFriction(0, (0.4,)),
            "joint1",
            1.0,
            500.0,
            4.0,
            1.0,
            id="a link that rubs by the load it makes",
            marks=pytest.mark.bench,
        ),
    ],
)
def test_true_parameters_explain_a_record_with_the_motion_they_make(
    effect: Effect, joint: str, f0: float, fs: float, measured: float, smoothed: float
) -> None:
    seed = 5 if f0 == 0.5 else 4  # with the fourth what lines so near tell hardly differs by the motion
    by_measured, by_smoothed = levels(effect, joint, (0.0, 0.4, 0.8), f0=f0, fs=fs, seed=seed)
    assert by_smoothed < smoothed
    assert by_measured > measured


@pytest.mark.bench
def test_friction_by_the_load_is_looked_for_under_the_load_with_which_it_was_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Else as many sweeps tell that load anew as did the first time."""
    problem, vector = recorded(LoadDependentFriction(0, (0.4,)), "joint1", (0.0, 0.4, 0.8), f0=2.0)
    problem = replace(problem, turns=TURNS)
    found: list[Forces] = []
    swept = ident.arm.smoothing._swept
    monkeypatch.setattr(ident.arm.smoothing, "_swept", lambda *args: found.append(swept(*args)) or found[-1])
    first = hold(problem, vector)
    sweeps = len(found)
    hold(replace(problem, slid=slides(problem, first)), vector)
    assert len(found) - sweeps < sweeps
    ((key, force),) = found[-1].items()
    assert force.near(found[sweeps - 1][key], 5 * SAME)


@pytest.mark.bench
def test_friction_is_found_together_with_a_hysteresis_at_its_port() -> None:
    """Each is of the motion that both leave: found once, beside a hysteresis of the motion before, 3400 times the noise was left."""
    both = LinkCoulomb(0, (0.3,)), LinkHysteresis(0, (0.3, 2e-4))
    by_measured, by_smoothed = levels(both[0], "joint1", (0.0, 1.57, 0.0), both[1])
    assert by_measured > 1e3 and by_smoothed < 1.0


@pytest.mark.bench
def test_forces_of_second_order_follow_from_the_motion_that_friction_leaves() -> None:
    """Those of the motion that was measured, in which the foot does not stick, leave 1.02 times the noise."""
    posture = (0.0, 0.0, 0.0, 0.0, 0.0, 1.8145)
    assert levels(LinkCoulomb(0, (4.3,)), "joint5", posture, robot="arm6", f0=1.0)[1] < 0.95


def test_terms_of_second_order_are_those_of_the_motion_in_which_links_pull_on_motors() -> None:
    """Measured or likeliest; without the pull 1.2 times the noise is left with the measured one."""
    assert max(levels(MotorCoupling(0, (-0.3, 1.0)), "joint2", (0.0, 0.5, 0.9), fs=500.0)) < 1.1


def test_a_joint_that_an_effect_puts_beside_its_posture_is_fitted_where_it_was() -> None:
    """A tooth that pulls the joint 2 mrad aside: at the posture 3.9 times the noise is left of the light joints' resonances."""
    teeth = TransmissionError(4, (2.06e-5, 2.0, -0.34))
    assert levels(teeth, "joint5", (0.0, 0.0, 0.0, 0.0, 0.0, 1.8145), robot="arm6", f0=1.0, fs=500.0)[1] < 1.0


def test_a_joint_is_beside_its_posture_by_more_than_a_softer_spring_would_do() -> None:
    """Nor where its encoder reads from another zero, or is known to, by the effect."""
    scene: Any = SimpleNamespace(posture=np.array([0.1, 0.5, -0.2]), arm=SimpleNamespace(live=np.array([0, 1, 2])), n=3)

    def aside(rest: list[float], sag: list[float], *effects: Effect) -> list[float]:
        means = np.array(rest), np.array(sag)
        return np.round(
            _aside(scene, effects, Motion(1.0, np.ones(3), np.ones(3), lambda name, joint: means[0], means=means)), 9
        ).tolist()

    assert aside([0.102, 0.501, -0.2], [0.0, 0.004, 0.0]) == [0.002, 0.0, 0.0]
    assert aside([0.1, 0.503, 0.2], [0.0, 0.004, 0.0]) == [0.0, 0.003, 0.0]
    assert aside([0.08, 0.5, -0.2], [0.0] * 3, JointZeroOffset(0, (0.02,))) == [0.0, 0.0, 0.0]


@pytest.mark.bench
def test_what_drags_beside_what_rubs_is_of_the_motion_that_both_leave() -> None:
    assert levels(MotorCoulomb(1, (3e-2,)), "joint2", (0.0, 0.4, 0.8), MotorQuadraticDrag(1, (2e-3,)), f0=1.0)[1] < 1.1


HARD, SCALED = SpringHardening(1, (3e7,)), TorqueScale(1, (0.1,))


@pytest.mark.parametrize(
    ("effect", "beside", "before"),
    [
        pytest.param(HARD, TorqueOffset(1, (0.05,)), 3650.0, id="an offset winds the spring"),
        pytest.param(HARD, SCALED, 3.5, id="a motor that gives more winds the spring further", marks=pytest.mark.bench),
        pytest.param(LoadDependentFriction(1, (0.05,)), SCALED, 71.0, id="and loads its gear more"),
        pytest.param(
            LinkHysteresis(1, (0.5, 1e-4)), HARD, 51.5, id="a spring and what holds its link", marks=pytest.mark.bench
        ),
        pytest.param(LinkCoulomb(1, (0.4,)), HARD, 7.6, id="a spring and what its link rubs on"),
    ],
)
def test_true_parameters_explain_a_record_of_two_effects_at_a_joint(
    effect: Effect, beside: Effect, before: float
) -> None:
    """What was left `before` means were of the torques that act, and sweeps went on as long as forces change."""
    assert levels(effect, "joint2", (0.0, 0.4, 0.8), beside, f0=2.0, fs=500.0)[1] < 1.1 < before


@pytest.mark.bench
def test_play_beside_what_rubs_is_met_where_sweeps_alone_lead_away() -> None:
    """The best of 30 leaves ten times the noise. Of six draws of noise some are explained by another motion near the true one: they leave
    1.2 to 1.3 times the noise, and one 24 times where what play becomes is followed before friction is known only."""
    play, rubs = Backlash(1, (1e-3,)), LinkCoulomb(1, (0.4,))
    left = sorted(levels(play, "joint2", (0.0, 1.2, -0.4), rubs, seed=seed)[1] for seed in range(4, 10))
    assert left[2] < 1.0
    assert left[-1] < 1.4


@pytest.mark.bench
def test_forces_from_which_sweeps_lead_away_are_kept_as_they_left_least(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a spring that hardens and of another joint's motor that sticks: what later sweeps made was kept, and a motion found before
    was never found again."""
    swept = ident.arm.smoothing._swept

    def led_away(arm: Any, effects: Any, laws: Any, on: Forces, slid: dict[Any, Any], *how: Any) -> Forces:
        again = bool(slid)
        on = swept(arm, effects, laws, on, slid, *how)
        if not again:
            return on
        slid.update({key: (10.0 * v, 10.0 * F) for key, (v, F) in slid.items()})
        return {key: Force(10.0 * force.lines, force.mean) for key, force in on.items()}

    problem, vector = recorded(
        SpringHardening(0, (2.5e10,)), "joint1", (0.0, 0.4, 0.8), MotorCoulomb(2, (2e-3,)), f0=2.0, fs=500.0
    )
    problem = replace(problem, turns=TURNS // 4)
    monkeypatch.setattr(ident.arm.smoothing, "_swept", led_away)
    left = []
    for _ in range(3):
        held = hold(problem, vector)
        left.append(chi_squared(problem, vector, held))
        problem = replace(problem, slid=slides(problem, held))
    assert problem.slid
    assert left[1:] == pytest.approx(left[:1] * 2, rel=1e-6)


def test_motors_that_stick_at_every_joint_are_met_together() -> None:
    """By turns at one after the other this record of six left 64 noise powers at the very truth."""
    every = [
        MotorCoulomb(joint, (level,)) for joint, level in enumerate((0.0631, 0.091, 0.0391, 6.45e-3, 5.83e-3, 1.72e-3))
    ]
    posture = (0.0, 0.0, 0.0, 0.0, -0.5, -1.9)
    assert levels(every[0], "joint4", posture, *every[1:], robot="arm6", f0=2.0, fs=500.0)[1] < 1.1


def test_motors_that_turn_the_other_way_than_their_joints_stick_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = load_robot(ROBOTS / "ypp3")
    robot = replace(robot, drives=tuple(replace(drive, N=-drive.N) for drive in robot.drives))
    chain = chain_of_robot(robot)
    monkeypatch.setattr("levels.arm", lambda name: (robot, chain, make_model(chain, believe_zeros=True)))
    besides = [MotorCoulomb(joint, (level,)) for joint, level in ((1, 3.5e-3), (2, 1.1e-3))]
    assert levels(MotorCoulomb(0, (2.7e-3,)), "joint2", (0.0, 0.4, 0.8), *besides, f0=1.0, fs=500.0)[1] < 1.1


def test_a_force_that_leaves_less_than_noise_gives_way_to_that_of_its_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stribeck friction of a held joint: by a few lines beyond the band, which tell little of it, the force of the measured motion left
    0.031 noise powers and that of its own motion 0.035; the model with the former then left 1551."""
    problem, vector = recorded(MotorCoulomb(1, (4e-3,)), "joint2", (0.0, 0.4, 0.8), f0=2.0, fs=500.0)
    problem = replace(problem, turns=TURNS)
    right = chi_squared(problem, vector, hold(problem, vector))
    misfit, begun = LikelyMotion.misfit, []

    def of_start_next_to_none(arm: LikelyMotion, on: Forces) -> float:
        begun.append(on)
        return 1e-3 * arm.degrees if len(begun) == 1 else misfit(arm, on)

    monkeypatch.setattr(LikelyMotion, "misfit", of_start_next_to_none)
    assert chi_squared(problem, vector, hold(problem, vector)) == pytest.approx(right, rel=1e-9)


def test_ports_that_answer_each_other_by_more_than_it_was_settle_by_mixing() -> None:
    """Sweeps alone would lead away: some lines come back by -1.3 of what they were."""
    rng = np.random.default_rng(3)
    answers, true = rng.uniform(-1.3, 0.3, 40), rng.normal(size=40) + 1j * rng.normal(size=40)

    def swept(on: Forces) -> Forces:
        link = true + answers * (0.01 * on["spring", 1].lines - true)
        mean = 1.0 - 1.2 * on["spring", 1].mean
        return {("link", 1): Force(link, mean), ("spring", 1): Force(100.0 * link, mean)}

    on: Forces = {("link", 1): Force(0j * true, 0.0), ("spring", 1): Force(0j * true, 0.0)}
    mixture = Mixture()
    for _ in range(12):
        before, on = on, swept(on)
        assert list(on) == list(before)
        on = mixture.leads(before, on)
    assert np.abs(on["link", 1].lines - true).max() < 1e-2 * np.abs(true).max()
    assert on["spring", 1].mean == pytest.approx(1.0 / 2.2, rel=1e-2)


def test_a_law_of_velocity_settles_by_the_best_line_through_velocity() -> None:
    """With that through position alone 5200 times the noise is left of this record."""
    assert levels(OneWayDamper(0, (5.0,)), "joint1", (0.0, 1.57, 0.0), fs=500.0)[1] < 1.15


def test_a_law_with_a_memory_settles_by_its_best_line() -> None:
    """As one more force of the motion it leaves 1770 times the noise."""
    measured, smoothed = levels(SpringHysteresis(0, (0.11, 4e-5)), "joint1", (0.0, 1.57, 0.0), fs=500.0)
    assert smoothed < 1.15 < measured


@pytest.mark.bench
def test_a_law_with_a_memory_is_met_where_turns_do_not_settle() -> None:
    """Nearly four times as stiff as the spring, where it turns often: 334 times the noise is left of this record without Newton's steps."""
    assert levels(SpringHysteresis(2, (0.5, 3e-5)), "joint3", (0.0, -0.32, -0.02), f0=1.0)[1] < 1.0


@pytest.mark.parametrize(
    ("gap", "posture", "seeds"),
    [
        (5e-5, (0.0, 1.57, 0.0), (5,)),
        (5e-5, (0.0, 1.57, 0.0), (4, 5, 6)),
        (8e-5, (0.0, 1.6884, -1.6884), (4, 5, 6)),
    ],
)
@pytest.mark.bench
def test_play_that_rattles_is_explained(gap: float, posture: tuple[float, ...], seeds: tuple[int, ...]) -> None:
    """Where it hardly touches, contacts told by samples of a line or two are others: 3.1 and 2.7 of the noise would be left."""
    found = [levels(Backlash(0, (gap,)), "joint1", posture, seed=seed)[1] for seed in seeds]  # of one draw: 0.9 to 1.8
    assert np.median(found) < 1.1


@pytest.mark.parametrize(("turns", "periods"), [(1, 0), (TURNS // 4, 4), (TURNS, 12)])
def test_play_is_followed_for_fewer_periods_in_haste_and_for_none_in_a_hurry(
    turns: int, periods: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[int]()

    def likeliest(self: Rattling, x: np.ndarray, force: np.ndarray, periods: int) -> np.ndarray:
        asked.append(periods)
        return force

    monkeypatch.setattr(Rattling, "likeliest", likeliest)
    problem, vector = recorded(Backlash(0, (8e-5,)), "joint1", (0.0, 1.57, 0.0), f0=2.0, fs=500.0)
    hold(replace(problem, turns=turns), vector)
    assert asked[0] == periods


def test_a_velocity_at_which_friction_is_met_already_stays() -> None:
    """Where only rounding is left it is an end of its bracket; a bracket without its ends would send it to the middle."""
    rng = np.random.default_rng(0)
    v, more, g, slope = *rng.normal(0.0, 1e-4, (2, 5000)), 3.0, 10.0
    w = np.nextafter(slope * v + more + g * v, np.inf)
    met = Meeting(lambda where: lambda x: slope * x + more[where], g, 0.05, v.copy(), w, np.zeros(5000))
    assert np.abs(met.goes(w) - v).max() < 1e-9


def test_friction_is_met_wherever_the_velocity_was_before() -> None:
    """From one w to the next, near and far, by friction that falls with speed and is not the same at all samples."""
    rng = np.random.default_rng(1)
    level, g = rng.uniform(0.5, 2.0, 4000), 5.0

    def friction(where):
        return lambda v: level[where] * np.tanh(v / 0.01) * (1.0 + 0.5 * np.exp(-((v / 0.3) ** 2)))

    w = np.sin(np.linspace(0.0, 20.0, 4000))
    met = Meeting(friction, g, 0.0, w / g, w, np.zeros(4000))
    for size in (1.0, 1.01, 5.0, 0.3, 40.0, 40.0001):
        v = met.goes(size * w)
        assert np.abs(friction(slice(None))(v) + g * v - size * w).max() < 1e-8 * size


def one_port(count: int, oversampled: int) -> Scene:
    """A record at so many lines, of one joint that nothing is known of."""
    lines, nothing = np.arange(1, count + 1), np.zeros((count, 1), dtype=complex)
    return Scene(
        arm=Posture(np.array([0]), np.ones(1), np.ones((1, 1, 1)), np.zeros((1, 1, 0))), n=1, lines=lines, f0=1.0,
        fs=1000.0, hold="continuous", tau=nothing, theta=nothing,
        noise=np.zeros((2, 1)), means=np.zeros((2, 1)), posture=np.zeros(1), N=np.ones(1),
        beyond=(lines[:0], nothing[:0], nothing[:0]), chain=LINKS, gravity=np.zeros(3), oversampled=oversampled,
    )  # fmt: skip


def test_the_force_of_friction_is_met_at_one_place_however_it_is_damped() -> None:
    """Beyond its lines a port is a mass: what is given up there must not depend on the resistance of the turns."""
    scene, S = one_port(59, 16), 1024
    lines = scene.lines
    Y = 1.0 / (0.02 * scene.s + 0.05)
    v0 = Y * np.where(lines == 1, 1.2, 0.0)
    assert scene.samples == S
    found = [
        in_turns(scene, lambda where: lambda v: np.tanh(v / 0.02), g, v0, Y, [np.zeros(S)], 3000)[0].lines
        for g in (0.5, 2.0, 8.0)
    ]
    for other in found[1:]:
        assert np.abs(other - found[0]).max() < 1e-2 * np.abs(found[0]).max()


def test_friction_in_turns_is_that_of_an_integrated_mass() -> None:
    """m v' = u - c v - level tanh(v / creep) under two harmonics, for many periods."""
    m, c, level, creep = 0.02, 0.05, 1.0, 0.02
    scene = one_port(199, 20)
    u = np.zeros(199, dtype=complex)
    u[[0, 4]] = 1.0, 0.8j  # odd: no mean velocity

    def push(t: float) -> float:
        return float(np.cos(2 * np.pi * t) - 0.8 * np.sin(10 * np.pi * t))

    def friction(v: np.ndarray) -> np.ndarray:
        return np.asarray(level * np.tanh(v / creep))

    Y = 1.0 / (m * scene.s + c)
    found, slope, _ = in_turns(
        scene, lambda where: friction, 0.5 * float(np.median(1 / np.abs(Y))), Y * u, Y, [np.zeros(scene.samples)], TURNS
    )
    t = np.arange(scene.samples) / scene.samples
    true = solve_ivp(
        lambda at, v: (push(at) - c * v - friction(v)) / m, (0.0, 11.0), [0.0], t_eval=10.0 + t, method="LSODA",
        rtol=1e-9, atol=1e-12, max_step=1e-3,
    )  # fmt: skip
    v = scene.in_time((Y * (u + found.lines))[:, None])[:, 0]
    assert np.max(np.abs(v - true.y[0])) < 5e-3 * np.abs(true.y[0]).max()
    stuck = np.abs(true.y[0]) < creep / 10
    assert 0.05 < stuck.mean() < 0.9
    assert slope[stuck].min() > 0.9 * level / creep > 10 * slope[np.abs(true.y[0]) > 5 * creep].max()
