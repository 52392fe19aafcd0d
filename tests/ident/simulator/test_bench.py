"""The simulated campaign is what the exact sampled model predicts, and nothing of the truth leaks into it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import expm

from ident.effects.friction import LinkViscous
from ident.errors import ExperimentError
from ident.records.campaign import Campaign, Record
from ident.simulator.bench import TORQUE_SHARE, design, head, prepare, run, simulate
from symgen.chain import Chain, Inertia
from symgen.plan import make_model, model_of_urdf
from symgen.robot import Drive, Experiment, Robot, load_robot
from symgen.urdf import load_chain, parse_chain

ROBOT = load_robot(Path(__file__).parents[3] / "robots" / "ypp3")
YPP = load_chain(ROBOT.urdf)
JUDGE = pin.buildModelFromUrdf(str(ROBOT.urdf))
POSTURE = np.array([0.2, 0.5, -0.9])
SHORT = Experiment(f0=0.5, band=(0.5, 120.0), periods=3, swing=0.002)
TINY = replace(SHORT, swing=1e-4)  # Coriolis terms grow with the square of the swing: here they are below 1e-6


def robot(experiment: Experiment = SHORT, **drive: object) -> Robot:
    return replace(ROBOT, experiment=experiment, drives=tuple(replace(d, **drive) for d in ROBOT.drives))


def quiet(experiment: Experiment = TINY) -> Robot:
    return robot(replace(experiment, torque_noise=0.0), encoder_counts=2**44)


def spectra(record: Record, values: np.ndarray, periods: int = 2) -> np.ndarray:
    """Mean spectrum [L, n] of the last `periods` at the excited lines."""
    last = values[-periods * record.samples_per_period :].reshape(periods, record.samples_per_period, -1)
    return np.fft.rfft(last, axis=1).mean(axis=0)[record.lines]


def exact_response(drives: list[Drive], J: np.ndarray, slope: np.ndarray, fs: float, f: np.ndarray) -> np.ndarray:
    """theta/tau [L, m, m] of flexible joints with held torque, from (7), (8), gravity's slope and the matrix exponential."""
    N, K, D, B, d = (np.diag([getattr(x, k) for x in drives]) for k in ("N", "K", "D_spring", "J_m", "D"))
    m, none = len(drives), np.zeros_like(N)
    M = np.block([[N @ N @ B, none], [none, J]])
    S = np.block([[K, -K], [-K, K + slope]])
    C = np.block([[N @ N @ d + D, -D], [-D, D]])
    G = np.zeros((5 * m, 5 * m))
    G[: 2 * m, 2 * m : 4 * m] = np.eye(2 * m)
    G[2 * m : 4 * m, : 4 * m] = -np.linalg.solve(M, np.hstack([S, C]))
    G[2 * m : 4 * m, 4 * m :] = np.linalg.solve(M, np.vstack([N, none]))
    step = expm(G / fs)
    z = np.exp(2j * np.pi * f / fs)[:, None, None]
    states = np.linalg.solve(z * np.eye(4 * m) - step[: 4 * m, : 4 * m], step[: 4 * m, 4 * m :].astype(complex))
    return N @ states[:, :m]


