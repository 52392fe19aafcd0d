"""A measured machine: the two-inertia motor bench, fitted on one multisine and scored on another at lines never fitted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motorbench import around_the_modes, imported, needs_records
from study import markdown, publish

from ident.arm.arm_fit import hold, residual
from ident.arm.coupled import declared_start, problem_of
from ident.arm.descent import minimise
from ident.arm.evidence import evidence, gravity_basis
from ident.effects.base import Effect
from ident.effects.friction import LinkViscous
from ident.effects.motor import InputDelay
from ident.effects.spring import SpringHardening
from ident.records.frf import estimate
from symgen.plan import model_of_urdf

FRICTION, DELAY = LinkViscous.of(0, {"damping": 1e-3}), InputDelay.of(0, {"time": 1e-4})
#: In the order in which `ident diagnose` finds them.
TRIED: dict[str, tuple[Effect, ...]] = {
    "two masses, damped": (),
    "+ friction of the load": (FRICTION,),
    "+ delay of the current": (FRICTION, DELAY),
    "+ a spring that softens": (FRICTION, DELAY, SpringHardening.of(0, {"cubic": -100.0})),
}
#: No model tried explains the bench to its noise: lines are weighted by that and an error granted, of this share of each angle
#: in the end.
DOUBTS = (1.0, 0.2, *[0.05] * 10)
SIZES = {"damping": 1e-2, "time": 1e-4, "cubic": 100.0}


@pytest.mark.bench
@needs_records
def test_fitted_on_one_record_scored_on_the_other(tmp_path: Path) -> None:
    campaign = imported(tmp_path).campaign
    model = model_of_urdf(campaign.urdf, campaign.joints)
    basis = gravity_basis(model, campaign.gravity)
    rows, last = [], (np.inf, np.inf, np.inf)
    responses = [estimate(record, campaign) for record in campaign.records]
    first = replace(campaign, records=campaign.records[:1])
    for name, effects in TRIED.items():
        data = tuple(evidence(campaign, model, basis, frf, k, "excited") for k, frf in enumerate(responses))
        start = declared_start(first, model, responses[:1], basis)
        kinds = [p for e in effects for p in e.parameters]
        limits = [(0.0 if p.low >= 0 else -np.inf, np.inf) if p.relative else (p.low, p.high) for p in kinds]
        fit = problem_of(campaign, model, basis, data[:1], start, effects, [SIZES[p.name] for p in kinds], limits)
        begin = np.concatenate([start.vector(), *[e.values for e in effects]])
        found = minimise(fit, begin, DOUBTS, outer=0)
        p, score = fit.parameters(found.vector), []
        for one in data:
            problem = replace(fit, data=(one,))
            off = residual(problem, found.vector, one, hold(problem, found.vector)[0].moved)[0][:, 0]
            theta = one.scene.theta[:, 0]
            relative = np.abs(off / theta)
            G, miss = (one.scene.s * values / one.scene.tau[:, 0] for values in (theta, off))
            whole = np.linalg.norm(miss) / np.linalg.norm(G)
            score.append((np.sqrt(np.mean(relative**2)), np.median(relative), whole))
        J_l, told = float(model.J(np.zeros(1), p.alpha)[0, 0]), load_side(campaign)
        values = ", ".join(f"{value:.3g}" for value in found.vector[fit.base :])
        rows.append(
            [
                name,
                *(f"{100 * value:.2f} %" for value in (*score[0], *score[1])),
                f"{J_l:.5f} ({100 * (J_l / told - 1):+.1f} %)",
                f"{float(p.J_m[0]):.5f}",
                values,
            ]
        )
        last = (*score[1], abs(J_l / told - 1))
    head = [
        "model",
        "A: rms",
        "median line",
        "whole",
        "B: rms",
        "median line",
        "whole",
        "J_l (against the load encoder)",
        "J_m",
        "effects",
    ]
    publish(
        "Measured: motor bench, fitted on A, scored on B",
        f"J_l by the load encoder: {told:.5f} A s2/rad.\n\n" + markdown(head, rows),
    )
    assert last[0] <= 0.065 and last[1] <= 0.03 and last[-1] <= 0.03


def load_side(campaign) -> float:
    """J_l by momentum: J_m s^2 theta + J_l s^2 q + D s q + T s tau = tau at every line around the modes, both encoders.

    Without the friction D of the load and the delay T of the current it comes out 5 % too small, with three times the residual.
    """
    equations, right = [], []
    for record in campaign.records:
        f, tau, theta, q = around_the_modes(record)
        s = 2j * np.pi * f
        columns = np.stack([s**2 * theta, s**2 * q, s * q, s * tau], axis=1) / np.abs(tau)[:, None]
        equations += [columns.real, columns.imag]
        b = tau / np.abs(tau)
        right += [b.real, b.imag]
    return float(np.linalg.lstsq(np.concatenate(equations), np.concatenate(right), rcond=None)[0][1])
