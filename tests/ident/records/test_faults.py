"""Every fault is called by its name and joint, with a remedy; nothing is called a fault where there is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from ident.effects.catalogue import parse
from ident.errors import IdentError
from ident.identification.identify import identify
from ident.loop.either_model import diagnose_either
from ident.records.campaign import Campaign, Record
from ident.records.faults import FLAG, REFUSE, Fault, faults, refuse
from ident.records.signal_faults import flat_top, jumps, stuck
from ident.simulator.bench import design, head, run, simulate
from symgen.chain import Chain, Inertia
from symgen.plan import chain_of_robot, model_of_urdf
from symgen.robot import Robot, load_robot

ROBOTS = Path(__file__).parents[3] / "robots"
NAMES = ("ypp3", "arm6")
EVERY = ("ypp3", "ypp3_general", "scara4", "arm6", "arm7")


def quick(name: str) -> Robot:
    robot = load_robot(ROBOTS / name)
    return replace(robot, experiment=replace(robot.experiment, f0=1.0, band=(1.0, 120.0), periods=4))


def cells(chain: Chain, seed: int = 0) -> list[tuple[str, np.ndarray]]:
    """Each joint once, at postures of no symmetry; the first joint stays at zero, as in every plan."""
    low, high = chain.limits.T
    middle, reach = (low + high) / 2, np.minimum(high - low, 2.0) / 2
    rng = np.random.default_rng(seed)
    postures = [middle * 0.3 + 0.7 * reach * rng.uniform(-1, 1, chain.n) for _ in chain.names]
    postures = [np.clip(q, low + 0.05, high - 0.05) for q in postures]
    return [(name, np.concatenate([[0.0], q[1:]])) for name, q in zip(chain.names, postures, strict=True)]


def off(chain: Chain, by: float, rng: np.random.Generator) -> Chain:
    """The arm as it really is: masses and centres of mass wrong by up to `by` in the file."""

    def true(body: Inertia) -> Inertia:
        factor = 1 + by * rng.uniform(-1, 1)
        return Inertia(factor * body.mass, body.com * (1 + by * rng.uniform(-1, 1)), factor * body.I)

    return replace(chain, joints=tuple(replace(joint, inertia=true(joint.inertia)) for joint in chain.joints))


def clean(name: str, lock: str = "dob", wrong: bool = False, every: bool = False) -> Campaign:
    """With torque noise and encoders; `wrong`: links off by 30 %, K by 30 %, J_m by 10 %. Some joints, or `every` one."""
    every = every and name not in ("ypp3", "ypp3_general")  # of three joints some are all
    return _clean(name, lock, wrong, every)  # a cache tells calls apart by how they are written, too


@cache
def _clean(name: str, lock: str, wrong: bool, every: bool) -> Campaign:
    robot, rng = quick(name), np.random.default_rng(7)
    chain = chain_of_robot(robot)
    truth: dict[str, object] = {}
    if wrong:
        drives = [robot.drive(joint) for joint in chain.names]
        true = [replace(d, K=d.K * rng.uniform(0.7, 1.3), J_m=d.J_m * rng.uniform(0.9, 1.1)) for d in drives]
        truth = {"truth": off(chain, 0.3, rng), "truth_drives": true}
    chosen = [cell for cell in cells(chain) if every or cell[0] in some(chain.names)]
    return simulate(chain, robot, chosen, lock=lock, seed=5, workers=1, **truth)


MODEL = cache(model_of_urdf)


def found(campaign: Campaign) -> tuple[Fault, ...]:
    return faults(campaign, MODEL(campaign.urdf, campaign.joints))


def some(joints: tuple[str, ...]) -> dict[str, int]:
    """The first joint, which was measured at zero only, the last one and one between."""
    return {joints[j]: j for j in (0, len(joints) // 2, len(joints) - 1)}


def every_record(campaign: Campaign, change: Callable[[Record], Record]) -> Campaign:
    return replace(campaign, records=tuple(change(record) for record in campaign.records))


def one_record(campaign: Campaign, k: int, change: Callable[[Record], Record]) -> Campaign:
    return replace(campaign, records=tuple(change(r) if i == k else r for i, r in enumerate(campaign.records)))


def column(record: Record, name: str, j: int, change: Callable[[np.ndarray], np.ndarray]) -> Record:
    values = np.array(getattr(record, name))
    values[:, j] = change(values[:, j])
    return replace(record, **{name: values})


def only(faults: tuple[Fault, ...], name: str, joint: str) -> Fault:
    """The one fault there is; its line names joint or record and fits in a line."""
    assert [(fault.name, fault.joint) for fault in faults] == [(name, joint)]
    (fault,) = faults
    assert fault.severity == REFUSE and "\n" not in fault.line and (joint.split(",")[0] or fault.record) in fault.line
    return fault


# no false alarm -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "wrong", "every"),
    [
        ("ypp3", True, True),
        ("scara4", True, True),
        ("arm6", True, False),  # whose records other tests need, too
        *(pytest.param(name, True, True, marks=pytest.mark.bench) for name in ("arm6", "arm7", "ypp3_general")),
        # as declared, where nothing else needs these records: the easier half, some joints of each arm
        *(pytest.param(name, False, False, marks=() if name == "ypp3" else pytest.mark.bench) for name in EVERY),
    ],
)
def test_nothing_is_found_where_nothing_is(name: str, wrong: bool, every: bool) -> None:
    assert found(clean(name, "dob", wrong, every)) == ()


@pytest.mark.parametrize("wrong", [True, pytest.param(False, marks=pytest.mark.bench)])
@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_found_where_nothing_is_and_others_are_rigid(name: str, wrong: bool) -> None:
    assert found(clean(name, "rigid", wrong)) == ()


@pytest.mark.parametrize(
    "effect",
    ["motor-coulomb:level=0.03", "motor-stribeck:level=0.01,peak=0.01,speed=1", "link-coulomb:level=1",
     "backlash:gap=1e-4", "spring-hardening:cubic=2e8", "encoder-eccentricity", "time-offset"],
)  # fmt: skip
def test_an_effect_of_the_arm_is_no_fault_of_the_recording(effect: str) -> None:
    """Friction that nearly holds a joint, a spring that is none: the fit's business, or the diagnosis'."""
    robot = quick("ypp3")
    robot = replace(robot, experiment=replace(robot.experiment, f0=2.0, band=(2.0, 120.0), fs=500.0))
    chain = chain_of_robot(robot)
    drives = [robot.drive(joint) for joint in chain.names]
    effects = [parse(f"{effect}@{joint}", drives) for joint in chain.names]
    (job,) = design(chain, robot, cells(chain)[2:], lock="rigid", seed=5, effects=effects)
    record = run(replace(job, setup=replace(job.setup, periods=job.setup.settle + 2)))
    assert found(head(chain, robot, (record,), lock="rigid")) == ()


def test_unknown_drives_are_no_fault_and_hide_none_at_rest() -> None:
    unknown = replace(clean("ypp3"), J_m=np.full(3, np.nan), K=np.full(3, np.nan))
    assert found(unknown) == ()
    only(found(every_record(unknown, lambda r: column(r, "theta", 1, np.negative))), "wrong gear ratio", "joint2")


# signs, units, ratios -------------------------------------------------------------------------------------------------

arms = pytest.mark.parametrize("name", NAMES)
#: What is told of six joints that are 30 % off is told of six as declared.
both = pytest.mark.parametrize(
    ("name", "wrong"),
    [("ypp3", False), ("ypp3", True), pytest.param("arm6", False, marks=pytest.mark.bench), ("arm6", True)],
    ids=["ypp3, as declared", "ypp3, 30 % off", "arm6, as declared", "arm6, 30 % off"],
)


@both
def test_a_sign(name: str, wrong: bool) -> None:
    campaign = clean(name, wrong=wrong)
    for joint, j in some(campaign.joints).items():
        angle = every_record(campaign, lambda r, j=j: column(r, "theta", j, np.negative))
        torque = every_record(campaign, lambda r, j=j: column(r, "tau", j, np.negative))
        which = "theta or tau" if j == 0 else "theta"  # joint 1 was measured at zero only
        assert f"negate {which} of {joint}" in only(found(angle), "wrong sign", joint).line
        which = "theta or tau" if j == 0 else "tau"
        assert f"negate {which} of {joint}" in only(found(torque), "wrong sign", joint).line


@both
def test_a_unit(name: str, wrong: bool) -> None:
    campaign = clean(name, wrong=wrong)
    for joint, j in some(campaign.joints).items():
        degrees = found(every_record(campaign, lambda r, j=j: column(r, "theta", j, np.degrees)))
        assert "degrees" in only(degrees, "degrees for radians" if j else "wrong unit", joint).line
        milli = found(every_record(campaign, lambda r, j=j: column(r, "tau", j, lambda x: 1000 * x)))
        assert "mN m" in only(milli, "wrong unit", joint).line
        N = campaign.N[j]
        joint_side = found(every_record(campaign, lambda r, j=j, N=N: column(r, "theta", j, lambda x: x / N)))
        assert "behind the gear" in only(joint_side, "wrong side of the gear" if j else "wrong unit", joint).line


def test_all_angles_in_degrees_are_named_joint_by_joint() -> None:
    campaign = every_record(clean("ypp3"), lambda r: replace(r, theta=np.degrees(r.theta)))
    assert [(f.name, f.joint) for f in found(campaign)] == [("degrees for radians", j) for j in ("joint2", "joint3")]


@both
@pytest.mark.parametrize("factor", [1.015, 2.5, -1.0, pytest.param(0.4, marks=pytest.mark.bench)])
def test_a_gear_ratio(name: str, wrong: bool, factor: float) -> None:
    campaign = clean(name, wrong=wrong)
    for joint, j in some(campaign.joints).items():
        if j == 0 and (factor in (1.015, -1.0) or wrong and factor > 1):
            continue  # seen in motion only: a little, or too large an N, looks like errors of K, J_m and CAD; no sign is seen
        N = np.array(campaign.N)
        N[j] *= factor
        only(found(replace(campaign, N=N)), "wrong gear ratio", joint)


def test_turns_that_a_single_turn_encoder_has_lost() -> None:
    campaign = clean("ypp3")
    turns = iter([0.0, 1.0, -2.0])
    lost = every_record(campaign, lambda r: column(r, "theta", 1, lambda x: x + 2 * np.pi * next(turns)))
    assert "-2 to +1 whole turns" in only(found(lost), "lost turns", "joint2").line


def test_the_true_gear_ratio_is_told() -> None:
    campaign = clean("ypp3")
    fault = only(found(replace(campaign, N=np.array([100.0, 80.0, 100.0]))), "wrong gear ratio", "joint2")
    told = float(fault.line.split("say N = ")[1].split(",")[0])
    assert told == pytest.approx(100, rel=0.01) and "declared is 80" in fault.line  # sag: 0.5 % of these angles


@both
def test_swapped_encoders_and_swapped_torques(name: str, wrong: bool) -> None:
    campaign = clean(name, wrong=wrong)
    for i, k in combinations(some(campaign.joints).values(), 2):
        order = np.arange(campaign.n)
        order[[i, k]] = order[[k, i]]
        pair = f"{campaign.joints[i]}, {campaign.joints[k]}"
        angles = found(every_record(campaign, lambda r, order=order: replace(r, theta=r.theta[:, order])))
        only(angles, "swapped encoders", pair)
        postures = found(every_record(campaign, lambda r, order=order: replace(r, posture=r.posture[order])))
        only(postures, "swapped postures", pair)
        torques = found(every_record(campaign, lambda r, order=order: replace(r, tau=r.tau[:, order])))
        assert {(f.name, f.joint) for f in torques} == {("wrong motor", campaign.joints[j]) for j in (i, k)}


def test_swapped_encoders_of_an_arm_that_was_measured_at_zero() -> None:
    """Nothing is seen at rest, but who answers the excited motor is."""
    robot = quick("ypp3")
    chain = chain_of_robot(robot)
    campaign = simulate(chain, robot, [(joint, np.zeros(3)) for joint in chain.names], lock="rigid", workers=1)
    assert found(campaign) == ()
    order = [0, 2, 1]
    only(
        found(every_record(campaign, lambda r: replace(r, theta=r.theta[:, order]))),
        "swapped encoders",
        "joint2, joint3",
    )


@arms
def test_the_record_of_another_posture_and_a_wrong_zero(name: str) -> None:
    campaign = clean(name)
    other = campaign.records[1].posture.copy()
    other[1] += 0.2
    moved = found(one_record(campaign, 1, lambda r: replace(r, posture=other)))
    assert only(moved, "another posture", "joint2").record == "0002"
    shift = 0.3 * campaign.N[2]
    zero = found(every_record(campaign, lambda r: column(r, "theta", 2, lambda x: x + shift)))
    told = float(only(zero, "encoder zero", "joint3").line.split("off by ")[1].split()[0])
    assert told == pytest.approx(0.3, abs=0.01)


def resting(postures: list[float], N: float, read: Callable[[np.ndarray], np.ndarray]) -> Campaign:
    """Records of joint 2 at these angles, which its encoder shows as `read` has them; its declared gear ratio is `N`."""
    campaign, records = clean("ypp3"), []
    for k, q in enumerate(postures):
        record = campaign.records[1]
        posture = record.posture.copy()
        posture[1], still = q, record.theta[:, 1] - record.theta[:, 1].mean()
        shown = float(N * read(np.array(q)))
        records.append(
            replace(column(record, "theta", 1, lambda x, s=still, at=shown: at + s), id=f"{k:04d}", posture=posture)
        )
    return replace(campaign, records=tuple(records), N=np.array([campaign.N[0], N, campaign.N[2]]))


def test_a_zero_that_is_off_is_no_gear_ratio_where_all_postures_lie_on_one_side() -> None:
    """A ratio of 1.04 leaves 2 % of these angles, the zero nothing; and the other way round."""
    postures = [1.2, 1.5, 1.7, 1.4]
    zero = only(found(resting(postures, 200.0, lambda q: q + 0.06)), "encoder zero", "joint2")
    assert float(zero.line.split("off by ")[1].split()[0]) == pytest.approx(0.06, rel=0.01)
    only(found(resting(postures, 200.0, lambda q: 1.04 * q)), "wrong gear ratio", "joint2")


@pytest.mark.parametrize("N", [1.0, -1.0])
def test_nothing_is_behind_a_gear_of_one(N: float) -> None:
    """0.08 rad at 4 rad are within what a side of the gear may leave."""
    only(found(resting([4.0, 4.2, 4.4], N, lambda q: q + 0.08)), "encoder zero", "joint2")


# signals --------------------------------------------------------------------------------------------------------------


def without(record: Record, at: int, count: int) -> Record:
    """Samples at .. at + count are lost; the recorder goes on to its full length."""

    def cut(values: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [np.delete(values, np.s_[at : at + count], axis=0), values[-record.samples_per_period :][:count]]
        )

    return replace(record, tau=cut(record.tau), theta=cut(record.theta))


def twice(record: Record, at: int) -> Record:
    def again(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values[:at], values[at - 1 : at], values[at:]])[: len(values)]

    return replace(record, tau=again(record.tau), theta=again(record.theta))


@pytest.mark.parametrize("lock", ["dob", "rigid"])
@arms
def test_lost_samples(name: str, lock: str) -> None:
    campaign = clean(name, lock, wrong=True)
    for at, count in ((4077, 1), (2700, 3), (4000, 40), (4900, 1), (1500, 2)):
        fault = only(found(one_record(campaign, 1, lambda r, a=at, c=count: without(r, a, c))), "lost samples", "")
        assert fault.record == "0002" and f"{count} sample" in fault.line and "missing" in fault.line
        when = float(fault.line.split("after about ")[1].split()[0])
        assert when == pytest.approx(at / 1000, abs=0.25)  # two blocks of an eighth of a second
    assert "there twice" in only(found(one_record(campaign, 1, lambda r: twice(r, 4000))), "lost samples", "").line


def test_an_encoder_that_leaps_at_some_angles_has_lost_no_samples() -> None:
    campaign = clean("ypp3", "dob", wrong=True)

    def leaping(theta: np.ndarray) -> np.ndarray:
        return theta + 0.01 * (2.0 * (8.0 * theta / (2.0 * np.pi) % 1.0) - 1.0)

    def misread(record: Record) -> Record:
        return column(record, "theta", campaign.joints.index(record.excited), leaping)

    assert "lost samples" not in [fault.name for fault in found(every_record(campaign, misread))]


@arms
def test_samples_filled_up_with_the_one_before(name: str) -> None:
    def fill(record: Record) -> Record:
        tau, theta = np.array(record.tau), np.array(record.theta)
        for at in (4000, 4051, 5700):
            tau[at], theta[at] = tau[at - 1], theta[at - 1]
        return replace(record, tau=tau, theta=theta)

    assert "3 rows repeat" in only(found(one_record(clean(name), 0, fill)), "lost samples", "").line


def test_a_record_that_is_there_twice() -> None:
    campaign = clean("ypp3")
    twice = replace(campaign, records=(*campaign.records, replace(campaign.records[0], id="again")))
    assert only(found(twice), "copied record", "").record == "again"


@arms
def test_torques_told_coarsely_rest_by_chance(name: str) -> None:
    """A drive that logs its current in thousandths: held joints' torques take a few values, and rows are those before."""

    def coarse(record: Record) -> Record:
        step = record.rms / 100
        return replace(record, tau=np.round(np.array(record.tau) / step) * step)

    def fill(record: Record) -> Record:
        tau, theta = np.array(record.tau), np.array(record.theta)
        speed = np.abs(np.diff(theta[:, campaign.joints.index(record.excited)]))
        for at in np.flatnonzero(speed > np.quantile(speed, 0.9))[[300, 350, 400]]:
            tau[at : at + 2], theta[at : at + 2] = tau[at - 1], theta[at - 1]
        return replace(record, tau=tau, theta=theta)

    campaign = every_record(clean(name), coarse)
    assert not found(campaign)
    assert "rows repeat" in only(found(one_record(campaign, 0, fill)), "lost samples", "").line


