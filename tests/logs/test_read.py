"""The table of formats, and a format of somebody else in it."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import polars as pl
import pytest
from dataflash_writer import told

import eivor as ev


def test_file_names_with_glob_characters(tmp_path):
    frame = pl.DataFrame({"time": [0.0, 0.1], "velocity_z": [1.0, 2.0]})
    frame.write_csv(tmp_path / "a[1]*?.csv")
    frame.write_parquet(tmp_path / "a[1]*?.parquet")
    for name in ("a[1]*?.csv", "a[1]*?.parquet"):
        assert ev.read_log(tmp_path / name).channels["velocity_z"].values.tolist() == [1.0, 2.0]


START = datetime(2026, 5, 1, 12, tzinfo=UTC)


def test_real_logs_know_their_boards(recordings):
    """Against pyulog's own info messages, and the texts in the DataFlash log."""
    px4 = ev.read_log(recordings / "px4" / "ekf_failure.ulg")
    assert px4.origin.board == "00050000000000000000615bb0a12b3c19d7"
    assert (px4.origin.airframe, px4.origin.firmware) == ("PX4 airframe 4001", "PX4 1.15.0 beta")
    assert px4.origin.start is not None
    assert abs((px4.origin.start - datetime(2025, 2, 10, 13, 57, tzinfo=UTC)).total_seconds()) < 300.0
    assert np.median(px4.channels["air_density"].values) == pytest.approx(1.2815, abs=1e-3)
    assert np.median(px4.channels["air_temperature"].values) == pytest.approx(6.4, abs=0.5)
    apm = ev.read_log(recordings / "ardupilot" / "log_0036_mechanical_failure.bin")
    assert apm.origin.board == "00420035 33355109 33373538"
    assert (apm.origin.airframe, apm.origin.firmware) == ("ArduPilot QUAD", "APM:Copter V3.4.4-rc1")
    assert np.median(apm.channels["air_density"].values) == pytest.approx(1.158, abs=2e-3)
    crazyflie = ev.read_log(recordings / "arpl-crazyflie" / "log10").origin
    assert (crazyflie.airframe, crazyflie.board, crazyflie.firmware, crazyflie.start) == (
        "Crazyflie",
        "",
        "",
        None,
    )
    nanobench = ev.read_log(next((recordings / "nanobench").glob("*.csv")))
    assert nanobench.origin.airframe == "Crazyflie 2.1"
    assert nanobench.origin.start is not None  # its clock is that of the computer beside it


@pytest.mark.parametrize(("first", "start"), [(START.timestamp(), START), (0.0, None), (5e7, None)])
def test_tables_on_a_clock_of_the_day_know_when(read, first, start):
    rows = "".join(f"{first + 0.1 * index:.1f},{index}\n" for index in range(5))
    assert read(f"time,velocity_z\n{rows}").origin.start == start


TIME_S = 0.01 * np.arange(1000)
COLUMNS = {
    "time": TIME_S,
    "velocity_z": np.sin(TIME_S),
    "rotor_command_1": 0.5 + 0.1 * np.cos(TIME_S),
    "reference_velocity_z": np.sin(TIME_S),
    "specific_force_body_z": 9.8 + np.cos(TIME_S),
}


@pytest.mark.usefixtures("coarse_search", "unchecked_shapes")
def test_an_accelerometer_without_an_attitude_is_said_to_be_of_no_use():
    result = ev.identify_flight(ev.recording_from_columns(COLUMNS))
    assert told(result, "no_accelerometer").startswith(
        "Without an attitude the accelerometer cannot be turned"
    )


ROWS = 1000
OWN_TIME_S = 0.01 * np.arange(ROWS)
VALUES = np.sin(OWN_TIME_S)


@pytest.mark.parametrize(("rate_hz", "name"), [(5.0, "velocity_x"), (30.0, "input"), (50.0, "input")])
def test_values_that_fill_the_rows_until_the_next_are_of_a_slower_logger(rate_hz, name):
    logged = np.floor(OWN_TIME_S * rate_hz + 1e-9) / rate_hz
    constant = (logged >= 4.0) & (logged < 5.0)
    column = np.where(constant, 0.0, np.cos(3.0 * logged))
    recording = ev.recording_from_columns({"time": OWN_TIME_S, name: column, "velocity_z": VALUES})
    channel = recording.channels[name]
    assert channel.rate_hz == pytest.approx(rate_hz, rel=0.01)
    assert np.diff(channel.time_s).max() < 1.1 / rate_hz  # also while it is constant
    assert f"read at rates of their own: {name} {channel.rate_hz:.3g} Hz" in told(recording, "own_clock")


@pytest.mark.parametrize(
    "column",
    [
        np.round(VALUES, 1),
        np.round(VALUES + 0.05 * np.random.default_rng(0).standard_normal(ROWS), 1),
        np.floor(OWN_TIME_S),
        np.sign(VALUES),
    ],
    ids=["rounded", "rounded noise", "steps", "two values"],
)
def test_values_that_repeat_by_themselves_are_of_every_row(column):
    channel = ev.recording_from_columns({"time": OWN_TIME_S, "input": column}).channels["input"]
    np.testing.assert_array_equal(channel.time_s, OWN_TIME_S)


@pytest.mark.parametrize(
    "has_value",
    [
        np.arange(ROWS) % 50 != 0,  # lost now and then
        (OWN_TIME_S < 3.0) | (OWN_TIME_S > 6.0),  # not in force for a while
        np.ones(ROWS, dtype=bool),
        np.arange(ROWS) < 5,
    ],
)
def test_blanks_that_are_no_clock_stay_blanks(has_value):
    columns = {
        "time": OWN_TIME_S,
        "rotor_command_1": np.where(has_value, VALUES, np.nan),
        "velocity_z": VALUES,
    }
    recording = ev.recording_from_columns(columns)
    channel = recording.channels["rotor_command_1"]
    np.testing.assert_array_equal(channel.time_s, OWN_TIME_S)
    np.testing.assert_array_equal(np.isfinite(channel.values), has_value)
    assert not told(recording, "own_clock")
