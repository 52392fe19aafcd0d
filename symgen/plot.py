"""A plan as one SVG: each posture as a stick figure, coverage of joint space, singular values, amplification.

matplotlib's only door in symgen, opened when something is drawn. Lengths on the page are inches from the upper left corner.
"""

from __future__ import annotations

import html
import io
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from symgen.chain import REVOLUTE, Array, Chain, placements, readonly
from symgen.errors import PlanError
from symgen.notation import entry_text
from symgen.plan import Cell, Model, load_plan_cells
from symgen.request import PLAN_FILE, model_for, recorded

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INK, _MUTED, _FAINT, _EXCITED, _SPARE = "#1b1b1b", "#757575", "#d4d4d4", "#0072b2", "#d55e00"
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none", "svg.hashsalt": "symgen", "text.parse_math": False, "font.size": 8, "axes.titlesize": 9,
    "text.color": _INK, "axes.edgecolor": _MUTED, "axes.linewidth": 0.7, "xtick.labelsize": 7, "ytick.labelsize": 7,
}  # fmt: skip

_WIDTH, _MARGIN, _TOP, _GAP = 12.0, 0.5, 0.75, 0.75
_CHARTS, _STRIP, _SQUARE, _LEAST_COVERAGE, _COLUMNS = 2.2, 0.32, 1.5, 1.8, 8

#: An arm all of whose points coincide is drawn as if it were this large [m].
_POINT = 1e-3

#: How a drawing begins.
_HEAD = '<svg role="img" aria-label="Plan of '

#: An amplification beyond this is no number.
_ENDLESS = 1e300

#: Where the arm is looked at from: azimuth and elevation.
_VIEW = np.deg2rad([-55.0, 22.0])

#: Singular values that count as zero are rounding: drawn at the power of ten above, and never below this.
_ROUNDING = 1e-15


@dataclass(frozen=True)
class Stick:
    """An arm in space: `points` [n + 2, 3, m, base frame] are the base, the n joints and the end of the last link; `axes`
    [n, 3] the unit vectors of the joint axes."""

    points: Array
    axes: Array


def stick(chain: Chain, q: Array) -> Stick:
    """Returns the arm at a posture q [n, rad or m]. The last link is drawn to twice its centre of mass."""
    R, points, axes = np.eye(3), [np.zeros(3)], []
    for (turn, shift), joint in zip(placements(chain, q[None]), chain.joints, strict=True):
        points.append(points[-1] + R @ shift[0])
        R = R @ turn[0]
        axes.append(R @ joint.axis)
    points.append(points[-1] + 2 * R @ chain.joints[-1].inertia.com)
    return Stick(readonly(points), readonly(axes))


def plot_of(directory: Path, urdf: Path) -> str:
    """Returns the SVG of the plan.json in a directory that symgen -o wrote for this URDF.

    Raises PlanError when plan.json is none, or of another URDF; UrdfError, RobotError.
    """
    path = directory / PLAN_FILE
    model = model_for(urdf, recorded(directory))
    cells = load_plan_cells(path, model)
    amplification = json.loads(path.read_text(encoding="utf-8"))["plan"].get("amplification_per_joint")
    if not (
        isinstance(amplification, list)
        and len(amplification) == model.chain.n
        and all(a is None or (isinstance(a, int | float) and 0 <= a < _ENDLESS) for a in amplification)
    ):
        raise PlanError(f"{path}: amplification_per_joint: expected {model.chain.n} numbers; run symgen again")
    if not cells:
        raise PlanError(f"{path}: cells: none to draw; run symgen again")
    return draw(model, cells, amplification)


def is_drawing(content: bytes) -> bool:
    """Whether a file holds what `plot_of` returns, for whatever plan."""
    return _HEAD.encode() in content[:1000]


