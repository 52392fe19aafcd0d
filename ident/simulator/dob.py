"""What keeps the joints in place during a record: locks, the soft hold of the excited joint, and whether both are stable."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, inf, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from ident.errors import ExperimentError

Array = NDArray[np.float64]

#: Damping ratio of the lock on its nominal inertia, the bare rotor. A load r times the rotor oscillates near the PD's
#: bandwidth unless (2 d w + g)(w + 2 d g) > (1 + r) g w (Routh, PD at w, observer at g): at 5 and 30 Hz, r < 11 with
#: d = 0.7, r < 17 with d = 1. Random postures of a Panda need the latter.
LOCK_DAMPING = 1.0

#: Damping ratio of the hold on rotor and load together.
HOLD_DAMPING = 0.7

#: The hold is at least this many times stiffer than gravity: softer, an arm falls to another equilibrium and stays periodic.
GRAVITY_MARGIN = 3.0

#: Gravity that is off by this share of the preload moves the excited joint by no more than this, if it turns [rad] or slides [m].
GRAVITY_ERROR, SAGS, SLIDES = 0.25, 0.04, 0.01

#: Lowest bandwidth of the hold [Hz]: it lets transients die within a few seconds and stays well below the first mode.
HOLD_BANDWIDTH = 0.5

#: What helps where the hold of the excited joint is not safe.
HOLD_REMEDY = "raise the sampling rate, check K_Nm_per_rad (K_N_per_m) and J_m_kgm2, or another posture"

_FAST = 0.1  # a mode that falls to a tenth within one sample has no resonance
_OBSERVED = 1e-9  # below this |S| at rest there is an observer: its gain is infinite there, and no factor makes it less


@dataclass(frozen=True)
class Servo:
    """Controller of one motor, all motor side: stiffness kp [N m/rad], damping kd [N m s/rad], and a disturbance observer
    of cut-off `dob` [rad/s, 0: none] with first-order Q on the one-mass nominal model 1/(J s^2), J [kg m2].

    With e = theta - rest, w the backward difference of e, and u the torque beyond the preload:
    z = a z_before + (1 - a) (u_before + dob J w), a = exp(-dob Ts);  u = -kp e - kd w + (z - dob J w).
    """

    kp: float
    kd: float
    J: float = 0.0
    dob: float = 0.0


def lock_servo(J_m: float, f_pd: float, f_dob: float, damping: float = LOCK_DAMPING) -> Servo:
    """A PD of bandwidth f_pd [Hz] and this damping ratio, and an observer of f_dob [Hz], on the rotor J_m [kg m2] alone.

    The paper's two-mass nominal (its Fig. 7) is stable only where the arm is decoupled; the rotor's is stable on coupled
    arms too, if f_dob stays well above f_pd.
    """
    w = 2 * pi * f_pd
    return Servo(kp=J_m * w * w, kd=2 * damping * J_m * w, J=J_m, dob=2 * pi * f_dob)


def hold_servo(
    N: float,
    inertia: float,
    gravity_stiffness: float,
    damping: float = 0.0,
    spring: float = inf,
    gravity: float = 0.0,
    sags: float = SAGS,
) -> Servo:
    """A soft PD for the excited joint: `inertia` [kg m2], `gravity_stiffness` dG_i/dq_i [N m/rad, negative where the link
    falls], the motor's own `damping` N^2 D [N m s/rad] and the `spring` K [N m/rad] joint side. Heavy damping needs a stiffer
    hold: the joint creeps back at stiffness/damping. So does the `gravity` [N m] that the preload bears, which is not known well:
    an error `GRAVITY_ERROR` of it moves the joint by `sags` [rad] at most.

    A link that falls feels hold and spring in series: k K/(k + K) is to be `GRAVITY_MARGIN` |dG/dq|. ExperimentError where
    the spring alone is softer than that.
    No integral action during the record: it would eat the lowest lines. It has acted before, and its result is the preload.
    """
    w, needed = 2 * pi * HOLD_BANDWIDTH, GRAVITY_MARGIN * abs(gravity_stiffness)
    if gravity_stiffness < 0:
        if spring <= needed:
            raise ExperimentError(
                f"its spring of {spring:.4g} N m/rad does not hold its link, which gravity pushes away with "
                f"{-gravity_stiffness:.3g} N m/rad, expected more than {GRAVITY_MARGIN:g} times that; a stiffer spring or "
                "another posture"
            )
        needed /= 1 - needed / spring
    stiffness = max(needed, inertia * w**2, damping * w, GRAVITY_ERROR * abs(gravity) / sags)
    return Servo(kp=stiffness / N**2, kd=2 * HOLD_DAMPING * sqrt(stiffness * inertia) / N**2)


def controller(
    servos: Sequence[Servo], rest: Sequence[float], preload: Sequence[float], Ts: float
) -> Callable[[Sequence[float]], list[float]]:
    """Returns the function to be called once a sample: motor angles [n, rad] in, motor torques [n, N m] out.

    `rest` [n, rad] and `preload` [n, N m] are angle and torque at rest, where the controller starts; Ts [s]. Plain floats:
    this runs a million times a campaign.
    """
    gains = [_gains(servo, Ts) for servo in servos]
    joints = range(len(gains))
    before = list(rest)
    u = [0.0] * len(gains)
    z = [0.0] * len(gains)
    rate = 1.0 / Ts

    def command(theta: Sequence[float]) -> list[float]:
        for i in joints:
            kp, kd, gJ, a, b = gains[i]
            w = (theta[i] - before[i]) * rate
            before[i] = theta[i]
            z[i] = a * z[i] + b * (u[i] + gJ * w)
            u[i] = z[i] - (kd + gJ) * w - kp * (theta[i] - rest[i])
        return [u[i] + preload[i] for i in joints]

    return command


@dataclass(frozen=True)
class ClosedLoop:
    """x+ = A x + B r, tau = U x + r: the sampled plant (first states) under its servos; r [n, N m] added to the torques."""

    A: Array
    B: Array
    U: Array
    Ts: float

    @property
    def growth(self) -> float:
        """Growth rate [1/s] of the slowest mode, log(spectral radius)/Ts: negative is stable."""
        return float(np.log(np.abs(np.linalg.eigvals(self.A)).max()) / self.Ts)

    def sensitivity(self, frequency: Array) -> NDArray[np.complex128]:
        """S = 1/(1 + L) [F, n] at each frequency [F, Hz], L the loop opened at one motor while the others stay closed."""
        z = np.exp(2j * np.pi * frequency * self.Ts)
        states = np.linalg.solve(z[:, None, None] * np.eye(len(self.A)) - self.A, self.B.astype(complex))
        return np.asarray(1 + np.einsum("is,fsi->fi", self.U, states))

    def response(self, frequency: NDArray[np.floating], joint: int) -> NDArray[np.complex128]:
        """States per unit of r at motor `joint`, at each frequency [L, Hz]: [L, states]."""
        z = np.exp(2j * np.pi * frequency * self.Ts)
        eye = np.eye(len(self.A))
        return np.linalg.solve(z[:, None, None] * eye - self.A, self.B[:, [joint]].astype(complex))[..., 0]


def close_loop(A: Array, B: Array, C: Array, servos: Sequence[Servo], Ts: float) -> ClosedLoop:
    """Closes sampled plant x+ = A x + B tau, theta = C x (A [s, s], B [s, n], C [n, s]) with the servos of `controller`.

    Each servo brings three states: the angle, the torque and the observer state of the sample before.
    """
    n, s = C.shape
    kp, kd, gJ, a, b = (np.diag(v) for v in np.array([_gains(servo, Ts) for servo in servos]).T)
    eye, none = np.eye(n), np.zeros((n, n))
    rate = np.hstack([C, -eye, none, none]) / Ts
    position = np.hstack([C, none, none, none])
    observed = a @ np.hstack([np.zeros((n, s)), none, none, eye])
    observed += b @ (np.hstack([np.zeros((n, s)), none, eye, none]) + gJ @ rate)
    U = observed - (kd + gJ) @ rate - kp @ position
    plant = np.hstack([A, np.zeros((s, 3 * n))]) + B @ U
    # the excitation r is added behind the servo: the observer does not know of it, and the excited joint has none
    return ClosedLoop(np.vstack([plant, position, U, observed]), np.vstack([B, np.zeros((3 * n, n))]), U, Ts)


@dataclass(frozen=True)
class Margins:
    """How far the loops are from instability, each opened at one motor: the worst of all motors.

    A motor's gain may be multiplied by anything from `gain_down` to `gain_up` (1), its phase turned by `phase` [deg], its
    torque come `delay` [s] later; `distance` is the least |1 + L|: it bears gain and phase at once.
    """

    gain_down: float
    gain_up: float
    phase: float
    distance: float
    delay: float


def margins(loop: ClosedLoop) -> Margins:
    """Returns the margins of a stable sampled loop, all joints coupled; infinite, zero or 180 deg where nothing is crossed.

    Read on frequencies as close as the resonances of the closed loop are narrow, and interpolated between them; at zero
    and half the sampling frequency L is real without crossing anything.
    """
    poles = np.linalg.eigvals(loop.A)
    poles = poles[(np.abs(poles) > _FAST) & (poles.imag >= 0)]
    centre, width = np.angle(poles), -np.log(np.abs(poles))
    around = (centre[:, None] + width[:, None] * np.array([-3, -1, -0.5, -0.2, 0, 0.2, 0.5, 1, 3])).ravel()
    w = np.unique(np.concatenate([np.geomspace(1e-5 * pi, pi, 150), around[(around > 1e-5) & (around < pi)]]))
    S = loop.sensitivity(w / (2 * pi * loop.Ts))
    L = 1 / S - 1
    k, i, part = _crossings(np.log(np.abs(L)))
    turn = np.angle(L[k, i] * (L[k + 1, i] / L[k, i]) ** part)
    delay = (turn + pi) % (2 * pi) / (w[k] + part * (w[k + 1] - w[k]))
    k, i, part = _crossings(L.imag)
    ends = loop.sensitivity(np.array([0.0, 0.5 / loop.Ts])).real
    real = np.concatenate(
        [L[k, i].real + part * (L[k + 1, i].real - L[k, i].real), 1 / ends[np.abs(ends) > _OBSERVED] - 1]
    )
    factors = -1 / real[real < 0]
    return Margins(
        float(factors[factors < 1].max(initial=0.0)),
        float(factors[factors > 1].min(initial=np.inf)),
        float(180 - np.degrees(np.abs(turn)).max(initial=0.0)),
        float(1 / max(np.abs(S).max(), np.abs(ends).max())),
        float(delay.min(initial=np.inf) * loop.Ts),
    )


def _crossings(values: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """(k, i, part): between rows k and k + 1, at `part` of the way, column i of values [F, n] passes zero."""
    k, i = np.nonzero(values[:-1] * values[1:] < 0)
    return k, i, values[k, i] / (values[k, i] - values[k + 1, i])


def _gains(servo: Servo, Ts: float) -> tuple[float, float, float, float, float]:
    """kp, kd, dob J, and z = a z_before + b (..) of the observer; without one z stays zero."""
    a = exp(-servo.dob * Ts)
    return (servo.kp, servo.kd, servo.dob * servo.J, *((a, 1.0 - a) if servo.dob else (0.0, 0.0)))


def check_stable(loop: ClosedLoop, where: str) -> float:
    """Returns the growth rate [1/s]; ExperimentError, beginning with `where` (joint and posture), if it is not negative."""
    growth = loop.growth
    if not growth < 0:
        raise ExperimentError(
            f"{where}: the sampled hold is unstable (growth rate {growth:+.3g} 1/s, expected < 0); {HOLD_REMEDY}"
        )
    return growth
