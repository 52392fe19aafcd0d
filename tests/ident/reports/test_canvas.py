"""What an axis tells can be read off it."""

from __future__ import annotations

import re

import pytest

from ident.reports.canvas import drawing, logarithmic


@pytest.mark.parametrize(
    ("low", "high", "labels"),
    [
        (12.0, 245.0, ["20", "50", "100", "200"]),
        (1.0, 45.0, ["1", "2", "5", "10", "20"]),
        (0.5, 120.0, ["1", "10", "100"]),
        (1e-4, 1e4, ["0.0001", "0.01", "1", "100", "10000"]),
    ],
)
def test_a_logarithmic_axis_of_less_than_two_decades_has_labels_between_them(low, high, labels):
    with drawing(4.0, 3.0, "axis") as (figure, svg):
        axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
        logarithmic(axes.set_xscale, axes.xaxis)
        axes.set_xlim(low, high)
        axes.set_yticks([])
        assert re.findall(r"<text[^>]*>([^<]*)</text>", svg("an axis")) == labels
