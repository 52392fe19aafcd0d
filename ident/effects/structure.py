"""What gives where the model is stiff: locked joints, base, links, things on springs; and what the model leaves out."""

from __future__ import annotations

from typing import final

import numpy as np

from ident.effects.base import Array, Body, Complex, Effect, Known, Parameter, Swing
from ident.effects.impedance import Sprung, coupling, own_inertia, posed, weighed
from ident.effects.sway import bent, rocked, second_order
from symgen.chain import Chain

#: Retardation time [s] of a spring: its damping over its stiffness. At 30 Hz, 2e-4 s is 2 % of critical.
_DAMPING = Parameter("damping", "s", 0.0, 0.01, (2e-4,), zero=None)
#: The twists of a base that turns about x, y and z.
_TURNS = np.hstack([np.zeros((3, 3)), np.eye(3)])


class LockedJointElasticity(Effect):
    """A joint that the lock holds rigid gives all the same: its link on its own spring, the motor still."""

    name, port, carries = "locked-joint-elasticity", "structure", True
    parameters = (
        Parameter("stiffness", "Nm/rad", 0.05, 100.0, (1.0,), zero=None, relative="K", sliding="N/m"),
        _DAMPING,
    )

    def impedance(self, s: Complex, arm: Known) -> Complex:
        """On the other joints; nothing where the joint is not locked, but live in J."""
        i = self.joint
        assert i is not None
        if arm.J[i, i]:
            return np.zeros((len(s), 2 * len(arm.N), 2 * len(arm.N)), dtype=complex)
        return self._sprung(arm).on_links(s)

    def second_order(self, s: Complex, arm: Known, swing: Swing) -> Complex | None:
        i = self.joint
        if arm.chain is None or i is None or arm.J[i, i]:
            return None
        return second_order(s, arm, swing, self._sprung(arm), arm.chain, [i])

    def _sprung(self, arm: Known) -> Sprung:
        stiffness, damping = self.values[:2]
        i = self.joint
        assert i is not None
        C, own = _row(arm, i)
        weight = _weight(arm, i)
        C[0, i] = 0.0
        if weight is not None:
            weight[0][0, i] = 0.0
        return Sprung(C, own, np.array([stiffness]), np.array([stiffness * damping]), weight)

    def structure(self, body: Body) -> None:
        assert self.joint is not None
        body.loosen(self.joint, self["stiffness"], self["stiffness"] * self["damping"])


def _row(arm: Known, joint: int) -> tuple[Array, Array]:
    """The row [1, n] of J of a joint, and J_ii [1, 1]; from the declared links where the joint is not live in J."""
    if arm.J[joint, joint] or arm.chain is None:
        return np.array(arm.J[[joint]]), np.array(arm.J[[joint]][:, [joint]])
    return coupling(arm.chain, arm.posture, posed(arm.chain, arm.posture).twists[[joint]], joint)


def _weight(arm: Known, link: int, motion: Array | None = None, share: float = 1.0) -> tuple[Array, Array] | None:
    """Gravity's stiffness for one more turn of a link about its joint's axis, or by another `motion` [6], as `weighed`."""
    if arm.chain is None or arm.gravity is None:
        return None
    motion = posed(arm.chain, arm.posture).twists[link] if motion is None else motion
    return weighed(arm.chain, arm.posture, arm.gravity, motion[None], link, share, link + 1)


class BaseCompliance(Effect):
    """The base on springs about its origin: it rocks about x and y, and turns about z. Its own inertia is told by the
    frequency `own` at which it would swing without the arm."""

    name, port, scope, carries, turns = "base-compliance", "structure", ("arm",), True, True
    parameters = (
        Parameter("rock", "Nm/rad", 0.5, 1e4, (10.0, 50.0), zero=None, relative="K"),
        Parameter("turn", "Nm/rad", 0.5, 1e4, (20.0, 100.0), zero=None, relative="K"),
        Parameter("own", "Hz", 20.0, 1e4, (150.0,), zero=None),
        _DAMPING,
    )

    def impedance(self, s: Complex, arm: Known) -> Complex | None:
        if arm.base_inertia is not None:
            n = len(arm.N)
            return self._sprung(arm.base_inertia[3:, :n], arm.base_inertia[3:, n + 3 :]).on_links(s)
        if arm.chain is None:
            return None
        return self._sprung(*coupling(arm.chain, arm.posture, _TURNS), self._weight(arm, arm.posture)).on_links(s)

    def second_order(self, s: Complex, arm: Known, swing: Swing) -> Complex | None:
        """While links swing, what the base carries changes: inertia and weight push it, and what turns it pushes the links."""
        chain, q = arm.chain, arm.posture
        if chain is None:
            return None
        sprung = self._sprung(*coupling(chain, q, _TURNS), self._weight(arm, q))
        return second_order(s, arm, swing, sprung, rocked(chain, self._springs()[1]), range(3))

    @staticmethod
    def _weight(arm: Known, q: Array) -> tuple[Array, Array] | None:
        return None if arm.chain is None or arm.gravity is None else weighed(arm.chain, q, arm.gravity, _TURNS)

    def _sprung(self, coupled: Array, carried: Array, weight: tuple[Array, Array] | None = None) -> Sprung:
        """The base's three turns, of the inertia they share with the joints and that of all that is carried."""
        k, own = self._springs()
        return Sprung(coupled, carried + np.diag(own), k, k * self["damping"], weight)

    def _springs(self) -> tuple[Array, Array]:
        """Stiffness and own inertia [3] about x, y, z."""
        k = np.array([self["rock"], self["rock"], self["turn"]])
        return k, k / (2 * np.pi * self["own"]) ** 2

    def structure(self, body: Body) -> None:
        k, own = self._springs()
        body.rock(k.tolist(), (k * self["damping"]).tolist(), own.tolist())


