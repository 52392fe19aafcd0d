"""What an effect adds to the dynamic stiffness of (theta/N, q) [S, 2n, 2n], and who feels what gives in the structure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.effects.base import Array, Complex
from symgen.chain import REVOLUTE, Chain, placements, readonly, skew


def at_link(z: Complex, joint: int | None, n: int) -> Complex:
    """z [S] on the link of a joint, nothing elsewhere."""
    assert joint is not None
    result = np.zeros((len(z), 2 * n, 2 * n), dtype=complex)
    result[:, n + joint, n + joint] = z
    return result


def at_spring(z: Complex, joint: int | None, n: int) -> Complex:
    """z [S] between motor and link of a joint, nothing elsewhere."""
    assert joint is not None
    result = np.zeros((len(z), 2 * n, 2 * n), dtype=complex)
    for a, b, sign in (
        (joint, joint, 1.0),
        (n + joint, n + joint, 1.0),
        (joint, n + joint, -1.0),
        (n + joint, joint, -1.0),
    ):
        result[:, a, b] = sign * z
    return result


@dataclass(frozen=True, eq=False)
class Sprung:
    """k more coordinates, each on its own spring, that move links along: `coupling` C [k, n] and `inertia` M [k, k] in kg m2,
    `stiffness`, `damping` [k]; `weight` (V [k, n], W [k, k]) the stiffness [N m/rad] that gravity adds, if any."""

    coupling: Array
    inertia: Array
    stiffness: Array
    damping: Array
    weight: tuple[Array, Array] | None = None

    def blocks(self, s: Complex) -> tuple[Complex, Complex]:
        """Their dynamic stiffness with the links, B = s^2 C + V [S, k, n], and their own, s^2 M + s d + k + W [S, k, k]."""
        V, W = self.weight or (np.zeros(self.coupling.shape), np.zeros(self.inertia.shape))
        own = s[:, None, None] ** 2 * self.inertia + W
        k = np.arange(len(self.inertia))
        own[:, k, k] += s[:, None] * self.damping + self.stiffness
        return np.asarray(s[:, None, None] ** 2 * self.coupling + V), np.asarray(own, dtype=complex)

    def on_links(self, s: Complex) -> Complex:
        """What they do to the links, -B^T (s^2 M + s d + k + W)^-1 B. That of C's own share in J(q), if it is new, is the
        caller's to add."""
        both, own = self.blocks(s)
        n = self.coupling.shape[1]
        result = np.zeros((len(s), 2 * n, 2 * n), dtype=complex)
        result[:, n:, n:] = -np.swapaxes(both, 1, 2) @ np.linalg.solve(own, both)
        return result

    def carried_along(self, s: Complex, q: Complex) -> Complex:
        """Their motion [S, k] when the links move by q [S, n]."""
        both, own = self.blocks(s)
        return np.asarray(-np.linalg.solve(own, both @ q[..., None])[..., 0])

    def passed_on(self, s: Complex, on_links: Complex, on_own: Complex) -> Complex:
        """All that the links feel [S, n] of forces on them and of forces [S, k] on what gives."""
        both, own = self.blocks(s)
        return np.asarray(on_links - (np.swapaxes(both, 1, 2) @ np.linalg.solve(own, on_own[..., None]))[..., 0])


@dataclass(frozen=True, eq=False)
class Posed:
    """The joints of a chain at a posture: their twists [n, 6] (velocity at the base's origin, angular velocity; base axes), the frames
    (R [n, 3, 3], p [n, 3]) of their links, and how these move with the base [n, 6, 6]: what turns a twist of the base into
    one in the link's own frame. Arrays are read only."""

    twists: Array
    R: Array
    p: Array
    carried: Array

    @staticmethod
    def of(chain: Chain, q: Array) -> Posed:
        R, p = np.eye(3), np.zeros(3)
        rows, turned, origins, carried = [], [], [], []
        for joint, (turn, shift) in zip(chain.joints, placements(chain, np.asarray(q)[None]), strict=True):
            R, p = R @ turn[0], p + R @ shift[0]
            axis = R @ joint.axis
            rows.append(np.concatenate([skew(p) @ axis, axis] if joint.type == REVOLUTE else [axis, np.zeros(3)]))
            turned.append(R)
            origins.append(p)
            carried.append(np.block([[R.T, -R.T @ skew(p)], [np.zeros((3, 3)), R.T]]))
        return Posed(readonly(rows), readonly(turned), readonly(origins), readonly(carried))


#: Those that were asked for last: a fit asks for the postures of its records again and again.
_POSED: dict[tuple[bytes, bytes], Posed] = {}
MOST_POSED = 1000

#: The inertia [6, 6] of a body for (velocity at the origin, angular velocity) of its frame, of each of its ten parameters [10, 6, 6].
_OF_PARAMETERS = np.zeros((10, 6, 6))
_OF_PARAMETERS[0, :3, :3] = np.eye(3)
for _k in range(3):
    _OF_PARAMETERS[1 + _k, :3, 3:] = -skew(np.eye(3)[_k])
    _OF_PARAMETERS[1 + _k, 3:, :3] = skew(np.eye(3)[_k])
for _k, (_i, _j) in enumerate(((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))):
    _OF_PARAMETERS[4 + _k, 3 + _i, 3 + _j] = _OF_PARAMETERS[4 + _k, 3 + _j, 3 + _i] = 1.0


