"""All records and all motors in one fit: J(q), drives and gravity stiffness of an arm whose locks are not rigid.

A motor that holds still does not hold its link still: the spring between them gives, and the response of the excited
joint shows the whole arm. So the arm is fitted as a whole (`arm_model`, `arm_fit`), from start values that need nobody.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import null_space

from ident.arm.arm_fit import UNSEEN_INFORMATION, Problem, hold, residual, scale_of, spectrum, whitened
from ident.arm.arm_model import DRIVES, Parameters
from ident.arm.descent import Minimum, minimise
from ident.arm.evidence import Evidence, evidence, gravity_basis, scenes_of
from ident.arm.lone_lines import lone_lines
from ident.arm.parts import degrees, thinned
from ident.arm.sliding import TURNS
from ident.effects.base import Effect
from ident.errors import IdentError
from ident.joint.certainty import certainty, thin
from ident.joint.fit import UNTOLD, chi2_limit, two_mass
from ident.joint.solve import RANK_TOLERANCE
from ident.joint.start import START_DAMPING
from ident.records.campaign import Array, Campaign
from ident.records.frf import Complex, Frf
from ident.records.left_out import without_lines
from ident.records.quantisation import HIDDEN_STEPS
from ident.records.resting import THERE, farthest_apart, rested
from symgen.plan import Model

#: Where a drive is not declared and nothing was fitted: only a start value, for a motor of a few hundred watts.
PLAIN_DRIVE = (5e3, 3e-5)
#: Relative errors the model is granted on the way from its start, so that no few clear lines pull it into a corner.
DOUBTS = (1.0, 0.1)
#: The same for fits that must find their way alone, and chi^2 per degree of freedom under the last of them below which they
#: did: elsewhere it was 5 and more, as resonances stand at other lines.
APPROACH, ARRIVED = (1.0, 0.3, 0.1), 2.0
#: An arm is expected to be off its start by about these steps of its scale: logarithms of K and J_m, of both dampings, alpha and
#: gravity. Together that weighs as much as this share of the data: nothing, but for what they do not see from there.
WIDTHS, SHARE = (1.0, 3.0, 1.0), 3e-3
#: Factors on all K from which a fit is tried again that does not arrive. Too stiff a start tends to end at a rigid joint.
SOFTER = (0.6, 0.35)
#: White torque noise and rounding that is white are what the noise of a record is taken for, right to this share of its power:
#: with 100 000 lines chance alone allows no more than a hundredth.
NOISE_MODEL = 0.05
#: The way from the start is gone with about this many lines a record: a hundredth of a resonance is not needed to find it.
FEW_LINES = 100
#: Times that records are read anew at the postures where K tells that they rest, and how far chi^2 must fall for that.
PLACES, LEAST = 8, 1.0
#: Noise powers of odd lines up to which links may swing so far that what is of second order comes back there.
SWINGS = 20.0
#: Share of its standard deviation below which a value is none.
NOTHING = 1e-3


@dataclass(frozen=True)
class CoupledFit:
    """An arm fitted to all its records.

    `alpha` [D] of the model with `covariance` [D, D]; `unseen` [D, k] orthonormal directions of alpha the records hold
    no information on: alpha is CAD's there where no record's J(q) depends on it, and means nothing where noise hides
    it. K [N m/rad, joint side], J_m [kg m2], D [N m s/rad] motor side, D_spring [N m s/rad, joint side], each [n], with
    `drive_std` [4, n] in the order of `DRIVES`. `gravity` [r, kg m] the orthonormal combinations of first moments on
    which the gravity stiffness depends (`gravity_basis`). `chi2_per_dof` over `dof` degrees of freedom is `explained`
    when below `chi2_limit`. `predictions`: see `predict`. `responses`: the records, as they were read, at the postures where they rest; `every` line of them was
    fitted, with the motion that terms of second order make.
    """

    alpha: Array
    covariance: Array
    unseen: Array
    K: Array
    J_m: Array
    D: Array
    D_spring: Array
    drive_std: Array
    gravity: Array
    chi2_per_dof: float
    dof: int
    chi2_limit: float
    explained: bool
    converged: bool
    status: tuple[str, ...]
    predictions: tuple[Complex, ...]
    responses: tuple[Frf, ...]
    every: bool

    def predict(self, record_index: int) -> Complex:
        """The model's motor angles of all joints [L, n, rad] at the lines of that record, for its measured torques."""
        return self.predictions[record_index]


