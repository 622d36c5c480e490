"""The coarse shape of the power of differences, and what means are worth that know it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eivor.estimation.weighting.whitening import residual_spectrum
from eivor.models.equation import Parameter
from eivor.models.rising_power import rising_power
from eivor.models.spectral import BinRows, SpectralRegression, SpectralRun

RUN = SpectralRun(0, 3000, 0.01, (0.05, 20.0), differenced=True)
FREQUENCY = RUN.frequency_hz


@given(level=st.floats(0.0, 1e3), rise=st.floats(0.0, 1e3))
def test_a_shape_without_noise_is_found_exactly(level, rise):
    power = level + rise * FREQUENCY**2
    if power.any():
        np.testing.assert_allclose(rising_power(FREQUENCY, power), power, rtol=1e-6)
    else:
        np.testing.assert_array_equal(rising_power(FREQUENCY, power), 1.0)


def test_a_shape_is_found_from_powers_that_scatter_as_those_of_noise_do():
    shape = 0.04 + FREQUENCY**2
    found = [rising_power(FREQUENCY, shape * rng.exponential(size=shape.size)) for rng in generators(200)]
    np.testing.assert_allclose(np.mean(found, axis=0), shape, rtol=0.05)
    assert np.all(np.std(found, axis=0) < 0.5 * shape)


def test_power_that_falls_has_the_shape_of_its_mean():
    np.testing.assert_allclose(rising_power(FREQUENCY, 1.0 / FREQUENCY), np.mean(1.0 / FREQUENCY))


@pytest.mark.parametrize("differenced", [True, False])
def test_power_at_the_lower_end_of_a_band_is_told_as_large_as_it_is(differenced):
    run = SpectralRun(0, 3000, 0.01, (0.05, 20.0), differenced=differenced)
    shape = 0.001 + FREQUENCY**2
    bins = SpectralRegression(
        np.empty((run.count, 1), complex),
        np.empty((run.count, 1), complex),
        np.empty((run.count, 0), complex),
        (Parameter("a", ""),),
        BinRows((run,)),
    )
    powers = []
    for rng in generators(200):
        noise = (rng.standard_normal(run.count) + 1j * rng.standard_normal(run.count)) * np.sqrt(shape / 2)
        powers.append(residual_spectrum(bins, noise[:, None])[1])
    ratio = np.mean(powers, axis=0) / shape
    low, middle = FREQUENCY < 0.3, (FREQUENCY > 2.0) & (FREQUENCY < 14.0)
    assert np.abs(ratio[middle] - 1.0).max() < 0.1
    if differenced:
        assert np.abs(ratio[low] - 1.0).max() < 0.25
    else:  # ten bins to each side tell it several times too large
        assert ratio[low].max() > 5.0


def generators(count: int) -> list[np.random.Generator]:
    """As many, each with a seed of its own."""
    return [np.random.default_rng(seed) for seed in range(count)]
