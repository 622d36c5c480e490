"""Crazyflie microSD logs: both versions, several types of events, and whatever is wrong with a file."""

import re
import struct
from pathlib import Path

import numpy as np
import pytest
from usd_writer import UsdLog, fixed, flight, with_checksum

import eivor as ev
from eivor.errors import ChannelMapError, CorruptLogError, EmptyLogError

G = 9.80665


def read(tmp_path, content, **options):
    path = Path(tmp_path) / "log07"
    path.write_bytes(content.bytes() if isinstance(content, UsdLog) else content)
    return ev.read_log(path, **options)


def messages(recording, name):
    return [finding.message for finding in recording.findings if finding.name == name]


def test_delays_of_the_firmware_s_filters_are_taken_off(tmp_path):
    r = read(tmp_path, flight())
    force, rate = r.channels["specific_force_body_z"], r.channels["angular_rate_y"]
    assert force.delay_s == pytest.approx(np.sqrt(2.0) / (2.0 * np.pi * 30.0))
    np.testing.assert_allclose(force.time_s, 0.01 * np.arange(200) - force.delay_s, atol=1e-9)
    assert rate.time_s[0] == pytest.approx(-np.sqrt(2.0) / (2.0 * np.pi * 80.0))
    (reported,) = messages(r, "sensor_delay")
    assert "acc.z: 7.5 ms (low-pass of 30 Hz); gyro.y: 2.8 ms (low-pass of 80 Hz)" in reported


def one_row(tmp_path, **variables):
    """Channels of three equal rows."""
    names = [name.replace("__", ".") for name in variables]
    r = read(tmp_path, fixed(2, [f"{name}(f)" for name in names], [list(variables.values())] * 3))
    return {name: channel.values[0] for name, channel in r.channels.items()}, r


def test_units_and_signs(tmp_path):
    values, r = one_row(
        tmp_path,
        acc__x=0.5,
        gyro__y=180.0,
        stateEstimate__z=1.5,
        stateEstimate__az=0.25,
        motor__m1=65535.0,
        rpm__m1=3000.0,
        pm__vbatMV=3900.0,
        ctrltarget__z=1.25,
        posCtl__targetVZ=0.75,
        stabilizer__thrust=32767.5,
    )
    assert values == pytest.approx(
        {
            "specific_force_body_x": 0.5 * G,
            "angular_rate_y": np.pi,
            "position_z": 1.5,
            "acceleration_z": 0.25 * G,
            "rotor_command_1": 1.0,
            "rotor_speed_1": 100.0 * np.pi,
            "battery_voltage": 3.9,
            "reference_position_z": 1.25,
            "feedback_reference_velocity_z": 0.75,
            "input": 0.5,
        }
    )
    estimated = {name for name, channel in r.channels.items() if channel.estimated}
    assert estimated == {"position_z", "acceleration_z"}


def test_the_compressed_state(tmp_path):
    values, _ = one_row(
        tmp_path,
        stateEstimateZ__z=1500.0,
        stateEstimateZ__vx=-250.0,
        stateEstimateZ__az=9806.65,
        stateEstimateZ__ratePitch=2000.0,
        ctrltargetZ__az=500.0,
    )
    assert values == pytest.approx(
        {
            "position_z": 1.5,
            "velocity_x": -0.25,
            "specific_force_z": G,
            "angular_rate_y": -2.0,
            "reference_acceleration_z": 0.5,
        }
    )


def test_the_pitch_of_the_angles_is_negated(tmp_path):
    angles = {"stabilizer__roll": 20.0, "stabilizer__pitch": -30.0, "stabilizer__yaw": 40.0}
    values, _ = one_row(tmp_path, **angles)
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_euler("ZYX", [40.0, 30.0, 20.0], degrees=True).as_quat()
    expected = {"attitude_w": w, "attitude_x": x, "attitude_y": y, "attitude_z": z}
    assert values == pytest.approx(expected, abs=1e-7)
    values, _ = one_row(tmp_path, stabilizer__roll=20.0, stabilizer__pitch=-30.0)
    assert values == pytest.approx({"cos_tilt": np.cos(np.pi / 9.0) * np.cos(np.pi / 6.0)}, abs=1e-7)


