"""Stamps that err go to the line of those around; those that are true, or drift, stay."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.flights.timestamps import corrected_stamps, with_corrected_stamps
from eivor.signals.recording import Channel, Frame, Recording

STEP_S, ERROR_S = 0.004, 0.001


def even(seconds: float = 40.0) -> np.ndarray:
    return np.arange(0.0, seconds, STEP_S)


def erring(seed: int, error_s: float = ERROR_S) -> np.ndarray:
    """Stamps of even samples, off by so much, in their order."""
    noise = np.random.default_rng(seed).standard_normal(even().size)
    return even() + np.clip(error_s * noise, -0.45 * STEP_S, 0.45 * STEP_S)


def recording(stamps, taken, command_s) -> Recording:
    """A smooth rate with noise, and a command that is not smooth."""
    rng = np.random.default_rng(1)
    rate = Channel(
        "angular_rate_x", stamps, np.sin(5.0 * taken) + 0.01 * rng.standard_normal(taken.size), "rad/s"
    )
    command = Channel("rotor_command_1", command_s, rng.standard_normal(command_s.size), "", held=True)
    return Recording("log", "frame", {item.name: item for item in (rate, command)}, Frame.Z_UP)


def test_stamps_that_err_are_evened_those_of_commands_too():
    log = recording(erring(2), even(), erring(3))
    result, (reported,) = with_corrected_stamps(log)
    for name in log.channels:
        assert np.std(result.channel(name).time_s - even()) < 0.2 * np.std(log.channel(name).time_s - even())
        assert result.channel(name).values is log.channel(name).values
    assert reported.name == "erring_stamps"
    said_ms = float(reported.message.split("by up to ")[1].split(" ms")[0])
    assert said_ms == pytest.approx(1e3 * np.std(erring(2) - even()), rel=0.03)


def test_stamps_that_are_true_stay_and_so_do_even_ones():
    for log in (recording(erring(2), erring(2), erring(3)), recording(even(), even(), erring(3))):
        assert with_corrected_stamps(log) == (log, ())


def test_errors_that_add_up_stay():
    waits = np.cumsum(STEP_S + 0.1 * STEP_S * np.random.default_rng(4).standard_normal(5000))
    assert corrected_stamps(waits) is None
    lost = np.delete(erring(5), np.random.default_rng(6).choice(even().size, 100, replace=False))
    assert corrected_stamps(lost) is None
    # in a log whose other stamps err as well
    log = recording(erring(2), even(), waits)
    result, _ = with_corrected_stamps(log)
    assert result.channel("rotor_command_1") is log.channel("rotor_command_1")


def test_a_pause_stays():
    stamps = erring(7) + np.where(even() > 20.0, 3.0, 0.0)
    result = corrected_stamps(stamps)
    assert result is not None
    assert np.diff(result).max() == pytest.approx(3.0, abs=0.01)
    assert corrected_stamps(stamps[:20]) is None
