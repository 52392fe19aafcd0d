"""A frequency response becomes motor inertia, stiffness, load inertia: by the paper's three points, or by all lines.

Equations (n) are those of K. Choi et al., "Identification of Flexible Joint Robot Inertia Matrix Using Frequency
Response Analysis". (3) is printed without the s^2 of its numerator s^2 + K/J_l; without it there is no anti-resonance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.special import gammaincinv

from ident.errors import IdentError
from ident.joint.start import START_DAMPING, largest_rise, starts_of
from ident.records.campaign import HOLDS, Array
from ident.records.frf import Complex, Frf

#: The six parameters of a flexible joint: J_m [kg m2], D [N m s/rad] motor side; K [N m/rad], J_l [kg m2],
#: D_spring [N m s/rad], K_g [N m/rad] (gravity stiffness of the link) joint side.
PARAMETERS = ("J_m", "K", "J_l", "D", "D_spring", "K_g")
Model = tuple[float, float, str]  # N, fs, hold
#: A model does not explain its data when chi^2 is larger than in this share of honest repetitions.
CONFIDENCE = 0.999
#: A fit that has to leave out more than this share of the lines, for lack of torque, says so.
LEFT_OUT = 0.1
#: A standard deviation above half the value: the data do not tell the parameter.
UNTOLD = 0.5
#: Singular values of the Jacobian below this share of the largest are rounding.
RANK_TOLERANCE = 1e-10
#: A fit leaves its start by no more than these factors (logarithms): masses and stiffness 400, dampings a million.
REACH = np.array([6.0, 6.0, 6.0, 14.0, 14.0])
#: Residual of a trial step that can not be computed: more than any measured one, and its square is still a number.
REFUSED = 1e100


@dataclass(frozen=True)
class ThreePoint:
    """The paper's reading of one response: f_AR, f_R [Hz] on the measured grid, J_m, K, J_l as in `PARAMETERS`."""

    joint: str
    f_AR: float
    f_R: float
    J_m: float
    K: float
    J_l: float
    status: tuple[str, ...]