def posed(chain: Chain, q: Array) -> Posed:
    """The joints of a chain at posture q [n]."""
    key = (chain.places, np.asarray(q, dtype=float).tobytes())
    found = _POSED.get(key)
    if found is None:
        if len(_POSED) >= MOST_POSED:
            _POSED.clear()
        found = _POSED[key] = Posed.of(chain, q)
    return found


def _bodies(chain: Chain, at: Posed) -> Array:
    """The inertia [n, 6, 6] of the bodies of a chain for twists of the base."""
    own = (chain.parameters.reshape(-1, 10) @ _OF_PARAMETERS.reshape(10, 36)).reshape(-1, 6, 6)
    return np.asarray(np.swapaxes(at.carried, 1, 2) @ own @ at.carried)


def coupling(chain: Chain, q: Array, motion: Array, link: int = 0, share: float = 1.0) -> tuple[Array, Array]:
    """Returns (C [k, n], M [k, k]): the inertia that k more motions share with the joints, and their own [kg m2].

    `motion` [k, 6]: twists, as those of `Posed`, that move a `share` of the body of `link` (from 0) and all links behind
    it.
    """
    joints, carried = _carried(chain, q, link, share)
    behind = carried[np.maximum(np.arange(chain.n), link)]
    return motion @ (behind @ joints[..., None])[..., 0].T, motion @ carried[link] @ motion.T


def weighed(
    chain: Chain, q: Array, gravity: Array, motion: Array, link: int = 0, share: float = 1.0, before: int = 0
) -> tuple[Array, Array]:
    """Returns the stiffness [N m/rad] that `gravity` [3] gives the same motions: (with the joints [k, n], their own [k, k]),
    second derivatives of the potential at posture q [n]. The first `before` joints move the axes of the motions, these
    those of the other joints."""
    joints, carried = _carried(chain, q, link, share)
    across = skew(gravity)
    by_motion = across @ carried[link, :3] @ motion.T  # gravity's pull on what each motion moves
    by_joint = across @ (carried[:, :3] @ joints[..., None])[..., 0].T
    V = motion[:, 3:] @ by_joint
    V[:, :before] = (joints[:before, 3:] @ by_motion).T
    W = motion[:, 3:] @ by_motion
    return V, 0.5 * (W + W.T)


def inertia_and_weight(chain: Chain, q: Array, gravity: Array) -> tuple[Array, Array]:
    """Returns the inertia matrix [n, n, kg m2] of the declared links, and the stiffness [n, n, N m/rad] that gravity adds."""
    joints, carried = _carried(chain, q, 0, 1.0)
    momentum = (carried @ joints[..., None])[..., 0]
    return _both_ways(joints @ momentum.T), _both_ways(joints[:, 3:] @ skew(gravity) @ momentum[:, :3].T)


def slopes(chain: Chain, q: Array, gravity: Array) -> tuple[Array, Array]:
    """d/dq_k of the inertia matrix and of the stiffness that gravity adds, [n, n, n] each, k first, at posture q [n].

    A joint moves the axes of those behind it by the commutator of their twists, and with these all that they carry.
    """
    joints, carried = _carried(chain, q, 0, 1.0)
    k, i, j = np.ogrid[: chain.n, : chain.n, : chain.n]
    v, w = joints[:, :3], joints[:, 3:]
    turned = np.cross(w[:, None], w)  # [k, i]
    moved = np.concatenate([np.cross(w[:, None], v) + np.cross(v[:, None], w), turned], axis=2)
    momentum = (carried[:, None] @ joints[..., None])[..., 0]  # of what k carries, by joint j
    own = momentum[np.arange(chain.n), np.arange(chain.n)]
    # a joint in between moves only what i is measured against; one behind both what it carries, too
    between = -(moved @ own.T)
    behind = -(moved @ np.swapaxes(momentum, 1, 2) + momentum @ np.swapaxes(moved, 1, 2))
    dJ = np.where(k <= i, 0.0, np.where(k <= j, between, behind))
    # linear momentum turns with joint k; of one behind only what that carries does, and joint j moves it otherwise
    whole = np.cross(w[:, None], own[:, :3])
    part = np.cross(w[:, None], momentum[..., :3]) - (carried[:, None, :3] @ moved[..., None])[..., 0]
    change = np.where(k <= i, whole, part)  # [k, j]
    across = skew(gravity)
    dK = w @ across @ np.swapaxes(change, 1, 2)
    dK += np.where(k < i, turned @ across @ own[:, :3].T, 0.0)
    return _both_ways(dJ), _both_ways(dK)


def _both_ways(upper: Array) -> Array:
    """Symmetric matrices [.., n, n] of which the entries on and above the diagonal are given."""
    above = np.triu(upper, 1)
    return np.asarray(np.triu(upper) + np.swapaxes(above, -1, -2))


def _carried(chain: Chain, q: Array, link: int, share: float) -> tuple[Array, Array]:
    """The twists [n, 6] of the joints, and what hangs on each [n, 6, 6] with a `share` of the body of `link`."""
    at = posed(chain, q)
    bodies = _bodies(chain, at)
    bodies[link] *= share
    return at.twists, np.cumsum(bodies[::-1], axis=0)[::-1]


def own_inertia(chain: Chain, q: Array, link: int, motion: Array) -> Array:
    """What the body of one link alone contributes to the inertia between a `motion` [6] and the joints [n, kg m2]."""
    at = posed(chain, q)
    joints = at.twists.copy()
    joints[link + 1 :] = 0.0
    return np.asarray(joints @ _bodies(chain, at)[link] @ motion)
