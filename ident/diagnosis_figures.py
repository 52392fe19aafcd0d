"""The figures of a diagnosis, each as SVG text: what is left of a response before and after, and the law that was found."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ident.campaign import Array
from ident.canvas import CAD, DATA, FIT, MUTED, dots, drawing, logarithmic
from ident.effects.response import Response
from ident.held_out import Force, HeldOut

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Instants drawn of a law, points of a curve.
INSTANTS, CURVE = 600, 200
#: Factor by which an axis reaches beyond the first and last line.
ROOM = 1.06


def before_after_figure(row: HeldOut) -> str:
    """Returns one held-out record as SVG: the response, and what each model leaves of it, against its noise."""
    velocity = 2.0 * np.pi * row.f / np.maximum(np.abs(row.tau), 1e-300)
    measured, before, after, noise = (
        velocity * np.abs(values) for values in (row.theta, row.before, row.after, row.noise)
    )
    with drawing(7.4, 3.9, f"before after {row.record}") as (figure, svg):
        axes = figure.add_axes((0.1, 0.13, 0.885, 0.75))
        logarithmic(axes.set_xscale, axes.xaxis)
        logarithmic(axes.set_yscale, axes.yaxis)
        axes.set_xlim(row.f[0] / ROOM, row.f[-1] * ROOM)
        axes.plot(row.f, noise, color=MUTED, linewidth=1.0, label="noise")
        for values, colour, label in (
            (measured, DATA, "response"),
            (before, CAD, "left before"),
            (after, FIT, "left after"),
        ):
            dots(axes, row.f, np.maximum(values, 1e-12 * measured.max()), colour, 3.2)
            axes.plot([], [], linestyle="none", marker=".", color=colour, label=label)
        everything = np.concatenate([measured, before, noise])
        axes.set_ylim(0.2 * float(np.quantile(noise, 0.02)), 2.0 * float(everything.max()))
        axes.set_xlabel("frequency [Hz]")
        axes.set_ylabel("velocity / torque [rad/s per N m]")
        figure.legend(*axes.get_legend_handles_labels(), loc="upper center", ncol=4)
        return svg("What each model leaves of the response, before and after, against the noise")


def law_figure(force: Force, slides: bool) -> str:
    """Returns what acted at a port, found from the records (dots) and as the effect has it, against the port's own motion; its joint
    `slides` or turns."""
    rad, angle, N, torque = ("m", "position", "N", "force") if slides else ("rad", "angle", "N m", "torque")
    names = {
        "motor": ("motor angle - mean [rad]", "motor velocity [rad/s]", "motor torque [N m]"),
        "spring": (f"deflection - mean [{rad}]", f"rate of deflection [{rad}/s]", f"spring {torque} [{N}]"),
        "link": (f"link {angle} - mean [{rad}]", f"link velocity [{rad}/s]", f"spring {torque} [{N}]"),
        "sensor": ("motor angle - mean [rad]", "motor velocity [rad/s]", "motor torque [N m]"),
    }[force.port]
    ylabel = {"sensor": "error of the angle [rad]", "motor": "torque [N m]"}.get(force.port, f"{torque} [{N}]")
    step = max(1, len(force.found) // INSTANTS)
    pick = slice(None, None, step)
    with drawing(7.4, 2.9, f"law {force.port} {force.joint} {force.record}") as (figure, svg):
        row = figure.subplots(1, 3, sharey=True)
        figure.subplots_adjust(left=0.1, right=0.985, top=0.86, bottom=0.18, wspace=0.08)
        for axes, x, name in zip(
            row, (force.position - force.position.mean(), force.velocity, force.torque), names, strict=True
        ):
            _cloud(axes, x[pick], force.found[pick], force.law[pick])
            axes.set_xlabel(name, loc="left")
            axes.locator_params(axis="x", nbins=5)
            axes.ticklabel_format(scilimits=(-2, 3))  # so that labels are short
        row[0].set_ylabel(ylabel)
        row[0].plot([], [], linestyle="none", marker=".", color=DATA, label="from the records, no law assumed")
        row[0].plot([], [], linestyle="none", marker=".", color=FIT, label="the effect")
        figure.legend(*row[0].get_legend_handles_labels(), loc="upper center", ncol=2)
        return svg("Torque at the port against its position, velocity and torque")


def response_figure(effect: Response) -> str:
    """Returns gain and delay of a learned frequency response as SVG, with its knots."""
    curve = effect.curve()
    knots = np.array(curve["knots"])
    f = np.geomspace(knots[0], knots[-1], CURVE)
    gain, delay = effect.at_frequencies(f)
    with drawing(7.4, 2.6, f"response {effect.port} {effect.joint}") as (figure, svg):
        row = figure.subplots(1, 2)
        figure.subplots_adjust(left=0.09, right=0.985, top=0.95, bottom=0.2, wspace=0.22)
        for axes, y, heights, name in (
            (row[0], gain, curve["heights"], "gain"),
            (row[1], 1e3 * delay, 1e3 * np.array(curve["delays"]), "delay [ms]"),
        ):
            logarithmic(axes.set_xscale, axes.xaxis)
            axes.plot(f, y, color=FIT)
            dots(axes, knots, np.asarray(heights), FIT, 5.0)
            axes.set_xlabel("frequency [Hz]")
            axes.set_ylabel(name)
        return svg("Gain and delay against frequency")


def _cloud(axes: Axes, x: Array, found: Array, law: Array) -> None:
    dots(axes, x, found, DATA, 1.6)
    dots(axes, x, law, FIT, 2.2)
    for low, high, limit in ((x.min(), x.max(), axes.set_xlim), (_low(found, law), -_low(-found, -law), axes.set_ylim)):
        room = 0.05 * max(float(high - low), 1e-12)
        limit(float(low) - room, float(high) + room)


def _low(found: Array, law: Array) -> float:
    """The lowest value drawn; a few stray dots may lie outside."""
    return float(min(np.quantile(found, 0.005), law.min()))
