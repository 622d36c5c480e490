"""Delays of a PX4 log's topics: filters known from parameters, means, the way to the stamp."""

from __future__ import annotations

import contextlib
import io
import re
import struct

import numpy as np
import pytest
from dataflash_writer import simulated
from ulog_writer import UlogWriter, flight, flight_log, message

import eivor as ev
from eivor.errors import CorruptLogError, EmptyLogError, UsageError


def read(tmp_path, writer):
    path = tmp_path / "flight.ulg"
    path.write_bytes(writer if isinstance(writer, bytes) else writer.bytes())
    return ev.read_log(path)


def names(recording):
    return [finding.name for finding in recording.findings]


def test_new_topic_names(tmp_path):
    r = read(tmp_path, flight())
    assert (r.format, r.frame, r.name) == ("ulog", ev.Frame.NED, "flight.ulg")
    assert len(r.sha256) == 64
    assert r.parameters == {"MPC_THR_HOVER": 0.5, "SYS_AUTOSTART": 4001.0}
    assert r.channels["position_z"].values.max() < 0  # z down, as logged
    u = r.channels["input"]
    assert u.values.min() > 0.39  # positive up
    assert u.held
    assert u.source == "-vehicle_thrust_setpoint.xyz[2]"
    np.testing.assert_allclose(u.time_s, np.arange(200) * 0.02, atol=1e-9)
    np.testing.assert_array_equal(r.channels["pilot_in_control"].values, [1.0, 0.0])
    np.testing.assert_array_equal(r.channels["input_open_loop"].values, [0.0, 0.0])
    np.testing.assert_array_equal(r.channels["landed"].values, [1.0, 0.0])
    assert "reference_acceleration_z" not in r.channels
    assert "never_valid" in names(r)
    assert r.channels["attitude_w"].values.size == 200  # padding is cut
    made = {name for name, channel in r.channels.items() if channel.estimated}
    assert made == {name for name, c in r.channels.items() if c.source.startswith("vehicle_local_position.")}
    assert "velocity_z" in made
    with pytest.raises(Exception, match=r"battery_status\.voltage_v \[SDLOG_PROFILE bit 0\]"):
        r.channel("battery_voltage")


@pytest.mark.parametrize(
    ("kinds", "parameters", "vehicle"),
    [
        ([1, 1], {"MAV_TYPE": 1}, "rotary wing"),  # PX4's own word counts
        ([2, 2], {"MAV_TYPE": 2}, "fixed wing"),
        ([1, 1], {"MAV_TYPE": 22}, "rotary wing"),  # a convertible plane that hovers all the time
        ([2, 1], {"MAV_TYPE": 22}, "VTOL"),
        ([1, 1], {"MAV_TYPE": 4}, "helicopter"),
        ([3, 3], {"MAV_TYPE": 11}, "boat"),
        ([3, 3], {"MAV_TYPE": 2}, "rover"),
        ([0, 9], {"MAV_TYPE": 10}, "rover"),
        ([0, 0], {"MAV_TYPE": 2}, ""),
        (None, {"MAV_TYPE": 1}, "fixed wing"),
        (None, {"MAV_TYPE": 11}, "boat"),
        (None, {"MAV_TYPE": 13}, ""),
        (None, {"CA_AIRFRAME": 0}, ""),
        (None, {"CA_AIRFRAME": 1}, "fixed wing"),
        (None, {"CA_AIRFRAME": 6}, "rover"),
        (None, {"CA_AIRFRAME": 3}, "VTOL"),
        (None, {"CA_AIRFRAME": 10}, "helicopter"),
        (None, {"MAV_TYPE": 12}, "submarine"),
    ],
)
def test_the_vehicle_is_told(tmp_path, kinds, parameters, vehicle):
    writer = UlogWriter()
    for name, value in parameters.items():
        writer.parameter(name, value)
    fields = {} if kinds is None else {"vehicle_type__uint8_t": np.array(kinds)}
    writer.topic("vehicle_status", [0.0, 1.0], nav_state__uint8_t=np.array([2, 3]), **fields)
    assert read(tmp_path, writer).vehicle == vehicle


