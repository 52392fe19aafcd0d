"""What gives where the model is stiff: locked joints, base, links, things on springs; and what the model leaves out."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import final

import numpy as np

from ident.effects.base import Array, Body, Complex, Effect, Known, Parameter, Swing
from ident.effects.impedance import Sprung, coupling, own_inertia, posed, weighed
from ident.effects.sway import bent, hinge, rocked, second_order
from symgen.chain import PRISMATIC, Chain, Inertia, skew

#: Retardation time [s] of a spring: its damping over its stiffness. At 30 Hz, 2e-4 s is 2 % of critical.
_DAMPING = Parameter("damping", "s", 0.0, 0.01, (2e-4,), zero=None)
#: That of a link that hardly rings, which looks like no other that does.
_DULL = 1.5e-3
#: The twists of a base that turns about x, y and z.
_TURNS = np.hstack([np.zeros((3, 3)), np.eye(3)])
#: Where something gives, from the base on: at it; then of every link at its joint, at its near part's disc, where it bends.
_AT_BASE, _AT_JOINT, _DISC, _BEND = -1, 0, 1, 2


@dataclass(frozen=True, eq=False)
class Freedom:
    """k more motions of an arm, of what gives: by themselves as `sprung` [k] has it, along twists `motion` [k, 6] as those of `Posed`.

    They move a `share` of the body of `link` (from 0) of `chain` and all links behind it; a disc, the link's disc alone. `place`
    tells which of two is nearer to the base. `joint` has the same motion, and fitted inertia tells what it is worth.
    """

    sprung: Sprung
    motion: Array
    chain: Chain
    link: int
    at: int
    share: float = 1.0
    joint: int | None = None

    @property
    def place(self) -> int:
        return self.at if self.at == _AT_BASE else 3 * self.link + self.at

    def shared(self, far: Freedom, arm: Known) -> tuple[Array, Array]:
        """The inertia and the stiffness of gravity [k, far's k] between these motions and those of another one farther from the
        base: both move what that moves. Of links that one of them found to be off, they are those."""
        chain = self.chain if far.chain is arm.chain else far.chain
        _, moved = coupling(chain, arm.posture, np.eye(6), far.link, far.share)
        momentum = moved @ far.motion.T
        inertia = self.motion @ momentum if self.joint is None else far.sprung.coupling[:, [self.joint]].T
        return inertia, self.motion[:, 3:] @ skew(arm.gravity) @ momentum[:3]

    def turning(self, disc: Freedom) -> Array:
        """How far each of these motions [k] turns a disc about its axis."""
        if self is disc:
            return np.ones(1)
        carries = self.at != _DISC and self.place < disc.place
        return np.asarray(carries * (self.motion[:, 3:] @ disc.motion[0, 3:]))


def _together(found: Sequence[Freedom], arm: Known) -> tuple[Sprung, Array]:
    """All of `found`, which are in the order of their places, and the inertia [n, n] of discs among them, which J(q) does not have."""
    parts = [one.sprung for one in found]
    n, where = len(arm.N), np.cumsum([0, *(len(part.inertia) for part in parts)])
    C, M, V = np.vstack([part.coupling for part in parts]), np.zeros((where[-1], where[-1])), np.zeros((where[-1], n))
    W, rigid, spans = np.zeros_like(M), np.zeros((n, n)), [slice(a, b) for a, b in pairwise(where)]
    solid = [(one, at) for one, at in zip(found, spans, strict=True) if one.at != _DISC]
    for k, (far, b) in enumerate(solid):
        M[b, b] = far.sprung.inertia
        if far.sprung.weight is not None:
            V[b], W[b, b] = far.sprung.weight
        for near, a in solid[:k]:
            M[a, b], W[a, b] = near.shared(far, arm)
            M[b, a], W[b, a] = M[a, b].T, W[a, b].T
    for disc, at in zip(found, spans, strict=True):
        if disc.at == _DISC:
            J, C[at] = float(disc.sprung.inertia[0, 0]), 0.0
            by_links, by_them = disc.sprung.coupling[0] / J, np.concatenate([one.turning(disc) for one in found])
            C += J * np.outer(by_them, by_links)
            M += J * np.outer(by_them, by_them)
            rigid += J * np.outer(by_links, by_links)
    stiffness, damping = (np.concatenate([getattr(part, name) for part in parts]) for name in ("stiffness", "damping"))
    return Sprung(C, M, stiffness, damping, (V, W)), rigid


class Giving(Effect):
    """What gives. Where more than one thing does, they move what they both carry, and are felt together."""

    @abstractmethod
    def freedom(self, arm: Known) -> Freedom | None:
        """The motions that it is, of an arm that is `carried`; None: it does nothing there."""

    @abstractmethod
    def opened(self, chain: Chain) -> tuple[Chain, Sequence[int]]:
        """A chain with its motions as joints more, and their places; things nearer to the base are not in it yet."""

    def carried(self, arm: Known) -> Known:
        """The arm of the links that it carries."""
        return arm

    def impedance(self, s: Complex, arm: Known) -> Complex | None:
        """What it adds to what is `beside` it."""
        mine = self.freedom(self.carried(arm))
        if mine is None or not arm.beside:
            return None if mine is None else mine.sprung.on_links(s)
        both = all_that_gives(s, arm, (*arm.beside, self))
        before = all_that_gives(s, arm, arm.beside)
        return both if both is None or before is None else both - before

    def second_order(self, s: Complex, arm: Known, swing: Swing) -> Complex | None:
        """Those of it and of all that is `beside` it, together: inertia and weight of what they carry change and push them, and what
        moves them pushes the links."""
        found = _found(arm, (*arm.beside, self))
        if all(one.at == _DISC for _, one in found):
            return None
        off = (one.chain for _, one in reversed(found) if one.chain is not arm.chain)
        chain, places = next(off, arm.chain), [one.link for _, one in found]
        if any(one.at != _AT_JOINT for _, one in found):  # else joints that the arm has
            places = []
            for effect, _ in reversed(found):
                chain, more = effect.opened(chain)
                places = [*more, *(place + len(more) if place >= more[0] else place for place in places)]
        sprung = found[0][1].sprung if len(found) == 1 else _together([one for _, one in found], arm)[0]
        return second_order(s, arm, swing, sprung, chain, places)


def _found(arm: Known, effects: Sequence[Effect]) -> list[tuple[Giving, Freedom]]:
    """Those of `effects` that give in an arm, and how, from the base on."""
    each = [(e, one) for e in effects if isinstance(e, Giving) and (one := e.freedom(e.carried(arm))) is not None]
    return sorted(each, key=lambda found: found[1].place)


def all_that_gives(s: Complex, arm: Known, effects: Sequence[Effect]) -> Complex | None:
    """What all of `effects` that give add, together, to the dynamic stiffness [S, 2n, 2n] of (theta/N, q) at s [S]."""
    found = [one for _, one in _found(arm, effects)]
    if not found:
        return None
    sprung, rigid = _together(found, arm)
    n, Z = len(arm.N), sprung.on_links(s)
    Z[:, n:, n:] += s[:, None, None] ** 2 * rigid
    return Z


class LockedJointElasticity(Giving):
    """A joint that the lock holds rigid gives all the same: its link on its own spring, the motor still."""

    name, port, carries = "locked-joint-elasticity", "structure", True
    parameters = (
        Parameter("stiffness", "Nm/rad", 0.05, 100.0, (1.0,), zero=None, relative="K", sliding="N/m"),
        _DAMPING,
    )

    def freedom(self, arm: Known) -> Freedom | None:
        """On the other joints; nothing where the joint is not locked, but live in J."""
        stiffness, damping = self.values[:2]
        i = self.joint
        assert i is not None
        if arm.J[i, i]:
            return None
        C, own = _row(arm, i)
        motion = _twist(arm, i)
        weight = _weight(arm, i, motion)
        C[0, i] = weight[0][0, i] = 0.0
        sprung = Sprung(C, own, np.array([stiffness]), np.array([stiffness * damping]), weight)
        return Freedom(sprung, motion, arm.chain, i, _AT_JOINT)

    def opened(self, chain: Chain) -> tuple[Chain, Sequence[int]]:
        """On a joint more, the same once again: the arm has its own, which is still."""
        i = self.joint
        assert i is not None
        more = bent(chain, i, 1.0, chain.joints[i].axis)
        if not chain.slides(i):
            return more, [i + 1]
        slide = replace(more.joints[i + 1], type=PRISMATIC)
        return replace(more, joints=(*more.joints[: i + 1], slide, *more.joints[i + 2 :])), [i + 1]

    def structure(self, body: Body) -> None:
        assert self.joint is not None
        body.loosen(self.joint, self["stiffness"], self["stiffness"] * self["damping"])


def _twist(arm: Known, joint: int) -> Array:
    """The twist of a joint [1, 6]."""
    return posed(arm.chain, arm.posture).twists[[joint]]


def _row(arm: Known, joint: int) -> tuple[Array, Array]:
    """The row [1, n] of J of a joint, and J_ii [1, 1]; from the declared links where the joint is not live in J."""
    if arm.J[joint, joint]:
        return np.array(arm.J[[joint]]), np.array(arm.J[[joint]][:, [joint]])
    return coupling(arm.chain, arm.posture, _twist(arm, joint), joint)


def _weight(arm: Known, link: int, motion: Array, share: float = 1.0) -> tuple[Array, Array]:
    """Gravity's stiffness for one more `motion` [1, 6] of a share of a link and all behind it, as `weighed`."""
    return weighed(arm.chain, arm.posture, arm.gravity, motion, link, share, link + 1)


class BaseCompliance(Giving):
    """The base on springs about its origin: it rocks about x and y, and turns about z. Its own inertia is told by the
    frequency `own` at which it would swing without the arm."""

    name, port, scope, carries, turns = "base-compliance", "structure", ("arm",), True, True
    parameters = (
        Parameter("rock", "Nm/rad", 0.5, 1e4, (10.0, 50.0), zero=None, relative="K"),
        Parameter("turn", "Nm/rad", 0.5, 1e4, (20.0, 100.0), zero=None, relative="K"),
        Parameter("own", "Hz", 20.0, 1e4, (150.0,), zero=None),
        _DAMPING,
    )

    def freedom(self, arm: Known) -> Freedom | None:
        """The base's three turns, of the inertia they share with the joints and that of all that is carried."""
        chain, q = arm.chain, arm.posture
        k, own = self._springs()
        coupled, carried = coupling(chain, q, _TURNS)
        weight = weighed(chain, q, arm.gravity, _TURNS)
        sprung = Sprung(coupled, carried + np.diag(own), k, k * self["damping"], weight)
        return Freedom(sprung, _TURNS, chain, 0, _AT_BASE)

    def opened(self, chain: Chain) -> tuple[Chain, Sequence[int]]:
        return rocked(chain, self._springs()[1]), range(3)

    def _springs(self) -> tuple[Array, Array]:
        """Stiffness and own inertia [3] about x, y, z."""
        k = np.array([self["rock"], self["rock"], self["turn"]])
        return k, k / (2 * np.pi * self["own"]) ** 2

    def structure(self, body: Body) -> None:
        k, own = self._springs()
        body.rock(k.tolist(), (k * self["damping"]).tolist(), own.tolist())


class LinkFlexibility(Giving):
    """A link that bends: a `share` of its body and all that it carries turn on a spring at its joint, about the joint's
    axis (across 0) or across it, out of the plane in which the joint moves it (across 1)."""

    name, port, impedance_of, carries, turns = "link-flexibility", "structure", "J", True, True
    parameters = (
        Parameter("stiffness", "Nm/rad", 0.05, 1e3, (2.0, 8.0), zero=None, relative="K"),
        Parameter("share", "", 0.05, 0.95, (0.5,), zero=None),
        replace(_DAMPING, sizes=(*_DAMPING.sizes, _DULL)),
        Parameter("across", "", 0.0, 1.0, (0.0, 1.0), zero=None, whole=True),
    )

    def freedom(self, arm: Known) -> Freedom:
        """About the joint's axis from the fitted J, less what stays of the declared link; across it from the declared links."""
        k, share, damping, across = self.values[:4]
        i, told = self.joint, None
        assert i is not None
        motion = _twist(arm, i)
        if across or arm.chain.slides(i):
            at = posed(arm.chain, arm.posture)
            axis = at.R[i] @ self._axis(arm.chain)
            motion = np.concatenate([np.cross(at.p[i], axis), axis])[None]
            C, own = coupling(arm.chain, arm.posture, motion, i, share)
        else:
            row = _row(arm, i)[0]
            link = row if i == arm.chain.n - 1 else own_inertia(arm.chain, arm.posture, i, motion[0])
            C = row - (1.0 - share) * link
            own = C[:, [i]]
            told = i if arm.J[i, i] else None
        sprung = Sprung(C, own, np.array([k]), np.array([k * damping]), _weight(arm, i, motion, share))
        return Freedom(sprung, motion, arm.chain, i, _BEND, share, told)

    def opened(self, chain: Chain) -> tuple[Chain, Sequence[int]]:
        assert self.joint is not None
        return bent(chain, self.joint, self["share"], self._axis(chain)), [self.joint + 1]

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
class AttachedResonator(Giving):
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

    def freedom(self, arm: Known) -> Freedom | None:
        J, (k, d), i = self["inertia"], self._spring(), self.joint
        assert i is not None
        if not J:
            return None
        motion = np.zeros((1, 6))
        motion[0, 3:] = posed(arm.chain, arm.posture).R[i] @ arm.chain.joints[i].axis
        w = self._turns(arm)[None]
        return Freedom(Sprung(J * w, np.array([[J]]), np.array([k]), np.array([d])), motion, arm.chain, i, _DISC)

    def impedance(self, s: Complex, arm: Known) -> Complex | None:
        if arm.beside:
            return super().impedance(s, arm)
        J, (k, d), n = self["inertia"], self._spring(), len(arm.N)
        w = np.zeros(2 * n)
        w[n:] = self._turns(arm)
        z = s**2 * J * (s * d + k) / (s**2 * J + s * d + k) if J else 0.0 * s
        return np.asarray(z[:, None, None] * np.outer(w, w))

    def opened(self, chain: Chain) -> tuple[Chain, Sequence[int]]:
        """Nothing rides on it: what it does of second order is none of the links'."""
        return replace(chain, joints=(*chain.joints, hinge(np.eye(3)[0], Inertia.zero()))), [chain.n]

    def _turns(self, arm: Known) -> Array:
        """How far it turns for each joint's unit motion [n]."""
        assert self.joint is not None
        return _turns(arm.chain, arm.posture, self.joint)

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
