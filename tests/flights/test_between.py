"""Curves between stamps keep the size of what moves slowly, and trust no stamps that lie unevenly."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.flights.grid import JITTER, curve_between, line_between

STAMPS = np.arange(0.0, 20.0, 0.1)
AT = np.arange(1.0, 19.0, 0.01)


@pytest.mark.parametrize(("frequency_hz", "curve", "line"), [(0.5, 5e-4, 1e-2), (1.0, 5e-3, 4e-2)])
def test_amplitudes_are_kept(frequency_hz, curve, line):
    truth = np.sin(2.0 * np.pi * frequency_hz * AT)
    gains = [
        float(item @ truth / (truth @ truth))
        for item in (
            between(STAMPS, np.sin(2.0 * np.pi * frequency_hz * STAMPS), AT)
            for between in (curve_between, line_between)
        )
    ]
    assert abs(gains[0] - 1.0) < curve
    assert 0.5 * line < 1.0 - gains[1] < line


def test_parabolas_are_kept_between_uneven_stamps_too():
    stamps = np.cumsum(np.random.default_rng(0).uniform(0.08, 0.08 * JITTER, 200))
    index = np.linspace(stamps[3], stamps[-4], 999)
    between = curve_between(stamps, 2.0 * stamps**2 - stamps + 3.0, index)
    # the mean of two parabolas' slopes: what a parabola is between stamps
    np.testing.assert_allclose(between, 2.0 * index**2 - index + 3.0, rtol=1e-12)


def test_stamps_stand_as_they_are():
    values = np.random.default_rng(1).standard_normal(STAMPS.size)
    np.testing.assert_array_equal(curve_between(STAMPS, values, STAMPS), values)


def test_noise_of_close_stamps_tilts_nothing():
    stamps = np.sort(np.concatenate([STAMPS, STAMPS[50:150:10] + 0.001]))
    values = np.random.default_rng(2).standard_normal(stamps.size)
    between = curve_between(stamps, values, AT)
    assert np.abs(between).max() < 1.3 * np.abs(values).max()
    neighbours = (STAMPS[60] < AT) & (STAMPS[61] > AT)
    np.testing.assert_array_equal(between[neighbours], line_between(stamps, values, AT)[neighbours])
    assert (between != line_between(stamps, values, AT)).any()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_stamps_are_lines(count):
    values = np.random.default_rng(3).standard_normal(count)
    np.testing.assert_array_equal(
        curve_between(STAMPS[:count], values, AT), line_between(STAMPS[:count], values, AT)
    )


def test_numbers_near_the_largest_give_numbers():
    values = 1e308 * (-1.0) ** np.arange(STAMPS.size)
    with np.errstate(all="ignore"):
        between, line = curve_between(STAMPS, values, AT), line_between(STAMPS, values, AT)
    assert np.array_equal(np.isfinite(between), np.isfinite(line))