def judge(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """J(q) and dG/dq by Pinocchio from the URDF file."""
    J = pin.crba(JUDGE, JUDGE.createData(), q)
    slope = pin.computeGeneralizedGravityDerivatives(JUDGE, JUDGE.createData(), q)
    return np.triu(J) + np.triu(J, 1).T, slope


# The linear part of a simulated step is exact; at this swing the arm's nonlinearity is about 1e-6 of the response.
ZOH_ERROR = 5e-6


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_rigid_lock_gives_the_exact_response_of_two_masses(joint: int) -> None:
    campaign = simulate(YPP, quiet(), [(YPP.names[joint], POSTURE)], lock="rigid", workers=1)
    (record,) = campaign.records
    J, slope = judge(POSTURE)
    one = slice(joint, joint + 1)
    expected = exact_response(
        [ROBOT.drives[joint]], J[one, one], slope[one, one], campaign.fs, record.lines * record.f0
    )
    measured = spectra(record, record.theta)[:, joint] / spectra(record, record.tau)[:, joint]
    assert np.abs(measured / expected[:, 0, 0] - 1).max() <= ZOH_ERROR


def coupled_error(swing: float = TINY.swing, **drive: object) -> tuple[float, float]:
    """Largest error of Theta = G T in the plane of joints 2 and 3, relative to the sum of its terms' magnitudes, and how
    much the held motor 2 moves beside the excited motor 3."""
    arm = robot(replace(TINY, torque_noise=0.0, swing=swing), encoder_counts=2**44, **drive)
    (record,) = simulate(YPP, arm, [("joint3", POSTURE)], workers=1).records
    G = exact_response(list(arm.drives), *judge(POSTURE), 1000.0, record.lines * record.f0)[:, 1:, 1:]
    torque, angle = spectra(record, record.tau)[:, 1:], spectra(record, record.theta)[:, 1:]
    terms = np.einsum("lij,lj->li", np.abs(G), np.abs(torque))
    error = np.abs(angle - np.einsum("lij,lj->li", G, torque)) / terms
    return error.max(), np.linalg.norm(angle[:, 0]) / np.linalg.norm(angle[:, 1])


def test_motor_lock_gives_the_exact_response_of_the_coupled_arm() -> None:
    """One step of RK4 a millisecond, and what is left is the arm's own nonlinearity: it falls with the swing."""
    (large, _), (small, held) = coupled_error(4e-4), coupled_error(1e-4)
    assert small <= ZOH_ERROR
    assert large > 3 * small
    assert held > 0.01, "a held motor moves: no disturbance observer makes it rigid"


@pytest.mark.parametrize(
    "stiff",
    [
        {"K": 1e6, "D_spring": 20.0},
        *(pytest.param(stiff, marks=pytest.mark.bench) for stiff in ({"D_spring": 500.0}, {"D": 0.01})),
    ],
    ids=["spring", "damper", "friction"],
)
def test_stiff_and_overdamped_drives_neither_blow_up_nor_lose_accuracy(stiff: dict[str, float]) -> None:
    error, _ = coupled_error(1e-4, **stiff)
    assert error <= ZOH_ERROR


def test_transients_that_do_not_die_are_refused() -> None:
    with pytest.raises(ExperimentError, match=r"joint 'joint3' at posture .* transients need .* s to die"):
        simulate(YPP, robot(D_spring=1e6), [("joint3", POSTURE)], workers=1)


def test_drives_beyond_any_step_are_refused() -> None:
    with pytest.raises(
        ExperimentError, match=r"joint 'joint3' at posture .* steps of the integrator a sample, at most"
    ):
        simulate(YPP, robot(), [("joint3", POSTURE)], truth_drives=robot(D_spring=1e6).drives, workers=1)


def test_a_simulation_that_blows_up_is_an_error_and_leaves_no_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ExperimentError, match=r"joint 'joint3' at posture .* (blown up|beyond its limit)"):
        stiff = robot(K=1e9).drives
        simulate(YPP, robot(), [("joint3", POSTURE)], truth_drives=stiff, workers=1, steps=1, integrator="Euler")
    assert list(tmp_path.iterdir()) == []


def test_a_larger_swing_shows_the_arms_own_nonlinearity() -> None:
    """Even lines of the response are silent for a linear arm and grow with the square of the swing."""
    levels = []
    for swing in (0.01, 0.02):
        (record,) = simulate(
            YPP, quiet(replace(SHORT, swing=swing)), [("joint2", POSTURE)], lock="rigid", workers=1
        ).records
        spectrum = np.abs(np.fft.rfft(record.theta[-record.samples_per_period :, 1]))
        levels.append(spectrum[2:40:2].max())
    assert levels[1] / levels[0] == pytest.approx(4.0, rel=0.1)


def same(one: Campaign, two: Campaign) -> bool:
    return all(
        np.array_equal(a.tau, b.tau) and np.array_equal(a.theta, b.theta) and np.array_equal(a.lines, b.lines)
        for a, b in zip(one.records, two.records, strict=True)
    )


BRIEF = replace(SHORT, periods=2)
CELLS = [("joint3", POSTURE), ("joint1", [0.0, 0.4, 0.1])]


@pytest.mark.bench
def test_link_encoders_read_the_links_with_effects_and_without() -> None:
    """Locked joints stay where they are, the first swings by less than a count; slowly a link follows its motor; an effect of no size is none."""
    arm = robot(replace(BRIEF, f0=2.0, band=(2.0, 120.0), torque_noise=0.0), link_encoder_counts=2**20)
    none = LinkViscous(2, (0.0,))
    step = 2 * np.pi / 2**20
    for lock, live in (("rigid", [2]), ("dob", [1, 2])):
        plain, effect = (simulate(YPP, arm, CELLS[:1], lock=lock, effects=e, workers=1) for e in ((), (none,)))
        q, other = (campaign.records[0].q_link for campaign in (plain, effect))
        assert np.abs(q - other).max() < 1.5 * step
        counts = q / step
        assert np.abs(counts - np.round(counts)).max() < 1e-6
        assert np.flatnonzero(np.ptp(q, axis=0) > 0).tolist() == live
        assert np.abs(q[0] - CELLS[0][1]).max() < step
        record = plain.records[0]
        link, motor = spectra(record, np.stack([q[:, 2], record.theta[:, 2] / 100.0], axis=1), periods=1)[0]
        assert record.lines[0] * record.f0 < 12.0, "far below its mode"
        assert abs(link / motor - 1.0) < 0.03


