"""What noises say of their covariance, against direct sums and against noise that was drawn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import gamma

from eivor.errors import NonFiniteError
from eivor.signals import noise
from eivor.signals.noise import (
    FractionalNoise,
    GrowthTable,
    WhiteNoise,
    fractional_difference,
    fractional_weights,
)


def direct(order: float, lag: int, start: int, count: int) -> np.ndarray:
    """Sum of the products of weights, term by term."""
    weights = fractional_weights(order, start + count + lag + 1)
    return np.array(
        [sum(weights[q] * weights[q + lag] for q in range(m + 1)) for m in range(start, start + count)]
    )


@given(
    order=st.floats(-0.5, 0.5),
    lag=st.integers(0, 12),
    start=st.integers(0, 40),
    count=st.integers(1, 40),
)
def test_fractional_autocovariance_is_the_double_sum(order, lag, start, count):
    autocovariance = FractionalNoise(2.0, order).autocovariance(lag, start, count)
    np.testing.assert_allclose(autocovariance, 4.0 * direct(order, lag, start, count), rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("lag", [0, 3, 11])
@pytest.mark.parametrize("order", [-0.5, -0.4, 0.3])
def test_growth_across_blocks_is_the_growth_without_them(monkeypatch, order, lag):
    whole = direct(order, lag, 0, 90)
    monkeypatch.setattr(noise, "BLOCK", 7)
    table = GrowthTable(order, lag)
    # The default number of weights was bound when the class was made: blocks of seven need their own.
    monkeypatch.setattr(GrowthTable._weights, "__defaults__", (8,), raising=True)
    for start, count in ((60, 5), (0, 90), (6, 2), (13, 30), (89, 1)):
        np.testing.assert_allclose(table.stretch(start, count), whole[start : start + count], rtol=1e-12)


def test_growth_across_the_border_of_real_blocks():
    border = noise.BLOCK
    lag, order = 4, -0.4
    weights = fractional_weights(order, border + 40)
    whole = np.cumsum(weights[: border + 20] * weights[lag : border + 20 + lag])
    stretch = GrowthTable(order, lag).stretch(border - 10, 25)
    np.testing.assert_allclose(stretch, whole[border - 10 : border + 15], rtol=1e-10)


@pytest.mark.parametrize(("order", "lag"), [(-0.5, 0), (-0.4, 3), (0.4, 1)])
def test_fractional_autocovariance_is_that_of_drawn_noise(order, lag):
    runs, count, std = 20_000, 30, 0.7
    white = std * np.random.default_rng(8).standard_normal((count, runs))
    drawn = fractional_difference(white, order)
    products = drawn[: count - lag] * drawn[lag:]
    expected = FractionalNoise(std, order).autocovariance(lag, 0, count - lag)
    error = products.std(axis=1) / np.sqrt(runs)
    # Thirty or so means, each within 4.5 standard errors: one in ten thousand fails by chance.
    assert np.all(np.abs(products.mean(axis=1) - expected) < 4.5 * error)


def test_white_noise_has_its_variance_at_lag_zero_only():
    noise = WhiteNoise(0.3)
    np.testing.assert_array_equal(noise.autocovariance(0, 5, 4), np.full(4, 0.3**2))
    np.testing.assert_array_equal(noise.autocovariance(2, 0, 3), np.zeros(3))
    assert noise.variance == pytest.approx(0.09)
    np.testing.assert_allclose(FractionalNoise(0.3, 0.0).autocovariance(0, 9, 3), 0.09)
    np.testing.assert_allclose(FractionalNoise(0.3, 0.0).autocovariance(2, 9, 3), 0.0, atol=1e-18)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: WhiteNoise(-0.1), "std=-0.1"),
        (lambda: WhiteNoise(float("nan")), "std=nan"),
        (lambda: FractionalNoise(float("inf"), 0.1), "std=inf"),
        (lambda: FractionalNoise(1.0, 0.51), "order=0.51"),
        (lambda: FractionalNoise(1.0, float("nan")), "order=nan"),
    ],
)
def test_impossible_noises_are_refused(make, said):
    with pytest.raises(NonFiniteError, match=f"Expected .*; received {said}"):
        make()


def test_published_weights_and_differences():
    """Order 0.4: 1, -0.4, -0.12, ...; order 0.5 of (1, 2, 4, 7, 0); by hand, from the binomial series."""
    np.testing.assert_allclose(
        fractional_weights(0.4, 6), [1.0, -0.4, -0.12, -0.064, -0.0416, -0.029952], rtol=1e-14
    )
    np.testing.assert_allclose(
        fractional_difference(np.array([1.0, 2.0, 4.0, 7.0, 0.0]), 0.5),
        [1.0, 1.5, 2.875, 4.6875, -4.1640625],
        rtol=1e-13,
    )


@pytest.mark.parametrize("memory", [0.2, 0.3])
def test_old_noise_has_the_moments_of_the_stationary_process(memory):
    """ARFIMA(0, d, 0): variance Gamma(1 - 2d) / Gamma(1 - d)^2, lag-one autocorrelation d / (1 - d)."""
    noise = FractionalNoise(1.0, -memory)
    age = 2_000_000
    variance = gamma(1.0 - 2.0 * memory) / gamma(1.0 - memory) ** 2
    # The sum of a_q^2 ~ q^(2d - 2) / Gamma(d)^2 beyond the record's age is what is still missing.
    missing = age ** (2.0 * memory - 1.0) / ((1.0 - 2.0 * memory) * gamma(memory) ** 2)
    assert noise.autocovariance(0, age, 1)[0] == pytest.approx(variance - missing, rel=1e-6)
    lagged = noise.autocovariance(1, age, 1)[0]
    assert lagged == pytest.approx(variance * memory / (1.0 - memory) - missing, rel=1e-6)


def test_half_derivative_of_a_ramp():
    """The half-derivative of t at t = 1 is 2 / sqrt(pi)."""
    step = 1e-5
    ramp = step * np.arange(100_001)
    result = fractional_difference(ramp, 0.5)[-1] / np.sqrt(step)
    assert result == pytest.approx(2.0 / np.sqrt(np.pi), rel=1e-5)


@pytest.mark.parametrize("noise", [WhiteNoise(0.3), FractionalNoise(0.3, -0.4), FractionalNoise(0.3, 0.5)])
def test_sampled_noise_has_its_autocovariance(noise):
    streams = np.random.default_rng(12).spawn(4000)
    drawn = np.array([noise.sample(40, stream) for stream in streams])
    for lag in (0, 1, 4):
        products = drawn[:, : 40 - lag] * drawn[:, lag:]
        error = products.std(axis=0) / np.sqrt(len(streams))
        expected = noise.autocovariance(lag, 0, 40 - lag)
        assert np.all(np.abs(products.mean(axis=0) - expected) < 4.5 * error)


@pytest.mark.parametrize("noise", [WhiteNoise(0.3), FractionalNoise(0.3, -0.5)])
def test_another_std_scales_every_sample(noise):
    sample = noise.sample(50, np.random.default_rng(5))
    other = noise.with_std(0.9).sample(50, np.random.default_rng(5))
    np.testing.assert_allclose(other, 3.0 * sample, rtol=1e-12)
    assert noise.with_std(0.9).std == 0.9
    assert noise.with_std(noise.std) == noise
    np.testing.assert_array_equal(noise.with_std(0.0).sample(50, np.random.default_rng(5)), 0.0)


def test_order_is_the_slope_of_the_spectrum():
    """Over the middle decades, log S rises by 2 * order per unit of log w."""
    for order in (-0.5, -0.4, 0.3):
        noise = FractionalNoise(1.0, order)
        power = np.mean(
            [
                np.abs(np.fft.rfft(noise.sample(4096, stream) * np.hanning(4096))) ** 2
                for stream in np.random.default_rng(2).spawn(60)
            ],
            axis=0,
        )
        w = 2.0 * np.pi * np.fft.rfftfreq(4096)
        band = (w > 0.01) & (w < 0.5)
        slope, _ = np.polyfit(np.log(2.0 * np.sin(w[band] / 2.0)), np.log(power[band]), 1)
        assert slope == pytest.approx(2.0 * order, abs=0.06)
