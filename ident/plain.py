"""Numbers as JSON has them, texts as files have them, and files that are complete or not there."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ident.errors import IdentError


def plain(value: Any) -> Any:
    """The value in JSON's own types; what is not finite is None."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def as_text(text: str) -> str:
    """The text with "?" for what UTF-8 lacks: bytes of a file's name that are no text."""
    return text.encode("utf-8", "replace").decode()


def storable(text: str) -> bool:
    """Whether a file can hold the text: no null characters, and nothing that UTF-8 lacks."""
    return re.search("[\0\ud800-\udfff]", text) is None


def replace_file(path: Path, text: str) -> None:
    """Writes a file complete or not at all, its directory too. IdentError naming it if it can not be written."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(text, encoding="utf-8", errors="replace")
        os.replace(part, path)
    except OSError as error:
        raise IdentError(f"{path}: cannot be written: {error.strerror}") from None
    finally:
        with suppress(OSError):
            part.unlink()
