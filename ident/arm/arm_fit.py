"""Maximum likelihood for a whole arm over all its records: residual theta - G tau of every motor, whitened, its chi^2.

Derivatives are analytic for the elastic arm, numerical for the few parameters of effects; the weights, which depend on G, are
held in a descent (`descent`) and made again until nothing changes (R. Pintelon, J. Schoukens, System Identification: A
Frequency Domain Approach, 2nd ed., Wiley 2012, chapters 9 and 12).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ident.arm.acting import Moved, Slid, acting, differences, linear_part, moved
from ident.arm.arm_model import DRIVES, Extra, Parameters, by_impedance, motion_and_derivatives, parameters_at, transfer
from ident.arm.evidence import Evidence
from ident.arm.scene import Scene, in_record, known, linear_extra
from ident.arm.sliding import TURNS
from ident.arm.small_matrices import times
from ident.arm.smoothing import smoothed
from ident.arm.whitening import Powers, noise_powers, whitening
from ident.effects.base import Effect, Known, has_forces, only_forces, only_gains, only_impedance, only_shares
from ident.effects.structure import Giving, all_that_gives
from ident.records.campaign import Array
from ident.records.frf import Complex
from symgen.forked import forked

#: A direction of the parameters with less information than this was not seen: its deviation is over ten times its size.
UNSEEN_INFORMATION = 1e-2
#: Relative rounding error of an information matrix.
INFORMATION_ROUNDING = 1e-13
#: Share of itself, or of its scale, by which an effect's parameter is changed to see what it does; where that is an impedance or a gain; of
#: itself, what its impedance depends on.
NUDGE, EXACT_NUDGE = 1e-4, 1e-6
#: Turns to the force of dry friction in a descent once it is late.
LATE_TURNS = 1
#: Where dry friction was found, by record and by port and joint.
Slides = Mapping[int, Mapping[tuple[str, int], Slid]]
#: What of `Extra` is forces and readings.
FORCES = ("on_motor", "on_link", "reading")


@dataclass(frozen=True, eq=False)
class Problem:
    """All records of an n-joint arm with D constants alpha and these `effects`, whose values are fitted too.

    The vector [P] is that of `Parameters` followed by the values of every effect; a step of `scale` [P] is a large one. `low`,
    `high` [P] bound it; `free` [P] are the parameters that may move. `scene_at` gives a record's scene at another posture.
    With `turns` the forces of effects are found together with the motion that they change, dry friction from where it was
    found last, `slid`, by record; with `TURNS` of them terms of second order are of the likeliest motion without forces, too.
    `expected` are a vector [P] known beforehand and the weights [P] of steps of `scale` away from it, added to chi^2. `workers` processes have a share of the records each. Fits end once `time.monotonic()` is `until`.
    """

    data: tuple[Evidence, ...]
    n: int
    D: int
    r: int
    effects: tuple[Effect, ...]
    scale: Array
    low: Array
    high: Array
    free: NDArray[np.bool_]
    scene_at: Callable[[Scene, Array], Scene]
    turns: int = 0
    expected: tuple[Array, Array] | None = None
    slid: Slides = field(default_factory=dict)
    workers: int = 1
    until: float = np.inf

    @property
    def late(self) -> bool:
        """Whether it is time to end."""
        return time.monotonic() > self.until

    @property
    def base(self) -> int:
        """The number of parameters of the elastic arm."""
        return 4 * self.n + self.D + self.r

    @cached_property
    def giving(self) -> NDArray[np.bool_]:
        """Which parameters [P] are stiffnesses or frequencies of what gives: it is felt as their inverse."""
        of_effects = [
            p.zero is None and (p.relative == "K" or p.unit == "Hz") for e in self.effects for p in e.parameters
        ]
        return np.array([False] * self.base + of_effects)

    @cached_property
    def shapes(self) -> NDArray[np.bool_]:
        """Which parameters [P] are other shapes that are never nothing: times, speeds, distances."""
        of_effects = [p.zero is None and p.low > 0.0 and not p.whole for e in self.effects for p in e.parameters]
        return np.array([False] * self.base + of_effects) & ~self.giving

    @cached_property
    def springs(self) -> NDArray[np.bool_]:
        """Which parameters [P] are logarithms of stiffnesses of joints beside which something gives, too: what both give adds up."""
        return (np.arange(len(self.scale)) < self.n) & self.giving.any()

    @cached_property
    def dampings(self) -> NDArray[np.bool_]:
        """Which parameters [P] are logarithms of dampings."""
        k = np.arange(len(self.scale))
        return (k >= 2 * self.n) & (k < 4 * self.n)

    def parameters(self, vector: Array) -> Parameters:
        return parameters_at(np.asarray(vector[: self.base], dtype=float).tobytes(), self.n, self.D)

    def effects_at(self, vector: Array) -> tuple[Effect, ...]:
        found, k = [], self.base
        for effect in self.effects:
            found.append(effect.with_values(vector[k : k + len(effect.values)].tolist()))
            k += len(effect.values)
        return tuple(found)

    def scene(self, one: Evidence, effects: Sequence[Effect]) -> Scene:
        """The record's scene, at the posture where the effects put the arm."""
        q = one.scene.posture
        for effect in effects:
            q = effect.posture(q)
        return one.scene if q is one.scene.posture else self.scene_at(one.scene, q)


