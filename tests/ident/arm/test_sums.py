"""Sums over records: the same by one process and by two, and those of the records one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from diagnosed import diagnosis

from ident.arm.arm_fit import chi_squared, hold, whitened
from ident.arm.sums import summed


def test_sums_are_those_of_the_records_whoever_found_them() -> None:
    end = diagnosis().end
    problem, vector = replace(end.problem, workers=2), end.minimum.vector
    held = hold(problem, vector)
    step = np.where(problem.free, 1e-3, 0.0)
    found = []
    for workers in (1, 2):
        with summed(replace(problem, workers=workers)) as sums:
            sums.hold(vector)
            found.append((sums.chi_squared(vector), *sums.equations(vector), sums.curved(vector, step, 0.1)))
    for one, two in zip(*found, strict=True):
        np.testing.assert_array_equal(one, two)
    chi2, from_equations, _, information, _ = found[0]
    np.testing.assert_allclose([chi2, from_equations], chi_squared(problem, vector, held), rtol=1e-12)
    expected = np.zeros_like(information)
    for one, kept in zip(problem.data, held, strict=True):
        _, A, columns = whitened(problem, vector, one, kept)
        expected[np.ix_(columns, columns)] += 2.0 * (A.conj().T @ A).real
    np.testing.assert_allclose(information, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


def test_what_is_beyond_numbers_is_infinitely_wrong_and_bends_nowhere() -> None:
    end = diagnosis().end
    problem, vector = end.problem, end.minimum.vector
    far = np.zeros_like(vector)
    far[0] = 1e4  # a stiffness is told by its logarithm
    with summed(problem) as sums:
        sums.hold(vector)
        assert sums.chi_squared(vector + far) == np.inf
        assert not np.isfinite(sums.curved(vector, far / problem.scale, 0.1)).all()


def test_a_curvature_is_of_second_order_in_the_step_and_the_same_however_far_it_looks() -> None:
    end = diagnosis().end
    problem, vector = end.problem, end.minimum.vector
    with summed(problem) as sums:
        sums.hold(vector)
        step = np.where(problem.free, 1e-3, 0.0)
        finer, coarser = sums.curved(vector, step, 0.05), sums.curved(vector, step, 0.1)
        twice = sums.curved(vector, 2.0 * step, 0.05)
    size = np.abs(finer).max()
    assert size > 0.0
    np.testing.assert_allclose(finer, coarser, atol=0.05 * size)
    np.testing.assert_allclose(twice, 4.0 * finer, atol=0.05 * np.abs(twice).max())  # of second order in the step
