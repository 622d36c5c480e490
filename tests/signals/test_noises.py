"""What noises say of their covariance, against direct sums and against noise that was drawn."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import pytest
from cost import in_transforms
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import binom

import eivor as ev
from eivor.errors import NonFiniteError, ParameterError, TooFewSamplesError, UsageError
from eivor.signals import noise
from eivor.signals.noise import GrowthTable, fractional_difference, fractional_weights
from eivor.signals.recording import DataSheet


def direct(order, lag, start, count):
    """Sum of the products of weights, term by term."""
    weights = fractional_weights(order, start + count + lag + 1)
    return np.array(
        [sum(weights[q] * weights[q + lag] for q in range(m + 1)) for m in range(start, start + count)]
    )


@given(order=st.floats(-0.5, 0.5), lag=st.integers(0, 12), start=st.integers(0, 40), count=st.integers(1, 40))
def test_fractional_autocovariance_is_the_double_sum(order, lag, start, count):
    autocovariance = ev.FractionalNoise(2.0, order).autocovariance(lag, start, count)
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


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: ev.WhiteNoise(-0.1), "std=-0.1"),
        (lambda: ev.WhiteNoise(float("nan")), "std=nan"),
        (lambda: ev.FractionalNoise(float("inf"), 0.1), "std=inf"),
        (lambda: ev.FractionalNoise(1.0, 0.51), "order=0.51"),
        (lambda: ev.FractionalNoise(1.0, float("nan")), "order=nan"),
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


def test_order_is_the_slope_of_the_spectrum():
    """Over the middle decades, log S rises by 2 * order per unit of log w."""
    for order in (-0.5, -0.4, 0.3):
        noise = ev.FractionalNoise(1.0, order)
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


COUNT = 200_000
NOISES = [
    ev.AutoregressiveNoise(0.4, 0.9),
    ev.AutoregressiveNoise(0.4, -0.5),
    ev.HeavyTailedNoise(0.4, 5.0),
    ev.RoundingNoise(0.4),
]


@pytest.mark.parametrize("noise", NOISES, ids=repr)
@pytest.mark.parametrize("lag", [0, 1, 7])
def test_samples_have_the_autocovariance(noise, lag):
    series = noise.sample(COUNT, np.random.default_rng(4))
    result = np.mean(series[: COUNT - lag] * series[lag:])
    expected = noise.autocovariance(lag, 1_000, 3)
    assert expected.shape == (3,)
    assert result == pytest.approx(expected[0], abs=0.03 * noise.std**2)


@pytest.mark.parametrize("noise", NOISES, ids=repr)
@pytest.mark.parametrize("lag", [0, 1, 3])
def test_the_moving_average_has_the_autocovariance_of_a_record_that_begins(noise, lag):
    weights = noise.moving_average(40)
    expected = [weights[: m + 1] @ weights[lag : lag + m + 1] for m in range(20)]
    np.testing.assert_allclose(noise.autocovariance(lag, 0, 20), expected, atol=1e-12)
    np.testing.assert_allclose(noise.autocovariance(lag, 5, 4), expected[5:9], atol=1e-12)


@pytest.mark.parametrize("noise", NOISES, ids=repr)
def test_another_size_is_the_same_noise_larger(noise):
    louder = noise.with_std(2.0 * noise.std)
    once, twice = (item.sample(50, np.random.default_rng(1)) for item in (noise, louder))
    np.testing.assert_allclose(twice, 2.0 * once, rtol=1e-12)


def test_tails_are_heavy_and_rounding_has_none():
    heavy = ev.HeavyTailedNoise(1.0, 3.0).sample(COUNT, np.random.default_rng(2))
    assert np.abs(heavy).max() > 12.0
    rounding = ev.RoundingNoise(1.0)
    assert rounding.step == pytest.approx(np.sqrt(12.0))
    assert np.abs(rounding.sample(COUNT, np.random.default_rng(2))).max() <= 0.5 * rounding.step


@pytest.mark.parametrize("coefficient", [1.0, -1.2, np.nan])
def test_a_coefficient_that_is_not_stationary(coefficient):
    with pytest.raises((ParameterError, NonFiniteError), match="coefficient"):
        ev.AutoregressiveNoise(1.0, coefficient)


@pytest.mark.parametrize("degrees", [2.0, -3.0, np.inf])
def test_tails_without_a_standard_deviation(degrees):
    with pytest.raises((ParameterError, NonFiniteError), match="degrees"):
        ev.HeavyTailedNoise(1.0, degrees)


def test_density_over_a_bandwidth_and_the_rounding_of_a_step_add_up():
    assert DataSheet(density=0.002, bandwidth_hz=50.0).std(200.0) == pytest.approx(0.002 * 50.0**0.5)
    assert DataSheet(density=0.002).std(200.0) == pytest.approx(0.02)
    assert DataSheet(step=0.12).std(1.0) == pytest.approx(0.12 / 12.0**0.5)


@pytest.mark.parametrize(
    "stated", [{}, {"density": -1.0}, {"step": float("inf")}, {"density": 1.0, "bandwidth_hz": -1.0}]
)
def test_sheets_that_say_nothing(stated):
    with pytest.raises(UsageError):
        DataSheet(**stated)


RUNS = 500


@pytest.mark.calibration
@pytest.mark.parametrize("bandwidth", [None, 1999])
@pytest.mark.parametrize("order", [-0.5, -0.4, 0.0, 0.3, 0.5])
def test_estimates_are_centred_and_their_errors_cover(order, bandwidth):
    rng = np.random.default_rng([31, int(10 * order + 10), bandwidth or 0])
    records = 1.7 * fractional_difference(rng.standard_normal((4000, RUNS)), order) + 9.81
    results = [ev.estimate_long_memory(record.copy(), bandwidth=bandwidth) for record in records.T]
    order_scores = np.array([(result.order - order) / result.order_error for result in results])
    std_scores = np.array([(result.std - 1.7) / result.std_error for result in results])
    # The periodogram's own bias is of the order of log(m)/sqrt(m): a fifth of a standard error at most.
    for scores in (order_scores, std_scores):
        assert abs(scores.mean()) < 0.2 + 4.0 / np.sqrt(RUNS)
        assert scores.std() == pytest.approx(1.0, abs=0.03 + 4.0 / np.sqrt(2.0 * RUNS))
    covered = np.mean([low <= order <= high for low, high in (result.order_interval() for result in results)])
    assert abs(covered - 0.95) < 0.01 + 3.5 * np.sqrt(0.95 * 0.05 / RUNS)


def test_errors_are_those_of_the_theory():
    values = np.random.default_rng(4).standard_normal(100_001)
    local, whole = (ev.estimate_long_memory(values, bandwidth=m) for m in (500, 50_000))
    assert local.order_error == pytest.approx(0.5 / np.sqrt(500), rel=0.04)  # ln(m)^2 / (2m) more
    assert whole.order_error == pytest.approx(np.sqrt(6.0 / np.pi**2 / values.size), rel=0.01)
    assert whole.std_error == pytest.approx(whole.std / np.sqrt(2.0 * values.size), rel=0.01)
    assert local.bandwidth == 500
    assert ev.estimate_long_memory(values).bandwidth == int(100_001**0.65)
    low, high = whole.order_interval(0.9)
    assert high - low == pytest.approx(2.0 * NormalDist().inv_cdf(0.95) * whole.order_error)


def test_noise_to_declare():
    record = fractional_difference(np.random.default_rng(3).standard_normal(2000), -0.7)
    memory = ev.estimate_long_memory(record)
    assert memory.order < -0.5
    assert memory.noise() == ev.FractionalNoise(memory.std, memory.order)


@pytest.mark.thorough
def test_a_million_samples_take_as_long_as_a_few_transforms():
    """About six, of 0.04 s each."""
    rng = np.random.default_rng(0)
    values = ev.FractionalNoise(1.0, -0.5).sample(999_983, rng)  # a prime: the FFT's worst case
    memory = ev.estimate_long_memory(values)
    assert in_transforms(lambda: ev.estimate_long_memory(values), values.size) < 20.0
    assert abs(memory.order + 0.5) < 5.0 * memory.order_error


@pytest.mark.parametrize(
    ("values", "options", "error", "said"),
    [
        (np.arange(10.0), {}, TooFewSamplesError, "Expected 17 samples or more; received 10"),
        (np.full(100, 3.3), {}, ParameterError, "a record that varies; received a constant one"),
        (np.zeros(100), {}, ParameterError, "a record that varies; received a constant one"),
        (np.full(100, np.nan), {}, NonFiniteError, "finite values; received NaN"),
        (
            np.arange(100.0),
            {"bandwidth": 50},
            ParameterError,
            "from 8 to 49 frequencies; received bandwidth=50",
        ),
        (
            np.arange(100.0),
            {"bandwidth": 3},
            ParameterError,
            "from 8 to 49 frequencies; received bandwidth=3",
        ),
    ],
)
def test_records_that_tell_nothing(values, options, error, said):
    with pytest.raises(error, match=said):
        ev.estimate_long_memory(values, **options)


def test_level_is_a_probability():
    with pytest.raises(ParameterError, match=r"a level between 0 and 1; received level=95"):
        ev.estimate_long_memory(np.arange(100.0) % 7).order_interval(95.0)


# Fractional differences against direct summation and against their own inverse.


@given(order=st.floats(-2.0, 2.0), count=st.integers(1, 60), seed=st.integers(0, 1000))
def test_fft_is_the_direct_sum(order, count, seed):
    values = np.random.default_rng(seed).standard_normal((count, 2))
    weights = fractional_weights(order, count)
    direct = np.stack([np.convolve(weights, column)[:count] for column in values.T], axis=1)
    scale = 1.0 + np.abs(direct).max()
    np.testing.assert_allclose(
        fractional_difference(values, order), direct, rtol=0.0, atol=1e-13 * count * scale
    )


@pytest.mark.parametrize("order", [-1.3, -0.5, 0.25, 0.5, 1.7])
def test_weights_are_signed_binomials(order):
    lags = np.arange(20)
    np.testing.assert_allclose(fractional_weights(order, 20), (-1.0) ** lags * binom(order, lags), rtol=1e-10)


def test_integer_orders_are_differences_and_sums_with_zeros_before():
    values = np.random.default_rng(1).standard_normal(30)
    np.testing.assert_allclose(fractional_difference(values, 0.0), values, atol=1e-13)
    np.testing.assert_allclose(fractional_difference(values, 1.0), np.diff(values, prepend=0.0), atol=1e-13)
    np.testing.assert_allclose(fractional_difference(values, -1.0), np.cumsum(values), atol=1e-12)


@pytest.mark.thorough
def test_a_million_samples_are_differenced_by_a_few_transforms():
    """About four; direct summation takes as long as a hundred thousand. One is 0.04 s."""
    values = np.random.default_rng(3).standard_normal(999_983)  # a prime: the FFT's worst case
    difference = fractional_difference(values, -0.5)
    assert in_transforms(lambda: fractional_difference(values, -0.5), values.size) < 15.0
    # The last sample, by direct summation over the whole record.
    direct = fractional_weights(-0.5, values.size) @ values[::-1]
    assert difference[-1] == pytest.approx(direct, rel=1e-10)
