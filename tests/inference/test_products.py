"""The table of products: its parts, totals and replicates against the rows themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.errors import UsageError
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


def test_totals_groups_and_sums():
    result = table(6)
    np.testing.assert_allclose(result.total.sums, table(1).sums, atol=1e-12)
    assert result.total.count == result.count == ROWS
    grouped = result.grouped([0, 2, 6])
    np.testing.assert_allclose(grouped.sums[0], result.sums[0] + result.sums[1], atol=1e-12)
    np.testing.assert_array_equal(grouped.counts, [result.counts[:2].sum(), result.counts[2:].sum()])
    np.testing.assert_allclose((grouped + result).total.sums, 2.0 * result.total.sums, atol=1e-12)
    np.testing.assert_allclose(result.equations_only.sums, table(6, whole=False).sums, atol=1e-12)
    np.testing.assert_allclose(result.means, result.total.sums[0] / ROWS)


def test_replicates_count_blocks_as_often_as_they_are_drawn():
    result = table(5)
    drawn = np.array([0, 3, 3, 4])
    once = result.weighted(np.bincount(drawn, minlength=5).astype(np.float64))
    np.testing.assert_allclose(result.resampled(drawn).sums, once.sums, atol=1e-12)
    assert result.resampled(drawn).count == once.count
    # rows may count less than one, so that old ones are forgotten
    weighted = result.weighted(0.9 ** np.arange(5.0))
    assert weighted.count == pytest.approx(float(0.9 ** np.arange(5.0) @ result.counts))


def test_stretches_of_blocks_are_added_as_often_as_they_are_drawn():
    """Three stretches of two blocks each: first blocks with first ones, and second with second."""
    result = table(6)
    drawn = result.weighted(np.array([2.0, 0.0, 1.0]))
    np.testing.assert_allclose(drawn.sums, 2.0 * result.sums[:2] + result.sums[4:], atol=1e-12)
    np.testing.assert_array_equal(drawn.counts, 2.0 * result.counts[:2] + result.counts[4:])


def test_what_is_not_in_the_table_is_not_made_up():
    small = table(whole=False)
    for part in ("instruments", "regressors", "regressor_response", "power"):
        with pytest.raises(UsageError, match="Make the products of all columns"):
            getattr(small, part)
    with pytest.raises(UsageError, match="Add the products of one problem"):
        small + table()
    other = replace(small, layout=replace(small.layout, instruments=P - 1))
    with pytest.raises(UsageError, match="2 instruments and 2 regressors"):
        small + other