def scale_of(start: Parameters) -> Array:
    """Returns what a large step is [P]: a factor e of a drive, the size of an alpha or first moment (1 % of the largest)."""
    drives = np.ones(4 * len(start.K))
    sizes = [np.maximum(np.abs(x), 1e-2 * np.abs(x).max(initial=1e-9)) for x in (start.alpha, start.gravity)]
    return np.concatenate([drives, *sizes])


@dataclass(frozen=True, eq=False)
class Held:
    """What stays as it is during one descent: the whitening matrices `W` [L, m, m] of a record and how the arm moved."""

    W: Complex
    moved: Moved | None


def hold(problem: Problem, vector: Array, doubt: float = 0.0, hurries: bool = False) -> list[Held]:
    """Weights and motions of all records, for the arm at `vector`. One that `hurries` takes `LATE_TURNS` once it is late: what such motions
    leave says whether to go on, and is told of nothing."""
    whole, effects = problem.parameters(vector), problem.effects_at(vector)
    forceful = any(map(has_forces, effects))

    def told(one: Evidence) -> tuple[Moved | None, Powers]:
        p = in_record(whole, effects, one.index)
        scene = problem.scene(one, effects)
        powers = noise_powers(scene.arm, p, one.sampling, one.noise, scene.theta, linear_extra(scene, p, effects))
        how = moved(scene, p, effects)
        turns = min(problem.turns, LATE_TURNS) if hurries and forceful and problem.late else problem.turns
        if how is not None and turns >= (1 if forceful else TURNS):
            how = smoothed(scene, p, effects, how, one.sampling, powers, turns, problem.slid.get(one.index))
        if how is not None and how.lined:
            linear = linear_part(scene, p, effects, how)
            powers = noise_powers(scene.arm, p, one.sampling, one.noise, scene.theta, linear)
        return how, powers

    records = {id(one.scene): one for one in problem.data}  # the same may be judged at some lines here, at others there
    every = forked(told, list(records.values()), problem.workers if forceful else 1)
    found = dict(zip(records, every, strict=True))
    held = []
    for one in problem.data:
        how, powers = found[id(one.scene)]
        W = whitening(powers, one.scene.theta, doubt)
        held.append(Held(W if one.judged is None else W * one.judged[:, None, None], how))
    return held


def slides(problem: Problem, held: Sequence[Held]) -> Slides:
    """Where dry friction was found in each record."""
    found = {one.index: kept.moved.slid for one, kept in zip(problem.data, held, strict=True) if kept.moved is not None}
    return {**problem.slid, **{record: slid for record, slid in found.items() if slid}}


