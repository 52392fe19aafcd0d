"""What a model leaves of each record in units of its noise, line by line, and what the declared arm would answer there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincinv

from ident.arm.acting import moved
from ident.arm.arm_fit import Problem, hold, residual, whitened_by
from ident.arm.arm_model import DRIVES, Parameters
from ident.arm.coupled import CoupledFit, evidence_of, problem_of
from ident.arm.evidence import Evidence, gravity_basis
from ident.arm.parts import degrees
from ident.arm.sliding import TURNS
from ident.records.campaign import Array, Campaign
from ident.records.frf import Complex, Frf
from symgen.plan import Model

#: Noise alone puts one line in a thousand above its limit.
CONFIDENCE = 0.999


@dataclass(frozen=True)
class Misfit:
    """What is left of one record: `size` [F] at the lines `f` [F, Hz], rms over the `motors` that were fitted, 1 where noise alone
    is left."""

    f: Array
    size: Array
    motors: int

    @property
    def limit(self) -> float:
        """What noise alone exceeds at one line in a thousand: of complex numbers of unit variance the mean square is gamma distributed."""
        return float(np.sqrt(gammaincinv(self.motors, CONFIDENCE) / self.motors))


@dataclass(frozen=True)
class Whole:
    """A record beside a fit of all motors: its `misfit`, its share `chi2_per_dof` of that of the fit, and `declared` [L], theta / tau of
    the excited motor by datasheet and CAD for the torques that were measured; NaN at lines that are not usable."""

    misfit: Misfit
    chi2_per_dof: float
    declared: Complex


def of_response(frf: Frf, G: Complex) -> Misfit:
    """Returns what the response G [L, rad per N m] of the excited motor alone leaves of the one measured."""
    use = frf.usable
    return Misfit(frf.frequencies[use], np.abs(frf.G - G)[use] / np.sqrt(frf.variance[use]), 1)


def of_coupled(campaign: Campaign, model: Model, fit: CoupledFit) -> tuple[Whole, ...]:
    """Returns what a fit of all motors leaves of each record, as it weighs them: torque noise of all motors through the arm, and angle
    noise. The records' chi2_per_dof, weighted by their numbers, are the fit's.

    Drives that no datasheet tells, and dampings, are the fitted ones in the declared arm, too.
    """
    basis = gravity_basis(model, campaign.gravity)
    data = evidence_of(campaign, model, basis, fit.responses, fit.every)
    fitted = Parameters(fit.K, fit.J_m, fit.D, fit.D_spring, fit.alpha, fit.gravity)
    problem, vector = problem_of(campaign, model, basis, data, fitted), fitted.vector()
    problem = replace(problem, turns=TURNS if fit.every else 0)
    share = degrees(data) / fit.dof
    K, J_m, D, D_spring = (_known(getattr(campaign, name), getattr(fit, name)) for name in DRIVES)
    declared = Parameters(K, J_m, D, D_spring, model.alpha_cad, basis @ model.chain.parameters).vector()
    found = []
    for one, kept, frf in zip(data, hold(problem, vector), fit.responses, strict=True):
        left = whitened_by(kept.W, residual(problem, vector, one, kept.moved)[0])
        power = np.mean(np.abs(left) ** 2, axis=1)
        misfit = Misfit(one.sampling.f, np.sqrt(power), left.shape[1])
        found.append(Whole(misfit, float(power.mean()) * share, _response(problem, declared, one, frf)))
    return tuple(found)


def _response(problem: Problem, vector: Array, one: Evidence, frf: Frf) -> Complex:
    """theta / tau [L] of the excited motor of the arm at `vector`, for the torques measured."""
    scene, place = one.scene, one.place
    left = residual(problem, vector, one, moved(scene, problem.parameters(vector), ()))[0]
    G = np.full(len(frf.frequencies), np.nan, dtype=complex)
    G[np.isin(frf.frequencies, one.sampling.f)] = ((scene.theta - left)[:, place] / scene.tau[:, place])[one.is_excited]
    return G


def _known(declared: Array, fitted: Array) -> Array:
    return np.where(np.nan_to_num(declared) > 0.0, declared, fitted)