class LinkFlexibility(Effect):
    """A link that bends: a `share` of its body and all that it carries turn on a spring at its joint, about the joint's
    axis (across 0) or across it, out of the plane in which the joint moves it (across 1)."""

    name, port, impedance_of, carries, turns = "link-flexibility", "structure", "J", True, True
    parameters = (
        Parameter("stiffness", "Nm/rad", 0.05, 1e3, (2.0, 8.0), zero=None, relative="K"),
        Parameter("share", "", 0.05, 0.95, (0.5,), zero=None),
        _DAMPING,
        Parameter("across", "", 0.0, 1.0, (0.0, 1.0), zero=None, whole=True),
    )

    def impedance(self, s: Complex, arm: Known) -> Complex:
        """About the joint's axis from the fitted J, less what stays of the declared link; across it from the declared links."""
        return self._sprung(arm).on_links(s)

    def second_order(self, s: Complex, arm: Known, swing: Swing) -> Complex | None:
        chain, i = arm.chain, self.joint
        if chain is None or i is None:
            return None
        return second_order(s, arm, swing, self._sprung(arm), bent(chain, i, self["share"], self._axis(chain)), [i + 1])

    def _sprung(self, arm: Known) -> Sprung:
        k, share, damping, across = self.values[:4]
        i = self.joint
        assert i is not None
        weight = None
        if arm.chain is None:
            C, own = arm.J[[i]] * share, arm.J[i : i + 1, i : i + 1] * share
        elif across or arm.chain.slides(i):
            at = posed(arm.chain, arm.posture)
            axis = at.R[i] @ self._axis(arm.chain)
            motion = np.concatenate([np.cross(at.p[i], axis), axis])
            C, own = coupling(arm.chain, arm.posture, motion[None], i, share)
            weight = _weight(arm, i, motion, share)
        else:
            motion, row = posed(arm.chain, arm.posture).twists[i], _row(arm, i)[0]
            link = row if i == arm.chain.n - 1 else own_inertia(arm.chain, arm.posture, i, motion)
            C = row - (1.0 - share) * link
            own = C[:, [i]]
            weight = _weight(arm, i, motion, share)
        return Sprung(C, own, np.array([k]), np.array([k * damping]), weight)

    def structure(self, body: Body) -> None:
        k, share, damping, _ = self.values[:4]
        i = self.joint
        assert i is not None
        body.split(i, share, self._axis(body.chain).tolist(), k, k * damping)

    def _axis(self, chain: Chain) -> Array:
        """The axis [3, link frame] about which the link turns on its spring."""
        assert self.joint is not None
        return _out_of_plane(chain, self.joint) if self["across"] else chain.joints[self.joint].axis


def _out_of_plane(chain: Chain, link: int) -> Array:
    """The axis [3, link frame] about which a link bends out of the plane of its joint: across the axis and the link."""
    joint = chain.joints[link]
    along = chain.joints[link + 1].p if link + 1 < chain.n else joint.inertia.com
    axis = np.cross(joint.axis, along)
    if np.linalg.norm(axis) < 1e-6:
        axis = np.cross(joint.axis, np.eye(3)[np.argmin(np.abs(joint.axis))])
    return np.asarray(axis / np.linalg.norm(axis))


@final
class AttachedResonator(Effect):
    """A tool, a cable, a cover on a spring: a disc that turns about the joint's axis, carried by the link.

    Every joint that turns the link about that axis feels it, s^2 J (s d + k) / (s^2 J + s d + k) times the cosines.
    """

    name, port, turns = "attached-resonator", "structure", True
    parameters = (
        Parameter("inertia", "kgm2", 0.0, 10.0, (0.1, 0.03), relative="J"),
        Parameter("frequency", "Hz", 0.5, 1e3, (10.0, 20.0, 40.0, 80.0), zero=None),
        Parameter("damping", "s", 0.0, 0.1, (2e-4,), zero=None),
    )

    def _spring(self) -> tuple[float, float]:
        k = self["inertia"] * (2 * np.pi * self["frequency"]) ** 2
        return k, k * self["damping"]

    def impedance(self, s: Complex, arm: Known) -> Complex:
        n, i = len(arm.N), self.joint
        assert i is not None
        J, (k, d) = self["inertia"], self._spring()
        w = np.zeros(2 * n)
        w[n:] = _turns(arm.chain, arm.posture, i) if arm.chain is not None else np.eye(n)[i]
        z = s**2 * J * (s * d + k) / (s**2 * J + s * d + k) if J else 0.0 * s
        return np.asarray(z[:, None, None] * np.outer(w, w))

    def structure(self, body: Body) -> None:
        assert self.joint is not None
        if self["inertia"]:
            body.attach_disc(self.joint, self["inertia"], body.chain.joints[self.joint].axis.tolist(), *self._spring())


def _turns(chain: Chain, q: Array, link: int) -> Array:
    """How far a link turns about its joint's axis for each joint's unit motion [n]: cosines between axes."""
    at = posed(chain, q)
    turns = at.twists[:, 3:] @ (at.R[link] @ chain.joints[link].axis)
    turns[link + 1 :] = 0.0
    return np.asarray(turns)


@final
class RigidBodyCoupling(Effect):
    """Coriolis and centrifugal torques: plain rigid-body physics that a linear model about rest leaves out."""

    name, port, scope, injectable = "rigid-body-coupling", "structure", ("arm",), False
    parameters = ()
