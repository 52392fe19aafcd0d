"""Are the files in a directory what symgen writes from this URDF today? Byte for byte."""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from symgen import output
from symgen.errors import SymgenError
from symgen.plot import is_drawing
from symgen.request import PLAN_FILE, Request, plan_for, recorded, urdf_of


@dataclass(frozen=True)
class Check:
    """The directory compared with `files` regenerated ones; `differences` by file name, empty where all are the same."""

    directory: Path
    urdf: Path
    files: int
    differences: dict[str, str]

    def document(self) -> dict[str, Any]:
        """For --json."""
        return {
            "directory": str(self.directory),
            "urdf": str(self.urdf),
            "files": self.files,
            "same": not self.differences,
            "differences": [{"file": name, "difference": what} for name, what in self.differences.items()],
        }


def check(directory: Path, urdf: Path | None = None, request: Request | None = None) -> Check:
    """Returns how a directory differs from what symgen writes for `request` (default: the options in its plan.json).

    `urdf` defaults to `request.urdf_of`. A plan of the user's own postures is regenerated from the cells in plan.json; a
    drawing of a plan (`symgen plan`) may stand beside it.
    Raises SymgenError when there is no such directory, no plan.json in it, or no plan for the URDF; OSError.
    """
    if not directory.is_dir():
        raise SymgenError(f"--check {directory}: no such directory; expected one that symgen -o wrote")
    request = recorded(directory) if request is None or request == Request() else request
    urdf = urdf_of(directory) if urdf is None else urdf
    with tempfile.TemporaryDirectory() as beside:
        plan = plan_for(urdf, request, output.of_model)
        names = output.write_all(plan, Path(beside), plan.meanwhile)
        wanted = {name: (Path(beside) / name).read_bytes() for name in names}
    found = {path.name: path.read_bytes() if path.is_file() else b"" for path in sorted(directory.iterdir())}
    differences = {name: "missing" for name in names if name not in found}
    for name, content in found.items():
        if name not in wanted and not is_drawing(content):
            differences[name] = "not written by symgen for this URDF and these options"
        elif name in wanted and content != wanted[name]:
            differences[name] = (_stale if name == PLAN_FILE else _first_difference)(content, wanted[name])
    return Check(directory, urdf, len(names), dict(sorted(differences.items())))


def _stale(content: bytes, wanted: bytes) -> str:
    """How a plan.json differs: by the URDF it was made for, or else where."""
    made_for = json.loads(wanted)["urdf_sha256"]
    if made_for.encode() not in content:
        return f"stale: made for another URDF than this one (SHA-256 {made_for[:12]}..)"
    return _first_difference(content, wanted)


def _first_difference(found: bytes, wanted: bytes) -> str:
    """Where a file first differs, and that it may be a break of lines only."""
    if found.replace(b"\r\n", b"\n") == wanted.replace(b"\r\n", b"\n"):
        return "differs in its line ends only"
    pairs = enumerate(zip(found, wanted, strict=False))
    at = next((k for k, (a, b) in pairs if a != b), min(len(found), len(wanted)))
    line = wanted[:at].count(b"\n") + 1
    return f"differs from line {line} on, byte {at + 1} (of {len(found)}; expected {len(wanted)} bytes)"
