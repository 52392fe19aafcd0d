"""What an effect adds to the torque of a rigid arm, as columns of a linear equation.

Joint side, with port forces as in `ident.effects`: N tau = Y(q, v, a) phi + N^2 J_m a - N F_motor - F_link. A term is an effect at a joint, or of the
whole arm, with its columns; what is not linear in it (a speed, an order) is tried at several values, each a term of its own. Effects of which
only the first order is a column (a late torque, a zero that is off, a tilted base) are small where they are told.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from ident.effects.catalogue import CATALOGUE
from ident.effects.motion import CREEP, direction
from ident.logs.moves import Moves
from ident.records.log import Array, Log
from symgen.plan import Model

#: Speeds of a Stribeck curve, of the rms velocity; whole orders of a ripple, per turn of the motor.
SPEEDS, ORDERS = (0.05, 0.15, 0.4, 1.0), (1, 2, 3, 4, 6, 8, 12)
#: Steps of the differences that give what a zero that is off [rad or m] and a tilt [rad] do.
STEP = 1e-4
#: Knots of a learned curve, at even shares of the samples.
KNOTS = 9
#: Shapes of a curve: without what names have at its joint, or whole. The names whose straight line one of each variable has.
BENT, WHOLE = (0.0,), (1.0,)
STRAIGHT = {
    "velocity": ("motor-viscous", "motor-coulomb", "motor-stribeck", "motor-quadratic-drag"),
    "position": ("cable-stiffness", "torque-offset"),
    "torque": ("torque-scale", "torque-offset", "load-dependent-friction"),
}
#: Periods of a ripple that a joint has to go through to show it.
PERIODS = 2.0
#: Numbers of which only the first order is a column are told up to this.
SMALL = {"torque-scale": 0.5, "joint-zero-offset": 0.2, "gravity-stiffness": 0.3}

#: By what shares of themselves links may be other ones than declared: each is tried.
WIDTHS = (0.03, 0.1, 0.3, 1.0)
#: Radius [m] that a link has at least, where its inertia is compared with its mass.
RADIUS = 0.05

#: Units of a motor that moves a slide itself.
_DIRECT = {"Nm": "N", "Nms/rad": "Ns/m", "Nms2/rad2": "Ns2/m2", "kgm2": "kg", "rad/s": "m/s", "rad": "m"}

Key = tuple[str, int | None, str, tuple[float, ...]]
Columns = Callable[[Moves], Array]
Told = Callable[[Array], Array]


def _as_is(coefficients: Array) -> Array:
    return coefficients


@dataclass(frozen=True, eq=False)
class Term:
    """An effect of the log's model: `columns` gives [S, n, c] for a trajectory, `told` its parameters [p] for c coefficients, which are the
    catalogue's by name. `knots` of a learned curve of `variable`. A term with a `width` is the links' inertial parameters: free, but for
    what the declared ones make likely."""

    name: str
    joint: int | None
    port: str
    parameters: tuple[tuple[str, str], ...]
    columns: Columns
    told: Told = _as_is
    shape: tuple[float, ...] = ()
    variable: str = ""
    knots: tuple[float, ...] = ()
    width: float = 0.0

    @property
    def key(self) -> Key:
        """What its columns are of, whatever its width."""
        return self.name, self.joint, self.variable, self.shape

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Between what each of its parameters is: the catalogue's bounds, where these are not relative."""
        kinds, far = CATALOGUE[self.name].parameters, SMALL.get(self.name, np.inf)
        low = [max(0.0 if p.low >= 0.0 else -np.inf if p.relative else p.low, -far) for p in kinds]
        return np.array(low), np.array([min(np.inf if p.relative else p.high, far) for p in kinds])

    @property
    def place(self) -> tuple[str, int | None, str]:
        """What it is, whatever its shape."""
        return self.name, self.joint, self.variable


def terms(log: Log, model: Model, moved: Sequence[Moves]) -> tuple[Term, ...]:
    """Returns every term that the trajectories `moved` of a log may need."""
    declared = model.chain.parameters.reshape(-1)

    @cache
    def loads(m: Moves) -> Array:
        return np.asarray(model.torque_rows(m.q, m.v, m.a, log.gravity) @ declared)

    own = [term for j in range(log.n) for term in _of_joint(log, model, moved, j, loads)]
    zeros = [
        _term(log, "joint-zero-offset", j, _zero_off(log, model, j, declared), slides=model.chain.slides(j))
        for j in range(log.n)
    ]
    return (*own, *zeros, *_of_arm(log, model, declared), links(log, model))


