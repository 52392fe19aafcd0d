"""What gives in the structure and carries links that are not the declared ones: these are fitted with it, as far as it shows them.

J(q) tells by far not all of the links that a soft base or a bent link feels: a mass on the first axis turns no joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, cast

import numpy as np

from ident.effects.base import Array, Complex, Effect, Known, Parameter
from ident.effects.structure import Giving
from symgen.chain import Chain

#: Standard deviations by which declared links may be off: of a mass (and all that goes with it), of a centre of mass and of moments
#: of inertia, in shares of the body's mass, of its radius of gyration about the joint and of this squared.
HEAVIER, ASIDE, BROADER = 0.2, 0.1, 0.1
#: Farthest that they are looked for, in these standard deviations.
FARTHEST = 5.0
#: A direction in which links may be off is shown by an effect when it changes this share of what the foremost one does.
SHOWN = 3e-4
#: Chains that are kept, for a fit that comes back to them.
RECENT = 100


class Carrying(Effect):
    """An effect that carries links which are off the declared ones: its last values are by how much, along `directions` [10 n, k]."""

    directions: ClassVar[Array]
    recent: ClassVar[dict[tuple[float, ...], tuple[Chain, Chain]]]

    def impedance(self, s: Complex, arm: Known) -> Complex | None:
        """What gives asks for the links itself: what is beside it carries others."""
        return super().impedance(s, arm if isinstance(self, Giving) else self.carried(arm))

    def carried(self, arm: Known) -> Known:
        off = self.values[-self.directions.shape[1] :]
        declared, found = self.recent.get(off, (None, None))
        if declared is not arm.chain or found is None:
            if len(self.recent) >= RECENT:
                self.recent.clear()
            found = arm.chain.with_parameters(arm.chain.parameters + self.directions @ np.array(off))
            self.recent[off] = arm.chain, found
        return replace(arm, chain=found)


def carrying(effect: Effect, directions: Array) -> Effect:
    """The effect, of links that may be off along `directions` [10 n, k], at first as declared."""
    count = directions.shape[1]
    more = tuple(Parameter(f"link_{k + 1}", "", -FARTHEST, FARTHEST, (0.0,), aside=True) for k in range(count))
    kind = type(effect)
    found = type(
        kind.__name__,
        (Carrying, kind),
        {"parameters": (*kind.parameters, *more), "directions": directions, "recent": {}},
    )
    return cast(Effect, found(effect.joint, (*effect.values, *[0.0] * count)))


def of_declared_links(effect: Effect) -> Effect:
    """The effect, of the declared links."""
    if not isinstance(effect, Carrying):
        return effect
    kind = cast(type[Effect], type(effect).__bases__[1])
    return kind(effect.joint, effect.values[: len(kind.parameters)])


def shown(effect: Effect, s: Complex, arms: Sequence[Known], symmetric: bool) -> Array:
    """Directions [10 n, k] in which links may be off, standard deviations each, and that `effect` shows at `s` [S] in one of `arms`, clearest
    first. Where links are `symmetric`, what is zero stays so."""
    chain = arms[0].chain
    off = _ways_off(chain, symmetric)
    step = 0.01

    def impedances(by: Array) -> Array:
        turned = chain.with_parameters(chain.parameters + by)
        parts = []
        for arm in arms:
            Z = effect.impedance(s, replace(arm, chain=turned))
            n = len(arm.N)
            stiff = np.sqrt(arm.K + np.abs(s[:, None]) ** 2 * np.diag(arm.J))
            parts.append(np.zeros(0) if Z is None else (Z[:, n:, n:] / (stiff[:, :, None] * stiff[:, None, :])).ravel())
        whole = np.concatenate(parts)
        return np.concatenate([whole.real, whole.imag])

    plain = impedances(np.zeros(len(off)))
    change = np.array([impedances(step * way) - plain for way in off.T]).T / step
    _, size, ways = np.linalg.svd(change, full_matrices=False)
    return np.asarray(off @ ways[size > SHOWN * size.max(initial=0.0)].T)


def _ways_off(chain: Chain, symmetric: bool) -> Array:
    """All ways [10 n, W] in which a link may be off, one standard deviation each."""
    ways = []
    for k, joint in enumerate(chain.joints):
        phi, b = joint.inertia.parameters, slice(10 * k, 10 * k + 10)
        radius = np.sqrt(
            max(np.trace(joint.inertia.I) / 2.0 / max(phi[0], 1e-300) + joint.inertia.com @ joint.inertia.com, 0.0)
        )
        sizes = phi[0] * np.array([0.0, *[ASIDE * radius] * 3, *[BROADER * radius**2] * 6])
        if symmetric:
            sizes[np.abs(phi) < 1e-12 * np.abs(phi).max()] = 0.0
        for way in [HEAVIER * phi, *(row for row in np.diag(sizes) if row.any())]:
            whole = np.zeros(10 * chain.n)
            whole[b] = way
            ways.append(whole)
    return np.array(ways).T
