"""Three kinds of record, or of lines: those that fit, those that choose, those that report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from ident.arm.evidence import Evidence
from ident.errors import IdentError
from symgen.plan import Model

#: Variance of J(q) at a record that does not fit, in units of one record's own: more, and it has to fit.
LEVERAGE = 3.0
#: Excited lines in a row that go to the same kind where lines take the place of records.
BLOCK = 3
#: Aliases a side computed one by one where few lines of a record do.
ROUGHLY_NEAR = 2
#: Times the band up to which dry friction moves a joint where few samples do.
ROUGHLY_BEYOND = 2


@dataclass(frozen=True, eq=False)
class Split:
    """Which records fit, choose and report; `note` says where the data did not reach for three different experiments."""

    fit: tuple[Evidence, ...]
    select: tuple[Evidence, ...]
    report: tuple[Evidence, ...]
    note: str


def split(data: tuple[Evidence, ...], model: Model) -> Split:
    """Three kinds of record: of each joint's records in turn one reports, one chooses, the others fit, as far as they reach.

    Everything about J(q) and gravity that all records show must be shown by those that fit, and every joint excited by one
    that chooses. Where there are too few records for that, lines take their place: blocks of neighbouring ones by turns, of the second of two
    records of a joint, else of each. Raises IdentError for too few of these.
    """
    kinds = {k: "fit" for k in range(len(data))}
    turn = 0
    for joint in sorted({one.excited for one in data}):
        own = [k for k, one in enumerate(data) if one.excited == joint]
        for place in range(len(own) - 1, 0, -1):
            if (len(own) - 1 - place) % 4 < 2:
                kinds[own[place]] = ("report", "select")[turn % 2]
                turn += 1
    kinds = _enough(data, model, kinds)
    fit, select, report = (
        tuple(one for k, one in enumerate(data) if kinds[k] == kind) for kind in ("fit", "select", "report")
    )
    if report and {one.excited for one in select} == {one.excited for one in data}:
        return Split(fit, select, report, "")
    if len(data) == 2 and kinds[1] != "fit":
        block = np.cumsum(data[1].is_excited) // BLOCK % 2
        note = "two records: choosing and reporting lines are blocks of the second by turns"
        return _excited(Split(data[:1], (lines_of(data[1], block == 0),), (lines_of(data[1], block == 1),), note))
    return split_lines(data, "too few records to keep some of every joint apart")


def _excited(parted: Split) -> Split:
    """The same. IdentError where a part has no excited line."""
    for part in (parted.fit, parted.select, parted.report):
        if not any((one.is_excited & one.use).any() for one in part):
            lines = sum(int(one.is_excited.sum()) for one in united(*parted.fit, *parted.select, *parted.report))
            raise IdentError(
                f"the records have {lines} excited lines, too few to fit by some, choose by others and report the rest; expected "
                f"{4 * BLOCK} or more, or more records"
            )
    return parted


def _enough(data: tuple[Evidence, ...], model: Model, kinds: dict[int, str]) -> dict[int, str]:
    """Moves records to those that fit, the one least told by them first, until these tell what the arm is at all the others.

    What they tell: the variance of J_ij(q) / sqrt(J_ii J_jj) there and of the gravity stiffness, each entry measured once
    by each record, unit error.
    """
    rows = []
    for one in data:
        size = np.sqrt(np.diag(model.J_cad(one.scene.posture)))
        J = (model.J_rows(one.scene.posture) / np.outer(size, size)[..., None]).reshape(-1, len(model.names))
        rows.append(block_diag(J, one.scene.arm.K_rows.reshape(len(one.scene.arm.live) ** 2, -1)))
    scale = np.linalg.norm(np.concatenate(rows), axis=0)
    rows = [row / np.where(scale > 0.0, scale, 1.0) for row in rows]
    while True:
        fitting = [rows[k] for k, kind in kinds.items() if kind == "fit"]
        others = [k for k, kind in kinds.items() if kind != "fit"]
        if not others:
            return kinds
        spread = np.linalg.pinv(sum(row.T @ row for row in fitting), rcond=1e-9, hermitian=True)
        seen = spread @ sum(row.T @ row for row in fitting)
        told = {
            k: float(np.einsum("ia,ab,ib->i", rows[k], spread, rows[k]).max())
            + 1e6 * float(np.abs(rows[k] @ (np.eye(len(seen)) - seen)).max() > 1e-6)
            for k in others
        }
        worst = max(told, key=lambda k: told[k])
        if told[worst] <= LEVERAGE:
            return kinds
        kinds[worst] = "fit"


def split_lines(data: tuple[Evidence, ...], why: str) -> Split:
    """Of every record two blocks of lines in four fit, one chooses, one reports: others of the next record, so that a narrow mode
    beside one line is fitted somewhere. IdentError for too few."""
    note = f"{why}: fitting, choosing and reporting lines are blocks of each record by turns"
    fit, select, report = (
        tuple(lines_of(one, np.isin((np.cumsum(one.is_excited) // BLOCK + one.index) % 4, turns)) for one in data)
        for turns in ((0, 2), (1,), (3,))
    )
    return _excited(Split(fit, select, report, note))


def lines_of(one: Evidence, use: NDArray[np.bool_]) -> Evidence:
    """The same record, judged at some of its lines; its motion is still that of all."""
    return replace(one, judged=use if one.judged is None else use & one.judged)


def united(*parts: Evidence) -> tuple[Evidence, ...]:
    """The records of `parts`, each once, judged at the lines of all parts of it."""
    found: dict[int, Evidence] = {}
    for one in parts:
        other = found.get(one.index)
        found[one.index] = one if other is None else replace(one, judged=one.use | other.use)
    return tuple(found[index] for index in sorted(found))


def few_lines(one: Evidence, most: int) -> Evidence:
    """The same record, judged at `most` of its lines at most, poles far above the sampling rate told less closely."""
    one = replace(one, sampling=replace(one.sampling, near=ROUGHLY_NEAR))
    judged = np.flatnonzero(one.use)
    if len(judged) <= most:
        return one
    few = np.zeros(len(one.use), dtype=bool)
    few[judged[np.linspace(0, len(judged) - 1, most).round().astype(int)]] = True
    return lines_of(one, few)


def thinned(one: Evidence, most: int) -> Evidence:
    """The record at about `most` of its lines; as it is where terms of second order act, which need them all."""
    every = len(one.sampling.f) // most
    if every < 2 or one.scene.slopes is not None:
        return one
    scene = one.scene
    few = replace(scene, lines=scene.lines[::every], tau=scene.tau[::every], theta=scene.theta[::every])
    return replace(
        one, is_excited=one.is_excited[::every], scene=few, sampling=replace(one.sampling, f=one.sampling.f[::every]),
        noise=replace(one.noise, samples=one.noise.samples[:, ::every], floor=one.noise.floor[::every]),
    )  # fmt: skip


def few_records(part: Sequence[Evidence], most: int) -> tuple[Evidence, ...]:
    """About `most` of some records, of every joint's the same share: in a campaign joints may take turns."""
    by_joint = sorted(part, key=lambda one: one.excited)
    return tuple(sorted(by_joint[:: max(1, round(len(part) / most))], key=lambda one: one.index))


def sampled(one: Evidence, samples: int) -> Evidence:
    """The same record, forces told by so many samples a line, and by fewer lines beyond the band."""
    scene = one.scene
    near = scene.beyond[0] <= ROUGHLY_BEYOND * scene.lines[-1]
    lines, tau, theta = (x[near] for x in scene.beyond)
    return replace(one, scene=replace(scene, oversampled=samples, beyond=(lines, tau, theta)))


def degrees(data: Sequence[Evidence]) -> int:
    """Real numbers measured at the lines judged."""
    return sum(2 * one.scene.theta.shape[1] * one.count for one in data)
