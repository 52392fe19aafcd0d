"""The coupled fit on arms whose truth is known: exact synthetic records, then MuJoCo's own records."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soft
from scipy.stats import chi2
from synthetic import ENCODER, FS, Arm, campaign, record

from ident.arm.arm_model import Parameters, Posture, Sampling, motion, motion_and_derivatives
from ident.arm.coupled import CoupledFit, Start, fit_coupled
from ident.arm.evidence import evidence, gravity_basis
from ident.errors import IdentError
from ident.joint.certainty import certainty
from ident.joint.fit import two_mass
from ident.joint.solve import inertia_std
from ident.records.campaign import Campaign
from ident.records.frf import BINS, ORDER, estimate
from ident.records.resting import elsewhere
from ident.simulator.bench import simulate
from symgen.plan import Model, chain_of_robot, make_model
from symgen.robot import load_robot
from symgen.urdf import load_chain

ROBOTS = Path(__file__).parents[3] / "robots"
GRAVITY = np.array([0.0, 0.0, -9.81])
LINES = np.arange(3, 240, 6)
#: Two joints of the symmetric arm; one posture shows both constants its diagonal has there, the others need the second.
POSTURES = ([0.3, 0.6], [-0.4, -1.1])

#: Standard deviation of J_ij(q) over sqrt(J_ii J_jj), worst entry at unseen postures, that five short records are good for (J_11 of
#: generic links has seven constants, and two records of joint 1 tell them least).
LIMIT = {"ypp3": 2e-3, "ypp3_general": 5e-2}


@pytest.fixture(scope="module")
def model() -> Model:
    """The shoulder and elbow of the symmetric arm."""
    return make_model(load_chain(ROBOTS / "ypp3" / "ypp3.urdf", at={"joint1": 0.0}), believe_zeros=True)


def linear_arm(model: Model, q: list[float]) -> Arm:
    """The arm at q, J(q) and gravity stiffness of its bodies."""
    K_g = model.gravity_stiffness_rows(np.array(q), GRAVITY) @ model.chain.parameters
    K, J_m, D, D_spring = np.array([[4500.0, 4200], [4e-5, 1e-5], [3e-5, 1e-5], [1.1, 0.3]])
    return Arm(model.J_cad(np.array(q)), K, J_m, D, D_spring, K_g, np.full(2, 100.0))


def posture_of(arm: Arm) -> Posture:
    """`arm` with the three entries of J, then those of its gravity stiffness, as constants."""
    rows = np.zeros((2, 2, 3))
    rows[0, 0, 0] = rows[0, 1, 1] = rows[1, 0, 1] = rows[1, 1, 2] = 1.0
    return Posture(np.arange(2), arm.N, rows, rows)


def parameters_of(arm: Arm) -> Parameters:
    entries = np.triu_indices(2)
    return Parameters(arm.K, arm.J_m, arm.D, arm.D_spring, arm.J[entries], arm.K_g[entries])


def measured(
    model: Model, rng: np.random.Generator, *, noise: float, step: float, K_2: float = 1.0, damped: float = 1.0
) -> Campaign:
    """A campaign of both motors at both postures, both held softly by feedback; joint 2 stiffer by `K_2` when it is excited, motors
    `damped` by this share of what they usually are."""
    records = []
    for k, (q, excited) in enumerate([(q, i) for q in POSTURES for i in range(2)]):
        arm = linear_arm(model, q)
        arm = replace(arm, K=arm.K * np.array([1.0, K_2 if excited else 1.0]), D=damped * arm.D)
        made = record(arm, excited, lines=LINES, f0=0.5, periods=4 if step else 9, noise=noise, step=step, posture=np.array(q),
                      gains=np.array([[0.4, 4e-3], [0.2, 2e-3]]), rng=rng, id=f"r{k}")  # fmt: skip
        records.append(made)
    whole = campaign(linear_arm(model, POSTURES[0]), records)
    return replace(whole, joints=("joint1", "joint2"), gravity=GRAVITY, J_m=arm.J_m)


def fitted(model: Model, data: Campaign, start: Start | None = None) -> CoupledFit:
    return fit_coupled(data, model, [estimate(one, data) for one in data.records], start)


@pytest.mark.parametrize("hold", ["zoh", "band-limited"])
@pytest.mark.parametrize("stiffness", [1.0, 60.0])
def test_response_is_that_of_the_exact_sampled_arm(model: Model, hold: str, stiffness: float) -> None:
    """Against expm: also with modes above the half of the sampling rate, where no series of the aliases converges."""
    arm = linear_arm(model, POSTURES[0])
    arm = replace(arm, K=arm.K * stiffness)
    f = np.linspace(0.1, 120, 300)
    unit = np.broadcast_to(np.eye(2, dtype=complex), (len(f), 2, 2))
    found = motion(posture_of(arm), parameters_of(arm), Sampling(f, FS, hold), unit)
    true = arm.response(f, hold)
    error = np.abs(found - true).max(axis=(1, 2)) / np.abs(true).max(axis=(1, 2))
    assert error.max() < (1e-8 if hold == "zoh" else 1e-10)


@pytest.mark.parametrize(
    ("hold", "stiffness", "live"), [("zoh", 1.0, 2), ("zoh", 60.0, 2), ("zoh", 600.0, 1), ("band-limited", 1.0, 2)]
)
def test_derivatives_are_central_differences(model: Model, hold: str, stiffness: float, live: int) -> None:
    """Also with modes so high that aliases lie among them, and where one joint alone is live."""
    arm, rng = linear_arm(model, POSTURES[1]), np.random.default_rng(2)
    arm = replace(arm, K=arm.K * stiffness)
    whole, p = posture_of(arm), parameters_of(arm)
    posture = Posture(whole.live[:live], whole.N[:live], whole.J_rows[:live, :live], whole.K_rows[:live, :live])
    sampling = Sampling(np.linspace(0.5, 120, 60), FS, hold)
    tau = rng.normal(size=(60, live)) + 1j * rng.normal(size=(60, live))
    vector = p.vector()
    theta, found = motion_and_derivatives(posture, p, sampling, tau)
    np.testing.assert_allclose(theta, motion(posture, p, sampling, tau[..., None])[..., 0], rtol=1e-13)
    for column, k in enumerate(posture.columns(2)):
        h = np.zeros(len(vector))
        h[k] = 1e-5 * (1.0 if k < 8 else max(abs(vector[k]), 0.01))
        sides = [
            motion(posture, Parameters.of(v, 2, 3), sampling, tau[..., None])[..., 0] for v in (vector + h, vector - h)
        ]
        numeric = (sides[0] - sides[1]) / (2 * h[k])
        # the difference is good to the square of its step, and to rounding: at 0.5 Hz springs cancel to 1e-3 of K, stiffer ones farther
        rounding = 1e-12 * stiffness * np.abs(theta).max(axis=1, keepdims=True) / h[k]
        assert np.all(np.abs(found[:, :, column] - numeric) < 1e-6 * np.abs(numeric).max() + rounding)


def test_exact_responses_give_the_exact_arm(model: Model) -> None:
    """From drives 30 % off and constants 20 % off, no gravity known; no noise."""
    data = measured(model, np.random.default_rng(3), noise=0.01, step=ENCODER)
    exact = []
    for one in data.records:
        frf = estimate(one, data)
        assert frf.band is not None
        G = linear_arm(model, list(one.posture)).response(frf.band.frequencies)
        theta = (G @ frf.band.tau[:, :, None])[:, :, 0]
        band = replace(frf.band, theta=theta, noise=np.zeros_like(frf.band.noise))
        exact.append(replace(frf, theta=theta[band.excited], band=band, floor=np.zeros(2)))
    arm = linear_arm(model, POSTURES[0])
    beta = gravity_basis(model, GRAVITY) @ model.chain.parameters
    alpha = model.alpha_cad * np.resize([1.2, 0.8], len(model.names))
    start = Start(arm.K * 1.3, arm.J_m * 0.75, arm.D * 4, arm.D_spring / 3, alpha, 0.5 * beta)
    found = fit_coupled(data, model, exact, start)
    assert found.converged and found.unseen.shape == (len(model.names), 0)
    for name in ("K", "J_m", "D", "D_spring"):
        np.testing.assert_allclose(getattr(found, name), getattr(arm, name), rtol=1e-6)
    np.testing.assert_allclose(found.alpha, model.alpha_cad, rtol=1e-6)
    np.testing.assert_allclose(found.gravity, beta, rtol=1e-6, atol=1e-6 * np.abs(beta).max())
    for k, one in enumerate(exact):
        np.testing.assert_allclose(found.predict(k), one.theta, rtol=1e-5)


@pytest.fixture(scope="module")
def noisy(model: Model) -> Campaign:
    return measured(model, np.random.default_rng(8), noise=0.005, step=ENCODER)


@pytest.fixture(scope="module")
def best(model: Model, noisy: Campaign) -> CoupledFit:
    """The fit that starts at the truth."""
    arm, beta = linear_arm(model, POSTURES[0]), gravity_basis(model, GRAVITY) @ model.chain.parameters
    return fitted(model, noisy, Start(arm.K, arm.J_m, arm.D, arm.D_spring, model.alpha_cad, beta))


@pytest.mark.parametrize(
    "off",
    [
        pytest.param([3.0, 3.0, 1.0, 1.0], marks=pytest.mark.bench),
        [3.0, 0.4, 3.0, 0.4],
        [0.4, 3.0, 0.4, 3.0],
    ],
)
def test_a_start_far_off_ends_at_the_same_optimum(
    model: Model, noisy: Campaign, best: CoupledFit, off: list[float]
) -> None:
    """K and J_m off by up to a factor 3, dampings by 30, constants by a fifth."""
    arm, beta = linear_arm(model, POSTURES[0]), gravity_basis(model, GRAVITY) @ model.chain.parameters
    K, J_m = arm.K * off[:2], arm.J_m * off[2:]
    alpha = model.alpha_cad * np.resize([1.2, 0.8], len(model.names))
    found = fitted(model, noisy, Start(K, J_m, arm.D * 30, arm.D_spring / 30, alpha, 0.5 * beta))
    assert best.explained and found.explained and found.converged
    std = np.sqrt(np.diag(best.covariance))
    assert np.all(np.abs(found.alpha - best.alpha) < 0.1 * std)  # a fit ends within a hundredth of what is left


def test_a_reversed_gear_gives_the_same_arm(model: Model, noisy: Campaign) -> None:
    """The same records, told by a motor that turns the other way; dampings are not declared."""
    sign = np.array([1.0, -1.0])
    records = tuple(replace(one, tau=one.tau * sign, theta=one.theta * sign) for one in noisy.records)
    found, turned = fitted(model, noisy), fitted(model, replace(noisy, N=noisy.N * sign, records=records))
    assert found.explained and turned.explained and turned.converged
    for name in ("alpha", "K", "J_m", "D", "D_spring"):
        np.testing.assert_allclose(getattr(turned, name), getattr(found, name), rtol=1e-6)


@pytest.mark.parametrize("draws", [8, *(pytest.param(draws, marks=pytest.mark.bench) for draws in (12, 60))])
def test_noise_gives_honest_deviations(model: Model, draws: int) -> None:
    """chi^2 within its limit, errors of alpha in units of their standard deviations like a normal variable's."""
    z, explained = [], []
    for seed in range(draws):
        found = fitted(model, measured(model, np.random.default_rng(seed), noise=0.01, step=ENCODER))
        z.append((found.alpha - model.alpha_cad) / np.sqrt(np.diag(found.covariance)))
        explained.append(found.explained and found.converged)
    assert sum(explained) >= draws - 1  # the limit lets one honest record in a thousand through
    spread = np.sqrt(np.mean(np.square(z), axis=0))  # 80 other draws gave 0.97, 1.06, 1.14
    low, high = np.sqrt(chi2.ppf([1e-4, 1 - 1e-4], draws) / draws)
    assert np.all((spread > low) & (spread < high)), spread


