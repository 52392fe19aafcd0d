"""A campaign becomes J(q): frequency responses, one fit a record, one drive a joint, one alpha for the arm.

Reads nothing but the campaign. What was simulated and what was measured look the same here.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from ident.arm import misfits
from ident.arm.coupled import CoupledFit, fit_coupled
from ident.arm.misfits import Misfit
from ident.errors import IdentError
from ident.identification.campaign_model import model_of_campaign
from ident.identification.links import nearest_links
from ident.identification.modal import Modal, modal
from ident.identification.one_arm import OneArm, determined, of_coupled, of_records
from ident.identification.physical import Consistency
from ident.joint.drive import SharedDrive
from ident.joint.fit import PARAMETERS, ThreePoint, TwoMass, predict, three_point, two_mass, two_mass_frequencies
from ident.joint.solve import Alpha, inertia_std
from ident.records.campaign import Array, Campaign, Record
from ident.records.doubtful import doubts, joint_medians
from ident.records.faults import Fault, refuse
from ident.records.frf import Complex, Frf, estimate
from ident.records.left_out import left_out
from ident.records.resting import elsewhere, statuses
from symgen.plan import Model, model_of_urdf

METHODS = ("coupled", "modal", "two-mass", "three-point")
#: Methods that read one anti-resonance and one resonance from a record.
OF_TWO_MASSES = ("two-mass", "three-point")

#: Postures never measured, at which J(q) is compared with CAD.
UNSEEN_POSTURES = 1000

#: Largest angle per torque over the band [rad per N m] that a motor can have: from a bridge's to a watch's.
_RESPONSES = (1e-20, 1e20)


@dataclass(frozen=True)
class Measurement:
    """One record and what was read from it: `J` [kg m2] with `std` is the J_ii(q) found at its posture; `J_cad` declared.

    `G_model` [L] is the response theta / tau of the excited joint by the method's model (by two masses for
    "three-point", which has none for all lines), `G_declared` [L] that of the declared arm by the model of all motors, None with other
    methods; `two_mass` with other methods a quick fit, to compare, None where the record has too few lines for it. `K` [N m/rad, joint
    side] and `J_m` [kg m2, motor side] are the drive that goes with J. `misfit` line by line; `explained` when `chi2_per_dof` stays below
    `chi2_limit`. With "coupled" misfit and chi2_per_dof are of all motors that move in the record, and all records stand or fall together.
    """

    record: Record
    index: int
    N: float
    method: str
    frf: Frf
    three_point: ThreePoint
    two_mass: TwoMass | None
    J: float
    std: float
    J_cad: float
    K: float
    J_m: float
    G_model: Complex
    G_declared: Complex | None
    misfit: Misfit
    chi2_per_dof: float
    chi2_limit: float
    explained: bool

    @property
    def pair(self) -> tuple[float, float]:
        """(f_AR, f_R) [Hz] by (4) of J and its drive, or as the three points were read; NaN where these are no masses and spring."""
        if self.method == "three-point":
            return self.three_point.f_AR, self.three_point.f_R
        if not (self.J > 0.0 and self.K > 0.0 and self.J_m > 0.0):
            return np.nan, np.nan
        return two_mass_frequencies(self.J_m, self.K, self.J, self.N)

    @property
    def inertia_ratio(self) -> float:
        """J / (N^2 J_m); NaN where that is no mass."""
        return self.J / (self.N**2 * self.J_m) if self.J_m > 0.0 else np.nan


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
        return np.where(determined(self.unseen), np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), np.inf)


def identify(
    campaign: Campaign,
    *,
    method: str = "coupled",
    believe_zeros: bool | None = None,
    workers: int = 1,
    progress: Callable[[str], None] | None = None,
) -> Identification:
    """Returns everything the campaign tells about the arm; sections II-A and III-C of the paper, put right.

    `method` "coupled" (all records and all motors in one fit: right where the locks are not rigid), or to compare, each record
    on its own: "modal" (all mode pairs of the excited motor), "two-mass" (least squares), "three-point" (the paper's reading);
    `believe_zeros` None believes the URDF's exact zeros only where the records do not determine the arm without. `workers`
    processes share the records of the coupled fit; its result does not depend on how many.
    Raises IdentError for a campaign without records, one with a fault that would end in wrong numbers (`ident.records.faults`), or an
    unknown method, SymgenError for a URDF that does not fit.
    """
    if method not in METHODS:
        raise IdentError(f"method {method!r}: expected one of {', '.join(METHODS)}")
    if not campaign.records:
        raise IdentError("the campaign holds no records")
    seconds: dict[str, float] = {}
    with _timed(seconds, "faults"):
        flags = refuse(campaign, model_of_urdf(campaign.urdf, campaign.joints))
    with _timed(seconds, "frf"):
        responses = _responses(campaign, progress)
    with _timed(seconds, "model"):
        model, notes = model_of_campaign(campaign, responses, believe_zeros, method)
        q = np.array([record.posture for record in campaign.records])
        index = np.array([frf.index for frf in responses])
        J_cad = model.J_cad(q)
    with _timed(seconds, "fit"):
        readings = _read(campaign, model, responses, method, J_cad, workers)
    with _timed(seconds, "solve"):
        if readings.coupled is not None:
            responses = list(readings.coupled.responses)  # at the postures where they rest
            q = np.array([frf.posture for frf in responses])
            J_cad = model.J_cad(q)
            arm = of_coupled(campaign, model, q, index, readings.coupled)
        else:
            three = readings.three_point if method == "three-point" else None
            arm = of_records(campaign, model, q, index, readings.fits, three)
        physical = _possible_links(model, arm)
    J_cad = J_cad[np.arange(len(q)), index, index]
    with _timed(seconds, "misfit"):
        measurements = _measurements(campaign, model, method, responses, readings, arm, J_cad)
    flags += _doubts(campaign, arm, arm.J / J_cad, index)
    found = (
        left_out(campaign, responses)
        + elsewhere(campaign, responses)
        + _notes(model, responses, readings, arm, physical)
    )
    agree = all(drive.agrees for drive in arm.drives) and arm.alpha.agrees
    return Identification(
        campaign=campaign,
        model=model,
        method=method,
        measurements=measurements,
        drives=arm.drives,
        alpha=arm.alpha,
        alpha_all=arm.alpha_all,
        covariance=arm.covariance,
        unseen=arm.unseen,
        coupled=readings.coupled,
        consistency=physical,
        chi2_per_dof=readings.chi2_per_dof,
        explained=all(measured.explained for measured in measurements) and agree,
        faults=flags,
        notes=(*notes, *(flag.line for flag in flags), *found),
        seconds=seconds,
    )


@contextmanager
def _timed(seconds: dict[str, float], step: str) -> Iterator[None]:
    """Puts down how long a step takes."""
    start = time.perf_counter()
    yield
    seconds[step] = time.perf_counter() - start


def _responses(campaign: Campaign, progress: Callable[[str], None] | None) -> list[Frf]:
    responses = []
    for record in campaign.records:
        if progress:
            progress(f"record {record.id}: {record.excited}")
        responses.append(_response(record, campaign))
    return responses


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


@dataclass(frozen=True)
class _Readings:
    """What was read from the records: `fits` by the method, record by record, or `coupled`; the others to compare."""

    three_point: list[ThreePoint]
    two_mass: Sequence[TwoMass | None]
    fits: Sequence[TwoMass | Modal]
    coupled: CoupledFit | None

    @property
    def chi2_per_dof(self) -> float:
        if self.coupled is not None:
            return self.coupled.chi2_per_dof
        return float(sum(fit.chi2_per_dof * fit.dof for fit in self.fits) / sum(fit.dof for fit in self.fits))


def _read(campaign: Campaign, model: Model, responses: list[Frf], method: str, J_cad: Array, workers: int) -> _Readings:
    """Fits the responses; `J_cad` [R, n, n, kg m2] is that of the declared arm at their postures."""
    three = [three_point(frf, campaign.N[frf.index]) for frf in responses]

    def two(frf: Frf, tries: int | None = None) -> TwoMass:
        return two_mass(frf, campaign.N[frf.index], campaign.fs, campaign.hold, tries=tries)

    if method in OF_TWO_MASSES:
        fits = [two(frf) for frf in responses]
        return _Readings(three, fits, fits, None)
    compared = [two(frf, 1) if frf.usable.sum() >= len(PARAMETERS) else None for frf in responses]
    if method == "modal":
        modes = [modal(frf, campaign, J) for frf, J in zip(responses, J_cad, strict=True)]
        return _Readings(three, compared, modes, None)
    return _Readings(three, compared, (), fit_coupled(campaign, model, responses, workers=workers))


def _measurements(
    campaign: Campaign, model: Model, method: str, responses: list[Frf], readings: _Readings, arm: OneArm, J_cad: Array
) -> tuple[Measurement, ...]:
    """The records as the method's model has them; `J_cad` [R] that of the declared arm."""
    drives = {drive.joint: drive for drive in arm.drives}
    found = []
    for k, (G, declared, left, judged) in enumerate(_told(campaign, model, responses, readings)):
        frf, record, drive = responses[k], campaign.records[k], drives[campaign.records[k].excited]
        K, J_m = drive.K.value, drive.J_m.value
        if method == "three-point":
            K, J_m = readings.three_point[k].K, readings.three_point[k].J_m
        elif not drive.agrees:  # each record keeps its own reading
            K, J_m = readings.fits[k].K, readings.fits[k].J_m
        three, two, N = readings.three_point[k], readings.two_mass[k], float(campaign.N[frf.index])
        J = float(arm.J[k]), float(arm.std[k]), float(J_cad[k])
        found.append(Measurement(record, frf.index, N, method, frf, three, two, *J, K, J_m, G, declared, left, *judged))
    return tuple(found)


def _told(
    campaign: Campaign, model: Model, responses: list[Frf], readings: _Readings
) -> Iterator[tuple[Complex, Complex | None, Misfit, tuple[float, float, bool]]]:
    """Yields of each record the model's response, the declared arm's, the misfit, and its chi2_per_dof, limit, `explained`."""
    fit = readings.coupled
    if fit is not None:
        for k, whole in enumerate(misfits.of_coupled(campaign, model, fit)):
            i = responses[k].index
            G = fit.predict(k)[:, i] / responses[k].tau[:, i]
            yield G, whole.declared, whole.misfit, (whole.chi2_per_dof, fit.chi2_limit, fit.explained)
        return
    for frf, one in zip(responses, readings.fits, strict=True):
        if isinstance(one, Modal):
            G = one.G
        else:
            G = predict(one.parameters, frf.frequencies, float(campaign.N[frf.index]), campaign.fs, campaign.hold)
        yield G, None, misfits.of_response(frf, G), (one.chi2_per_dof, one.chi2_limit, one.explained)


def _possible_links(model: Model, arm: OneArm) -> Consistency:
    """Whether rigid bodies exist with the constants [D] along what the records show, and the nearest that have."""
    found = nearest_links(model, arm.alpha_all, arm.covariance, arm.unseen)
    return Consistency(found.ok, found.distance, found.alpha, found.parameters.ravel(), found.status)


def _doubts(campaign: Campaign, arm: OneArm, share: Array, index: Array) -> tuple[Fault, ...]:
    """Scales that the drives found and the `share` [R] of CAD's J_ii found, that of joint `index` [R], make doubtful."""
    K, J_m = np.full((2, campaign.n), np.nan)
    for drive in arm.drives:
        i = campaign.joints.index(drive.joint)
        K[i], J_m[i] = drive.K.value / campaign.K[i], drive.J_m.value / campaign.J_m[i]
    own = joint_medians(share, index, campaign.n)
    return doubts(campaign.joints, campaign.fs, campaign.N, K, J_m, own)


def _notes(model: Model, responses: list[Frf], readings: _Readings, arm: OneArm, physical: Consistency) -> list[str]:
    alpha, coupled = arm.alpha, readings.coupled
    notes = statuses(model.chain.names, responses)
    notes += [line for fit in readings.fits for line in fit.status] if coupled is None else coupled.status
    for drive in arm.drives:
        if not drive.agrees:
            notes.append(
                f"{drive.joint}: its records want different K or J_m (chi2 {drive.chi2:.3g} for {drive.dof} degrees of freedom, "
                f"K scatters by {drive.K.spread:.3g}): a model error; each record keeps its own reading"
            )
    open_names = [name for name, known in zip(model.names, alpha.determined, strict=False) if not known]
    if open_names:
        names = ", ".join(open_names)
        notes.append(f"Not determined by these records: {names} (CAD's along what none shows); measure more postures")
    if not alpha.agrees:
        notes.append(
            f"The measured J_ii contradict each other: chi2 {alpha.chi2:.3g} for {alpha.dof} degrees of freedom"
        )
    if not physical.ok:
        notes.append(
            f"No rigid bodies have these constants: the nearest possible ones are {physical.distance:.2g} standard deviations away"
        )
    return notes
