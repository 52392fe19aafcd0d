"""Joints that do not repeat themselves from period to period as the others do.

What a motor does otherwise in every period, under the same torque, counts as noise, and a model is held to explain what is
beyond it: a brake that drags by turns, play that rattles or a clock that jitters is not seen as what it is.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

#: A joint's noise, relative to its motion, that is so many times that of the others in the middle, and this much. Of clean campaigns it is
#: 5 times at most, of light joints whose encoders are coarse.
TIMES, LEAST = 8.0, 5e-3


def unrepeated(noise: Mapping[str, float | None]) -> dict[str, float]:
    """Returns the joints of which too much differs from period to period, and how many times what does of the others; `noise` is that of
    each joint, relative to its motion, or nothing."""
    found, known = {}, {joint: level for joint, level in noise.items() if level}
    for joint, own in known.items():
        others = [level for other, level in known.items() if other != joint]
        usual = float(np.median(others)) if others else 0.0
        if own > LEAST and own > TIMES * usual > 0.0:
            found[joint] = own / usual
    return found


def remarks_on(noise: Mapping[str, float]) -> list[str]:
    """A line for each of them."""
    return [
        f"{joint} does not repeat itself from period to period: {100 * noise[joint]:.2g} % of its motion differs, {times:.2g} times as much as of "
        "the other joints. It counts as noise: what makes it (a brake that drags by turns, play that rattles, a clock that jitters) is not seen"
        for joint, times in unrepeated(noise).items()
    ]