def test_a_damping_that_went_to_zero_has_the_deviation_of_what_is_felt(model: Model) -> None:
    """Of its logarithm nothing is felt: it was told as 1e-35 with a deviation of 1e-33."""
    data = measured(model, np.random.default_rng(4), noise=0.05, step=ENCODER, damped=1e-3)
    found, true = fitted(model, data), 1e-3 * linear_arm(model, POSTURES[0]).D
    usual = fitted(model, measured(model, np.random.default_rng(4), noise=0.05, step=ENCODER)).drive_std[2]
    assert found.D.min() < 1e-2 * true.max()  # one did
    assert np.all(np.abs(found.D - true) < 5 * found.drive_std[2])
    assert np.all((0.3 * usual < found.drive_std[2]) & (found.drive_std[2] < 3 * usual))


def test_a_stiffness_that_changes_is_not_explained(model: Model) -> None:
    """The twin without it is in the test before."""
    data = measured(model, np.random.default_rng(0), noise=0.01, step=ENCODER, K_2=1.05)
    found = fitted(model, data)
    assert not found.explained and "does not explain" in found.status[0]


def test_what_was_not_measured_is_said_and_kept(model: Model) -> None:
    """Joint 2 alone, joint 1 clamped: its own inertia is found, the rest of alpha stays CAD's, nothing is NaN."""
    data = measured(model, np.random.default_rng(0), noise=0.01, step=ENCODER)
    arm = linear_arm(model, POSTURES[0])
    alone = Arm(*(np.array(x)[1:] for x in (arm.J[:, 1:], arm.K, arm.J_m, arm.D, arm.D_spring, arm.K_g[:, 1:], arm.N)))
    made = record(
        alone, 0, lines=LINES, f0=0.5, periods=4, gains=np.array([[0.2, 2e-3]]), posture=np.array(POSTURES[0][1:])
    )
    still = np.zeros((len(made.tau), 1))
    made = replace(made, excited="joint2", posture=np.array(POSTURES[0]), tau=np.hstack([still + 0.3, made.tau]),
                   theta=np.hstack([still + 30.0, made.theta]))  # fmt: skip
    found = fitted(model, replace(data, records=(made,)))
    assert found.explained and found.unseen.shape == (len(model.names), len(model.names) - 1)
    np.testing.assert_allclose(found.unseen.T @ found.unseen, np.eye(len(model.names) - 1), atol=1e-12)
    for values in (found.alpha, found.covariance, found.drive_std, found.gravity, found.predict(0)):
        assert np.isfinite(values).all()
    J = model.J(np.array(POSTURES[0]), found.alpha)
    assert J[1, 1] == pytest.approx(arm.J[1, 1], rel=1e-3)
    assert any("no information" in line for line in found.status)
    assert np.all(found.predict(0)[:, 0] == 0.0)


