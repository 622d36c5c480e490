"""Least squares and total least squares against textbook formulas, NumPy and SciPy."""

from __future__ import annotations

from pathlib import Path

import mpmath
import numpy as np
import pytest
import scipy
import scipy.linalg
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

import eivor as ev
import refusal_rows as refusals
from eivor.errors import (
    CollinearError,
    CovarianceError,
    EstimationError,
    NonFiniteError,
    NoUniqueSolutionError,
    ShapeError,
    TooFewSamplesError,
    UsageError,
)
from eivor.lab.regularised import (
    DECADES,
    POINTS,
    RegularisedLeastSquares,
    RegularisedTotalLeastSquares,
    Tikhonov,
)
from eivor.linalg.system import LinearSystem, triangular_root
from eivor.linalg.total_least_squares import (
    AugmentedLeastSquares,
    AugmentedTotalLeastSquares,
    LeastSquares,
    TotalLeastSquares,
    weighted_total_least_squares,
)
from reference import constants as truth

LEAST = (LeastSquares(), AugmentedLeastSquares())
TOTAL = (TotalLeastSquares(), AugmentedTotalLeastSquares())


def noisy(seed, rows=40, unknowns=3, noise=0.1):
    """Matrix and right-hand side, both measured with errors."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((rows, unknowns))
    b = A @ rng.standard_normal(unknowns)
    return A + noise * rng.standard_normal(A.shape), b + noise * rng.standard_normal(rows)


def covariance(seed, size):
    root = np.random.default_rng(seed + 1000).standard_normal((size, size + 3))
    return root @ root.T / size


@pytest.mark.parametrize("solver", LEAST)
@settings(max_examples=30)
@given(seed=st.integers(0, 999), rows=st.integers(3, 30), scale=st.floats(1e-8, 1e8))
def test_least_squares_is_numpys(solver, seed, rows, scale):
    A, b = noisy(seed, rows)
    units = np.array([1.0, scale, 1.0])
    A = A * units
    solve = solver.solve(LinearSystem(A, b))
    wanted = np.linalg.lstsq(A / units, b)[0] / units
    size = np.abs(wanted * units).max() + 1e-3
    np.testing.assert_allclose(solve.theta * units, wanted * units, atol=1e-8 * size)
    np.testing.assert_allclose(solve.residual, b - A @ solve.theta, atol=1e-12)
    assert solve.objective == pytest.approx(float(solve.residual @ solve.residual))


@pytest.mark.parametrize(("solver", "total"), [(LEAST[1], False), (TOTAL[1], True)])
def test_augmented_total_solution_is_that_of_the_full_system(solver, total):
    """The paper's (10) and (16) with all their m + n rows, of which the product solves a reduction to 2 n."""
    A, b = noisy(2)
    A = A if total else A / np.linalg.norm(A, axis=0)
    wanted = full_augmented(A, b, total=total)
    np.testing.assert_allclose(solver.solve(LinearSystem(A, b)).theta, wanted, rtol=1e-10)


@pytest.mark.parametrize("solver", LEAST)
def test_high_condition_numbers_are_not_squared(solver):
    """At condition 1e8 the normal equations keep no digit of what these keep seven of."""
    rng = np.random.default_rng(3)
    U, _ = np.linalg.qr(rng.standard_normal((50, 4)))
    V, _ = np.linalg.qr(rng.standard_normal((4, 4)))
    A = U * np.geomspace(1.0, 1e-8, 4) @ V
    theta = np.ones(4)
    solve = solver.solve(LinearSystem(A, A @ theta))
    np.testing.assert_allclose(solve.theta, theta, atol=1e-6)
    assert solve.condition > 1e7


@pytest.mark.parametrize("solver", TOTAL)
@settings(max_examples=30)
@given(seed=st.integers(0, 999))
def test_total_least_squares_is_the_textbooks_formula(solver, seed):
    """(A'A - sigma^2 I)^-1 A'b, and the smallest right singular vector of [A b]."""
    A, b = noisy(seed)
    solve = solver.solve(LinearSystem(A, b))
    _, singular, Vt = np.linalg.svd(np.column_stack([A, b]))
    np.testing.assert_allclose(solve.theta, -Vt[-1, :3] / Vt[-1, 3], rtol=1e-7)
    wanted = np.linalg.solve(A.T @ A - singular[-1] ** 2 * np.eye(3), A.T @ b)
    np.testing.assert_allclose(solve.theta, wanted, rtol=1e-7)
    assert solve.objective == pytest.approx(singular[-1] ** 2)


