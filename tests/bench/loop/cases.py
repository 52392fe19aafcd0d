"""What the blind study draws: a robot, effects at random joints and of random sizes that its records show, its records.

A case is a function of (kind, index, seed) alone: killed and started again it is the same case.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from draws import KINDS, RANGES, RIGID, SILENT, draw_at_random
from outside import OUTSIDE_RANGES

from ident.arm.arm_fit import Problem, chi_squared, hold, residual
from ident.arm.coupled import DOUBTS, declared_start, problem_of
from ident.arm.descent import minimise
from ident.arm.evidence import evidence, gravity_basis
from ident.effects.base import Arm, Effect
from ident.errors import ExperimentError
from ident.loop.confounded import never_told_apart
from ident.records.campaign import Campaign
from ident.records.frf import estimate
from ident.simulator.bench import simulate
from symgen.chain import Chain, Inertia
from symgen.plan import Model, chain_of_robot, make_model, plan_of_robot
from symgen.robot import Drive, Robot, load_robot

ROBOTS = Path(__file__).parents[3] / "robots"
#: Those that are drawn; any other is asked for.
OURS = ("ypp3", "arm6")
#: Lines apart [Hz] by turns, and periods, of which the last are steady.
GRIDS, PERIODS = (0.5, 0.2, 0.5, 0.8), 5
#: How often the plan is measured: three kinds of record need more than one of a joint; a plan of so many records has that.
TIMES, ENOUGH = 2, 20
#: One draw in so many is of the large arm.
LARGE = 12
KINDS_OF_CASE = ("clean", "one", "two", "outside", "faint")
#: Single draws of which pairs are made: as many for each pair, so that by turns most are drawn before it; of those the last so many, and
#: no fewer than so many.
SINGLES, EACH, RECENT, LEAST = 150, 3, 24, 8
#: A draw shows when the rms of the whitened residual is this large in some band of some joint of some record.
SHOWS = 3.0
#: What is to be faint is made smaller so many times at most, by no more than this factor, towards the first of these, while it
#: shows by more than the second.
FAINTER, LEAST_FACTOR, FAINT = 5, 0.02, (3.7, 5.0)
#: Bands [Hz], and the least lines in one.
BANDS, LEAST_LINES = (0.0, 1.0, 3.0, 10.0, 30.0, 1000.0), 8
#: Numbers that are declared: the fit is free of them, so they show against the declared arm, not the refitted one.
DECLARED = ("motor-viscous", "motor-inertia", "spring-damping", "payload", "inertial-parameters", "gravity-stiffness")
#: Logarithmic standard deviations by which an arm may be built otherwise than declared.
BUILT = {"K": 0.1, "J_m": 0.1, "D": 0.2, "D_spring": 0.2, "mass": 0.1, "com": 0.05, "I": 0.05}
#: A draw too small is made larger so many times, by this factor; one that topples the arm smaller; then another is drawn.
TRIES, LARGER, SMALLER, DRAWS = 3, 2.0, 0.6, 6


@dataclass(frozen=True)
class Case:
    """One draw of the study; `name` the effect's where it has one, `records` the seed of its excitation and noise.

    `f0` [Hz] apart are its lines. `built`: the drives and links of the arm are not the declared ones, by `BUILT`, drawn from `records`.
    """

    kind: str
    index: int
    seed: int
    robot: str
    lock: str
    name: str
    records: int
    f0: float
    built: bool

    @property
    def id(self) -> str:
        return f"{self.kind}-{self.seed}-{self.index:03d}"

    def rng(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, KINDS_OF_CASE.index(self.kind), self.index])


@dataclass(frozen=True, eq=False)
class Drawn:
    """Effects of a case, and how clearly they show: rms of the whitened residual in the band where it is largest, of the
    refitted arm and of the declared one."""

    effects: tuple[Effect, ...]
    refitted: float
    declared: float
    draws: int


def cases(kind: str, count: int, seed: int, robot: str = "") -> Iterator[Case]:
    """The first `count` cases of a kind: effects by turns in an order of their own, every `LARGE`th on the large arm.

    robot: the directory of another one, of which all are.
    """
    catalogue = [n for n in RANGES if n not in SILENT]
    names = {"one": catalogue, "faint": catalogue, "outside": list(OUTSIDE_RANGES)}.get(kind, [""])
    rng = np.random.default_rng([seed, KINDS_OF_CASE.index(kind)])
    order: list[str] = []
    while len(order) < count:
        order += [str(name) for name in rng.permutation(names)]
    for k in range(count):
        lock = "rigid" if order[k] in RIGID else "dob"
        usual = "arm6" if k % LARGE == LARGE - 1 and lock == "dob" else "ypp3"
        yield Case(
            kind, k, seed, robot or usual, lock, order[k], seed * 1000 + k, _grid(k), _otherwise(kind, k, order[k])
        )


def _otherwise(kind: str, index: int, name: str) -> bool:
    """Whether an arm is built otherwise than declared: every second one, but where the effect is that it is."""
    return kind != "clean" and index % 2 == 1 and name not in DECLARED


def _grid(index: int) -> float:
    """How far apart [Hz] lines are: by turns, as often of an arm built otherwise as of another."""
    return GRIDS[index // 2 % len(GRIDS)]


def twin(case: Case) -> Case:
    """The same records without the effect."""
    return replace(case, kind="clean", name="")


@cache
def arm(name: str) -> tuple[Robot, Chain, Model, tuple[tuple[str, np.ndarray], ...]]:
    """A robot of ours or of a directory, with short records; its chain, its model and the cells that are measured."""
    robot = load_robot(ROBOTS / name)
    robot = replace(robot, experiment=replace(robot.experiment, f0=GRIDS[0], periods=PERIODS))
    chain = chain_of_robot(robot)
    cells = tuple((cell.joint, np.asarray(cell.q)) for cell in plan_of_robot(robot).cells)
    return (
        robot,
        chain,
        make_model(chain, believe_zeros=robot.believe_zeros),
        cells * (TIMES if len(cells) < ENOUGH else 1),
    )


def built(case: Case) -> Arm:
    """The arm of a case without its effects."""
    robot, chain, *_ = arm(case.robot)
    drives, gravity = tuple(robot.drive(name) for name in chain.names), np.asarray(robot.gravity)
    if not case.built:
        return Arm(chain, drives, gravity)
    rng = np.random.default_rng(case.records)

    def off(what: str) -> float:
        return float(np.exp(rng.normal(0.0, BUILT[what])))

    def drive(one: Drive) -> Drive:
        return replace(one, **{what: getattr(one, what) * off(what) for what in ("K", "J_m", "D", "D_spring")})

    def link(one: Inertia) -> Inertia:
        heavier = off("mass")
        return Inertia(one.mass * heavier, one.com * off("com"), one.I * heavier * off("I"))

    joints = tuple(replace(joint, inertia=link(joint.inertia)) for joint in chain.joints)
    return Arm(replace(chain, joints=joints), tuple(drive(one) for one in drives), gravity)


def measured(case: Case, effects: Sequence[Effect]) -> Campaign:
    """The records of a case. ExperimentError: the arm falls, or can not have the effects."""
    robot, chain, _, cells = arm(case.robot)
    robot = replace(robot, experiment=replace(robot.experiment, f0=case.f0))
    true = built(case)
    return simulate(
        chain, robot, cells, lock=case.lock, seed=case.records, truth=true.chain, truth_drives=true.drives, effects=effects,
        workers=1,
    )  # fmt: skip


def drawn(case: Case, cache_directory: Path, reuse: Path | None = None) -> tuple[Drawn, Campaign | None]:
    """Effects of a case that show, and its records; None for these where a file `reuse` has them and the effects are known."""
    path = cache_directory / "drawn" / f"{case.id}.json"
    if reuse and path.exists():
        return _read(path), None
    found, campaign = _drawn(case, path, cache_directory)
    _write(found, path)
    return found, campaign


def _drawn(case: Case, path: Path, cache_directory: Path) -> tuple[Drawn, Campaign]:
    if case.kind == "clean":
        return Drawn((), 0.0, 0.0, 0), measured(case, ())
    if case.kind == "two":
        return _two(case, cache_directory)
    if path.exists():
        known = _read(path)
        return known, measured(case, known.effects)
    return _faint(case) if case.kind == "faint" else _shown(case)


def _shown(case: Case) -> tuple[Drawn, Campaign]:
    """An effect of the case's name that shows: larger until it does, smaller while the arm falls, else another."""
    robot, chain, _, cells = arm(case.robot)
    rng = case.rng()
    for draws in range(1, DRAWS + 1):
        effect = draw_at_random(rng, case.name, chain, robot, cells, {}, lock=case.lock).effect
        fell = False
        for _ in range(TRIES):
            try:
                campaign = measured(case, [effect])
            except ExperimentError:
                effect, fell = sized(effect, SMALLER), True
                continue
            known = Drawn((effect,), *shows(case, campaign), draws)
            if _size(case, known) >= SHOWS:
                return known, campaign
            if fell:
                break
            effect = sized(effect, LARGER)
    raise ExperimentError(f"{case.id}: {DRAWS} draws of {case.name} on {case.robot} and none that shows")


