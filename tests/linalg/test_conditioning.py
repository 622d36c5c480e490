"""Forward errors against 50-digit arithmetic: what the augmented systems are for."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from eivor.linalg import AugmentedLeastSquares, AugmentedTotalLeastSquares, LinearSystem
from eivor.linalg.total_least_squares import solve_augmented

ROWS, UNKNOWNS, PROBLEMS = 20, 3, 100
RELATIVE_RESIDUAL = 1e-6
mpmath.mp.dps = 50


def ill_conditioned(condition, rng):
    """A problem whose condition survives the scaling of columns to unit length."""
    U = np.linalg.qr(rng.standard_normal((ROWS, UNKNOWNS)))[0]
    V = np.linalg.qr(rng.standard_normal((UNKNOWNS, UNKNOWNS)))[0]
    A = (U * np.geomspace(1.0, 1.0 / condition, UNKNOWNS)) @ V.T
    A = A / np.linalg.norm(A, axis=0)
    b = A @ rng.standard_normal(UNKNOWNS)
    noise = rng.standard_normal(ROWS)
    noise -= U @ (U.T @ noise)
    return A, b + RELATIVE_RESIDUAL * np.linalg.norm(b) * noise / np.linalg.norm(noise)


def exact_least_squares(A, b):
    M, r = mpmath.matrix(A.tolist()), mpmath.matrix(b.tolist())
    return np.array([float(x) for x in mpmath.lu_solve(M.T * M, M.T * r)])


def exact_total_least_squares(A, b):
    """From the smallest eigenvector of [A b]'[A b], by inverse iteration in 50 digits."""
    M = mpmath.matrix(np.column_stack([A, b]).tolist())
    inverse = mpmath.inverse(M.T * M)  # of a condition that leaves half of the digits
    vector = mpmath.matrix([mpmath.mpf(1)] * (UNKNOWNS + 1))
    for _ in range(40):
        vector = inverse * vector
        vector = vector / mpmath.norm(vector)
    return np.array([float(-vector[i] / vector[UNKNOWNS]) for i in range(UNKNOWNS)])


def error(theta, exact):
    return float(np.linalg.norm(theta - exact) / np.linalg.norm(exact))


def full_augmented(A, b, *, total):
    """The paper's (N + n)-square system, as printed."""
    if total:
        s = np.linalg.svd(np.column_stack([A, b]), compute_uv=False)[-1]
        return solve_augmented(A, b, s, s)
    s = np.linalg.svd(A, compute_uv=False)[-1] / np.sqrt(2.0)
    return solve_augmented(A, b, s, 0.0)


def normal_equations(A, b, *, total):
    s = np.linalg.svd(np.column_stack([A, b]), compute_uv=False)[-1] if total else 0.0
    return np.linalg.solve(A.T @ A - s**2 * np.eye(UNKNOWNS), A.T @ b)


@pytest.mark.thorough
@pytest.mark.parametrize("total", [False, True], ids=["least squares", "total least squares"])
@pytest.mark.parametrize("condition", [1e2, 1e4, 1e6, 1e8])
def test_reduced_augmented_solver_is_as_good_as_the_full_system(condition, total):
    rng = np.random.default_rng(int(np.log10(condition)) + 10 * total)
    exact_solution = exact_total_least_squares if total else exact_least_squares
    solver = AugmentedTotalLeastSquares() if total else AugmentedLeastSquares()
    reduced, full, normal = [], [], []
    conditions = []
    for _ in range(PROBLEMS):
        A, b = ill_conditioned(condition, rng)
        exact = exact_solution(A, b)
        solution = solver.solve(LinearSystem(A, b))
        conditions.append(solution.condition)
        reduced.append(error(solution.theta, exact))
        full.append(error(full_augmented(A, b, total=total), exact))
        if condition <= 1e6:
            normal.append(error(normal_equations(A, b, total=total), exact))
    bound = max(float(np.median(full)), np.finfo(float).eps * float(np.median(conditions)))
    assert float(np.median(reduced)) <= 10.0 * bound
    if condition == 1e6:
        assert float(np.median(normal)) >= 1e4 * float(np.median(reduced))