def residual(
    problem: Problem, vector: Array, one: Evidence, how: Moved | None, derive: bool = False, judged: bool = False
) -> tuple[Complex, Complex, NDArray[np.int64]]:
    """Returns theta - G tau [L, m], its derivatives [L, m, C] and the parameters [C] that they belong to; with `judged` at
    those lines only that count."""
    whole, effects = problem.parameters(vector), problem.effects_at(vector)
    use = one.use if judged else np.ones(len(one.sampling.f), dtype=bool)
    sampling = replace(one.sampling, f=one.sampling.f[use])

    def acted(effects: tuple[Effect, ...]) -> tuple[Scene, Parameters, Extra]:
        scene, p = problem.scene(one, effects), in_record(whole, effects, one.index)
        return scene, p, acting(scene, p, effects, how).at(use)

    def run(scene: Scene, p: Parameters, extra: Extra, derive: bool) -> tuple[Complex, Complex]:
        theta, slopes = motion_and_derivatives(scene.arm, p, sampling, scene.tau[use], extra, derive)
        return scene.theta[use] - theta, -slopes

    scene, p, extra = acted(effects)
    r, slopes = run(scene, p, extra, derive)
    if not derive:
        return r, slopes, np.zeros(0, dtype=np.int64)
    columns, more = [scene.arm.columns(problem.n)], [slopes]
    if not effects:
        return r, slopes, columns[0]
    arms = [known(scene, p, (*effects[:place], *effects[place + 1 :])) for place in range(len(effects))]
    s, theta = scene.s[use], scene.theta[use] - r
    on_motor, on_link = pushed = transfer(scene.arm, p, s, extra)
    for effect, arm in zip(effects, arms, strict=True):
        if effect.impedance_of and effect.joint in scene.arm.live:
            slopes -= _by_impedance(scene, p, effect, arm, theta, extra, use, pushed)
    k = problem.base
    for place, (effect, arm) in enumerate(zip(effects, arms, strict=True)):
        nudged = _nudged(problem, effect, k)
        k += len(effect.values)
        if not nudged:
            continue
        places, nudges, changed = zip(*nudged, strict=True)
        if only_shares(effect):
            moves = _by_shares(scene, effect, changed, one.index, slopes)
        elif only_gains(effect):
            torque = scene.acting_torque(None)[use] * (1.0 if extra.torque_gain is None else extra.torque_gain)
            turned = on_motor * (scene.arm.N * torque)[:, None]
            read = theta - (0.0 if extra.reading is None else extra.reading)
            moves = _by_gains(scene, effect, changed, arm, s, turned, read)
        elif only_impedance(effect):
            Z = _impedances(scene, s, [(effect, arm), *((other, arm) for other in changed)])
            moves = by_impedance(scene.arm, p, s, extra, theta, Z[1:] - Z[0], pushed)
        elif how is not None and only_forces(effect):
            by = [beyond.at(use) for beyond in differences(scene, effect, changed, how)]
            motor, link, reading = (np.stack([getattr(b, name) for b in by], axis=2) for name in FORCES)
            moves = on_motor @ motor + on_link @ link + reading
            if by[0].impedance is not None:
                moves += by_impedance(scene.arm, p, s, extra, theta, np.array([b.impedance for b in by]), pushed)
        else:
            others = [acted((*effects[:place], e, *effects[place + 1 :])) for e in changed]
            moves = np.stack([r - run(*other, False)[0] for other in others], axis=2)
        more.append(-moves / np.array(nudges))
        columns.append(np.array(places))
    return r, np.concatenate(more, axis=2), np.concatenate(columns)


def _nudged(problem: Problem, effect: Effect, first: int) -> list[tuple[int, float, Effect]]:
    """(its place in the vector, by how much it is changed, the effect that is then) of each value that is free."""
    found = []
    for j, value in enumerate(effect.values):
        if not problem.free[first + j]:
            continue
        size = problem.scale[first + j]
        share = EXACT_NUDGE if only_impedance(effect) or only_gains(effect) else NUDGE
        nudge = share * float(np.clip(abs(value), 1e-2 * size, size))
        nudge = nudge if value + nudge <= problem.high[first + j] else -nudge
        found.append((first + j, nudge, effect.with_value(j, value + nudge)))
    return found


def _by_shares(scene: Scene, effect: Effect, others: Sequence[Effect], record: int, slopes: Complex) -> Complex:
    """By how much `others`, by which drives change by other shares than by `effect`, change the angles [L, m, k] of a record in which
    the residual follows the arm's parameters by `slopes` [L, m, C]."""
    live, now = scene.arm.live, effect.shares(record)
    moves = np.zeros((*slopes.shape[:2], len(others)), dtype=complex)
    for here in np.flatnonzero(live == effect.joint):
        for k, other in enumerate(others):
            for name, share in other.shares(record).items():
                along = slopes[:, :, DRIVES.index(name) * len(live) + here]
                moves[:, :, k] -= along * np.log((1.0 + share) / (1.0 + now[name]))
    return moves


def _by_gains(
    scene: Scene, effect: Effect, others: Sequence[Effect], arm: Known, s: Complex, turned: Complex, read: Complex
) -> Complex:
    """By how much `others`, whose gains are others than those of `effect`, change the angles [L, m, k] at s [L] that each motor's torque
    has `turned` [L, m, m (motor)] and that are `read` [L, m] in all. Aliases of torques, which turn hardly anything, stay."""
    live, moves = scene.arm.live, np.zeros((*read.shape, len(others)), dtype=complex)
    for hook, by in (("torque_gain", turned), ("angle_gain", np.eye(len(live)) * read[:, None])):
        now, *then = (getattr(one, hook)(s, arm) for one in (effect, *others))
        if now is not None:
            moves += by @ np.stack([gain[:, live] / now[:, live] - 1.0 for gain in then], axis=2)
    return moves


def _impedances(scene: Scene, s: Complex, cases: Sequence[tuple[Effect, Known]]) -> Complex:
    """What an effect adds to the dynamic stiffness of the live joints of an arm, case by case, at s [L]: [k, L, 2m, 2m]; with what gives
    beside it, which is the same in all cases, if there is any."""
    nothing = np.zeros((len(s), 2 * scene.n, 2 * scene.n), dtype=complex)
    every = [
        all_that_gives(s, arm, (*arm.beside, effect))
        if arm.beside and isinstance(effect, Giving)
        else effect.impedance(s, arm)
        for effect, arm in cases
    ]
    return np.array([scene.of_live(nothing if Z is None else Z) for Z in every])