#: Where a fit starts: an arm as the model knows it.
Start = Parameters


def fit_coupled(
    campaign: Campaign, model: Model, responses: Sequence[Frf], start: Start | None = None, workers: int = 1
) -> CoupledFit:
    """Returns the arm that explains all `responses` of `campaign` best; `responses` [records] in their order.

    Starts from `start`, else from the datasheet (two-mass fits where it is silent), CAD and a damping of 1 %; if that
    leads nowhere, from softer springs and from the drives of two-mass fits. All of this on few lines a record; all lines
    then have the last word, but for those that stand alone (`lone_lines`). Joints that neither moved nor were driven in a
    record are taken as clamped there. Raises IdentError for no records, for a record without usable lines and for too few
    lines in all.
    """
    if not responses:
        raise IdentError("no records to fit; expected at least one")
    basis = gravity_basis(model, campaign.gravity)
    data = evidence_of(campaign, model, basis, responses)
    rough = tuple(thinned(one, FEW_LINES) for one in data)
    best: tuple[Problem, Minimum] | None = None
    for guess in _starts(campaign, model, responses, basis, start):
        problem = replace(problem_of(campaign, model, basis, rough, guess), workers=workers)
        found = _approach(problem, guess.vector())
        if best is None or found.chi2 < best[1].chi2:
            best = (problem, found)
        if found.chi2 < ARRIVED * max(degrees(rough) - len(found.vector), 1):
            break
    assert best is not None
    problem, found = replace(best[0], data=data), minimise(best[0], best[1].vector)
    if any(few is not one for few, one in zip(rough, data, strict=True)):
        found = minimise(problem, found.vector)
    for _ in range(PLACES):
        there = rested(campaign, responses, problem.parameters(found.vector).K)
        if farthest_apart(responses, there) <= THERE:
            responses = there
            break
        moved = replace(problem, data=evidence_of(campaign, model, basis, there))
        other = minimise(moved, found.vector)
        if other.chi2 >= found.chi2 - LEAST:
            break
        problem, found, responses = moved, other, there
    fit = _result(campaign, model, responses, problem, found)
    if not fit.explained and (tones := lone_lines(problem, found.vector)).size:
        return fit_coupled(campaign, model, [without_lines(frf, tones) for frf in responses], start, workers)
    if fit.explained or fit.chi2_per_dof > SWINGS:
        return fit
    swung = replace(problem, data=evidence_of(campaign, model, basis, responses, every=True), turns=TURNS)
    whole = _result(campaign, model, responses, swung, minimise(swung, found.vector))
    return whole if whole.chi2_per_dof / whole.chi2_limit < fit.chi2_per_dof / fit.chi2_limit else fit


def evidence_of(
    campaign: Campaign, model: Model, basis: Array, responses: Sequence[Frf], every: bool = False
) -> tuple[Evidence, ...]:
    """Returns the records at the lines that are fitted: those that are usable; `every` one where even ones are excited, or links swing far, as
    terms of second order act there."""
    odd = all(np.all(record.lines % 2) for record in campaign.records)
    lines = "usable" if odd and not every else "every"
    return tuple(evidence(campaign, model, basis, frf, k, lines) for k, frf in enumerate(responses))


def _approach(problem: Problem, vector: Array) -> Minimum:
    """Where doubts and what is expected of an arm lead from `vector`: near its optimum, if it is the arm at all."""
    n = problem.n
    widths = np.repeat(WIDTHS, [2 * n, 2 * n, len(vector) - 4 * n])
    data = 2 * sum(one.scene.theta.size for one in problem.data)
    return minimise(replace(problem, expected=(vector, SHARE * data / widths**2)), vector, APPROACH, outer=0)


