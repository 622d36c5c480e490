"""Certified and published solutions: NIST, York, Pearson."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from eivor.linalg import AugmentedLeastSquares, LeastSquares, LinearSystem
from eivor.linalg.total_least_squares import weighted_total_least_squares
from reference import constants as truth


def certified_digits(theta, certified):
    """Correct significant digits of the worst coefficient."""
    return float(np.min(-np.log10(np.abs(theta / certified - 1.0))))


def filip():
    x, y = np.loadtxt(
        Path(truth.__file__).with_name("nist_filip.csv"), delimiter=",", skiprows=1, unpack=True
    )
    return LinearSystem(np.vander(x, 11, increasing=True), y)


@pytest.mark.parametrize(("solver", "digits"), [(AugmentedLeastSquares(), 6.0), (LeastSquares(), 7.0)])
def test_filip_to_certified_digits(solver, digits):
    assert certified_digits(solver.solve(filip()).theta, truth.FILIP) >= digits


def test_filip_is_lost_by_the_normal_equations():
    system = filip()
    A, b = system.matrix, system.right
    theta = np.linalg.solve(A.T @ A, A.T @ b)
    assert certified_digits(theta, truth.FILIP) < 1.0


def pearson_system(error_covariance=None):
    A = np.column_stack([np.ones_like(truth.PEARSON_X), truth.PEARSON_X])
    return LinearSystem(A, truth.PEARSON_Y, error_covariance)


def york_covariances():
    S = np.zeros((truth.PEARSON_X.size, 3, 3))
    S[:, 1, 1] = 1.0 / truth.YORK_WEIGHTS_X
    S[:, 2, 2] = 1.0 / truth.YORK_WEIGHTS_Y
    return S


def test_yorks_line_to_its_printed_digits():
    theta = weighted_total_least_squares(pearson_system(), york_covariances()).theta
    assert f"{theta[0]:.5f}" == f"{truth.YORK_LINE[0]:.5f}"
    assert f"{theta[1]:.6f}" == f"{truth.YORK_LINE[1]:.6f}"
