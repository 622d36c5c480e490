"""Constancy of parameters and leverage of stretches: formulas written out, size, power, second routes."""

from __future__ import annotations

import instrument_data as data
import numpy as np
import pytest
from scipy import stats

from eivor.inference.diagnostics.residuals import (
    GROUPS,
    QUANTILES,
    TAILS,
    constancy,
    p_value,
    segment_leverage,
    wald_path,
)


def tenths(count: int) -> tuple[tuple[int, int], ...]:
    """Stretches of ten rows each."""
    return tuple((10 * k, 10 * k + 10) for k in range(count))


def scores_of(seed, count=2560, memory=0.0, change=0.0, nuisances=0.6):
    """Least squares of y on two columns, the first one's parameter changing; scores, M, and the rows."""
    rng = np.random.default_rng(seed)
    X = data.autoregression(rng, (count, 2), memory)
    slope = np.where(np.arange(count) < nuisances * count, 1.0, 1.0 + change)
    y = slope * X[:, 0] - 0.5 * X[:, 1] + data.autoregression(rng, (count,), memory)
    theta = np.linalg.lstsq(X, y, rcond=None)[0]
    return X * (y - X @ theta)[:, None], X.T @ X, X, y


def constancy_of(seed, **circumstances):
    scores, M, *_ = scores_of(seed, **circumstances)
    return constancy(scores.reshape(128, -1, 2).sum(axis=1), M)


def test_wald_path_is_its_formula():
    groups = np.random.default_rng(0).standard_normal((GROUPS, 2)) @ np.array([[1.0, 0.3], [0.0, 2.0]])
    path = wald_path(groups)
    assert path.size == GROUPS - 20 + 1
    for k in (10, 31, 54):
        S = np.zeros((2, 2))
        for side in (groups[:k], groups[k:]):
            size = len(side)
            for j in range(1, 7):
                L = np.sqrt(2.0 / size) * sum(
                    side[t] * np.cos(np.pi * j * (t + 0.5) / size) for t in range(size)
                )
                S += np.outer(L, L) / 12.0
        difference = groups[:k].mean(axis=0) - groups[k:].mean(axis=0)
        W = difference @ np.linalg.solve(S * (1.0 / k + 1.0 / (GROUPS - k)), difference)
        assert path[k - 10] == pytest.approx(W * (12 - 2 + 1) / (12 * 2), rel=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("unknowns", [1, 2, 3, 6])
def test_table_is_what_the_simulation_draws(unknowns):
    """Shares of a fresh simulation beyond each quantile, within their binomial error."""
    runs = 3000
    rng = np.random.default_rng(100 + unknowns)
    suprema = np.array([wald_path(rng.standard_normal((GROUPS, unknowns))).max() for _ in range(runs)])
    for tail, quantile in zip(TAILS[:6], QUANTILES[unknowns], strict=False):
        low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], runs, tail)
        assert low <= np.sum(suprema > quantile) <= high
        assert p_value(quantile, unknowns) == pytest.approx(tail)
    assert p_value(1e9, unknowns) == pytest.approx(0.001)
    assert p_value(0.0, unknowns) == pytest.approx(0.5)


@pytest.mark.calibration
@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_size_with_constant_parameters(memory):
    runs = 600
    results = [constancy_of(seed, memory=memory) for seed in range(runs)]
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], runs, [0.04, 0.06])
    assert low <= sum(result.p_value < 0.05 for result in results) <= high
    for j in (0, 1):
        assert low <= sum(result.p_values[j] < 0.05 for result in results) <= high


def test_a_change_is_found_where_and_what_it_is():
    results = [constancy_of(seed, change=0.5, memory=0.5) for seed in range(60)]
    assert sum(result.p_value < 0.05 for result in results) > 50
    assert np.median([result.break_at for result in results]) == pytest.approx(0.6, abs=0.02)
    changes = np.array([result.change for result in results])
    error = changes.std(axis=0) / np.sqrt(len(results))
    np.testing.assert_array_less(np.abs(changes.mean(axis=0) - [0.5, 0.0]), 4.0 * error + 0.03)
    # power does not fall as the change grows: either side has a covariance of its own
    assert sum(constancy_of(seed, change=5.0, memory=0.5).p_value < 0.05 for seed in range(60)) == 60


def test_units_do_not_count():
    scores, M, *_ = scores_of(3, change=0.2)
    sums, units = scores.reshape(128, -1, 2).sum(axis=1), np.array([1e-6, 1e5])
    item, other = constancy(sums, M), constancy(sums * units, M * np.outer(units, units))
    assert item.statistic == pytest.approx(other.statistic, rel=1e-6)
    np.testing.assert_allclose(item.change, other.change * units, rtol=1e-6)
    assert item.break_at == other.break_at


def test_many_parameters_are_bounded_by_the_strongest():
    rng = np.random.default_rng(6)
    sums = rng.standard_normal((64, 8))
    result = constancy(sums, np.eye(8))
    assert result.p_value == pytest.approx(min(1.0, 8 * result.p_values.min()))
    sums[40:, 5] += 5.0
    result = constancy(sums, np.eye(8))
    assert result.p_value < 0.05
    assert int(np.argmin(result.p_values)) == 5
    assert result.break_at == pytest.approx(40 / 64)


def test_scores_of_zero_are_constant():
    assert constancy(np.zeros((64, 2)), np.eye(2)).p_value == pytest.approx(0.5)


# -- leverage ---------------------------------------------------------------------------------------------


def test_leverage_is_the_estimate_without_the_stretch():
    scores, _, X, y = scores_of(4)
    theta = np.linalg.lstsq(X, y, rcond=None)[0]
    sums = scores.reshape(10, -1, 2).sum(axis=1)
    current = np.einsum("kti,ktj->kij", X.reshape(10, -1, 2), X.reshape(10, -1, 2))
    leverage = segment_leverage(sums, current, np.array([0.1, 0.2]), tenths(len(sums)))
    for k in range(10):
        rest = np.ones(len(y), dtype=bool)
        rest[k * 256 : (k + 1) * 256] = False
        again = np.linalg.lstsq(X[rest], y[rest], rcond=None)[0]
        np.testing.assert_allclose(leverage.shift[k], again - theta, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(leverage.in_std_errors, leverage.shift / [0.1, 0.2])
    most = np.argmax(np.abs(leverage.in_std_errors), axis=0)
    np.testing.assert_array_equal(leverage.most, most)
    np.testing.assert_allclose(leverage.largest, leverage.in_std_errors[most, [0, 1]])


def test_a_stretch_that_alone_determines_a_parameter():
    sensitivities = np.stack([np.diag([1.0, 0.0]), np.diag([1.0, 2.0])])
    leverage = segment_leverage(np.array([[1.0, 0.0], [-1.0, 0.0]]), sensitivities, np.ones(2), tenths(2))
    assert np.isnan(leverage.shift[1]).all()
    assert leverage.most[0] == 0


def test_alike_stretches_move_the_estimate_by_a_third_of_its_error():
    runs, shifts = 100, []
    for seed in range(runs):
        scores, M, X, _ = scores_of(seed)
        current = np.einsum("kti,ktj->kij", X.reshape(10, -1, 2), X.reshape(10, -1, 2))
        errors = np.sqrt(np.diag(np.linalg.inv(M)))
        shifts.append(
            segment_leverage(scores.reshape(10, -1, 2).sum(axis=1), current, errors, tenths(10)).in_std_errors
        )
    spread = np.std(shifts)
    assert spread == pytest.approx(1.0 / 3.0, abs=4.0 * spread / np.sqrt(2.0 * 20 * runs) + 0.01)
