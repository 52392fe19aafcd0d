"""One K and one J_m a joint: what sharing gains, what it must refuse, and whether its covariance is its own scatter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.joint.drive import share
from ident.joint.fit import PARAMETERS, TwoMass

TRUE = {"J_m": 4e-5, "K": 5500.0, "D": 1e-5, "D_spring": 1.0, "K_g": 0.0}
J_L = (0.7, 0.3, 0.0152)


def covariance_of(J_l: float) -> np.ndarray:
    """(K, J_m, J_l) as one response tells them: a common scale of 0.01 %, K and J_l together worse the lighter J_l is.

    f_AR tells their ratio well whatever J_l; only the split of the frequencies tells them apart from N^2 J_m.
    """
    relative = 1e-8 * np.ones((3, 3)) + np.diag([1e-9, 1e-9, 1e-9])
    relative[np.ix_([0, 2], [0, 2])] += (1e-4 * 0.4 / J_l) ** 2
    return relative


def reading(J_l: float, noise: np.ndarray, *, K: float = TRUE["K"]) -> TwoMass:
    """A fit of a record at load inertia J_l whose errors are drawn with `noise` [3]."""
    use = [PARAMETERS.index(name) for name in ("K", "J_m", "J_l")]
    true = np.array([{**TRUE, "K": K, "J_l": J_l}[name] for name in PARAMETERS])
    covariance = np.diag((1e-4 * np.maximum(np.abs(true), 1.0)) ** 2)
    covariance[np.ix_(use, use)] = covariance_of(J_l) * np.outer(true[use], true[use])
    true[use] *= 1 + np.linalg.cholesky(covariance_of(J_l)) @ noise
    return TwoMass(
        "0001", "joint1", *true, covariance, chi2_per_dof=1.0, dof=500, chi2_limit=1.2, explained=True,
        f_AR=10.0, f_R=12.0, inertia_ratio=1.0, band_ratio=0.1, status=(),
    )  # fmt: skip


def draws(count: int) -> np.ndarray:
    return np.random.default_rng(4).standard_normal((count, len(J_L), 3))


def test_scatter_is_the_stated_covariance_and_smaller_than_alone() -> None:
    found = [share("joint1", [reading(J, noise) for J, noise in zip(J_L, draw, strict=True)]) for draw in draws(400)]
    relative = np.array([drive.J_l for drive in found]) / J_L - 1
    stated = found[0].covariance / np.outer(J_L, J_L)
    sigma = np.sqrt(np.diag(stated))
    assert np.abs(relative.mean(axis=0)).max() < 4 * sigma.max() / np.sqrt(400)
    whitened = np.linalg.solve(np.linalg.cholesky(stated), relative.T)
    # 400 draws: the variance of each whitened component is 1 with standard deviation sqrt(2 / 400) = 0.07
    assert np.abs(np.cov(whitened) - np.eye(3)).max() < 4 * 0.07
    alone = np.sqrt(covariance_of(J_L[2])[2, 2])
    assert sigma[2] < 0.3 * alone, "K known from the heavy postures must tell the light one"
    assert all(drive.agrees for drive in found[:20])
    # the mean of 400 chi^2 of 4 degrees of freedom scatters by sqrt(8 / 400) = 0.14
    assert {drive.dof for drive in found} == {4}
    assert np.mean([drive.chi2 for drive in found]) == pytest.approx(4.0, abs=4 * 0.14)


def test_one_record_stays_as_it_is() -> None:
    fit = reading(J_L[0], draws(1)[0, 0])
    drive = share("joint1", [fit])
    assert drive.agrees and drive.dof == 0
    assert drive.J_l[0] == pytest.approx(fit.J_l, rel=1e-9)
    assert drive.K.value == pytest.approx(fit.K, rel=1e-9)
    assert drive.covariance[0, 0] == pytest.approx(fit.covariance[2, 2], rel=1e-6)


def test_a_stiffness_that_changes_between_postures_is_not_shared() -> None:
    """Table II: K falls from 5500 to 4000 N m/rad from one posture of joint 1 to the next."""
    noise = draws(1)[0]
    fits = [reading(J, n, K=K) for J, n, K in zip(J_L, noise, (5500.0, 4000.0, 4000.0), strict=True)]
    drive = share("joint1", fits)
    assert not drive.agrees
    np.testing.assert_array_equal(drive.J_l, [fit.J_l for fit in fits])
    spread = np.sqrt(
        np.average((np.array([fit.K for fit in fits]) - drive.K.value) ** 2, weights=[fit.std[1] ** -2 for fit in fits])
    )
    assert drive.K.spread == pytest.approx(float(spread), rel=1e-9)
    assert 600 < spread < 800


def test_a_fit_that_does_not_explain_its_record_counts_less() -> None:
    good, bad = (reading(J, n) for J, n in zip(J_L[:2], draws(1)[0][:2], strict=True))
    bad = replace(bad, explained=False, chi2_per_dof=1e4)
    drive = share("joint1", [good, bad])
    assert np.sqrt(drive.covariance[1, 1]) > 10 * bad.std[2]
    assert drive.K.value == pytest.approx(good.K, rel=1e-5)
    assert drive.D_spring.value == pytest.approx(good.D_spring, rel=1e-5)