def _term(
    log: Log, name: str, joint: int | None, columns: Columns, told: Told = _as_is, shape: tuple[float, ...] = (), slides: bool = False
) -> Term:  # fmt: skip
    kind = CATALOGUE[name]
    direct = slides and joint is not None and abs(log.N[joint]) == 1.0
    units = [_DIRECT.get(unit, unit) if direct else unit for unit in (kind.unit(p, slides) for p in kind.parameters)]
    parameters = tuple((p.name, unit) for p, unit in zip(kind.parameters, units, strict=True))
    return Term(name, joint, kind.port, parameters, columns, told, shape)


def _of_joint(
    log: Log, model: Model, moved: Sequence[Moves], j: int, loads: Callable[[Moves], Array]
) -> Iterator[Term]:
    """What may act at joint j; `loads` are the torques [S, n] of the declared links."""
    N, slides = float(log.N[j]), model.chain.slides(j)

    def row(of: Callable[[Moves], Sequence[Array]]) -> Columns:
        """Columns that act at this joint alone."""

        def columns(m: Moves) -> Array:
            values = np.stack(np.broadcast_arrays(*of(m)), axis=-1)
            result = np.zeros((*m.q.shape, values.shape[-1]))
            result[:, j] = values
            return result

        return columns

    def term(
        name: str, of: Callable[[Moves], Sequence[Array]], told: Told = _as_is, shape: tuple[float, ...] = ()
    ) -> Term:
        return _term(log, name, j, row(of), told, shape, slides)

    def load(m: Moves) -> Array:
        return loads(m)[:, j]

    def sliding(m: Moves) -> Array:
        return abs(N) * way(m.v[:, j])

    def stribeck(speed: float) -> Term:
        def of(m: Moves) -> Sequence[Array]:
            return [sliding(m), sliding(m) * np.exp(-((N * m.v[:, j] / speed) ** 2))]

        return term("motor-stribeck", of, lambda c: np.append(c, speed), (speed,))

    def ripple(order: float) -> Term:
        def of(m: Moves) -> Sequence[Array]:
            return [-N * np.sin(order * N * m.q[:, j]), -N * np.cos(order * N * m.q[:, j])]

        return term("torque-ripple", of, lambda c: np.array([np.hypot(*c), order, np.arctan2(c[1], c[0])]), (order,))

    def curve(variable: str, what: Callable[[Moves], Array]) -> Iterator[Term]:
        x = np.concatenate([what(m) for m in moved])
        knots = np.unique(np.quantile(x, np.linspace(0.005, 0.995, KNOTS)))
        if len(knots) == KNOTS:
            heights = tuple((f"height {k + 1}", "N" if slides else "Nm") for k in range(KNOTS))
            for shape, of in ((BENT, bends(x, knots)), (WHOLE, lambda x: hats(x, knots))):
                yield Term(
                    "unknown", j, "link", heights, row(_of(of, what)), _as_is, shape, variable, tuple(knots.tolist())
                )

    yield term("motor-viscous", lambda m: [N * N * m.v[:, j]])
    yield term("motor-coulomb", lambda m: [sliding(m)])
    rate = float(np.sqrt(np.mean(np.concatenate([N * m.v[:, j] for m in moved]) ** 2)))
    yield from map(stribeck, (rate * share for share in SPEEDS if rate))
    yield term("motor-quadratic-drag", lambda m: [abs(N) * N * N * m.v[:, j] * np.abs(m.v[:, j])])
    yield term("load-dependent-friction", lambda m: [np.abs(load(m)) * way(m.v[:, j])])
    yield term("torque-offset", lambda m: [np.full(len(m.q), -N)])
    yield term("input-delay", lambda m: [m.tau_rate[:, j]])
    if log.n > 1:  # of a single joint these are its link's inertia
        rotor = N * N * float(np.nan_to_num(log.J_m[j]))
        yield term("motor-inertia", lambda m: [N * N * m.a[:, j]])
        yield term("torque-scale", lambda m: [load(m) + rotor * m.a[:, j]], lambda c: 1.0 / (1.0 + c) - 1.0)
    yield term("cable-stiffness", lambda m: [m.q[:, j], -np.ones(len(m.q))], _laid_out)
    periods = max(float(np.ptp(m.q[:, j])) for m in moved) * abs(N) / (2 * np.pi)
    if not slides or abs(N) != 1.0:  # a direct slide has no turns
        yield from map(ripple, (float(order) for order in ORDERS if order * periods > PERIODS))
    yield from curve("velocity", lambda m: m.v[:, j])
    yield from curve("position", lambda m: m.q[:, j])
    yield from curve("torque", load)


