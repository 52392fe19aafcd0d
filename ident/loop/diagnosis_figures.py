"""The figures of a diagnosis, each as SVG text: what is left of a response before and after, and the law that was found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ident.effects.by_record import ByRecord
from ident.effects.learned import LearnedCurve
from ident.effects.response import Response
from ident.effects.ringing import Ringing
from ident.loop.effect_words import abscissa, ordinate
from ident.loop.held_out import Force, Gains, HeldOut, heights
from ident.records.campaign import Array
from ident.reports.canvas import CAD, DATA, FIT, MUTED, dots, drawing, logarithmic

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Instants drawn of a law, points of a curve.
INSTANTS, CURVE = 600, 200
#: Factor by which an axis reaches beyond the first and last line.
ROOM = 1.06
#: Share of the dots that may lie outside at either end of an axis.
STRAY = 0.005
#: What is drawn above what: the law found, the records on it, the knots.
LAW, RECORDS, KNOTS = 2, 3, 4
#: Widths of what was found, and of the dots on it.
WIDE, SMALL = 3.2, 1.3
#: Labels of what the records want and of what was found.
MEASURED, FOUND = "from the records, no law assumed", "the effect"


def before_after_figure(row: HeldOut) -> str:
    """Returns one held-out record as SVG: the response, and what each model leaves of it, or the one there is, against its noise."""
    velocity = 2.0 * np.pi * row.f / np.maximum(np.abs(row.tau), 1e-300)
    measured, before, after, noise = (
        velocity * np.abs(values) for values in (row.theta, row.before, row.after, row.noise)
    )
    with drawing(7.4, 3.9, f"before after {row.record}") as (figure, svg):
        axes = figure.add_axes((0.1, 0.13, 0.885, 0.75))
        logarithmic(axes.set_xscale, axes.xaxis)
        logarithmic(axes.set_yscale, axes.yaxis)
        axes.set_xlim(row.f[0] / ROOM, row.f[-1] * ROOM)
        gaps = np.flatnonzero(row.apart)
        line = (np.insert(values, gaps, np.nan) for values in (row.f, noise))
        axes.plot(*line, color=MUTED, linewidth=1.0, label="noise")
        alone = row.apart & np.append(row.apart[1:], True)
        dots(axes, row.f[alone], noise[alone], MUTED, 1.6)
        models = [(before, CAD, "left before"), (after, FIT, "left after")]
        if np.array_equal(before, after):
            models = [(after, FIT, "left")]
        for values, colour, label in [(measured, DATA, "response"), *models]:
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
            dots(axes, x[pick], force.law[pick], FIT, WIDE, LAW)
            dots(axes, x[pick], force.found[pick], DATA, SMALL, RECORDS)
            _across(axes, x[pick])
            _up(axes, force.found[pick], force.law[pick])
            axes.set_xlabel(name, loc="left")
            axes.locator_params(axis="x", nbins=5)
            axes.ticklabel_format(scilimits=(-2, 3))  # so that labels are short
        row[0].set_ylabel(ylabel)
        _key(row[0], ".")
        figure.legend(*row[0].get_legend_handles_labels(), loc="upper center", ncol=2)
        return svg("Torque at the port against its position, velocity and torque")


def curve_figure(effect: LearnedCurve, std: Sequence[float], forces: Sequence[Force], slides: bool) -> str:
    """Returns a learned curve over its variable as SVG: its heights at the knots, each with its standard deviation `std` [K] where the
    records tell it, and the heights that the records want without a curve."""
    x, y = heights(effect, forces)
    pick = slice(None, None, max(1, len(x) // INSTANTS))
    x, y = x[pick], y[pick]
    curve = effect.curve(slides)
    knots, values = np.array(curve["knots"]), np.array(curve["heights"])
    if curve["period"]:
        x = np.mod(x, curve["period"])
        fine = np.linspace(0.0, curve["period"], CURVE)
    else:
        ends = np.append(knots, x)
        fine = np.unique(np.append(np.linspace(ends.min(), ends.max(), CURVE), knots))
    with drawing(7.4, 2.9, f"curve {effect.port} {effect.joint} {effect.variable}") as (figure, svg):
        axes = figure.add_axes((0.11, 0.17, 0.875, 0.68))
        axes.plot(fine, effect.height(fine), color=FIT, linewidth=0.5 * WIDE, zorder=LAW, label=FOUND)
        dots(axes, x, y, DATA, SMALL, RECORDS)
        _knots(axes, knots, values, np.array(std))
        _across(axes, np.append(fine, x))
        _up(axes, y, np.append(effect.height(fine), values))
        axes.set_xlabel(abscissa(curve, effect.port))
        axes.set_ylabel(ordinate(curve, effect.port))
        axes.ticklabel_format(scilimits=(-3, 4))
        axes.plot([], [], linestyle="none", marker=".", color=DATA, label=MEASURED)
        figure.legend(*axes.get_legend_handles_labels(), loc="upper center", ncol=3)
        return svg("The learned curve over its variable, with its knots")


def gains_figure(found: Gains) -> str:
    """Returns what becomes of a signal on its way as SVG: gain and phase by frequency, measured (dots) and as the effect has it."""
    order = np.argsort(found.f)
    f, measured, law = found.f[order], found.measured[order], found.law[order]
    phase = np.degrees(np.unwrap(np.angle(law)))
    off = np.degrees(np.angle(measured / law))  # never further than half a turn from the law
    with drawing(7.4, 2.9, f"gains {found.records}") as (figure, svg):
        row = figure.subplots(1, 2)
        figure.subplots_adjust(left=0.09, right=0.985, top=0.86, bottom=0.18, wspace=0.24)
        for axes, y, model, name in (
            (row[0], phase + off, phase, "phase [deg]"),
            (row[1], np.abs(measured), np.abs(law), "gain"),
        ):
            axes.plot(f, model, color=FIT, linewidth=WIDE, zorder=LAW)
            dots(axes, f, y, DATA, SMALL, RECORDS)
            _across(axes, np.append(f, 0.0))
            _up(axes, y, model)
            axes.set_xlabel("frequency [Hz]")
            axes.set_ylabel(name)
        _key(row[0], "")
        figure.legend(*row[0].get_legend_handles_labels(), loc="upper center", ncol=2)
        return svg("Phase and gain of what becomes of the signal, against frequency")


def response_figure(effect: Response, std: Sequence[float], found: Gains | None) -> str:
    """Returns gain and delay of a learned frequency response as SVG: its knots, each with its standard deviation `std` where the records
    tell it, and what was `found` without a curve."""
    curve = effect.curve()
    knots = np.array(curve["knots"])
    f = np.geomspace(knots[0], knots[-1], CURVE)
    gain, delay = effect.at_frequencies(f)
    of_gains, of_delays = np.split(np.array(std, dtype=float), [len(knots) - 1])
    sizes = np.array(curve["heights"])
    with drawing(7.4, 2.9, f"response {effect.port} {effect.joint}") as (figure, svg):
        row = figure.subplots(1, 2)
        figure.subplots_adjust(left=0.09, right=0.985, top=0.86, bottom=0.18, wspace=0.24)
        for axes, y, at, error, name in (
            (row[0], gain, sizes, sizes * np.append(0.0, of_gains), "gain"),
            (row[1], 1e3 * delay, 1e3 * np.array(curve["delays"]), 1e3 * of_delays, "delay [ms]"),
        ):
            logarithmic(axes.set_xscale, axes.xaxis)
            known = np.isfinite(error) | ~np.isfinite(error).any()  # what is not told may be far away
            drawn = f >= knots[known][0]
            axes.plot(f[drawn], y[drawn], color=FIT, linewidth=0.5 * WIDE, zorder=LAW)
            _knots(axes, knots, at, error)
            own = told = at[known]
            if found is not None:
                turned = np.angle(found.measured / found.law) / (2.0 * np.pi * found.f)
                own = np.abs(found.measured) if axes is row[0] else 1e3 * (effect.at_frequencies(found.f)[1] - turned)
                dots(axes, found.f, own, DATA, SMALL, RECORDS)
            _up(axes, own, told)
            axes.set_xlim(knots[0] / ROOM, knots[-1] * ROOM)
            axes.set_xlabel("frequency [Hz]")
            axes.set_ylabel(name)
        _key(row[0], "")
        figure.legend(*row[0].get_legend_handles_labels(), loc="upper center", ncol=3)
        return svg("Gain and delay against frequency")


def resonance_figure(effect: Ringing, found: Gains) -> str:
    """Returns the inertia that a motor feels of a mass that rings with it as SVG: size and phase by frequency, and what was `found` without
    it."""
    curve = effect.curve()
    f, size, phase = (np.array(curve[key]) for key in ("knots", "heights", "phases"))
    with drawing(7.4, 2.9, f"resonance {effect.joint}") as (figure, svg):
        row = figure.subplots(1, 2)
        figure.subplots_adjust(left=0.1, right=0.985, top=0.86, bottom=0.18, wspace=0.26)
        off = np.angle(found.measured / found.law)  # never further than half a turn from the effect
        for axes, y, own, name in (
            (row[0], size, np.abs(found.measured), "inertia felt [kg m²]"),
            (row[1], np.degrees(phase), np.degrees(np.angle(found.law) + off), "phase [deg]"),
        ):
            logarithmic(axes.set_xscale, axes.xaxis)
            axes.plot(f, y, color=FIT, linewidth=0.5 * WIDE, zorder=LAW)
            near = (found.f > f[0] / ROOM) & (found.f < f[-1] * ROOM)
            dots(axes, found.f[near], own[near], DATA, SMALL, RECORDS)
            axes.set_xlim(f[0] / ROOM, f[-1] * ROOM)
            axes.set_xlabel("frequency [Hz]")
            axes.set_ylabel(name)
        logarithmic(row[0].set_yscale, row[0].yaxis)
        row[0].set_ylim(0.5 * float(size.min()), 2.0 * float(size.max()))
        row[1].set_ylim(-270.0, 90.0)
        _key(row[0], "")
        figure.legend(*row[0].get_legend_handles_labels(), loc="upper center", ncol=2)
        return svg("Inertia that the motor feels, and its phase, against frequency")


def record_figure(effect: ByRecord, std: Sequence[float]) -> str:
    """Returns by what share a joint's stiffness is another in each record, over the records from 1: each with its standard deviation."""
    records, shares = np.array([1.0, *effect.knots]), np.array([0.0, *effect.values])
    with drawing(7.4, 2.9, f"records {effect.joint}") as (figure, svg):
        axes = figure.add_axes((0.11, 0.17, 0.875, 0.68))
        axes.plot(records, shares, color=DATA, linewidth=0.5 * WIDE)
        _knots(axes, records[1:], shares[1:], np.array(std, dtype=float))
        _across(axes, records)
        axes.set_xlabel("record")
        axes.set_ylabel("share of the stiffness")
        figure.legend(*axes.get_legend_handles_labels(), loc="upper center", ncol=3)
        return svg("The share by which the stiffness is another in each record")


