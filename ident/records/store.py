"""The campaign file, format "frf-campaign", and the log of trajectories, format "joint-log": objects as HDF5 and back, version 1 each."""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ident.errors import CampaignError, message, short
from ident.records.campaign import Array, Campaign, Record
from ident.records.campaign_rules import OPTIONAL, check_campaign, damping
from ident.records.hdf5_node import DAMAGE, Node
from ident.records.log import Log, Trajectory, check_log

FORMAT, LOG, VERSION = "frf-campaign", "joint-log", 1

_GZIP = 1  # every HDF5 reader has it; level 4 saves 5 % of the space and takes half as long again
_CHUNK_BYTES = 2**18  # a few chunks a period: cheap to read in part, and below h5py's chunk cache
_DAMPING = {"D": "drive/damping", "D_spring": "drive/spring_damping"}
_CURRENTS = "drive/currents"  # of a log: not 0 where a torque is a current
_MADE_FROM = "made_from"  # beyond the format: what `join_campaigns` was told
_TEXT_CHECK = "text_crc32"  # HDF5 keeps strings of variable length in a heap, which has no checksum of its own


def write_campaign(campaign: Campaign, path: str | os.PathLike[str]) -> None:
    """Writes the campaign, complete or not at all: an existing file is replaced only by a finished one.

    CampaignError, one line, if the campaign breaks a rule of the format or the file can not be written.
    """
    path = Path(path)
    check_campaign(campaign, str(path))
    _replace(path, lambda file: _write(file, campaign))


def write_log(log: Log, path: str | os.PathLike[str]) -> None:
    """Writes the log, complete or not at all. CampaignError, one line, if it breaks a rule or the file can not be written."""
    path = Path(path)
    check_log(log, str(path))
    _replace(path, lambda file: _write_log(file, log))


def join_campaigns(parts: Sequence[Path], path: str | os.PathLike[str], made_from: str = "") -> None:
    """Writes the campaign of all records in the campaign files `parts`, which agree in everything else.

    Records are copied as they are stored; the file says what it was `made_from`. Complete or not at all, and errors, as in
    `write_campaign`, and for a part that is damaged.
    """

    def fill(file: h5py.File) -> None:
        for k, part in enumerate(parts):
            try:
                with h5py.File(part, "r") as one:
                    if k == 0:
                        file.attrs.update(one.attrs)
                        for name in ("robot", "drive"):
                            one.copy(name, file)
                    for id, record in one["experiments"].items():
                        one.copy(record, file.require_group("experiments"), id)
            except DAMAGE as error:
                raise CampaignError(f"{part}: damaged: {message(error)}") from None
        if made_from:
            file.attrs[_MADE_FROM] = made_from

    _replace(Path(path), fill)


def made_from(path: str | os.PathLike[str]) -> str:
    """Returns what `join_campaigns` was told that the file is made from; nothing where there is no such file."""
    try:
        with h5py.File(path, "r") as file:
            return str(file.attrs.get(_MADE_FROM, ""))
    except DAMAGE:
        return ""


