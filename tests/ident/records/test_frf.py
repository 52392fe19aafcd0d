"""From a record to a frequency response: exact without noise, honest about noise, and only from settled periods."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import ENCODER, FS, YPP, Arm, campaign, record

from ident.errors import CampaignError
from ident.joint.fit import chi2_limit, two_mass_frequencies
from ident.records.frf import BINS, ORDER, estimate, moving_average, noise_dof

JOINT = Arm.joint(J_m=4e-5, K=4500, J_l=0.6929, D=3e-5, D_spring=1.1, K_g=-8)
SOFT = [[0.002, 0.001]]  # holds JOINT with 20 N m/rad joint side, more than its gravity stiffness
STIFF = [[0.05, 0.01]]
HOLD = [[0.02, 0.004], [0.02, 0.004], [0.01, 0.002]]
FULL = np.arange(1, 1201)


def relative_error(frf, arm):
    """Squared error of G over its claimed variance, mean over usable lines: chi^2 per complex line."""
    error = frf.G - arm.response(frf.frequencies)[:, frf.index, frf.index]
    return np.mean((np.abs(error) ** 2 / frf.variance)[frf.usable])


def bounds(frf):
    """What honest variances give in 998 of 1000 records."""
    L = np.count_nonzero(frf.usable)
    return [chi2_limit(2 * L, frf.dof, frf.width, confidence) for confidence in (0.001, 0.999)]


def test_without_noise_the_response_is_the_exact_sampled_one():
    made = record(JOINT, 0, gains=SOFT, noise=0, step=0)
    frf = estimate(made, campaign(JOINT))
    truth = JOINT.response(frf.frequencies)[:, 0, 0]
    # what is left of the transient after a period, exp(-1.4 * 10), of a response that starts at its own size
    assert np.max(np.abs(frf.G / truth - 1)) < np.exp(-14)
    assert frf.status == ()


def test_responses_of_all_joints_satisfy_the_coupled_equations_of_motion():
    frf = estimate(record(YPP, 2, gains=HOLD, noise=0, step=0, periods=8), campaign(YPP))
    expected = np.einsum("ljk,lk->lj", YPP.response(frf.frequencies), frf.tau)
    # held motors move little: compare with the largest angle of the line; leakage of the start, 1e-6 of it after 10 s
    assert np.max(np.abs(frf.theta - expected) / np.abs(expected).max(axis=1, keepdims=True)) < 1e-6
    assert np.allclose(frf.H * frf.tau[:, [2]], frf.theta, rtol=1e-12, atol=0)


@pytest.mark.parametrize("gains", [SOFT, STIFF], ids=["soft", "stiff"])
@pytest.mark.parametrize(("periods", "lines"), [(2, FULL), (3, None), (6, None), (6, FULL)])
def test_claimed_variance_is_the_real_one_in_closed_loop(gains, periods, lines):
    made = record(JOINT, 0, gains=gains, periods=periods, lines=lines, rng=np.random.default_rng(periods))
    frf = estimate(made, campaign(JOINT))
    low, high = bounds(frf)
    assert low < relative_error(frf, JOINT) < high


def test_claimed_variance_is_the_real_one_in_open_loop():
    """Mean of six draws: slow noise leaks, and what of it is not worth being taken off is charged on average."""
    arm, errors = Arm.joint(4e-5, 4500, 0.6929, 3e-4, 1.1, 8), []  # hangs: stable by itself
    for seed in range(6):
        frf = estimate(record(arm, 0, periods=8, rng=np.random.default_rng(seed)), campaign(arm))
        errors.append(relative_error(frf, arm))
    low, high = bounds(frf)
    assert low < np.mean(errors) < high


def test_claimed_variance_is_the_real_one_beside_a_sharp_resonance_too():
    arm = Arm.joint(4e-5, 4500, 0.1, 3e-5, 0.2, 0)  # damping 0.5 %: dip and peak are a few lines wide
    ratio = []
    for seed in range(8):
        made = record(arm, 0, gains=STIFF, periods=2, rng=np.random.default_rng(seed))
        frf = estimate(made, campaign(arm))
        chi = np.abs(frf.G - arm.response(frf.frequencies)[:, 0, 0]) ** 2 / frf.variance
        ratio.append(
            [chi[np.abs(frf.frequencies - f) < 0.7].mean() for f in two_mass_frequencies(4e-5, 4500, 0.1, 100)]
        )
    # 8 records of 7 lines each: five times 1 / sqrt(56); the smallest figure that smearing over 18 lines gives is 0.14
    assert np.mean(ratio, axis=0) == pytest.approx([1, 1], abs=0.67)


def test_lines_whose_torque_feedback_has_eaten_are_not_usable():
    arm = Arm.joint(4e-5, 4500, 0.1, 3e-5, 0.5, 0)
    for seed in range(4):
        frf = estimate(record(arm, 0, gains=STIFF, rng=np.random.default_rng(seed)), campaign(arm))
        # 500 N m/rad against J w^2: at 0.1 Hz 4e-4 of the excitation is left, less than the torque noise
        assert not frf.usable[:3].any() and frf.usable[frf.frequencies > 2].all()
        assert relative_error(frf, arm) < bounds(frf)[1]
    assert estimate(record(arm, 0, gains=STIFF, noise=0, step=0), campaign(arm)).usable.all()


@pytest.mark.parametrize("lines", [None, FULL], ids=["odd", "full"])
@pytest.mark.parametrize("noise", [0, 1e-5, 1e-4])
def test_quantisation_that_repeats_in_every_period_is_never_underestimated(noise, lines):
    made = record(JOINT, 0, gains=SOFT, noise=noise, lines=lines, level=[0.1], posture=[0.37])
    frf = estimate(made, campaign(JOINT))
    _, high = bounds(frf)
    # below the truth by a factor of 20 at most: noise just under one step is charged twice
    assert 0.05 < relative_error(frf, JOINT) < high
    assert frf.step == pytest.approx(ENCODER, rel=1e-9)  # 157 rad / 2^52 over 5e-5 rad


def bump(period, samples, periods, size=0.5):
    """Unrecorded torque for one tenth of a second in the middle of a period."""
    torque = np.zeros(samples * periods)
    torque[int((period + 0.5) * samples) :][:100] = size
    return torque


@pytest.mark.parametrize("period", [1, 2, 3, 4])
def test_the_first_settled_period_is_the_one_after_the_last_disturbed_one(period):
    made = record(JOINT, 0, gains=SOFT, periods=8, extra=bump(period, 10000, 8))
    frf = estimate(made, campaign(JOINT))
    # the tail of the disturbance is exp(-1.4 * 5) in the next period: it may cost one more
    assert frf.first in (period + 1, period + 2) and frf.periods == 8 - frf.first
    assert frf.status == ()
    assert relative_error(frf, JOINT) < bounds(frf)[1]


def test_settled_records_are_kept_whole():
    shorter = []
    for seed in range(20):
        made = record(
            JOINT, 0, gains=SOFT, periods=6, f0=0.5, lines=np.arange(1, 241, 2), rng=np.random.default_rng(seed)
        )
        cut = 3 * made.samples_per_period  # 6 s: exp(-1.4 * 6) of a start from rest
        settled = replace(made, periods=3, tau=made.tau[cut:], theta=made.theta[cut:])
        shorter.append(estimate(settled, campaign(JOINT)).first)
    assert shorter == [0] * 20  # false alarms: 1 in 1000 each


@pytest.mark.parametrize(
    ("left", "dry", "first"), [(0.4, True, (2, 3)), (0.75, True, (3, 4)), (1.0, True, (0, 1)), (0.75, False, (0, 1))]
)
def test_under_friction_periods_are_left_out_in_which_a_joint_is_on_its_way_to_where_it_rests(left, dry, first):
    """`left` of it is still to go after each period; what drifts evenly does it in all periods alike."""
    odd = np.arange(1, 241, 2)
    made = record(JOINT, 0, gains=SOFT, periods=6, f0=0.5, lines=odd[odd % 3 != 0])
    x, t = made.theta / made.theta.std(), np.arange(len(made.theta))[:, None] / made.samples_per_period
    gone = left**t if left < 1.0 else -0.1 * t
    bent = x + 0.05 * x**3 if dry else x
    assert estimate(replace(made, theta=made.theta.std() * bent), campaign(JOINT)).first in (0, 1)
    assert estimate(replace(made, theta=made.theta.std() * (bent + gone)), campaign(JOINT)).first in first


def test_a_response_that_still_creeps_is_a_status_and_the_response_stays_right():
    slow = [[0.0012, 0.02]]  # pole at -(12 - 8) / 200 per second: 0.82 of the transient is left after a period
    frf = estimate(record(JOINT, 0, gains=slow, periods=6, extra=bump(0, 10000, 6, 20.0)), campaign(JOINT))
    assert any("drifts" in line for line in frf.status) and any("rests" in line for line in frf.status)
    assert relative_error(frf, JOINT) < bounds(frf)[1]


def test_a_record_disturbed_to_its_last_but_two_periods_is_a_status():
    frf = estimate(record(JOINT, 0, gains=STIFF, periods=6, extra=bump(3, 10000, 6)), campaign(JOINT))
    assert frf.periods == 2
    assert "still changes after 4 of 6 periods; the last 2 are used" in frf.status[0]
    assert relative_error(frf, JOINT) < bounds(frf)[1]


def test_two_periods_can_not_show_that_they_have_settled():
    frf = estimate(record(JOINT, 0, gains=SOFT, periods=2), campaign(JOINT))
    assert len(frf.status) == 1 and "2 periods are too few" in frf.status[0]


@pytest.mark.parametrize(("power", "odd"), [(2, False), (3, True)])
def test_distortion_appears_on_the_lines_of_its_parity_at_its_level(power, odd):
    rng = np.random.default_rng(3)
    lines = np.arange(1, 1201, 2)
    lines = np.sort(rng.permutation(lines)[: 3 * len(lines) // 4])
    made = record(JOINT, 0, gains=SOFT, lines=lines, rng=rng, step=0)
    bent = made.theta + 0.02 * (made.theta - made.theta.mean()) ** power
    frf = estimate(replace(made, theta=bent), campaign(JOINT))
    detection = frf.detection
    assert detection.distortion(not odd)[0] < 0.01 * detection.distortion(odd)[0]
    # the same figure by plain DFT over the settled periods, where the distortion stands well above the noise
    X = np.abs(np.fft.rfft(bent[frf.first * 10000 :, 0]))[:: frf.periods]
    chosen = detection.lines[(detection.odd == odd) & (detection.frequencies < 3)]
    around = np.exp(np.interp(chosen, lines, np.log(X[lines])))
    plain = np.sqrt(np.mean((X[chosen] / around) ** 2))
    assert detection.distortion(odd, high=3)[0] == pytest.approx(plain, rel=0.05)  # noise power is 2 % of it


def test_a_linear_joint_shows_no_distortion():
    lines = np.arange(1, 1201, 2)[np.arange(600) % 4 != 1]
    for seed in range(5):
        made = record(JOINT, 0, gains=SOFT, lines=lines, rng=np.random.default_rng(seed))
        detection = estimate(made, campaign(JOINT)).detection
        assert np.count_nonzero(detection.odd) == 150 and len(detection.lines) == 1199 - 450
        assert detection.distortion(True) == detection.distortion(False) == [0]  # false alarms: 1 in 1000


@pytest.mark.parametrize(("spacing", "periods"), [(1, 2), (1, 3), (2, 2), (6, 4), (20, 2)])
def test_every_bin_between_the_lines_counts_once(spacing, periods):
    """Against sets of bins: those nearest to each of 50 lines, line bins left out."""
    at = periods * spacing * np.arange(100, 150)
    every = np.arange(20 * at[-1])
    between = every[every % periods != 0]
    nearest = [between[np.searchsorted(between, k) - BINS // 2 :][:BINS] for k in at]
    assert noise_dof(50, spacing, periods) == pytest.approx((BINS - ORDER) / BINS * len(np.unique(nearest)))
    lines = np.arange(1, 240, spacing)
    made = record(JOINT, 0, gains=SOFT, lines=lines, f0=0.5, periods=periods)
    frf = estimate(made, campaign(JOINT))
    assert frf.spacing == spacing and frf.dof == 2 * noise_dof(frf.width, spacing, frf.periods)


def covariance(frf):
    """Of torque and angle at every line [L, 2, 2], by samples of neighbouring ones; the angle's above quantisation."""
    matrix = moving_average(np.einsum("rla,rlb->lab", frf.noise, frf.noise.conj()) / len(frf.noise), frf.width)
    matrix[:, 1, 1] = np.maximum(matrix[:, 1, 1].real, frf.floor[0])
    return matrix


