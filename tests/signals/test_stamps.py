"""Stamps that err are evened; every other kind of stamps stays as it is."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.logs.common import channel_findings
from eivor.signals.filters import evened
from eivor.signals.recording import clean_channel


def erring(step_s: float, error_s: float, seconds: float = 40.0):
    """Even times, and stamps of them that err."""
    even = np.arange(0.0, seconds, step_s)
    return even, even + error_s * np.random.default_rng(5).standard_normal(even.size)


@pytest.mark.parametrize(("step_s", "error_s"), [(0.004, 0.004), (0.004, 0.002), (0.010, 0.004)])
def test_stamps_that_err_are_evened_and_none_is_lost(step_s, error_s):
    even, stamps = erring(step_s, error_s)
    channel = clean_channel("velocity_z", stamps, np.sin(even), "m/s")
    assert channel.values.size == even.size
    assert channel.quality.evened_stamps == even.size
    assert channel.quality.backward_stamps == 0
    away = channel.time_s - even
    assert away.mean() == pytest.approx((stamps - even).mean(), abs=0.02 * error_s)
    assert away.std() < 0.2 * error_s
    # those that do not go back are late
    kept = stamps == np.maximum.accumulate(stamps)
    assert (stamps - even)[kept].mean() > (stamps - even).mean() + 0.05 * error_s


def test_it_is_said():
    even, stamps = erring(0.004, 0.004)
    channel = clean_channel("velocity_z", stamps, np.sin(even), "m/s")
    (findings,) = channel_findings({"velocity_z": channel})
    assert findings.name == "time_stamps"
    assert "evened: velocity_z 10000" in findings.message


def test_a_pause_stays():
    even, stamps = erring(0.004, 0.004)
    result = evened(stamps + np.where(even > 20.0, 3.0, 0.0))
    assert np.diff(result).max() == pytest.approx(3.0, abs=0.02)


def test_stamps_that_are_in_order_stay_however_uneven():
    stamps = np.cumsum(np.random.default_rng(6).uniform(0.001, 0.02, 2000))
    assert evened(stamps) is stamps


def test_a_few_slips_and_a_clock_that_was_set_stay():
    slips = 0.01 * np.arange(4000)
    slips[[1000, 3000]] -= 0.03
    assert evened(slips) is slips
    was_set = 0.01 * np.arange(4000) - np.where(np.arange(4000) > 2000, 5.0, 0.0)
    assert evened(was_set) is was_set
    again_and_again = 0.01 * (np.arange(4000) % 100)
    assert evened(again_and_again) is again_and_again


def test_a_repeated_stamp_is_no_error():
    stamps = np.repeat(0.01 * np.arange(1000), 2)
    assert evened(stamps) is stamps