def test_the_preferred_source_comes_first_and_zeros_are_none(tmp_path):
    values, r = one_row(
        tmp_path, stateEstimateZ__vz=200.0, stateEstimate__vz=0.0, rpm__m1=0.0, motor__m1=0.0, baro__asl=3.0
    )
    assert values == pytest.approx({"velocity_z": 0.2, "rotor_command_1": 0.0})
    assert messages(r, "never_valid") == ["Logged as zero throughout: 'stateEstimate.vz', 'rpm.m1'."]
    (reported,) = messages(r, "ignored_columns")
    assert "'baro.asl'" in reported
    values, _ = one_row(tmp_path, stateEstimateZ__vz=200.0, stateEstimate__vz=0.5)
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


def test_packed_quaternions(tmp_path):
    quaternions = np.random.default_rng(0).normal(size=(50, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1)[:, None]
    rows = [[packed(q)] for q in quaternions]
    c = read(tmp_path, fixed(2, ["stateEstimateZ.quat(I)"], rows)).channels
    got = np.column_stack([c[f"attitude_{part}"].values for part in "xyzw"])
    np.testing.assert_allclose(np.abs(np.sum(got * quaternions, axis=1)), 1.0, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(got, axis=1), 1.0)


def test_a_velocity_setpoint_that_the_position_loop_wrote_is_feedback(tmp_path):
    steps = np.repeat([0.5, 1.0, 0.5], 20)
    answers = np.random.default_rng(0).normal(size=60)
    names = ["ctrltarget.z(f)", "ctrltarget.vz(f)"]
    r = read(tmp_path, fixed(2, names, np.column_stack([steps, answers])))
    assert set(r.channels) == {"reference_position_z", "feedback_reference_velocity_z"}
    assert "it answers the vehicle" in messages(r, "feedback_setpoint")[0]
    t = 0.01 * np.arange(60)
    planned = np.column_stack([1.0 + 0.2 * np.sin(t), 0.2 * np.cos(t)])
    r = read(tmp_path, fixed(2, names, planned))
    assert set(r.channels) == {"reference_position_z", "reference_velocity_z"}


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        ('column = "acc.y"', "a column 'acc.y'.*Did you mean 'acc.z'"),
        (
            'expression = \'"acc.z" - "pm.vbat"\'',
            "one type of events for channels.velocity_z.*no type of 'log07'",
        ),
    ],
)
def test_maps_that_do_not_fit(tmp_path, rule, words):
    text = f'name = "m"\n[time]\ncolumn = "timestamp"\n[channels.velocity_z]\n{rule}\n'
    (tmp_path / "m.toml").write_text(text)
    with pytest.raises(ChannelMapError, match=words):
        read(tmp_path, flight(), channel_map=tmp_path / "m.toml")


# What is wrong with a file.


def test_a_cut_log_is_read_as_far_as_it_goes(tmp_path):
    log = flight()
    sizes = 3 * (10 + 28) + (10 + 4) + (10 + 6)  # three records, and one of each other type
    whole = log.head() + bytes(log.body[:sizes])
    r = read(tmp_path, whole + bytes(log.body[sizes:][:11]))
    assert r.channels["velocity_z"].values.size == 3
    (reported,) = messages(r, "truncated")
    assert "11 bytes at its end, of no whole record, were left out" in reported
    (reported,) = messages(read(tmp_path, whole), "truncated")
    assert "no record is broken" in reported


def test_a_wrong_checksum_is_told(tmp_path):
    content = bytearray(flight().bytes())
    content[-20] ^= 1
    r = read(tmp_path, bytes(content))
    assert r.channels["velocity_z"].values.size == 200
    assert "The checksum does not fit" in messages(r, "checksum")[0]
    assert not messages(r, "truncated")


