"""An onboard low-pass on the grid, against the transfer function that it is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lsim

from eivor.signals.filters import low_passed


@pytest.mark.parametrize(("step_s", "cutoff_hz"), [(0.002, 80.0), (0.01, 80.0), (0.005, 30.0)])
def test_lines_between_samples_are_filtered_exactly_also_beyond_half_the_grids_rate(step_s, cutoff_hz):
    time = step_s * np.arange(300)
    series = np.cos(2.0 * np.pi * 3.0 * time) + time
    omega = 2.0 * np.pi * cutoff_hz
    # from rest, so that the constant that the filter has seen for ever is taken off
    _, expected, _ = lsim(([omega**2], [1.0, np.sqrt(2.0) * omega, omega**2]), series - series[0], time)
    result = low_passed(series[:, None], step_s=step_s, cutoff_hz=cutoff_hz)[:, 0]
    np.testing.assert_allclose(result, expected + series[0], atol=1e-12)


def test_slow_series_are_late_by_the_filters_delay():
    time = 0.002 * np.arange(500)
    ramps = np.column_stack([time, -2.0 * time])
    passed = low_passed(ramps, step_s=0.002, cutoff_hz=30.0)
    late_s = np.sqrt(2.0) / (2.0 * np.pi * 30.0)
    np.testing.assert_allclose(passed[100:], np.outer(time - late_s, [1.0, -2.0])[100:], atol=1e-9)
