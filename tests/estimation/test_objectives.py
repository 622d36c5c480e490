"""What a search asks of many points at once is what it would get point by point."""

from __future__ import annotations

import numpy as np
import pytest
from nuisance_runs import lag, problem, share

from eivor.estimation.linear import LinearMethod
from eivor.estimation.methods import reference_iv
from eivor.linalg.system import LinearSystem, Solver
from eivor.linalg.total_least_squares import AugmentedLeastSquares, LeastSquares, TotalLeastSquares


@pytest.mark.parametrize(
    ("solver", "equations"),
    [(LeastSquares(), 3), (LeastSquares(), 7), (AugmentedLeastSquares(), 7), (TotalLeastSquares(), 7)],
)
def test_objectives_are_those_of_each_system(solver: Solver, equations: int) -> None:
    systems = np.random.default_rng(equations).normal(size=(5, equations, 4)) * [1.0, 1e3, 1e-3, 1.0]
    each = [solver.solve(LinearSystem(system[:, :-1], system[:, -1])).objective for system in systems]
    np.testing.assert_allclose(solver.objectives(systems), each, rtol=1e-9, atol=1e-20)


def test_products_of_whitened_rows_are_those_of_each_point():
    method, made = reference_iv(), problem(lag(), share())
    assert isinstance(method, LinearMethod)
    weights = method.row_weighting.first_pass(made)
    grid = made.nuisances[0].grid[::5]
    points = [made.first_values | {made.nuisances[0].name: float(value)} for value in grid]
    result = weights.products(points)
    assert result.shape[0] == len(points)
    for point, products in zip(points, result, strict=True):
        rows = weights.rows(point)
        by_hand = rows.instruments.T @ np.column_stack([rows.regressors, rows.response]) / rows.response.size
        np.testing.assert_allclose(products, by_hand, rtol=1e-10, atol=1e-14 * np.abs(by_hand).max())
        system = method.assembler.system(method.moments(rows))
        np.testing.assert_allclose(products[:, :-1], system.matrix, rtol=1e-10, atol=1e-14)
