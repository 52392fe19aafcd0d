"""Slips of a log are refused in one line that names joint, signal and remedy; sound logs, whatever they are off by, are not; what no arm has is no result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from logged import FS, GRAVITY, Moved, friction, log

from ident.cli import main
from ident.errors import IdentError
from ident.logs import diagnose
from ident.logs.diagnose import diagnose_log
from ident.logs.faults import refuse_signals, refuse_slips
from ident.logs.moves import bands, moves
from ident.logs.plausible_arm import seen
from ident.logs.report import sentence, text
from ident.logs.robot import write_robot
from ident.logs.signals import frozen, held, leap, lost_rows
from ident.logs.verdict import result_document, verdict_document
from ident.machines.stand_in import Body, stand_in
from ident.records.log import Log, Trajectory
from ident.records.store import read_log, write_log
from symgen.plan import model_of_urdf

Change = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
SECOND, THIRD = np.eye(3)[1:]


def changed(own: Log, change: Change) -> Log:
    return replace(
        own, trajectories=tuple(Trajectory(run.id, *change(run.q.copy(), run.tau.copy())) for run in own.trajectories)
    )


def refuse(own: Log) -> None:
    refuse_signals(own)
    refuse_slips(own, model_of_urdf(own.urdf, own.joints), moves(own))


bench = pytest.mark.bench
QUICK = ("degrees", "rate")

SLIPS: dict[str, tuple[str, Callable[[Log], Log]]] = {
    "sign": ("joint2: the torque has the wrong sign: negate", lambda own: changed(own, lambda q, tau: (q, tau * (1 - 2 * SECOND)))),
    "all signs": ("all joints: the torque has the wrong sign", lambda own: changed(own, lambda q, tau: (q, -tau))),
    "degrees": ("joint3: the angle is in degrees: divide", lambda own: changed(own, lambda q, tau: (q * (1 + 56.29578 * THIRD), tau))),
    "unit": ("all joints: the torque is in mN m", lambda own: changed(own, lambda q, tau: (q, 1000 * tau))),
    "side": ("all joints: the torque is the one behind the gear", lambda own: changed(own, lambda q, tau: (q, own.N * tau))),
    "columns": ("joint2 and joint3: each one's torques are the other's", lambda own: changed(own, lambda q, tau: (q, tau[:, [0, 2, 1]]))),
    "gear": ("N is declared the wrong way round.* declare N = 50", lambda own: replace(
        changed(own, lambda q, tau: (q * own.N**2, tau / own.N**2)), N=1 / own.N)),
    "rate": ("fits a sampling rate of (49|50).* Hz, declared is 250", lambda own: replace(own, fs=FS / 2)),
}  # fmt: skip


@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name in QUICK else bench) for name in SLIPS])
def test_a_slip_is_refused_with_its_joint_and_its_remedy(name: str) -> None:
    says, slip = SLIPS[name]
    with pytest.raises(IdentError, match=says) as error:
        refuse(slip(log(friction, runs=1)))
    assert "\n" not in str(error.value)


def test_a_diagnosis_refuses_before_it_searches(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_log(SLIPS["sign"][1](log(runs=1)), tmp_path / "log.h5")
    assert main(["diagnose", str(tmp_path / "log.h5"), "-o", str(tmp_path / "out")]) == 2
    error = capfd.readouterr().err
    assert "joint2: the torque has the wrong sign" in error and not (tmp_path / "out").exists()


@pytest.mark.parametrize("robot", ["ypp3_general", pytest.param("arm6", marks=bench)])
def test_a_sound_log_is_not_refused_whatever_it_is_off_by(robot: str) -> None:
    """Links by 30 %, a joint whose friction is half its torque, angles by 0.1 rad, delays of 10 ms, noise of 5 %, a payload of 30 % of the torques."""

    def acts(m: Moved) -> np.ndarray:
        return 0.5 * m.typical[4] * np.tanh(m.v / 5e-4) + 0.01 * np.gradient(m.tau) * FS + 0.3 * m.load

    own = log(acts, robot=robot, runs=1, off=0.3, noise=0.05, seed=5)
    refuse(changed(own, lambda q, tau: (q + 0.1 / abs(own.N) * 50.0, tau)))


@bench
def test_torques_in_amperes_have_no_wrong_unit(tmp_path: Path) -> None:
    own = changed(log(friction, runs=1), lambda q, tau: (q, tau * [1000.0, 0.05, 3.0]))
    own = replace(own, currents=own.joints)
    refuse(own)
    write_log(own, tmp_path / "log.h5")
    assert read_log(tmp_path / "log.h5").currents == own.joints


def test_signals_that_leap_freeze_or_lose_rows_are_told() -> None:
    t = np.arange(4000) / 400.0
    q = np.sin(1.3 * t) + 0.3 * np.sin(4.1 * t)
    for coarse in (q, np.round(q / 2e-3) * 2e-3):
        assert leap(coarse) is None and frozen(coarse, 400.0) is None and held(coarse) == 1
        assert lost_rows(coarse[:, None]).size == 0
    assert leap(np.mod(q, 0.7)) and held(np.repeat(q[::8], 8)) == 8
    stuck = q.copy()
    stuck[2000:2600] = stuck[2000]
    first, last = frozen(stuck, 400.0) or (0, 0)
    assert abs(first - 2000) <= 1 and abs(last - 2599) <= 1
    resting = np.concatenate([q[:900], np.full(900, q[900]), q[900:]])
    assert frozen(resting + 0.0, 400.0) is not None  # from full speed at once
    lost = np.delete(np.stack([q, np.cos(2.0 * t)], axis=1), [800, 1500, 2501, 3300], axis=0)
    assert np.array_equal(lost_rows(lost), [800, 1499, 2499, 3297])


def test_a_torque_that_is_cut_off_is_refused() -> None:
    own = log(runs=1)
    top = np.quantile(own.trajectories[0].tau[:, 1], 0.35)
    with pytest.raises(IdentError, match="joint2: its torque is cut off"):
        refuse(changed(own, lambda q, tau: (q, np.clip(tau, [-1e9, -1e9, -1e9], [1e9, top, 1e9]))))


def test_a_torque_that_is_cut_off_at_both_ends_is_marked_at_both() -> None:
    own = log(runs=1)
    low, high = np.quantile(own.trajectories[0].tau[:, 1], [0.2, 0.7])
    for ends in ((low, high), (low, 1e9), (-1e9, high)):
        cut = changed(own, lambda q, tau, ends=ends: (q, np.where(np.arange(3) == 1, np.clip(tau, *ends), tau)))
        marked = seen(cut, model_of_urdf(own.urdf, own.joints), moves(cut)).cut
        share = [0.2 if ends[0] == low else 0.0, 0.3 if ends[1] == high else 0.0]
        assert marked[:, 1].mean() == pytest.approx(sum(share), abs=0.05) and not marked[:, [0, 2]].any()


def test_the_steps_of_a_coarse_encoder_are_no_motion() -> None:
    own = log(runs=1)
    coarse = changed(own, lambda q, tau: (np.round(q / 1.5e-3) * 1.5e-3, tau))
    assert bands(coarse).motion < 1.3 * bands(own).motion


def slide(seconds: float = 12.0, fs: float = 100.0) -> Log:
    """A slide that moves against its torque."""
    t = np.arange(int(seconds * fs)) / fs
    w = 2 * np.pi * np.array([0.2, 0.5, 0.9])
    rng = np.random.default_rng(0)
    runs = []
    for k in range(3):
        phase = rng.uniform(0, 6, 3)
        q, v, a = (
            0.03 * (f(w * t[:, None] + phase) * w**p).sum(axis=1) for f, p in ((np.sin, 0), (np.cos, 1), (np.sin, 2))
        )
        tau = 95.0 * a - 20.0 * np.tanh(v / 1e-3) + rng.normal(size=len(t))  # a is minus the acceleration
        runs.append(Trajectory(f"{k + 1:04d}", q[:, None], tau[:, None]))
    text = stand_in([Body("slide", True, 80.0)])
    return Log(text, ("slide",), fs, np.ones(1), np.full(1, np.nan), 0 * GRAVITY, "a slide", tuple(runs))


def test_what_no_arm_has_is_no_result_and_is_marked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(IdentError, match="slide: the torque has the wrong sign"):
        refuse(slide())
    monkeypatch.setattr(diagnose, "refuse_slips", lambda *_: None)
    d = diagnose_log(slide())
    v, r = verdict_document(d, [Path(__file__)]), result_document(d, {})
    assert v["status"] == "unexplained" and v["inertia"]["alpha_after"]["alpha_11"]["value"] < -50
    assert "is no arm" in sentence(v) and "J_11 of slide would be -9" in sentence(v) and "impossible:" in text(v)
    held_by_files = d.links.alpha
    assert held_by_files > 0 and np.array_equal(v["inertia"]["alpha_in_files"], held_by_files)
    assert np.array_equal(r["alpha"]["in_files"], held_by_files) and not r["physically_consistent"]["ok"]
    assert r["physically_consistent"]["distance"] > 10 and not r["explained"]
    assert any("hold the nearest that some have" in note for note in v["notes"])
    assert not any("that have their J(q)" in note for note in v["notes"])
    assert write_robot(d, tmp_path)
    from ident.logs.report import html

    page = html(d, v)
    assert "Impossible: these are constants of no arm" in page and "in the files" in page