def _size(case: Case, known: Drawn) -> float:
    """How clearly the effect of a case shows."""
    return known.declared if case.name in DECLARED else known.refitted


def _faint(case: Case) -> tuple[Drawn, Campaign]:
    """An effect of the case's name made so small that it just shows; what a law does need not be in proportion."""
    known, campaign = _shown(case)
    aim, most = FAINT
    for _ in range(FAINTER):
        factor = max(aim / _size(case, known), LEAST_FACTOR)
        for smaller in (factor, factor**0.5, factor**0.25, factor**0.125):
            if _size(case, known) <= most:
                return known, campaign
            effect = sized(known.effects[0], smaller)
            records = measured(case, [effect])
            new = Drawn((effect,), *shows(case, records), known.draws)
            if _size(case, new) >= SHOWS:
                known, campaign = new, records
                break
    return known, campaign


def _two(case: Case, cache_directory: Path) -> tuple[Drawn, Campaign]:
    """Two effects of single draws of the same arm, each of which shows alone, and that can be told apart."""
    rng, n = case.rng(), arm(case.robot)[1].n
    other = "" if case.robot in OURS else case.robot
    singles = [one for one in cases("one", SINGLES, case.seed, other)
               if (one.robot, one.lock) == (case.robot, case.lock) and not (case.built and one.name in DECLARED)]  # fmt: skip
    before = max(sum(one.index < EACH * (case.index + 1) for one in singles), LEAST)
    pairs = list(combinations(singles[max(before - RECENT, 0) : before], 2))
    for draws, k in enumerate(rng.permutation(len(pairs))[:DRAWS].tolist(), 1):
        parts = [single(one, cache_directory) for one in pairs[k]]
        effects = tuple(part.effects[0] for part in parts)
        a, b = effects
        if (
            a.name == b.name
            or _one_body(a, b, n)
            or (b.name in never_told_apart(a.name, a.joint, n) and a.joint == b.joint)
        ):
            continue
        try:
            campaign = measured(case, effects)
        except ExperimentError:
            continue
        return Drawn(effects, min(p.refitted for p in parts), min(p.declared for p in parts), draws), campaign
    raise ExperimentError(f"{case.id}: {DRAWS} pairs and none that leaves the arm standing")


