"""The tables that pyulog's `ulog2csv` makes of a flight are read as its ULog is."""

import bag_writer
import numpy as np
import pytest
from dataflash_writer import simulated
from pyulog.ulog2csv import convert_ulog2csv

from eivor.errors import InputError
from eivor.logs import read_log

PARAMETERS = "IMU_ACCEL_CUTOFF"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "flight_1.ulg").write_bytes(bag_writer.ulog(simulated(seed=3, duration=2.0)))
    made = tmp_path / "tables"
    made.mkdir()
    convert_ulog2csv(str(tmp_path / "flight_1.ulg"), "", str(made), ",", None, None)
    return made


def told(recording, name):
    return " ".join(finding.message for finding in recording.findings if finding.name == name)


def test_the_same_channels(folder):
    expected = read_log(folder.parent / "flight_1.ulg")
    r = read_log(folder)
    assert (r.format, r.name, r.frame, r.vehicle) == ("ulog2csv", "tables", expected.frame, "rotary wing")
    assert set(r.channels) == set(expected.channels)
    for name, channel in expected.channels.items():
        np.testing.assert_allclose(r.channels[name].time_s, channel.time_s, atol=1e-9)
        np.testing.assert_allclose(r.channels[name].values, channel.values, rtol=1e-6, atol=1e-7)
        assert r.channels[name].source == channel.source
    assert PARAMETERS in told(r, "sensor_delay")


def test_tables_that_are_damaged_or_of_another_log(folder):
    (folder / "flight_1_vehicle_attitude_0.csv").write_text("timestamp,q[0]\n1,2,3\n")
    (folder / "flight_1_vehicle_status_0.csv").write_text("timestamp,nav_state\nx,2\n")
    r = read_log(folder)
    assert "attitude_w" not in r.channels
    assert "whose line 2 has 3 fields" in told(r, "corrupt_parts")
    assert "vehicle_status" in told(r, "time_stamps")
    (folder / "other_vehicle_attitude_0.csv").write_text("timestamp,q[0]\n1,2\n")
    with pytest.raises(InputError, match="one log; received 'tables' with those of 2: flight_1, other"):
        read_log(folder)