def draw(model: Model, cells: Sequence[Cell], amplification: Sequence[float | None]) -> str:
    """Returns one SVG file as text, the same for the same input; `amplification` [n], None where it is not finite."""
    import matplotlib
    from matplotlib.figure import Figure

    chain = model.chain
    paired = max(chain.n - 2, 0)
    coverage = max(_LEAST_COVERAGE, _STRIP * chain.n, min(_SQUARE, 2.8 / max(paired, 1)) * paired)
    drawn = _Sticks(chain, cells)
    below = _TOP + _CHARTS + _GAP + coverage + _GAP
    height = below + drawn.rows * (drawn.height + _Sticks.label) + _MARGIN / 2
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # whatever style the user has set elsewhere
        matplotlib.rcParams.update(_STYLE)
        page = _Page(Figure(figsize=(_WIDTH, height)), height)
        spare = sum(cell.spare for cell in cells)
        page.text(_MARGIN, 0.3, f"{_plain(chain.name)}: {len(cells) - spare} measurements, {spare} spare", size=13)
        half = (_WIDTH - 3 * _MARGIN - 0.4) / 2
        right = 2 * _MARGIN + half + 0.4
        _singular_values(page.axes(_MARGIN + 0.2, _TOP, half, _CHARTS), model)
        _amplification(page.axes(right, _TOP, half, _CHARTS), amplification)
        strips = page.axes(_MARGIN + 0.9, _TOP + _CHARTS + _GAP, half - 1.1, coverage)
        _coverage(strips, chain, cells)
        _pairs(page, chain, cells, right, _TOP + _CHARTS + _GAP, coverage)
        drawn.draw(page, below)
        return _svg(page.figure, _plain(chain.name))


@dataclass(frozen=True)
class _Page:
    figure: Figure
    height: float

    def axes(self, x: float, y: float, width: float, height: float) -> Axes:
        axes = self.figure.add_axes((x / _WIDTH, 1 - (y + height) / self.height, width / _WIDTH, height / self.height))
        axes.spines[["top", "right"]].set_visible(False)
        return axes

    def text(self, x: float, y: float, text: str, **style: Any) -> None:
        self.figure.text(x / _WIDTH, 1 - y / self.height, text, va="center", **style)


# Charts --------------------------------------------------------------------------------------------------------------


def _singular_values(axes: Axes, model: Model) -> None:
    values, d = model.factoring.singular_values, model.d
    kept, dropped = values[:d], values[d:]
    above = np.maximum(10.0 ** np.ceil(np.log10(np.maximum(dropped, _ROUNDING)) - 1e-9), _ROUNDING)
    _dots(axes, np.arange(1, d + 1), np.log10(kept), _EXCITED, "singular-values")
    if len(above):
        _dots(axes, np.arange(d + 1, len(values) + 1), np.log10(above), _MUTED, "rounding")
        axes.axvline(d + 0.5, color=_SPARE, linewidth=1, linestyle="--", gid="rank-gap")
        low, high = float(np.log10(above[0])), float(np.log10(kept[-1]))
        text = f" rank {d}: {kept[-1]:.3g} counts, {above[0]:.0e} is rounding "
        axes.text(d + 0.5, (low + high) / 2, text, color=_SPARE, ha="right" if 2 * d > len(values) else "left")
    ticks = np.arange(0, np.floor(np.log10(min([kept[-1], *above[:1]]))) - 1, -3)
    axes.set_yticks(ticks, [f"1e{tick:.0f}" for tick in ticks])
    axes.set_xlim(0, len(values) + 1)
    axes.set_title("Singular values of the stacked coefficients of all J_ii, relative", loc="left")


def _amplification(axes: Axes, amplification: Sequence[float | None]) -> None:
    joints = range(1, len(amplification) + 1)
    highest = max([a for a in amplification if a is not None], default=1.0)
    for joint, value in zip(joints, amplification, strict=True):
        if value is not None:
            axes.bar(joint, value, 0.6, color=_EXCITED, gid=f"amplification-{joint}")
        axes.text(joint, value or 0.0, "open" if value is None else f"{value:.3g}", ha="center", va="bottom")
    axes.axhline(1.0, color=_MUTED, linewidth=0.8, linestyle="--")
    axes.set_xticks(joints, [entry_text(len(joints), k, k) for k in range(len(joints))])
    axes.set_ylim(0, 1.15 * max(highest, 1.0))
    axes.set_title("Error of J_ii(q) over the workspace, rms, per unit error of a measurement", loc="left")


