"""An identified arm, apart from how it was identified: what has to be kept to write its files at any later time."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ident.arm.arm_model import DRIVES
from ident.arm.coupled import PLAIN_DRIVE
from ident.errors import IdentError
from ident.identification.identify import Identification
from ident.joint.start import START_DAMPING
from ident.records.campaign import Array, Campaign
from symgen.chain import PRISMATIC
from symgen.plan import Model, model_of_urdf
from symgen.robot import MOST_SAMPLES, Drive, Experiment, Robot

FORMAT, VERSION = "identified-arm", 1
#: The file of this name in a result's directory.
FILE = "identified.json"

#: CAD's constants, computed again, agree with those of the file to this share of the largest.
_SAME_CONSTANTS = 1e-9
#: An encoder whose steps stand out has most samples this close to a multiple of a step [steps].
_ON_STEP = 0.05
#: Samples that tell the step of an encoder.
_SAMPLES = 20_000
_ARRAYS = ("gravity", "alpha", "covariance", "unseen")

#: What robot.toml says of a drive that nothing was found of.
_UNSEEN = "no record excites this joint: K and J_m as declared, or typical; damping 1 %"
#: The same of one that is excited, but shows no spring.
_UNTOLD = "the records do not tell K, its standard deviation is larger than K: {}"


@dataclass(frozen=True)
class Identified:
    """An arm with identified numbers. `urdf` is the declared robot and `model` what symgen reads from it.

    `alpha` [D] with `covariance` [D, D] and `unseen` [D, k] as in `Identification`; `drives` [n] in the order of the chain's
    joints, `notes` [n] what of each drive is not identified ("" when all is); `gravity` [3, m/s2]; `experiment` as it was
    made; `base`, `tip`, `at` as in robot.toml; `source` says where the records come from and the method.
    """

    model: Model
    urdf: str
    alpha: Array
    covariance: Array
    unseen: Array
    drives: tuple[Drive, ...]
    notes: tuple[str, ...]
    gravity: Array
    experiment: Experiment
    source: str
    base: str | None = None
    tip: str | None = None
    at: Mapping[str, float] | None = None

    @property
    def believes_zeros(self) -> bool:
        """Whether parameters that are exactly zero in the URDF are taken as known."""
        return bool(self.model.factoring.believed)


def of_parts(
    campaign: Campaign,
    model: Model,
    alpha: Array,
    covariance: Array,
    unseen: Array,
    K: Array,
    J_m: Array,
    D: Array,
    D_spring: Array,
    *,
    robot: Robot | None = None,
    source: str = "",
    notes: tuple[str, ...] | None = None,
) -> Identified:
    """Returns the arm of these numbers: alpha [D] with `covariance` [D, D] and `unseen` [D, k]; K, J_m, D, D_spring [n] in the
    units of robot.toml. `robot` tells encoders, torque limits and the experiment; without it the campaign does, or the URDF.
    """
    n = campaign.n
    drives = []
    for i, (name, joint) in enumerate(zip(campaign.joints, model.chain.joints, strict=True)):
        link_counts = None
        if robot is not None:
            declared = robot.drive(name)
            counts, tau_max, link_counts = declared.encoder_counts, declared.tau_max, declared.link_encoder_counts
        else:
            counts, tau_max = _encoder_counts(campaign, i), _torque_limit(campaign, i, joint.effort)
        numbers = {"N": campaign.N[i], "J_m": J_m[i], "K": K[i], "D": D[i], "D_spring": D_spring[i]}
        drives.append(
            Drive(
                name,
                **{key: float(value) for key, value in numbers.items()},
                encoder_counts=counts,
                tau_max=float(tau_max),
                linear=joint.type == PRISMATIC,
                link_encoder_counts=link_counts,
            )
        )
    return Identified(
        model, campaign.urdf, np.array(alpha), np.array(covariance), np.array(unseen), tuple(drives),
        notes or ("",) * n, campaign.gravity, robot.experiment if robot else _experiment(campaign),
        source or campaign.source, **_arm(model, campaign, robot),
    )  # fmt: skip


def of_identification(identification: Identification, robot: Robot | None = None) -> Identified:
    """Returns the arm that was identified. A drive that no record excited keeps what was declared, else a plain one's."""
    r = identification
    if r.coupled is not None:
        c, fit = r.campaign, r.coupled
        told, declared = fit.drive_std[0] <= fit.K, np.isfinite(c.K)
        K = np.where(told | ~declared, fit.K, c.K)
        D_spring = np.where(told | ~np.isfinite(c.D_spring), fit.D_spring, c.D_spring)
        numbers = [K, fit.J_m, fit.D, D_spring]
        excited = {record.excited for record in c.records}
        untold = [_UNTOLD.format("K is as declared" if known else "K is anything so stiff") for known in declared]
        notes = tuple("" if told[i] else untold[i] if joint in excited else _UNSEEN for i, joint in enumerate(c.joints))
    else:
        numbers, notes = _separate_drives(r)
    return of_parts(
        r.campaign, r.model, r.alpha_all, r.covariance, r.unseen, *numbers, robot=robot, notes=notes,
        source=f"{r.campaign.source}; method {r.method}",
    )  # fmt: skip


