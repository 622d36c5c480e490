"""Regularised solvers against dense formulas, brute force over hat matrices, and problems that need them."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.errors import EstimationError, NonFiniteError, ShapeError, UsageError
from eivor.lab.regularised import (
    DECADES,
    POINTS,
    RegularisedLeastSquares,
    RegularisedTotalLeastSquares,
    Tikhonov,
)
from eivor.linalg import LeastSquares, LinearSystem, TotalLeastSquares
from eivor.linalg.system import triangular_root

GRID = np.append(0.0, np.logspace(*DECADES, (DECADES[1] - DECADES[0]) * POINTS + 1))
TOWARDS = np.array([0.5, -1.0, 2.0])


def noisy(seed, rows=40, noise=0.1):
    """Matrix and right-hand side, both measured with errors, in units that are far apart."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((rows, 3))
    b = A @ rng.standard_normal(3)
    units = np.array([1.0, 30.0, 0.01])
    return (A + noise * rng.standard_normal(A.shape)) * units, b + noise * rng.standard_normal(rows)


def ill_posed(seed):
    """Sixty rows like a Hilbert matrix, and a right-hand side with errors of a thousandth."""
    rng = np.random.default_rng(seed)
    A = 1.0 / (1.0 + np.arange(60.0)[:, None] / 6.0 + np.arange(8.0))
    truth = np.ones(8)
    return A, A @ truth + 1e-3 * rng.standard_normal(60), truth


def pulled_least_squares(A, b, strength, towards):
    """(A'A + a D^2) theta = A'b + a D^2 towards by the normal equations."""
    D2 = np.diag(np.sum(A**2, axis=0))
    return np.linalg.solve(A.T @ A + strength * D2, A.T @ b + strength * D2 @ towards)


@pytest.mark.parametrize("strength", [0.0, 1e-3, 0.3, 20.0])
def test_tikhonov_is_the_penalised_normal_equations(strength):
    A, b = noisy(1)
    solver = RegularisedLeastSquares(Tikhonov(strength, TOWARDS))
    solve = solver.solve(LinearSystem(A, b))
    np.testing.assert_allclose(solve.theta, pulled_least_squares(A, b, strength, TOWARDS), rtol=1e-10)
    least = LeastSquares().solve(LinearSystem(A, b)).theta
    np.testing.assert_allclose(solve.shrinkage.shift, solve.theta - least, atol=1e-10)
    unit = A / np.linalg.norm(A, axis=0)
    hat = unit @ np.linalg.solve(unit.T @ unit + strength * np.eye(3), unit.T)
    assert solve.shrinkage.kept == pytest.approx(np.trace(hat), rel=1e-10)


@pytest.mark.parametrize("strength", [0.0, 1e-3, 0.3])
def test_total_form_is_the_shifted_normal_equations(strength):
    """(X'X - sigma^2 I + a I) theta = X'b + a towards."""
    A, b = noisy(4)
    A = A / [1.0, 30.0, 0.01]
    G, right = A.T @ A, A.T @ b
    shift = np.linalg.svd(np.column_stack([A, b]), compute_uv=False)[-1] ** 2
    a = strength * np.trace(G) / 3
    wanted = np.linalg.solve(G + (a - shift) * np.eye(3), right + a * TOWARDS)
    solve = RegularisedTotalLeastSquares(Tikhonov(strength, TOWARDS)).solve(LinearSystem(A, b))
    np.testing.assert_allclose(solve.theta, wanted, rtol=1e-10)
    total = TotalLeastSquares().solve(LinearSystem(A, b)).theta
    np.testing.assert_allclose(solve.shrinkage.shift, solve.theta - total, atol=1e-10)


def test_columns_without_error_are_not_pulled():
    A, b = noisy(6)
    S = np.diag([0.3, 0.0, 0.0, 0.5])
    solve = RegularisedTotalLeastSquares(Tikhonov(1e8, TOWARDS)).solve(LinearSystem(A, b, S))
    assert solve.theta[0] == pytest.approx(TOWARDS[0], rel=1e-4)
    left = LeastSquares().solve(LinearSystem(A[:, 1:], b - TOWARDS[0] * A[:, 0])).theta
    np.testing.assert_allclose(solve.theta[1:], left, rtol=1e-4)
    exact = RegularisedTotalLeastSquares().solve(LinearSystem(A, b, np.diag([0.0, 0.0, 0.0, 1.0])))
    np.testing.assert_allclose(exact.theta, LeastSquares().solve(LinearSystem(A, b)).theta, rtol=1e-9)


def test_cross_validation_counts_the_rows_that_a_root_stands_for():
    """Brute force over m x m hat matrices; a root that does not know its count would choose another."""
    A, b, _ = ill_posed(0)
    unit = A / np.linalg.norm(A, axis=0)
    scores = []
    for a in GRID:
        hat = unit @ np.linalg.solve(unit.T @ unit + (a + 1e-300) * np.eye(8), unit.T) if a > 1e-12 else None
        scores.append(np.inf if hat is None else np.sum((b - hat @ b) ** 2) / (60.0 - np.trace(hat)) ** 2)
    wanted = GRID[int(np.argmin(scores))]
    assert 1e-11 < wanted < 1e-3
    whole = RegularisedLeastSquares().solve(LinearSystem(A, b))
    assert whole.shrinkage.parameter == pytest.approx(wanted, rel=1e-12)
    root = triangular_root(np.column_stack([A, b]))
    counted = RegularisedLeastSquares().solve(LinearSystem(root[:, :-1], root[:, -1], count=60.0))
    np.testing.assert_allclose(counted.theta, whole.theta, rtol=1e-6)
    blind = RegularisedLeastSquares().solve(LinearSystem(root[:, :-1], root[:, -1]))
    assert blind.shrinkage.parameter != whole.shrinkage.parameter


def test_an_ill_posed_problem_is_regularised():
    """Errors of a thousandth make least squares useless; cross-validation brings it near the truth."""
    A, b, truth = ill_posed(1)
    system = LinearSystem(A, b)
    assert np.linalg.norm(LeastSquares().solve(system).theta - truth) > 1e4
    assert np.linalg.norm(RegularisedLeastSquares().solve(system).theta - truth) < 0.1


def test_cross_validation_needs_an_equation_left_over():
    A, b = noisy(7, rows=3)
    with pytest.raises(EstimationError, match=r"more equations than the 3 unknowns .*; received 3"):
        RegularisedLeastSquares().solve(LinearSystem(A, b))
    RegularisedLeastSquares(Tikhonov(0.1)).solve(LinearSystem(A, b))


@pytest.mark.usefixtures("unchecked_shapes")
def test_what_cannot_be_used_is_refused():
    A, b = noisy(8)
    with pytest.raises(ShapeError, match="3 numbers to be shrunk towards"):
        RegularisedLeastSquares(Tikhonov(towards=np.ones(2))).solve(LinearSystem(A, b))
    with pytest.raises(NonFiniteError, match="a vector of finite numbers"):
        Tikhonov(towards=np.array([1.0, np.nan]))
    with pytest.raises(UsageError, match="a parameter of zero or more; received -1"):
        Tikhonov(-1.0)
