"""How many periods, how far apart the lines: what a precision of J(q) costs in robot time, from the Fisher information.

The declared arm tells what every motor would answer, its drives what noise comes with it; each further period of a record adds
the same information. Periods go where they lower the largest standard deviation of J(q) most, until it is small enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ident.arm.arm_fit import INFORMATION_ROUNDING
from ident.arm.arm_model import Parameters, Sampling, motion_and_derivatives, response
from ident.arm.coupled import problem_of, uncertainty
from ident.arm.descent import Minimum
from ident.arm.evidence import gravity_basis, posture_at
from ident.arm.whitening import Powers, whitening
from ident.errors import ExperimentError
from ident.identification.verdict import entry
from ident.joint.certainty import certainty
from ident.records.campaign import Array, Campaign
from ident.simulator.bench import head
from ident.simulator.design import STEADY, Setup, prepare
from ident.simulator.dob import close_loop
from ident.simulator.plant import build_plant, linearise
from symgen.plan import Model
from symgen.robot import MOST_SAMPLES, Robot, recordable

#: Line spacings [Hz] tried, besides the declared one. Wide apart is quick, but a period must hold the arm's slow motions.
SPACINGS = (0.1, 0.2, 0.5, 1.0, 2.0)
#: Variance of a record over that of its ideal: what taking leakage off may cost, and arms that are not as declared.
ALLOWANCE = 1.25
#: Settled periods of one record at most: what an hour can not buy is bought by another experiment.
MOST_PERIODS = 100


@dataclass(frozen=True)
class Precision:
    """A campaign for a precision: the `robot` with its line spacing, `periods` of each record (settling ones included) and
    the `seconds` that all take; `sigma` is the largest standard deviation of J_ij(q) over sqrt(J_ii J_jj) predicted. The `shortest` has
    no more periods than settle and tell noise."""

    robot: Robot
    periods: tuple[int, ...]
    seconds: float
    sigma: float
    shortest: bool = False

    @property
    def text(self) -> str:
        """One line for a person."""
        few, many = min(self.periods), max(self.periods)
        each = f"{few}" if few == many else f"{few} to {many}"
        return (
            f"predicted: sigma of J(q) at most {100 * self.sigma:.2g} % of sqrt(J_ii J_jj), from {len(self.periods)} records of "
            f"{each} periods of {1 / self.robot.experiment.f0:g} s: {self.seconds:.0f} s of robot time"
            + (", the least that settles and tells its noise" if self.shortest else "")
        )


def for_target(model: Model, robot: Robot, cells: Sequence[tuple[str, ArrayLike]], target: float, *, lock: str = "dob",
               seed: int = 0, realisations: int = 1) -> Precision:  # fmt: skip
    """Returns the campaign of `cells` that takes least robot time for a standard deviation of J(q) of `target`, relative to
    sqrt(J_ii J_jj), at any entry and posture; seed and realisations as `bench.design` has them. ExperimentError: out of reach, or as
    `design.prepare` says."""
    e, best, reasons = robot.experiment, None, {}
    others = {f0 for f0 in SPACINGS if f0 <= e.band[1] and recordable(e.fs, f0, STEADY)}
    for f0 in sorted({e.f0, *others}, reverse=True):  # wide ones are quick, and tell what narrow ones have to beat
        other = replace(robot, experiment=replace(e, f0=f0, band=(max(e.band[0], f0), e.band[1])))
        try:
            best = _with_spacing(model, other, cells, target, lock, seed, realisations, best) or best
        except ExperimentError as error:
            reasons[f0] = error
    if best is None:
        raise reasons[e.f0]
    return best


def _with_spacing(
    model: Model,
    robot: Robot,
    cells: Sequence[tuple[str, ArrayLike]],
    target: float,
    lock: str,
    seed: int,
    realisations: int,
    best: Precision | None,
) -> Precision | None:
    """The shortest campaign with the robot's own line spacing; None where it is no shorter than the `best`."""
    chain, e = model.chain, robot.experiment
    most = np.inf if best is None else best.seconds * e.f0 / realisations
    if len(cells) * (1 + STEADY) >= most:  # one period at least settles
        return None
    setups = []
    for (joint, q), cell in zip(cells, np.random.SeedSequence(seed).spawn(len(cells)), strict=True):
        rng = np.random.default_rng(cell.spawn(2)[0])
        setups.append(prepare(chain, robot, joint, q, lock=lock, rng=rng))
    empty = head(chain, robot, (), lock=lock)
    basis = gravity_basis(model, empty.gravity)
    drives = [robot.drive(name) for name in chain.names]
    K, J_m, D, D_spring = np.array([[d.K, d.J_m, d.D, d.D_spring] for d in drives]).T
    arm = Parameters(K, J_m, D, D_spring, model.alpha_cad, basis @ chain.parameters)
    problem = problem_of(empty, model, basis, (), arm)
    each = np.array([_information(model, robot, empty, basis, setup, arm, problem.scale) for setup in setups])
    each *= realisations / ALLOWANCE
    alphas = slice(4 * chain.n, 4 * chain.n + len(model.names))
    size = problem.scale[alphas]
    settling, steady = np.array([setup.settle for setup in setups]), np.full(len(setups), STEADY)
    while (settling + steady).sum() < most:
        whole = np.einsum("k,kab->ab", steady.astype(float), each)
        covariance, unseen, _ = uncertainty(problem, Minimum(arm.vector(), whole, 0.0, True))
        known = certainty(model, covariance, unseen)
        sigma = float(known.per_entry.max())
        fits = recordable(e.fs, e.f0, int((settling + steady).max()))
        if sigma <= target and fits:
            periods = tuple(np.repeat(settling + steady, realisations).tolist())
            return Precision(robot, periods, sum(periods) / e.f0, sigma, bool(np.all(steady == STEADY)))
        name, found = entry(*known.worst, chain.n), f"target {100 * target:g} %"
        if not np.isfinite(sigma):
            remedy = "more postures, or the other joints held by their motors (--lock dob), which are then read, too"
            raise ExperimentError(
                f"{found}: the records hold no information on {name}, however long they are; expected "
                f"{remedy if lock == 'rigid' else 'more postures'}"
            )
        if not fits or steady.max() >= MOST_PERIODS:
            long = "" if fits else f" (a record has at most {MOST_SAMPLES:g} samples), lines further apart"
            raise ExperimentError(
                f"{found}: {name} stays at {100 * sigma:.2g} % after {steady.max()} periods of {1 / e.f0:g} s; expected a larger "
                f"target{long}, more postures or a larger swing"
            )
        spread = np.linalg.pinv(whole, rcond=INFORMATION_ROUNDING, hermitian=True)[:, alphas]
        # the thin direction as the drives follow it: what else must be known to know alpha
        direction = spread @ np.linalg.lstsq(spread[alphas], known.direction / size, rcond=None)[0]
        steady = _more(steady, each, direction, sigma / target)
    return None


