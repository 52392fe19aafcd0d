"""The campaign files that a result was made of: read together, told in the result, and found again unchanged."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ident.errors import IdentError
from ident.records.campaign import Campaign, is_copy
from ident.records.store import read_campaign

#: What a campaign declares of its drives, as far as it is known.
_DATASHEET = ("J_m", "K", "D", "D_spring")
#: By so much [relative] two ways of writing one number differ.
_ROUNDING = 1e-9


def joined(paths: Sequence[str | Path]) -> Campaign:
    """Returns all records of the campaigns at `paths`; those of later ones have their file's name before their own. What one file does not
    know of a drive another may.

    IdentError for campaigns that are not of one robot, as its URDF, joints, gears, gravity, sampling, hold and drives say, or that share a
    record: its copy would choose, or report, what it has fitted.
    """
    first, *others = (read_campaign(path) for path in paths)
    records, stems = list(first.records), {Path(paths[0]).stem}
    for k, (path, other) in enumerate(zip(paths[1:], others, strict=True), 2):
        if _robot(other) != _robot(first):
            raise IdentError(
                f"{path}: another URDF, gear, gravity, sampling or hold than {paths[0]}; expected campaigns of one robot, or "
                "diagnose it by itself"
            )
        first = replace(first, **_drives(first, other, path))
        stem = Path(path).stem if Path(path).stem not in stems else f"{Path(path).stem}-{k}"
        stems.add(stem)
        copies = [(record.id, one.id) for record in other.records for one in records if is_copy(record, one)]
        if copies:
            raise IdentError(
                f"{path}: record {copies[0][0]} has the samples of record {copies[0][1]} of the files before; expected each record once"
            )
        records += [replace(record, id=f"{stem}/{record.id}") for record in other.records]
    return replace(first, records=tuple(records))


def _robot(c: Campaign) -> tuple[Any, ...]:
    return c.urdf, c.joints, c.fs, c.hold, c.N.tolist(), c.gravity.tolist()


def _drives(first: Campaign, other: Campaign, path: str | Path) -> dict[str, Any]:
    """The declared numbers [n] of the drives in the files before and in that at `path`. IdentError where these are not the same ones."""
    found: dict[str, Any] = {}
    for name in _DATASHEET:
        ours, theirs = getattr(first, name), getattr(other, name)
        differ = np.abs(ours - theirs) > _ROUNDING * np.maximum(
            np.abs(ours), np.abs(theirs)
        )  # never where one is unknown
        if differ.any():
            j = int(np.argmax(differ))
            raise IdentError(
                f"{path}: {first.joints[j]}: {name} = {theirs[j]:g}, in the files before {ours[j]:g}; expected campaigns of one "
                "robot, or diagnose it by itself"
            )
        found[name] = np.where(np.isnan(ours), theirs, ours)
    return found


def told(paths: Sequence[str | Path]) -> dict[str, Any]:
    """Returns the first file as {"file", "path", "sha256"}, and under "more_files" the others alike."""
    first, *more = (
        {
            "file": str(path),
            "path": str(Path(path).resolve()),
            "sha256": hashlib.sha256(Path(path).read_bytes()).hexdigest(),
        }
        for path in paths
    )
    return {**first, "more_files": more}


def again(given: Mapping[str, Any]) -> Campaign:
    """Returns the campaign of the files that `told` told of. IdentError for one that is gone or has changed since."""
    return joined([file_again(one) for one in (given, *given.get("more_files", ()))])


def file_again(given: Mapping[str, Any]) -> Path:
    """Returns where a file that `told` told of is now: as it was named, or where it was; another file of its name is passed by. IdentError for one
    that is gone or has changed since."""
    there = [path for path in (Path(given["file"]), Path(given.get("path", given["file"]))) if path.is_file()]
    for path in there:
        if hashlib.sha256(path.read_bytes()).hexdigest() == given["sha256"]:
            return path
    if there:
        raise IdentError(f"{there[-1]}: has changed since the result was made of it; make the result again")
    raise IdentError(f"{given['file']}: no such file; expected the campaign that the result was made of")


def document(file: Path, made_by: str) -> dict[str, Any]:
    """Returns the JSON document in a result's `file`. IdentError, one line, naming the command that makes it."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(found, dict):
            raise TypeError(f"found a {type(found).__name__}, expected an object")
    except OSError:
        raise IdentError(f"{file}: no such file; expected what {made_by} wrote") from None
    except (ValueError, TypeError) as error:
        raise IdentError(f"{file}: not a result: {error}; run {made_by}") from None
    return found
