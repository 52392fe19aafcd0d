"""The numbers of a record that a fit of the whole arm takes: lines, spectra, noise, the arm at its posture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ident.arm.arm_model import Posture, Sampling
from ident.arm.scene import Scene, Slopes
from ident.arm.whitening import Noise
from ident.errors import IdentError
from ident.records.campaign import Array, Campaign
from ident.records.frf import ROUNDING, Frf, noise_dof
from ident.records.left_out import silenced
from symgen.plan import Model

#: Step [rad or m] of the fourth-order differences that give dJ/dq: error h^4 / 30 and rounding 1e-16 / h.
DIFFERENCE = 2e-3
#: Random postures that show what the gravity stiffness depends on.
PROBES = 200
#: Other postures that are kept, for a fit that comes back to them.
RECENT = 64


@dataclass(frozen=True, eq=False)
class Evidence:
    """One record, ready to be fitted: the joints that move, at L lines. `index` among the records, `excited` joint and
    `is_excited` [L] lines; `noise_dof` degrees of freedom of its noise powers. Only lines `judged` [L] count; None: all."""

    index: int
    excited: int
    is_excited: NDArray[np.bool_]
    scene: Scene
    sampling: Sampling
    noise: Noise
    noise_dof: float
    judged: NDArray[np.bool_] | None = None

    @property
    def use(self) -> NDArray[np.bool_]:
        """The lines [L] that count."""
        return np.ones(len(self.sampling.f), dtype=bool) if self.judged is None else self.judged

    @property
    def place(self) -> int:
        """Where the excited joint is among those that move."""
        return int(np.flatnonzero(self.scene.arm.live == self.excited)[0])

    @property
    def count(self) -> int:
        """How many lines count."""
        return int(self.use.sum())


def gravity_basis(model: Model, gravity: Array) -> Array:
    """Returns the orthonormal rows [r, 10 n] with which the gravity stiffness is a function of `basis` . phi."""
    q = model.random_postures(PROBES, np.random.default_rng(0))
    rows = model.gravity_stiffness_rows(q, gravity).reshape(-1, 10 * model.chain.n)
    _, singular, V = np.linalg.svd(rows, full_matrices=False)
    return V[: int(np.sum(singular > 1e-9 * max(singular[0], 1e-9)))]


def evidence(campaign: Campaign, model: Model, basis: Array, frf: Frf, index: int, lines: str) -> Evidence:
    """Returns record `index`, its response `frf`, at its "usable" excited `lines`, all "excited" ones or "every" one of its band.

    With "every" the rigid-body terms of second order act too. Raises IdentError for a record without usable lines.
    """
    if not frf.usable.any():
        raise IdentError(f"record {frf.record}: no line is usable; expected torque of {frf.joint} above its noise")
    live, band = live_joints(frf), frf.band
    if band is None:
        raise IdentError(f"record {frf.record}: its spectra are missing; expected those of estimate()")
    usable = np.zeros(len(band.lines), dtype=bool)
    usable[np.flatnonzero(band.excited)[frf.usable]] = True
    use = {"usable": usable, "excited": band.excited, "every": np.ones_like(usable)}[lines]
    arm, record = posture_at(campaign, model, basis, live, frf.posture), campaign.records[index]
    samples = band.noise[:, use][:, :, np.concatenate([live, frf.n + live])]
    floors = np.stack([ROUNDING * np.abs(band.tau[:, live]).max(axis=0), np.sqrt(frf.floor[live])]) + 1e-300
    errors = np.sqrt(np.mean(np.abs(samples) ** 2, axis=(0, 1))).reshape(2, -1)
    scene = Scene(
        arm=arm,
        n=frf.n,
        lines=band.lines[use],
        f0=band.f0,
        fs=campaign.fs,
        hold=campaign.hold,
        tau=band.tau[use][:, live],
        theta=band.theta[use][:, live],
        noise=np.maximum(errors, floors),
        means=np.stack([band.mean_tau, band.mean_theta]),
        posture=frf.posture,
        N=campaign.N,
        beyond=(band.beyond[0], band.beyond[1][:, live], band.beyond[2][:, live]),
        slopes=_slopes(campaign, model, basis, live, frf.posture) if lines == "every" else None,
        kept=silenced(record, frf) if lines == "every" else None,
        chain=model.chain,
        gravity=campaign.gravity,
    )
    spacing = 1 if lines == "every" else frf.spacing
    return Evidence(
        index, frf.index, band.excited[use], scene, Sampling(scene.f0 * scene.lines, campaign.fs, campaign.hold),
        Noise(samples, band.floor[use][:, live]), noise_dof(len(scene.lines), spacing, frf.periods),
    )  # fmt: skip


def posture_at(campaign: Campaign, model: Model, basis: Array, live: NDArray[np.int64], q: Array) -> Posture:
    """The rows of J and of the gravity stiffness of the `live` joints at posture q [n]."""
    square = np.ix_(live, live)
    K_rows = model.gravity_stiffness_rows(q, campaign.gravity) @ basis.T
    return Posture(live, campaign.N[live], model.J_rows(q)[square], K_rows[square])


def scenes_of(campaign: Campaign, model: Model, basis: Array) -> Callable[[Scene, Array], Scene]:
    """What makes of a record's scene the same at another posture q [n]."""

    @lru_cache(maxsize=RECENT)
    def arm_at(live: tuple[int, ...], q: tuple[float, ...], moves: bool) -> tuple[Posture, Slopes | None]:
        where = campaign, model, basis, np.array(live), np.array(q)
        return posture_at(*where), _slopes(*where) if moves else None

    def scene_at(scene: Scene, q: Array) -> Scene:
        arm, slopes = arm_at(tuple(scene.arm.live.tolist()), tuple(q.tolist()), scene.slopes is not None)
        return replace(scene, arm=arm, posture=q, slopes=slopes)

    return scene_at


def _slopes(campaign: Campaign, model: Model, basis: Array, live: NDArray[np.int64], q: Array) -> Slopes:
    """d/dq_k of the rows of J [m, m, m, D] and of the gravity stiffness [m, m, m, r], k first, of the live joints."""
    steps = DIFFERENCE * np.array([-2.0, -1.0, 1.0, 2.0])
    weights = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * DIFFERENCE)
    at = q + steps[:, None, None] * np.eye(len(q))[live]  # 4, m, n
    square = np.ix_(np.arange(len(live)), live, live)
    J = np.einsum("a,akijd->kijd", weights, model.J_rows(at))[square]
    K = np.einsum("a,akijd->kijd", weights, model.gravity_stiffness_rows(at, campaign.gravity))[square] @ basis.T
    return J, K


def live_joints(frf: Frf) -> NDArray[np.int64]:
    """Returns the joints that take part: all but those whose torque is constant and whose angle shows a flicker at most."""
    n = frf.n
    power = np.mean(np.abs(np.hstack([frf.tau, frf.theta])) ** 2, axis=0) + np.mean(np.abs(frf.noise) ** 2, axis=(0, 1))
    still = np.concatenate([np.zeros(n), 16.0 * frf.floor]) + ROUNDING**2 * np.repeat(
        power[[frf.index, n + frf.index]], n
    )
    clamped = (power <= still).reshape(2, n).all(axis=0)
    clamped[frf.index] = False
    return np.flatnonzero(~clamped)
