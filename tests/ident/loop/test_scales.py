"""A verdict on records of a wrong unit says so: all that it finds off goes with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from diagnosed import diagnosis

from ident.loop.scales import doubtful


def test_torques_in_another_unit_are_told() -> None:
    d = diagnosis()
    assert doubtful(d) == []
    n, D, vector = d.campaign.n, len(d.model.alpha_cad), d.end.minimum.vector.copy()
    vector[: 2 * n] += np.log(1.356)  # K and J_m by their logarithms
    vector[4 * n : 4 * n + D] *= 1.356
    (line,) = doubtful(replace(d, end=replace(d.end, minimum=replace(d.end.minimum, vector=vector))))
    assert line.startswith("K and J_m are 1.35") and "torques are told" in line