def problem_of(
    campaign: Campaign, model: Model, basis: Array, data: tuple[Evidence, ...], start: Parameters,
    effects: Sequence[Effect] = (), scales: Sequence[float] = (), bounds: Sequence[tuple[float, float]] = (),
) -> Problem:  # fmt: skip
    """Returns the fit of `data` from `start`, with `effects` whose values have `scales` and `bounds`, one each."""
    scale = np.concatenate([scale_of(start), np.asarray(scales, dtype=float)])
    low, high = np.full(len(scale), -np.inf), np.full(len(scale), np.inf)
    if len(bounds):
        low[-len(bounds) :], high[-len(bounds) :] = np.array(bounds).T

    return Problem(
        data, campaign.n, len(start.alpha), len(start.gravity), tuple(effects), scale, low, high,
        np.ones(len(scale), dtype=bool), scenes_of(campaign, model, basis),
    )  # fmt: skip


def degrees_of_freedom(problem: Problem, found: Minimum) -> tuple[int, float]:
    """Returns the degrees of freedom of chi^2, and the chi^2 per degree that noise alone rarely exceeds: noise powers are
    shared by all lines, and right to `NOISE_MODEL`. IdentError where the records hold no more numbers than they fix."""
    judged, seen = degrees(problem.data), int(spectrum(found.information)[2].sum())
    dof = judged - seen
    if dof < 1:
        raise IdentError(
            f"the usable lines hold {judged} numbers and fix {seen} parameters; expected more lines to judge it by"
        )
    width = int(np.mean([len(one.sampling.f) for one in problem.data]))
    noise_dof = float(np.mean([one.noise_dof for one in problem.data]))
    return dof, (1.0 + NOISE_MODEL) * chi2_limit(dof, noise_dof, width)


def _starts(
    campaign: Campaign, model: Model, responses: Sequence[Frf], basis: Array, start: Start | None
) -> Iterator[Start]:
    """Yields start values, best first: `start` or datasheet and CAD, softer springs, then what two masses say."""
    if start is None:
        start = declared_start(campaign, model, responses, basis)

    def other(K: Array, J_m: Array) -> Start:
        return _damped(campaign, model, responses, K, J_m, start.alpha, start.gravity)

    yield start
    yield other(SOFTER[0] * start.K, start.J_m)
    K, J_m = _two_mass_drives(campaign, responses)
    yield other(K, J_m)
    yield other(SOFTER[0] * K, J_m)
    yield other(SOFTER[1] * start.K, start.J_m)


def declared_start(campaign: Campaign, model: Model, responses: Sequence[Frf], basis: Array) -> Start:
    """The declared arm: datasheet (two-mass fits where it is silent), CAD, and the declared damping or 1 %."""
    K, J_m = campaign.K, campaign.J_m
    if not (np.isfinite(K) & np.isfinite(J_m)).all():
        fitted = _two_mass_drives(campaign, responses)
        K, J_m = (np.where(np.isfinite(own), own, other) for own, other in zip((K, J_m), fitted, strict=True))
    start = _damped(campaign, model, responses, K, J_m, model.alpha_cad, basis @ model.chain.parameters)

    def known(declared: Array, guess: Array) -> Array:
        return np.where(np.nan_to_num(declared) > 0.0, declared, guess)

    return replace(start, D=known(campaign.D, start.D), D_spring=known(campaign.D_spring, start.D_spring))


def _damped(
    campaign: Campaign, model: Model, responses: Sequence[Frf], K: Array, J_m: Array, alpha: Array, gravity: Array
) -> Start:
    """These drives and links with a damping of 1 %."""
    J = np.mean([np.diag(model.J_cad(frf.posture)) for frf in responses], axis=0)
    D, D_spring = 2 * START_DAMPING * np.sqrt(K * J_m) / np.abs(campaign.N), 2 * START_DAMPING * np.sqrt(K * J)
    return Start(K, J_m, D, D_spring, alpha, gravity)