def test_the_seed_decides_and_the_number_of_workers_does_not() -> None:
    arm = robot(replace(BRIEF, f0=2.0, band=(2.0, 120.0)))
    alone, done = simulate(YPP, arm, CELLS, seed=3, workers=1), []
    both = simulate(YPP, arm, CELLS, seed=3, workers=2, progress=lambda k, n: done.append((k, n)))
    assert same(alone, both)
    assert done == [(1, 2), (2, 2)]
    assert not same(alone, simulate(YPP, arm, CELLS, seed=4, workers=1))
    first = simulate(YPP, arm, CELLS[:1], seed=3, workers=1)
    assert np.array_equal(first.records[0].theta, alone.records[0].theta), "records do not depend on each other"
    assert not np.array_equal(alone.records[0].lines, alone.records[1].lines)


def test_records_hold_what_a_controller_sees() -> None:
    campaign = simulate(YPP, robot(replace(SHORT, periods=5)), CELLS, workers=1)
    assert [record.id for record in campaign.records] == ["0001", "0002"]
    for record, (name, q) in zip(campaign.records, CELLS, strict=True):
        i = YPP.names.index(name)
        assert (record.excited, record.samples_per_period, record.periods) == (name, 2000, 5)
        assert record.tau.shape == record.theta.shape == (10_000, 3)
        assert record.omega is None and record.q_link is None
        counts = record.theta / (2 * np.pi / 131072)
        assert np.abs(counts - np.round(counts)).max() < 1e-6, "read through the encoder"
        force = pin.computeGeneralizedGravity(JUDGE, JUDGE.createData(), np.array(q))
        K, N = np.array([5500.0, 4500.0, 4500.0]), 100.0
        step = 2 * np.pi / 131072
        assert np.abs(record.theta[0] - N * (q + force / K)).max() <= step, "starts at rest, motors carrying the load"
        away = np.abs(record.theta / N - (q + force / K)).max(axis=0)
        assert 0.5 * SHORT.swing < away[i] < 1.5 * SHORT.swing
        lines = np.abs(spectra(record, record.tau)[:, i])
        multisine = record.rms * np.sqrt(2 / np.sum(np.minimum(1, record.lines * 0.5 / 3) ** 2)) * 1000
        middle = record.lines * 0.5 > 100  # Hz: far above the hold's bandwidth it adds next to nothing
        assert lines[middle] == pytest.approx(multisine, rel=0.1)


def test_noise_acts_on_the_arm_and_is_not_recorded() -> None:
    still = replace(BRIEF, torque_noise=0.0)
    (without,), (noisy,) = (
        simulate(YPP, robot(e), CELLS[:1], lock="rigid", workers=1).records
        for e in (still, replace(BRIEF, torque_noise=0.1))
    )
    assert not np.array_equal(without.theta, noisy.theta)
    # what the recorded torque does not explain: the hold's answer to the noise is far smaller than the noise itself
    assert np.std(noisy.tau[:, 2] - without.tau[:, 2]) < 0.3 * 0.1 * noisy.rms


def test_rigid_lock_freezes_the_other_joints_under_their_load() -> None:
    (record,) = simulate(YPP, robot(BRIEF), CELLS[:1], lock="rigid", workers=1).records
    force = pin.computeGeneralizedGravity(JUDGE, JUDGE.createData(), POSTURE)
    assert np.ptp(record.theta[:, :2]) != 0 and np.ptp(record.theta[:, 0]) == np.ptp(record.theta[:, 1]) == 0
    assert record.tau[:, :2] == pytest.approx(np.tile(force[:2] / 100, (len(record.tau), 1)), rel=1e-9, abs=1e-12)