def _coverage(axes: Axes, chain: Chain, cells: Sequence[Cell]) -> None:
    """One line a joint from limit to limit, and on it the cells whose J_ii depends on that joint."""
    for k, joint in enumerate(chain.joints):
        axes.plot([0, 1], [k, k], color=_FAINT, linewidth=5, solid_capstyle="butt")
        for x, value, side in ((-0.02, chain.limits[k, 0], "right"), (1.02, chain.limits[k, 1], "left")):
            axes.text(x, k, _value(joint.type, value), ha=side, va="center", fontsize=7, color=_MUTED)
        for spare, colour in ((False, _EXCITED), (True, _SPARE)):
            at = _within(chain, cells, k, spare)[:, k]
            _dots(axes, at, np.full(len(at), float(k)), colour, f"coverage-{k + 1}-{'spare' if spare else 'planned'}")
    axes.text(0.5, 0, "no J_ii depends on it", ha="center", va="center", fontsize=7, color=_MUTED)
    axes.set_yticks(range(chain.n), [f"{k + 1} {_plain(name)[:16]}" for k, name in enumerate(chain.names)])
    axes.tick_params(axis="y", length=0, pad=32)
    axes.set_xticks([])
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.set_xlim(0, 1)
    axes.set_ylim(chain.n - 0.5, -0.5)
    axes.set_title("Where the cells are within the joint limits [deg, mm]; spare ones orange", loc="left")


def _pairs(page: _Page, chain: Chain, cells: Sequence[Cell], left: float, top: float, height: float) -> None:
    """For each pair of joints beyond the first a square from limits to limits, with the cells that depend on both."""
    if chain.n < 3:
        return
    side = min(_SQUARE, 2.8 / (chain.n - 2), height / (chain.n - 2))
    page.text(left, top - 0.22, "The same for pairs of joints", size=9)
    for row in range(2, chain.n):
        for column in range(1, row):
            x, y = left + 0.2 + (column - 1) * side, top + (row - 2) * side
            axes = page.axes(x, y, 0.9 * side, 0.9 * side)
            axes.spines[["top", "right"]].set_visible(True)
            axes.set_xticks([])
            axes.set_yticks([])
            for spare, colour in ((False, _EXCITED), (True, _SPARE)):
                at = _within(chain, cells, column, spare)
                _dots(axes, at[:, column], at[:, row], colour, f"pair-{column + 1}-{row + 1}-{int(spare)}", 1.8)
            axes.set_xlim(-0.05, 1.05)
            axes.set_ylim(-0.05, 1.05)
        page.text(left, top + (row - 1.55) * side, f"{row + 1}", size=7)
        page.text(left + 0.2 + (row - 1.6) * side, top + (row - 2) * side - 0.06, f"{row}", size=7)


def _within(chain: Chain, cells: Sequence[Cell], k: int, spare: bool) -> Array:
    """The cells [m, n] whose J_ii depends on joint k, from 0 (lower limits) to 1 (upper limits)."""
    low, high = chain.limits.T
    q = np.array([c.q for c in cells if c.spare == spare and chain.names.index(c.joint) < k]).reshape(-1, chain.n)
    share: Array = (q - low) / (high - low)
    return share


def _value(kind: str, value: float) -> str:
    return f"{np.rad2deg(value) if kind == REVOLUTE else 1e3 * value:.0f}".replace("-0", "0")


# Postures ------------------------------------------------------------------------------------------------------------


