"""The figures of the report, each as SVG text: responses with their misfit, J(q) along the joints, distortion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ident.arm.misfits import Misfit
from ident.identification.identify import OF_TWO_MASSES, Identification, Measurement
from ident.identification.verdict import entry
from ident.joint.fit import PARAMETERS, predict
from ident.records.campaign import Array, Campaign
from ident.records.frf import Complex
from ident.reports.canvas import CAD, DATA, EVEN, FIT, GRID, INK, MUTED, ODD, dots, drawing, logarithmic

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: An inertia that changes by less than this share over a joint's range does not depend on that joint.
DEPENDS = 1e-9


@dataclass(frozen=True)
class Response:
    """What one record shows and two models of it, as velocity over torque [rad/s per N m, motor side].

    Measured at the usable lines `f` [L, Hz]: `measured` [L], `noise` [L] its standard deviation; `misfit` of the fit.
    On the fine grid `fine` [F, Hz]: `fitted` the method's model, `declared` the datasheet's drive with CAD's inertia, and `means` what
    that takes for granted.
    """

    f: Array
    measured: Complex
    noise: Array
    misfit: Misfit
    fine: Array
    fitted: Complex
    declared: Complex
    means: str


def response(m: Measurement, campaign: Campaign) -> Response:
    """Returns the curves of one record.

    With a fit of all motors the declared arm has these, too. Else the other joints of the declared arm are rigid, and its drive takes
    damping, and what no datasheet tells, from the fit of two masses; K_g too where that explains the record.
    """
    frf, fit = m.frf, m.two_mass
    f, G = frf.frequencies[frf.usable], frf.G[frf.usable]
    N, fs, hold = m.N, campaign.fs, campaign.hold
    at_lines = m.G_model[frf.usable]
    if fit is None or m.method not in OF_TWO_MASSES:  # known at the lines only
        fine, at_fine = f, at_lines
    else:
        near = 1.0 + np.linspace(-0.04, 0.04, 33)
        fine = np.concatenate([np.geomspace(f[0], f[-1], 240), fit.f_AR * near, fit.f_R * near])
        fine = np.unique(fine[(fine >= f[0]) & (fine <= f[-1])])
        at_fine = predict(fit.parameters, fine, N, fs, hold)
    sigma = np.sqrt(frf.variance[frf.usable])
    s, fine_s = 2j * np.pi * f, 2j * np.pi * fine
    if m.G_declared is not None:
        expected, means = m.G_declared[frf.usable], "datasheet and CAD"
    else:
        declared, means = _declared(m, campaign), "datasheet and CAD, other joints rigid"
        known = np.isfinite(declared).all()
        expected = predict(declared, fine, N, fs, hold) if known else np.full(len(fine), np.nan, dtype=complex)
    return Response(f, s * G, np.abs(s) * sigma, m.misfit, fine, fine_s * at_fine, fine_s * expected, means)


def _declared(m: Measurement, campaign: Campaign) -> Array:
    """The six parameters of the datasheet's drive with CAD's inertia; what these do not tell as two masses fit it."""
    fit, i = m.two_mass, m.index
    if fit is None:
        return np.full(len(PARAMETERS), np.nan)
    declared = fit.parameters
    for k, value in enumerate((campaign.J_m[i], campaign.K[i], m.J_cad)):
        if np.isfinite(value) and value > 0:
            declared[k] = value
    if not fit.explained:
        declared[PARAMETERS.index("K_g")] = 0.0
    return declared


def frf_figure(m: Measurement, campaign: Campaign) -> str:
    """Returns one record as SVG: magnitude and phase with fit, CAD and noise level, and below the whitened residual."""
    r, fit = response(m, campaign), m.two_mass
    with drawing(6.3, 5.0, f"frf {m.record.id}") as (figure, svg):
        size, phase, misfit = figure.subplots(3, 1, sharex=True, height_ratios=[3.0, 1.5, 1.2])
        figure.subplots_adjust(left=0.115, right=0.985, top=0.885, bottom=0.09, hspace=0.15)
        _magnitude(size, r)
        size.set_ylabel("|velocity / torque| [rad/s per N m]")
        if fit is not None and m.method in OF_TWO_MASSES:
            for f in (fit.f_AR, fit.f_R):
                if r.f[0] < f < r.f[-1]:
                    for axes in (size, phase, misfit):
                        axes.axvline(f, color=MUTED, linewidth=0.9, linestyle=(0, (1, 1.5)))
            at = float(np.clip(np.sqrt(fit.f_AR * fit.f_R), r.f[0], r.f[-1]))
            right = at**2 > r.f[0] * r.f[-1]
            size.text(
                min(1.25 * at, r.f[-1]) if right else max(0.8 * at, r.f[0]), 1.02,
                f"f_AR {fit.f_AR:.4g} Hz, f_R {fit.f_R:.4g} Hz", fontsize=8.5,
                transform=size.get_xaxis_transform(), ha="right" if right else "left",
            )  # fmt: skip
        dots(phase, r.f, np.degrees(np.angle(r.measured)), DATA, 3.4)
        phase.plot(r.fine, _angle(r.fitted), color=FIT, linewidth=1.2)
        phase.plot(r.fine, _angle(r.declared), color=CAD, linewidth=1.2, linestyle=(0, (4, 2)))
        phase.set_ylim(-200, 200)
        phase.set_yticks([-180, -90, 0, 90, 180])
        phase.set_ylabel("phase [deg]")
        logarithmic(misfit.set_yscale, misfit.yaxis)
        misfit.set_ylim(0.03, max(10.0, 1.5 * float(r.misfit.size.max())))
        misfit.axhspan(0.03, r.misfit.limit, color=GRID, alpha=0.55, linewidth=0)
        dots(misfit, r.misfit.f, np.maximum(r.misfit.size, 0.03), INK)
        misfit.set_ylabel("|misfit| [σ]")
        misfit.set_xlabel("frequency [Hz]")
        figure.align_ylabels()
        figure.legend(*size.get_legend_handles_labels(), loc="upper center", ncol=4, columnspacing=1.4)
        return svg("Frequency response: measured, fitted and CAD")


def sweep_figures(identification: Identification) -> list[tuple[int, int, float, str]]:
    """Returns (i, j, sigma, SVG), i, j from 0: J_ii with 2 sigma along each joint j on which it depends, against CAD.

    `sigma` is the largest standard deviation of J_ii on the way, infinite where it needs a constant that was not
    measured. The other joints stay at zero, or at their limit next to it.
    """
    model = identification.model
    low, high = model.chain.limits.T
    rest = np.clip(0.0, low, high)
    probe = model.random_postures(20, np.random.default_rng(0))
    figures = []
    for i in range(model.chain.n):
        for j in range(i + 1, model.chain.n):
            turned = probe.copy()
            turned[:, j] = low[j] + high[j] - probe[:, j] + 0.1
            change = identification.J(turned)[:, i, i] - identification.J(probe)[:, i, i]
            if np.abs(change).max() <= DEPENDS * np.abs(identification.J(probe)[:, i, i]).max():
                continue
            q = np.tile(rest, (121, 1))
            q[:, j] = np.linspace(low[j], high[j], len(q))
            std = identification.J_std(q)[:, i, i]
            figures.append((i, j, float(std.max()), _sweep(identification, q, std, i, j)))
    return figures


def distortion_figure(m: Measurement) -> str | None:
    """Returns the response at the lines that were not excited, by third octaves, as SVG; None without such lines."""
    d, i = m.frf.detection, m.index
    if not len(d.lines):
        return None
    with drawing(3.1, 2.2, f"distortion {m.record.id}") as (figure, svg):
        axes = figure.add_axes((0.23, 0.2, 0.74, 0.76))
        logarithmic(axes.set_xscale, axes.xaxis)
        logarithmic(axes.set_yscale, axes.yaxis)
        f, noise = _third_octaves(d.frequencies, d.noise[:, i])
        drawn = [noise]
        axes.plot(f, noise, color=MUTED, linewidth=1.2)
        for odd, colour in ((False, EVEN), (True, ODD)):
            if (d.odd == odd).any():
                f, level = _third_octaves(d.frequencies[d.odd == odd], d.level[d.odd == odd, i])
                drawn.append(level)
                dots(axes, f, level, colour, 4.0)
        axes.set_xlim(d.frequencies[0], d.frequencies[-1])
        axes.set_ylim(*_decades(np.concatenate(drawn)))
        axes.set_xlabel("frequency [Hz]")
        axes.set_ylabel("level / excited [1]")
        return svg("Response at lines that were not excited")


def summary_figure(identification: Identification) -> str:
    """Returns all records' velocity responses as one SVG file: measured, fitted and CAD."""
    records, columns = identification.measurements, min(4, len(identification.measurements))
    rows = -(-len(records) // columns)
    width, height = 2.9 * columns, 2.15 * rows + 0.75
    with drawing(width, height, "summary") as (figure, svg):
        grid = figure.subplots(rows, columns, squeeze=False)
        figure.subplots_adjust(0.85 / width, 0.45 / height, 0.99, 1 - 0.6 / height, wspace=0.24, hspace=0.42)
        for k, axes in enumerate(grid.flat):
            if k >= len(records):
                axes.set_visible(False)
                continue
            _magnitude(axes, response(records[k], identification.campaign))
            i, chi2 = records[k].index, records[k].chi2_per_dof
            axes.set_title(
                f"{k + 1}: {entry(i, i, identification.campaign.n)}, χ²/dof {chi2:.3g}", fontsize=9, loc="left"
            )
            if k >= len(records) - columns:
                axes.set_xlabel("frequency [Hz]")
            if k % columns == 0:
                axes.set_ylabel("rad/s per N m")
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="upper center", ncol=4)
        return svg("Velocity over torque of every record: measured, fitted and CAD", standalone=True)


