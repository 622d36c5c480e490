"""Columns of joined tables, which have values in some of the rows only."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.logs.mapping import recording_from_columns

ROWS = 1000
TIME_S = 0.01 * np.arange(ROWS)
VALUES = np.sin(TIME_S)


def joined(*, has_value: np.ndarray, name: str = "rotor_command_1"):
    column = np.where(has_value, VALUES, np.nan)
    return recording_from_columns({"time": TIME_S, name: column, "velocity_z": VALUES})


def found(recording) -> list[str]:
    return [finding.message for finding in recording.findings if finding.name == "own_clock"]


@pytest.mark.parametrize("every", [2, 5, 20])
def test_a_column_of_a_slower_topic_has_its_own_rate(every):
    recording = joined(has_value=np.arange(ROWS) % every == 1)
    channel = recording.channels["rotor_command_1"]
    np.testing.assert_array_equal(channel.time_s, TIME_S[1::every])
    np.testing.assert_array_equal(channel.values, VALUES[1::every])
    assert channel.rate_hz == pytest.approx(100.0 / every)
    assert channel.quality.missing_values == 0
    (message,) = found(recording)
    assert message.endswith(f"read at rates of their own: rotor_command_1 {100 / every:.3g} Hz.")


def test_a_setpoint_that_is_not_in_force_for_a_while_stays_so():
    slow = np.arange(ROWS) % 10 == 0
    gone = (TIME_S > 4.0) & (TIME_S < 7.0)
    channel = joined(has_value=slow & ~gone, name="reference_position_z").channels["reference_position_z"]
    silent_s = channel.time_s[np.isnan(channel.values)]
    np.testing.assert_allclose(silent_s, [5.0])


@pytest.mark.parametrize(
    "has_value",
    [
        np.arange(ROWS) % 50 != 0,  # lost now and then
        (TIME_S < 3.0) | (TIME_S > 6.0),  # not in force for a while
        np.ones(ROWS, dtype=bool),
        np.arange(ROWS) < 5,
    ],
)
def test_blanks_that_are_no_clock_stay_blanks(has_value):
    recording = joined(has_value=has_value)
    channel = recording.channels["rotor_command_1"]
    np.testing.assert_array_equal(channel.time_s, TIME_S)
    np.testing.assert_array_equal(np.isfinite(channel.values), has_value)
    assert not found(recording)
