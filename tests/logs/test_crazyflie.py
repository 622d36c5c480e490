"""Crazyflie microSD logs: both versions, several types of events, and whatever is wrong with a file."""

import re
import struct

import numpy as np
import pytest
from dataflash_writer import told
from scipy.spatial.transform import Rotation
from usd_writer import fixed, flight, with_checksum

G = 9.80665


def test_delays_of_the_firmware_s_filters_are_taken_off(read):
    r = read(flight())
    force, rate = r.channels["specific_force_body_z"], r.channels["angular_rate_y"]
    assert force.delay_s == pytest.approx(np.sqrt(2.0) / (2.0 * np.pi * 30.0))
    np.testing.assert_allclose(force.time_s, 0.01 * np.arange(200) - force.delay_s, atol=1e-9)
    assert rate.time_s[0] == pytest.approx(-np.sqrt(2.0) / (2.0 * np.pi * 80.0))
    reported = told(r, "sensor_delay")
    assert "acc.z: 7.5 ms (low-pass of 30 Hz); gyro.y: 2.8 ms (low-pass of 80 Hz)" in reported


def one_row(read, variables):
    """Values of channels of three equal rows, and the recording."""
    r = read(fixed(2, [f"{name}(f)" for name in variables], [list(variables.values())] * 3))
    return {name: channel.values[0] for name, channel in r.channels.items()}, r


#: Variables, and what is made of each.
ROWS = [
    {
        "acc.x": (0.5, "specific_force_body_x", 0.5 * G),
        "gyro.y": (180.0, "angular_rate_y", np.pi),
        "stateEstimate.z": (1.5, "position_z", 1.5),
        "stateEstimate.az": (0.25, "acceleration_z", 0.25 * G),
        "motor.m1": (65535.0, "rotor_command_1", 1.0),
        "rpm.m1": (3000.0, "rotor_speed_1", 100.0 * np.pi),
        "pm.vbatMV": (3900.0, "battery_voltage", 3.9),
        "ctrltarget.z": (1.25, "reference_position_z", 1.25),
        "posCtl.targetVZ": (0.75, "feedback_reference_velocity_z", 0.75),
        "stabilizer.thrust": (32767.5, "input", 0.5),
    },
    {  # the compressed state
        "stateEstimateZ.z": (1500.0, "position_z", 1.5),
        "stateEstimateZ.vx": (-250.0, "velocity_x", -0.25),
        "stateEstimateZ.az": (9806.65, "specific_force_z", G),
        "stateEstimateZ.ratePitch": (2000.0, "angular_rate_y", -2.0),
        "ctrltargetZ.az": (500.0, "reference_acceleration_z", 0.5),
    },
]


@pytest.mark.parametrize("row", ROWS)
def test_units_and_signs(read, row):
    values, r = one_row(read, {name: logged for name, (logged, *_) in row.items()})
    assert values == pytest.approx({name: value for _, name, value in row.values()})
    if "acc.x" in row:
        estimated = {name for name, channel in r.channels.items() if channel.estimated}
        assert estimated == {"position_z", "acceleration_z"}


def test_the_pitch_of_the_angles_is_negated(read):
    angles = {"stabilizer.roll": 20.0, "stabilizer.pitch": -30.0, "stabilizer.yaw": 40.0}
    values, _ = one_row(read, angles)
    expected = Rotation.from_euler("ZYX", [40.0, 30.0, 20.0], degrees=True).as_quat(scalar_first=True)
    assert [values[f"attitude_{part}"] for part in "wxyz"] == pytest.approx(expected, abs=1e-7)
    del angles["stabilizer.yaw"]
    values, _ = one_row(read, angles)
    assert values == pytest.approx({"cos_tilt": np.cos(np.pi / 9.0) * np.cos(np.pi / 6.0)}, abs=1e-7)


def test_the_preferred_source_comes_first_and_zeros_are_none(read):
    zeros = dict.fromkeys(("stateEstimate.vz", "rpm.m1", "motor.m1"), 0.0)
    values, r = one_row(read, {"stateEstimateZ.vz": 200.0, **zeros, "baro.asl": 3.0})
    assert values == pytest.approx({"velocity_z": 0.2, "rotor_command_1": 0.0})
    assert told(r, "never_valid") == "Logged as zero throughout: 'stateEstimate.vz', 'rpm.m1'."
    assert "'baro.asl'" in told(r, "ignored_columns")
    values, _ = one_row(read, {"stateEstimateZ.vz": 200.0, "stateEstimate.vz": 0.5})
    assert values == pytest.approx({"velocity_z": 0.5})