def _magnitude(axes: Axes, r: Response) -> None:
    logarithmic(axes.set_xscale, axes.xaxis)
    logarithmic(axes.set_yscale, axes.yaxis)
    axes.set_xlim(r.f[0], r.f[-1] if len(r.f) > 1 else 1.1 * r.f[0])
    axes.set_ylim(*_decades(np.concatenate([np.abs(r.measured), np.abs(r.fitted), [max(np.median(r.noise), 1e-300)]])))
    axes.plot(r.f, r.noise, color=MUTED, linewidth=0.7, label="noise level")
    axes.plot(r.fine, np.abs(r.fitted), color=FIT, linewidth=1.2, label="fitted")
    axes.plot(r.fine, np.abs(r.declared), color=CAD, linewidth=1.2, linestyle=(0, (4, 2)), label=r.means)
    dots(axes, r.f, np.abs(r.measured), DATA, 3.4)
    axes.plot([], [], linestyle="none", marker=".", color=DATA, label="measured")


def _sweep(identification: Identification, q: Array, std: Array, i: int, j: int) -> str:
    joints = identification.model.chain.joints
    linear = joints[j].type == "prismatic"
    x = q[:, j] if linear else np.degrees(q[:, j])
    J, J_cad = identification.J(q)[:, i, i], identification.model.J_cad(q)[:, i, i]
    with drawing(3.1, 2.2, f"sweep {i} {j}") as (figure, svg):
        axes = figure.add_axes((0.2, 0.2, 0.77, 0.76))
        band = 2.0 * np.nan_to_num(std, posinf=0.0)
        axes.fill_between(x, J - band, J + band, color=FIT, alpha=0.25, linewidth=0)
        axes.plot(x, J, color=FIT, linewidth=1.4)
        axes.plot(x, J_cad, color=CAD, linewidth=1.4, linestyle=(0, (4, 2)))
        axes.set_ylim(min(0.0, 1.05 * float(J.min())), 1.08 * float(max(J.max(), J_cad.max(), 1e-12)))
        axes.set_xlim(x[0], x[-1])
        axes.set_xlabel(f"q{j + 1} [{'m' if linear else 'deg'}]")
        name, unit = entry(i, i, len(joints)), "kg" if joints[i].type == "prismatic" else "kg m²"
        axes.set_ylabel(f"{name} [{unit}]")
        return svg(f"{name} along joint {j + 1}: identified and CAD")


def _angle(values: Complex) -> Array:
    """Degrees; a jump of a whole turn is a gap and no line across the plot."""
    angle = np.degrees(np.angle(values))
    angle[1:][np.abs(np.diff(angle)) > 270.0] = np.nan
    return np.asarray(angle)


def _third_octaves(f: Array, level: Array) -> tuple[Array, Array]:
    """Returns centres [Hz] and rms levels of the third octaves that hold lines."""
    band = np.floor(3.0 * np.log2(f)).astype(int)
    bands = np.unique(band)
    rms = np.array([np.sqrt(np.mean(level[band == b] ** 2)) for b in bands])
    return 2.0 ** ((bands + 0.5) / 3.0), np.maximum(rms, 1e-300)


def _decades(values: NDArray[Any]) -> tuple[float, float]:
    """Limits of a logarithmic axis around the positive values, with a little room."""
    positive = values[np.isfinite(values) & (values > 1e-30)]
    if not positive.size:
        return 0.1, 1.0
    return float(positive.min()) / 1.5, float(positive.max()) * 1.5
