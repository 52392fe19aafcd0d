"""The campaign file: a `Campaign` as HDF5 and back, format "frf-campaign", version 1.

Writing, reading and the rules stay in one module, longer than most: both directions are judged by the same rules.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import h5py
import numpy as np
from numpy.typing import NDArray

from ident.campaign import Campaign, Record
from ident.errors import CampaignError

Array = NDArray[np.float64]

FORMAT, VERSION = "frf-campaign", 1
HOLDS = ("zoh", "band-limited")
OPTIONAL = ("omega", "q_link")

_MOVING = ("revolute", "continuous", "prismatic")
_WHOLE = 1e-9  # relative: samples_per_period f0 = fs up to a few roundings
_LIMIT_SLACK = 1e-6  # rad: limits and postures are written with a few digits
_GZIP = 1  # every HDF5 reader has it; level 4 saves 5 % of the space and takes half as long again
_CHUNK_BYTES = 2**18  # a few chunks a period: cheap to read in part, and below h5py's chunk cache
_TEXT_CHECK = "text_crc32"  # HDF5 keeps strings of variable length in a heap, which has no checksum of its own
# What h5py raises when bytes are not what they should be; nothing else is done inside the guarded calls.
_DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, OverflowError, MemoryError)


def write_campaign(campaign: Campaign, path: str | os.PathLike[str]) -> None:
    """Writes the campaign, complete or not at all: an existing file is replaced only by a finished one.

    CampaignError, one line, if the campaign breaks a rule of the format or the file can not be written.
    """
    path = Path(path)
    _check_campaign(campaign, str(path))
    _replace(path, lambda file: _write(file, campaign))


def join_campaigns(parts: Sequence[Path], path: str | os.PathLike[str]) -> None:
    """Writes the campaign of all records in the campaign files `parts`, which agree in everything else.

    Records are copied as they are stored. Complete or not at all, and errors, as in `write_campaign`.
    """

    def fill(file: h5py.File) -> None:
        for k, part in enumerate(parts):
            with h5py.File(part, "r") as one:
                if k == 0:
                    file.attrs.update(one.attrs)
                    for name in ("robot", "drive"):
                        one.copy(name, file)
                for id, record in one["experiments"].items():
                    one.copy(record, file.require_group("experiments"), id)

    _replace(Path(path), fill)


def _replace(path: Path, fill: Callable[[h5py.File], None]) -> None:
    """Puts a file with what `fill` writes in the place of `path`, once it is safely on the disk.

    It is made in memory: HDF5 does not bear a disk that fills up while it writes.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    with h5py.File(h5py.h5f.create(path.name.encode(), fcpl=_creation(), fapl=_access())) as file:
        fill(file)
        file.flush()
        image = file.id.get_file_image()
    try:
        with part.open("wb") as out:
            out.write(image)
            out.flush()
            os.fsync(out.fileno())
        os.replace(part, path)
        _sync(path.parent)
    except OSError as error:
        raise CampaignError(f"{path}: cannot be written: {error.strerror or _line(error)}") from None
    finally:
        part.unlink(missing_ok=True)


def _creation() -> Any:
    """The same campaign is the same file: HDF5 would write down when."""
    properties = h5py.h5p.create(h5py.h5p.FILE_CREATE)
    properties.set_obj_track_times(False)
    return properties


def _access() -> Any:
    """In memory. Object headers of HDF5 1.10 carry checksums: a bit flipped in an attribute or a shape is found, too."""
    properties = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    properties.set_fapl_core(backing_store=False)
    properties.set_libver_bounds(h5py.h5f.LIBVER_V110, h5py.h5f.LIBVER_V110)
    return properties


