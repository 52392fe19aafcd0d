"""What angles that move say of a joint at rest: the ratio of motor to link, and whether a motor turns with its torque.

No line need lie below the modes: on a soft spring the lowest ones may lie above the first, where the link is in antiphase.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from ident.records.campaign import Array

Complex = NDArray[np.complex128]

#: Fewest lines of which a straight line is told, and how far its value at 0 may be off, relative, for it to be believed.
_FEWEST, _UNSURE = 4, 0.25
#: How sure the spread of a value at 0 is.
_SURE = 0.99
#: At so many steps, even on a logarithmic scale, a torque's sign is judged: turned if what it falls by is this share of all it does, and
#: of what a mass would.
_STEPS, _FALLS = 60, 1 / 3


def ratio_at_rest(f: Array, motor: Complex, link: Complex) -> float | None:
    """Motor over link angle at standstill, with its sign, of their spectra [L] at the lines f [L, ascending, any unit]; None where these do
    not tell.

    A link on its spring moves as q N/theta = 1/(1 - (f/f_0)^2), f_0 its mode with the motor held: theta/q is straight in f^2 and its value
    at 0 is N, on whichever side of f_0 the lines are. Of a coupled arm it is straight far from the modes that the others have with this link
    held. So the fewest lowest lines are taken of which the straight line's value is sure, and a parabola's agrees.
    """
    heard = (link != 0) & np.isfinite(motor) & np.isfinite(link)
    f, ratio = f[heard], (motor[heard] / link[heard]).real
    if not len(ratio):
        return None
    size = float(np.median(np.abs(ratio))) or 1.0
    count = _FEWEST
    while count // 2 < len(ratio) >= _FEWEST:
        some = slice(min(count, len(ratio)))
        value, spread = _at_zero((f[some] / f[some][-1]) ** 2, ratio[some], size)
        if spread < _UNSURE * abs(value):
            return value
        count *= 2
    return None


def _at_zero(x: Array, y: Array, size: float) -> tuple[float, float]:
    """The value at 0 of the straight line through y(x), and how far it may be off: by noise, and by what a parabola says otherwise.

    Weighted by 1/(|y| + size): near the mode and far above it lines are to count alike.
    """
    weight = 1 / (np.abs(y) + size)
    values, spread = [], np.inf
    for powers in (2, 3):
        A = weight[:, None] * x[:, None] ** np.arange(powers)
        inverse = np.linalg.pinv(A)
        best = inverse @ (weight * y)
        values.append(float(best[0]))
        if powers == 2:
            left = np.linalg.norm(weight * y - A @ best) / np.sqrt(len(y) - powers)
            spread = float(student.ppf((1 + _SURE) / 2, len(y) - powers) * left * np.linalg.norm(inverse[0]))
    return values[0], spread + abs(values[1] - values[0])


def opposed(f: Array, tau: Complex, theta: Complex) -> bool:
    """Whether torque and angle of a motor, of these spectra [L] at the lines f [L, ascending, any unit], are of opposite sign.

    Between its poles f theta/tau grows with f, of everything that only springs and masses hold (Foster), whichever modes the lines are
    above; with a sign turned it falls. Near a damped mode, and where friction holds the motor, theta/tau is in quadrature: such lines do
    not count, nor do steps across a zero or pole.
    """
    some = np.unique(np.searchsorted(f, np.geomspace(f[0], f[-1], _STEPS)).clip(max=len(f) - 1))
    heard = some[(tau[some] != 0) & (theta[some] != 0)]
    moved = theta[heard] / tau[heard]
    counts, up = np.abs(moved.real) > np.abs(moved.imag), np.sign(moved.real)
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = np.diff(np.log(f[heard] * np.abs(moved.real))) * up[1:]
    steps = steps[counts[1:] & counts[:-1] & (up[1:] == up[:-1])]
    return bool(steps.sum() < -_FALLS * max(np.abs(steps).sum(), np.log(f[-1] / f[0])) < 0)
