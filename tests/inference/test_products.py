"""The table of products: its parts, totals and replicates against the rows themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from eivor.errors import UsageError
from eivor.inference.bootstrap import autocovariance, automatic_block_length
from eivor.inference.covariance import ByRow
from eivor.inference.estimating_equation import EquationRows, EstimatingEquation
from eivor.inference.products import Products, block_edges, products_of_rows

ROWS, P, N = 97, 3, 2


def rows() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    return rng.standard_normal((ROWS, P)), rng.standard_normal((ROWS, N)), rng.standard_normal(ROWS)


def table(blocks: int = 4, *, whole: bool = True) -> Products:
    return products_of_rows(*rows(), edges=block_edges(ROWS, blocks), whole=whole)


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("blocks", [1, 4, ROWS])
def test_blocks_are_the_products_of_their_rows(blocks, whole):
    """Long blocks by matrix products, short ones many at once."""
    psi, phi, y = rows()
    edges = block_edges(ROWS, blocks)
    result = table(blocks, whole=whole)
    for k in range(blocks):
        here = slice(edges[k], edges[k + 1])
        assert result.counts[k] == edges[k + 1] - edges[k]
        np.testing.assert_allclose(result.cross[k], psi[here].T @ phi[here], atol=1e-12)
        np.testing.assert_allclose(result.instrument_response[k], psi[here].T @ y[here], atol=1e-12)
        if whole:
            np.testing.assert_allclose(result.instruments[k], psi[here].T @ psi[here], atol=1e-12)
            np.testing.assert_allclose(result.regressors[k], phi[here].T @ phi[here], atol=1e-12)
            np.testing.assert_allclose(result.regressor_response[k], phi[here].T @ y[here], atol=1e-12)
            np.testing.assert_allclose(result.power[k], y[here] @ y[here], atol=1e-12)


@pytest.mark.parametrize("whole", [True, False])
def test_residual_in_the_responses_place(whole):
    psi, phi, y = rows()
    theta = np.array([0.7, -1.3])
    expected = products_of_rows(psi, phi, y - phi @ theta, edges=block_edges(ROWS, 4), whole=whole)
    np.testing.assert_allclose(table(whole=whole).with_residual(theta).sums, expected.sums, atol=1e-12)


def test_totals_and_sums():
    result = table(6)
    np.testing.assert_allclose(result.total.sums, table(1).sums, atol=1e-12)
    assert result.total.count == result.count == ROWS
    np.testing.assert_allclose((result.total + result).total.sums, 2.0 * result.total.sums, atol=1e-12)
    np.testing.assert_allclose(result.equations_only.sums, table(6, whole=False).sums, atol=1e-12)


def test_what_is_not_in_the_table_is_not_made_up():
    small = table(whole=False)
    for part in ("instruments", "regressors", "regressor_response", "power"):
        with pytest.raises(UsageError, match="Make the products of all columns"):
            getattr(small, part)
    with pytest.raises(UsageError, match="Add the products of one problem"):
        small + table()
    with pytest.raises(UsageError, match="received products of 2 instruments"):
        small + replace(small, sums=small.sums[:, : P - 1], tested=P - 1)


def test_autocovariance_is_its_formula() -> None:
    x = np.random.default_rng(8).normal(size=101)
    x -= x.mean()
    wanted = [float(x[k:] @ x[: x.size - k]) / x.size for k in range(20)]
    np.testing.assert_allclose(autocovariance(x, 19), wanted, atol=1e-14)


def test_automatic_length_of_white_noise_is_short_and_that_of_a_trend_long() -> None:
    random = np.random.default_rng(10)
    white = [automatic_block_length(random.normal(size=(1000, 1))) for _ in range(40)]
    assert float(np.median(white)) < 4.0
    assert automatic_block_length(np.arange(1000.0)[:, None]) > 60.0
    assert automatic_block_length(np.ones((100, 1))) == 1.0


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


def test_a_column_in_a_single_row_is_no_error():
    (part,) = ByRow().parts(equation_of(np.column_stack([np.ones(8), np.eye(8)[0]]), np.arange(8.0)))
    assert np.isfinite(part.matrix).all()
