"""One record becomes J_ii by all mode pairs of its excited motor: (5), (6) of the paper without its two masses.

What motor i feels of the arm is a dynamic stiffness, joint side: N tau = Z x_i with x = theta / N and, with all other motors
still, Z = N^2 J_m s^2 + N^2 D s + K - sum_r (a_r + b_r s) / (s^2 + c_r s + w_r^2), a mode r for every anti-resonance. Then
J_ii = sum a_r / w_r^4 (modal masses), which is N^2 J_m (prod f_R^2 / f_AR^2 - 1) and, for one mode, (5). Held motors that give
a little are taken out: their angles are measured, and each acts through the same modes with amplitudes of its own. That is
not unique where a held motor follows its link in a simple way (PD alone, no observer): a fit with a mode too few may explain
the record and read J_ii wrong, beyond its sigma. `coupled` uses the held motors' torques too and is not deceived.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import least_squares, nnls

from ident.arm.arm_model import hold_gain
from ident.arm.evidence import live_joints
from ident.errors import IdentError
from ident.joint.fit import PARAMETERS, UNTOLD, JointFit, chi2_limit
from ident.joint.start import START_DAMPING
from ident.records.campaign import Array, Campaign
from ident.records.frf import Complex, Frf, noise_dof

#: Modes are looked for in this many times the band, damped between these shares of critical.
REACH, DAMPINGS = (0.8, 1.5), (1e-4, 2.0)
#: Passes that make the weights anew from the fitted arm, and of the noise powers among them.
WEIGHT_PASSES, NOISE_PASSES = 3, 3
#: Rates of a held torque's aliases on each side; those left out fall with the third power.
ALIASES = 16
#: A mode beyond those found must lower chi^2 by this for each of its parameters: the logarithm of a thousand real numbers (BIC).
WORTH = 7.0
#: Places looked at for a further mode, those of them tried, this far apart (logarithm of frequency) from each other and from those found.
TRIED, PLACES, APART = 160, 3, 0.1
#: A mode of the declared arm above the band with more than this share of J_ii is told.
TOLD_SHARE = 1e-3


@dataclass(frozen=True)
class Modal(JointFit):
    """The excited joint of one record, read by its modes.

    `f_AR` and `mass` [modes]: anti-resonances [Hz] and modal masses [kg m2], of which J_l is the sum.
    `J_m` holds the masses of modes above the band. `G` [L] is the model's theta / tau with the other motors moving as they did.
    """

    f_AR: Array
    mass: Array
    G: Complex


def modal(frf: Frf, campaign: Campaign, J: Array | None = None) -> Modal:
    """Returns the reading of one record; as many modes as chi^2 asks for, at most one for each joint that moves.

    `J` [n, n] of the declared arm at the record's posture tells, with the declared K, what lies above the band. Raises
    IdentError for too few usable lines. Exact for a linear arm without gravity all of whose modes are in the band; K_g
    and J_ii are corrected for gravity by its own diagonal.
    """
    scene = _scene(frf, campaign)
    moving = scene.x.shape[1]
    least = max(2 * len(PARAMETERS), moving + 3)  # two numbers a line for a rigid rotor, and a mode that all feel
    if len(scene.s) < least:
        raise IdentError(f"record {frf.record}: {len(scene.s)} lines are usable, modes need {least} or more")
    best = _Fit(np.zeros((0, 2)), np.zeros(0), np.inf, np.abs(scene.tau))
    most = min(moving, (2 * len(scene.s) - 4) // (2 + 2 * moving))
    while len(best.poles) < most:
        better = _with_another(scene, best)
        if better is None:
            break
        best = better
        scene = scene.corrected(best.c[0])
    best = _fitted(scene, best.poles)  # without the aliases that the last fit still had
    return _reading(scene, frf, best, J, campaign)


@dataclass(frozen=True, eq=False)
class _Scene:
    """The usable lines: s [L], N tau [L] as a held torque acts, x [L, m] of the excited joint first and of the others that move
    (joint side), as continuous signals. `noise` [R, L, 1 + m] samples of their errors, `floor` [m] least power of x."""

    s: Complex
    tau: Complex
    x: Complex
    noise: Complex
    floor: Array
    N: float
    alias: Complex
    measured: Complex

    def corrected(self, inertia: float) -> _Scene:
        """With the aliases of the excited motor taken off, its `inertia` N^2 J_m known."""
        x = self.x.copy()
        x[:, 0] = self.measured - self.alias / max(inertia, 1e-300)
        return replace(self, x=x)


@dataclass(frozen=True, eq=False)
class _Fit:
    """`poles` [modes, 2] (log w, log zeta); amplitudes `c` of the columns; chi^2; the standard deviations `sigma` [L] it used;
    `jacobian` [2 L, all] of the whitened residual by c, then poles."""

    poles: Array
    c: Array
    chi2: float
    sigma: Array
    jacobian: Array = field(default_factory=lambda: np.zeros((0, 0)))


def _scene(frf: Frf, campaign: Campaign) -> _Scene:
    i, use = frf.index, frf.usable
    order = np.array([i, *[k for k in live_joints(frf) if k != i]])
    s = 2j * np.pi * frf.frequencies[use]
    tau, theta, N = frf.tau[use], frf.theta[use][:, order], campaign.N[order]
    rise, above = np.ones_like(s), np.zeros_like(s)
    if campaign.hold == "zoh":
        shifts = np.delete(np.arange(-ALIASES, ALIASES + 1), ALIASES)
        rise = hold_gain(s, campaign.fs)
        above = rise * s * np.sum(1.0 / (s[:, None] + 2j * np.pi * campaign.fs * shifts) ** 3, axis=1)
    J_m = np.where(np.isfinite(campaign.J_m[order]), campaign.J_m[order], np.inf)
    x = (theta - above[:, None] * tau[:, order] / J_m) / N
    samples = frf.noise[:, use]
    noise = np.concatenate([N[0] * rise[:, None] * samples[:, :, [i]], samples[:, :, frf.n + order] / N], axis=2)
    return _Scene(
        s, N[0] * rise * tau[:, i], x, noise, frf.floor[order] / N**2 + 1e-300, float(N[0]),
        N[0] * above * tau[:, i], theta[:, 0] / N[0],
    )  # fmt: skip


def _denominators(scene: _Scene, poles: Array) -> Complex:
    """s^2 + c s + w^2 of every mode [L, modes]."""
    w, zeta = np.exp(poles).T
    s = scene.s[:, None]
    return np.asarray(s**2 + 2 * zeta * w * s + w**2)


def _columns(scene: _Scene, poles: Array) -> Complex:
    """N tau = columns [L, 3 + modes m 2] . c: inertia, damping and stiffness; of each mode and joint (a, b)."""
    s, x = scene.s[:, None], scene.x
    rigid = np.concatenate([s**2, s, np.ones_like(s)], axis=1) * x[:, :1]
    shape = x[:, None, :, None] / _denominators(scene, poles)[:, :, None, None]
    modes = -shape * np.concatenate([np.ones_like(s), s], axis=1)[:, None, None, :]
    return np.concatenate([rigid, modes.reshape(len(s), -1)], axis=1)


def _sensitivity(scene: _Scene, poles: Array, c: Array) -> Complex:
    """What one unit of every x [L, m] changes N tau by."""
    unit = replace(scene, x=np.ones_like(scene.x))
    columns, m = _columns(unit, poles), scene.x.shape[1]
    parts = (columns[:, 3:] * c[3:]).reshape(len(scene.s), len(poles), m, 2).sum(axis=(1, 3))
    parts[:, 0] += columns[:, :3] @ c[:3]
    return parts


def _sigma(scene: _Scene, poles: Array, c: Array) -> Array:
    """Standard deviation [L] of N tau minus the model: torque noise of one power over the band, angle noise of another for each
    joint, by their samples (weighted by their own prediction), angles not below quantisation."""
    gain = _sensitivity(scene, poles, c)
    error = scene.noise[:, :, 0] - np.einsum("lm,rlm->rl", gain, scene.noise[:, :, 1:])
    power = np.mean(np.abs(error) ** 2, axis=0)
    rows = np.concatenate([np.ones((len(gain), 1)), np.abs(gain) ** 2], axis=1)
    least = rows[:, 1:] @ scene.floor
    predicted, powers = np.maximum(power, least), np.zeros(rows.shape[1])
    for _ in range(NOISE_PASSES):
        A = rows / predicted[:, None]
        size = np.linalg.norm(A, axis=0)
        powers = nnls(A / size, power / predicted)[0] / size
        predicted = np.maximum(powers[0] + rows[:, 1:] @ np.maximum(powers[1:], scene.floor), least)
    return np.sqrt(predicted)


def _projected(scene: _Scene, poles: Array, sigma: Array) -> tuple[Array, Array, Array, Array]:
    """Least squares at given poles: c, residual [2 L], derivatives of the residual by the poles alone [2 L, 2 modes] and with c
    refitted (Kaufman's; DOI 10.1007/BF01932995)."""
    columns = _columns(scene, poles) * (np.sqrt(2.0) / sigma)[:, None]
    A, y = _real(columns), _real(scene.tau * np.sqrt(2.0) / sigma)
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = 1.0
    Q, R = np.linalg.qr(A / size)
    R[np.diag_indices(len(R))] += np.where(np.abs(np.diag(R)) < 1e-12, 1e-12, 0.0)
    c = np.linalg.solve(R, Q.T @ y) / size
    w, zeta = np.exp(poles).T
    s = scene.s[:, None]
    by_mode = (columns[:, 3:] * c[3:]).reshape(len(s), len(poles), 2 * scene.x.shape[1]).sum(axis=2)
    slopes = np.stack([2 * zeta * w * s + 2 * w**2, 2 * zeta * w * s], axis=2) / _denominators(scene, poles)[:, :, None]
    direct = _real((by_mode[:, :, None] * slopes).reshape(len(s), 2 * len(poles)))
    return c, y - A @ c, direct, direct - Q @ (Q.T @ direct)


def _real(values: Complex) -> Array:
    return np.concatenate([values.real, values.imag])


def _fitted(scene: _Scene, poles: Array) -> _Fit:
    """The poles that explain the record best, from `poles`, the weights made anew by the model a few times."""
    w = np.abs(scene.s)
    low = np.tile(np.log([REACH[0] * w[0], DAMPINGS[0]]), len(poles))
    high = np.tile(np.log([REACH[1] * w[-1], DAMPINGS[1]]), len(poles))
    x = np.clip(poles.ravel(), low + 1e-9, high - 1e-9)
    sigma = np.abs(scene.tau) * 1e-3 + 1e-300
    for turn in range(1 + WEIGHT_PASSES):
        weights = sigma

        def residual(v: Array, weights: Array = weights) -> Array:
            return _projected(scene, v.reshape(-1, 2), weights)[1]

        def slope(v: Array, weights: Array = weights) -> Array:
            return _projected(scene, v.reshape(-1, 2), weights)[3]

        found = least_squares(residual, x, jac=slope, bounds=(low, high), max_nfev=10 if not turn else 40, x_scale=0.1)
        x = np.clip(found.x, low + 1e-9, high - 1e-9)
        c = _projected(scene, x.reshape(-1, 2), sigma)[0]
        if turn < WEIGHT_PASSES:
            sigma = _sigma(scene, x.reshape(-1, 2), c)
    poles = x.reshape(-1, 2)
    c, r, direct, _ = _projected(scene, poles, sigma)
    jacobian = np.concatenate([-_real(_columns(scene, poles) * (np.sqrt(2.0) / sigma)[:, None]), direct], axis=1)
    return _Fit(poles, c, float(r @ r), sigma, jacobian)


def _with_another(scene: _Scene, fit: _Fit) -> _Fit | None:
    """The fit with one mode more, all masses positive, at the first place where that is worth its parameters; else None."""
    found = None
    for place in _places(scene, fit):
        tried = _fitted(scene, np.vstack([fit.poles, place]))
        worth = fit.chi2 - tried.chi2 > WORTH * (2 + 2 * scene.x.shape[1])
        if worth and np.all(_masses(scene, tried) > 0.0):
            return tried
        found = found or tried
    return None if len(fit.poles) else found


def _places(scene: _Scene, fit: _Fit) -> list[Array]:
    """Where one more mode explains most of what the fit leaves, best first: (log w, log zeta) [2] each."""
    weight = (np.sqrt(2.0) / fit.sigma)[:, None]
    columns = _columns(scene, fit.poles)
    Q = np.linalg.qr(_real(columns * weight))[0]
    y = _real(scene.tau * weight[:, 0])
    r = y - Q @ (Q.T @ y)
    tried = []
    for w in np.geomspace(np.abs(scene.s[0]), np.abs(scene.s[-1]), TRIED):
        for zeta in (START_DAMPING, 5 * START_DAMPING):
            pole = np.log([[w, zeta]])
            own = _real(_columns(scene, pole)[:, 3:5] * weight)
            own = own - Q @ (Q.T @ own)
            tried.append((float(np.sum((np.linalg.qr(own)[0].T @ r) ** 2)), pole[0]))
    taken: list[Array] = []
    for _, pole in sorted(tried, key=lambda one: -one[0]):
        if all(abs(pole[0] - other[0]) > APART for other in [*fit.poles, *taken]):
            taken.append(pole)
        if len(taken) == PLACES:
            break
    return taken


def _mode_values(scene: _Scene, poles: Array, c: Array) -> tuple[Array, Array, Array, Array]:
    """a, b, damping c, w^2 [modes] of the excited joint's own amplitudes."""
    own = c[3:].reshape(len(poles), scene.x.shape[1], 2)[:, 0]
    w, zeta = np.exp(poles).T
    return own[:, 0], own[:, 1], 2 * zeta * w, w**2


def _masses(scene: _Scene, fit: _Fit) -> Array:
    """Modal masses [modes]: the s^2 term of every mode at s = 0, damping included."""
    a, b, c, w2 = _mode_values(scene, fit.poles, fit.c)
    return np.asarray(a / w2**2 - a * c**2 / w2**3 + b * c / w2**2)


def _values(scene: _Scene, fit: _Fit) -> Array:
    """The six parameters [6]: Z at s = 0 and far above, term by term.

    The constant of Z lacks what the spring's damping makes of the modes: with S = K + D_spring s the arm is S - S^2 /
    (..), which is nothing where S is, at s = -K / D_spring. S^2 and its slope are zero there: a rough K is enough to go
    there.
    """
    a, b, c, w2 = _mode_values(scene, fit.poles, fit.c)
    mass, damping, constant = fit.c[:3]
    N2 = scene.N**2
    D = damping - np.sum(b / w2 - a * c / w2**2)
    D_spring = damping - D
    K = constant + D_spring**2 * np.sum(a) / constant**2
    K = constant + np.sum(D_spring * (b * K - a * D_spring) / (K**2 - c * K * D_spring + w2 * D_spring**2))
    static = constant - np.sum(a / w2)  # the spring and gravity, one after the other
    K_g = K * static / (K - static)
    return np.array([mass / N2, K, np.sum(_masses(scene, fit)) * (1.0 + K_g / K) ** 2, D / N2, D_spring, K_g])


def _degrees(scene: _Scene, frf: Frf, fit: _Fit) -> tuple[int, float]:
    dof = 2 * len(scene.s) - len(fit.c) - fit.poles.size
    return dof, chi2_limit(dof, noise_dof(len(scene.s), frf.spacing, frf.periods), len(scene.s))


def _reading(scene: _Scene, frf: Frf, fit: _Fit, J: Array | None, campaign: Campaign) -> Modal:
    values = _values(scene, fit)
    step = np.concatenate([np.abs(fit.c) * 1e-6 + 1e-300, np.full(fit.poles.size, 1e-6)])
    size = len(fit.c)
    slopes = np.zeros((len(PARAMETERS), len(step)))
    for k, h in enumerate(step):
        sides = []
        for sign in (1.0, -1.0):
            moved = np.concatenate([fit.c, fit.poles.ravel()])
            moved[k] += sign * h
            sides.append(_values(scene, replace(fit, c=moved[:size], poles=moved[size:].reshape(-1, 2))))
        slopes[:, k] = (sides[0] - sides[1]) / (2 * h)
    scale = np.maximum(np.linalg.norm(fit.jacobian, axis=0), 1e-300)
    _, singular, V = np.linalg.svd(fit.jacobian / scale, full_matrices=False)
    half = (slopes / scale) @ (V.T / np.maximum(singular, singular[0] * 1e-10))
    covariance = half @ half.T
    dof, limit = _degrees(scene, frf, fit)
    chi2 = fit.chi2 / dof
    status = _status(frf, values, np.sqrt(np.diag(covariance)), chi2, limit, len(fit.poles), _above(frf, J, campaign))
    J_m, K, J_l, D, D_spring, K_g = map(float, values)
    G = np.array(frf.G)
    x = scene.x[:, 0] * (_columns(scene, fit.poles) @ fit.c) / scene.tau
    G[frf.usable] *= scene.x[:, 0] / x
    return Modal(
        frf.record, frf.joint, J_m, K, J_l, D, D_spring, K_g, covariance, float(chi2), dof, limit, bool(chi2 <= limit),
        status, np.exp(fit.poles[:, 0]) / (2 * np.pi), _masses(scene, fit), G,
    )  # fmt: skip


def anti_resonances(frf: Frf, J: Array, K: Array) -> tuple[Array, Array]:
    """Frequencies [k, Hz] and shares of J_ii of the anti-resonances that the excited motor sees.

    The other motors that moved stand still (where a link is locked itself none is held): J v = K v / w^2, and J_ii is
    the sum of these modal masses. `J` [n, n, kg m2], `K` [n] of the arm; nothing where one of these K is not known.
    """
    live = live_joints(frf)
    K, J = K[live], J[np.ix_(live, live)]
    i = int(np.flatnonzero(live == frf.index)[0])
    if not np.isfinite(K).all() or J[i, i] <= 0.0:
        return np.zeros(0), np.zeros(0)
    inverse, v = eigh(J, np.diag(K))
    return 1.0 / (2 * np.pi * np.sqrt(inverse)), inverse * (v[i] * K[i]) ** 2 / J[i, i]


def _above(frf: Frf, J: Array | None, campaign: Campaign) -> tuple[Array, Array]:
    """Those of the declared arm above the band."""
    if J is None:
        return np.zeros(0), np.zeros(0)
    f, share = anti_resonances(frf, J, campaign.K)
    hidden = f > frf.frequencies[-1]
    return f[hidden], share[hidden]


def _status(
    frf: Frf, values: Array, std: Array, chi2: float, limit: float, modes: int, above: tuple[Array, Array]
) -> tuple[str, ...]:
    where, lines = f"record {frf.record}, {frf.joint}: ", []
    if chi2 > limit:
        lines.append(f"{modes} modes do not explain the response: chi2/dof {chi2:.3g}, limit {limit:.3g}")
    for f, share in zip(*above, strict=True):
        if share > TOLD_SHARE:
            lines.append(
                f"an anti-resonance of the declared arm at {f:.4g} Hz, above the band, holds {100 * share:.2g} % of J_ii: it is "
                "read as motor inertia"
            )
    for k, name in enumerate(PARAMETERS[:3]):
        if std[k] > UNTOLD * abs(values[k]):
            lines.append(f"{name} not identifiable: {values[k]:.3g} with standard deviation {std[k]:.2g}")
    return tuple(where + line for line in lines)