def _by_impedance(
    scene: Scene, p: Parameters, effect: Effect, now: Known, theta: Complex, extra: Extra, use: NDArray[np.bool_],
    pushed: tuple[Complex, Complex],
) -> Complex:  # fmt: skip
    """How the angles `theta` [L, m] at the lines in `use` follow the arm's parameters [C] through the impedance of `effect`, and of
    what gives beside it, by what it is told of `now`; under `extra` at these lines, where forces have `pushed` the angles [L, m, C]."""
    arm, s, i = scene.arm, scene.s[use], effect.joint
    assert i is not None
    m, (here,) = len(arm.live), np.flatnonzero(arm.live == i)
    weights = np.zeros((m, len(arm.columns(scene.n))))  # of what the impedance depends on, by the parameters
    changed = []
    if effect.impedance_of == "K":
        step, K = EXACT_NUDGE, now.K.copy()
        K[i] *= 1.0 + step
        changed.append(replace(now, K=K))
        weights[0, here] = 1.0
    else:
        step = EXACT_NUDGE * float(now.J[i, i])
        for k, j in enumerate(arm.live.tolist()):
            J = now.J.copy()
            J[i, j] += step  # of the row that this effect is told by; another one beside it has its own
            changed.append(replace(now, J=J))
            weights[k, 4 * m : 4 * m + arm.J_rows.shape[2]] = arm.J_rows[here, k]
    Z = _impedances(scene, s, [(effect, one) for one in (now, *changed)])
    return by_impedance(arm, p, s, extra, theta, (Z[1:] - Z[0]) / step, pushed) @ weights[: len(changed)]


def whitened_by(W: Complex, r: Complex) -> Complex:
    """Returns angles r [L, m, rad] in units of their noise [L, m, 1], by whitening matrices W [L, m, m, 1/rad]."""
    return times(W, r)


def chi_squared(problem: Problem, vector: Array, held: Sequence[Held]) -> float:
    """chi^2 of all records; infinite where the arm is not one (J not positive, numbers beyond numbers)."""
    total = unexpected(problem, vector)[0]
    for one, kept in zip(problem.data, held, strict=True):
        total += chi_squared_of(problem, vector, one, kept)
        if not np.isfinite(total):
            return float(np.inf)
    return total


def chi_squared_of(problem: Problem, vector: Array, one: Evidence, kept: Held) -> float:
    """chi^2 of one record; infinite as that of all."""
    with np.errstate(all="ignore"):  # a trial step beyond numbers is refused for its size
        J = one.scene.arm.J(problem.parameters(vector))
        if not np.isfinite(J).all() or not is_positive(J):
            return float(np.inf)
        r = residual(problem, vector, one, kept.moved, judged=True)[0]
        chi2 = 2.0 * float(np.sum(np.abs(whitened_by(kept.W[one.use], r)) ** 2))
    return chi2 if np.isfinite(chi2) else float(np.inf)


def is_positive(J: Array) -> bool:
    """Whether an inertia matrix [m, m] is positive beyond rounding, by which it would have no inverse."""
    moments = np.linalg.eigvalsh(J)
    return bool(moments[0] > len(J) * np.finfo(float).eps * moments[-1])


def chi_squared_of_lines(problem: Problem, vector: Array, one: Evidence, kept: Held) -> Array:
    """chi^2 [L] of a record at each of its lines."""
    r = residual(problem, vector, one, kept.moved)[0]
    return np.asarray(2.0 * np.sum(np.abs(whitened_by(kept.W, r)) ** 2, axis=1))


def whitened(problem: Problem, vector: Array, one: Evidence, kept: Held) -> tuple[Complex, Complex, NDArray[np.int64]]:
    """Returns the whitened residual of a record [L m], its derivatives [L m, C] per step of `scale`, and their parameters [C]."""
    r, slopes, columns = residual(problem, vector, one, kept.moved, derive=True, judged=True)
    W = kept.W[one.use]
    A = (W @ (slopes * problem.scale[columns])).reshape(-1, len(columns))
    return whitened_by(W, r).ravel(), A, columns


def unexpected(problem: Problem, vector: Array) -> tuple[float, Array, Array]:
    """What `Problem.expected` adds to chi^2, half its gradient [P] and half its Hessian [P, P]."""
    P = len(vector)
    if problem.expected is None:
        return 0.0, np.zeros(P), np.zeros((P, P))
    centre, weight = problem.expected
    away = (vector - centre) / problem.scale
    return float(weight @ away**2), weight * away, np.diag(weight)


def spectrum(information: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Returns eigenvalues [P], eigenvectors [P, P] of the information, and which of them were seen."""
    values, vectors = np.linalg.eigh(information)
    return values, vectors, values > max(UNSEEN_INFORMATION, INFORMATION_ROUNDING * values[-1])
