"""What several tests of `ident` are given."""

from __future__ import annotations

from pathlib import Path

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of the diagnosis made by hand come first: one process makes it, for the other takes its tests from the end."""
    items.sort(key=lambda item: not _diagnosed(item))


def _diagnosed(item: pytest.Item) -> bool:
    module = vars(item.module) if isinstance(item, pytest.Function) else {}
    return any("diagnosed" in (getattr(v, "__module__", ""), getattr(v, "__name__", "")) for v in module.values())


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Where the records of a diagnosis are said to come from."""
    path = tmp_path / "campaign.h5"
    path.write_bytes(b"not read, only signed")
    return path
