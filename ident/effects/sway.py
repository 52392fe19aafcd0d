"""What comes back of second order from a structure that gives: Coriolis, centrifugal, and what inertia and weight change by.

What gives about an axis is one joint more of the arm. Its motion follows from the links' to first order; the forces of second
order on all joints follow from that and the declared links, and the one that pushes what gives is passed on by its spring.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.effects.base import Array, Complex, Known, Swing
from ident.effects.impedance import Sprung, slopes
from symgen.chain import REVOLUTE, Chain, Inertia, Joint


def bent(chain: Chain, link: int, share: float, axis: Array) -> Chain:
    """The chain with one joint more behind that of `link`: about `axis` [3, link frame], a `share` of the link's body on it."""
    near = chain.joints[link]

    def part(of: float) -> Inertia:
        return Inertia(of * near.inertia.mass, near.inertia.com, of * near.inertia.I)

    joints = (*chain.joints[:link], replace(near, inertia=part(1.0 - share)), hinge(axis, part(share)))
    return replace(chain, joints=(*joints, *chain.joints[link + 1 :]))


def rocked(chain: Chain, own: Array) -> Chain:
    """The chain behind three joints more, about x, y and z of its base, that turn what has the inertia `own` [3] about them."""
    turned = (Inertia.zero(), Inertia.zero(), Inertia(0.0, np.zeros(3), np.diag(own)))
    joints = tuple(hinge(axis, body) for axis, body in zip(np.eye(3), turned, strict=True))
    return replace(chain, joints=(*joints, *chain.joints))


def hinge(axis: Array, body: Inertia) -> Joint:
    """A joint about `axis` at the origin of the link before, with `body` on it."""
    return Joint("", REVOLUTE, np.eye(3), np.zeros(3), axis, "", body)


def second_order(s: Complex, arm: Known, swing: Swing, sprung: Sprung, chain: Chain, places: Sequence[int]) -> Complex:
    """Forces [L, n] on the links, beyond those of the stiff arm, while the joints `places` of `chain` give on springs as `sprung`
    has it; these come besides the arm's n joints, or one of these gives that is locked."""
    n, many = len(arm.posture), len(places)
    links = np.arange(n) if chain.n == n else np.setdiff1d(np.arange(n + many), places)
    posture = np.zeros(chain.n)
    posture[links] = arm.posture
    turn = sprung.carried_along(s, swing.at_lines(swing.q))
    stiff = np.zeros((3, len(swing.q), chain.n))
    stiff[:, :, links] = swing.q, swing.v, swing.a
    giving = stiff.copy()
    for order in range(3):
        giving[order][:, places] = swing.in_time(s[:, None] ** order * turn)
    changes = slopes(chain, posture, arm.gravity)
    forces = of_second_order(*changes, *giving)
    more = forces - of_second_order(*changes, *stiff)
    more[:, places] = 0.0
    return sprung.passed_on(s, swing.at_lines(more[:, links]), swing.at_lines(forces[:, places]))


def of_second_order(dJ: Array, dK: Array, q: Array, v: Array, a: Array) -> Array:
    """Rigid-body forces of second order [S, n] in positions, velocities, accelerations [S, n] about a posture, of what the inertia
    matrix and the stiffness of gravity change by, d/dq_k [k, i, j]: Coriolis and centrifugal forces, and what J and gravity
    change by."""
    by_k = dJ.transpose(0, 2, 1)  # [k, j, i]
    parts = [(q, a, by_k), (v, v, by_k - 0.5 * dJ.transpose(1, 2, 0)), (q, q, 0.5 * dK.transpose(0, 2, 1))]
    S, n = q.shape
    pairs = np.concatenate([(x[:, :, None] * y[:, None, :]).reshape(S, n * n) for x, y, _ in parts], axis=1)
    return np.asarray(-pairs @ np.concatenate([part.reshape(n * n, n) for _, _, part in parts]))