@dataclass(frozen=True)
class JointFit:
    """A flexible joint fitted to one response: J_m .. K_g and `covariance` [6, 6] in the order and units of `PARAMETERS`.

    The covariance is from the measured noise alone. `chi2_per_dof` over `dof` degrees of freedom; `explained` when it is
    below `chi2_limit`. `status` says what the data do not tell.
    """

    record: str
    joint: str
    J_m: float
    K: float
    J_l: float
    D: float
    D_spring: float
    K_g: float
    covariance: Array
    chi2_per_dof: float
    dof: int
    chi2_limit: float
    explained: bool
    status: tuple[str, ...]

    @property
    def parameters(self) -> Array:
        """The six parameters [6]."""
        return np.array([getattr(self, name) for name in PARAMETERS])

    @property
    def std(self) -> Array:
        """Their standard deviations [6]."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def std_inflated(self) -> Array:
        """These times sqrt(chi2_per_dof) where the model does not explain the data: a better guess then, not a bound, because
        model errors are no noise."""
        return self.std * (1.0 if self.explained else np.sqrt(self.chi2_per_dof))


@dataclass(frozen=True)
class TwoMass(JointFit):
    """A motor and its load: `f_AR`, `f_R` [Hz] by (4); `inertia_ratio` J_l / (N^2 J_m); `band_ratio` f_AR over the highest line."""

    f_AR: float
    f_R: float
    inertia_ratio: float
    band_ratio: float


def predict(parameters: ArrayLike, frequencies: ArrayLike, N: float, fs: float, hold: str) -> Complex:
    """Returns theta / tau of a flexible joint [L, rad per N m, motor side].

    `parameters` [6] in the order of `PARAMETERS`, `frequencies` [L, Hz]; `hold` "zoh": exact response of the sampled
    angle to a torque held for 1/fs; "band-limited": of the continuous angle. Raises IdentError for another hold and
    for masses or a stiffness that are not positive. Source: (1), (2), with motor and spring damping and K_g.
    """
    return _response(_vector(parameters), np.asarray(frequencies, dtype=float), N, fs, hold)[0]


def two_mass_frequencies(J_m: float, K: float, J_l: float, N: float) -> tuple[float, float]:
    """Returns (f_AR, f_R) [Hz] by (4)."""
    f_AR = float(np.sqrt(K / J_l) / (2 * np.pi))
    return f_AR, f_AR * float(np.sqrt(1 + J_l / (N**2 * J_m)))


def three_point(frf: Frf, N: float) -> ThreePoint:
    """Returns J_m, K, J_l by the paper's rule: dip, peak and top of the band of the velocity response |jw G|.

    f_AR and f_R are the lines between which |jw G| rises most; J_m = 1 / (w |jw G|) at the highest line; (5), (6).
    Biased, because the highest line is no asymptote and the grid is coarse: use `two_mass` to know, this to compare.
    """
    f = frf.frequencies
    velocity = 2 * np.pi * f * np.abs(frf.G)
    dip, peak = largest_rise(velocity)
    J_m = 1.0 / (2 * np.pi * f[-1] * velocity[-1])
    J_l = (f[peak] ** 2 / f[dip] ** 2 - 1.0) * N**2 * J_m
    status = []
    noise = 3.0 * np.sqrt(frf.variance[dip] / np.abs(frf.G[dip]) ** 2 + frf.variance[peak] / np.abs(frf.G[peak]) ** 2)
    if np.log(velocity[peak] / velocity[dip]) <= noise:
        status.append(f"record {frf.record}, {frf.joint}: no anti-resonance and resonance stand out of the noise")
    if peak == len(f) - 1 or dip == 0:
        status.append(f"record {frf.record}, {frf.joint}: the pair is not inside {f[0]:g} .. {f[-1]:g} Hz")
    K = 4 * np.pi**2 * f[dip] ** 2 * J_l
    return ThreePoint(frf.joint, float(f[dip]), float(f[peak]), float(J_m), float(K), float(J_l), tuple(status))


def two_mass(
    frf: Frf, N: float, fs: float, hold: str, start: ArrayLike | None = None, tries: int | None = None
) -> TwoMass:
    """Returns the flexible joint that explains the excited joint's response best: maximum likelihood over all lines.

    Only the usable lines count. `start` [6] replaces the automatic start values, of which `tries` are used (None: until one
    explains the data). Raises IdentError for less than 6 of
    them or an unknown hold. What cannot be told from the data is said in `status`. Source: (1)-(6); weighting as in
    Pintelon & Schoukens, chapter 9.
    """
    f, G, sigma = frf.frequencies[frf.usable], frf.G[frf.usable], np.sqrt(frf.variance[frf.usable])
    if len(f) < len(PARAMETERS):
        found = f"{len(f)} of {len(frf.frequencies)} excited lines are usable"
        raise IdentError(f"record {frf.record}: {found}, a flexible joint needs at least {len(PARAMETERS)}")
    dof = 2 * len(f) - len(PARAMETERS)
    limit = chi2_limit(dof, frf.dof, frf.width)
    starts = iter([_vector(start)]) if start is not None else starts_of(f, G, sigma, N, fs, hold)
    best, cost, converged = np.zeros(len(PARAMETERS)), np.inf, False
    for guess in islice(starts, tries):  # made one by one: most records need only the first
        p, c, success = _least_squares(guess, f, G, sigma, (N, fs, hold))
        if c < cost:
            best, cost, converged = p, c, success
        if converged and cost / dof <= limit:
            break
    _, dH = _response(best, f, N, fs, hold)
    covariance, condition = _covariance(np.sqrt(2.0) * dH / sigma[:, None], best)
    u1, u2 = _weight_moments(frf.dof)
    covariance *= u2 / u1  # estimated weights claim u1 times the information, and scatter
    covariance.setflags(write=False)
    std = np.sqrt(np.diag(covariance))
    explained = bool(cost / dof <= limit)
    J_m, K, J_l, D, D_spring, K_g = map(float, best)
    f_AR, f_R = two_mass_frequencies(J_m, K, J_l, N)
    inflation = 1.0 if explained else np.sqrt(cost / dof)
    where = f"record {frf.record}, {frf.joint}: "
    status = _unidentifiable(best, std * inflation, condition, (f_AR, f_R), (float(f[0]), float(f[-1])))
    if not explained:
        status.insert(0, f"two masses do not explain the response: chi2/dof {cost / dof:.3g}, limit {limit:.3g}"
                        f" (std_inflated is std times {inflation:.3g})")  # fmt: skip
    left_out = 1.0 - len(f) / len(frf.frequencies)
    if left_out > LEFT_OUT:
        status.insert(0, f"{left_out:.0%} of the lines left out: feedback takes their torque, hold {frf.joint} softer")
    if not converged:
        status.insert(0, "the fit did not converge")
    return TwoMass(
        frf.record, frf.joint, J_m, K, J_l, D, D_spring, K_g, covariance, float(cost / dof), dof, limit, explained,
        tuple(where + line for line in status), f_AR, f_R, J_l / (N**2 * J_m), f_AR / float(f[-1]),
    )  # fmt: skip


def chi2_limit(dof: int, variance_dof: float, width: int, confidence: float = CONFIDENCE) -> float:
    """Returns the chi^2 per degree of freedom that noise alone exceeds with probability 1 - `confidence`.

    The chi^2 of complex residuals, `dof` real degrees of freedom, is divided by variances which themselves are
    estimates with `variance_dof` degrees of freedom shared by `width` neighbouring lines: each line is F(2,
    variance_dof) distributed. The gamma distribution with the mean and variance of the sum gives the limit
    (Satterthwaite).
    """
    u1, u2 = _weight_moments(variance_dof)
    one = 8.0 * u2 - 4.0 * u1**2
    shared = (width - 1) * 4.0 * (u2 - u1**2)
    mean, variance = dof * u1, dof / 2.0 * (one + shared)
    return float(gammaincinv(mean**2 / variance, confidence) * variance / mean / dof)


def _weight_moments(nu: float) -> tuple[float, float]:
    """Returns E u and E u^2 of a weight u = 1 / (chi2_nu / nu), one over a variance estimated with nu > 4 dof."""
    return nu / (nu - 2.0), nu**2 / ((nu - 2.0) * (nu - 4.0))


def _vector(parameters: ArrayLike) -> Array:
    p = np.asarray(parameters, dtype=float)
    if p.shape != (len(PARAMETERS),) or not np.isfinite(p).all() or min(p[:3]) <= 0:
        raise IdentError(f"parameters must be {', '.join(PARAMETERS)} with J_m, K, J_l > 0, found {p.tolist()}")
    return p


def _state_space(p: Array, N: float) -> tuple[Array, Array]:
    """Returns [A B; 0 0] of x = (theta, N q, their rates) [5, 5] and its derivatives by the six parameters [6, 5, 5]:
    (1), (2).
    """
    J_m, K, J_l, D, D_spring, K_g = p
    m, s = 1.0 / J_m, 1.0 / (J_l / N**2)
    n2 = N**-2
    F, dF = np.zeros((5, 5)), np.zeros((6, 5, 5))
    F[0, 2] = F[1, 3] = 1.0
    F[2] = m * np.array([-K * n2, K * n2, -D - D_spring * n2, D_spring * n2, 1.0])
    F[3] = s * n2 * np.array([K, -K - K_g, D_spring, -D_spring, 0.0])
    dF[0, 2] = -F[2] / J_m
    dF[1, 2, :2], dF[1, 3, :2] = [-m * n2, m * n2], [s * n2, -s * n2]
    dF[2, 3] = -F[3] / J_l
    dF[3, 2, 2] = -m
    dF[4, 2, 2:4], dF[4, 3, 2:4] = [-m * n2, m * n2], [s * n2, -s * n2]
    dF[5, 3, 1] = -s * n2
    return F, dF


def _response(p: Array, f: Array, N: float, fs: float, hold: str) -> tuple[Complex, Complex]:
    """Returns theta / tau [L] and its derivatives by the six parameters [L, 6]."""
    if hold not in HOLDS:
        raise IdentError(f"hold must be one of {', '.join(HOLDS)}, found {hold!r}")
    F, dF = _state_space(p, N)
    point = 2j * np.pi * f
    if hold == "zoh":  # exp [F dF; 0 F] holds exp F and its derivative; z - 1 and A_d - 1 keep the low lines exact
        rates = np.array([1.0, 1.0, 1.0 / fs, 1.0 / fs, 1.0])  # per sample, not per second: a small norm
        both = np.zeros((6, 10, 10))
        both[:, :5, :5] = both[:, 5:, 5:] = F * rates[:, None] / rates / fs
        both[:, :5, 5:] = dF * rates[:, None] / rates / fs
        both = _expm1(both)
        F, dF = both[0, :5, :5], both[:, :5, 5:]
        point = np.expm1(point / fs)
    inverse = np.linalg.inv(point[:, None, None] * np.eye(4) - F[:4, :4])
    x: Complex = inverse @ F[:4, 4].astype(complex)
    x1 = np.concatenate([x, np.ones((len(f), 1))], axis=1)
    return x[:, 0], np.einsum("la,pab,lb->lp", inverse[:, 0], dF[:, :4], x1, optimize=True)


def _expm1(A: Array) -> Array:
    """Returns exp(A) - 1 of matrices [.., m, m]: Taylor series of A / 2^k, then k times (1 + E)^2 - 1 = 2 E + E^2.

    Keeps the small entries, which scipy.linalg.expm loses next to the 1, and starts no threads.
    """
    doublings = max(0, int(np.ceil(np.log2(max(np.abs(A).sum(axis=-1).max(), 1e-300)))) + 1)
    A = A / 2.0**doublings
    E, term = A, A
    for k in range(2, 15):  # 0.5^15 / 15! < 1e-16
        term = term @ A / k
        E = E + term
    for _ in range(doublings):
        E = 2.0 * E + E @ E
    return E


def _least_squares(start: Array, f: Array, G: Complex, sigma: Array, model: Model) -> tuple[Array, float, bool]:
    """Returns (parameters [6], chi^2, converged) near `start`; logarithms keep all but K_g positive."""
    scale = np.sqrt(2.0) / sigma
    K, N = start[1], model[0]
    least = 1e-3 * START_DAMPING * np.sqrt(K * start[2]) * np.array([N**-2, 1.0])
    x0 = np.concatenate([np.log(start[:3]), np.log(np.maximum(start[3:5], least)), [start[5] / K]])

    def parameters(x: Array) -> Array:
        return np.append(np.exp(np.clip(x[:5], x0[:5] - REACH, x0[:5] + REACH)), x[5] * K)

    def residual(x: Array) -> Array:
        with np.errstate(all="ignore"):  # a trial step to a stiffness beyond numbers is refused for its size
            r = scale * (_response(parameters(x), f, *model)[0] - G)
        return np.nan_to_num(np.concatenate([r.real, r.imag]), nan=REFUSED, posinf=REFUSED, neginf=REFUSED)

    def jacobian(x: Array) -> Array:
        p = parameters(x)
        dr = scale[:, None] * _response(p, f, *model)[1] * np.append(p[:5], K)
        return np.concatenate([dr.real, dr.imag])

    found = least_squares(residual, x0, jac=jacobian, method="lm", xtol=1e-10, ftol=1e-10, gtol=1e-12, max_nfev=60)
    return parameters(found.x), 2.0 * float(found.cost), bool(found.success)


def _covariance(J: NDArray[np.complex128], p: Array) -> tuple[Array, float]:
    """Returns the covariance [6, 6] of `p` from the Jacobian J [L, 6] of unit-variance residuals, and J's condition.

    Both per relative change; directions without information get a huge, finite variance.
    """
    scale = np.append(p[:5], p[1])
    scaled = np.concatenate([J.real, J.imag]) * scale
    _, singular, V = np.linalg.svd(scaled, full_matrices=False)
    lifted = np.maximum(singular, singular[0] * RANK_TOLERANCE)
    root = V.T / lifted * scale[:, None]
    return root @ root.T, float(singular[0] / lifted[-1])


def _unidentifiable(p: Array, std: Array, condition: float, pair: Sequence[float], band: Sequence[float]) -> list[str]:
    """Returns what the data do not tell, with numbers and the way out."""
    lines = []
    (f_AR, f_R), (low, high) = pair, band
    if f_AR > high:
        lines.append(f"f_AR {f_AR:.4g} Hz above the band, {high:g} Hz: widen the band or measure K elsewhere")
    elif f_AR < low:
        lines.append(f"f_AR {f_AR:.4g} Hz below the band, {low:g} Hz: widen the band")
    elif f_R > high:
        lines.append(f"f_R {f_R:.4g} Hz above the band, {high:g} Hz: J_m rests on the shape below it")
    if condition >= 1.0 / RANK_TOLERANCE:
        lines.append(f"the response does not tell all parameters apart: condition {condition:.1g} or more")
    for k in range(3):
        if std[k] > UNTOLD * p[k]:
            lines.append(f"{PARAMETERS[k]} not identifiable: {p[k]:.3g} with standard deviation {std[k]:.2g}")
    return lines