def test_covariance_of_torque_and_angle_is_the_real_one():
    distance = []
    for seed in range(8):
        frf = estimate(record(JOINT, 0, gains=STIFF, rng=np.random.default_rng(seed)), campaign(JOINT))
        clean = record(JOINT, 0, gains=STIFF, rng=np.random.default_rng(seed), noise=0, step=0)
        clean = estimate(clean, campaign(JOINT))
        error = np.concatenate([frf.tau - clean.tau, frf.theta - clean.theta], axis=1)
        distance.append(np.einsum("la,lab,lb->l", error.conj(), np.linalg.inv(covariance(frf)), error).real)
    m = frf.dof / 2  # complex Wishart: E d^H C^-1 d = p m / (m - p)
    expected = 2 * m / (m - 2)
    # five times the scatter of the mean: 8 * 600 lines, of which `width` share a covariance
    assert np.mean(distance) == pytest.approx(expected, rel=5 * np.sqrt((1 + frf.width / m) / 4800))


def test_a_posture_other_than_the_declared_one_is_a_status_with_its_distance():
    made = record(JOINT, 0, gains=SOFT, posture=[0.4], level=[0.3])
    # deflection N tau / K known; the start swings by 0.02 rad for 1 / 1.4 s of 60
    assert estimate(made, campaign(JOINT)).offset == pytest.approx([0], abs=5e-4)
    frf = estimate(replace(made, posture=np.array([0.5])), campaign(JOINT))
    assert frf.offset == pytest.approx([-0.1], abs=5e-4)
    assert f"joint1 rests {frf.offset[0]:+.3g} from its declared posture" in frf.status[0]
    unknown = replace(campaign(JOINT), K=np.array([np.nan]))
    assert estimate(made, unknown).offset == pytest.approx([100 * 0.3 / 4500], abs=5e-4)


