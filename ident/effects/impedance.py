"""What an effect adds to the dynamic stiffness of (theta/N, q) [S, 2n, 2n], and who feels what gives in the structure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.effects.base import Array, Complex
from symgen.chain import REVOLUTE, Chain, Inertia, placements, readonly, skew


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
    """A chain at a posture: the twists [n, 6] of its joints, the frames (R [3, 3], p [3]) of its links and their inertia [n, 6, 6],
    as `_spatial`. Arrays are read only."""

    chain: Chain
    twists: Array
    frames: tuple[tuple[Array, Array], ...]
    bodies: Array

    @staticmethod
    def of(chain: Chain, q: Array) -> Posed:
        R, p = np.eye(3), np.zeros(3)
        rows, frames, bodies = [], [], []
        for joint, (turn, shift) in zip(chain.joints, placements(chain, np.asarray(q)[None]), strict=True):
            R, p = R @ turn[0], p + R @ shift[0]
            axis = R @ joint.axis
            rows.append(np.concatenate([skew(p) @ axis, axis] if joint.type == REVOLUTE else [axis, np.zeros(3)]))
            frames.append((readonly(R), readonly(p)))
            bodies.append(_spatial(joint.inertia.moved(R, p)))
        return Posed(chain, readonly(rows), tuple(frames), readonly(bodies))


#: Those that were asked for last: a fit asks for the postures of its records again and again.
_POSED: dict[tuple[int, bytes], Posed] = {}
MOST_POSED = 1000


def _posed(chain: Chain, q: Array) -> Posed:
    key = (id(chain), np.asarray(q, dtype=float).tobytes())
    found = _POSED.get(key)
    if found is None or found.chain is not chain:
        if len(_POSED) >= MOST_POSED:
            _POSED.clear()
        found = _POSED[key] = Posed.of(chain, q)
    return found


def twists(chain: Chain, q: Array) -> tuple[Array, tuple[tuple[Array, Array], ...]]:
    """Returns the twists [n, 6] of the joints (velocity at the base's origin, angular velocity; base axes), and the frames
    (R [3, 3], p [3]) of the links, at posture q [n]."""
    posed = _posed(chain, q)
    return posed.twists, posed.frames


def coupling(chain: Chain, q: Array, motion: Array, link: int = 0, share: float = 1.0) -> tuple[Array, Array]:
    """Returns (C [k, n], M [k, k]): the inertia that k more motions share with the joints, and their own [kg m2].

    `motion` [k, 6]: twists, as `twists` gives them, that move a `share` of the body of `link` (from 0) and all links
    behind it.
    """
    joints, carried = _carried(chain, q, link, share)
    C = np.array([motion @ carried[max(j, link)] @ joints[j] for j in range(chain.n)]).T
    return C, motion @ carried[link] @ motion.T


def weighed(
    chain: Chain, q: Array, gravity: Array, motion: Array, link: int = 0, share: float = 1.0, before: int = 0
) -> tuple[Array, Array]:
    """Returns the stiffness [N m/rad] that `gravity` [3] gives the same motions: (with the joints [k, n], their own [k, k]),
    second derivatives of the potential at posture q [n]. The first `before` joints move the axes of the motions, these
    those of the other joints."""
    joints, carried = _carried(chain, q, link, share)
    across = skew(gravity)

    def second(outer: Array, inner: Array, body: Array) -> float:
        """What turns about `outer` do to what `inner` lifts of what it carries."""
        return float(outer[3:] @ (across @ (body @ inner)[:3]))

    V = [
        [
            second(joints[j], one, carried[link]) if j < before else second(one, joints[j], carried[j])
            for j in range(chain.n)
        ]
        for one in motion
    ]
    W = np.array([[second(a, b, carried[link]) for b in motion] for a in motion])
    return np.array(V), 0.5 * (W + W.T)


def inertia_and_weight(chain: Chain, q: Array, gravity: Array) -> tuple[Array, Array]:
    """Returns the inertia matrix [n, n, kg m2] of the declared links, and the stiffness [n, n, N m/rad] that gravity adds."""
    joints, carried = _carried(chain, q, 0, 1.0)
    J, K = np.zeros((2, chain.n, chain.n))
    for j, body in enumerate(carried):
        momentum = body @ joints[j]
        J[j, : j + 1] = J[: j + 1, j] = joints[: j + 1] @ momentum
        K[j, : j + 1] = K[: j + 1, j] = -joints[: j + 1, 3:] @ (skew(momentum[:3]) @ gravity)
    return J, K


def _carried(chain: Chain, q: Array, link: int, share: float) -> tuple[Array, Array]:
    """The twists [n, 6] of the joints, and what hangs on each [n, 6, 6] with a `share` of the body of `link`."""
    posed = _posed(chain, q)
    bodies = posed.bodies.copy()
    bodies[link] *= share
    return posed.twists, np.cumsum(bodies[::-1], axis=0)[::-1]


def own_inertia(chain: Chain, q: Array, link: int, motion: Array) -> Array:
    """What the body of one link alone contributes to the inertia between a `motion` [6] and the joints [n, kg m2]."""
    posed = _posed(chain, q)
    joints = posed.twists.copy()
    joints[link + 1 :] = 0.0
    return np.asarray(joints @ posed.bodies[link] @ motion)


def _spatial(body: Inertia) -> Array:
    """The inertia [6, 6] of a body for (velocity at the origin, angular velocity)."""
    c = skew(body.com)
    m = body.mass
    return np.block([[m * np.eye(3), -m * c], [m * c, body.I - m * c @ c]])
