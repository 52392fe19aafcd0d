"""Where a fit of one flexible joint starts, so that no person has to say."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ident.records.campaign import Array
from ident.records.frf import Complex

#: Two decades of damping ratio around this cover gears from good to worn; only a start value.
START_DAMPING = 0.01


def starts_of(f: Array, G: Complex, sigma: Array, N: float, fs: float, hold: str) -> Iterator[Array]:
    """Yields start values [6] in the order of `fit.PARAMETERS`, best first.

    Rational fit, interpolated three points, a scan of the band for the pair, a pair above the band. `f` [L, Hz], `G` [L]
    theta / tau with standard deviation `sigma` [L], `hold` as in `fit.predict`.
    """
    w, T = 2 * np.pi * f, 1.0 / fs
    z = np.exp(1j * w * T)
    free = T**2 * (z + 1) / (2 * (z - 1) ** 2) if hold == "zoh" else -1.0 / w**2  # response of a unit inertia
    H = G / free
    rational = _rational_start((1j * w).astype(complex), H, sigma / np.abs(free), N)
    if rational is not None:
        yield rational
    three = _three_point_start(f, np.abs(H), N)
    if three is not None:
        yield three
    yield from _scanned_starts(w, H, sigma / np.abs(free), N)
    J_top = float(1.0 / np.abs(H[-1]))
    above = (2 * np.pi * 1.5 * f[-1]) ** 2 * J_top / 2 * N**2
    damping = 2 * START_DAMPING * np.sqrt(above * J_top / 2) * abs(N)
    yield np.array([J_top / 2, above, J_top / 2 * N**2, J_top * w[0], damping, 0.0])


def _rational_start(s: Complex, H: Complex, sigma: Array, N: float) -> Array | None:
    """Returns parameters from s^2 (n0 + n1 s + n2 s^2) / (s^4 + d3 s^3 + d2 s^2 + d1 s + d0) = H [L], if possible.

    H = theta / tau over the response of a unit inertia, so that the hold cancels. Linear in the coefficients, no local
    minima: iterated linear least squares, C. Sanathanan, J. Koerner, IEEE TAC 8 (1963), DOI 10.1109/TAC.1963.1105517.
    """
    unit = np.abs(s[-1])
    x = s / unit
    lead = x**4
    columns = np.stack([x**2, x**3, lead, -H, -H * x, -H * x**2, -H * x**3], axis=1)
    weight, best, coefficients = 1.0 / (sigma * np.abs(lead)), np.inf, np.zeros(7)
    for _ in range(20):
        A, b = columns * weight[:, None], H * lead * weight
        A, b = np.concatenate([A.real, A.imag]), np.concatenate([b.real, b.imag])
        size = np.linalg.norm(A, axis=0)
        c = np.linalg.lstsq(A / size, b, rcond=None)[0] / size
        denominator = lead + np.stack([x**k for k in range(4)], axis=1) @ c[3:]
        cost = np.sum(np.abs((H - columns[:, :3] @ c[:3] / denominator) / sigma) ** 2)
        if cost < best:
            best, coefficients = cost, c
        weight = 1.0 / (sigma * np.abs(denominator))
    n0, n1, n2, d0, _, d2, d3 = coefficients * unit ** np.array([2.0, 1, 0, 4, 3, 2, 1])
    if n2 == 0.0:
        return None
    J_m, w_z2 = 1.0 / n2, n0 / n2  # w_z2 = (K + K_g) / J_l
    k = (d2 - w_z2) * J_m  # K / N^2, damping products left out
    if J_m <= 0.0 or k <= 0.0 or w_z2 <= d0 * J_m / k:
        return None
    J_l = k / (w_z2 - d0 * J_m / k)
    c = n1 / n2 * J_l
    D = J_m * d3 - c * (1.0 + J_m / J_l)
    return np.array([J_m, k * N**2, J_l * N**2, D, c * N**2, d0 * J_m / k * J_l * N**2])


def _scanned_starts(w: Array, H: Complex, sigma: Array, N: float, most: int = 3) -> Iterator[Array]:
    """Yields parameters from the pairs that explain H best, f_AR tried at every line and a few damping ratios.

    1/H = J_m + (J_l/N^2) / (1 - (w/w_AR)^2 + 2 j zeta w/w_AR) + D/(j w) - K_g/(N w)^2 is linear in the rest. A resonance as
    light as J_l of a few percent of N^2 J_m drowns the other starts; here it stands out of the residual.
    """
    weight = np.abs(H) ** 2 / sigma
    fixed = np.stack([np.ones_like(w), 1.0 / (1j * w), -1.0 / w**2]) * weight
    target = weight / H
    found: list[tuple[float, float, float, Array]] = []
    for zeta in (0.3 * START_DAMPING, START_DAMPING, 3 * START_DAMPING):
        x = w[None, :] / w[:, None]
        mode = weight / (1.0 - x**2 + 2j * zeta * x)
        columns = np.stack([*np.broadcast_to(fixed[:, None, :], (3, *mode.shape)), mode], axis=1)  # [tries, 4, L]
        size = np.linalg.norm(columns, axis=2)
        columns = columns / size[:, :, None]
        normal = np.einsum("tal,tbl->tab", columns, columns.conj()).real
        right = (columns.conj() @ target).real
        try:
            c = np.linalg.solve(normal, right[..., None])[..., 0]
        except np.linalg.LinAlgError:
            continue
        gain = np.einsum("ta,ta->t", c, right)
        c = c / size
        possible = (c[:, 0] > 0) & (c[:, 3] > 0)
        found += [(float(gain[k]), float(w[k]), zeta, c[k]) for k in np.flatnonzero(possible)]
    taken: list[float] = []
    for _, w_AR, zeta, (J_m, D, K_g, J) in sorted(found, key=lambda item: -item[0]):
        if len(taken) == most:
            return
        if all(abs(np.log(w_AR / other)) > 0.05 for other in taken):
            taken.append(w_AR)
            K, J_l = w_AR**2 * J * N**2, J * N**2
            yield np.array([J_m, K, J_l, max(D, J_m * w[0] * 1e-3), 2 * zeta * np.sqrt(K * J_l), K_g * N**2])


def _three_point_start(f: Array, size: Array, N: float) -> Array | None:
    """Returns parameters from interpolated dip and peak of |H| [L], or None when they are not inside the band.

    |H| at the top is 1/J_m times (1 - f_AR^2/f^2) / (1 - f_R^2/f^2): the factor that the paper's rule leaves out.
    """
    dip, peak = largest_rise(size)
    f_AR, f_R = _vertex(f, np.log(size), dip), _vertex(f, np.log(size), peak)
    if not f_AR < f_R < f[-1]:
        return None
    top = f[-1] ** 2
    J_m = (1.0 - f_AR**2 / top) / (1.0 - f_R**2 / top) / size[-1]
    J_l = (f_R**2 / f_AR**2 - 1.0) * N**2 * J_m
    K = 4 * np.pi**2 * f_AR**2 * J_l
    return np.array([J_m, K, J_l, J_m * 2 * np.pi * f[0], 2 * START_DAMPING * np.sqrt(K * J_l), 0.0])


def largest_rise(size: Array) -> tuple[int, int]:
    """Returns (dip, peak): the indices i < j with the largest ratio size[j] / size[i]."""
    logarithm = np.log(size)
    lowest = np.minimum.accumulate(logarithm)
    peak = int(np.argmax(logarithm - lowest))
    return int(np.argmin(logarithm[: peak + 1])), peak


def _vertex(f: Array, y: Array, i: int) -> float:
    """Returns the frequency of the extremum of the parabola through y around index i; f[i] at the ends of the band."""
    if not 0 < i < len(f) - 1:
        return float(f[i])
    a, b, _ = np.polyfit(f[i - 1 : i + 2] - f[i], y[i - 1 : i + 2], 2)
    return float(f[i] + np.clip(-b / (2 * a) if a else 0.0, f[i - 1] - f[i], f[i + 1] - f[i]))
