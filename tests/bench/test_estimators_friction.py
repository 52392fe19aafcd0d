"""The paper's claim (Fig. 2, 3): friction spoils identification in the time domain and not by frequency responses.

Stribeck friction and cogging on every joint of ypp3, undeclared. Beside the estimators: the classical way, a rich periodic
trajectory of the same simulated robot, rigid inverse dynamics, linear least squares.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from study import case, error, markdown, planned, publish

from ident.effects.base import Effect
from ident.effects.friction import MotorStribeck
from ident.effects.motor import TorqueRipple
from ident.identification.identify import METHODS, identify
from ident.simulator.injection import inject
from ident.simulator.machine import Machine, steps_for
from symgen.kinematics import gravity_rows
from symgen.robot import load_robot

ROBOT = Path(__file__).parents[2] / "robots" / "ypp3"
#: Shares of a record's rms torque: Stribeck level and its peak at rest, cogging.
LEVEL, PEAK, COGGING, ORDER = 0.02, 0.02, 0.01, 6
#: The trajectory: harmonics of BASE [Hz], SECONDS long, this far [rad] about a bent elbow; motors under PD of this bandwidth [Hz].
BASE, SECONDS, REACH, HOLD = 0.1, 10.0, 0.6, 8.0
CUT = 5.0  # Hz: above, rates of the encoder are left out


def effects_of(sizes: np.ndarray) -> list[Effect]:
    return [
        effect
        for j, rms in enumerate(sizes)
        for effect in (
            MotorStribeck.of(j, {"level": LEVEL * rms, "peak": PEAK * rms, "speed": 0.3}),
            TorqueRipple.of(j, {"amplitude": COGGING * rms, "order": ORDER, "phase": 0.4 * j}),
        )
    ]


def trajectory(n: int, rng: np.random.Generator, Ts: float) -> np.ndarray:
    """Angles [T, n]: five harmonics a joint, each with a random phase."""
    t = np.arange(round(2 * SECONDS / Ts)) * Ts
    centre = np.resize([0.0, 0.8, -1.2], n)
    shape = sum(np.sin(2 * np.pi * BASE * k * t[:, None] + rng.uniform(0, 2 * np.pi, n)) for k in range(1, 6))
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.minimum(t / 1.0, 1.0))
    return centre + REACH / 3 * shape * ramp[:, None]


def followed(studied, effects: list[Effect]) -> tuple[np.ndarray, np.ndarray]:
    """Motor angles [S, n] and torques [S, n] of the second round on the trajectory."""
    robot, n = studied.robot, studied.model.chain.n
    Ts, rng = 1 / robot.experiment.fs, np.random.default_rng(3)
    want = trajectory(n, rng, Ts)
    arm = inject(studied.truth, studied.drives, robot.gravity, want[0], effects, record=0, free=None, integrator="RK4")
    steps = steps_for(arm, Ts, robot.experiment.band[1])
    arm.plant.model.opt.timestep = Ts / steps
    machine = Machine(arm, Ts, steps)
    N = np.array([drive.N for drive in studied.drives])
    resolution = np.array([2 * np.pi / drive.encoder_counts for drive in studied.drives])
    J = N * 0 + [drive.J_m for drive in studied.drives] + np.diag(studied.model.J_cad(want[0])) / N**2
    kp, kd = J * (2 * np.pi * HOLD) ** 2, 2 * J * 2 * np.pi * HOLD
    offset = arm.plant.rest - N * want[0]
    theta, tau, before = [], [], arm.plant.rest
    for q, rate in zip(want, np.gradient(want, Ts, axis=0), strict=True):
        read = resolution * np.round(N * np.array(machine.angles()) / resolution)
        u = arm.plant.preload + kp * (N * q + offset - read) + kd * (N * rate - (read - before) / Ts)
        machine.advance(u.tolist(), (0.005 * 0.1 * rng.standard_normal(n)).tolist())
        theta.append(read)
        tau.append(u)
        before = read
    half = len(theta) // 2
    return np.array(theta)[half:], np.array(tau)[half:]


def classical(studied, theta: np.ndarray, tau: np.ndarray, friction: bool) -> np.ndarray:
    """alpha by least squares on tau N = d/dt(J q') - d(q' J q' / 2)/dq + gravity + N^2 J_m q'' (+ Coulomb and viscous).

    The motors' inertias are given their true values.
    """
    model, n = studied.model, studied.model.chain.n
    c = studied.campaign
    w = 2 * np.pi * np.fft.rfftfreq(len(theta), 1 / c.fs)
    low = w < 2 * np.pi * CUT

    def filtered(signal: np.ndarray, order: int = 0) -> np.ndarray:
        return np.fft.irfft(np.fft.rfft(signal, axis=0) * (low * (1j * w) ** order)[:, None], len(signal), axis=0)

    every = slice(0, None, 20)
    q, v, a = (filtered(theta / c.N, order)[every] for order in range(3))
    rows, h = model.J_rows(q), 1e-5
    slopes = np.stack(
        [(model.J_rows(q + h * e) - model.J_rows(q - h * e)) / (2 * h) for e in np.eye(n)], axis=1
    )  # t, k, i, j, D
    Y = np.einsum("tijd,tj->tid", rows, a) + np.einsum("tkijd,tk,tj->tid", slopes, v, v)
    Y -= 0.5 * np.einsum("tijkd,tj,tk->tid", slopes, v, v)
    G = gravity_rows(model.chain, q, np.asarray(c.gravity)).reshape(len(q) * n, -1)
    G = G * model.factoring.free
    U, singular, _ = np.linalg.svd(G, full_matrices=False)
    eye = np.eye(n)
    columns = [Y.reshape(len(q) * n, -1), U[:, singular > 1e-9 * singular[0]]]
    if friction:
        columns += [(shape[:, :, None] * eye).reshape(len(q) * n, n) for shape in (v, np.sign(v))]
    J_m = np.array([drive.J_m for drive in studied.drives])  # a gift: rigid dynamics can not tell them from the links
    y = (filtered(tau)[every] * c.N - a * c.N**2 * J_m).ravel()
    A = np.concatenate(columns, axis=1)
    size = np.linalg.norm(A, axis=0)
    size[size == 0] = 1.0
    return (np.linalg.lstsq(A / size, y, rcond=1e-10)[0] / size)[: len(model.names)]


@pytest.mark.bench
def test_friction_and_cogging_nobody_declared() -> None:
    robot = load_robot(ROBOT)
    quick = replace(robot, experiment=replace(robot.experiment, f0=0.5, periods=3))
    cells = planned(robot)
    clean = case(quick, cells, seed=21, believe=True)
    sizes = np.array(
        [max(r.rms for r in clean.campaign.records if r.excited == name) for name in clean.campaign.joints]
    )
    effects = effects_of(sizes)
    studied = case(quick, cells, seed=21, believe=True, effects=effects)
    table: dict[str, list[str]] = {}
    worst = {}
    for kind, one, present in (("clean", clean, []), ("with", studied, effects)):
        for method in METHODS:
            found = identify(one.campaign, method=method, believe_zeros=True)
            off = error(found.model, one.truth, found.alpha_all)
            worst[method, kind] = float(off.max())
            explained = "" if method == "three-point" else f", chi2/dof {found.chi2_per_dof:.3g}"
            table.setdefault(method, []).append(f"{100 * off.max():.3g} %{explained}")
        theta, tau = followed(one, present)
        for friction in (False, True):
            name = "time domain, rigid" + (", Coulomb and viscous declared" if friction else "")
            off = error(one.model, one.truth, classical(one, theta, tau, friction))
            worst[name, kind] = float(off.max())
            table.setdefault(name, []).append(f"{100 * off.max():.3g} %")
    publish(
        "Friction: Stribeck and cogging on every joint of ypp3, undeclared",
        f"Stribeck {100 * LEVEL:g} % + {100 * PEAK:g} % of the excitation's rms torque, cogging {100 * COGGING:g} %. J(q), worst entry. The time domain is told the true J_m.\n\n"
        + markdown(["estimator", "without", "with"], [[name, *cells] for name, cells in table.items()]),
    )
    assert worst["coupled", "with"] < min(
        worst[name, "with"] for name, kind in worst if name.startswith("time") and kind == "with"
    )
