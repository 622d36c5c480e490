"""Covariance row by row: its formula, and that it holds a slow column in bins with a power of their own."""

from __future__ import annotations

import numpy as np
from scipy import stats

from eivor.inference.covariance import ByRow, Classical
from eivor.inference.estimating_equation import EquationRows, EstimatingEquation


def equation_of(P, e):
    """Least squares in the coordinates of its columns."""
    rows = EquationRows(P, e, P * e[:, None], np.zeros(e.size, dtype=np.int64))
    return EstimatingEquation(np.eye(P.shape[1]), P.T @ P, e.size, lambda: [rows])


def test_it_is_hc3_with_t_of_each_parameters_own_rows():
    rng = np.random.default_rng(0)
    P, e = rng.standard_normal((40, 2)) * [1.0, 3.0], rng.standard_normal(40)
    P[5:, 1] *= 0.1
    (part,) = ByRow().parts(equation_of(P, e))
    inverse = np.linalg.inv(P.T @ P)
    influence = P @ inverse
    leverage = np.einsum("ti,ij,tj->t", P, inverse, P)
    plain = influence.T * (e / (1.0 - leverage)) ** 2 @ influence
    nu = (influence**2).sum(axis=0) ** 2 / (influence**4).sum(axis=0)
    assert nu[1] < 8.0 < nu[0]
    wider = stats.t(nu).ppf(0.975) / stats.norm.ppf(0.975)
    np.testing.assert_allclose(part.matrix, plain * np.outer(wider, wider), rtol=1e-9)
    assert part.name == "by_row"
    assert np.isinf(part.degrees)


def test_it_holds_a_column_in_few_rows_whose_residual_is_stronger_than_the_rest():
    """Sixty of 400 intervals of a .95 level by one variance for all rows miss; row by row at most 32 do."""
    rng = np.random.default_rng(1)
    n, held = 200, {"all": 0, "own": 0}
    slow = 1.0 / np.arange(2.0, n + 2.0)
    size = np.where(np.arange(n) < 10, 1.7, 1.0)
    for _ in range(400):
        y = size * rng.standard_normal(n)
        error = slow @ y / (slow @ slow)
        equation = equation_of(slow[:, None], y - error * slow)
        held["all"] += abs(error) <= Classical().joint(equation).half_width(np.ones(1))
        held["own"] += abs(error) <= ByRow().joint(equation).half_width(np.ones(1))
    assert held["all"] < 340
    assert held["own"] >= 368


def test_a_column_in_a_single_row_is_no_error():
    (part,) = ByRow().parts(equation_of(np.column_stack([np.ones(8), np.eye(8)[0]]), np.arange(8.0)))
    assert np.isfinite(part.matrix).all()