def test_modes_without_height_control_are_told(tmp_path):
    writer = UlogWriter().topic(
        "vehicle_status", np.arange(6.0), nav_state__uint8_t=np.array([0, 1, 2, 10, 15, 3])
    )
    channels = read(tmp_path, writer).channels
    np.testing.assert_array_equal(channels["input_open_loop"].values[-6:], [1.0, 0.0, 0.0, 1.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("filtered", "raw", "source"),
    [(20, 200, "sensor_combined"), (200, 250, "vehicle_acceleration"), (20, 0, "vehicle_acceleration")],
)
def test_the_accelerometer_is_chosen_by_rate(tmp_path, filtered, raw, source):
    writer = flight()
    stamps = np.linspace(0.0, 3.9, filtered)
    writer.topic("vehicle_acceleration", stamps, xyz=np.tile([0.0, 0.0, -9.8], (filtered, 1)))
    if raw:
        readings = np.tile([0.0, 0.0, -9.8], (raw, 1))
        writer.topic("sensor_combined", np.linspace(0.0, 3.9, raw), accelerometer_m_s2=readings)
    channels = read(tmp_path, writer).channels
    for axis in "xyz":
        assert source in channels[f"specific_force_body_{axis}"].source
        assert channels[f"specific_force_body_{axis}"].values.size == (
            raw if "combined" in source else filtered
        )


def test_old_topic_names(tmp_path):
    t = np.arange(50) * 0.1
    writer = (
        UlogWriter(flags=False)
        .topic("vehicle_local_position", t, z=-t, vz=-1 + 0 * t, az=0 * t)
        .topic(
            "sensor_combined", t, gyro_rad=np.full((50, 3), 0.1), accelerometer_m_s2=np.full((50, 3), -9.8)
        )
        .topic("actuator_controls_0", t, control=np.tile([0, 0, 0, 0.4, 0], (50, 1)))
        .topic("vehicle_local_position_setpoint", t, z=np.where(t < 2, np.nan, -3), vz=0.5 + 0 * t)
        .topic("manual_control_setpoint", t, z=0.5 + 0 * t)
        .topic("battery_status", t, voltage_v=16 - 0.01 * t)
        .topic("actuator_outputs", t, output=np.stack([900 + t, 900 + 0 * t, 901 + t, np.nan * t], 1))
    )
    r = read(tmp_path, writer)
    assert r.channels["input"].source == "actuator_controls_0.control[3]"
    assert r.channels["input"].curve_side.name == "BEFORE"
    assert r.channels["actuator_output_1"].curve_side.name == "BEHIND"
    assert r.channels["specific_force_body_z"].source == "sensor_combined.accelerometer_m_s2[2]"
    assert r.channels["angular_rate_x"].source == "sensor_combined.gyro_rad[0]"
    assert "acceleration_z" not in r.channels  # zeros throughout: old firmware does not estimate it
    assert r.channels["pilot_throttle"].source == "manual_control_setpoint.z"
    assert r.channels["actuator_output_2"].source == "actuator_outputs.output[2]"
    assert "actuator_output_3" not in r.channels
    # the controller's velocity setpoint is feedback while a height is commanded, a climb rate otherwise
    commanded, feedback = r.channels["reference_velocity_z"], r.channels["feedback_reference_velocity_z"]
    np.testing.assert_array_equal(np.isfinite(commanded.values), commanded.time_s < 1.99)
    np.testing.assert_array_equal(np.isfinite(feedback.values), feedback.time_s > 1.99)


def test_commands_before_and_behind_the_thrust_curve(tmp_path):
    record = simulated(seed=3, duration=5.0)
    sides = {}
    for topic in ("actuator_motors", "actuator_outputs"):
        writer = flight_log(record, 0.65, 0.3, topic)
        t = np.arange(50) * 0.1
        writer.topic("esc_status", t, **{f"esc[{n}].esc_rpm": 5000.0 + t for n in range(4)})
        r = read(tmp_path, writer)
        sides[topic] = {
            name: channel.curve_side.name for name, channel in r.channels.items() if channel.curve_side.value
        }
        assert r.channels["actuator_output_1"].source.startswith(topic)
    speeds = {f"rotor_speed_{n}": "BEHIND" for n in range(1, 5)}
    for topic, side in (("actuator_motors", "BEFORE"), ("actuator_outputs", "BEHIND")):
        outputs = {f"actuator_output_{n}": side for n in range(1, 5)}
        assert sides[topic] == {"input": "BEFORE", **outputs, **speeds}


def test_a_silent_setpoint_is_not_in_force(tmp_path):
    t = np.concatenate([np.arange(20) * 0.2, 30 + np.arange(20) * 0.2])
    writer = UlogWriter().topic("trajectory_setpoint", t, position=np.full((40, 3), -2.0))
    r = read(
        tmp_path, writer.topic("vehicle_attitude", np.arange(0, 60, 0.1), q=np.tile([1.0, 0, 0, 0], (600, 1)))
    )
    reference = r.channels["reference_position_z"]
    assert "setpoint_silent" in names(r)
    np.testing.assert_allclose(reference.time_s[np.isnan(reference.values)], [4.8, 34.8], atol=1e-6)


def test_instances(tmp_path):
    t = np.arange(100) * 0.1
    writer = (
        UlogWriter()
        .topic("vehicle_attitude", t[:10], q=np.tile([1.0, 0, 0, 0], (10, 1)))
        .topic("vehicle_attitude", t, instance=1, q=np.tile([0.0, 1, 0, 0], (100, 1)))
        .topic("battery_status", t, voltage_v=0 * t, connected__bool=t < -1)
        .topic("battery_status", t, instance=1, voltage_v=12 + 0 * t, connected__bool=t > -1)
        .topic("actuator_outputs", t, output=np.full((100, 2), 1000.0))
        .topic("actuator_outputs", t[:60], instance=1, output=np.stack([t, 2 * t], 1)[:60])
    )
    r = read(tmp_path, writer)
    assert names(r).count("several_instances") == 3
    np.testing.assert_allclose(r.channels["battery_voltage"].values, 12.0)
    assert r.channels["attitude_x"].values[0] == 1.0
    assert r.channels["actuator_output_2"].time_s.size == 60


def test_stamps(tmp_path):
    t = np.array([-5.0, 0.0, 1.0, 1.0, 0.5, 2.0, 1e9, 3.0])
    r = read(tmp_path, UlogWriter(start_us=10**16).topic("vehicle_local_position", t, z=np.arange(8.0)))
    z = r.channels["position_z"]
    np.testing.assert_allclose(z.time_s, [-5, 0, 1, 2, 3])
    np.testing.assert_array_equal(z.values, [0, 1, 2, 5, 7])
    assert (z.quality.duplicated_stamps, z.quality.backward_stamps) == (1, 2)
    assert "time_stamps" in names(r)


def test_invalid_samples_are_missing(tmp_path):
    t = np.arange(10) * 0.1
    r = read(tmp_path, UlogWriter().topic("vehicle_local_position", t, z=-t, z_valid__bool=t > 0.45))
    assert np.isnan(r.channels["position_z"].values).sum() == 5
    assert any(f.name == "missing_values" and "position_z 5" in f.message for f in r.findings)


def test_estimator_resets_are_told(tmp_path):
    t = np.arange(40) * 0.1
    counter = np.where(t < 2, 254, 255) + (t > 3) * -254
    fields = {"z": -t, "z_reset_counter__uint8_t": counter, "vz_reset_counter__uint8_t": 0 * counter}
    r = read(tmp_path, UlogWriter().topic("vehicle_local_position", t, **fields))
    messages = [f.message for f in r.findings if f.name == "estimator_reset"]
    assert messages == ["The estimate of height jumps at 2.00, 3.10 s."]


def test_dropouts(tmp_path):
    r = read(tmp_path, flight().dropout(250).dropout(1000))
    assert [f.message for f in r.findings if f.name == "dropouts"] == [
        "The logger lost data 2 times, 1.25 s in total."
    ]


def test_truncated(tmp_path):
    blob = flight().bytes()
    r = read(tmp_path, blob[:-20])
    assert "truncated" in names(r)
    assert r.channels["position_z"].time_s.size == 200


def test_appended_data(tmp_path):
    writer = flight()
    cut = len(writer.bytes())
    writer.definitions = (
        message("B", bytes(8) + b"\x01" + bytes(7) + struct.pack("<3Q", cut - 4, 0, 0))
        + writer.definitions[43:]
    )
    blob = writer.bytes()[: cut - 4] + message("O", b"\x64\x00")
    assert "dropouts" in names(read(tmp_path, blob))


def test_damage_between_sync_marks(tmp_path):
    writer = flight()
    t = np.arange(4, 6, 0.02)
    writer.raw(b"\xff" * 100 + message("S", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"))
    number = 16 + 0
    for time in t:
        body = struct.pack("<HQ", number, 1_000_000 + round(time * 1e6)) + struct.pack(
            "<5f3?", -1, 0, 0, 0, 0, 1, 1, 1
        )
        writer.raw(message("D", body))
    r = read(tmp_path, writer)
    assert "corrupt_parts" in names(r)
    assert r.channels["position_z"].time_s.size == 300


def test_nothing_useful(tmp_path):
    with pytest.raises(EmptyLogError, match="one of the topics"):
        read(tmp_path, UlogWriter().topic("wind", [0.0, 1.0], windspeed_north=np.zeros(2)))
    with pytest.raises(CorruptLogError, match="header of 16 bytes"):
        read(tmp_path, UlogWriter().bytes()[:12])


def test_unknown_flags(tmp_path):
    writer = flight()
    writer.definitions = message("B", bytes(8) + b"\x02" + bytes(31)) + writer.definitions[43:]
    with pytest.raises(CorruptLogError, match="incompatible flags"):
        read(tmp_path, writer)


def test_a_channel_map_is_refused(tmp_path):
    path = tmp_path / "f.ulg"
    path.write_bytes(flight().bytes())
    with pytest.raises(UsageError, match="only with logs whose columns have any names"):
        ev.read_log(path, channel_map="nanobench")


@pytest.mark.parametrize(
    "definition",
    [
        b"vehicle_status:uint64_t timestamp;" + b"a[65535] x;" * 3,
        b"vehicle_status:uint64_t timestamp;vehicle_status self;",
        b"vehicle_status:uint64_t timestamp;uint8_t[99999999999] nav_state;",
        b"vehicle_status:uint64_t timestamp;uint8_t[-1] nav_state;",
        b"vehicle_status:uint64_t timestamp;uint8_t nav_state;uint8_t nav_state;",
        b"vehicle_status",
    ],
)
def test_unsound_formats_are_left_out(tmp_path, definition):
    bomb = b"a:" + b"b[65535] x;"
    writer = UlogWriter()
    writer.definitions += message("F", definition) + message("F", bomb) + message("F", b"b:" + b"a[65535] x;")
    writer.raw(message("A", b"\x00\x01\x00vehicle_status")).raw(message("D", b"\x01\x00" + bytes(9)))
    t = np.arange(10) * 0.1
    writer.topic("vehicle_attitude", t, q=np.tile([1.0, 0, 0, 0], (10, 1)))
    r = read(tmp_path, writer)
    assert "pilot_in_control" not in r.channels
    assert "corrupt_parts" in names(r)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("found", "bits"),
    [
        (b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;", [7]),
        (b"sensor_combined:", range(8)),
        (b"float[3] gyro", range(3, 8)),  # the lowest bits make other numbers of other fields
    ],
)
def test_a_damaged_definition_is_told(tmp_path, capfd, found, bits):
    """Whatever bit of it is wrong: the topic is named as lost, and nothing is printed."""
    t = np.arange(50) * 0.1
    force = np.tile([0.1, 0.2, -9.8], (50, 1))
    writer = UlogWriter().topic("vehicle_attitude", t, q=np.tile([1.0, 0, 0, 0], (50, 1)))
    writer.topic("sensor_combined", t, gyro_rad=0 * force, accelerometer_m_s2=force)
    blob = writer.bytes()
    for index in range(blob.index(found), blob.index(found) + len(found)):
        for bit in bits:
            damaged = bytearray(blob)
            damaged[index] ^= 1 << bit
            r = read(tmp_path, bytes(damaged))
            messages = [f.message for f in r.findings if f.name == "corrupt_parts"]
            assert (len(messages) == 1 and "all of sensor_combined" in messages[0]) or (
                # a field of another name is no damage that a reader can know
                bit != 7 and "specific_force_body_z" in r.channels
            )
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("letter", [b"\xf6", b"x"])
def test_a_damaged_subscription_is_counted(tmp_path, letter):
    blob = flight().bytes()
    rindex = blob.rindex(b"vehicle_attitude")
    r = read(tmp_path, blob[:rindex] + letter + blob[rindex + 1 :])
    assert "attitude_w" not in r.channels
    assert "corrupt_parts" in names(r)
    (lost,) = [finding.message for finding in r.findings if finding.name == "lost_messages"]
    assert "200 of topics whose names are damaged" in lost


def test_damaged_messages_are_counted_by_topic(tmp_path):
    """Five messages of another length than their format has: a number that is damaged, or a length."""
    r = read(tmp_path, flight().raw(message("D", struct.pack("<H", 16) + bytes(3)) * 5))
    (lost,) = [finding.message for finding in r.findings if finding.name == "lost_messages"]
    assert re.search(r"read: \w+ 5 of 205\.", lost)


def test_a_nested_format(tmp_path):
    writer = UlogWriter()
    writer.definitions += message("F", b"vehicle_status:uint64_t timestamp;inner[2] part;uint8_t nav_state;")
    writer.definitions += message("F", b"inner:float a;float b;")
    writer.raw(message("A", b"\x00\x01\x00vehicle_status"))
    writer.raw(message("D", struct.pack("<HQ4fB", 1, 1_500_000, 0, 0, 0, 0, 15)))
    r = read(tmp_path, writer)
    np.testing.assert_array_equal(r.channels["pilot_in_control"].values, [1.0])


@pytest.mark.parametrize(
    ("functions", "names"),
    [((102, 101, 0), ["rotor_speed_1", "rotor_speed_2"]), ((0, 101, 0), ["rotor_speed_1", "rotor_speed_2"])],
)
def test_telemetry_of_speed_controllers_are_rotor_speeds(tmp_path, functions, names):
    """By the motor that a report says it is of, or in the order of reports; one that stands still is none."""
    t, report = np.arange(0, 3, 0.25), "int32_t esc_rpm;uint8_t actuator_function"
    writer = UlogWriter()
    writer.definitions += message("F", f"esc_report:{report};".encode())
    writer.definitions += message("F", b"esc_status:uint64_t timestamp;uint8_t esc_count;esc_report[3] esc;")
    writer.data += message("A", struct.pack("<BH", 0, 3) + b"esc_status")
    for k, time in enumerate(t):
        reports = [(9000 + 10 * k, functions[0]), (4000 + k, functions[1]), (0, functions[2])]
        payload = b"".join(struct.pack("<iB", *item) for item in reports)
        stamp = writer.start_us + round(time * 1e6)
        writer.data += message("D", struct.pack("<HQB", 3, stamp, 3) + payload)
    r = read(tmp_path, writer)
    assert sorted(r.channels) == names
    first, second = (r.channels[name] for name in names)
    if functions[0]:
        first, second = second, first
    assert first.source == "esc_status.esc[0].esc_rpm"
    turn = np.pi / 30.0
    np.testing.assert_allclose(first.values, turn * (9000.0 + 10.0 * np.arange(12)), rtol=1e-12)
    np.testing.assert_allclose(second.values, turn * (4000.0 + np.arange(12)), rtol=1e-12)
    assert not first.held


def test_nothing_is_printed(tmp_path):
    blob = bytearray(flight().bytes())
    rng = np.random.default_rng(0)
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        for _ in range(60):
            damaged = bytearray(blob)
            for integer in rng.integers(16, len(blob), 30):
                damaged[integer] = rng.integers(256)
            with contextlib.suppress(CorruptLogError, EmptyLogError):
                read(tmp_path, bytes(damaged))
    assert out.getvalue() == ""
    assert err.getvalue() == ""


def test_a_log_is_read_with_them(tmp_path):
    time = 0.004 * np.arange(500)
    log = UlogWriter().parameter("IMU_ACCEL_CUTOFF", 30.0)
    log.topic("vehicle_acceleration", time, xyz=np.ones((500, 3)))
    log.topic("vehicle_thrust_setpoint", time, xyz=-0.5 * np.ones((500, 3)))
    (tmp_path / "log.ulg").write_bytes(log.bytes())
    r = ev.read_log(tmp_path / "log.ulg")
    late = np.sqrt(2.0) / (2.0 * np.pi * 30.0)
    channel = r.channels["specific_force_body_z"]
    np.testing.assert_allclose(channel.time_s, time - late, atol=1e-9)
    assert channel.delay_s == pytest.approx(late)
    np.testing.assert_allclose(r.channels["input"].time_s, time, atol=1e-9)
    (message,) = [finding.message for finding in r.findings if finding.name == "sensor_delay"]
    assert message.endswith("of vehicle_acceleration: 7.5 ms (low-pass of 30 Hz, IMU_ACCEL_CUTOFF).")


def test_a_log_of_pulses_has_shares_for_an_input(tmp_path):
    t = np.arange(100) * 0.1
    widths = np.stack([1100 + t * 10, 1200 + t * 10, 1500 + t], 1)
    writer = UlogWriter(flags=False).topic("actuator_outputs", t, output=widths)
    for name, value in (
        ("PWM_MAIN_FUNC1", 102),
        ("PWM_MAIN_FUNC2", 101),
        ("PWM_MAIN_FUNC3", 201),
        *((f"PWM_MAIN_{end}{n}", width) for end, width in (("MIN", 1100), ("MAX", 1900)) for n in (1, 2)),
    ):
        writer = writer.parameter(name, value)
    r = read(tmp_path, writer)
    sources = [channel.source for channel in r.family("actuator_output")]
    assert sources == ["actuator_outputs.output[1]", "actuator_outputs.output[0]"]
    np.testing.assert_allclose(r.channels["actuator_output_1"].values, (100 + t * 10) / 800)
    (finding,) = [item for item in r.findings if item.name == "pulse_widths"]
    assert finding.message.endswith("shares of the range 1100 to 1900 (PWM_MAIN_MIN2 and PWM_MAIN_MAX2).")
