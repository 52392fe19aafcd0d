"""A campaign becomes J(q): frequency responses, one fit a record, one drive a joint, one alpha for the arm.

Reads nothing but the campaign. What was simulated and what was measured look the same here.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ident.campaign import Array, Campaign, Record
from ident.drive import SharedDrive, share
from ident.errors import IdentError
from ident.fit import ThreePoint, TwoMass, three_point, two_mass
from ident.frf import Frf, estimate
from ident.physical import Consistency, consistency
from ident.solve import Alpha, inertia_std, solve
from symgen.plan import Model, model_of_urdf

METHODS = ("two-mass", "three-point")

#: Postures never measured, at which J(q) is compared with CAD.
UNSEEN_POSTURES = 1000


@dataclass(frozen=True)
class Measurement:
    """One record and what was read from it: `J` [kg m2] with `std` is the J_ii(q) that goes into alpha; `J_cad` declared."""

    record: Record
    index: int
    frf: Frf
    three_point: ThreePoint
    two_mass: TwoMass
    J: float
    std: float
    J_cad: float


@dataclass(frozen=True)
class Identification:
    """The identified arm. `alpha` covers the constants J_ii shows; `alpha_all` [D] adds CAD's for those only off-diagonals show.

    `chi2_per_dof` over all records' fits; `explained` when every record is explained and all J_ii agree with one alpha.
    `notes` are one-line findings for a person; `seconds` where the time went.
    """

    campaign: Campaign
    model: Model
    method: str
    measurements: tuple[Measurement, ...]
    drives: tuple[SharedDrive, ...]
    alpha: Alpha
    alpha_all: Array
    consistency: Consistency
    chi2_per_dof: float
    explained: bool
    notes: tuple[str, ...]
    seconds: dict[str, float]

    def J(self, q: Array) -> Array:
        """The identified inertia matrix [.., n, n, kg m2] at postures q [.., n, rad]."""
        return self.model.J(q, self.alpha_all)

    def J_std(self, q: Array) -> Array:
        """Its standard deviation [.., n, n]; infinite where an entry needs a constant that was not measured."""
        rows, d = self.model.J_rows(q), self.model.d
        std = inertia_std(rows[..., :d], self.alpha.covariance, self.alpha.unseen)
        blind = np.abs(rows[..., d:]).max(axis=-1, initial=0.0) > 1e-9 * np.abs(rows).max(axis=-1, initial=1e-300)
        return np.where(blind, np.inf, std)


def identify(
    campaign: Campaign,
    *,
    method: str = "two-mass",
    believe_zeros: bool | None = None,
    progress: Callable[[str], None] | None = None,
) -> Identification:
    """Returns everything the campaign tells about the arm; sections II-A and III-C of the paper, put right.

    `method` "two-mass" (weighted least squares on all lines) or "three-point" (the paper's reading, to compare);
    `believe_zeros` None believes the URDF's exact zeros only where the records do not determine the arm without.
    Raises IdentError for a campaign without records or an unknown method, SymgenError for a URDF that does not fit.
    """
    if method not in METHODS:
        raise IdentError(f"method {method!r}: expected one of {', '.join(METHODS)}")
    if not campaign.records:
        raise IdentError("the campaign holds no records")
    clock = time.perf_counter
    start = clock()
    model, notes = _model(campaign, believe_zeros)
    seconds = {"model": clock() - start}

    start = clock()
    responses = []
    for record in campaign.records:
        if progress:
            progress(f"record {record.id}: {record.excited}")
        responses.append(estimate(record, campaign))
    seconds["frf"] = clock() - start

    start = clock()
    three = [three_point(frf, campaign.N[frf.index]) for frf in responses]
    two = [two_mass(frf, campaign.N[frf.index], campaign.fs, campaign.hold) for frf in responses]
    drives = _drives(campaign, two)
    seconds["fit"] = clock() - start

    start = clock()
    J, covariance = _inertias(campaign, method, three, two, drives)
    q = np.array([record.posture for record in campaign.records])
    index = np.array([frf.index for frf in responses])
    rows = model.C_rows(q)[np.arange(len(q)), index]
    alpha = solve(rows, J, covariance, index, np.array(model.alpha_joint[: model.d]))
    cad = model.alpha_cad[: model.d]
    # along what the records do not see, CAD: measured combinations hold even where no single constant is determined
    identified = alpha.value + alpha.unseen @ (alpha.unseen.T @ (cad - alpha.value))
    alpha_all = np.concatenate([identified, model.alpha_cad[model.d :]])
    physical = _possible_links(model, alpha)
    seconds["solve"] = clock() - start

    J_cad = model.J_cad(q)[np.arange(len(q)), index, index]
    std = np.sqrt(np.diag(covariance))
    measurements = tuple(
        Measurement(record, frf.index, frf, a, b, float(J[k]), float(std[k]), float(J_cad[k]))
        for k, (record, frf, a, b) in enumerate(zip(campaign.records, responses, three, two, strict=True))
    )
    return Identification(
        campaign=campaign,
        model=model,
        method=method,
        measurements=measurements,
        drives=drives,
        alpha=alpha,
        alpha_all=alpha_all,
        consistency=physical,
        chi2_per_dof=float(sum(fit.chi2_per_dof * fit.dof for fit in two) / sum(fit.dof for fit in two)),
        explained=all(fit.explained for fit in two) and all(drive.agrees for drive in drives) and alpha.agrees,
        notes=(*notes, *_notes(model, responses, two, drives, alpha, physical)),
        seconds=seconds,
    )


def _model(campaign: Campaign, believe_zeros: bool | None) -> tuple[Model, tuple[str, ...]]:
    """The model whose constants the records determine, and a note where that took believing zeros nobody declared."""
    model = model_of_urdf(campaign.urdf, campaign.joints, believe_zeros=bool(believe_zeros))
    if believe_zeros is not None:
        return model, ()
    q = np.array([record.posture for record in campaign.records])
    index = [campaign.joints.index(record.excited) for record in campaign.records]
    cells = np.arange(len(q))
    if np.linalg.matrix_rank(model.C_rows(q)[cells, index]) == model.d:
        return model, ()
    symmetric = model_of_urdf(campaign.urdf, campaign.joints, believe_zeros=True)
    if np.linalg.matrix_rank(symmetric.C_rows(q)[cells, index]) < symmetric.d:
        return model, ()
    believed = len(symmetric.factoring.believed)
    note = (
        f"The records do not determine all {model.d} constants of general links: the {believed} inertial parameters that "
        "are exactly zero in the URDF are believed to be zero."
    )
    return symmetric, (note,)


def _drives(campaign: Campaign, fits: list[TwoMass]) -> tuple[SharedDrive, ...]:
    """One a joint that was excited, base to tip."""
    by_joint = {joint: [fit for fit in fits if fit.joint == joint] for joint in campaign.joints}
    return tuple(share(joint, own) for joint, own in by_joint.items() if own)


def _inertias(
    campaign: Campaign, method: str, three: list[ThreePoint], two: list[TwoMass], drives: tuple[SharedDrive, ...]
) -> tuple[Array, Array]:
    """J_ii of every record [R] with its covariance [R, R], in the records' order."""
    if method == "three-point":
        values = np.array([reading.J_l for reading in three])
        return values, np.diag([_grid_variance(campaign, k, reading) for k, reading in enumerate(three)])
    values, covariance = np.zeros(len(two)), np.zeros((len(two), len(two)))
    for drive in drives:
        own = [k for k, fit in enumerate(two) if fit.joint == drive.joint]
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


def _possible_links(model: Model, alpha: Alpha) -> Consistency:
    """Whether rigid bodies exist with the constants that the records determine; where they determine none, with CAD's."""
    W, free, known = model.factoring.W[: model.d], model.factoring.free, alpha.determined
    if not known.any():
        return consistency(model.alpha_cad[: model.d], None, W, free)
    return consistency(alpha.value[known], alpha.covariance[np.ix_(known, known)], W[known], free)


def _notes(
    model: Model,
    responses: list[Frf],
    fits: list[TwoMass],
    drives: tuple[SharedDrive, ...],
    alpha: Alpha,
    physical: Consistency,
) -> list[str]:
    notes = [line for frf in responses for line in frf.status]
    notes += [line for fit in fits for line in fit.status]
    for drive in drives:
        if not drive.agrees:
            notes.append(
                f"{drive.joint}: its records want different K or J_m (chi2 {drive.chi2:.3g} for {drive.dof} degrees of freedom, "
                f"K scatters by {drive.K.spread:.3g}): a model error; each record keeps its own reading"
            )
    open_names = [name for name, known in zip(model.names, alpha.determined, strict=False) if not known]
    if open_names:
        notes.append(f"Not determined by these records, held at CAD: {', '.join(open_names)}; measure more postures")
    if not alpha.agrees:
        notes.append(
            f"The measured J_ii contradict each other: chi2 {alpha.chi2:.3g} for {alpha.dof} degrees of freedom"
        )
    if not physical.ok:
        notes.append(
            f"No rigid bodies have these constants: the nearest possible ones are {physical.distance:.2g} standard deviations away"
        )
    return notes
