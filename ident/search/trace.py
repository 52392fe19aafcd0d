"""Where a residual acts, and what could make it: the residual of a fit, linearised, against every port and candidate.

A force at one port moves all measured motors in one known direction at each frequency, whatever its law is: so the port
can be found before the effect. A candidate is scored with everything else refitted (one Gauss-Newton step of all
parameters), never by correlation alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ident.arm.acting import moved
from ident.arm.arm_fit import Held, Problem, residual, whitened_by
from ident.arm.arm_model import Parameters, transfer
from ident.arm.parts import few_lines, few_records
from ident.arm.scene import Scene, in_record, known, linear_extra
from ident.arm.small_matrices import by_component
from ident.effects.base import Known
from ident.effects.motion import Motion
from ident.records.campaign import Array
from ident.records.frf import Complex

#: Ports at which one signal acts on one joint.
PORTS = ("motor", "spring", "link", "sensor")
#: Lines of a record, and records about, by which candidates are told where much is left.
FEW_LINES, FEW_RECORDS = 250, 20
#: Noise powers at lines that no torque excites from which what acts there is no matter of small motions about a linear arm.
DISTORTED = 100.0
#: Relative ridge of a Gauss-Newton step: directions weaker than this are left alone.
RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class Judged:
    """What candidates need of a record, at the lines judged alone: s [L], what unit signals at the ports of live joints do to all whitened
    angles [L, m, m], and by port (theta / N, q) of the live joints [L, 2m]; their angles and torques as they act [L, m]."""

    s: Complex
    pushes: dict[str, Complex]
    positions: dict[str, Complex]
    theta: Complex
    torque: Complex


@dataclass(frozen=True, eq=False)
class Linearised:
    """A fit about `vector`, all whitened: residuals [one a record: L, m], Jacobians [L, m, C] with their columns [C], of the
    free parameters in units of `scale`. `W` [one a record: L, m, m]."""

    problem: Problem
    vector: Array
    W: tuple[Complex, ...]
    r: tuple[Complex, ...]
    A: tuple[Complex, ...]
    columns: tuple[NDArray[np.int64], ...]

    def by_few(self) -> Linearised:
        """The same by fewer lines of fewer records."""
        few = few_records(self.problem.data, FEW_RECORDS)
        places = [k for k, one in enumerate(self.problem.data) if any(one is other for other in few)]
        W, r, A = (tuple(of[k] for k in places) for of in (self.W, self.r, self.A))
        problem = replace(self.problem, data=tuple(few_lines(one, FEW_LINES) for one in few))
        return Linearised(problem, self.vector, W, r, A, tuple(self.columns[k] for k in places))

    @cached_property
    def information(self) -> Array:
        """Of all records [P, P]."""
        return np.asarray(sum(self.blocks[0]))

    @cached_property
    def slope(self) -> Array:
        """Half the gradient of chi^2 [P]."""
        return np.asarray(sum(self.blocks[1]))

    @cached_property
    def blocks(self) -> tuple[list[Array], list[Array]]:
        """Information [P, P] and slope [P] of each record."""
        P = len(self.vector)
        matrices, slopes = [], []
        for one, r, A, columns in zip(self.problem.data, self.r, self.real, self.columns, strict=True):
            matrix, slope = np.zeros((P, P)), np.zeros(P)
            matrix[np.ix_(columns, columns)] = 2.0 * (A.T @ A)
            slope[columns] = 2.0 * (A.T @ _real(r[one.use]))
            matrices.append(matrix)
            slopes.append(slope)
        return matrices, slopes

    @cached_property
    def real(self) -> tuple[Array, ...]:
        """The Jacobians at the lines judged [2 L m, C]: real parts, then imaginary ones."""
        return tuple(_real(A[one.use], A.shape[2]) for one, A in zip(self.problem.data, self.A, strict=True))

    @cached_property
    def scenes(self) -> tuple[Scene, ...]:
        """Each record's scene, at the posture where the effects put the arm."""
        effects = self.problem.effects_at(self.vector)
        return tuple(self.problem.scene(one, effects) for one in self.problem.data)

    @cached_property
    def arms(self) -> tuple[tuple[Parameters, Known], ...]:
        """The arm as it is in each record, and as effects know it there."""
        effects, p = self.problem.effects_at(self.vector), self.problem.parameters(self.vector)
        here = [in_record(p, effects, one.index) for one in self.problem.data]
        return tuple((p, known(scene, p, effects)) for scene, p in zip(self.scenes, here, strict=True))

    def acting_torque(self, at: int) -> Complex:
        """The motors' torques in record `at` [L, m] as they act: behind the gains that the fit has already, and held."""
        effects = self.problem.effects_at(self.vector)
        return self.scenes[at].acting_torque(linear_extra(self.scenes[at], self.arms[at][0], effects).torque_gain)

    @cached_property
    def chi2(self) -> float:
        return 2.0 * sum(float(np.vdot(r, r).real) for r in self.r)

    @cached_property
    def motions(self) -> dict[str, tuple[Motion, ...]]:
        """For each port: how the arm moved in each record, found without trusting the equation of that port."""
        effects = self.problem.effects_at(self.vector)

        def at(port: str) -> Iterator[Motion]:
            for scene, (p, _) in zip(self.scenes, self.arms, strict=True):
                how = moved(scene, p, effects, port)
                assert how is not None
                yield how.motion

        return {port: tuple(at(port)) for port in ("motor", "spring", "link")}

    @cached_property
    def swings(self) -> dict[tuple[str, int], tuple[float, float, float]]:
        """The largest rms angle, rate and torque of each joint at each port, over the records, by its `motions`."""
        found = {}
        for port, motions in self.motions.items():
            for joint in range(self.problem.n):
                kinds = zip(*(motion.at(port, joint) for motion in motions), strict=True)
                angle, rate, torque = (max(float(np.std(signal)) for signal in kind) for kind in kinds)
                found[port, joint] = angle, rate, torque
        return found

    @cached_property
    def positions(self) -> dict[str, tuple[Complex, ...]]:
        """For each port: (theta / N, q) of the live joints at the lines of each record [L, 2m], by its `motions`."""

        def at(port: str) -> Iterator[Complex]:
            for one, motion in zip(self.problem.data, self.motions[port], strict=True):
                live = one.scene.arm.live
                signals = np.concatenate([motion.of("theta", live) / motion.N[live], motion.of("q", live)], axis=1)
                yield one.scene.at_lines(signals)

        return {port: tuple(at(port)) for port in self.motions}

    @cached_property
    def pushes(self) -> tuple[dict[str, Complex], ...]:
        """For each record and port: what unit signals at the live joints do to all whitened angles [L, m (angle), m (joint)], joint
        side; a motor's own torque counts N times."""
        effects, found = self.problem.effects_at(self.vector), []
        for scene, W, (p, _) in zip(self.scenes, self.W, self.arms, strict=True):
            extra = linear_extra(scene, p, effects)
            on_motor, on_link = transfer(scene.arm, p, scene.s, extra)
            by_port = {"motor": on_motor * scene.arm.N, "spring": on_link - on_motor, "link": on_link}
            found.append({port: W @ matrix for port, matrix in by_port.items()} | {"sensor": W})
        return tuple(found)

    @cached_property
    def ports(self) -> tuple[dict[tuple[str, int], Complex], ...]:
        """For each record: what a unit signal at a port of a joint does to all whitened angles [L, m]."""
        return tuple(
            {
                (port, int(j)): matrix[:, :, k]
                for port, matrix in pushes.items()
                for k, j in enumerate(one.scene.arm.live)
            }
            for one, pushes in zip(self.problem.data, self.pushes, strict=True)
        )

    @cached_property
    def judged(self) -> tuple[Judged, ...]:
        """Each record at the lines judged."""

        def at(k: int, use: NDArray[np.bool_]) -> Judged:
            pushes = {port: by_component(np.moveaxis(matrix[use], 0, 2)) for port, matrix in self.pushes[k].items()}
            positions = {port: found[k][use] for port, found in self.positions.items()}
            return Judged(
                self.scenes[k].s[use], pushes, positions, self.scenes[k].theta[use], self.acting_torque(k)[use]
            )

        return tuple(at(k, one.use) for k, one in enumerate(self.problem.data))

    def prepare(self) -> None:
        """Computes what all candidates need, once, before they are shared out."""
        _ = self.information, self.slope, self.motions, self.swings, self.ports, self.arms, self.judged

    def step(self, columns: Sequence[Sequence[Complex | None]], leaving: Sequence[int] = ()) -> tuple[Array, float]:
        """Returns how large each new column wants to be, all free parameters refitted, and by how much chi^2 falls.

        A column is what one unit of a parameter adds to the whitened prediction at the lines judged: an array [L, m] a record, None:
        nothing. Records that are `leaving`, by their places, tell nothing.
        """
        k, free = len(columns), np.flatnonzero(self.problem.free)
        X, own, b = np.zeros((len(self.vector), k)), np.zeros((k, k)), np.zeros(k)
        for at, (one, r, A, where) in enumerate(zip(self.problem.data, self.r, self.real, self.columns, strict=True)):
            here = [i for i in range(k) if columns[i][at] is not None]
            if not here or at in leaving:
                continue
            B = np.stack([_real(np.asarray(columns[i][at])) for i in here], axis=1)
            X[np.ix_(where, np.array(here))] += 2.0 * (A.T @ B)
            own[np.ix_(np.array(here), np.array(here))] += 2.0 * (B.T @ B)
            b[here] += 2.0 * (B.T @ _real(r[one.use]))
        H, g = self.information, self.slope
        for at in leaving:
            H, g = H - self.blocks[0][at], g - self.blocks[1][at]
        H, g, X = H[np.ix_(free, free)], g[free], X[free]
        size = np.sqrt(np.maximum(np.diag(H), 1e-300))
        solved = np.linalg.solve(
            H / size / size[:, None] + RIDGE * np.eye(len(free)), np.column_stack([X, g]) / size[:, None]
        )
        left = own - (X / size[:, None]).T @ solved[:, :k]
        b = b - (X / size[:, None]).T @ solved[:, k]
        unit = np.sqrt(
            np.maximum(np.diag(own), 1e-300)
        )  # by its own size: what the other parameters do as well is nothing
        sizes = np.linalg.pinv(left / unit / unit[:, None], rcond=1e-5, hermitian=True) @ (b / unit) / unit
        return sizes, float(b @ sizes)


