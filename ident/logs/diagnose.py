"""The loop on a log: what the declared rigid arm lacks, added to it; the errors before and after on what nothing else has seen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ident.identification.links import Links, nearest_links
from ident.identification.physical import pseudo_inertia
from ident.logs.equations import Equations, Fit, Part, equations
from ident.logs.faults import refuse_signals, refuse_slips
from ident.logs.impossible import impossible
from ident.logs.moves import Bands, moves
from ident.logs.search import Found, searched
from ident.logs.terms import Term, sizes, terms
from ident.records.log import Array, Log
from symgen.plan import Model, model_of_urdf

#: Held-out error, of noise alone, up to which a log is explained.
EXPLAINED = 1.3


@dataclass(frozen=True, eq=False)
class LogDiagnosis:
    """What was found in a log. `status` is "explained", "effect-found" or "unexplained"; `before` the declared arm and `found.end` the corrected one,
    both as they are judged on `equations.report`."""

    log: Log
    model: Model
    bands: Bands
    equations: Equations
    found: Found

    @property
    def before(self) -> Fit:
        return self.found.start

    @property
    def after(self) -> Fit:
        return self.found.end

    @cached_property
    def noise(self) -> Array:
        """What noise alone leaves [n, rms, N m] of the torques: of a motion that was repeated what its repetitions leave otherwise; else what is above
        the equations' band, were it as strong within."""
        e = self.equations
        apart = [
            other - one
            for part in (e.fit, e.select, e.report)
            for one, other in _again(part, self.after.left(part), e.repeats)
        ]
        return np.sqrt(np.mean(np.concatenate(apart) ** 2, axis=0) / 2) if apart else e.noise

    @property
    def status(self) -> str:
        if self.impossible:
            return "unexplained"  # numbers that no arm has explain nothing
        if self.found.steps and self.found.errors[-1] > self.found.errors[0]:
            return "unexplained"  # what told motion that nothing has seen worse is none of what acts
        if self.found.errors[-1] > EXPLAINED * share(self.noise**2, self.equations.report):
            return "unexplained"
        return "effect-found" if self.found.steps else "explained"

    @cached_property
    def parameters(self) -> tuple[Array, Array]:
        """The links' inertial parameters [10 n] as found, and their covariance: of the declared ones where none was found to be off."""
        phi, covariance = self.model.chain.parameters.reshape(-1).copy(), np.zeros((10 * self.log.n,) * 2)
        size = sizes(self.model)
        for term, x, spread in self.equations.of(self.after):
            if term.width:
                phi += size * x
                covariance += np.outer(size, size) * spread
            elif term.name == "payload":
                last = slice(10 * (self.log.n - 1), 10 * (self.log.n - 1) + 4)
                phi[last] += x
                covariance[last, last] += spread
        return phi, covariance

    @cached_property
    def alpha(self) -> tuple[Array, Array]:
        """The constants of J(q) [D] as found, and their covariance."""
        (phi, covariance), W = self.parameters, self.model.factoring.W
        return W @ phi, W @ covariance @ W.T

    @cached_property
    def impossible(self) -> tuple[tuple[Term | None, str], ...]:
        """What was found that no arm has, and of which term (None: of all that makes J(q))."""
        if not self.found.steps:
            return ()
        return tuple(impossible(self.log, self.model, *self.alpha, self.equations.of(self.after)))

    @cached_property
    def links(self) -> Links:
        """The links that files hold: those found, or, where no bodies have these, the nearest to CAD that have their J(q), or the nearest to it."""
        (alpha, spread), n = self.alpha, self.log.n
        if self.bodies:
            return Links(self.parameters[0].reshape(n, 10), alpha, True, True, 0.0, np.zeros(n), ())
        return nearest_links(self.model, alpha, spread + np.diag(np.full(len(alpha), 1e-12 * np.abs(alpha).max() ** 2)))

    @property
    def bodies(self) -> bool:
        """Whether there can be links with these parameters; those that were declared are taken as they are."""
        phi = self.parameters[0]
        if np.array_equal(phi, self.model.chain.parameters.reshape(-1)):
            return True
        return bool(np.linalg.eigvalsh(pseudo_inertia(phi.reshape(-1, 10))).min() > 0.0)


def diagnose_log(log: Log, say: Callable[[str], None] = lambda line: None) -> LogDiagnosis:
    """Returns what the declared arm of a log lacks.

    IdentError, one line: trajectories that are too short, in which nothing moves; a fault of the recording (`ident.logs.faults`): what bends the fit of
    a wrong sign or unit is no effect.
    """
    refuse_signals(log)
    model = model_of_urdf(log.urdf, log.joints)
    moved = moves(log)
    refuse_slips(log, model, moved)
    made = equations(log, model, moved, terms(log, model, moved))
    return LogDiagnosis(log, model, moved[0].bands, made, searched(made, say))


def _again(part: Part, left: Array, repeats: Sequence[tuple[str, str]]) -> Iterator[tuple[Array, Array]]:
    """What is left of the same piece of a motion, once and again."""
    ends = np.cumsum([span.samples for span in part.spans])
    pieces = {span.id: left[end - span.samples : end] for span, end in zip(part.spans, ends, strict=True)}
    for one, other in repeats:
        if one in pieces and other in pieces:
            size = min(len(pieces[one]), len(pieces[other]))
            yield pieces[one][:size], pieces[other][:size]


def share(power: Array, part: Part) -> float:
    """What powers [n] left of the joints are of all torques of a part, relative rms."""
    return float(np.sqrt(np.sum(power) / np.sum(np.mean(part.tau**2, axis=0))))
