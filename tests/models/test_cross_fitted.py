"""Predictions that are fitted where they are not used."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.models.signal_regression import BLOCKS, cross_fitted

RNG = np.random.default_rng(0)
COUNT = 1000
ALL = np.ones(COUNT, dtype=np.bool_)


def test_what_is_a_sum_of_the_columns_is_found_again():
    exogenous = RNG.standard_normal((COUNT, 3))
    values = exogenous @ RNG.standard_normal((3, 2)) + [4.0, -1.0]
    np.testing.assert_allclose(cross_fitted(exogenous, values, ALL), values, atol=1e-4)


def test_columns_that_say_the_same_are_one():
    column = RNG.standard_normal((COUNT, 1))
    exogenous = np.column_stack([column, 1e6 * column, np.zeros(COUNT)])
    np.testing.assert_allclose(cross_fitted(exogenous, 2.0 * column, ALL), 2.0 * column, atol=1e-4)


def test_a_block_is_predicted_by_the_others_alone():
    exogenous = RNG.standard_normal((COUNT, 3))
    values = RNG.standard_normal((COUNT, 1))
    changed = values.copy()
    first = slice(0, COUNT // BLOCKS)
    changed[first] += 10.0
    before, after = (cross_fitted(exogenous, item, ALL) for item in (values, changed))
    np.testing.assert_allclose(after[first], before[first])
    assert np.abs(after[first.stop :] - before[first.stop :]).max() > 0.1


def test_many_columns_that_say_nothing_do_not_follow_the_values():
    exogenous = RNG.standard_normal((COUNT, 150))
    values = RNG.standard_normal((COUNT, 1))
    design = np.column_stack([np.ones(COUNT), exogenous])
    fitted = design @ np.linalg.lstsq(design, values, rcond=None)[0]
    correlations = [
        np.corrcoef(item[:, 0], values[:, 0])[0, 1] for item in (fitted, cross_fitted(exogenous, values, ALL))
    ]
    assert correlations[0] > 0.3
    assert abs(correlations[1]) < 0.12


def test_samples_that_are_not_used_are_predicted_and_not_fitted_to():
    exogenous = RNG.standard_normal((COUNT, 2))
    values = exogenous @ np.array([[1.0], [2.0]])
    used = ALL.copy()
    used[300:500] = used[:20] = False
    spoilt = np.where(used[:, None], values, 1e3)
    np.testing.assert_allclose(cross_fitted(exogenous, spoilt, used), values, atol=1e-4)


@pytest.mark.parametrize("columns", [0, 60])
def test_without_columns_or_with_too_few_samples_it_is_the_mean(columns):
    exogenous = RNG.standard_normal((100, columns))
    values = RNG.standard_normal((100, 1))
    fitted = cross_fitted(exogenous, values, np.ones(100, dtype=np.bool_))
    assert np.ptp(fitted) < 0.3
    assert fitted.mean() == pytest.approx(values.mean(), abs=0.3)
    if columns:
        np.testing.assert_allclose(fitted, values.mean())


def test_columns_that_hardly_differ_do_not_lead_astray():
    time = np.linspace(0.0, 6.0, COUNT)
    exogenous = np.sin(time[:, None] - 1e-3 * np.arange(8) ** 1.1)
    values = exogenous[:, :1] + 0.1 * np.cumsum(RNG.standard_normal((COUNT, 1)), axis=0) / np.sqrt(COUNT)
    assert np.std(cross_fitted(exogenous, values, ALL) - values) < 0.3