def _real(x: Complex, columns: int = 0) -> Array:
    """Numbers in a row, or rows of so many: real parts, then imaginary ones."""
    flat = x.reshape(-1, columns) if columns else x.ravel()
    return np.concatenate([flat.real, flat.imag])


def along(a: Complex, r: Complex) -> tuple[Complex, Array]:
    """Returns the force [L] at a port whose unit adds `a` [L, m] to the whitened angles, from residuals r [L, m], in units of the
    port; and its square over its variance [L]."""
    size = np.maximum(np.sum(np.abs(a) ** 2, axis=1), 1e-300)
    product = np.sum(a.conj() * r, axis=1)
    return product / size, np.abs(product) ** 2 / size


def distorts(lin: Linearised) -> bool:
    """Whether far more than noise is left at lines that no torque excites: what is linear in the motion leaves hardly anything there."""
    data = zip(lin.problem.data, lin.r, strict=True)
    powers = [np.abs(r[one.use & ~one.is_excited]) ** 2 for one, r in data]
    return sum(power.sum() for power in powers) > DISTORTED * max(sum(power.size for power in powers), 1)


def port_shares(lin: Linearised, low: float = 0.0, high: float = np.inf) -> tuple[tuple[str, int, float], ...]:
    """Returns how much of what is in excess of noise from `low` [Hz] to below `high` a free force at each (port, joint) explains,
    largest first; 0 for all where nothing is in excess.

    One complex number a line for every port: each takes 2 of its 2 m degrees of freedom. 1 means that all of the residual
    points where that port pushes.
    """
    left: dict[tuple[str, int], float] = {}
    total = 0.0
    for one, r, ports in zip(lin.problem.data, lin.r, lin.ports, strict=True):
        use = one.use & (one.sampling.f >= low) & (one.sampling.f < high)
        total += 2.0 * float(np.sum(np.abs(r[use]) ** 2)) - 2.0 * r[use].size
        for key, a in ports.items():
            power = along(a, r)[1]
            left[key] = left.get(key, 0.0) + 2.0 * float(np.sum(power[use])) - 2.0 * int(use.sum())
    shares = [(port, joint, value / total if total > 0.0 else 0.0) for (port, joint), value in left.items()]
    return tuple(sorted(shares, key=lambda share: -share[2]))


def linearise(problem: Problem, vector: Array, held: Sequence[Held]) -> Linearised:
    """The fit about `vector`, held as it was fitted."""
    r, A, columns = [], [], []
    for one, kept in zip(problem.data, held, strict=True):
        residuals, slopes, where = residual(problem, vector, one, kept.moved, derive=True)
        use = problem.free[where]
        where = where[use]
        r.append(whitened_by(kept.W, residuals))
        A.append(kept.W @ (slopes[:, :, use] * problem.scale[where]))
        columns.append(where)
    W = tuple(kept.W for kept in held)
    return Linearised(problem, vector, W, tuple(r), tuple(A), tuple(columns))
