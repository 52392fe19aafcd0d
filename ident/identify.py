"""A campaign becomes J(q): frequency responses, one fit a record, one drive a joint, one alpha for the arm.

Reads nothing but the campaign. What was simulated and what was measured look the same here.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ident.arm_fit import live_joints
from ident.campaign import Array, Campaign, Record
from ident.coupled import DRIVES, CoupledFit, fit_coupled
from ident.drive import SharedDrive, share
from ident.errors import IdentError
from ident.faults import Fault, doubtful_ratio, refuse
from ident.fit import ThreePoint, TwoMass, predict, three_point, two_mass
from ident.frf import Complex, Frf, estimate
from ident.links import nearest_links
from ident.modal import Modal, modal
from ident.physical import Consistency
from ident.solve import Alpha, Combined, inertia_std, solve
from symgen.plan import Model, model_of_urdf

METHODS = ("coupled", "modal", "two-mass", "three-point")
#: Methods that read one anti-resonance and one resonance from a record.
OF_TWO_MASSES = ("two-mass", "three-point")

#: Postures never measured, at which J(q) is compared with CAD.
UNSEEN_POSTURES = 1000

#: Largest angle per torque over the band [rad per N m] that a motor can have: from a bridge's to a watch's.
_RESPONSES = (1e-20, 1e20)

#: A constant with less than this part of it in the unseen directions counts as determined.
_SEEN = 1e-4


@dataclass(frozen=True)
class Measurement:
    """One record and what was read from it: `J` [kg m2] with `std` is the J_ii(q) found at its posture; `J_cad` declared.

    `G_model` [L] is the response theta / tau of the excited joint by the method's model (by two masses for "three-point",
    which has none for all lines); `two_mass` with other methods a quick fit, to compare; `explained` when the misfit `chi2_per_dof` stays below `chi2_limit`. With "coupled" all
    records stand or fall together, and chi2_per_dof is that of the excited joint alone.
    """

    record: Record
    index: int
    method: str
    frf: Frf
    three_point: ThreePoint
    two_mass: TwoMass
    J: float
    std: float
    J_cad: float
    G_model: Complex
    chi2_per_dof: float
    chi2_limit: float
    explained: bool


@dataclass(frozen=True)
class Identification:
    """The identified arm. `alpha` covers the d constants J_ii shows; `alpha_all` [D] all, CAD's where nothing was measured.

    `covariance` [D, D] of alpha_all and `unseen` [D, k], the orthonormal directions that no record saw. `chi2_per_dof` over
    all records' fits; `explained` when every record is explained and all J_ii agree with one alpha. `coupled` is the fit
    behind the method of that name. `faults` of the recording that do not forbid its use; `notes` are one-line findings for a
    person; `seconds` where the time went.
    """

    campaign: Campaign
    model: Model
    method: str
    measurements: tuple[Measurement, ...]
    drives: tuple[SharedDrive, ...]
    alpha: Alpha
    alpha_all: Array
    covariance: Array
    unseen: Array
    coupled: CoupledFit | None
    consistency: Consistency
    chi2_per_dof: float
    explained: bool
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]
    seconds: dict[str, float]

    def J(self, q: Array) -> Array:
        """The identified inertia matrix [.., n, n, kg m2] at postures q [.., n, rad]."""
        return self.model.J(q, self.alpha_all)

    def J_std(self, q: Array) -> Array:
        """Its standard deviation [.., n, n]; infinite where an entry needs a constant that was not measured."""
        return inertia_std(self.model.J_rows(q), self.covariance, self.unseen)

    @property
    def alpha_std(self) -> Array:
        """Standard deviations of alpha_all [D]; infinite where it was not measured."""
        seen = np.linalg.norm(self.unseen, axis=1) < _SEEN
        return np.where(seen, np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), np.inf)


def identify(
    campaign: Campaign,
    *,
    method: str = "coupled",
    believe_zeros: bool | None = None,
    progress: Callable[[str], None] | None = None,
) -> Identification:
    """Returns everything the campaign tells about the arm; sections II-A and III-C of the paper, put right.

    `method` "coupled" (all records and all motors in one fit: right where the locks are not rigid), or to compare, each record
    on its own: "modal" (all mode pairs of the excited motor), "two-mass" (least squares), "three-point" (the paper's reading);
    `believe_zeros` None believes the URDF's exact zeros only where the records do not determine the arm without.
    Raises IdentError for a campaign without records, one with a fault that would end in wrong numbers (`ident.faults`), or an
    unknown method, SymgenError for a URDF that does not fit.
    """
    if method not in METHODS:
        raise IdentError(f"method {method!r}: expected one of {', '.join(METHODS)}")
    if not campaign.records:
        raise IdentError("the campaign holds no records")
    clock = time.perf_counter
    start = clock()
    doubts = refuse(campaign, model_of_urdf(campaign.urdf, campaign.joints))
    seconds = {"faults": clock() - start}

    start = clock()
    responses = []
    for record in campaign.records:
        if progress:
            progress(f"record {record.id}: {record.excited}")
        responses.append(_response(record, campaign))
    seconds["frf"] = clock() - start

    start = clock()
    model, notes = model_of_campaign(campaign, responses, believe_zeros, method)
    seconds["model"] = clock() - start

    start = clock()
    q = np.array([record.posture for record in campaign.records])
    index = np.array([frf.index for frf in responses])
    cells = np.arange(len(q))
    J_declared = model.J_cad(q)
    three = [three_point(frf, campaign.N[frf.index]) for frf in responses]
    two = [
        two_mass(frf, campaign.N[frf.index], campaign.fs, campaign.hold, tries=None if method in OF_TWO_MASSES else 1)
        for frf in responses
    ]
    fits: Sequence[TwoMass | Modal] = two
    if method == "modal":
        fits = [modal(frf, campaign, J) for frf, J in zip(responses, J_declared, strict=True)]
    coupled = fit_coupled(campaign, model, responses) if method == "coupled" else None
    seconds["fit"] = clock() - start

    start = clock()
    if coupled is not None:
        rows = model.J_rows(q)[cells, index, index]
        alpha = _alpha_of(coupled, model.d, len(q))
        alpha_all, covariance, unseen = coupled.alpha, coupled.covariance, coupled.unseen
        drives = _coupled_drives(campaign, coupled)
        J, std = rows @ alpha_all, inertia_std(rows, covariance, unseen)
    else:
        drives = _drives(campaign, fits)
        J, spread = _inertias(campaign, method, three, drives, index)
        alpha = solve(model.C_rows(q)[cells, index], J, spread, index, np.array(model.alpha_joint[: model.d]))
        alpha_all, covariance, unseen = _with_cad(model, alpha)
        std = np.sqrt(np.diag(spread))
    physical = _possible_links(model, alpha_all, covariance, unseen)
    seconds["solve"] = clock() - start

    J_cad = J_declared[cells, index, index]
    measurements = tuple(
        _measurement(campaign, k, method, responses[k], three[k], two[k], coupled or fits[k], (J[k], std[k], J_cad[k]))
        for k in range(len(q))
    )
    for drive in drives:
        i = campaign.joints.index(drive.joint)
        share = np.median((J / J_cad)[index == i]) if np.any(index == i) else np.nan
        doubts += doubtful_ratio(drive.joint, campaign.N[i], drive.K.value / campaign.K[i], float(share))
    fitted = all(drive.agrees for drive in drives) and alpha.agrees
    return Identification(
        campaign=campaign,
        model=model,
        method=method,
        measurements=measurements,
        drives=drives,
        alpha=alpha,
        alpha_all=alpha_all,
        covariance=covariance,
        unseen=unseen,
        coupled=coupled,
        consistency=physical,
        chi2_per_dof=coupled.chi2_per_dof
        if coupled
        else float(sum(fit.chi2_per_dof * fit.dof for fit in fits) / sum(fit.dof for fit in fits)),
        explained=all(measured.explained for measured in measurements) and fitted,
        faults=doubts,
        notes=(
            *notes,
            *(doubt.line for doubt in doubts),
            *_notes(model, responses, fits, drives, alpha, physical, coupled),
        ),
        seconds=seconds,
    )


def _response(record: Record, campaign: Campaign) -> Frf:
    """The frequency response of a record. Raises IdentError where it is beyond what any drive does."""
    frf = estimate(record, campaign)
    size = np.abs(frf.G)
    if not (np.isfinite(size).all() and size.max() > _RESPONSES[0] and size.max() < _RESPONSES[1]):
        raise IdentError(
            f"record {record.id}, {record.excited}: the motor answers with {size.max():.3g} rad per N m; expected "
            f"{_RESPONSES[0]:g} to {_RESPONSES[1]:g}: check the encoder and the units of theta and tau"
        )
    return frf


def _measurement(
    campaign: Campaign,
    k: int,
    method: str,
    frf: Frf,
    three: ThreePoint,
    two: TwoMass,
    fit: CoupledFit | TwoMass | Modal,
    found: tuple[float, float, float],
) -> Measurement:
    """Record k with its model's response and misfit; `found` is J, its standard deviation, and CAD's J."""
    misfit = (fit.chi2_per_dof, fit.chi2_limit, fit.explained)
    if isinstance(fit, TwoMass):
        G = predict(fit.parameters, frf.frequencies, float(campaign.N[frf.index]), campaign.fs, campaign.hold)
    elif isinstance(fit, Modal):
        G = fit.G
    else:
        G = fit.predict(k)[:, frf.index] / frf.tau[:, frf.index]
        off = np.abs(frf.G - G)[frf.usable] ** 2 / frf.variance[frf.usable]
        misfit = (float(off.mean()), fit.chi2_limit, fit.explained)
    J, std, J_cad = map(float, found)
    return Measurement(campaign.records[k], frf.index, method, frf, three, two, J, std, J_cad, G, *misfit)


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
    seen = np.linalg.norm(coupled.unseen[:d], axis=1) < _SEEN
    return Alpha(
        coupled.alpha[:d], coupled.covariance[:d, :d], seen, coupled.unseen[:d], (), none, none, none, none, 0.0, 0, True, ()
    )  # fmt: skip


def _coupled_drives(campaign: Campaign, coupled: CoupledFit) -> tuple[SharedDrive, ...]:
    """One a joint: a coupled fit has one K, J_m and D for all records."""

    def one(name: str, i: int) -> Combined:
        return Combined(
            float(getattr(coupled, name)[i]), float(coupled.drive_std[DRIVES.index(name), i]), 0.0, 0, True, 0.0
        )

    empty = np.zeros(0)
    return tuple(
        SharedDrive(joint, one("K", i), one("J_m", i), one("D", i), empty, np.zeros((0, 0)), 0.0, 0, True)
        for i, joint in enumerate(campaign.joints)
    )


def model_of_campaign(
    campaign: Campaign, responses: Sequence[Frf], believe_zeros: bool | None, method: str
) -> tuple[Model, tuple[str, ...]]:
    """The model whose constants the records determine, and a note where that took believing zeros nobody declared."""
    model = model_of_urdf(campaign.urdf, campaign.joints, believe_zeros=bool(believe_zeros))
    if believe_zeros is not None or _determined(responses, model, method):
        return model, ()
    symmetric = model_of_urdf(campaign.urdf, campaign.joints, believe_zeros=True)
    if not _determined(responses, symmetric, method):
        return model, ()
    believed = len(symmetric.factoring.believed)
    note = (
        f"The records do not determine all constants of general links: the {believed} inertial parameters that are exactly "
        "zero in the URDF are believed to be zero."
    )
    return symmetric, (note,)


def _determined(responses: Sequence[Frf], model: Model, method: str) -> bool:
    """Whether the records show every constant: one J_ii each, or with "coupled" the matrix of the joints that move."""
    q = np.array([frf.posture for frf in responses])
    if method == "coupled":
        blocks = [
            rows[np.ix_(live, live)] for rows, live in zip(model.J_rows(q), map(live_joints, responses), strict=True)
        ]
        rows = np.concatenate([block.reshape(-1, block.shape[-1]) for block in blocks])
        return bool(np.linalg.matrix_rank(rows) == rows.shape[-1])
    index = [frf.index for frf in responses]
    return bool(np.linalg.matrix_rank(model.C_rows(q)[np.arange(len(q)), index]) == model.d)


def _drives(campaign: Campaign, fits: Sequence[TwoMass | Modal]) -> tuple[SharedDrive, ...]:
    """One a joint that was excited, base to tip."""
    by_joint = {joint: [fit for fit in fits if fit.joint == joint] for joint in campaign.joints}
    return tuple(share(joint, own) for joint, own in by_joint.items() if own)


def _inertias(
    campaign: Campaign, method: str, three: list[ThreePoint], drives: tuple[SharedDrive, ...], index: Array
) -> tuple[Array, Array]:
    """J_ii of every record [R] with its covariance [R, R], in the records' order."""
    if method == "three-point":
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


def _possible_links(model: Model, alpha_all: Array, covariance: Array, unseen: Array) -> Consistency:
    """Whether rigid bodies exist with the constants [D] along what the records show, and the nearest that have."""
    found = nearest_links(model, alpha_all, covariance, unseen)
    return Consistency(found.ok, found.distance, found.alpha, found.parameters.ravel(), found.status)


def _notes(
    model: Model,
    responses: list[Frf],
    fits: Sequence[TwoMass | Modal],
    drives: tuple[SharedDrive, ...],
    alpha: Alpha,
    physical: Consistency,
    coupled: CoupledFit | None,
) -> list[str]:
    notes = [line for frf in responses for line in frf.status]
    notes += [line for fit in fits for line in fit.status] if coupled is None else coupled.status
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