def _replace(path: Path, fill: Callable[[h5py.File], None]) -> None:
    """Puts a file with what `fill` writes in the place of `path`, once it is safely on the disk.

    It is made in memory: HDF5 does not bear a disk that fills up while it writes.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    with h5py.File(h5py.h5f.create(os.fsencode(path.name), fcpl=_creation(), fapl=_access())) as file:
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
        raise CampaignError(f"{path}: cannot be written: {error.strerror or message(error)}") from None
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
    campaign = _opened(Path(path), _read)
    check_campaign(campaign, str(path))
    return campaign


def read_log(path: str | os.PathLike[str]) -> Log:
    """Returns the log in the file; trajectories sorted by id, whatever else is in it ignored. Errors as in `read_campaign`."""
    log = _opened(Path(path), _read_log)
    check_log(log, str(path))
    return log


def is_log(path: str | os.PathLike[str]) -> bool:
    """Whether the file says that it is a log; False where it says nothing or can not be read."""
    try:
        with h5py.File(path, "r") as file:
            return str(file.attrs.get("format", "")) == LOG
    except DAMAGE:
        return False


def _opened(path: Path, read: Callable[[h5py.File, str], Any]) -> Any:
    """What `read` makes of a file. CampaignError, one line, for one that can not be read."""
    try:
        if path.is_dir():
            raise CampaignError(f"{path}: is a directory; expected a campaign file")
        if not path.exists():
            raise CampaignError(f"{path}: no such file; expected a campaign file")
        with path.open("rb"):
            pass  # says "permission denied" in plain words, where HDF5 does not
    except (OSError, ValueError) as error:
        raise CampaignError(f"{path}: cannot be read: {message(error)}") from None
    if not h5py.is_hdf5(path):
        raise CampaignError(f"{path}: not an HDF5 file; expected a campaign file")
    try:
        with h5py.File(path, "r") as file:
            return read(file, str(path))
    except DAMAGE as error:
        raise CampaignError(f"{path}: damaged: {message(error)}") from None


# writing --------------------------------------------------------------------------------------------------------------


def _write(file: h5py.File, c: Campaign) -> None:
    file.attrs.update(format=FORMAT, version=VERSION, source=c.source, fs_hz=c.fs, hold=c.hold)
    file.attrs[_TEXT_CHECK] = _checksum(c.urdf, c.source, c.hold)
    _robot(file, c.urdf, c.joints)
    for name, values in (("gear_ratio", c.N), ("motor_inertia", c.J_m), ("stiffness", c.K), ("gravity", c.gravity)):
        _array(file, f"drive/{name}", values)
    for name, D in damping(c):
        if not np.all(np.isnan(D)):
            _array(file, f"drive/{name}", D)
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


def _write_log(file: h5py.File, log: Log) -> None:
    file.attrs.update(format=LOG, version=VERSION, source=log.source, fs_hz=log.fs)
    file.attrs[_TEXT_CHECK] = _checksum(log.urdf, log.source)
    _robot(file, log.urdf, log.joints)
    for name, values in (("gear_ratio", log.N), ("motor_inertia", log.J_m), ("gravity", log.gravity)):
        _array(file, f"drive/{name}", values)
    if log.currents:
        _array(file, _CURRENTS, np.array([name in log.currents for name in log.joints], dtype=float))
    for one in log.trajectories:
        group = file.create_group(f"trajectories/{one.id}")
        _array(group, "q", one.q)
        _array(group, "tau", one.tau)


def _robot(file: h5py.File, urdf: str, joints: Sequence[str]) -> None:
    file.create_group("robot")["urdf"] = urdf  # a group that comes with its first child would keep the time
    names = [name.encode() for name in joints]
    kind = h5py.string_dtype("utf-8", max(map(len, names)))  # of fixed length: stored, and so checked, with the dataset
    file.create_dataset("robot/joint_names", data=names, dtype=kind, chunks=True, compression=_GZIP, fletcher32=True)


def _array(group: h5py.Group, name: str, values: Array) -> None:
    rows = max(1, _CHUNK_BYTES // values[:1].nbytes)
    chunks = (min(len(values), rows), *values.shape[1:])
    group.create_dataset(name, data=values, chunks=chunks, compression=_GZIP, shuffle=True, fletcher32=True)


def _checksum(*texts: str) -> int:
    return zlib.crc32("\0".join(texts).encode())


# reading --------------------------------------------------------------------------------------------------------------


def _root(file: h5py.File, where: str, format: str) -> Node:
    """The file itself, which says that it is of this format."""
    root = Node(file, where)
    if (found := root.attribute("format")) != format:
        log = " (ident diagnose reads logs of trajectories)" if found == LOG else ""
        raise root.error("format", f"found {short(found)}, expected {format!r}{log}")
    if (version := root.number("version")) != VERSION:
        why = ", a version from the future" if version > VERSION else ""
        raise root.error("version", f"found {version:g}{why}; this program reads {VERSION}")
    return root


def _read(file: h5py.File, where: str) -> Campaign:
    root = _root(file, where, FORMAT)
    joints = root.strings("robot/joint_names", ndim=1)
    n = len(joints)
    experiments = root.below("experiments")
    urdf, source, hold = root.strings("robot/urdf", ndim=0), root.string("source"), root.string("hold")
    _verify(root, urdf, source, hold)
    dampings: dict[str, Any] = {name: root.array(path, (n,)) for name, path in _DAMPING.items() if path in file}
    return Campaign(
        urdf=urdf,
        joints=tuple(joints),
        fs=root.number("fs_hz"),
        hold=hold,
        N=root.array("drive/gear_ratio", (n,)),
        J_m=root.array("drive/motor_inertia", (n,)),
        K=root.array("drive/stiffness", (n,)),
        gravity=root.array("drive/gravity", (3,)),
        **dampings,
        source=source,
        records=tuple(_read_record(experiments.below(id), id, n) for id in sorted(experiments.group)),
    )


def _read_log(file: h5py.File, where: str) -> Log:
    root = _root(file, where, LOG)
    joints = root.strings("robot/joint_names", ndim=1)
    n = len(joints)
    urdf, source = root.strings("robot/urdf", ndim=0), root.string("source")
    _verify(root, urdf, source)
    runs = root.below("trajectories")
    currents = root.array(_CURRENTS, (n,)) if _CURRENTS in file else np.zeros(n)
    return Log(
        urdf=urdf,
        joints=tuple(joints),
        fs=root.number("fs_hz"),
        N=root.array("drive/gear_ratio", (n,)),
        J_m=root.array("drive/motor_inertia", (n,)),
        gravity=root.array("drive/gravity", (3,)),
        source=source,
        trajectories=tuple(_read_trajectory(runs.below(id), id, n) for id in sorted(runs.group)),
        currents=tuple(name for name, current in zip(joints, currents, strict=True) if current),
    )


def _read_trajectory(node: Node, id: str, n: int) -> Trajectory:
    samples = int(node.dataset("q").shape[0]) if node.dataset("q").ndim else 0
    return Trajectory(id, node.array("q", (samples, n)), node.array("tau", (samples, n)))


def _read_record(node: Node, id: str, n: int) -> Record:
    excited = node.string("excited")
    _verify(node, excited)
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
        **{name: node.array(name, shape) for name in OPTIONAL if name in node.group},
    )


def _verify(node: Node, *texts: str) -> None:
    """Compares the texts with the checksum beside them, if the file has one."""
    if _TEXT_CHECK in node.group.attrs and node.whole(_TEXT_CHECK) != _checksum(*texts):
        raise node.error(_TEXT_CHECK, f"damaged: the checksum of {', '.join(map(short, texts))} does not fit")
