"""Runs in frequency: there and back, Parseval's sums, the edges of the band, smoothing by a plain loop."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eivor.models.regression import Parameter
from eivor.models.spectral import BinRows, SpectralRegression, SpectralRun

LENGTHS = st.integers(60, 900)


@given(length=LENGTHS, seed=st.integers(0, 99))
def test_series_and_spectrum_are_inverse_on_the_bins_kept(length, seed):
    run = SpectralRun(0, length, 0.01, (0.04, 5.0))
    rng = np.random.default_rng(seed)
    spectrum = rng.standard_normal((run.count, 2)) + 1j * rng.standard_normal((run.count, 2))
    series = run.series(spectrum)
    again = np.fft.rfft(series, axis=0)[run.bins] / np.sqrt(length)
    np.testing.assert_allclose(again, spectrum, atol=1e-12)
    # A sinusoid of the band keeps its power: the FFT is unitary.
    assert np.sum(series**2) == pytest.approx(2.0 * np.sum(np.abs(spectrum) ** 2))


@given(lengths=st.lists(LENGTHS, min_size=1, max_size=3), seed=st.integers(0, 99))
def test_scores_add_up_to_the_products_of_rows(lengths, seed):
    rows = BinRows(tuple(SpectralRun(i, n, 0.01, (0.04, 5.0)) for i, n in enumerate(lengths)))
    total = sum(2 * run.count for run in rows.runs)
    rng = np.random.default_rng(seed)
    test, residual = rng.standard_normal((total, 3)), rng.standard_normal(total)
    scores = rows.scores(test, residual)
    assert scores.shape == (sum(lengths), 3)
    np.testing.assert_allclose(scores.sum(axis=0), test.T @ residual, atol=1e-10)
    # Also run by run, so that clusters of flights add up.
    first = lengths[0]
    np.testing.assert_allclose(
        scores[:first].sum(axis=0),
        test[rows.flight_of_row == 0].T @ residual[rows.flight_of_row == 0],
        atol=1e-10,
    )


@given(lengths=st.lists(LENGTHS, min_size=1, max_size=3), seed=st.integers(0, 99))
def test_stacked_rows_are_taken_apart_again(lengths, seed):
    layout = BinRows(tuple(SpectralRun(i, n, 0.01, (0.04, 5.0)) for i, n in enumerate(lengths)))
    bins = sum(run.count for run in layout.runs)
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((bins, 2)) + 1j * rng.standard_normal((bins, 2))
    np.testing.assert_array_equal(np.concatenate(layout.complex_blocks(layout.stacked(columns))), columns)


@pytest.mark.parametrize("length", [300, 301, 1000, 6000, 6001])
@pytest.mark.parametrize("step_s", [0.01, 0.005, 0.1])
def test_band_keeps_every_frequency_inside_and_none_outside(length, step_s):
    run = SpectralRun(0, length, step_s, (0.04, 5.0))
    every = np.fft.rfftfreq(length, step_s)
    low = max(0.04, 1.5 / (length * step_s))
    # The Nyquist bin of an even length is real: it has no imaginary row.
    nyquist = 0.5 / step_s
    inside = (every >= low * (1 - 1e-12)) & (every <= 5.0 * (1 + 1e-12)) & (every < nyquist * (1 - 1e-12))
    np.testing.assert_allclose(run.frequency_hz, every[inside], rtol=1e-12)
    assert run.count == inside.sum()


def test_band_without_a_bin_is_empty():
    run = SpectralRun(0, 20, 0.01, (0.04, 5.0))
    assert run.count == 0
    assert run.spectrum(np.random.default_rng(0).standard_normal((20, 2))).shape == (0, 2)


@pytest.mark.parametrize("length", [300, 1000, 6001])
def test_smoothing_is_the_mean_over_a_share_of_the_frequency(length):
    run = SpectralRun(0, length, 0.01, (0.04, 5.0))
    values = np.random.default_rng(1).exponential(size=(run.count, 2))
    index = np.arange(run.bins.start, run.bins.stop)
    naive = np.empty_like(values)
    for position, k in enumerate(index):
        half = max(10, int(0.3 * k))
        near = np.abs(index - k) <= half
        naive[position] = values[near].mean(axis=0)
    np.testing.assert_allclose(run.smoothed(values), naive, rtol=1e-10)


def test_spectrum_forgets_an_offset_and_keeps_a_sinusoid():
    run = SpectralRun(0, 2000, 0.01, (0.04, 5.0))
    time = 0.01 * np.arange(2000)
    wave = np.sin(2.0 * np.pi * 1.0 * time)[:, None]
    np.testing.assert_allclose(run.spectrum(wave + 100.0), run.spectrum(wave), atol=1e-10)
    power = np.abs(run.spectrum(wave)[:, 0]) ** 2
    assert run.frequency_hz[np.argmax(power)] == pytest.approx(1.0)
    # Half of the tapered series' energy is at positive frequencies, and the line holds nearly all of it.
    energy = np.sum((wave[:, 0] * run.taper) ** 2)
    assert power.sum() == pytest.approx(0.5 * energy, rel=1e-3)
    np.testing.assert_array_equal(run.taper, run.taper[::-1])
    assert (run.taper == 1.0).sum() == 2000 - 2 * 100


def test_whitening_divides_every_column_and_blends_the_responses():
    run = SpectralRun(0, 400, 0.01, (0.04, 5.0))
    rng = np.random.default_rng(2)
    parts = rng.standard_normal((run.count, 4)) + 1j * rng.standard_normal((run.count, 4))
    layout = BinRows((run,))
    bins = SpectralRegression(
        parts[:, :2], parts[:, 2:], parts[:, :0], (Parameter("a"), Parameter("b")), layout
    )
    blend, power = rng.uniform(0.0, 1.0, run.count), rng.uniform(0.5, 2.0, run.count)
    theta = np.array([0.7, -0.3])
    rows = bins.whitened(blend, power, np.empty((2 * run.count, 0)))
    item, other = bins.residuals(theta).T
    wanted = ((1.0 - blend) * item + blend * other) / np.sqrt(power)
    np.testing.assert_allclose(
        rows.response - rows.regressors @ theta, np.concatenate([wanted.real, wanted.imag]), atol=1e-12
    )
