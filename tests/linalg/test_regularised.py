"""Regularised solvers against dense formulas, brute force over hat matrices, and problems that need them."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.errors import EstimationError, NonFiniteError, ShapeError, UsageError
from eivor.linalg import (
    DiscrepancyPrinciple,
    GeneralizedCrossValidation,
    GivenParameter,
    ImplicitIteration,
    LCurve,
    LeastSquares,
    LinearSystem,
    RegularisedLeastSquares,
    RegularisedTotalLeastSquares,
    Tikhonov,
    TotalLeastSquares,
)
from eivor.linalg.triangular import triangular_root

CHOICES = (GeneralizedCrossValidation(), DiscrepancyPrinciple(), LCurve())
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


# -- against dense formulas -------------------------------------------------------------------------------


def pulled_least_squares(A, b, strength, towards):
    """(A'A + a D^2) theta = A'b + a D^2 towards by the normal equations."""
    D2 = np.diag(np.sum(A**2, axis=0))
    return np.linalg.solve(A.T @ A + strength * D2, A.T @ b + strength * D2 @ towards)


@pytest.mark.parametrize("strength", [0.0, 1e-3, 0.3, 20.0])
def test_tikhonov_is_the_penalised_normal_equations(strength):
    A, b = noisy(1)
    solver = RegularisedLeastSquares(Tikhonov(), GivenParameter(strength), TOWARDS)
    found = solver.solve(LinearSystem(A, b))
    np.testing.assert_allclose(found.theta, pulled_least_squares(A, b, strength, TOWARDS), rtol=1e-10)
    least = LeastSquares().solve(LinearSystem(A, b)).theta
    np.testing.assert_allclose(found.shrinkage.shift, found.theta - least, atol=1e-10)
    unit = A / np.linalg.norm(A, axis=0)
    hat = unit @ np.linalg.solve(unit.T @ unit + strength * np.eye(3), unit.T)
    assert found.shrinkage.kept == pytest.approx(np.trace(hat), rel=1e-10)


def test_tikhonov_is_the_full_augmented_system():
    """[[s I, A], [A', -(a/s) I]] [r/s; theta] = [b; -(a/s) towards] with all its m + n rows."""
    A, b = noisy(2)
    lengths = np.linalg.norm(A, axis=0)
    unit, a, s = A / lengths, 0.2, np.sqrt(0.2)
    m, n = A.shape
    full = np.block([[s * np.eye(m), unit], [unit.T, -a / s * np.eye(n)]])
    wanted = np.linalg.solve(full, np.append(b, -a / s * TOWARDS * lengths))[m:] / lengths
    found = RegularisedLeastSquares(choice=GivenParameter(a), towards=TOWARDS).solve(LinearSystem(A, b))
    np.testing.assert_allclose(found.theta, wanted, rtol=1e-11)


@pytest.mark.parametrize("steps", [1, 2, 7, 60])
def test_implicit_iteration_repeats_tikhonov(steps):
    A, b = noisy(3)
    wanted = TOWARDS
    for _ in range(steps):
        wanted = pulled_least_squares(A, b, 0.1, wanted)
    solver = RegularisedLeastSquares(ImplicitIteration(), GivenParameter(steps), TOWARDS)
    np.testing.assert_allclose(solver.solve(LinearSystem(A, b)).theta, wanted, rtol=1e-10)


@pytest.mark.parametrize("strength", [0.0, 1e-3, 0.3])
@pytest.mark.parametrize("steps", [1, 3])
def test_total_forms_are_the_shifted_normal_equations(strength, steps):
    """(X'X - sigma^2 I + a I) theta = X'b + a towards, once or again and again."""
    A, b = noisy(4)
    A = A / [1.0, 30.0, 0.01]
    G, right = A.T @ A, A.T @ b
    shift = np.linalg.svd(np.column_stack([A, b]), compute_uv=False)[-1] ** 2
    a = strength * np.trace(G) / 3
    wanted = TOWARDS
    for _ in range(steps):
        wanted = np.linalg.solve(G + (a - shift) * np.eye(3), right + a * wanted)
    if steps == 1:
        solver = RegularisedTotalLeastSquares(Tikhonov(), GivenParameter(strength), TOWARDS)
    elif strength:
        scheme = ImplicitIteration(strength)
        solver = RegularisedTotalLeastSquares(scheme, GivenParameter(steps), TOWARDS)
    else:
        return
    found = solver.solve(LinearSystem(A, b))
    np.testing.assert_allclose(found.theta, wanted, rtol=1e-10)
    total = TotalLeastSquares().solve(LinearSystem(A, b)).theta
    np.testing.assert_allclose(found.shrinkage.shift, found.theta - total, atol=1e-10)


@pytest.mark.parametrize("choice", CHOICES)
@pytest.mark.parametrize("scheme", [Tikhonov(), ImplicitIteration()])
def test_units_do_not_matter(scheme, choice):
    """Of least squares in any case, of total least squares with the errors and the vector changed along."""
    A, b = noisy(5)
    units = np.array([1e3, 1e-5, 7.0])
    S = np.array([[0.2, 0.05, 0.0, 0.0], [0.05, 0.3, 0.0, 0.02], [0.0, 0.0, 0.0, 0.0], [0.0, 0.02, 0.0, 0.4]])
    other = np.diag(np.append(units, 1.0))
    for solver, here, there in (
        (RegularisedLeastSquares, None, None),
        (RegularisedTotalLeastSquares, S, other @ S @ other),
    ):
        one = solver(scheme, choice, TOWARDS).solve(LinearSystem(A, b, here))
        two = solver(scheme, choice, TOWARDS / units).solve(LinearSystem(A * units, b, there))
        np.testing.assert_allclose(two.theta * units, one.theta, rtol=1e-8)


def test_columns_without_error_are_not_pulled():
    A, b = noisy(6)
    S = np.diag([0.3, 0.0, 0.0, 0.5])
    found = RegularisedTotalLeastSquares(choice=GivenParameter(1e8), towards=TOWARDS).solve(
        LinearSystem(A, b, S)
    )
    assert found.theta[0] == pytest.approx(TOWARDS[0], rel=1e-4)
    left = LeastSquares().solve(LinearSystem(A[:, 1:], b - TOWARDS[0] * A[:, 0])).theta
    np.testing.assert_allclose(found.theta[1:], left, rtol=1e-4)
    exact = RegularisedTotalLeastSquares().solve(LinearSystem(A, b, np.diag([0.0, 0.0, 0.0, 1.0])))
    np.testing.assert_allclose(exact.theta, LeastSquares().solve(LinearSystem(A, b)).theta, rtol=1e-9)


# -- choices of the parameter -----------------------------------------------------------------------------


def test_cross_validation_counts_the_rows_that_a_root_stands_for():
    """Brute force over m x m hat matrices; a root that does not know its count would choose another."""
    A, b, _ = ill_posed(0)
    unit = A / np.linalg.norm(A, axis=0)
    scores = []
    for a in Tikhonov().parameters:
        hat = unit @ np.linalg.solve(unit.T @ unit + (a + 1e-300) * np.eye(8), unit.T) if a > 1e-12 else None
        scores.append(np.inf if hat is None else np.sum((b - hat @ b) ** 2) / (60.0 - np.trace(hat)) ** 2)
    wanted = Tikhonov().parameters[int(np.argmin(scores))]
    assert 1e-11 < wanted < 1e-3
    whole = RegularisedLeastSquares().solve(LinearSystem(A, b))
    assert whole.shrinkage.parameter == pytest.approx(wanted, rel=1e-12)
    root = triangular_root(np.column_stack([A, b]))
    counted = RegularisedLeastSquares().solve(LinearSystem(root[:, :-1], root[:, -1], count=60.0))
    np.testing.assert_allclose(counted.theta, whole.theta, rtol=1e-6)
    blind = RegularisedLeastSquares().solve(LinearSystem(root[:, :-1], root[:, -1]))
    assert blind.shrinkage.parameter != whole.shrinkage.parameter


@pytest.mark.parametrize("choice", CHOICES)
@pytest.mark.parametrize("scheme", [Tikhonov(), ImplicitIteration(1e-4)])
def test_an_ill_posed_problem_is_brought_to_reason(scheme, choice):
    """Errors of a thousandth make least squares useless, and every choice brings it near the truth."""
    A, b, truth = ill_posed(1)
    system = LinearSystem(A, b)
    found = RegularisedLeastSquares(scheme, choice).solve(system)
    assert np.linalg.norm(LeastSquares().solve(system).theta - truth) > 1e4
    assert np.linalg.norm(found.theta - truth) < 0.1


@pytest.mark.parametrize("choice", CHOICES)
@pytest.mark.parametrize("scheme", [Tikhonov(), ImplicitIteration(1e-4)])
def test_so_are_ones_with_errors_in_their_columns(scheme, choice):
    """In all of six: the corner of an L-curve is not seen in each."""
    plain, found = [], []
    for seed in range(6):
        A, b, truth = ill_posed(seed)
        system = LinearSystem(A + 1e-3 * np.random.default_rng([seed, 1]).standard_normal(A.shape), b)
        plain.append(TotalLeastSquares().solve(system).theta - truth)
        found.append(RegularisedTotalLeastSquares(scheme, choice).solve(system).theta - truth)
    assert np.linalg.norm(found) < 0.8 * np.linalg.norm(plain)


def test_discrepancy_stops_where_the_misfit_is_the_noise():
    A, b, _ = ill_posed(2)
    system, power = LinearSystem(A, b), 60e-6
    found = RegularisedLeastSquares(choice=DiscrepancyPrinciple(power)).solve(system)
    grid = Tikhonov().parameters
    beyond = grid[int(np.searchsorted(grid, found.shrinkage.parameter * 1.001))]
    further = RegularisedLeastSquares(choice=GivenParameter(beyond)).solve(system)
    assert found.objective <= power < further.objective
    estimated = RegularisedLeastSquares(choice=DiscrepancyPrinciple()).solve(system)
    left = LeastSquares().solve(system).objective
    assert estimated.objective <= left * 60.0 / 52.0 < 1.05 * estimated.objective


@pytest.mark.parametrize("choice", [GeneralizedCrossValidation(), DiscrepancyPrinciple()])
def test_as_many_equations_as_unknowns_tell_no_noise(choice):
    A, b = noisy(7, rows=3)
    with pytest.raises(EstimationError, match=r"more equations than the 3 unknowns .*; received 3"):
        RegularisedLeastSquares(choice=choice).solve(LinearSystem(A, b))
    RegularisedLeastSquares(choice=LCurve()).solve(LinearSystem(A, b))


@pytest.mark.usefixtures("unchecked_shapes")
def test_what_cannot_be_used_is_refused():
    A, b = noisy(8)
    with pytest.raises(ShapeError, match="3 numbers to be pulled towards"):
        RegularisedLeastSquares(towards=np.ones(2)).solve(LinearSystem(A, b))
    with pytest.raises(NonFiniteError, match="a vector of finite numbers"):
        RegularisedTotalLeastSquares(towards=np.array([1.0, np.nan]))
    with pytest.raises(UsageError, match="a parameter of zero or more; received -1"):
        RegularisedLeastSquares(choice=GivenParameter(-1.0)).solve(LinearSystem(A, b))
    with pytest.raises(UsageError, match=r"a whole number of steps from 1 to 1000; received 2\.5"):
        RegularisedLeastSquares(ImplicitIteration(), GivenParameter(2.5)).solve(LinearSystem(A, b))
    with pytest.raises(UsageError, match="a regularisation for scheme"):
        RegularisedLeastSquares(scheme="tikhonov")
    with pytest.raises(UsageError, match="a choice for choice"):
        RegularisedTotalLeastSquares(choice=0.1)
