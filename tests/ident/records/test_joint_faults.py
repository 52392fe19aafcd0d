"""Soft springs are no fault of a joint; a gear that turns the other way round is told where no angle at rest tells of it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from two_joints import two_joints

from ident.records.campaign import Campaign, Record
from ident.records.faults import FLAG, REFUSE, Fault, faults
from ident.records.joint_faults import at_rest
from ident.records.looks import observe
from ident.simulator.bench import simulate
from symgen.plan import model_of_urdf

EXPERIMENT = "sample_rate_Hz = 500\nline_spacing_Hz = 1.0\nband_Hz = [1.0, 60.0]\nperiods = 3"
POSTURES = ([0.0, 0.2], [0.0, -1.3], [0.0, 1.1], [0.0, -0.4])


def found(campaign: Campaign) -> tuple[Fault, ...]:
    return faults(campaign, model_of_urdf(campaign.urdf, campaign.joints))


@pytest.fixture(scope="module")
def soft(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Of an arm whose second spring gives by 73 mrad under gravity."""
    folder: Path = tmp_path_factory.mktemp("soft")
    drives = [{"K_Nm_per_rad": K, "D_spring_Nms_per_rad": K / 1000} for K in (100.0, 30.0)]
    robot = two_joints(folder, EXPERIMENT, *drives)
    chain = model_of_urdf((folder / "r.urdf").read_text(), ("j1", "j2")).chain
    cells = [("j2", np.array(POSTURES[0])), *[("j1", np.array(q)) for q in POSTURES]]
    return simulate(chain, robot, cells, seed=0, workers=1)


