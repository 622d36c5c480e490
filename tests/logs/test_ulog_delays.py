"""Delays of a PX4 log's topics: filters known from parameters, means, the way to the stamp."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, group_delay, iirnotch
from ulog_writer import UlogWriter

from eivor.logs import read_log
from eivor.logs.ulog.channels import topic_delays
from eivor.logs.ulog.topics import Topic

RATE_HZ = 4000.0


def topic(name: str, **fields) -> Topic:
    stamps = (1_000_000 + 4000 * np.arange(50)).astype(np.uint64)
    return Topic(name, 0, {"timestamp": stamps, **fields})


def seconds(name: str, parameters=None, **fields) -> float:
    return sum(seconds for seconds, _ in topic_delays(topic(name, **fields), parameters or {}))


def late_at_one_hertz(b, a) -> float:
    return float(group_delay((b, a), w=[1.0], fs=RATE_HZ)[1][0]) / RATE_HZ


def test_low_passes_are_late_by_their_group_delay():
    expected = late_at_one_hertz(*butter(2, 30.0, fs=RATE_HZ))
    assert seconds("vehicle_acceleration", {"IMU_ACCEL_CUTOFF": 30.0}) == pytest.approx(expected, rel=0.01)
    assert seconds("vehicle_angular_velocity", {"IMU_GYRO_CUTOFF": 30.0}) == pytest.approx(expected, rel=0.01)
    # the one's parameter says nothing of the other, and zero turns a filter off
    assert seconds("vehicle_acceleration", {"IMU_GYRO_CUTOFF": 30.0, "IMU_ACCEL_CUTOFF": 0.0}) == 0.0


@pytest.mark.parametrize("name", ["IMU_GYRO_NF0", "IMU_GYRO_NF1", "IMU_GYRO_NF"])
def test_notches_are_late_by_their_group_delay(name):
    frequency = f"{name}_FREQ" if name.endswith("NF") else f"{name}_FRQ"
    result = seconds("vehicle_angular_velocity", {frequency: 80.0, f"{name}_BW": 20.0})
    assert result == pytest.approx(late_at_one_hertz(*iirnotch(80.0, 80.0 / 20.0, fs=RATE_HZ)), rel=0.02)


@pytest.mark.parametrize("length", [np.full(50, 5000, dtype=np.uint32), np.full(50, 0.005)])
def test_a_mean_is_late_by_half_of_its_interval(length):
    cutoff = {"IMU_ACCEL_CUTOFF": 30.0}
    assert seconds("sensor_combined", cutoff, accelerometer_integral_dt=length) == pytest.approx(0.0025)


def test_what_says_when_it_was_sampled_is_late_by_the_way_to_its_stamp():
    stamps = topic("x").fields["timestamp"]
    assert seconds("vehicle_local_position", timestamp_sample=stamps - np.uint64(1400)) == pytest.approx(
        0.0014
    )
    # of another clock, or in the future: not known
    assert seconds("vehicle_local_position", timestamp_sample=stamps - np.uint64(900_000)) == 0.0
    assert seconds("vehicle_local_position", timestamp_sample=stamps + np.uint64(5000)) == 0.0
    # a setpoint is in force from when it is published
    assert seconds("vehicle_thrust_setpoint", timestamp_sample=stamps - np.uint64(1400)) == 0.0


def test_a_log_is_read_with_them(tmp_path):
    time = 0.004 * np.arange(500)
    log = UlogWriter().parameter("IMU_ACCEL_CUTOFF", 30.0)
    log.topic("vehicle_acceleration", time, xyz=np.ones((500, 3)))
    log.topic("vehicle_thrust_setpoint", time, xyz=-0.5 * np.ones((500, 3)))
    (tmp_path / "log.ulg").write_bytes(log.bytes())
    r = read_log(tmp_path / "log.ulg")
    late = np.sqrt(2.0) / (2.0 * np.pi * 30.0)
    channel = r.channels["specific_force_body_z"]
    np.testing.assert_allclose(channel.time_s, time - late, atol=1e-9)
    assert channel.delay_s == pytest.approx(late)
    np.testing.assert_allclose(r.channels["input"].time_s, time, atol=1e-9)
    (messages,) = [finding.message for finding in r.findings if finding.name == "sensor_delay"]
    assert (
        messages
        == "Taken off the stamps of vehicle_acceleration: 7.5 ms (low-pass of 30 Hz, IMU_ACCEL_CUTOFF)."
    )