def test_alpha_is_cads_along_what_no_record_depends_on() -> None:
    """One posture of general links a third heavier than CAD's: the search moves all, also along what nothing shows."""
    model = make_model(load_chain(ROBOTS / "ypp3" / "ypp3.urdf", at={"joint1": 0.0}), believe_zeros=False)
    arm, q = linear_arm(model, POSTURES[0]), np.array(POSTURES[0])
    heavy = replace(arm, J=1.3 * arm.J, K=1.3 * arm.K, K_g=1.3 * arm.K_g)
    made = record(heavy, 0, lines=LINES, f0=0.5, periods=4, gains=np.array([[0.4, 4e-3], [0.2, 2e-3]]), posture=q)
    data = replace(campaign(arm, [made]), joints=("joint1", "joint2"), gravity=GRAVITY, J_m=arm.J_m)
    found = fitted(model, data)
    assert found.explained and found.unseen.shape == (4, 1)
    assert abs(found.unseen.T @ (found.alpha - model.alpha_cad))[0] < 1e-9 * np.abs(model.alpha_cad).max()
    assert any("CAD value kept" in line for line in found.status)
    J, std = model.J(q, found.alpha), inertia_std(model.J_rows(q), found.covariance, found.unseen)
    assert np.all(np.abs(J - heavy.J) < 5 * std) and np.all(std < 1e-2 * np.abs(heavy.J))  # none the worse for it
    off = np.abs(found.predict(0)[:, 0] / estimate(made, data).theta[:, 0] - 1)
    assert np.median(off) < 1e-2
    # low lines in noise: they do depend on the other constants, too little to tell, and the search ends anywhere
    gains = np.array([[0.4, 4e-3], [0.2, 2e-3]])
    poor = record(heavy, 0, lines=np.arange(3, 20, 2), f0=0.5, periods=4, noise=1.0, gains=gains, posture=q)
    told = fitted(model, replace(data, records=(poor,)))
    assert told.unseen.shape[1] > 1 and sum("CAD value kept" in line for line in told.status) == 1
    assert sum("is lost in noise" in line for line in told.status) == told.unseen.shape[1] - 1