@pytest.fixture(scope="module")
def softer(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Of an arm whose second spring gives by 0.2 rad under gravity."""
    folder: Path = tmp_path_factory.mktemp("softer")
    drives = [{"K_Nm_per_rad": K, "D_spring_Nms_per_rad": 0.1} for K in (100.0, 10.0)]
    robot = two_joints(folder, EXPERIMENT, *drives)
    chain = model_of_urdf((folder / "r.urdf").read_text(), ("j1", "j2")).chain
    cells = [("j2", np.array(POSTURES[0])), *[("j1", np.array(q)) for q in POSTURES], ("j2", np.array(POSTURES[2]))]
    return simulate(chain, robot, cells, seed=0, workers=1)


def with_theta(campaign: Campaign, j: int, factor: float) -> Campaign:
    scale = np.where(np.arange(campaign.n) == j, factor, 1.0)
    return replace(campaign, records=tuple(replace(r, theta=r.theta * scale) for r in campaign.records))


def test_a_spring_that_gives_is_no_fault(soft: Campaign) -> None:
    bent = [r.tau[:, 1].mean() * soft.N[1] / soft.K[1] for r in soft.records]
    assert np.abs(bent).max() > 0.06
    assert found(soft) == ()


def with_K(campaign: Campaign, factor: float) -> Campaign:
    return replace(campaign, K=campaign.K * factor)


def zero_off(campaign: Campaign, j: int, by: float) -> Campaign:
    shift = np.where(np.arange(campaign.n) == j, by, 0.0) * campaign.N
    return replace(campaign, records=tuple(replace(r, theta=r.theta + shift) for r in campaign.records))


@pytest.mark.parametrize(
    "factor", [0.7, *(pytest.param(factor, marks=pytest.mark.bench) for factor in (0.5, 1.4, 2.0, np.nan))]
)
def test_sag_by_another_stiffness_is_no_fault(softer: Campaign, factor: float) -> None:
    """Where K is unknown, or off: what goes with the load is the spring's."""
    assert found(with_K(softer, factor)) == ()


def test_sag_of_records_of_one_load_is_no_zero(softer: Campaign) -> None:
    """The motion tells which: K is that of the sag, or another."""
    one = replace(softer, records=softer.records[:1], K=softer.K * [1.0, np.nan])
    assert found(one) == ()
    (zero,) = found(zero_off(one, 1, 0.6))  # 3 N m/rad
    assert (zero.joint, zero.severity) == ("j2", REFUSE)


@pytest.mark.parametrize(
    "factor", [0.7, *(pytest.param(factor, marks=pytest.mark.bench) for factor in (1.0, 1.4, np.nan))]
)
def test_what_does_not_go_with_the_load_is_no_sag(softer: Campaign, factor: float) -> None:
    campaign = with_K(softer, factor)
    (zero,) = found(zero_off(campaign, 1, 0.3))
    assert (zero.name, zero.joint) == ("encoder zero", "j2")
    assert float(zero.line.split("off by ")[1].split()[0]) == pytest.approx(0.3, abs=0.05)
    fallen = replace(campaign.records[1], posture=campaign.records[1].posture + [0.0, 0.3])
    (other,) = found(replace(campaign, records=(campaign.records[0], fallen, *campaign.records[2:])))
    assert (other.name, other.joint, other.record) == ("another posture", "j2", campaign.records[1].id)
    (sign,) = found(with_theta(campaign, 1, -1.0))
    assert (sign.name, sign.joint) == ("wrong sign", "j2")
    (degrees,) = found(with_theta(campaign, 1, 180 / np.pi))
    assert (degrees.name, degrees.joint) == ("degrees for radians", "j2")
    (gear,) = found(replace(campaign, N=campaign.N * [1.0, 0.5]))
    assert (gear.name, gear.joint) == ("wrong gear ratio", "j2")


@pytest.mark.parametrize("K", [0.1, 0.3, 3.0, 10.0])
def test_a_stiffness_that_no_datasheet_is_off_by_is_no_sag(softer: Campaign, K: float) -> None:
    assert [fault.joint for fault in found(replace(softer, K=softer.K * [1.0, K])) if fault.severity == REFUSE]


def test_faults_of_a_soft_joint_keep_their_names(soft: Campaign) -> None:
    (sign,) = found(with_theta(soft, 1, -1.0))
    assert (sign.name, sign.joint, sign.severity) == ("wrong sign", "j2", REFUSE)
    (degrees,) = found(with_theta(soft, 1, 180 / np.pi))
    assert (degrees.name, degrees.joint) == ("degrees for radians", "j2")


def test_a_wrong_unit_of_torque_makes_nothing_worse_at_rest(soft: Campaign) -> None:
    """In mN m it is 70 rad by which the spring would give."""
    bent = [soft.N * [0.0, r.tau[:, 1].mean() * soft.N[1] / soft.K[1]] for r in soft.records]
    records = [replace(r, tau=r.tau * [1.0, 1e3], theta=r.theta - x) for r, x in zip(soft.records, bent, strict=True)]
    (unit,) = found(replace(soft, records=tuple(records)))
    assert (unit.name, unit.joint) == ("wrong unit", "j2") and "mN m" in unit.line


def test_a_joint_that_slides_is_off_by_metres() -> None:
    """Joint 3 of SCARA slides, by a motor that turns; its neighbours turn."""
    urdf = (Path(__file__).parents[3] / "robots/scara4/scara4.urdf").read_text()
    names, rng = ("joint1", "joint2", "joint3", "joint4"), np.random.default_rng(0)
    model, unknown = model_of_urdf(urdf, names), np.full(4, np.nan)
    postures = [np.array([0.1, 0.4 * k, -0.02 * k, 0.3]) for k in range(3)]

    def lines(j: int, *off: float, N: float = 600.0) -> list[str]:
        gears = np.where(np.arange(4) == j, N, 80.0)
        records = tuple(
            Record(f"{k:04d}", names[j], q, 2.0, np.arange(1, 50), 500, 2, 1.0, tau := rng.standard_normal((1000, 4)),
                   gears * (q + away * (np.arange(4) == j)) + 1e-3 * tau)
            for k, (q, away) in enumerate(zip(postures, off, strict=True))
        )  # fmt: skip
        c = Campaign(urdf, names, 1000.0, "zoh", gears, unknown, unknown, np.zeros(3), "", records)
        return [fault.line for fault in at_rest(c, [observe(c, model, record) for record in records], j)]

    for j, unit in ((1, "rad"), (2, "m")):
        (zero,) = lines(j, 0.08, 0.08, 0.08)
        assert f"off by 0.08 {unit} (joint side) in all records: subtract 48 rad from theta" in zero
        (one,) = lines(j, 0.0, 0.07, 0.0)
        assert f"rests +0.07 {unit} from its declared posture" in one
        (wild,) = lines(j, 0.07, -0.3, 0.4)
        assert f"lie up to 0.4 {unit} from the declared postures" in wild
    (direct,) = lines(2, 0.08, 0.08, 0.08, N=-1.0)
    assert re.search(r"off by 0.0\d* m \(joint side\) in all records: subtract -0.0\d* m from theta", direct)


def test_a_gear_that_reverses_is_told_of_a_joint_that_rested_at_zero(soft: Campaign) -> None:
    (fault,) = found(replace(soft, N=soft.N * [-1.0, 1.0]))
    assert (fault.name, fault.joint, fault.severity) == ("doubtful gear ratio", "j1", FLAG)
    assert "declare N = 100" in fault.line


def declared(campaign: Campaign, K: float, J_m: float, mass: float) -> Campaign:
    """The campaign as one would have it whose datasheets and CAD are off by these factors."""
    urdf = re.sub(r'(mass value|i[xyz][xyz])="([^"]+)"', lambda m: f'{m[1]}="{mass * float(m[2])}"', campaign.urdf)
    return replace(campaign, K=K * campaign.K, J_m=J_m * campaign.J_m, urdf=urdf)


@pytest.fixture(scope="module")
def light(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Of an arm whose motors are light beside their links, the first one at rest at 0 always."""
    folder: Path = tmp_path_factory.mktemp("light")
    robot = two_joints(folder, EXPERIMENT, *[{"J_m_kgm2": 2e-6, "K_Nm_per_rad": 150.0}] * 2)
    chain = model_of_urdf((folder / "r.urdf").read_text(), ("j1", "j2")).chain
    return simulate(chain, robot, [("j1", np.zeros(2)), ("j2", np.zeros(2))], lock="rigid", seed=0, workers=1)


def test_a_sign_is_told_where_no_spring_turns_it(light: Campaign, tmp_path: Path) -> None:
    """A rotor of a fortieth of its link moves with its torque over most of the band, between anti-resonance and resonance: what looks like a
    sign is none. One of a half moves against it at most lines, whatever its spring."""
    robot = two_joints(tmp_path, EXPERIMENT, *[{"J_m_kgm2": 1e-7, "K_Nm_per_rad": 150.0}] * 2)
    chain = model_of_urdf((tmp_path / "r.urdf").read_text(), ("j1", "j2")).chain
    turned = simulate(chain, robot, [("j2", np.zeros(2))], lock="rigid", seed=0, workers=1)
    assert "wrong sign" in [fault.name for fault in found(with_K(turned, 1e3))]  # as a rigid spring would have it
    assert found(with_K(turned, np.nan)) == ()
    (sign,) = found(with_theta(with_K(light, np.nan), 1, -1.0))
    assert (sign.name, sign.joint, sign.severity) == ("wrong sign", "j2", REFUSE)


OFF = [(0.7, 1.3, 1.3), (1.3, 0.7, 0.7), (0.6, 1.4, 1.4), (1.4, 0.6, 0.6)]


@pytest.mark.parametrize("off", OFF)
def test_drives_and_links_that_are_off_are_no_gear_ratio(light: Campaign, off: tuple[float, float, float]) -> None:
    assert found(declared(light, *off)) == ()


@pytest.mark.parametrize("factor", [0.5, 2.0, 10.0, 100.0])
def test_a_gear_ratio_of_a_joint_at_zero_is_told_by_its_motion(light: Campaign, factor: float) -> None:
    (gear,) = found(replace(light, N=light.N * [factor, 1.0]))
    assert (gear.name, gear.joint, gear.severity) == ("wrong gear ratio", "j1", REFUSE)
    assert float(gear.line.split("about ")[1].split()[0]) == pytest.approx(100, rel=0.3)


def test_a_gear_ratio_is_told_where_drives_and_links_are_off(light: Campaign) -> None:
    (gear,) = found(replace(declared(light, 0.8, 1.2, 1.2), N=light.N * [0.3, 1.0]))
    assert (gear.name, gear.joint, gear.severity) == ("wrong gear ratio", "j1", REFUSE)