@pytest.mark.parametrize("solver", TOTAL)
@settings(max_examples=30)
@given(seed=st.integers(0, 999))
def test_any_covariance_is_the_generalized_eigenproblem(solver, seed):
    """[A b]'[A b] v = lambda S v, smallest lambda, v scaled to end in -1."""
    A, b = noisy(seed)
    S = covariance(seed, 4)
    rows = np.column_stack([A, b])
    values, vectors = scipy.linalg.eigh(rows.T @ rows, S)
    solve = solver.solve(LinearSystem(A, b, S))
    np.testing.assert_allclose(solve.theta, -vectors[:-1, 0] / vectors[-1, 0], rtol=1e-6)
    assert solve.objective == pytest.approx(values[0], rel=1e-8)
    # Only the proportions of the covariance count, and its units go along with the columns'.
    units = np.array([1e-5, 1.0, 3e4])
    scaled = solver.solve(LinearSystem(A * units, b, 7.0 * S * np.outer([*units, 1.0], [*units, 1.0])))
    np.testing.assert_allclose(scaled.theta * units, solve.theta, rtol=1e-6)
    assert 7.0 * scaled.objective == pytest.approx(solve.objective, rel=1e-7)


@pytest.mark.parametrize("solver", TOTAL)
@pytest.mark.parametrize("exact", [[0], [2], [0, 1], [1, 2]])
def test_exact_columns_are_eliminated_first(solver, exact):
    """Project the exact columns out of the others, solve those, then the exact ones: by hand."""
    A, b = noisy(4)
    A[:, exact[0]] = 1.0
    variances = np.array([0.5, 1.0, 2.0, 0.7])
    variances[exact] = 0.0
    rest = [j for j in range(3) if j not in exact]
    Q, _ = np.linalg.qr(A[:, exact])
    projected = np.column_stack([A[:, rest], b])
    projected -= Q @ (Q.T @ projected)
    weights = 1.0 / np.sqrt(variances[[*rest, 3]])
    v = np.linalg.svd(projected * weights)[2][-1] * weights
    noisy_part = -v[:-1] / v[-1]
    exact_part = np.linalg.lstsq(A[:, exact], b - A[:, rest] @ noisy_part)[0]
    theta = solver.solve(LinearSystem(A, b, np.diag(variances))).theta
    np.testing.assert_allclose(theta[rest], noisy_part, rtol=1e-8)
    np.testing.assert_allclose(theta[exact], exact_part, rtol=1e-8)


@pytest.mark.parametrize("solver", TOTAL)
def test_score_correction_makes_the_derivative_of_the_objective(solver):
    """Half the objective's gradient is -sum e_t x_t / weight, and its curvature is the sensitivity."""
    A, b = noisy(6)
    S = covariance(6, 4)
    solution = solver.solve(LinearSystem(A, b, S))

    def gradient(theta):
        residual = b - A @ theta
        correction = solver.score_correction(residual, theta, S)
        direction = np.append(theta, -1.0)
        return -(A + correction.rows).T @ residual / (direction @ S @ direction)

    def objective(theta):
        direction = np.append(theta, -1.0)
        return 0.5 * float(np.sum((A @ theta - b) ** 2) / (direction @ S @ direction))

    away = solution.theta + 0.1
    np.testing.assert_allclose(gradient(solution.theta), 0.0, atol=1e-10)
    np.testing.assert_allclose(gradient(away), scipy.optimize.approx_fprime(away, objective, 1e-7), rtol=1e-4)
    ends = ((gradient(solution.theta + s), gradient(solution.theta - s)) for s in 1e-5 * np.eye(3))
    curvature = np.array([(after - before) / 2e-5 for after, before in ends])
    correction = solver.score_correction(solution.residual, solution.theta, S)
    direction = np.append(solution.theta, -1.0)
    sensitivity = (A.T @ A + correction.sensitivity) / (direction @ S @ direction)
    np.testing.assert_allclose(curvature, sensitivity, rtol=1e-5, atol=1e-6)


