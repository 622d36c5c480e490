"""Columns that are there and cannot be used: what is said of them."""

from __future__ import annotations

import numpy as np
import pytest

from eivor.errors import MissingChannelError
from eivor.logs.mapping import recording_from_columns
from eivor.motions.identify import identify_flight

TIME_S = 0.01 * np.arange(1000)
COLUMNS = {
    "time": TIME_S,
    "velocity_z": np.sin(TIME_S),
    "rotor_command_1": 0.5 + 0.1 * np.cos(TIME_S),
    "reference_velocity_z": np.sin(TIME_S),
    "specific_force_body_z": 9.8 + np.cos(TIME_S),
}


def test_a_column_without_a_number_is_said_to_be_there():
    recording = recording_from_columns(COLUMNS | {"velocity_z": np.full(1000, np.nan)})
    with pytest.raises(MissingChannelError, match="velocity_z, which is there and holds no number"):
        identify_flight(recording)


def test_a_clock_that_runs_backwards_is_named():
    recording = recording_from_columns({name: column[::-1] for name, column in COLUMNS.items()})
    with pytest.raises(MissingChannelError, match=r"999 were dropped, because their stamp .* goes backward"):
        identify_flight(recording)


def test_an_accelerometer_without_an_attitude_is_said_to_be_of_no_use():
    (results,) = (
        finding.message
        for finding in identify_flight(recording_from_columns(COLUMNS)).findings
        if finding.name == "no_accelerometer"
    )
    assert results.startswith("Without an attitude the accelerometer cannot be turned to the world's axes")