def packed(quaternion):
    """A quaternion x, y, z, w in 32 bits, by the rule of the firmware in plain Python."""
    largest = max(range(4), key=lambda item: abs(quaternion[item]))
    negated = quaternion[largest] < 0
    bits = largest
    for index in range(4):
        if index != largest:
            size = int(511 * abs(quaternion[index]) / np.sqrt(0.5) + 0.5)
            bits = bits << 10 | ((quaternion[index] < 0) ^ negated) << 9 | size
    return bits


def test_packed_quaternions(read):
    quaternions = np.random.default_rng(0).normal(size=(50, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1)[:, None]
    rows = [[packed(q)] for q in quaternions]
    c = read(fixed(2, ["stateEstimateZ.quat(I)"], rows)).channels
    got = np.column_stack([c[f"attitude_{part}"].values for part in "xyzw"])
    np.testing.assert_allclose(np.abs(np.sum(got * quaternions, axis=1)), 1.0, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(got, axis=1), 1.0)


def test_a_velocity_setpoint_that_the_position_loop_wrote_is_feedback(read):
    steps = np.repeat([0.5, 1.0, 0.5], 20)
    answers = np.random.default_rng(0).normal(size=60)
    names = ["ctrltarget.z(f)", "ctrltarget.vz(f)"]
    r = read(fixed(2, names, np.column_stack([steps, answers])))
    assert set(r.channels) == {"reference_position_z", "feedback_reference_velocity_z"}
    assert "it answers the vehicle" in told(r, "feedback_setpoint")
    t = 0.01 * np.arange(60)
    planned = np.column_stack([1.0 + 0.2 * np.sin(t), 0.2 * np.cos(t)])
    r = read(fixed(2, names, planned))
    assert set(r.channels) == {"reference_position_z", "reference_velocity_z"}


def test_a_cut_log_is_read_as_far_as_it_goes(read):
    log = flight()
    sizes = 3 * (10 + 28) + (10 + 4) + (10 + 6)  # three records, and one of each other type
    whole = log.head() + bytes(log.body[:sizes])
    r = read(whole + bytes(log.body[sizes:][:11]))
    assert r.channels["velocity_z"].values.size == 3
    assert "11 bytes at its end, of no whole record, were left out" in told(r, "truncated")
    assert "no record is broken" in told(read(whole), "truncated")


def test_a_wrong_checksum_is_told(read):
    content = bytearray(flight().bytes())
    content[-20] ^= 1
    r = read(bytes(content))
    assert r.channels["velocity_z"].values.size == 200
    assert "The checksum does not fit" in told(r, "checksum")
    assert not told(r, "truncated")


@pytest.mark.parametrize("lost", [1, 37, 100, 650])
def test_lost_bytes_cost_only_the_records_around_them(read, lost):
    log = flight()
    content = log.head() + bytes(log.body[:2000]) + bytes(log.body[2000 + lost :])
    r = read(with_checksum(content))
    assert 200 - lost / 40 - 3 <= r.channels["velocity_z"].values.size < 200
    assert r.channels["velocity_z"].time_s[-1] == pytest.approx(1.99)
    reported = told(r, "corrupt_parts") + told(r, "time_stamps")
    assert "bytes that belong to no record" in reported or "their stamp cannot be" in reported


def test_stamps_that_cannot_be(read):
    log = fixed(2, ["stateEstimate.vz(f)"], [[1.0]] * 100)
    size, start = 14, len(log.head())
    content = bytearray(log.head() + log.body)
    content[start + 40 * size + 2 + 3] += 1  # ahead by 17 s
    content[start + 50 * size + 2 + 7] += 1  # by 2000 years
    content[start + 60 * size + 2 + 2] -= 2  # back by a moment
    content[start + 2 + 3] += 1  # the first record
    r = read(with_checksum(bytes(content)))
    c = r.channels["velocity_z"]
    assert c.values.size == 96
    assert c.time_s[-1] == pytest.approx(0.98)
    first, second = (item.message for item in r.findings if item.name == "time_stamps")
    assert first.endswith("cannot be: 3.")
    assert "dropped" not in first
    assert "velocity_z 1" in second


def head(*parts):
    return b"\xbc" + b"".join(struct.pack("<H", part) if isinstance(part, int) else part for part in parts)


def test_a_search_without_end_is_given_up(read, monkeypatch):
    monkeypatch.setattr("eivor.logs.crazyflie.MAX_SEARCH_BYTES", 2048)
    log = flight()
    content = log.head() + bytes(log.body[:2000]) + b"\x37" * 8192 + bytes(log.body[2000:])
    r = read(with_checksum(content))
    assert 40 < r.channels["velocity_z"].values.size < 60
    left = int(re.search(r"(\d+) bytes", told(r, "corrupt_parts"))[1])
    assert left == pytest.approx(8192 + len(log.body) - 2000, abs=40)