def test_too_few_lines_are_an_error(model: Model) -> None:
    arm = linear_arm(model, POSTURES[0])
    one = record(
        arm, 0, lines=[61], f0=0.5, periods=4, gains=np.array([[0.4, 4e-3], [0.2, 2e-3]]), posture=np.array(POSTURES[0])
    )
    data = replace(campaign(arm, [one]), joints=("joint1", "joint2"), gravity=GRAVITY, J_m=arm.J_m)
    with pytest.raises(IdentError, match="the usable lines hold 4 numbers and fix 4 parameters; expected more lines"):
        fitted(model, data)


def test_noise_has_no_more_freedom_at_every_line_than_there_are_bins(model: Model, noisy: Campaign) -> None:
    """Where all lines of the band are fitted, they share the bins that the excited ones had for themselves."""
    basis, frf = gravity_basis(model, GRAVITY), estimate(noisy.records[0], noisy)
    excited, every = (evidence(noisy, model, basis, frf, 0, lines) for lines in ("usable", "every"))
    bins = (LINES[-1] - LINES[0]) * (frf.periods - 1) + BINS
    assert excited.noise_dof == (BINS - ORDER) * len(LINES)
    assert every.noise_dof == pytest.approx((BINS - ORDER) * bins / BINS)
    assert every.noise_dof < 2 * excited.noise_dof