def _two_mass_drives(campaign: Campaign, responses: Sequence[Frf]) -> tuple[Array, Array]:
    """Returns K, J_m [n] of the two-mass fit that suits each joint best; the median of the others where there is none."""
    found = np.full((2, campaign.n), np.nan)
    least = np.full(campaign.n, np.inf)
    for frf in responses:
        try:
            fit = two_mass(frf, float(campaign.N[frf.index]), campaign.fs, campaign.hold)
        except IdentError:
            continue
        if fit.chi2_per_dof < least[frf.index]:
            least[frf.index], found[:, frf.index] = fit.chi2_per_dof, (fit.K, fit.J_m)
    for row, declared, plain in zip(found, (campaign.K, campaign.J_m), PLAIN_DRIVE, strict=True):
        row[:] = np.where(np.isfinite(row), row, declared)
        known = row[np.isfinite(row)]
        row[~np.isfinite(row)] = np.median(known) if known.size else plain
    return found[0], found[1]


def _result(campaign: Campaign, model: Model, responses: Sequence[Frf], problem: Problem, found: Minimum) -> CoupledFit:
    """The fit as its users see it; predictions at the lines that were too noisy to fit, too."""
    basis = gravity_basis(model, campaign.gravity)
    shown = [
        one if one.scene.slopes else evidence(campaign, model, basis, frf, one.index, "excited")
        for one, frf in zip(problem.data, responses, strict=True)
    ]
    p = problem.parameters(found.vector)
    absent = _absent(problem)  # a descent goes along these, too
    alpha = p.alpha + absent @ (absent.T @ (model.alpha_cad - p.alpha))
    covariance, unseen, _ = uncertainty(problem, found)
    dof, limit = degrees_of_freedom(problem, found)
    plain = _damped(campaign, model, responses, p.K, p.J_m, p.alpha, p.gravity)
    chi2 = found.chi2 / dof
    fit = CoupledFit(
        alpha, covariance, unseen, p.K, p.J_m, p.D, p.D_spring,
        _drive_std(problem, found, np.concatenate([plain.D, plain.D_spring])), p.gravity,
        chi2, dof, limit, chi2 <= limit, found.converged, (), _predictions(problem, found.vector, shown, responses),
        tuple(responses), problem.turns > 0,
    )  # fmt: skip
    coarse = _coarse(campaign, model, responses, fit)
    return replace(fit, status=(*_status(fit, absent, campaign, model), *coarse))


def _coarse(campaign: Campaign, model: Model, responses: Sequence[Frf], fit: CoupledFit) -> Iterator[str]:
    """A line for every joint whose encoder tells so little of where it was held that J(q) there may be off by more than its deviation."""
    for j, name in enumerate(campaign.joints):
        most, error = 0.0, 0.0
        for record, frf in zip(campaign.records, responses, strict=True):
            if frf.index == j or np.ptp(record.theta[:, j]) >= (HIDDEN_STEPS + 0.5) * frf.step[j]:
                continue
            away = frf.step[j] / np.sqrt(12.0) / abs(campaign.N[j])
            rows = model.J_rows(frf.posture + away * np.array([[-1.0], [0.0], [1.0]]) * np.eye(campaign.n)[j])
            std = np.sqrt(np.einsum("ija,ab,ijb->ij", rows[1], fit.covariance, rows[1])) + np.finfo(float).tiny
            times = float((np.abs((rows[2] - rows[0]) @ fit.alpha) / 2.0 / std).max())
            most, error = (times, away) if times > most else (most, error)
        if most > 1.0:
            yield (
                f"{name}: held within {HIDDEN_STEPS} counts of its encoder, which tells its angle to {error:.2g} only: J(q) read there may be "
                f"off by {most:.2g} standard deviations more"
            )


def _absent(problem: Problem) -> Array:
    """Orthonormal directions of alpha [D, k] on which no record depends, whatever the arm."""
    D = problem.D
    size = problem.scale[4 * problem.n : 4 * problem.n + D]
    rows = [one.scene.arm.J_rows.reshape(-1, D) for one in problem.data]
    rows += [one.scene.slopes[0].reshape(-1, D) for one in problem.data if one.scene.slopes]
    return np.linalg.qr(size[:, None] * null_space(np.concatenate(rows) * size, rcond=RANK_TOLERANCE))[0]


