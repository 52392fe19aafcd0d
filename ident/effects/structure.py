"""What gives where the model is stiff: locked joints, base, links, things on springs; and what the model leaves out."""

from __future__ import annotations

from typing import final

import numpy as np

from ident.effects.base import Array, Body, Complex, Effect, Known, Parameter
from ident.effects.impedance import coupling, eliminated, own_inertia, tilted, twists
from symgen.chain import Chain

#: Retardation time [s] of a spring: its damping over its stiffness. At 30 Hz, 2e-4 s is 2 % of critical.
_DAMPING = Parameter("damping", "s", 0.0, 0.01, (2e-4,), zero=None)


@final
class LockedJointElasticity(Effect):
    """A joint that the lock holds rigid gives all the same: its link on its own spring, the motor still."""

    name, port = "locked-joint-elasticity", "structure"
    parameters = (Parameter("stiffness", "Nm/rad", 0.05, 100.0, (1.0,), zero=None, relative="K"), _DAMPING)

    def impedance(self, s: Complex, arm: Known) -> Complex:
        """On the other joints; nothing where the joint is not locked, but live in J."""
        stiffness, damping = self.values
        i = self.joint
        assert i is not None
        if arm.J[i, i]:
            return np.zeros((len(s), 2 * len(arm.N), 2 * len(arm.N)), dtype=complex)
        C, own = _row(arm, i)
        C[0, i] = 0.0
        return eliminated(s, C, own, np.array([stiffness]), np.array([stiffness * damping]))

    def structure(self, body: Body) -> None:
        assert self.joint is not None
        body.loosen(self.joint, self["stiffness"], self["stiffness"] * self["damping"])


def _row(arm: Known, joint: int) -> tuple[Array, Array]:
    """The row [1, n] of J of a joint, and J_ii [1, 1]; from the declared links where the joint is not live in J."""
    if arm.J[joint, joint] or arm.chain is None:
        return np.array(arm.J[[joint]]), np.array(arm.J[[joint]][:, [joint]])
    return coupling(arm.chain, arm.posture, twists(arm.chain, arm.posture)[0][[joint]], joint)


@final
class BaseCompliance(Effect):
    """The base on springs about its origin: it rocks about x and y, and turns about z. Its own inertia is told by the
    frequency `own` at which it would swing without the arm."""

    name, port, scope = "base-compliance", "structure", ("arm",)
    parameters = (
        Parameter("rock", "Nm/rad", 0.5, 1e4, (10.0, 50.0), zero=None, relative="K"),
        Parameter("turn", "Nm/rad", 0.5, 1e4, (20.0, 100.0), zero=None, relative="K"),
        Parameter("own", "Hz", 20.0, 1e4, (150.0,), zero=None),
        _DAMPING,
    )

    def impedance(self, s: Complex, arm: Known) -> Complex | None:
        n = len(arm.N)
        if arm.base_inertia is not None:
            C, carried = arm.base_inertia[3:, :n], arm.base_inertia[3:, n + 3 :]
        elif arm.chain is not None:
            C, carried = coupling(arm.chain, arm.posture, np.hstack([np.zeros((3, 3)), np.eye(3)]))
        else:
            return None
        k, own = self._springs()
        weight = None if arm.chain is None or arm.gravity is None else tilted(arm.chain, arm.posture, arm.gravity)
        return eliminated(s, C, carried + np.diag(own), k, k * self["damping"], weight)

    def _springs(self) -> tuple[Array, Array]:
        """Stiffness and own inertia [3] about x, y, z."""
        k = np.array([self["rock"], self["rock"], self["turn"]])
        return k, k / (2 * np.pi * self["own"]) ** 2

    def structure(self, body: Body) -> None:
        k, own = self._springs()
        body.rock(k.tolist(), (k * self["damping"]).tolist(), own.tolist())


@final
class LinkFlexibility(Effect):
    """A link that bends: a `share` of its body and all that it carries turn on a spring at its joint, about the joint's
    axis (across 0) or across it, out of the plane in which the joint moves it (across 1)."""

    name, port, impedance_of = "link-flexibility", "structure", "J"
    parameters = (
        Parameter("stiffness", "Nm/rad", 0.05, 1e3, (2.0, 8.0), zero=None, relative="K"),
        Parameter("share", "", 0.05, 0.95, (0.5,), zero=None),
        _DAMPING,
        Parameter("across", "", 0.0, 1.0, (0.0, 1.0), zero=None, whole=True),
    )

    def impedance(self, s: Complex, arm: Known) -> Complex:
        """About the joint's axis from the fitted J, less what stays of the link; across it from the declared links."""
        k, share, damping, across = self.values
        i = self.joint
        assert i is not None
        if arm.chain is None:
            C, own = arm.J[[i]] * share, arm.J[i : i + 1, i : i + 1] * share
        elif across:
            R, p = twists(arm.chain, arm.posture)[1][i]
            axis = R @ _out_of_plane(arm.chain, i)
            C, own = coupling(arm.chain, arm.posture, np.concatenate([np.cross(p, axis), axis])[None], i, share)
        else:
            motion = twists(arm.chain, arm.posture)[0][i]
            C = _row(arm, i)[0] - (1.0 - share) * own_inertia(arm.chain, arm.posture, i, motion)
            own = C[:, [i]]
        return eliminated(s, C, own, np.array([k]), np.array([k * damping]))

    def structure(self, body: Body) -> None:
        k, share, damping, across = self.values
        i = self.joint
        assert i is not None
        axis = _out_of_plane(body.chain, i) if across else body.chain.joints[i].axis
        body.split(i, share, axis.tolist(), k, k * damping)


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

    name, port = "attached-resonator", "structure"
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
    rows, frames = twists(chain, q)
    turns = rows[:, 3:] @ (frames[link][0] @ chain.joints[link].axis)
    turns[link + 1 :] = 0.0
    return np.asarray(turns)


@final
class RigidBodyCoupling(Effect):
    """Coriolis and centrifugal torques: plain rigid-body physics that a linear model about rest leaves out."""

    name, port, scope, injectable = "rigid-body-coupling", "structure", ("arm",), False
    parameters = ()
