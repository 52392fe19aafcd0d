"""All records and all motors in one fit: J(q), drives and gravity stiffness of an arm whose locks are not rigid.

A motor that holds still does not hold its link still: the spring between them gives, and the response of the excited
joint shows the whole arm. So the arm is fitted as a whole (`arm_model`): maximum likelihood in the frequency domain,
residual theta - G tau of every motor, weighted by the noise found between the lines (R. Pintelon, J. Schoukens, System
Identification: A Frequency Domain Approach, 2nd ed., Wiley 2012, chapters 9 and 12). Levenberg-Marquardt with analytic
derivatives; the weights, which depend on G, are made again until nothing changes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from ident.arm_model import Parameters, Posture, Sampling, motion, motion_and_derivatives
from ident.campaign import Array, Campaign
from ident.errors import IdentError
from ident.fit import UNTOLD, chi2_limit, two_mass
from ident.frf import BINS, ORDER, ROUNDING, Complex, Frf, moving_average
from ident.start import START_DAMPING
from symgen.plan import Model

#: Names of the four rows of `CoupledFit.drive_std`.
DRIVES = ("K", "J_m", "D", "D_spring")
#: Where a drive is not declared and nothing was fitted: only a start value, for a motor of a few hundred watts.
PLAIN_DRIVE = (5e3, 3e-5)
#: A step of less than this share of a standard deviation ends a fit, of ten times as much the weighting.
SMALL_STEP = 0.01
OUTER, INNER, TRIALS = 6, 30, 8
#: Relative errors the model is granted on the way from its start, so that no few clear lines pull it into a corner.
DOUBTS = (1.0, 0.1)
#: Progress below this share of chi^2 ends the way there.
ROUGHLY = 0.01
#: The model is computed to about this accuracy of an angle: no noise is taken to be smaller.
MODEL_ACCURACY = 1e-8
#: A direction of the parameters with less information than this was not seen: its deviation is over ten times its size.
UNSEEN_INFORMATION = 1e-2
#: Relative rounding error of an information matrix.
INFORMATION_ROUNDING = 1e-13
#: Factors on all K from which a fit is tried again that does not explain its data.
SCALES = (0.6, 1.6, 0.35, 2.8)
#: Two starts that end at chi^2 as close as this found the same minimum.
SAME_MINIMUM = 1e-3
#: Lines over which the first guess of the noise power is smoothed, and the passes that replace it by its model.
SMOOTHED, NOISE_PASSES = 15, 3
#: Random postures that show what the gravity stiffness depends on.
PROBES = 200


@dataclass(frozen=True)
class CoupledFit:
    """An arm fitted to all its records.

    `alpha` [D] of the model with `covariance` [D, D]; `unseen` [D, k] orthonormal directions of alpha the records hold no
    information on (there alpha is the start's, CAD). K [N m/rad, joint side], J_m [kg m2], D [N m s/rad] motor side,
    D_spring [N m s/rad, joint side], each [n], with `drive_std` [4, n] in the order of `DRIVES`. `gravity` [r, kg m] the
    orthonormal combinations of first moments on which the gravity stiffness depends (`gravity_basis`), with `gravity_std`.
    `chi2_per_dof` over `dof` degrees of freedom is `explained` when below `chi2_limit`. `predictions`: see `predict`.
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
    gravity_std: Array
    chi2_per_dof: float
    dof: int
    chi2_limit: float
    explained: bool
    converged: bool
    status: tuple[str, ...]
    predictions: tuple[Complex, ...]

    def predict(self, record_index: int) -> Complex:
        """The model's motor angles of all joints [L, n, rad] at the lines of that record, for its measured torques."""
        return self.predictions[record_index]


#: Where a fit starts: an arm as the model knows it.
Start = Parameters


@dataclass(frozen=True)
class _Data:
    """One record: the joints that move, at the usable lines. `noise` [R, L, 2 m] samples of (tau, theta)."""

    arm: Posture
    sampling: Sampling
    tau: Complex
    theta: Complex
    noise: Complex
    floor: Array
    noise_dof: float


@dataclass(frozen=True)
class _Problem:
    """All records of an n-joint arm with D constants alpha; a step of `scale` [P] is a large one."""

    data: tuple[_Data, ...]
    n: int
    D: int
    scale: Array

    def parameters(self, vector: Array) -> Parameters:
        return Parameters.of(vector, self.n, self.D)


@dataclass(frozen=True)
class _Minimum:
    vector: Array
    information: Array
    chi2: float
    converged: bool


def fit_coupled(campaign: Campaign, model: Model, responses: Sequence[Frf], start: Start | None = None) -> CoupledFit:
    """Returns the arm that explains all `responses` of `campaign` best; `responses` [records] in their order.

    Starts from `start`, else from the datasheet (two-mass fits where it is silent), CAD and a damping of 1 %; if that
    does not explain the data, from the drives of two-mass fits and from other stiffnesses too. Joints that neither moved nor were driven in a record are
    taken as clamped there. Raises IdentError for no records and for a record without usable lines.
    """
    if not responses:
        raise IdentError("no records to fit; expected at least one")
    basis = gravity_basis(model, campaign.gravity)
    data = tuple(_data(campaign, model, basis, frf) for frf in responses)
    best, before = None, np.inf
    lines = sum(one.theta.size for one in data)
    for guess, doubts in _starts(campaign, model, responses, basis, start):
        problem = _Problem(data, campaign.n, len(model.names), _scale(guess))
        found = _minimise(problem, guess.vector(), doubts)
        dof = 2 * lines - _seen(problem, found.information)
        limit = _limit(data, dof)
        again = abs(found.chi2 - before) < SAME_MINIMUM * found.chi2
        if best is None or found.chi2 < best[1].chi2:
            best = (problem, found, dof, limit)
        if best[1].chi2 <= best[3] * best[2] or again:
            break
        before = best[1].chi2
    assert best is not None
    return _result(campaign, model, responses, basis, *best)


def gravity_basis(model: Model, gravity: Array) -> Array:
    """Returns the orthonormal rows [r, 10 n] with which the gravity stiffness is a function of `basis` . phi."""
    q = model.random_postures(PROBES, np.random.default_rng(0))
    rows = model.gravity_stiffness_rows(q, gravity).reshape(-1, 10 * model.chain.n)
    _, singular, V = np.linalg.svd(rows, full_matrices=False)
    return V[: int(np.sum(singular > 1e-9 * max(singular[0], 1e-9)))]


def _data(campaign: Campaign, model: Model, basis: Array, frf: Frf) -> _Data:
    use, live = frf.usable, _live(frf)
    if not use.any():
        raise IdentError(f"record {frf.record}: no line is usable; expected torque of {frf.joint} above its noise")
    square = np.ix_(live, live)
    K_rows = model.gravity_stiffness_rows(frf.posture, campaign.gravity) @ basis.T
    arm = Posture(live, campaign.N[live], model.J_rows(frf.posture)[square], K_rows[square])
    noise = frf.noise[:, use][:, :, np.concatenate([live, frf.n + live])]
    one = 2.0 * (BINS - ORDER)
    share = (frf.dof / one - 1.0) / (frf.width - 1) if frf.width > 1 else 1.0
    return _Data(
        arm, Sampling(frf.frequencies[use], campaign.fs, campaign.hold), frf.tau[use][:, live], frf.theta[use][:, live],
        noise, frf.floor[live], one / 2.0 * (1.0 + (int(use.sum()) - 1) * share),
    )  # fmt: skip


def _live(frf: Frf) -> NDArray[np.int64]:
    """Returns the joints that take part: all but those whose torque is constant and whose angle shows a flicker at most."""
    n = frf.n
    power = np.mean(np.abs(np.hstack([frf.tau, frf.theta])) ** 2, axis=0) + np.mean(np.abs(frf.noise) ** 2, axis=(0, 1))
    still = np.concatenate([np.zeros(n), 16.0 * frf.floor]) + ROUNDING**2 * np.repeat(
        power[[frf.index, n + frf.index]], n
    )
    clamped = (power <= still).reshape(2, n).all(axis=0)
    clamped[frf.index] = False
    return np.flatnonzero(~clamped)


def _scale(start: Start) -> Array:
    """Returns what a large step is [P]: a factor e of a drive, the size of an alpha or first moment (1 % of the largest)."""
    drives = np.ones(4 * len(start.K))
    sizes = [np.maximum(np.abs(x), 1e-2 * np.abs(x).max(initial=1e-9)) for x in (start.alpha, start.gravity)]
    return np.concatenate([drives, *sizes])


def _starts(
    campaign: Campaign, model: Model, responses: Sequence[Frf], basis: Array, start: Start | None
) -> Iterator[tuple[Start, tuple[float, ...]]]:
    """Yields start values, best first, and how far to doubt the model on the way.

    `start` or datasheet and CAD, at once and by detours, then other stiffnesses, then what two masses say.
    """
    J = np.mean([np.diag(model.J_cad(frf.posture)) for frf in responses], axis=0)

    def damped(K: Array, J_m: Array, alpha: Array, gravity: Array) -> Start:
        D, D_spring = 2 * START_DAMPING * np.sqrt(K * J_m) / campaign.N, 2 * START_DAMPING * np.sqrt(K * J)
        return Start(K, J_m, D, D_spring, alpha, gravity)

    fitted = None
    if start is None:
        K, J_m = campaign.K, campaign.J_m
        if not (np.isfinite(K) & np.isfinite(J_m)).all():
            fitted = _two_mass_drives(campaign, responses)
            K, J_m = (np.where(np.isfinite(own), own, other) for own, other in zip((K, J_m), fitted, strict=True))
        start = damped(K, J_m, model.alpha_cad, basis @ model.chain.parameters)
    yield start, ()
    yield start, DOUBTS
    for factor in SCALES:
        yield damped(start.K * factor, start.J_m, start.alpha, start.gravity), DOUBTS
    yield damped(*(fitted or _two_mass_drives(campaign, responses)), start.alpha, start.gravity), DOUBTS


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


def _minimise(problem: _Problem, vector: Array, doubts: Sequence[float]) -> _Minimum:
    """Levenberg-Marquardt, weights made anew at every minimum until that moves nothing; first with `doubts`."""
    converged = False
    for doubt in (*doubts, *[0.0] * OUTER):
        weights = [_whitening(one, problem.parameters(vector), doubt) for one in problem.data]
        chi2, slope, information = _normal_equations(problem, vector, weights)
        begin, settled, damping = vector, False, 1e-3
        for _ in range(INNER):
            for _ in range(TRIALS):
                step = _step(slope, information, damping)
                trial = vector + problem.scale * step
                cost = _chi2(problem, trial, weights)
                if cost <= chi2:
                    break
                damping *= 5.0
            else:
                settled = bool(-step @ slope < SMALL_STEP)
                break
            damping = max(damping / 5.0, 1e-12)
            vector, moved, before = trial, float(step @ information @ step), chi2
            chi2, slope, information = _normal_equations(problem, vector, weights)
            if moved < SMALL_STEP**2 or (doubt and before - chi2 < ROUGHLY * before):
                settled = True
                break
        shift = (vector - begin) / problem.scale
        if not doubt and settled and shift @ information @ shift < (10.0 * SMALL_STEP) ** 2:
            converged = True
            break
    return _Minimum(vector, information, chi2, converged)


def _step(slope: Array, information: Array, damping: float) -> Array:
    """Returns the damped step, no component beyond 1."""
    size = np.sqrt(np.diag(information))
    size[size == 0.0] = 1.0
    matrix = information / size / size[:, None] + damping * np.eye(len(slope))
    return np.clip(-np.linalg.solve(matrix, slope / size) / size, -1.0, 1.0)


def _chi2(problem: _Problem, vector: Array, weights: Sequence[Complex]) -> float:
    p = problem.parameters(vector)
    total = 0.0
    with np.errstate(all="ignore"):  # a trial step beyond numbers is refused for its size
        for one, W in zip(problem.data, weights, strict=True):
            if np.linalg.eigvalsh(one.arm.J(p))[0] <= 0.0:
                return float(np.inf)
            theta = motion(one.arm, p, one.sampling, one.tau[..., None])
            total += 2.0 * float(np.sum(np.abs(W @ (one.theta[..., None] - theta)) ** 2))
    return total if np.isfinite(total) else np.inf


def _normal_equations(problem: _Problem, vector: Array, weights: Sequence[Complex]) -> tuple[float, Array, Array]:
    """Returns chi^2, half its gradient [P] and half its Gauss-Newton Hessian [P, P] per step of `scale`: the information."""
    p, P = problem.parameters(vector), len(vector)
    chi2, slope, information = 0.0, np.zeros(P), np.zeros((P, P))
    for one, W in zip(problem.data, weights, strict=True):
        columns = one.arm.columns(problem.n)
        theta, derivatives = motion_and_derivatives(one.arm, p, one.sampling, one.tau)
        A = -(W @ (derivatives * problem.scale[columns])).reshape(-1, len(columns))
        r = (W @ (one.theta - theta)[..., None]).ravel()
        chi2 += 2.0 * float(np.vdot(r, r).real)
        slope[columns] += 2.0 * (A.conj().T @ r).real
        real = np.concatenate([A.real, A.imag])
        information[np.ix_(columns, columns)] += 2.0 * (real.T @ real)
    return chi2, slope, information


def _whitening(one: _Data, p: Parameters, doubt: float) -> Complex:
    """Returns W [L, m, m] that makes the error of theta - G tau white, of unit variance: torque noise through G, and angle
    noise.

    Each joint's two noise powers are constant over the band; fitted to the samples between the lines, weighted by their
    own prediction (maximum likelihood, P. Whittle), and not below quantisation. `doubt` is the error the model is granted,
    relative to each angle.
    """
    m, L = len(one.arm.live), len(one.sampling.f)
    G = motion(one.arm, p, one.sampling, np.broadcast_to(np.eye(m, dtype=complex), (L, m, m)))
    error = one.noise[:, :, m:] - np.einsum("lij,rlj->rli", G, one.noise[:, :, :m])
    power = np.mean(np.abs(error) ** 2, axis=0)
    least = np.maximum(
        one.floor, (MODEL_ACCURACY * (np.abs(one.theta) / one.arm.N).max(axis=1)[:, None] * one.arm.N) ** 2
    )
    rows = np.concatenate([np.abs(G) ** 2, np.broadcast_to(np.eye(m), (L, m, m))], axis=2)
    predicted, powers = moving_average(power, min(SMOOTHED, L)), np.zeros(2 * m)
    for _ in range(NOISE_PASSES):
        weight = 1.0 / np.maximum(predicted, least)
        X = (rows * weight[..., None]).reshape(L * m, 2 * m)
        size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
        powers = nnls(X / size, (power * weight).ravel())[0] / size
        predicted = rows @ powers
    covariance: Complex = np.einsum("lij,j,lkj->lik", G, powers[:m], G.conj())
    i = np.arange(m)
    covariance[:, i, i] += np.maximum(powers[m:], least) + (doubt * np.abs(one.theta)) ** 2
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=complex)


