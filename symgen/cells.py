"""Cells (i, q) - excite joint i at posture q - and their rows f_i(q) = C_i(q) / sigma_i(q): what a plan is chosen by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from symgen.basis import Factoring
from symgen.chain import REVOLUTE, Array, Joint, skew
from symgen.kinematics import energy_row, inertia_matrix, motion
from symgen.regressor import to_alpha

#: v' M v = (v v') . FORMS . phi: how the energy of a twist v depends on the ten parameters of its body [36, 10].
_FORMS = energy_row(np.eye(6)[:, None], np.eye(6)[None]).reshape(36, 10)

#: The same for the different entries of v v' alone: places of the two factors [21], and the forms [21, 10].
_ONE, _OTHER = np.triu_indices(6)
_HALF_FORMS = np.where(_ONE == _OTHER, 1, 2)[:, None] * _FORMS[6 * _ONE + _OTHER]

#: No J_ii counts as measured better than to this part of its largest over some postures: points on an axis have none.
_LEAST, _SOME = 1e-6, 32


#: Postures that stand for the whole workspace.
_WORKSPACE = 2000


@dataclass(frozen=True)
class Cells:
    """Measurements: cell k excites joint `joint[k]` (from 0) at `q[k]`; joint [N], q [N, n, rad or m]."""

    joint: NDArray[np.int64]
    q: Array

    def __len__(self) -> int:
        return len(self.joint)

    def __getitem__(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> Cells:
        return Cells(self.joint[index], self.q[index])

    def __add__(self, other: Cells) -> Cells:
        return Cells(np.concatenate([self.joint, other.joint]), np.concatenate([self.q, other.q]))


def spread(limits: Array, count: int, offset: float) -> Array:
    """Returns `count` postures [count, n] evenly spread over `limits` [n, 2]; another set for each `offset` in [0, 1).

    An additive low-discrepancy sequence: the golden ratio, generalised to n dimensions.
    """
    n = len(limits)
    phi = 2.0
    for _ in range(64):
        phi = (1 + phi) ** (1 / (n + 1))
    unit = (offset + np.arange(1, count + 1)[:, None] * phi ** -np.arange(1, n + 1)) % 1.0
    postures: Array = limits[:, 0] + (limits[:, 1] - limits[:, 0]) * unit
    return postures


def steady(values: Array, digits: int = 4) -> Array:
    """Returns the values rounded. Between one step of a search and the next this keeps the last bits, which differ from one
    processor to another, from growing into other plans."""
    rounded: Array = np.round(values, digits)
    return rounded


def ranked(values: Array, most: int | None = None) -> NDArray[np.int64]:
    """Returns the order of values [N], largest first, of all or of the `most` largest; those that agree to single precision
    (mirror images) by position."""
    falling = -values.astype(np.float32)
    if most is None or most >= len(falling):
        return np.argsort(falling, kind="stable")
    among = np.flatnonzero(falling <= np.partition(falling, most - 1)[most - 1])
    return among[np.argsort(falling[among], kind="stable")[:most]]


def every_joint(q: Array) -> Cells:
    """Returns the cells of all joints at postures q [m, n], posture by posture: [m n]."""
    m, n = q.shape
    return Cells(np.tile(np.arange(n), m), np.repeat(q, n, axis=0))


def _maps(joint: Joint) -> Array:
    """Maps of a twist (omega, u), as a row, from the link before a joint to the link behind it [6, 18].

    Side by side the coefficients of 1, c, s of a turning joint, of 1, q and nothing of a sliding one:
    omega' = R' omega, u' = R' (u + omega x p).
    """

    def shift(p: Array) -> Array:
        T = np.eye(6)
        T[:3, 3:] = skew(p)
        return T

    placed = shift(joint.p) @ np.kron(np.eye(2), joint.R)
    if joint.type == REVOLUTE:
        A0 = np.outer(joint.axis, joint.axis)
        parts = [np.kron(np.eye(2), A) for A in (A0, np.eye(3) - A0, skew(joint.axis))]
    else:
        parts = [np.eye(6), shift(joint.axis) - np.eye(6), np.zeros((6, 6))]
    return placed @ np.concatenate(parts, axis=1)


def _phi_of(v: Array) -> Array:
    """The rows [.., 10] with v' M v = row . phi of twists v [.., 6]."""
    by_entry = np.ascontiguousarray(v.reshape(-1, 6).T)
    return ((by_entry[_ONE] * by_entry[_OTHER]).T @ _HALF_FORMS).reshape(*v.shape[:-1], 10)


@dataclass(frozen=True)
class _Walk:
    """For body k and each cell: the twist `v[k]` [N, 6] when the cell's joint turns, in the frame of link k; the `parts[k]`
    [N, 3, 6] of it that the three maps give, and the `shares[k]` [N, 3] of these: 1, c, s or 1, q, 0."""

    v: Array
    parts: Array
    shares: Array


