"""Excitations: their peaks, their bands, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.errors import ParameterError
from eivor.simulation.excitation import (
    Chirp,
    FilteredWhite,
    GivenSeries,
    Multisine,
    PaperInput,
    PseudoRandomBinary,
    RandomSteps,
    ScaledExcitation,
    SteppedExcitation,
    WhiteExcitation,
    maximal_sequence,
)

STEP_S = 0.2


def rng(seed=1):
    return np.random.default_rng(seed)


def sampled(excitation, count=4000, seed=1):
    return excitation.sample(count, STEP_S, rng(seed))


def power_outside(series, low_hz, high_hz):
    """Share of the power outside a band."""
    power = np.abs(np.fft.rfft(series)) ** 2
    frequencies = np.fft.rfftfreq(series.size, STEP_S)
    inside = (frequencies > low_hz - 1e-9) & (frequencies < high_hz + 1e-9)
    return float(power[~inside].sum() / power.sum())


def test_paper_input_is_its_equation():
    count = 30
    w = np.sqrt(0.02) * rng().standard_normal(count + 2)
    t = STEP_S * np.arange(count)
    expected = [0.7 * w[k + 1] + 0.49 * w[k] + np.sin(0.1 * t[k] ** 1.1) for k in range(count)]
    np.testing.assert_allclose(sampled(PaperInput(), count), expected, atol=1e-14)


def test_filtered_white_keeps_to_its_band():
    series = sampled(FilteredWhite(0.5, 0.1, 1.5))
    assert power_outside(series, 0.1, 1.5) < 1e-25
    variances = [sampled(FilteredWhite(0.5, 0.1, 1.5), 500, seed).var() for seed in range(400)]
    assert np.mean(variances) == pytest.approx(0.25, rel=4.5 * np.std(variances) / 0.25 / 20)


def test_multisine_is_flat_in_its_band_and_low_in_its_peak():
    series = sampled(Multisine(0.5, 0.05, 1.0))
    assert series.std() == pytest.approx(0.5, rel=1e-12)
    assert power_outside(series, 0.05, 1.0) < 1e-25
    power = np.abs(np.fft.rfft(series))
    frequencies = np.fft.rfftfreq(4000, STEP_S)
    inside = (frequencies > 0.05 - 1e-9) & (frequencies < 1.0 + 1e-9)
    np.testing.assert_allclose(power[inside], power[inside].mean(), rtol=1e-9)
    assert np.abs(series).max() / series.std() < 1.9
    random_phases = np.fft.irfft(np.where(inside, np.exp(2j * np.pi * rng().random(inside.size)), 0.0))
    assert np.abs(random_phases).max() / random_phases.std() > 3.0


@pytest.mark.parametrize("register", range(2, 17))
def test_binary_sequence_is_maximal(register):
    """Autocorrelation: the period at shift zero and -1 at every other one."""
    period = maximal_sequence(register)
    assert period.size == 2**register - 1
    correlation = np.fft.irfft(np.abs(np.fft.rfft(period)) ** 2, period.size)
    assert correlation[0] == pytest.approx(period.size)
    np.testing.assert_allclose(correlation[1:], -1.0, atol=1e-6)


def test_given_series_is_the_users():
    np.testing.assert_array_equal(sampled(GivenSeries((1.0, 2.0, 3.0)), 2), [1.0, 2.0])
    with pytest.raises(ParameterError, match=r"a series of 4 values or more.*received 3"):
        sampled(GivenSeries((1.0, 2.0, 3.0)), 4)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: WhiteExcitation(float("nan")), "a finite std"),
        (
            lambda: sampled(FilteredWhite(1.0, 0.1, 2.5)),
            "ends below half the rate; received high_hz=2.5 at 5 Hz",
        ),
        (lambda: sampled(Chirp(1.0, 0.1, 3.0)), "ends below half the rate"),
        (lambda: sampled(Multisine(1.0, 0.1001, 0.1002), 50), "holds a multiple of 0.1 Hz"),
        (lambda: PseudoRandomBinary(1.0, 5, 0), "hold of 1 or more"),
        (lambda: RandomSteps(0.2, 2.0, 1.0), "a shortest_s up to longest_s"),
        (lambda: SteppedExcitation((1.0,), 0.0), "a finite dwell_s above zero"),
        (lambda: GivenSeries((1.0, float("inf"))), "a finite value"),
        (lambda: ScaledExcitation(PaperInput(), -1.0), "a finite std of zero or more"),
    ],
)
def test_impossible_excitations_are_refused(make, said):
    with pytest.raises(ParameterError, match=f"Expected .*{said}"):
        make()


#: Relative tolerance of K and of K_u.
EXACT, SPECTRAL = 1e-6, 0.015