def test_roots_in_blocks_are_the_root(monkeypatch):
    rows = np.random.default_rng(0).standard_normal((500, 3))
    whole = triangular_root(rows)
    monkeypatch.setattr("eivor.linalg.system.COPIED_ROWS", 37)
    np.testing.assert_allclose(np.abs(triangular_root(rows)), np.abs(whole), rtol=1e-11)


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
    m, n = A.shape
    columns, root = (np.column_stack([A, b]), 1.0) if total else (A, np.sqrt(2.0))
    s = np.linalg.svd(columns, compute_uv=False)[-1] / root
    full = np.block([[s * np.eye(m), A], [A.T, total * s * np.eye(n)]])
    return np.linalg.solve(full, np.append(b, np.zeros(n)))[m:]


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
            s = np.linalg.svd(np.column_stack([A, b]), compute_uv=False)[-1] if total else 0.0
            theta = np.linalg.solve(A.T @ A - s**2 * np.eye(UNKNOWNS), A.T @ b)
            normal.append(error(theta, exact))
    bound = max(float(np.median(full)), np.finfo(float).eps * float(np.median(conditions)))
    assert float(np.median(reduced)) <= 10.0 * bound
    if condition == 1e6:
        assert float(np.median(normal)) >= 1e4 * float(np.median(reduced))


# Regularised solvers against dense formulas, brute force over hat matrices, and problems that need them.

GRID = np.append(0.0, np.logspace(*DECADES, (DECADES[1] - DECADES[0]) * POINTS + 1))
TOWARDS = np.array([0.5, -1.0, 2.0])


def noisy_in_units(seed, rows=40):
    """Matrix and right-hand side, both measured with errors, in units that are far apart."""
    A, b = noisy(seed, rows)
    return A * [1.0, 30.0, 0.01], b


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
    A, b = noisy_in_units(1)
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
    A, b = noisy_in_units(4)
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
    A, b = noisy_in_units(6)
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


def test_rows_are_the_equations_of_a_direct_method():
    """The root of three rows stands for all: as many as the whole matrix has."""
    A, b = noisy(1, rows=400, noise=1.0)
    whole = RegularisedLeastSquares().solve(LinearSystem(A, b))
    rows = ev.regression(response=b, regressors=A)
    result = ev.identify(rows, ev.methods.regularised(ev.methods.least_squares()))
    assert result.solution.shrinkage.parameter == pytest.approx(whole.shrinkage.parameter, rel=1e-9)
    np.testing.assert_allclose(result.theta, whole.theta, rtol=1e-9)
    uncounted = RegularisedLeastSquares().solve(LinearSystem(result.system.matrix, result.system.right))
    assert uncounted.shrinkage.parameter != pytest.approx(whole.shrinkage.parameter, rel=1e-3)


# Certified and published solutions: NIST, York, Pearson.


def certified_digits(theta, certified):
    """Correct significant digits of the worst coefficient."""
    return float(np.min(-np.log10(np.abs(theta / certified - 1.0))))


def filip():
    path = Path(truth.__file__).with_name("nist_filip.csv")
    x, y = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
    return LinearSystem(np.vander(x, 11, increasing=True), y)


@pytest.mark.parametrize(("solver", "digits"), [(AugmentedLeastSquares(), 6.0), (LeastSquares(), 7.0)])
def test_filip_to_certified_digits(solver, digits):
    assert certified_digits(solver.solve(filip()).theta, truth.FILIP) >= digits
    A, b = filip().matrix, filip().right
    assert certified_digits(np.linalg.solve(A.T @ A, A.T @ b), truth.FILIP) < 1.0


def test_yorks_line_to_its_printed_digits():
    A = np.column_stack([np.ones_like(truth.PEARSON_X), truth.PEARSON_X])
    S = np.zeros((truth.PEARSON_X.size, 3, 3))
    S[:, 1, 1] = 1.0 / truth.YORK_WEIGHTS_X
    S[:, 2, 2] = 1.0 / truth.YORK_WEIGHTS_Y
    theta = weighted_total_least_squares(LinearSystem(A, truth.PEARSON_Y), S).theta
    assert f"{theta[0]:.5f}" == f"{truth.YORK_LINE[0]:.5f}"
    assert f"{theta[1]:.6f}" == f"{truth.YORK_LINE[1]:.6f}"


def solved(solver, A, b, *covariance):
    solver.solve(LinearSystem(A, b, *covariance))