class Rows:
    """The scaled rows f_i(q) = C_i(q) / sigma_i(q) of a factoring, for the URDF's own constants and the drives' rotors.

    sigma_i(q) = J_ii(q) + rotor_i: to this the standard deviation of a measured J_ii is proportional, from (5) with a
    fixed relative error of the frequencies; it does not vanish with J_ii. `rotor` [n, kg m2 or kg, joint side] is N^2 J_m.
    """

    def __init__(self, factoring: Factoring, rotor: Array):
        self.factoring, self.rotor = factoring, rotor
        self._maps = [_maps(joint) for joint in factoring.chain.joints]
        self._motions = np.array([motion(factoring.chain, k) for k in range(factoring.chain.n)])
        self._turning = np.array([joint.type == REVOLUTE for joint in factoring.chain.joints])[:, None]
        self._to_alpha = to_alpha(factoring, factoring.d)
        inertia = inertia_matrix(factoring.chain, spread(factoring.chain.limits, _SOME, 0.5))
        self._least = _LEAST * np.einsum("mii->mi", inertia).max(axis=0)

    def __call__(self, q: Array, of: Factoring | None = None) -> Array:
        """All joints' rows at postures q [m, n]: [m, n, d]; with `of`, another factoring's rows in the same scaling."""
        chain, m = self.factoring.chain, len(q)
        P = np.column_stack([self._to_alpha if of is None else to_alpha(of, of.d), chain.parameters])
        phi, v, shares = np.zeros((chain.n, m, 10 * chain.n)), np.zeros((0, m, 6)), self._shares(q)
        for k in range(chain.n):
            parts = (v.reshape(-1, 6) @ self._maps[k]).reshape(k, m, 3, 6)
            moved = np.einsum("mf,imfx->imx", shares[k], parts)
            v = np.concatenate([moved, np.broadcast_to(self._motions[k], (1, m, 6))])
            phi[: k + 1, :, 10 * k : 10 * k + 10] = _phi_of(v)
        rows = np.empty((m, chain.n, P.shape[1] - 1))
        for i in range(chain.n):
            C = phi[i, :, 10 * i :] @ P[10 * i :]
            rows[:, i] = C[:, :-1] / np.maximum(C[:, -1:] + self.rotor[i], self._least[i])
        return rows

    @cached_property
    def workspace(self) -> Array:
        """The rows [m, n, d] at postures evenly spread over the whole limits."""
        return self(spread(self.factoring.chain.limits, _WORKSPACE, 0.123))

    def of_cells(self, cells: Cells, of: Factoring | None = None) -> Array:
        """One row a cell [N, d]; `of` as above."""
        phi, sigma = self._phi(cells, self._walk(cells))
        return phi @ (self._to_alpha if of is None else to_alpha(of, of.d)) / sigma

    def sizes(self, cells: Cells) -> Array:
        """The largest sum of magnitudes behind each column of the rows [d]: a column much smaller than this is rounding."""
        phi, sigma = self._phi(cells, self._walk(cells))
        sizes: Array = (np.abs(phi / sigma) @ np.abs(self._to_alpha)).max(axis=0)
        return sizes

    def traced(self, cells: Cells) -> tuple[Array, Callable[[Array], Array]]:
        """Rows F [N, d] of cells, and the function that takes dv/dF [N, d] of a number v to its slope dv/dq [N, n].

        The slope costs about as much as the rows: one walk along the arm out, one back (reverse accumulation).
        """
        chain, N = self.factoring.chain, len(cells)
        walk = self._walk(cells)
        phi, sigma = self._phi(cells, walk)
        F = phi @ self._to_alpha / sigma

        def slope(dF: Array) -> Array:
            by_phi = (dF @ self._to_alpha.T - (dF * F).sum(axis=1, keepdims=True) * chain.parameters) / sigma
            M = (by_phi.reshape(N, chain.n, 10).swapaxes(0, 1) @ _FORMS.T).reshape(chain.n, N, 6, 6)
            pull = 2 * (M @ walk.v[..., None])[..., 0]
            dv = np.einsum("kNf,kNfx->kNx", self._slopes(cells.q), walk.parts)
            out = np.zeros((N, chain.n))
            for k in reversed(range(1, chain.n)):
                out[:, k] = (pull[k] * dv[k]).sum(axis=1)
                pull[k - 1] += (walk.shares[k][:, :, None] * pull[k][:, None]).reshape(N, 18) @ self._maps[k].T
            return out

        return F, slope

    def _shares(self, q: Array) -> Array:
        """The shares [n, m, 3] of the three maps of each joint at postures q [m, n]."""
        x = q.T
        c, s = np.where(self._turning, np.cos(x), x), np.where(self._turning, np.sin(x), 0.0)
        return np.stack([np.ones(x.shape), c, s], axis=-1)

    def _slopes(self, q: Array) -> Array:
        """The derivatives [n, m, 3] of the shares by the joint's own q."""
        x = q.T
        c, s = np.where(self._turning, -np.sin(x), 1.0), np.where(self._turning, np.cos(x), 0.0)
        return np.stack([np.zeros(x.shape), c, s], axis=-1)

    def _walk(self, cells: Cells) -> _Walk:
        n, N = self.factoring.chain.n, len(cells)
        shares, v, parts = self._shares(cells.q), np.zeros((n, N, 6)), np.zeros((n, N, 3, 6))
        v[cells.joint, np.arange(N)] = self._motions[cells.joint]
        for k in range(1, n):  # a cell's joint is at rest before it turns: nothing is added to its own motion
            np.matmul(v[k - 1], self._maps[k], out=parts[k].reshape(N, 18))
            v[k] += np.einsum("Nf,Nfx->Nx", shares[k], parts[k])
        return _Walk(v, parts, shares)

    def _phi(self, cells: Cells, walk: _Walk) -> tuple[Array, Array]:
        """The rows over all bodies' parameters [N, 10 n], and sigma [N, 1]."""
        phi = _phi_of(walk.v).swapaxes(0, 1).reshape(len(cells), 10 * len(walk.v))
        sigma = np.maximum(phi @ self.factoring.chain.parameters + self.rotor[cells.joint], self._least[cells.joint])
        return phi, sigma[:, None]