def test_setup_predicts_swing_and_torque() -> None:
    stream = np.random.SeedSequence(1).spawn(1)[0].spawn(2)[0]  # the one `simulate` designs its first record from
    setup = prepare(YPP, quiet(), "joint2", POSTURE, lock="dob", rng=np.random.default_rng(stream))
    (record,) = simulate(YPP, quiet(), [("joint2", POSTURE)], workers=1, seed=1).records
    tau, theta = record.tau[-2000:, 1], record.theta[-2000:, 1] / 100
    preload = tau.mean()
    assert setup.growth < 0
    assert setup.swing == pytest.approx(TINY.swing)
    assert np.abs(theta - theta.mean()).max() <= 1.001 * setup.swing
    assert setup.torque[1] == pytest.approx(abs(preload) + np.abs(tau - preload).max(), rel=1e-3)


def test_torque_limit_binds_where_the_swing_does_not() -> None:
    small = robot(replace(SHORT, swing=0.5), tau_max=0.4)
    setup = prepare(YPP, small, "joint2", [0, 0, 0], lock="rigid", rng=np.random.default_rng(0))
    assert setup.torque[0] == pytest.approx(TORQUE_SHARE * 0.4)
    assert setup.swing < 0.5


def test_schroeder_excites_every_line() -> None:
    (record,) = simulate(YPP, robot(BRIEF), CELLS[:1], lock="rigid", workers=1, excitation="schroeder").records
    assert list(record.lines) == list(range(1, 241))


def heavier(chain: Chain, factor: float) -> Chain:
    def grow(body: Inertia) -> Inertia:
        return Inertia(factor * body.mass, body.com, factor * body.I)

    return replace(chain, joints=tuple(replace(joint, inertia=grow(joint.inertia)) for joint in chain.joints))


def test_the_campaign_tells_the_declared_robot_and_the_records_the_true_one() -> None:
    softer = [replace(drive, K=0.8 * drive.K, J_m=1.1 * drive.J_m) for drive in quiet().drives]
    truth = {"truth": heavier(YPP, 1.3), "truth_drives": softer}
    campaign = simulate(YPP, quiet(), [("joint2", POSTURE)], lock="rigid", workers=1, **truth)
    assert campaign.urdf == ROBOT.urdf.read_text()
    assert list(campaign.K) == [5500.0, 4500.0, 4500.0] and list(campaign.J_m) == [4e-5, 4e-5, 1e-5]
    assert "1.3" not in campaign.source and "rigid" in campaign.source and "MuJoCo" in campaign.source
    (record,) = campaign.records
    J, slope = judge(POSTURE)
    expected = exact_response(softer[1:2], 1.3 * J[1:2, 1:2], 1.3 * slope[1:2, 1:2], 1000.0, record.lines * record.f0)
    measured = spectra(record, record.theta)[:, 1] / spectra(record, record.tau)[:, 1]
    assert np.abs(measured / expected[:, 0, 0] - 1).max() <= ZOH_ERROR


