"""A canvas for SVG: matplotlib's only door, opened when something is drawn. Small, deterministic, readable in the dark.

Data are grey dots, the fit is blue, CAD dashed orange: Okabe and Ito's palette, which colour-blind readers can tell
apart. No text of the user enters a figure, so that nothing needs escaping here.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.records.campaign import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Ratio of the ends of a logarithmic axis below which its decades alone are too few labels.
TWO_DECADES = 100.0
INK, DATA, MUTED, GRID = "#1b1b1b", "#757575", "#a0a0a0", "#d4d4d4"
FIT, CAD, EVEN, ODD = "#0072b2", "#d55e00", "#009e73", "#cc79a7"
#: In the report a style sheet sets these, so that the figures follow a dark screen.
_VARIABLES = {
    INK: "ink", DATA: "data", MUTED: "muted", GRID: "grid", FIT: "fit", CAD: "cad", EVEN: "even", ODD: "odd",
}  # fmt: skip
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none", "text.parse_math": False, "axes.unicode_minus": True, "font.size": 9, "axes.labelsize": 9,
    "text.color": INK, "axes.labelcolor": INK, "xtick.color": INK, "ytick.color": INK, "axes.edgecolor": MUTED,
    "axes.grid": True, "grid.color": GRID, "grid.linewidth": 0.6, "axes.linewidth": 0.8, "axes.axisbelow": True,
    "legend.frameon": False, "legend.fontsize": 8.5, "xtick.labelsize": 8.5, "ytick.labelsize": 8.5,
}  # fmt: skip


def dots(axes: Axes, x: Array, y: Array, colour: str, size: float = 2.0, above: int = 1) -> None:
    """Draws dots at (x, y) as one path of empty strokes with round ends: a quarter of the size of markers; `above` what is lower."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Curve

    curve = Curve(np.repeat(np.column_stack([x, y]), 2, axis=0), np.tile([Curve.MOVETO, Curve.LINETO], len(x)))
    curve.should_simplify = False
    axes.add_artist(PathPatch(curve, fill=False, edgecolor=colour, linewidth=size, capstyle="round", zorder=above))


def logarithmic(set_scale: Callable[[str], None], axis: Any) -> None:
    """Makes an axis logarithmic, with plain numbers at the decades and nothing between them; at twice and five times these, too, where
    fewer than two decades are seen."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    class Decades(LogLocator):
        def tick_values(self, vmin: float, vmax: float) -> Any:
            self.set_params(subs=(1.0, 2.0, 5.0) if vmax < TWO_DECADES * vmin else (1.0,))
            return super().tick_values(vmin, vmax)

    set_scale("log")
    axis.set_major_locator(Decades(numticks=7))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


@contextmanager
def drawing(width: float, height: float, salt: str) -> Iterator[tuple[Figure, Callable[..., str]]]:
    """A figure of `width` x `height` inches and the function svg(title, standalone=False) that returns it as SVG text.

    `title` is for screen readers. `standalone` is a file of its own with a white page; else the SVG is for the report,
    in whose style sheet its colours are. The user's matplotlib style has no say; `salt` keeps ids of figures apart.
    """
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # whatever style the user has set elsewhere
        matplotlib.rcParams.update(_STYLE | {"svg.hashsalt": salt})
        figure = Figure(figsize=(width, height))

        def svg(title: str, standalone: bool = False) -> str:
            buffer = io.StringIO()
            figure.savefig(buffer, format="svg", transparent=not standalone, metadata={"Date": None})
            return _compact(buffer.getvalue(), title, standalone)

        yield figure, svg


def _compact(svg: str, title: str, standalone: bool) -> str:
    """Returns matplotlib's SVG without prolog and metadata, with rounded paths, for use inside HTML or as a file."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"\s*<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    svg = re.sub(r' d="([^"]*)"', lambda found: f' d="{_rounded(found[1])}"', svg)
    svg = re.sub(r' (x|y|width|height)="(\d+\.\d+)"', lambda n: f' {n[1]}="{float(n[2]):.2f}"', svg)
    svg = re.sub(r"\n\s*", "\n", svg)
    svg = svg.replace("<svg ", f'<svg role="img" aria-label="{title}" ', 1)
    if standalone:
        return '<?xml version="1.0" encoding="utf-8"?>\n' + svg
    svg = re.sub(r'(<svg [^>]*?)width="[^"]*" height="[^"]*"', r"\1", svg)
    svg = re.sub(r"; font-family: [^;\"]*|font-family: [^;\"]*; ?", "", svg)
    for colour, variable in _VARIABLES.items():
        svg = svg.replace(colour, f"var(--{variable})")
    return svg.replace("xlink:href", "href").replace(' xmlns:xlink="http://www.w3.org/1999/xlink"', "")


def _rounded(path: str) -> str:
    path = re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.2f}".rstrip("0").rstrip("."), path)
    path = re.sub(r"M (\S+ \S+) \nL \1 \n", r"M\1h0", path)
    return re.sub(r"\s*\n\s*", "", re.sub(r"([MLz]) ", r"\1", path))