def _more(steady: Array, each: Array, direction: Array, excess: float) -> Array:
    """More periods for the records that see the thin `direction` [P] best: a tenth of what all have, by share, one at least."""
    seen = np.einsum("a,kab,b->k", direction, each, direction)
    best = seen >= 0.5 * seen.max()
    factor = min(max(excess**2, 1.0), 2.0) ** 0.25
    return np.where(best, np.maximum(steady + 1, np.round(steady * factor)), steady).astype(int)


def _information(
    model: Model, robot: Robot, empty: Campaign, basis: Array, setup: Setup, arm: Parameters, scale: Array
) -> Array:
    """What one settled period of a record tells of all parameters [P, P], per step of `scale`, were the arm as declared."""
    e, live = robot.experiment, np.array(setup.live)
    posture = posture_at(empty, model, basis, live, setup.posture)
    sampling = Sampling(setup.excitation.lines * e.f0, e.fs, empty.hold)
    tau = _torques(model, robot, setup, sampling.f)
    _, slopes = motion_and_derivatives(posture, arm, sampling, tau)
    drives = [robot.drive(model.chain.names[k]) for k in live]
    own = robot.drive(model.chain.names[setup.joint])
    amplitude = 4.0 / e.samples_per_period  # E|z|^2 of a line, as a peak amplitude, per variance of a sample
    noise = np.array([e.torque_noise * setup.excitation.rms * d.tau_max / own.tau_max for d in drives])
    step = np.array([2 * np.pi / d.encoder_counts for d in drives])
    G = response(posture, arm, sampling)
    angle = np.broadcast_to(amplitude * step**2 / 12.0, tau.shape)
    W = whitening(Powers(amplitude * noise**2, angle, G), np.zeros_like(tau))
    columns = posture.columns(model.chain.n)
    A = (W @ (slopes * scale[columns])).reshape(-1, len(columns))
    information = np.zeros((len(scale), len(scale)))
    information[np.ix_(columns, columns)] = 2.0 * (A.conj().T @ A).real
    return information


def _torques(model: Model, robot: Robot, setup: Setup, f: Array) -> np.ndarray:
    """The torques [L, live, N m] of all motors that move, at the lines `f` [L, Hz], under the record's controllers."""
    chain, e = model.chain, robot.experiment
    free = None if len(setup.live) == chain.n else setup.joint
    plant = build_plant(chain, [robot.drive(name) for name in chain.names], robot.gravity, setup.posture, free=free)
    loop = close_loop(*linearise(plant).sampled(1 / e.fs), setup.servos, 1 / e.fs)
    port = setup.live.index(setup.joint)
    spectrum = setup.excitation.spectrum
    torque = (loop.response(f, port) * spectrum[:, None]) @ loop.U.T
    torque[:, port] += spectrum
    return np.asarray(torque)