def test_a_joint_that_rests_between_two_counts_has_a_torque_with_noise() -> None:
    campaign = clean("ypp3")
    j = next(j for j, joint in enumerate(campaign.joints) if joint != campaign.records[0].excited)
    rng = np.random.default_rng(0)
    rests = one_record(campaign, 0, lambda r: column(r, "theta", j, lambda x: np.full_like(x, x[0])))
    rests = one_record(
        rests, 0, lambda r: column(r, "tau", j, lambda x: x.mean() + 0.005 * r.rms * rng.normal(size=len(x)))
    )
    assert not found(rests)


def test_an_arm_that_rests_before_it_is_excited_repeats_itself() -> None:
    def late(record: Record) -> Record:
        tau, theta = np.array(record.tau), np.array(record.theta)
        tau[:400], theta[:400] = tau[0], theta[0]
        return replace(record, tau=tau, theta=theta)

    lines = [fault.line for fault in found(one_record(clean("ypp3"), 0, late))]
    assert not any("repeat" in line for line in lines)


@both
def test_a_torque_or_an_angle_that_is_cut_off(name: str, wrong: bool) -> None:
    campaign = clean(name, wrong=wrong)

    def clip(values: np.ndarray) -> np.ndarray:
        level = 0.75 * np.abs(values - values.mean()).max()
        return np.clip(values, values.mean() - level, values.mean() + level)

    def saturate(values: np.ndarray) -> np.ndarray:
        settled = values[len(values) // 2 :]
        return np.minimum(values, settled.min() + 0.92 * np.ptp(settled))

    def wrap(values: np.ndarray) -> np.ndarray:
        return np.where(values > np.median(values), values - 2 * np.pi, values)

    for k, (joint, j) in enumerate(some(campaign.joints).items()):
        for name_, signal, change in (
            ("clipped torque", "tau", clip), ("saturated encoder", "theta", saturate), ("jumping encoder", "theta", wrap)
        ):  # fmt: skip
            changed = one_record(campaign, k, lambda r, s=signal, j=j, c=change: column(r, s, j, c))
            only(found(changed), name_, joint)


@arms
def test_a_stuck_encoder(name: str) -> None:
    campaign = clean(name)
    for own, (joint, j) in enumerate(some(campaign.joints).items()):
        # of the excited joint, of a held one that another moves: joint1 of ypp3 moves none, and none moves it
        held = [k for k, r in enumerate(campaign.records) if name != "ypp3" or "joint1" not in (joint, r.excited)]
        for k in {own, *held}:
            changed = one_record(campaign, k, lambda r, j=j: column(r, "theta", j, lambda x: np.full_like(x, x[0])))
            assert only(found(changed), "stuck encoder", joint).record == campaign.records[k].id
        half = one_record(
            campaign,
            own,
            lambda r, j=j: column(r, "theta", j, lambda x: np.where(np.arange(len(x)) < 3500, x, x[3500])),
        )
        only(found(half), "stuck encoder", joint)


def test_signals_of_their_own() -> None:
    t = np.arange(4000) / 1000
    slow = np.round(np.sin(2 * np.pi * t) / 1e-3) * 1e-3  # coarse: it rests on its top for samples
    assert flat_top(slow) is None and flat_top(np.sin(2 * np.pi * t)) is None and flat_top(np.ones(100)) is None
    level, share = flat_top(np.minimum(slow, 0.9)) or (0.0, 0.0)
    assert level == 0.9 and share == pytest.approx(np.arccos(0.9) / np.pi, rel=0.02)
    assert (flat_top(np.maximum(slow, -0.8)) or (0.0, 0.0))[0] == -0.8
    assert jumps(slow) is None and jumps(np.where(t < 1.6, slow, slow + 1)) == 1600
    assert not stuck(slow, 1000) and stuck(np.where(t < 3, slow, slow[3000]), 1000)


# what identify makes of them ------------------------------------------------------------------------------------------


def test_identify_refuses_in_one_line() -> None:
    campaign = every_record(clean("ypp3"), lambda r: column(column(r, "theta", 1, np.degrees), "theta", 2, np.negative))
    with pytest.raises(IdentError, match=r"^joint2: theta is in degrees.* \[1 more: wrong sign \(joint3\)\]$") as error:
        identify(campaign, method="two-mass")
    assert "\n" not in str(error.value)


def test_a_diagnosis_refuses_in_one_line_too() -> None:
    """What a wrong sign bends is no effect: it was told as a resonator, after four minutes."""
    campaign = every_record(clean("ypp3"), lambda r: column(r, "theta", 2, np.negative))
    with pytest.raises(IdentError, match="^joint3: theta has the wrong sign, .*: negate theta of joint3$"):
        diagnose_either(campaign)


def test_records_that_are_all_said_to_be_of_another_motor() -> None:
    (one, *_) = clean("ypp3").records
    wrong = replace(clean("ypp3"), records=(replace(one, excited="joint1" if one.excited != "joint1" else "joint2"),))
    with pytest.raises(IdentError, match=f"but the multisine is on the motor of {one.excited}"):
        refuse(wrong, model_of_urdf(wrong.urdf, wrong.joints))


def test_a_gear_ratio_too_large_shows_in_what_is_identified() -> None:
    """N = 250 for 100: the angles at rest are zero, and the responses look like 10 % of J_m until they are fitted."""
    campaign = clean("ypp3", "rigid", wrong=True)
    result = identify(replace(campaign, N=np.array([250.0, 100.0, 100.0])), method="two-mass", believe_zeros=True)
    assert [(fault.name, fault.joint) for fault in result.faults] == [("doubtful gear ratio", "joint1")]
    told = float(result.faults[0].line.split("about ")[1].split()[0])
    assert told == pytest.approx(100, rel=0.2)


def test_identify_names_the_fault_where_there_is_no_response() -> None:
    still = one_record(clean("ypp3"), 0, lambda r: column(r, "theta", 0, lambda x: np.full_like(x, x[0])))
    with pytest.raises(IdentError, match="record 0001: joint1: the angle does not change"):
        identify(still, method="two-mass")


def test_a_scale_without_a_name_is_told_and_not_refused() -> None:
    strange = every_record(clean("ypp3"), lambda r: column(r, "tau", 0, lambda x: 25 * x))
    (fault,) = refuse(strange, model_of_urdf(strange.urdf, strange.joints))
    assert (fault.name, fault.joint, fault.severity) == ("wrong scale", "joint1", FLAG)
    assert "0.04" in fault.line and fault.line in identify(strange, method="two-mass").notes