def test_no_records_is_an_error(model: Model) -> None:
    with pytest.raises(IdentError, match="no records"):
        fit_coupled(measured(model, np.random.default_rng(0), noise=0.01, step=ENCODER), model, [])


@pytest.mark.parametrize("name, believe", [("ypp3", True), ("ypp3_general", False)])
@pytest.mark.bench
def test_held_by_motors_that_give(name: str, believe: bool) -> None:
    """MuJoCo's flexible arm, motors held by disturbance observers: J(q) where nothing was measured, off-diagonals too.

    Two masses read the distal joint wrong by more than a tenth from the same records.
    """
    robot = load_robot(ROBOTS / name)
    chain = chain_of_robot(robot)
    quick = replace(robot, experiment=replace(robot.experiment, f0=0.5, periods=3))
    cells = [("joint1", [0.0, 0.0, 0.0]), ("joint1", [0.2, 1.3, 0.3]), ("joint3", [-0.5, -0.3, 1.4]),
             ("joint1", [0.4, 0.0, -1.5]), ("joint2", [1.0, 0.1, 2.0])]  # fmt: skip
    data = simulate(chain, quick, cells, lock="dob", seed=4, workers=1)
    model = make_model(chain, believe_zeros=believe)
    responses = [estimate(one, data) for one in data.records]
    found = fit_coupled(data, model, responses)
    assert found.converged and found.explained, found.status
    q = model.random_postures(1000, np.random.default_rng(5))
    J, true = model.J(q, found.alpha), model.J_cad(q)
    size = np.sqrt(np.einsum("mii->mi", true))
    error = np.abs(J - true) / size[:, :, None] / size[:, None, :]
    sigma = certainty(model, found.covariance, found.unseen).per_entry.max()
    assert sigma < LIMIT[name] and error.max() < 3 * sigma, (sigma, error.max(axis=0))
    assert error[:, 0, 1:].max() < 1e-3  # J_12, J_13
    apart = two_mass(responses[2], float(data.N[2]), data.fs, data.hold)
    assert abs(apart.J_l / true[0, 2, 2] - 1) > 0.1 and not apart.explained
    beside = replace(
        data, records=tuple(replace(one, posture=one.posture + [0.0, 2e-3, -1e-3]) for one in data.records)
    )
    there = fit_coupled(beside, model, [estimate(one, beside) for one in beside.records])
    assert there.explained, "records tell where they rest"
    np.testing.assert_allclose(there.alpha, found.alpha, atol=0.3 * sigma * size.max() ** 2)


@pytest.mark.parametrize("share", [*(pytest.param(share, marks=pytest.mark.bench) for share in (1.0, 0.7)), np.inf])
def test_postures_told_by_other_springs_are_those_where_the_links_rest(share: float) -> None:
    """A spring that sags by 0.1 rad, declared 30 % softer, or not at all: J(q) was 5 to 30 % off."""
    c, arm = soft.campaign()
    fit = fit_coupled(told := soft.declared_by(c, c.K * [1.0, share]), arm, [estimate(r, told) for r in told.records])
    aside = [np.abs(one.posture - r.posture).max() for one, r in zip(told.records, c.records, strict=True)]
    assert max(aside) > 0.03 or share == 1.0
    assert fit.explained and fit.K == pytest.approx(c.K, rel=1e-3)
    assert all(np.abs(one.posture - r.posture).max() < 3e-4 for one, r in zip(fit.responses, c.records, strict=True))
    assert not any("rests" in line for one in fit.responses for line in one.status)
    assert [line.split()[0] for line in elsewhere(told, fit.responses)] == ([] if share == 1.0 else ["j2"])
    off = (fit.alpha - arm.alpha_cad) / np.sqrt(np.diag(fit.covariance))
    assert np.abs(off).max() < 4.0


@pytest.mark.bench
def test_links_that_swing_far_are_explained_by_forces_of_higher_order() -> None:
    """0.03 rad, told to 1e-4: odd lines without what is of second order leave twice the noise."""
    c, arm = soft.campaign(swing=0.03, noise=1e-4)
    fit = fit_coupled(c, arm, [estimate(record, c) for record in c.records])
    assert fit.every and fit.explained
    off = (fit.alpha - arm.alpha_cad) / np.sqrt(np.diag(fit.covariance))
    assert np.abs(off).max() < 4.0