def test_a_drifting_mean_is_a_status_with_its_size():
    made = record(JOINT, 0, gains=SOFT)
    drift = np.linspace(0, 100 * 0.06, len(made.theta))[:, None]
    frf = estimate(replace(made, theta=made.theta + drift), campaign(JOINT))
    assert any("the mean of joint1 drifts by 0.04" in line or "drifts by 0.05" in line for line in frf.status)


def test_a_drifting_mean_does_not_reach_the_lines_beyond_the_band():
    """Where a period ends it would be a jump, as large as it drifts in one, which is in all lines."""
    made, drift = record(JOINT, 0, gains=SOFT, noise=0, step=0), 0.05
    ramp = drift * np.arange(len(made.theta))[:, None] / made.samples_per_period
    still, moving = (
        estimate(replace(made, theta=theta), campaign(JOINT)).band for theta in (made.theta, made.theta + ramp)
    )
    lines, _, theta = moving.beyond
    assert lines[0] > still.lines[-1]
    jump = drift / (np.pi * lines[:, None])
    assert np.max(np.abs(theta - still.beyond[2]) / jump) < 0.01


def test_a_band_of_all_lines_leaves_none_beyond_it():
    band = estimate(record(JOINT, 0, gains=SOFT, lines=np.arange(1, 4501), periods=3), campaign(JOINT)).band
    assert [part.shape for part in band.beyond] == [(0,), (0, 1), (0, 1)]


