"""Whiteness, memory and excitation: formulas written out, sizes, and known orders."""

from __future__ import annotations

import instrument_data as data
import numpy as np
import pytest
from scipy import stats

from eivor.inference.diagnostics.excitation import band_power, information
from eivor.inference.diagnostics.record import equation_products
from eivor.inference.diagnostics.residuals import LONGEST, residual_memory, residual_whiteness
from eivor.signals.noise import fractional_difference


def test_whiteness_is_its_formulas():
    e = data.autoregression(np.random.default_rng(0), (70_000,), 0.3)  # longer than a block
    whiteness = residual_whiteness(e, 12)
    r = np.array([e[lag:] @ e[:-lag] for lag in range(1, 13)]) / (e @ e)
    np.testing.assert_allclose(whiteness.autocorrelation, r, rtol=1e-9)
    Q = e.size * (e.size + 2) * sum(r[lag - 1] ** 2 / (e.size - lag) for lag in range(1, 13))
    assert whiteness.ljung_box == pytest.approx(Q, rel=1e-9)
    assert whiteness.durbin_watson == pytest.approx(np.sum(np.diff(e) ** 2) / np.sum(e**2), rel=1e-9)
    assert whiteness.band == pytest.approx(stats.norm.ppf(0.975) / np.sqrt(e.size), rel=1e-9)
    assert whiteness.outside == int((np.abs(r) > whiteness.band).sum())


@pytest.mark.thorough
def test_statsmodels_ljung_box():
    diagnostic = pytest.importorskip("statsmodels.stats.diagnostic")
    e = data.autoregression(np.random.default_rng(1), (500,), 0.1)
    e -= e.mean()
    peer = diagnostic.acorr_ljungbox(e, lags=[20])
    whiteness = residual_whiteness(e)
    assert whiteness.ljung_box == pytest.approx(float(peer["lb_stat"].iloc[0]), rel=1e-6)
    assert whiteness.p_value == pytest.approx(float(peer["lb_pvalue"].iloc[0]), rel=1e-6)


@pytest.mark.thorough
def test_size_of_the_whiteness_test():
    runs = 1500
    e = np.random.default_rng(2).standard_normal((runs, 400))
    results = [residual_whiteness(item) for item in e]
    rejected = sum(result.p_value < 0.05 for result in results)
    assert stats.binom.ppf(1e-4, runs, 0.045) <= rejected <= stats.binom.ppf(1.0 - 1e-4, runs, 0.065)
    outside = sum(result.outside for result in results)
    assert abs(outside / (20 * runs) - 0.05) < 0.005


def test_a_residual_of_zeros_or_of_few_samples_is_white():
    assert residual_whiteness(np.zeros(100)).p_value == 1.0
    assert residual_whiteness(np.zeros(100)).durbin_watson == 2.0
    assert residual_whiteness(np.array([1.0, -1.0, 1.0])).autocorrelation.size == 1


@pytest.mark.parametrize("memory", [0.0, 0.3, 0.45])
def test_memory_of_a_long_record_is_found_from_its_means(memory):
    """Fractional noises of 40,000 samples, averaged five to one: the error is the one that is told."""
    runs, z = 60, []
    for seed in range(runs):
        white = np.random.default_rng(seed).standard_normal(5 * LONGEST)
        result = residual_memory(np.asarray(fractional_difference(white, -memory)))
        z.append((result.memory - memory) / result.order_error)
    assert abs(np.mean(z)) < 4.0 / np.sqrt(runs) + 0.3  # the noise starts with its record, hence the .3
    assert 0.6 < np.std(z) < 1.4


def test_memory_needs_a_record():
    assert residual_memory(np.zeros(1000)) is None
    assert residual_memory(np.ones(1000) * 3.3) is None
    assert residual_memory(np.arange(16.0)) is None


def test_bands_add_up_to_the_variance():
    rng = np.random.default_rng(3)
    u, e = data.autoregression(rng, (30_000,), 0.9), rng.standard_normal(30_000)
    power = band_power([u, 2.0 * u], [3.0, 0.5], 0.4 * e, rate_hz=50.0)
    assert power.input_power[:, 0].sum() == pytest.approx(9.0, rel=0.1)
    assert power.input_power[:, 1].sum() == pytest.approx(1.0, rel=0.1)
    assert power.residual_power.sum() == pytest.approx(0.16, rel=0.05)
    assert power.low_hz[0] == pytest.approx(50.0 / 4096)
    assert power.high_hz[-1] == pytest.approx(25.0)
    assert np.all(power.high_hz[:-1] < power.low_hz[1:])


def test_where_the_input_is_below_the_residual():
    """A sine lifts its own band above the residual and no other."""
    count, rate = 8192, 10.0
    t = np.arange(count) / rate
    power = band_power(
        [np.sin(2.0 * np.pi * 0.5 * t)], [1.0], np.random.default_rng(4).standard_normal(count), rate_hz=rate
    )
    inside = (power.low_hz <= 0.5) & (power.high_hz >= 0.5)
    assert power.excited[inside, 0].all()
    assert not power.excited[~inside, 0].any()
    assert power.share_above[0] > 0.99


def test_information_names_the_combination_that_is_worst():
    rng = np.random.default_rng(5)
    standard_normal = rng.standard_normal(1000)
    X = np.column_stack(
        [
            standard_normal,
            1e3 * (standard_normal + 0.1 * rng.standard_normal(1000)),
            rng.standard_normal(1000),
        ]
    )
    products = equation_products(instruments=X, jacobian=X, residual=np.ones(1000), blocks=10)
    result = information(products, instrumental=False)
    correlation = np.array([[a @ b / np.sqrt((a @ a) * (b @ b)) for a in X.T] for b in X.T])
    np.testing.assert_allclose(result.matrix, correlation, rtol=1e-6, atol=1e-9)
    assert result.condition == pytest.approx(np.linalg.cond(correlation), rel=1e-6)
    words = result.worst(("friction", "gain", "bias"))
    assert words in {"0.71 friction - 0.71 gain", "0.71 gain - 0.71 friction"}
    # with the columns as instruments the information is the same
    np.testing.assert_allclose(
        information(products, instrumental=True).matrix, correlation, rtol=1e-6, atol=1e-9
    )