def collinear(solver, scale):
    A, b = noisy(7)
    A[:, 2] = scale * (A[:, 0] - 2.0 * A[:, 1])
    return solver, A, b, "Expected linearly independent regressors; received columns"


def by_rows(row=None):
    """Covariances of three columns, or of all but one row."""
    covariances = np.tile(np.eye(3 if row is None else 4), (40, 1, 1))
    covariances[row or 0] *= row is None
    weighted_total_least_squares(LinearSystem(*noisy(11)), covariances)


ZERO = noisy(7)[0] * [1.0, 1.0, 0.0]
ORTHOGONAL = np.linalg.qr(np.random.default_rng(9).standard_normal((10, 3)))[0]
COLLINEAR = refusals.rows("collinear", CollinearError, solved,
    *(collinear(solver, scale) for solver in (*LEAST, *TOTAL) for scale in (1e-9, 1.0, 1e9)),
    *((solver, ZERO, noisy(7)[1], "received column 2 is zero") for solver in (*LEAST, *TOTAL)),
)  # fmt: skip
INFINITE = r"Expected sigma_min\(\[A b\]\) below sigma_min\(A\)"
# A response that no regressor explains, larger than every regressor: the minimum is at infinity.
NOT_UNIQUE = refusals.rows("not unique", NoUniqueSolutionError, solved,
    *((solver, ORTHOGONAL[:, :2], 5.0 * ORTHOGONAL[:, 2], INFINITE) for solver in TOTAL),
)  # fmt: skip
FEW = refusals.rows("few equations", TooFewSamplesError, solved,
    *((solver, *noisy(8, rows=3), "4 equations for total least squares with 3 unknowns") for solver in TOTAL),
)  # fmt: skip
COVARIANCES = refusals.rows("covariance", None, solved, *(
    (solver, *noisy(10, unknowns=2), S, error, f"Expected .*{text}")
    for solver in TOTAL
    for S, error, text in (
        (np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), CovarianceError, "positive definite"),
        (np.ones((3, 3)), CovarianceError, "positive definite"),
        (np.diag([1.0, -1.0, 1.0]), CovarianceError, "variances of zero or more"),
        (np.diag([1.0, np.nan, 1.0]), CovarianceError, "variances of zero or more"),
        (np.diag([1.0, 1.0, 0.0]), NoUniqueSolutionError, "a response with noise"),
    )
))  # fmt: skip
SYSTEMS = refusals.rows("system", None, lambda given: LinearSystem(*(np.asarray(part) for part in given)),
    (([[1.0, 2.0], [3.0, 4.0]], [1.0, 2.0, 3.0]), ShapeError, "Expected .*2 right-hand sides"),
    (([[1.0, 2.0], [3.0, 4.0]], [1.0, 2.0], np.eye(2)), ShapeError,
        "Expected .*error covariance of 3 columns"),
    (([[1.0, 2.0]], [1.0]), TooFewSamplesError, "Expected .*at least 2 equations"),
    (([[1.0], [np.nan]], [1.0, 2.0]), NonFiniteError, "Expected .*finite equations"),
    (([[1.0], [2.0]], [1.0, np.inf]), NonFiniteError, "Expected .*finite equations"),
)  # fmt: skip
SHRUNK = RegularisedLeastSquares(Tikhonov(towards=np.ones(2)))
CALLS = refusals.calls("call", None,
    (by_rows, ShapeError, r"covariances of shape \(40, 4, 4\)"),
    (lambda: by_rows(7), CovarianceError, "variance of every row's residual; received 0 in row 7"),
    (lambda: solved(RegularisedLeastSquares(), *noisy_in_units(7, rows=3)), EstimationError,
        r"more equations than the 3 unknowns .*; received 3"),
    (lambda: solved(SHRUNK, *noisy_in_units(8)), ShapeError, "3 numbers to be shrunk towards"),
    (lambda: Tikhonov(towards=np.array([1.0, np.nan])), NonFiniteError, "a vector of finite numbers"),
    (lambda: Tikhonov(-1.0), UsageError, "a parameter of zero or more; received -1"),
)  # fmt: skip


test_refused = refusals.table(COLLINEAR, NOT_UNIQUE, FEW, COVARIANCES, SYSTEMS, CALLS)


def test_a_given_parameter_needs_no_equation_left_over():
    solved(RegularisedLeastSquares(Tikhonov(0.1)), *noisy_in_units(7, rows=3))
