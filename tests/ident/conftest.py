"""What several tests of `ident` are given."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Where the records of a diagnosis are said to come from."""
    path = tmp_path / "campaign.h5"
    path.write_bytes(b"not read, only signed")
    return path
