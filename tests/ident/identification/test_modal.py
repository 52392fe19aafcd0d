"""The modal reading: exact records of a coupled arm whose modes two masses can not hold, then MuJoCo's with locks that give."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.stats import chi2, norm
from synthetic import YPP, Arm, campaign, record

from ident.errors import IdentError
from ident.identification.modal import anti_resonances, modal
from ident.joint.fit import PARAMETERS, two_mass
from ident.records.frf import estimate
from ident.simulator.bench import simulate
from symgen.plan import chain_of_robot
from symgen.robot import load_robot

ROBOT = Path(__file__).parents[3] / "robots" / "ypp3"

#: Of 0.25 Hz; and half of them as far up, of 0.5 Hz.
LINES, FEW = np.arange(1, 480, 2), np.arange(1, 240, 2)
#: A rotor this much heavier than it is does not move.
HELD = 1e7
#: Without gravity the sum of the modal masses is J_ii.
FREE = replace(YPP, K_g=np.zeros((3, 3)))


def measured(arm: Arm, excited: int, *, lines: np.ndarray = FEW, f0: float = 0.5, seed: int = 2):
    """A record of the arm with all motors but one held: their springs give all the same."""
    held = replace(arm, J_m=np.where(np.arange(len(arm.K)) == excited, 1.0, HELD) * arm.J_m)
    gains = held.J_m[:, None] * [(2 * np.pi) ** 2, 4 * np.pi]  # PD of 1 Hz
    rng = np.random.default_rng(seed)
    data = record(held, excited, lines=lines, f0=f0, rms=0.05, gains=gains, rng=rng)
    whole = campaign(arm, [data])
    return estimate(whole.records[0], whole), whole


@pytest.mark.parametrize("excited", [0, pytest.param(1, marks=pytest.mark.bench), 2])
def test_all_mode_pairs_give_what_two_masses_can_not(excited: int) -> None:
    frf, whole = measured(FREE, excited)
    found = modal(frf, whole, FREE.J)
    true = FREE.J[excited, excited]
    assert found.explained, found.status
    assert abs(found.J_l - true) < max(4 * found.std_inflated[2], 1e-3 * true)
    assert found.J_l == pytest.approx(true, rel=0.05)
    assert found.K == pytest.approx(FREE.K[excited], rel=0.01) and found.J_m == pytest.approx(
        FREE.J_m[excited], rel=2e-3
    )
    inverse, shapes = eigh(FREE.J, np.diag(FREE.K))
    share = inverse * (shapes[excited] * FREE.K[excited]) ** 2
    f = 1 / (2 * np.pi * np.sqrt(inverse))
    seen = share > 0.02 * share.sum()
    for frequency, mass in zip(f[seen], share[seen], strict=True):
        nearest = np.argmin(np.abs(found.f_AR - frequency))
        assert found.f_AR[nearest] == pytest.approx(frequency, rel=0.01)
        assert found.mass[nearest] == pytest.approx(mass, rel=0.05)
    if excited == 2:  # light, and coupled to a heavy neighbour
        apart = two_mass(frf, 100.0, whole.fs, whole.hold)
        assert abs(apart.J_l / true - 1) > 0.05 and not apart.explained


def test_it_is_equations_5_and_6_for_all_pairs() -> None:
    """J_ii = N^2 J_m (prod f_R^2 / f_AR^2 - 1) with the resonances of the fitted modes (others held, no damping)."""
    frf, whole = measured(FREE, 2)
    found = modal(frf, whole)
    N2J = 100.0**2 * found.J_m
    w2 = (2 * np.pi * found.f_AR) ** 2
    size = len(w2) + 1  # the motor as one mass, each mode as a mass on a spring of mu w^2
    K = np.diag(np.concatenate([[np.sum(found.mass * w2)], found.mass * w2]))
    K[0, 1:] = K[1:, 0] = -found.mass * w2
    squares = eigh(K, np.diag(np.concatenate([[N2J], found.mass])), eigvals_only=True)
    product = np.prod(squares[1:size] / w2[np.argsort(w2)])
    assert N2J * (product - 1) == pytest.approx(found.mass.sum(), rel=1e-6)


@pytest.mark.bench  # single draws are within four deviations in the tests before and after
@pytest.mark.parametrize("excited", [2, 1])
@pytest.mark.parametrize("draws", [8, 40])
def test_errors_are_those_that_are_predicted(excited: int, draws: int) -> None:
    """Draws of the elbow, all else held, and of the shoulder, all held softly: errors over their standard deviations.
    Chance would exceed the limits once in 10^4."""
    names = ["J_m", "K", "J_l", "D", "D_spring"]
    true = np.array([FREE.J[excited, excited] if name == "J_l" else getattr(FREE, name)[excited] for name in names])
    use, z = [PARAMETERS.index(name) for name in names], []
    for seed in range(draws):
        if excited == 2:
            found = modal(*measured(FREE, 2, seed=100 + seed))
        else:
            gains, rng = np.array([[0.8, 8e-3], [0.4, 4e-3], [0.2, 2e-3]]), np.random.default_rng(seed)
            whole = campaign(FREE, [record(FREE, 1, lines=FEW, f0=0.5, rms=0.05, gains=gains, rng=rng)])
            found = modal(estimate(whole.records[0], whole), whole)
        z.append((found.parameters[use] - true) / found.std_inflated[use])
    spread = np.mean(np.square(z), axis=0)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], draws) / draws
    assert np.all((spread > low) & (spread < high)), spread
    assert np.all(np.abs(np.mean(z, axis=0)) < norm.ppf(1 - 5e-5) / np.sqrt(draws)), np.mean(z, axis=0)


@pytest.mark.parametrize(("damping", "K_g"), [(0.01, 0.0), (0.1, 0.0), (0.1, 100.0), (0.01, -20.0)])
def test_damped_springs_and_gravity_are_told_apart(damping: float, K_g: float) -> None:
    """One joint. The spring's damping lowers the constant of Z (10 %: by 4 % of K), gravity acts through the spring."""
    K, J = 4500.0, 0.4
    arm = Arm.joint(4e-5, K, J, 3e-5, 2 * damping * np.sqrt(K * J), K_g)
    data = record(arm, 0, lines=LINES, f0=0.25, rms=0.05, noise=1e-3, gains=np.array([[0.01, 1e-3]]))
    whole = campaign(arm, [data])
    found = modal(estimate(whole.records[0], whole), whole)
    assert found.explained, found.status
    for name, true in (("J_m", 4e-5), ("K", K), ("J_l", J), ("K_g", K_g)):
        std = found.std[PARAMETERS.index(name)]
        assert std < 0.01 * K if name == "K_g" else std < 1e-3 * true
        assert abs(getattr(found, name) - true) < 4 * std, name