def uncertainty(problem: Problem, found: Minimum) -> tuple[Array, Array, Array]:
    """Returns the covariance of alpha [D, D], the orthonormal directions of alpha that were not seen [D, k], and the standard
    deviations of all parameters [P]: relative ones of the drives, whose logarithms are fitted."""
    n, D = problem.n, problem.D
    values, vectors, seen = spectrum(found.information)
    lifted = np.where(seen, values, UNSEEN_INFORMATION**2)
    covariance = (vectors / lifted) @ vectors.T
    a = slice(4 * n, 4 * n + D)
    spread, directions = np.linalg.eigh(covariance[a, a])
    unseen = np.linalg.qr(problem.scale[a, None] * directions[:, spread > 1.0 / UNSEEN_INFORMATION])[0]
    size = problem.scale[a]
    return covariance[a, a] * np.outer(size, size), unseen, np.sqrt(np.diag(covariance)) * problem.scale


def _drive_std(problem: Problem, found: Minimum, plain: Array) -> Array:
    """Standard deviations [4, n] of the drives.

    A damping that went to zero has a logarithm of which nothing is felt: of one that is hardly known derivatives are taken where it
    is `plain` [2n], D and D_spring, and then where it is one standard deviation.
    """
    n = problem.n

    def deviations(vector: Array, information: Array) -> Array:
        std = uncertainty(problem, replace(found, information=information))[2][: 4 * n]
        return np.asarray(std * np.exp(vector[: 4 * n]))

    std, damping = deviations(found.vector, found.information), np.flatnonzero(problem.dampings)
    lost = damping[std[damping] > UNTOLD * np.exp(found.vector[damping])]
    if not lost.size:
        return std.reshape(4, n)
    vector, held = found.vector.copy(), hold(problem, found.vector)
    size = np.concatenate([np.zeros(2 * n), plain])
    for _ in range(2):
        vector[lost] = np.log(np.maximum(np.exp(found.vector[lost]), size[lost]))
        information = np.zeros_like(found.information)
        for one, kept in zip(problem.data, held, strict=True):
            _, A, columns = whitened(problem, vector, one, kept)
            information[np.ix_(columns, columns)] += 2.0 * (A.conj().T @ A).real
        size = deviations(vector, information)
    std[lost] = size[lost]
    return std.reshape(4, n)


def _predictions(
    problem: Problem, vector: Array, data: Sequence[Evidence], responses: Sequence[Frf]
) -> tuple[Complex, ...]:
    """What the arm at `vector` answers at the excited lines [L, n] of every record."""
    predictions = []
    for one, kept, frf in zip(data, hold(replace(problem, data=tuple(data)), vector), responses, strict=True):
        theta = np.zeros_like(frf.theta)
        theta[:, one.scene.arm.live] = (one.scene.theta - residual(problem, vector, one, kept.moved)[0])[one.is_excited]
        theta.setflags(write=False)
        predictions.append(theta)
    return tuple(predictions)


def _status(fit: CoupledFit, absent: Array, campaign: Campaign, model: Model) -> tuple[str, ...]:
    """What the fit does not tell, one line each; along `absent` [D, k] alpha is CAD's."""
    lines = []
    if not fit.converged:
        lines.append("the coupled fit did not converge")
    if not fit.explained:
        lines.append(
            f"the elastic arm does not explain its records: chi2/dof {fit.chi2_per_dof:.3g}, limit {fit.chi2_limit:.3g}"
        )
    hidden = fit.unseen - absent @ (absent.T @ fit.unseen)
    directions, sizes, _ = np.linalg.svd(hidden, full_matrices=False)
    for found, why in (
        (absent.T, "the records hold no information on a direction of alpha, mostly {}: CAD value kept"),
        (
            directions.T[sizes > 0.5],
            "a direction of alpha, mostly {}, is lost in noise and what else may be: its value means nothing",
        ),
    ):
        lines += [why.format(model.names[int(np.argmax(np.abs(direction)))]) for direction in found]
    lines += thin(certainty(model, fit.covariance, fit.unseen))
    for name, std in zip(DRIVES, fit.drive_std, strict=True):
        for joint, value, deviation in zip(campaign.joints, getattr(fit, name), std, strict=True):
            if deviation > UNTOLD * value:
                some = f"{value:.3g} with standard deviation {deviation:.2g}"
                none = f"none is seen, and less than {2.0 * deviation:.2g} is there"
                lines.append(f"{joint}: {name} hardly known: {none if value < NOTHING * deviation else some}")
    return tuple(lines)
