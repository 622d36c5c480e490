"""PX4 logs: topics of old and new firmware, delays, setpoints, outputs, and whatever is damaged."""

from __future__ import annotations

import contextlib
import re
import struct

import numpy as np
import pytest
from dataflash_writer import simulated, told
from scipy.signal import butter, group_delay, iirnotch
from scipy.spatial.transform import Rotation
from ulog_writer import UlogWriter, flight, flight_log, message

import eivor as ev
from eivor.errors import CorruptLogError, EmptyLogError


def names(recording):
    return [finding.name for finding in recording.findings]


def test_new_topic_names(read):
    r = read(flight())
    assert (r.format, r.frame, r.name) == ("ulog", ev.Frame.NED, "flight.log")
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
def test_the_vehicle_is_told(read, kinds, parameters, vehicle):
    writer = UlogWriter()
    for name, value in parameters.items():
        writer.parameter(name, value)
    fields = {} if kinds is None else {"vehicle_type__uint8_t": np.array(kinds)}
    writer.topic("vehicle_status", [0.0, 1.0], nav_state__uint8_t=np.array([2, 3]), **fields)
    assert read(writer).vehicle == vehicle


def test_modes_without_height_control_are_told(read):
    modes = np.array([0, 1, 2, 10, 15, 3])
    channels = read(UlogWriter().topic("vehicle_status", np.arange(6.0), nav_state__uint8_t=modes)).channels
    np.testing.assert_array_equal(channels["input_open_loop"].values[-6:], [1.0, 0.0, 0.0, 1.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("filtered", "raw", "source"),
    [(20, 200, "sensor_combined"), (200, 250, "vehicle_acceleration"), (20, 0, "vehicle_acceleration")],
)
def test_the_accelerometer_is_chosen_by_rate(read, filtered, raw, source):
    writer = flight()
    stamps = np.linspace(0.0, 3.9, filtered)
    writer.topic("vehicle_acceleration", stamps, xyz=np.tile([0.0, 0.0, -9.8], (filtered, 1)))
    if raw:
        readings = np.tile([0.0, 0.0, -9.8], (raw, 1))
        writer.topic("sensor_combined", np.linspace(0.0, 3.9, raw), accelerometer_m_s2=readings)
    channels = read(writer).channels
    for axis in "xyz":
        force = channels[f"specific_force_body_{axis}"]
        assert source in force.source
        assert force.values.size == (raw if "combined" in source else filtered)


def test_old_topic_names(read):
    t, every = np.arange(50) * 0.1, np.ones((50, 3))
    writer = (
        UlogWriter(flags=False)
        .topic("vehicle_local_position", t, z=-t, vz=-1 + 0 * t, az=0 * t)
        .topic("sensor_combined", t, gyro_rad=0.1 * every, accelerometer_m_s2=-9.8 * every)
        .topic("actuator_controls_0", t, control=np.tile([0, 0, 0, 0.4, 0], (50, 1)))
        .topic("vehicle_local_position_setpoint", t, z=np.where(t < 2, np.nan, -3), vz=0.5 + 0 * t)
        .topic("manual_control_setpoint", t, z=0.5 + 0 * t)
        .topic("battery_status", t, voltage_v=16 - 0.01 * t)
        .topic("actuator_outputs", t, output=np.stack([900 + t, 900 + 0 * t, 901 + t, np.nan * t], 1))
    )
    r = read(writer)
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


def test_commands_before_and_behind_the_thrust_curve(read):
    record = simulated(seed=3, duration=5.0)
    sides = {}
    for topic in ("actuator_motors", "actuator_outputs"):
        writer = flight_log(record, 0.65, 0.3, topic)
        t = np.arange(50) * 0.1
        writer.topic("esc_status", t, **{f"esc[{n}].esc_rpm": 5000.0 + t for n in range(4)})
        r = read(writer)
        sides[topic] = {
            name: channel.curve_side.name for name, channel in r.channels.items() if channel.curve_side.value
        }
        assert r.channels["actuator_output_1"].source.startswith(topic)
    speeds = {f"rotor_speed_{n}": "BEHIND" for n in range(1, 5)}
    for topic, side in (("actuator_motors", "BEFORE"), ("actuator_outputs", "BEHIND")):
        outputs = {f"actuator_output_{n}": side for n in range(1, 5)}
        assert sides[topic] == {"input": "BEFORE", **outputs, **speeds}


def test_a_silent_setpoint_is_not_in_force(read):
    t = np.concatenate([np.arange(20) * 0.2, 30 + np.arange(20) * 0.2])
    writer = UlogWriter().topic("trajectory_setpoint", t, position=np.full((40, 3), -2.0))
    writer.topic("vehicle_attitude", np.arange(0, 60, 0.1), q=np.tile([1.0, 0, 0, 0], (600, 1)))
    r = read(writer)
    reference = r.channels["reference_position_z"]
    assert "setpoint_silent" in names(r)
    np.testing.assert_allclose(reference.time_s[np.isnan(reference.values)], [4.8, 34.8], atol=1e-6)


def test_instances(read):
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
    r = read(writer)
    assert names(r).count("several_instances") == 3
    np.testing.assert_allclose(r.channels["battery_voltage"].values, 12.0)
    assert (r.channels["attitude_x"].values[0], r.channels["actuator_output_2"].time_s.size) == (1.0, 60)


def test_stamps(read):
    t = np.array([-5.0, 0.0, 1.0, 1.0, 0.5, 2.0, 1e9, 3.0])
    r = read(UlogWriter(start_us=10**16).topic("vehicle_local_position", t, z=np.arange(8.0)))
    z = r.channels["position_z"]
    np.testing.assert_allclose(z.time_s, [-5, 0, 1, 2, 3])
    np.testing.assert_array_equal(z.values, [0, 1, 2, 5, 7])
    assert (z.quality.duplicated_stamps, z.quality.backward_stamps) == (1, 2)
    assert "time_stamps" in names(r)


def test_invalid_samples_are_missing(read):
    t = np.arange(10) * 0.1
    r = read(UlogWriter().topic("vehicle_local_position", t, z=-t, z_valid__bool=t > 0.45))
    assert np.isnan(r.channels["position_z"].values).sum() == 5
    assert "position_z 5" in told(r, "missing_values")


def test_estimator_resets_are_told(read):
    t = np.arange(40) * 0.1
    counter = np.where(t < 2, 254, 255) + (t > 3) * -254
    fields = {"z": -t, "z_reset_counter__uint8_t": counter, "vz_reset_counter__uint8_t": 0 * counter}
    r = read(UlogWriter().topic("vehicle_local_position", t, **fields))
    assert told(r, "estimator_reset") == "The estimate of height jumps at 2.00, 3.10 s."


def test_dropouts_and_a_cut(read):
    r = read(flight().bytes()[:-20])
    assert "truncated" in names(r)
    assert r.channels["position_z"].time_s.size == 200
    r = read(flight().dropout(250).dropout(1000))
    assert told(r, "dropouts") == "The logger lost data 2 times, 1.25 s in total."


def test_appended_data(read):
    writer = flight()
    cut = len(writer.bytes())
    flags = message("B", bytes(8) + b"\x01" + bytes(7) + struct.pack("<3Q", cut - 4, 0, 0))
    writer.definitions = flags + writer.definitions[43:]
    blob = writer.bytes()[: cut - 4] + message("O", b"\x64\x00")
    assert "dropouts" in names(read(blob))


def test_damage_between_sync_marks(read):
    writer = flight()
    writer.raw(b"\xff" * 100).sync()
    for time in np.arange(4, 6, 0.02):
        body = struct.pack("<HQ5f3?", 16, 1_000_000 + round(time * 1e6), -1, 0, 0, 0, 0, 1, 1, 1)
        writer.raw(message("D", body))
    r = read(writer)
    assert "corrupt_parts" in names(r)
    assert r.channels["position_z"].time_s.size == 300


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
def test_unsound_formats_are_left_out(read, definition):
    writer = UlogWriter()
    for text in (definition, b"a:b[65535] x;", b"b:a[65535] x;"):
        writer.definitions += message("F", text)
    writer.raw(message("A", b"\x00\x01\x00vehicle_status")).raw(message("D", b"\x01\x00" + bytes(9)))
    t = np.arange(10) * 0.1
    writer.topic("vehicle_attitude", t, q=np.tile([1.0, 0, 0, 0], (10, 1)))
    r = read(writer)
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
def test_a_damaged_definition_is_told(read, capfd, found, bits):
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
            r = read(bytes(damaged))
            messages = [f.message for f in r.findings if f.name == "corrupt_parts"]
            assert (len(messages) == 1 and "all of sensor_combined" in messages[0]) or (
                # a field of another name is no damage that a reader can know
                bit != 7 and "specific_force_body_z" in r.channels
            )
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("letter", [b"\xf6", b"x"])
def test_a_damaged_subscription_is_counted(read, letter):
    blob = flight().bytes()
    rindex = blob.rindex(b"vehicle_attitude")
    r = read(blob[:rindex] + letter + blob[rindex + 1 :])
    assert "attitude_w" not in r.channels
    assert "corrupt_parts" in names(r)
    assert "200 of topics whose names are damaged" in told(r, "lost_messages")


def test_damaged_messages_are_counted_by_topic(read):
    """Five messages of another length than their format has: a number that is damaged, or a length."""
    r = read(flight().raw(message("D", struct.pack("<H", 16) + bytes(3)) * 5))
    assert re.search(r"read: \w+ 5 of 205\.", told(r, "lost_messages"))


def test_a_nested_format(read):
    writer = UlogWriter()
    writer.definitions += message("F", b"vehicle_status:uint64_t timestamp;inner[2] part;uint8_t nav_state;")
    writer.definitions += message("F", b"inner:float a;float b;")
    writer.raw(message("A", b"\x00\x01\x00vehicle_status"))
    writer.raw(message("D", struct.pack("<HQ4fB", 1, 1_500_000, 0, 0, 0, 0, 15)))
    r = read(writer)
    np.testing.assert_array_equal(r.channels["pilot_in_control"].values, [1.0])


@pytest.mark.parametrize(
    ("functions", "names"),
    [((102, 101, 0), ["rotor_speed_1", "rotor_speed_2"]), ((0, 101, 0), ["rotor_speed_1", "rotor_speed_2"])],
)
def test_telemetry_of_speed_controllers_are_rotor_speeds(read, functions, names):
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
    r = read(writer)
    assert sorted(r.channels) == names
    first, second = (r.channels[name] for name in names)
    if functions[0]:
        first, second = second, first
    assert first.source == "esc_status.esc[0].esc_rpm"
    turn = np.pi / 30.0
    np.testing.assert_allclose(first.values, turn * (9000.0 + 10.0 * np.arange(12)), rtol=1e-12)
    np.testing.assert_allclose(second.values, turn * (4000.0 + np.arange(12)), rtol=1e-12)
    assert not first.held


def test_nothing_is_printed(read, capfd):
    blob = bytearray(flight().bytes())
    rng = np.random.default_rng(0)
    for _ in range(60):
        damaged = bytearray(blob)
        for integer in rng.integers(16, len(blob), 30):
            damaged[integer] = rng.integers(256)
        with contextlib.suppress(CorruptLogError, EmptyLogError):
            read(bytes(damaged))
    assert capfd.readouterr() == ("", "")


def test_a_log_is_read_with_them(read):
    time = 0.004 * np.arange(500)
    log = UlogWriter().parameter("IMU_ACCEL_CUTOFF", 30.0)
    log.topic("vehicle_acceleration", time, xyz=np.ones((500, 3)))
    log.topic("vehicle_thrust_setpoint", time, xyz=-0.5 * np.ones((500, 3)))
    r = read(log)
    late = np.sqrt(2.0) / (2.0 * np.pi * 30.0)
    channel = r.channels["specific_force_body_z"]
    np.testing.assert_allclose(channel.time_s, time - late, atol=1e-9)
    assert channel.delay_s == pytest.approx(late)
    np.testing.assert_allclose(r.channels["input"].time_s, time, atol=1e-9)
    message = told(r, "sensor_delay")
    assert message.endswith("of vehicle_acceleration: 7.5 ms (low-pass of 30 Hz, IMU_ACCEL_CUTOFF).")


def test_a_log_of_pulses_has_shares_for_an_input(read):
    t = np.arange(100) * 0.1
    widths = np.stack([1100 + t * 10, 1200 + t * 10, 1500 + t], 1)
    writer = UlogWriter(flags=False).topic("actuator_outputs", t, output=widths)
    values = {
        "FUNC1": 102,
        "FUNC2": 101,
        "FUNC3": 201,
        "MIN1": 1100,
        "MIN2": 1100,
        "MAX1": 1900,
        "MAX2": 1900,
    }
    for name, value in values.items():
        writer.parameter(f"PWM_MAIN_{name}", value)
    r = read(writer)
    sources = [channel.source for channel in r.family("actuator_output")]
    assert sources == ["actuator_outputs.output[1]", "actuator_outputs.output[0]"]
    np.testing.assert_allclose(r.channels["actuator_output_1"].values, (100 + t * 10) / 800)
    assert told(r, "pulse_widths").endswith(
        "shares of the range 1100 to 1900 (PWM_MAIN_MIN2 and PWM_MAIN_MAX2)."
    )


#: Stamps of 50 messages [us], and group delays of a low-pass and a notch at 1 Hz by SciPy [s].
STAMPS, RATE_HZ = 1_000_000 + 4000 * np.arange(50), 4000.0
LOW_PASS, NOTCH = (
    pytest.approx(group_delay(filtered, w=[1.0], fs=RATE_HZ)[1][0] / RATE_HZ, rel=rel)
    for filtered, rel in (
        (butter(2, 30.0, fs=RATE_HZ), 0.01),
        (iirnotch(80.0, 80.0 / 20.0, fs=RATE_HZ), 0.02),
    )
)
#: Field of each topic, and the channel that is made of it.
MEASURED = {
    "vehicle_acceleration": ("xyz", "specific_force_body_z"),
    "vehicle_angular_velocity": ("xyz", "angular_rate_x"),
    "sensor_combined": ("accelerometer_m_s2", "specific_force_body_z"),
    "vehicle_local_position": ("z", "position_z"),
    "vehicle_thrust_setpoint": ("xyz", "input"),
}


@pytest.mark.parametrize(
    ("topic", "parameters", "fields", "late"),
    [
        ("vehicle_acceleration", {"IMU_ACCEL_CUTOFF": 30.0}, {}, LOW_PASS),
        ("vehicle_angular_velocity", {"IMU_GYRO_CUTOFF": 30.0}, {}, LOW_PASS),
        # the one's parameter says nothing of the other, and zero turns a filter off
        ("vehicle_acceleration", {"IMU_GYRO_CUTOFF": 30.0, "IMU_ACCEL_CUTOFF": 0.0}, {}, 0.0),
        ("vehicle_angular_velocity", {"IMU_GYRO_NF0_FRQ": 80.0, "IMU_GYRO_NF0_BW": 20.0}, {}, NOTCH),
        ("vehicle_angular_velocity", {"IMU_GYRO_NF1_FRQ": 80.0, "IMU_GYRO_NF1_BW": 20.0}, {}, NOTCH),
        ("vehicle_angular_velocity", {"IMU_GYRO_NF_FREQ": 80.0, "IMU_GYRO_NF_BW": 20.0}, {}, NOTCH),
        # half of what readings are the mean of, in microseconds or seconds
        ("sensor_combined", {}, {"accelerometer_integral_dt__uint32_t": 5000}, 0.0025),
        ("sensor_combined", {"IMU_ACCEL_CUTOFF": 30.0}, {"accelerometer_integral_dt": 0.005}, 0.0025),
        # the way from the sample to the stamp; of another clock, or in the future, it is not known
        ("vehicle_local_position", {}, {"timestamp_sample__uint64_t": STAMPS - 1400}, 0.0014),
        ("vehicle_local_position", {}, {"timestamp_sample__uint64_t": STAMPS - 900_000}, 0.0),
        ("vehicle_local_position", {}, {"timestamp_sample__uint64_t": STAMPS + 5000}, 0.0),
        # a setpoint is in force from when it is published
        ("vehicle_thrust_setpoint", {}, {"timestamp_sample__uint64_t": STAMPS - 1400}, 0.0),
    ],
)
def test_delays_of_filters_means_and_ways_to_the_stamp(read, topic, parameters, fields, late):
    writer, (field, name) = UlogWriter(), MEASURED[topic]
    for parameter, value in parameters.items():
        writer.parameter(parameter, value)
    values = -np.linspace(0.4, 0.6, 50)
    fields |= {field: values if field == "z" else np.tile(values[:, None], 3)}
    delay_s = read(writer.topic(topic, 0.004 * np.arange(50), **fields)).channels[name].delay_s
    assert delay_s == (pytest.approx(late) if isinstance(late, float) else late)


RISING = np.linspace(1100.0, 1900.0, 50)


@pytest.mark.parametrize(
    ("outputs", "parameters", "group"),
    [
        ([RISING, 0.0 * RISING], {}, "PWM_MAIN"),
        ([RISING], {"PWM_MAIN_TIM0": 400, "DSHOT_CONFIG": 0}, "PWM_MAIN"),
        ([RISING] * 3, {"PWM_AUX_FUNC1": 102, "PWM_AUX_FUNC2": 101, "PWM_AUX_FUNC3": 201}, "PWM_AUX"),
        ([RISING / 2000.0], {}, ""),
        ([RISING - 900.0], {}, ""),
        ([RISING], {"PWM_MAIN_TIM0": -3}, ""),
        ([RISING], {"DSHOT_CONFIG": 600}, ""),
    ],
)
def test_pulse_widths_of_unknown_range_and_what_is_none_stay(read, outputs, parameters, group):
    writer = UlogWriter().topic("actuator_outputs", 0.1 * np.arange(50), output=np.stack(outputs, 1))
    for name, value in parameters.items():
        writer.parameter(name, value)
    r = read(writer)
    np.testing.assert_allclose(r.channels["actuator_output_1"].values, outputs[0], rtol=1e-6)
    words = f"no parameter gives their range ({group}_MIN1 and {group}_MAX1" if group else ""
    assert words in told(r, "pulse_range_unknown")
    assert ("pulse_range_unknown" in names(r)) == bool(group)
    assert "pulse_widths" not in names(r)


TIME = np.arange(8.0)


def attitude_setpoints(read, states=(), **attitude):
    """Values of the channels of attitude setpoints, with a mode every two seconds."""
    writer = UlogWriter().topic("vehicle_attitude_setpoint", TIME, **attitude) if attitude else UlogWriter()
    writer.topic("vehicle_rates_setpoint", TIME, roll=1.0, pitch=2.0, yaw=3.0)
    if states:
        nav_state = np.array(states)
        writer.topic("vehicle_status", 2.0 * np.arange(nav_state.size), nav_state__uint8_t=nav_state)
    channels = read(writer.topic("vehicle_attitude", TIME, q=np.tile([1.0, 0, 0, 0], (8, 1)))).channels
    return {name: channel.values for name, channel in channels.items() if "reference" in name}


def quaternions(angles):
    return {"q_d": Rotation.from_euler("ZYX", np.array(angles)[:, ::-1]).as_quat(scalar_first=True)}


def test_quaternions_become_angles_and_yaw_has_no_jumps(read):
    angles = np.array([(0.1 * k, -0.05 * k, 2.5 + 0.2 * k) for k in range(8)])
    result = attitude_setpoints(read, (15, 15, 15, 15), **quaternions(angles))
    for number, name in enumerate(("roll", "pitch", "yaw")):
        np.testing.assert_allclose(result[f"reference_{name}"], angles[:, number], atol=1e-6)
        assert f"feedback_reference_{name}" not in result


def test_they_are_told_apart_by_the_mode_in_force(read):
    # from second 0 stabilized, from 2 position, from 4 acro, from 6 altitude
    result = attitude_setpoints(read, (15, 2, 10, 1), **quaternions([(0.3, 0.2, 0.1)] * 8))
    by_sticks = [True, True, False, False, False, False, True, True]
    np.testing.assert_array_equal(np.isfinite(result["reference_roll"]), by_sticks)
    np.testing.assert_array_equal(np.isfinite(result["feedback_reference_roll"]), np.logical_not(by_sticks))
    rates = np.where((TIME >= 4.0) & (TIME < 6.0), 2.0, np.nan)
    np.testing.assert_array_equal(result["reference_angular_rate_y"], rates)


def test_without_a_mode_a_loop_made_them_and_old_logs_hold_angles(read):
    result = attitude_setpoints(read, **quaternions([(0.3, 0.2, 0.1)] * 8))
    assert set(result) == {f"feedback_reference_{name}" for name in ("roll", "pitch", "yaw")}
    old = attitude_setpoints(
        read, (0, 0, 0, 0), roll_body=0.1, pitch_body=0.2, yaw_body=0.3, q_d=np.zeros((8, 4))
    )
    np.testing.assert_allclose(old["reference_pitch"], 0.2, rtol=1e-6)
    assert attitude_setpoints(read, (15,)) == {}