def _knots(axes: Axes, x: Array, y: Array, std: Array) -> None:
    """Knots of a curve, with a bar of a standard deviation each side of those that the records tell."""
    told = np.isfinite(std)
    axes.plot(x, y, linestyle="none", marker="o", markersize=3.6, color=FIT, zorder=KNOTS, label="its knots ± σ")
    axes.vlines(x[told], (y - std)[told], (y + std)[told], color=FIT, linewidth=1.2, zorder=KNOTS)


def _key(axes: Axes, marker: str) -> None:
    """Labels of the dots from the records and of what was found: by dots, or by a line where there is no marker."""
    axes.plot([], [], linestyle="none", marker=".", color=DATA, label=MEASURED)
    axes.plot([], [], linestyle="none" if marker else "-", marker=marker, color=FIT, label=FOUND)


def _across(axes: Axes, x: Array) -> None:
    """Room for all of x."""
    axes.set_xlim(*_with_room(float(x.min()), float(x.max())))


def _up(axes: Axes, found: Array, law: Array) -> None:
    """Room for all of the law, and all of the dots but a few stray ones."""
    axes.set_ylim(*_with_room(_low(found, law), -_low(-found, -law)))


def _with_room(low: float, high: float) -> tuple[float, float]:
    room = 0.05 * max(high - low, 1e-12)
    return low - room, high + room


def _low(found: Array, law: Array) -> float:
    """The lowest value drawn; a few stray dots may lie outside."""
    return float(min(np.quantile(found, STRAY), law.min()))