def _of(shares: Callable[[Array], Array], what: Callable[[Moves], Array]) -> Callable[[Moves], Sequence[Array]]:
    return lambda m: list(shares(what(m)).T)


def _laid_out(c: Array) -> Array:
    """Stiffness of a cable and where it does not pull, of what it pulls with: stiffness q - c[1]."""
    return np.array([c[0], c[1] / c[0] if c[0] else 0.0])


def way(v: Array) -> Array:
    """The way [S] that a joint slides, of its velocity: that of `motion.direction`, the mean over the time around each sample, for it turns between
    samples, too."""
    mid = np.concatenate([v[:1], 0.5 * (v[1:] + v[:-1]), v[-1:]])
    halves = [(mid[:-1], v), (v, mid[1:])]
    return np.asarray(np.mean([_mean_way(a, b) for a, b in halves], axis=0))


def _mean_way(a: Array, b: Array) -> Array:
    """The mean of `direction` as the velocity goes evenly from a to b."""
    gone = b - a
    moved = np.abs(gone) > 1e-3 * CREEP
    whole = CREEP * (np.logaddexp(b / CREEP, -b / CREEP) - np.logaddexp(a / CREEP, -a / CREEP))
    return np.where(moved, whole / np.where(moved, gone, 1.0), direction(0.5 * (a + b)))


def hats(x: Array, knots: Array) -> Array:
    """Shares [S, k] of a curve's heights at its `knots` [k] in what it is at x [S]: straight between these and level beyond."""
    return np.stack([np.interp(x, knots, unit) for unit in np.eye(len(knots))], axis=-1)


def bends(x: Array, knots: Array) -> Callable[[Array], Array]:
    """The same without what is a constant, a straight line or a sign, at samples `x` [S]: names have those."""

    def plain(x: Array) -> Array:
        return np.stack([np.ones(len(x)), x, np.sign(x)], axis=-1)

    named = np.linalg.lstsq(plain(x), hats(x, knots), rcond=None)[0]
    return lambda x: hats(x, knots) - plain(x) @ named


def _zero_off(log: Log, model: Model, j: int, declared: Array) -> Columns:
    """What the torques of the declared links change by as the joint is beside where it reads to be."""

    def columns(m: Moves) -> Array:
        away = STEP * np.eye(log.n)[j]
        more, less = (model.torque_rows(m.q + d, m.v, m.a, log.gravity) @ declared for d in (away, -away))
        return np.asarray((more - less)[..., None] / (2 * STEP))

    return columns


def _of_arm(log: Log, model: Model, declared: Array) -> Iterator[Term]:
    if np.any(log.gravity):
        yield _term(log, "gravity-stiffness", None, _gravity(log, model, declared))
    last = slice(10 * (log.n - 1), 10 * (log.n - 1) + 4)
    if log.n > 1:
        yield _term(
            log, "payload", None, lambda m: model.torque_rows(m.q, m.v, m.a, log.gravity)[..., last],
            lambda c: np.array([c[0], np.linalg.norm(c[1:]) / c[0] if c[0] else 0.0]),
        )  # fmt: skip
        yield _term(log, "time-offset", None, lambda m: m.tau_rate[..., None])


def _gravity(log: Log, model: Model, declared: Array) -> Columns:
    """What a gravity by a share stronger, and tilts of the base about its x and y axes, change the torques of the declared links by."""
    x, y, z = log.gravity
    changes = np.array([[x, y, z], [0.0, z, -y], [-z, 0.0, x]])

    def columns(m: Moves) -> Array:
        still = np.zeros_like(m.q)
        return np.stack([model.torque_rows(m.q, still, still, g) @ declared for g in changes], axis=-1)

    return columns


def links(log: Log, model: Model) -> Term:
    """The links' inertial parameters as a term: of each link mass, moments and inertia, in shares of what is declared."""
    size = sizes(model)
    return Term(
        "inertial-parameters", None, "link", (("change", ""),), lambda m: model.torque_rows(m.q, m.v, m.a, log.gravity) * size, width=WIDTHS[-1]
    )  # fmt: skip


def sizes(model: Model) -> Array:
    """By what [10 n] a link's parameters are other ones that is as much as the link itself: its mass, that times its radius, and squared."""
    result = []
    for m, _, _, _, xx, _, yy, _, _, zz in model.chain.parameters.reshape(-1, 10):
        mass = max(m, 1e-3)
        radius = max(np.sqrt(max(xx + yy + zz, 0.0) / (2 * mass)), RADIUS)
        result += [mass, *3 * [mass * radius], *6 * [mass * radius**2]]
    return np.array(result)