def _spectrum(information: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Returns eigenvalues [P], eigenvectors [P, P] of the information, and which of them were seen."""
    values, vectors = np.linalg.eigh(information)
    return values, vectors, values > max(UNSEEN_INFORMATION, INFORMATION_ROUNDING * values[-1])


def _seen(problem: _Problem, information: Array) -> int:
    return int(_spectrum(information)[2].sum())


def _limit(data: Sequence[_Data], dof: int) -> float:
    """Returns the chi^2 per degree of freedom that noise alone rarely exceeds; noise powers are shared by all lines."""
    lines = sum(one.theta.size for one in data)
    width = int(np.mean([len(one.sampling.f) for one in data]))
    return chi2_limit(lines, dof, float(np.mean([max(one.noise_dof, 5.0) for one in data])), width)


def _result(
    campaign: Campaign, model: Model, responses: Sequence[Frf], basis: Array, problem: _Problem, found: _Minimum, dof: int,
    limit: float,
) -> CoupledFit:  # fmt: skip
    n, D = problem.n, problem.D
    p = problem.parameters(found.vector)
    values, vectors, seen = _spectrum(found.information)
    lifted = np.where(seen, values, UNSEEN_INFORMATION**2)
    covariance = (vectors / lifted) @ vectors.T
    a = slice(4 * n, 4 * n + D)
    spread, directions = np.linalg.eigh(covariance[a, a])
    unseen = np.linalg.qr(problem.scale[a, None] * directions[:, spread > 1.0 / UNSEEN_INFORMATION])[0]
    std = np.sqrt(np.diag(covariance)) * problem.scale
    chi2 = found.chi2 / dof
    fit = CoupledFit(
        p.alpha, covariance[a, a] * np.outer(problem.scale[a], problem.scale[a]), unseen, p.K, p.J_m, p.D, p.D_spring,
        std[: 4 * n].reshape(4, n) * np.stack([p.K, p.J_m, p.D, p.D_spring]), p.gravity, std[4 * n + D :], chi2, dof,
        limit, chi2 <= limit, found.converged, (), _predictions(campaign, problem, p, responses),
    )  # fmt: skip
    return replace(fit, status=_status(fit, campaign, model))


def _predictions(campaign: Campaign, problem: _Problem, p: Parameters, responses: Sequence[Frf]) -> tuple[Complex, ...]:
    predictions = []
    for one, frf in zip(problem.data, responses, strict=True):
        theta = np.zeros_like(frf.theta)
        sampling = Sampling(frf.frequencies, campaign.fs, campaign.hold)
        theta[:, one.arm.live] = motion(one.arm, p, sampling, frf.tau[:, one.arm.live, None])[..., 0]
        theta.setflags(write=False)
        predictions.append(theta)
    return tuple(predictions)


def _status(fit: CoupledFit, campaign: Campaign, model: Model) -> tuple[str, ...]:
    """What the fit does not tell, one line each."""
    lines = []
    if not fit.converged:
        lines.append("the coupled fit did not converge")
    if not fit.explained:
        lines.append(
            f"the elastic arm does not explain its records: chi2/dof {fit.chi2_per_dof:.3g}, limit {fit.chi2_limit:.3g}"
        )
    for direction in fit.unseen.T:
        k = int(np.argmax(np.abs(direction)))
        lines.append(
            f"the records hold no information on a direction of alpha, mostly {model.names[k]}: CAD value kept"
        )
    blind = np.abs(fit.unseen).max(axis=1, initial=0.0) > 1e-6
    for name, value, variance, hidden in zip(model.names, fit.alpha, np.diag(fit.covariance), blind, strict=True):
        if not hidden and np.sqrt(variance) > UNTOLD * abs(value):
            lines.append(f"{name} hardly known: {value:.3g} with standard deviation {np.sqrt(variance):.2g}")
    for name, std in zip(DRIVES, fit.drive_std, strict=True):
        for joint, value, deviation in zip(campaign.joints, getattr(fit, name), std, strict=True):
            if deviation > UNTOLD * value:
                lines.append(f"{joint}: {name} hardly known: {value:.3g} with standard deviation {deviation:.2g}")
    return tuple(lines)