def broken(field, value):
    made = record(JOINT, 0, gains=SOFT, periods=2)
    return replace(made, **{field: value(made)})


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("excited", lambda r: "elbow", "'elbow' is none of joint1"),
        ("periods", lambda r: 1, "1 period recorded"),
        ("tau", lambda r: r.tau[:-1], r"tau has shape \(19999, 1\), expected \(20000, 1\)"),
        (
            "theta",
            lambda r: np.where(np.arange(20000) == 7, np.nan, r.theta[:, 0])[:, None],
            "theta holds a non-finite",
        ),
        ("lines", lambda r: [1, 3, 6000], r"lines must be different ones of 1 .. 4999, found 6000"),
        ("lines", lambda r: [1, 3, 5000], r"found 5000"),
        ("lines", lambda r: [3, 1, 3], r"found 3"),
        ("lines", lambda r: [0, 1, 3], r"found 0"),
        ("lines", lambda r: [], "found none"),
        ("tau", lambda r: r.tau * 0, "line 1 is listed as excited, but joint1 has no torque there"),
    ],
)
def test_a_record_that_contradicts_itself_is_refused_in_one_line(field, value, message):
    with pytest.raises(CampaignError, match=message) as error:
        estimate(broken(field, value), campaign(JOINT))
    assert "record r0" in str(error.value) and "\n" not in str(error.value)


def test_lines_may_be_listed_in_any_order():
    made = record(JOINT, 0, gains=SOFT, periods=3)
    mixed = replace(made, lines=np.random.default_rng(0).permutation(made.lines))
    one, other = (estimate(r, campaign(JOINT)) for r in (made, mixed))
    np.testing.assert_array_equal(one.frequencies, other.frequencies)
    np.testing.assert_array_equal(one.G, other.G)


def test_frequencies_are_those_of_the_lines():
    made = record(JOINT, 0, gains=SOFT, periods=3)
    frf = estimate(made, campaign(JOINT))
    assert frf.frequencies == pytest.approx(made.lines * FS / made.samples_per_period, rel=1e-15)


@pytest.mark.parametrize("width", [1, 6, 7, 16, 40])
def test_a_mean_over_lines_has_the_digits_of_its_own_lines(width: int) -> None:
    """Lines that are 1e20 times as large, elsewhere, say nothing of a small one: a running sum lost it."""
    values = np.random.default_rng(0).uniform(1.0, 2.0, (60, 2))
    values[:9] *= 1e20
    starts = np.clip(np.arange(60) - width // 2, 0, 60 - width)
    exact = [values[k : k + width].mean(axis=0) for k in starts]
    assert moving_average(values, width) == pytest.approx(np.array(exact), rel=1e-13, abs=0.0)
