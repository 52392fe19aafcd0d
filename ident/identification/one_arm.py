"""What records say one by one, or all at once, becomes one arm: a drive a joint, one alpha, and J_ii of every record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ident.arm.arm_model import DRIVES
from ident.arm.coupled import CoupledFit
from ident.joint.drive import SharedDrive, share
from ident.joint.fit import JointFit, ThreePoint
from ident.joint.solve import SEEN, Alpha, Combined, inertia_std, solve
from ident.records.campaign import Array, Campaign
from symgen.plan import Model


@dataclass(frozen=True)
class OneArm:
    """The arm of R records: `drives` of the joints, and `alpha`, `alpha_all` [D], `covariance` [D, D] and `unseen` [D, k] as in
    `Identification`; `J` [R, kg m2] with `std` [R] is J_ii of each record's excited joint at its posture."""

    drives: tuple[SharedDrive, ...]
    alpha: Alpha
    alpha_all: Array
    covariance: Array
    unseen: Array
    J: Array
    std: Array


def determined(unseen: Array) -> NDArray[np.bool_]:
    """Returns which constants [D] the directions `unseen` [D, k] leave alone."""
    return np.asarray(np.linalg.norm(unseen, axis=1) < SEEN)


def of_coupled(campaign: Campaign, model: Model, q: Array, index: Array, fit: CoupledFit) -> OneArm:
    """Returns the arm of one fit of all records; these excite joints `index` [R] at `q` [R, n, rad]."""
    rows = model.J_rows(q)[np.arange(len(q)), index, index]
    alpha, std = _alpha_of(fit, model.d, len(q)), inertia_std(rows, fit.covariance, fit.unseen)
    drives = _coupled_drives(campaign, fit)
    return OneArm(drives, alpha, fit.alpha, fit.covariance, fit.unseen, rows @ fit.alpha, std)


def of_records(
    campaign: Campaign,
    model: Model,
    q: Array,
    index: Array,
    fits: Sequence[JointFit],
    three: Sequence[ThreePoint] | None = None,
) -> OneArm:
    """Returns the arm of R fits, one a record; `q` and `index` as in `of_coupled`. J_ii is that of `three`, where given."""
    drives = _drives(campaign, fits)
    J, spread = _inertias(campaign, index, drives, three)
    rows = model.C_rows(q)[np.arange(len(q)), index]
    alpha = solve(rows, J, spread, index, np.array(model.alpha_joint[: model.d]))
    return OneArm(drives, alpha, *_with_cad(model, alpha), J, np.sqrt(np.diag(spread)))


def _with_cad(model: Model, alpha: Alpha) -> tuple[Array, Array, Array]:
    """All constants [D], their covariance and the unseen directions [D, k]: CAD along what the records do not see.

    Measured combinations hold even where no single constant of them is determined.
    """
    d, D = model.d, len(model.alpha_cad)
    cad = model.alpha_cad
    identified = alpha.value + alpha.unseen @ (alpha.unseen.T @ (cad[:d] - alpha.value))
    covariance, unseen = np.zeros((D, D)), np.zeros((D, alpha.unseen.shape[1] + D - d))
    covariance[:d, :d] = alpha.covariance
    unseen[:d, : alpha.unseen.shape[1]] = alpha.unseen
    unseen[d:, alpha.unseen.shape[1] :] = np.eye(D - d)
    return np.concatenate([identified, cad[d:]]), covariance, unseen


def _alpha_of(coupled: CoupledFit, d: int, M: int) -> Alpha:
    """The constants the diagonal shows, as `solve` would return them; a coupled fit leaves no residual of J_ii."""
    none = np.zeros(M)
    return Alpha(
        coupled.alpha[:d], coupled.covariance[:d, :d], determined(coupled.unseen[:d]), coupled.unseen[:d],
        none, none, none, none, 0.0, 0, True, (),
    )  # fmt: skip


def _coupled_drives(campaign: Campaign, coupled: CoupledFit) -> tuple[SharedDrive, ...]:
    """One a joint: a coupled fit has one drive for all records."""

    def one(name: str, i: int) -> Combined:
        return Combined(
            float(getattr(coupled, name)[i]), float(coupled.drive_std[DRIVES.index(name), i]), 0.0, 0, True, 0.0
        )

    empty = np.zeros(0), np.zeros((0, 0))
    return tuple(
        SharedDrive(joint, one("K", i), one("J_m", i), one("D", i), one("D_spring", i), *empty, 0.0, 0, True)
        for i, joint in enumerate(campaign.joints)
    )


def _drives(campaign: Campaign, fits: Sequence[JointFit]) -> tuple[SharedDrive, ...]:
    """One a joint that was excited, base to tip."""
    by_joint = {joint: [fit for fit in fits if fit.joint == joint] for joint in campaign.joints}
    return tuple(share(joint, own) for joint, own in by_joint.items() if own)


def _inertias(
    campaign: Campaign, index: Array, drives: tuple[SharedDrive, ...], three: Sequence[ThreePoint] | None
) -> tuple[Array, Array]:
    """J_ii of every record [R] with its covariance [R, R], in the records' order."""
    if three is not None:
        values = np.array([reading.J_l for reading in three])
        return values, np.diag([_grid_variance(campaign, k, reading) for k, reading in enumerate(three)])
    values, covariance = np.zeros(len(index)), np.zeros((len(index), len(index)))
    for drive in drives:
        own = np.flatnonzero(index == campaign.joints.index(drive.joint))
        values[own] = drive.J_l
        covariance[np.ix_(own, own)] = drive.covariance
    return values, covariance


def _grid_variance(campaign: Campaign, k: int, reading: ThreePoint) -> float:
    """Variance of (5) from reading f_AR and f_R on a grid of excited lines: spacing^2/12 each."""
    record = campaign.records[k]
    spacing = float(np.diff(record.lines).mean()) * record.f0
    N = campaign.N[campaign.joints.index(record.excited)]
    ratio = (reading.f_R / reading.f_AR) ** 2
    relative = spacing**2 / 12 * (1 / reading.f_AR**2 + 1 / reading.f_R**2)
    return float((2 * ratio * N**2 * reading.J_m) ** 2 * relative)