@pytest.mark.parametrize("lost", [1, 37, 100, 650])
def test_lost_bytes_cost_only_the_records_around_them(tmp_path, lost):
    log = flight()
    content = log.head() + bytes(log.body[:2000]) + bytes(log.body[2000 + lost :])
    r = read(tmp_path, with_checksum(content))
    assert 200 - lost / 40 - 3 <= r.channels["velocity_z"].values.size < 200
    assert r.channels["velocity_z"].time_s[-1] == pytest.approx(1.99)
    reported = messages(r, "corrupt_parts") + messages(r, "time_stamps")
    assert any(
        "bytes that belong to no record" in item or "their stamp cannot be" in item for item in reported
    )


def test_stamps_that_cannot_be(tmp_path):
    log = fixed(2, ["stateEstimate.vz(f)"], [[1.0]] * 100)
    size, start = 14, len(log.head())
    content = bytearray(log.head() + log.body)
    content[start + 40 * size + 2 + 3] += 1  # ahead by 17 s
    content[start + 50 * size + 2 + 7] += 1  # by 2000 years
    content[start + 60 * size + 2 + 2] -= 2  # back by a moment
    content[start + 2 + 3] += 1  # the first record
    r = read(tmp_path, with_checksum(bytes(content)))
    c = r.channels["velocity_z"]
    assert c.values.size == 96
    assert c.time_s[-1] == pytest.approx(0.98)
    assert messages(r, "time_stamps")[0].endswith("cannot be: 3.")
    assert "dropped" not in messages(r, "time_stamps")[0]
    assert "velocity_z 1" in messages(r, "time_stamps")[1]


def head(*parts):
    return b"\xbc" + b"".join(struct.pack("<H", part) if isinstance(part, int) else part for part in parts)


@pytest.mark.parametrize(
    ("content", "error", "words"),
    [
        (head(2), CorruptLogError, "ends in its head"),
        (head(7, 1), CorruptLogError, "version 1 or 2.*version 7.*newer"),
        (head(2, 65535) + bytes(90), CorruptLogError, "65535 types"),
        (head(2, 1, 5, b"e\x00", 65535), CorruptLogError, "65535 variables"),
        (head(2, 1, 5, b"e\x00", 9, b"acc.x(f)\x00"), CorruptLogError, "ends in its head"),
        (head(2, 1, 5, b"e\x00", 1, b"acc.x(z)\x00"), CorruptLogError, r"'acc.x\(z\)', whose type is not"),
        (head(2, 2, 5, b"e\x00", 0, 5, b"f\x00", 0), CorruptLogError, "same id"),
        (
            head(2, 1, 5, b"e\x00", 1, b"acc.x(f)\x00"),
            EmptyLogError,
            "without a whole record.*types of events: 1",
        ),
        (head(2, 1, 5, b"e\x00", 1, b"odd(B)\x00", 5, bytes(9)), EmptyLogError, "with 'odd'.*channel map"),
    ],
)
def test_heads_that_are_not_sound(tmp_path, content, error, words):
    with pytest.raises(error, match=f"(?s){words}"):
        read(tmp_path, content)


def test_a_log_that_announces_no_types_of_events(tmp_path):
    path = tmp_path / "log00"
    path.write_bytes(flight(2).head()[:3] + b"\0\0" + flight(2).bytes()[5:])
    with pytest.raises(EmptyLogError):
        ev.read_log(path)


def test_a_search_without_end_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr("eivor.logs.crazyflie.reader.MAX_SEARCH_BYTES", 2048)
    log = flight()
    content = log.head() + bytes(log.body[:2000]) + b"\x37" * 8192 + bytes(log.body[2000:])
    r = read(tmp_path, with_checksum(content))
    assert 40 < r.channels["velocity_z"].values.size < 60
    left = int(re.search(r"(\d+) bytes", messages(r, "corrupt_parts")[0])[1])
    assert left == pytest.approx(8192 + len(log.body) - 2000, abs=40)


# What people are told.