def _sync(directory: Path) -> None:
    """Makes a new name survive a power cut, where directories can be opened."""
    if hasattr(os, "O_DIRECTORY"):
        handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def read_campaign(path: str | os.PathLike[str]) -> Campaign:
    """Returns the campaign in the file; records sorted by id, unknown groups, datasets and attributes ignored.

    CampaignError, one line naming file, group, field and rule, for whatever is not a sound campaign file.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise CampaignError(f"{path}: is a directory; expected a campaign file")
        if not path.exists():
            raise CampaignError(f"{path}: no such file; expected a campaign file")
        with path.open("rb"):
            pass  # says "permission denied" in plain words, where HDF5 does not
    except (OSError, ValueError) as error:
        raise CampaignError(f"{path}: cannot be read: {_line(error)}") from None
    if not h5py.is_hdf5(path):
        raise CampaignError(f"{path}: not an HDF5 file; expected a campaign file")
    try:
        with h5py.File(path, "r") as file:
            campaign = _read(file, str(path))
    except _DAMAGE as error:
        raise CampaignError(f"{path}: damaged: {_line(error)}") from None
    _check_campaign(campaign, str(path))
    return campaign


# writing --------------------------------------------------------------------------------------------------------------


def _write(file: h5py.File, c: Campaign) -> None:
    file.attrs.update(format=FORMAT, version=VERSION, source=c.source, fs_hz=c.fs, hold=c.hold)
    file.attrs[_TEXT_CHECK] = _checksum(c.urdf, c.source, c.hold)
    file.create_group("robot")["urdf"] = c.urdf  # a group that comes with its first child would keep the time
    names = [name.encode() for name in c.joints]
    kind = h5py.string_dtype("utf-8", max(map(len, names)))  # of fixed length: stored, and so checked, with the dataset
    file.create_dataset("robot/joint_names", data=names, dtype=kind, chunks=True, compression=_GZIP, fletcher32=True)
    for name, values in (("gear_ratio", c.N), ("motor_inertia", c.J_m), ("stiffness", c.K), ("gravity", c.gravity)):
        _array(file, f"drive/{name}", values)
    for name, damping in _damping(c):
        if damping is not None and not np.all(np.isnan(damping)):
            _array(file, f"drive/{name}", damping)
    for record in c.records:
        group = file.create_group(f"experiments/{record.id}")
        group.attrs.update(
            excited=record.excited,
            posture=record.posture,
            f0_hz=record.f0,
            lines=record.lines,
            samples_per_period=record.samples_per_period,
            periods=record.periods,
            rms=record.rms,
        )
        group.attrs[_TEXT_CHECK] = _checksum(record.excited)
        for name in ("tau", "theta", *OPTIONAL):
            if getattr(record, name) is not None:
                _array(group, name, getattr(record, name))


def _array(group: h5py.Group, name: str, values: Array) -> None:
    rows = max(1, _CHUNK_BYTES // values[:1].nbytes)
    chunks = (min(len(values), rows), *values.shape[1:])
    group.create_dataset(name, data=values, chunks=chunks, compression=_GZIP, shuffle=True, fletcher32=True)


def _checksum(*texts: str) -> int:
    return zlib.crc32("\0".join(texts).encode())


# reading: presence, kinds and shapes; what the values must be is checked below ----------------------------------------


@dataclass(frozen=True)
class _Node:
    """One group of the file, and how to speak of it."""

    group: h5py.Group
    file: str

    def error(self, field: str, problem: str) -> CampaignError:
        return CampaignError(f"{self.file}: {self.group.name}: {field}: {problem}")

    def attribute(self, name: str) -> Any:
        if name not in self.group.attrs:
            raise self.error(name, "missing; expected an attribute")
        value = self.group.attrs[name]
        return value.decode("utf-8", "replace") if isinstance(value, bytes) else value

    def string(self, name: str) -> str:
        value = self.attribute(name)
        if not isinstance(value, str):
            raise self.error(name, f"found {_short(value)}, expected a string")
        return value

    def numbers(self, name: str) -> Array:
        value = self.attribute(name)
        if np.asarray(value).dtype.kind not in "iuf":
            raise self.error(name, f"found {_short(value)}, expected numbers")
        return np.array(value, dtype=float)

    def number(self, name: str) -> float:
        value = self.numbers(name)
        if value.size != 1:
            raise self.error(name, f"found {value.size} numbers, expected one")
        return float(value.item())

    def wholes(self, name: str) -> NDArray[np.int64]:
        value = self.numbers(name)
        if not np.all((np.abs(value) < 2**53) & (np.floor(value) == value)):
            raise self.error(name, f"found {_short(value)}, expected whole numbers")
        return value.astype(np.int64)

    def whole(self, name: str) -> int:
        self.number(name)
        return int(self.wholes(name).item())

    def dataset(self, name: str) -> h5py.Dataset:
        return _child(self.group, name, h5py.Dataset, self.file)

    def strings(self, name: str, ndim: int) -> Any:
        """A string (ndim 0) or a list of them (ndim 1)."""
        dataset = self.dataset(name)
        if h5py.check_string_dtype(dataset.dtype) is None or dataset.ndim != ndim:
            expected = "one UTF-8 string" if ndim == 0 else "UTF-8 strings [n]"
            raise self.error(name, f"found {dataset.dtype} of shape {dataset.shape}, expected {expected}")
        try:
            return np.array(dataset.asstr()[()], dtype=object).tolist()
        except _DAMAGE as error:
            raise self.error(name, f"damaged: {_line(error)}") from None

    def array(self, name: str, shape: tuple[int, ...]) -> Array:
        dataset = self.dataset(name)
        if dataset.shape != shape or dataset.dtype.kind not in "iuf":
            raise self.error(name, f"found {dataset.dtype} of shape {dataset.shape}, expected numbers of shape {shape}")
        try:
            return np.array(dataset[()], dtype=float)
        except _DAMAGE as error:
            raise self.error(name, f"damaged: {_line(error)}") from None

    def verify(self, *texts: str) -> None:
        """Compares the texts with the checksum beside them, if the file has one."""
        if _TEXT_CHECK in self.group.attrs and self.whole(_TEXT_CHECK) != _checksum(*texts):
            raise self.error(_TEXT_CHECK, f"damaged: the checksum of {', '.join(map(_short, texts))} does not fit")


def _child(group: h5py.Group, name: str, kind: type, where: str) -> Any:
    node, expected = _Node(group, where), kind.__name__.lower()
    if name not in group:
        raise node.error(name, f"missing; expected a {expected}")
    try:
        child = group[name]
    except _DAMAGE as error:
        raise node.error(name, f"damaged: {_line(error)}") from None
    if not isinstance(child, kind):
        raise node.error(name, f"found a {type(child).__name__.lower()}, expected a {expected}")
    return child


def _read(file: h5py.File, where: str) -> Campaign:
    root = _Node(file, where)
    if (found := root.attribute("format")) != FORMAT:
        raise root.error("format", f"found {_short(found)}, expected {FORMAT!r}")
    if (version := root.number("version")) != VERSION:
        why = ", a version from the future" if version > VERSION else ""
        raise root.error("version", f"found {version:g}{why}; this program reads {VERSION}")
    joints = root.strings("robot/joint_names", ndim=1)
    n = len(joints)
    groups = _child(file, "experiments", h5py.Group, where)
    urdf, source, hold = root.strings("robot/urdf", ndim=0), root.string("source"), root.string("hold")
    root.verify(urdf, source, hold)
    return Campaign(
        urdf=urdf,
        joints=tuple(joints),
        fs=root.number("fs_hz"),
        hold=hold,
        N=root.array("drive/gear_ratio", (n,)),
        J_m=root.array("drive/motor_inertia", (n,)),
        K=root.array("drive/stiffness", (n,)),
        gravity=root.array("drive/gravity", (3,)),
        D=root.array("drive/damping", (n,)) if "drive/damping" in file else None,
        D_spring=root.array("drive/spring_damping", (n,)) if "drive/spring_damping" in file else None,
        source=source,
        records=tuple(_read_record(groups, id, n, where) for id in sorted(groups)),
    )


def _read_record(groups: h5py.Group, id: str, n: int, where: str) -> Record:
    group = _child(groups, id, h5py.Group, where)
    node = _Node(group, where)
    excited = node.string("excited")
    node.verify(excited)
    samples_per_period, periods = node.whole("samples_per_period"), node.whole("periods")
    shape = (periods * samples_per_period, n)
    return Record(
        id=id,
        excited=excited,
        posture=node.numbers("posture"),
        f0=node.number("f0_hz"),
        lines=node.wholes("lines"),
        samples_per_period=samples_per_period,
        periods=periods,
        rms=node.number("rms"),
        tau=node.array("tau", shape),
        theta=node.array("theta", shape),
        **{name: node.array(name, shape) for name in OPTIONAL if name in group},
    )


# the rules ------------------------------------------------------------------------------------------------------------


def _check_campaign(c: Campaign, where: str) -> None:
    """CampaignError naming `where`, group, field and rule, if the campaign breaks a rule of the format."""
    n = c.n
    limits = _urdf_limits(c.urdf, f"{where}: /: robot/urdf")
    for name in c.joints:
        if name not in limits:
            known = ", ".join(limits) or "none"
            raise CampaignError(f"{where}: /: robot/joint_names: the URDF has no moving joint {name!r}; it has {known}")
    rules = (
        ("robot/joint_names", c.joints, n > 0 and len(set(c.joints)) == n, "at least one, all different"),
        ("hold", c.hold, c.hold in HOLDS, " or ".join(HOLDS)),
        ("fs_hz", c.fs, 0 < c.fs < np.inf, "a finite number > 0"),
        ("drive/gear_ratio", c.N, _finite(c.N, (n,)) and np.all(c.N != 0), "n finite numbers other than 0"),
        ("drive/motor_inertia", c.J_m, _positive_or_nan(c.J_m, n), "n finite numbers > 0, NaN where unknown"),
        ("drive/stiffness", c.K, _positive_or_nan(c.K, n), "n finite numbers > 0, NaN where unknown"),
        *(
            (f"drive/{name}", D, _not_negative_or_nan(D, n), "n finite numbers >= 0, NaN where unknown")
            for name, D in _damping(c)
        ),
        ("drive/gravity", c.gravity, _finite(c.gravity, (3,)), "3 finite numbers"),
        ("experiments", len(c.records), len(c.records) > 0, "at least one record"),
    )
    _require(rules, f"{where}: /")
    ids = [record.id for record in c.records]
    for k, id in enumerate(ids):
        if not id or "/" in id or id == "." or (k and id <= ids[k - 1]):
            raise CampaignError(
                f"{where}: /experiments: id {id!r}; expected names without '/', ascending in the order of recording"
            )
    for record in c.records:
        _check_record(record, c, limits, f"{where}: /experiments/{record.id}")


def _check_record(r: Record, c: Campaign, limits: Mapping[str, tuple[float, float]], where: str) -> None:
    n, samples = c.n, r.samples_per_period * r.f0
    _require(
        (
            ("excited", r.excited, r.excited in c.joints, f"one of {', '.join(c.joints)}"),
            ("posture", r.posture, _finite(r.posture, (n,)), f"{n} finite numbers"),
            ("f0_hz", r.f0, 0 < r.f0 < np.inf, "a finite number > 0"),
            ("periods", r.periods, r.periods >= 1, "at least 1"),
            ("samples_per_period", r.samples_per_period, r.samples_per_period >= 1, "at least 1"),
            (
                "samples_per_period",
                r.samples_per_period,
                abs(samples - c.fs) <= _WHOLE * c.fs,
                f"samples_per_period * f0_hz = fs_hz, which is {samples:.10g} against {c.fs:.10g}",
            ),
            ("rms", r.rms, 0 < r.rms < np.inf, "a finite number > 0"),
            ("lines", r.lines, r.lines.ndim == 1 and r.lines.size > 0, "a list of at least one harmonic"),
            ("lines", r.lines, bool(np.all(r.lines >= 1)), "harmonics >= 1"),
            ("lines", r.lines, len(np.unique(r.lines)) == r.lines.size, "harmonics that are all different"),
        ),
        where,
    )
    top = int(r.lines.max())
    if 2 * top > r.samples_per_period:
        raise CampaignError(
            f"{where}: lines: line {top} is at {top * r.f0:g} Hz, expected none above fs/2 = {c.fs / 2:g} Hz"
        )
    for name, value in zip(c.joints, r.posture, strict=True):
        low, high = limits[name]
        if not low - _LIMIT_SLACK <= value <= high + _LIMIT_SLACK:
            raise CampaignError(
                f"{where}: posture: {name!r} = {value:g}, expected within its limits [{low:g}, {high:g}]"
            )
    shape = (r.periods * r.samples_per_period, n)
    for name in ("tau", "theta", *OPTIONAL):
        values = getattr(r, name)
        if values is None:
            continue
        if values.shape != shape:
            raise CampaignError(f"{where}: {name}: found shape {values.shape}, expected {shape}")
        if not np.all(np.isfinite(values)):
            k, j = np.argwhere(~np.isfinite(values))[0]
            raise CampaignError(
                f"{where}: {name}: sample {k} of joint {c.joints[j]!r} is {values[k, j]}, expected finite samples"
            )


def _require(rules: tuple[tuple[str, Any, Any, str], ...], where: str) -> None:
    for field, found, ok, expected in rules:
        if not ok:
            raise CampaignError(f"{where}: {field}: found {_short(found)}, expected {expected}")


def _finite(values: Array, shape: tuple[int, ...]) -> bool:
    return values.shape == shape and bool(np.all(np.isfinite(values)))


def _positive_or_nan(values: Array, n: int) -> bool:
    return values.shape == (n,) and bool(np.all(np.isnan(values) | ((values > 0) & np.isfinite(values))))


def _not_negative_or_nan(values: Array | None, n: int) -> bool:
    return (
        values is not None
        and values.shape == (n,)
        and bool(np.all(np.isnan(values) | ((values >= 0) & np.isfinite(values))))
    )


def _damping(c: Campaign) -> tuple[tuple[str, Array | None], ...]:
    """Beyond the format: the declared damping, where there is any."""
    return (("damping", c.D), ("spring_damping", c.D_spring))


def _urdf_limits(urdf: str, where: str) -> dict[str, tuple[float, float]]:
    """(lower, upper) of every moving joint of a URDF, infinite where it states none."""
    if "<!DOCTYPE" in urdf or "<!ENTITY" in urdf:
        raise CampaignError(f"{where}: found a document type declaration, expected plain URDF")
    try:
        root = ET.fromstring(urdf)
        joints = [joint for joint in root.findall("joint") if joint.get("type") in _MOVING]
        return {joint.get("name", ""): _limits(joint) for joint in joints}
    except (ET.ParseError, ValueError) as error:
        raise CampaignError(f"{where}: not a readable URDF: {_line(error)}") from None


def _limits(joint: ET.Element) -> tuple[float, float]:
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return -np.inf, np.inf
    return float(limit.get("lower", "0")), float(limit.get("upper", "0"))


def _short(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