@pytest.mark.bench
def test_what_lies_above_the_band_is_told() -> None:
    low = FEW[FEW * 0.5 < 40]  # the elbow's own mode is at 90 Hz
    frf, whole = measured(FREE, 2, lines=low)
    found = modal(frf, whole, FREE.J)
    assert any("above the band" in line and "% of J_ii" in line for line in found.status)
    assert found.J_l < 0.9 * FREE.J[2, 2]
    enough, whole = measured(FREE, 2)
    assert not any("above the band" in line for line in modal(enough, whole, FREE.J).status)


def test_welded_joints_are_no_held_motors() -> None:
    """The elbow alone, in a band above which a held shoulder would put a mode; the other springs are unknown."""
    alone = Arm(*(x[2:] for x in (FREE.J[:, 2:], FREE.K, FREE.J_m, FREE.D, FREE.D_spring, FREE.K_g[:, 2:], FREE.N)))
    low = record(alone, 0, lines=LINES[LINES * 0.25 < 65], f0=0.25, rms=0.05)
    tau, theta = (np.pad(x, ((0, 0), (2, 0))) for x in (low.tau, low.theta))
    whole = campaign(FREE, [replace(low, excited="joint3", posture=np.zeros(3), tau=tau, theta=theta)])
    frf = estimate(whole.records[0], whole)
    f, share = anti_resonances(frf, FREE.J, np.array([np.nan, np.nan, FREE.K[2]]))
    assert f == pytest.approx([np.sqrt(FREE.K[2] / FREE.J[2, 2]) / (2 * np.pi)]) and share == pytest.approx([1.0])
    found = modal(frf, whole, FREE.J)
    assert not any("above the band" in line for line in found.status)
    assert found.J_l == pytest.approx(FREE.J[2, 2], rel=1e-3)


def test_gravity_is_corrected() -> None:
    """Gravity moves J_22 by what a two-mass fit calls K_g; K_g of the neighbours is left out."""
    frf, whole = measured(YPP, 1)
    found = modal(frf, whole, YPP.J)
    assert found.J_l == pytest.approx(YPP.J[1, 1], rel=5e-3)
    assert found.K_g < 0


def test_too_few_lines_are_an_error() -> None:
    frf, whole = measured(FREE, 2, lines=np.array([3, 23, 43, 63, 103, 143]))
    with pytest.raises(IdentError, match="lines are usable"):
        modal(frf, whole)


@pytest.mark.bench
def test_held_motors_that_move_are_taken_out() -> None:
    """MuJoCo's flexible arm under disturbance observers: held motors move a third as much as the excited one."""
    robot = load_robot(ROBOT)
    quick = replace(robot, experiment=replace(robot.experiment, f0=0.4, periods=4))
    data = simulate(chain_of_robot(robot), quick, [("joint3", (0.0, 0.0, 0.0)), ("joint2", (0.0, 0.0, 0.0))], workers=1)
    for one, true, limit in zip(data.records, (0.0466, 0.6929), (0.03, 0.005), strict=True):
        frf = estimate(one, data)
        assert modal(frf, data).J_l == pytest.approx(true, rel=limit)
        assert abs(two_mass(frf, 100.0, data.fs, data.hold).J_l / true - 1) > 3 * limit
