"""Noises that are neither white and normal nor fractional have the moments that they say."""

from __future__ import annotations

import numpy as np
import pytest

import eivor as ev
from eivor.errors import NonFiniteError, ParameterError
from eivor.signals.noise import MeasurementNoise

COUNT = 200_000
NOISES = [
    ev.AutoregressiveNoise(0.4, 0.9),
    ev.AutoregressiveNoise(0.4, -0.5),
    ev.HeavyTailedNoise(0.4, 5.0),
    ev.RoundingNoise(0.4),
]


@pytest.mark.parametrize("noise", NOISES, ids=repr)
@pytest.mark.parametrize("lag", [0, 1, 7])
def test_samples_have_the_autocovariance(noise: MeasurementNoise, lag: int) -> None:
    series = noise.sample(COUNT, np.random.default_rng(4))
    result = np.mean(series[: COUNT - lag] * series[lag:])
    expected = noise.autocovariance(lag, 1_000, 3)
    assert expected.shape == (3,)
    assert result == pytest.approx(expected[0], abs=0.03 * noise.std**2)


@pytest.mark.parametrize("noise", NOISES, ids=repr)
@pytest.mark.parametrize("lag", [0, 1, 3])
def test_the_moving_average_has_the_autocovariance_of_a_record_that_begins(
    noise: MeasurementNoise, lag: int
) -> None:
    weights = noise.moving_average(40)
    expected = [weights[: m + 1] @ weights[lag : lag + m + 1] for m in range(20)]
    np.testing.assert_allclose(noise.autocovariance(lag, 0, 20), expected, atol=1e-12)
    np.testing.assert_allclose(noise.autocovariance(lag, 5, 4), expected[5:9], atol=1e-12)


@pytest.mark.parametrize("noise", NOISES, ids=repr)
def test_another_size_is_the_same_noise_larger(noise: MeasurementNoise) -> None:
    louder = noise.with_std(2.0 * noise.std)
    once, twice = (item.sample(50, np.random.default_rng(1)) for item in (noise, louder))
    np.testing.assert_allclose(twice, 2.0 * once, rtol=1e-12)


def test_tails_are_heavy_and_rounding_has_none() -> None:
    heavy = ev.HeavyTailedNoise(1.0, 3.0).sample(COUNT, np.random.default_rng(2))
    assert np.abs(heavy).max() > 12.0
    rounding = ev.RoundingNoise(1.0)
    assert rounding.step == pytest.approx(np.sqrt(12.0))
    assert np.abs(rounding.sample(COUNT, np.random.default_rng(2))).max() <= 0.5 * rounding.step


@pytest.mark.parametrize("coefficient", [1.0, -1.2, np.nan])
def test_a_coefficient_that_is_not_stationary(coefficient: float) -> None:
    with pytest.raises((ParameterError, NonFiniteError), match="coefficient"):
        ev.AutoregressiveNoise(1.0, coefficient)


@pytest.mark.parametrize("degrees", [2.0, -3.0, np.inf])
def test_tails_without_a_standard_deviation(degrees: float) -> None:
    with pytest.raises((ParameterError, NonFiniteError), match="degrees"):
        ev.HeavyTailedNoise(1.0, degrees)


def test_a_random_walk_is_a_fractional_noise() -> None:
    walk = ev.FractionalNoise(1.0, -1.0).sample(100, np.random.default_rng(3))
    white = ev.WhiteNoise(1.0).sample(100, np.random.default_rng(3))
    np.testing.assert_allclose(walk, np.cumsum(white), atol=1e-9)
    with pytest.raises(NonFiniteError, match=r"between -1\.0 and 0\.5"):
        ev.FractionalNoise(1.0, -1.1)
