"""Certified and published solutions: NIST, York, Pearson."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import mpmath
import numpy as np
import pytest

from eivor.linalg import (
    AugmentedLeastSquares,
    AugmentedTotalLeastSquares,
    LeastSquares,
    LinearSystem,
    TotalLeastSquares,
)
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


@pytest.mark.parametrize("solver", [AugmentedLeastSquares(), LeastSquares()])
def test_what_is_lost_of_filip_is_the_rounding_of_its_powers(solver):
    """A step of refinement on all rows, its residual in extended precision, and what no step can pass."""
    system = filip()
    A, b = system.matrix, system.right
    theta = solver.solve(system).theta
    residual = (b - A.astype(np.longdouble) @ theta.astype(np.longdouble)).astype(float)
    refined = theta + solver.solve(LinearSystem(A, residual)).theta
    with mpmath.workdps(60):
        powers, right = mpmath.matrix(A.tolist()), mpmath.matrix(b.tolist())
        exact = mpmath.lu_solve(powers.T * powers, powers.T * right)
        limit = np.array([float(value) for value in exact])
    digits = [certified_digits(values, truth.FILIP) for values in (theta, refined, limit)]
    assert digits[1] - digits[0] < 0.1
    assert digits[2] == pytest.approx(digits[1], abs=0.1)


def test_filip_is_lost_by_the_normal_equations():
    system = filip()
    A, b = system.matrix, system.right
    theta = np.linalg.solve(A.T @ A, A.T @ b)
    assert certified_digits(theta, truth.FILIP) < 1.0


@pytest.mark.parametrize("solver", [AugmentedLeastSquares(), LeastSquares()])
def test_norris_to_certified_digits(solver):
    data = resources.files("scipy.stats.tests.data.nist_linregress").joinpath("Norris.dat").read_text()
    rows = [line.split() for line in data.splitlines()[60:] if line.strip()]
    y, x = np.array(rows, dtype=float).T
    theta = solver.solve(LinearSystem(np.column_stack([np.ones_like(x), x]), y)).theta
    assert certified_digits(theta, truth.NORRIS) >= 12.0


def pearson_system(error_covariance=None):
    A = np.column_stack([np.ones_like(truth.PEARSON_X), truth.PEARSON_X])
    return LinearSystem(A, truth.PEARSON_Y, error_covariance)


@pytest.mark.parametrize("solver", [AugmentedTotalLeastSquares(), TotalLeastSquares()])
def test_pearsons_line_by_mixed_total_least_squares(solver):
    """Orthogonal regression: equal errors in x and y, none in the constant."""
    x, y = truth.PEARSON_X, truth.PEARSON_Y
    theta = solver.solve(pearson_system(np.diag([0.0, 1.0, 1.0]))).theta
    centred = np.column_stack([x - x.mean(), y - y.mean()])
    normal = np.linalg.svd(centred)[2][-1]
    slope = -normal[0] / normal[1]
    np.testing.assert_allclose(theta, [y.mean() - slope * x.mean(), slope], rtol=1e-12)


def york_covariances():
    S = np.zeros((truth.PEARSON_X.size, 3, 3))
    S[:, 1, 1] = 1.0 / truth.YORK_WEIGHTS_X
    S[:, 2, 2] = 1.0 / truth.YORK_WEIGHTS_Y
    return S


def test_yorks_line_to_its_printed_digits():
    theta = weighted_total_least_squares(pearson_system(), york_covariances()).theta
    assert f"{theta[0]:.5f}" == f"{truth.YORK_LINE[0]:.5f}"
    assert f"{theta[1]:.6f}" == f"{truth.YORK_LINE[1]:.6f}"


def test_yorks_line_against_odrpack():
    odrpack = pytest.importorskip("odrpack")
    fit = odrpack.odr_fit(
        lambda x, beta: beta[0] + beta[1] * x,
        truth.PEARSON_X,
        truth.PEARSON_Y,
        np.array([5.0, -0.5]),
        weight_x=truth.YORK_WEIGHTS_X.astype(float),
        weight_y=truth.YORK_WEIGHTS_Y.astype(float),
        sstol=1e-16,
        partol=1e-16,
    )
    theta = weighted_total_least_squares(pearson_system(), york_covariances()).theta
    np.testing.assert_allclose(theta, fit.beta, rtol=1e-6)


def test_equal_weights_are_mixed_total_least_squares():
    """The iterative solver with the same covariance in every row."""
    S = np.zeros((truth.PEARSON_X.size, 3, 3))
    S[:, 1, 1] = S[:, 2, 2] = 1.0
    theta = weighted_total_least_squares(pearson_system(), S).theta
    mixed = TotalLeastSquares().solve(pearson_system(np.diag([0.0, 1.0, 1.0]))).theta
    np.testing.assert_allclose(theta, mixed, rtol=1e-9)