def _one_body(a: Effect, b: Effect, n: int) -> bool:
    """Whether two effects only make another body of the last link: a load, and one that is not as declared."""
    last = {(e.name, e.joint) for e in (a, b)}
    return last == {("payload", None), ("inertial-parameters", n - 1)}


def single(case: Case, cache_directory: Path) -> Drawn:
    """The effect of a single draw, without its records where it has been drawn before."""
    path = cache_directory / "drawn" / f"{case.id}.json"
    return _read(path) if path.exists() else drawn(case, cache_directory)[0]


def sized(effect: Effect, factor: float) -> Effect:
    """The effect `factor` times as strong: its sizes, or stiffnesses that many times softer, within their bounds."""
    values = list(effect.values)
    sizes = [k for k, p in enumerate(effect.parameters) if p.zero is not None and values[k] != p.zero]
    for k, p in enumerate(effect.parameters):
        if k in sizes:
            values[k] *= factor
        elif not sizes and p.relative == "K":
            values[k] /= factor
        if not p.relative:
            values[k] = float(np.clip(values[k], p.low, p.high))
    return effect.with_values(values)


def shows(case: Case, campaign: Campaign) -> tuple[float, float]:
    """The rms of the whitened residual in the band, joint and record where it is largest: refitted arm, declared arm."""
    _, _, model, _ = arm(case.robot)
    basis = gravity_basis(model, campaign.gravity)
    responses = tuple(estimate(record, campaign) for record in campaign.records)
    data = tuple(evidence(campaign, model, basis, frf, k, "every") for k, frf in enumerate(responses))
    start = declared_start(campaign, model, responses, basis)
    problem, vector = problem_of(campaign, model, basis, data, start), start.vector()
    fits = [minimise(problem, vector, doubts, 2, roughly=0.01).vector for doubts in ((), DOUBTS)]
    refitted = min(fits, key=lambda v: chi_squared(problem, v, hold(problem, v)))
    return _largest(problem, refitted), _largest(problem, vector)


def _largest(problem: Problem, vector: np.ndarray) -> float:
    largest = 0.0
    for one, kept in zip(problem.data, hold(problem, vector), strict=True):
        r = residual(problem, vector, one, kept.moved)[0]
        power = np.abs((kept.W @ r[..., None])[..., 0]) ** 2
        band = np.digitize(one.sampling.f, BANDS)
        for use in (band == b for b in np.unique(band)):
            if use.sum() >= LEAST_LINES:
                largest = max(largest, float(power[use].mean(axis=0).max()))
    return float(np.sqrt(largest))


def truth(case: Case, effects: Sequence[Effect]) -> list[dict[str, Any]]:
    """What was put in, as the verdict would name it."""
    joints = arm(case.robot)[1].names
    return [
        {"name": e.name, "joint": None if e.joint is None else joints[e.joint], "port": e.port,
         "values": dict(zip((p.name for p in e.parameters), e.values, strict=True))} for e in effects
    ]  # fmt: skip


def _write(found: Drawn, path: Path) -> None:
    document = asdict(replace(found, effects=()))
    document["effects"] = [[e.name, e.joint, list(e.values)] for e in found.effects]
    write_json(document, path)


def _read(path: Path) -> Drawn:
    document = json.loads(path.read_text())
    effects = tuple(KINDS[name](joint, tuple(values)) for name, joint, values in document.pop("effects"))
    return Drawn(**document | {"effects": effects})


def write_json(document: Any, path: Path) -> None:
    """The file complete or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(f".{os.getpid()}")
    beside.write_text(json.dumps(document, indent=1))
    os.replace(beside, path)