def write(identified: Identified, path: Path) -> None:
    """Writes the arm as one JSON document. Raises OSError."""
    i = identified
    document = {
        "format": FORMAT,
        "version": VERSION,
        "source": i.source,
        "joints": i.model.chain.names,
        "believe_zeros": i.believes_zeros,
        "alpha_names": i.model.names,
        "alpha_cad": i.model.alpha_cad.tolist(),
        **{name: getattr(i, name).tolist() for name in _ARRAYS},
        "drives": [asdict(drive) for drive in i.drives],
        "notes": i.notes,
        "experiment": asdict(i.experiment),
        "base": i.base,
        "tip": i.tip,
        "at": i.at,
        "urdf": i.urdf,
    }
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def read(path: Path) -> Identified:
    """Returns the arm in a file that `write` wrote. IdentError, one line, for anything else, SymgenError for its URDF."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["format"] != FORMAT or document["version"] > VERSION:
            raise IdentError(f"{path}: format {document['format']!r}; expected {FORMAT!r} up to version {VERSION}")
        model = model_of_urdf(document["urdf"], tuple(document["joints"]), believe_zeros=document["believe_zeros"])
        arrays = {name: np.array(document[name], dtype=float) for name in _ARRAYS}
        D = len(model.names)
        arrays["unseen"] = arrays["unseen"].reshape(D, -1)
        shapes = {"gravity": (3,), "alpha": (D,), "covariance": (D, D), "unseen": arrays["unseen"].shape}
        experiment = document["experiment"]
        found = Identified(
            model=model,
            urdf=document["urdf"],
            alpha=arrays["alpha"],
            covariance=arrays["covariance"],
            unseen=arrays["unseen"],
            gravity=arrays["gravity"],
            drives=tuple(Drive(**drive) for drive in document["drives"]),
            notes=tuple(document["notes"]),
            experiment=Experiment(**(experiment | {"band": tuple(experiment["band"])})),
            source=document["source"],
            base=document["base"],
            tip=document["tip"],
            at=document["at"],
        )
        cad = np.array(document["alpha_cad"], dtype=float)
        fits = tuple(document["alpha_names"]) == model.names and _close(cad, model.alpha_cad)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise IdentError(
            f"{path}: not an identified arm: {type(error).__name__} {_line(error)}; run ident fit"
        ) from None
    if not fits:
        raise IdentError(f"{path}: its constants are not those that symgen derives from its URDF; run ident fit again")
    for name, shape in shapes.items():
        if arrays[name].shape != shape or not np.isfinite(arrays[name]).all():
            raise IdentError(f"{path}: {name}: shape {arrays[name].shape}; expected {shape} finite numbers")
    if len(found.drives) != model.chain.n or len(found.notes) != model.chain.n:
        raise IdentError(f"{path}: {len(found.drives)} drives; expected {model.chain.n}, one a joint")
    return found


def _close(a: Array, b: Array) -> bool:
    return a.shape == b.shape and bool(np.abs(a - b).max() <= _SAME_CONSTANTS * np.abs(b).max())


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]


def _separate_drives(r: Identification) -> tuple[list[Array], tuple[str, ...]]:
    """K, J_m, D, D_spring [n] of fits record by record, and a note for every joint that no record excited.

    Dampings that noise makes negative are zero.
    """
    c, notes = r.campaign, []
    K, J_m = (np.where(np.isfinite(own), own, plain) for own, plain in zip((c.K, c.J_m), PLAIN_DRIVE, strict=True))
    J = np.diag(r.model.J_cad(np.zeros(c.n)))
    D, D_spring = 2 * START_DAMPING * np.sqrt(K * J_m) / np.abs(c.N), 2 * START_DAMPING * np.sqrt(K * J)
    for i, joint in enumerate(c.joints):
        drive = next((drive for drive in r.drives if drive.joint == joint), None)
        if drive is None:
            notes.append(_UNSEEN)
            continue
        K[i], J_m[i], *own = (getattr(drive, name).value for name in DRIVES)
        D[i], D_spring[i] = np.maximum(own, 0.0)
        notes.append("")
    return [K, J_m, D, D_spring], tuple(notes)


def _arm(model: Model, campaign: Campaign, robot: Robot | None) -> dict[str, Any]:
    """Where the arm begins and ends, and which of its joints are frozen: what makes symgen read these joints again; nothing where the URDF
    says it itself, in its <symgen> element."""
    if robot is not None:
        return {"base": robot.base, "tip": robot.tip, "at": dict(robot.at)}
    root = ET.fromstring(campaign.urdf.removeprefix("\ufeff").encode(), ET.XMLParser(encoding="utf-8"))
    if root.find("symgen") is not None:
        return {"at": {}}
    moving = ("revolute", "continuous", "prismatic")
    driven = {joint.get("name", "") for joint in root.findall("joint") if joint.get("type") in moving}
    return {"at": {name: value for name, value in model.chain.frozen.items() if name in driven and value == 0.0}}


def _encoder_counts(campaign: Campaign, i: int) -> int:
    """Steps of the encoder in one motor revolution, read from the records; 2^20 where they show none."""
    steps = []
    for record in campaign.records:
        theta = np.unique(record.theta[-_SAMPLES:, i])
        if len(theta) > 2:
            rises = np.diff(theta)
            step = float(rises.min())
            off = np.abs(rises / step - np.round(rises / step))
            if np.mean(off < _ON_STEP) > 0.99 and np.mean(rises < 1.5 * step) > 0.1:
                steps.append(float(np.sum(rises) / np.sum(np.round(rises / step))))
    return round(2 * np.pi / float(np.median(steps))) if steps else 2**20


def _torque_limit(campaign: Campaign, i: int, effort: float) -> float:
    """The URDF's effort at the motor, or the largest torque in the records where it states none."""
    if np.isfinite(effort) and effort > 0.0:
        return effort / abs(float(campaign.N[i]))
    largest = max((float(np.abs(record.tau[:, i]).max()) for record in campaign.records), default=0.0)
    return largest or 1.0


def _experiment(campaign: Campaign) -> Experiment:
    """The experiment as the records show it, in numbers that robot.toml takes: the band of a single line begins below it, and where records
    are longer than it has them, periods are fewer and lines further apart. What records do not show is as usual."""
    if not campaign.records:
        return Experiment(fs=campaign.fs)
    first = campaign.records[0]
    low = min(float(record.lines.min()) * record.f0 for record in campaign.records)
    high = max(float(record.lines.max()) * record.f0 for record in campaign.records)
    samples, f0 = first.samples_per_period, first.f0
    if 2 * samples > MOST_SAMPLES:
        samples = int(MOST_SAMPLES) // 4
        f0 = campaign.fs / samples
        low, high = min(low, f0), max(high, f0)
    low -= f0 / 2 if low == high else 0.0
    periods = min(max(2, *(record.periods for record in campaign.records)), int(MOST_SAMPLES) // samples)
    low, high = (
        float(f"{edge:.12g}") for edge in (low, high)
    )  # as a person would write them: 39.9, not 39.900000000000006
    return Experiment(fs=campaign.fs, band=(low, high), f0=f0, periods=periods)
