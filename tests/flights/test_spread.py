"""What lines between stamps do to one side of an equation is done to the other."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.flights.grid import Grid
from eivor.flights.prepared import triangle_mean

GRID = Grid(0.0, 0.005, (range(4000),))


@pytest.mark.parametrize("frequency_hz", [1.0, 4.0, 8.0])
def test_amplitudes_shrink_as_those_of_a_line_between_stamps(frequency_hz):
    time, width_s = GRID.time_s, 0.02
    series = np.sin(2.0 * np.pi * frequency_hz * time)
    # the line between samples that are as far apart, with every phase of the samples
    lines = np.mean(
        [
            np.interp(time, stamps, np.sin(2.0 * np.pi * frequency_hz * stamps))
            for stamps in (np.arange(-0.1, 20.1, width_s) + shift for shift in np.arange(0.0, width_s, 0.001))
        ],
        axis=0,
    )
    inside = slice(100, -100)
    spread = triangle_mean(series, GRID, width_s)
    gains = [
        float(item[inside] @ series[inside] / (series[inside] @ series[inside])) for item in (spread, lines)
    ]
    assert gains[0] == pytest.approx(gains[1], abs=6e-3)
    assert gains[0] < 1.0


def test_pieces_are_spread_each_by_itself():
    grid = Grid(0.0, 0.005, (range(10), range(1000, 1010)))
    values = np.concatenate([np.zeros(10), np.ones(10)])
    np.testing.assert_allclose(triangle_mean(values, grid, 0.02), values)


def test_what_is_as_quick_as_the_grid_stays():
    values = np.random.default_rng(0).standard_normal(GRID.count)
    assert triangle_mean(values, GRID, 0.005) is values
