"""Which machine wrote a log, with what, and when."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

import eivor as ev
from eivor.errors import UsageError
from eivor.logs import read_log
from eivor.logs.table.columnar import write_recording
from eivor.logs.ulog.topics import _release
from eivor.signals.recording import LogOrigin, utc_time

START = datetime(2026, 5, 1, 12, tzinfo=UTC)


def test_real_logs_know_their_boards(recordings):
    """Against pyulog's own info messages, and the texts in the DataFlash log."""
    px4 = read_log(recordings / "px4" / "ekf_failure.ulg")
    assert px4.origin == LogOrigin(
        "00050000000000000000615bb0a12b3c19d7",
        "PX4 airframe 4001",
        f"PX4 {_release(17760384)}",
        px4.origin.start,
    )
    assert px4.origin.start is not None
    assert abs((px4.origin.start - datetime(2025, 2, 10, 13, 57, tzinfo=UTC)).total_seconds()) < 300.0
    assert np.median(px4.channels["air_density"].values) == pytest.approx(1.2815, abs=1e-3)
    assert np.median(px4.channels["air_temperature"].values) == pytest.approx(6.4, abs=0.5)
    apm = read_log(recordings / "ardupilot" / "log_0036_mechanical_failure.bin")
    assert apm.origin.board == "00420035 33355109 33373538"
    assert (apm.origin.airframe, apm.origin.firmware) == ("ArduPilot QUAD", "APM:Copter V3.4.4-rc1")
    assert np.median(apm.channels["air_density"].values) == pytest.approx(1.158, abs=2e-3)
    assert read_log(recordings / "arpl-crazyflie" / "log10").origin == LogOrigin(airframe="Crazyflie")
    nanobench = read_log(next((recordings / "nanobench").glob("*.csv")))
    assert nanobench.origin.airframe == "Crazyflie 2.1"
    assert nanobench.origin.start is not None  # its clock is that of the computer beside it


def test_versions_of_px4():
    assert _release(0x010F01FF) == "1.15.1"
    assert _release(0x010F0080) == "1.15.0 beta"
    assert _release(0x01100000) == "1.16.0 development"


@pytest.mark.parametrize(
    ("seconds", "told"),
    [(START.timestamp(), START), (0.0, None), (12.5, None), (1e12, None), (1e30, None), (float("nan"), None)],
)
def test_clocks_that_were_never_set_tell_no_time(seconds, told):
    assert utc_time(seconds) == told


@pytest.mark.parametrize(("first", "start"), [(START.timestamp(), START), (0.0, None), (5e7, None)])
def test_tables_on_a_clock_of_the_day_know_when(tmp_path, first, start):
    path = tmp_path / "log.csv"
    rows = "".join(f"{first + 0.1 * index:.1f},{index}\n" for index in range(5))
    path.write_text(f"time,velocity_z\n{rows}")
    assert read_log(path).origin.start == start


@pytest.mark.thorough
def test_a_written_recording_keeps_its_origin(tmp_path):
    log = ev.recording_from_columns({"time": np.arange(5.0), "velocity_z": np.ones(5)})
    for origin in (LogOrigin("N1", "quad", "PX4 1.15.0", START), LogOrigin()):
        write_recording(replace(log, origin=origin), tmp_path / "log.parquet")
        assert read_log(tmp_path / "log.parquet").origin == origin


@pytest.mark.usefixtures("unchecked_shapes")
def test_what_is_no_origin_is_told():
    with pytest.raises(UsageError, match="a datetime"):
        LogOrigin(start="2026")