class _Sticks:
    """All cells as stick figures in a table, all to one scale and seen from the same side."""

    label = 0.32

    def __init__(self, chain: Chain, cells: Sequence[Cell]):
        self.chain, self.cells = chain, cells
        self.columns = min(_COLUMNS, max(len(cells), 4))
        self.rows = -(-len(cells) // self.columns)
        self.sticks = [stick(chain, cell.q) for cell in cells]
        every = np.concatenate([s.points for s in self.sticks])
        size = max(float(np.linalg.norm(np.ptp(every, axis=0))), _POINT)
        self.long = 0.07 * size  # half of a joint axis as drawn [m]
        seen = np.concatenate([_seen(every), _seen(every * [1, 1, 0])])
        self.low, high = seen.min(axis=0) - self.long, seen.max(axis=0) + self.long
        self.width = (_WIDTH - 2 * _MARGIN) / self.columns
        self.scale = min((self.width - 0.1) / (high - self.low)[0], 1.7 / (high - self.low)[1])
        self.height = self.scale * (high - self.low)[1] + 0.1

    def draw(self, page: _Page, top: float) -> None:
        height = self.rows * (self.height + self.label)
        axes = page.axes(_MARGIN, top, _WIDTH - 2 * _MARGIN, height)
        axes.set_axis_off()
        axes.set_xlim(0, _WIDTH - 2 * _MARGIN)
        axes.set_ylim(height, 0)
        page.text(_MARGIN, top - 0.32, "The postures in the order of the plan: blue the axis of the excited joint, grey the "
                  "other axes and the shadow on the floor, dashed frame a spare one.", size=8)  # fmt: skip
        page.text(
            _MARGIN, top - 0.14, "Below: joints 2, 3, .. in deg and mm; - where J_ii does not depend on it.", size=8
        )
        for k in range(len(self.cells)):
            self._draw_one(axes, k, k % self.columns * self.width, k // self.columns * (self.height + self.label))

    def _draw_one(self, axes: Axes, k: int, x: float, y: float) -> None:
        cell, arm, joint = self.cells[k], self.sticks[k], self.chain.names.index(self.cells[k].joint)

        def at(points: Array) -> Array:
            on_page = self.scale * (_seen(points) - self.low) + 0.05
            placed: Array = np.stack([x + on_page[:, 0], y + self.height - on_page[:, 1]], axis=1)
            return placed

        def axis(j: int) -> Array:
            return at(arm.points[j + 1] + np.outer([-1, 1], self.long * arm.axes[j]))

        frame = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) * [
            self.width - 0.08,
            self.height + self.label - 0.06,
        ]
        name = f"cell-{k + 1}{'-spare' if cell.spare else ''}"
        _lines(axes, [frame + [x, y]], _SPARE if cell.spare else _FAINT, 0.8, name, "--" if cell.spare else "-")
        _lines(axes, [at(arm.points * [1, 1, 0])], _FAINT, 1.6, f"shadow-{k + 1}")
        others = [axis(j) for j in range(self.chain.n) if j != joint]
        _lines(axes, others, _MUTED, 1.0, f"axes-{k + 1}")
        _lines(axes, [at(arm.points)], _INK, 2.2, f"arm-{k + 1}")
        _lines(axes, [axis(joint)], _EXCITED, 3.2, f"excited-{k + 1}")
        number = entry_text(self.chain.n, joint, joint)
        axes.text(x + 0.05, y + 0.1, f"{k + 1}  {number}{'  spare' if cell.spare else ''}", va="center", fontsize=7)
        values = [
            _value(one.type, q) if j > joint else "-"
            for j, (one, q) in enumerate(zip(self.chain.joints, cell.q, strict=True))
        ]
        axes.text(x + 0.05, y + self.height + 0.12, " ".join(values[1:]), va="center", fontsize=6, color=_MUTED)


def _seen(points: Array) -> Array:
    """Points [m, 3] as seen from `_VIEW`, orthographic: to the right and up [m, 2]."""
    (ca, ce), (sa, se) = np.cos(_VIEW), np.sin(_VIEW)
    right, up = np.array([-sa, ca, 0.0]), np.array([-ca * se, -sa * se, ce])
    seen: Array = points @ np.stack([right, up], axis=1)
    return seen


# SVG -----------------------------------------------------------------------------------------------------------------


def _lines(axes: Axes, lines: Iterable[Array], colour: str, width: float, name: str, style: str = "-") -> None:
    """Draws polylines [m, 2] as one path, which keeps the file small."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Curve

    lines = list(lines)
    if not lines:
        return
    codes = [code for line in lines for code in (Curve.MOVETO, *[Curve.LINETO] * (len(line) - 1))]
    curve = Curve(np.concatenate(lines), codes)
    curve.should_simplify = False
    axes.add_artist(
        PathPatch(
            curve, fill=False, edgecolor=colour, linewidth=width, linestyle=style, capstyle="round", joinstyle="round",
            gid=name,
        )
    )  # fmt: skip


def _dots(axes: Axes, x: Array, y: Array, colour: str, name: str, size: float = 3.5) -> None:
    axes.plot(x, y, "o", color=colour, markersize=size, markeredgewidth=0, gid=name, clip_on=False)


def _plain(text: str) -> str:
    """The text with nothing that a font or XML may lack."""
    return re.sub(r"[^ -~]", "?", text)


def _svg(figure: Figure, name: str) -> str:
    """The figure of the arm of this name as a file: no date, short numbers."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    svg = buffer.getvalue()
    svg = re.sub(r"\s*<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r' d="([^"]*)"', lambda path: f' d="{_rounded(path[1])}"', svg)
    return svg.replace("<svg ", f'{_HEAD}{html.escape(name)}" ', 1)


def _rounded(path: str) -> str:
    return re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]) + 0.0:.2f}".rstrip("0").rstrip("."), path)
