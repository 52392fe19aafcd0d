"""Several records of one joint share its motor and its spring: K and J_m are one number each, J_l is one a posture.

Reading K and J_m anew at every posture throws knowledge away: where J_l is a few percent of N^2 J_m the split of the
frequencies tells J_l badly, while f_AR and a K known from other postures tell it well (J_l = K / (4 pi^2 f_AR^2), (6)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.joint.fit import PARAMETERS, JointFit
from ident.joint.solve import Combined, combine, noise_allows
from ident.records.campaign import Array

_SHARED = ("K", "J_m")


@dataclass(frozen=True)
class SharedDrive:
    """One joint: `K` [N m/rad] and `D_spring` [N m s/rad] joint side, `J_m` [kg m2] and `D` [N m s/rad] motor side, and
    J_l of its R records.

    `J_l` [R, kg m2] with `covariance` [R, R]. `chi2` over `dof` tells whether one K and one J_m explain all records;
    where not (`agrees` false), each record keeps its own reading, as the paper does, and nothing is shared.
    """

    joint: str
    K: Combined
    J_m: Combined
    D: Combined
    D_spring: Combined
    J_l: Array
    covariance: Array
    chi2: float
    dof: int
    agrees: bool


def share(joint: str, fits: Sequence[JointFit]) -> SharedDrive:
    """Returns what the fits [R] of one joint's records say together: generalised least squares on (K, J_m, J_l) of each.

    A record that its model does not explain enters with its covariance times its chi^2 per degree of freedom.
    """
    use = [PARAMETERS.index(name) for name in (*_SHARED, "J_l")]
    values = np.array([fit.parameters[use] for fit in fits])
    inflation = np.array([1.0 if fit.explained else fit.chi2_per_dof for fit in fits])
    covariances = np.array([fit.covariance[np.ix_(use, use)] for fit in fits]) * inflation[:, None, None]
    combined = {
        name: combine([getattr(fit, name) for fit in fits], [_std(fit, name) for fit in fits])
        for name in ("K", "J_m", "D", "D_spring")
    }
    R, dof = len(fits), 2 * (len(fits) - 1)
    scale = np.concatenate([values[0, :2], values[:, 2]])
    information, right, weights = np.zeros((R + 2, R + 2)), np.zeros(R + 2), []
    for r in range(R):
        pick = np.array([0, 1, 2 + r])
        relative = covariances[r] / np.outer(scale[pick], scale[pick])
        weight = np.linalg.inv(relative)
        weights.append(weight)
        information[np.ix_(pick, pick)] += weight
        right[pick] += weight @ (values[r] / scale[pick])
    covariance = np.linalg.inv(information)
    x = covariance @ right
    misfit = 0.0
    for r, weight in enumerate(weights):
        pick = np.array([0, 1, 2 + r])
        off = values[r] / scale[pick] - x[pick]
        misfit += float(off @ weight @ off)
    agrees = dof == 0 or misfit <= noise_allows(dof)
    if not agrees:
        own = np.diag(covariances[:, 2, 2])
        return SharedDrive(joint, **combined, J_l=values[:, 2], covariance=own, chi2=misfit, dof=dof, agrees=False)
    std = np.sqrt(np.diag(covariance)) * scale
    for k, name in enumerate(_SHARED):
        old = combined[name]
        combined[name] = Combined(float(x[k] * scale[k]), float(std[k]), old.chi2, old.dof, old.agrees, old.spread)
    J_l, spread = (x * scale)[2:], (covariance * np.outer(scale, scale))[2:, 2:]
    return SharedDrive(joint, **combined, J_l=J_l, covariance=spread, chi2=misfit, dof=dof, agrees=True)


def _std(fit: JointFit, name: str) -> float:
    return float(fit.std_inflated[PARAMETERS.index(name)])