GANTRY = """<robot name="gantry"><link name="base"/>
<joint name="rail" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="500" velocity="1"/></joint>
<link name="cart"><inertial><mass value="8"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="wrist" type="continuous"><parent link="cart"/><child link="hand"/><axis xyz="1 0 0"/></joint>
<link name="hand"><inertial><origin xyz="0 0.2 0"/><mass value="2"/><inertia ixx="0.02" iyy="0.01" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


def test_a_campaign_of_a_part_of_a_robot_is_of_that_part() -> None:
    """A joint that stands still at an angle, and an arm that ends before the last link: whoever reads the campaign gets the same J(q)."""
    chain = load_chain(ROBOT.urdf, tip="link2", at={"joint1": 0.7, "joint3": -0.4}, base="base_link")
    part = head(chain, ROBOT, ())
    q = np.linspace(-1.0, 1.0, 5)[:, None]
    J, as_read = (make_model(chain).J_cad(q), model_of_urdf(part.urdf, part.joints).J_cad(q))
    straight = model_of_urdf(chain.source, chain.names).J_cad(q)
    np.testing.assert_array_equal(as_read, J)
    assert np.abs(straight / J - 1.0).max() > 1e-3


def test_a_vertical_rail_and_a_reversed_wrist() -> None:
    chain = parse_chain(GANTRY)
    fine = 2**50  # at 2**44 counts the rounding alone is near ZOH_ERROR
    rail = Drive("rail", 400.0, 1e-4, 2e5, 3e-5, 20.0, fine, 3.0, linear=True)
    wrist = Drive("wrist", -80.0, 2e-5, 3000.0, 3e-5, 0.4, fine, 1.0)
    arm = replace(ROBOT, urdf=Path("gantry.urdf"), drives=(wrist, rail), experiment=replace(TINY, torque_noise=0.0))
    q = [0.3, 0.5]
    campaign = simulate(chain, arm, [("wrist", q), ("rail", q)], workers=1)
    model = pin.buildModelFromXML(GANTRY)
    # Pinocchio turns a continuous joint into (cos, sin)
    state = np.array([q[0], np.cos(q[1]), np.sin(q[1])])
    J = pin.crba(model, model.createData(), state)
    J = np.triu(J) + np.triu(J, 1).T
    slope = pin.computeGeneralizedGravityDerivatives(model, model.createData(), state)
    for record in campaign.records:
        G = exact_response([rail, wrist], J, slope, 1000.0, record.lines * record.f0)
        torque, angle = spectra(record, record.tau), spectra(record, record.theta)
        terms = np.einsum("lij,lj->li", np.abs(G), np.abs(torque))
        assert (np.abs(angle - np.einsum("lij,lj->li", G, torque)) / terms).max() <= ZOH_ERROR
    assert campaign.records[0].tau[0] * [400.0, -80.0] == pytest.approx([10 * 9.81, 2 * 9.81 * 0.2 * np.cos(0.5)])


def test_a_rail_that_strays_strays_by_metres() -> None:
    chain, short = parse_chain(GANTRY), replace(SHORT, f0=4.0, band=(4.0, 120.0), periods=3)
    rail = Drive("rail", 400.0, 1e-4, 2e5, 3e-5, 20.0, 2**20, 300.0, linear=True)
    wrist = Drive("wrist", -80.0, 2e-5, 3000.0, 3e-5, 0.4, 2**20, 100.0)
    arm = replace(ROBOT, urdf=Path("gantry.urdf"), drives=(wrist, rail), experiment=short)
    for joint, unit in (("rail", "m"), ("wrist", "rad")):
        (job,) = design(chain, arm, [(joint, [0.3, 0.5])], lock="rigid")
        wild = job.setup.excitation.scaled(20 * job.setup.excitation.rms)
        with pytest.raises(
            ExperimentError, match=rf"'{joint}' moves \S+ {unit} from rest in .* swing of \S+ {unit}: it fell"
        ):
            run(replace(job, setup=replace(job.setup, excitation=wild)))


@pytest.mark.parametrize(
    ("changes", "cell", "lock", "message"),
    [
        ({}, ("joint9", [0, 0, 0]), "dob", r"excites joint 'joint9'; the arm has joint1, joint2, joint3"),
        ({}, ("joint2", [0, 0]), "dob", r"joint 'joint2': posture .* expected 3 finite numbers"),
        ({}, ("joint2", [0, np.nan, 0]), "dob", r"expected 3 finite numbers"),
        ({}, ("joint2", [0, 0, 2.7]), "dob", r"joint 'joint2' at posture .*'joint3' = 2.7 is outside .* \[-2.6, 2.6\]"),
        ({}, ("joint2", [0, 0, 0]), "soft", r"lock = 'soft'; expected 'dob' or 'rigid'"),
        ({"tau_max": 0.25}, ("joint3", [0, 0, 0]), "dob", r"gravity alone needs 0.21 N m of motor 'joint2'.* 0.25 N m"),
    ],
)
def test_bad_requests_are_refused_before_anything_runs(
    changes: dict[str, float], cell: tuple[str, list[float]], lock: str, message: str
) -> None:
    with pytest.raises(ExperimentError, match=message) as error:
        simulate(YPP, robot(**changes), [cell], lock=lock)
    assert "\n" not in str(error.value)


def test_torque_beyond_the_limit_is_an_error_and_not_a_flat_top() -> None:
    weak = [replace(drive, tau_max=0.25) for drive in ROBOT.drives]
    with pytest.raises(
        ExperimentError, match=r"joint 'joint2' at posture .*s after the start the torque of motor 'joint2'"
    ):
        simulate(YPP, robot(replace(SHORT, swing=0.02)), [("joint2", [0, 0, 0])], truth_drives=weak, workers=1)


def test_an_arm_that_falls_is_noticed() -> None:
    """Twenty times the declared gravity above an upright joint: the hold is too soft and the arm tips over."""
    strong = robot(tau_max=200.0)
    with pytest.raises(ExperimentError, match=r"joint 'joint2' at posture .* moves .* it fell"):
        simulate(
            YPP,
            strong,
            [("joint2", [0, np.pi / 2, 0])],
            truth=heavier(YPP, 20),
            truth_drives=strong.drives,
            lock="rigid",
            workers=1,
        )


def test_truth_must_have_the_same_joints() -> None:
    other = replace(YPP, joints=YPP.joints[:2])
    with pytest.raises(ExperimentError, match="truth has the joints joint1, joint2; expected joint1, joint2, joint3"):
        simulate(YPP, robot(), CELLS, truth=other)
