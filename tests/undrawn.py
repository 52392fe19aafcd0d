"""Reports without curves, or with those of one record, for tests that do not look at the others: two thirds of the time of a report."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def undrawn() -> Iterator[None]:
    """Nothing of the records is drawn meanwhile; all else of a report is written."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ident.reports.figures.frf_figure", lambda *_: "")
        patch.setattr("ident.reports.figures.distortion_figure", lambda *_: None)
        patch.setattr("ident.reports.figures.summary_figure", lambda *_: "")
        patch.setattr("ident.reports.figures.sweep_figures", lambda *_: ())
        for name in ("before_after", "law", "curve", "gains", "response", "record", "resonance"):
            patch.setattr(f"ident.loop.diagnosis_figures.{name}_figure", lambda *_: "")
        yield


@contextmanager
def drawn_of(record: str) -> Iterator[None]:
    """Of all records but this one nothing is drawn meanwhile."""
    from ident.reports import figures

    with pytest.MonkeyPatch.context() as patch:
        for name in ("frf_figure", "distortion_figure"):
            draw = getattr(figures, name)
            patch.setattr(figures, name, lambda m, *of, draw=draw: draw(m, *of) if m.record.id == record else "")
        yield
